"""Covariances of least-squares estimates whose residuals are correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from rx90b_flex.effects.motion import Array

LARGEST_ABSORBED = 0.8  # part of the noise at a frequency that a fit is taken to have absorbed at the most
LARGEST_ORDER = 24  # of the autoregression that takes out most of a residual's colour


@dataclass(frozen=True)
class Spectrum:
    """Smoothed spectrum of one residual, prewhitened: a lag window on what an autoregression leaves, coloured again.

    A lag window alone smears the peak of a strongly coloured residual, and calls estimates more certain than they are.

    Attributes
    ----------
    autocovariance : array, shape (M,)
        Of the prewhitened residual, tapered by Parzen's window, from lag zero.
    filter : array, shape (order + 1,)
        Prewhitening filter, the first coefficient one.
    degrees_of_freedom : float
        Of the estimate, 3.7 N / M.
    """

    autocovariance: Array
    filter: Array
    degrees_of_freedom: float

    def product(self, columns: Array) -> Array:
        """``columns.T @ Sigma @ columns`` with the Toeplitz matrix Sigma of this spectrum; (N, k) -> (k, k)."""
        samples = len(columns)
        # room for the correlation on either side, so that the ends do not meet
        size = fft.next_fast_len(2 * samples + len(self.autocovariance), real=True)
        density = np.maximum(fft.rfft(_symmetric(self.autocovariance, size)).real, 0.0)
        density /= np.abs(fft.rfft(self.filter, size)) ** 2
        spectra = fft.rfft(columns, size, axis=0)
        # one-sided: every line but the first (and the middle one) stands for two
        weight = np.full(len(density), 2.0)
        weight[0] = 1.0
        if size % 2 == 0:
            weight[-1] = 1.0
        weight *= density / size
        return ((spectra.conj() * weight[:, None]).T @ spectra).real


def _symmetric(lags: Array, size: int) -> Array:
    out = np.zeros(size)
    count = min(len(lags), size // 2)
    out[:count] = lags[:count]
    out[size - count + 1 :] = lags[count - 1 : 0 : -1]
    return out


def residual_spectrum(residual: Array, spans: Sequence[slice], absorbed: Array, longest: int) -> Spectrum:
    """Spectrum of the noise behind one joint's residual.

    Parameters
    ----------
    residual : array, shape (N,)
    spans : sequence of slice
        Stretches that do not follow each other in time.
    absorbed : array, shape (M,)
        What the fit took out of the noise (`absorbed_by_fit`); zeros where nothing was fitted.
    longest : int
        Longest correlation to allow for, samples.
    """
    parts = [residual[s] for s in spans]
    total = sum(len(p) for p in parts)
    lags = max(2, min(longest, total // 6))
    raw = _autocovariance(parts, lags + LARGEST_ORDER, absorbed)
    whitening = _autoregression(raw[: min(LARGEST_ORDER, lags - 1) + 1], total)
    # the autocovariance of the prewhitened residual follows from its own: twice through the filter
    kernel = np.correlate(whitening, whitening, mode="full")
    both = np.concatenate([raw[:0:-1], raw])
    white = np.convolve(both, kernel, mode="same")[len(raw) - 1 :][:lags]
    return Spectrum(white * parzen(lags), whitening, 3.7 * total / lags)


def absorbed_by_fit(basis: Array, spans: Sequence[slice], longest: int) -> Array:
    """Autocovariance of the part of a joint's noise that a fit takes up, for noise of variance one.

    A fit is keenest where its columns have their power; what it takes out there is missing in the residual's spectrum.

    Parameters
    ----------
    basis : array, shape (N, r)
        The joint's rows of an orthonormal basis of the weighted columns.
    spans : sequence of slice
    longest : int
        Longest correlation to allow for, samples.
    """
    total = sum(s.stop - s.start for s in spans)
    lags = max(2, min(longest, total // 6))
    out = np.zeros(lags)
    for span in spans:
        size = fft.next_fast_len(span.stop - span.start + lags, real=True)
        power = (np.abs(fft.rfft(basis[span], size, axis=0)) ** 2).sum(axis=1)
        out += fft.irfft(power, size)[:lags]
    return out / max(total, 1) * parzen(lags)


def _autocovariance(parts: Sequence[Array], lags: int, absorbed: Array) -> Array:
    """Biased autocovariance over several stretches, from lag zero, with what a fit absorbed put back."""
    out = np.zeros(lags)
    for part in parts:
        size = fft.next_fast_len(max(len(part) + lags, 2 * len(absorbed), 2), real=True)
        missing = fft.rfft(_symmetric(absorbed, size)).real
        power = np.abs(fft.rfft(part, size)) ** 2 / (1.0 - np.clip(missing, 0.0, LARGEST_ABSORBED))
        out += fft.irfft(power, size)[:lags]
    return out / max(sum(len(p) for p in parts), 1)


def _autoregression(autocovariance: Array, samples: int) -> Array:
    """Prediction-error filter of the order that Akaike's criterion chooses (Levinson's recursion)."""
    best, chosen = np.inf, np.ones(1)
    error, filter_ = float(autocovariance[0]), np.ones(1)
    for order in range(len(autocovariance)):
        if error <= 1e-12 * autocovariance[0]:
            break
        criterion = samples * np.log(error) + 2 * order
        if criterion < best:
            best, chosen = criterion, filter_
        if order + 1 < len(autocovariance):
            reflection = -float(filter_ @ autocovariance[order + 1 : 0 : -1]) / error
            padded = np.append(filter_, 0.0)
            filter_ = padded + reflection * padded[::-1]
            error *= 1.0 - reflection**2
    return chosen


def parzen(lags: int) -> Array:
    """Parzen's lag window, from lag zero, shape (lags,)."""
    x = np.arange(lags) / lags
    return np.where(x <= 0.5, 1 - 6 * x**2 * (1 - x), 2 * (1 - x) ** 3)


def scatter(columns: Array, weights: Array, spectra: Sequence[Spectrum], spans: Sequence[slice]) -> Array:
    """Covariance of the weighted score, sum over joints of w_j^2 X_j' Sigma_j X_j.

    Parameters
    ----------
    columns : array, shape (N, joints, k)
    weights : array, shape (joints,)
        Inverse variances used in the fit.
    spectra : sequence of Spectrum, one a joint
    spans : sequence of slice
    """
    out = np.zeros((columns.shape[2],) * 2)
    for j, spectrum in enumerate(spectra):
        x = columns[:, j]
        if not x.any():
            continue
        for span in spans:
            out += weights[j] ** 2 * spectrum.product(x[span])
    return out
