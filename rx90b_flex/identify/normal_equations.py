"""Weighted least squares from products of columns and torque, one weight a joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.levenberg import ROUNDING

# A direction in parameter space whose scaled singular value is smaller than this part of the largest one is
# called undetermined: rounding leaves exact dependencies near 1e-8, and real data resolve nothing below 1e-5.
RANK_TOLERANCE = 1.0e-6
SURELY = 10.0  # times that, below which a pivot's root leaves it open whether a direction is determined
RIDGE = 1.0e-11  # of a column's square, where only the squares count that a solution leaves,
CORRECTIONS = 3  # and solutions with it, each for what the last ones left


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of columns and torque, apart for each block and each joint.

    Attributes
    ----------
    gram : array, shape (blocks, joints, p, p)
    cross : array, shape (blocks, joints, p)
    power : array, shape (blocks, joints)
    counts : array, shape (blocks,)
    """

    gram: Array
    cross: Array
    power: Array
    counts: Array

    @staticmethod
    def of(columns: Array, torque: Array, blocks: Sequence[slice]) -> NormalEquations:
        """Sum up ``columns`` (N, joints, p) and ``torque`` (N, joints)."""
        gram, cross, power = [], [], []
        for block in blocks:
            x = np.ascontiguousarray(columns[block].transpose(1, 0, 2))
            y = torque[block].T
            gram.append(x.transpose(0, 2, 1) @ x)
            cross.append((x.transpose(0, 2, 1) @ y[:, :, None])[:, :, 0])
            power.append((y**2).sum(axis=1))
        return NormalEquations(
            np.array(gram), np.array(cross), np.array(power), np.array([b.stop - b.start for b in blocks])
        )

    @staticmethod
    def by_joint(columns: ColumnsByJoint, torque: Array, blocks: Sequence[slice], count: int) -> NormalEquations:
        """Sum up columns, each in its own one of `count` places, and ``torque`` (joints, N)."""
        joints = len(torque)
        gram, cross = np.zeros((len(blocks), joints, count, count)), np.zeros((len(blocks), joints, count))
        for b, block in enumerate(blocks):
            for j, (at, x) in enumerate(zip(columns.places, columns.columns, strict=True)):
                part = x[block]
                gram[b, j][np.ix_(at, at)] = part.T @ part
                cross[b, j, at] = part.T @ torque[j, block]
        power = np.array([(torque[:, block] ** 2).sum(axis=1) for block in blocks])
        return NormalEquations(gram, cross, power, np.array([b.stop - b.start for b in blocks]))

    @cached_property
    def total(self) -> tuple[Array, Array, Array]:
        """Sums over blocks of gram, cross and power."""
        return self.gram.sum(axis=0), self.cross.sum(axis=0), self.power.sum(axis=0)

    def about(self, values: Array) -> NormalEquations:
        """Of the torque less that of some values of the parameters (p,)."""
        taken = self.gram @ values
        power = self.power + (taken - 2.0 * self.cross) @ values
        return NormalEquations(self.gram, self.cross - taken, power, self.counts)

    def grouped(self, groups: Sequence[Indices]) -> NormalEquations:
        """With blocks put together."""
        arrays = (self.gram, self.cross, self.power, self.counts)
        return NormalEquations(*(np.array([x[at].sum(axis=0) for at in groups]) for x in arrays))

    def squares(self, theta: Array) -> Array:
        """Sum of squared errors of each joint, shape (joints,)."""
        gram, cross, power = self.total
        return np.maximum(power - 2 * cross @ theta + (gram @ theta) @ theta, 0.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of weighted normal equations, worked out where it is asked for: many fits on a way are asked for `sigma` alone.

    Attributes
    ----------
    sigma : array, shape (joints,)
        Residual standard deviation a joint; the weights are ``1 / sigma^2``.
    gram, cross : array, shape (p, p) and (p,)
        Of the equations.
    prior : array, shape (p,)
    """

    sigma: Array
    gram: Array
    cross: Array
    prior: Array

    @cached_property
    def _solved(self) -> tuple[Array, Array, Array, Array]:
        return solve_weighted(self.gram, self.cross, self.prior)

    @property
    def theta(self) -> Array:
        """Where the data says nothing, as near to the prior as the rest allows; shape (p,)."""
        return self._solved[0]

    @property
    def inverse(self) -> Array:
        """Pseudo-inverse of the weighted Gram matrix, shape (p, p)."""
        return self._solved[1]

    @property
    def null(self) -> Array:
        """Directions that the data does not determine, in scaled parameters (orthonormal), shape (p, m)."""
        return self._solved[2]

    @property
    def scale(self) -> Array:
        """Scaled parameter = parameter * scale, shape (p,)."""
        return self._solved[3]

    @property
    def rank(self) -> int:
        """Number of parameter combinations that the data determines."""
        return len(self.theta) - self.null.shape[1]

    @property
    def determined(self) -> Mask:
        """Whether each parameter is determined by itself, shape (p,), bool."""
        return np.linalg.norm(self.null, axis=1) < 1e-3


def column_scale(squares: Array) -> Array:
    """Lengths of columns from their squares, shape (p,).

    A column of nothing but rounding gets the longest one's: brought to length one, it would count as determined.
    """
    largest = float(squares.max(initial=0.0))
    return np.sqrt(np.where(squares > ROUNDING**2 * largest, squares, largest if largest > 0.0 else 1.0))


def solve_weighted(gram: Array, cross: Array, prior: Array) -> tuple[Array, Array, Array, Array]:
    """Least squares from normal equations, staying at the prior where they are singular.

    Returns theta, the pseudo-inverse of `gram`, null directions (scaled), and the scale.
    """
    scale = column_scale(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    largest = values[-1] if len(values) else 0.0
    kept = values > RANK_TOLERANCE**2 * max(largest, 1e-300)
    # a column of zeros scales to a zero row: it falls to the null directions by itself
    basis = vectors[:, kept]
    inverse = (basis / values[kept]) @ basis.T / np.outer(scale, scale)
    theta = prior + inverse @ (cross - gram @ prior)
    return theta, inverse, vectors[:, ~kept], scale


def solved(gram: Array, cross: Array, prior: Array) -> tuple[Array, Array]:
    """The first two of what `solve_weighted` gives: by Cholesky's factors, several times as fast, where all is determined."""
    if not len(gram):
        return prior, gram
    scale = column_scale(np.diag(gram))
    factor, failed = linalg.lapack.dpotrf(gram / np.outer(scale, scale), lower=1)
    if failed or not (np.diag(factor) > SURELY * RANK_TOLERANCE).all():
        return solve_weighted(gram, cross, prior)[:2]
    lower, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = (lower + np.tril(lower, -1).T) / np.outer(scale, scale)
    return prior + inverse @ (cross - gram @ prior), inverse


def dependent(gram: Array) -> Indices:
    """Columns (d,) for which others can stand, by their products (p, p): the last ones of Cholesky's factors with pivots."""
    scale = column_scale(np.diag(gram))
    _, pivots, rank, _ = linalg.lapack.dpstrf(gram / np.outer(scale, scale), tol=RANK_TOLERANCE**2 * len(gram))
    return np.sort(pivots[rank:] - 1)


def coefficients(gram: Array, cross: Array, prior: Array) -> Array:
    """The first of what `solve_weighted` gives, without its rank: by Cholesky's factors, a touch of ridge and its correction.

    Of one right-hand side (p,), or several (p, k).
    """
    if not len(prior):
        return np.zeros(prior.shape)
    scale = column_scale(np.diag(gram))
    scaled = gram / np.outer(scale, scale)
    factor, failed = linalg.lapack.dpotrf(scaled + RIDGE * np.eye(len(scaled)))
    if failed:
        return solve_weighted(gram, cross, prior)[0]
    asked = ((cross - gram @ prior).T / scale).T
    found = np.zeros(prior.shape)
    for _ in range(CORRECTIONS):
        found = found + linalg.lapack.dpotrs(factor, asked - scaled @ found)[0]
    return np.asarray(prior + (found.T / scale).T)


def fit_weighted(
    normal: NormalEquations,
    prior: Array,
    sigma: Array | None = None,
    rounds: int = 12,
    precision: Array | None = None,
    centre: Array | None = None,
) -> Solution:
    """Weighted least squares, one weight a joint from its own residual, iterated.

    Parameters
    ----------
    normal : NormalEquations
    prior : array, shape (p,)
        Values to stay near where the data says nothing.
    sigma : array, shape (joints,), optional
        Fixed residual standard deviations; they are iterated where not given.
    precision : array, shape (p, p), optional
        Inverse covariance of the coefficients before the data: a penalty.
    centre : array, shape (p,), optional
        What it pulls to; zero where not given.
    """
    gram, cross, power = normal.total
    before = np.zeros((len(prior), len(prior))) if precision is None else precision
    pulled = 0.0 if centre is None else before @ centre
    samples = int(normal.counts.sum())
    fixed = sigma is not None
    # noise-free data must not make one joint's weight infinite
    smallest = 1e-9 * np.sqrt(power / samples) + 1e-12
    current = np.sqrt(power / samples) + smallest if sigma is None else np.asarray(sigma, dtype=float)

    def weighted() -> tuple[Array, Array]:
        weight = current**-2.0
        return np.tensordot(weight, gram, axes=1) + before, weight @ cross + pulled

    last = weighted()
    for _ in range(0 if fixed else rounds):
        last = weighted()
        squares = normal.squares(coefficients(*last, prior))
        new = np.maximum(np.sqrt(squares / samples), smallest)
        done = np.abs(new / current - 1).max() < 1e-4
        current = new
        if done:
            break
    return Solution(current, *last, prior)


def squares_left(normal: NormalEquations, prior: Array, sigma: Array, precision: Array, centre: Array) -> float:
    """Sum of squares over given variances, and of the penalty by a precision (p, p) about a centre, at the best coefficients."""
    gram, cross, _ = normal.total
    weight = sigma**-2.0
    pulled = weight @ cross + precision @ centre
    theta = coefficients(np.tensordot(weight, gram, axes=1) + precision, pulled, prior)
    return float(normal.squares(theta) @ weight + (theta - centre) @ precision @ (theta - centre))


def squares_held_out(normal: NormalEquations, prior: Array, sigma: Array, precision: Array, centre: Array) -> float:
    """Sum of squares over given variances on each block at the coefficients that are best on the others; arguments as above."""
    weight = sigma**-2.0
    grams, crosses = np.einsum("j,bjpq->bpq", weight, normal.gram), np.einsum("j,bjp->bp", weight, normal.cross)
    gram, cross = grams.sum(axis=0) + precision, crosses.sum(axis=0) + precision @ centre
    left = float((normal.power @ weight).sum())
    for g, c in zip(grams, crosses, strict=True):
        theta = coefficients(gram - g, cross - c, prior)
        left += float(theta @ g @ theta - 2.0 * c @ theta)
    return left
