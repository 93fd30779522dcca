"""Claims about the equations of motion of robots with flexible drives, joints and bases (chapter 3 of the source)."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_effects import ROBOTS, TYPES, draw_state, tree, with_drawn_effects
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_angles import JointAngleDynamics
from scipy.integrate import solve_ivp

from rx90b_flex.effects import catalogue
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import BaseFlexibility, DriveFlexibility
from rx90b_flex.robot import Robot, load_robot

FLEXIBLE = ("rx90b", "rx90b_4dof", "rx90b_3dof")


def places(robot: Robot, kind: str) -> list[int]:
    """Coordinates of one kind, joint by joint, of the joints with a flexible drive."""
    twisting = [j for j in robot.joints if robot.layout.index(j, "torsion") is not None]
    return [robot.coordinates.index(f"{joint}:{kind}") for joint in twisting]


def seeds() -> st.SearchStrategy[int]:
    return st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("name", FLEXIBLE)
def test_the_mass_matrix_is_symmetric_and_positive_definite_in_every_pose(name):
    robot = load_robot(name)
    for q in np.random.default_rng(1).uniform(-2, 2, (20, robot.model.nv)):
        mass = robot.mass_matrix(q)
        assert np.array_equal(mass, mass.T)
        assert np.linalg.eigvalsh(mass)[0] > 0


@settings(max_examples=30)
@given(st.sampled_from(ROBOTS), st.lists(st.sampled_from(TYPES), max_size=6), seeds())
def test_inverse_dynamics_is_affine_in_the_acceleration_with_the_mass_matrix(source, kinds, seed):
    rng = np.random.default_rng(seed)
    # what follows the size of the load has a corner where that changes sign
    robot = with_drawn_effects(tree(source), [k for k in kinds if not catalogue()[k].traits.needs_load], rng)
    q, v, a = draw_state(robot, rng)
    found = robot.inverse_dynamics(q, v, a) - robot.inverse_dynamics(q, v, 0 * a)
    expected = robot.mass_matrix(q) @ a
    assert np.abs(found - expected).max() <= 1e-10 * np.abs(robot.inverse_dynamics(q, v, a)).max()


@settings(max_examples=30)
@given(st.lists(st.sampled_from(TYPES), max_size=6), seeds())
def test_forward_dynamics_inverts_inverse_dynamics(kinds, seed):
    rng = np.random.default_rng(seed)
    drives = [DriveInertia(joint=j, inertia=1.0) for j in tree("rx90b").joints]
    robot = with_drawn_effects(tree("rx90b"), [k for k in [*kinds, "load_friction"] if k != "drive_inertia"], rng)
    # a load friction beyond its load would leave no way to move
    drawn = [e.with_coefficients(0.1 * e.coefficients) if e.traits.needs_load else e for e in robot.effects]
    robot = robot.with_effects([*drives, *drawn])
    q, v, _ = draw_state(robot, rng)
    torque = rng.uniform(-100, 100, len(robot.joints))
    a = robot.forward_dynamics(q, v, torque)
    force = robot.inverse_dynamics(q, v, a)
    assert np.abs(force - robot.input_matrix @ torque).max() <= 1e-9 * np.abs(force).max()


@pytest.mark.parametrize("name", FLEXIBLE)
def test_forward_dynamics_leaves_no_force_on_flexible_coordinates(name):
    robot = load_robot(name)
    rng = np.random.default_rng(2)
    q = np.where([c.endswith("drive") for c in robot.coordinates], 1.0, 1e-3) * rng.uniform(-1, 1, robot.model.nv)
    v = rng.uniform(-1, 1, robot.model.nv)
    torque = rng.uniform(-100, 100, len(robot.joints))
    force = robot.inverse_dynamics(q, v, robot.forward_dynamics(q, v, torque))
    np.testing.assert_allclose(force, robot.input_matrix @ torque, rtol=0, atol=1e-9 * 100)


def test_a_flexible_drive_without_inertia_has_no_forward_dynamics():
    robot = tree("rx90b").with_effects([DriveFlexibility(joint="joint_2", stiffness=1e5, damping=0.0)])
    with pytest.raises(ValueError, match="a flexible drive needs a drive_inertia to move; none at joint_2"):
        robot.forward_dynamics(np.zeros(7), np.zeros(7), np.zeros(6))


# ---- drive angles and torsions, or drive and joint angles (3.73-3.83) --------------------------------------------


@pytest.mark.parametrize("name", FLEXIBLE)
def test_drive_and_torsion_turn_the_links_alike(name):
    """(3.77): rows of the mass matrix of e and eps1 differ by the drive inertia alone."""
    robot = load_robot(name)
    inertia = {e.joint: e.inertia for e in robot.effects if e.type_name() == "drive_inertia"}
    drives, torsions = places(robot, "drive"), places(robot, "torsion")
    for q in np.random.default_rng(3).uniform(-1, 1, (5, robot.model.nv)):
        mass = robot.mass_matrix(q)
        expected = np.zeros_like(mass[drives])
        for row, place in enumerate(drives):
            expected[row, place] = inertia[robot.coordinates[place].split(":")[0]]
        assert np.abs(mass[drives] - mass[torsions] - expected).max() <= 1e-12 * np.abs(mass).max()


@pytest.mark.parametrize("name", FLEXIBLE)
def test_in_joint_angles_the_mass_matrix_couples_no_drive_with_anything(name):
    """(3.79), (3.80): drive rows hold the drive inertias, the rest is the links' mass matrix in (theta, eps2, eps3)."""
    robot = load_robot(name)
    links = robot.with_effects([e for e in robot.effects if e.type_name() != "drive_inertia" or e.joint >= "joint_5"])
    dynamics = JointAngleDynamics(robot)
    inertia = [e.inertia for e in robot.effects if e.type_name() == "drive_inertia"]
    drives = places(robot, "drive")
    others = [i for i in range(robot.model.nv) if i not in drives]
    for q in np.random.default_rng(4).uniform(-1, 1, (5, robot.model.nv)):
        mass = dynamics.mass_matrix(q)
        atol = 1e-12 * np.abs(mass).max()
        np.testing.assert_allclose(mass[np.ix_(drives, drives)], np.diag(inertia[: len(drives)]), rtol=0, atol=atol)
        np.testing.assert_allclose(mass[np.ix_(drives, others)], 0.0, rtol=0, atol=atol)
        link_mass = links.mass_matrix(dynamics.to_torsions(q))[np.ix_(others, others)]
        np.testing.assert_allclose(mass[np.ix_(others, others)], link_mass, rtol=0, atol=atol)


