"""Dry friction whose sign turns over along an angle and is kept at rest, beside hysteresis of the same joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rx90b_flex.compiled.signals import dahl
from rx90b_flex.effects.effect import Effect, JointForce
from rx90b_flex.effects.hints import ShapeSearch
from rx90b_flex.effects.law_effect import RememberingLaw
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import given
from rx90b_flex.effects.reversal import SHARP, DryFriction, reversal
from rx90b_flex.effects.stand_in import OtherForm

SMALLEST = 1e-9  # rad, along which a sign turns over at once


@dataclass(frozen=True, kw_only=True)
class AlongAngle(OtherForm, RememberingLaw, DryFriction):
    """A dry friction in the form whose sign is that of `presliding_friction` with a ``deflection`` (rad).

    It stands beside hysteresis, along whose angle it turns over. Laws remember the sign: `dahl` from one step to the next.
    """

    stated_by: ClassVar[str] = "deflection"

    turnover: float | None = None  # it has none
    deflection: float | None = given("rad", lower=SMALLEST)

    def beside(self, others: Sequence[Effect]) -> Effect | None:
        known = (e.turns_along for e in others if isinstance(e, RememberingLaw))
        return next((dataclasses.replace(self, deflection=angle) for angle in known if angle is not None), None)

    def at(self, motion: Motion) -> JointMotion:
        return JointForce.at(self, motion)

    def law_shape(self, motion: Motion) -> Array:
        return np.append(self.known_shape(), self._angle)

    @property
    def _angle(self) -> float:
        return SMALLEST if self.deflection is None else self.deflection

    def shape_range(self, motion: Motion) -> Array:
        return self.own_range(motion)

    def with_turnover(self, motion: Motion, own: Array, independent: int = 1) -> ShapeSearch:
        return ShapeSearch(own, independent)

    def direction(self, at: JointMotion) -> Array:
        return dahl(at.q, self._angle) if at.follows else reversal(at.v, SHARP)

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        """As of the form that turns over within a velocity, at once."""
        sharp = {f.name: getattr(self, f.name) for f in dataclasses.fields(self.form_of)} | {"turnover": SHARP}
        return self.form_of(**sharp).slopes(at)  # type: ignore[attr-defined]
