"""Claims that an independent engine computes the same dynamics.

The engine is MuJoCo; `mujoco_engine` builds its model from the rigid URDF, with virtual hinges of its own placing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from rx90b_flex.effects import Effect
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import BaseFlexibility, DriveFlexibility, JointFlexibility
from rx90b_flex.effects.motion import Array
from rx90b_flex.flexify import urdf_path
from rx90b_flex.robot import Robot, load_robot, robots_folder

pytest.importorskip("mujoco", reason="the independent engine")

from mujoco_engine import Engine

STATES = 20
AGREE = 1e-8  # of the norm
UR10, PANDA = "example-robot-data:ur10", "example-robot-data:panda"
FLEXIBLE_JOINTS = {"rx90b": 4, UR10: 6, PANDA: 8}  # the Panda's eighth drive, of its fingers, is prismatic


@dataclass(frozen=True)
class Pair:
    """The same robot here and in MuJoCo; `order` takes MuJoCo's coordinates to ours."""

    robot: Robot
    engine: Engine
    order: list[int]

    def mass_matrices(self, q: Array) -> tuple[Array, Array]:
        theirs = self.engine.mass_matrix(self._to_theirs(q))
        return self.robot.mass_matrix(q), theirs[np.ix_(self.order, self.order)]

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        theirs = self.engine.inverse_dynamics(*(self._to_theirs(x) for x in (q, v, a)))
        return self.robot.inverse_dynamics(q, v, a), theirs[self.order]

    def _to_theirs(self, x: Array) -> Array:
        out = np.empty_like(x)
        out[self.order] = x
        return out


def pair(source: str, base: bool = False, springs: bool = False) -> Pair:
    """A robot with drive inertias whose drives twist and whose joints bend, freely or against springs and dampers."""
    plain = load_robot(source).with_effects([])
    joints = plain.joints[: FLEXIBLE_JOINTS[source]]
    rng = np.random.default_rng(1)
    inertia = {f"{joint}:drive": rng.uniform(0.5, 2.0) for joint in plain.joints}
    hinges = [f"{joint}:{kind}" for joint in joints for kind in ("torsion", "bend_1", "bend_2")]
    hinges += ["base:bend_1", "base:bend_2"] * base
    stiffness = {hinge: rng.uniform(1e5, 5e5) * springs for hinge in hinges}
    damping = {hinge: 1e-3 * stiffness[hinge] for hinge in hinges}

    def bendings(place: str) -> dict[str, tuple[float, float]]:
        first, second = f"{place}:bend_1", f"{place}:bend_2"
        return {"stiffness": (stiffness[first], stiffness[second]), "damping": (damping[first], damping[second])}

    effects: list[Effect] = [DriveInertia(joint=joint, inertia=inertia[f"{joint}:drive"]) for joint in plain.joints]
    for joint in joints:
        twist = f"{joint}:torsion"
        effects.append(DriveFlexibility(joint=joint, stiffness=stiffness[twist], damping=damping[twist]))
        effects.append(JointFlexibility(joint=joint, **bendings(joint)))
    if base:
        effects.append(BaseFlexibility(**bendings("base")))
    robot = plain.with_effects(effects)
    path = urdf_path(source) if ":" in source else robots_folder() / f"{source}.urdf"
    engine = Engine(path.read_text(encoding="utf-8"), joints, joints, base, inertia, stiffness, damping)
    return Pair(robot, engine, [engine.coordinates.index(name) for name in robot.coordinates])


def states(robot: Robot, deformation: float = 1.0) -> Array:
    """Random q, v, a, shape (STATES, 3, n); coordinates of hinges within +-`deformation` rad."""
    size = np.where([name.endswith(":drive") for name in robot.coordinates], 3.0, deformation)
    scale = np.stack([size, np.full_like(size, 2.0), np.full_like(size, 5.0)])
    return scale * np.random.default_rng(2).uniform(-1, 1, (STATES, 3, len(size)))


def assert_agree(ours: Array, theirs: Array) -> None:
    assert np.isfinite(theirs).all()
    assert np.linalg.norm(ours - theirs) <= AGREE * np.linalg.norm(theirs)


@pytest.mark.parametrize("source", FLEXIBLE_JOINTS)
def test_both_have_the_same_coordinates(source):
    both = pair(source)
    assert set(both.engine.coordinates) == set(both.robot.coordinates)
    assert len(both.robot.coordinates) == len(both.robot.joints) + 3 * FLEXIBLE_JOINTS[source]


@pytest.mark.parametrize("source", FLEXIBLE_JOINTS)
def test_mass_matrix_is_that_of_mujoco_with_drive_inertias_as_armature(source):
    both = pair(source)
    for q, _, _ in states(both.robot):
        assert_agree(*both.mass_matrices(q))


@pytest.mark.parametrize("source", FLEXIBLE_JOINTS)
def test_inverse_dynamics_of_links_and_drives_is_that_of_mujoco(source):
    both = pair(source)
    for q, v, a in states(both.robot):
        assert_agree(*both.inverse_dynamics(q, v, a))


@pytest.mark.parametrize("source", FLEXIBLE_JOINTS)
def test_hinge_stiffness_and_damping_are_mujocos_springs_and_dampers(source):
    both = pair(source, springs=True)
    # as small as they are in use: springs as strong as these would otherwise hide the links
    for q, v, a in states(both.robot, deformation=1e-3):
        assert_agree(*both.inverse_dynamics(q, v, a))


def test_a_flexible_base_is_two_hinges_under_the_root_link():
    both = pair("rx90b", base=True)
    for q, v, a in states(both.robot):
        assert_agree(*both.mass_matrices(q))
        assert_agree(*both.inverse_dynamics(q, v, a))


def test_the_engine_keeps_the_inertias_of_table_d1_that_break_the_triangle_inequality():
    """What MuJoCo's compiler would refuse or balance; without this the comparison would be one of other robots."""
    engine = pair("rx90b").engine
    for link, largest in (("link_1", 0.361), ("link_2", 0.299)):
        principal = engine.principal_inertia(link)
        assert principal[2] == pytest.approx(largest, abs=5e-4)
        assert principal[2] > principal[0] + principal[1]
