"""Where a drive sticks, at a reversal or for a moment on its way, from its logged angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from rx90b_flex.pieces import Array

NOISE = 16.0  # standard deviations of a log's noise that a dwell reaches over at the least,
TRAVEL = 2e-5  # or this part of the joint's travel
WIDER = 4.0  # times that reach: a second one, which a steady reversal takes twice as long to cross
FEWEST = 4  # samples of a stick
LONGEST_S = 0.5  # what stands longer is at rest
TURN = 0.25  # of the time within the reach, that a stick lasts at the least where the motion turns over; a steady one has 0,
PAUSE = 0.6  # and where it goes on: one that slows down to nothing has 0.41


class Stick(NamedTuple):
    """First sample of a stick, the one behind its last, and the signs of the moves before and after."""

    begin: int
    end: int
    before: float
    after: float


def held_part(position: Array, sample_rate_hz: float) -> Array | None:
    """Part of its dry friction, -1 to 1, that a drive which sticks is taken to hold, elsewhere NaN; (N, joints), None without sticks.

    A drive that turns comes to rest and breaks away only when its controller's torque has gone from the friction of the move before
    to that of the next. What it holds in between is no function of the motion: it is taken to go evenly from the one to the other,
    and where the motion goes on as it was, to less and back, the more so the longer it stands: its controller asks for less, first
    slowly, then faster, and what stood for `LONGEST_S` would have been about to turn.

    Parameters
    ----------
    position : shape (N, joints)
        As logged, rad.
    sample_rate_hz : float
    """
    out = np.full(position.shape, np.nan)
    for j in range(position.shape[1]):
        for begin, end, before, after in sticks(position[:, j], sample_rate_hz):
            out[begin:end, j] = np.linspace(before, after, end - begin)
            if before == after:
                away = 2.0 * ((end - begin) / (LONGEST_S * sample_rate_hz)) ** 2
                out[begin:end, j] *= 1.0 - away * (1.0 - np.abs(np.linspace(-1.0, 1.0, end - begin)))
    return None if np.isnan(out).all() else out


def sticks(q: Array, sample_rate_hz: float) -> list[Stick]:
    """Where an angle (N,) stands still between two moves.

    A steady reversal leaves a reach about its turning point within a time that grows with the reach's root, a stick adds its own
    to that: of two reaches, one four times the other, twice the shorter time less the longer one is the stick's.
    """
    if len(q) < 2 * FEWEST:
        return []
    noise = float(np.median(np.abs(np.diff(q, 3)))) / (np.sqrt(20.0) * 0.6745)
    reach = max(NOISE * noise, TRAVEL * float(np.ptp(q)))
    if reach <= 0.0:
        return []
    longest = int(LONGEST_S * sample_rate_hz)
    still = maximum_filter1d(q, FEWEST) - minimum_filter1d(q, FEWEST) <= reach
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
    runs = (
        (int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a <= longest + 2 * WIDER * FEWEST
    )
    found = (_stick(q, (a + b) // 2, reach, longest) for a, b in runs)
    return [stick for stick in found if stick is not None]


def _stick(q: Array, middle: int, reach: float, longest: int) -> Stick | None:
    """That about a sample, if there is one."""
    begin, end = max(0, middle - 2 * longest), min(len(q), middle + 2 * longest)
    off = np.abs(q[begin:end] - q[middle])
    back, on = off[: middle - begin + 1][::-1], off[middle - begin :]
    if min(back.max(), on.max()) <= WIDER * reach:
        return None
    (left, further_left), (right, further_right) = (
        [int(np.argmax(x > r)) for r in (reach, WIDER * reach)] for x in (back, on)
    )
    before, after = (float(np.sign(q[middle] - q[middle - left])), float(np.sign(q[middle + right] - q[middle])))
    first, last = middle - 2 * left + further_left, middle + 2 * right - further_right
    shortest = max(FEWEST, (PAUSE if before == after else TURN) * (left + right))
    if not shortest <= last - first <= longest or first < 0 or last > len(q):
        return None
    return Stick(first, last, before, after)
