"""Equations of motion in drive and joint angles, q' = (e, theta, eps2, eps3), instead of drive angles and torsions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.linearize import Linearization, joint_angle_transform
from rx90b_flex.robot import Robot


@dataclass(frozen=True, eq=False)
class JointAngleDynamics:
    """A robot's dynamics in q'. Drive and link meet in stiffness and damping, not in the mass matrix (3.79).

    Attributes
    ----------
    robot : Robot
    """

    robot: Robot

    @cached_property
    def transform(self) -> Array:
        """T of ``q = T q'``, shape (n, n); rates and accelerations alike."""
        return joint_angle_transform(self.robot.coordinates)[0]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of q'."""
        return joint_angle_transform(self.robot.coordinates)[1]

    def from_torsions(self, q: Array) -> Array:
        """q' of coordinates (or rates, or accelerations) q, shape (n,) or (N, n)."""
        # T is 1 plus terms whose square is zero, so this is its inverse
        return np.asarray(q) @ (2.0 * np.eye(len(self.transform)) - self.transform).T

    def to_torsions(self, q: Array) -> Array:
        """q of coordinates (or rates, or accelerations) q', shape (n,) or (N, n)."""
        return np.asarray(q) @ self.transform.T

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrix at q', shape (n, n): drive inertia alone in the drives' rows of flexible joints (3.79)."""
        return self.transform.T @ self.robot.mass_matrix(self.to_torsions(q)) @ self.transform

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Generalised forces dual to q' (equation 3.75), shape (n,) or (N, n)."""
        return self.robot.inverse_dynamics(*(self.to_torsions(x) for x in (q, v, a))) @ self.transform

    def forward_dynamics(self, q: Array, v: Array, drive_torque: Array) -> Array:
        """Accelerations of q' under drive torques (joints,), shape (n,), rad/s^2."""
        a = self.robot.forward_dynamics(self.to_torsions(q), self.to_torsions(v), drive_torque)
        return self.from_torsions(a)

    def linearize(self, q: Array, v: Array | None = None, a: Array | None = None) -> Linearization:
        """`Robot.linearize` at q', in q'."""
        point = (None if x is None else self.to_torsions(x) for x in (v, a))
        return self.robot.linearize(self.to_torsions(q), *point).in_joint_angles()
