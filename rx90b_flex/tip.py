"""The frame that counts as a robot's tip: said, and asked for where it is a finger."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

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


_FINGERS = ("finger", "thumb", "knuckle", "jaw")  # in names of links


def is_finger(robot: Robot) -> bool:
    """Whether the tip frame is on a finger: its name says so, or links move beside it on the same hand."""
    return any(word in robot.tip_frame.lower() for word in _FINGERS) or bool(fingers(robot))


def fingers(robot: Robot) -> tuple[str, ...]:
    """Links that move beside each other on the link before the tip's joint, the tip's first; empty where it is no finger."""
    tree = robot.tree
    joint = tree.frames[tree.getFrameId(robot.tip_frame)].parentJoint
    if joint == 0:
        return ()
    parent = tree.parents[joint]
    beside = [j for j in range(1, tree.njoints) if tree.parents[j] == parent and not any(p == j for p in tree.parents)]
    if parent == 0 or len(beside) < 2 or joint not in beside:
        return ()
    links = {f.parentJoint: f.name for f in reversed(list(tree.frames)) if f.type == pin.FrameType.BODY}
    return tuple(links[j] for j in sorted(beside, key=lambda j: j != joint))


def tip_words(robot: Robot) -> str:
    """Which frame is the tip; where it is a finger, what else could be."""
    said = f"Tip frame: {robot.tip_frame}"
    if not is_finger(robot):
        return said
    tree = robot.tree
    joint = tree.frames[tree.getFrameId(robot.tip_frame)].parentJoint
    hand = [f.name for f in tree.frames if f.type == pin.FrameType.BODY and f.parentJoint == tree.parents[joint]]
    return f"{said}, a finger; if another is meant, --tip or a robot file's tip_frame says which: {', '.join(hand)}"
