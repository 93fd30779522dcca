"""Stiffness of a hinge from dead weights: a line with its interval, and what loading and unloading tell apart.

Section 4.1 takes the inverse slope of deformation over moment. The same line is fitted here with what the source leaves
out: how far it can be trusted, and whether the way up differs from the way down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.linear_fit import LinearFit
from rx90b_flex.signals.static_test import Mask, StaticTest

SMALLEST_SLOPE = 1e-30  # rad per N m or N m per rad; below it, and above its inverse, is rounding
OUTLIER = 0.01  # how often sound readings may hold one that stands out
ALIKE = 0.01  # p-value below which loading and unloading are said to differ
BACKWARDS = 3.0  # standard deviations of a loop's area below zero, from which it is said to run the wrong way round
ROUNDING = 1e-12  # of the largest reading: what is less is no noise of a measurement

Response = Literal["deformation", "moment"]


@dataclass(frozen=True)
class StaticLine:
    """A straight line through some readings.

    Attributes
    ----------
    stiffness : float
        N m/rad.
    interval : (float, float)
        Confidence interval of the stiffness; its upper end is infinite where the slope's reaches zero.
    mean_moment, deformation : float
        A point of the line: the mean moment of both directions, and where the line stands there; N m and rad.
    """

    stiffness: float
    interval: tuple[float, float]
    mean_moment: float
    deformation: float


@dataclass(frozen=True)
class StaticStiffness:
    """What a dead-weight test tells of a hinge.

    Attributes
    ----------
    coordinate : str
    stiffness, stiffness_std : float
        N m/rad; the standard deviation to first order of the slope's.
    interval : (float, float)
        Confidence interval of `stiffness`, N m/rad.
    confidence : float
        Of every interval here.
    response : str
        The noisier variable, whose distance from the line was made small.
    noise_std : float
        Of one reading of the response about the line, rad or N m.
    degrees_of_freedom : int
    loading, unloading : StaticLine
        Each direction by itself, the noise taken from both.
    p_value : float
        That the two differ by chance alone, in slope or in height; F test of two lines against one.
    slope_p_value : float
        The same of their slopes alone.
    hysteresis_area : float
        Work lost in the loop, J (N m rad); positive where unloading lags.
    hysteresis_std : float
        What noise alone gives that area.
    outlier : int or None
        Place, in the test, of the reading that stands out from the lines: largest studentized residual, Student's t at 1 %
        over all readings (Bonferroni).
    """

    coordinate: str
    stiffness: float
    stiffness_std: float
    interval: tuple[float, float]
    confidence: float
    response: Response
    noise_std: float
    degrees_of_freedom: int
    loading: StaticLine
    unloading: StaticLine
    p_value: float
    slope_p_value: float
    hysteresis_area: float
    hysteresis_std: float
    outlier: int | None = None

    @property
    def differs(self) -> bool:
        """Whether loading and unloading do, by more than chance."""
        return self.p_value < ALIKE

    @property
    def backwards(self) -> bool:
        """Whether their loop runs the wrong way round: a drift, for friction makes the deformation lag."""
        return self.differs and self.hysteresis_area < -BACKWARDS * self.hysteresis_std


def fit_static_stiffness(
    test: StaticTest, *, response: Response | None = None, skip: int = 0, confidence: float = 0.95
) -> StaticStiffness:
    """Stiffness from a dead-weight test: one slope for both directions, a height for each.

    With the deformation as response, ``deformation = height(direction) + moment / stiffness``. Friction that resists
    moves the two directions apart but, once it slides, turns neither: with a height each it is not taken for noise.
    Before it slides, at the start and after the top, it flattens the lines; `skip` leaves such readings out.

    The interval is Student's of the slope, inverted (1/x is monotonic): it covers as often as it says for independent
    normal noise of unknown size in the response and none in the other variable. Noise in the other variable would
    flatten the line by ``(std / spread of that variable)^2``; that is not corrected.

    Parameters
    ----------
    test : StaticTest
        At least three readings a direction and two loads in each.
    response : ``deformation`` or ``moment``, optional
        The noisier variable, each measured by its spread. Where not given: by the test's standard deviations; where it
        has none of the deformation, the deformation, as in the source.
    skip : int
        Readings left out at the beginning of each direction, as many as it takes friction to slide: its torque (after
        the top, twice that) over the step of the moment. The loop's area is that of all readings.
    confidence : float

    Raises
    ------
    ValueError
        Too few readings, one load only, or a deformation that does not grow with the moment.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence is {confidence!r}; expected a number between 0 and 1")
    response = response or _noisier(test)
    if response not in ("deformation", "moment"):
        raise ValueError(f"response is {response!r}; expected 'deformation' or 'moment'")
    area, weight = hysteresis_area(test)
    kept = _without_beginnings(test, skip)
    test = replace(test, moment=test.moment[kept], deformation=test.deformation[kept], rising=test.rising[kept])
    line, parallel, both = _fits(test, response)
    slope = float(parallel.theta[0])
    noisy = test.deformation if response == "deformation" else test.moment
    rounding = len(test) * (ROUNDING * float(np.abs(noisy).max())) ** 2
    # the noise of a deformation, for the loop's own uncertainty
    deformation_std = parallel.noise if response == "deformation" else parallel.noise / slope
    return StaticStiffness(
        coordinate=test.coordinate,
        stiffness=1.0 / slope if response == "deformation" else slope,
        stiffness_std=float(parallel.std[0]) / (slope**2 if response == "deformation" else 1.0),
        interval=_stiffness_interval(parallel, 0, confidence, response),
        confidence=confidence,
        response=response,
        noise_std=parallel.noise,
        degrees_of_freedom=parallel.freedom,
        loading=_branch(test, both, 0, confidence, response),
        unloading=_branch(test, both, 1, confidence, response),
        p_value=_f_test(line, both, rounding),
        slope_p_value=_f_test(parallel, both, rounding),
        hysteresis_area=area,
        hysteresis_std=float(deformation_std * np.linalg.norm(weight)),
        outlier=None if (place := _outlier(parallel, rounding)) is None else int(np.flatnonzero(kept)[place]),
    )


