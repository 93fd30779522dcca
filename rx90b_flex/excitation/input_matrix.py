"""Input matrices: which joints are excited with which sign in the experiments of one realisation (section 6.5.1).

Rows are joints, columns experiments. The feed-forward torques are ``input_matrix @ multisine`` (6.49).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import hadamard as sylvester

from rx90b_flex.pieces import Array


def identity(joints: int) -> Array:
    """One joint an experiment. The controllers of the others answer with torques that the excited joint brings about."""
    return np.eye(joints)


def minus_below_first(joints: int) -> Array:
    """The matrix of (6.50): ones, with -1 down the diagonal below the first row.

    Its rows are orthogonal for no more than two joints (three joints: condition number 2).
    """
    matrix = np.ones((joints, joints))
    matrix[np.arange(1, joints), np.arange(1, joints)] = -1.0
    return matrix


def hadamard(joints: int) -> Array:
    """Rows of a Hadamard matrix: orthogonal, every joint excited fully in every experiment, shape (joints, experiments).

    The experiments are the next order for which Sylvester's or Paley's construction gives one (1, 2, 4, 8, 12, 16, 20, 24, 32, ...);
    they may be more than the joints. Of the matrix's rows the first, of ones alone, is used last.
    """
    if joints < 1:
        raise ValueError(f"input matrix of {joints} joints; expected 1 or more")
    order = joints
    while (matrix := _hadamard(order)) is None:
        order += 1
    return np.roll(matrix, -1, axis=0)[:joints] if order > joints else matrix


def scaled(matrix: ArrayLike, peaks: ArrayLike) -> Array:
    """The matrix with each joint's row times its own largest torque, for a multisine of peak 1.

    Parameters
    ----------
    peaks : array, shape (joints,), N m
        For example a part of each joint's torque limit.
    """
    rows, size = np.asarray(matrix, dtype=float), np.asarray(peaks, dtype=float)
    if size.shape != rows.shape[:1] or not np.all(size > 0):
        raise ValueError(f"peaks {size.tolist()}: expected {len(rows)} torques above 0, one a joint")
    return rows * size[:, None]


def _hadamard(order: int) -> Array | None:
    if order & (order - 1) == 0:
        return np.asarray(sylvester(order, dtype=float))
    prime = order - 1
    if order % 4 or any(prime % k == 0 for k in range(2, int(prime**0.5) + 1)):
        return None
    # Paley: residues[b - a] is 1 where b - a is a square modulo the prime, -1 where it is not
    residues = -np.ones(prime)
    residues[np.unique(np.arange(1, prime) ** 2 % prime)] = 1.0
    residues[0] = 0.0
    places = np.arange(prime)
    jacobsthal = residues[(places[None, :] - places[:, None]) % prime]
    matrix = np.ones((order, order))
    matrix[1:, 1:] = jacobsthal + np.eye(prime)
    matrix[1:, 0] = -1.0
    return matrix
