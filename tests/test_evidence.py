"""Claims about what a residual still depends on."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.diagnose.evidence import order_dependence

TIME = np.arange(3000) / 100
ANGLE = 0.8 * np.sin(1.1 * TIME) + 0.5 * np.sin(2.9 * TIME + 1.0)


@pytest.mark.parametrize("order", [24.0, 61.0, 150.0])
def test_a_residual_that_repeats_with_an_angle_is_told_with_its_order(order):
    rng = np.random.default_rng(0)
    left = np.sin(order * ANGLE + 0.4) + rng.normal(size=len(TIME))
    found = order_dependence("joint", left, ANGLE, 6, rng)
    assert found is not None
    name, at = found.signal.rsplit(" ", 1)
    # two lines a lobe of the periodogram: the best lies within half a step
    assert name == "joint order" and float(at) == pytest.approx(order, abs=np.pi / np.ptp(ANGLE))
    # of a power of 1/2 beside 1, a third; the nearest line of the grid may hold four tenths of it
    assert 0.4 / 3 - 0.05 < found.score < 1 / 3 + 0.05


def test_noise_repeats_with_no_angle():
    """Asked at 1 % for one joint, a hundred times: seven or more by chance have a probability below 1e-4."""
    rng = np.random.default_rng(1)
    found = [order_dependence("joint", rng.normal(size=500), ANGLE[:500], 1, rng) for _ in range(100)]
    assert sum(f is not None for f in found) < 7


def test_orders_worked_out_one_from_the_other_are_those_of_their_sines():
    """Of 1,350 orders to 240, each comes from the one before."""
    rng = np.random.default_rng(2)
    angle = np.cumsum(rng.normal(size=2000)) * 0.02 + 20.0 * TIME[:2000] / TIME[1999]
    left = np.sin(231.0 * angle) + 0.3 * rng.normal(size=2000)
    found = order_dependence("joint", left, angle, 1, np.random.default_rng(0))
    assert found is not None
    order = np.arange(8.0 * np.pi / np.ptp(angle), 240.0, np.pi / np.ptp(angle))
    assert len(order) == 1350
    turn = np.outer(order, angle)
    share = 2.0 * ((np.cos(turn) @ left) ** 2 + (np.sin(turn) @ left) ** 2) / len(left) / (left @ left)
    assert found.signal == f"joint order {order[share.argmax()]:.1f}"
    # the score is what is explained beyond chance, which for 2000 samples is about a hundredth
    assert share.max() - 0.03 < found.score < share.max()
