"""The frame that counts as a robot's tip where nobody says which: the last link, but a tool's frame before a finger."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import pinocchio as pin

FINGER_WORDS = ("finger", "thumb", "knuckle", "jaw")  # in names of links and joints
# of frames where a tool is mounted or works, the best first; words of their names
_TOOLS = (
    {"tcp"},
    {"tool", "tool0"},
    {"ee", "eef", "effector"},
    {"flange"},
)


def default_tip(tree: pin.Model, leaders: Collection[str] = ()) -> str:
    """The last body frame of the longest chain of joints; where that is a finger's, a frame before it that is named like a tool's.

    Parameters
    ----------
    tree : of the rigid robot.
    leaders : joints that others mimic in the robot's URDF.
    """
    bodies = [f for f in tree.frames if f.type == pin.FrameType.BODY]
    tip = max(reversed(bodies), key=lambda f: len(_before(tree, f.parentJoint)))
    finger = _slides(tree, tip.parentJoint) or is_finger_frame(tree, tip.name, leaders)
    if not finger or _rank_of_tool(tip.name) is not None:  # a tool behind a slide, as a SCARA's, is no finger
        return str(tip.name)
    before = _before(tree, tip.parentJoint)
    tools = [(f, rank) for f in bodies if f.parentJoint in before and (rank := _rank_of_tool(f.name)) is not None]
    if not tools:
        return str(tip.name)
    return str(max(tools, key=lambda found: (before.index(found[0].parentJoint), -found[1]))[0].name)


def is_finger_frame(tree: pin.Model, frame: str, leaders: Collection[str] = ()) -> bool:
    """Whether a frame is on a finger: its name or its joint's says so, another joint mimics that one, or links move beside it."""
    joint = joint_of(tree, frame)
    names = (frame, tree.names[joint]) if joint else (frame,)
    worded = any(word in name.lower() for word in FINGER_WORDS for name in names)
    return worded or tree.names[joint] in leaders or bool(fingers_with(tree, joint))


def joint_of(tree: pin.Model, frame: str) -> int:
    """The joint that moves a frame, the link's where a joint has the same name; 0: none does."""
    named = [f for f in tree.frames if f.name == frame]
    return int(min(named, key=lambda f: f.type != pin.FrameType.BODY).parentJoint)


def fingers_with(tree: pin.Model, joint: int) -> Sequence[int]:
    """Joints that move the last links beside each other on one link, with `joint` among them; empty where that moves no finger."""
    parent = tree.parents[joint]
    beside = [j for j in range(1, tree.njoints) if tree.parents[j] == parent and not any(p == j for p in tree.parents)]
    return () if joint == 0 or parent == 0 or len(beside) < 2 or joint not in beside else beside


def _before(tree: pin.Model, joint: int) -> list[int]:
    """Joints that carry one, from the base on; without it."""
    before: list[int] = []
    while joint and (joint := int(tree.parents[joint])):
        before.insert(0, joint)
    return before


def _slides(tree: pin.Model, joint: int) -> bool:
    return joint > 0 and "JointModelP" in tree.joints[joint].shortname()


def _rank_of_tool(name: str) -> int | None:
    """Place of a frame's name among those of tools; None: it is none's."""
    words = set(re.findall(r"[a-z]+\d*", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()))
    return next((rank for rank, tools in enumerate(_TOOLS) if words & tools), None)
