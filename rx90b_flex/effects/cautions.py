"""What has to be said of effects whose values are not all that they seem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.gravity_spring import assumed_levers
from rx90b_flex.effects.torque_signal import long_delays


def cautions(effects: Sequence[Effect]) -> Iterator[str]:
    """A sentence for each effect that was found and has to be doubted, or whose values hold for something that was assumed."""
    for of_kind in (long_delays, assumed_levers):
        yield from of_kind(effects)
