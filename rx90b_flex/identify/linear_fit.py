"""Least squares on plain columns, with what is left and how it makes the coefficients uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.coloured import residual_spectrum

NOTHING = 1.0e-12  # length of a column over the longest one's below which there is nothing in it


@dataclass(frozen=True, eq=False)
class LinearFit:
    """``target = columns @ theta + residual``, by normal equations of columns of one length; a column of nothing gets zero.

    Attributes
    ----------
    columns : array, shape (N, k)
    theta : array, shape (k,)
    inverse : array, shape (k, k)
        Of the normal equations: the coefficients' covariance for independent noise of variance 1.
    residual : array, shape (N,)
    """

    columns: Array
    theta: Array
    inverse: Array
    residual: Array

    @classmethod
    def of(cls, columns: Array, target: Array) -> LinearFit:
        """Of columns (N, k) and a target (N,)."""
        scale = np.sqrt((columns**2).sum(axis=0))
        scale = np.where(scale > NOTHING * scale.max(initial=0.0), scale, np.inf)
        inverse = np.linalg.pinv((columns / scale).T @ (columns / scale), rcond=1e-12) / np.outer(scale, scale)
        theta = inverse @ (columns.T @ target)
        return cls(columns, theta, inverse, target - columns @ theta)

    @property
    def squares(self) -> float:
        """Of the residual."""
        return float((self.residual**2).sum())

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return len(self.residual) - len(self.theta)

    @property
    def noise(self) -> float:
        """Standard deviation of independent noise, as the residual shows it."""
        return float(np.sqrt(self.squares / self.freedom))

    @property
    def std(self) -> Array:
        """Standard deviations of the coefficients for such noise, (k,)."""
        return np.asarray(self.noise * np.sqrt(np.diag(self.inverse)))

    def coloured_covariance(self, spans: Sequence[slice], longest: int) -> Array:
        """Of the coefficients, (k, k), for noise of the colour that the residual has within some rows, over `longest` samples."""
        spectrum = residual_spectrum(self.residual, spans, np.zeros(1), longest)
        score = np.asarray(sum(spectrum.product(self.columns[rows]) for rows in spans))
        return np.asarray(self.inverse @ score @ self.inverse)


def weighted_mean(values: Array, stds: Array) -> tuple[float, float, float]:
    """Of independent estimates of one number: mean, standard deviation, and the probability that they differ so much or more."""
    weight = stds**-2.0
    mean = weight @ values / weight.sum()
    p_value = stats.chi2.sf((((values - mean) / stds) ** 2).sum(), max(len(values) - 1, 1))
    return float(mean), float(1.0 / np.sqrt(weight.sum())), float(p_value)
