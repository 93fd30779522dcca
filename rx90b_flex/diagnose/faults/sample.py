"""A thinned-out look at a campaign, and the ways in which its columns may be read."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from rx90b_flex.compiled.signals import dahl
from rx90b_flex.effects import Effect, Motion
from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording, lowpass, motion
from rx90b_flex.signals.facts import quiet_cutoff_hz, sensible_cutoff_hz
from rx90b_flex.signals.filters import minimum_samples
from rx90b_flex.signals.stated import FlangeLoad

ROWS = 900  # of all recordings together: enough to tell hypotheses apart that change torques by tens of per cent
FOLDS = 4  # each is held out once
BLOCKS = 12  # contiguous segments of which a fold gets every fourth
HIGHEST = 0.4  # of the sample rate: the highest low-pass
POSITION_CUTOFF_RATIO = 2.0  # positions keep an octave more than torques, so that columns are low-passed once
LEFT = 0.01  # of a joint's travel, which it is to move before its rows count: what friction held till then nobody knows
BEGINNING = 0.25  # of a recording at the most: rows of a joint that stands for longer tell of its links, too
WINDINGS = (1e-3, 3e-3, 1e-2)  # of a joint's travel, over which friction winds up before it slides
ARRAYS = ("q", "v", "a", "dry", "wound", "left", "fold")  # of a sample, one row a row
BASICS = ("drive_inertia", "viscous_friction", "coulomb_friction", "torque_offset")  # in the order of their columns


@dataclass(frozen=True)
class OneLog:
    """How the columns of one log are to be read before they are as those of the other logs.

    Angle column k is ``scale[k] * column[order[k]] + offset[k]``, torque column k ``torque_scale[k] * column[torque_order[k]]``, each
    of the log's, torques taken ``shift_s[k]`` later.

    Attributes
    ----------
    order, torque_order : tuple of int
    scale, offset, torque_scale, shift_s : tuple of float
    rate : float
        Its true over its stated sample rate.
    other_load : bool
        Whether its last link is another body than the others'.
    """

    order: tuple[int, ...]
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    torque_order: tuple[int, ...]
    torque_scale: tuple[float, ...]
    shift_s: tuple[float, ...]
    rate: float = 1.0
    other_load: bool = False

    @staticmethod
    def of(joints: int) -> OneLog:
        """As the others."""
        same, one, zero = tuple(range(joints)), (1.0,) * joints, (0.0,) * joints
        return OneLog(same, one, zero, same, one, zero)

    @property
    def motion_key(self) -> tuple[object, ...]:
        """The same for logs of the same motion."""
        return self.order, self.scale, self.offset, self.rate, self.other_load

    @property
    def torque_key(self) -> tuple[object, ...]:
        """The same for logs of the same torques."""
        return self.torque_order, self.torque_scale, self.shift_s


@dataclass(frozen=True, eq=False)
class Reading:
    """How a log's columns are read: which is whose, with which sign and scale, against which tree.

    The angle of joint j is ``scale[j] * column[order[j]] + offset[j]``, its torque ``torque_scale[j] *
    column[torque_order[j]]``. Velocities grow with `rate`, accelerations with its square. The columns are those of each log as
    `logs` has them.

    Attributes
    ----------
    robot : Robot
        Rigid, of the campaign's joints.
    order, torque_order : tuple of int
    scale, offset, torque_scale : tuple of float
    logs : tuple of OneLog
        One a recording.
    rate : float
        True over stated sample rate.
    gravity : tuple of 3 float
        Direction in the base frame.
    torque_mix : tuple of tuple of float, or None
        Torque columns, as those above count them, over those of the log, where motors' columns stand under other motors' names.
    carried : tuple of (int, int, float, bool)
        Joints (a, b), a factor, and whether torques are the motors': what is b's angle above is that of its motor, which also turns
        with a, factor times.
    """

    robot: Robot
    order: tuple[int, ...]
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    torque_order: tuple[int, ...]
    torque_scale: tuple[float, ...]
    logs: tuple[OneLog, ...]
    rate: float = 1.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)
    carried: tuple[tuple[int, int, float, bool], ...] = ()
    torque_mix: tuple[tuple[float, ...], ...] | None = None

    @property
    def to_joints(self) -> Array:
        """Joint angles over what is logged as such, (joints, joints)."""
        return self._to_joints(self.carried)

    @property
    def torques_to_motors(self) -> Array:
        """What is logged as torques over joint torques, (joints, joints)."""
        return self._to_joints([c for c in self.carried if c[-1]]).T

    def _to_joints(self, carried: Collection[tuple[int, int, float, bool]]) -> Array:
        gear = np.eye(len(self.order))
        for a, b, factor, _ in carried:
            gear[b, a] += factor
        return np.asarray(np.linalg.inv(gear))

    @staticmethod
    def of(robot: Robot, joints: int, recordings: int) -> Reading:
        """As the campaign file states it."""
        same, one, zero = tuple(range(joints)), (1.0,) * joints, (0.0,) * joints
        return Reading(robot, same, one, zero, same, one, (OneLog.of(joints),) * recordings)

    @property
    def links(self) -> int:
        """Number of link parameters, whose columns come first."""
        return 10 * len(self.robot.bodies)

    def changed(self, name: str, which: Collection[int], change: Callable[[float], float]) -> Reading:
        """With some entries of `scale`, `offset` or `torque_scale` changed."""
        values = tuple(change(x) if k in which else x for k, x in enumerate(getattr(self, name)))
        return self.with_entries({name: values})

    def changed_in(self, recording: int, entries: Mapping[str, Any]) -> Reading:
        """With some attributes of one log changed."""
        logs = list(self.logs)
        logs[recording] = dataclasses.replace(logs[recording], **entries)
        return self.with_entries({"logs": tuple(logs)})

    def scaled_in(self, recording: int, name: str, joints: Collection[int], factor: float) -> Reading:
        """With some joints' `scale` or `torque_scale` so many times what it is in one log."""
        order = self.order if name == "scale" else self.torque_order
        values = list(getattr(self.logs[recording], name))
        for joint in joints:
            values[order[joint]] *= factor
        return self.changed_in(recording, {name: tuple(values)})

    def later(self, where: Mask, seconds: float) -> Reading:
        """With the torques of some joints taken later in some logs, `where` of shape (recordings, joints)."""
        columns = np.zeros(where.shape)
        columns[:, list(self.torque_order)] = seconds * where
        logs = [
            dataclasses.replace(log, shift_s=tuple((np.array(log.shift_s) + more).tolist()))
            for log, more in zip(self.logs, columns, strict=True)
        ]
        return self.with_entries({"logs": tuple(logs)})

    def with_entries(self, entries: Mapping[str, Any]) -> Reading:
        """With other values of some of the attributes."""
        return dataclasses.replace(self, **entries)

    @property
    def motion_key(self) -> tuple[object, ...]:
        """The same for readings of the same motion of the same tree."""
        return (
            id(self.robot), self.order, self.scale, self.offset, self.rate, self.gravity, self.carried,
            tuple(log.motion_key for log in self.logs),
        )  # fmt: skip

    @property
    def torque_key(self) -> tuple[object, ...]:
        """The same for readings of the same torque columns at the same times."""
        return (self.torque_mix, tuple(log.torque_key for log in self.logs))


