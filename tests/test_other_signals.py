"""Campaign files with currents, torque sensors and known payloads, and what a known payload does to an identification."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import independent as plain
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.identify.carried import carried_parameters
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign, write_campaign
from rx90b_flex.signals.stated import FlangeLoad

CAMPAIGN = """
robot = "two.toml"
sample_rate_hz = 100.0
joints = ["a", "b"]
[signals]
motor_position = ["q1", "q2"]
motor_current = ["i1", "i2"]
joint_torque = ["s1", "s2"]
[motor]
torque_constant = [1.5, nan]
[[recording]]
file = "run.csv"
role = "identification"
payload = { mass = 2.5, centre = [0.0, 0.1, 0.05] }
"""


def write(folder: Path, text: str = CAMPAIGN) -> Path:
    t = np.arange(50) / 100.0
    table = np.column_stack([np.sin(t), np.cos(t), 2.0 * t, -t, 3.0 + t, 4.0 - t, t])
    np.savetxt(folder / "run.csv", table, fmt="%.17g", delimiter=",", header="q1,q2,i1,i2,s1,s2,t1", comments="")
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


# --- the campaign file -----------------------------------------------------------------------------------------------


def test_a_torque_is_the_current_times_its_constant_and_amperes_where_that_is_left_out(tmp_path: Path) -> None:
    campaign = load_campaign(write(tmp_path))
    (run,) = campaign.recordings
    t = np.arange(50) / 100.0
    assert campaign.torque_constants == (1.5, None)
    np.testing.assert_allclose(run.torque, np.column_stack([3.0 * t, -t]), atol=1e-15)
    np.testing.assert_allclose(run.motor_current, np.column_stack([2.0 * t, -t]), atol=1e-15)
    np.testing.assert_allclose(run.joint_torque, np.column_stack([3.0 + t, 4.0 - t]), atol=1e-15)
    assert run.payload == FlangeLoad(2.5, (0.0, 0.1, 0.05))


@pytest.mark.parametrize(
    ("text", "expected"),
    [("{ b = 0.7 }", (None, 0.7)), ("[nan, nan]", (None, None)), ("[2, 3]", (2.0, 3.0)), (None, (None, None))],
)
def test_torque_constants_may_be_left_out_singly_or_all(
    tmp_path: Path, text: str | None, expected: tuple[float | None, ...]
) -> None:
    old = "[motor]\ntorque_constant = [1.5, nan]\n"
    new = "" if text is None else f"[motor]\ntorque_constant = {text}\n"
    assert load_campaign(write(tmp_path, CAMPAIGN.replace(old, new))).torque_constants == expected


def test_currents_and_torque_sensors_stay_at_the_joint_where_a_gear_matrix_moves_the_angles(tmp_path: Path) -> None:
    text = CAMPAIGN.replace("[motor]", "[motor]\ngear_matrix = [[2.0, 0.0], [0.0, 4.0]]")
    (bare,) = load_campaign(write(tmp_path)).recordings
    (geared,) = load_campaign(write(tmp_path, text)).recordings
    np.testing.assert_allclose(geared.position, bare.position / [2.0, 4.0], rtol=1e-14)
    np.testing.assert_array_equal(geared.torque, bare.torque)
    np.testing.assert_array_equal(geared.joint_torque, bare.joint_torque)


def test_a_torque_beside_a_current_is_taken_as_it_is(tmp_path: Path) -> None:
    text = CAMPAIGN.replace("[signals]", '[signals]\ntorque = ["t1", "t2"]').replace('"s1", "s2"', '"t3", "t4"')
    header = "q1,q2,i1,i2,t1,t2,t3,t4"
    path = write(tmp_path, text)
    np.savetxt(tmp_path / "run.csv", np.arange(400.0).reshape(50, 8) / 50.0, delimiter=",", header=header, comments="")
    campaign = load_campaign(path)
    np.testing.assert_allclose(campaign.recordings[0].torque[1], [12.0 / 50.0, 13.0 / 50.0])
    assert campaign.torque_constants is None


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[1.5, nan]", "[1.5]", "[motor] torque_constant: lists 1 values, joints lists 2"),
        ("[1.5, nan]", "[1.5, 0.0]", "[motor] torque_constant: found 0, another number"),
        ("[1.5, nan]", '[1.5, "x"]', "[motor] torque_constant: found 'x', a finite number is expected"),
        ("[1.5, nan]", "{ c = 1.0 }", "[motor] torque_constant: unknown joint 'c'"),
        ("[1.5, nan]", "2.0", "[motor] torque_constant: found 2.0, a list of 2 numbers or a table by joint"),
        (
            'motor_current = ["i1", "i2"]',
            'torque = ["i1", "i2"]',
            "torque_constant: there is no [signals] motor_current",
        ),
        ('motor_current = ["i1", "i2"]\n', "", "[signals] torque: missing"),
        ("mass = 2.5", "mass = -1", "[[recording]] 1 payload mass: found -1, a number above 0 is expected"),
        ("mass = 2.5, ", "", "[[recording]] 1 payload mass: missing"),
        ("[0.0, 0.1, 0.05]", "[0.0, 0.1]", "payload centre: found [0.0, 0.1]; three numbers"),
        (", centre = [0.0, 0.1, 0.05]", "", "payload centre: missing; three numbers"),
        ("mass = 2.5,", "mass = 2.5, center = 1,", "payload 'center': unknown key (did you mean 'centre'?)"),
        ("{ mass = 2.5, centre = [0.0, 0.1, 0.05] }", "2.5", "payload: found 2.5, { mass = kg, centre = [x, y, z] }"),
    ],
)
def test_a_wrong_constant_or_payload_is_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in CAMPAIGN
    with pytest.raises(ValueError) as caught:
        load_campaign(write(tmp_path, CAMPAIGN.replace(old, new, 1)))
    text = str(caught.value)
    assert "\n" not in text and text.startswith(str(tmp_path / "campaign.toml")) and expected in text


def test_written_signals_and_payloads_read_back_the_same(tmp_path: Path) -> None:
    (run,) = load_campaign(write(tmp_path)).recordings
    again = load_campaign(write_campaign(tmp_path / "again", "two.toml", [run])).recordings[0]
    assert again.payload == run.payload
    for name in ("torque", "joint_torque", "motor_current"):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))


# --- recordings with a known payload ---------------------------------------------------------------------------------

LOAD = FlangeLoad(1.7, (0.05, -0.02, 0.11))


def runs_with_and_without_payload(folder: Path, noise: float) -> tuple[plain.Arm, Path]:
    """Three recordings of an arm of two joints, the second and third with a known mass at its tip, made with pinocchio alone."""
    rng = np.random.default_rng(5)
    arm = plain.two_joints(folder)
    frictions = plain.friction([1.0, 0.6], [2.0, 1.1])
    payload = plain.carrying(arm, "lower", LOAD.mass, LOAD.centre)
    runs = []
    for role, torques in (
        ("identification", [frictions]),
        ("identification", [frictions, payload]),
        ("validation", [frictions, payload]),
    ):
        motion = plain.harmonics(rng, 2, period_s=8.0)
        runs.append(plain.run(arm, role, motion, torques, plain.white(rng, len(motion.time), [noise, noise])))
    declared = [
        {"type": kind, "joint": joint} for joint in arm.joints for kind in ("coulomb_friction", "viscous_friction")
    ]
    path = plain.write_files(folder, arm, declared, runs, cutoff_hz=15.0)
    head, first, second, third = path.read_text().split("[[recording]]")
    stated = f"payload = {{ mass = {LOAD.mass}, centre = {list(LOAD.centre)} }}\n"
    path.write_text("[[recording]]".join([head, first, second + stated, third + stated]))
    return arm, path


def test_a_known_payload_leaves_the_links_as_they_are(tmp_path: Path) -> None:
    """Parameters that the data determine agree with the URDF's, whether or not a recording had the payload on."""
    arm, path = runs_with_and_without_payload(tmp_path, noise=0.01)
    campaign = load_campaign(path)
    robot = rf.load_robot(campaign.robot_source)
    regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz)
    model = identify(regression, regression.robot.effects, fit_links=True)
    true = np.concatenate([inertia.toDynamicParameters() for inertia in arm.model.inertias[1:]])
    order = [0, 1, 2, 3, 4, 6, 9, 5, 7, 8]  # pinocchio: xx xy yy xz yz zz
    true = true.reshape(-1, 10)[:, order].ravel()
    sure = model.solution.determined[:20]
    assert sure.any()
    std = np.sqrt(np.diag(model.covariance)[:20])
    assert np.abs((model.link_parameters - true)[sure] / std[sure]).max() < 4.0
    bare = [dataclasses.replace(r, payload=None) for r in campaign.identification]
    without = identify(Regression.of(robot, bare, campaign.cutoff_hz), regression.robot.effects, fit_links=True)
    assert without.relative_error > 5.0 * model.relative_error


def test_the_parameters_of_a_payload_are_its_torque(tmp_path: Path) -> None:
    arm = plain.two_joints(tmp_path)
    plain.write_robot(tmp_path, arm, [])
    robot = rf.load_robot(tmp_path / "robot_declared.toml")
    rng = np.random.default_rng(3)
    q, v, a = rng.normal(size=(3, 30, 2))
    moved = plain.Motion(np.arange(30.0), q, v, a)
    expected = plain.carrying(arm, robot.tip_frame, LOAD.mass, LOAD.centre)(moved, arm.torque(moved))
    found = robot.link_regressor(robot.motion(q, v, a)) @ carried_parameters(robot, LOAD)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_closing_the_loop_finds_nothing_missing_where_payloads_are_stated(tmp_path: Path) -> None:
    _, path = runs_with_and_without_payload(tmp_path, noise=0.05)
    result = rf.close_loop(path)
    assert result.effects == ()
    assert max(result.after.validation.torque_rms) < 0.05  # the noise before the low-pass
