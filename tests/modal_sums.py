"""Accelerances of two drives as sums over real modes, some of them above the lines; their poles and zeros are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

HZ = np.arange(33, 322, 4) / 4.096  # 8 to 78 Hz
IN_BAND = (16.0, 24.0, 33.0, 47.0, 61.0, 73.0)
ABOVE = (98.0, 120.0, 170.0, 240.0)
DRIVES = 2


@dataclass(frozen=True, eq=False)
class ModalSum:
    """``P = s^2 sum phi_r phi_r^T / (s^2 + 2 z_r w_r s + w_r^2)`` at the drives; as many rows of phi as modes.

    Attributes
    ----------
    frequency_hz, damping_ratio : array, shape (m,)
        First the rigid-body modes, one a drive, at zero.
    shapes : array, shape (m, m)
        Mass-normalised modes by columns; the first rows are the drives.
    """

    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shapes: np.ndarray

    @classmethod
    def draw(cls, hz: tuple[float, ...], damping: Callable[[np.ndarray], np.ndarray], seed: int) -> ModalSum:
        rng = np.random.default_rng(seed)
        f = np.concatenate([np.zeros(DRIVES), hz])
        size = len(f)
        shapes = rng.normal(size=(size, size)) / np.sqrt(size) + 0.5 * np.eye(size)
        shapes[:DRIVES, :DRIVES] = 0.5 * np.eye(DRIVES) + 0.1 * rng.normal(size=(DRIVES, DRIVES))
        return cls(f, np.where(f > 0.0, damping(f), 0.0), shapes)

    def response(self, hz: np.ndarray) -> np.ndarray:
        """P at these lines, (F, drives, drives), rad/s^2 per N m."""
        s, w = 2j * np.pi * hz[:, None], 2 * np.pi * self.frequency_hz
        share = s**2 / (s**2 + 2 * self.damping_ratio * w * s + w**2)
        at = self.shapes[:DRIVES]
        return np.einsum("jm,km,fm->fjk", at, at, share)

    def poles_hz(self) -> np.ndarray:
        """Distances of the poles from the origin, Hz."""
        return self.frequency_hz[DRIVES:]

    def zeros_hz(self, drive: int) -> np.ndarray:
        """Of the complex zeros of a drive point: the poles of the structure with that drive held, ascending, Hz."""
        w, inverse = 2 * np.pi * self.frequency_hz, np.linalg.inv(self.shapes)
        free = np.delete(np.arange(len(w)), drive)
        mass, damping, stiffness = (
            (inverse.T @ np.diag(each) @ inverse)[np.ix_(free, free)]
            for each in (np.ones_like(w), 2 * self.damping_ratio * w, w**2)
        )
        none = np.zeros_like(mass)
        first = np.block(
            [[none, np.eye(len(free))], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
        )
        found = np.linalg.eigvals(first)
        return np.sort(np.abs(found[found.imag > 1e-3 * np.maximum(np.abs(found), 1.0)])) / (2 * np.pi)

    def flexibility(self, from_hz: float) -> np.ndarray:
        """Static compliance at the drives of the modes above a frequency, rad per N m."""
        above = self.frequency_hz > from_hz
        at = self.shapes[:DRIVES, above]
        return (at / (2 * np.pi * self.frequency_hz[above]) ** 2) @ at.T


def a_millisecond(f: np.ndarray) -> np.ndarray:
    """Damping ratios where damping over stiffness is 1e-3 s."""
    return np.minimum(np.pi * f * 1e-3, 0.9)


def high_above_55_hz(f: np.ndarray) -> np.ndarray:
    """3 % below 55 Hz, then 20 to 40 %."""
    return np.where(f < 55.0, 0.03, np.interp(f, [55.0, 75.0, 300.0], [0.2, 0.4, 0.4]))
