"""Huber's M-estimator."""

from __future__ import annotations

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.estimators.m_estimator import MEstimator

CUT = 1.345  # standard deviations: 95 % as certain as least squares where all errors are normal


class Huber(MEstimator):
    """Squares of errors up to 1.345 times their scale, absolute values beyond.

    Single bumps and lost samples move the estimate by no more than an error at the limit does.

    Source
    ------
    P. J. Huber, Robust estimation of a location parameter, Annals of Mathematical Statistics 35(1), 1964.
    """

    def influence(self, u: Array) -> Array:
        return np.clip(u, -CUT, CUT)

    def influence_slope(self, u: Array) -> Array:
        return np.asarray(np.abs(u) <= CUT, dtype=float)
