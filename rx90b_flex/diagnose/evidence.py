"""What a residual still depends on: a nonparametric measure with a permutation test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.regression import Regression

BINS = 24
SHUFFLES = 400
SIGNIFICANCE = 0.01
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


def dependences(regression: Regression, residual: Array, seed: int = 0) -> tuple[Dependence, ...]:
    """Signals that a residual depends on, strongest first.

    The score is the correlation ratio over bins of equal count; its distribution under "no dependence" comes from
    shifting the residual in time, which keeps both signals' own correlation in time.

    Parameters
    ----------
    regression : Regression
    residual : array, shape (N, joints)
    seed : int
        Of the shifts.
    """
    tried = signals(regression)
    rng = np.random.default_rng(seed)
    samples = len(residual)
    shifts = rng.integers(samples // 20 + 1, samples - samples // 20, SHUFFLES)
    tests = residual.shape[1] * len(tried)
    out = []
    power = (residual**2).sum(axis=0)
    shifted = np.stack([np.roll(residual, s, axis=0) for s in shifts], axis=2)  # (N, joints, shuffles)
    for name, values in tried:
        order = np.argsort(values, kind="stable")
        edges = np.linspace(0, samples, BINS + 1).astype(int)
        counts = np.diff(edges)[:, None]
        real = _explained(residual[order], edges, counts)
        chance = _explained(shifted[order].reshape(samples, -1), edges, counts).reshape(residual.shape[1], -1)
        mean, std = chance.mean(axis=1), chance.std(axis=1)
        for j, joint in enumerate(regression.joints):
            if power[j] == 0:
                continue
            score = (real[j] - mean[j]) / power[j]
            beyond = int((chance[j] >= real[j]).sum())
            p_value = (beyond + 1) / (SHUFFLES + 1)
            # shuffles are too few for a corrected p-value: beyond them a normal tail stands in
            if beyond == 0 and std[j] > 0:
                p_value = min(p_value, float(np.exp(-0.5 * ((real[j] - mean[j]) / std[j]) ** 2)))
            p_value = min(1.0, p_value * tests)
            if p_value < SIGNIFICANCE and score > SMALLEST_SCORE:
                out.append(Dependence(joint, name, float(score), p_value))
    return tuple(sorted(out, key=lambda d: -d.score))


def _explained(residual: Array, edges: Array, counts: Array) -> Array:
    sums = np.add.reduceat(residual, edges[:-1], axis=0)
    return (sums**2 / counts).sum(axis=0)


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
