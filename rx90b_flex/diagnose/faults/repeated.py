"""The same motion in both roles, which makes the held-out error say nothing; and the same samples twice in one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from scipy import signal

from rx90b_flex.effects.motion import Array
from rx90b_flex.signals import Recording
from rx90b_flex.signals.data_fault import DataFault

ALIKE = 0.02**2  # squared difference of two motions over their own size
ALIKE_TORQUE = 0.15**2  # and of their torques: another load, or pulses on top, make it another experiment
SAMPLES_A_SECOND = 40.0


def repeated(recordings: Sequence[Recording]) -> Iterator[DataFault]:
    """Validation recordings whose motion one of the identification recordings has as well, and samples that are fitted twice."""
    fitted = [r for r in recordings if r.role == "identification"]
    for one, other in combinations(fitted, 2):
        if np.array_equal(one.position, other.position) and np.array_equal(one.torque, other.torque):
            names = one.name if one.name == other.name else f"{one.name} and {other.name}"
            message = (
                f"The same samples are fitted twice ({names}): they tell no more than once, and standard deviations come out too "
                "small; leave one out."
            )
            yield DataFault("repeated_recording", None, (), message, usable=True)
    for other in (r for r in recordings if r.role == "validation"):
        same = next((r for r in fitted if _contains(r, other)), None)
        if same is not None:
            message = (
                f"Recording {other.name} (validation) holds the same motion as {same.name} (identification): its error says "
                "nothing about other motions; record another one, or split one recording with start_s and end_s."
            )
            yield DataFault("repeated_recording", None, (), message)


def _contains(whole: Recording, part: Recording) -> bool:
    """Whether the shorter of two motions, with its torques, is a segment of the longer one."""
    if whole.sample_rate_hz != part.sample_rate_hz:
        return False
    if whole.samples < part.samples:
        whole, part = part, whole
    every = max(1, round(whole.sample_rate_hz / SAMPLES_A_SECOND))
    for start in range(min(every, 4)):  # the two may have been started between thinned samples
        long, short = whole.position[start::every], part.position[::every]
        count = min(len(long), len(short))
        short = short[:count]
        size = ((short - short.mean(axis=0)) ** 2).sum()
        off = _differences(long, short)
        at = int(np.argmin(off))
        if size > 0.0 and off[at] < ALIKE * size:
            one, other = whole.torque[start::every][at : at + count], part.torque[::every][:count]
            spread = other.std(axis=0) + 1e-300
            return bool((((one - other) / spread) ** 2).mean() < ALIKE_TORQUE)
    return False


def _differences(long: Array, short: Array) -> Array:
    """Squared difference of the shorter motion to every segment of the longer one."""
    centre = short.mean(axis=0)
    a, b = long - centre, short - centre
    square = np.concatenate([[0.0], np.cumsum((a**2).sum(axis=1))])
    window = square[len(b) :] - square[: len(a) - len(b) + 1]
    product = sum(signal.fftconvolve(a[:, k], b[::-1, k], mode="valid") for k in range(a.shape[1]))
    return np.asarray(window - 2 * product + (b**2).sum())
