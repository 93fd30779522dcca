"""How far each row of a regression can be trusted where a log does not say what friction holds: near reversals and at rests.

Dry friction steps at a velocity that no log resolves: between filters, a drive that sticks for a tenth of a second and one
that turns at once look much alike, and their torques differ by the whole step. The torque of the present model is asked for
at the velocity of the fit and at that of positions which keep another octave, on the samples and half a sample beside them,
for a step between two samples has an instant of its own. Hysteresis, which goes by angles, is asked for along both angles, and
along those that a counter may have rounded where a joint stands: no mean makes that smaller, and all rows of a rest share it. What
they differ by behind the low-pass is a standard deviation that a row has beside its noise. It depends on motion and present
model, not on what is tried beside it.

Where a joint stands as its recording begins, nobody knows what friction holds until it has moved: anything between both
directions' own. At later rests it is what the model leaves there, if that differs from one to the next.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy import ndimage

from rx90b_flex.diagnose.moving import unmoved
from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Mask, with_forces
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import STANDING_S, Segment
from rx90b_flex.pieces import AT_ONCE
from rx90b_flex.signals.facts import counter_steps

FEWEST_RESTS = 5  # of which something can be said of what friction holds at others
MAD_TO_STD = 1.4826  # of a normal distribution; residuals near reversals are its outliers


def row_weights(regression: Regression, model: Identification) -> Array:
    """Factor of each row, ``1 / sqrt(1 + (doubt / sigma)^2)``, shape (N, joints).

    Parameters
    ----------
    regression : Regression
        As measured, without factors of its rows.
    model : Identification
        Its friction steps by so much; its residual's median deviation is sigma.
    """
    motors = regression.motors
    residual = model.residual_on(motors)
    sigma = MAD_TO_STD * np.median(np.abs(residual), axis=0)
    known = [e for e in model.effects if e.traits.in_dynamics and not (e.traits.virtual or e.traits.needs_model)]
    by_angle, steep = ([e for e in known if e.traits.remembers is remembers] for remembers in (True, False))
    seen = motors.with_model(model.link_parameters, model.effects)
    pairs = zip(seen.segments, motors.segments, strict=True)
    doubt = np.concatenate([_doubt(s, first, by_angle, steep) for s, first in pairs])[:, motors.rows]
    doubt = np.maximum(doubt, _at_rests(seen, residual, by_angle, steep))
    return np.asarray(1.0 / np.sqrt(1.0 + (doubt / np.maximum(sigma, 1e-300)) ** 2))


def _doubt(segment: Segment, measured: Segment, by_angle: list[Effect], steep: list[Effect]) -> Array:
    """What the torque may be off for want of the motion; after the low-pass, (N, n), N m.

    `measured` is the same segment whatever the model, with another guess at angle and velocity.
    """
    if segment.cutoff_hz is None:
        return np.zeros((len(segment), segment.motion.q.shape[1]))
    still = unmoved(segment.motion.v, segment.rate_hz * segment.factor)
    pairs = zip(segment.split(), measured.split(), strict=True)
    envelope = np.concatenate([_envelope(part, first, steep, still[part.first :]) for part, first in pairs])
    if by_angle:
        envelope = np.hypot(envelope, _along_angles(segment, measured.wider[0], by_angle, still))
        if len(segment.motion) > AT_ONCE:
            del measured.__dict__["wider"]
    return np.asarray(envelope)


def _at_rests(regression: Regression, residual: Array, by_angle: list[Effect], steep: list[Effect]) -> Array | float:
    """What friction may hold at rests beside what the model says of it, (N, joints), N m; elsewhere zero.

    As much as the residual's mean differs from rest to rest, and no more than friction can hold.
    """
    segments, rows = regression.segments, regression.rows
    means: list[list[float]] = [[] for _ in rows]
    for s, left in zip(segments, np.split(residual, np.cumsum([len(s) for s in segments])[:-1]), strict=True):
        still = (s.motion.v == 0.0)[:: s.factor][s.kept][:, rows]
        for own, rest, torque in zip(means, still.T, left.T, strict=True):
            numbered, count = ndimage.label(rest)
            first = 2 if rest[0] else 1  # that with which the log begins is another matter
            own += list(ndimage.mean(torque, numbered, range(first, count + 1)))
    held = np.array([np.sqrt(np.mean(np.square(own))) if len(own) >= FEWEST_RESTS else 0.0 for own in means])
    if not held.any():
        return 0.0
    parts = [part for s in segments for part in s.split()]
    near = np.concatenate([_near(part, (part.motion.v == 0.0).astype(float))[:, rows] for part in parts])
    return np.asarray(near * np.minimum(held, np.max([_may_hold(s, by_angle, steep)[rows] for s in segments], axis=0)))


def _near(segment: Segment, *unknown: Array) -> Array:
    """Sum of what is unknown, each (N_working, n), behind the low-pass; (N, n).

    An impulse behind the low-pass rings, and is unknown between its zeros too: the envelope over half a period.
    """
    size = sum(np.abs(segment.low_passed(off)) for off in unknown)
    envelope = ndimage.maximum_filter1d(size, _width(segment), axis=0, mode="nearest")
    return np.asarray(envelope[:: segment.factor][segment.kept])


def _may_hold(segment: Segment, by_angle: list[Effect], steep: list[Effect]) -> Array:
    """Dry friction of each coordinate, (n,), N m."""
    moved = segment.motion.part(slice(0, 2))
    ends = (
        with_forces(np.zeros_like(moved.v), steep, dataclasses.replace(moved, stuck=way * np.ones_like(moved.v)))
        for way in (1.0, -1.0)
    )
    at_once = 0.5 * np.abs(np.subtract(*ends)).max(axis=0)
    return np.asarray(at_once + np.abs(_force(segment, by_angle)).max(axis=0) if by_angle else at_once)


def _envelope(segment: Segment, measured: Segment, steep: list[Effect], still: Mask) -> Array:
    """The same for friction that goes by velocity alone."""
    there, here = _force(segment, steep, v=measured.wider[1]), _force(segment, steep)
    beside = 0.5 * sum(_force(segment, steep, v=v) for v in measured.half_a_sample_off)
    unknown = [there - here, beside - there]
    # while a drive sticks, and before it first moves, its friction is any torque between both directions' own
    motion = segment.motion
    sticks = still[: len(motion)] if motion.stuck is None else still[: len(motion)] | ~np.isnan(motion.stuck)
    if sticks.any():
        stuck = np.where(sticks, 1.0, np.nan)
        unknown.append(0.5 * (_force(segment, steep, stuck=stuck) - _force(segment, steep, stuck=-stuck)))
    return _near(segment, *unknown)


def _along_angles(segment: Segment, wider: Array, effects: list[Effect], still: Mask) -> Array:
    """The same for hysteresis, which goes by angles: by those of a wider filter, by those that a counter rounds at rest, and by what
    joints did before they stood as the recording began.
    """
    here = _force(segment, effects)

    def off(angle: Array) -> Array:
        return segment.low_passed(_force(segment, effects, q=angle) - here) ** 2

    around = ndimage.uniform_filter1d(off(wider), _width(segment), axis=0, mode="nearest")
    squares = np.maximum(around, 0.0)  # a running sum may end below zero
    rounding = _rounding(segment)
    if rounding.any():
        squares += 0.5 * (off(segment.motion.q + rounding) + off(segment.motion.q - rounding))
    if still.any():
        came = np.zeros_like(segment.motion.q)
        came[0] = np.where(still[0], np.ptp(segment.motion.q, axis=0), 0.0)
        ends = [_force(segment, effects, q=segment.motion.q + way * came) for way in (1.0, -1.0)]
        squares += (0.5 * segment.low_passed(ends[0] - ends[1])) ** 2
    return np.sqrt(squares[:: segment.factor][segment.kept])


def _width(segment: Segment) -> int:
    """Working samples of half a period of the cutoff to either side of one."""
    return 1 + 2 * round(0.5 / (segment.cutoff_hz or np.inf) * segment.rate_hz * segment.factor)


def _force(segment: Segment, of: list[Effect], **changes: Any) -> Array:
    motion = dataclasses.replace(segment.motion, **changes) if changes else segment.motion
    return with_forces(np.zeros_like(motion.v), of, motion)


def _rounding(segment: Segment) -> Array:
    """Standard deviation of an angle that a counter rounds, where its joint stands; elsewhere zero, (N_working, joints), rad."""
    order = [segment.recording.joints.index(j) for j in segment.motion.coordinates.joints]
    steps = counter_steps(segment.recording.position)[order]
    position = segment.recording.position[:: segment.working_factor][:, order]
    window = max(3, round(STANDING_S * segment.rate_hz * segment.factor))
    highest, lowest = (
        f(position, window, axis=0, mode="nearest") for f in (ndimage.maximum_filter1d, ndimage.minimum_filter1d)
    )
    return np.where(highest - lowest < 1.5 * steps, steps / np.sqrt(12.0), 0.0)
