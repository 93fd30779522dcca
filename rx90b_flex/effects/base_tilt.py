"""A base that does not stand upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.elements import GravityChange
from rx90b_flex.effects.hints import Sites
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.parameters import OTHER, linear

# A base turned by R = 1 + [angles] sees gravity along R^T (-e_z), to first order -e_z + angle_x (-e_y) + angle_y e_x
WIDEST = 0.35  # rad, up to which the first order says what gravity does: 6 % of it are missing there
_DIRECTIONS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True, kw_only=True)
class BaseTilt(Effect, behind_gear=True, on="robot", part="links", needs_model=True):
    """Gravity not along the base's z: the base is turned by small angles about its own x and y.

    To first order in the angles (error: half their square, 1e-4 of gravity at 0.8 degrees) the force is
    ``angle_x * g_x(q) + angle_y * g_y(q)``, each the torque that the links, and every
    `payload` on them, would need if gravity pulled along -y, +x.

    Signature
    ---------
    About an upright first axis a sine of its angle, larger with the arm stretched out, at rest too; small changes
    of gravity elsewhere.

    Neighbours
    ----------
    `torque_offset` does not change as the robot turns; `payload` does not load an upright first axis at rest. Needs
    the first joint to turn far.

    Source
    ------
    Not in Hardeman 2008; gravity (equation 3.47) in a turned base, to first order.
    """

    angle_x: float | None = linear("rad", rank=OTHER)
    angle_y: float | None = linear("rad", rank=OTHER)

    def possible(self) -> bool:
        """Within `WIDEST`; an axis about which the tilt does next to nothing has any angle, and tells none."""
        return bool(np.abs(self.known_coefficients()).max() <= WIDEST)

    def columns(self, motion: Motion) -> Array:
        return np.stack([motion.on_tree.gravity_torque(d, laden=True) for d in _DIRECTIONS], axis=2)

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        by_q = sum(
            angle * motion.on_tree.gravity_derivative(d, laden=True)
            for angle, d in zip(self.known_coefficients(), _DIRECTIONS, strict=True)
        )
        zero = np.zeros_like(by_q)
        return np.asarray(by_q), zero, zero

    def potential(self, motion: Motion) -> Array:
        along = [motion.on_tree.gravity_potential(d, laden=True) for d in _DIRECTIONS]
        return np.stack(along, axis=1) @ self.known_coefficients()

    def element(self) -> GravityChange:
        return GravityChange(self.known_coefficients() @ _DIRECTIONS)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls()]
