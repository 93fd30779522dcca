"""From logs as people have them to a campaign: which column is what, in which unit, at which rate; and how sure that is.

What is worked out comes from names (`q1`, `pos_joint_1`, `joint_1_effort`), from the robot's joints and their limits, and
from the times; an option overrules each of these.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.files.keys import suggestion
from rx90b_flex.pieces import Array
from rx90b_flex.signals.columns import ColumnFinder, LogTimes, PlacedColumn
from rx90b_flex.signals.import_options import FIELDS, Axes, Finding, Findings, ReadingOptions
from rx90b_flex.signals.logs import read_log, stem_of
from rx90b_flex.signals.readers.reader import Log
from rx90b_flex.signals.recording import REQUIRED, Recording, Role, day_of
from rx90b_flex.signals.tables import LARGEST
from rx90b_flex.signals.times import printed_resolution
from rx90b_flex.signals.units import DEGREE

SPLIT = 0.7  # of a single file: the part that is fitted
NEAR_RATE = 0.01  # that a rate may lie beside the median one and be the same
JITTER = 0.01  # of a sample period: times closer to a grid than this are on it
TICKS = 0.7  # of rows with a time of their own, below which a clock is coarse and rows are not written twice
GAP = 10.0  # sample periods without a sample: the log was interrupted
SHORTEST = 10  # samples
SHORT_S = 10.0  # s of identification below which intervals are wide
FEWEST_S = 4.0  # s of identification, of which close-loop holds parts out
FEWEST_SAMPLES = 64  # below which there is no spectrum to tell noise from motion
MIXED = 8.0  # times the motion of another file, in the numbers of both: they are in different units
SLOWEST_HZ, FASTEST_HZ = 0.1, 1e6  # rates that a log may have


@dataclass(frozen=True, eq=False)
class Imported:
    """Recordings of one campaign, and how they came about.

    Attributes
    ----------
    recordings : identification first.
    findings : file name (or "all files") and finding, in order.
    """

    recordings: tuple[Recording, ...]
    findings: tuple[tuple[str, Finding], ...]


def import_logs(files: Sequence[Path], axes: Axes, options: ReadingOptions | None = None) -> Imported:
    """Read logs and make recordings of them.

    Several files: the last is for validation, the others for identification. One file: the first 70 % identify, the rest
    validates. A log whose times are not uniform is interpolated (PCHIP, which adds no overshoot) at its own rate; one that is
    to have another rate is resampled with an anti-alias filter.

    Parameters
    ----------
    files : one or more.
    axes : of the robot.
    options : what the user says.

    Raises
    ------
    ValueError
        One line that names file and column: nothing that can be a position or a torque, two columns for one place, times that run
        backwards, files that do not fit together.
    """
    options = options or ReadingOptions()
    if not files:
        raise ValueError("no files to import")
    _check_options(options, axes)
    _refuse_the_same_file(files)
    imports = _all_in_one_unit(files, axes, options)
    of_all = Findings()
    parts = _alike([i.recording for i in imports], options, of_all)
    if len(parts) == 1:
        recordings = _split(parts[0])
        first, second = (f"{r.duration_s:.4g} s" for r in recordings)
        of_all.add(f"one file: its first {first} identify, the last {second} validate")
    else:
        recordings = tuple(
            dataclasses.replace(r, role="identification" if k < len(parts) - 1 else "validation", name=name)
            for k, (r, name) in enumerate(zip(parts, _unique([r.name for r in parts]), strict=True))
        )
        of_all.add(f"the last file, {recordings[-1].name}, validates")
    _warn_of_short(recordings, of_all)
    by_file = [(file.name, finding) for file, i in zip(files, imports, strict=True) for finding in i.found]
    return Imported(recordings, (*by_file, *(("all files", finding) for finding in of_all)))


def _warn_of_short(recordings: Sequence[Recording], found: Findings) -> None:
    """A word where recordings are so short that what is found in them is uncertain, or that a search cannot be made."""
    fitted = sum(r.duration_s for r in recordings if r.role == "identification")
    fewest = min(r.samples for r in recordings)
    if fitted < SHORT_S:
        found.add(
            f"only {fitted:.3g} s are for identification, so parameters will be uncertain: record more than {SHORT_S:g} s for it"
            + (f"; close-loop needs {FEWEST_S:g} s at least" if fitted < FEWEST_S else "")
        )
    if fewest < FEWEST_SAMPLES:
        found.add(f"a part of {fewest} samples: state a cutoff_hz, for noise cannot be told from motion in it")


def _refuse_the_same_file(files: Sequence[Path]) -> None:
    for k, file in enumerate(files):
        if any(file.resolve() == other.resolve() for other in files[:k]):
            raise ValueError(f"{file}: given twice; a recording that is fitted cannot validate, too")


def _all_in_one_unit(files: Sequence[Path], axes: Axes, options: ReadingOptions) -> list[_Import]:
    """Every file; a unit that is worked out is the same for all of them."""
    imports = [_Import(read_log(file, options.topic), axes, options) for file in files]
    scales = [i.scale for i in imports]
    if len(set(scales)) > 1:
        stated = [all(f.sure != "likely" for f in i.found if f.what.startswith("angles:")) for i in imports]
        other = next(k for k, scale in enumerate(scales) if scale != scales[0])
        names = {1.0: "rad", DEGREE: "degrees"}
        widest = [float(np.median(np.ptp(i.recording.position, axis=0) / i.scale)) for i in imports]
        if any(stated) or max(widest) > MIXED * min(widest):
            one, two = (names.get(scales[k], f"{scales[k]:g} rad") for k in (other, 0))
            raise ValueError(
                f"{files[other]}: angles in {one}; those of {files[0]} are in {two}: bring them to one unit, or state it with "
                "--degrees or --radians"
            )
        # motions of one size: what could be either is what the wider one must be
        options = dataclasses.replace(options, degrees=True)
        imports = [_Import(i.log, axes, options) for i in imports]
    return imports


def _check_options(options: ReadingOptions, axes: Axes) -> None:
    used: dict[str, str] = {}
    for signal, names in options.columns.items():
        for name in names:
            if name in used:
                raise ValueError(f"--columns {signal}: column {name!r} is already used by {used[name]}")
            used[name] = signal
    for signal in options.columns:
        if signal not in FIELDS:
            raise ValueError(
                f"--columns {signal}: unknown signal{suggestion(signal, list(FIELDS))}; known: {', '.join(FIELDS)}"
            )
    for joint in options.joints:
        if joint not in axes.joints:
            raise ValueError(
                f"--joints {joint}: no such joint{suggestion(joint, axes.joints)}; it has {', '.join(axes.joints)}"
            )
    if options.rate_hz is not None and not (np.isfinite(options.rate_hz) and options.rate_hz > 0.0):
        raise ValueError(f"--rate {options.rate_hz}: a number above 0 is expected")
    if options.offset and not options.gear:
        raise ValueError("--offset is of motor angles; expected --gear with it")


# ---- one file -------------------------------------------------------------------------------------------------


class _Import:
    """A log on its way to a recording.

    Attributes
    ----------
    recording : with the role identification.
    found : what was worked out.
    scale : what the first joint's angles were multiplied with.
    """

    def __init__(self, log: Log, axes: Axes, options: ReadingOptions) -> None:
        self.log, self.axes, self.options = log, axes, options
        self.found = Findings(Finding(note, "sure") for note in log.notes)
        self.found += [Finding(note, "likely") for note in log.assumed]
        finder = ColumnFinder(log, axes, options, self.found)
        times = finder.time()
        time = times.seconds
        joints, signals = finder.signals(times.column)
        names = [c.name for columns in signals.values() for c in columns]
        rows, used = self._usable(names, time)
        begin = used[0] - time[0]  # what drifts with time counts it from where the log began
        values = {
            signal: np.stack([log.column(c.name)[rows] for c in columns], axis=1) for signal, columns in signals.items()
        }
        self.scale = self._to_si(joints, signals, values)
        if "torque" not in values:
            values["torque"] = values["motor_current"]
        if options.gear:
            self._to_joint_side(joints, values)
        rate, grid = self._uniform(used - used[0], values)
        fields: dict[str, Any] = {FIELDS[signal]: array for signal, array in values.items()}
        self.recording = Recording(
            name=stem_of(log.path), role="identification", time=begin + grid, sample_rate_hz=rate, joints=joints, source=log.path,
            date=self._day(times, begin), **fields,
        )  # fmt: skip

    def _problem(self, what: str) -> ValueError:
        return ValueError(f"{self.log.path}: {what}")

    def _day(self, times: LogTimes, begin: float) -> str | None:
        """The day on which the rows begin that are used, `begin` s after the first; None where the log tells none."""
        day = None if times.clock is None else day_of(times.clock + begin)
        if day is not None:
            self.found.add(f"recorded on {day}", "sure" if times.sure else "likely")
        return day

    # units

    def _to_si(
        self, joints: tuple[str, ...], signals: Mapping[str, list[PlacedColumn]], values: dict[str, Array]
    ) -> float:
        """Bring values to SI, in place; what the first joint's angles were multiplied with."""
        degrees = self.options.degrees
        position = signals["motor_position"]
        unsaid = all(c.scale is None for c in position if self.axes.turns(c.joint))
        if degrees is None and unsaid and not self.options.gear:
            degrees = self._looks_like_degrees(joints, position, values["motor_position"])
            unit = "degrees, for in rad they would leave the robot's limits" if degrees else "rad"
            self.found.add(f"angles: in {unit}", "likely")
        elif degrees is not None:
            self.found.add(f"angles: in {'degrees' if degrees else 'rad'}", "stated")
        first = 1.0
        for signal, columns in signals.items():
            turns = "torque" not in signal and signal != "motor_current"
            in_degrees = bool(degrees) and turns
            assumed = [DEGREE if in_degrees and self.axes.turns(c.joint) else 1.0 for c in columns]
            # an option overrules what names of angles say
            overrules = self.options.degrees is not None and turns
            named = [c.scale is not None and not (overrules and self.axes.turns(c.joint)) for c in columns]
            scales = np.array([c.scale if said else a for a, c, said in zip(assumed, columns, named, strict=True)])
            values[signal] = values[signal] * scales
            told = [c.name for c, said in zip(columns, named, strict=True) if said and c.scale != 1.0]
            if told:
                self.found.add(f"{signal}: brought to SI from the unit of {', '.join(told)}")
            if signal == "motor_position":
                first = float(scales[0])
        return first

    def _looks_like_degrees(self, joints: tuple[str, ...], columns: Sequence[PlacedColumn], position: Array) -> bool:
        """Whether angles fit the robot's limits in degrees but not in rad; refused where they fit in neither."""
        at = [self.axes.joints.index(j) for j in joints]
        lower, upper = np.array(self.axes.lower)[at], np.array(self.axes.upper)[at]
        turns = np.array([self.axes.turns(j) for j in joints])
        slack = 0.1  # rad: offsets, and overshoot over the limits

        def outside(scale: float) -> NDArray[np.bool_]:
            q = scale * position
            return np.asarray(turns & ((q.min(axis=0) < lower - slack) | (q.max(axis=0) > upper + slack)))

        if not outside(1.0).any():
            return False
        in_degrees = outside(DEGREE)
        if not in_degrees.any():
            return True
        worst = int(np.argmax(in_degrees))
        low, high = position[:, worst].min(), position[:, worst].max()
        raise self._problem(
            f"column {columns[worst].name!r} runs from {low:.4g} to {high:.4g}, outside the limits of {joints[worst]} "
            f"in rad ({lower[worst]:.4g} to {upper[worst]:.4g}) and in degrees; motor side (--gear)? another joint (--columns)?"
        )

    def _to_joint_side(self, joints: tuple[str, ...], values: dict[str, Array]) -> None:
        """Bring motor-side values to the joint side, in place, as a campaign's [motor] table does."""
        count, rows, offset = len(joints), self.options.gear, self.options.offset
        if [len(row) for row in rows] not in ([count], [count] * count):
            raise ValueError(f"--gear: expected {count} numbers, or {count} rows of them, for {', '.join(joints)}")
        gear = np.diag(rows[0]) if len(rows) == 1 else np.array(rows)
        if not np.isfinite(gear).all() or np.linalg.matrix_rank(gear) < count:
            raise ValueError("--gear: singular; joint angles cannot be found from motor angles")
        if offset and len(offset) != count:
            raise ValueError(f"--offset lists {len(offset)} numbers; expected one for each of {', '.join(joints)}")
        for signal, array in values.items():
            if signal in ("link_position", "joint_torque"):
                continue
            if signal == "motor_current":
                # torque constants are the joints': a motor that turns the other way pulls the other way
                values[signal] = array * np.where(np.diag(gear) < 0.0, -1.0, 1.0)
                if np.count_nonzero(gear) > count:
                    self.found.add("currents of coupled motors are taken as those of their own joints alone", "likely")
            elif "torque" in signal:
                values[signal] = array @ gear
            else:
                at_zero = np.array(offset or 0.0) if "position" in signal else 0.0
                values[signal] = np.linalg.solve(gear, array.T).T + at_zero
        self.found.add("motor side, brought to the joint side by --gear", "stated")

    # rows and times

    def _usable(self, names: Sequence[str], time: Array) -> tuple[NDArray[np.intp], Array]:
        """Rows to keep: rising times, the longest part between interruptions, no empty cells."""
        self._check_finite(names, time)
        empty = np.isnan(np.column_stack([self.log.column(name) for name in names]))
        self._check_number(int(np.count_nonzero(~empty.all(axis=1))), "with numbers")
        whole = np.flatnonzero(~empty.any(axis=1))
        if len(whole) == 0:
            column = int(np.argmax(empty.sum(axis=0)))
            raise self._problem(f"column {names[column]!r}: no row has numbers in this and in all other columns")
        rows = np.arange(whole[0], whole[-1] + 1)
        if empty[rows].any():
            column = int(np.argmax(empty[rows].any(axis=0)))
            row = int(rows[np.argmax(empty[rows, column])])
            raise self._problem(f"column {names[column]!r}, row {row + 1}: empty or NaN")
        if len(rows) < len(empty):
            self.found.add(f"{_many(len(empty) - len(rows), 'row')} with empty cells at the ends left out")
        time = time[rows]
        back = np.flatnonzero(np.diff(time) < 0.0)
        if len(back):
            row = int(back[0]) + 1
            raise self._problem(
                f"row {rows[row] + 1}: time runs backwards, from {time[row - 1]:.9g} s to {time[row]:.9g} s after the start; "
                "cut the file there into two logs, and import both"
            )
        fresh = np.r_[True, np.diff(time) > 0.0]
        if fresh.mean() < TICKS and (even := _between_ticks(time)) is not None:
            tick = float(np.median(np.diff(time[fresh])))
            self.found.add(
                f"times in ticks of {1e3 * tick:.3g} ms, of several rows each: rows taken as evenly spaced", "likely"
            )
            time, fresh = even, np.ones(len(time), dtype=bool)
        if not fresh.all():
            self.found.add(f"{_many(int(np.count_nonzero(~fresh)), 'row')} with the time of the row before left out")
            rows, time = rows[fresh], time[fresh]
        self._check_number(len(rows), "at different times")
        steps = np.diff(time)
        ends = np.r_[0, np.flatnonzero(steps > GAP * np.median(steps)) + 1, len(time)]
        if len(ends) > 2:
            longest = int(np.argmax(np.diff(ends)))
            part = slice(ends[longest], ends[longest + 1])
            rows, time = rows[part], time[part]
            self.found.add(
                f"{_many(len(ends) - 2, 'interruption')}: only the longest part is used, {time[0]:.4g} to {time[-1]:.4g} s"
            )
            self._check_number(len(rows), "between interruptions")
        return rows, time

    def _check_number(self, rows: int, which: str) -> None:
        if rows < SHORTEST:
            raise self._problem(f"{rows} rows {which}; expected {SHORTEST} or more")

    def _check_finite(self, names: Sequence[str], time: Array) -> None:
        if not np.isfinite(time).all():
            raise self._problem(f"row {int(np.argmin(np.isfinite(time))) + 1}: no time")
        for name in names:
            values = self.log.column(name)
            bad = np.abs(values) > LARGEST
            if bad.any():
                row = int(np.argmax(bad))
                said = "infinite" if np.isinf(values[row]) else f"{values[row]:g}; expected below {LARGEST:g}"
                raise self._problem(f"column {name!r}, row {row + 1}: {said}")

    def _uniform(self, time: Array, values: dict[str, Array]) -> tuple[float, Array]:
        """Rate and times of a uniform grid, on which values are put, in place."""
        printed = float(np.max(printed_resolution(time, False)))  # s: times may be off the grid by as much
        mean = (len(time) - 1) / time[-1]
        if not SLOWEST_HZ <= mean <= FASTEST_HZ:
            raise self._problem(
                f"times: {mean:.3g} samples a second; expected {SLOWEST_HZ:g} to {FASTEST_HZ:g}; are they in another unit?"
            )
        # the shortest number that the times allow
        for rate in (_round_rate(mean, printed / time[-1]), *(float(f"{mean:.{d}g}") for d in (4, 5, 6, 7))):
            grid = np.arange(len(time)) / rate
            if np.abs(time - grid).max() <= JITTER / rate + min(printed, 1.0 / rate):
                self.found.add(f"{rate:.7g} Hz, {len(time)} samples")
                return rate, grid
        from scipy.interpolate import PchipInterpolator  # here, for most logs do without

        lost = _lost_rows(np.diff(time), printed)
        mean *= 1.0 + lost / (len(time) - 1)
        of, rate = self._rate_of_jitter(mean, 1.0 / float(np.median(np.diff(time))))
        grid = np.arange(int(np.floor(time[-1] * rate + 1e-9)) + 1) / rate
        for signal, array in values.items():
            values[signal] = PchipInterpolator(time, array, axis=0)(np.minimum(grid, time[-1]))
        spread = np.ptp(np.diff(time))
        self.found.add(
            (f"{_many(lost, 'row')} {'is' if lost == 1 else 'are'} missing; " if lost else "")
            + f"steps differ by up to {1e3 * spread:.3g} ms: interpolated (PCHIP) at the {of} rate, {rate:g} Hz, {len(grid)} samples",
            "likely",
        )
        return rate, grid

    def _rate_of_jitter(self, mean: float, median: float) -> tuple[str, float]:
        """Rate of a grid for times that come early and late, and which it is: the stated one, the mean where that is a round number,
        else the median, which lost rows leave as it is.
        """
        stated, near = self.options.rate_hz, NEAR_RATE * median
        if stated is not None and abs(stated - median) < near:
            return "stated", stated
        if abs(mean - median) < near and _round_rate(mean) == float(f"{mean:.3g}"):
            return "mean", _round_rate(mean)
        return "median", _round_rate(median)


