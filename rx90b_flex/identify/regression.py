"""From recordings and a robot to the columns of a regression, after one and the same low-pass."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from rx90b_flex.effects import Effect, Motion
from rx90b_flex.effects.effect import of_motion_alone
from rx90b_flex.effects.motion import STICKS, Array, Held, Indices, Mask
from rx90b_flex.identify.columns import beyond_digits
from rx90b_flex.identify.drives_that_stick import drives_that_stick
from rx90b_flex.identify.first_looks import FirstColumns, FirstLooks
from rx90b_flex.identify.many_columns import Unfiltered, at_once, through
from rx90b_flex.identify.segment import Segment, prepare
from rx90b_flex.pieces import AT_ONCE
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Recording

LOOKED_AT = 15_000  # working samples that a first look needs at the most,
LOOKED_AT_PART = 1 / 32  # or this part of a longer log
GLIMPSE = 4_000  # of them with which a search begins on a log that is not long
MOST_KEPT = 200  # effects whose columns are kept from one identification to the next,
FEWEST_KEPT, KEPT_BYTES = 12, 4e7  # of a long log fewer: so many, or what takes so much

Valued = tuple[Effect, Array]  # with coefficients (k,)
Pair = tuple[Valued, Valued]


@dataclass(frozen=True, eq=False)
class Regression:
    """All segments of one role, with the columns of the links.

    The rows of a column are one array a joint of the campaign, then one a torque sensor behind a gear; samples of all segments
    follow each other. What acts before the gear leaves nothing in the rows of a sensor (`Traits.behind_gear`): they tell the
    links without friction, and the difference to the motor's is friction. A sensor's zero is not known: its rows are less their mean.

    Attributes
    ----------
    robot : Robot
        Rigid.
    joints : tuple of str
    segments : tuple of Segment
    row_weights : array, shape (N, joints), or None
        Factors between 0 and 1 of all rows of joints, torque and columns alike; None leaves them as they are.
    sensors : tuple of str
        Joints whose torque sensors are fitted beside the motors.
    sticking : tuple of (str, str)
        Joints whose dry friction is held where their drives stick (`Motion.stuck`), each with ``turn`` or ``pause``.
    """

    robot: Robot
    joints: tuple[str, ...]
    segments: tuple[Segment, ...]
    row_weights: Array | None = None
    sensors: tuple[str, ...] = ()
    sticking: tuple[Held, ...] = ()

    @staticmethod
    def of(
        robot: Robot, recordings: Sequence[Recording], cutoff_hz: float | None, sensors: Sequence[str] = ()
    ) -> Regression:
        """Prepare recordings of one robot for a fit, of motors (and torque sensors of some joints) on a rigid tree."""
        return Regression._of(robot, recordings, cutoff_hz, sensors, None, thin=True)[0]

    @staticmethod
    def and_whole(
        robot: Robot,
        recordings: Sequence[Recording],
        cutoff_hz: float | None,
        sensors: Sequence[str] = (),
        sticking: Sequence[Held] | None = None,
    ) -> tuple[Regression, tuple[Segment, ...]]:
        """As `of`, and the recordings with all their samples, to be predicted: each prepared once.

        With `sticking`, of other recordings' regression, it is not asked of these which joints' drives stick.
        """
        return Regression._of(robot, recordings, cutoff_hz, sensors, sticking, thin=False)

    @staticmethod
    def _of(
        robot: Robot,
        recordings: Sequence[Recording],
        cutoff_hz: float | None,
        sensors: Sequence[str],
        sticking: Sequence[Held] | None,
        thin: bool,
    ) -> tuple[Regression, tuple[Segment, ...]]:
        joints = recordings[0].joints
        every = tuple((j, kind) for j in joints for kind in STICKS)
        rigid, asked = robot.over_time().restricted(joints), every if sticking is None else tuple(sticking)
        whole = tuple(prepare(rigid, r, cutoff_hz, thin, asked) for r in recordings)
        segments = whole if thin else tuple(s.thinned() for s in whole)
        made = Regression(rigid, joints, segments, None, tuple(sensors), asked)
        if sticking is not None:
            return made, whole
        found = drives_that_stick(made)
        whole = tuple(s.sticking(found) for s in whole)
        return made._with_segments(whole if thin else tuple(s.thinned() for s in whole), found), whole

    def with_sticking(self, held: tuple[Held, ...]) -> Regression:
        """The same, with friction held in these sticks alone."""
        return self._with_segments(tuple(s.sticking(held) for s in self.segments), held)

    def with_torques_times(self, factors: Array) -> Regression:
        """The same motion, with the measured torque of each joint times a factor, (joints,)."""
        segments = (dataclasses.replace(s, torque=s.torque * factors) for s in self.segments)
        return self._with_segments(tuple(segments), self.sticking)

    def _with_segments(self, segments: tuple[Segment, ...], held: tuple[Held, ...]) -> Regression:
        """The same motion with friction held in these sticks."""
        return self._with_links_of(dataclasses.replace(self, segments=segments, sticking=held))

    @property
    def motors(self) -> Regression:
        """The same without torque sensors."""
        return dataclasses.replace(self, sensors=()) if self.sensors else self

    def __len__(self) -> int:
        return sum(len(s) for s in self.segments)

    @property
    def longest(self) -> Motion:
        """Motion of the longest recording, from which starts and ranges of shapes are taken."""
        return max((s.motion for s in self.segments), key=len)

    @cached_property
    def torque(self) -> Array:
        """Measured torque less what known payloads take, shape (N, rows), N m."""
        torque = np.concatenate([np.hstack([s.torque, self._sensed(s)]) for s in self.segments])
        counted = self._counted(torque[:, :, None], np.arange(len(self.rows)))[:, :, 0]
        return counted if self.carried_torque is None else counted - self.carried_torque

    @cached_property
    def carried_torque(self) -> Array | None:
        """What known payloads take, shape (N, rows), N m; None where there are none."""
        if all(s.carried is None for s in self.segments):
            return None
        torque = np.zeros((len(self), len(self.rows), 1))
        for span, segment in zip(self.spans, self.segments, strict=True):
            if segment.carried is not None:
                torque[span, :, 0] = self._untouched_links[span] @ segment.carried
        return self._counted(torque, np.arange(len(self.rows)))[:, :, 0]

    def _counted(self, columns: Array, rows: Indices) -> Array:
        """Columns (N, rows, k) with the factors of their rows, those of sensors less their means."""
        factors, first = self._factors, len(self.joints)
        if factors is None or not len(rows):
            return columns
        out = columns * factors[:, rows, None]
        for i in np.flatnonzero(rows >= first):
            there = factors[:, rows[i]] > 0.0
            out[there, i] -= out[there, i].mean(axis=0)
        return out

    def _sensed(self, segment: Segment) -> Array:
        """Of the sensors that are fitted, (N, sensors), N m; zero where a recording has none."""
        if segment.sensed is None:
            return np.zeros((len(segment), len(self.sensors)))
        return segment.sensed[:, [self.joints.index(j) for j in self.sensors]]

    @cached_property
    def _factors(self) -> Array | None:
        """Of all rows, (N, rows): `row_weights`, and nothing of the sensors that a recording does not have."""
        if not self.sensors:
            return self.row_weights
        there = [self._sensed(s).any(axis=0) * np.ones((len(s), 1)) for s in self.segments]
        row_weights = np.ones((len(self), len(self.joints))) if self.row_weights is None else self.row_weights
        return np.hstack([row_weights, np.concatenate(there)])

    @property
    def alike(self) -> Array:
        """Variance that rows have in common over that of the noise, each (N, rows) times the number of those it is common to.

        Where a joint comes to rest or leaves it, the filter rounds its velocity in the same way each time, and noise makes its
        friction smaller in the mean: what such rows are off beside their noise (`row_weights`) is alike, whatever their number.
        """
        out = np.zeros((len(self), len(self.rows)))
        if self.row_weights is not None:
            beside = np.concatenate([s.beside_rests for s in self.segments])[:, self.rows[: len(self.joints)]]
            out[:, : len(self.joints)] = beside * beside.sum(axis=0) * (1.0 - self.row_weights**2)
        return out

    @cached_property
    def share(self) -> Array:
        """Part of each row's samples that is left, shape (rows,)."""
        return np.ones(len(self.rows)) if self._factors is None else np.asarray((self._factors**2).mean(axis=0))

    def weighted(self, row_weights: Array | None) -> Regression:
        """The same regression with other factors of its rows."""
        return self._sharing(dataclasses.replace(self, row_weights=row_weights))

    @cached_property
    def rows(self) -> Indices:
        """Coordinate of each joint of the campaign, and of each that has a torque sensor."""
        return np.array([self.robot.layout.index(j) for j in (*self.joints, *self.sensors)])

    def seen(self, effect: Effect, columns: Array) -> Array:
        """Columns (N, coordinates, k) of an effect in each row; shape (N, rows, k)."""
        out = columns[:, self.rows]
        if not effect.traits.behind_gear:
            out[:, len(self.joints) :] = 0.0
        return out

    def beginning(self, samples: int) -> Regression:
        """The beginnings of all recordings, so many working samples at the most; of a short log all of it."""
        part = samples / sum(len(s.motion) for s in self.segments)
        if part >= 1.0:
            return self
        return dataclasses.replace(self, segments=tuple(s.beginning(part) for s in self.segments), row_weights=None)

    @cached_property
    def excerpt(self) -> tuple[Regression, Indices] | None:
        """Pieces of a long log, which show what is there in less time, and which samples these are; None where it is short."""
        working = sum(len(s.motion) for s in self.segments)
        return self._pieces(max(LOOKED_AT, LOOKED_AT_PART * working) / working, self._first_looks_of_excerpt)

    @cached_property
    def glimpse(self) -> tuple[Regression, Indices] | None:
        """Fewer and shorter ones, which tell shapes and effects apart that show all the time; None where they are no less work."""
        # of a log that is not long some effect asks the tree at all samples anyway
        working = sum(len(s.motion) for s in self.segments)
        seen, samples = self.halved or (self, np.arange(len(self)))
        found = seen._pieces(GLIMPSE / working, self._first_looks_of_glimpse, of_whole=working <= LOOKED_AT)
        return found and (found[0], samples[found[1]])

    @cached_property
    def halved(self) -> tuple[Regression, Indices] | None:
        """Every other sample of a log that is not long, and which samples these are; None where the low-pass bears no fewer."""
        if self.excerpt is not None:
            return None
        parts, samples = [], []
        for segment, span in zip(self.segments, self.spans, strict=True):
            half = segment.halved()
            if half is None:
                return None
            parts.append(half[0])
            samples.append(span.start + half[1])
        return self._of_samples(parts, np.concatenate(samples), self._first_looks_of_excerpt)

    @property
    def _all_first_looks(self) -> tuple[FirstLooks, ...]:
        return self._first_looks, self._first_looks_of_excerpt, self._first_looks_of_glimpse

    def known_first_looks(self) -> list[set[Effect]]:
        """Effects whose columns are kept for first looks, of the whole and of its pieces."""
        return [looks.known for looks in self._all_first_looks]

    def first_looks_since(self, known: Sequence[set[Effect]]) -> list[FirstColumns]:
        """What first looks asked for in this round, with those columns that were not `known`."""
        return [looks.since(before) for looks, before in zip(self._all_first_looks, known, strict=True)]

    def take_first_looks(self, asked: Sequence[FirstColumns]) -> None:
        """What they asked for in another process, which has a copy."""
        for looks, of_these in zip(self._all_first_looks, asked, strict=True):
            looks.take(of_these)

    def round_over(self) -> None:
        """Give back what a round of a search leaves that another one would not ask for."""
        self.forget()
        for looks in self._all_first_looks:
            looks.round_over()

    def forget_long(self) -> None:
        """Give back what effects worked out of a long motion, which holds more than it takes to work it out again."""
        if len(self.longest) > AT_ONCE:
            self.forget()

    def forget(self, first_looks: bool = False) -> None:
        """Give back what effects worked out of the motion; also columns that a search's next round would ask for."""
        for segment in self.segments:
            segment.motion.forget()
            segment.__dict__.pop("sampled", None)
        self.forget_pieces()
        if first_looks:
            for looks in self._all_first_looks:
                looks.clear()
            self._columns_kept.clear()
            if len(self.longest) > AT_ONCE:
                self.__dict__.pop("_untouched_links", None)

    def forget_pieces(self) -> None:
        """The same of the excerpt, the glimpse, and every other sample."""
        for name in ("excerpt", "glimpse", "halved"):
            if self.__dict__.get(name) is not None:
                self.__dict__[name][0].forget()

    def _pieces(
        self, part: float, first_looks: FirstLooks, of_whole: bool = False
    ) -> tuple[Regression, Indices] | None:
        """A part of all recordings in pieces, and which samples these are; None where it is more than half."""
        if part > 0.5:
            return None
        pairs = [
            (p, span.start + at)
            for s, span in zip(self.segments, self.spans, strict=True)
            for p, at in s.pieces(part, of_whole)
        ]
        samples = np.concatenate([at + np.arange(len(p)) for p, at in pairs])
        return self._of_samples([p for p, _ in pairs], samples, first_looks)

    def _of_samples(
        self, segments: Sequence[Segment], samples: Indices, first_looks: FirstLooks
    ) -> tuple[Regression, Indices]:
        """A regression on segments that have some of the samples, and these."""
        row_weights = None if self.row_weights is None else self.row_weights[samples]
        found = dataclasses.replace(self, segments=tuple(segments), row_weights=row_weights)
        found.__dict__["_first_looks"] = first_looks
        return found, samples

    def columns(self, effect: Effect) -> Array:
        """Columns of an effect, shape (N, rows, k)."""
        rows, columns = self.compact([effect])
        out = np.zeros((len(self), len(self.rows), columns.shape[2]))
        out[:, rows] = columns
        return out

    def compact(self, effects: Sequence[Effect], leading: bool = False) -> tuple[Indices, Array]:
        """Columns of effects in one place side by side: the rows where they are not zero, and (N, rows, sum of k).

        With `leading`, only the larger part of those that say which it is.
        """
        rows, columns = self._untouched(effects, leading)
        return rows, self._counted(columns, rows)

    def _untouched(self, effects: Sequence[Effect], leading: bool) -> tuple[Indices, Array]:
        """As `compact`, before `row_weights`."""
        if leading and all(of_motion_alone(e) for e in effects):
            return self._first_looks.columns(effects, lambda new: self._made(new, False))
        if not leading and len(effects) == 1 and of_motion_alone(effects[0]):
            return self._kept(effects[0])
        return self._made(effects, leading)

    def each(self, effects: Sequence[Effect], once: bool = False) -> list[tuple[Indices, Array]]:
        """As `compact` for each effect by itself, in one go: of a short log, calls take longer than their numbers.

        Nothing is kept of effects that are asked for `once`.
        """
        keys = [None if once or not of_motion_alone(e) else _without_coefficients(e) for e in effects]
        known = [None if key is None else self._columns_kept.get(key) for key in keys]
        made = iter(self._made_each([e for e, found in zip(effects, known, strict=True) if found is None]))
        out = []
        for key, found in zip(keys, known, strict=True):
            rows, columns = found or next(made)
            if key is not None:
                self._keep(key, (rows, columns))
            out.append((rows, self._counted(columns, rows)))
        return out

    def _made_each(self, effects: Sequence[Effect]) -> list[tuple[Indices, Array]]:
        """As `_made`, for each by itself."""
        parts = [through(s, (self._unfiltered(s, e) for e in effects)) for s in self.segments]
        return [self._over_segments(of_one) for of_one in zip(*parts, strict=True)]

    def apart(self, pairs: Sequence[Pair]) -> list[tuple[Indices, Array]]:
        """Torque of the first effect of each pair less that of the second one: rows, and (N, rows, 1)."""
        parts = [through(s, (self._less(s, *pair) for pair in pairs)) for s in self.segments]
        made = (self._over_segments(of_one) for of_one in zip(*parts, strict=True))
        return [(rows, self._counted(torque, rows)) for rows, torque in made]

    def _less(self, segment: Segment, more: Valued, less: Valued) -> Unfiltered:
        """As `apart`, of which one column goes through the low-pass in place of both effects' own."""
        (a, up), (b, down) = ((self._unfiltered(segment, e), values) for e, values in (more, less))
        one_place = np.array_equal(a.rows, b.rows)
        if one_place and a.weight is not None and b.weight is not None and np.array_equal(a.weight, b.weight):
            return Unfiltered(a.rows, a.weight, (a.basis @ up - b.basis @ down)[:, None])
        rows = np.union1d(a.rows, b.rows)
        out = np.zeros((len(segment.motion), len(rows), 1))
        for x, values in ((a, up), (b, -down)):
            torque = x.basis @ values
            out[:, np.searchsorted(rows, x.rows), 0] += torque if x.weight is None else np.outer(torque, x.weight)
        return Unfiltered(rows, None, out)

    def _unfiltered(self, segment: Segment, effect: Effect) -> Unfiltered:
        factors = effect.factors(segment.motion)
        if factors is None:
            columns = self.seen(effect, effect.columns(segment.motion))
            touched = np.flatnonzero(columns.any(axis=(0, 2)))
            return Unfiltered(touched, None, columns[:, touched])
        weight = self.seen(effect, factors[0][None, :, None])[0, :, 0]
        touched = np.flatnonzero(weight)
        return Unfiltered(touched, weight[touched], factors[1])

    def _made(self, effects: Sequence[Effect], leading: bool) -> tuple[Indices, Array]:
        return self._over_segments([self._factored(s, effects, leading) for s in self.segments])

    def _over_segments(self, parts: Sequence[tuple[Indices, Array]]) -> tuple[Indices, Array]:
        """Joints (rows,) and columns (N, rows, k) from those of each segment."""
        first = parts[0][0]
        if all(np.array_equal(r, first) for r, _ in parts):
            return first, parts[0][1] if len(parts) == 1 else np.concatenate([x for _, x in parts])
        rows = np.unique(np.concatenate([r for r, _ in parts]))
        out = np.zeros((len(self), len(rows), parts[0][1].shape[2]))
        for span, (here, columns) in zip(self.spans, parts, strict=True):
            out[span][:, np.searchsorted(rows, here)] = columns
        return rows, out

    @cached_property
    def _first_looks(self) -> FirstLooks:
        return FirstLooks()

    @cached_property
    def _first_looks_of_excerpt(self) -> FirstLooks:
        return FirstLooks()

    @cached_property
    def _first_looks_of_glimpse(self) -> FirstLooks:
        return FirstLooks()

    @cached_property
    def _columns_kept(self) -> dict[Effect, tuple[Indices, Array]]:
        return {}

    def _kept(self, effect: Effect) -> tuple[Indices, Array]:
        """As `_untouched`, for an effect whose columns do not depend on the model: a fit asks again with other coefficients."""
        key = _without_coefficients(effect)
        found = self._columns_kept.get(key) or self._made([effect], False)
        self._keep(key, found)
        return found

    def _keep(self, key: Effect, found: tuple[Indices, Array]) -> None:
        known = self._columns_kept
        most = min(MOST_KEPT, max(FEWEST_KEPT, int(KEPT_BYTES / (8 * len(self)))))
        # what was asked for last stands last
        if known.pop(key, None) is None and len(known) >= most:
            del known[next(iter(known))]
        known[key] = found

    def _factored(self, segment: Segment, effects: Sequence[Effect], leading: bool) -> tuple[Indices, Array]:
        many = at_once(segment, len(effects[0].coefficients))
        if many < len(effects) and len(segment.motion) > AT_ONCE:
            some = (effects[i : i + many] for i in range(0, len(effects), many))
            return _beside([self._factored(segment, e, leading) for e in some])
        port, columns = effects[0].side_by_side(effects, segment.motion, leading)
        if port is not None:
            weight = self.seen(effects[0], port[None, :, None])[0, :, 0]
            rows = np.flatnonzero(weight)
            return rows, weight[rows][None, :, None] * segment.brought(columns)[:, None, :]
        columns = self.seen(effects[0], columns)
        rows = np.flatnonzero(columns.any(axis=(0, 2)))
        return rows, segment.brought(columns[:, rows])

    def by_links(self, effects: Sequence[Effect]) -> Array:
        """Change of the effects' torque per change of the links' parameters, shape (N, rows, 10 * bodies)."""
        out = np.zeros((len(self), len(self.rows), len(self.robot.link_parameters)))
        for span, segment in zip(self.spans, self.segments, strict=True):
            for effect in effects:
                change = effect.by_links(segment.motion)
                if change is not None:
                    part = self._brought(segment, change)
                    out[span, : len(self.joints)] += part[:, : len(self.joints)]
                    if effect.traits.behind_gear:
                        out[span, len(self.joints) :] += part[:, len(self.joints) :]
        return self._counted(out * self.links_shown, np.arange(len(self.rows)))

    @property
    def link_columns(self) -> Array:
        """Columns of the links, shape (N, rows, 10 * bodies)."""
        return np.stack([self.links_in(i) for i in range(len(self.rows))], axis=1)

    def links_in(self, row: int) -> Array:
        """The same in one row, (N, 10 * bodies)."""
        own = self._counted(self._untouched_links[:, row : row + 1], np.array([row]))[:, 0]
        if self.links_shown.all():
            return own
        # of a long log one more copy is much
        return np.multiply(own, self.links_shown, out=None if self._factors is None else own)

    def link_torque(self, link_parameters: Array) -> Array:
        """What the links ask for, (N, rows), N m."""
        return self._counted((self._untouched_links @ link_parameters)[:, :, None], np.arange(len(self.rows)))[:, :, 0]

    @cached_property
    def links_shown(self) -> Mask:
        """Which of the links' parameters are to be fitted, (10 * bodies,)."""
        return beyond_digits(np.sqrt(np.einsum("nrp,nrp->p", self._untouched_links, self._untouched_links)))

    @cached_property
    def _untouched_links(self) -> Array:
        out, end = np.empty((len(self), len(self.rows), len(self.robot.link_parameters))), 0
        for piece in (p for s in self.segments for p in s.split()):
            begin, end = end, end + len(piece)
            out[begin:end] = self._brought(piece, piece.motion.on_tree.link_regressor())
        return out

    def with_model(self, link_parameters: Array, effects: Sequence[Effect]) -> Regression:
        """The same regression, in which effects see a model: the tree with these link parameters and these effects."""
        segments = tuple(
            dataclasses.replace(s, motion=self.robot.on_links(s.motion, s.loaded(link_parameters), effects=effects))
            for s in self.segments
        )
        return self._sharing(dataclasses.replace(self, segments=segments))

    def _sharing(self, other: Regression) -> Regression:
        """Another regression on the same motion, with the columns that depend on motion alone."""
        for name in ("_first_looks", "_first_looks_of_excerpt", "_first_looks_of_glimpse", "_columns_kept"):
            other.__dict__[name] = getattr(self, name)
        return self._with_links_of(other)

    def _with_links_of(self, other: Regression) -> Regression:
        other.__dict__.update({n: self.__dict__[n] for n in ("_untouched_links", "links_shown") if n in self.__dict__})
        return other

    def _brought(self, segment: Segment, columns: Array) -> Array:
        out = np.zeros((len(segment), len(self.rows), columns.shape[2]))
        for j, row in enumerate(self.rows):
            # most columns are zero in most rows: only the others are worth a filter
            used = np.flatnonzero(columns[:, row].any(axis=0))
            out[:, j, used] = segment.brought(columns[:, row, used])
        return out

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """Samples of each segment."""
        ends = np.cumsum([0, *(len(s) for s in self.segments)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def blocks(self, at_least: int = 8, correlation_s: float = 0.5) -> tuple[slice, ...]:
        """Contiguous blocks for held-out tests: about `at_least` or more in all, each longer than the correlation."""
        total = sum(len(s) / s.rate_hz for s in self.segments)
        length = max(total / at_least, 2 * correlation_s)
        out: list[slice] = []
        for span, segment in zip(self.spans, self.segments, strict=True):
            samples = span.stop - span.start
            parts = max(1, round(samples / segment.rate_hz / length))
            edges = np.linspace(span.start, span.stop, parts + 1).astype(int)
            out += [slice(int(a), int(b)) for a, b in pairwise(edges)]
        return tuple(out)


def _beside(parts: Sequence[tuple[Indices, Array]]) -> tuple[Indices, Array]:
    """Columns of the same samples side by side: joints (rows,) and (N, rows, sum of k)."""
    rows = np.unique(np.concatenate([r for r, _ in parts]))
    wide = [np.zeros((len(x), len(rows), x.shape[2])) for _, x in parts]
    for out, (here, columns) in zip(wide, parts, strict=True):
        out[:, np.searchsorted(rows, here)] = columns
    return rows, np.concatenate(wide, axis=2)


def _without_coefficients(effect: Effect) -> Effect:
    """The effect without values of its coefficients, on which its columns do not depend."""
    return effect.with_coefficients(np.full(len(effect.coefficients), np.nan))
