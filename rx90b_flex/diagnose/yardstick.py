"""How much of a declared model's residual follows from the motion at all: a free-form model on held-out recordings.

What a model leaves is noise, or something that it lacks. Where no recording repeats nothing tells noise apart; but what a free
form, fitted to the identification recordings, predicts on the validation recordings is no noise. It is the measure for what
effects with a name explain.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import interpolate

from rx90b_flex.compiled.signals import dahl
from rx90b_flex.diagnose.free_form import NO_FORM, Families, FreeForm, best_form
from rx90b_flex.diagnose.residual import Errors
from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import Segment
from rx90b_flex.signals import lowpass

FEWEST_SAMPLES = 200  # of a fit: with less, parts of it are too short to hold out
LONGEST = 100_000  # samples of a role at the rate at which columns are worked out
# of all samples, up to which a recording is held out whole, for parts of one are too alike to tell what carries over; a longer
# one would leave too little to fit
LARGEST_PART = 0.75
PARTS = (3, 4, 5)  # of equal length instead, in as many ways; few, so that they are long
LEAST_DROP = 0.05  # of the declared model's error: coloured noise leaves values open by that much, and a free form fits them better
# of the largest speed at which dry friction sets in: from what a log hardly resolves to a curve over all speeds
SPEEDS = np.array([0.001, 0.01, 0.03, 0.1, 0.3, 1.0])
TRAVELS = np.array([1e-5, 3e-5, 1e-4, 1e-3, 1e-2])  # of the range of angles, within which friction turns over
LAST_MOVE = 1e-3  # of the range of angles: what is less is no move
MUCH_LESS = 0.5  # of a final model's error
AT_NOISE = 1.1  # error over noise floor up to which nothing is left
KNOTS = 7  # of a curve over the range of an angle


@dataclass(frozen=True)
class Explainable:
    """What a free-form model of the declared model's residual reaches on the validation recordings.

    Attributes
    ----------
    validation : Errors
        With the free form added to the declared model.
    share : float
        Part of the drop from the declared model's relative error to that one which the final model reaches; above 1 where it
        predicts better, below 0 where it is worse than the declared one. Where there is no drop to speak of: 1, or 0 if the
        final model is worse.
    forms : tuple of str
        The free form of each joint: ``none``, ``smooth curves`` or ``boosted trees``; ``none`` for all where together they
        predict worse than the declared model, whose error is then the one given.
    """

    validation: Errors
    share: float
    forms: tuple[str, ...]

    def of(self, before: Errors, after: Errors) -> Explainable:
        """The same measure for another final model, with its share of the drop."""
        return dataclasses.replace(self, share=_share(before, after, self.validation))

    @property
    def told(self) -> Explainable:
        """But for rows up to joints' first moves; its share is that of no model yet (`of`)."""
        return dataclasses.replace(self, validation=self.validation.told)

    def less_of(self, joints: Sequence[str], after: Errors, part: float = MUCH_LESS) -> list[str]:
        """Joints of which the free forms leave less than this part of what the final model does; by default much less."""
        pairs = zip(joints, self.validation.told.torque_rms, after.told.torque_rms, strict=True)
        return [joint for joint, free, left in pairs if free < part * left]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """One validation recording: measured torque and what the declared model says, each (N, joints), N m, after the low-pass; and
    rows up to a joint's first move.
    """

    torque: Array
    declared: Array
    waiting: Mask

    def beginning(self, samples: int) -> HeldOut:
        """Its first samples."""
        return HeldOut(self.torque[:samples], self.declared[:samples], self.waiting[:samples])


def _errors(held_out: Sequence[HeldOut], said: Sequence[Array | float]) -> Errors:
    """Of the declared model with something added to it."""
    predicted = [r.declared + s for r, s in zip(held_out, said, strict=True)]
    return Errors.of([r.torque for r in held_out], predicted, [r.waiting for r in held_out])


