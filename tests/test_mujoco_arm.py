"""Claims about the whole road, ``excite``, logs, ``frf``, ``close-loop``, on an arm in MuJoCo under its own controller.

Nothing of the arm is the package's but its robot file, whose values are wrong by up to a fifth, and its controller file.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco_arm import GEARS, JOINTS, Arm, play, write_controller, write_robot

from rx90b_flex import cli

ONE_POSE, TWO_POSES = ("0,90,30",), ("0,90,30", "0,50,80")
SEED = 1


def run(*arguments: object) -> None:
    """A command; figures of the report of frequency responses take longer than all else, and are not what this is about."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rx90b_flex.view.frf_report.write_frf_report", lambda result, path: path.write_text("report"))
        patch.setattr("sys.argv", ["rx90b-flex", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert not ended.value.code, arguments


def recorded(
    arm: Arm,
    folder: Path,
    *,
    by: str,
    known: bool,
    poses: tuple[str, ...] = ONE_POSE,
    period_s: float = 4.096,
    realisations: int = 3,
    declared: Arm | None = None,
    guess: float = 0.2,
) -> Path:
    """A campaign that the arm has played; `known`: whether its controller is described; `declared`: what its robot file is of."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = write_robot(declared or arm, folder, guess=guess)
    how = ("--controller", write_controller(arm, folder / "own.toml")) if known else ("--rate-hz", 500)
    turned = [x for pose in poses for x in ("--pose", pose)]
    size = ("--realisations", realisations, "--periods", 2, "--period-s", period_s)
    run("excite", robot, *turned, "--by", by, *how, *size, "--out", folder / "runs")
    campaign = folder / "runs" / "campaign.toml"
    for number, reference in enumerate(sorted((folder / "runs" / "references").rglob("*.csv"))):
        play(arm, reference, folder / "runs" / "logs" / reference.parent.name / reference.name, 2, number)
    campaign.write_text(as_logged(campaign.read_text()))
    return campaign


def as_logged(text: str) -> str:
    """The campaign file with the log's own columns and side: angles and torques of motors, and nothing that was sent."""
    own = {"motor_position": "angle", "torque": "torque", "feedforward_torque": None, "reference_position": None}
    lines = []
    for line in text.splitlines():
        key = line.split(" = ")[0]
        if key in own:
            line = "" if own[key] is None else f"{key} = {json.dumps([f'{own[key]}_{j}' for j in JOINTS])}"
        lines.append(line)
    motor = f"[motor]\ngear_matrix = {np.diag(GEARS).tolist()}\noffset = [0.0, 0.0, 0.0]\n"
    return "\n".join(lines).replace("[[recording]]", f"{motor}\n[[recording]]", 1) + "\n"


def identified(campaign: Path, *options: object) -> dict[str, Any]:
    """The content of ``frf.json``; nothing may be left out."""
    out = campaign.parent.parent / "frf"
    run("frf", campaign, "--out", out, "--jobs", 1, "--bending-alike-std", 0, *options)
    found: dict[str, Any] = json.loads((out / "frf.json").read_text())
    assert found["left_out"] == [] and found["replay"] is not None
    return found


def closed_loop(folder: Path, robot: Path) -> dict[str, Any]:
    """The content of ``closed_loop.json`` on what `identified` wrote."""
    run("close-loop", folder / "frf", "--robot", robot, "--out", folder / "closed")
    found: dict[str, Any] = json.loads((folder / "closed" / "closed_loop.json").read_text())
    return found


def errors(arm: Arm, fit: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Of each inertia and stiffness, logarithms: the error and its stated standard deviation."""
    out = {}
    for name, true in arm.truth.items():
        p = fit["parameters"][name]
        out[name] = float(np.log(p["value"] / true)), float(np.log(p["high"] / p["low"]) / 3.92)
    return out


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


def test_by_motion_alone_the_drives_of_an_unknown_arm_are_found(tmp_path: Path) -> None:
    """Neither a torque input nor the controller is known, and only angles and torques of the motors are logged."""
    arm = Arm.drawn(SEED)
    campaign = recorded(arm, tmp_path, by="reference", known=False, period_s=2.048, realisations=2)
    assert_found(arm, identified(campaign, "--modes", 6))


@pytest.mark.slow
def test_two_poses_tell_a_known_loop_s_arm_and_that_nothing_is_missing(tmp_path: Path) -> None:
    """Torques are fed forward, and logged a millisecond late: the skew is taken out and no cause is named."""
    arm = Arm.drawn(3, torque_late_s=1e-3)
    campaign = recorded(arm, tmp_path, by="torque", known=True, poses=TWO_POSES)
    assert_found(arm, identified(campaign, "--modes", 6))
    closed = closed_loop(tmp_path, write_robot(arm, tmp_path, guess=0.0))
    assert closed["verdict"] == "nothing_missing" and closed["effects"] == []


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
