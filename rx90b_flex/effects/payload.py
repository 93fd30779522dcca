"""A mass that the robot carries and its links do not know of."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np

from rx90b_flex.effects.at_rest import RestSites, RestSizes, ShownAtRest
from rx90b_flex.effects.effect import FrameEffect
from rx90b_flex.effects.elements import PointMass, unit_body
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.parameters import INERTIA, linear, shape

REACH = 0.1  # m; how far from the tip a search first looks for the mass


@dataclass(frozen=True, kw_only=True)
class Payload(FrameEffect, ShownAtRest, behind_gear=True, adds_inertia=True, part="links", scaled=((0,),)):
    """A point mass fixed to a frame.

    The force is linear in the mass. About the frame a point mass at c has the first moment ``mass * c`` and the
    inertia ``mass * (c.c I - c c^T)``, so the place c is three shape parameters: with the frame's ten body columns Y
    (3.47) the one column is ``Y @ (1, c, c.c I - c c^T)``.

    Signature
    ---------
    Gravity and inertia torques in every joint before the frame, in the proportions of a mass there.

    Neighbours
    ----------
    Fitted links take a payload up: the last link's own ten parameters hold it. It shows where links are ``known``,
    or between recordings with and without the tool. `base_tilt` also loads an upright first axis at rest.

    Source
    ------
    Hardeman 2008, equations 3.47 to 3.52 for a point mass.
    """

    mass: float | None = linear("kg", lower=0.0, rank=INERTIA)
    centre: tuple[float, float, float] | None = shape("m", start=REACH, lower=-2.0, upper=2.0, size=3)

    def _unit_body(self) -> Array:
        return unit_body(self.known_shape())

    def columns(self, motion: Motion) -> Array:
        return (motion.on_tree.body_columns(self.frame) @ self._unit_body())[:, :, None]

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        (mass,) = self.known_coefficients()
        by_q, by_v, by_a = motion.on_tree.body_derivatives(self.frame, self._unit_body())
        return mass * by_q, mass * by_v, mass * by_a

    def potential(self, motion: Motion) -> Array:
        return self.known_coefficients()[0] * motion.on_tree.body_potential(self.frame, self._unit_body())

    def element(self) -> PointMass:
        return PointMass(self.frame, float(self.known_coefficients()[0]), self.known_shape())

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        # a mass elsewhere may look like none of these alone, for the last joints, which feel least of it, tell most of where it is.
        # Several pull as their sum does at their centre of mass, and with one at the frame they need not have more inertia than it
        corners = np.array([(0.0, 0.0, 0.0), *itertools.product((-REACH, REACH), repeat=3)])
        return ShapeSearch(corners, independent=4, spread=np.full(3, REACH), mixes=True)

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        return [cls(frame=sites.tip_frame, mass=1.0, centre=(0.0, 0.0, 0.0))]

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        return np.array([[0.01], [0.1]]) * sizes.total_mass
