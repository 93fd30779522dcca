"""Claims about `rx90b-flex identify`: what it finds, what it writes, and that nothing impossible leaves it unseen."""

from __future__ import annotations

import dataclasses
import json
import pickle
from pathlib import Path

import independent as ind
import numpy as np
import pandas as pd
import pytest
from scipy import optimize

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.bodies import inconsistencies
from rx90b_flex.identify.command import Identified, identify_campaign, write_identified
from rx90b_flex.identify.physical import consistent_parameters
from rx90b_flex.view.identify_report import headline

RATE_HZ, CUTOFF_HZ = 100.0, 10.0
COULOMB, VISCOUS, NOISE = (2.0, 1.0), (3.0, 1.5), (0.2, 0.08)
DECLARED = [{"type": t, "joint": j} for j in ("shoulder", "elbow") for t in ("coulomb_friction", "viscous_friction")]


def campaign(
    folder: Path, seed: int = 1, noise: float = 1.0, viscous: tuple[float, float] = VISCOUS, known: bool = False
) -> Path:
    """Two recordings of an arm of two joints, made without the package."""
    folder.mkdir(exist_ok=True)
    arm, rng = ind.two_joints(folder), np.random.default_rng(seed)
    motions = [ind.harmonics(rng, 2, period_s=6.0, rate_hz=RATE_HZ) for _ in range(2)]
    runs = [
        ind.run(arm, role, m, [ind.friction(COULOMB, viscous)], noise * ind.white(rng, len(m.time), NOISE))
        for role, m in zip(("identification", "validation"), motions, strict=True)
    ]
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ, known=known)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Identified:
    return identify_campaign(campaign(tmp_path_factory.mktemp("data")))


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0)  # type: ignore[arg-type]


def test_friction_is_found_within_its_standard_deviations(result: Identified) -> None:
    found = {e.name: e for e in result.parameters}
    for joint, coulomb, viscous in zip(("shoulder", "elbow"), COULOMB, VISCOUS, strict=True):
        for name, true in (
            (f"{joint}.coulomb_friction.torque", coulomb),
            (f"{joint}.viscous_friction.coefficient", viscous),
        ):
            estimate = found[name]
            assert estimate.value is not None and estimate.std is not None
            assert abs(estimate.value - true) < 4 * estimate.std
            assert estimate.std < 0.1 * true


def test_a_result_that_was_pickled_gives_the_same_numbers(result: Identified) -> None:
    loaded = pickle.loads(pickle.dumps(result))
    assert loaded.parameters == result.parameters and loaded.identification == result.identification
    assert loaded.robot.effects == result.robot.effects
    for name in ("theta", "covariance", "columns"):
        np.testing.assert_array_equal(getattr(loaded.model, name), getattr(result.model, name))
    again, first = (r.model.residual_on(r.model.regression) for r in (loaded, result))
    np.testing.assert_array_equal(again, first)
    q, v, a = np.full((3, 2), 0.3)
    np.testing.assert_array_equal(loaded.robot.inverse_dynamics(q, v, a), result.robot.inverse_dynamics(q, v, a))


def test_base_parameters_are_the_true_combinations_within_their_standard_deviations(result: Identified) -> None:
    robot = result.model.regression.robot
    true = dict(zip(robot.parameter_names, robot.parameters, strict=True))
    friction = {f"{j}.coulomb_friction.torque": x for j, x in zip(("shoulder", "elbow"), COULOMB, strict=True)}
    friction |= {f"{j}.viscous_friction.coefficient": x for j, x in zip(("shoulder", "elbow"), VISCOUS, strict=True)}
    true |= friction
    assert len(result.base) == result.model.solution.rank
    z = [(b.value - sum(c * true[name] for name, c in b.terms)) / b.std for b in result.base]
    assert np.abs(z).max() < 4


