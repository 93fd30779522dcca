"""Robots as URDF: the rigid tree, payloads in its links, damping and dry friction on its joints."""

from __future__ import annotations

import numpy as np

from rx90b_flex.bodies import inconsistencies
from rx90b_flex.export import with_link_parameters
from rx90b_flex.flexify import read_xml, to_xml, with_continuous
from rx90b_flex.simulators.held import Format, Held, Lost

URDF = Format(
    "urdf", "a URDF", rotors=False, springs=False, constants=False, pairs=False, gravity=False, lines=False
)  # fmt: skip


def urdf_text(held: Held) -> tuple[str, tuple[Lost, ...]]:
    """A robot as URDF, and what beyond its effects the text does not hold.

    Raises
    ------
    ValueError
        A link that a URDF cannot hold.
    """
    from yourdfpy.urdf import Dynamics  # type: ignore[import-untyped, unused-ignore]

    robot = held.robot
    wanted = np.concatenate([held.bodies[link] for link, _ in robot.bodies])
    if not np.array_equal(wanted, robot.link_parameters):
        robot = with_link_parameters(robot, wanted, allow_inconsistent=True)
    urdf = read_xml(robot.urdf)
    for joint in urdf.robot.joints:
        port = held.on(f"{joint.name}:drive")  # a URDF may state others of its own: they are not this robot's
        joint.dynamics = Dynamics(port.damping, port.friction) if port.damping or port.friction else None
    lost = [
        Lost(found.link, "no body has its moments of inertia: written as they are, and some simulators refuse them")
        for found in inconsistencies(wanted, [link for link, _ in robot.bodies])
    ]
    return to_xml(with_continuous(urdf)), tuple(lost)