def test_in_joint_angles_friction_acts_on_the_joint_angle_alone():
    """(3.83): T^T F = [0; I; 0; 0]."""
    robot = load_robot("rx90b_4dof")
    dynamics = JointAngleDynamics(robot)
    rates = np.random.default_rng(5).uniform(0.2, 1, 16)
    motion = robot.motion(np.zeros(16), dynamics.to_torsions(rates), np.zeros(16))
    torque = sum(e.force(motion)[0] for e in robot.effects if e.traits.is_friction) @ dynamics.transform
    angles = [i for i, name in enumerate(dynamics.coordinates) if name.endswith(":angle")]
    assert np.abs(np.delete(torque, angles)).max() <= 1e-13 * np.abs(torque).max()
    assert (torque[angles] > 0).all()


def test_dynamics_in_joint_angles_are_the_same_motion_in_other_coordinates():
    robot = load_robot("rx90b_3dof")
    dynamics = JointAngleDynamics(robot)
    q, v, _ = draw_state(robot, np.random.default_rng(6))
    torque = np.array([10.0, -20.0, 5.0])
    a = dynamics.forward_dynamics(dynamics.from_torsions(q), dynamics.from_torsions(v), torque)
    expected = robot.forward_dynamics(q, v, torque)
    np.testing.assert_allclose(dynamics.to_torsions(a), expected, rtol=1e-12, atol=1e-9)
    theta = dynamics.coordinates.index("joint_2:angle")
    drive, torsion = (robot.coordinates.index(f"joint_2:{kind}") for kind in ("drive", "torsion"))
    assert a[theta] == pytest.approx(expected[drive] + expected[torsion], rel=1e-12)
    forces = dynamics.inverse_dynamics(*(dynamics.from_torsions(x) for x in (q, v)), a)
    np.testing.assert_allclose(forces, robot.input_matrix @ torque, rtol=0, atol=1e-8)


# ---- base and energy ----------------------------------------------------------------------------------------


def test_a_very_stiff_base_moves_its_robot_like_a_fixed_one():
    fixed = load_robot("rx90b").rigid()
    stiff = fixed.with_effects([*fixed.effects, BaseFlexibility(stiffness=(1.2e12, 1.2e12), damping=(0.0, 0.0))])
    q, v, _ = draw_state(fixed, np.random.default_rng(7))
    torque = np.full(6, 20.0)
    start = np.r_[0, 0, q]
    # the base gives way by torque over stiffness; in that place it has no acceleration left
    base = -fixed_base_moment(stiff, start, np.r_[0, 0, v], torque) / 1.2e12
    found = stiff.forward_dynamics(np.r_[base, q], np.r_[0, 0, v], torque)
    np.testing.assert_allclose(found[2:], fixed.forward_dynamics(q, v, torque), rtol=1e-6)


def fixed_base_moment(robot: Robot, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Moment about the base's two hinges when they are held."""
    free = np.arange(2, robot.model.nv)
    bias = robot.inverse_dynamics(q, v, 0 * q)
    a = np.zeros_like(q)
    a[free] = np.linalg.solve(robot.mass_matrix(q)[np.ix_(free, free)], torque - bias[free])
    return robot.inverse_dynamics(q, v, a)[:2]


def test_free_motion_without_friction_and_damping_keeps_the_energy():
    """One second from a bent pose with the flexible coordinates deflected and joint_1 turning."""
    robot = load_robot("rx90b_3dof").restricted(["joint_1", "joint_2"])
    lossless = [_undamped(e) if e.traits.virtual else e for e in robot.effects if not e.traits.is_friction]
    robot = robot.with_effects(lossless)
    n = robot.model.nv
    q, v = np.zeros(n), np.zeros(n)
    for name, value in {"joint_2:drive": 1.0, "joint_2:torsion": 1e-3, "joint_2:bend_1": 1e-3}.items():
        q[robot.coordinates.index(name)] = value
    v[robot.coordinates.index("joint_1:drive")] = 1.0
    idle = np.zeros(2)

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        return np.r_[x[n:], robot.forward_dynamics(x[:n], x[n:], idle)]

    run = solve_ivp(rates, (0, 1), np.r_[q, v], method="DOP853", rtol=1e-6, atol=1e-10, t_eval=np.linspace(0, 1, 21))
    energy = np.array([robot.energy(x[:n], x[n:]) for x in run.y.T])
    kinetic = np.array([0.5 * x[n:] @ robot.mass_matrix(x[:n]) @ x[n:] for x in run.y.T])
    assert kinetic.max() > 5 * kinetic[0]  # so that there is something to keep
    assert np.ptp(energy) <= 1e-6 * kinetic.max()


def _undamped(effect):
    stiffness, damping = np.split(effect.coefficients, 2)
    return effect.with_coefficients(np.r_[stiffness, 0 * damping])
