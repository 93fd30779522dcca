"""Dry friction that changes with the angle of its joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.compiled.in_laws import turned_over, turning
from rx90b_flex.effects.along_angle import AlongAngle
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.law_effect import LawEffect
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import derived, shape
from rx90b_flex.effects.reversal import DryFriction, quick_range, turnover_shape
from rx90b_flex.effects.ripple import PeriodicEffect


@dataclass(frozen=True, kw_only=True)
class PositionFriction(PeriodicEffect, LawEffect, DryFriction, repeats=False):
    """Dry friction that changes with the angle, ``amplitude * sin(order * q + phase) * sign(v)``, order cycles a joint turn.

    With a ``deflection`` (rad; in place of ``turnover``) its sign turns over along that angle and is kept at rest, as that of
    hysteresis beside it.

    Signature
    ---------
    At one angle the residual is opposite for the two directions, and it comes and goes along the angle.

    Neighbours
    ----------
    `gear_ripple` is the same in both directions; `coulomb_friction` is the same at all angles; `load_friction` follows the load,
    which gravity changes with the angle too: other poses of the joints behind tell.

    Source
    ------
    Not in Hardeman 2008; friction that depends on the position in gears: B. Armstrong-Hélouvry, P. Dupont,
    C. Canudas de Wit, Automatica 30(7), 1994.
    """

    PEAKS: ClassVar[int] = 4
    SHOWN: ClassVar[float] = 0.25  # no other law changes sign with the direction and along the angle

    order: float | None = shape("1/turn", start=1.0, lower=0.5, upper=PeriodicEffect.HIGHEST_ORDER, least_will_do=True)
    amplitude: float | None = derived("N m", lower=0.0)
    phase: float | None = derived("rad")
    turnover: float | None = turnover_shape()

    def own_range(self, motion: Motion) -> Array:
        """From a quarter of a cycle over the joint's travel: what changes less along it the other dry friction has as well."""
        out = super().own_range(motion)
        out[0, 0] = max(out[0, 0], 2.0 * np.pi * self.SHOWN / max(self._range(motion), 1e-2))
        out[1, 0] = max(out[1, 0], 2.0 * out[0, 0])
        return out

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """As of a ripple, for a residual that changes sign with the direction."""
        found = self._orders(motion, left)
        low, high = quick_range(motion.joint(self.joint))
        starts = np.concatenate([found.starts, np.full((len(found.starts), 1), np.sqrt(low * high))], axis=1)
        return replace(found, starts=starts, spread=np.r_[found.spread, 0.3 * self.sharpness])

    def _orders(self, motion: Motion, left: LeftOver | None) -> ShapeSearch:
        """How its order is searched for."""
        if left is not None:
            left = replace(left, residual=[(m, x * np.sign(m.joint(self.joint).v)) for m, x in left.residual])
        return PeriodicEffect.shape_search(self, motion, left)

    def basis(self, at: JointMotion) -> Array:
        # as the law has it, without the slopes: a search over orders asks for it most
        angle = self.known_shape()[0] * at.q
        return np.stack([np.sin(angle), np.cos(angle)], axis=1) * self.direction(at)[:, None]

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        sine, cosine, order, turnover = parameters[0], parameters[1], parameters[2], parameters[3]
        s, c, sign = np.sin(order * x), np.cos(order * x), np.tanh(rate / turnover)
        out[0] = (sine * s + cosine * c) * sign
        out[1] = order * (sine * c - cosine * s) * sign
        out[2] = (sine * s + cosine * c) * (1.0 - sign * sign) / turnover


@dataclass(frozen=True, kw_only=True)
class _PositionFrictionAlongAngle(AlongAngle, PositionFriction, replaces=("position_friction",), repeats=False):
    """Position friction whose sign turns over along an angle and is kept at rest, as that of hysteresis beside it."""

    form_of: ClassVar[type[Effect]] = PositionFriction

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        return self._orders(motion, left)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        sine, cosine, order, deflection = parameters[0], parameters[1], parameters[2], parameters[3]
        before, part = parameters[6], parameters[7]
        part = turned_over(x, before, part, deflection)
        s, c = np.sin(order * x), np.cos(order * x)
        size = sine * s + cosine * c
        out[0] = size * part
        out[1] = order * (sine * c - cosine * s) * part + size * turning(part, rate, deflection)
        out[2] = 0.0
        out[4] = part
