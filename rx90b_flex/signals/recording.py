"""Campaign files and recordings: logged signals of one robot, on the joint side, in SI units."""

from __future__ import annotations

import dataclasses
import datetime
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from rx90b_flex.files.keys import suggestion
from rx90b_flex.files.table import TomlTable
from rx90b_flex.files.toml import named_beside, read_toml, toml_text
from rx90b_flex.pieces import Array
from rx90b_flex.signals import tables
from rx90b_flex.signals.data_fault import DataFault, DataFaultError
from rx90b_flex.signals.stated import (
    JOINT_SIDES,
    Accelerometer,
    FlangeLoad,
    read_accelerometers,
    read_date,
    read_flange_load,
    read_torque_constants,
    read_torque_side,
)
from rx90b_flex.signals.times import check_increasing, check_uniform, printed_resolution

Role = Literal["identification", "validation"]
ROLES: tuple[Role, ...] = get_args(Role)
FIRST_CLOCK_S, LAST_CLOCK_S = 1e9, 1e10  # seconds since 1970, from 2001 on: what a log's clock says is then a date


@dataclass(frozen=True)
class Signal:
    """How one signal is called in a campaign file (`key`), in a `Recording` and in written tables; all names stand here."""

    key: str
    field: str
    prefix: str
    kind: Literal["angle", "velocity", "torque", "current"]
    always_joint_side: bool = False


