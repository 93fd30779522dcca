"""Tests of a fit: they pass where the model holds, and each fails where it should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from two_drives import HZ, noisy, truth

from rx90b_flex.identify.transfer_function import TransferFit, fit_transfer_functions
from rx90b_flex.identify.validation import Validation, cost_bounds, validate


@pytest.fixture(scope="module")
def good() -> TransferFit:
    return fit_transfer_functions(noisy(truth(HZ), HZ, 0.01, np.random.default_rng(1)), 3)


def verdicts(validation: Validation) -> dict[str, bool]:
    return {check.name: check.passed for check in validation.checks}


def test_good_fits_pass() -> None:
    passed = count_passes(range(8))
    # the cost passes 95 times in 100: 5 or more of 8 with probability 0.9996; the others more often
    assert (passed >= 5).all()


def count_passes(seeds: range) -> np.ndarray:
    """How many fits pass each test."""
    fits = [fit_transfer_functions(noisy(truth(HZ), HZ, 0.01, np.random.default_rng(s)), 3) for s in seeds]
    return np.sum([[check.passed for check in validate(fit).checks] for fit in fits], axis=0)


def test_a_missing_mode_fails_cost_whiteness_and_agreement_and_says_so() -> None:
    short = fit_transfer_functions(noisy(truth(HZ), HZ, 0.01, np.random.default_rng(1)), 2)
    validation = validate(short)
    told = {check.name: check for check in validation.checks}
    assert not told["cost"].passed and not told["whiteness"].passed and not told["agreement"].passed
    assert "modes are missing" in told["cost"].implies
    assert short.inflation > 1.0  # and the standard deviations are wider than noise alone makes them


def test_a_covariance_that_is_too_large_fails_the_cost(good: TransferFit) -> None:
    loose = replace(good.response, covariance=4.0 * good.response.covariance)
    told = validate(fit_transfer_functions(loose, 3)).checks[0]
    assert not told.passed and "covariance is too large" in told.implies


def test_cost_bounds_are_those_of_the_source_for_one_output() -> None:
    """(6.42), (6.43): one entry a line, weights from N_o realisations."""
    rng = np.random.default_rng(2)
    measured = noisy(truth(HZ)[:, :1, :1], HZ, 0.01, rng, ("joint_1",))
    fit = fit_transfer_functions(replace(measured, degrees_of_freedom=15.0), 2)
    no, free = 16, len(HZ) - fit.parameters / 2
    mean = (no - 1) / (no - 2) * free
    std = np.sqrt((no - 1) ** 3 / ((no - 2) ** 2 * (no - 3)) * free)
    np.testing.assert_allclose(cost_bounds(fit), (mean - 1.959964 * std, mean + 1.959964 * std), rtol=1e-6)


def test_too_few_degrees_of_freedom_give_no_bound_and_no_pass(good: TransferFit) -> None:
    few = fit_transfer_functions(replace(good.response, degrees_of_freedom=4.0), 3)
    told = validate(few).checks[0]
    assert not told.passed and "too few degrees of freedom" in told.implies


@pytest.mark.slow
def test_good_fits_pass_as_often_as_their_levels_say() -> None:
    passed = count_passes(range(40))
    # cost: 95 %, 32 or more of 40 with probability 0.9999; the others count at a level of 1 % for each of at most four
    assert passed[0] >= 32
    assert (passed[1:] >= 33).all()
