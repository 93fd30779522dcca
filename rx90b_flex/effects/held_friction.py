"""Dry friction that a joint at rest still holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.effect import FRICTION, Remembering, linear
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.reversal import DryFriction, last_direction, turnover_shape


@dataclass(frozen=True, kw_only=True)
class HeldFriction(DryFriction, Remembering):
    """What dry friction still holds at rest in the direction of the last move, ``torque * (last direction - sign(v))``.

    A controller that brings a joint to rest leaves the gear wound up: the motor goes on holding part of the friction that it last
    overcame. While the joint moves the two directions agree and nothing is left of it.

    Signature
    ---------
    At rest, a torque that has the sign of the last move and stays until the next one; nothing while the joint moves.

    Neighbours
    ----------
    `torque_offset` does not change with the last move. `presliding_friction` and `maxwell_slip_friction` also turn over
    gradually after the joint has reversed, along an angle. Needs rests after moves in both directions.

    Source
    ------
    Not in Hardeman 2008; dry friction at standstill takes any value up to its own (C. A. Coulomb, 1785).
    """

    torque: float | None = linear("N m", lower=0.0, rank=FRICTION)
    turnover: float | None = turnover_shape()

    def basis(self, at: JointMotion) -> Array:
        if not at.follows:
            return np.zeros((len(at.q), 1))
        return self._held(at, last_direction(at))[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(at.q), 1))
        moved = last_direction(at) != 0.0 if at.follows else True
        return zero, np.where(moved, -self.direction_slope(at.v), 0.0)[:, None], zero

    def memory(self, motion: Motion) -> Array:
        return np.zeros((len(motion), 1))

    def onward(self, memory: Array, motion: Motion) -> Array:
        """Direction of the last move from one sample to the next."""
        v = motion.joint(self.joint).v
        return np.where(np.abs(v) > self.sharpness, np.sign(v), memory[:, 0])[:, None]

    def remembered(self, memory: Array, motion: Motion) -> tuple[Array, Array]:
        at = motion.joint(self.joint)
        (torque,) = self.known_coefficients()
        held = np.where(np.abs(at.v) > self.sharpness, 0.0, self._held(at, memory[:, 0]))
        return np.outer(torque * held, at.port), np.zeros((len(at.q), len(at.port), len(at.port)))

    def _held(self, at: JointMotion, last: Array) -> Array:
        """Last direction less the present one; nothing before the first move, of which nobody knows what came before."""
        return np.where(last == 0.0, 0.0, last - self.direction(at.v))