SIGNALS = (
    Signal("motor_position", "position", "q", "angle"),
    Signal("torque", "torque", "tau", "torque"),
    Signal("motor_velocity", "velocity", "v", "velocity"),
    Signal("link_position", "link_position", "link", "angle", always_joint_side=True),
    Signal("reference_position", "reference_position", "ref", "angle"),
    Signal("reference_velocity", "reference_velocity", "refv", "velocity"),
    Signal("feedforward_torque", "feedforward_torque", "ff", "torque"),
    Signal("joint_torque", "joint_torque", "jtau", "torque", always_joint_side=True),
    Signal("motor_current", "motor_current", "i", "current", always_joint_side=True),
)
REQUIRED = ("motor_position", "torque")  # in a campaign file motor_current may stand in for the torque
# No robot joint turns further in a recording; degrees and motor angles do.
LARGEST_ANGLE = 100.0
# Nor is there a torque, a speed or a current of this size; sums of squares stay finite below it.
_LARGEST_DEGREES = 360.0  # beyond it, motor turns are as likely
_OTHER_UNIT = re.compile(
    r"[_\[( /](degs?|degrees?|deg[_/]s2?|dps|mrad|revs?|rpm|turns?|mm|nmm|ncm|knm|ma|mv|counts?|ticks?|percent)[\])]?$",
    re.IGNORECASE,
)


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording (or part of one), N samples of n joints, on the joint side of the gears.

    Attributes
    ----------
    name : name of the file without extension, unique among the recordings of one role of a campaign.
    role : "identification" or "validation".
    time : (N,) s, as in the file; from the sample rate where the file has no such column.
    sample_rate_hz : Hz.
    joints : n names, the order of the columns.
    position : (N, n) rad, measured motor angle seen through the gears (`drive_angle`).
    torque : (N, n) N m, measured motor torque seen through the gears (`drive_torque`).
    velocity : (N, n) rad/s, measured, or None.
    link_position : (N, n) rad, measured behind the gears (`joint_angle`), or None.
    reference_position, reference_velocity : (N, n) rad and rad/s, what the controller was asked for, or None.
    feedforward_torque : (N, n) N m, added to the controller's torque, or None.
    joint_torque : (N, n) N m, of torque sensors behind the gears, or None.
    motor_current : (N, n) A, or None.
    acceleration : (N, 3 s) m/s^2, x, y and z of each accelerometer of the campaign, or None.
    payload : known mass on the flange, or None.
    period_s : s, the excitation's period, a whole number of samples; None where it does not repeat.
    source : the file it came from.
    date : the day it was made, as in 2026-03-02 (ISO 8601), or None.

    Raises
    ------
    ValueError
        Shapes that do not fit together, an unknown role, a sample rate or period that cannot be.
    """

    name: str
    role: Role
    time: Array
    sample_rate_hz: float
    joints: tuple[str, ...]
    position: Array
    torque: Array
    velocity: Array | None = None
    link_position: Array | None = None
    reference_position: Array | None = None
    reference_velocity: Array | None = None
    feedforward_torque: Array | None = None
    joint_torque: Array | None = None
    motor_current: Array | None = None
    acceleration: Array | None = None
    payload: FlangeLoad | None = None
    period_s: float | None = None
    source: Path | None = None
    date: str | None = None

    def __post_init__(self) -> None:
        where = f"recording {self.name!r}"
        if self.role not in ROLES:
            raise ValueError(f"{where}: role {self.role!r} is not one of {', '.join(ROLES)}")
        if not (math.isfinite(self.sample_rate_hz) and self.sample_rate_hz > 0.0):
            raise ValueError(f"{where}: sample_rate_hz = {self.sample_rate_hz!r}, a number above 0 is expected")
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "time", np.asarray(self.time, dtype=np.float64))
        if self.time.ndim != 1:
            raise ValueError(f"{where}: time has shape {self.time.shape}, (samples,) is expected")
        expected = (len(self.time), len(self.joints))
        for item in SIGNALS:
            value = getattr(self, item.field)
            if value is None and item.key not in REQUIRED:
                continue
            array = np.asarray(value, dtype=np.float64)
            if array.shape != expected:
                raise ValueError(f"{where}: {item.field} has shape {array.shape}, {expected} is expected")
            object.__setattr__(self, item.field, array)
        if self.acceleration is not None:
            array = np.asarray(self.acceleration, dtype=np.float64)
            if array.ndim != 2 or len(array) != len(self.time) or array.shape[1] % 3:
                raise ValueError(
                    f"{where}: acceleration has shape {array.shape}, ({len(self.time)}, 3 a sensor) is expected"
                )
            object.__setattr__(self, "acceleration", array)
        problem = _period_problem(self.period_s, self.sample_rate_hz, self.samples)
        if problem:
            raise ValueError(f"{where}: period_s = {self.period_s!r} {problem}")
        if self.date is not None:
            try:
                datetime.date.fromisoformat(self.date)
            except ValueError:
                raise ValueError(f"{where}: date = {self.date!r}, a day such as 2026-03-02 is expected") from None

    @property
    def file_name(self) -> str:
        """Name of its file, or its own where it came from none."""
        return self.source.name if self.source else self.name

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return len(self.time)

    @property
    def duration_s(self) -> float:
        """N sample periods, s."""
        return self.samples / self.sample_rate_hz

    @property
    def period_samples(self) -> int | None:
        """Samples of one period of the excitation, or None."""
        return None if self.period_s is None else round(self.period_s * self.sample_rate_hz)


@dataclass(frozen=True, eq=False)
class Campaign:
    """Recordings of one robot and what is stated about them.

    Attributes
    ----------
    path : the campaign file.
    robot : as given in the file.
    robot_source : path of the robot file where `robot` names a file beside the campaign file, else the same string.
    sample_rate_hz : Hz, of every recording.
    joints : names, in the order of the columns of every recording.
    recordings : in the order of the file.
    cutoff_hz : Hz, zero-phase low-pass that the user asks for on every signal, or None. Not yet applied.
    noise_torque : n values, N m, joint side, 0 or more: stated RMS of the torque sensors' noise (`[noise] torque_rms`),
        or None.
    torque_side : side of the gears that the torques are measured on as the file states it (`[torque] side`), or None.
    torque_constants : n values, N m/A at the joint, where torques come from currents, else None; None for one that is left out:
        the torque of that joint stands in A until the constant is identified.
    accelerometers : sensors on links, in the order of the recordings' `acceleration`.
    gear_matrix : n rows of n, where the file's columns are those of motors, else None: motor angle = gear_matrix @ (joint angle -
        `offset`).
    offset : n values, rad, beside a `gear_matrix`.
    """

    path: Path
    robot: str
    robot_source: Path | str
    sample_rate_hz: float
    joints: tuple[str, ...]
    recordings: tuple[Recording, ...]
    cutoff_hz: float | None = None
    noise_torque: tuple[float, ...] | None = None
    torque_constants: tuple[float | None, ...] | None = None
    torque_side: str | None = None
    accelerometers: tuple[Accelerometer, ...] = ()
    gear_matrix: tuple[tuple[float, ...], ...] | None = None
    offset: tuple[float, ...] = ()

    @property
    def identification(self) -> tuple[Recording, ...]:
        """Recordings that parameters are identified on."""
        return tuple(recording for recording in self.recordings if recording.role == "identification")

    @property
    def validation(self) -> tuple[Recording, ...]:
        """Recordings that predictions are judged on; may be empty."""
        return tuple(recording for recording in self.recordings if recording.role == "validation")


def load_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Read a campaign file (TOML) and its recordings; angles and torques are brought to the joint side.

    With a `[motor]` table: motor angle = gear_matrix @ (joint angle - offset), joint torque = gear_matrix.T @ motor
    torque, unless `[torque] side` says that torques are not the motors'; velocities likewise without the offset. References
    and feed-forward torque are motor side as well then; `link_position`, `joint_torque` and `motor_current` never are; where
    there is a current and no torque, the torque is ``torque_constant * motor_current``. A data file used by several
    recordings is read once, only the columns needed.

    Raises
    ------
    ValueError
        One line that names the campaign file and the key, or the data file, column and row (data rows count from 1),
        what was found and what is expected.
    """
    path = Path(path)
    missing = "no such file; a campaign file (TOML) is expected"
    root = TomlTable(str(path), "", read_toml(path, "campaign file", missing))
    layout = _read_layout(root, path)
    entries = [_read_entry(section, path, layout) for section in root.sections("recording")]
    if not any(entry.role == "identification" for entry in entries):
        raise root.problem("recording", 'none has role = "identification"; at least one is needed')

    columns = list(dict.fromkeys(name for names in (*layout.columns.values(), layout.acceleration) for name in names))
    files: dict[Path, tables.Table] = {}
    recordings: list[Recording] = []
    names: set[tuple[Role, str]] = set()
    for entry in entries:
        try:
            if entry.file not in files:
                files[entry.file] = tables.read_table(entry.file, columns, optional=("time",))
            recording = _cut(files[entry.file], entry, layout)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        name, count = recording.name, 1
        while (entry.role, name) in names:
            count += 1
            name = f"{recording.name}_{count}"
        names.add((entry.role, name))
        recordings.append(dataclasses.replace(recording, name=name))

    return dataclasses.replace(layout.stated, recordings=tuple(recordings))


