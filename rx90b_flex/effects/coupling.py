"""Two joints that share a motor."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np

from rx90b_flex.effects.at_rest import RestSites, RestSizes, ShownAtRest
from rx90b_flex.effects.effect import PairEffect
from rx90b_flex.effects.friction import CoulombFriction
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.law_effect import SumOfLaws
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.parameters import FRICTION, INERTIA, linear
from rx90b_flex.effects.reversal import turnover_range, turnover_shape, turnover_start


@dataclass(frozen=True, kw_only=True)
class JointCoupling(SumOfLaws, PairEffect, ShownAtRest, adds_inertia=True, scaled=((0,),), rescaled="coupling_inertia"):
    """Motor b also turns with joint a, as in a wrist whose last motor sits behind the joint before.

    The motor's angle is q_a + q_b (joint side of b), so its rotor's inertia, its viscous and its dry friction
    act on that sum, and load both joints alike:
    ``inertia*(a_a + a_b) + viscous*(v_a + v_b) + coulomb*sign(v_a + v_b)`` in both rows.

    Signature
    ---------
    The same residual in two joints, following the sum of their accelerations, velocities and signs of velocity.

    Neighbours
    ----------
    `drive_inertia` and friction follow one joint's motion alone. Moving joint a with b at rest gives a torque in b
    that a link's inertia alone does not: friction, and the same in every pose.

    Source
    ------
    Not in Hardeman 2008; the wrist of the Stäubli TX40, see A. Janot, P.-O. Vandanjon, M. Gautier, IEEE
    Transactions on Control Systems Technology 22(1), 2014.
    """

    inertia: float | None = linear("kg m^2", rank=INERTIA)
    viscous: float | None = linear("N m s/rad", rank=FRICTION)
    coulomb: float | None = linear("N m", rank=FRICTION)
    turnover: float | None = turnover_shape()  # of motor b's gear

    def shape_range(self, motion: Motion) -> Array:
        return np.array(turnover_range(motion.joint(self.joint_pair[1])))[:, None]

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        return ShapeSearch(np.array([[turnover_start(motion.joint(self.joint_pair[1]))]]))

    def unit_laws(self, motion: Motion) -> tuple[Law, ...]:
        a, b = (motion.coordinates.port(joint, "drive") for joint in self.joint_pair)
        dry = Law(a + b, function=CoulombFriction.law, parameters=np.r_[1.0, self.known_shape()])
        return Law(a + b, inertia=1.0), Law(a + b, damping=1.0), dry

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        pairs = itertools.combinations(sites.moving, 2)
        return [cls(joint_pair=pair, inertia=1.0, viscous=0.0, coulomb=0.0) for pair in pairs]

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        drives = (sizes.coordinates.port(joint, "drive") for joint in self.joint_pair)
        return np.array([[0.05], [0.3]]) * min(sizes.inertia(port) for port in drives)
