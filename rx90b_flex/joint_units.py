"""Units of what turns and of what slides."""

from __future__ import annotations

import math
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
        return unit.replace("kg m^2", "kg").replace("(N m)", "N").replace("N m", "N").replace("rad", "m")


TURNS = JointUnits("rad", "rad/s", "N m", "degrees", math.degrees(1.0), "turn", "torque", False)
SLIDES = JointUnits("m", "m/s", "N", "m", 1.0, "move", "force", True)
