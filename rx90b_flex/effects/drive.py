"""What sits on the drive: the rotor's inertia and a constant torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rx90b_flex.effects.at_rest import RestSites, RestSizes, ShownAtRest
from rx90b_flex.effects.effect import JointEffect
from rx90b_flex.effects.law import Law, constant
from rx90b_flex.effects.law_effect import LawEffect, SumOfLaws
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.parameters import FRICTION, INERTIA, linear


@dataclass(frozen=True, kw_only=True)
class DriveInertia(
    SumOfLaws, JointEffect, ShownAtRest, adds_inertia=True, part="drives", scaled=((0,),), rescaled="drive_inertia"
):
    """Rotor and gear, ``inertia * a``, joint side; one scalar a joint (section 3.3.2, after Spong).

    Signature
    ---------
    A residual proportional to the joint's acceleration: largest where the motion reverses, zero at constant speed,
    the same in every pose.

    Neighbours
    ----------
    A link's inertia loads other joints too and changes with the pose; about the axis of the first joint the two can
    only be told together. Friction follows the velocity. Where two joints' residuals follow the sum of both
    accelerations it is `joint_coupling`.

    Source
    ------
    Hardeman 2008, section 2.1.2 and equation 3.55; M. W. Spong, ASME Journal of Dynamic Systems, Measurement, and
    Control 109(4), 1987.
    """

    acts_at: ClassVar[str] = "drive"

    inertia: float | None = linear("kg m^2", lower=0.0, rank=INERTIA)

    def unit_laws(self, motion: Motion) -> tuple[Law, ...]:
        return (Law(motion.coordinates.port(self.joint, self.port_kind), inertia=1.0),)

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        return [cls(joint=j, inertia=1.0) for j in sites.moving]

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        return np.array([[0.05], [0.3]]) * sizes.inertia(sizes.coordinates.port(self.joint, self.port_kind))


@dataclass(frozen=True, kw_only=True)
class TorqueOffset(LawEffect, of_make=False, straight=("level",)):
    """A constant torque: an offset of the current sensor, or friction that never changes sign.

    Signature
    ---------
    The same residual at every angle, speed and time, at standstill too.

    Neighbours
    ----------
    Dry friction changes its sign with the velocity, gravity and springs change with the angle. A preloaded
    `joint_spring` has the same constant in it, so beside an offset its rest angle stays open; `base_tilt` turns
    into an offset where joint 1 hardly moves.

    Source
    ------
    Not in Hardeman 2008; usual in identification (W. Khalil, E. Dombre, *Modeling, Identification and Control of
    Robots*, 2002).
    """

    acts_at: ClassVar[str] = "drive"
    law = staticmethod(constant)
    law_stores: ClassVar[bool] = True

    torque: float | None = linear("N m", rank=FRICTION)

    def potential(self, motion: Motion) -> Array:
        return self.known_coefficients()[0] * motion.joint(self.joint, self.port_kind).q
