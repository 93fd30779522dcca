"""Claims about where turn-overs of dry friction begin that nobody stated: logs whose moves begin and end in exact rests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from independent import Motion, run, two_joints, white, write_files

import rx90b_flex as rf
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign

RATE_HZ, TURNOVER = 250.0, 0.02  # rad/s
DRY, VISCOUS, NOISE = np.array([4.0, 2.5]), np.array([3.0, 2.0]), (0.02, 0.02)


def point_to_point(rng: np.random.Generator, duration_s: float) -> Motion:
    """Moves by polynomials of fifth degree between random points, with rests between them in which nothing moves at all."""
    time = np.arange(int(duration_s * RATE_HZ)) / RATE_HZ
    q, v, a = (np.zeros((len(time), 2)) for _ in range(3))
    at, now = rng.uniform(-1.0, 1.0, 2), 0.0
    while now < duration_s:
        to = rng.uniform(-1.0, 1.0, 2)
        length = max(0.5, 2.0 * np.abs(to - at).max() / rng.uniform(0.5, 1.2))
        moves = (time >= now) & (time < now + length)
        s = ((time[moves] - now) / length)[:, None]
        q[moves] = at + (to - at) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        v[moves] = (to - at) * (30 * s**2 - 60 * s**3 + 30 * s**4) / length
        a[moves] = (to - at) * (60 * s - 180 * s**2 + 120 * s**3) / length**2
        q[time >= now + length], at, now = to, to, now + length + rng.uniform(0.2, 0.8)
    return Motion(time, q, v, a)


def campaign(folder: Path, seed: int, step_rad: float, turnover: float = TURNOVER) -> Path:
    """Two joints whose dry friction turns over within so many rad/s; angles exact, or counted in steps."""
    arm, rng, runs = two_joints(folder), np.random.default_rng(seed), []

    def friction(m: Motion, _load: np.ndarray) -> np.ndarray:
        return DRY * np.tanh(m.v / turnover) + VISCOUS * m.v

    for role in ("identification", "identification", "validation"):
        m = point_to_point(rng, 20.0)
        made = run(arm, role, m, [friction], white(rng, len(m.time), NOISE))
        logged = np.round(m.q / step_rad) * step_rad if step_rad else m.q
        runs.append(replace(made, motion=replace(m, q=logged)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    return write_files(folder, arm, declared, runs, cutoff_hz=10.0)


@pytest.mark.parametrize("step_rad", [0.0, 1e-5])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_a_turn_over_is_found_from_moves_between_exact_rests(tmp_path, seed, step_rad):
    read = load_campaign(campaign(tmp_path, seed, step_rad))
    regression = Regression.of(load_robot(read.robot_source), read.identification, read.cutoff_hz)
    model = identify(regression, regression.robot.effects, fit_links=True)
    found = [e.turnover for e in model.effects if e.type_name() == "coulomb_friction"]
    assert found == pytest.approx([TURNOVER] * 2, rel=0.02)
    assert [e.torque for e in model.effects if e.type_name() == "coulomb_friction"] == pytest.approx(DRY, rel=0.01)


@pytest.mark.parametrize("turnover", [0.1, pytest.param(0.3, marks=pytest.mark.slow)])
def test_a_turn_over_may_be_as_wide_as_a_good_part_of_the_speed(tmp_path, turnover):
    read = load_campaign(campaign(tmp_path, 1, 0.0, turnover))
    regression = Regression.of(load_robot(read.robot_source), read.identification, read.cutoff_hz)
    model = identify(regression, regression.robot.effects, fit_links=True)
    found = [e for e in model.effects if e.type_name() == "coulomb_friction"]
    assert [e.turnover for e in found] == pytest.approx([turnover] * 2, rel=0.05)
    assert [e.torque for e in found] == pytest.approx(DRY, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5])
def test_with_nothing_hidden_nothing_is_found_between_exact_rests(tmp_path, seed):
    result = rf.close_loop(campaign(tmp_path, seed, 0.0))
    assert result.effects == ()
    assert result.verdict == "nothing_missing"
