"""A frequency response with its covariance: what estimators of it return and what fits to it take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.showing import Showing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from rx90b_flex.linearize import Linearization

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Showing):
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
        lines, rows, n = len(self.hz), self._rows, len(self.joints)
        shapes = {"value": (lines, rows, n), "covariance": (lines, rows * n, rows * n)}
        for name, expected in shapes.items():
            if np.shape(getattr(self, name)) != expected:
                raise ValueError(f"{name} has shape {np.shape(getattr(self, name))}; expected {expected}")

    @property
    def _rows(self) -> int:
        return len(self.joints)

    def band(self, low_hz: float, high_hz: float) -> FrequencyResponse:
        """The lines between two frequencies, both included."""
        return self.lines((self.hz >= low_hz) & (self.hz <= high_hz))

    def lines(self, kept: Mask) -> FrequencyResponse:
        """Some of the lines."""
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
        return self._deviation(self.covariance)

    def noise_std(self) -> Array | None:
        """The part of measurement noise alone; None where it is not known."""
        return None if self.noise_covariance is None else self._deviation(self.noise_covariance)

    def _deviation(self, covariance: ComplexArray) -> Array:
        return np.sqrt(np.einsum("faa->fa", covariance).real).reshape(self.value.shape)

    def bode(self, *others: FrequencyResponse | Linearization) -> Figure:
        """Magnitude and phase of every entry with their 95 % bands, and those of other responses or of a linearised robot."""
        from rx90b_flex.view.frf_plots import bode

        return bode(
            self, [(self.hz, self.of(x), f"model {k}" if len(others) > 1 else "model") for k, x in enumerate(others, 1)]
        )

    def compare(self, model: FrequencyResponse | Linearization | ComplexArray) -> pd.DataFrame:
        """How well a model fits each entry, %: 100 (1 - |P - model| / |P - mean of P|), 2-norms over the lines; 100 is all of it.

        Rows are accelerations, columns torques. Negative where the entry's mean fits better.
        """
        import pandas as pd

        left = np.linalg.norm(self.value - self.of(model), axis=0)
        fit = 100.0 * (1.0 - left / np.linalg.norm(self.value - self.value.mean(axis=0), axis=0))
        return pd.DataFrame(
            fit, index=pd.Index(self.joints, name="acceleration"), columns=pd.Index(self.joints, name="torque")
        )

    def residuals(self, model: FrequencyResponse | Linearization | ComplexArray) -> ComplexArray:
        """What a model leaves of each entry, over the entry's standard deviation, (F, n, n): of size 1 where it is noise."""
        return np.asarray((self.value - self.of(model)) / self.std())

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` with value and standard deviation over hz, acceleration and torque (needs the package xarray)."""
        try:
            import xarray
        except ImportError:
            raise ImportError("to_xarray needs xarray: install rx90b_flex[grids]") from None

        grid = ("hz", "acceleration", "torque")
        places = {"hz": self.hz, "acceleration": list(self.joints), "torque": list(self.joints)}
        units = {"units": "rad/s^2 per N m"}
        return xarray.Dataset({"value": (grid, self.value, units), "std": (grid, self.std(), units)}, places)

    def of(self, model: FrequencyResponse | Linearization | ComplexArray) -> ComplexArray:
        """The response of a model at these lines, (F, n, n).

        Raises
        ------
        ValueError
            A response at other lines or of another shape.
        """
        if isinstance(model, FrequencyResponse):
            if not np.array_equal(model.hz, self.hz):
                raise ValueError(
                    f"the other response has {len(model.hz)} lines; expected the {len(self.hz)} lines of this one"
                )
            model = model.value
        value = np.asarray(model if isinstance(model, np.ndarray) else model.frf(self.hz))
        if value.shape != self.value.shape:
            raise ValueError(f"the model's response has shape {value.shape}; expected {self.value.shape}")
        return value
