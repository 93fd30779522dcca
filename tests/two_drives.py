"""Two drives before three masses: a system whose frequency response, modes and noise are known."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from rx90b_flex.identify.frequency_response import FrequencyResponse

HZ = np.arange(33, 322, 4) / 4.096  # every second odd line of section 6.6.2
JOINTS = ("joint_1", "joint_2")

# Two drives before three masses: kg m^2, N m/rad. Two rigid-body modes, as two drives have, and three of vibration.
MASS = np.diag([2.0, 1.0, 4.0, 3.0, 2.0])
SPRINGS = [((1, 0, -1, 0, 0), 6.0e4), ((0, 1, 0, -1, 0), 9.0e4), ((0, 0, 1, -1, 1), 5.0e4)]
STIFFNESS = sum(k * np.outer(c, c) for c, k in SPRINGS).astype(float)
DAMPING = 2e-4 * STIFFNESS
FREE = np.sqrt(eigh(STIFFNESS, MASS, eigvals_only=True)[2:]) / (2 * np.pi)


def locked(drive: int) -> np.ndarray:
    """Frequencies, Hz, with one drive held, without the rigid-body mode that is left."""
    free = np.delete(np.arange(5), drive)
    at = np.ix_(free, free)
    return np.sqrt(eigh(STIFFNESS[at], MASS[at], eigvals_only=True)[1:]) / (2 * np.pi)


LOCKED = [locked(0), locked(1)]


def truth(hz: np.ndarray, delay: np.ndarray | None = None) -> np.ndarray:
    """P(j w) of the two drives; torques late by `delay`, s."""
    s = 2j * np.pi * hz[:, None, None]
    p = s**2 * np.linalg.inv(STIFFNESS + s * DAMPING + s**2 * MASS)[:, :2, :2]
    return p if delay is None else p * np.exp(-s * delay)


def noisy(
    value: np.ndarray, hz: np.ndarray, level: float, rng: np.random.Generator, joints: tuple[str, ...] = JOINTS
) -> FrequencyResponse:
    """Errors of each row alike, and correlated between its entries, as noise on an output makes them."""
    n = value.shape[1]
    row = level * np.sqrt(np.einsum("fjk,fjk->fj", value, value.conj()).real / n)
    mixed = 0.7 * np.eye(n) + 0.3
    covariance = np.einsum("fj,jl,km->fjklm", row**2, np.eye(n), mixed).reshape(len(hz), n * n, n * n).astype(complex)
    white = (rng.normal(size=(2, len(hz), n * n, 1)) / np.sqrt(2)).transpose(1, 2, 3, 0) @ [1, 1j]
    error = (np.linalg.cholesky(covariance) @ white)[..., 0]
    return FrequencyResponse(hz, value + error.reshape(value.shape), covariance, joints, np.zeros(n))
