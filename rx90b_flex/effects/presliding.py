"""Friction that remembers: hysteresis before sliding (Dahl, 1968)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rx90b_flex.compiled.in_laws import turned_over, turning
from rx90b_flex.compiled.signals import dahl
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.law_effect import RememberingLaw
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import FRICTION, Parameter, derived, linear
from rx90b_flex.effects.reversal import SHARP, Resolution, reversal, reversal_slope
from rx90b_flex.effects.stand_in import StandIn

DEFLECTION = Parameter("rad", "shape", 1e-9, 1e3)  # torque over stiffness: the shape that a fit works with
LARGEST_DEFLECTION = 0.3  # of a joint's travel: what takes longer to turn over is a spring


@dataclass(frozen=True, kw_only=True)
class PreslidingFriction(RememberingLaw, breaks_away=True):
    """Dahl's friction: at reversal the torque turns over with `stiffness`, then approaches `torque`.

    ``dF/dq = stiffness * (1 - F / torque * sign(v))``. Where samples do not follow each other in time there is no memory, and it
    is what it comes to after sliding: ``torque * sign(v)``.

    Signature
    ---------
    After each reversal the torque turns over gradually, along the same small angle whatever the speed: a loop
    against position.

    Where it is all of a joint's dry friction it stands in `coulomb_friction`'s place, and holds at rest what it last overcame.

    Neighbours
    ----------
    `coulomb_friction` turns over at once; `stribeck_friction` depends on the speed reached since. `backlash` acts
    where the load changes sign, not the velocity. A log with few samples a reversal cannot tell it from dry
    friction behind a slow filter.

    Source
    ------
    Not in Hardeman 2008; P. R. Dahl, *A Solid Friction Model*, The Aerospace Corporation, TOR-0158(3107-18)-1,
    1968.
    """

    torque: float | None = linear("N m", lower=0.0, rank=FRICTION)
    stiffness: float | None = derived("N m/rad", lower=0.0)
    deflection: float | None = None  # rad

    def __post_init__(self) -> None:
        if self.deflection is None and self.torque and self.stiffness:
            object.__setattr__(self, "deflection", self.torque / self.stiffness)

    @property
    def shape_parameters(self) -> dict[str, Parameter]:
        return {"deflection": DEFLECTION}

    @property
    def turns_along(self) -> float | None:
        return self.deflection

    def too_small(self, part: float, sample_s: float, motion: Motion) -> str:
        return super().too_small(part, sample_s, motion) or lost_in_noise(self.shape[0], motion.joint(self.joint))

    def shape_range(self, motion: Motion) -> Array:
        return np.array(deflection_range(motion.joint(self.joint)))[:, None]

    @property
    def shape(self) -> Array:
        return np.array([np.nan if self.deflection is None else self.deflection])

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        deflection = float(values[0])
        return self._consistent(self.torque, None if np.isnan(deflection) else deflection)

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        torque = float(values[0])
        return self._consistent(None if np.isnan(torque) else torque, self.deflection)

    def _consistent(self, torque: float | None, deflection: float | None) -> Self:
        known = torque is not None and deflection is not None
        stiffness = torque / deflection if known else None  # type: ignore[operator]
        return dataclasses.replace(self, torque=torque, stiffness=stiffness, deflection=deflection)

    def basis(self, at: JointMotion) -> Array:
        (deflection,) = self.known_shape()
        if not at.follows:
            return reversal(at.v, SHARP)[:, None]
        return dahl(at.q, deflection)[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(at.q), 1))
        return zero, reversal_slope(at.v, SHARP)[:, None], zero

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """It remembers its torque over `torque`: `dahl` from one step to the next."""
        torque, deflection, before, part = parameters[0], parameters[1], parameters[4], parameters[5]
        part = turned_over(x, before, part, deflection)
        out[0] = torque * part
        out[1] = torque * turning(part, rate, deflection)
        out[2] = 0.0
        out[4] = part

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        low, high = self.shape_range(motion)[:, 0]
        return ShapeSearch(np.geomspace(1.5 * low, 0.5 * high, 8)[:, None], independent=3, part=0.5)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        """Beside dry friction, and in its place."""
        return [form(joint=j) for form in (PreslidingFriction, _InPlaceOfASign) for j in sites.joints]


@dataclass(frozen=True, kw_only=True)
class _InPlaceOfASign(StandIn, PreslidingFriction, replaces=("coulomb_friction",), needs=("coulomb_friction",)):
    """All of a joint's dry friction, which then holds at rest what it last overcame; no parameter more than a sign has."""

    in_files: ClassVar[type[Effect]] = PreslidingFriction


def lost_in_noise(deflection: float, at: JointMotion) -> str:
    """Why a log cannot tell hysteresis of so small a deflection, rad, in words; empty where it can.

    Where a joint rests, the noise of its angle would take the torque more than half the way from one end to the other.
    """
    wander = Resolution.of(at).wander
    if deflection >= 2.0 * wander:
        return ""
    return f"it would turn over along {deflection:.2g} rad, and noise takes a joint at rest along {wander:.2g} rad"


def deflection_range(at: JointMotion) -> tuple[float, float]:
    """Smallest and largest angle, rad, along which a log can tell that friction turns over."""
    known = Resolution.of(at)
    low = 2.0 * known.angle
    return low, max(LARGEST_DEFLECTION * known.travel, 4.0 * low)
