"""Friction that grows with the torque through the transmission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.compiled.in_laws import put_friction_of_load, turned_over
from rx90b_flex.effects.along_angle import AlongAngle
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.law_effect import LawEffect
from rx90b_flex.effects.motion import Array, JointMotion
from rx90b_flex.effects.parameters import FRICTION, linear
from rx90b_flex.effects.reversal import DryFriction, turnover_shape


@dataclass(frozen=True, kw_only=True)
class LoadFriction(LawEffect, DryFriction, needs_load=True):
    """Gear friction, ``coefficient * |load| * sign(v)``; the load is the torque that the links ask of the joint.

    The load comes from the tree as it is known, so the column is linear in the coefficient alone. With a ``deflection`` (rad; in
    place of ``turnover``) its sign turns over along that angle and is kept at rest, as that of hysteresis beside it.

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

    coefficient: float | None = linear("-", lower=0.0, rank=FRICTION)
    turnover: float | None = turnover_shape()

    def basis(self, at: JointMotion) -> Array:
        # as the law has it, without the slopes
        return (np.abs(at.load) * self.direction(at))[:, None]

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        coefficient, turnover, load = parameters[0], parameters[1], parameters[3]
        sign, size = np.tanh(rate / turnover), coefficient * np.abs(load)
        out[0] = size * sign
        out[1] = 0.0
        out[2] = size * (1.0 - sign * sign) / turnover
        out[3] = coefficient * np.sign(load) * sign


@dataclass(frozen=True, kw_only=True)
class _LoadFrictionAlongAngle(AlongAngle, LoadFriction, replaces=("load_friction",)):
    """Load friction whose sign turns over along an angle and is kept at rest, as that of hysteresis beside it."""

    form_of: ClassVar[type[Effect]] = LoadFriction

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        coefficient, deflection, load = parameters[0], parameters[1], parameters[3]
        before, part = parameters[4], parameters[5]
        part = turned_over(x, before, part, deflection)
        put_friction_of_load(coefficient, load, part, rate, deflection, out)
