"""What an effect type says about itself in a word: how it is simulated, fitted and searched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Part = Literal["links", "drives", "flexibility", "spring", "friction"]
PARTS: tuple[Part, ...] = get_args(Part)


@dataclass(frozen=True, kw_only=True)
class Traits:
    """Keywords of an effect's class, as in ``class Hose(JointForce, behind_gear=True)``; what it does not say its base class says.

    Attributes
    ----------
    on : str
        Place: "joint", "joints", "robot", "frame" or "robot or joint".
    part : str
        Of a linearisation: one of `PARTS`.
    virtual : tuple of str
        Coordinates that it adds to its place: "torsion", "bend_1", "bend_2".
    adds_inertia : bool
        Its force holds accelerations, so it is part of the mass matrix.
    in_dynamics : bool
        A force of the robot; otherwise it stands between robot and log.
    needs_load : bool
        Its columns depend on the torque through the transmission.
    needs_model : bool
        Its columns depend on the torque of the model as a whole.
    remembers : bool
        Its force depends on the motion before, which a simulation step does not know.
    breaks_away : bool
        Its coefficients add up to a dry friction of its joint just before it slides.
    grows_with_speed : bool
        Friction that grows with the velocity: beside it, dry friction that turns over widely does not play its part.
    straight : tuple of str
        What of a straight torque it can have, whatever else it has: "level", lines along "angle" or "velocity" of its joint, and
        "speed", a V against its velocity.
    behind_gear : bool
        A torque sensor behind the gear feels it; what may be on either side is the motor's.
    multiplies : bool
        Its one coefficient scales all that its joint's log shows of the model.
    coefficients_follow : bool
        From its shape, in a fit; a search may leave them free.
    needs : tuple of str
        Effect types of which one must stand at the same place.
    repeats : bool
        It may stand twice in the same place.
    of_make : bool
        Joints of one make have it by one law, which they may show together; a spring or a tooth's place is one joint's own.
    replaces : tuple of str
        Effect types that it stands in for at the same place.
    refines : tuple of str
        Those that it is tried in place of; declared, both may stand side by side.
    last_resort : bool
        A curve of no known law, tried where nothing with a name explains more.
    repeats_with_motion : bool
        False: where the motion repeats, its torque does not.
    by_clock : bool
        Its torque is a line at a frequency of its own, whatever the robot does.
    scaled : tuple of tuple of int
        Coefficients that a search over frequency multiplies together.
    rescaled : str
        What such a search may find another value of where it is declared; empty: nothing.
    """

    on: str = "joint"
    part: Part = "friction"
    virtual: tuple[str, ...] = ()
    adds_inertia: bool = False
    in_dynamics: bool = True
    needs_load: bool = False
    needs_model: bool = False
    remembers: bool = False
    breaks_away: bool = False
    grows_with_speed: bool = False
    straight: tuple[str, ...] = ()
    behind_gear: bool = False
    multiplies: bool = False
    coefficients_follow: bool = False
    needs: tuple[str, ...] = ()
    repeats: bool = False
    of_make: bool = True
    replaces: tuple[str, ...] = ()
    refines: tuple[str, ...] = ()
    last_resort: bool = False
    repeats_with_motion: bool = True
    by_clock: bool = False
    scaled: tuple[tuple[int, ...], ...] = ()
    rescaled: str = ""

    def __post_init__(self) -> None:
        """One line where a class names a part that there is not."""
        if self.part not in PARTS:
            raise ValueError(f"part is {self.part!r}; expected one of {', '.join(PARTS)}")

    @property
    def is_friction(self) -> bool:
        """Whether it takes energy out of the motion where it rubs."""
        return self.part == "friction"

    @property
    def in_drivetrain(self) -> bool:
        """Whether it is a drive, or bends: what a fit over frequency finds values of."""
        return self.part in ("drives", "flexibility")

    @property
    def stands_for(self) -> tuple[str, ...]:
        """Effect types whose place it takes where it is added."""
        return (*self.replaces, *self.refines)
