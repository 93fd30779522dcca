"""Statistics over the robots of a make: one parameter, one estimate with its standard deviation a robot.

The model of random effects: robot i has the value ``mean + b_i``, where b_i has the standard deviation tau between robots, and its
data show it with the error e_i of known standard deviation s_i.

Sources
-------
Restricted maximum likelihood for tau: W. Viechtbauer, Journal of Educational and Behavioral Statistics 30(3), 2005.
Interval of tau, by the profile of Cochran's Q: W. Viechtbauer, Statistics in Medicine 26(1), 2007.
Interval of the mean: J. Hartung, G. Knapp, Statistics in Medicine 20, 2001, with their factor not below one (G. Knapp, J. Hartung,
Statistics in Medicine 22, 2003).
A robot held against the others: J. P. T. Higgins, S. G. Thompson, D. J. Spiegelhalter, Journal of the Royal Statistical Society A
172(1), 2009, section 4. Many tests: S. Holm, Scandinavian Journal of Statistics 6(2), 1979.
A change at an unknown date: R. E. Quandt, Journal of the American Statistical Association 55, 1960, with Bonferroni's correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from rx90b_flex.effects.motion import Array, Mask

LEVEL = 0.95  # of intervals
STANDS_OUT = 0.01  # chance that any robot of a sound fleet is said to stand out in any parameter
SUSPECT = 2.5  # standard deviations from the median beyond which a robot does not count from the first
FEWEST_OTHERS = 3  # robots that one is held against
CHANGED = 0.01  # p-value of a change, corrected for all that was tried
MEDIAN_SQUARE = float(stats.chi2.median(1))  # of a standard normal deviate
ROUNDS = 20  # of the robust start


@dataclass(frozen=True)
class Summary:
    """One parameter over the robots of a make.

    Attributes
    ----------
    count : int
        Robots that it is made of.
    mean, low, high : float
        Mean over the make and its 95 % interval, in the parameter's unit.
    between_std, between_low, between_high : float or None
        Standard deviation between robots and its 95 % interval; None for a single one. Zero where the estimates differ no more than
        their own standard deviations let expect; how much the robots may differ nevertheless is what the upper limit says.
    """

    count: int
    mean: float
    low: float
    high: float
    between_std: float | None
    between_low: float | None
    between_high: float | None


@dataclass(frozen=True, eq=False)
class Spread:
    """Mean over robots, the variance of that mean, and the variance between robots with twice its information."""

    mean: float
    mean_variance: float
    between: float
    information: float


def spread(values: Array, stds: Array) -> Spread:
    """Mean, its variance after Hartung and Knapp, and the variance between robots by restricted maximum likelihood.

    Parameters
    ----------
    values, stds : array, shape (k,)
        Two robots or more.
    """
    scale = float(np.sqrt(np.var(values) + np.mean(stds**2)))
    if scale == 0.0:
        return Spread(float(values[0]), 0.0, 0.0, np.inf)
    y, v = (values - values.mean()) / scale, (stds / scale) ** 2 + 1e-12
    between = _restricted(y, v)
    weights = 1.0 / (v + between)
    mean = float(weights @ y / weights.sum())
    factor = max(1.0, float(weights @ (y - mean) ** 2) / (len(y) - 1))
    one, two, three = (float((weights**n).sum()) for n in (1, 2, 3))
    information = (two - 2.0 * three / one + (two / one) ** 2) / scale**4
    return Spread(float(values.mean() + scale * mean), scale**2 * factor / one, scale**2 * between, information)


def _restricted(y: Array, v: Array) -> float:
    """Where the slope of the restricted log-likelihood by the variance between robots vanishes; zero where it only falls."""

    def slope(between: float) -> float:
        w = 1.0 / (v + between)
        mean = w @ y / w.sum()
        return float(w**2 @ (y - mean) ** 2 - w.sum() + w @ w / w.sum())

    return _where_it_vanishes(slope)


def summary(values: Array, stds: Array) -> Summary:
    """Mean over a make with its interval, and the standard deviation between robots.

    Parameters
    ----------
    values, stds : array, shape (k,)
        Estimates of one parameter and their standard deviations, one a robot.
    """
    if len(values) == 1:
        half = float(stats.norm.ppf(0.5 + 0.5 * LEVEL) * stds[0])
        return Summary(1, float(values[0]), float(values[0]) - half, float(values[0]) + half, None, None, None)
    found = spread(values, stds)
    half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, len(values) - 1) * np.sqrt(found.mean_variance))
    return Summary(
        len(values), found.mean, found.mean - half, found.mean + half, float(np.sqrt(found.between)),
        *between_interval(values, stds),
    )  # fmt: skip


def between_interval(values: Array, stds: Array) -> tuple[float, float]:
    """95 % interval of the standard deviation between two robots or more.

    Limits are where ``Q = sum (y - mean)^2 / (s^2 + tau^2)``, which falls with tau, is at the quantiles of its distribution,
    chi-square with one degree of freedom less than there are robots.
    """
    scale = float(np.sqrt(np.var(values) + np.mean(stds**2)))
    if scale == 0.0:
        return 0.0, 0.0
    y, v = (values - values.mean()) / scale, (stds / scale) ** 2 + 1e-12

    def limit(share: float) -> float:
        wanted = float(stats.chi2.ppf(share, len(y) - 1))

        def excess(between: float) -> float:
            w = 1.0 / (v + between)
            return float(w @ (y - w @ y / w.sum()) ** 2) - wanted

        return scale * float(np.sqrt(_where_it_vanishes(excess)))

    return limit(0.5 + 0.5 * LEVEL), limit(0.5 - 0.5 * LEVEL)


def _where_it_vanishes(function: Callable[[float], float]) -> float:
    """Of a function that ends negative: where it changes sign; zero where it is negative there already."""
    if function(0.0) <= 0.0:
        return 0.0
    high = 1.0
    while function(high) > 0.0:
        high *= 4.0
    return float(optimize.brentq(function, 0.0, high, xtol=1e-14, rtol=1e-12))


def p_value_beside(value: float, std: float, others: Array, others_std: Array) -> float:
    """Chance of a robot's estimate as far from what the others predict, two-sided; 1 with too few others.

    The estimate less the others' mean has the variance ``std^2 + tau^2 + variance of the mean``; Student's t with the degrees of
    freedom ``2 variance^2 / variance(tau^2)`` (F. E. Satterthwaite, Biometrics Bulletin 2, 1946), the latter from the restricted
    likelihood's information; one less than there are others where all are equally certain.
    """
    if len(others) < FEWEST_OTHERS:
        return 1.0
    found = spread(others, others_std)
    variance = std**2 + found.between + found.mean_variance
    if variance == 0.0:
        return 1.0
    freedom = max(1.0, variance**2 * found.information)
    return float(2.0 * stats.t.sf(abs(value - found.mean) / np.sqrt(variance), freedom))


def p_values(values: Array, stds: Array, tests: int = 1) -> tuple[Array, Mask]:
    """Each robot's p-value beside the others, corrected for so many `tests` (Bonferroni), and which robots stand out; both (k,).

    Robots that stand out must not hide each other. Those begin that lie near a median, with a median deviation as the standard
    deviation between robots; the others are held against them, the likeliest first, and join them unless the corrected p-value
    is below `STANDS_OUT`. A third stands out at the most.
    """
    count = len(values)
    counted = _near_median(values, stds)

    def beside(i: int) -> float:
        others = counted & (np.arange(count) != i)
        return min(1.0, tests * p_value_beside(float(values[i]), float(stds[i]), values[others], stds[others]))

    for _ in range(count):
        left = [(beside(i), i) for i in np.flatnonzero(~counted).tolist()]
        if not left or max(left)[0] < STANDS_OUT:
            break
        counted[max(left)[1]] = True
    p = np.array([beside(i) for i in range(count)])
    return p, p < STANDS_OUT


def _near_median(values: Array, stds: Array) -> Mask:
    """Robots whose deviation from the median is one that median deviations make likely."""
    mean, between = float(np.median(values)), 0.0
    for _ in range(ROUNDS):
        off = (values - mean) ** 2
        between = _median_variance(off, stds)
        weights = 1.0 / np.maximum(stds**2 + between, 1e-300)
        mean = float(np.quantile(values, 0.5, method="inverted_cdf", weights=weights))
    deviation = np.abs(values - mean) / np.sqrt(np.maximum(stds**2 + between, 1e-300))
    out = np.ones(len(values), dtype=bool)
    farthest = np.argsort(-deviation, kind="stable")[: len(values) // 3]
    out[farthest[deviation[farthest] > SUSPECT]] = False
    return out


def _median_variance(off: Array, stds: Array) -> float:
    """Variance between robots at which the median of ``off / (s^2 + variance)`` is that of a squared normal deviate."""

    def excess(between: float) -> float:
        return float(np.median(off / np.maximum(stds**2 + between, 1e-300))) - MEDIAN_SQUARE

    high = float(np.max(off)) / MEDIAN_SQUARE
    if excess(0.0) <= 0.0 or high == 0.0:
        return 0.0
    return float(optimize.brentq(excess, 0.0, high, xtol=1e-12 * high, rtol=1e-12))


@dataclass(frozen=True)
class LevelChange:
    """When a robot's parameter changed.

    Attributes
    ----------
    at : int
        Place of the first date after the change.
    before, after : float
        Its value until then and from then on.
    p_value : float
        That nothing changed, corrected for the dates at which it may have been and for other tests.
    """

    at: int
    before: float
    after: float
    p_value: float


def change(values: Array, covariance: Array, tests: int = 1) -> LevelChange | None:
    """The date between two levels that fits estimates by date best; None where one level does as well.

    Parameters
    ----------
    values : array, shape (d,)
        Estimates in the order of their dates.
    covariance : array, shape (d, d)
    tests : int
        For which the p-value is corrected, beside the dates.
    """
    count = len(values)
    best: tuple[float, LevelChange] | None = None
    inverse = np.linalg.pinv(covariance, rcond=1e-10, hermitian=True)
    for at in range(1, count):
        design = np.stack([np.arange(count) < at, np.arange(count) >= at], axis=1).astype(float)
        of_levels = np.linalg.pinv(design.T @ inverse @ design, rcond=1e-10, hermitian=True)
        before, after = of_levels @ design.T @ inverse @ values
        variance = float(of_levels[0, 0] + of_levels[1, 1] - 2.0 * of_levels[0, 1])
        size = abs(after - before) / np.sqrt(variance) if variance > 0.0 else 0.0
        p = min(1.0, tests * (count - 1) * float(2.0 * stats.norm.sf(size)))
        if best is None or size > best[0]:
            best = size, LevelChange(at, float(before), float(after), p)
    return best[1] if best is not None and best[1].p_value < CHANGED else None
