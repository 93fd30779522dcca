"""Poles to start a transfer-function fit from: linear least squares, iterated, over orders and weights; no hand in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse

POWERS = (0.5, 1.0, 2.0)  # w of (6.41); the source scans 0.2 to 2
ITERATIONS = 6


@dataclass(frozen=True, eq=False)
class PoleSet:
    """Poles that one linear fit gave.

    Attributes
    ----------
    order : int
        Degree of the common denominator.
    power : float
        w of (6.41).
    poles : complex array, shape (m,)
        Those above the real axis, by distance from the origin, mirrored into the left half plane; rad/s.
    cost : float
        Weighted sum of squares that free, symmetric numerators over these poles leave.
    """

    order: int
    power: float
    poles: ComplexArray
    cost: float

    @property
    def frequencies_hz(self) -> Array:
        """Distance of each pole from the origin, shape (m,)."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping_ratios(self) -> Array:
        """``-Re(p) / |p|``, shape (m,)."""
        return -self.poles.real / np.abs(self.poles)


def whitening(response: FrequencyResponse) -> ComplexArray:
    """Hermitian inverse square root of the covariance at each line, shape (F, n*n, n*n).

    Raises
    ------
    ValueError
        A covariance that is not positive definite, with its line: every entry needs an uncertainty.
    """
    values, vectors = np.linalg.eigh(response.covariance)
    smallest, largest = values[:, 0], values[:, -1]
    bad = np.flatnonzero(~(smallest > 1e-12 * largest))
    if len(bad):
        raise ValueError(
            f"the covariance at {response.hz[bad[0]]:.4g} Hz is not positive definite (eigenvalues {smallest[bad[0]]:.3g} to "
            f"{largest[bad[0]]:.3g}); expected as many independent realisations as entries, or a smoothed covariance"
        )
    return (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2)


@lru_cache
def symmetric_basis(n: int) -> Array:
    """Symmetric n x n matrices with one independent entry each, shape (n (n + 1) / 2, n, n); not to be written to."""
    rows, columns = np.triu_indices(n)
    basis = np.zeros((len(rows), n, n))
    basis[np.arange(len(rows)), rows, columns] = basis[np.arange(len(rows)), columns, rows] = 1.0
    basis.setflags(write=False)
    return basis


def real_rows(complex_rows: NDArray[Any]) -> Array:
    """Real parts over imaginary parts, all leading axes but the last made one."""
    flat = complex_rows.reshape(-1, complex_rows.shape[-1])
    return np.concatenate([flat.real, flat.imag])


@dataclass(frozen=True, eq=False)
class SymmetricData:
    """All that a symmetric model can explain of a frequency response, whitened: ``|target - weight y|^2`` with y its entries.

    Attributes
    ----------
    s : complex array, shape (F,)
        rad/s.
    weight : complex array, shape (F, k, k)
        k = n (n + 1) / 2; upper triangular.
    target : complex array, shape (F, k)
    rest : float
        Sum of squares that no symmetric model explains.
    size : int
        n.
    """

    s: ComplexArray
    weight: ComplexArray
    target: ComplexArray
    rest: float
    size: int


def symmetric_data(response: FrequencyResponse) -> SymmetricData:
    """Project a response on symmetric matrices by its covariance: two thirds of the rows for three joints, the same fit."""
    n = len(response.joints)
    white = whitening(response)
    basis = np.einsum("fab,kb->fak", white, symmetric_basis(n).reshape(-1, n * n))
    measured = np.einsum("fab,fb->fa", white, response.value.reshape(-1, n * n))
    q, r = np.linalg.qr(basis)
    target = np.einsum("fak,fa->fk", q.conj(), measured)
    rest = float((np.abs(measured) ** 2).sum() - (np.abs(target) ** 2).sum())
    return SymmetricData((2j * np.pi * response.hz).astype(complex), r, target, rest, n)


def starting_poles(data: SymmetricData, orders: Iterable[int], powers: Sequence[float] = POWERS) -> tuple[PoleSet, ...]:
    """Poles of common-denominator fits by iterated weighted least squares (6.41), for every order and power.

    ``min sum |C^-1/2 (N(s) - A(s) P)|^2 / |A_before(s)|^w`` over symmetric numerators N, two degrees above A, and the
    denominator A of unit norm. Both are written in polynomials orthonormal over the lines (Arnoldi), so that the
    condition of the problem does not grow with the order as it does in powers of s. Poles on the right are mirrored.

    Parameters
    ----------
    data : SymmetricData
    orders : degrees of the denominator to try.
    powers : values of w to try.

    Returns
    -------
    tuple of PoleSet
        One for each order and power, in that order: the iteration whose poles leave the lowest cost.
    """
    orders = tuple(orders)
    unit = float(np.abs(data.s).max())
    basis, hessenberg = _orthonormal(data.s / unit, max(orders) + 2)
    return tuple(_iterated(order, power, basis, hessenberg, data, unit) for order in orders for power in powers)


