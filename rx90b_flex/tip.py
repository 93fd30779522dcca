"""The frame that counts as a robot's tip: said, with what else it could be where it is a finger."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from rx90b_flex.default_tip import is_finger_frame, joint_of
from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot


def jacobian_at(model: pin.Model, data: pin.Data, q: Array, frame: int) -> Array:
    """A frame's velocity and rate of turning, base axes at its origin, by each coordinate; shape (6, n), also of one coordinate,
    where Pinocchio gives a vector.
    """
    return np.reshape(pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED), (6, model.nv))


def with_tip(robot: Robot, frame: str) -> Robot:
    """The robot with another frame as its tip.

    Raises
    ------
    ValueError
        No such frame.
    """
    frames = [f.name for f in robot.tree.frames]
    if frame not in frames:
        raise ValueError(f"unknown tip frame {frame!r} for robot {robot.name}; {close_match(frame, frames)}")
    return dataclasses.replace(robot, tip_frame=frame)


def is_finger(robot: Robot) -> bool:
    """Whether the tip frame is on a finger: its name or its joint's says so, another joint mimics that one, or links move beside it
    on the same hand.
    """
    return is_finger_frame(robot.tree, robot.tip_frame, {leader for _, leader in robot.followers})


def tip_words(robot: Robot, option: str = "--tip") -> str:
    """Which frame is the tip; where it is a finger, what else could be, and the command's option that says it, if there is one."""
    said = f"Tip frame: {robot.tip_frame}"
    if not is_finger(robot):
        return said
    tree = robot.tree
    joint = joint_of(tree, robot.tip_frame)
    hand = [f.name for f in tree.frames if f.type == pin.FrameType.BODY and f.parentJoint == tree.parents[joint]]
    says = f"{option} or a robot file's tip_frame" if option else "a robot file's tip_frame"
    return f"{said}, a finger; if another is meant, {says} says which: {', '.join(hand)}"
