"""Claims about ``rx90b-flex frf``: from recordings to physical parameters, its files, and what it says of what it cannot do."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from rx90b_flex import cli
from rx90b_flex.effects import Effect
from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.export import save_robot
from rx90b_flex.identify import frf_command
from rx90b_flex.identify.frf_command import (
    FrfOptions,
    feedback_of,
    frf_json,
    identify_from_motors,
    mean_motion,
    write_motor_identification,
)
from rx90b_flex.identify.grey_model import declared_parameters
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.simulate import Noise, load_cs8, run_campaign, save_cs8, section_662
from rx90b_flex.simulate.trajectories import square_wave
from rx90b_flex.view.page import Image
from rx90b_flex.view.zoom import script

SLOPES = (60.0, 32.0, 14.0)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four realisations of three experiments, both signs, two periods kept; viscous friction, arm bent at the elbow."""
    robot = load_robot("rx90b_3dof")
    viscous = [ViscousFriction(joint=j, coefficient=c) for j, c in zip(robot.joints, SLOPES, strict=True)]
    robot = robot.with_effects([*(e for e in robot.effects if not e.traits.is_friction), *viscous])
    reference = square_wave(robot, [0.0, 0.5 * np.pi, 1.0], moving=robot.joints)
    noise = Noise(torque=0.1, position=1e-6, velocity=1e-4)
    plan = section_662(robot, load_cs8(), reference=reference, realisations=4, periods=3, noise=noise, peak=20.0)
    result = run_campaign(plan, tmp_path_factory.mktemp("frf") / "campaign")
    assert result.file is not None
    return result.file


def test_stiffness_comes_from_motor_signals_and_is_written(campaign, tmp_path):
    out = tmp_path / "out"
    result = identify_from_motors(campaign, FrfOptions(bending_alike_std=0.0, starts=0, modes=(5,), replay=False))
    write_motor_identification(result, out)
    assert {p.name for p in out.iterdir()} >= {"frf.json", "robot.toml"}
    found = json.loads((out / "frf.json").read_text())
    assert found["schema"] == 1 and found["left_out"] == []
    assert found["poses"][0]["pose_rad"] == pytest.approx([0.0, 0.5 * np.pi, 1.0], abs=1e-3)
    transfer = found["poses"][0]["transfer_functions"]
    assert [one["modes"] for one in transfer["stabilisation"]] == [5]
    poles = [one["value"] for one in transfer["stabilisation"][0]["poles"]]
    kept = [one["value"] for one in transfer["resonances"]]
    away = [one for one in transfer["refused"] if one["kind"] == "resonance"]
    assert sorted(kept + [one["value"] for one in away]) == poles and all(one["why"] for one in away)
    assert "direct" in transfer["residual_terms"]
    parameters = found["grey_box"]["parameters"]
    declared = load_robot("rx90b_3dof")
    for effect in declared.effects:
        if effect.type_name() in ("drive_flexibility", "drive_inertia"):
            what = "stiffness" if effect.type_name() == "drive_flexibility" else "inertia"
            one = parameters[f"{effect.joints[0]}.drive_{what}"]
            # six intervals of 95 %, wide by the stated model error: four deviations, twice their half width, hold all
            assert abs(one["value"] - getattr(effect, what)) < 2.0 * (one["high"] - one["low"]) / 2.0
            assert one["std"] < 0.05 * one["value"]
    written = load_robot(str(out / "robot.toml"))
    stiffness = next(e for e in written.effects if e.type_name() == "drive_flexibility").stiffness
    assert stiffness == pytest.approx(parameters["joint_1.drive_stiffness"]["value"], rel=1e-9)


