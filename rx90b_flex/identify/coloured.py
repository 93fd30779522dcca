"""Covariances of least-squares estimates whose residuals are correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, stats

from rx90b_flex.compiled.signals import prediction_error_filter
from rx90b_flex.effects.motion import Array

LARGEST_ORDER = 24  # of the autoregression that takes out most of a residual's colour
INTERVAL = 0.95  # whose limits 1.96 standard deviations are
TOGETHER = 2  # columns that are transformed at once: of a long log all would take room
SPECTRA_BYTES = 2e7  # of transformed columns at a time; the others are transformed once more
# Of a spectrum with what the fit absorbed put back: what is missing after each is missed by the next as well.
ROUNDS = 3


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
        density = self.density(size)
        # one-sided: every line but the first (and the middle one) stands for two
        weight = np.full(len(density), 2.0)
        weight[0] = 1.0
        if size % 2 == 0:
            weight[-1] = 1.0
        root, count = np.sqrt(weight * density / size), columns.shape[1]
        out = np.zeros((count, count))
        passes = 1 + int(16 * count * len(density) / SPECTRA_BYTES)
        for lines in np.array_split(np.arange(len(density)), passes):
            inside = slice(lines[0], lines[-1] + 1)
            spectra = np.empty((count, len(lines)), dtype=complex)
            for at in range(0, count, TOGETHER):
                some = slice(at, at + TOGETHER)
                spectra[some] = fft.rfft(np.ascontiguousarray(columns[:, some].T), size)[:, inside]
            spectra *= root[inside]
            parts = spectra.view(float)  # real and imaginary
            out += parts @ parts.T
        return out

    def density(self, size: int) -> Array:
        """At the lines of a transform of so many samples, over that of white noise of variance one; (size // 2 + 1,)."""
        return np.asarray(_densities([self], size)[0])


def _symmetric(lags: Array, size: int) -> Array:
    out = np.zeros(size)
    count = min(len(lags), size // 2)
    out[:count] = lags[:count]
    out[size - count + 1 :] = lags[count - 1 : 0 : -1]
    return out


def residual_spectrum(residual: Array, spans: Sequence[slice], absorbed: Array, longest: int) -> Spectrum:
    """As `residual_spectra`, of one joint: its residual (N,) and what the fit absorbed of it (lines,)."""
    return residual_spectra(residual[None], spans, [absorbed], longest)[0]


def residual_spectra(
    residual: Array, spans: Sequence[slice], absorbed: Sequence[Array], longest: int
) -> tuple[Spectrum, ...]:
    """Spectra of the noise behind the joints' residuals.

    What the fit took out of the noise at a frequency is put back there in proportion to the noise's own spectrum, which is not known
    before: it is estimated, put back and estimated again (expectation and maximisation). Put back by a smoothed share, steep spectra
    would come out too low where the columns have their power, and estimates too certain.

    Parameters
    ----------
    residual : array, shape (joints, N)
    spans : sequence of slice
        Segments that do not follow each other in time.
    absorbed : sequence of array, shape (lines,)
        What the fit took out of each joint's noise (`absorbed_by_fit`); zeros where nothing was fitted.
    longest : int
        Longest correlation to allow for, samples.
    """
    lags = _lags(spans, longest)
    sizes = _sizes(spans, lags)
    total = sum(s.stop - s.start for s in spans)
    powers = [np.abs(fft.rfft(residual[:, s], size)) ** 2 for s, size in zip(spans, sizes, strict=True)]
    spectra = _smoothed(powers, sizes, lags, total)
    fitted = [j for j, a in enumerate(absorbed) if a.any()]
    if not fitted:
        return spectra
    ends = np.cumsum([p.shape[1] for p in powers])[:-1]
    missing = np.split(np.array([absorbed[j] for j in fitted]), ends, axis=1)
    powers, found = [p[fitted] for p in powers], tuple(spectra[j] for j in fitted)
    for _ in range(ROUNDS):
        whole = [p + m * _densities(found, n) for p, m, n in zip(powers, missing, sizes, strict=True)]
        found = _smoothed(whole, sizes, lags, total)
    put_back = dict(zip(fitted, found, strict=True))
    return tuple(put_back.get(j, known) for j, known in enumerate(spectra))


def _smoothed(powers: Sequence[Array], sizes: Sequence[int], lags: int, total: int) -> tuple[Spectrum, ...]:
    """From the squared transforms (joints, lines) of several segments, of `total` samples together."""
    count = lags + LARGEST_ORDER
    raw = np.zeros((len(powers[0]), count))
    for power, size in zip(powers, sizes, strict=True):
        raw += fft.irfft(power, size)[:, :count]
    raw /= max(total, 1)
    window = parzen(lags)
    return tuple(_prewhitened(of_one, window, total) for of_one in raw)


def _prewhitened(raw: Array, window: Array, total: int) -> Spectrum:
    """From an autocovariance, its lags beyond those of the window there for the prewhitening."""
    lags = len(window)
    whitening = prediction_error_filter(raw[: min(LARGEST_ORDER, lags - 1) + 1], total)
    # the autocovariance of the prewhitened residual follows from its own: twice through the filter
    kernel = np.correlate(whitening, whitening, mode="full")
    both = np.concatenate([raw[:0:-1], raw])
    white = np.convolve(both, kernel, mode="same")[len(raw) - 1 :][:lags]
    return Spectrum(white * window, whitening, 3.7 * total / lags)


def _densities(spectra: Sequence[Spectrum], size: int) -> Array:
    """`Spectrum.density` of several, (joints, size // 2 + 1)."""
    lags = np.stack([_symmetric(s.autocovariance, size) for s in spectra])
    filters = np.zeros((len(spectra), LARGEST_ORDER + 1))
    for row, s in zip(filters, spectra, strict=True):
        row[: len(s.filter)] = s.filter
    return np.asarray(np.maximum(fft.rfft(lags).real, 0.0) / np.abs(fft.rfft(filters, size)) ** 2)


def _lags(spans: Sequence[slice], longest: int) -> int:
    """Length of the lag window: no more than a sixth of the samples."""
    return max(2, min(longest, sum(s.stop - s.start for s in spans) // 6))


def _sizes(spans: Sequence[slice], lags: int) -> list[int]:
    """Of the transforms of each segment: room for the correlation, so that the ends do not meet."""
    return [fft.next_fast_len(max(s.stop - s.start + lags + LARGEST_ORDER, 2 * lags), real=True) for s in spans]


def absorbed_by_fit(basis: Array, spans: Sequence[slice], longest: int) -> Array:
    """Squared transform of the part of a joint's noise that a fit takes up, for white noise of variance one.

    A fit is keenest where its columns have their power; what it takes out there is missing in the residual's spectrum.

    Parameters
    ----------
    basis : array, shape (N, r)
        The joint's rows of an orthonormal basis of the weighted columns.
    spans : sequence of slice
    longest : int
        Longest correlation to allow for, samples.

    Returns
    -------
    array, shape (lines,)
        Lines of all segments, one segment after the other, as `residual_spectrum` has them.
    """
    sizes = _sizes(spans, _lags(spans, longest))
    parts = [np.zeros(size // 2 + 1) for size in sizes]
    for part, span, size in zip(parts, spans, sizes, strict=True):
        for at in range(0, basis.shape[1], TOGETHER):
            part += (np.abs(fft.rfft(basis[span, at : at + TOGETHER], size, axis=0)) ** 2).sum(axis=1)
    return np.concatenate(parts)


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


def widening(spectra: Sequence[Spectrum]) -> float:
    """Factor of covariances that are worked out with estimated spectra.

    An estimate over its estimated standard deviation follows Student's distribution: with as few degrees of freedom as the least
    known spectrum has, 95 % of it lie within more than 1.96. A covariance times this keeps 1.96 standard deviations the limits
    of 95 %.
    """
    freedom = min(s.degrees_of_freedom for s in spectra)
    upper = 0.5 * (1.0 + INTERVAL)
    return float((stats.t.ppf(upper, freedom) / stats.norm.ppf(upper)) ** 2)
