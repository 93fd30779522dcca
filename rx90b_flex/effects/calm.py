"""What of the load of drives is motion, and what only the noise of the angles that it was worked out from.

Accelerations carry the noise of measured angles. A link swings on its drive under it as under a load, most of all at its own
frequency, and a fit to the torque takes that swing away by damping it, however little the drive is damped. So drives twist under
what stands out of the noise: Wiener's filter leaves the best linear estimate of the load, which has nothing in common with its own
error, and least squares on such an estimate are not biased (regression calibration; R. J. Carroll, D. Ruppert, L. A. Stefanski,
C. M. Crainiceanu, *Measurement Error in Nonlinear Models*, 2006, chapter 4). The noise is that of the log's angles through the
tree's inertia. Where what the filter takes out is for a while more than noise (a robot that stops), it is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import blackmanharris

from rx90b_flex.effects.motion import Array, Indices, Motion

LINES = 16  # of a log's spectrum that are averaged; the filter rings for so small a part of the log
SHORTEST = 16 * LINES  # samples of a motion that its noise is told in
OUT_OF_NOISE = (2.0, 4.0)  # times the noise's power: from where on, and where for certain, there is motion
SMOOTHED = 3  # times, that a band's edges do not ring
MOSTLY = 0.5  # gain below which a line is taken out more than it is left
ORDER = 4  # of the low-pass of angles, forward and backward
BEYOND = 1e100  # kg m^2, no inertia
ALL = 1.0 - 1e-6  # of a load at every line: no filter is worth while


@dataclass(frozen=True, eq=False)
class Calm:
    """A filter of what depends on the noisy motion as its load does.

    Attributes
    ----------
    gain : array, shape (lines, n)
        At the lines of a signal that is continued at both ends.
    kept : array, shape (N, n)
        Part of what the gain takes out that is left where it is, for there it stands out of the noise by itself: 0 to 1.
    """

    gain: Array
    kept: Array

    @staticmethod
    def of(motion: Motion, load: Array) -> Calm | None:
        """Of a load (N, n), N m, on a motion of measured angles; None where nothing is to be taken out."""
        noise, low_pass = motion.angle_noise, motion.low_pass
        samples = len(load)
        step = float(motion.time[1] - motion.time[0]) if samples >= SHORTEST else 0.0
        if noise is None or low_pass is None or step <= 0.0 or not np.isfinite(load).all():
            return None
        band, inertia = low_pass.cutoff_hz, motion.on_tree.derivatives()[2]
        if not np.abs(inertia).max() < BEYOND:
            return None  # values from which a fit turns back
        by_acceleration = (inertia**2).mean(axis=0) @ (noise**2 / band)

        def noisy(hz: Array) -> Array:
            through = 1.0 / (1.0 + (hz / band) ** (2 * ORDER))
            return np.maximum(by_acceleration * ((2.0 * np.pi * hz) ** 4 * through**2)[:, None], 1e-300)

        hz = np.fft.rfftfreq(samples, step).astype(float)
        gain = uniform_filter1d(_out_of_noise(_density(load, step) / noisy(hz)), LINES, axis=0, mode="nearest")
        if gain.min() >= ALL:
            return None
        # what is taken out for the most part, white where it is noise
        out = ((gain < MOSTLY) & ((hz > 0.0) & (hz <= band))[:, None]).astype(float)
        for _ in range(SMOOTHED):
            out = uniform_filter1d(out, LINES, axis=0, mode="nearest")
        longer = np.fft.rfftfreq(samples + 2 * _beyond(samples), step).astype(float)
        gain, out = (np.stack([np.interp(longer, hz, g) for g in x.T], axis=1) for x in (gain, out))
        white = np.where(out > 0.0, out * (1.0 - gain) / np.sqrt(noisy(longer)), 0.0)
        power = uniform_filter1d(_filtered(load, white) ** 2, max(1, _beyond(samples) // 2), axis=0, mode="nearest")
        expected = (out**2 * (1.0 - gain) ** 2).sum(axis=0) * (longer[1] - longer[0])
        return Calm(gain, _out_of_noise(power / np.maximum(expected, 1e-300)))

    def __call__(self, x: Array, places: Indices | slice = slice(None)) -> Array:
        """Behind the filter: (N, m, ...) at some places of the n."""
        kept = self.kept[:, places].reshape(len(x), -1, *[1] * (x.ndim - 2))
        return np.asarray(kept * x + (1.0 - kept) * _filtered(x, self.gain[:, places]))


def _out_of_noise(over: Array) -> Array:
    """Wiener's gain for a power over that of the noise; nothing where it might be noise alone."""
    certain = np.clip((over - OUT_OF_NOISE[0]) / (OUT_OF_NOISE[1] - OUT_OF_NOISE[0]), 0.0, 1.0)
    return np.asarray(certain * (1.0 - 1.0 / np.maximum(over, 1.0)))


def _filtered(x: Array, gain: Array) -> Array:
    """(N, n, ...) continued by odd reflection."""
    samples = len(x)
    beyond = _beyond(samples)
    longer = np.concatenate([2.0 * x[0] - x[beyond:0:-1], x, 2.0 * x[-1] - x[-2 : -2 - beyond : -1]])
    gain = gain.reshape(*gain.shape, *[1] * (x.ndim - 2))
    # the line that joins its ends, which would else meet in a step
    line = np.linspace(0.0, 1.0, len(longer)).reshape(-1, *[1] * (x.ndim - 1)) * (longer[-1] - longer[0]) + longer[0]
    out = np.fft.irfft(np.fft.rfft(longer - line, axis=0) * gain, len(longer), axis=0) + line * gain[0]
    return np.asarray(out[beyond : beyond + samples])


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
