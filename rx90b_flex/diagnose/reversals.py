"""How far each row of a regression can be trusted near reversals, where a log does not say how fast a joint turns.

Dry friction steps at a velocity that no log resolves: between filters, a drive that sticks for a tenth of a second and one
that turns at once look much alike, and their torques differ by the whole step. The torque of the present model is asked for
twice, a little faster and a little slower by what the log leaves open; half the difference is a standard deviation that the
row has beside its noise. It depends on the motion and the present model, not on what is tried beside it.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import POSITION_CUTOFF_RATIO, Regression, Stretch
from rx90b_flex.signals import lowpass, motion

WIDER = 2.0  # times the cutoff of positions: what the octave above changes in a velocity is what the log leaves open
MAD_TO_STD = 1.4826  # of a normal distribution; residuals near reversals are its outliers


def trust(regression: Regression, model: Identification) -> Array:
    """Factor of each row, ``1 / sqrt(1 + (doubt / sigma)^2)``, shape (N, joints).

    Parameters
    ----------
    regression : Regression
        As measured, without factors of its rows.
    model : Identification
        Its friction steps by so much; its residual's median deviation is sigma.
    """
    sigma = MAD_TO_STD * np.median(np.abs(model.residual_on(regression)), axis=0)
    steep = [e for e in model.effects if e.in_dynamics and not (e.virtual or e.remembers or e.needs_model)]
    seen = regression.with_model(model.link_parameters, model.effects)
    doubt = np.concatenate([_doubt(s, steep) for s in seen.stretches])[:, regression.rows]
    return np.asarray(1.0 / np.sqrt(1.0 + (doubt / np.maximum(sigma, 1e-300)) ** 2))


def _doubt(stretch: Stretch, effects: list[Effect]) -> Array:
    """What the torque may be off for want of the velocity, after the low-pass; shape (N, n), N m."""
    if stretch.cutoff_hz is None:
        return np.zeros((len(stretch), stretch.motion.q.shape[1]))
    unknown = _unknown_velocity(stretch)
    faster, slower = (dataclasses.replace(stretch.motion, v=stretch.motion.v + v) for v in (unknown, -unknown))
    off = sum((0.5 * np.abs(e.force(faster) - e.force(slower)) for e in effects), np.zeros_like(unknown))
    rate = stretch.rate_hz * stretch.factor
    # the envelope: an impulse behind the low-pass rings, and is unknown between its zeros too
    spread = _highest(np.abs(lowpass(off, stretch.cutoff_hz, rate)), 0.5 / stretch.cutoff_hz, rate)
    return spread[:: stretch.factor][stretch.kept]


def _unknown_velocity(stretch: Stretch) -> Array:
    """Largest change of the velocity about each sample if positions keep another octave; working rate, (N, n), rad/s."""
    recording = stretch.recording
    assert stretch.cutoff_hz is not None
    rate, cutoff = recording.sample_rate_hz, POSITION_CUTOFF_RATIO * stretch.cutoff_hz
    wide = motion(recording.position, rate, WIDER * cutoff if WIDER * cutoff < 0.4 * rate else None).velocity
    order = [recording.joints.index(j) for j in stretch.motion.coordinates.joints]
    change = np.abs(wide[:: stretch.working_factor][:, order] - stretch.motion.v)
    return _highest(change, 0.5 / cutoff, rate / stretch.working_factor)


def _highest(x: Array, half_s: float, rate_hz: float) -> Array:
    """Largest value within a time on either side, along axis 0."""
    return np.asarray(ndimage.maximum_filter1d(x, 2 * round(half_s * rate_hz) + 1, axis=0, mode="nearest"))
