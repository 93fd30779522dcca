"""What a motion must keep to: angles, speeds, torques, and distance of the robot to itself and to the floor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.cs8 import CS8

RADIUS = 0.1  # m, of the capsules; choice: covers forearm and upper arm of the RX90B
CLEARANCE = 0.02  # m, choice
# Choice: part of speed and torque limits that a design may use; noise, vibration and tracking need the rest.
USED = 0.95
FLOOR_SIZE = 20.0  # m
PROBES = 300  # random poses that tell which shapes always overlap


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a robot, joint side.

    Attributes
    ----------
    joints : tuple of str
    lower, upper : array, shape (joints,), rad
    velocity : array, shape (joints,), rad/s
    torque : array, shape (joints,), N m
    feedforward : array, shape (joints,), N m
        Largest feed-forward torque; that of `torque` unless the user asks for less.
    geometry : pinocchio.GeometryModel
        Shapes of the rigid tree and the pairs that must stay apart: `capsules`, or one's own.
    clearance : float, m
        Smallest distance of such a pair.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    torque: Array
    feedforward: Array
    geometry: pin.GeometryModel
    clearance: float

    @staticmethod
    def of(
        robot: Robot,
        controller: CS8 | None = None,
        *,
        used: float = USED,
        clearance: float = CLEARANCE,
        radius: float = RADIUS,
        floor: float | None = 0.0,
        feedforward: float | Array | None = None,
    ) -> Limits:
        """Limits of a robot: angles and speeds of its URDF, torques of its controller (of its URDF without one).

        Parameters
        ----------
        used : float
            Part of the speed and torque limits that may be used, 0 to 1.
        clearance, radius, floor : float, m
            See `capsules`.
        feedforward : float or array, shape (joints,), N m
            Largest feed-forward torque, where less than the torque limit.
        """
        if not 0.0 < used <= 1.0:
            raise ValueError(f"used is {used:g}; expected more than 0, up to 1")
        tree = robot.tree
        torque = np.array(tree.upperEffortLimit, dtype=float)
        if controller is not None:
            torque = np.minimum(torque, controller.for_joints(robot.joints).column("torque_limit"))
        torque = used * torque
        return Limits(
            robot.joints,
            np.array(tree.lowerPositionLimit, dtype=float),
            np.array(tree.upperPositionLimit, dtype=float),
            used * np.array(tree.upperVelocityLimit, dtype=float),
            torque,
            torque if feedforward is None else np.minimum(torque, np.broadcast_to(feedforward, torque.shape)),
            capsules(robot, radius, floor, clearance),
            clearance,
        )

    def excess(
        self, position: Array, velocity: Array, torque: Array, distance: Array, feedforward: Array | None = None
    ) -> Array:
        """How far samples are outside, each limit by its own size, positive outside; one row a sample."""
        middle, half = 0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)
        given = [] if feedforward is None else [np.abs(feedforward) / self.feedforward - 1.0]
        return np.concatenate(
            [
                (np.abs(position - middle) - half) / half,
                np.abs(velocity) / self.velocity - 1.0,
                np.abs(torque) / self.torque - 1.0,
                (self.clearance - distance) / RADIUS,
                *given,
            ],
            axis=1,
        )

    def slope(
        self, position: Array, velocity: Array, torque: Array, distance: Array, feedforward: Array, by_excess: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Change of a number by position, velocity, torque, distance and feed-forward, from its change by `excess`."""
        n = len(self.joints)
        middle, half = 0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)
        return (
            by_excess[:, :n] * np.sign(position - middle) / half,
            by_excess[:, n : 2 * n] * np.sign(velocity) / self.velocity,
            by_excess[:, 2 * n : 3 * n] * np.sign(torque) / self.torque,
            -by_excess[:, 3 * n : -n] / RADIUS,
            by_excess[:, -n:] * np.sign(feedforward) / self.feedforward,
        )

    def distances(self, tree: pin.Model, position: Array) -> Array:
        """Distance of every pair of shapes, negative where they overlap; shape (N, pairs), m."""
        data, shapes = tree.createData(), self.geometry.createData()
        out = np.empty((len(position), len(self.geometry.collisionPairs)))
        for k, q in enumerate(position):
            pin.computeDistances(tree, data, self.geometry, shapes, q)
            out[k] = [result.min_distance for result in shapes.distanceResults]
        return out

    def margins(self, tree: pin.Model, position: Array, velocity: Array, torque: Array) -> Margins:
        """What is left to each limit along a motion, each of (N, joints)."""
        distance = self.distances(tree, position)
        return Margins(
            np.minimum(position - self.lower, self.upper - position).min(axis=0),
            self.velocity - np.abs(velocity).max(axis=0),
            self.torque - np.abs(torque).max(axis=0),
            float(distance.min(initial=np.inf)) - self.clearance,
        )


