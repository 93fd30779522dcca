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
