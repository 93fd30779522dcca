"""What every drive has and a bare URDF does not say: inertia, dry and viscous friction, an offset."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.diagnose.faults.sample import BASICS
from rx90b_flex.effects import Effect, catalogue
from rx90b_flex.robot import Robot


def with_basics(robot: Robot, joints: Sequence[str] | None = None) -> Robot:
    """The robot with drive inertia, Coulomb and viscous friction and an offset declared on joints that lack them.

    Their values are left open, to be identified.

    Parameters
    ----------
    robot : Robot
    joints : sequence of str, optional
        All of the robot's, where not given.
    """
    known = catalogue()
    added: list[Effect] = []
    for joint in robot.joints if joints is None else joints:
        here = [e for e in robot.effects if e.joints == (joint,)]
        have = {e.type_name() for e in here} | {name for e in here for name in e.replaces}
        added += [known[name](joint=joint) for name in BASICS if name not in have]  # type: ignore[call-arg]
    return robot.with_effects([*robot.effects, *added])
