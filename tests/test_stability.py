"""Claims about which modes of a fit count, and how well they are known, where there are modes above the lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from modal_sums import ABOVE, HZ, IN_BAND, ModalSum, a_millisecond, high_above_55_hz
from scipy import stats
from two_drives import FREE, LOCKED, noisy, truth

from rx90b_flex.identify.inverse_eigenvalue import identify_drives
from rx90b_flex.identify.stability import model_weights, spread
from rx90b_flex.identify.transfer_function import TransferFit, fit_transfer_functions


def light(f: np.ndarray) -> np.ndarray:
    return np.full_like(f, 0.02)


def made(system: ModalSum, level: float, seed: int, modes: int | range = range(3, 9)) -> TransferFit:
    return fit_transfer_functions(noisy(system.response(HZ), HZ, level, np.random.default_rng(seed)), modes)


def test_modes_far_above_the_lines_leave_their_flexibility() -> None:
    system = ModalSum.draw((20.0, 34.0, 50.0, 450.0, 600.0), light, 5)
    fit = made(system, 0.01, 1, 3)
    assert "flexibility" in fit.residual_terms
    value, std = fit.residual_flexibility()
    expected = system.flexibility(HZ[-1])
    # at the highest line the next term of the series is (78/450)^2 of this one
    assert (np.abs(value - expected) < 4 * std + (HZ[-1] / 450.0) ** 2 * np.abs(expected).max()).all()
    assert (np.abs(value) > 4 * std).any()
    assert (np.abs(fit.resonances_hz - system.poles_hz()[:3]) < 4 * fit.resonances_std_hz()).all()


def test_without_modes_above_the_lines_no_flexibility_is_found() -> None:
    for seed in range(4):
        fit = fit_transfer_functions(noisy(truth(HZ), HZ, 0.02, np.random.default_rng(seed)), 3)
        # three parameters that say nothing save 9.5, what they cost here, three times in ten thousand
        assert fit.residual_terms == ("direct",)
        assert not fit.residual_flexibility()[0].any() and not fit.residual_flexibility()[1].any()


def test_modes_that_noise_makes_are_refused_and_do_not_count_for_the_drives() -> None:
    """Two modes more than there are, and a user who asks for no fewer."""
    measured = noisy(truth(HZ), HZ, 0.02, np.random.default_rng(1))
    fit = fit_transfer_functions(measured, range(5, 8))
    assert len(fit.resonances_hz) >= 5
    counted = fit.resonances_hz[fit.counted]
    assert len(counted) == len(FREE)
    assert (np.abs(counted - FREE) < 4 * fit.resonances_std_hz()[fit.counted]).all()
    for j in range(2):
        kept = np.array([not why for why in fit.refused_antiresonances(j)])
        found, std = (x[kept] for x in fit.antiresonances(j))
        assert len(found) == len(LOCKED[j]) and (np.abs(found - LOCKED[j]) < 4 * std).all()
    assert all(why for why, counts in zip(fit.refused, fit.counted, strict=True) if not counts)
    drives = identify_drives(fit)
    assert drives.modes == (3, 3) and len(drives.decay_rate) == 3
    for drive, inertia, stiffness in zip(drives.drives, (2.0, 1.0), (6.0e4, 9.0e4), strict=True):
        assert abs(drive.inertia - inertia) < 4 * drive.inertia_std
        assert abs(drive.stiffness - stiffness) < 4 * drive.stiffness_std


def test_a_vague_mode_is_refused_with_its_deviation() -> None:
    fit = fit_transfer_functions(noisy(truth(HZ), HZ, 0.02, np.random.default_rng(1)), 3)
    assert fit.counted.all()
    worse = tuple(replace(one, covariance=1e6 * one.covariance) for one in fit.alternatives)
    vague = replace(fit, covariance=1e6 * fit.covariance, alternatives=worse)
    shares = vague.resonances_std_hz() / vague.resonances_hz
    for share, why in zip(shares, vague.refused, strict=True):
        assert ("its standard deviation" in why) == (share > 0.1)
    assert (shares > 0.1).any()


def test_a_mode_that_other_orders_do_not_have_is_refused() -> None:
    fit = fit_transfer_functions(noisy(truth(HZ), HZ, 0.02, np.random.default_rng(1)), range(2, 6))
    assert len(fit.resonances_hz) == 3 and fit.counted.all()
    moved = tuple(
        replace(one, model=replace(one.model, frequency_hz=np.where(one.resonances_hz > 50.0, 70.0, one.resonances_hz)))
        if one.modes != 3
        else one
        for one in fit.candidates
    )
    told = replace(fit, candidates=moved)
    assert [bool(why) for why in told.refused] == [False, False, True]
    assert "not found again" in told.refused[2]


def test_models_that_fit_alike_widen_what_they_disagree_on() -> None:
    one = np.array([0.1])
    others = [(np.array([20.0]), one), (np.array([21.0]), one), (np.array([90.0]), one)]
    # half and half: the mean square of 0 and 1 Hz on top; the third has another mode
    expected = np.sqrt(0.1**2 + 0.5)
    np.testing.assert_allclose(spread(np.array([20.0]), one, others, [0.4, 0.4, 0.2]), expected)
    fit = fit_transfer_functions(noisy(truth(HZ), HZ, 0.02, np.random.default_rng(1)), range(2, 6))
    weights = model_weights(fit.alternatives, 1.0, 1.0)
    assert weights.sum() == pytest.approx(1.0)
    assert all(w == 0.0 for w, tried in zip(weights, fit.alternatives, strict=True) if tried.modes == 2)


def test_a_fit_sets_out_from_given_resonances_too() -> None:
    measured = noisy(truth(HZ), HZ, 0.02, np.random.default_rng(3))
    own, given = (fit_transfer_functions(measured, 3, start_hz=start) for start in ((), (25.0, 40.0, 60.0)))
    assert given.cost <= own.cost + 0.02  # both within a hundredth of the same summit, or the given one higher
    for start, said in (((25.0,), "1 resonances to start from"), ((1.0, 40.0, 60.0), "is 1 Hz")):
        with pytest.raises(ValueError, match=said):
            fit_transfer_functions(measured, 3, start_hz=start)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [a_millisecond, pytest.param(high_above_55_hz, marks=pytest.mark.long)])
def test_intervals_of_95_per_cent_hold_where_damping_is_high(damping: Callable[[np.ndarray], np.ndarray]) -> None:
    """Of all resonances and antiresonances between the lines that count; four modes lie above, orders are chosen by the fit."""
    held: list[bool] = []
    poles = 0
    for seed in range(40, 50):
        system = ModalSum.draw(IN_BAND + ABOVE, damping, seed)
        fit = made(system, 0.01 if seed % 2 else 0.003, 1000 + seed, range(4, 9))
        rows = [(fit.resonances_hz, fit.resonances_std_hz(), fit.refused, system.poles_hz())]
        for j in range(2):
            rows.append((*fit.antiresonances(j), fit.refused_antiresonances(j), system.zeros_hz(j)))
        for found, std, refused, true in rows:
            counts = fit.in_band(found) & np.array([not why for why in refused])
            off = np.abs(found[counts, None] - true).min(axis=1)
            held += (off < 1.96 * std[counts]).tolist()
        poles += int((fit.counted & fit.in_band(fit.resonances_hz)).sum())
    # a zero's error goes with that of the pole beside it: as many independent intervals as poles
    low, high = stats.binom.ppf(1e-3, poles, 0.93) / poles, stats.binom.isf(1e-3, poles, 0.97) / poles
    assert low <= np.mean(held) <= high