def save_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write one recording as .parquet, .csv or .csv.gz: `time` and joint-side columns named `q_<joint>`, `tau_<joint>`,
    and, for the optional signals there are, `v_`, `link_`, `ref_`, `refv_`, `ff_`, `jtau_` and `i_<joint>`, and of
    accelerometers `acc_1_x` and so on.

    Every format reads back the same numbers. The file appears whole or not at all.
    """
    _save(recording, Path(path), SIGNALS)


def _save(recording: Recording, path: Path, signals: Sequence[Signal]) -> None:
    """Write time, those of `signals` that a recording has, and accelerations."""
    names = ["time"]
    blocks = [recording.time[:, None]]
    for item in signals:
        value = getattr(recording, item.field)
        if value is not None:
            names += [f"{item.prefix}_{joint}" for joint in recording.joints]
            blocks.append(value)
    if recording.acceleration is not None:
        names += _acceleration_columns(recording.acceleration.shape[1] // 3)
        blocks.append(recording.acceleration)
    tables.write_table(path, names, np.hstack(blocks))


def write_campaign(
    directory: str | os.PathLike[str],
    robot: str | Path,
    recordings: Sequence[Recording],
    *,
    cutoff_hz: float | None = None,
    noise_torque: Sequence[float] | None = None,
    accelerometers: Sequence[Accelerometer] = (),
    file_format: Literal["parquet", "csv", "csv.gz"] = "parquet",
    from_current: bool = False,
) -> Path:
    """Write recordings and a `campaign.toml` that `load_campaign` reads back as the same recordings.

    Parameters
    ----------
    directory : made where missing.
    robot : written as it is (a name, or relative to `directory`); a `Path` is written relative to `directory`.
    recordings : of one robot: same joints, sample rate and signals. Files take the recordings' names, in a folder named
        for the role where both roles have a recording of that name.
    cutoff_hz, noise_torque, accelerometers : as in `Campaign`.
    from_current : whether torques are the currents times constants that are not known; they are not written then.

    Returns
    -------
    Path of the campaign file, written last.

    Raises
    ------
    ValueError
        Recordings that do not fit in one campaign, or a name that cannot be a file's.
    """
    directory = Path(directory)
    if file_format not in ("parquet", "csv", "csv.gz"):
        raise ValueError(f"file_format {file_format!r}: parquet, csv or csv.gz is expected")
    fields = [f for f in _common_signals(recordings) if not (from_current and f.key == "torque")]
    first = recordings[0]
    robot_text = robot if isinstance(robot, str) else Path(os.path.relpath(robot, directory)).as_posix()
    if noise_torque is not None and len(noise_torque) != len(first.joints):
        raise ValueError(f"noise_torque has {len(noise_torque)} values for {len(first.joints)} joints")
    columns = np.reshape(_acceleration_columns(len(accelerometers)), (-1, 3))
    content: dict[str, Any] = {
        "robot": robot_text,
        "sample_rate_hz": float(first.sample_rate_hz),
        "joints": first.joints,
        "signals": {item.key: [f"{item.prefix}_{joint}" for joint in first.joints] for item in fields},
        "preprocessing": None if cutoff_hz is None else {"cutoff_hz": float(cutoff_hz)},
        "noise": None if noise_torque is None else {"torque_rms": np.asarray(noise_torque, dtype=float)},
        "accelerometer": [
            {"link": sensor.link, "position": np.asarray(sensor.position, dtype=float), "columns": of_sensor.tolist()}
            for sensor, of_sensor in zip(accelerometers, columns, strict=True)
        ],
        "recording": [],
    }
    for recording, file in zip(recordings, _file_names(recordings, file_format), strict=True):
        target = directory / file
        target.parent.mkdir(parents=True, exist_ok=True)
        _save(recording, target, fields)
        content["recording"].append(_entry_of(recording, file))
    campaign = directory / "campaign.toml"
    tables.write_whole(campaign, lambda temporary: temporary.write_text(toml_text(content), encoding="utf-8"))
    return campaign


def _entry_of(recording: Recording, file: str) -> dict[str, Any]:
    """A recording's section of the campaign file."""
    return {
        "file": file,
        "role": recording.role,
        "period_s": None if recording.period_s is None else float(recording.period_s),
        "payload": None if recording.payload is None else dataclasses.asdict(recording.payload),
        "date": None if recording.date is None else datetime.date.fromisoformat(recording.date),
    }


