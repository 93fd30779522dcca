"""A sample rate that is not the stated one: inertia and gravity then do not go together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading

LEAST = 0.2  # off one: less is no other clock
GRID = (10.0, 4.0, 2.0, 1.4, 0.7, 0.5, 0.25, 0.1)  # stated over true


def sample_rates(look: Look) -> Iterator[Hypothesis]:
    """The stated sample rate is so many times the true one."""
    text = "The stated sample rate is <factor> times the true one: inertia and gravity do not go together otherwise."

    def reading(factor: float) -> Reading:
        return dataclasses.replace(look.reading, rate=look.reading.rate / factor)

    for factor in GRID:
        yield Hypothesis(
            "sample_rate", None, (), text, reading, factor, (factor / 1.6, factor * 1.6), smallest=LEAST, neutral=1.0
        )
