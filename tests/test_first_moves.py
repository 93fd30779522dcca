"""Claims about logs that begin at rest: what friction holds until a joint first moves spoils no model, name or verdict."""

from __future__ import annotations

from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.moving import unmoved, waiting
from rx90b_flex.diagnose.residual import Errors
from rx90b_flex.view.report import headline

COULOMB, VISCOUS, STIFFNESS = np.array([1.0, 0.6]), np.array([1.5, 0.8]), np.array([150.0, 100.0])
NOISE, RATE_HZ, LENGTH_S, RAMP_S, CUTOFF_HZ = (0.02, 0.02), 200.0, 20.0, 0.6, 20.0
WAITS_S = (0.5, 2.0)
DECLARED = [{"type": t, "joint": j} for j in ("shoulder", "elbow") for t in ("coulomb_friction", "viscous_friction")]
RIPPLE = ("gear_ripple", 0, {"order": 30.0, "amplitude": 0.25, "phase": 0.4})
STRIBECK = ("stribeck_friction", 1, {"torque": 0.4, "velocity": 0.1, "power": 1.0})


def started(rng: np.random.Generator, ramp_s: float = RAMP_S) -> tuple[ind.Motion, ind.Array]:
    """Harmonics that each joint begins after a wait of its own, with its rate rising along a quintic; and the waits, s."""
    whole = ind.harmonics(rng, 2, period_s=LENGTH_S, rate_hz=RATE_HZ)
    wait = rng.uniform(*WAITS_S, 2)
    since = whole.time[:, None] - wait
    s = np.clip(since / ramp_s, 0.0, 1.0)
    rate, rising = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2 / ramp_s
    at = (2.5 * s**4 - 3 * s**5 + s**6) * ramp_s + np.maximum(since - ramp_s, 0.0)
    q, v, a = (
        np.stack([np.interp(x, whole.time, y) for x, y in zip(at.T, ys.T, strict=True)], 1)
        for ys in (whole.q, whole.v, whole.a)
    )
    return ind.Motion(whole.time, q, v * rate, a * rate**2 + v * rising), wait


def dry(rng: np.random.Generator, wait: ind.Array) -> ind.Torque:
    """A sign of the velocity, and before the first move any part of it."""
    part = rng.uniform(-1, 1, 2)
    return lambda m, load: COULOMB * np.where(m.time[:, None] < wait, part, np.sign(m.v))


def dahl(rng: np.random.Generator, wait: ind.Array) -> ind.Torque:
    """Dahl's friction that begins anywhere."""
    begins = rng.uniform(-1, 1, 2)

    def torque(m: ind.Motion, load: ind.Array) -> ind.Array:
        out = np.tile(begins, (len(m.time), 1))
        for k in range(1, len(out)):
            step = m.q[k] - m.q[k - 1]
            end = np.sign(step)
            out[k] = np.where(
                step == 0, out[k - 1], end + (out[k - 1] - end) * np.exp(-np.abs(step) * STIFFNESS / COULOMB)
            )
        return COULOMB * out

    return torque


def closed(folder: Path, seed: int, friction: object, hidden: tuple = ()) -> rf.ClosedLoop:
    arm, rng, runs = ind.two_joints(folder), np.random.default_rng(seed), []
    for role in ("identification", "identification", "validation"):
        m, wait = started(rng)
        torques = [ind.friction((0.0, 0.0), VISCOUS), friction(rng, wait), *(ind.hidden(*h) for h in hidden)]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE)))
    result = rf.close_loop(ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ))
    assert isinstance(result, rf.ClosedLoop)
    return result


def names(result: rf.ClosedLoop) -> set[str]:
    return {e.effect.label for e in result.effects}


SEEDS = [
    1,
    *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3)),
    *(pytest.param(seed, marks=pytest.mark.long) for seed in (4, 5)),
]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_sound_robot_that_waits_lacks_nothing(tmp_path, seed):
    result = closed(tmp_path, seed, dry)
    assert not result.effects
    assert result.verdict == "nothing_missing"


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_hidden_is_found_behind_a_wait_and_nothing_else(tmp_path, seed):
    result = closed(tmp_path, seed, dry, (RIPPLE, STRIBECK))
    assert names(result) == {"shoulder.gear_ripple", "elbow.stribeck_friction"}
    assert result.verdict == "explained"
    noise = np.sqrt(2 * CUTOFF_HZ / RATE_HZ) * np.array(NOISE)  # white noise behind the low-pass
    assert (np.array(result.after.told.validation.torque_rms) < 1.2 * noise).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_hysteresis_that_begins_anywhere_is_found_on_both_joints(tmp_path, seed):
    result = closed(tmp_path, seed, dahl)
    assert names(result) == {"shoulder.presliding_friction", "elbow.presliding_friction"}
    stiffness = [
        next(p for p in e.parameters if p.name == "stiffness").value
        for e in sorted(result.effects, key=lambda e: e.effect.label, reverse=True)
    ]
    assert stiffness == pytest.approx(STIFFNESS, rel=0.05)
    assert "since joints first move, from" in headline(result)


def test_rows_wait_up_to_half_a_second_after_the_first_move_and_a_creeping_joint_has_yet_to_break_away():
    time = np.arange(1000) / 100.0
    velocity = np.column_stack(
        [np.where(time < 1, 0.0, 1.0), np.where(time < 1, 5e-4, 1.0), np.where(time < 0.1, 0.0, 1.0)]
    )
    assert unmoved(velocity, 100.0).sum(axis=0).tolist() == [100, 100, 0]
    assert waiting(velocity, 100.0).sum(axis=0).tolist() == [150, 0, 0]


def test_errors_are_told_without_rows_that_wait():
    measured, wait = np.ones((10, 2)), np.zeros((10, 2), dtype=bool)
    wait[:5, 0] = True
    predicted = np.where(wait, 5.0, 0.9)
    assert Errors.of([measured], [predicted]).told.relative_error == Errors.of([measured], [predicted]).relative_error
    assert Errors.of([measured], [predicted], [wait]).told.relative_error == pytest.approx(0.1)
