"""What ``rx90b-flex import`` does: logs and a robot become a campaign that the other commands read."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rx90b_flex.export import save_robot
from rx90b_flex.files.keys import whole_names
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals.facts import found_period_s, sensible_cutoff_hz
from rx90b_flex.signals.filters import minimum_samples
from rx90b_flex.signals.folders import CAMPAIGN, check_folder, fill_folder
from rx90b_flex.signals.import_options import Axes, Finding, ReadingOptions, Sureness
from rx90b_flex.signals.importers import Imported, import_logs
from rx90b_flex.signals.recording import LARGEST_ANGLE, Recording, load_campaign, write_campaign
from rx90b_flex.tip import is_finger, tip_words

FILTERS = 4  # times the length of the low-pass that a recording must have
FORMATS = ("parquet", "csv", "csv.gz")


def options_of(
    columns: Sequence[str],
    joints: str | None,
    rate: float | None,
    degrees: bool | None,
    gear: str | None,
    offset: str | None,
    topic: str | None,
) -> ReadingOptions:
    """Options from the command line's words.

    Raises
    ------
    ValueError
        One line that names the option.
    """
    chosen: dict[str, tuple[str, ...]] = {}
    for text in columns:
        signal, equals, names = text.partition("=")
        if not equals or not names:
            raise ValueError(f"--columns {text}: expected SIGNAL=NAME,NAME,...")
        chosen[signal.strip()] = _listed(names)
    gears = tuple(_numbers("--gear", row) for row in (gear or "").split(";") if row.strip())
    if joints is not None and not _listed(joints):
        raise ValueError(f"--joints {joints}: expected names with commas between")
    return ReadingOptions(
        chosen, _listed(joints or ""), rate, degrees, gears, _numbers("--offset", offset or ""), topic
    )


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in _listed(text))
    except ValueError:
        raise ValueError(f"{option} {text}: expected numbers with commas between") from None


def _listed(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def import_into(
    folder: Path,
    files: Sequence[Path],
    robot: str,
    options: ReadingOptions,
    file_format: str = "parquet",
    basics: bool = False,
    overwrite: bool = False,
) -> Imported:
    """Import and write the campaign; nothing is written unless all of it is, and can be read again.

    Parameters
    ----------
    folder : of the campaign.
    files : of logs; the last validates.
    robot : as `load_robot` takes it.
    options : what is not to be worked out.
    file_format : of the recordings: parquet, csv or csv.gz.
    basics : whether to write a robot file that declares drive inertia, friction and an offset on every joint of the logs.
    overwrite : whether what is in the way is replaced.

    Raises
    ------
    ValueError
        One line that names the file and the column, or the option.
    """
    if file_format not in FORMATS:
        raise ValueError(f"--format {file_format}: expected {', '.join(FORMATS)}")
    check_folder(folder, CAMPAIGN, overwrite)
    loaded = load_robot(robot)
    options = dataclasses.replace(options, joints=whole_names(options.joints, loaded.joints))
    lower, upper = (tuple(map(float, x)) for x in (loaded.tree.lowerPositionLimit, loaded.tree.upperPositionLimit))
    axes = Axes(loaded.joints, lower, upper, tuple(unit.slides for unit in loaded.units))
    imported = import_logs(files, axes, options)
    _refuse_far(imported.recordings, axes)
    imported = _with_facts(imported)
    imported, cutoff = _with_low_pass(imported)
    if is_finger(loaded):
        imported = _with_finding(imported, tip_words(loaded, ""), "likely")
    if not basics:
        imported = _with_offer(imported, loaded)
    written_names = {f"{r.name}.{file_format}" for r in imported.recordings}
    for file in files:
        if file.name in written_names and file.resolve().parent == folder.resolve():
            raise ValueError(f"{folder}: holds {file.name}, which this run reads; give another folder")
    path = Path(robot)
    # as seen from where the campaign will lie, not from where it is made
    written = Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix() if path.is_file() else robot

    def fill(at: Path) -> None:
        name = _write_basics(loaded, imported.recordings[0].joints, at) if basics else written
        from_current = imported.recordings[0].motor_current is not None
        made = write_campaign(
            at,
            name,
            imported.recordings,
            cutoff_hz=cutoff,
            file_format=file_format,  # type: ignore[arg-type]
            from_current=from_current,
        )
        try:
            load_campaign(made)
        except ValueError as error:  # it will not lie where it was made
            raise ValueError(str(error).replace(str(at), str(folder))) from error

    fill_folder(folder, fill, CAMPAIGN, overwrite)
    return imported


def _refuse_far(recordings: Sequence[Recording], axes: Axes) -> None:
    """Refuse positions that no joint has, in terms of what an import can be told."""
    for r in recordings:
        largest = np.abs(r.position).max(axis=0)
        worst = int(largest.argmax())
        if largest[worst] > LARGEST_ANGLE:
            turns = axes.turns(r.joints[worst])
            unit, cure = ("rad", "--degrees") if turns else ("m", "a unit in the column's name, as in [mm]")
            raise ValueError(
                f"{r.source}: motor_position of {r.joints[worst]} reaches {largest[worst]:.4g} {unit}, below {LARGEST_ANGLE:g} is "
                f"expected; motor side (--gear)? another unit ({cure})? another joint (--columns)?"
            )


def _with_facts(imported: Imported) -> Imported:
    """With the period of each motion that repeats."""
    recordings, findings = [], list(imported.findings)
    for recording in imported.recordings:
        period = recording.period_s or found_period_s(recording)
        if period is not None and recording.period_s is None:
            recording = dataclasses.replace(recording, period_s=period)
            findings.append((recording.name, Finding(f"the motion repeats every {period:g} s", "likely")))
        recordings.append(recording)
    return dataclasses.replace(imported, recordings=tuple(recordings), findings=tuple(findings))


def _with_low_pass(imported: Imported) -> tuple[Imported, float | None]:
    """With a low-pass that keeps the motion, Hz; none where a recording is too short for it."""
    cutoff = round(sensible_cutoff_hz(imported.recordings), 1)
    fits = all(r.samples >= FILTERS * minimum_samples(cutoff, r.sample_rate_hz) for r in imported.recordings)
    if not fits:
        return imported, None
    said = f"low-pass: {cutoff:g} Hz, from the motion's own frequencies; change cutoff_hz in the file"
    return _with_finding(imported, said, "likely"), cutoff


def _with_finding(imported: Imported, said: str, sure: Sureness) -> Imported:
    return dataclasses.replace(imported, findings=(*imported.findings, ("all files", Finding(said, sure))))


def _with_offer(imported: Imported, robot: Robot) -> Imported:
    """With the offer to declare what every drive has, where the robot has none of it on any joint of the logs."""
    from rx90b_flex.diagnose.faults.sample import BASICS

    joints = set(imported.recordings[0].joints)
    here = [e for e in robot.effects if joints & set(e.joints)]
    if set(BASICS) & {name for e in here for name in (e.type_name(), *e.traits.replaces)}:
        return imported
    text = f"{robot.name} declares neither friction nor drive inertia on these joints; --basics has them identified"
    return _with_finding(imported, text, "sure")


def _write_basics(robot: Robot, joints: Sequence[str], folder: Path) -> str:
    """The robot with what every drive has declared, as files beside the campaign."""
    from rx90b_flex.diagnose.basics import with_basics

    path = save_robot(with_basics(robot, joints), folder, allow_inconsistent=True)
    return path.name