# --- the campaign file -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _CampaignLayout:
    """The campaign file apart from its recordings: what it states, and how columns become signals."""

    stated: Campaign  # without recordings
    columns: dict[str, tuple[str, ...]]
    gear_matrix: Array | None
    offset: Array
    acceleration: tuple[str, ...]  # columns of the accelerometers


@dataclass(frozen=True)
class _Entry:
    """One [[recording]]."""

    where: TomlTable
    file: Path
    role: Role
    start_s: float | None
    end_s: float | None
    period_s: float | None
    payload: FlangeLoad | None
    date: str | None


def _read_layout(root: TomlTable, path: Path) -> _CampaignLayout:
    root.allow(
        "robot", "sample_rate_hz", "joints", "signals", "motor", "preprocessing", "noise", "torque", "accelerometer", "recording"
    )  # fmt: skip
    rate = root.positive("sample_rate_hz")
    joints = root.texts("joints")
    _refuse_repeats(root, "joints", joints)
    count = len(joints)

    signals = root.section("signals")
    signals.allow(*(item.key for item in SIGNALS))
    columns: dict[str, tuple[str, ...]] = {}
    used: dict[str, str] = {}
    from_current = signals.has("motor_current") and not signals.has("torque")
    for item in SIGNALS:
        needed = item.key in REQUIRED and not (item.key == "torque" and from_current)
        if not (needed or signals.has(item.key)):
            continue
        names = signals.texts(item.key)
        if len(names) != count:
            raise signals.problem(item.key, f"lists {len(names)} columns, joints lists {count}")
        for name, joint in zip(names, joints, strict=True):
            unit = _OTHER_UNIT.search(name)
            if unit and not joint.lower().endswith(unit[1].lower()):  # a joint may be called turn
                raise signals.problem(
                    item.key, f"column {name!r} seems to be in {unit[1]}; SI units (rad, rad/s, N m) are expected"
                )
            if name in used:
                raise signals.problem(item.key, f"column {name!r} is already used by {used[name]}")
            used[name] = item.key
        columns[item.key] = names

    gear_matrix, offset, constants = _read_motor(root, joints, signals.has("motor_current"), from_current)

    preprocessing = root.section_or_empty("preprocessing")
    preprocessing.allow("cutoff_hz")
    cutoff = preprocessing.optional("cutoff_hz", preprocessing.positive)
    if cutoff is not None and cutoff >= 0.5 * rate:
        raise preprocessing.problem(
            "cutoff_hz", f"found {cutoff:g}, below half of sample_rate_hz ({0.5 * rate:g}) is expected"
        )
    noise = None
    if root.has("noise"):
        section = root.section("noise")
        section.allow("torque_rms")
        noise = tuple(section.numbers("torque_rms", count).tolist())
        if min(noise) < 0.0:
            raise section.problem("torque_rms", f"found {min(noise):g}, numbers of 0 or more are expected")
    side = read_torque_side(root, gear_matrix is not None, from_current) if root.has("torque") else None
    sensors, acceleration = read_accelerometers(root)
    for name in acceleration:
        if name in used:
            raise root.problem("accelerometer", f"column {name!r} is already used by {used[name]}")
    robot = root.text("robot")
    stated = Campaign(path, robot, named_beside(path, robot), rate, joints, (), cutoff, noise, constants, side, sensors)
    if gear_matrix is not None:
        gears = tuple(tuple(row) for row in gear_matrix.tolist())
        stated = dataclasses.replace(stated, gear_matrix=gears, offset=tuple(offset.tolist()))
    return _CampaignLayout(stated, columns, gear_matrix, offset, acceleration)


