"""What of the load of drives is motion, and what only the noise of the angles that it was worked out from.

Accelerations carry the noise of measured angles. A link swings on its drive under it as under a load, most of all at its own
frequency, and a fit to the torque takes that swing away by damping it, however little the drive is damped. So drives twist under what
stands out of the noise: Wiener's filter leaves the best linear estimate of the load, which has nothing in common with its own error, and
least squares on such an estimate are not biased (regression calibration; R. J. Carroll, D. Ruppert, L. A. Stefanski, C. M. Crainiceanu,
*Measurement Error in Nonlinear Models*, 2006, chapter 4). The noise is that of the log's angles through the tree's inertia.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import blackmanharris

from rx90b_flex.effects.motion import Array, Motion

LINES = 16  # of a log's spectrum that are averaged; the filter rings for so small a part of the log
SHORTEST = 16 * LINES  # samples of a motion that its noise is told in
OUT_OF_NOISE = (2.0, 4.0)  # times the noise's density: from where on, and where for certain, there is motion
ORDER = 4  # of the low-pass of angles, forward and backward
ALL = 1.0 - 1e-6  # of a load at every line: no filter is worth while


def gain(motion: Motion, load: Array) -> Array:
    """Of the filter that leaves of a load (N, n), N m, what stands out of the angles' noise; (lines, n), none where nothing is to be done.

    At the lines of a load that is continued at both ends (`calmed`).
    """
    noise, band = motion.angle_noise, motion.angle_band_hz
    samples, nothing = len(load), np.zeros((0, load.shape[1]))
    step = float(motion.time[1] - motion.time[0]) if samples >= SHORTEST else 0.0
    if noise is None or band is None or step <= 0.0 or not np.isfinite(load).all():
        return nothing
    hz = np.fft.rfftfreq(samples, step)
    through = 1.0 / (1.0 + (hz / band) ** (2 * ORDER))
    drives = [motion.coordinates.index(j) for j in motion.coordinates.joints]
    by_acceleration = (motion.on_tree.derivatives()[2][:, :, drives] ** 2).mean(axis=0) @ (noise**2 / band)
    noisy = by_acceleration * ((2.0 * np.pi * hz) ** 4 * through**2)[:, None]
    power = _density(load, step)
    over = power / np.maximum(noisy, 1e-300)
    certain = np.clip((over - OUT_OF_NOISE[0]) / (OUT_OF_NOISE[1] - OUT_OF_NOISE[0]), 0.0, 1.0)
    kept = uniform_filter1d(certain * (1.0 - 1.0 / np.maximum(over, 1.0)), LINES, axis=0, mode="nearest")
    if kept.min() >= ALL:
        return nothing
    longer = np.fft.rfftfreq(samples + 2 * _beyond(samples), step)
    return np.stack([np.interp(longer, hz, g) for g in kept.T], axis=1)


def calmed(x: Array, gain: Array) -> Array:
    """Behind the filter of `gain`: (N, n, ...) of the same motion, continued by odd reflection; its ends are left as they are."""
    if not len(gain):
        return x
    samples = len(x)
    beyond = _beyond(samples)
    longer = np.concatenate([2.0 * x[0] - x[beyond:0:-1], x, 2.0 * x[-1] - x[-2 : -2 - beyond : -1]])
    lines = np.fft.rfft(longer, axis=0) * gain.reshape(*gain.shape, *[1] * (x.ndim - 2))
    out = np.fft.irfft(lines, len(longer), axis=0)[beyond : beyond + samples]
    inside = np.minimum(np.arange(samples), np.arange(samples)[::-1]) / beyond
    return np.asarray(x + np.minimum(inside, 1.0).reshape(-1, *[1] * (x.ndim - 1)) * (out - x))


def _beyond(samples: int) -> int:
    """Samples in which the filter rings out."""
    return samples // LINES


def _density(x: Array, step: float) -> Array:
    """Smoothed one-sided spectral density of (N, n) less a straight line, by a window whose side lobes lie 92 dB down."""
    time = np.linspace(-1.0, 1.0, len(x))
    line = np.polynomial.polynomial.polyfit(time, x, 1)
    window = blackmanharris(len(x), sym=False)[:, None]
    lines = np.fft.rfft((x - line[0] - time[:, None] * line[1]) * window, axis=0)
    power = 2.0 * step * np.abs(lines) ** 2 / (window**2).sum()
    return np.asarray(uniform_filter1d(power, LINES, axis=0, mode="nearest"))
