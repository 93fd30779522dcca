"""Torques that were logged at other times than positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.rigid_fit import FLOOR, RIDGE
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.effects.motion import Array

SMALLEST_S = 0.05  # below it a delay of filters and buses, which the loop finds as an effect
LARGEST_S = 3.0
# squared error of most of the joints that are brought to another time, above which it is not theirs either: at some time torques
# go with any motion a little better
STILL_FAR = 0.5**2
PART = 0.25  # of the shortest recording: the largest shift that leaves enough in common
STEPS_A_PERIOD = 6.0  # of the cutoff
TOGETHER = 64  # times that are worked out at once


def shifted(look: Look) -> Iterator[Hypothesis]:
    """All torques, one joint's, or one recording's, by the time at which they fit best."""
    longest = min(LARGEST_S, PART * min(len(t.torque) / t.rate_hz for t in look.sample.tracks))
    step = max(1.0 / (STEPS_A_PERIOD * look.sample.cutoff_hz), longest / 400)
    lags = np.arange(-np.floor(longest / step), np.floor(longest / step) + 1) * step
    joints, tracks = len(look.sample.joints), len(look.sample.tracks)
    groups: list[tuple[str, tuple[int, ...]]] = [("shift_s", tuple(range(joints)))]
    groups += [("shift_s", (k,)) for k in range(joints)] if joints > 1 else []
    groups += [("log", (r,)) for r in range(tracks)] if tracks > 1 else []
    scores = _scores(look, lags, groups)
    for (name, chosen), row in zip(groups, scores, strict=True):
        lag = float(lags[int(np.argmin(row))])
        if abs(lag) >= SMALLEST_S:
            yield _of(look, name, chosen, lag, step)


def _scores(look: Look, lags: Array, groups: list[tuple[str, tuple[int, ...]]]) -> Array:
    """Log errors of fits with the weights and columns of the present reading, shape (groups, lags)."""
    sample, reading = look.sample, look.reading
    n, tracks = len(sample.joints), len(sample.tracks)
    x = np.ascontiguousarray(look.columns(reading).transpose(1, 0, 2))
    counts = sample.left_seen(reading).T[:, None]

    def at(lags: Array) -> tuple[Array, Array]:
        """Products with the columns (tracks, joints, lags, p), and squares (tracks, joints, lags), of torques so much later."""
        y = sample.torque_later(reading, lags) * counts
        parts = [(y[..., span] @ x[:, span], (y[..., span] ** 2).sum(axis=2)) for span in sample.spans]
        products, squares = (np.array(p) for p in zip(*parts, strict=True))
        return products, squares

    still = at(np.zeros(1))
    torque = look.measured()
    variance = torque.var(axis=0) * len(torque) + 1e-300
    weight = 1.0 / (variance * (look.fit().error + FLOOR))
    gram = x.transpose(0, 2, 1) @ x
    whole = np.tensordot(weight, gram, axes=(0, 0))
    size = np.sqrt(np.diag(whole))
    size[size < 1e-6 * size.max()] = size.max()
    inverse = np.linalg.inv(whole / np.outer(size, size) + RIDGE * np.eye(len(size))) / np.outer(size, size)
    moves = np.zeros((len(groups), tracks, n), dtype=bool)
    for move, (name, chosen) in zip(moves, groups, strict=True):
        (move.T if name == "shift_s" else move)[list(chosen)] = True
    out = np.empty((len(groups), len(lags)))
    for begin in range(0, len(lags), TOGETHER):
        some = slice(begin, begin + TOGETHER)
        late = at(lags[some])
        for move, row in zip(moves, out, strict=True):
            cross = np.where(move[..., None, None], late[0], still[0]).sum(axis=0)
            power = np.where(move[..., None], late[1], still[1]).sum(axis=0)
            theta = np.tensordot(weight, cross, axes=1) @ inverse
            left = power + ((theta @ gram - 2 * cross) * theta).sum(axis=2)
            row[some] = np.log(np.maximum(left / variance[:, None], 0.0) + FLOOR).sum(axis=0)
    return out


def _of(look: Look, name: str, chosen: tuple[int, ...], lag: float, step: float) -> Hypothesis:
    sample = look.sample

    def reading(seconds: float) -> Reading:
        if name == "log":
            r = chosen[0]
            return look.reading.changed_in(r, {"shift_s": look.reading.logs[r].shift_s + seconds})
        return look.reading.changed(name, chosen, lambda x: x + seconds)

    joints = tuple(sample.joints[k] for k in chosen) if name == "shift_s" else sample.joints
    where = f"of {', '.join(joints)}" if name == "shift_s" else f"in recording {chosen[0] + 1}"
    when = "after" if lag > 0 else "before"
    text = f"Torques {where} are logged <factor> s {when} the positions they belong to: bring both to one clock."
    bounds = lag - 2 * step, lag + 2 * step
    return Hypothesis(
        "time_shift", "torque", joints, text, reading, lag, bounds,
        shown=float(np.sign(lag)), smallest=SMALLEST_S, far=STILL_FAR,
    )  # fmt: skip
