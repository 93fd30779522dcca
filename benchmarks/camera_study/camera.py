"""A camera that sees markers on the links: positions in its own frame, with the noise of table C.2 (appendix C)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.camera import link_poses
from rx90b_flex.robot import Robot

ZONES_M = (2.0, 3.0, 4.0, 5.0, 6.0)
XY_STD = (0.007e-3, 0.010e-3, 0.022e-3, 0.032e-3)  # table C.2, m
Z_STD = (0.033e-3, 0.050e-3, 0.110e-3, 0.161e-3)
VALIDATED_FACTOR = 2.5  # the real camera did at least this much worse
RESOLUTION = 2.0e-6  # m
WAVES = 200  # that make up a slowly varying error: enough for it to be normal


@dataclass(frozen=True)
class CameraNoise:
    """Errors of a marker's position in the camera's frame, z along the optical axis.

    Attributes
    ----------
    xy_std, z_std : tuple of float, m
        One for each zone of distance along z, table C.2.
    zones : tuple of float, m
        The zones' borders, one more than zones.
    factor : float
        On both; 1 is table C.2, 2.5 what a validation found.
    correlation_length : float, m
        0: every reading has its own error, which averaging takes away. Otherwise the error is a fixed function of the
        position, smooth over this length: a calibration's error, which no averaging takes away.
    resolution : float, m
        Readings are rounded to it.
    """

    xy_std: tuple[float, ...] = XY_STD
    z_std: tuple[float, ...] = Z_STD
    zones: tuple[float, ...] = ZONES_M
    factor: float = 1.0
    correlation_length: float = 0.0
    resolution: float = RESOLUTION

    def times(self, factor: float) -> CameraNoise:
        """The same camera, that many times as noisy."""
        return replace(self, factor=self.factor * factor)

    def std(self, points: Array) -> Array:
        """Standard deviations of x, y and z for points in the camera's frame, shape (..., 3), m.

        Raises
        ------
        ValueError
            A point outside the zones.
        """
        depth = np.asarray(points, dtype=float)[..., 2]
        if depth.size and not (depth.min() >= self.zones[0] and depth.max() <= self.zones[-1]):
            raise ValueError(
                f"markers are {depth.min():.2f} to {depth.max():.2f} m from the camera;"
                f" expected {self.zones[0]:g} to {self.zones[-1]:g} m"
            )
        zone = np.clip(np.searchsorted(self.zones, depth, side="right") - 1, 0, len(self.xy_std) - 1)
        xy, z = self.factor * np.asarray(self.xy_std)[zone], self.factor * np.asarray(self.z_std)[zone]
        return np.stack([xy, xy, z], axis=-1)

    def read(self, points: Array, rng: np.random.Generator) -> Array:
        """What the camera tells of points in its frame, shape (..., 3), m."""
        points = np.asarray(points, dtype=float)
        if self.correlation_length == 0.0:
            error = rng.standard_normal(points.shape)
        else:
            # random waves: a normal field whose correlation falls as exp(-distance^2 / (2 length^2))
            waves = rng.standard_normal((3, WAVES, 3)) / self.correlation_length
            phase = rng.uniform(0.0, 2.0 * np.pi, (3, WAVES))
            swing = np.cos(np.einsum("...i,cwi->...cw", points, waves) + phase)
            error = np.sqrt(2.0 / WAVES) * swing.sum(axis=-1)
        seen = points + self.std(points) * error
        return seen if self.resolution == 0.0 else self.resolution * np.round(seen / self.resolution)


@dataclass(frozen=True, eq=False)
class Camera:
    """Where a camera stands.

    Attributes
    ----------
    rotation : array, shape (3, 3)
        Columns are its axes in the world, the third the optical axis.
    position : array, shape (3,), m
    noise : CameraNoise
    """

    rotation: Array
    position: Array
    noise: CameraNoise

    @classmethod
    def looking(cls, position: Sequence[float], at: Sequence[float], noise: CameraNoise | None = None) -> Camera:
        """A camera that looks from one point at another, its y pointing down."""
        start, end = np.asarray(position, dtype=float), np.asarray(at, dtype=float)
        z = (end - start) / np.linalg.norm(end - start)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x = x / np.linalg.norm(x)
        return cls(np.stack([x, np.cross(z, x), z], axis=1), start, CameraNoise() if noise is None else noise)

    def see(self, points: Array) -> Array:
        """Points of the world in the camera's frame, without noise, shape (..., 3), m."""
        return (np.asarray(points) - self.position) @ self.rotation

    def read(self, points: Array, rng: np.random.Generator) -> Array:
        """Points of the world as the camera tells them in its frame, shape (..., 3), m."""
        return self.noise.read(self.see(points), rng)


def marker_positions(robot: Robot, q: Array, markers: Mapping[str, Array]) -> dict[str, Array]:
    """Positions in the world of markers given in their links' frames, link -> (m, 3) to link -> (N, m, 3), m."""
    poses = link_poses(robot, q, list(markers))
    return {
        link: np.einsum("nij,mj->nmi", rotation, np.asarray(markers[link])) + position[:, None]
        for link, (rotation, position) in poses.items()
    }


@dataclass(frozen=True, eq=False)
class CarriedMotion:
    """A motion of the drives with the deformations that weight, inertia and friction ask for at every instant.

    Attributes
    ----------
    q : array, shape (N, n)
    moment : array, shape (N, n), N m
        What the rigid robot's motion loads each coordinate with: what an analyst knows who knows the links.
    """

    q: Array
    moment: Array


def carried_motion(robot: Robot, position: Array, velocity: Array, acceleration: Array) -> CarriedMotion:
    """The flexible robot along a motion of its drives, its hinges in balance, without vibration.

    The slow part of the deformation, on which the fit of the thesis' section 4.2.3 breaks; vibration comes on top.

    Parameters
    ----------
    position, velocity, acceleration : array, shape (N, joints)
    """
    drives = np.asarray(position) @ robot.input_matrix.T
    v, a = (np.asarray(x) @ robot.input_matrix.T for x in (velocity, acceleration))
    free = np.flatnonzero(robot.input_matrix.sum(axis=1) == 0.0)
    stiffness = robot.linearize(np.zeros(robot.model.nv)).K[np.ix_(free, free)]
    moment = -robot.inverse_dynamics(drives, v, a)
    moment[:, robot.input_matrix.any(axis=1)] *= -1.0  # the drives' rows: torque that the drives give
    q = drives.copy()
    for _ in range(50):
        step = np.linalg.solve(stiffness, robot.inverse_dynamics(q, v, a)[:, free].T).T
        q[:, free] -= step
        if np.abs(step).max(initial=0.0) < 1e-12:
            return CarriedMotion(q, moment)
    raise ValueError(f"{robot.name}: the hinges find no balance along the motion")
