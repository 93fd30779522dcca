"""The present model as normal equations, block by block: what a candidate is held against."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.normal_equations import NormalEquations, dependent, solved
from rx90b_flex.identify.penalty import parameters_used

LEAK = 0.02  # of what is left out which a fit to the rest sees all the same: what that leaves open must not run away
DETERMINED = 1.0e-5  # part of a column's square that the model must leave for it to count as its own


@dataclass(frozen=True, eq=False)
class SharedColumns:
    """Columns of the present model and their products, which all bases have in common."""

    columns: ColumnsByJoint
    target: Array  # (joints, N)
    weight: Array
    blocks: tuple[slice, ...]
    precision: Array  # (p, p) inverse covariance of coefficients before the data: penalties, and sizes of shapes
    theta: Array  # (p,) coefficients of the present model
    links: int = 0  # of the columns, the first ones

    @cached_property
    def spare(self) -> tuple[Indices, Array]:
        """Columns of links (d,) for which others can stand in all that a base explains, and coefficients (p,) without them."""
        own, theta = slice(self.links), self.theta.copy()
        none = np.zeros(0, dtype=np.intp)
        if not self.links or self.precision[own].any():
            return none, theta
        gram = np.einsum("j,bjpq->pq", self.weight, self.normal.gram[:, :, own, own])
        out = dependent(gram)
        rest = np.setdiff1d(np.arange(self.links), out)
        theta[rest] += solved(gram[np.ix_(rest, rest)], gram[np.ix_(rest, out)] @ theta[out], np.zeros(len(rest)))[0]
        theta[out] = 0.0
        return out, theta

    @cached_property
    def normal(self) -> NormalEquations:
        return NormalEquations.by_joint(self.columns, self.target, self.blocks, len(self.precision))

    def at(self, samples: Indices) -> SharedColumns:
        """Of some samples, in one block."""
        blocks = (slice(0, len(samples)),)
        return dataclasses.replace(
            self, columns=self.columns.at(samples), target=self.target[:, samples], blocks=blocks
        )


@dataclass(frozen=True, eq=False)
class Base:
    """The present model (perhaps without an effect that a candidate replaces), with all that a trial needs of it."""

    shared: SharedColumns
    kept: Indices  # places of the base's columns among the shared ones
    prior: Array

    @property
    def weight(self) -> Array:
        """Inverse variance of each joint's residual."""
        return self.shared.weight

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.kept)

    @cached_property
    def grams(self) -> Array:
        """Weighted Gram matrices, shape (blocks, p, p)."""
        whole = np.einsum("j,bjpq->bpq", self.weight, self.shared.normal.gram)
        whole = whole + self.shared.precision / len(whole)
        return whole[:, self.kept[:, None], self.kept]

    @cached_property
    def crosses(self) -> Array:
        return np.einsum("j,bjp->bp", self.weight, self.shared.normal.cross)[:, self.kept]

    @cached_property
    def powers(self) -> Array:
        return self.shared.normal.power @ self.weight

    @cached_property
    def whole(self) -> tuple[Array, Array]:
        """Coefficients and pseudo-inverse on all blocks."""
        return solved(self.grams.sum(axis=0), self.crosses.sum(axis=0), self.prior)

    @cached_property
    def without(self) -> tuple[Array, Array]:
        """Coefficients and pseudo-inverse with each block held out but for a trace; shapes (blocks, p) and (blocks, p, p)."""
        gram, cross = self.grams.sum(axis=0), self.crosses.sum(axis=0)
        part = 1.0 - LEAK
        found = [
            solved(gram - part * g, cross - part * c, self.prior) for g, c in zip(self.grams, self.crosses, strict=True)
        ]
        theta, inverse = zip(*found, strict=True)
        return np.array(theta), np.array(inverse)

    @cached_property
    def held_out(self) -> Array:
        """Weighted squared error on each block when it is held out, shape (blocks,)."""
        theta, _ = self.without
        predicted = times(self.grams, theta)
        return np.asarray(self.powers + ((predicted - 2 * self.crosses) * theta).sum(axis=1))

    def held_out_beside(self, b: Array, y: Array, d: Array, precision: Array) -> Array:
        """The same with a candidate, both fitted to the other blocks, from its `products` on each; shape (blocks,).

        Parameters
        ----------
        b, y, d : array, shape (blocks, p, k), (blocks, k) and (blocks, k, k)
        precision : array, shape (k, k)
            Of the candidate's coefficients before the data.
        """
        theta, inverse = self.without
        bb, yy, dd = (x.sum(axis=0) - (1.0 - LEAK) * x for x in (b, y, d))
        across = inverse @ bb
        turned = np.swapaxes(bb, 1, 2)
        beta = solve_beside(dd - turned @ across, dd, yy - times(turned, theta), precision)
        new = theta - times(across, beta)
        return np.asarray(
            self.powers
            - 2 * ((self.crosses * new).sum(axis=1) + (y * beta).sum(axis=1))
            + (new * times(self.grams, new)).sum(axis=1)
            + 2 * (new * times(b, beta)).sum(axis=1)
            + (beta * times(d, beta)).sum(axis=1)
        )

    @cached_property
    def _grouped(self) -> dict[tuple[tuple[int, ...], ...], Base]:
        return {}

    def grouped(self, groups: Sequence[Indices]) -> Base:
        """With blocks put together."""
        key = tuple(tuple(at.tolist()) for at in groups)
        if key not in self._grouped:  # every trial asks for it
            self._grouped[key] = self._of_groups(groups)
        return self._grouped[key]

    def _of_groups(self, groups: Sequence[Indices]) -> Base:
        other = dataclasses.replace(self, shared=dataclasses.replace(self.shared))
        other.shared.__dict__["normal"] = self.shared.normal.grouped(groups)
        return other

    @cached_property
    def residual(self) -> Array:
        """What the base leaves of the torque, shape (joints, N)."""
        return self.shared.target - self._times(self.whole[0])

    def _times(self, theta: Array) -> Array:
        """The base's columns times coefficients (p,) or (p, k); shape (joints, N) or (joints, N, k)."""
        full = np.zeros((len(self.shared.precision), *theta.shape[1:]))
        full[self.kept] = theta
        return self.shared.columns.times(full)

    @cached_property
    def squares(self) -> Array:
        """Weighted squared error of each joint on all blocks."""
        return self.weight * (self.residual**2).sum(axis=1)

    def with_base(self, rows: Indices, columns: Array, samples: slice = slice(None)) -> Array:
        """Weighted products of the base's columns with candidate ones (N, rows, k); shape (p, k)."""
        out = np.zeros((len(self.shared.precision), columns.shape[2]))
        own = self.shared.columns
        for i, j in enumerate(rows):  # none where a candidate has nothing to act on
            out[own.places[j]] += self.weight[j] * (own.columns[j][samples].T @ columns[samples, i])
        return out[self.kept]

    def products(self, rows: Indices, columns: Array, block: slice) -> tuple[Array, Array, Array]:
        """Weighted products of candidate columns (N, rows, k) on one block: with the base's, the torque, themselves."""
        c, weight = columns[block], self.weight[rows]
        weighted = np.ascontiguousarray((c * weight[:, None]).transpose(1, 0, 2))
        score = sum(x.T @ y for x, y in zip(weighted, self.shared.target[rows, block], strict=True))
        own = sum(x.T @ c[:, i] for i, x in enumerate(weighted))
        return self.with_base(rows, columns, block), np.asarray(score), np.asarray(own)

    def apart(self, rows: Indices, columns: Array) -> Array:
        """What of candidate columns (N, rows, k) the base does not explain, shape (joints, N, k)."""
        _, inverse = self.whole
        out = -self._times(inverse @ self.with_base(rows, columns))
        out[rows] += columns.transpose(1, 0, 2)
        return out

    def projected(self, rows: Indices, columns: Array) -> tuple[Array, Array, Array]:
        """Weighted Gram matrix of candidate columns (N, rows, k) less the base's part, and with it, (k, k); score (k,)."""
        weighted = columns * np.sqrt(self.weight[rows])[:, None]
        flat = weighted.transpose(1, 0, 2).reshape(-1, columns.shape[2])
        own = flat.T @ flat
        with_base = self.with_base(rows, columns)
        return own - with_base.T @ self.whole[1] @ with_base, own, self._score(rows, columns)

    def gains(self, rows: Indices, columns: Array, k: int) -> Array:
        """Drop of the weighted squared error for many candidates of k columns each; (N, rows, M * k) -> (M,)."""
        _, inverse = self.whole
        many = columns.shape[2] // k
        with_base = self.with_base(rows, columns).reshape(-1, many, k)
        own = _products((columns * np.sqrt(self.weight[rows])[:, None]).reshape(-1, many, k))
        left = own - _products(with_base, np.tensordot(inverse, with_base, axes=1))
        score = self._score(rows, columns).reshape(many, k)
        return np.asarray((score * solve_beside(left, own, score)).sum(axis=1))

    def _score(self, rows: Indices, columns: Array) -> Array:
        out = np.zeros(columns.shape[2])
        for i, j in enumerate(rows):
            out += self.weight[j] * (self.residual[j] @ columns[:, i])
        return out