@dataclass(frozen=True, eq=False)
class Track:
    """One recording's torques at its own rate, so that they can be read at other times.

    Attributes
    ----------
    torque : array, shape (N, joints)
        After the low-pass.
    rows : array of int, shape (r,)
        Samples that the look keeps.
    rate_hz : float
    name : str
        Of its file.
    load : FlangeLoad or None
        What was stated to be on the flange.
    """

    torque: Array
    rows: Indices
    rate_hz: float
    name: str = ""
    load: FlangeLoad | None = None


@dataclass(frozen=True, eq=False)
class Sample:
    """Rows of all recordings of a campaign, in the order of its columns.

    Attributes
    ----------
    joints : tuple of str
    q, v, a, dry : array, shape (R, joints)
        Angles, velocities, accelerations, and the low-passed sign of velocity; rad, s.
    wound : array, shape (R, joints, len(WINDINGS))
        Low-passed friction that winds up over a part of a joint's travel before it slides, over its torque.
    left : array of bool, shape (R, joints)
        Whether a joint has left the place where its recording began; everywhere in one that it stands in for long.
    tracks : tuple of Track
    fold : array of int, shape (R,)
        Which block a row is held out with.
    cutoff_hz : float
    loaded : bool
        Whether any recording states a load, were it one that is left out here.
    """

    joints: tuple[str, ...]
    q: Array
    v: Array
    a: Array
    dry: Array
    wound: Array
    left: Mask
    tracks: tuple[Track, ...]
    fold: Indices
    cutoff_hz: float
    loaded: bool = False

    @staticmethod
    def of(campaign: Campaign, recordings: Sequence[Recording]) -> Sample:
        """Low-pass, differentiate and thin out recordings.

        Raises
        ------
        ValueError
            A recording that is shorter than the low-pass.
        """
        cutoff = min(campaign.cutoff_hz or sensible_cutoff_hz(recordings), quiet_cutoff_hz(recordings))
        return Sample._made(campaign.joints, recordings, cutoff, [np.zeros(0, dtype=int)] * len(recordings))

    def with_rows(self, recordings: Sequence[Recording], rows: Sequence[Indices]) -> Sample:
        """The sample of the same recordings with some more rows of each, but for those at its ends that the low-pass spoils."""
        made = Sample._made(self.joints, recordings, self.cutoff_hz, rows)
        tracks = (dataclasses.replace(t, load=own.load) for t, own in zip(made.tracks, self.tracks, strict=True))
        return dataclasses.replace(made, tracks=tuple(tracks), loaded=self.loaded)

    @staticmethod
    def _made(
        joints: tuple[str, ...], recordings: Sequence[Recording], cutoff: float, more: Sequence[Indices]
    ) -> Sample:
        total = sum(r.samples for r in recordings)
        every = max(1, total // ROWS)
        parts = [_part(r, cutoff, every, rows) for r, rows in zip(recordings, more, strict=True)]
        q, v, a, dry, wound = (np.concatenate([p[k] for p, _ in parts]) for k in range(5))
        tracks = tuple(track for _, track in parts)
        blocks = [max(2, round(BLOCKS * r.samples / total)) for r in recordings]
        fold = np.concatenate(
            [np.arange(len(t.rows)) * n // max(1, len(t.rows)) for t, n in zip(tracks, blocks, strict=True)]
        )
        starts = np.cumsum([0, *blocks[:-1]]).repeat([len(t.rows) for t in tracks])
        left = _left(q, _spans(tracks))
        return Sample(
            joints, q, v, a, dry, wound, left, tracks, (fold + starts) % FOLDS, cutoff, any(t.load for t in tracks)
        )

    def torque_of(self, reading: Reading) -> tuple[Array, Array]:
        """Torque columns at the times of a reading, (R, joints), and which rows lie inside the logs, (R,) bool."""
        columns, out, inside = np.arange(len(self.joints)), [], []
        for torque, at in self._rows(reading, np.zeros(1)):
            inside.append(((at >= 0) & (at < len(torque))).all(axis=(0, 1)))
            out.append(torque[np.clip(at[:, 0].T, 0, len(torque) - 1), columns])
        return np.concatenate(out), np.concatenate(inside)

    def _rows(self, reading: Reading, lags: Array) -> Iterator[tuple[Array, Indices]]:
        """Torques of each log as the reading has its columns, and the samples at which each is taken, (L,) s later; (columns, L, r),
        beyond its ends too.
        """
        for track, log in zip(self.tracks, reading.logs, strict=True):
            late = np.round((np.array(log.shift_s)[:, None] + lags) * track.rate_hz).astype(int)
            yield _torque(track.torque, log, reading), track.rows + late[..., None]

    def as_read(self, reading: Reading, torques: Sequence[Array]) -> list[Array]:
        """Torque columns of each log (N, joints) as those of each joint, at their own times."""
        order, scale = list(reading.torque_order), np.array(reading.torque_scale)
        return [_torque(x, log, reading)[:, order] * scale for x, log in zip(torques, reading.logs, strict=True)]

    def torque_seen(self, reading: Reading) -> Array:
        """Torque of each joint as a reading has it, shape (R, joints), N m."""
        return self.torque_later(reading, np.zeros(1))[:, 0].T

    def torque_later(self, reading: Reading, lags: Array) -> Array:
        """The same at some times (L,), s, after those that the reading has, shape (joints, L, R), N m."""
        columns, order = np.arange(len(self.joints))[:, None, None], list(reading.torque_order)
        out = [torque[np.clip(at, 0, len(torque) - 1), columns] for torque, at in self._rows(reading, lags)]
        return np.asarray(np.concatenate(out, axis=2)[order] * np.array(reading.torque_scale)[:, None, None])

    def thinned(self, factor: int) -> Sample:
        """Every so many-th row."""
        tracks = tuple(dataclasses.replace(t, rows=t.rows[::factor]) for t in self.tracks)
        rows = np.concatenate([np.arange(span.start, span.stop)[::factor] for span in self.spans])
        arrays = {name: getattr(self, name)[rows] for name in ARRAYS}
        return dataclasses.replace(self, **arrays, tracks=tracks)

    def stating(self, load: FlangeLoad | None, recordings: Collection[int]) -> Sample:
        """With another payload in some recordings."""
        each = enumerate(self.tracks)
        tracks = tuple(dataclasses.replace(t, load=load) if r in recordings else t for r, t in each)
        return dataclasses.replace(self, tracks=tracks, loaded=any(t.load for t in tracks))

    def only(self, recording: int) -> Sample:
        """Rows of one recording alone."""
        span = self.spans[recording]
        arrays = {name: getattr(self, name)[span] for name in ARRAYS}
        return dataclasses.replace(self, **arrays, tracks=self.tracks[recording : recording + 1])

    @property
    def independent_rows(self) -> float:
        """Rows of a low-passed signal are worth about two a period of the cutoff."""
        seconds = sum(len(t.torque) / t.rate_hz for t in self.tracks)
        return min(2.0 * self.cutoff_hz * seconds, float(len(self.fold)))

    @property
    def spans(self) -> tuple[slice, ...]:
        """Rows of each recording."""
        return _spans(self.tracks)

    def seen(self, reading: Reading) -> tuple[Array, Array, Array, Array]:
        """Angle, velocity, acceleration and dry friction's sign of each joint as a reading has them, each (R, joints).

        Of a motor that is carried by another joint, its own: `motion` has the joints'.
        """
        scale, rate = self.scale_of(reading), reading.rate * self.in_logs(reading, "rate")[:, None]
        offset = self.in_logs(reading, "offset")[:, list(reading.order)]
        return (
            self._column(self.q, reading) * scale + offset * reading.scale + np.array(reading.offset),
            self._column(self.v, reading) * scale * rate,
            self._column(self.a, reading) * scale * rate**2,
            self._column(self.dry, reading) * np.sign(scale),
        )

    def wound_seen(self, reading: Reading) -> Array:
        """`wound` of each joint as a reading has it."""
        return self._column(self.wound, reading) * np.sign(self.scale_of(reading))[:, :, None]

    def left_seen(self, reading: Reading) -> Mask:
        """`left` of each joint as a reading has it: the rows that count."""
        return self._column(self.left, reading)

    def scale_of(self, reading: Reading) -> Array:
        """Factor of each angle, (R, joints)."""
        return self.in_logs(reading, "scale")[:, list(reading.order)] * reading.scale

    def _column(self, x: np.ndarray, reading: Reading) -> Any:
        """What the log has for each joint in its angle's place, (R, joints, ...)."""
        columns = self.in_logs(reading, "order").astype(int)[:, list(reading.order)]
        if len(columns) == 1:
            return x[:, columns[0]]
        return np.take_along_axis(x, columns.reshape(*columns.shape, *[1] * (x.ndim - 2)), axis=1)

    def in_logs(self, reading: Reading, name: str) -> Array:
        """An attribute of `OneLog` at each row of the log that it is of, (R, ...), or (1, ...) where all logs have the same."""
        values = [getattr(log, name) for log in reading.logs]
        return np.array(values[:1]) if values.count(values[0]) == len(values) else self.by_rows(values)

    def by_rows(self, of_recordings: Sequence[Any]) -> Array:
        """What holds for each recording, at each of its rows, (R, ...)."""
        return np.repeat(np.array(of_recordings), [len(t.rows) for t in self.tracks], axis=0)

    def motion(self, reading: Reading) -> Motion:
        """The tree's motion in tree order."""
        columns = [self.joints.index(j) for j in reading.robot.joints]
        to_joints = reading.to_joints[columns].T
        return reading.robot.motion(*(x @ to_joints for x in self.seen(reading)[:3]))


def _torque(torque: Array, log: OneLog, reading: Reading) -> Array:
    """Torque columns as a reading counts them, (N, joints)."""
    plain = OneLog.of(len(log.order))
    if (log.torque_order, log.torque_scale) != (plain.torque_order, plain.torque_scale):
        torque = torque[:, list(log.torque_order)] * log.torque_scale
    return torque if reading.torque_mix is None else torque @ np.array(reading.torque_mix).T


def _spans(tracks: Sequence[Track]) -> tuple[slice, ...]:
    ends = np.cumsum([0, *(len(t.rows) for t in tracks)])
    return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))


