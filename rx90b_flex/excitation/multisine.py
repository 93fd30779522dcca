"""Multisines: periodic excitation with a given amplitude at each line, phases drawn at random and then moved to lower its peak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90b_flex.levenberg import Damping, Iterate, descent
from rx90b_flex.pieces import Array

Crest = Literal["random", "clipping", "lp"]

CLIPPING_LEVELS = (0.75, 0.95)  # of the peak: first and last level at which the clipping algorithm cuts
CLIPPING_STEPS = 300
POWERS = (4, 8, 16, 32, 64, 128, 256)  # even: of the norms that near the largest value, one after the other
EVALUATIONS = 25  # of the norm, for each power
DAMPING = Damping(rise=4.0, fall=1.0 / 0.3)
SETTLED = 1e-4  # relative change of the norm below which the next power is taken


def odd_lines(first: int, last: int) -> tuple[int, ...]:
    """Odd numbers of cycles in the period, `first` to `last`, both included where they are odd.

    Even nonlinearities answer odd lines on even ones alone (section 6.5.1).
    """
    return tuple(range(first | 1, last + 1, 2))


def lines_in_band(low_hz: float, high_hz: float, period_s: float) -> tuple[int, ...]:
    """The odd lines between two frequencies. A longer period makes them finer."""
    return odd_lines(int(np.ceil(low_hz * period_s - 1e-9)), int(np.floor(high_hz * period_s + 1e-9)))


def crest_factor(wave: ArrayLike) -> Array:
    """Largest absolute value over root mean square of each column (section 6.5.1), shape (samples, ...) to (...)."""
    x = np.asarray(wave, dtype=float)
    return np.asarray(np.abs(x).max(axis=0) / np.sqrt(np.mean(x**2, axis=0)))


def multisine(
    lines: Sequence[int],
    samples: int,
    peak: float,
    rng: np.random.Generator,
    columns: int = 1,
    *,
    amplitudes: ArrayLike | None = None,
    crest: Crest = "random",
    oversampling: int = 1,
) -> Array:
    """Multisines (6.11) with phases from `rng`, scaled to a peak, shape (samples, columns).

    ``f(t) = sum_k A_k cos(2 pi l_k t / T + phi_k)``. The phases are independent and uniform; they stay so with `crest`
    ``random``, and are otherwise the start from which the peak is lowered, see `lower_crest`. Each column has its own.

    Parameters
    ----------
    lines : numbers of whole cycles in the period
    samples : int
        Of one period.
    peak : float
        Largest absolute value at the samples.
    amplitudes : array, shape (len(lines),), optional
        Spectrum A_k up to a factor; all alike by default.
    crest : ``random``, ``clipping`` or ``lp``
    oversampling : int
        The peak is lowered on a grid so many times finer than the samples. 1 suits what is held or interpolated linearly between
        samples, as the CS8 does; 4 suits a smooth signal.

    Raises
    ------
    ValueError
        Lines at or beyond half the sample rate, repeated or below 1; amplitudes that do not fit.
    """
    numbers = np.asarray(lines)
    beyond = [int(k) for k in numbers if not 0 < 2 * k < samples]
    if beyond or len(numbers) == 0 or len(set(numbers.tolist())) < len(numbers):
        what = f"line {beyond[0]} of {samples} samples a period" if beyond else "no lines, or one of them twice"
        raise ValueError(f"multisine: {what}; expected different lines from 1 to {(samples - 1) // 2}, below Nyquist")
    spectrum = np.ones(len(numbers)) if amplitudes is None else np.asarray(amplitudes, dtype=float)
    if spectrum.shape != numbers.shape or not np.all(np.isfinite(spectrum) & (spectrum > 0)):
        raise ValueError(f"multisine: amplitudes of shape {spectrum.shape}; expected {len(numbers)} numbers above 0")
    phases = rng.uniform(0.0, 2.0 * np.pi, (len(numbers), columns))
    if crest != "random":
        phases = np.stack(
            [lower_crest(numbers, spectrum, p, samples * oversampling, method=crest) for p in phases.T], axis=1
        )
    waves = _waves(numbers, spectrum[:, None] * np.exp(1j * phases), samples)
    return np.asarray(peak * waves / np.abs(waves).max(axis=0))


def lower_crest(
    lines: ArrayLike,
    amplitudes: ArrayLike,
    phases: ArrayLike,
    samples: int,
    *,
    method: Literal["clipping", "lp"] = "lp",
) -> Array:
    """Phases with a lower crest factor than the given ones, shape (F,).

    ``clipping`` (Van der Ouderaa; Pintelon and Schoukens 2001; the source's): cut the signal near its peak, keep the phases
    of what is left and the amplitudes asked for, again and again, cutting less and less. ``lp`` goes on from there: the norm
    ``|f|_p`` is minimised for p = 4, 8, ..., 256 by Levenberg and Marquardt's steps, residuals ``f^(p/2)`` (Guillaume et al.
    1991). As p grows the norm nears the largest value; the phases of one p start the next.

    Parameters
    ----------
    samples : int
        Of the grid on which the peak is counted.
    """
    numbers, size, phase = np.asarray(lines), np.asarray(amplitudes, dtype=float), np.asarray(phases, dtype=float)
    size = size / np.sqrt(0.5 * np.sum(size**2))  # effective value 1: the largest value is the crest factor
    phase = _clip(numbers, size, phase, samples)
    return phase if method == "clipping" else _minimise_norms(numbers, size, phase, samples)


def whitening(sensitivity: ArrayLike) -> Array:
    """Amplitudes of the multisine that make the drive torques' spectra flat (section 7.2 recommends it), shape (joints, F).

    Each joint's torque line over its feed-forward line is the loop's sensitivity, whose diagonal is divided out. Mean square 1.

    Parameters
    ----------
    sensitivity : complex array, shape (F, joints, joints)
        Drive torque over feed-forward torque at the lines, from `CS8.sensitivity`. Of the joints that are excited.
    """
    own = np.abs(np.einsum("fjj->jf", np.asarray(sensitivity)))
    return np.asarray(1.0 / own / np.sqrt(np.mean(own**-2, axis=1, keepdims=True)))


def smoothed_square(samples: int, odd_count: int) -> tuple[Array, Array]:
    """One period of a smoothed square wave of height 1 and of its integral over the phase 0..2 pi, each (samples,).

    The first `odd_count` odd lines of a square wave, and no other line, each with Lanczos's factor, so that it overshoots by
    2.3 % only, at its flanks. As a joint's velocity reference it keeps the joint from reversing but twice a period (section
    6.5.2).
    """
    angle = 2.0 * np.pi * np.arange(samples) / samples
    odd = 2 * np.arange(odd_count) + 1
    weight = 4.0 / np.pi / odd * np.sinc(odd / (2 * odd_count))
    return np.sin(np.outer(angle, odd)) @ weight, -np.cos(np.outer(angle, odd)) @ (weight / odd)


def _waves(lines: Array, coefficients: NDArray[np.complex128], samples: int) -> Array:
    """Real signals of complex line amplitudes, shape (F, ...) to (samples, ...)."""
    spectrum = np.zeros((samples // 2 + 1, *coefficients.shape[1:]), complex)
    spectrum[lines] = coefficients * (0.5 * samples)
    return np.asarray(np.fft.irfft(spectrum, samples, axis=0))


def _clip(lines: Array, size: Array, phase: Array, samples: int) -> Array:
    best, lowest = phase, np.inf
    for level in np.linspace(*CLIPPING_LEVELS, CLIPPING_STEPS):
        wave = _waves(lines, size * np.exp(1j * phase), samples)
        peak = np.abs(wave).max()
        if peak < lowest:
            best, lowest = phase, peak
        limit = level * peak
        phase = np.angle(np.fft.rfft(np.clip(wave, -limit, limit))[lines])
    return np.asarray(best)


@dataclass(frozen=True, eq=False)
class _Norm(Iterate):
    """Phases on their way to the smallest norm ``|f|_p``; residuals are over the largest value, so that powers do not overflow."""

    cosine: Array  # (N, F) of lines without phases, times their amplitudes
    sine: Array
    power: int
    phase: Array
    peak: float = 1.0

    @cached_property
    def wave(self) -> Array:
        return np.asarray(self.cosine @ np.cos(self.phase) - self.sine @ np.sin(self.phase))

    @cached_property
    def goal(self) -> float:
        with np.errstate(over="ignore"):
            return float(np.sum((self.wave / self.peak) ** self.power))

    @property
    def enough(self) -> float:
        return self.goal * (1.0 - (1.0 - SETTLED) ** self.power)

    def equations(self) -> tuple[Array, Array]:
        value, half = self.wave / self.peak, self.power // 2
        slope = -(self.cosine * np.sin(self.phase) + self.sine * np.cos(self.phase))
        jacobian = (half / self.peak * value ** (half - 1))[:, None] * slope
        return jacobian.T @ jacobian, -jacobian.T @ value**half

    def moved(self, step: Array) -> _Norm:
        return replace(self, phase=self.phase + step)

    def renewed(self) -> _Norm:
        return replace(self, peak=float(np.abs(self.wave).max()))


def _minimise_norms(lines: Array, size: Array, phase: Array, samples: int) -> Array:
    half = bool(np.all(lines % 2 == 1)) and samples % 2 == 0  # odd lines alone: the second half is minus the first
    angle = 2.0 * np.pi / samples * np.outer(np.arange(samples // 2 if half else samples), lines)
    best = at = _Norm(size * np.cos(angle), size * np.sin(angle), POWERS[0], phase).renewed()
    for power in POWERS:
        way = list(descent(replace(at, power=power), EVALUATIONS, DAMPING))
        best, at = min(best, *way, key=lambda one: one.peak), way[-1]
    return best.phase
