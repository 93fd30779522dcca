"""M-estimators: what errs by much more than most counts less."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array
from rx90b_flex.files.extensions import whose
from rx90b_flex.identify.estimators.estimator import Estimator
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression

ROUNDS = 50
SETTLED = 1e-5  # of the errors' scale: predictions that change by less stay
TO_STD = 1.4826  # times the median of absolute normal errors is their standard deviation
LEAST_SLOPE = 0.2  # mean of the influence's slope that a step counts on
NOISE_FREE = 1e-9  # of a joint's torque: no scale is smaller


class MEstimator(Estimator):
    """Estimates that solve ``sum of influence(error / scale) * column = 0``, the scale of each joint's errors from their median.

    By modified residuals: least squares of the predicted torque plus ``scale * influence / mean slope`` in place of the error, until
    that changes nothing. At the end they are that fit, so that its covariance is theirs, noise correlated in time included.

    Source
    ------
    P. J. Huber, Robust Statistics, Wiley, 1981, sections 7.6 to 7.8.
    """

    @abstractmethod
    def influence(self, u: Array) -> Array:
        """Of an error over its scale; u near zero, and bounded."""

    @abstractmethod
    def influence_slope(self, u: Array) -> Array:
        """Derivative of `influence`."""

    def first(self, regression: Regression, effects: Sequence[Effect], fit_links: bool) -> Identification:
        """Where the rounds begin: least squares."""
        return identify(regression, effects, fit_links=fit_links, with_covariance=False)

    def identify(self, regression: Regression, effects: Sequence[Effect], *, fit_links: bool) -> Identification:
        fit = self.first(regression, effects, fit_links)
        left = regression.torque - (fit.regression.torque - fit.residual)
        for _ in range(ROUNDS):
            given = _with_torque(regression, regression.torque - left + self._modified(left, regression))
            fit = identify(given, fit.effects, fit_links=fit_links, start=fit, with_covariance=False)
            before, left = left, regression.torque - (given.torque - fit.residual)
            if (np.sqrt(((left - before) ** 2).mean(axis=0)) <= SETTLED * _scale(left, regression)).all():
                break
        given = _with_torque(regression, regression.torque - left + self._modified(left, regression))
        fit = identify(given, fit.effects, fit_links=fit_links, start=fit)
        left = regression.torque - (given.torque - fit.residual)
        seen = _with_torque(fit.regression, regression.torque)
        return dataclasses.replace(fit, residual=left, regression=seen)

    def _modified(self, left: Array, regression: Regression) -> Array:
        """In place of the errors `left` (N, joints), N m."""
        scale = _scale(left, regression)
        slope = np.maximum(self._of_errors("influence_slope", left / scale).mean(axis=0), LEAST_SLOPE)
        return scale * self._of_errors("influence", left / scale) / slope

    def _of_errors(self, what: str, u: Array) -> Array:
        """What a method says of errors over their scale, in the shape of these."""
        said = getattr(self, what)(u)
        if said is None or np.shape(said) != u.shape:
            shape = "None" if said is None else f"an array of shape {np.shape(said)}"
            raise ValueError(
                f"estimator is {self.name()!r}; {whose(type(self))}: {what} returned {shape}; expected {u.shape}"
            )
        return np.asarray(said)


def _scale(left: Array, regression: Regression) -> Array:
    """Standard deviation of most of each joint's errors, shape (joints,), N m."""
    smallest = NOISE_FREE * np.sqrt((regression.torque**2).mean(axis=0)) + 1e-12
    return np.maximum(TO_STD * np.median(np.abs(left), axis=0), smallest)


def _with_torque(regression: Regression, torque: Array) -> Regression:
    """The same rows with another torque (N, rows), N m, less known payloads as `Regression.torque` is."""
    change = torque - regression.torque
    joints = len(regression.joints)
    of_sensors = np.zeros((len(change), joints))
    of_sensors[:, [regression.joints.index(j) for j in regression.sensors]] = change[:, joints:]
    return dataclasses.replace(
        regression,
        segments=tuple(
            dataclasses.replace(
                s, torque=s.torque + change[at, :joints], sensed=None if s.sensed is None else s.sensed + of_sensors[at]
            )
            for s, at in zip(regression.segments, regression.spans, strict=True)
        ),
    )
