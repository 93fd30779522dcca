"""A frequency response with its covariance: what estimators of it return and what fits to it take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """P(j w), drive acceleration over drive torque (chapter 5), at some lines and one pose.

    Attributes
    ----------
    hz : array, shape (F,)
        Frequencies, ascending.
    value : complex array, shape (F, n, n)
        ``value[f, j, k]``: acceleration of drive j over torque of drive k, rad/s^2 per N m.
    covariance : complex array, shape (F, n*n, n*n)
        ``E[d d^H]`` of the error d of ``value[f].ravel()`` (row j, then column k), noise and nonlinear distortion
        together; of the mean, if the estimate is a mean.
    noise_covariance : complex array, shape (F, n*n, n*n), or None
        The part of measurement noise alone.
    joints : tuple of str
        The n joints.
    pose : array
        Mean joint angles of the whole robot in the order of its joints, rad; empty where not known.
    degrees_of_freedom : float
        Of the covariance; infinite where it is known rather than estimated.
    """

    hz: Array
    value: ComplexArray
    covariance: ComplexArray
    joints: tuple[str, ...]
    pose: Array
    noise_covariance: ComplexArray | None = None
    degrees_of_freedom: float = np.inf

    def __post_init__(self) -> None:
        lines, n = len(self.hz), len(self.joints)
        shapes = {"value": (lines, n, n), "covariance": (lines, n * n, n * n)}
        for name, expected in shapes.items():
            if np.shape(getattr(self, name)) != expected:
                raise ValueError(f"{name} has shape {np.shape(getattr(self, name))}; expected {expected}")

    def band(self, low_hz: float, high_hz: float) -> FrequencyResponse:
        """The lines between two frequencies, both included."""
        kept = (self.hz >= low_hz) & (self.hz <= high_hz)
        noise = None if self.noise_covariance is None else self.noise_covariance[kept]
        return FrequencyResponse(
            self.hz[kept],
            self.value[kept],
            self.covariance[kept],
            self.joints,
            self.pose,
            noise,
            self.degrees_of_freedom,
        )

    def std(self) -> Array:
        """Standard deviation of each entry, ``sqrt(E |d|^2)``, shape (F, n, n)."""
        variance = np.einsum("faa->fa", self.covariance).real
        return np.sqrt(variance).reshape(self.value.shape)
