"""Covariances of least-squares estimates whose residuals are correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from rx90b_flex.effects.motion import Array


@dataclass(frozen=True)
class Spectrum:
    """Smoothed spectrum of one residual: a lag-window estimate (Parzen's window).

    Attributes
    ----------
    autocovariance : array, shape (M,)
        Tapered, from lag zero.
    degrees_of_freedom : float
        Of the estimate, 3.7 N / M.
    """

    autocovariance: Array
    degrees_of_freedom: float

    def product(self, columns: Array) -> Array:
        """``columns.T @ Sigma @ columns`` with the Toeplitz matrix Sigma of this spectrum; (N, k) -> (k, k)."""
        samples = len(columns)
        size = fft.next_fast_len(samples + len(self.autocovariance), real=True)
        density = fft.rfft(_symmetric(self.autocovariance, size)).real
        spectra = fft.rfft(columns, size, axis=0)
        # one-sided: every line but the first (and the middle one) stands for two
        weight = np.full(len(density), 2.0)
        weight[0] = 1.0
        if size % 2 == 0:
            weight[-1] = 1.0
        weight *= np.maximum(density, 0.0) / size
        return ((spectra.conj() * weight[:, None]).T @ spectra).real


def _symmetric(lags: Array, size: int) -> Array:
    out = np.zeros(size)
    count = min(len(lags), size // 2)
    out[:count] = lags[:count]
    out[size - count + 1 :] = lags[count - 1 : 0 : -1]
    return out


def residual_spectrum(residual: Array, spans: Sequence[slice], fitted_parameters: float, longest: int) -> Spectrum:
    """Spectrum of one joint's residual.

    Parameters
    ----------
    residual : array, shape (N,)
    spans : sequence of slice
        Stretches that do not follow each other in time.
    fitted_parameters : float
        How many parameters were fitted to these samples: the residual is smaller than the noise by them.
    longest : int
        Longest correlation to allow for, samples.
    """
    total = sum(s.stop - s.start for s in spans)
    lags = max(2, min(longest, total // 6))
    autocovariance = np.zeros(lags)
    for span in spans:
        part = residual[span]
        size = fft.next_fast_len(len(part) + lags, real=True)
        power = np.abs(fft.rfft(part, size)) ** 2
        autocovariance += fft.irfft(power, size)[:lags]
    autocovariance /= max(total - fitted_parameters, 1.0)
    return Spectrum(autocovariance * _parzen(lags), 3.7 * total / lags)


def _parzen(lags: int) -> Array:
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
