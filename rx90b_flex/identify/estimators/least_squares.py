"""Weighted least squares, the estimator of every command that is not told another."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.effects import Effect
from rx90b_flex.identify.estimators.estimator import Estimator
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression


class LeastSquares(Estimator):
    """Squares of the errors, each joint weighted by its own residual; covariance under noise that is correlated in time."""

    def identify(self, regression: Regression, effects: Sequence[Effect], *, fit_links: bool) -> Identification:
        return identify(regression, effects, fit_links=fit_links)
