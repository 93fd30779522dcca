"""Dry friction that a joint at rest still holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rx90b_flex.effects.law_effect import RememberingLaw
from rx90b_flex.effects.motion import Array, JointMotion
from rx90b_flex.effects.parameters import FRICTION, linear
from rx90b_flex.effects.reversal import DryFriction, last_direction, turnover_shape


@dataclass(frozen=True, kw_only=True)
class HeldFriction(RememberingLaw, DryFriction):
    """What dry friction still holds at rest in the direction of the last move, ``torque * (last direction - sign(v))``.

    A controller that brings a joint to rest leaves the gear wound up: the motor goes on holding part of the friction that it last
    overcame. While the joint moves the two directions agree and nothing is left of it.

    Signature
    ---------
    At rest, a torque that has the sign of the last move and stays until the next one; nothing while the joint moves. Before the
    first move nobody knows what came before: it is taken to have the sign of that.

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
        last = last_direction(at)
        return np.where(last == 0.0, 0.0, last - self.direction(at))[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(at.q), 1))
        moved = last_direction(at) != 0.0 if at.follows else True
        return zero, np.where(moved, -self.direction_slope(at.v), 0.0)[:, None], zero

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """It remembers the direction of the last move; the slope at rest, which drives away from it, is left out."""
        torque, turnover, last = parameters[0], parameters[1], parameters[5]
        moving = 1.0 * (np.abs(rate) > turnover)
        last = moving * np.sign(rate) + (1.0 - moving) * last
        out[0] = torque * (1.0 - moving) * np.abs(last) * (last - np.tanh(rate / turnover))
        out[1] = 0.0
        out[2] = 0.0
        out[4] = last
