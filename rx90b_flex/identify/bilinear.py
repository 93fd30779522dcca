"""Currents as gains times the torques of a model that is fitted with them: linear in each of the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.normal_equations import solve_weighted
from rx90b_flex.levenberg import Iterate, lowest

ROUNDS = 20  # of weights that follow from the residuals
EVALUATIONS = 25  # of a descent with one set of weights
SETTLED = 1.0e-6  # relative change of the gains below which the rounds end
WORTH = 1.0e-9  # of the squares, below which no further step is worth while
BROAD = 1.0  # standard deviation of a gain's logarithm about its start before the data: holds what they do not tell
LONGEST = 1.0  # step of a logarithm
SURELY = 0.01  # of the log error of a joint's sample: by so much a start of other signs has to end lower


@dataclass(frozen=True, eq=False)
class CurrentProducts:
    """Of each joint's columns with its known torque as the last one, ``z_j``, and of its current.

    Attributes
    ----------
    gram : array, shape (joints, p + 1, p + 1)
    cross : array, shape (joints, p + 1)
    power : array, shape (joints,)
    samples : int
    precision : array, shape (p, p)
        Of the coefficients before the data.
    """

    gram: Array
    cross: Array
    power: Array
    samples: int
    precision: Array

    @staticmethod
    def of(columns: Array, known: Array, current: Array, precision: Array) -> CurrentProducts:
        """Sum up columns (N, joints, p), known torques and currents (N, joints)."""
        gram, cross = [], []
        for j in range(current.shape[1]):
            z = np.column_stack([columns[:, j], known[:, j]])
            gram.append(z.T @ z)
            cross.append(z.T @ current[:, j])
        return CurrentProducts(np.array(gram), np.array(cross), (current**2).sum(axis=0), len(current), precision)


@dataclass(frozen=True, eq=False)
class _Place(Iterate):
    """Gains (joints,) of which some move, weights 1/sigma^2 (joints,), and the coefficients that are best with both."""

    products: CurrentProducts
    gains: Array
    places: Sequence[int]
    start: Array
    weight: Array

    @cached_property
    def theta(self) -> Array:
        """Coefficients, (p,)."""
        gram, cross = self._linear
        return solve_weighted(gram, cross, np.zeros(len(cross)))[0]

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        p, w, g = self.products, self.weight, self.gains
        gram = np.tensordot(w * g**2, p.gram, axes=1)
        cross = np.tensordot(w * g, p.cross, axes=1)
        return gram[:-1, :-1] + p.precision, cross[:-1] - gram[:-1, -1]

    @cached_property
    def squares(self) -> Array:
        """Sum of squared errors of each joint's current, (joints,)."""
        p, g, z = self.products, self.gains, np.append(self.theta, 1.0)
        return np.maximum(p.power - 2.0 * g * (p.cross @ z) + g**2 * ((p.gram @ z) @ z), 0.0)

    @property
    def _off(self) -> Array:
        return np.asarray(np.log(self.gains[self.places] / self.start[self.places]))

    @cached_property
    def goal(self) -> float:
        held = float(self.theta @ self.products.precision @ self.theta) + float((self._off**2).sum()) / BROAD**2
        return float(self.weight @ self.squares) + held

    @property
    def enough(self) -> float:
        return WORTH * self.goal

    def equations(self) -> tuple[Array, Array]:
        """By the logarithms of the gains, with the coefficients projected out."""
        p, w, g, at = self.products, self.weight, self.gains, list(self.places)
        z = np.append(self.theta, 1.0)
        torque = p.gram @ z  # (joints, p + 1): products of each column with the model's torque
        mixed = (w * g**2)[at, None] * torque[at, :-1]
        gram, _ = self._linear
        inverse = solve_weighted(gram, np.zeros(len(gram)), np.zeros(len(gram)))[1]
        bend = np.diag((w * g**2 * (torque @ z))[at] + BROAD**-2.0) - mixed @ inverse @ mixed.T
        fall = (w * g * (p.cross @ z - g * (torque @ z)))[at] - self._off / BROAD**2
        return bend, fall

    def moved(self, step: Array) -> _Place:
        gains = self.gains.copy()
        gains[list(self.places)] *= np.exp(np.clip(step, -LONGEST, LONGEST))
        return replace(self, gains=gains)

    def weighted(self) -> _Place:
        """With the weights that follow from its errors."""
        least = 1e-18 * self.products.power / self.products.samples + 1e-300
        return replace(self, weight=1.0 / np.maximum(self.squares / self.products.samples, least))

    @property
    def misfit(self) -> float:
        """Mean log error of a joint's sample."""
        return float(np.mean(np.log(self.squares / self.products.power + 1e-18))) / 2.0


def gains_and_coefficients(
    products: CurrentProducts, starts: Sequence[Array], places: Sequence[int]
) -> tuple[Array, Array, Array]:
    """Gains (joints,), of which those at `places` are fitted, coefficients (p,) and standard deviations of currents (joints,).

    Of several starts that which ends lowest; a later one has to be better for sure.
    """
    best: _Place | None = None
    for start in starts:
        at = _settled(products, start, places)
        if best is None or at.misfit < best.misfit - SURELY:
            best = at
    assert best is not None
    return best.gains, best.theta, best.weight**-0.5


def _settled(products: CurrentProducts, start: Array, places: Sequence[int]) -> _Place:
    at = _Place(products, start, list(places), start, products.samples / products.power).weighted()
    for _ in range(ROUNDS):
        before = at.gains
        at = lowest(at, EVALUATIONS).weighted()
        if np.abs(at.gains / before - 1.0).max() < SETTLED:
            break
    return at
