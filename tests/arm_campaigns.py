"""Campaigns that the arm of `mujoco_arm` has played, by documented commands alone, and what is found of it beside the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco_arm import GEARS, JOINTS, Arm, play, write_controller, write_robot

from rx90b_flex import cli

ONE_POSE, TWO_POSES = ("0,90,30",), ("0,90,30", "0,50,80")


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
    without: tuple[str, ...] = (),
    guess: float = 0.2,
) -> Path:
    """A campaign that the arm has played.

    `known`: whether its controller is described; `declared` and `without`: what its robot file is of.
    """
    folder.mkdir(parents=True, exist_ok=True)
    robot = write_robot(declared or arm, folder, without, guess=guess)
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


def analysed(campaign: Path, *options: object) -> dict[str, Any]:
    """The content of ``frf.json``."""
    out = campaign.parent.parent / "frf"
    run("frf", campaign, "--out", out, "--jobs", 1, "--bending-alike-std", 0, *options)
    found: dict[str, Any] = json.loads((out / "frf.json").read_text())
    return found


def identified(campaign: Path, *options: object) -> dict[str, Any]:
    """The same; nothing may be left out."""
    found = analysed(campaign, *options)
    assert found["left_out"] == [] and found["replay"] is not None
    return found


def errors(arm: Arm, fit: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Of each inertia and stiffness, logarithms: the error and its stated standard deviation."""
    out = {}
    for name, true in arm.truth.items():
        p = fit["parameters"][name]
        out[name] = float(np.log(p["value"] / true)), float(np.log(p["high"] / p["low"]) / 3.92)
    return out