def _many(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _between_ticks(time: Array) -> Array | None:
    """Evenly spaced times (N,), s, of rows whose clock ticks less often than they come; None where they do not keep step with it."""
    rows = np.arange(len(time))
    slope, begin = np.polyfit(rows, time, 1)
    even = time[0] + slope * rows
    tick = float(np.diff(np.unique(time)).max(initial=0.0))
    return even if slope > 0.0 and np.abs(begin + slope * rows - time).max() <= tick else None


def _lost_rows(steps: Array, printed: float) -> int:
    """How many rows are missing between times of these steps (N,), s, known to `printed`: a late row comes before an early one."""
    typical = float(np.median(steps))
    off = np.abs(steps - typical) > 0.5 * typical + min(printed, 0.25 * typical)
    return max(0, int(np.sum(np.round(steps[off] / typical) - 1.0)))


def _round_rate(rate: float, slack: float = 0.0) -> float:
    """The nearest number of three digits where that is within 0.05 %, as clocks drift, and what print allows (relative)."""
    nice = float(f"{rate:.3g}")
    return nice if abs(nice / rate - 1.0) < 5e-4 + slack else rate


# ---- all files together ---------------------------------------------------------------------------------------


def _alike(parts: list[Recording], options: ReadingOptions, found: Findings) -> list[Recording]:
    """The same rate, joints and signals in every recording."""
    rate = options.rate_hz or parts[0].sample_rate_hz
    for k, part in enumerate(parts):
        if part.joints != parts[0].joints:
            raise ValueError(
                f"{part.source}: joints {', '.join(part.joints)}; expected {', '.join(parts[0].joints)}, as in {parts[0].source}"
            )
        if part.sample_rate_hz != rate:
            if options.rate_hz is None:
                raise ValueError(
                    f"{part.source}: {part.sample_rate_hz:g} Hz; expected {rate:g}, as in {parts[0].source}, or --rate for all"
                )
            parts[k] = _at_rate(part, rate)
            found.add(f"{part.name}: resampled from {part.sample_rate_hz:g} to {rate:g} Hz, filtered", "stated")
    for field in [f for s, f in FIELDS.items() if s not in REQUIRED]:
        have = [getattr(part, field) is not None for part in parts]
        if any(have) and not all(have):
            found.add(f"{field}: left out, not in every file")
            parts = [dataclasses.replace(part, **{field: None}) for part in parts]  # type: ignore[arg-type]
    return parts


def _arrays(part: Recording) -> dict[str, Array]:
    """The fields that a recording has of those that can be told by names."""
    found = {field: getattr(part, field) for field in FIELDS.values()}
    return {field: array for field, array in found.items() if array is not None}


def _at_rate(part: Recording, rate: float) -> Recording:
    from rx90b_flex.signals.filters import resample  # here, for most logs do without

    try:
        changed = {field: resample(array, part.sample_rate_hz, rate) for field, array in _arrays(part).items()}
    except ValueError as error:
        raise ValueError(f"{part.source}: --rate {rate:g}: {error}") from None
    time = part.time[0] + np.arange(len(changed["position"])) / rate
    return dataclasses.replace(part, time=time, sample_rate_hz=rate, **changed)  # type: ignore[arg-type]


def _split(whole: Recording) -> tuple[Recording, ...]:
    at = round(SPLIT * whole.samples)
    if min(at, whole.samples - at) < SHORTEST:
        raise ValueError(
            f"{whole.source}: {whole.samples} samples; too few to fit on one part and to validate on another"
        )
    parts: tuple[tuple[str, Role, slice], ...] = (
        ("fit", "identification", slice(None, at)),
        ("check", "validation", slice(at, None)),
    )
    out = []
    for name, role, rows in parts:
        arrays: dict[str, Any] = {field: array[rows] for field, array in _arrays(whole).items()}
        out.append(dataclasses.replace(whole, name=f"{whole.name}_{name}", role=role, time=whole.time[rows], **arrays))
    return tuple(out)


def _unique(names: Sequence[str]) -> list[str]:
    return [f"{n}_{names[: k + 1].count(n)}" if names.count(n) > 1 else n for k, n in enumerate(names)]
