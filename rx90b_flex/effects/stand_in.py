"""Effects as a fit of torques over time works with them, which robot files have as others."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.motion import Motion


class StandIn(Effect):
    """An effect that stands for one of another type: on a rigid tree for one that bends, or in another form of its parameters."""

    in_files: ClassVar[type[Effect]]  # what it stands for

    @classmethod
    def type_name(cls) -> str:
        return cls.in_files.type_name()

    @abstractmethod
    def in_tree(self, motion: Motion) -> Effect:
        """What it stands for, with its values, on the tree of any sample of motion."""


def as_in_files(effects: Sequence[Effect], motion: Motion) -> tuple[Effect, ...]:
    """Effects as a robot file has them, on the tree of any sample of motion."""
    return tuple(e.in_tree(motion) if isinstance(e, StandIn) else e for e in effects)
