"""A robot's links and joints as nested bodies, for formats that have no massless links between the hinges of one joint."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rx90b_flex.effects.motion import Array
from rx90b_flex.flexify import CONTINUOUS_LIMIT, UNLIMITED, coordinate_name, read_xml
from rx90b_flex.robot import Robot


@dataclass(frozen=True)
class Hinge:
    """One coordinate of a joint, or the joint of a link.

    Attributes
    ----------
    name : str
        Of the URDF's joint.
    coordinate : str
        As `Robot.coordinates` has it.
    slides : bool
    axis : array, shape (3,)
        In the frame of the joint.
    limits : (lower, upper) or None
        Of a driven joint that has some, rad or m.
    effort, speed : float or None
        Largest ones of a driven joint that states them.
    """

    name: str
    coordinate: str
    slides: bool
    axis: Array
    limits: tuple[float, float] | None
    effort: float | None
    speed: float | None


@dataclass(frozen=True)
class Node:
    """A link, the hinges by which it hangs on its parent, and what hangs on it.

    Attributes
    ----------
    link : str
    placement : array, shape (4, 4)
        In the parent link's frame, all hinges at zero.
    hinges : tuple of Hinge
        In their order; none for a link fixed to its parent.
    shapes : tuple
        yourdfpy's visuals, then collisions.
    children : tuple of Node
    """

    link: str
    placement: Array
    hinges: tuple[Hinge, ...]
    visuals: tuple[Any, ...]
    collisions: tuple[Any, ...]
    children: tuple[Node, ...]

    def walk(self) -> Iterator[Node]:
        """This node and all behind it, a parent before its children."""
        yield self
        for child in self.children:
            yield from child.walk()


def tree_of(robot: Robot) -> Node:
    """Links of a robot from its root, the hinges of one joint together."""
    urdf = read_xml(robot.flexible_urdf).robot
    links = {link.name: link for link in urdf.links}
    joints_of: dict[str, list[Any]] = {}
    for joint in urdf.joints:
        joints_of.setdefault(joint.parent, []).append(joint)
    moving = set(tuple(robot.model.names)[1:])
    carrying = {name for name, _ in robot.bodies}

    def between(link: str) -> bool:
        """Whether a link only joins two hinges of one joint."""
        behind = joints_of.get(link, [])
        if len(behind) != 1 or behind[0].name not in moving or link in carrying:
            return False
        place = coordinate_name(behind[0].name, robot.joints)
        return not place.endswith(":drive") and place != "base:bend_1"

    def node(link: str, joint: Any) -> Node:
        placement = np.eye(4) if joint is None or joint.origin is None else np.array(joint.origin)
        hinges: list[Hinge] = []
        while joint is not None and joint.name in moving:
            hinges.append(_hinge(robot, joint))
            if not between(link):
                break
            (joint,) = joints_of[link]
            link = joint.child
        children = tuple(node(j.child, j) for j in joints_of.get(link, []))
        found = links[link]
        return Node(link, placement, tuple(hinges), tuple(found.visuals), tuple(found.collisions), children)

    children = {joint.child for joint in urdf.joints}
    (root,) = (name for name in links if name not in children)
    return node(root, None)


def _hinge(robot: Robot, joint: Any) -> Hinge:
    coordinate = coordinate_name(joint.name, robot.joints)
    limits = effort = speed = None
    if coordinate.endswith(":drive") and joint.limit is not None:
        lower, upper = float(joint.limit.lower or 0.0), float(joint.limit.upper or 0.0)
        if upper - lower < 2 * CONTINUOUS_LIMIT and upper > lower:
            limits = (lower, upper)
        effort = _below(joint.limit.effort)
        speed = _below(joint.limit.velocity)
    axis = np.asarray(joint.axis, dtype=float)
    return Hinge(joint.name, coordinate, joint.type == "prismatic", axis, limits, effort, speed)


def _below(limit: float | None) -> float | None:
    return float(limit) if limit is not None and 0.0 < limit < UNLIMITED else None


def rotation_quaternion(rotation: Array) -> Array:
    """Quaternion (4,), scalar first and not negative, of a rotation (3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True))


def numbers(values: Any) -> str:
    """Numbers with as many digits as bring each double back."""
    return " ".join(repr(float(x) + 0.0) for x in np.atleast_1d(values))
