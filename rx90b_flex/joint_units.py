"""Units of what turns and of what slides."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class JointUnits:
    """In what a joint's motion and force are told.

    Attributes
    ----------
    position, speed, force : str
        Units.
    given : str
        Unit in which people write a position; `scale` of them are one of `position`.
    scale : float
    move, effort : str
        What it does, and what its drive gives for it.
    slides : bool
    """

    position: str
    speed: str
    force: str
    given: str
    scale: float
    move: str
    effort: str
    slides: bool

    def place(self, value: float) -> str:
        """A position, in what people give it in."""
        return f"{round(self.scale * value, 3) + 0.0:.4g}{' m' if self.slides else '°'}"

    def of(self, unit: str) -> str:
        """The unit that a parameter has on such a joint, from the one that it has where a joint turns."""
        if not self.slides:
            return unit
        if unit == "1/turn":
            return "rad/m"  # of the wave along the joint
        return unit.replace("kg m^2", "kg").replace("(N m)", "N").replace("N m", "N").replace("rad", "m")


TURNS = JointUnits("rad", "rad/s", "N m", "degrees", math.degrees(1.0), "turn", "torque", False)
SLIDES = JointUnits("m", "m/s", "N", "m", 1.0, "move", "force", True)


def response_unit(units: Iterable[JointUnits]) -> str:
    """Of accelerations over torques of some joints, as a figure is labelled; all that there are where some turn and some slide."""
    several = tuple(units)
    return f"{any_of(f'{u.position}/s²' for u in several)} per {any_of(u.force for u in several)}"


def any_of(units: Iterable[str]) -> str:
    """Different units of one axis: ``N m or N``."""
    return " or ".join(dict.fromkeys(units))


def flexibility_unit(units: Sequence[JointUnits]) -> str | list[list[str]]:
    """Of the joints' angles over their torques; by row and column where some turn and some slide."""
    each = [
        [f"{u.position}/({f.force})" if " " in f.force else f"{u.position}/{f.force}" for f in units] for u in units
    ]
    return each[0][0] if len({x for row in each for x in row}) == 1 else each
