"""How sure weighted least squares are of what they estimate, under coloured noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.identify.coloured import Spectrum, absorbed_by_fit, residual_spectra, widening
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.normal_equations import RANK_TOLERANCE, column_scale, solve_weighted


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How sure a fit is, worked out where it is asked for: most fits of a search are left for better ones before.

    Attributes
    ----------
    estimated : ColumnsByJoint
        Derivatives of the torque by all that was estimated, e places.
    free : array of int, shape (e,)
        Where these stand among theta and the shape parameters.
    size : int
        Number of the latter, p + s.
    precision : array, shape (e, e)
        Inverse covariance before the data.
    sigma : array, shape (rows,)
        Residual standard deviations.
    residual : array, shape (rows, N)
        Torque left over, each row over the root of the part of its samples that counts.
    spans : tuple of slice
        Samples of each segment.
    alike : callable
        `Regression.alike`, (N, rows), where a covariance is wanted.
    longest : int
        Longest correlation to allow for, samples.
    known : bool
        Whether a covariance is wanted; else it is zero.
    held : ColumnsByJoint
        Derivatives by what the fit leaves as it is, in all p + s places.
    variance : array, shape (p + s,)
        Of that, before the data; elsewhere zero.
    """

    estimated: ColumnsByJoint
    free: Indices
    size: int
    precision: Array
    sigma: Array
    residual: Array
    spans: tuple[slice, ...]
    alike: Callable[[], Array]
    longest: int
    known: bool
    held: ColumnsByJoint
    variance: Array

    @cached_property
    def absorbed(self) -> list[Array]:
        """What the fit took out of each row's noise (`absorbed_by_fit`)."""
        return absorbed_each(self.estimated, self.precision, self.sigma**-2.0, self.spans, self.longest)

    @cached_property
    def spectra(self) -> tuple[Spectrum, ...]:
        """Of the residual, one a row."""
        return residual_spectra(self.residual, self.spans, self.absorbed, self.longest)

    @cached_property
    def covariance(self) -> Array:
        """Of theta and the shape parameters, (p + s, p + s)."""
        out = np.zeros((self.size, self.size))
        if self.known:
            own = coloured_covariance(
                self.estimated, self.precision, self.sigma, self.spectra, self.spans, self.alike()
            )
            out[np.ix_(self.free, self.free)] = own
            out += self._of_held
        return out

    @property
    def _of_held(self) -> Array:
        """What is not known of what the fit leaves as it is, and what that does to the rest; (p + s, p + s)."""
        at = np.flatnonzero(self.variance)
        moved = np.zeros((self.size, len(at)))
        if len(at):
            weight, own = self.sigma**-2.0, self.estimated.gram(self.sigma**-2.0, len(self.free)) + self.precision
            across = self.held.gram(weight, self.size)[np.ix_(self.free, at)]
            zero = np.zeros(len(own))
            moved[self.free] = -solve_weighted(own, zero, zero)[1] @ across
            moved[at, np.arange(len(at))] = 1.0
        return (moved * self.variance[at]) @ moved.T


def absorbed_each(
    columns: ColumnsByJoint, precision: Array, weight: Array, spans: Sequence[slice], longest: int
) -> list[Array]:
    """`absorbed_by_fit` of each joint, for columns fitted with inverse variances `weight` and a precision (p, p) before the data."""
    gram = columns.gram(weight, len(precision)) + precision
    scale = column_scale(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = values > RANK_TOLERANCE**2 * max(values[-1] if len(values) else 0.0, 1e-300)
    to_basis = vectors[:, kept] / scale[:, None] / np.sqrt(values[kept])
    # of a joint's rows only as many combinations count as it has columns
    turned = [np.asarray(np.linalg.qr(to_basis[at].T, mode="r")).T for at in columns.places]
    each = zip(weight, turned, columns.columns, strict=True)
    return [absorbed_by_fit(x @ (np.sqrt(w) * to_own), spans, longest) for w, to_own, x in each]


def coloured_covariance(
    columns: ColumnsByJoint,
    precision: Array,
    sigma: Array,
    spectra: Sequence[Spectrum],
    spans: Sequence[slice],
    alike: Array | None = None,
) -> Array:
    """Covariance of weighted least-squares estimates of columns under coloured noise: (A + P)^-1 (S + P) (A + P)^-1.

    A is the weighted Gram matrix, S the covariance of the weighted score, in which errors that many rows have in common, `alike`
    (N, rows), count as if all their parts had one sign; P the precision (p, p) before the data: with it the bias of
    penalised coefficients counts (D. Nychka, Journal of the American Statistical Association 83, 1988). Undetermined directions count
    as zero.
    """
    weight, count = sigma**-2.0, len(precision)
    _, inverse, _, _ = solve_weighted(columns.gram(weight, count) + precision, np.zeros(count), np.zeros(count))
    score = np.array(precision)
    common = np.zeros((len(weight), 1)) if alike is None else alike.T
    for w, at, x, spectrum, off in zip(weight, columns.places, columns.columns, spectra, common, strict=True):
        if off.any():
            score[np.ix_(at, at)] += w * (x.T * off) @ x
        for span in spans:
            score[np.ix_(at, at)] += w**2 * spectrum.product(x[span])
    return widening(spectra) * inverse @ score @ inverse
