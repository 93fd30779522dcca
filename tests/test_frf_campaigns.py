"""Claims about campaigns as users have them: several poses in one run, and recordings that are missing, short or unfit, by name."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from linear_campaign import BENT, HZ, LINES, RATE, SAMPLES, changed, recordings_at, viscous_robot, write

from rx90b_flex import cli
from rx90b_flex.identify import frf_command
from rx90b_flex.identify.frf import POSE_SPREAD, confidence_radius, estimate_frequency_response, group_poses
from rx90b_flex.identify.frf_command import FrfOptions, frf_json, identify_from_motors
from rx90b_flex.identify.grey_box import VAGUE
from rx90b_flex.identify.grey_model import Delay
from rx90b_flex.joint_units import flexibility_unit, response_unit
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import Recording, load_campaign
from rx90b_flex.simulate.excite import write_reference
from rx90b_flex.simulate.trajectories import Trajectory
from rx90b_flex.view import frf_report
from rx90b_flex.view.page import Image

QUICK = FrfOptions(starts=0, modes=(5,), bending_alike_std=0.0, replay=False)
STRETCHED = np.array([0.0, 0.5 * np.pi, 0.0])
ROBOT = viscous_robot()


def first_samples(r: Recording, count: int) -> Recording:
    assert r.feedforward_torque is not None
    return dataclasses.replace(
        r,
        time=r.time[:count],
        position=r.position[:count],
        torque=r.torque[:count],
        feedforward_torque=r.feedforward_torque[:count],
    )


def alike_at_a_line(runs: Sequence[Recording], line: int) -> list[Recording]:
    """Experiment 2 repeats experiment 1 at one line."""
    by_name = {r.name: r for r in runs}

    def with_other(r: Recording) -> Recording:
        if "_2_" not in r.name:
            return r
        new = {}
        for field in ("torque", "position", "feedforward_torque"):
            waves = [getattr(x, field).reshape(-1, SAMPLES, 3) for x in (r, by_name[r.name.replace("_2_", "_1_")])]
            own, other = np.fft.rfft(waves, axis=2)
            own[:, line] = other[:, line]
            new[field] = np.fft.irfft(own, SAMPLES, axis=1).reshape(-1, 3)
        return dataclasses.replace(r, **new)

    return [with_other(r) for r in runs]


def run(campaign: Path, out: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "frf", str(campaign), "--out", str(out), *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


# ---- several poses --------------------------------------------------------------------------------------------


def test_recordings_are_grouped_by_mean_angle_in_any_order() -> None:
    rng = np.random.default_rng(0)
    runs = [r for k, pose in enumerate(BENT) for r in recordings_at(ROBOT, pose, rng, realisations=2, name=f"p{k}")]
    near = [dataclasses.replace(r, name=f"near_{r.name}", position=r.position + 0.5 * POSE_SPREAD) for r in runs[:1]]
    shuffled = [[*runs, *near][i] for i in rng.permutation(len(runs) + 1)]
    groups = group_poses(shuffled)
    assert sorted(len(g) for g in groups) == [len(runs) // 2, len(runs) // 2 + 1]
    for group in groups:
        assert len({r.name.replace("near_", "")[:2] for r in group}) == 1


@pytest.mark.slow
def test_two_poses_tell_what_a_stretched_arm_alone_cannot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stretched, joints 2 and 3 bend about the same axis; one more pose parts them, and links and hinges are those of both."""
    rng = np.random.default_rng(1)
    poses = (STRETCHED, BENT[0])
    runs = [r for k, q in enumerate(poses) for r in recordings_at(ROBOT, q, rng, noise=0.01, name=f"p{k}")]
    both = identify_from_motors(write(tmp_path / "both", ROBOT, runs), QUICK)
    alone = identify_from_motors(write(tmp_path / "alone", ROBOT, runs[: len(runs) // 2]), QUICK)
    assert both.left_out == alone.left_out == ()
    assert both.grey is not None and alone.grey is not None
    vague = [e.name for e in alone.grey.estimates if ".joint_" in e.name and e.std > VAGUE * e.value]
    assert vague and all(both.grey[name].std < VAGUE * both.grey[name].value for name in vague)
    for e in both.grey.estimates:
        where, kind = e.name.rsplit(".", 1)
        if not kind.startswith("friction_slope"):
            # the robot is declared as it is: start is the truth; thirty normal errors stay below four deviations
            assert abs(np.log(e.value / e.start)) < 4.0 * e.std / e.value, (where, kind)
    found = frf_json(both)
    assert [p["pose_rad"] for p in found["poses"]] == [pytest.approx(q, abs=1e-3) for q in poses]
    for p, q in zip(found["poses"], poses, strict=True):
        value = np.array(p["frequency_response"]["real"]) + 1j * np.array(p["frequency_response"]["imag"])
        truth = ROBOT.linearize(ROBOT.input_matrix @ q).frf(HZ)
        assert np.max(np.abs(value - truth) / np.array(p["frequency_response"]["std"])) < 6.0
        assert p["transfer_functions"] and p["drives"] and len(p["recordings"]) == 24
    assert found["grey_box"]["poses"] == ["pose 1", "pose 2"]
    monkeypatch.setattr(
        frf_report, "image", lambda figure, alt, caption="", zoom=False: Image("", alt, 1, 1, caption)
    )  # drawing is slow
    frf_report.write_frf_report(both, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    for words in ("Pose 1: Frequency response", "Pose 2: Frequency response", "Pose 2: Transfer functions"):
        assert words in page


def test_modes_and_delays_of_transfer_functions_are_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rng, delay = np.random.default_rng(7), 1.25e-4
    runs = [late(r, delay) for r in recordings_at(ROBOT, BENT[0], rng, noise=0.01)]
    file = write(tmp_path / "c", ROBOT, runs)
    monkeypatch.setattr(frf_command, "FrfOptions", functools.partial(FrfOptions, starts=0))
    monkeypatch.setattr("rx90b_flex.view.frf_report.write_frf_report", lambda result, path: path.write_text("report"))
    arguments = ("--modes", "5", "--delays", "common", "--no-replay")
    assert run(file, tmp_path / "out", monkeypatch, *arguments) == 0
    assert "µs later than angles" in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "frf.json").read_text())
    transfer = found["poses"][0]["transfer_functions"]
    assert len(transfer["resonances"]) <= 5
    (one,), whole = transfer["torque_delays"], found["grey_box"]["torque_delay"]
    assert one["unit"] == whole["unit"] == "s"
    assert abs(whole["value"] - delay) < min(4.0 * whole["std"], 1e-5)
    # poles and residues without a robot behind them tell it far less well
    assert whole["std"] < one["std"] and abs(one["value"] - delay) < 4.0 * one["std"]
    for wrong, words in ((("--modes", "6,3"), "--modes is '6,3'"), (("--delays", "some"), "--delays is 'some'")):
        assert run(file, tmp_path / "other", monkeypatch, *wrong) == 2
        assert words in capsys.readouterr().err


def late(r: Recording, delay: float) -> Recording:
    """The same log with its torques so much later, by the Fourier series of its periods."""
    spectrum = np.fft.rfft(r.torque, axis=0)
    turned = spectrum * np.exp(-2j * np.pi * np.fft.rfftfreq(r.samples, 1.0 / RATE)[:, None] * delay)
    return dataclasses.replace(r, torque=np.fft.irfft(turned, r.samples, axis=0))


# ---- what is missing or unfit ---------------------------------------------------------------------------------


def test_a_campaign_with_many_faults_is_used_where_it_is_sound_and_each_fault_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(2)
    first = recordings_at(ROBOT, BENT[0], rng, realisations=6, noise=0.01, name="one")
    first = changed(first, lambda name: not name.startswith("one_001_2") and name != "one_002_3_plus")
    first = [first_samples(r, SAMPLES) if r.name == "one_003_1_minus" else r for r in alike_at_a_line(first, LINES[5])]
    second = recordings_at(ROBOT, BENT[1], rng, noise=0.01, name="two")
    file = write(tmp_path / "c", ROBOT, [*first, *changed(second, lambda name: "_3_" not in name)])
    # one number of modes, one start and no figures: none of them are what this is about, all take long
    monkeypatch.setattr(frf_command, "FrfOptions", functools.partial(FrfOptions, starts=0, modes=(5,)))
    monkeypatch.setattr("rx90b_flex.view.frf_report.write_frf_report", lambda result, path: path.write_text("report"))
    assert run(file, tmp_path / "out", monkeypatch, "--high-hz", "300") == 0
    said = capsys.readouterr().out
    for words in (
        "pose 1: realisation 2 has 2 of 3 experiments and is left out",
        "pose 1: realisation 3: one_002_3_minus lacks the run of opposite sign and is left out",
        "pose 1: recording one_003_1_minus has 1 of 2 periods and is left out",
        f"pose 1: 1 line is left out, the experiments' torques are dependent there: {HZ[5]:.4g} Hz",
        "pose 1: the band is asked for up to 300 Hz, and ends below Nyquist (125 Hz)",
        "pose 1: 3 realisations: 9 neighbouring lines count for each line's covariance",
        "pose 2: frequency response: 2 experiments a realisation for 3 joints (joint_1, joint_2, joint_3)",
    ):
        assert words in said
    found = json.loads((tmp_path / "out" / "frf.json").read_text())
    (pose,) = found["poses"]
    assert pose["frequency_response"]["hz"] == pytest.approx(np.delete(HZ, 5))
    assert found["grey_box"]["parameters"]["joint_2.drive_stiffness"]["determined"]


def without(field: str) -> list[Recording]:
    return [dataclasses.replace(r, **{field: None}) for r in SMALL]


SMALL = recordings_at(ROBOT, BENT[0], np.random.default_rng(3), realisations=2, noise=0.01)
UNFIT = {
    "an experiment is missing everywhere": (
        changed(SMALL, lambda name: "_2_" not in name),
        (),
        "2 experiments a realisation for 3 joints (joint_1, joint_2, joint_3); expected 3 or more",
    ),
    "one realisation of one period": (
        [first_samples(r, SAMPLES) for r in SMALL[:6]],
        (),
        "one realisation of one period: no covariance can be estimated; record more periods or realisations",
    ),
    "two columns of the input matrix depend on each other": (
        recordings_at(
            ROBOT,
            BENT[0],
            np.random.default_rng(4),
            realisations=2,
            noise=0.01,
            matrix=np.array([[1.0, 0.5, 1.0], [1.0, 0.5, -1.0], [1.0, 0.5, 1.0]]),
        ),
        (),
        "the experiments' torques are linearly dependent at every line; check the input matrix",
    ),
    "a band beyond Nyquist": (
        SMALL,
        ("--low-hz", "150", "--high-hz", "200"),
        "no line is left between 150 and 200 Hz; excited lines lie from 8.057 to 78.37 Hz, Nyquist is 125 Hz",
    ),
    "no period": (without("period_s"), (), "'run_000_1_plus' has no period_s"),
    "no feed-forward": (
        without("feedforward_torque"),
        (),
        "'run_000_1_plus' has no feedforward_torque, which tells the excited lines; log it",
    ),
    "a run that is there twice": (
        [*SMALL, dataclasses.replace(SMALL[0], name="again")],
        (),
        "recordings run_000_1_plus, again have the same excitation",
    ),
}


@pytest.mark.parametrize("fault", UNFIT)
def test_what_cannot_be_used_at_all_is_one_line_and_nothing_is_written(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, arguments, words = UNFIT[fault]
    assert run(write(tmp_path / "c", ROBOT, runs), tmp_path / "out", monkeypatch, *arguments) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_references_that_vibrate_tell_the_experiments_as_torques_do() -> None:
    """Runs without a torque input: lines, realisations, experiments and signs are told by what the references differ by."""
    swing = 0.1 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)[:, None]

    def by_reference(r: Recording) -> Recording:
        assert r.feedforward_torque is not None
        asked = np.resize(swing + 1e-5 * r.feedforward_torque[:SAMPLES], r.torque.shape)
        return dataclasses.replace(r, feedforward_torque=np.zeros_like(r.torque), reference_position=asked)

    told, usual = (estimate_frequency_response(runs) for runs in ([by_reference(r) for r in SMALL], SMALL))
    assert told.places == usual.places
    assert np.array_equal(told.hz, usual.hz) and np.array_equal(told.value, usual.value)


def test_logs_that_show_references_begin_where_these_do(tmp_path: Path) -> None:
    time = np.arange(SAMPLES) / RATE
    angle = 2.0 * np.pi * time[:, None] * np.array([1.0, 3.0, 5.0]) / (SAMPLES / RATE)
    position, velocity = 0.1 * np.sin(angle), 0.1 * np.cos(angle) * np.gradient(angle, 1.0 / RATE, axis=0)
    sent = Trajectory("run_000_1_plus", ROBOT.joints, RATE, position, velocity, None, SAMPLES / RATE)
    write_reference(sent, tmp_path / "run_000_1_plus.csv")
    log = dataclasses.replace(
        SMALL[0], source=tmp_path / "run_000_1_plus.csv", feedforward_torque=None,
        reference_position=np.resize(np.roll(position, -300, axis=0), SMALL[0].torque.shape),
    )  # fmt: skip
    found = frf_command.with_reference(log, tmp_path)
    assert found.reference_velocity is not None
    np.testing.assert_allclose(found.reference_velocity[:SAMPLES], np.roll(velocity, -300, axis=0), atol=1e-8)
    alone = frf_command._with_speed(log)  # without the file that was sent
    assert alone.reference_velocity is not None
    np.testing.assert_allclose(alone.reference_velocity[:SAMPLES], np.roll(velocity, -300, axis=0), atol=1e-8)
    other = dataclasses.replace(
        log, reference_position=-2.0 * position[: len(log.torque)].repeat(2, axis=0)[: len(log.torque)]
    )
    with pytest.raises(ValueError, match=r"references are not those that run_000_1_plus was given"):
        frf_command.with_reference(other, tmp_path)


def test_logs_without_feedforward_take_it_from_the_references_that_were_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "c", ROBOT, without("feedforward_torque"))
    sent = tmp_path / "references"
    sent.mkdir()
    for r in SMALL:
        period = Trajectory(r.name, r.joints, r.sample_rate_hz, r.position, r.torque, r.feedforward_torque).part(
            0, SAMPLES / RATE
        )
        write_reference(period, sent / f"{r.name}.csv")
    logs = load_campaign(file).identification
    with_it = [frf_command.with_reference(r, sent) for r in logs]
    found, meant = (estimate_frequency_response(x) for x in (with_it, SMALL))
    np.testing.assert_allclose(found.value, meant.value, rtol=1e-9)
    assert found.places == meant.places
    late = [frf_command.with_reference(begun_later(r, 100), sent) for r in logs]
    # as good, with other noise at the ends of the periods
    np.testing.assert_allclose(
        estimate_frequency_response(late).value, meant.value, atol=6.0 * float(np.max(meant.std()))
    )
    (sent / f"{SMALL[4].name}.csv").unlink()
    assert run(file, tmp_path / "out", monkeypatch, "--references", str(sent)) == 2
    assert f"no {SMALL[4].name}.csv" in capsys.readouterr().err


def test_references_beside_a_campaign_are_taken_without_being_asked_for(tmp_path: Path) -> None:
    """`excite` writes them there; where torques fed forward were logged, these say when in its period a log began."""
    file = write(tmp_path / "c", ROBOT, SMALL)
    logs = load_campaign(file).identification
    assert all(r.feedforward_torque is not None and r.reference_position is None for r in logs)
    remarks: list[str] = []
    campaign = load_campaign(file)
    assert frf_command.with_references(campaign, None, remarks) == campaign.identification and remarks == []
    sent = file.parent / "references"
    sent.mkdir()
    for r in SMALL:
        period = Trajectory(r.name, r.joints, r.sample_rate_hz, r.position, r.torque, r.feedforward_torque).part(
            0, SAMPLES / RATE
        )
        write_reference(period, sent / f"{r.name}.csv")
    for log, r in zip(frf_command.with_references(campaign, None, remarks), SMALL, strict=True):
        assert log.reference_position is not None
        np.testing.assert_allclose(log.reference_position[:SAMPLES], r.position[:SAMPLES], atol=1e-8)
    assert remarks == []
    late = begun_later(logs[0], 100)
    assert logs[0].feedforward_torque is not None
    late = dataclasses.replace(late, feedforward_torque=np.roll(logs[0].feedforward_torque, -100, axis=0))
    found = frf_command.with_reference(late, sent)
    assert found.reference_position is not None
    whole = np.roll(np.tile(SMALL[0].position[:SAMPLES], (2, 1)), -100, axis=0)[:SAMPLES]
    np.testing.assert_allclose(found.reference_position[:SAMPLES], whole, atol=1e-8)
    other = dataclasses.replace(late, feedforward_torque=3.0 * np.asarray(late.feedforward_torque))
    with pytest.raises(ValueError, match="its torques are not those"):
        frf_command.with_reference(other, sent)
    (sent / f"{SMALL[0].name}.csv").unlink()
    assert frf_command.with_references(campaign, None, remarks) == campaign.identification
    assert len(remarks) == 1 and f"no {SMALL[0].name}.csv" in remarks[0]


def begun_later(r: Recording, samples: int) -> Recording:
    """The same log, begun so much later in the period."""
    return dataclasses.replace(
        r, position=np.roll(r.position, -samples, axis=0), torque=np.roll(r.torque, -samples, axis=0)
    )


def test_two_realisations_still_give_a_covariance_that_can_be_inverted_and_bands_that_hold() -> None:
    """By the departures of more lines, compared as torques: where these are alike over the window, as friction's are."""
    truth = ROBOT.linearize(ROBOT.input_matrix @ BENT[0]).frf(HZ)
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(10):
        r = estimate_frequency_response(recordings_at(ROBOT, BENT[0], rng, realisations=2, torque_noise=0.05))
        assert r.degrees_of_freedom >= 2 * 9
        assert np.linalg.eigvalsh(r.covariance).min() > 0.0
        inside.append(np.abs(r.value - truth) < confidence_radius(r))
    # 10 * 37 circles of each entry, alike in 19 neighbours' radius: deviation 1.1 % of the circles, about as much of the radii
    by_entry = np.mean(inside, axis=(0, 1))
    assert np.all(np.abs(by_entry - 0.95) < 3.0 * 0.011 * np.sqrt(2.0))


@pytest.mark.parametrize(
    ("value", "std", "said"),
    [
        (2e-9, 1e-9, []),  # a thousandth of what a sentence says
        (3e-5, 2e-5, []),
        (2.5e-4, 4e-6, ["Torques are logged 250.0 ± 4.0 µs later than angles; that is taken out."]),
        (-2e-6, 4e-9, ["Torques are logged 2.000 ± 0.010 µs earlier than angles; that is taken out."]),
    ],
)
def test_a_delay_is_told_where_there_is_one(value: float, std: float, said: list[str]) -> None:
    assert frf_report.delay_words(Delay(value, std)) == said


# ---- joints that slide ----------------------------------------------------------------------------------------

CART = """<robot name="cart"><link name="base"/>
<link name="rail"><inertial><origin xyz="0.1 0.2 0"/><mass value="10"/>
<inertia ixx="0.3" iyy="0.3" izz="0.3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.2 0.2 0"/><mass value="4"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="rail"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="1" effort="900"/></joint>
<joint name="swing" type="revolute"><parent link="rail"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="3" effort="90"/></joint></robot>
"""


@pytest.mark.slow
def test_what_slides_is_told_in_metres_newtons_and_kilograms(tmp_path: Path, monkeypatch, capsys) -> None:
    """A cart's drive has a mass and pushes; its bendings and the arm on it turn."""
    (tmp_path / "cart.urdf").write_text(CART)
    effects = [
        ("drive_inertia", "slide", "inertia = 20.0"),
        ("drive_flexibility", "slide", "stiffness = 3e5\ndamping = 300.0"),
        ("viscous_friction", "slide", "coefficient = 60.0"),
        ("drive_inertia", "swing", "inertia = 0.5"),
        ("drive_flexibility", "swing", "stiffness = 9e3\ndamping = 9.0"),
        ("viscous_friction", "swing", "coefficient = 6.0"),
    ]
    tables = [f'[[effects]]\ntype = "{kind}"\njoint = "{joint}"\n{rest}' for kind, joint, rest in effects]
    (tmp_path / "cart.toml").write_text("\n".join(['name = "cart"', 'urdf = "cart.urdf"', *tables]) + "\n")
    cart = load_robot(tmp_path / "cart.toml")
    runs = recordings_at(cart, np.array([0.25, 0.4]), np.random.default_rng(3), realisations=3, noise=1e-3)
    campaign = write(tmp_path / "runs", cart, runs)
    assert run(campaign, tmp_path / "out", monkeypatch, "--no-replay", "--modes", "2", "--jobs", "1") == 0
    assert "kg m^2" in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "frf.json").read_text())
    units = {name: p["unit"] for name, p in found["grey_box"]["parameters"].items()}
    for name, slides, turns in (
        ("drive_inertia", "kg", "kg m^2"),
        ("drive_stiffness", "N/m", "N m/rad"),
        ("drive_damping", "N s/m", "N m s/rad"),
        ("friction_slope_1", "N s/m", "N m s/rad"),
    ):
        assert (units[f"slide.{name}"], units[f"swing.{name}"]) == (slides, turns)
    drives = found["poses"][0]["drives"]
    assert drives["slide"]["stiffness"]["unit"] == "N/m" and drives["swing"]["inertia"]["unit"] == "kg m^2"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "slide 0.25 m, swing 22.9°" in page and "N s/m" in page
    slides, turns = cart.units
    assert response_unit([slides]) == "m/s² per N" and response_unit(cart.units) == "m/s² or rad/s² per N or N m"
    assert flexibility_unit([turns]) == "rad/(N m)"
    assert flexibility_unit(cart.units) == [["m/N", "m/(N m)"], ["rad/N", "rad/(N m)"]]
