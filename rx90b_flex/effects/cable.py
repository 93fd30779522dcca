"""Torque of a hose or cable that another joint bends."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rx90b_flex.effects.effect import SPRING, PairEffect, Sites, linear
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array, Motion


@dataclass(frozen=True, kw_only=True)
class CableTorque(PairEffect):
    """Torque on joint a from a hose or cable that joint b bends, ``coefficients[0] * q_b + coefficients[1] * q_b^2``.

    The reaction is not modelled: the cable is clamped elsewhere.

    Signature
    ---------
    A smooth curve of one joint's residual against another joint's angle, at rest too.

    Neighbours
    ----------
    `joint_spring` follows the joint's own angle; gravity follows both angles together, and bends over a radian.

    Source
    ------
    Not in Hardeman 2008; torques of cable packages along an arm, the first two terms of a smooth curve.
    """

    behind_gear: ClassVar[bool] = True

    bends: tuple[float, float] | None = linear("N m/rad^k", rank=SPRING, size=2, public="coefficients")

    def factors(self, motion: Motion) -> tuple[Array, Array]:
        on, by = self.joint_pair
        q = motion.joint(by).q
        return motion.coordinates.port(on), np.stack([q, q**2], axis=1)

    def columns(self, motion: Motion) -> Array:
        port, basis = self.factors(motion)
        return port[None, :, None] * basis[:, None, :]

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        on, by = (motion.coordinates.port(joint) for joint in self.joint_pair)
        first, second = self.known_coefficients()
        slope = first + 2.0 * second * (motion.q @ by)
        by_q = slope[:, None, None] * np.outer(on, by)
        return by_q, np.zeros_like(by_q), np.zeros_like(by_q)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        out[0] = (parameters[0] + parameters[1] * x) * x
        out[1] = parameters[0] + 2.0 * parameters[1] * x
        out[2] = 0.0

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        on, by = (motion.coordinates.port(joint) for joint in self.joint_pair)
        return (Law(on, reads=by, function=self.law, parameters=self.known_coefficients(), stores=True),)

    @classmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        return [cls(joint_pair=pair) for pair in itertools.permutations(sites.joints, 2)]
