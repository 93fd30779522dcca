"""The arms of the study, what their files declare, and the true values of what is identified."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import example_robot_data
import independent as ind
import numpy as np
import pinocchio as pin

import rx90b_flex as rf
from rx90b_flex.robot import Robot

Array = ind.Array
LINKS_OFF = 0.15  # of a link's inertia, at most


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot of the study: the arm that makes the logs, and the friction that it has and declares."""

    name: str
    arm: ind.Arm
    coulomb: tuple[float, ...]
    viscous: tuple[float, ...]


def z1() -> ind.Arm:
    """The Z1's six joints, its gripper held."""
    model = example_robot_data.load("z1").model
    gripper = [i for i, name in enumerate(model.names) if "Gripper" in name]
    return ind.Arm("example-robot-data:z1", pin.buildReducedModel(model, gripper, pin.neutral(model)))


@cache
def subject(name: str) -> Subject:
    if name == "ur10":
        return Subject(name, ind.ur10(), (10.0, 10.0, 6.0, 1.5, 1.5, 1.0), (20.0, 20.0, 12.0, 3.0, 3.0, 2.0))
    if name == "panda":
        return Subject(name, ind.panda(), (2.0, 2.0, 1.5, 1.5, 1.0, 0.8, 0.6), (4.0, 4.0, 3.0, 3.0, 1.5, 1.2, 1.0))
    if name == "z1":
        return Subject(name, z1(), (1.2, 1.5, 1.0, 0.4, 0.3, 0.2), (1.5, 2.0, 1.2, 0.5, 0.4, 0.2))
    return Subject(name, ind.rx90b(), (17.4, 16.7, 5.6, 4.6, 1.6, 0.8), (45.7, 42.7, 14.5, 11.8, 4.1, 2.1))


ROBOTS = ("rx90b", "ur10", "panda", "z1")


def with_links_off(arm: ind.Arm, rng: np.random.Generator) -> ind.Arm:
    """The arm with every link's inertia off by its own factor."""
    model = arm.model.copy()
    for i, inertia in enumerate(model.inertias):
        factor = 1.0 + LINKS_OFF * rng.uniform(-1.0, 1.0)
        model.inertias[i] = pin.Inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)
    return ind.Arm(arm.urdf, model)


@cache
def declared_robot(name: str, absent: Sequence[tuple[str, str]], known_links: bool) -> Robot:
    """The robot as its file declares it: friction on every joint, less what is absent (type, joint)."""
    arm = subject(name).arm
    tables = [
        {"type": kind, "joint": j}
        for j in arm.joints
        for kind in ("coulomb_friction", "viscous_friction")
        if (kind, j) not in absent
    ]
    with tempfile.TemporaryDirectory() as folder:
        return rf.load_robot(ind.write_robot(Path(folder), arm, tables, known_links))


def link_values(arm: ind.Arm) -> Array:
    """m, m c, J about the joint in the order xx yy zz xy xz yz of each link, by the parallel-axis theorem; (links, 10)."""
    out = []
    for inertia in list(arm.model.inertias)[1:]:
        m, c = inertia.mass, inertia.lever
        about_joint = inertia.inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
        out.append([m, *(m * c), *about_joint[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])
    return np.array(out)
