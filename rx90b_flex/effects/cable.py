"""Torque of a hose or cable that another joint bends."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rx90b_flex.effects.effect import Effect, PairEffect
from rx90b_flex.effects.hints import Sites
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.law_effect import SumOfLaws
from rx90b_flex.effects.motion import Motion
from rx90b_flex.effects.parameters import SPRING, linear


@dataclass(frozen=True, kw_only=True)
class CableTorque(SumOfLaws, PairEffect, behind_gear=True):
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

    bends: tuple[float, float] | None = linear("N m/rad^k", rank=SPRING, size=2, public="coefficients")

    def unit_laws(self, motion: Motion) -> tuple[Law, ...]:
        on, by = (motion.coordinates.port(joint) for joint in self.joint_pair)
        powers = (np.array([1.0, 1.0]), np.array([1.0, 2.0]))
        return tuple(Law(on, reads=by, function=self.law, parameters=p, stores=True) for p in powers)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """A torque by a power, 1 or more, of the other joint's angle."""
        factor, power = parameters[0], parameters[1]
        out[0] = factor * x**power
        out[1] = factor * power * x ** (power - 1.0)
        out[2] = 0.0

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(joint_pair=pair) for pair in itertools.permutations(sites.joints, 2)]