def yardstick(
    declared: Identification,
    validation: Regression,
    held_out: Sequence[HeldOut],
    after: Errors,
    floor: Array | None = None,
) -> Explainable | str:
    """Fit free forms to what the declared model leaves, and apply them to recordings that were not fitted.

    One form a joint: smooth curves of its velocity, hysteresis, load and angle, of the other joints' motion and of link
    parameters of its own; or boosted trees of the same signals. Which one, and how smooth, is told by the identification
    recordings alone, each held out in turn (one recording: its parts). Where they show no gain the form is zero. Of long
    recordings the beginnings are enough.

    Parameters
    ----------
    declared : Identification
    validation : Regression
        The validation recordings, as for a fit.
    held_out : sequence of HeldOut
        The same recordings at their own rate.
    after : Errors
        Of the final model on the validation recordings.
    floor : array, shape (joints,), optional
        Noise of the torque, N m: a joint that the final model leaves with no more has nothing left that trees, which take longest,
        could show, and is judged by smooth curves alone.

    Returns
    -------
    Explainable, or a sentence that says why nothing is known.
    """
    fitted = declared.regression.motors.weighted(None).beginning(LONGEST)
    if len(fitted) < FEWEST_SAMPLES:
        return (
            f"Too little data for a free-form model: {len(fitted)} samples behind the low-pass; "
            f"{FEWEST_SAMPLES} or more are needed."
        )
    whole = _errors(held_out, [0.0] * len(held_out))
    validation = validation.beginning(LONGEST)
    held_out = [
        r.beginning(len(s.motion) * s.working_factor) for r, s in zip(held_out, validation.segments, strict=True)
    ]
    residual = declared.residual_on(fitted)
    here, there = (_signals(r, declared) for r in (fitted, validation))
    ranges = _Ranges.of(here)
    parts = _layouts(fitted)
    noise = np.zeros(len(fitted.joints)) if floor is None else floor
    more_left = np.array(after.told.torque_rms) > AT_NOISE * noise
    forms = [_form(here, there, ranges, residual[:, j], j, parts, more_left[j]) for j in range(len(fitted.joints))]
    said = _at_own_rate(np.stack([f.elsewhere for f in forms], axis=1), validation, held_out)
    errors, before = _errors(held_out, said), _errors(held_out, [0.0] * len(held_out))
    names = tuple(f.name for f in forms)
    errors, before = _of_the_whole(errors, before, whole), whole
    if errors.told.relative_error > before.told.relative_error:
        # what does not carry over explains nothing: the declared model alone predicts better
        errors, names = before, (NO_FORM,) * len(forms)
    return Explainable(errors, _share(before, after, errors), names)


def _of_the_whole(errors: Errors, before: Errors, whole: Errors) -> Errors:
    """Errors on the beginnings of long recordings, by as much more or less as the declared model's are on the whole."""

    def more(error: float, known: float, all_of_it: float) -> float:
        return error * all_of_it / known if known > 0.0 else error

    rms = zip(errors.torque_rms, before.torque_rms, whole.torque_rms, strict=True)
    relative = more(errors.relative_error, before.relative_error, whole.relative_error)
    since = errors.since_moved and _of_the_whole(errors.since_moved, before.told, whole.told)
    return Errors(relative, tuple(more(*x) for x in rms), since)


def _share(before: Errors, after: Errors, free: Errors) -> float:
    drop = before.relative_error - free.relative_error
    if drop < LEAST_DROP * before.relative_error:
        return float(after.relative_error <= before.relative_error)
    return (before.relative_error - after.relative_error) / drop