def test_what_is_predicted_is_predicted_by_the_robot_that_is_exported(result: Identified, tmp_path: Path) -> None:
    write_identified(result, tmp_path)
    robot = rf.load_robot(tmp_path / "robot.toml")
    assert inconsistencies(robot.link_parameters, [name for name, _ in robot.bodies]) == ()
    table = pd.read_csv(tmp_path / f"prediction_{result.campaign.validation[0].name}.csv")
    error = (
        table[["tau_shoulder", "tau_elbow"]].to_numpy() - table[["tau_model_shoulder", "tau_model_elbow"]].to_numpy()
    )
    np.testing.assert_allclose(np.sqrt((error**2).mean(axis=0)), result.validation.torque_rms, rtol=1e-9)
    passed = np.sqrt(2 * CUTOFF_HZ / RATE_HZ)  # of white noise, by the low-pass
    assert (np.array(result.validation.torque_rms) < 1.5 * passed * np.array(NOISE)).all()


def test_links_that_noise_makes_impossible_are_named_and_replaced(tmp_path: Path) -> None:
    noisy = identify_campaign(campaign(tmp_path / "data", noise=10.0))
    assert noisy.consistency.found  # at ten times the noise the small moments come out impossible
    robot = noisy.robot
    assert inconsistencies(robot.link_parameters, [name for name, _ in robot.bodies]) == ()
    assert noisy.consistency.largest_shift_std < 3
    assert noisy.consistency.relative_error_after < 1.05 * noisy.consistency.relative_error_before


def test_friction_below_zero_is_held_at_zero_and_said(tmp_path: Path) -> None:
    held = identify_campaign(campaign(tmp_path / "data", viscous=(3.0, -0.5)))
    assert held.consistency.held == ("elbow.viscous_friction.coefficient",)
    by_name = dict(zip(held.robot.parameter_names, held.robot.parameters, strict=True))
    assert by_name["elbow.viscous_friction.coefficient"] == 0.0
    (tmp_path / "out").mkdir()
    write_identified(held, tmp_path / "out")  # a robot file with a negative coefficient would not load


def test_values_that_are_told_are_possible_and_a_wrong_sign_is_named_as_the_cause(tmp_path: Path) -> None:
    source = campaign(tmp_path / "data")
    for log in (tmp_path / "data").glob("log_*.csv"):
        table = pd.read_csv(log)
        table[["moment_0", "moment_1"]] *= -1.0
        table.to_csv(log, index=False)
    found = identify_campaign(source)
    named = {e.name: e.value for e in found.parameters}
    fitted = {e.name: e.value for e in found.fitted}
    for joint, coulomb in zip(("shoulder", "elbow"), COULOMB, strict=True):
        name = f"{joint}.coulomb_friction.torque"
        assert fitted[name] == pytest.approx(-coulomb, rel=0.1)
        assert named[name] is not None and named[name] >= 0.0
        assert name in found.consistency.wrong_sign
    lead = " ".join(headline(found))
    assert "column has the wrong sign" in lead
    assert "shoulder.coulomb_friction.torque" in lead
    (tmp_path / "out").mkdir()
    write_identified(found, tmp_path / "out")
    written = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert all(p["value"] >= 0.0 for p in written["parameters"] if p["name"].endswith(("torque", "coefficient")))
    assert written["physical_consistency"]["wrong_sign"]


def test_nothing_is_said_of_wrong_signs_where_there_are_none(result: Identified) -> None:
    assert result.consistency.wrong_sign == ()
    assert "wrong sign" not in " ".join(headline(result))


def test_nothing_is_told_of_a_joint_that_never_moves(tmp_path: Path) -> None:
    arm, rng, runs = ind.two_joints(tmp_path), np.random.default_rng(0), []
    for role in ("identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=6.0, rate_hz=RATE_HZ)
        still = np.array([1.0, 0.0])  # the elbow is held, its encoder counts noise
        m = ind.Motion(m.time, m.q * still + [0.0, 0.4], m.v * still, m.a * still)
        logged = ind.run(arm, role, m, [ind.friction(COULOMB, VISCOUS)], ind.white(rng, len(m.time), NOISE))
        noisy = dataclasses.replace(m, q=m.q + 1e-5 * rng.normal(size=m.q.shape))
        runs.append(dataclasses.replace(logged, motion=noisy))
    found = identify_campaign(ind.write_files(tmp_path, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ))
    told = {e.name: e.value for e in found.parameters}
    assert [value for name, value in told.items() if name.startswith("elbow.")] == [None, None, None]
    assert told["shoulder.viscous_friction.coefficient"] == pytest.approx(VISCOUS[0], rel=0.1)


def test_bounds_without_bodies_give_bounded_least_squares() -> None:
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(30, 5)) + rng.normal(size=(30, 1))  # they look alike: one that is held moves the others
    target = columns @ [-0.5, 0.3, -0.1, 1.0, -1.0] + 0.1 * rng.normal(size=30)
    estimate = np.linalg.lstsq(columns, target, rcond=None)[0]
    lower = np.where(np.arange(5) < 3, 0.0, -np.inf)
    assert (estimate < lower).any()
    found = consistent_parameters(estimate, columns.T @ columns, estimate, lower=lower, pull=1e-9).parameters
    bounded = optimize.lsq_linear(columns, target, (lower, np.full(5, np.inf))).x
    np.testing.assert_allclose(found, bounded, atol=1e-5)


