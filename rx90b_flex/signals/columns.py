"""Which column of a log is what: by the format itself, by its name, by the unit in that or below it, by what the user states."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.files.keys import suggestion
from rx90b_flex.pieces import Array
from rx90b_flex.signals.column_names import FORCE, NO_UNITS, find_words, is_time, signal_of, time_words, unnumbered
from rx90b_flex.signals.import_options import FIELDS, Axes, Findings, ReadingOptions, Sureness
from rx90b_flex.signals.logs import TIME
from rx90b_flex.signals.readers.reader import Log
from rx90b_flex.signals.recording import REQUIRED, SIGNALS, day_of
from rx90b_flex.signals.times import seconds_and_nanoseconds
from rx90b_flex.signals.units import (
    TIME_UNITS,
    ForeignUnit,
    is_time_unit,
    kinds_of,
    time_unit_in_row,
    unit_in_name,
    unit_in_row,
    words_of,
)

EFFORTS = ("torque", "motor_current")
_JOINT_SIDE = {s.key for s in SIGNALS if s.always_joint_side}
_OF_MOTORS = {"motor", "motors", "motormoment", "drive"}


@dataclass(frozen=True)
class PlacedColumn:
    """A column's role.

    Attributes
    ----------
    name, signal, joint : of the column, as in a campaign file, of the robot.
    sure : how sure that is.
    scale : to SI; None: the name says no unit.
    foreign : the unit that it has and the signal cannot have; None: it has none such.
    extra : words of the name that say nothing known.
    """

    name: str
    signal: str
    joint: str
    sure: Sureness
    scale: float | None
    foreign: ForeignUnit | None = None
    extra: int = 0


@dataclass(frozen=True, eq=False)
class LogTimes:
    """Times of a log's rows.

    Attributes
    ----------
    seconds : (N,) s, from the first row.
    column : that they are in; None: in none.
    clock : s since 1970 in the first row, where the log tells it; else None.
    sure : whether names or the format say so.
    """

    seconds: Array
    column: str | None = None
    clock: float | None = None
    sure: bool = True


class ColumnFinder:
    """Finds the columns of one log; what it works out is added to `found`."""

    def __init__(self, log: Log, axes: Axes, options: ReadingOptions, found: Findings) -> None:
        self.log, self.axes, self.options, self.found = log, axes, options, found
        self._among = options.joints or axes.joints  # what numbers count
        self._beyond: list[str] = []  # columns with the number of a joint that is not there
        self._leave_out_names_that_are_there_twice()

    def _problem(self, what: str) -> ValueError:
        return ValueError(f"{self.log.path}: {what}")

    def signals(self, time_name: str | None) -> tuple[tuple[str, ...], dict[str, list[PlacedColumn]]]:
        """The joints that have position and torque, or current, and signal -> a column of each of them.

        Raises
        ------
        ValueError
            One line that names file and column: none that can be a position or a torque, two for one place, a unit that the signal
            cannot have, a name that is there twice.
        """
        return self._complete(self._places(time_name))

    def time(self) -> LogTimes:
        """When its rows were logged; ValueError where the log does not tell."""
        log, options = self.log, self.options
        if log.time is not None:
            return LogTimes(log.time, clock=log.clocks.get(TIME))
        stamp = seconds_and_nanoseconds(log.names)
        if stamp is not None:
            seconds, rest = (log.column(name) for name in stamp)
            self.found.add(f"time: columns {stamp[0]!r} and {stamp[1]!r}, in s and ns")
            return LogTimes(seconds - seconds[0] + 1e-9 * (rest - rest[0]), stamp[0], float(seconds[0]))
        candidates = [name for name in log.names if is_time(name)]
        exact = [name for name in candidates if name.lower() == TIME]
        if not candidates and options.rate_hz is None:  # the only one that is in seconds, as dates with times are
            in_seconds = [name for name in log.names if is_time_unit(log.units.get(name, ""))]
            candidates = in_seconds if len(in_seconds) == 1 else []
        if candidates:
            name = (exact or candidates)[0]
            time = log.column(name) - log.column(name)[0]
            below = self._time_unit(name)
            stated = [TIME_UNITS[w] for w in time_words(name)[1:] if w in TIME_UNITS] if below is None else [below]
            step = float(np.nanmedian(np.abs(np.diff(time))))
            # the unit in which the rate is one that robots are logged at
            scale = stated[0] if stated else next((s for s in (1.0, 1e-3, 1e-6, 1e-9) if 0.0 < step * s <= 0.2), 1.0)
            unit = next(u for u, s in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)) if s == scale)
            sure = bool(stated) or (scale == 1.0 and step > 1e-5)
            self.found.add(f"time: column {name!r}, in {unit}", "sure" if sure else "likely")
            # dates with times, in this column or in one beside it
            dated = [log.clocks[n] for n in (name, *log.clocks) if day_of(log.clocks.get(n, 0.0)) is not None]
            clock = dated[0] if dated else float(log.column(name)[0]) * scale
            return LogTimes(time * scale, name, clock, sure or bool(dated))
        if options.rate_hz is None:
            for name in log.words:
                if is_time(name):
                    self._refuse_words(name, "time")
            raise self._problem("no time column; expected one named time, or --rate with the sample rate in Hz")
        self.found.add(f"time: {options.rate_hz:g} Hz", "stated")
        return LogTimes(np.arange(len(log.values)) / options.rate_hz)

    def _places(self, time_name: str | None) -> dict[str, list[PlacedColumn]]:
        """Signal -> columns that can hold it."""
        log, stated = self.log, self.options.columns
        taken = {name for names in stated.values() for name in names}
        for name in taken:
            if name not in log.names:
                raise self._problem(f"no column {name!r}{suggestion(name, log.names)}")
        read: dict[str, list[PlacedColumn]] = {}
        numbered = [n for n in log.names if n not in taken and n != time_name]
        # columns that are called alike count from 0 where one of them says so
        zeros = {unnumbered(n) for n in numbered if self._number_in(n) == 0}
        self._among = self._counted(numbered)
        for name in numbered:
            column = self._column(name, unnumbered(name) in zeros)
            if column is not None and column.signal not in stated:
                read.setdefault(column.signal, []).append(column)
        if self._beyond:
            self.found.add(
                f"left out, for joints are counted to {len(self._among)}: {', '.join(self._beyond)}", "likely"
            )
        if "joint_torque" not in stated:
            _tell_joint_torques(read)
        for name in log.words:
            column = self._column(name, unnumbered(name) in zeros)
            if column is not None and column.signal in REQUIRED and column.signal not in stated:
                self._refuse_words(name, f"{column.signal} of {column.joint}")
        self._place_stated(read)
        return read

    def _place_stated(self, read: dict[str, list[PlacedColumn]]) -> None:
        """Add the columns that an option states."""
        stated = self.options.columns
        joints = self.options.joints or self.axes.joints
        first = next(iter(stated), "")
        for signal, names in stated.items():
            most = "" if self.options.joints else "at most "
            if len(names) > len(joints) or (self.options.joints and len(names) < len(joints)):
                raise ValueError(
                    f"--columns {signal} lists {len(names)} columns; expected {most}{len(joints)}, one a joint"
                )
            if len(names) != len(stated[first]):
                raise ValueError(
                    f"--columns {signal} lists {len(names)} columns, {first} {len(stated[first])}; expected one each a joint"
                )
            for name, joint in zip(names, joints, strict=False):
                column = PlacedColumn(name, signal, joint, "stated", *self._unit(name, signal, joint))
                if column.foreign is not None:
                    raise self._refusal(column)
                read.setdefault(signal, []).append(column)

    def _counted(self, names: Sequence[str]) -> tuple[str, ...]:
        """The joints that numbers in names count: those of --joints, or the robot's where the numbers are of these."""
        chosen, joints = self.options.joints, self.axes.joints
        if not chosen or len(chosen) == len(joints):
            return chosen or joints
        angles: list[tuple[int, int]] = []  # words that say nothing known, number
        efforts: list[tuple[int, int]] = []
        for name in names:
            number = None if self.log.roles else self._number_in(name)
            signal, rest = self._signal(name, [w for w in words_of(name) if not w.isdigit()])
            if number is not None and (signal == "motor_position" or signal in EFFORTS):
                (efforts if signal in EFFORTS else angles).append((len(rest), number))
        # a tool's torque 3 is no joint's
        numbers = _least(angles) & _least(efforts)
        first = 0 if 0 in numbers else 1
        if numbers <= set(range(first, first + len(chosen))):
            return chosen
        of_robot = dict(enumerate(joints, first))
        if numbers not in (set(of_robot), {k for k, joint in of_robot.items() if joint in chosen}):
            raise self._problem(
                f"columns are numbered {', '.join(map(str, sorted(numbers)))}, --joints names {len(chosen)} of the robot's "
                f"{len(joints)} joints: which is whose? choose with --columns motor_position=NAME,... and --columns torque=NAME,..."
            )
        shown = ", ".join(f"{k} is {joint}" for k, joint in of_robot.items() if joint in chosen)
        others = [str(k) for k in sorted(numbers) if of_robot[k] not in chosen]
        left = f"; left out, for --joints does not name them: {', '.join(others)}" if others else ""
        self.found.add(f"numbers are those of the robot's {len(joints)} joints: {shown}{left}", "likely")
        return joints

    def _leave_out_names_that_are_there_twice(self) -> None:
        """Refuse a name that is there more than once where it can be used."""
        stated = {name for names in self.options.columns.values() for name in names}
        for name, count in self.log.twice.items():
            column = self._column(name, False)
            used = column is not None and column.signal not in self.options.columns
            if used or name in stated or is_time(name):
                raise self._problem(f"column {name!r} is there {count} times")
            self.found.add(f"column {name!r}: left out, for it is there {count} times")
        self._beyond.clear()

    def _refuse_words(self, name: str, what: str) -> None:
        raise self._problem(f"column {name!r} can be {what}, but holds {self.log.words[name]!r}, which is no number")

    def _column(self, name: str, from_zero: bool) -> PlacedColumn | None:
        """What a column is by the format itself, else by its name; None: nothing known."""
        joints, words, sure = self.axes.joints, words_of(name), True
        if self.log.roles:
            role, joint = self.log.roles[name]
            return PlacedColumn(name, role, joint, "sure", 1.0) if joint in joints else None
        for joint in sorted(joints, key=len, reverse=True):  # shoulder_pan before shoulder
            place = find_words(words_of(joint), words)
            # where columns count from 0, the second one is no joint 1
            if place is not None and not (from_zero and words_of(joint)[-1].isdigit()):
                rest = words[: place[0]] + words[place[1] :]
                break
        else:
            number, among = _last_number(words), self._among
            index = 0 if number is None else number if from_zero else number - 1
            named = self._named.get(number) if number is not None and not self.options.joints else None
            if named is None and (not 0 <= index < len(among) or (number is None and len(among) != 1)):
                if number is not None and signal_of([w for w in words if not w.isdigit()])[0] in REQUIRED:
                    self._beyond.append(name)
                return None
            joint, sure = named or among[index], number is None or named is not None
            rest = [w for w in words if not w.isdigit()]
        if self.axes.prismatic and self.axes.prismatic[joints.index(joint)]:
            rest = ["torque" if w in FORCE else w for w in rest]
        signal, left = self._signal(name, rest)
        if signal is None:
            return None
        return PlacedColumn(
            name, signal, joint, "sure" if sure else "likely", *self._unit(name, signal, joint), extra=len(left)
        )

    def _signal(self, name: str, rest: Sequence[str]) -> tuple[str | None, list[str]]:
        """The signal of a column by the words of its name but the joint's, else by these and the unit below; the words left."""
        signal, left = signal_of(rest)
        return (signal, left) if signal is not None else signal_of([*rest, *words_of(self.log.units.get(name, ""))])

    @cached_property
    def _named(self) -> dict[int, str]:
        """Number -> joint, where columns of words name them, as `field.name0` does."""
        numbers = {
            name: [int(w) for w in words_of(name) if w.isdigit()] for name in self.log.words if "name" in words_of(name)
        }
        return {
            n[-1]: self.log.words[name] for name, n in numbers.items() if n and self.log.words[name] in self.axes.joints
        }

    def _unit(self, name: str, signal: str, joint: str) -> tuple[float | None, ForeignUnit | None]:
        """What brings a column to SI, by its name, else by the row below, None where neither says it; a unit that it cannot have."""
        turns = self.axes.turns(joint)
        motor_side = bool(self.options.gear) and signal not in _JOINT_SIDE
        kinds = kinds_of(signal, turns, motor_side)
        of_joints = {word for j in self.axes.joints for word in words_of(j)}
        try:
            scale = unit_in_name(name, kinds, NO_UNITS | of_joints)
            if scale is None:
                scale = unit_in_row(signal, self.log.units.get(name, ""), kinds)
        except ForeignUnit as foreign:
            # an option overrules what names of angles say
            overruled = self.options.degrees is not None and turns and kinds[0] in ("angle", "angle rate")
            return None, None if overruled else foreign
        return (1.0 if scale is None and signal == "motor_current" else scale), None

    def _refusal(self, column: PlacedColumn) -> ValueError:
        """Why a column cannot be used, and what to do."""
        foreign, between = column.foreign, " " if str(column.foreign).startswith("is in") else ": "
        turns = self.axes.turns(column.joint)
        why = "" if column.signal == "motor_current" else f", for {column.joint} {'turns' if turns else 'slides'}"
        cure = "bring it to one of these, or take the unit away"
        if foreign is not None and foreign.kind == "current":
            cure = "name currents with --columns motor_current=..."
        elif foreign is not None and foreign.kind is None and turns and "torque" not in column.signal:
            cure += ", or state --degrees or --radians"
        return self._problem(f"column {column.name!r}{between}{foreign}{why}; {cure}")

    def _time_unit(self, name: str) -> float | None:
        """Seconds of the unit below the name of times; None where there is none."""
        try:
            return time_unit_in_row(self.log.units.get(name, ""))
        except ForeignUnit as error:
            raise self._problem(f"column {name!r}: {error}; bring it to one of these, or take the unit away") from None

    def _number_in(self, name: str) -> int | None:
        """The number of a joint in a name: its last one, where no joint's own name is in it."""
        words = words_of(name)
        if any(find_words(words_of(joint), words) for joint in self.axes.joints):
            return None
        return _last_number(words)

    def _complete(
        self, places: Mapping[str, list[PlacedColumn]]
    ) -> tuple[tuple[str, ...], dict[str, list[PlacedColumn]]]:
        """The joints that have position and torque, and the signals that all of these have."""
        by_joint = self._one_for_each_place(places)
        from_current = self._from_current(by_joint)
        required = ("motor_position", "motor_current") if from_current else REQUIRED
        for signal in required:
            if not by_joint.get(signal):
                raise self._nothing_found(signal)
        by_joint.pop("torque" if from_current else "motor_current", None)
        wanted = self.options.joints or self.axes.joints
        self._settle_foreign_units(by_joint, required, wanted)
        joints = tuple(j for j in wanted if all(j in by_joint[signal] for signal in required))
        if not joints:
            shown = "; ".join(f"{signal} of {', '.join(c.joint for c in cs)}" for signal, cs in places.items())
            raise self._problem(f"no joint has both position and torque; {shown}")
        signals = {}
        for signal in FIELDS:
            at = by_joint.get(signal, {})
            have = [at[j] for j in joints if j in at]
            if len(have) == len(joints):
                signals[signal] = have
                sure: Sureness = next((s for s in ("likely", "sure") if any(c.sure == s for c in have)), "stated")
                self.found.add(f"{signal}: {', '.join(c.name for c in have)} for {', '.join(joints)}", sure)
            elif have:
                self.found.add(f"{signal}: left out, none for {', '.join(j for j in joints if j not in at)}")
        if from_current:
            self.found.add(
                "no torques, but currents: torque constants are identified; [motor] torque_constant states them"
            )
        self._tell_of_joints_without([j for j in wanted if j not in joints], by_joint, required)
        return joints, signals

    def _tell_of_joints_without(
        self, without: list[str], by_joint: Mapping[str, Mapping[str, PlacedColumn]], required: Sequence[str]
    ) -> None:
        """A word of joints that are held at zero: those with half of their columns, and those with none."""
        for signal in required:
            half = [j for j in without if j not in by_joint[signal] and any(j in by_joint[s] for s in required)]
            without = [j for j in without if j not in half]
            if half:
                why = f"no column can be their {signal}; choose with --columns {signal}=..."
                self.found.add(f"held at zero though there are columns of them: {', '.join(half)}: {why}", "likely")
        if without:
            self.found.add(f"held at zero, for they have no columns: {', '.join(without)}")

    def _one_for_each_place(self, places: Mapping[str, list[PlacedColumn]]) -> dict[str, dict[str, PlacedColumn]]:
        """Signal -> joint -> column: that whose unit the signal can have, and whose name says least else."""
        by_joint: dict[str, dict[str, PlacedColumn]] = {}
        for signal, columns in places.items():
            at = by_joint.setdefault(signal, {})
            for column in sorted(columns, key=lambda c: (c.foreign is not None, c.extra)):
                other = at.setdefault(column.joint, column)
                if other is column:
                    continue
                if column.foreign is not None:
                    self._leave_out(column)
                elif other.extra == column.extra:
                    sensor = any(find_words(("joint", "torque"), words_of(c.name)) for c in (other, column))
                    raise self._problem(
                        f"columns {other.name!r} and {column.name!r} can both be {signal} of {column.joint}; "
                        f"choose with --columns {signal}=..."
                        + ("; torque sensors behind the gears are --columns joint_torque=..." if sensor else "")
                    )
        torques, currents = by_joint.get("torque", {}), by_joint.get("motor_current", {})
        if torques and all(c.foreign is not None for c in torques.values()):
            units = [c.foreign for c in torques.values() if c.foreign is not None]
            if not currents and all(unit.kind == "current" for unit in units):
                by_joint["motor_current"] = {
                    joint: dataclasses.replace(c, signal="motor_current", scale=unit.scale, foreign=None)
                    for (joint, c), unit in zip(torques.items(), units, strict=True)
                }
                self.found.add(f"torques in {units[0].unit} are taken as currents", "likely")
                del by_joint["torque"]
            elif currents and not any(unit.kind == "current" for unit in units):
                for column in by_joint.pop("torque").values():
                    self._leave_out(column)
        return by_joint

    def _settle_foreign_units(
        self, by_joint: dict[str, dict[str, PlacedColumn]], required: Sequence[str], wanted: Sequence[str]
    ) -> None:
        """Refuse a unit that a signal cannot have where that is needed, leave its column out elsewhere."""
        for signal, at in by_joint.items():
            for column in [c for c in at.values() if c.foreign is not None]:
                if signal in required and column.joint in wanted:
                    raise self._refusal(column)
                self._leave_out(at.pop(column.joint))

    def _leave_out(self, column: PlacedColumn) -> None:
        unit = column.foreign.unit if column.foreign is not None else ""
        self.found.add(f"column {column.name!r}: left out, for it is in {unit}")

    def _from_current(self, by_joint: Mapping[str, Mapping[str, PlacedColumn]]) -> bool:
        """Whether torques come from currents: these are all there is, or the ones that were asked for."""
        stated = self.options.columns
        if "torque" in by_joint and "motor_current" in by_joint:
            currents = "motor_current" in stated and "torque" not in stated
            left, used = ("torque", "currents") if currents else ("motor_current", "torques")
            names = ", ".join(c.name for c in by_joint[left].values())
            choice = (
                ""
                if stated.keys() & {"torque", "motor_current"}
                else "; --columns motor_current=... takes the currents"
            )
            self.found.add(f"{left}: left out, for {used} are used: {names}{choice}")
            return currents
        return "motor_current" in by_joint

    def _nothing_found(self, signal: str) -> ValueError:
        log, joints, hint = self.log, self.axes.joints, ""
        wanted = self.options.joints or joints
        shown = ", ".join(repr(n) for n in log.names[:12]) + (" and others" if len(log.names) > 12 else "")
        if signal == "torque":
            hint = "; where a log has currents alone, name them with --columns motor_current=..."
        if log.roles and not any(joint in joints for _, joint in log.roles.values()):
            hint = f"; the robot's joints are {', '.join(joints)}"
        plain = [name for name in log.names if not log.roles and _last_number(words_of(name)) is None]
        lone = next((name for name in plain if self._signal(name, words_of(name))[0] == signal), None)
        if lone is not None and len(wanted) > 1:
            return self._problem(
                f"column {lone!r} can be {signal}, but of which joint of {', '.join(wanted)}? Where each joint has a file of its "
                f"own, put them into one table, with columns such as {lone}_{wanted[0]} and {lone}_{wanted[1]}"
            )
        return self._problem(
            f"no column can be {signal}; it has {shown}{hint}; "
            f"choose with --columns {signal}=NAME,NAME,... (one a joint of {', '.join(wanted)})"
        )


def _tell_joint_torques(read: dict[str, list[PlacedColumn]]) -> None:
    """Take what is called `joint_torque` beside a motor's torque for that of a sensor behind the gear, in place."""
    torques = read.get("torque", [])
    motors = [c for c in torques if _OF_MOTORS & set(words_of(c.name))]
    sensors = [c for c in torques if c not in motors and find_words(("joint", "torque"), words_of(c.name))]
    if sensors and {c.joint for c in sensors} <= {c.joint for c in motors}:
        read["torque"] = [c for c in torques if c not in sensors]
        read["joint_torque"] = [dataclasses.replace(c, signal="joint_torque") for c in sensors]


def _least(numbers: Sequence[tuple[int, int]]) -> set[int]:
    """The numbers of those columns whose names say least else."""
    least = min((extra for extra, _ in numbers), default=0)
    return {number for extra, number in numbers if extra == least}


def _last_number(words: Sequence[str]) -> int | None:
    numbers = [int(w) for w in words if w.isdigit()]
    return numbers[-1] if numbers else None
