"""A sample rate that is not the stated one: inertia and gravity then do not go together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading

LEAST = 0.2  # off one: less is no other clock
WITHIN = 1.6  # times a factor of the grid
GRID = (10.0, 4.0, 2.0, 1.4, 0.7, 0.5, 0.25, 0.1)  # stated over true


def sample_rates(look: Look) -> Iterator[Hypothesis]:
    """The stated sample rate is so many times the true one."""
    text = "The stated sample rate is <factor> times the true one: inertia and gravity do not go together otherwise."

    def reading(factor: float) -> Reading:
        return dataclasses.replace(look.reading, rate=look.reading.rate / factor)

    yield from (another_rate(text, reading, factor) for factor in GRID)


def another_rate(text: str, reading: Callable[[float], Reading], factor: float) -> Hypothesis:
    """One with a factor, stated over true, near that which is given."""
    bounds = factor / WITHIN, factor * WITHIN
    return Hypothesis("sample_rate", None, (), text, reading, factor, bounds, smallest=LEAST, neutral=1.0)
