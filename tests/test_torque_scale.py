"""Torque constants that a campaign leaves out: known loads and torque sensors tell them, nothing else does."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

import independent as plain
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.output import write_result
from rx90b_flex.identify.torque_scale import TorqueConstant, resolved
from rx90b_flex.identify.torque_sensors import sensor_gain, wrong_sensors
from rx90b_flex.signals import Campaign, Recording, load_campaign

CONSTANTS = np.array([3.7, 0.9])
LOAD = (1.9, (0.05, -0.02, 0.11))


def logged(
    folder: Path,
    *,
    payload: bool,
    known: bool = False,
    constants: str = "",
    sensor: bool = False,
    true: np.ndarray = CONSTANTS,
    hidden: Sequence[plain.Torque] = (),
) -> Path:
    """An arm of two joints, its currents logged; the second and third recording with a payload on, stated or not there."""
    rng = np.random.default_rng(11)
    arm = plain.two_joints(folder)
    rubbing = plain.friction([1.0, 0.6], [2.0, 1.1])
    runs = []
    for role, loaded in (("identification", False), ("identification", payload), ("validation", payload)):
        motion = plain.harmonics(rng, 2, period_s=8.0)
        torques = [rubbing, *hidden, *([plain.carrying(arm, "lower", *LOAD)] if loaded else [])]
        runs.append(plain.run(arm, role, motion, torques, plain.white(rng, len(motion.time), [0.05, 0.05])))
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    path = plain.write_files(folder, arm, declared, runs, cutoff_hz=15.0, known=known)
    for i, run in enumerate(runs):
        file = folder / f"log_{i + 1}.csv"
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        moving = plain.friction([1.0, 0.6], [2.0, 1.1])(run.motion, run.torque)
        behind = run.torque - moving
        table = np.column_stack([table[:, :3], table[:, 3:] / true, behind])
        header = "time,angle_0,angle_1,moment_0,moment_1,sensor_0,sensor_1"
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")
    text = path.read_text().replace("\ntorque = ", "\nmotor_current = ")
    if sensor:
        text = text.replace("[preprocessing]", 'joint_torque = ["sensor_0", "sensor_1"]\n[preprocessing]')
    if constants:
        text = text.replace("[preprocessing]", f"[motor]\ntorque_constant = {constants}\n[preprocessing]")
    if payload:
        parts = text.split("[[recording]]")
        stated = f"payload = {{ mass = {LOAD[0]}, centre = {list(LOAD[1])} }}\n"
        text = "[[recording]]".join([*parts[:2], *(p + stated for p in parts[2:])])
    path.write_text(text)
    return path


def constants_of(path: Path) -> tuple[Campaign, tuple[TorqueConstant, ...]]:
    campaign = load_campaign(path)
    return resolved(campaign, rf.load_robot(campaign.robot_source))


def close_to_truth(found: tuple[TorqueConstant, ...], truth: np.ndarray = CONSTANTS, within: float = 0.1) -> None:
    for constant, true in zip(found, truth, strict=False):
        assert constant.value is not None and constant.std is not None
        assert constant.std < within * true
        assert abs(constant.value - true) < 4.0 * constant.std


def test_a_payload_of_known_mass_tells_the_constants(tmp_path: Path) -> None:
    _, found = constants_of(logged(tmp_path, payload=True))
    close_to_truth(found)
    assert {c.source for c in found} == {"model"}


def test_constants_far_from_one_are_told_as_well(tmp_path: Path) -> None:
    """Currents are small beside a payload in N m: shapes of friction fitted to both would be those of neither."""
    found = []
    for i, times in enumerate((1.0, 20.0)):
        folder = tmp_path / str(i)
        folder.mkdir()
        _, constants = constants_of(logged(folder, payload=True, true=times * CONSTANTS))
        close_to_truth(constants, times * CONSTANTS, within=0.01)
        found.append(np.array([(c.value, c.std) for c in constants], dtype=float) / times)
    near, far = found
    np.testing.assert_allclose(far[:, 0], near[:, 0], atol=0.1 * near[:, 1].min())  # no more than rounds leave open
    np.testing.assert_allclose(far[:, 1], near[:, 1], rtol=0.1)


def test_known_links_tell_the_constants(tmp_path: Path) -> None:
    _, found = constants_of(logged(tmp_path, payload=False, known=True))
    close_to_truth(found)


def test_one_constant_that_is_stated_tells_the_other(tmp_path: Path) -> None:
    _, found = constants_of(logged(tmp_path, payload=False, constants="[nan, 0.9]"))
    close_to_truth((found[0],))
    assert found[1].source == "stated"


def test_torque_sensors_tell_the_constants(tmp_path: Path) -> None:
    campaign, found = constants_of(logged(tmp_path, payload=False, sensor=True))
    for constant, true in zip(found, CONSTANTS, strict=True):
        assert constant.source == "torque sensor"
        assert constant.value == pytest.approx(true, rel=0.02)
    measured = campaign.recordings[0]
    assert measured.motor_current is not None
    ratio = np.array([c.value for c in found], dtype=float)
    np.testing.assert_allclose(measured.torque, measured.motor_current * ratio)


def test_without_anything_known_the_constants_are_not_determined_and_that_is_said(tmp_path: Path) -> None:
    _, found = constants_of(logged(tmp_path, payload=False))
    assert [c.value for c in found] == [None, None]
    assert all("not determined" in c.message for c in found)


def currents_of_an_arm(folder: Path, arm: plain.Arm, constants: np.ndarray, noise: Sequence[float]) -> Path:
    """Two recordings of currents, nothing known of their constants, and one to validate."""
    rng = np.random.default_rng(5)
    n, runs = len(arm.joints), []
    coulomb, viscous = 10.0 * np.asarray(noise), 14.0 * np.asarray(noise)
    for role in ("identification", "identification", "validation"):
        motion = plain.harmonics(rng, n, period_s=10.0)
        run = plain.run(
            arm, role, motion, [plain.friction(coulomb, viscous)], plain.white(rng, len(motion.time), noise)
        )
        runs.append(dataclasses.replace(run, torque=run.torque / constants))
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    path = plain.write_files(folder, arm, declared, runs, cutoff_hz=15.0)
    path.write_text(path.read_text().replace("\ntorque = ", "\nmotor_current = "))
    return path


ARMS = {
    "ur10": (plain.ur10, [0.8, 1.0, 0.6, 0.12, 0.1, 0.06]),
    "panda": (plain.panda, [0.15, 0.25, 0.12, 0.12, 0.05, 0.04, 0.02]),
}


@pytest.mark.parametrize("name", ["ur10", pytest.param("panda", marks=pytest.mark.slow)])
def test_links_that_several_joints_move_tell_how_their_constants_go_together(tmp_path: Path, name: str) -> None:
    """Currents of constants between 0.7 and 1.4, nothing of which is known: no scale, but ratios, and torques go on by these."""
    build, noise = ARMS[name]
    arm = build()
    true = np.random.default_rng(1).uniform(0.7, 1.4, len(arm.joints))
    campaign, found = constants_of(currents_of_an_arm(tmp_path, arm, true, noise))
    assert [c.value for c in found] == [None] * len(true)
    told = [c for c in found if c.relative_to is not None]
    assert len(told) >= 3
    used = dict(zip(campaign.joints, campaign.torque_constants or (), strict=True))
    truth = dict(zip(campaign.joints, true, strict=True))
    for c in told:
        assert c.relative_to is not None and c.ratio is not None and c.ratio_std is not None
        assert abs(c.ratio - truth[c.joint] / truth[c.relative_to]) < 4.0 * c.ratio_std
        ours, other = used[c.joint], used[c.relative_to]
        assert ours is not None and other is not None
        assert ours / other == pytest.approx(c.ratio, rel=1e-6)
    assert min(c.ratio_std / c.ratio for c in told if c.ratio and c.ratio_std) < 0.01  # those that carry the arm


@pytest.mark.slow
def test_torques_by_ratios_fit_one_tree_as_well_as_torques_in_newton_metres(tmp_path: Path) -> None:
    """But for what the ratios are off; with all constants 1 the torques of several joints go together far worse."""
    true = np.random.default_rng(1).uniform(0.7, 1.4, 7)
    path = currents_of_an_arm(tmp_path, plain.panda(), true, ARMS["panda"][1])
    raw = load_campaign(path)
    campaign, found = constants_of(path)
    logs = tuple(dataclasses.replace(r, torque=r.torque * true) for r in raw.recordings)
    right = dataclasses.replace(raw, recordings=logs, torque_constants=tuple(map(float, true)))
    errors = [np.array(rf.check(c).relative_error) for c in (raw, campaign, right)]
    off = np.array([4.0 * c.ratio_std / c.ratio if c.ratio and c.ratio_std else 0.0 for c in found])
    assert (errors[1] ** 2 <= (1.1 * errors[2]) ** 2 + off**2).all()
    assert (errors[0] > 2.0 * errors[1]).sum() >= 2


@pytest.mark.parametrize("rise", [0.05, 0.1])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_friction_that_rises_over_some_speeds_is_no_gain_of_the_sensor(seed: int, rise: float) -> None:
    """A motor that lifts a weight and overcomes tanh(v / v0), v0 a part of its speed, which no sign follows near reversals."""
    rng, time = np.random.default_rng(seed), np.arange(10_000) / 250.0
    parts = [
        (a, w, p)
        for a, w, p in zip(rng.uniform(0.1, 0.4, 4), rng.uniform(0.5, 3.0, 4), rng.uniform(0, 6, 4), strict=True)
    ]
    q = sum(a * np.sin(w * time + p) for a, w, p in parts)
    v = sum(a * w * np.cos(w * time + p) for a, w, p in parts)
    behind = 30.0 * np.cos(q) + 3.0 * np.gradient(v, time)
    motor = behind + 15.0 * np.tanh(v / (rise * np.abs(v).max())) + 4.0 * v
    torque, sensor = (x + rng.normal(scale=0.1, size=len(x)) for x in (motor, behind))
    run = Recording(
        "run",
        "identification",
        time,
        250.0,
        ("a",),
        position=q[:, None],
        torque=torque[:, None],
        joint_torque=sensor[:, None],
    )
    gain, std = sensor_gain([run], "a") or (np.nan, np.nan)
    assert abs(gain - 1.0) < min(3.0 * std, 0.02)  # where all speeds but the slowest count it is 0.33 to 0.77


def test_a_sensor_ahead_of_the_friction_is_the_motor_s_column(tmp_path: Path) -> None:
    campaign = load_campaign(logged(tmp_path, payload=False, sensor=True, constants=str(CONSTANTS.tolist())))
    assert wrong_sensors(campaign) == ()
    runs = tuple(dataclasses.replace(r, torque=r.joint_torque, joint_torque=r.torque) for r in campaign.recordings)
    found = wrong_sensors(dataclasses.replace(campaign, recordings=runs))
    assert [(w.kind, w.joints) for w in found] == [("swapped_columns", (j,)) for j in campaign.joints]
    assert all("are the columns of torque and joint_torque exchanged?" in w.message for w in found)


@pytest.mark.parametrize("gain", [0.75, 1.3])
def test_a_gain_is_that_of_a_known_payload_s_torque_too(tmp_path: Path, gain: float) -> None:
    stated = [gain * CONSTANTS[0], CONSTANTS[1]]
    path = logged(tmp_path, payload=True, constants=str([float(c) for c in stated]))
    campaign = load_campaign(path)
    with Path(campaign.robot_source).open("a") as robot:
        robot.write(f'\n[[effects]]\ntype = "torque_gain"\njoint = "{campaign.joints[0]}"\n')
    (found,) = (p for p in rf.identify(path).parameters if "torque_gain" in p.name)
    assert found.value is not None and found.std is not None and found.std < 0.02
    assert abs(found.value - gain) < 4.0 * found.std


@pytest.mark.slow
def test_currents_of_which_nothing_tells_the_size_are_no_fault(tmp_path: Path) -> None:
    path = logged(tmp_path, payload=False)
    for file in tmp_path.glob("log_*.csv"):  # of motors with 80 N m/A at the joint
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        table[:, 3:5] /= 80.0
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=file.read_text().splitlines()[0], comments="")
    assert rf.check(path).usable
    result = rf.close_loop(path)
    assert isinstance(result, rf.ClosedLoop) and result.verdict == "nothing_missing"
    assert sum("is not determined" in c for c in result.cautions) == 2
    (tmp_path / "out").mkdir()
    write_result(result, tmp_path / "out")
    again = rf.replay_errors(tmp_path / "out" / "robot.toml", path)  # whose currents have no constants
    assert again.relative_error == pytest.approx(result.after.validation.relative_error, rel=2e-3)


def test_closing_the_loop_on_currents_goes_by_the_constants_that_it_finds(tmp_path: Path) -> None:
    result = rf.close_loop(logged(tmp_path, payload=True))
    assert max(result.after.validation.torque_rms) < 0.2  # N m, of torques of several
    assert sum(bool(re.search(r"told by what is known", c)) for c in result.cautions) == 2


@pytest.mark.slow
def test_what_was_missing_where_constants_were_told_leaves_no_gain(tmp_path: Path) -> None:
    """A ripple that nobody declared bends the first constants; those that are told with it are reported, and no effect."""
    ripple = plain.hidden("gear_ripple", 0, {"order": 20.0, "amplitude": 6.0, "phase": 0.3})
    result = rf.close_loop(logged(tmp_path, payload=True, hidden=[ripple]))
    assert isinstance(result, rf.ClosedLoop)
    assert [e.type for e in result.effects] == ["gear_ripple"]
    told = [re.match(r"Torque constant of .*: (\S+) ± (\S+) N m/A, told by what", c) for c in result.cautions]
    values = [(float(m[1]), float(m[2])) for m in told if m]
    assert len(values) == 2 and result.campaign.torque_constants is not None
    for (value, std), used, true in zip(values, result.campaign.torque_constants, CONSTANTS, strict=True):
        assert used == pytest.approx(value, rel=1e-3)
        assert abs(value - true) < 4.0 * std + 1e-3 * true  # of four digits
        assert std < 0.01 * true


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["all", "none"])
def test_currents_of_an_arm_with_a_stated_payload_miss_nothing(tmp_path: Path, stated: str) -> None:
    """Six joints, nothing hidden: whether constants are stated or not, there is no gain."""
    arm, rng, true = plain.ur5(), np.random.default_rng(4), np.array([12.0, 11.0, 9.0, 6.0, 5.0, 4.0])
    noise, runs = 0.03 * np.array([1.0, 20.0, 5.0, 1.0, 1.0, 1.0]), []
    for role, load in (("identification", 0.0), ("identification", 3.0), ("validation", 3.0)):
        motion = plain.harmonics(rng, 6, period_s=20.0)
        torques = [plain.friction(20.0 * noise, 15.0 * noise), plain.carrying(arm, "ee_link", load, (0.0, 0.0, 0.1))]
        run = plain.run(arm, role, motion, torques, plain.white(rng, len(motion.time), noise))
        runs.append(dataclasses.replace(run, torque=run.torque / true))
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    path = plain.write_files(tmp_path, arm, declared, runs, cutoff_hz=15.0)
    with (tmp_path / "robot_declared.toml").open("r+") as robot:
        text = robot.read()
        robot.seek(0)
        robot.write(f'tip_frame = "ee_link"\n{text}')
    first, *loaded = path.read_text().replace("\ntorque = ", "\nmotor_current = ").split("[[recording]]")
    constants = true.tolist() if stated == "all" else [float("nan")] * 6
    first = first.replace("[preprocessing]", f"[motor]\ntorque_constant = {constants}\n[preprocessing]")
    payload = "payload = { mass = 3.0, centre = [0.0, 0.0, 0.1] }\n"
    path.write_text("[[recording]]".join([first, loaded[0], *(x + payload for x in loaded[1:])]))
    result = rf.close_loop(path)
    assert list(result.effects) == [] and result.verdict == "nothing_missing"
    if stated == "none":
        _, found = constants_of(path)
        close_to_truth(found, true, within=0.01)
