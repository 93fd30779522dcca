"""How far each row of a regression can be trusted near reversals, where a log does not say how fast a joint turns.

Dry friction steps at a velocity that no log resolves: between filters, a drive that sticks for a tenth of a second and one
that turns at once look much alike, and their torques differ by the whole step. The torque of the present model is asked for
at the velocity of the fit and at that of positions which keep another octave, on the samples and half a sample beside them,
for a step between two samples has an instant of its own. Hysteresis, which goes by angles, is asked for along both angles, and
along those that a counter may have rounded where a joint stands: no mean makes that smaller, and all rows of a rest share it. What
they differ by behind the low-pass is a standard deviation that a row has beside its noise. It depends on motion and present
model, not on what is tried beside it.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy import ndimage

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, with_forces
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import STANDING_S, Regression, Segment
from rx90b_flex.signals import lowpass
from rx90b_flex.signals.facts import counter_steps

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
    sigma = MAD_TO_STD * np.median(np.abs(model.residual_on(motors)), axis=0)
    steep = [e for e in model.effects if e.traits.in_dynamics and not (e.traits.virtual or e.traits.needs_model)]
    seen = motors.with_model(model.link_parameters, model.effects)
    pairs = zip(seen.segments, motors.segments, strict=True)
    doubt = np.concatenate([_doubt(s, first, steep) for s, first in pairs])[:, motors.rows]
    return np.asarray(1.0 / np.sqrt(1.0 + (doubt / np.maximum(sigma, 1e-300)) ** 2))


def _doubt(segment: Segment, measured: Segment, effects: list[Effect]) -> Array:
    """What the torque may be off for want of the motion; after the low-pass, (N, n), N m.

    `measured` is the same segment whatever the model, with another guess at angle and velocity.
    """
    if segment.cutoff_hz is None:
        return np.zeros((len(segment), segment.motion.q.shape[1]))
    rate = segment.rate_hz * segment.factor

    def force(of: list[Effect], **changes: Any) -> Array:
        return with_forces(np.zeros_like(segment.motion.v), of, dataclasses.replace(segment.motion, **changes))

    angle, velocity = measured.wider
    by_angle, steep = ([e for e in effects if e.traits.remembers is known] for known in (True, False))
    beside = 0.5 * sum(force(steep, v=v) for v in measured.half_a_sample_off())
    there, here = force(steep, v=velocity), force(steep)
    unknown = [there - here, beside - there]
    if segment.motion.stuck is not None:
        # while a drive sticks its friction is any torque between both directions' own
        stuck = np.where(np.isnan(segment.motion.stuck), np.nan, 1.0)
        unknown.append(0.5 * (force(steep, stuck=stuck) - force(steep, stuck=-stuck)))
    size = sum(np.abs(lowpass(off, segment.cutoff_hz, rate)) for off in unknown)
    # an impulse behind the low-pass rings, and is unknown between its zeros too: the envelope over half a period
    width = 2 * round(0.5 / segment.cutoff_hz * rate) + 1
    envelope = ndimage.maximum_filter1d(size, width, axis=0, mode="nearest")
    if by_angle:
        rests = _rounding(segment)
        unknown = [
            force(by_angle, q=q) - force(by_angle) for q in (angle, segment.motion.q + rests, segment.motion.q - rests)
        ]
        between, *rounded = (lowpass(off, segment.cutoff_hz, rate) for off in unknown)
        around = ndimage.uniform_filter1d(between**2, width, axis=0, mode="nearest")
        # a running sum may end below zero
        envelope = np.sqrt(envelope**2 + np.maximum(around, 0.0) + 0.5 * (rounded[0] ** 2 + rounded[1] ** 2))
    return np.asarray(envelope[:: segment.factor][segment.kept])


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
