"""Friction that grows with the torque through the transmission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rx90b_flex.effects.effect import FRICTION, JointEffect, linear
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.reversal import reversal, reversal_slope


@dataclass(frozen=True, kw_only=True)
class LoadFriction(JointEffect):
    """Gear friction, ``coefficient * |load| * sign(v)``; the load is the torque that the links ask of the joint.

    The load comes from the tree as it is known, so the column is linear in the coefficient alone.
    """

    needs_load: ClassVar[bool] = True

    coefficient: float | None = linear("-", lower=0.0, rank=FRICTION)

    def basis(self, at: JointMotion) -> Array:
        return (np.abs(at.load) * reversal(at.v))[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        slope = (np.abs(at.load) * reversal_slope(at.v))[:, None]
        zero = np.zeros_like(slope)
        return zero, slope, zero

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        by_q, by_v, by_a = super().derivatives(motion)
        at = motion.joint(self.joint)
        place = int(np.flatnonzero(at.port)[-1])
        factor = self.known_coefficients()[0] * reversal(at.v) * np.sign(at.load)
        through_load = [
            factor[:, None, None] * at.port[None, :, None] * by[:, place, None, :]
            for by in motion.on_tree.derivatives()
        ]
        return by_q + through_load[0], by_v + through_load[1], by_a + through_load[2]