def test_without_validation_recordings_the_fit_itself_is_shown_and_said_to_be(tmp_path: Path) -> None:
    source = campaign(tmp_path / "data")
    source.write_text(source.read_text().replace('"validation"', '"identification"'))
    found = identify_campaign(source)
    assert found.validation is None
    assert [p.recording.name for p in found.predictions] == ["log_1", "log_2"]
    assert "on the data of the fit" in headline(found)[0]


def test_known_links_are_kept(tmp_path: Path) -> None:
    found = identify_campaign(campaign(tmp_path / "data", known=True))
    np.testing.assert_array_equal(found.robot.link_parameters, found.source.link_parameters)
    # of each joint's dry friction the torque and the velocity within which it turns over; of viscous friction the slope
    own = ["coulomb_friction.torque", "coulomb_friction.turnover", "viscous_friction.coefficient"]
    assert sorted(e.name for e in found.parameters) == sorted(f"{j}.{p}" for j in ("shoulder", "elbow") for p in own)


def test_drives_that_bend_without_a_stiffness_stay_so_and_it_is_said(result: Identified, tmp_path: Path) -> None:
    path = campaign(tmp_path)
    file = tmp_path / "robot_declared.toml"
    for joint in ("shoulder", "elbow"):
        for kind in ("drive_flexibility", *(["stiffness_hardening"] if joint == "elbow" else [])):
            file.write_text(file.read_text() + f'\n[[effects]]\ntype = "{kind}"\njoint = "{joint}"\n')
    bending = identify_campaign(path)
    assert [(e.value, e.std) for e in bending.parameters] == [(e.value, e.std) for e in result.parameters]
    stiff = "shoulder.drive_flexibility, elbow.drive_flexibility, elbow.stiffness_hardening"
    assert any(n.startswith(f"{stiff}: declared without") for n in bending.cautions)
    assert rf.check(path).usable
    (tmp_path / "out").mkdir()
    write_identified(bending, tmp_path / "out")
    exported = rf.load_robot(tmp_path / "out" / "robot.toml")
    assert [e.label for e in exported.effects if e.label in stiff] == stiff.split(", ")


def test_the_command_writes_a_report_that_opens_offline_and_json_without_nan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = campaign(tmp_path / "data"), tmp_path / "out"
    assert run(monkeypatch, "identify", source, "--out", out) == 0
    assert {p.name for p in out.iterdir()} == {
        "identification.json", "prediction_log_2.csv", "report.html", "robot.toml", "robot.urdf",
    }  # fmt: skip
    written = json.loads((out / "identification.json").read_text())
    assert written["schema"] == 1 and written["joints"] == ["shoulder", "elbow"]
    assert written["rank"] == len(written["base_parameters"])
    assert written["validation"]["relative_error"] < 0.1
    html = (out / "report.html").read_text()
    assert 'src="http' not in html and "Base parameters" in html and "elbow.viscous_friction.coefficient" in html
    assert "torque error is" in capsys.readouterr().out


def test_bad_input_is_one_line_status_2_and_nothing_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = campaign(tmp_path / "data"), tmp_path / "out"
    source.write_text(source.read_text().replace('"elbow"', '"albow"'))
    assert run(monkeypatch, "identify", source, "--out", out) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "campaign.toml: joints: unknown joint 'albow'" in error
    assert not out.exists()