def _fits(test: StaticTest, response: Response) -> tuple[LinearFit, LinearFit, LinearFit]:
    """One line through all readings; a height for each direction; a slope for each, too."""
    given, noisy = (test.moment, test.deformation) if response == "deformation" else (test.deformation, test.moment)
    for name, rows in (("up", test.rising), ("down", ~test.rising)):
        if rows.sum() < 3 or np.ptp(given[rows]) == 0.0:
            raise ValueError(
                f"static test {test.coordinate!r}: direction {name!r} has {rows.sum()} readings"
                f" of {len(np.unique(given[rows]))} loads; expected at least three, not all the same"
            )
    centre = given - given.mean()
    up, down = test.rising.astype(float), 1.0 - test.rising
    parallel = LinearFit.of(np.stack([centre, up, down], axis=1), noisy)
    slope = float(parallel.theta[0])
    if not SMALLEST_SLOPE < slope < 1.0 / SMALLEST_SLOPE:
        raise ValueError(
            f"static test {test.coordinate!r}: the deformation does not grow with the moment (slope {slope:.3g})"
        )
    return (
        LinearFit.of(np.stack([centre, np.ones(len(test))], axis=1), noisy),
        parallel,
        LinearFit.of(np.stack([centre * up, centre * down, up, down], axis=1), noisy),
    )


def _branch(test: StaticTest, both: LinearFit, place: int, confidence: float, response: Response) -> StaticLine:
    """One direction's line, of the fit with a slope for each: 0 loading, 1 unloading."""
    gradient, height = float(both.theta[place]), float(both.theta[2 + place])
    middle = float(test.moment.mean())
    interval = _stiffness_interval(both, place, confidence, response)
    if response == "deformation":
        return StaticLine(1.0 / gradient, interval, middle, height)
    at_middle = float(test.deformation.mean() + (middle - height) / gradient)
    return StaticLine(gradient, interval, middle, at_middle)


def hysteresis_area(test: StaticTest) -> tuple[float, Array]:
    """Work lost in the loop that the readings close, and how it follows from each deformation.

    The polygon through the readings in their order, the last joined to the first: ``area = weight @ deformation``.

    Returns
    -------
    area : float
        J; positive where the deformation lags behind the moment.
    weight : array, shape (N,), N m
    """
    # the moment times each step of the deformation (trapezoids), summed by parts
    weight = 0.5 * (np.roll(test.moment, 1) - np.roll(test.moment, -1))
    return float(weight @ test.deformation), weight


def _without_beginnings(test: StaticTest, skip: int) -> Mask:
    """Which readings are left without the first ones of each direction."""
    kept = np.ones(len(test), dtype=bool)
    for rows in (test.rising, ~test.rising):
        kept[np.flatnonzero(rows)[:skip]] = False
    return kept


def _outlier(fit: LinearFit, rounding: float) -> int | None:
    """The reading whose residual is too large for the noise that all others show."""
    if fit.freedom < 2 or fit.squares <= rounding:
        return None
    free = 1.0 - np.einsum("ij,jk,ik->i", fit.columns, fit.inverse, fit.columns)
    own = fit.residual**2 / np.maximum(free, ROUNDING)
    place = int(np.argmax(own))
    others = max(fit.squares - float(own[place]), rounding, 1e-300) / (fit.freedom - 1)
    chance = 2.0 * float(special.stdtr(fit.freedom - 1, -np.sqrt(own[place] / others)))
    return place if len(own) * chance < OUTLIER else None


def _f_test(small: LinearFit, large: LinearFit, rounding: float) -> float:
    """Chance that the larger model fits that much better where the smaller one is true, to squares of rounding."""
    if small.squares <= rounding:
        return 1.0
    if large.squares == 0.0:
        return 0.0
    more = small.freedom - large.freedom
    ratio = (small.squares - large.squares) / more / (large.squares / large.freedom)
    return float(special.fdtrc(more, large.freedom, ratio))


def _stiffness_interval(fit: LinearFit, place: int, confidence: float, response: Response) -> tuple[float, float]:
    """Of the stiffness, N m/rad, that the slope in that place says."""
    slope = float(fit.theta[place])
    reach = float(special.stdtrit(fit.freedom, 0.5 + 0.5 * confidence) * fit.std[place])  # Student's t
    low, high = slope - reach, slope + reach
    if response == "moment":
        return max(low, 0.0), high
    # a slope that may be zero or below leaves the stiffness without an upper bound
    return (1.0 / high if high > 0.0 else np.inf), (1.0 / low if low > 0.0 else np.inf)


def _noisier(test: StaticTest) -> Response:
    if test.deformation_std is None or not test.moment_std:
        return "deformation"
    by_spread = test.deformation_std / np.ptp(test.deformation), test.moment_std / np.ptp(test.moment)
    return "deformation" if by_spread[0] >= by_spread[1] else "moment"
