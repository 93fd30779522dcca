"""The inverse of `rx90b_flex.flexify.flexify`: a URDF with written hinges becomes the rigid one again."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

from rx90b_flex.flexify import BASE_JOINTS, GROUND_LINK, read_xml, to_xml, virtual_joint_names, with_robot

if TYPE_CHECKING:
    import yourdfpy  # type: ignore[import-untyped, unused-ignore]


def unflexify(urdf: yourdfpy.URDF) -> tuple[yourdfpy.URDF, tuple[str, ...], tuple[str, ...], bool]:
    """Copy without the virtual joints of `rx90b_flex.flexify.flexify`, and where they were.

    Returns
    -------
    urdf
        Rigid tree; the same where there are none.
    torsion, bending : tuple of str
        Driving joints that twisted, and that bent.
    base : bool
        Whether the base tilted.
    """
    robot = copy.deepcopy(urdf.robot)
    by_parent = {joint.parent: joint for joint in robot.joints}
    base = [joint.name for joint in robot.joints if joint.parent == GROUND_LINK] == [BASE_JOINTS[0]]
    found: dict[str, tuple[str, ...]] = {}
    links: set[str] = set()
    for joint in robot.joints:
        last = joint
        names: list[str] = []
        while (behind := by_parent.get(last.child)) is not None and behind.name in virtual_joint_names(joint.name):
            links.add(last.child)
            last = behind
            names.append(last.name)
        if names:
            joint.child = last.child
            found[joint.name] = tuple(names)
    gone = {name for names in found.values() for name in names} | (set(BASE_JOINTS) if base else set())
    links |= {GROUND_LINK, f"{BASE_JOINTS[0]}_link"} if base else set()
    robot.joints = [joint for joint in robot.joints if joint.name not in gone]
    robot.links = [link for link in robot.links if link.name not in links]
    torsion = tuple(name for name, names in found.items() if f"{name}_torsion" in names)
    bending = tuple(name for name, names in found.items() if f"{name}_bend_1" in names)
    return read_xml(to_xml(with_robot(urdf, robot))), torsion, bending, base