def _products(x: Array, y: Array | None = None) -> Array:
    """Of the columns of many candidates, each with its own, (N, M, k) twice; shape (M, k, k)."""
    y = x if y is None else y
    out = np.empty((x.shape[1], x.shape[2], y.shape[2]))
    for i, j in np.ndindex(out.shape[1:]):
        out[:, i, j] = np.einsum("nm,nm->m", x[:, :, i], y[:, :, j])
    return out


def solve_beside(left: Array, own: Array, score: Array, precision: Array | None = None) -> Array:
    """Coefficients (..., k) of columns that are partly explained by the base; what is wholly explained gets zero.

    Parameters
    ----------
    left, own : array, shape (..., k, k)
        Gram matrices of the columns less the base's part, and with it.
    score : array, shape (..., k)
    precision : array, shape (k, k), optional
        Of the coefficients before the data: they are penalised.
    """
    scale, scaled = _scaled(left if precision is None else left + precision, own)
    if scaled.shape[-1] == 1:  # most of them
        values, vectors = scaled[..., 0], np.ones_like(scaled)
    else:
        values, vectors = np.linalg.eigh(scaled)
    along = times(np.swapaxes(vectors, -1, -2), score / scale)
    kept = values > DETERMINED
    along = np.where(kept, along / np.where(kept, values, 1.0), 0.0)
    return times(vectors, along) / scale