def _read_motor(
    root: TomlTable, joints: Sequence[str], has_current: bool, from_current: bool
) -> tuple[Array | None, Array, tuple[float | None, ...] | None]:
    """Gear matrix, offset and torque constants; the constants None where the torque does not come from currents."""
    count = len(joints)
    motor = root.section_or_empty("motor")
    motor.allow("gear_matrix", "offset", "torque_constant")
    if motor.has("torque_constant") and not has_current:
        raise motor.problem("torque_constant", "there is no [signals] motor_current that it belongs to")
    constants = read_torque_constants(motor, joints)
    gear_matrix, offset = None, np.zeros(count)
    if motor.has("gear_matrix") or motor.has("offset") or (root.has("motor") and not motor.has("torque_constant")):
        gear_matrix = motor.square("gear_matrix", count)
        # rows are scaled first, for ratios of very different size are no trouble
        sizes = np.linalg.norm(gear_matrix, axis=1, keepdims=True)
        if np.any(sizes == 0.0) or np.linalg.cond(gear_matrix / sizes) > 1e10:
            raise motor.problem("gear_matrix", "is singular; joint angles cannot be found from motor angles")
        if motor.has("offset"):
            offset = motor.numbers("offset", count)
    return gear_matrix, offset, constants if from_current else None


def _read_entry(section: TomlTable, campaign: Path, layout: _CampaignLayout) -> _Entry:
    section.allow("file", "role", "start_s", "end_s", "period_s", "payload", "date")
    file = campaign.parent / section.text("file")
    try:
        tables.extension_of(file)
    except ValueError as error:
        raise section.problem("file", str(error)) from error
    text = section.text("role")
    role = next((known for known in ROLES if known == text), None)
    if role is None:
        hint = suggestion(text, ROLES)
        raise section.problem("role", f'found {text!r}{hint}, "identification" or "validation" is expected')
    start, end = (section.optional(key, section.number) for key in ("start_s", "end_s"))
    if start is not None and end is not None and start >= end:
        raise section.problem("end_s", f"found {end:g}, more than start_s = {start:g} is expected")
    period = section.optional("period_s", section.positive)
    problem = _period_problem(period, layout.stated.sample_rate_hz, None)
    if problem:
        raise section.problem("period_s", f"{period!r} {problem}")
    return _Entry(section, file, role, start, end, period, read_flange_load(section), read_date(section))


def _period_problem(period_s: float | None, rate: float, samples: int | None) -> str:
    """What is wrong with a period, in words. `samples` None: the length is not known yet."""
    if period_s is None:
        return ""
    if not (math.isfinite(period_s) and period_s > 0.0):
        return "is no time above 0"
    count = period_s * rate
    if round(count) < 2 or abs(count - round(count)) > 1e-6 * count:
        return f"is {count:.6g} sample periods at {rate:g} Hz, a whole number of 2 or more is expected"
    if samples is not None and round(count) > samples:
        return f"is {round(count)} samples, more than the recording's {samples}"
    return ""


