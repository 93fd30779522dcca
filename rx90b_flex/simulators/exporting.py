"""A robot into a simulator's file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rx90b_flex.effects import close_match
from rx90b_flex.flexify import read_xml
from rx90b_flex.robot import LINK_PARAMETERS, Robot, load_robot
from rx90b_flex.signals.single import check_file, write_file
from rx90b_flex.simulators.held import Lost, held_by
from rx90b_flex.simulators.mjcf import MJCF, mjcf_text
from rx90b_flex.simulators.sdf import SDF, sdf_text
from rx90b_flex.simulators.urdf import URDF, urdf_text

FORMATS = {"urdf": (URDF, urdf_text), "mjcf": (MJCF, mjcf_text), "sdf": (SDF, sdf_text)}
FormatName = Literal["urdf", "mjcf", "sdf"]


@dataclass(frozen=True)
class Exported:
    """What `export_robot` wrote.

    Attributes
    ----------
    path : Path
    format : str
    lost : tuple of Lost
        What is not held, or not as it is; one entry an effect, link or joint that followed another. As text: one line each.
    """

    path: Path
    format: str
    lost: tuple[Lost, ...]


def lost_followers(robot: Robot) -> tuple[Lost, ...]:
    """Joints that follow another in the URDF that was read, and no more in any file that is written."""
    return tuple(
        Lost(joint, f"follows {leader} where it is from; here it is fixed") for joint, leader in robot.followers
    )


def lost_masses(robot: Robot) -> tuple[Lost, ...]:
    """Where no moving link, or none from a joint on, has a mass: a file of such links can be looked at, not moved."""
    if not robot.link_parameters[:: len(LINK_PARAMETERS)].any():
        return (Lost(robot.name, "no moving link has a mass in its URDF: a simulator cannot move it"),)
    tree, moved = robot.tree, {j for e in robot.effects if e.traits.adds_inertia for j in e.joints}
    behind = [inertia.mass for inertia in tree.inertias]
    for i in range(tree.njoints - 1, 0, -1):
        behind[tree.parents[i]] += behind[i]
    light = [str(name) for name, mass in zip(tree.names, behind, strict=True) if mass == 0.0 and name in robot.joints]
    why = "no link behind it has a mass in its URDF: a simulator cannot move it"
    return tuple(Lost(joint, why) for joint in light if joint not in moved)


def lost_dynamics(robot: Robot) -> tuple[Lost, ...]:
    """Damping and friction that the URDF states of joints for which the robot has none: a robot's own are its effects."""
    rubbing = {j for e in robot.effects if e.traits.is_friction for j in e.joints}
    stated = ((j, j.dynamics) for j in read_xml(robot.urdf).robot.joints if j.dynamics and j.name in robot.joints)
    why = "its URDF's damping of {:g} and friction of {:g} are no effects of this robot: declare viscous_friction, coulomb_friction"
    each = ((j.name, float(d.damping or 0.0), float(d.friction or 0.0)) for j, d in stated if j.name not in rubbing)
    return tuple(Lost(name, why.format(d, f)) for name, d, f in each if d or f)


def export_robot(robot: Robot | str | os.PathLike[str], path: str | os.PathLike[str], format: FormatName) -> Exported:
    """Write a robot for a simulator, with what its format holds.

    Loaded back, mass matrix and gravity are the robot's own, less what `Exported.lost` names.

    Parameters
    ----------
    robot : Robot, or what `load_robot` takes
    path : path
        File to write; it is replaced as a whole or not at all.
    format : ``urdf``, ``mjcf`` or ``sdf``

    Raises
    ------
    ValueError
        An unknown format; an effect without a value; a link that no body is; a path that cannot be written, or that is
        the robot's own.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> exported = rf.export_robot("rx90b_rigid", "rx90b.urdf", "urdf")
    >>> print(exported.lost[0])
    joint_1.drive_inertia: a URDF has no inertia of a rotor behind its gear
    """
    if format not in FORMATS:
        raise ValueError(f"format is {format!r}; {close_match(str(format), list(FORMATS))}")
    path = Path(path)
    check_file(path, None if isinstance(robot, Robot) else robot)
    robot = load_robot(robot)
    how, text_of = FORMATS[format]
    held = held_by(robot, how)
    text, more = text_of(held)
    write_file(path, text)
    lost = (*lost_masses(robot), *lost_followers(robot), *lost_dynamics(robot), *held.lost, *more)
    return Exported(path, format, lost)
