"""Claims about errors that no noise has, where how much of them is noise is not known: such a model lacks something."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from independent import Array, Motion, coloured, friction, harmonics, run, two_joints, white, write_files

import rx90b_flex as rf
from rx90b_flex.diagnose.moving import TorqueErrors
from rx90b_flex.diagnose.unlike_noise import Bursts, Course, unlike_noise

NOISE = (0.3, 0.2)  # N m
RATE_HZ = 200.0
DECLARED = ("torque_offset", "coulomb_friction", "viscous_friction")


def closed(folder: Path, hidden: Callable[[np.random.Generator, Motion], Array], memory: float = 0.9) -> rf.ClosedLoop:
    """Of three recordings whose torques have something of no law, beside coloured noise of unknown size."""
    arm, rng, runs = two_joints(folder), np.random.default_rng(7), []
    for role in ("identification", "identification", "validation"):
        m = harmonics(rng, 2, period_s=20.0, rate_hz=RATE_HZ, lines=8)
        off = hidden(rng, m) + coloured(rng, len(m.time), NOISE, memory)
        runs.append(run(arm, role, m, [friction((1.0, 0.6), (1.5, 0.8))], off))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in DECLARED]
    return rf.close_loop(write_files(folder, arm, declared, runs, cutoff_hz=20.0))


def nothing(rng: np.random.Generator, m: Motion) -> Array:
    return np.zeros_like(m.q)


def knocks(rng: np.random.Generator, m: Motion) -> Array:
    """Of a gear with play: decaying knocks of either sign, at times that no law of the motion tells."""
    out, t = np.zeros_like(m.q), m.time
    for at in rng.uniform(1.0, t[-1] - 1.0, 9):
        after = np.maximum(t - at, 0.0)
        knock = rng.normal() * 12.0 * np.exp(-after / 0.04) * np.cos(70.0 * after) * (t >= at)
        out += knock[:, None] * [1.0, 0.6]
    return out


def warming(rng: np.random.Generator, m: Motion) -> Array:
    """A sensor's zero that creeps to its end."""
    out = np.zeros_like(m.q)
    out[:, 1] = 0.6 * (1.0 - np.exp(-m.time / 12.0))
    return out


def test_bursts_are_not_called_nothing_missing(tmp_path: Path) -> None:
    result = closed(tmp_path, knocks)
    assert result.verdict in ("unexplained", "partly_explained")
    assert any("comes in no bursts" in c or "something happened there" in c for c in result.cautions), result.cautions


def test_a_zero_that_drifts_is_not_called_nothing_missing(tmp_path: Path) -> None:
    result = closed(tmp_path, warming)
    assert result.verdict in ("unexplained", "partly_explained")
    assert any("elbow" in c and "drifts with time" in c for c in result.cautions), result.cautions


@pytest.mark.parametrize("memory", [0.9, pytest.param(0.0, marks=pytest.mark.slow)])
def test_noise_stays_noise(tmp_path: Path, memory: float) -> None:
    result = closed(tmp_path, nothing, memory)
    assert result.verdict == "nothing_missing" and list(result.effects) == []
    assert not any("noise" in c for c in result.cautions), result.cautions


@pytest.mark.parametrize("memory", [0.0, 0.98, pytest.param(0.9, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seconds", [5.0, 10.0, 60.0])
def test_no_noise_has_a_course_or_bursts(memory: float, seconds: float) -> None:
    """Of two recordings of six joints each, fifty draws."""
    rng, names = np.random.default_rng(3), [f"j{i}" for i in range(6)]
    samples = int(seconds * RATE_HZ)
    t = np.arange(samples) / RATE_HZ
    v = np.cos(np.outer(t, 1.0 + 0.3 * np.arange(6)))
    found = 0
    for _ in range(50):
        rms = np.ones(6)
        left = [coloured(rng, samples, rms, memory) if memory else white(rng, samples, rms) for _ in range(2)]
        found += len(list(unlike_noise(TorqueErrors(names, "ab", [RATE_HZ] * 2, [5.0 * v] * 2, left, [v] * 2))))
    assert found <= 1  # of three hundred


def test_what_is_no_noise_is_told_of_its_joint_alone() -> None:
    rng, rate = np.random.default_rng(5), 250.0
    t = np.arange(5000) / rate
    v = np.cos(np.outer(t, [1.0, 1.3, 1.7]))
    left = 0.2 * rng.normal(size=v.shape)
    left[:, 0] += 0.4 * (t / t[-1] - 0.5)
    left[::350, 2] += 12.0
    (course, bursts) = unlike_noise(TorqueErrors(["a", "b", "c"], ["first"], [rate], [3.0 * v], [left], [v]))
    assert isinstance(course, Course) and course.joint == "a"
    assert isinstance(bursts, Bursts) and bursts.joint == "c"
    assert course.share == pytest.approx(0.4**2 / 12.0 / (0.4**2 / 12.0 + 0.04), abs=0.06)
