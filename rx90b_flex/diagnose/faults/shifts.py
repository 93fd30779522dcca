"""Torques that were logged at other times than positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rx90b_flex.diagnose.faults.columns_in_one import name_of, standing_apart
from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.rigid_fit import FLOOR, RIDGE
from rx90b_flex.diagnose.faults.warm import of_friction
from rx90b_flex.effects.motion import Array, Mask

SMALLEST_S = 0.05  # below it a delay of filters and buses, which the loop finds as an effect
SMALLEST_IN_ONE_S = 0.01  # of all joints in one recording beside others, which filters and buses have in common
LARGEST_S = 3.0
# squared error of most of the joints that are brought to another time, above which it is not theirs either: at some time torques
# go with any motion a little better
STILL_FAR = 0.5**2
PART = 0.25  # of the shortest recording: the largest shift that leaves enough in common
STEPS_A_PERIOD = 6.0  # of the cutoff
TOGETHER = 64  # times that are worked out at once


def shifted(look: Look) -> Iterator[Hypothesis]:
    """All torques, one joint's, one recording's, or one joint's in one recording, by the time at which they fit best."""
    longest = min(LARGEST_S, PART * min(len(t.torque) / t.rate_hz for t in look.sample.tracks))
    step = max(1.0 / (STEPS_A_PERIOD * look.sample.cutoff_hz), longest / 400)
    lags = np.arange(-np.floor(longest / step), np.floor(longest / step) + 1) * step
    moves = np.array(list(_moves(look)))
    for move, row in zip(moves, _scores(look, lags, moves), strict=True):
        lag = float(lags[int(np.argmin(row))])
        if abs(lag) >= _smallest(move):
            yield _of(look, move, lag, step)


def _smallest(move: Mask) -> float:
    """Shift, s, below which torques (recordings, joints) are not said to have come at another time."""
    whole = move.all(axis=1)
    return SMALLEST_IN_ONE_S if whole.any() and not whole.all() else SMALLEST_S


def _moves(look: Look) -> Iterator[Mask]:
    """Which torques may have come at another time, (recordings, joints): all first, then more and more special ones."""
    tracks, joints = len(look.sample.tracks), len(look.sample.joints)
    yield np.ones((tracks, joints), dtype=bool)
    in_turn = [np.arange(n)[:, None] == np.arange(n) for n in (joints, tracks)]
    if joints > 1:
        yield from (np.tile(own, (tracks, 1)) for own in in_turn[0])
    if tracks > 1:
        # a warmer robot rubs less with its speed, as torques that come later do where gravity is most of them
        as_warm = np.flatnonzero(~of_friction(look).warm)
        yield from (np.tile(in_turn[1][r][:, None], (1, joints)) for r in as_warm)
    if joints > 1 and tracks > 1:
        yield from (np.outer(in_turn[1][r], own) for r in standing_apart(look) for own in in_turn[0])


def _scores(look: Look, lags: Array, moves: Mask) -> Array:
    """Log errors of fits with the weights and columns of the present reading, shape (moves, lags)."""
    sample, reading = look.sample, look.reading
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
    out = np.empty((len(moves), len(lags)))
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


def _of(look: Look, move: Mask, lag: float, step: float) -> Hypothesis:
    joints = tuple(j for j, own in zip(look.sample.joints, np.atleast_1d(move.any(axis=0)), strict=True) if own)
    recordings = np.flatnonzero(move.any(axis=1)).tolist()
    whose = f" of {', '.join(joints)}" if move.all() or not move.all(axis=1).any() else ""
    where = f" in {name_of(look, recordings[0])}" if len(recordings) < len(move) else ""
    when = "after" if lag > 0 else "before"
    text = f"Torques{whose}{where} are logged <factor> s {when} the positions they belong to: bring both to one clock."
    bounds = lag - 2 * step, lag + 2 * step
    sample_s = 1.0 / min(t.rate_hz for t in look.sample.tracks)
    return Hypothesis(
        "time_shift", "torque", joints, text, lambda seconds: look.reading.later(move, seconds), lag, bounds,
        shown=float(np.sign(lag)), smallest=_smallest(move), far=STILL_FAR,
        grain=sample_s,
    )  # fmt: skip
