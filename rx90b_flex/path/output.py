"""What ``rx90b-flex check-path`` reads and writes."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from rx90b_flex.effects.motion import Array
from rx90b_flex.path.check import Deviation, PathCheck, PathOptions, Tell, check_path
from rx90b_flex.path.seam import EXAMPLES, load_seam
from rx90b_flex.robot import load_robot
from rx90b_flex.simulate.command import controller_of, write_run

ROBOT = "rx90b"  # where neither the command nor the path file says
RUNS = ("as_planned", "corrected")  # folders


@dataclass(frozen=True)
class PathRequest:
    """What the user asks for.

    Attributes
    ----------
    path : str
        A path file, a table of points, or the name of an example.
    robot : str or None
        As `load_robot` takes it; the path file's, or the RX90B, where not given.
    controller : Path or None
        Controller file; the CS8's where the robot has its joints, else gains designed for the robot.
    speed_mm_s : float or None
        Instead of the path file's.
    options : Options
    """

    path: str
    robot: str | None = None
    controller: Path | None = None
    speed_mm_s: float | None = None
    options: PathOptions = field(default_factory=PathOptions)


def run_request(request: PathRequest, tell: Tell | None = None) -> PathCheck:
    """Read everything that a request names, and check the path.

    Raises
    ------
    ValueError
        One line that names the file and key, or the place along the path and what is wrong there.
    """
    seam = load_seam(request.path, request.speed_mm_s)
    robot = load_robot(request.robot or seam.robot or ROBOT)
    for effect in robot.effects:
        effect.known_coefficients()
    return check_path(seam, robot, controller_of(robot, request.controller), request.options, tell)


def write_example(name: str, file: Path) -> None:
    """Write one of the examples as a path file to start from; an existing file is left alone."""
    if name not in EXAMPLES:
        raise ValueError(f"{name} is no example; expected {' or '.join(EXAMPLES)}")
    if file.suffix != ".toml":
        raise ValueError(f"{file}: expected a name that ends in .toml")
    if file.exists():
        raise ValueError(f"{file}: exists; expected a new file")
    if not file.absolute().parent.is_dir():
        raise ValueError(f"{file}: {file.absolute().parent} is no folder")
    file.write_text(EXAMPLES[name], encoding="utf-8")


def write_check(
    result: PathCheck,
    folder: Path,
    more: tuple[Callable[[PathCheck, Path], None], ...] = (),
    overwrite: bool = False,
) -> None:
    """Fill a folder, whole or not at all: `path_check.json`, `seam.csv`, and of a corrected path `corrected_path.csv` and
    `corrected_joints.csv`; the runs in the folders `RUNS`, as `rx90b-flex view` takes them; then what `more` writes there.
    """
    from rx90b_flex.signals.folders import PATH_CHECK, fill_folder

    def fill(at: Path) -> None:
        (at / "path_check.json").write_text(json.dumps(as_json(result), indent=1) + "\n", encoding="utf-8")
        write_seam(result, at / "seam.csv")
        if result.correction is not None:
            write_corrected(result, at)
        write_runs(result, at)
        for write in more:
            write(result, at)

    fill_folder(folder, fill, PATH_CHECK, overwrite)


def as_json(result: PathCheck) -> dict[str, Any]:
    """Everything but the samples."""
    plan, options = result.plan, result.options
    effects = [
        {
            "name": c.name,
            "part": c.part,
            "max_across_mm": _finite(c.max_across),
            "rms_across_mm": _finite(c.rms_across),
            "max_along_mm": _finite(c.max_along),
            "rms_across_without_mm": _finite(c.rms_without),
            "not_switched_off": c.why_not,
        }
        for c in result.contributions
    ]
    return {
        "schema": 1,
        "path": plan.seam.name,
        "robot": plan.robot.name,
        "tolerance_mm": options.tolerance_mm,
        "verdict": result.verdict,
        "length_mm": 1e3 * plan.seam.pieces.total,
        "speed_mm_s": 1e3 * plan.seam.speed,
        "duration_s": plan.seam.duration_s,
        "notes": plan.seam.notes(),
        "before": _deviation(result.before, options.tolerance_mm),
        "after": None if result.after is None else _deviation(result.after, options.tolerance_mm),
        "iterations": [{"max_across_mm": i.max_across, "rms_across_mm": i.rms_across} for i in result.iterations],
        "contributions": effects,
        "only_together_rms_across_mm": _finite(result.left_over),
        "sticking": [{"joint": s.joint, "stops": s.stops} for s in result.sticking],
        "wrong_model": [{"lower": name, **_deviation(d, options.tolerance_mm)} for name, d in result.wrong_model],
        "seconds": {stage: round(s, 3) for stage, s in result.seconds.items()},
    }


def _deviation(of: Deviation, tolerance_mm: float) -> dict[str, Any]:
    within = of.within(tolerance_mm)
    return {
        "max_across_mm": of.max_across,
        "rms_across_mm": of.rms_across,
        "max_along_mm": of.max_along,
        "worst_at_mm": of.worst_at_mm,
        "millimetres": len(within),
        "millimetres_within": int(within.sum()),
        "failing": [{"from_mm": a, "to_mm": b, "max_across_mm": _finite(c)} for a, b, c in of.failing(tolerance_mm)],
        "ended": of.ended,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_seam(result: PathCheck, file: Path) -> None:
    """Pass or fail of each millimetre: `mm` is where it begins; an empty cell is a place that the run did not reach."""
    columns = [("before", result.before), *([("after", result.after)] if result.after is not None else [])]
    names = ["mm", *(name for when, _ in columns for name in (f"across_{when}_mm", f"{when}"))]
    lines = [",".join(names)]
    for mm in range(len(result.before.by_mm)):
        cells = [str(mm)]
        for _, of in columns:
            value = float(of.by_mm[mm])
            cells += [
                f"{value:.5f}" if math.isfinite(value) else "",
                "pass" if value <= result.options.tolerance_mm else "fail",
            ]
        lines.append(",".join(cells))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_corrected(result: PathCheck, folder: Path) -> None:
    """The corrected reference: `corrected_path.csv`, the tip's place that the rigid robot would have (m), its displacement from the
    path (mm) and the joint angles (rad); `corrected_joints.csv`, the angles alone, as `rx90b-flex simulate --trajectory` takes them.
    """
    plan = result.plan
    trajectory = plan.trajectory(result.correction)
    place = reference_tip(result)
    columns = {"time": plan.time, "distance_mm": 1e3 * plan.distance}
    columns |= {axis: place[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"correction_{axis}_mm": 1e3 * (place - plan.point)[:, i] for i, axis in enumerate("xyz")}
    joints = dict(zip(trajectory.joints, trajectory.position.T, strict=True))
    _write_columns(folder / "corrected_path.csv", columns | joints)
    _write_columns(folder / "corrected_joints.csv", {"time": plan.time, **joints})


def write_runs(result: PathCheck, folder: Path) -> None:
    """The runs with all their coordinates; both have the planned path as reference, so that deviations are from that."""
    for name, run in zip(RUNS, result.runs, strict=False):
        planned = result.runs[0].recording
        recording = dataclasses.replace(
            run.recording,
            reference_position=planned.reference_position,
            reference_velocity=planned.reference_velocity,
        )
        (folder / name).mkdir()
        write_run(dataclasses.replace(run, recording=recording), folder / name)


def reference_tip(result: PathCheck) -> Array:
    """Where the corrected references would put the rigid robot's tip, shape (N, 3), m."""
    model = result.plan.robot.tree
    data, tip = model.createData(), model.getFrameId(result.plan.robot.tip_frame)
    out = np.empty_like(result.plan.point)
    for k, q in enumerate(result.plan.trajectory(result.correction).position):
        pin.framesForwardKinematics(model, data, q)
        out[k] = data.oMf[tip].translation
    return out


def _write_columns(file: Path, columns: dict[str, Array]) -> None:
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(f"{x:.10g}" for x in row) for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
