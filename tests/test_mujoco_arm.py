"""Claims about the whole road, ``excite``, logs, ``frf``, ``close-loop``, on an arm in MuJoCo under its own controller.

Nothing of the arm is the package's but its robot file, whose values are wrong by up to a fifth, and its controller file.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_campaigns import TWO_POSES, analysed, errors, identified, recorded, run
from mujoco_arm import JOINTS, Arm, write_robot, write_slow_campaign
from scipy import stats

import rx90b_flex as rf

SEED = 1


def closed_loop(folder: Path, robot: Path) -> dict[str, Any]:
    """The content of ``closed_loop.json`` on what `identified` wrote."""
    run("close-loop", folder / "frf", "--robot", robot, "--out", folder / "closed")
    found: dict[str, Any] = json.loads((folder / "closed" / "closed_loop.json").read_text())
    return found


def assert_found(arm: Arm, found: dict[str, Any]) -> None:
    """Drives within 2 %, joints within 5 % where they are told so well, the skew within 10 us, friction's distortion explained."""
    off = errors(arm, found["replay"])
    told = {name: error for name, (error, std) in off.items() if ".drive_" in name or std < 0.025}
    assert len(told) >= 9  # of 12: six of drives, and half of those across the axes
    for name, error in told.items():
        assert abs(error) < (0.05 if ".joint_" in name else 0.02), name
    inside = [abs(error) < 1.96 * std for error, std in off.values()]
    assert np.mean(inside) > 0.8  # they depend on each other: all but two
    assert abs(found["replay"]["torque_delay"]["value"] - arm.skew_s) < 1e-5
    as_measured, less = (np.array(x) for x in found["replay"]["realisations_deviate"].values())
    diagonal = (slice(None), *np.diag_indices(len(JOINTS)))
    assert (less[diagonal] < 0.2 * as_measured[diagonal]).all()


@pytest.mark.long
@pytest.mark.slow
def test_by_motion_alone_the_drives_of_an_unknown_arm_are_found(tmp_path: Path) -> None:
    """Neither a torque input nor the controller is known, and only angles and torques of the motors are logged."""
    arm = Arm.drawn(SEED)
    campaign = recorded(arm, tmp_path, by="reference", known=False, period_s=2.048, realisations=2)
    assert_found(arm, identified(campaign, "--modes", 6))


@pytest.mark.long
def test_intervals_hold_and_drives_are_found_whatever_the_arm(tmp_path: Path) -> None:
    """No fewer 95 % intervals hold than chance leaves of 93 % in 99 of 100 such tests; `benchmarks/motor_arm.py` has more arms."""
    held = []
    for seed in (301, 302, 303):
        arm, known = Arm.drawn(seed), seed % 2 == 0
        campaign = recorded(arm, tmp_path / str(seed), by="torque" if known else "reference", known=known)
        found = identified(campaign, "--modes", 6)["replay"]
        assert abs(found["torque_delay"]["value"] - arm.skew_s) < 1e-5
        for name, (error, std) in errors(arm, found).items():
            held.append(abs(error) < 1.96 * std)
            assert ".drive_" not in name or abs(error) < 0.02, (seed, name)
    assert sum(held) >= stats.binom.ppf(0.01, len(held), 0.93)


@pytest.mark.slow
@pytest.mark.long  # of one pose, and from more than one without another engine, others tell
def test_two_poses_tell_a_known_loop_s_arm_and_that_nothing_is_missing(tmp_path: Path) -> None:
    """Torques are fed forward, and logged a millisecond late: the skew is taken out and no cause is named."""
    arm = Arm.drawn(3, torque_late_s=1e-3)
    campaign = recorded(arm, tmp_path, by="torque", known=True, poses=TWO_POSES)
    assert_found(arm, identified(campaign, "--modes", 6))
    closed = closed_loop(tmp_path, write_robot(arm, tmp_path, guess=0.0))
    assert closed["verdict"] == "nothing_missing" and closed["effects"] == []


@pytest.mark.slow
@pytest.mark.long
def test_under_a_filtered_loop_the_arm_is_found_and_filters_that_nobody_stated_are_told(tmp_path: Path) -> None:
    """The arm's own loop filters its speeds at 100 Hz and its torques about 25 Hz; its references alone excite it."""
    arm = Arm.drawn(6, speed_hz=100.0, notch_hz=25.0)
    campaign = recorded(arm, tmp_path, by="reference", known=True)
    found = identified(campaign, "--modes", 6)
    assert_found(arm, found)
    assert np.max(found["replay"]["torques_off"]) < 0.1
    assert not any("off those logged" in remark for remark in found["remarks"])
    text = (campaign.parent / "controller.toml").read_text().splitlines()
    bare = tmp_path / "bare.toml"
    bare.write_text("\n".join(line for line in text if "_filters" not in line))
    found = analysed(campaign, "--modes", 6, "--controller", bare, "--overwrite")
    assert found["replay"] is None or any("off those logged" in remark for remark in found["remarks"])


