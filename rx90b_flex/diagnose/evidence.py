"""What a residual still depends on: a nonparametric measure with a permutation test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.identify.regression import Regression

BINS = 12
SHUFFLES = 200
MOST_SAMPLES = 3000  # more do not change a score, and cost
SIGNIFICANCE = 0.01
STANDSTILL = "standstill"  # name of the signal "no joint moves"
REST = 1.0e-3  # of a joint's largest speed, below which it rests
SMALLEST_PART = 0.02  # of the samples, at rest or moving, for the other to be told apart
SMALLEST_SCORE = 0.05  # share of a residual's power; less is not worth a line in a report


@dataclass(frozen=True)
class Dependence:
    """A joint's residual depends on a signal.

    Attributes
    ----------
    joint : str
        Whose residual.
    signal : str
        What it depends on, as in ``joint_3 position``.
    score : float
        Share of the residual's power that a free curve over the signal explains, 0 to 1, less what chance explains.
    p_value : float
        Of the score under shifts of the residual in time, corrected for the number of signals.
    """

    joint: str
    signal: str
    score: float
    p_value: float


def dependences(data: Sequence[tuple[Regression, Array]], seed: int = 0) -> tuple[Dependence, ...]:
    """Signals that a residual depends on, strongest first.

    The score is the correlation ratio over bins of equal count, apart for each direction in which the joint moves (what
    friction does forward it undoes backward); its distribution under "no dependence" comes from shifting the
    residual in time, which keeps both signals' own correlation in time.

    Parameters
    ----------
    data : sequence of (Regression, array of shape (N, joints))
        Recordings with what a model leaves over on them.
    seed : int
        Of the shifts.
    """
    joints = data[0][0].joints
    residual = np.concatenate([r for _, r in data])
    rng = np.random.default_rng(seed)
    resting = np.concatenate([at_rest(regression) for regression, _ in data])
    moving = ~resting
    names = [name for name, _ in signals(data[0][0])]
    values = [np.concatenate(parts) for parts in zip(*([v for _, v in signals(r)] for r, _ in data), strict=True)]
    tests = len(joints) * len(names)
    found: list[Dependence] = []
    if SMALLEST_PART < resting.mean() < 1 - SMALLEST_PART:
        excess, chance = _excess(residual**2, resting, rng)
        # one question a joint, asked before and apart from the search through all signals
        found += _dependences(joints, STANDSTILL, excess, chance, (residual**2).sum(axis=0), len(joints))
    # at rest every signal has one value and friction any: what else depends on what shows in motion only
    if moving.sum() > 20 * BINS:
        every = max(1, int(moving.sum()) // MOST_SAMPLES)
        at = np.flatnonzero(moving)[::every]
        rest = residual[at]
        forward = [values[names.index(f"{joint} velocity")][at] > 0 for joint in joints]
        # a shift by s is the residual read at (i - s) modulo N
        back = (np.arange(len(rest))[:, None] - _shifts(len(rest), rng)) % len(rest)
        shifted = [r[back] for r in rest.T]
        for name, value in zip(names, values, strict=True):
            bins = _bins(value[at])
            real, chance = np.empty(len(joints)), np.empty((len(joints), SHUFFLES))
            for j in range(len(joints)):
                order, edges = _cells(2 * bins + forward[j])
                real[j] = _explained(rest[order, j : j + 1], edges)[0]
                chance[j] = _explained(shifted[j][order], edges)
            found += _dependences(joints, name, real, chance, (rest**2).sum(axis=0), tests)
    return tuple(sorted(found, key=lambda d: -d.score))


def _bins(value: Array) -> Indices:
    """Which of the bins of equal count each sample falls into, shape (N,)."""
    rank = np.empty(len(value), dtype=np.intp)
    rank[np.argsort(value, kind="stable")] = np.arange(len(value))
    return rank * BINS // len(value)


def _cells(cell: Indices) -> tuple[Indices, Indices]:
    """Order that puts samples of one cell together, and where each cell begins, with the end as the last."""
    order = np.argsort(cell, kind="stable")
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    return order, np.append(begins, len(cell))


def _shifts(samples: int, rng: np.random.Generator) -> Indices:
    return rng.integers(samples // 20 + 1, samples - samples // 20, SHUFFLES)


def _excess(power: Array, mask: Mask, rng: np.random.Generator) -> tuple[Array, Array]:
    """Power in part of the samples beyond the mean elsewhere: (joints,), and (joints, shuffles) for shifted masks."""

    def beyond(at: Mask) -> Array:
        return np.asarray(power[at].sum(axis=0) - at.sum() * power[~at].mean(axis=0))

    return beyond(mask), np.stack([beyond(np.roll(mask, s)) for s in _shifts(len(mask), rng)], axis=1)


def _dependences(
    joints: Sequence[str], signal: str, real: Array, chance: Array, power: Array, tests: int
) -> list[Dependence]:
    """Scores of one signal for each joint, where they are significant and worth a line."""
    out = []
    mean, std = chance.mean(axis=1), chance.std(axis=1)
    for j, joint in enumerate(joints):
        if power[j] == 0:
            continue
        # with a mask, chance draws the rest of the recording: its mean is no level that the score starts from
        score = (real[j] - (mean[j] if signal != STANDSTILL else 0.0)) / power[j]
        beyond = int((chance[j] >= real[j]).sum())
        p_value = (beyond + 1) / (SHUFFLES + 1)
        # shuffles are too few for a corrected p-value: beyond them a normal tail stands in
        if beyond == 0 and std[j] > 0:
            p_value = min(p_value, float(np.exp(-0.5 * ((real[j] - mean[j]) / std[j]) ** 2)))
        p_value = min(1.0, p_value * tests)
        if p_value < SIGNIFICANCE and score > SMALLEST_SCORE:
            out.append(Dependence(joint, signal, float(score), p_value))
    return out


def at_rest(regression: Regression) -> Mask:
    """Samples of the fit at which no joint moves, shape (N,), bool."""
    speed = [np.abs(s.motion.v[:: s.factor][s.kept]) for s in regression.stretches]
    fastest = np.max([v.max(axis=0) for v in speed], axis=0)
    return np.concatenate([(v <= REST * np.maximum(fastest, 1e-12)).all(axis=1) for v in speed])


def _explained(residual: Array, edges: Indices) -> Array:
    """Power of the means over consecutive runs of samples, shape (joints,)."""
    sums = np.add.reduceat(residual, edges[:-1], axis=0)
    power: Array = (sums**2 / np.diff(edges)[:, None]).sum(axis=0)
    return power


def signals(regression: Regression) -> Sequence[tuple[str, Array]]:
    """Signals that a residual may depend on: motion of every joint and time in the recording, at the fit's samples."""
    out: list[tuple[str, Array]] = []
    for joint in regression.joints:
        column = regression.robot.layout.index(joint)
        for name in ("position", "velocity", "acceleration"):
            values = [getattr(s.motion, name[0] if name[0] != "p" else "q") for s in regression.stretches]
            thinned = [v[:: s.factor][s.kept][:, column] for v, s in zip(values, regression.stretches, strict=True)]
            out.append((f"{joint} {name}", np.concatenate(thinned)))
    time = [s.motion.time[:: s.factor][s.kept] for s in regression.stretches]
    out.append(("time", np.concatenate(time)))
    return out