@pytest.mark.slow
def test_the_command_does_it_all_by_itself(campaign, tmp_path, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "frf", str(campaign), "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert {p.name for p in out.iterdir()} >= {"frf.json", "report.html", "robot.toml"}
    assert json.loads((out / "frf.json").read_text())["left_out"] == []
    page = (out / "report.html").read_text()
    page = page.replace(script(), "")  # the figures' own
    assert "<script src" not in page and "http://" not in page and "https://" not in page
    for words in (
        "Physical parameters",
        "Frequency response",
        "Transfer functions",
        "Correlation of the residuals",
        "Signal-to-noise",
    ):
        assert words in page


def test_a_stage_that_fails_is_left_out_with_its_reason(campaign):
    # a band of three lines is too little for transfer functions, and so for poles and zeros; the grey box goes on
    result = identify_from_motors(campaign, FrfOptions(band_hz=(30.0, 31.5), starts=0, replay=False))
    (at,) = result.poses
    assert at.transfer is None and at.drives is None and result.grey is not None
    stages = {x["stage"]: x["why"] for x in frf_json(result)["left_out"]}
    assert "lines" in stages["transfer functions"]
    assert "builds on" in stages["inverse eigenvalue problem"]
    assert frf_json(result)["poses"][0]["transfer_functions"] is None


def test_bad_input_is_one_line_and_nothing_is_written(campaign, tmp_path, monkeypatch, capsys):
    for arguments, words in (
        ([str(tmp_path / "none.toml")], "none.toml"),
        ([str(campaign), "--low-hz", "50", "--high-hz", "20"], "--low-hz and --high-hz are 50 and 20"),
        ([str(campaign), "--start-hz", "20"], "--start-hz is '20'; expected 2 to 8 resonances"),
        ([str(campaign), "--start-hz", "2,30"], "between 8 and 160 Hz"),
        ([str(campaign), "--controller", str(tmp_path / "c.toml")], "no such controller file"),
    ):
        monkeypatch.setattr("sys.argv", ["rx90b-flex", "frf", *arguments, "--out", str(tmp_path / "out")])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr().err
        assert ended.value.code == 2 and words in said and said.count("\n") == 1
        assert not (tmp_path / "out").exists()


def test_the_mean_motion_is_the_reference(campaign):
    recordings = load_campaign(campaign).identification
    motion = mean_motion(recordings, recordings[0].joints)
    reference = recordings[0].reference_position[: len(motion)]
    # the controller follows within its error at 0.11 rad/s; the excitation's part goes with the signs
    assert np.abs(motion - reference).max() < 5e-3


def test_feedback_is_stiff_at_low_and_soft_at_high_frequency():
    controller = load_cs8()
    joints = tuple(j.name for j in controller.joints[:2])
    feedback = feedback_of(controller, joints)(np.array([0.01, 10.0, 1000.0]))
    assert feedback.shape == (3, 2, 2)
    first = controller.joints[0]
    s = 2j * np.pi * 0.01
    # integral and position gain at 0.01 Hz; the lags turn it by 1e-5
    assert feedback[0, 0, 0] == pytest.approx((first.position_gain + first.integral_gain / s) / s**2, rel=2e-3)
    assert np.all(feedback[:, 0, 1] == 0.0)
    # from 10 Hz to 1 kHz the velocity part falls by 100, and the current loop's bandwidth of 1 kHz takes another sqrt(2)
    assert abs(feedback[2, 0, 0]) < 1e-2 * abs(feedback[1, 0, 0])


# ---- with friction that reverses: the replay --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def with_dry_friction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three realisations, one period kept, on a robot whose drives and friction are not as its campaign declares."""
    true = load_robot("rx90b_3dof")
    noise = Noise(torque=0.1, position=1e-6, velocity=1e-4)
    plan = section_662(true, load_cs8(), noise=noise, realisations=3, periods=2, method="perturbation", seed=4)
    result = run_campaign(plan, tmp_path_factory.mktemp("dry") / "campaign")
    assert result.file is not None
    return declare(
        result.file, [e.with_coefficients(WRONG.get(e.traits.part, 1.0) * e.coefficients) for e in true.effects]
    )


WRONG = {"drives": 1.1, "friction": 0.9}


def declare(campaign: Path, effects: list[Effect]) -> Path:
    """The campaign of a robot that is declared with these effects."""
    save_robot(load_robot("rx90b_3dof").with_effects(effects), campaign.parent, allow_inconsistent=True)
    return campaign


@pytest.mark.long
@pytest.mark.slow  # without the command: test_all_coordinates.py, test_replay.py
def test_the_command_gives_both_as_measured_and_with_friction_s_distortion_removed(
    with_dry_friction, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    options = functools.partial(
        FrfOptions, starts=0, modes=(5,)
    )  # neither many starts nor orders are what this is about
    monkeypatch.setattr(frf_command, "FrfOptions", options)
    no_picture = Image("", "", 1, 1, "")
    monkeypatch.setattr("rx90b_flex.view.frf_report.image", lambda figure, alt, caption="", zoom=False: no_picture)
    arguments = ["frf", str(with_dry_friction), "--out", str(out), "--jobs", "1", "--high-hz", "45"]
    monkeypatch.setattr("sys.argv", ["rx90b-flex", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    found = json.loads((out / "frf.json").read_text())
    assert found["left_out"] == [] and "friction has the form" in found["replay"]["assumes"]
    before, after = (np.diagonal(found["replay"]["realisations_deviate"][x][0]) for x in ("as_measured", "less_replay"))
    assert (after < 0.2 * before).all()  # noise is 16 times weaker than the distortion
    truth = declared_parameters(load_robot("rx90b_3dof"))
    names = [n for n in truth if "drive_stiffness" in n or "drive_inertia" in n]
    off = {
        way: np.array([abs(found[way]["parameters"][n]["value"] / truth[n] - 1.0) for n in names])
        for way in ("grey_box", "replay")
    }
    assert np.sqrt(np.mean(off["replay"] ** 2)) < np.sqrt(np.mean(off["grey_box"] ** 2))
    for n in names:  # six intervals; four deviations hold all
        one = found["replay"]["parameters"][n]
        assert abs(np.log(one["value"] / truth[n])) < 4.0 * one["std"] / one["value"], n
    for name, one in found["replay"]["friction"].items():
        if "joint_1" not in name:  # it hardly vibrates: its friction shows little
            assert abs(one["value"] / one["declared"] * WRONG["friction"] - 1.0) < 0.05, name
    written = declared_parameters(load_robot(str(out / "robot.toml")))
    assert written[names[0]] == pytest.approx(found["replay"]["parameters"][names[0]]["value"], rel=1e-9)
    page = (out / "report.html").read_text()
    for words in ("distortion removed", "as measured", "The replay assumes that friction has the form"):
        assert words in page


@pytest.mark.slow
def test_under_a_controller_that_nobody_knows_logged_torques_are_replayed(with_dry_friction, tmp_path):
    lone = shutil.copytree(with_dry_friction.parent, tmp_path / "lone")
    (lone / "controller.toml").unlink()
    result = identify_from_motors(lone / "campaign.toml", FrfOptions((8.0, 45.0), starts=0, modes=(5,)))
    found = frf_json(result)
    assert found["left_out"] == [] and any("driven by the torques as logged" in text for text in found["remarks"])
    before, after = (np.diagonal(found["replay"]["realisations_deviate"][x][0]) for x in ("as_measured", "less_replay"))
    assert (after < 0.3 * before).all()
    truth = declared_parameters(load_robot("rx90b_3dof"))
    for n in truth:
        if "drive_stiffness" in n or "drive_inertia" in n:  # six intervals; four deviations hold all
            one = found["replay"]["parameters"][n]
            assert abs(np.log(one["value"] / truth[n])) < 4.0 * one["std"] / one["value"], n
    assert abs(found["replay"]["torque_delay"]["value"]) < 4.0 * found["replay"]["torque_delay"]["std"]


@pytest.mark.slow
def test_what_keeps_a_replay_away_is_said_and_the_rest_goes_on(with_dry_friction, tmp_path):
    # three modes below 30 Hz count or not by the last digit of a log
    options = FrfOptions((8.0, 45.0), starts=0, modes=(5,))
    lone = shutil.copytree(with_dry_friction.parent, tmp_path / "lone")
    other = load_cs8(lone / "controller.toml")
    save_cs8(dataclasses.replace(other, reference_rate_hz=200.0), lone / "controller.toml")
    result = identify_from_motors(lone / "campaign.toml", options)
    assert result.grey is not None and result.replayed is None and frf_json(result)["replay"] is None
    assert [x.stage for x in result.left_out] == ["replay"]
    assert "no whole number of references" in result.left_out[0].why
    unwanted = identify_from_motors(with_dry_friction, dataclasses.replace(options, replay=False))
    assert unwanted.replayed is None and unwanted.left_out == ()
