"""Hinges that lie elsewhere on their links than declared."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.flexify import read_xml, to_xml
from rx90b_flex.robot import Robot


def with_hinges_moved(robot: Robot, offsets: Mapping[str, Array]) -> Robot:
    """The robot with the hinges of some joints, driving and flexible ones, elsewhere; at zero angles all links stay where they are.

    Parameters
    ----------
    robot : Robot
    offsets : mapping of joint to array, shape (3,)
        m, in the joint's frame at zero angle.

    Raises
    ------
    ValueError
        A joint that the robot does not have.
    """
    for name in offsets:
        if name not in robot.joints:
            raise ValueError(f"{robot.name} has no joint {name!r}; {close_match(name, robot.joints)}")
    urdf = read_xml(robot.urdf)
    links = {link.name: link for link in urdf.robot.links}
    for joint in (j for j in urdf.robot.joints if j.name in offsets):
        move = np.eye(4)
        move[:3, 3] = offsets[joint.name]
        back = np.linalg.inv(move)
        joint.origin = _origin(joint) @ move
        child = links[joint.child]
        for part in [x for x in (child.inertial, *child.visuals, *child.collisions) if x is not None]:
            part.origin = back @ _origin(part)
        for behind in (j for j in urdf.robot.joints if j.parent == joint.child):
            behind.origin = back @ _origin(behind)
    return dataclasses.replace(robot, urdf=to_xml(urdf))


def _origin(part: object) -> Array:
    origin = getattr(part, "origin", None)
    return np.eye(4) if origin is None else np.asarray(origin, dtype=float)
