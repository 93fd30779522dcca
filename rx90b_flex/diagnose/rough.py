"""What a first look shows of a candidate."""

from __future__ import annotations

from dataclasses import dataclass

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array


@dataclass(frozen=True, eq=False)
class Rough:
    """A candidate at the shape that a first look likes best.

    Attributes
    ----------
    effect : Effect
    replaced : Effect or None
        The declared effect whose place it would take.
    starts : array, shape (M, s)
        Shapes that it was looked at.
    lost : float
        Gain that is none, for without what it replaces the model is worse than the present one.
    gain : float
    glimpsed : bool
        Whether no more was seen than a glimpse of the log.
    elsewhere : tuple of (float, Effect)
        Where else a refinement may begin, and what a first look gains there.
    """

    effect: Effect
    replaced: Effect | None
    starts: Array
    lost: float
    gain: float = 0.0
    glimpsed: bool = False
    elsewhere: tuple[tuple[float, Effect], ...] = ()
