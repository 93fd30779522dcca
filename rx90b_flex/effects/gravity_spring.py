"""The spring inside an arm that carries its weight."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rx90b_flex.effects.effect import SPRING, JointEffect, Sites, given, linear
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array, JointMotion, Motion


@dataclass(frozen=True, kw_only=True)
class GravitySpring(JointEffect):
    """A spring between two neighbouring links, equations 3.9 and 3.61.

    It pulls its ends together with ``stiffness * (l - l_0) + prestress``, so its torque about the joint is
    ``(stiffness * (l - l_0) + prestress) * dl/dtheta``. l is the distance of the anchors, l_0 that at zero joint angle.

    The anchors are points in the joint's own frame at zero angle, m: the first fixed to the parent link, the second
    to the child. They are geometry and cannot be estimated, so no search tries this effect. The length follows the
    joint angle theta = e + eps1 alone; what the bending of the joint (about 1e-3 rad) adds to it is left out.

    Signature
    ---------
    A curve against the joint's own angle, near a sine, at rest too, against the links' weight.

    Neighbours
    ----------
    `joint_spring` is a straight line. Gravity depends on how the link lies in space, the spring only on its own joint's
    angle: tilt the link by a joint before it. Where nothing else tilts it, as the upper arm of an upright robot, a
    fitted link takes the spring up.

    Source
    ------
    Hardeman 2008, equations 3.9 and 3.61.
    """

    part: ClassVar[str] = "spring"

    stiffness: float | None = linear("N/m", lower=0.0, rank=SPRING)
    prestress: float | None = linear("N", rank=SPRING)
    anchors: tuple[float, ...] | None = given("m", size=6)

    def basis(self, at: JointMotion) -> Array:
        elongation, slope, _ = self._elongation(at)
        return np.stack([elongation * slope, slope], axis=1)

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        elongation, slope, curvature = self._elongation(at)
        by_angle = np.stack([elongation * curvature + slope**2, curvature], axis=1)
        zero = np.zeros_like(by_angle)
        return by_angle, zero, zero

    def potential(self, motion: Motion) -> Array:
        stiffness, prestress = self.known_coefficients()
        elongation, _, _ = self._elongation(motion.joint(self.joint, self.side))
        return (0.5 * stiffness * elongation + prestress) * elongation

    def _elongation(self, at: JointMotion) -> tuple[Array, Array, Array]:
        """Elongation and its first two derivatives by the joint angle, each (N,)."""
        constant, cosine, sine, squares = self._geometry(at.motion)
        product = constant + cosine * np.cos(at.q) + sine * np.sin(at.q)
        by_angle = sine * np.cos(at.q) - cosine * np.sin(at.q)
        rest = np.sqrt(squares - 2.0 * (constant + cosine))
        length = np.sqrt(squares - 2.0 * product)
        if rest == 0.0 or not length.all():
            raise ValueError(f"{self.label}: the anchors meet, where the spring's force has no direction")
        slope = -by_angle / length
        curvature = (product - constant - slope**2) / length
        return length - rest, slope, curvature

    def _geometry(self, motion: Motion) -> Array:
        """Parts of ``fixed . R(theta) moving`` (constant, by cosine, by sine), and the anchors' squared distances from
        the axis.
        """
        if self.anchors is None:
            raise ValueError(f"{self.label}: anchors have no value; they cannot be identified")
        fixed, moving = np.asarray(self.anchors, dtype=float).reshape(2, 3)
        axis = motion.on_tree.joint_axis(self.joint)
        along = axis * (axis @ moving)  # Rodrigues' formula for the turn about the axis
        turned = fixed @ (moving - along), fixed @ np.cross(axis, moving)
        return np.array([fixed @ along, *turned, fixed @ fixed + moving @ moving])

    @staticmethod
    def law(x: float, rate: float, parameters: Any, out: Any) -> None:
        constant, cosine, sine, squares = parameters[2], parameters[3], parameters[4], parameters[5]
        turned = cosine * math.cos(x) + sine * math.sin(x)
        length = math.sqrt(squares - 2.0 * (constant + turned))
        slope = (cosine * math.sin(x) - sine * math.cos(x)) / length
        curvature = (turned - slope * slope) / length
        force = parameters[0] * (length - math.sqrt(squares - 2.0 * (constant + cosine))) + parameters[1]
        out[0] = force * slope
        out[1] = force * curvature + parameters[0] * slope * slope
        out[2] = 0.0

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        values = np.concatenate([self.known_coefficients(), self._geometry(motion)])
        port = motion.coordinates.port(self.joint, self.side)
        return (Law(port, function=self.law, parameters=values, stores=True),)

    @classmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        return []