@dataclass(frozen=True, eq=False)
class Margins:
    """Smallest distance to each limit along a motion, negative outside.

    Attributes
    ----------
    position, velocity, torque : array, shape (joints,)
        rad, rad/s, N m.
    clearance : float, m
    """

    position: Array
    velocity: Array
    torque: Array
    clearance: float

    @property
    def kept(self) -> bool:
        """Whether no limit is passed."""
        return self.clearance >= 0.0 and all(x.min() >= 0.0 for x in (self.position, self.velocity, self.torque))

    def __str__(self) -> str:
        def listed(x: Array) -> str:
            return ", ".join(f"{value:.3g}" for value in x)

        return (
            f"left to the limits: position {listed(self.position)} rad; velocity {listed(self.velocity)} rad/s; "
            f"torque {listed(self.torque)} N m; clearance {self.clearance:.3g} m"
        )


def capsules(
    robot: Robot, radius: float = RADIUS, floor: float | None = 0.0, clearance: float = CLEARANCE
) -> pin.GeometryModel:
    """Shapes of a robot for self-collision: one capsule from each joint to every joint behind it, and to the tip.

    Not the URDF's collision shapes: few URDFs have them without meshes, and the RX90B's has none. Two bodies on one
    joint touch by design (floor and base count as one body), as do two that are nearer than the clearance in most of
    `PROBES` random poses within the limits (the two arms at an elbow without length); what keeps them apart is the
    joints' limits. All other pairs are watched.

    Parameters
    ----------
    radius : float, m
    floor : float, m, or None
        Height of the floor in the base frame; None: there is none.
    """
    tree = robot.tree
    geometry = pin.GeometryModel()
    for joint, name, start, end in _bones(tree, robot.tip_frame):
        along = end - start
        length = float(np.linalg.norm(along))
        shape = coal.Capsule(radius, length) if length > 1e-6 else coal.Sphere(radius)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along / length) if length > 1e-6 else None
        rotation = np.eye(3) if turn is None else turn.toRotationMatrix()
        place = pin.SE3(rotation, 0.5 * (start + end))
        geometry.addGeometryObject(pin.GeometryObject(f"{name}_{geometry.ngeoms}", joint, 0, place, shape))
    if floor is not None:
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, floor - 0.5]))
        box = coal.Box(FLOOR_SIZE, FLOOR_SIZE, 1.0)
        geometry.addGeometryObject(pin.GeometryObject("floor", 0, 0, place, box))
    shapes = geometry.geometryObjects
    for j, second in enumerate(shapes):
        for i, first in enumerate(shapes[:j]):
            a, b = first.parentJoint, second.parentJoint
            if a != b and tree.parents[b] != a and tree.parents[a] != b:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    _leave_out_neighbours(robot, geometry, clearance)
    return geometry


def _bones(tree: pin.Model, tip_frame: str) -> Iterator[tuple[int, str, Array, Array]]:
    """Joint, name, and both ends in the joint's frame of each straight piece of the robot."""
    tip = tree.frames[tree.getFrameId(tip_frame)]
    for joint in range(tree.njoints):
        ends = [
            tree.jointPlacements[child].translation for child in range(1, tree.njoints) if tree.parents[child] == joint
        ]
        if tip.parentJoint == joint:
            ends.append(tip.placement.translation)
        for end in ends:
            yield joint, tree.names[joint], np.zeros(3), np.array(end)


def _leave_out_neighbours(robot: Robot, geometry: pin.GeometryModel, clearance: float) -> None:
    tree = robot.tree
    lower, upper = (np.clip(x, -np.pi, np.pi) for x in (tree.lowerPositionLimit, tree.upperPositionLimit))
    poses = np.random.default_rng(0).uniform(lower, upper, (PROBES, tree.nv))
    nothing = np.zeros(0)
    unbounded = Limits(robot.joints, nothing, nothing, nothing, nothing, nothing, geometry, 0.0)
    touching = (unbounded.distances(tree, poses) <= clearance).mean(axis=0) > 0.5
    names = [shape.name for shape in geometry.geometryObjects]
    # own copies: removal shifts the list
    pairs = [pin.CollisionPair(p.first, p.second) for p in geometry.collisionPairs]
    for pair in [p for p, out in zip(pairs, touching, strict=True) if out and names[p.second] != "floor"]:
        geometry.removeCollisionPair(pair)
