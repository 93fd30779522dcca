"""Five forms of dry friction, and hysteresis of gears, over one period of a motion that repeats.

Each is a torque over the friction's size, between -1 and 1. The elements of the last form are Maxwell's (a spring in series with a
Coulomb slider, as F. Al-Bender, V. Lampaert, J. Swevers, IEEE Transactions on Automatic Control 50(11), 2005, stack them); Dahl's law
bends where they break.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from independent import Array
from scipy import signal

TANH = {"tanh_1": 1e-3, "tanh_10": 1e-2, "tanh_30": 3e-2}  # rad/s
FORMS = ("sign", *TANH, "maxwell")
SHARES = (0.6, 0.4)  # of the friction, of the two elements
DEFLECTIONS = ((2e-4, 5e-4), (1e-3, 3e-3))  # rad, within which they break away
FINER = 4  # times the sample rate, for turning points

Law = Callable[[float, Array], Array]  # value at the last turn and travel since, signed; the values on the way


def dry(form: str, q: Array, v: Array, deflections: Sequence[float]) -> Array:
    """Dry friction of joints over its torque; q and v (N, n) are one period."""
    if form == "sign":
        return np.sign(v)
    if form in TANH:
        return np.tanh(v / TANH[form])
    parts = [share * hysteresis(q, maxwell(d)) for share, d in zip(SHARES, deflections, strict=True)]
    return np.asarray(sum(parts))


def maxwell(deflection: float) -> Law:
    return lambda at, travel: np.clip(at + travel / deflection, -1.0, 1.0)


def dahl(deflection: float) -> Law:
    def law(at: float, travel: Array) -> Array:
        s = np.sign(travel)
        return np.asarray(s - (s - at) * np.exp(-np.abs(travel) / deflection))

    return law


def hysteresis(q: Array, law: Law) -> Array:
    """Of one period of joint angles (N, n), after one period in which it settles."""
    fine = signal.resample(q, FINER * len(q), axis=0) if not _at_rest(q) else np.repeat(q, FINER, axis=0)
    twice = np.concatenate([fine, fine, fine[:1]])
    out = np.stack([_along(x, law) for x in twice.T], axis=1)
    return out[len(fine) : 2 * len(fine) : FINER]


def _at_rest(q: Array) -> bool:
    """Whether samples repeat exactly: a Fourier series would ripple there."""
    return bool((np.diff(q, axis=0) == 0).any())


def _along(q: Array, law: Law) -> Array:
    """One joint's, exact between turns of the motion; (M,) -> (M,)."""
    step = np.diff(q)
    out = np.zeros(len(q))
    moving = np.flatnonzero(step)
    if len(moving) == 0:
        return out
    last = np.maximum(np.maximum.accumulate(np.where(step != 0, np.arange(len(step)), -1)), moving[0])
    turns = np.flatnonzero(np.diff(np.sign(step)[last])) + 1
    at = 0.0
    for first, end in pairwise([0, *turns.tolist(), len(q) - 1]):
        out[first : end + 1] = law(at, q[first : end + 1] - q[first])
        at = float(out[end])
    return out


def last_direction(v: Array) -> Array:
    """Direction of each joint's last move over one period (N, n): its velocity's sign, kept while it stands still."""
    twice = np.sign(np.concatenate([v, v]))
    place = np.where(twice != 0, np.arange(len(twice))[:, None], 0)
    kept = np.take_along_axis(twice, np.maximum.accumulate(place, axis=0), axis=0)
    return np.asarray(kept[len(v) :])
