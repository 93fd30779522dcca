"""The spring inside an arm that carries its weight."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.effects.effect import Effect, JointEffect
from rx90b_flex.effects.elements import AnchoredSpring
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.law_effect import LawEffect
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import SPRING, given, linear, shape
from rx90b_flex.effects.stand_in import StandIn

FAR = 0.4  # m from the axis, the farther anchor of a spring that was searched for: its torque does not tell the scale
HALF = 0.5  # of that, the nearer one where the torque does not tell their ratio either
# geometries from which a search begins: springs whose ends nearly meet make narrow valleys
ANGLES, RATIOS = 16, (0.4, 0.75, 0.93)
LARGEST_RATIO = 0.9999  # of such a spring: at 1 its ends may meet


@dataclass(frozen=True, kw_only=True)
class GravitySpring(LawEffect, behind_gear=True, part="spring"):
    """A spring between two neighbouring links, equations 3.9 and 3.61.

    It pulls its ends together with ``stiffness * (l - l_0) + prestress``, so its torque about the joint is
    ``(stiffness * (l - l_0) + prestress) * dl/dtheta``. l is the distance of the anchors, l_0 that at zero joint angle.

    The anchors are points in the joint's own frame at zero angle, m: the first fixed to the parent link, the second
    to the child. They are geometry that torques tell in part: the angle between them and the ratio of their distances from the
    axis, no more. A search over time finds these and takes the farther anchor 0.4 m from the axis, both in one plane. The length
    follows the joint angle theta = e + eps1 alone; what the bending of the joint (about 1e-3 rad) adds to it is left out.

    Signature
    ---------
    A curve against the joint's own angle, near a sine, at rest too, against the links' weight.

    Neighbours
    ----------
    `joint_spring` is a straight line. `gear_ripple` of order 1 is the spring whose pull is in proportion to its length, a pure sine.
    Gravity depends on how the link lies in space, the spring only on its own joint's
    angle: tilt the link by a joint before it. Where nothing else tilts it, as the upper arm of an upright robot, a
    fitted link takes the spring up.

    Source
    ------
    Hardeman 2008, equations 3.9 and 3.61.
    """

    law_stores: ClassVar[bool] = True

    stiffness: float | None = linear("N/m", lower=0.0, rank=SPRING)
    prestress: float | None = linear("N", rank=SPRING)
    anchors: tuple[float, ...] | None = given("m", size=6)

    def potential(self, motion: Motion) -> Array:
        stiffness, prestress = self.known_coefficients()
        length, rest = self._lengths(motion)
        return (0.5 * stiffness * (length - rest) + prestress) * (length - rest)

    def law_shape(self, motion: Motion) -> Array:
        self._lengths(motion)  # which must have a direction
        return self._geometry(motion)

    def _lengths(self, motion: Motion) -> tuple[Array, float]:
        """Distance of the anchors along a motion, (N,), and at zero joint angle, m."""
        constant, cosine, sine, squares = self._geometry(motion)
        q = motion.joint(self.joint).q
        length = np.sqrt(squares - 2.0 * (constant + cosine * np.cos(q) + sine * np.sin(q)))
        rest = float(np.sqrt(squares - 2.0 * (constant + cosine)))
        if rest == 0.0 or not length.all():
            raise ValueError(f"{self.label}: the anchors meet, where the spring's force has no direction")
        return length, rest

    def _ends(self) -> Array:
        """The anchors, (2, 3)."""
        if self.anchors is None:
            raise ValueError(f"{self.label}: anchors have no value; they cannot be identified")
        return np.asarray(self.anchors, dtype=float).reshape(2, 3)

    def _geometry(self, motion: Motion) -> Array:
        """Parts of ``fixed . R(theta) moving`` (constant, by cosine, by sine), and the anchors' squared distances from
        the axis.
        """
        fixed, moving = self._ends()
        axis = motion.on_tree.joint_axis(self.joint)
        along = axis * (axis @ moving)  # Rodrigues' formula for the turn about the axis
        turned = fixed @ (moving - along), fixed @ np.cross(axis, moving)
        return np.array([fixed @ along, *turned, fixed @ fixed + moving @ moving])

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        stiffness, prestress = parameters[0], parameters[1]
        constant, cosine, sine, squares = parameters[2], parameters[3], parameters[4], parameters[5]
        turned = cosine * np.cos(x) + sine * np.sin(x)
        length = np.sqrt(squares - 2.0 * (constant + turned))
        slope = (cosine * np.sin(x) - sine * np.cos(x)) / length
        curvature = (turned - slope * slope) / length
        force = stiffness * (length - np.sqrt(squares - 2.0 * (constant + cosine))) + prestress
        out[0] = force * slope
        out[1] = force * curvature + stiffness * slope * slope
        out[2] = 0.0

    def element(self) -> AnchoredSpring:
        stiffness, prestress = (float(x) for x in self.known_coefficients())
        fixed, moving = self._ends()
        return AnchoredSpring(fixed, moving, stiffness, prestress)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        turning = [j for j in sites.joints if j not in sites.sliding]
        return [own(joint=j) for own in (_SineSpring, _SearchedSpring) for j in turning]


class _SpringOfTwoLevers(StandIn, JointEffect, behind_gear=True, of_make=False):
    """A `GravitySpring` of unknown geometry: levers a and b from the axis to its ends, ``l^2 = a^2 + b^2 - 2 a b cos(q - angle)``."""

    in_files: ClassVar[type[Effect]] = GravitySpring

    @abstractmethod
    def geometry(self) -> tuple[float, float]:
        """Nearer lever over the farther one, and the angle, rad."""

    @abstractmethod
    def pulls(self) -> tuple[float, float]:
        """Stiffness times both levers, and what the pull has beyond stiffness times length, times both levers; N m and N m^2."""

    def _spring(self) -> tuple[float, float, float, float]:
        """Stiffness (N/m), prestress (N), nearer over farther lever, angle (rad)."""
        ratio, angle = self.geometry()
        stiff, beyond = (x / (ratio * FAR**2) for x in self.pulls())
        rest = FAR * float(np.sqrt(1.0 + ratio**2 - 2.0 * ratio * np.cos(angle)))
        return stiff, beyond + stiff * rest, ratio, angle

    def public_values(self) -> list[tuple[str, str, float]]:
        names = (("stiffness", "N/m"), ("prestress", "N"), ("lever_ratio", "-"), ("angle", "rad"))
        return [(name, unit, value) for (name, unit), value in zip(names, self._spring(), strict=True)]

    def caution(self) -> str:
        if not self.known:
            return ""
        (ratio, _), (pull, _) = self.geometry(), self.pulls()
        return (
            f"{self.label}: torques tell its stiffness times both levers, {pull:.4g} N m, and no length. Its N/m and N are for ends "
            f"{FAR:g} m and {ratio * FAR:.3g} m from the axis, which are assumed: declare it with its anchors to have those of the "
            "spring that is there."
        )

    def in_tree(self, motion: Motion) -> Effect:
        stiffness, prestress, ratio, angle = self._spring()
        axis = motion.on_tree.joint_axis(self.joint)
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        across /= np.linalg.norm(across)
        moving = ratio * (np.cos(angle) * across - np.sin(angle) * np.cross(axis, across))
        anchors = tuple(float(x) for x in FAR * np.r_[across, moving])
        return GravitySpring(joint=self.joint, stiffness=stiffness, prestress=prestress, anchors=anchors)


@dataclass(frozen=True, kw_only=True)
class _SearchedSpring(_SpringOfTwoLevers, part="spring", replaces=("gravity_spring", "joint_spring")):
    """``(pull + slack / sqrt(1 - ratio cos(q - angle))) sin(q - angle)``, ratio 2ab/(a^2 + b^2): any spring between two levers."""

    pull: float | None = linear("N m", lower=0.0, rank=SPRING)
    slack: float | None = linear("N m", rank=SPRING)
    angle: float | None = shape("rad", start=0.0, lower=-3.0 * np.pi, upper=3.0 * np.pi)
    ratio: float | None = shape("-", start=0.75, lower=0.02, upper=LARGEST_RATIO)

    def basis(self, at: JointMotion) -> Array:
        return self._at_shapes(at, self.known_shape()[None])

    def side_by_side(
        self, effects: Sequence[Effect], motion: Motion, leading: bool = False
    ) -> tuple[Array | None, Array]:
        if any(type(e) is not type(self) or e.joints != self.joints for e in effects):
            return super().side_by_side(effects, motion, leading)
        at = self.at(motion)
        return at.port, self._at_shapes(at, np.array([e.known_shape() for e in effects]))

    @staticmethod
    def _at_shapes(at: JointMotion, shapes: Array) -> Array:
        """Two columns of each of some angles and ratios (M, 2), one pair behind the other, (N, 2 M)."""
        angle, ratio = shapes.T
        s, c = np.sin(at.q)[:, None], np.cos(at.q)[:, None]
        out = np.empty((len(at.q), len(shapes), 2))
        sine, over_root = out[..., 0], out[..., 1]
        sine[:] = s * np.cos(angle) - c * np.sin(angle)
        # a difference quotient by the ratio goes a little beyond its range
        square = np.maximum(1.0 - c * (ratio * np.cos(angle)) - s * (ratio * np.sin(angle)), 1.0 - LARGEST_RATIO)
        np.divide(sine, np.sqrt(square), out=over_root)
        return out.reshape(len(at.q), -1)

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        angles = np.pi * (2.0 * np.arange(ANGLES) / ANGLES - 1.0)
        replaced = None if left is None else left.instead_of
        if isinstance(replaced, _SpringOfTwoLevers):  # whose angle is known to more than these tell apart
            _, angle = replaced.geometry()
            angles = np.append(angles, [angle, angle - np.sign(angle) * np.pi])
        starts = np.stack(np.meshgrid(angles, RATIOS), axis=-1).reshape(-1, 2)
        # neighbouring angles are much alike, and a refinement finds the ratio from any
        return ShapeSearch(starts, independent=ANGLES // 2, spread=np.array([0.45, 0.6]))

    def geometry(self) -> tuple[float, float]:
        angle, ratio = self.shape
        return float((1.0 - np.sqrt(1.0 - ratio**2)) / ratio), float(angle)

    def pulls(self) -> tuple[float, float]:
        pull, slack = self.coefficients
        lever, _ = self.geometry()
        return float(pull), float(slack * FAR * np.sqrt(1.0 + lever**2))


@dataclass(frozen=True, kw_only=True)
class _SineSpring(_SpringOfTwoLevers, part="spring"):
    """``sine sin(q) + cosine cos(q)``: a spring that pulls in proportion to its length, as one that balances a weight exactly."""

    sine: float | None = linear("N m", rank=SPRING)
    cosine: float | None = linear("N m", rank=SPRING)

    def basis(self, at: JointMotion) -> Array:
        return np.stack([np.sin(at.q), np.cos(at.q)], axis=1)

    def geometry(self) -> tuple[float, float]:
        sine, cosine = self.coefficients
        return HALF, float(np.arctan2(-cosine, sine))

    def pulls(self) -> tuple[float, float]:
        return float(np.hypot(*self.coefficients)), 0.0
