"""Mains taken out of periodic recordings: one frequency that is no whole number of cycles in the period leaks into every line.

What repeats with the period and what does not are told apart by the periods' mean, so that no excited line is touched:
sine and cosine are fitted to what the periods differ by.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import optimize

from rx90b_flex.effects.motion import Array
from rx90b_flex.signals import Recording
from rx90b_flex.signals.filters import periods

REACH_HZ = 0.2  # by which mains may be off the frequency given: grids stay within it
FINENESS = 4  # places a resolution cell, one over the recording's length, where the search begins
APART = 0.1  # part of a sine that must differ between periods; else it repeats with them and cannot be told


@dataclasses.dataclass(frozen=True)
class Mains:
    """A fixed frequency as it was found in one recording.

    Attributes
    ----------
    hz : float
    torque_amplitude : array, shape (n,), N m
        NaN where it could not be told from the excitation.
    """

    hz: float
    torque_amplitude: Array

    @property
    def told(self) -> bool:
        """Whether it differs between periods."""
        return bool(np.isfinite(self.torque_amplitude).all())


def without_mains(recording: Recording, near_hz: float) -> tuple[Recording, Mains]:
    """Torque and angle without the sine that explains most of what the torques' periods differ by, near a frequency.

    Each recording has its own frequency, amplitudes and phases: mains wander. Where there are none, what is taken out is noise of
    two degrees of freedom a signal.

    Parameters
    ----------
    near_hz : float
        50 or 60, or any other; the frequency is sought `REACH_HZ` on either side.

    Raises
    ------
    ValueError
        No period, fewer than two of them, or a frequency beyond Nyquist.
    """
    size = recording.period_samples or recording.samples
    count = recording.samples // size
    if recording.period_samples is None or count < 2:
        raise ValueError(
            f"recording {recording.name!r} has {count} periods; mains are told from the excitation by two or more"
        )
    nyquist = 0.5 * recording.sample_rate_hz
    if not REACH_HZ < near_hz < nyquist - REACH_HZ:
        raise ValueError(f"mains_hz is {near_hz:g}; expected {REACH_HZ:g} to {nyquist - REACH_HZ:g} Hz")
    time = np.arange(recording.samples) / recording.sample_rate_hz

    def differing(x: Array) -> Array:
        each = periods(x, size)
        return np.asarray((each - each.mean(axis=0)).reshape(count * size, -1))

    def waves(hz: float) -> Array:
        return np.column_stack([np.cos(2.0 * np.pi * hz * time), np.sin(2.0 * np.pi * hz * time)])

    torque = differing(recording.torque)
    # noise of each joint counts alike
    scaled = torque / np.maximum(torque.std(axis=0), 1e-300)

    def unexplained(hz: float) -> float:
        basis = np.linalg.qr(differing(waves(hz)))[0]
        return -float(np.sum((basis.T @ scaled) ** 2))

    step = recording.sample_rate_hz / (FINENESS * count * size)
    places = np.arange(near_hz - REACH_HZ, near_hz + REACH_HZ + step, step)
    best = places[np.argmin([unexplained(hz) for hz in places])]
    hz = float(optimize.minimize_scalar(unexplained, bounds=(best - step, best + step), method="bounded").x)
    basis = differing(waves(hz))
    if np.sum(basis**2) < APART * len(basis):  # a whole sine and cosine have one a sample together
        return recording, Mains(hz, np.full(torque.shape[1], np.nan))
    clean, amplitudes = [], []
    for signal in (recording.torque, recording.position):
        parts = np.linalg.lstsq(basis, differing(signal), rcond=None)[0]
        clean.append(signal - waves(hz) @ parts)
        amplitudes.append(np.hypot(*parts))
    return dataclasses.replace(recording, torque=clean[0], position=clean[1]), Mains(hz, amplitudes[0])
