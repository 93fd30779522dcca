"""What every drive has and a bare URDF does not say: inertia, dry and viscous friction, an offset."""

from __future__ import annotations

import os
from collections.abc import Sequence

from rx90b_flex.diagnose.faults.sample import BASICS
from rx90b_flex.effects import Effect, catalogue
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Campaign

BEHIND_GEARS = ("torque_offset",)  # what sensors there see of a drive: their own offset


def with_basics(robot: Robot, joints: Sequence[str] | None = None, behind_gears: bool = False) -> Robot:
    """The robot with drive inertia, Coulomb and viscous friction and an offset declared on joints that lack them.

    Their values are left open, to be identified.

    Parameters
    ----------
    robot : Robot
    joints : sequence of str, optional
        All of the robot's, where not given.
    behind_gears : bool
        Whether torques are measured there, so that neither friction nor rotor inertia is in them.
    """
    known = catalogue()
    added: list[Effect] = []
    for joint in robot.joints if joints is None else joints:
        here = [e for e in robot.effects if e.joints == (joint,)]
        have = {e.type_name() for e in here} | {name for e in here for name in e.traits.replaces}
        added += [known[name](joint=joint) for name in (BEHIND_GEARS if behind_gears else BASICS) if name not in have]  # type: ignore[call-arg]
    return robot.with_effects([*robot.effects, *added])


def declared_robot(campaign: Campaign, basics: bool, robot: Robot | str | os.PathLike[str] | None = None) -> Robot:
    """The campaign's robot, or another one; with `basics`, what every drive has is declared on all of the campaign's joints."""
    declared = load_robot(campaign.robot_source if robot is None else robot)
    if not basics:
        return declared
    joints = [j for j in campaign.joints if j in declared.joints]
    return with_basics(declared, joints, campaign.torque_side == "behind_gear")
