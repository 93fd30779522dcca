"""Springs across one joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from rx90b_flex.effects.at_rest import RestSites, RestSizes, ShownAtRest
from rx90b_flex.effects.effect import JointEffect
from rx90b_flex.effects.law import Law, constant
from rx90b_flex.effects.law_effect import SumOfLaws
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.parameters import SPRING, Parameter, derived, linear


@dataclass(frozen=True, kw_only=True)
class JointSpring(
    SumOfLaws,
    JointEffect,
    ShownAtRest,
    behind_gear=True,
    part="spring",
    of_make=False,
    scaled=((0, 1),),
    straight=("level", "angle"),
):
    """A hose or cable, ``stiffness * (q - rest_angle)``.

    Linear in the stiffness and in ``preload = stiffness * rest_angle``. Where the model has a constant torque on
    the same joint, the preload cannot be told from it and the rest angle stays unknown.

    Signature
    ---------
    A straight line against the joint's own angle, at rest too, whatever the other joints do.

    Neighbours
    ----------
    Gravity bends over a radian and depends on the joints before it as well. `gravity_spring` is a curve. A constant
    torque on the same joint (`torque_offset`) takes the preload's place.

    Source
    ------
    Not in Hardeman 2008; the linear case of equation 3.61 between two neighbouring links.
    """

    stiffness: float | None = linear("N m/rad", lower=0.0, rank=SPRING)
    rest_angle: float | None = derived("rad")

    @property
    def coefficient_parameters(self) -> dict[str, Parameter]:
        return {"stiffness": self.parameters()["stiffness"], "preload": Parameter("N m", "linear", rank=SPRING)}

    @property
    def coefficients(self) -> Array:
        stiffness, rest = (np.nan if x is None else x for x in (self.stiffness, self.rest_angle))
        return np.array([stiffness, stiffness * rest])

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        stiffness, preload = (float(x) for x in values)
        rest = preload / stiffness if stiffness != 0 else 0.0  # without stiffness any angle is one of rest
        return dataclasses.replace(
            self, stiffness=None if np.isnan(stiffness) else stiffness, rest_angle=None if np.isnan(rest) else rest
        )

    def unit_laws(self, motion: Motion) -> tuple[Law, ...]:
        port = motion.coordinates.port(self.joint, self.port_kind)
        return Law(port, stiffness=1.0), Law(port, function=constant, parameters=np.array([-1.0]), stores=True)

    def potential(self, motion: Motion) -> Array:
        stiffness, preload = self.known_coefficients()
        q = motion.joint(self.joint).q
        return (0.5 * stiffness * q - preload) * q

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        return [cls(joint=j, stiffness=1.0, rest_angle=sites.angles[j]) for j in sites.moving]

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        inertia = sizes.inertia(sizes.coordinates.port(self.joint, "drive"))
        return inertia * (2 * np.pi * np.array([[0.1], [0.5]]) * sizes.band_hz[0]) ** 2
