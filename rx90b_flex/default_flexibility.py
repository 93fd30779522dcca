"""A bending robot from a URDF alone: stated values for what no URDF holds, and the hinges that `flexify` wrote.

They are no identification: a drive's links swing at `DRIVE_HZ` on its torsion, as those of the source's robot do (RX90B, joints 1 to
3: 21, 22 and 32 Hz by tables 4.1 and 6.6), in the pose where they are heaviest for it; bearings are as stiff as the drive.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from rx90b_flex import flexify as virtual
from rx90b_flex.effects import Effect
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import DAMPING_TIME, BaseFlexibility, DriveFlexibility, JointFlexibility
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.written_hinges import unflexify

DRIVE_HZ = 20.0  # of the links behind a drive on its torsion, the other drives held
DRIVE_SHARE = 0.15  # drive's inertia over that of the links; RX90B, joints 1 to 3: 0.18, 0.09, 0.3
POSES = 64  # drawn within the joints' limits, or +-pi
LIGHTEST = 1e-6  # of the heaviest joint's inertia


def with_default_flexibility(
    robot: Robot, torsion: tuple[str, ...] | None = None, bending: tuple[str, ...] | None = None, base: bool = False
) -> Robot:
    """The robot with drives that twist and joints that bend, by stated default values; what it declares itself stays.

    Parameters
    ----------
    robot : Robot
    torsion, bending : tuple of str, optional
        Joints; all where not given.
    base : bool
        Whether the base tilts, as stiff as the first joint.
    """
    inertia = dict(zip(robot.joints, heaviest(robot), strict=True))
    stiffness = {joint: (2.0 * np.pi * DRIVE_HZ) ** 2 * m for joint, m in inertia.items()}
    declared = {(e.type_name(), e.place) for e in robot.effects}
    added: list[Effect] = []
    for joint in robot.joints:
        k, d = stiffness[joint], DAMPING_TIME * stiffness[joint]
        if torsion is None or joint in torsion:
            added.append(DriveInertia(joint=joint, inertia=DRIVE_SHARE * inertia[joint]))
            added.append(DriveFlexibility(joint=joint, stiffness=k, damping=d))
        if bending is None or joint in bending:
            added.append(JointFlexibility(joint=joint, stiffness=(k, k), damping=(d, d)))
    if base:
        k = stiffness[robot.joints[0]]
        added.append(BaseFlexibility(stiffness=(k, k), damping=(DAMPING_TIME * k,) * 2))
    new = [e for e in added if (e.type_name(), e.place) not in declared]
    return robot.with_effects([*robot.effects, *new])


def heaviest(robot: Robot) -> Array:
    """Largest inertia (kg m^2; kg where it slides) that the links have for each drive, over drawn poses; shape (joints,)."""
    rigid = robot.with_effects([])
    lower, upper = (np.clip(x, -np.pi, np.pi) for x in (rigid.tree.lowerPositionLimit, rigid.tree.upperPositionLimit))
    poses = np.random.default_rng(0).uniform(lower, np.maximum(upper, lower), (POSES, len(lower)))
    found = np.max([np.diag(rigid.mass_matrix(q)) for q in poses], axis=0)
    return np.maximum(found, LIGHTEST * found.max())


def without_written_hinges(robot: Robot) -> tuple[Robot, tuple[str, ...], tuple[str, ...], bool]:
    """A robot whose URDF `rx90b-flex flexify` wrote, its hinges taken out again; others as they are.

    Returns
    -------
    robot : Robot
    torsion, bending : tuple of str
        Joints that had hinges.
    base : bool
        Whether the base had.
    """
    urdf, torsion, bending, base = unflexify(virtual.read_xml(robot.urdf))
    if not (torsion or bending or base):
        return robot, (), (), False
    return dataclasses.replace(robot, urdf=virtual.to_xml(urdf)), torsion, bending, base


def default_words(robot: Robot, before: Robot) -> list[str]:
    """The default values that a robot got, a line a joint."""
    lines = []
    new = [e for e in robot.effects if e not in before.effects]
    if new:
        lines.append(
            f"Stated, not identified: links swing at {DRIVE_HZ:g} Hz on each drive where they are heaviest for it, bearings are as "
            f"stiff, drives have {100 * DRIVE_SHARE:g} % of the links' inertia"
        )
    for place in dict.fromkeys(e.joints for e in new):
        values = "; ".join(
            f"{e.type_name().replace('_', ' ')} {value:.3g} {unit}"
            for e in new
            for _, unit, value in robot.values_of(e)[:1]
            if e.joints == place
        )
        lines.append(f"{' '.join(place) or 'base'}: {values}")
    return lines
