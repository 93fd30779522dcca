"""Claims about errors that are slow: they are no noise, whatever a free form of the motion makes of them, and coloured noise is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from independent import Array, Motion, coloured, friction, harmonics, run, two_joints, white, write_files

import rx90b_flex as rf

NOISE = (0.05, 0.05)  # N m
DECLARED = ("torque_offset", "coulomb_friction", "viscous_friction")
RATE_HZ, MOVES_S, RESTS_S = 200.0, 10.0, 10.0
Hidden = Callable[[Motion, Array, int], Array]


def closed(folder: Path, hidden: Hidden, memory: float = 0.0, noise: tuple[float, float] = NOISE) -> rf.ClosedLoop:
    """Of three recordings with a torque that no motion tells, its offsets declared."""
    arm, rng, runs = two_joints(folder), np.random.default_rng(5), []
    for i, role in enumerate(("identification", "identification", "validation")):
        m = harmonics(rng, 2, period_s=20.0, rate_hz=200.0, lines=8)
        off = coloured(rng, len(m.time), noise, memory) if memory else white(rng, len(m.time), noise)
        forces = [friction((1.0, 0.6), (1.5, 0.8)), lambda m, load, i=i: hidden(m, load, i)]
        runs.append(run(arm, role, m, forces, off))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in DECLARED]
    return rf.close_loop(write_files(folder, arm, declared, runs, cutoff_hz=20.0))


def drifting(motion: Motion, load: Array, number: int) -> Array:
    """An offset of the second joint that goes up and down with a time of its own."""
    out = np.zeros_like(load)
    out[:, 1] = 1.5 * np.sin(2 * np.pi * motion.time / 13.7 + number)
    return out


def differing(motion: Motion, load: Array, number: int) -> Array:
    """An offset of the second joint that each recording has another of."""
    out = np.zeros_like(load)
    out[:, 1] = (1.0, -1.0, 2.0)[number]
    return out


def nothing(motion: Motion, load: Array, number: int) -> Array:
    return np.zeros_like(load)


@pytest.mark.parametrize(
    ("hidden", "said"),
    [(drifting, "drifts with time"), pytest.param(differing, "differs between", marks=pytest.mark.slow)],
)
def test_what_is_slow_is_not_called_noise(tmp_path: Path, hidden: Hidden, said: str) -> None:
    result = closed(tmp_path, hidden)
    assert result.verdict in ("unexplained", "partly_explained")
    assert any("elbow" in c and said in c for c in result.cautions), result.cautions


@pytest.mark.parametrize("memory", [0.95, pytest.param(0.0, marks=pytest.mark.slow)])
def test_noise_is_no_such_error(tmp_path: Path, memory: float) -> None:
    result = closed(tmp_path, nothing, memory, (0.5, 0.3))
    assert result.verdict == "nothing_missing" and not any("slow" in c for c in result.cautions)


def stopping(rng: np.random.Generator) -> Motion:
    """Harmonics that fade in and out, and a rest as long as they last."""
    m = harmonics(rng, 2, period_s=MOVES_S, rate_hz=RATE_HZ, lines=8)
    s = np.clip(np.minimum(m.time, MOVES_S - m.time) / 2.0, 0.0, 1.0)[:, None]
    fade = s**3 * (10 - 15 * s + 6 * s**2)
    q = np.vstack([fade * m.q, np.repeat((fade * m.q)[-1:], round(RESTS_S * RATE_HZ), axis=0)])
    v = np.gradient(q, 1 / RATE_HZ, axis=0)
    return Motion(np.arange(len(q)) / RATE_HZ, q, v, np.gradient(v, 1 / RATE_HZ, axis=0))


@pytest.mark.parametrize("creeps", [2.0, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_torque_that_creeps_while_joints_stand_is_told_from_noise(tmp_path: Path, creeps: float) -> None:
    """As under a controller that integrates: within what friction holds it goes where it likes."""
    arm, rng, runs = two_joints(tmp_path), np.random.default_rng(3), []
    for i, role in enumerate(("identification", "identification", "validation")):
        m = stopping(rng)

        def held(m: Motion, load: Array, i: int = i) -> Array:
            rest = np.where(m.time > MOVES_S, m.time - MOVES_S, 0.0)[:, None]
            return np.asarray(creeps * np.sin(rest * np.array([0.7, 0.9]) + i * (rest > 0)) * (rest > 0))

        runs.append(run(arm, role, m, [friction((3.0, 2.0), (1.5, 0.8)), held], white(rng, len(m.time), NOISE)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in DECLARED]
    result = rf.close_loop(write_files(tmp_path, arm, declared, runs, cutoff_hz=20.0))
    said = [c for c in result.cautions if "stand still" in c]
    assert bool(said) == (creeps > 0.0)
    assert (result.verdict in ("unexplained", "partly_explained")) == (creeps > 0.0)
    if said:
        moving = result.moving.after
        assert f"{moving:.2g}"[:4] in said[0] or moving < result.after.validation.relative_error / 2
