"""Gear losses that depend on load: with speed, and with the direction in which power flows."""

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
class DriveEfficiency(LawEffect, DryFriction, needs_load=True, replaces=("load_friction",)):
    """Gear friction ``|load| * sign(v)`` with one coefficient where power flows to the load and another where it flows back.

    ``motoring`` acts where load and velocity have one sign, ``backdriving`` where they differ. It stands in for `load_friction`,
    which has the same coefficient for both. With a ``deflection`` (rad; in place of ``turnover``) its sign turns over along that
    angle and is kept at rest, as that of hysteresis beside it.

    Signature
    ---------
    A jump at reversal whose height follows the load, higher (or lower) when lifting than when lowering.

    Neighbours
    ----------
    `load_friction` loses alike both ways. With a `torque_gain` beside it that is the same but for reversals, by the half of what the
    two coefficients differ. `load_viscous_friction` grows with speed too. Needs lifting and lowering at several loads.

    Source
    ------
    Not in Hardeman 2008; P. Hamon, M. Gautier, P. Garrec, *Dynamic identification of robots with a dry friction model depending on
    load and velocity*, IROS 2010: friction that depends on the load and on the direction of power flow.
    """

    motoring: float | None = linear("-", lower=0.0, rank=FRICTION)
    backdriving: float | None = linear("-", lower=0.0, rank=FRICTION)
    turnover: float | None = turnover_shape()

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        motoring, backdriving, turnover, load = parameters[0], parameters[1], parameters[2], parameters[4]
        coefficient = backdriving + (motoring - backdriving) * (load * rate > 0.0)
        sign, size = np.tanh(rate / turnover), coefficient * np.abs(load)
        out[0] = size * sign
        out[1] = 0.0
        out[2] = size * (1.0 - sign * sign) / turnover
        out[3] = coefficient * np.sign(load) * sign


@dataclass(frozen=True, kw_only=True)
class _DriveEfficiencyAlongAngle(AlongAngle, DriveEfficiency, replaces=("load_friction",)):
    """Drive efficiency whose sign turns over along an angle and is kept at rest, as that of hysteresis beside it.

    ``motoring`` acts where load and that sign agree.
    """

    form_of: ClassVar[type[Effect]] = DriveEfficiency

    def basis(self, at: JointMotion) -> Array:
        size = np.abs(at.load) * (part := self.direction(at))
        drives = at.load * part > 0.0
        return np.column_stack([size * drives, size * ~drives])

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        motoring, backdriving, deflection, load = parameters[0], parameters[1], parameters[2], parameters[4]
        before, part = parameters[5], parameters[6]
        part = turned_over(x, before, part, deflection)
        coefficient = backdriving + (motoring - backdriving) * (load * part > 0.0)
        put_friction_of_load(coefficient, load, part, rate, deflection, out)


@dataclass(frozen=True, kw_only=True)
class LoadViscousFriction(LawEffect, needs_load=True):
    """Gear losses that grow with load and speed, ``coefficient * |load| * v``.

    Signature
    ---------
    Against velocity straight lines through the origin, steeper where the joint carries more.

    Neighbours
    ----------
    `viscous_friction` has one slope for all loads, `load_friction` a jump that does not grow with speed.

    Source
    ------
    Not in Hardeman 2008; P. Hamon, M. Gautier, P. Garrec, IROS 2010: friction with the product of load and velocity.
    """

    coefficient: float | None = linear("s/rad", lower=0.0, rank=FRICTION)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        coefficient, load = parameters[0], parameters[2]
        out[0] = coefficient * np.abs(load) * rate
        out[1] = 0.0
        out[2] = coefficient * np.abs(load)
        out[3] = coefficient * np.sign(load) * rate