@pytest.mark.long
@pytest.mark.slow
def test_a_softer_drive_is_found_and_nothing_else(tmp_path: Path) -> None:
    as_declared = Arm.drawn(3)
    drives = list(as_declared.drives)
    drives[1] = dataclasses.replace(drives[1], stiffness=0.6 * drives[1].stiffness)
    arm = dataclasses.replace(as_declared, drives=tuple(drives))
    campaign = recorded(arm, tmp_path, by="torque", known=True, declared=as_declared, guess=0.0)
    identified(campaign, "--modes", 6)
    closed = closed_loop(tmp_path, tmp_path / "arm.toml")
    (effect,) = closed["effects"]
    assert (effect["type"], effect["place"]) == ("drive_flexibility", "shoulder")
    assert effect["parameters"]["drive_stiffness"]["value"] == pytest.approx(0.6, abs=0.02)


@pytest.mark.slow
@pytest.mark.long
def test_a_tool_that_nobody_declared_is_found_beside_a_skew_and_nothing_else(tmp_path: Path) -> None:
    as_declared = Arm.drawn(5)
    arm = dataclasses.replace(as_declared, tool_kg=2.0, torque_late_s=5e-4)
    campaign = recorded(arm, tmp_path, by="reference", known=True, declared=as_declared, guess=0.0)
    identified(campaign, "--modes", 6)
    closed = closed_loop(tmp_path, tmp_path / "arm.toml")
    (effect,) = closed["effects"]
    assert effect["type"] == "payload"
    mass = effect["parameters"]["mass"]
    assert abs(mass["value"] - 2.0) < 3.0 * mass["std"] and mass["std"] < 0.1


# ---- one thing hidden -------------------------------------------------------------------------------------------------


def searched(arm: Arm, folder: Path, declared: Arm, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """The loop closed on an arm whose robot file is right but in what is hidden. A replay on a wrong robot may be left out."""
    campaign = recorded(arm, folder, by="reference", known=True, declared=declared, without=without, guess=0.0)
    left = [x["stage"] for x in analysed(campaign, "--modes", 6)["left_out"]]
    assert left in ([], ["replay"])
    return closed_loop(folder, folder / "arm.toml")


def other(arm: Arm, joint: str, **factors: float) -> Arm:
    """The arm with other values of one drive."""
    at = JOINTS.index(joint)
    values = {name: np.multiply(getattr(arm.drives[at], name), factor) for name, factor in factors.items()}
    values = {name: tuple(x) if np.ndim(x) else float(x) for name, x in values.items()}
    drives = list(arm.drives)
    drives[at] = dataclasses.replace(drives[at], **values)
    return dataclasses.replace(arm, drives=tuple(drives))


def assert_added(effect: dict[str, Any], kind: str, place: str, true: tuple[float, ...]) -> None:
    """With the stiffnesses that it has; one for both axes may be either's or between."""
    assert (effect["type"], effect["place"], effect["change"]) == (kind, place, "added")
    values = [(p["value"], p["std"]) for p in effect["parameters"].values()]
    between = [(k, k) for k in true] if len(values) == len(true) else [(min(true), max(true))]
    for (value, std), (low, high) in zip(values, between, strict=True):
        assert low - 3.0 * std < value < high + 3.0 * std and std < 0.05 * value


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "joint", "seed"),
    [
        ("joint_flexibility", "waist", 34),
        pytest.param("joint_flexibility", "shoulder", 21, marks=pytest.mark.long),
        pytest.param("joint_flexibility", "waist", 5, marks=pytest.mark.long),
        pytest.param("joint_flexibility", "elbow", 22, marks=pytest.mark.long),
        pytest.param("drive_flexibility", "shoulder", 27, marks=pytest.mark.long),
    ],
)
def test_a_flexibility_that_nobody_declared_is_found_and_nothing_else(
    kind: str, joint: str, seed: int, tmp_path: Path
) -> None:
    """What a replay on a robot that lacks it makes of friction's distortion is wrong, and does not count."""
    arm = Arm.drawn(seed)
    (effect,) = searched(arm, tmp_path, arm, without=(f"{joint}.{kind}",))["effects"]
    drive = arm.drives[JOINTS.index(joint)]
    assert_added(effect, kind, joint, (drive.stiffness,) if kind == "drive_flexibility" else drive.bending)


@pytest.mark.slow
@pytest.mark.long
def test_a_floor_that_gives_way_is_found_and_nothing_else(tmp_path: Path) -> None:
    arm = Arm.drawn(25, floor=(9e5, 5e5))
    (effect,) = searched(arm, tmp_path, Arm.drawn(25))["effects"]
    assert_added(effect, "base_flexibility", "base", (9e5, 5e5))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameter", "joint", "factor", "seed"),
    [
        ("inertia", "drive_inertia", "elbow", 1.3, 28),
        pytest.param("stiffness", "drive_stiffness", "elbow", 0.6, 24, marks=pytest.mark.long),
        pytest.param("bending", "joint_stiffness", "shoulder", 0.6, 29, marks=pytest.mark.long),
        pytest.param("bending", "joint_stiffness", "waist", 0.6, 30, marks=pytest.mark.long),
    ],
)
def test_another_value_than_declared_is_found_and_nothing_else(
    name: str, parameter: str, joint: str, factor: float, seed: int, tmp_path: Path
) -> None:
    declared = Arm.drawn(seed)
    (effect,) = searched(other(declared, joint, **{name: factor}), tmp_path, declared)["effects"]
    assert (effect["place"], effect["change"], list(effect["parameters"])) == (joint, "multiplied", [parameter])
    found = effect["parameters"][parameter]
    assert found["value"] == pytest.approx(factor, abs=3.0 * found["std"]) and found["std"] < 0.02 * factor


