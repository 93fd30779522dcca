"""What ``rx90b-flex check-path`` reads and writes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rx90b_flex.effects.motion import Array
from rx90b_flex.files.results import finite, write_json
from rx90b_flex.path.check import Deviation, PathCheck
from rx90b_flex.path.seam import EXAMPLES
from rx90b_flex.simulate.closed_loop import tip_poses
from rx90b_flex.simulate.command import write_run

RUNS = ("as_planned", "corrected")  # folders
SENT = """\
# The references in this log are those of the path as planned, which deviations are from.
# What the controller was sent is ../corrected_joints.csv.
"""


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
    result: PathCheck, folder: Path, more: Callable[[PathCheck, Path], None] | None = None, overwrite: bool = False
) -> None:
    """Fill a folder, whole or not at all: `path_check.json`, `seam.csv`, and of a corrected path `corrected_path.csv` and
    `corrected_joints.csv`; the runs in the folders `RUNS`, as `rx90b-flex view` takes them; then what `more` writes there.
    """
    from rx90b_flex.signals.folders import PATH_CHECK, fill_folder

    def fill(at: Path) -> None:
        write_json(at / "path_check.json", as_json(result), indent=1, allow_nan=True)
        write_seam(result, at / "seam.csv")
        if result.correction is not None:
            write_corrected(result, at)
        write_runs(result, at)
        if more is not None:
            more(result, at)

    fill_folder(folder, fill, PATH_CHECK, overwrite)


def as_json(result: PathCheck) -> dict[str, Any]:
    """Everything but the samples."""
    plan, tolerance = result.plan, result.options.tolerance_mm
    return {
        "schema": 1,
        "path": plan.seam.name,
        "robot": plan.robot.name,
        "tolerance_mm": tolerance,
        "verdict": result.verdict,
        "length_mm": 1e3 * plan.seam.pieces.total,
        "speed_mm_s": 1e3 * plan.seam.speed,
        "duration_s": plan.seam.duration_s,
        "notes": plan.seam.notes(),
        "before": _deviation(result.before, tolerance),
        "after": None if result.after is None else _deviation(result.after, tolerance),
        "correction_ended": result.correction_ended,
        "iterations": [_in_mm(i, "max_across", "rms_across") for i in result.iterations],
        "contributions": [
            {"name": c.name, "part": c.part}
            | _in_mm(c, "max_across", "rms_across", "max_along")
            | {"rms_across_without_mm": finite(c.rms_without), "not_switched_off": c.why_not}
            for c in result.contributions
        ],
        "only_together_rms_across_mm": finite(result.left_over),
        "sticking": [s._asdict() for s in result.sticking],
        "wrong_model": [{"lower": name, **_deviation(d, tolerance)} for name, d in result.wrong_model],
        "seconds": {stage: round(s, 3) for stage, s in result.seconds.items()},
    }


def _deviation(of: Deviation, tolerance_mm: float) -> dict[str, Any]:
    within = of.within(tolerance_mm)
    return {
        **_in_mm(of, "max_across", "rms_across", "max_along"),
        "worst_at_mm": of.worst_at_mm,
        "millimetres": len(within),
        "millimetres_within": int(within.sum()),
        "failing": [{"from_mm": a, "to_mm": b, "max_across_mm": finite(c)} for a, b, c in of.failing(tolerance_mm)],
        "ended": of.ended,
    }


def _in_mm(of: object, *names: str) -> dict[str, float | None]:
    return {f"{name}_mm": finite(getattr(of, name)) for name in names}


def write_columns(file: Path, columns: Mapping[str, Array], digits: int) -> None:
    """A CSV table of numbers with so many digits."""
    pd.DataFrame(columns).to_csv(file, index=False, float_format=f"%.{digits}g")


def write_seam(result: PathCheck, file: Path) -> None:
    """Pass or fail of each millimetre: `mm` is where it begins; an empty cell is a place that the run did not reach."""
    columns: dict[str, Any] = {"mm": np.arange(len(result.before.by_mm))}
    for when, of in (("before", result.before), ("after", result.after)):
        if of is not None:
            columns[f"across_{when}_mm"] = np.where(np.isfinite(of.by_mm), of.by_mm, np.nan)
            columns[when] = np.where(of.within(result.options.tolerance_mm), "pass", "fail")
    pd.DataFrame(columns).to_csv(file, index=False, float_format="%.5f")


def write_corrected(result: PathCheck, folder: Path) -> None:
    """The corrected reference: `corrected_path.csv`, the tip's place that the rigid robot would have (m), its displacement from the
    path (mm) and the joint angles (rad; a joint called x, y or z as `joint_x`); `corrected_joints.csv`, the angles alone, as
    `rx90b-flex simulate --trajectory` takes them.
    """
    plan = result.plan
    trajectory = plan.trajectory(result.correction)
    place = reference_tip(result)
    columns = {"time": plan.time, "distance_mm": 1e3 * plan.distance}
    columns |= {axis: place[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"correction_{axis}_mm": 1e3 * (place - plan.point)[:, i] for i, axis in enumerate("xyz")}
    joints = dict(zip(trajectory.joints, trajectory.position.T, strict=True))
    beside = {f"joint_{j}" if j in columns else j: angles for j, angles in joints.items()}
    write_columns(folder / "corrected_path.csv", columns | beside, digits=10)
    write_columns(folder / "corrected_joints.csv", {"time": plan.time, **joints}, digits=10)


def write_runs(result: PathCheck, folder: Path) -> None:
    """The runs with all their coordinates; both have the planned path as reference, so that deviations are from that."""
    for name, run in zip(RUNS, result.runs, strict=False):
        references = ("reference_position", "reference_velocity")
        planned = {name: getattr(result.runs[0].recording, name) for name in references}
        recording = dataclasses.replace(run.recording, **planned)
        (folder / name).mkdir()
        write_run(dataclasses.replace(run, recording=recording), folder / name)
        if name == RUNS[1]:
            campaign = folder / name / "campaign.toml"
            campaign.write_text(SENT + campaign.read_text(encoding="utf-8"), encoding="utf-8")


def reference_tip(result: PathCheck) -> Array:
    """Where the corrected references would put the rigid robot's tip, shape (N, 3), m."""
    robot, references = result.plan.robot, result.plan.trajectory(result.correction)
    return tip_poses(robot.tree, robot.tip_frame, references.position)[:, :3, 3]
