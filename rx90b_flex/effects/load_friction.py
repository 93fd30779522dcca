"""Friction that grows with the torque through the transmission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rx90b_flex.effects.effect import FRICTION, linear
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.reversal import DryFriction, turnover_shape


@dataclass(frozen=True, kw_only=True)
class LoadFriction(DryFriction):
    """Gear friction, ``coefficient * |load| * sign(v)``; the load is the torque that the links ask of the joint.

    The load comes from the tree as it is known, so the column is linear in the coefficient alone.

    Signature
    ---------
    A jump at reversal whose height follows the torque that the joint carries: against velocity the residual fans
    out by load.

    Neighbours
    ----------
    `coulomb_friction` jumps by the same in every pose. Told apart by stretched and folded poses, or with and
    without payload.

    Source
    ------
    Not in Hardeman 2008; load dependence of friction in a robot joint: A. C. Bittencourt, S. Gunnarsson, ASME
    Journal of Dynamic Systems, Measurement, and Control 134(5), 2012.
    """

    needs_load: ClassVar[bool] = True

    coefficient: float | None = linear("-", lower=0.0, rank=FRICTION)
    turnover: float | None = turnover_shape()

    def basis(self, at: JointMotion) -> Array:
        return (np.abs(at.load) * self.direction(at.v))[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        slope = (np.abs(at.load) * self.direction_slope(at.v))[:, None]
        zero = np.zeros_like(slope)
        return zero, slope, zero

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        by_q, by_v, by_a = super().derivatives(motion)
        at = motion.joint(self.joint)
        place = int(np.flatnonzero(at.port)[-1])
        factor = self.known_coefficients()[0] * self.direction(at.v) * np.sign(at.load)
        through_load = [
            factor[:, None, None] * at.port[None, :, None] * by[:, place, None, :]
            for by in motion.on_tree.derivatives()
        ]
        return by_q + through_load[0], by_v + through_load[1], by_a + through_load[2]