def _refuse_repeats(section: TomlTable, key: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise section.problem(key, f"{name!r} is listed {names.count(name)} times")


# --- one recording ---------------------------------------------------------------------------------------------------


def _cut(table: tables.Table, entry: _Entry, layout: _CampaignLayout) -> Recording:
    """The part of a table that one [[recording]] asks for, checked and brought to the joint side."""
    rate = layout.stated.sample_rate_hz
    time, part = _part(table, entry, rate)
    values: dict[str, Any] = _signals(table, part, layout)
    problem = _period_problem(entry.period_s, rate, part.stop - part.start)
    if problem:
        raise ValueError(f"{table.path}: {entry.where.name} period_s: {entry.period_s!r} {problem}")
    return Recording(
        name=tables.stem_of(table.path),
        role=entry.role,
        time=time[part].copy(),
        sample_rate_hz=rate,
        joints=layout.stated.joints,
        **values,
        payload=entry.payload,
        period_s=entry.period_s,
        source=table.path,
        date=entry.date or day_of(float(time[part.start])),
    )


def _part(table: tables.Table, entry: _Entry, rate: float) -> tuple[Array, slice]:
    """Times of a table (N,), s, and the rows that one [[recording]] asks for."""
    rows = len(table.values)
    if "time" in table.names:
        time = table.columns(["time"])[:, 0]
        _check_finite(table.path, ["time"], time[:, None], 0)
        resolution = printed_resolution(time, table.single_precision[table.names.index("time")])
        check_increasing(table.path, time, rate, resolution)
    else:
        time = np.arange(rows) / rate
        resolution = np.zeros(rows)
    first, last = _select(table.path, time, entry, rate)
    part = slice(first, last)
    if last - first < 2:
        raise ValueError(
            f"{table.path}: {last - first} data row(s) in the part that {entry.where.name} asks for, 2 are needed"
        )
    check_uniform(table.path, time[part], rate, resolution[part], first)
    return time, part


def _signals(table: tables.Table, part: slice, layout: _CampaignLayout) -> dict[str, Array]:
    """Fields of a recording, on the joint side."""
    first = part.start
    values: dict[str, Array] = {}
    for item in SIGNALS:
        names = layout.columns.get(item.key)
        if names is None:
            continue
        measured = table.columns(names)[part]
        _check_finite(table.path, names, measured, first)
        values[item.field] = _to_joint_side(measured, item, layout)
        _check_sizes(table.path, names, values[item.field], item, layout)
    if layout.acceleration:
        values["acceleration"] = table.columns(layout.acceleration)[part]
        _check_finite(table.path, layout.acceleration, values["acceleration"], first)
    if layout.stated.torque_constants is not None:
        values["torque"] = values["motor_current"] * np.array([c or 1.0 for c in layout.stated.torque_constants])
    return values


def day_of(clock: float) -> str | None:
    """Day (UTC) of a clock that counts seconds since 1970; None for one that begins with the log."""
    if not FIRST_CLOCK_S <= clock <= LAST_CLOCK_S:
        return None
    return datetime.datetime.fromtimestamp(clock, datetime.UTC).date().isoformat()


def _to_joint_side(measured: Array, item: Signal, layout: _CampaignLayout) -> Array:
    gear = layout.gear_matrix
    if gear is None or item.always_joint_side or (item.key == "torque" and layout.stated.torque_side in JOINT_SIDES):
        return measured
    if item.kind == "torque":
        return measured @ gear  # rows are samples: (gear.T @ torque).T
    joint_side = np.ascontiguousarray(np.linalg.solve(gear, measured.T).T)
    return joint_side + layout.offset if item.kind == "angle" else joint_side


def _check_finite(file: Path, names: Sequence[str], values: Array, first: int) -> None:
    bad = ~np.isfinite(values)
    if not np.any(bad):
        return
    column = int(np.argmax(np.any(bad, axis=0)))
    row = int(np.argmax(bad[:, column]))
    found = "missing or NaN" if np.isnan(values[row, column]) else f"{values[row, column]:g}"
    count = int(np.count_nonzero(bad[:, column]))
    message = (
        f"{file}: column {names[column]!r}, row {first + row + 1}: {found}"
        f" ({count} such row{'s' if count > 1 else ''} in this column); finite numbers are expected"
    )
    rows = np.flatnonzero(bad.any(axis=1))[:20] + first + 1
    raise DataFaultError(DataFault("glitch", None, (), message, rows=tuple(rows.tolist())))


def _check_sizes(file: Path, names: Sequence[str], values: Array, item: Signal, layout: _CampaignLayout) -> None:
    joints, largest = layout.stated.joints, np.max(np.abs(values), axis=0)
    worst = int(np.argmax(largest))
    found = f"{file}: column {names[worst]!r}: {item.key} of {joints[worst]!r} reaches {largest[worst]:.4g}"
    if item.kind == "angle" and largest[worst] > LARGEST_ANGLE:
        cause = (
            "probably degrees, or motor side without a [motor] gear_matrix (where it slides: mm)"
            if layout.gear_matrix is None or item.always_joint_side
            else "probably degrees, or joint side although [motor] gives a gear_matrix, or a wrong gear_matrix"
        )
        degrees = layout.gear_matrix is None and largest[worst] <= _LARGEST_DEGREES
        # what stays within a turn in rad may well be in rad
        beyond = tuple(n for n, x in zip(joints, largest, strict=True) if x > (math.tau if degrees else LARGEST_ANGLE))
        message = f"{found} rad on the joint side, below {LARGEST_ANGLE:g} is expected: {cause}"
        factor = 180.0 / math.pi if degrees else None
        raise DataFaultError(DataFault("unit", item.key, beyond, message, factor=factor))
    if largest[worst] > tables.LARGEST:
        raise ValueError(f"{found} on the joint side; SI units, below {tables.LARGEST:g}, are expected")


def _select(file: Path, time: Array, entry: _Entry, rate: float) -> tuple[int, int]:
    """First row and one past the last row of start_s <= time < end_s."""
    # A time meant to be on the edge may be off by the rounding of its print.
    slack = 1e-3 / rate
    first, last = float(time[0]), float(time[-1])
    for key, edge in (("start_s", entry.start_s), ("end_s", entry.end_s)):
        # one sample period is allowed beyond either end: logs start at 0 or after one period, an end is exclusive
        if edge is not None and not first - 1.0 / rate - slack <= edge <= last + 1.0 / rate + slack:
            raise ValueError(
                f"{file}: {entry.where.name} {key}: {edge:g} s is outside the file's {first:g} ... {last:g} s"
            )
    begin = 0 if entry.start_s is None else int(np.searchsorted(time, entry.start_s - slack))
    end = len(time) if entry.end_s is None else int(np.searchsorted(time, entry.end_s - slack))
    return begin, end


# --- writing ---------------------------------------------------------------------------------------------------------


def _common_signals(recordings: Sequence[Recording]) -> list[Signal]:
    if not recordings:
        raise ValueError("a campaign needs at least one recording")
    first = recordings[0]
    present = [item for item in SIGNALS if getattr(first, item.field) is not None]
    for other in recordings[1:]:
        if other.joints != first.joints or other.sample_rate_hz != first.sample_rate_hz:
            raise ValueError(f"recordings {first.name!r} and {other.name!r} differ in joints or sample rate")
        if [item for item in SIGNALS if getattr(other, item.field) is not None] != present:
            raise ValueError(f"recordings {first.name!r} and {other.name!r} differ in the signals they have")
    return present


def _file_names(recordings: Sequence[Recording], file_format: str) -> list[str]:
    keys = [(recording.role, recording.name) for recording in recordings]
    names = [recording.name for recording in recordings]
    files = []
    for role, name in keys:
        if not name or name != Path(name).name or "\\" in name or name.lower().endswith(tables.EXTENSIONS):
            raise ValueError(f"recording name {name!r}: a file name without folder or extension is expected")
        if keys.count((role, name)) > 1:
            raise ValueError(f"two {role} recordings are called {name!r}")
        folder = f"{role}/" if names.count(name) > 1 else ""
        files.append(f"{folder}{name}.{file_format}")
    return files


def _acceleration_columns(sensors: int) -> list[str]:
    return [f"acc_{i + 1}_{axis}" for i in range(sensors) for axis in "xyz"]