def _scaled(left: Array, own: Array) -> tuple[Array, Array]:
    """Lengths of columns (..., k), and a Gram matrix (..., k, k) with them taken out."""
    scale = np.sqrt(np.maximum(np.diagonal(own, axis1=-2, axis2=-1), 1e-300))
    return scale, left / (scale[..., :, None] * scale[..., None, :])


def parameters_told(left: Array, own: Array, precision: Array) -> float:
    """How many parameters the coefficients of `solve_beside` come to: combinations that the base wholly explains are none."""
    if precision.any():
        return parameters_used(left, precision)
    return float((np.linalg.eigvalsh(_scaled(left, own)[1]) > DETERMINED).sum())


def times(matrices: Array, vectors: Array) -> Array:
    """Matrices (..., m, n) times vectors (..., n), each its own; shape (..., m)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def wald(bread: Array, meat: Array, own: Array, beta: Array, tolerance: float) -> tuple[float, int, Array]:
    """Wald statistic of the determined combinations of coefficients, their number, and the covariance.

    `own` (k,) are the squares of the candidate's columns before the base took its part: what is left of one is judged
    against that, so that a column which the base explains wholly does not come back as rounding.
    """
    scale = np.sqrt(np.maximum(own, 1e-300))
    values, vectors = np.linalg.eigh(bread / np.outer(scale, scale))
    kept = values > tolerance
    basis = vectors[:, kept] / scale[:, None]
    inverse = (basis / values[kept]) @ basis.T
    covariance = inverse @ meat @ inverse
    along = vectors[:, kept] * scale[:, None]
    combined = along.T @ beta
    statistic = combined @ np.linalg.pinv(along.T @ covariance @ along, rcond=1e-10, hermitian=True) @ combined
    return float(statistic), int(kept.sum()), covariance


def penalised_wald(bread: Array, meat: Array, own: Array, precision: Array, beta: Array) -> tuple[float, int, Array]:
    """Wald statistic of the combinations of penalised coefficients that the data say more of than the penalty, their number,
    and the coefficients' covariance with the penalty's bias.

    Source: S. N. Wood, "On p-values for smooth components of an extended generalized additive model", Biometrika 100(1), 2013,
    with as many combinations as the penalty leaves to more than half.

    Parameters
    ----------
    bread, meat : array, shape (k, k)
        Weighted Gram matrix of the columns less the base's part, and the covariance of their score.
    own : array, shape (k,)
        Squares of the columns before the base took its part.
    precision : array, shape (k, k)
    beta : array, shape (k,)
    """
    scale = np.sqrt(np.maximum(own, 1e-300))
    values, vectors = np.linalg.eigh(bread / np.outer(scale, scale))
    kept = values > DETERMINED
    basis = vectors[:, kept] / scale[:, None] / np.sqrt(values[kept])
    bent, turned = np.linalg.eigh(basis.T @ precision @ basis)
    some = basis @ turned[:, : max(int((bent < 1.0).sum()), 1)]  # in each of these the data's precision is one
    said = some.T @ (bread + precision) @ beta
    statistic = said @ np.linalg.pinv(some.T @ meat @ some, rcond=1e-10, hermitian=True) @ said
    inverse = (basis @ turned / (1.0 + bent)) @ (basis @ turned).T
    return float(statistic), some.shape[1], inverse @ (meat + precision) @ inverse
