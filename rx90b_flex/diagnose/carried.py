"""Whether what was added carries over to recordings that were not fitted: no name for what does worse there than nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from rx90b_flex.diagnose.moving import FIRST_S, resting_each, waiting
from rx90b_flex.effects.motion import Array, Mask

BLOCK_S = 1.0  # parts of a recording whose losses are compared with their spread
FEWEST, MOST = 4, 20  # of them, in a recording
GROSS = 1.1  # times the error of all recordings, a rise that counts even where few of their parts have it
CHANCE = 0.05  # that errors which only chance raises count as raised, all recordings and both kinds of rows together


def rise(
    torque: Sequence[Array],
    velocity: Sequence[Array],
    rates: Sequence[float],
    without: Sequence[Array],
    added: Sequence[Array],
) -> tuple[int, float] | None:
    """The recording whose error an addition raises most surely, beyond what its parts' spread explains.

    A rise counts over all rows, and over those in which the joint concerned moves: at rest friction takes any value. What it
    holds where a joint stands as a recording begins nobody knows: these rows do not count at all.

    Parameters
    ----------
    torque, velocity : sequences of arrays (N, joints)
        Measured, one a recording; N m, rad/s.
    rates : sequence of float
        Hz.
    without, added : sequences of arrays (N, joints)
        Predictions without the addition and with it, N m.

    Returns
    -------
    (int, float) or None
        Index of the recording, and probability that chance does it, corrected for the number of tests; None where nothing rises.
    """
    moving = [~still for still in resting_each(velocity)]
    told = [~waiting(v, rate) for v, rate in zip(velocity, rates, strict=True)]
    chances = []
    for tau, mask, known, rate, less, more in zip(torque, moving, told, rates, without, added, strict=True):
        lost = (tau - more) ** 2 - (tau - less) ** 2
        parts = int(np.clip(len(lost) / rate / BLOCK_S, FEWEST, MOST))
        chances.append(min(_chance(lost, known, parts), _chance(lost, mask & known, parts)))
    worst = int(np.argmin(chances))
    p_value = min(1.0, 2.0 * len(chances) * chances[worst])
    return (worst, p_value) if p_value < CHANCE else None


def grossly_risen(
    torque: Sequence[Array],
    velocity: Sequence[Array],
    rates: Sequence[float],
    without: Sequence[Array],
    added: Sequence[Array],
) -> bool:
    """Whether an addition raises the error of all recordings so much that no spread excuses it; for the parameters see `rise`.

    What remembers the motion errs as a recording begins, whatever it is: its first second does not count.
    """
    less = more = 0.0
    for tau, v, rate, before, after in zip(torque, velocity, rates, without, added, strict=True):
        known = ~waiting(v, rate) & (np.arange(len(tau)) >= FIRST_S * rate)[:, None]
        less += float((((tau - before) ** 2) * known).sum())
        more += float((((tau - after) ** 2) * known).sum())
    return more > GROSS**2 * less


def _chance(lost: Array, rows: Mask, parts: int) -> float:
    """That a loss is chance: Student's t over consecutive parts of a recording, of signed roots as in `TorqueTrial.gain_t`."""
    sums = np.array([x.sum() for x in np.array_split((lost * rows).sum(axis=1), parts)])
    roots = np.sign(sums) * np.sqrt(np.abs(sums))
    error = roots.std(ddof=1) / np.sqrt(parts)
    return float(stats.t.sf(roots.mean() / error, parts - 1)) if error > 0 and sums.sum() > 0 else 1.0