def _left(q: Array, spans: Sequence[slice]) -> Mask:
    out = np.ones(q.shape, dtype=bool)
    reach = np.ptp(q, axis=0)
    for span in spans:
        left = np.maximum.accumulate(np.abs(q[span] - q[span][0]) > LEFT * reach, axis=0)
        out[span] = left | (left.mean(axis=0) < 1.0 - BEGINNING)
    return out


def _part(recording: Recording, cutoff: float, every: int, more: Indices) -> tuple[tuple[Array, ...], Track]:
    rate = recording.sample_rate_hz
    cutoff = min(cutoff, HIGHEST * rate)
    # never none: differentiated twice, a counter's noise outweighs any motion
    wide = POSITION_CUTOFF_RATIO * cutoff if POSITION_CUTOFF_RATIO * cutoff < HIGHEST * rate else cutoff
    try:
        torque = lowpass(recording.torque, cutoff, rate)  # first: a cutoff that is too low is named as it was given
        q, v, a = motion(recording.position, rate, wide)
        # friction that turns over within a hundredth of the fastest motion: finer is the loop's business
        turn = 1e-2 * np.abs(v).max(axis=0) + 1e-9
        dry = lowpass((2.0 / np.pi) * np.arctan(v / turn), cutoff, rate)
        over = [[dahl(x, part * float(np.ptp(x)) + 1e-9) for part in WINDINGS] for x in q.T]
        wound = lowpass(np.array(over).transpose(2, 0, 1), cutoff, rate)
    except ValueError as error:
        raise ValueError(f"{recording.source or recording.name}: {error}") from None
    edge = min(minimum_samples(cutoff, rate) // 3, recording.samples // 20)
    rows = np.arange(edge, recording.samples - edge, every)
    rows = np.union1d(rows, more[(more >= edge) & (more < recording.samples - edge)])
    return tuple(x[rows] for x in (q, v, a, dry, wound)), Track(
        torque, rows, rate, recording.file_name, recording.payload
    )


def other_effects(robot: Robot) -> tuple[Effect, ...]:
    """Declared effects that stand beside the basics in every fit: those whose columns a motion alone gives."""
    return tuple(
        e
        for e in robot.effects
        if e.type_name() not in BASICS
        and not e.traits.virtual
        and not e.traits.needs
        and not e.traits.needs_model
        and not e.traits.by_clock
        and e.traits.in_dynamics
    )