def _layouts(regression: Regression) -> list[Indices]:
    """The part of each sample that is held out with it."""
    lengths, samples = [len(s) for s in regression.segments], len(regression)
    if max(lengths) <= LARGEST_PART * samples:
        return [np.repeat(np.arange(len(lengths)), lengths)]
    return [np.arange(samples) * parts // samples for parts in PARTS]


def _at_own_rate(said: Array, validation: Regression, held_out: Sequence[HeldOut]) -> list[Array]:
    """Values (M, joints) at the rate at which columns are worked out, brought to each recording's samples."""
    ends = np.cumsum([len(s.motion) for s in validation.segments])[:-1]
    out = []
    for values, segment, recording in zip(np.split(said, ends), validation.segments, held_out, strict=True):
        # behind the low-pass neighbouring samples lie on a smooth curve
        sample = np.minimum(np.arange(len(recording.torque)) / segment.working_factor, len(values) - 1)
        out.append(np.asarray(interpolate.CubicSpline(np.arange(len(values)), values)(sample)))
    return out


# ---- what a free form sees ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Signals:
    """One recording at the rate at which columns are worked out; arrays (N, joints) in the campaign's order."""

    segment: Segment
    rows: Indices  # coordinate of each joint
    position: Array
    velocity: Array
    acceleration: Array
    load: Array  # torque through the transmissions, of the declared model's links
    forces: Array  # (N, joints, effects): of the declared effects, one by one

    def links(self, joint: int) -> Array:
        """Regressor of the links in one joint, (N, 10 * bodies); those of all joints together would take most of the memory."""
        return np.array(self.segment.motion.on_tree.link_regressor()[:, self.rows[joint]])

    @property
    def rate_hz(self) -> float:
        return self.segment.rate_hz * self.segment.factor

    def filtered(self, columns: Array) -> Array:
        """Behind the low-pass, every sample."""
        cutoff = self.segment.cutoff_hz
        return columns if cutoff is None else lowpass(columns, cutoff, self.rate_hz)


def _signals(regression: Regression, declared: Identification) -> list[_Signals]:
    seen = regression.with_model(declared.link_parameters, declared.effects)
    return [_recording(s, seen.rows, declared.effects) for s in seen.segments]


def _recording(segment: Segment, rows: Indices, effects: Sequence[Effect]) -> _Signals:
    motion = segment.motion
    forces = [np.asarray(e.force(motion)[:, rows]) for e in effects if e.traits.in_dynamics]
    return _Signals(
        segment,
        rows,
        motion.q[:, rows],
        motion.v[:, rows],
        motion.a[:, rows],
        motion.on_tree.load()[:, rows],
        np.stack(forces, axis=2) if forces else np.zeros((*motion.q[:, rows].shape, 0)),
    )


@dataclass(frozen=True, eq=False)
class _Ranges:
    """Smallest and largest value of each joint's signals where fitted, each (2, joints): curves go on flat beyond them."""

    position: Array
    velocity: Array
    acceleration: Array
    load: Array

    @staticmethod
    def of(recordings: Sequence[_Signals]) -> _Ranges:
        def extremes(name: str) -> Array:
            values = np.concatenate([getattr(r, name) for r in recordings])
            return np.stack([values.min(axis=0), values.max(axis=0)])

        return _Ranges(*(extremes(f.name) for f in dataclasses.fields(_Ranges)))

    def within(self, name: str, signals: _Signals) -> Array:
        return np.asarray(np.clip(getattr(signals, name), *getattr(self, name)))

    def largest(self, name: str) -> Array:
        """Largest size of a signal of each joint, shape (joints,)."""
        size = np.abs(getattr(self, name)).max(axis=0)
        return np.where(size > 0, size, 1.0)

    @property
    def travel(self) -> Array:
        """Range of each joint's angle, shape (joints,)."""
        return np.maximum(np.ptp(self.position, axis=0), 1e-9)


def _form(
    here: Sequence[_Signals],
    there: Sequence[_Signals],
    ranges: _Ranges,
    residual: Array,
    joint: int,
    layouts: Sequence[Indices],
    trees: bool,
) -> FreeForm:
    # one recording behind the other: at the rate at which they are worked out they take much room
    fitted = [{n: r.segment.brought(x) for n, x in _families(r, ranges, joint).items()} for r in here]

    @cache
    def other(at: int) -> dict[str, Array]:
        return _families(there[at], ranges, joint)

    families = Families(
        {name: np.concatenate([f.pop(name) for f in fitted]) for name in list(fitted[0])},
        lambda name: np.concatenate([r.filtered(other(i)[name]) for i, r in enumerate(there)]),
        sum(len(r.position) for r in there),
    )
    if not trees:
        return best_form(families, None, residual, layouts)
    signals = (
        np.concatenate([r.segment.brought(_plain_signals(r, ranges, joint)) for r in here]),
        np.concatenate([r.filtered(_plain_signals(r, ranges, joint)) for r in there]),
    )
    return best_form(families, signals, residual, layouts)


def _families(signals: _Signals, ranges: _Ranges, joint: int) -> dict[str, Array]:
    """Columns that a joint's residual may be made of, by families; each (N, k)."""
    speed = ranges.within("velocity", signals) / ranges.largest("velocity")
    v = speed[:, [joint]]
    acceleration = ranges.within("acceleration", signals) / ranges.largest("acceleration")
    load = ranges.within("load", signals) / ranges.largest("load")
    angle = (ranges.within("position", signals)[:, joint] - ranges.position[0, joint]) / ranges.travel[joint]
    turning = np.tanh(v / SPEEDS)
    memory = np.stack([_direction(signals, ranges, joint, part) for part in TRAVELS], axis=1)
    bumps = np.exp(-0.5 * ((KNOTS - 1) * angle[:, None] - np.arange(KNOTS)) ** 2)
    out = {
        "friction over velocity": np.hstack(
            [signals.forces[:, joint], turning, v, np.abs(v), v * np.abs(v), acceleration[:, [joint]]]
        ),
        "friction over travel": np.hstack([memory, _at_first(signals, ranges, joint)[:, None]]),
        "friction over load": _over_load(
            load[:, [joint]], np.hstack([np.tanh(v / 0.03), np.tanh(v / 0.3), memory[:, [3]], v])
        ),
        "angle": bumps,
        "friction over angle": bumps * memory[:, [3]],
        "rates": _rates(signals, ranges, joint),
    }
    others = [k for k in range(speed.shape[1]) if k != joint]
    if others:
        moves = np.stack([_direction(signals, ranges, k, LAST_MOVE) for k in others], axis=1)
        out["motion of other joints"] = np.hstack([np.tanh(speed[:, others] / 0.03), speed[:, others], moves])
        out["acceleration of other joints"] = acceleration[:, others]
        out["load of other joints"] = load[:, others]
        out["links of its own"] = signals.links(joint)  # a torque off by a factor, which shared links cannot follow
    return out


def _over_load(load: Array, friction: Array) -> Array:
    return np.hstack([friction * np.abs(load), friction * load, load, np.abs(load), load**3])


def _rates(signals: _Signals, ranges: _Ranges, joint: int) -> Array:
    """What comes early or late: rates of the load and of dry friction, and the load itself, beyond their ranges too."""
    load = signals.load[:, joint] / ranges.largest("load")[joint]
    dry = np.tanh(signals.velocity[:, joint] / ranges.largest("velocity")[joint] / 0.1)
    return np.stack([np.gradient(load) * signals.rate_hz, np.gradient(dry) * signals.rate_hz, load], axis=1)


def _direction(signals: _Signals, ranges: _Ranges, joint: int, part: float) -> Array:
    """Direction of a joint's last move, kept across rests; it turns over within a part of the joint's range of angles."""
    return dahl(signals.position[:, joint], part * float(ranges.travel[joint]))


def _at_first(signals: _Signals, ranges: _Ranges, joint: int) -> Array:
    """The same until the joint first moves, for what it held before nobody knows; zero from then on."""
    angle = signals.position[:, joint]
    moved = np.abs(angle - angle[0]) > LAST_MOVE * ranges.travel[joint]
    return np.where(np.logical_or.accumulate(moved), 0.0, _direction(signals, ranges, joint, LAST_MOVE))


def _plain_signals(signals: _Signals, ranges: _Ranges, joint: int) -> Array:
    """What the trees see, (N, s): motion of all joints, the joint's load, directions of last moves."""
    moves = [_direction(signals, ranges, k, LAST_MOVE) for k in range(signals.position.shape[1])]
    load = signals.load[:, [joint]]
    return np.hstack([signals.position, signals.velocity, signals.acceleration, load, np.stack(moves, axis=1)])
