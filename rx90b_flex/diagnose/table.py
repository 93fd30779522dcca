"""Tables of numbers with independent normal errors: the residual that asks least of a new kind of data."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from rx90b_flex.diagnose.likelihood import Change, LikelihoodFit, LikelihoodResidual, State
from rx90b_flex.effects.motion import Array


class TableResidual(LikelihoodResidual):
    """Measured numbers less those that a model predicts.

    A kind of table gives `changes` and `predict`.

    Parameters
    ----------
    measured, std : array, shape (m,)
        The numbers and their standard deviations, in one unit or each in its own.
    model_error : float
        Part of each number that is always allowed for beside its standard deviation.

    Raises
    ------
    ValueError
        Arrays of other shapes, standard deviations or a model error not above 0.
    """

    def __init__(self, measured: Array, std: Array, model_error: float = 1e-3) -> None:
        self.measured, self.std = np.asarray(measured, dtype=float), np.asarray(std, dtype=float)
        if self.measured.ndim != 1 or self.std.shape != self.measured.shape:
            raise ValueError(f"measured has shape {self.measured.shape}, std {self.std.shape}; expected (m,) of both")
        if not (np.isfinite(self.measured).all() and (self.std > 0).all() and model_error > 0):
            raise ValueError("expected finite numbers, standard deviations above 0 and a model_error above 0")
        self.smallest_error = model_error

    @abstractmethod
    def predict(self, changes: tuple[Change, ...], x: Array) -> tuple[Array, Array]:
        """What a model with changes gives, (m,), and its slopes by x, (m, p); x: logarithms of their parameters, in order."""

    @property
    def size(self) -> float:
        return float(len(self.measured))

    def evaluate(self, changes: tuple[Change, ...], x: Array, model_error: float) -> State:
        predicted, slopes = self.predict(changes, x)
        return self.of_independent(self.measured - predicted, slopes, self.std**2, self.measured, model_error)

    def chance(self, fit: LikelihoodFit) -> float:
        left = self.measured - self.predict((*self.nuisance, *fit.changes), fit.x)[0]
        variance = self.std**2 + (self.smallest_error * self.measured) ** 2
        return self.by_chi_squared(float((left**2 / variance).sum()), len(left), fit)
