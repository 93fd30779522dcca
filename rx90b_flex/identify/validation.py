"""Is a fitted transfer function good enough? Tests of section 6.4.2, each with its verdict and what that implies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frf import confidence_radius
from rx90b_flex.identify.starting_values import whitening
from rx90b_flex.identify.transfer_function import TransferFit, efficiency

LEVEL = 0.95  # of every band
DOUBT = 0.01  # chance that a good fit fails a test that counts how often a band is left


@dataclass(frozen=True)
class Check:
    """One test.

    Attributes
    ----------
    name : str
    passed : bool
    found : str
        What was measured against what was expected.
    implies : str
        What that means for the user of the fit.
    """

    name: str
    passed: bool
    found: str
    implies: str


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Correlation of the weighted residuals along the lines (6.44), over that at lag zero.

    Attributes
    ----------
    lag : array, shape (L,)
        Lines apart, 1 to L.
    correlation : complex array, shape (L, n)
        One column an output; its n inputs are averaged.
    bound : array, shape (L,)
        Amplitude that white residuals stay below at 95 % of the lags (6.45).
    """

    lag: Array
    correlation: np.ndarray
    bound: Array

    @property
    def inside(self) -> Array:
        """Part of the lags within the bound, shape (n,)."""
        return (np.abs(self.correlation) <= self.bound[:, None]).mean(axis=0)


@dataclass(frozen=True, eq=False)
class Validation:
    """All tests of a fit.

    Attributes
    ----------
    checks : tuple of Check
    inside : array, shape (n, n)
        Part of the lines at which the fit lies in the 95 % band of the nonparametric estimate.
    """

    checks: tuple[Check, ...]
    inside: Array

    @property
    def passed(self) -> bool:
        """Whether every test passed."""
        return all(check.passed for check in self.checks)


def validate(fit: TransferFit) -> Validation:
    """Test a fit: value of the cost, whiteness of the residuals, bands of the modes, agreement with the nonparametric estimate."""
    inside = band_agreement(fit)
    return Validation((_cost(fit), _white(fit), _modes(fit), _agreement(fit, inside)), inside)


def cost_bounds(fit: TransferFit) -> tuple[float, float]:
    """95 % bounds of the cost where the model lacks nothing: (6.42) and (6.43) for n*n entries weighted together.

    Infinite where the weights have too few degrees of freedom.
    """
    lines, entries = len(fit.response.hz), len(fit.response.joints) ** 2
    mean, variance, _ = efficiency(fit.response)
    free = lines * entries - fit.parameters / 2
    if not np.isfinite(mean * variance):
        return 0.0, np.inf
    half = stats.norm.ppf(0.5 + LEVEL / 2) * np.sqrt(variance * free)
    return float(mean * free - half), float(mean * free + half)


def whiteness(fit: TransferFit) -> Whiteness:
    """Correlation of the residuals over lags up to half the lines.

    It is divided by its value at lag zero, which the test of the cost judges; the degrees of freedom of the weights then drop out.
    """
    n, lines = len(fit.response.joints), len(fit.response.hz)
    error = fit.model.frf(fit.response.hz) - fit.response.value
    weighted = np.einsum("fab,fb->fa", whitening(fit.response), error.reshape(lines, -1)).reshape(lines, n, n)
    lag = np.arange(1, lines // 2 + 1)
    power = (np.abs(weighted) ** 2).mean(axis=(0, 2))
    products = [(weighted[:-k].conj() * weighted[k:]).mean(axis=(0, 2)) / power for k in lag]
    return Whiteness(lag.astype(float), np.array(products), np.sqrt(-np.log(1 - LEVEL) / ((lines - lag) * n)))


def band_agreement(fit: TransferFit) -> Array:
    """Part of the lines at which each entry of the fit lies in the 95 % band of the nonparametric estimate, shape (n, n)."""
    error = np.abs(fit.model.frf(fit.response.hz) - fit.response.value)
    return (error <= confidence_radius(fit.response, LEVEL)).mean(axis=0)


def _fewest(trials: int) -> float:
    """Part inside a 95 % band below which a good fit falls with probability `DOUBT`."""
    return float(stats.binom.ppf(DOUBT, trials, LEVEL) / trials)


def _cost(fit: TransferFit) -> Check:
    low, high = cost_bounds(fit)
    found = f"cost {fit.cost:.0f}, expected {low:.0f} to {high:.0f}"
    if not np.isfinite(high):
        return Check(
            "cost",
            False,
            f"cost {fit.cost:.0f}, no bounds",
            "the covariance has too few degrees of freedom for a bound: more realisations, or a smoothed covariance, are needed",
        )
    if fit.cost > high:
        implies = (
            "noise does not explain the residuals: modes are missing or nonlinear bias is left; standard deviations "
            f"were widened by {np.sqrt(fit.inflation):.2f}"
        )
    elif fit.cost < low:
        implies = "the residuals are smaller than the noise: the covariance is too large or its degrees of freedom are too low"
    else:
        implies = "noise explains the residuals"
    return Check("cost", low <= fit.cost <= high, found, implies)


def _white(fit: TransferFit) -> Check:
    white = whiteness(fit)
    fewest = _fewest(len(white.lag))
    found = ", ".join(f"{j} {100 * part:.0f} %" for j, part in zip(fit.response.joints, white.inside, strict=True))
    bad = [j for j, part in zip(fit.response.joints, white.inside, strict=True) if part < fewest]
    implies = (
        f"residuals of {', '.join(bad)} keep a shape along frequency: dynamics that the model lacks, or nonlinear bias"
        if bad
        else "no dynamics are left in the residuals"
    )
    return Check(
        "whiteness", not bad, f"lags within the 95 % bound: {found}; expected {100 * fewest:.0f} % or more", implies
    )


def _modes(fit: TransferFit) -> Check:
    f, std = fit.resonances_hz, fit.resonances_std_hz()
    width = f * fit.model.damping_ratio
    inside = fit.in_band(f) & fit.counted
    loose = [f"{x:.1f} Hz" for x in f[inside & (std > 0.5 * width)]]
    refused = [f"{x:.1f} Hz" for x in f[fit.in_band(f) & ~fit.counted]]
    found = f"{int(inside.sum())} modes in the band, frequencies to {std[inside].max(initial=0.0):.2f} Hz (one sigma)"
    if refused:
        found += f"; {len(refused)} more refused"
    implies = "each mode's frequency is known to less than half its own half width"
    if loose:
        implies = f"the modes at {', '.join(loose)} are hardly determined: fewer modes, or more data"
    if refused:
        implies += f"; terms at {', '.join(refused)} are no modes that the data show"
    return Check("modes", not loose, found, implies)


def _agreement(fit: TransferFit, inside: Array) -> Check:
    fewest = _fewest(len(fit.response.hz))
    joints = fit.response.joints
    bad = [f"{joints[j]} from {joints[k]}" for j, k in zip(*np.nonzero(inside < fewest), strict=True)]
    blunt = (fit.frf_std(fit.response.hz) > 0.5 * fit.response.std()).mean()
    found = f"{100 * inside.min():.0f} to {100 * inside.max():.0f} % of lines in the 95 % band; expected {100 * fewest:.0f} % or more"
    implies = f"the model misses {', '.join(bad)}" if bad else "the model stands for the measured response"
    if blunt > 0.5:
        implies += "; the fit's own band is as wide as the data's at most lines, so that this test sees little"
    return Check("agreement", not bad, found, implies)
