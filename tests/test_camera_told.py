"""Claims about what the camera's command tells of a stiffness, and of mistakes in its table."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.identify.measured_stiffness import REACH, HingeStiffness


def hinges(stiffness: np.ndarray, share: np.ndarray, seed: int) -> list[HingeStiffness]:
    """Of compliances that are known with normal errors, of some share of the true one."""
    compliance = (1.0 + share * np.random.default_rng(seed).standard_normal(len(stiffness))) / stiffness
    std = share / stiffness
    return [HingeStiffness("hinge", 1.0 / c, s / c**2) for c, s in zip(compliance, std, strict=True)]


@pytest.mark.parametrize("seed", range(3))
def test_what_is_called_determined_holds_about_as_often_as_stated(seed: int) -> None:
    """Of hinges of all kinds, most of them told weakly; 95 % of 4000 are known to 0.35 %."""
    share = np.exp(np.random.default_rng(seed).uniform(np.log(0.02), np.log(2.0), 8000))
    found = [h for h in hinges(np.full(8000, 2.1e4), share, seed) if h.determined]
    assert len(found) > 3000
    assert 0.93 < np.mean([abs(h.value - 2.1e4) < REACH * h.even_std for h in found]) < 0.96


@pytest.mark.parametrize("share", [0.03, 0.2, 0.43, 1.0])
def test_the_interval_of_a_stiffness_holds_in_95_percent_however_weakly_it_is_told(share: float) -> None:
    found = hinges(np.full(2000, 2.1e4), np.full(2000, share), 1)
    assert np.mean([h.interval[0] <= 2.1e4 <= h.interval[1] for h in found]) == pytest.approx(0.95, abs=0.02)
    wrong = [h for h in found if h.determined and abs(h.value - 2.1e4) > REACH * h.even_std]
    assert len(wrong) / len(found) < 0.07  # selected or not: no stiffness is called determined and wrong more often


def test_a_compliance_below_zero_bounds_no_stiffness() -> None:
    low, high = HingeStiffness("hinge", -1e4, 1e3).interval
    assert np.isinf(low) and np.isinf(high)
    low, high = HingeStiffness("hinge", -1e4, 1e4).interval
    assert low == pytest.approx(1e4 / (REACH - 1.0)) and np.isinf(high)
