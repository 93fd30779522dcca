"""Gear losses that depend on load: with speed, and with the direction in which power flows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rx90b_flex.effects.effect import FRICTION, JointEffect, JointForce, linear
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.reversal import DryFriction, turnover_shape


def through_load(effect: JointEffect, motion: Motion, factor: Array) -> tuple[Array, Array, Array]:
    """Derivatives (N, n, n) by q, v and a of a torque on a joint that the load changes by `factor` (N,) a N m."""
    at = motion.joint(effect.joint)
    place = int(np.flatnonzero(at.port)[-1])
    by_q, by_v, by_a = (
        factor[:, None, None] * at.port[None, :, None] * by[:, place, None, :] for by in motion.on_tree.derivatives()
    )
    return by_q, by_v, by_a


@dataclass(frozen=True, kw_only=True)
class DriveEfficiency(DryFriction):
    """Gear friction ``|load| * sign(v)`` with one coefficient where power flows to the load and another where it flows back.

    ``motoring`` acts where load and velocity have one sign, ``backdriving`` where they differ. It stands in for `load_friction`,
    which has the same coefficient for both.

    Signature
    ---------
    A jump at reversal whose height follows the load, higher (or lower) when lifting than when lowering.

    Neighbours
    ----------
    `load_friction` loses alike both ways. `load_viscous_friction` grows with speed too. Needs lifting and lowering at several loads.

    Source
    ------
    Not in Hardeman 2008; P. Hamon, M. Gautier, P. Garrec, *Dynamic identification of robots with a dry friction model depending on
    load and velocity*, IROS 2010: friction that depends on the load and on the direction of power flow.
    """

    needs_load: ClassVar[bool] = True
    replaces: ClassVar[tuple[str, ...]] = ("load_friction",)

    motoring: float | None = linear("-", lower=0.0, rank=FRICTION)
    backdriving: float | None = linear("-", lower=0.0, rank=FRICTION)
    turnover: float | None = turnover_shape()

    def _loads(self, at: JointMotion) -> Array:
        """Size of the load where power flows to it and where it flows back, (N, 2), N m."""
        size, forth = np.abs(at.load), at.load * at.v > 0
        return np.stack([np.where(forth, size, 0.0), np.where(forth, 0.0, size)], axis=1)

    def basis(self, at: JointMotion) -> Array:
        return self._loads(at) * self.direction(at.v)[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        slope = self._loads(at) * self.direction_slope(at.v)[:, None]
        return np.zeros_like(slope), slope, np.zeros_like(slope)

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        at = motion.joint(self.joint)
        motoring, backdriving = self.known_coefficients()
        coefficient = np.where(at.load * at.v > 0, motoring, backdriving)
        own = super().derivatives(motion)
        load = through_load(self, motion, coefficient * self.direction(at.v) * np.sign(at.load))
        return own[0] + load[0], own[1] + load[1], own[2] + load[2]


@dataclass(frozen=True, kw_only=True)
class LoadViscousFriction(JointForce):
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

    needs_load: ClassVar[bool] = True

    coefficient: float | None = linear("s/rad", lower=0.0, rank=FRICTION)

    def basis(self, at: JointMotion) -> Array:
        return (np.abs(at.load) * at.v)[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        slope = np.abs(at.load)[:, None]
        return np.zeros_like(slope), slope, np.zeros_like(slope)

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        at = motion.joint(self.joint)
        own = super().derivatives(motion)
        load = through_load(self, motion, self.known_coefficients()[0] * at.v * np.sign(at.load))
        return own[0] + load[0], own[1] + load[1], own[2] + load[2]