@pytest.mark.slow
@pytest.mark.parametrize("seed", [31, pytest.param(32, marks=pytest.mark.long)])
def test_other_dampings_and_frictions_are_no_finding(seed: int, tmp_path: Path) -> None:
    declared = Arm.drawn(seed)
    joint, factors = {
        31: ("shoulder", {"damping": 2.5, "bending_damping": 2.5}),
        32: ("elbow", {"dry": 1.5, "viscous": 1.5}),
    }[seed]
    closed = searched(other(declared, joint, **factors), tmp_path, declared)
    assert closed["verdict"] == "nothing_missing" and closed["effects"] == []


# ---- over time ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "cutoff_hz"),
    [*(pytest.param(seed, hz, marks=pytest.mark.long) for seed, hz in ((610, 4.0), (611, 10.0))), (612, 25.0)],
)
def test_over_time_nothing_is_named_where_nothing_is_missing(seed: int, cutoff_hz: float, tmp_path: Path) -> None:
    # drives stick at each reversal for up to a fifth of a second, which no law of the motion shows
    arm = Arm.drawn(seed)
    found = rf.close_loop(write_slow_campaign(arm, arm, tmp_path, cutoff_hz))
    assert found.effects == ()
    assert found.before.validation.relative_error < 0.006
    assert rf.identify(tmp_path / "campaign.toml").validation.relative_error < 0.006


@pytest.mark.slow
@pytest.mark.parametrize("seed", [613, pytest.param(614, marks=pytest.mark.long)])
def test_over_time_a_tool_that_nobody_declared_is_found(seed: int, tmp_path: Path) -> None:
    arm = Arm.drawn(seed, tool_kg=2.0)
    found = rf.close_loop(write_slow_campaign(arm, Arm.drawn(seed), tmp_path, 4.0))
    first = found.effects[0]
    assert first.effect.label == "tip.payload"
    mass = first.parameters[0]
    assert mass.value == pytest.approx(2.0, abs=0.03)
    assert found.after.validation.relative_error < 0.05 * found.before.validation.relative_error


AT_ONCE = {("softer joint", 620)}  # the others take ten minutes; this one was false before there was a rule for it

# hidden, and the names that are right; a fit of what is declared may make good for it, or the motion be too slow to show it
OVER_TIME: dict[str, tuple[Callable[[Arm], Arm], tuple[str, ...], tuple[str, ...]]] = {
    "tool": (lambda arm: dataclasses.replace(arm, tool_kg=2.0), (), ("tip.payload",)),
    "floor": (lambda arm: dataclasses.replace(arm, floor=(9e5, 5e5)), (), ("base.base_flexibility",)),
    "inertia": (lambda arm: other(arm, "elbow", inertia=1.3), (), ()),
    "softer drive": (lambda arm: other(arm, "elbow", stiffness=0.6), (), ()),
    "softer joint": (lambda arm: other(arm, "shoulder", bending=0.6), (), ()),
    "joint's springs": (lambda arm: arm, ("elbow.joint_flexibility",), ("elbow.joint_flexibility",)),
    "drive's spring": (lambda arm: arm, ("shoulder.drive_flexibility",), ("shoulder.drive_flexibility",)),
    "friction": (lambda arm: other(arm, "elbow", dry=1.5, viscous=1.5), (), ()),
    "damping": (lambda arm: other(arm, "shoulder", damping=2.5, bending_damping=2.5), (), ()),
    "late torques": (lambda arm: dataclasses.replace(arm, torque_late_s=4e-3), (), ("torque_delay",)),
}


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "seed", "cutoff_hz"),
    [
        pytest.param(cause, first + i, hz, marks=() if (cause, first) in AT_ONCE else pytest.mark.long)
        for first, hz in ((620, 10.0), (640, 4.0), (660, 6.0), (680, 8.0))
        for i, cause in enumerate(OVER_TIME)
    ],
)
def test_over_time_nothing_false_is_named_whatever_is_hidden(
    cause: str, seed: int, cutoff_hz: float, tmp_path: Path
) -> None:
    hidden, without, right = OVER_TIME[cause]
    declared = Arm.drawn(seed)
    campaign = write_slow_campaign(hidden(declared), declared, tmp_path, cutoff_hz, without=without)
    found = rf.close_loop(campaign)
    assert all(e.effect.label.endswith(right) for e in found.effects)
    if cause == "tool":
        mass = found.effects[0].parameters[0]
        assert abs(mass.value - 2.0) < 4.0 * mass.std < 0.01