def _iterated(
    order: int, power: float, basis: ComplexArray, hessenberg: Array, data: SymmetricData, unit: float
) -> PoleSet:
    lines, free = data.target.shape
    numerators = np.einsum("fak,fd->fakd", data.weight, basis[:, : order + 3]).reshape(lines, free, -1)
    rows = np.concatenate([numerators, -data.target[:, :, None] * basis[:, None, : order + 1]], axis=2)
    scale, best = np.ones(lines), PoleSet(order, power, np.empty(0, complex), np.inf)
    split = free * (order + 3)
    for _ in range(ITERATIONS):
        x = real_rows(rows * scale[:, None, None])
        gram = x.T @ x
        # what is left for A when N has done what it can
        corner = gram[split:, split:] - gram[split:, :split] @ np.linalg.solve(
            gram[:split, :split], gram[:split, split:]
        )
        a = np.linalg.eigh(corner)[1][:, 0]
        step = hessenberg[:order, :order].copy()
        step[:, -1] -= hessenberg[order, order - 1] / a[order] * a[:order]
        poles = np.linalg.eigvals(step)
        poles = unit * (-np.abs(poles.real) + 1j * poles.imag)
        cost = residue_fit(data, poles)[1]
        if cost < best.cost:
            kept = poles[poles.imag > 0]
            best = PoleSet(order, power, kept[np.argsort(np.abs(kept))], cost)
        scale = np.abs(basis[:, : order + 1] @ a) ** (-power / 2)
    return best


def residue_fit(data: SymmetricData, poles: ComplexArray) -> tuple[Array, float]:
    """Best symmetric terms in powers of s and residues over given poles, and the cost they leave (with the unexplained rest).

    The coefficients, shape (k, 4 + poles), belong to the columns of `partial_fractions`.
    """
    fractions = partial_fractions(data.s, poles)
    size = np.linalg.norm(fractions, axis=0)
    rows = real_rows(np.einsum("fak,fd->fakd", data.weight, fractions / size).reshape(*data.target.shape, -1))
    target = real_rows(data.target[:, :, None])[:, 0]
    gram = rows.T @ rows
    gram[np.diag_indices_from(gram)] *= 1 + 1e-12  # poles that coincide leave their shares undetermined
    found = np.linalg.solve(gram, rows.T @ target)
    left = target - rows @ found
    return found.reshape(data.target.shape[1], -1) / size, float(left @ left) + data.rest


def partial_fractions(s: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """1 / s^2, 1, s, s^2 and the real and imaginary parts' columns of each pole, with real coefficients; shape (F, 4 + poles)."""
    above, real = poles[poles.imag > 0], poles[poles.imag == 0]
    one, other = 1 / (s[:, None] - above), 1 / (s[:, None] - above.conj())
    return np.concatenate(
        [s[:, None] ** np.array([-2, 0, 1, 2]), 1 / (s[:, None] - real), one + other, 1j * (one - other)], axis=1
    )


def _orthonormal(s: ComplexArray, degree: int) -> tuple[ComplexArray, Array]:
    """Polynomials with real coefficients, orthonormal over the lines and their mirror images, and their recursion.

    Returns ``basis`` (F, degree + 1) and H (degree + 1, degree) with ``s basis[:, :degree] = basis H``.
    """
    basis = np.zeros((len(s), degree + 1), complex)
    hessenberg = np.zeros((degree + 1, degree))
    basis[:, 0] = 1 / np.sqrt(len(s))
    for k in range(degree):
        new = s * basis[:, k]
        for _ in range(2):  # once more, against what rounding left
            part = (basis[:, : k + 1].conj().T @ new).real
            hessenberg[: k + 1, k] += part
            new = new - basis[:, : k + 1] @ part
        hessenberg[k + 1, k] = np.linalg.norm(new)
        basis[:, k + 1] = new / hessenberg[k + 1, k]
    return basis, hessenberg
