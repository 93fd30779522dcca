"""Claims about the linearised equations of motion (3.88-3.94) and what follows from them in frequency (chapter 5)."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest
from drawn_effects import ROBOTS, TYPES, draw_state, tree, with_drawn_effects
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90b_flex.effects import Effect
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import DriveFlexibility
from rx90b_flex.effects.springs import JointSpring
from rx90b_flex.effects.traits import PARTS
from rx90b_flex.linearize import Linearization
from rx90b_flex.robot import Robot, load_robot


def finite_differences(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[np.ndarray]:
    """Derivatives of the inverse dynamics by q, v and a: central differences of fourth order, error about 1e-10."""
    steps = 1e-3 * np.eye(robot.model.nv)
    found = []
    for place in range(3):
        forces = []
        for k in (-2, -1, 1, 2):
            moved = [x + k * steps if i == place else x for i, x in enumerate((q, v, a))]
            forces.append(robot.inverse_dynamics(*moved).T)
        low2, low, high, high2 = forces
        found.append((low2 - 8 * low + 8 * high - high2) / (12 * 1e-3))
    return found


def moving_state(robot: Robot, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A bent pose in motion: joints fast enough for smooth friction, small deformations."""
    rng = np.random.default_rng(seed)
    drive = np.array([c.endswith("drive") for c in robot.coordinates])
    q, v, a = draw_state(robot, rng)
    return np.where(drive, 1.0, 1e-3) * q, np.where(drive, 1.0, 1e-2) * v, a


def undamped(lin: Linearization) -> Linearization:
    """The same without damping, friction and Coriolis forces."""
    groups = {name: getattr(lin, name) for name in PARTS}
    return dataclasses.replace(lin, **{n: dataclasses.replace(t, D=np.zeros_like(t.D)) for n, t in groups.items()})


def as_table_d1(robot: Robot) -> Robot:
    """The same with damping of 1e-3 s times stiffness, and friction on the joints."""
    effects: list[Effect] = []
    for e in robot.effects:
        if e.traits.part == "flexibility":
            stiffness = np.split(e.coefficients, 2)[0]
            e = e.with_coefficients(np.r_[stiffness, 1e-3 * stiffness])
        effects.append(dataclasses.replace(e, side="joint") if e.traits.is_friction else e)
    return robot.with_effects(effects)


def stretched(v: float = 0.0) -> Linearization:
    """The three-axis arm stretched horizontally, each drive turning at v rad/s; damping and friction's side as in table D.1."""
    robot = as_table_d1(load_robot("rx90b_3dof"))
    q = np.zeros(robot.model.nv)
    q[robot.coordinates.index("joint_2:drive")] = np.pi / 2
    return robot.linearize(q, robot.input_matrix @ np.full(3, v))


# ---- matrices -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rx90b", "rx90b_3dof"])
def test_moving_with_friction_and_spring_it_is_the_derivative_of_the_inverse_dynamics(name):
    robot = load_robot(name)
    state = moving_state(robot, 1)
    lin = robot.linearize(*state)
    # the constant matrices of the hinges are some 1e4 times the rest: without them the tolerance is one for the rest
    hinges = lin.flexibility
    expected = finite_differences(robot, *state)
    for found, difference, exact in zip((lin.K, lin.D, lin.M), expected, (hinges.K, hinges.D, hinges.M), strict=True):
        scale = np.abs(found - exact).max()
        assert np.abs(found - difference).max() <= 1e-6 * scale


@settings(max_examples=25)
@given(st.sampled_from(ROBOTS), st.lists(st.sampled_from(TYPES), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_with_any_effects_it_is_the_derivative_of_the_inverse_dynamics(source, kinds, seed):
    rng = np.random.default_rng(seed)
    robot = with_drawn_effects(tree(source), kinds, rng)
    state = draw_state(robot, rng)
    lin = robot.linearize(*state)
    for found, difference in zip((lin.K, lin.D, lin.M), finite_differences(robot, *state), strict=True):
        assert np.abs(found - difference).max() <= 1e-6 * np.abs(difference).max()


def test_at_rest_mass_and_stiffness_are_symmetric_and_nothing_is_dynamic():
    robot = load_robot("rx90b_4dof")
    lin = robot.linearize(moving_state(robot, 2)[0])
    for matrix in (lin.M, lin.D, lin.K, lin.G0):
        np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    assert not lin.N0.any()
    assert not lin.C0.any()
    mass = robot.mass_matrix(moving_state(robot, 2)[0])
    np.testing.assert_allclose(lin.M, mass, rtol=0, atol=1e-13 * np.abs(mass).max())


def test_the_matrices_are_the_sums_that_the_source_writes():
    """(3.90): D0 + C0 + F0 and K0 + G0 + N0; no friction depends on the position here."""
    robot = load_robot("rx90b_4dof")
    lin = robot.linearize(*moving_state(robot, 3))
    np.testing.assert_allclose(lin.D, lin.D0 + lin.C0 + lin.F0, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(lin.K, lin.K0 + lin.G0 + lin.N0, rtol=1e-12, atol=1e-9)
    flexible = [not c.endswith("drive") for c in robot.coordinates]
    stiffness = {"joint_1": (2.8e5, 4.4e5, 4.4e5), "joint_2": (2.7e5, 2.4e5, 2.4e5)}
    stiffness |= {"joint_3": (1.0e5, 2.1e5, 2.1e5), "joint_4": (0.9e5, 1.6e5, 1.6e5)}
    assert np.diag(lin.flexibility.K)[flexible].tolist() == [k for joint in robot.joints for k in stiffness[joint]]
    assert np.count_nonzero(lin.flexibility.K) == np.count_nonzero(lin.D0) == 12


def test_the_friction_block_on_drive_and_torsion_is_full():
    """Friction acts on e + eps1, so (3.92) is [[f', f'], [f', f']] and not diagonal."""
    robot = as_table_d1(load_robot("rx90b_3dof"))
    lin = robot.linearize(*moving_state(robot, 4))
    slopes = []
    for joint in robot.joints:
        pair = [robot.coordinates.index(f"{joint}:{kind}") for kind in ("drive", "torsion")]
        block = lin.F0[np.ix_(pair, pair)]
        assert np.array_equal(block, np.full((2, 2), block[0, 0]))
        slopes.append(block[0, 0])
    assert min(slopes) > 0
    assert np.count_nonzero(lin.F0) == 4 * len(slopes)


def test_friction_on_the_motors_has_a_slope_on_the_drives_alone():
    robot = load_robot("rx90b_3dof")  # friction's side is "motor" there
    lin = robot.linearize(*moving_state(robot, 4))
    drives = np.flatnonzero(robot.input_matrix.any(axis=1))
    assert (np.diag(lin.F0)[drives] > 0).all()
    assert np.count_nonzero(lin.F0) == len(drives)


def test_in_joint_angles_the_coupling_of_drive_and_link_is_in_stiffness_and_damping():
    """(3.79), (3.81), (3.82), (3.83) for the links' own matrices."""
    lin = stretched(0.11)
    changed = lin.in_joint_angles()
    assert changed.coordinates[:4] == ("joint_1:drive", "joint_1:angle", "joint_1:bend_1", "joint_1:bend_2")
    drive, angle = 0, 1
    pair = np.ix_([drive, angle], [drive, angle])
    np.testing.assert_allclose(changed.M[drive], [3.10, *np.zeros(11)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(changed.flexibility.K[pair], 2.8e5 * np.array([[1, -1], [-1, 1]]), rtol=1e-12)
    np.testing.assert_allclose(changed.D0[pair], 2.8e2 * np.array([[1, -1], [-1, 1]]), rtol=1e-12)
    assert changed.F0[pair][0].tolist() == [0.0, 0.0]
    assert changed.F0[angle, angle] > 0
    np.testing.assert_allclose(changed.frequencies_hz(), lin.frequencies_hz(), rtol=1e-6, atol=1e-2)
    hz = np.array([5.0, 30.0, 100.0])
    np.testing.assert_allclose(changed.frf(hz), lin.frf(hz), rtol=1e-9)
    np.testing.assert_allclose(lin.frf(float(hz[0])), lin.frf(hz)[0], rtol=1e-12)


def test_several_samples_are_refused():
    robot = load_robot("rx90b_3dof")
    for asked in (robot.linearize, robot.mass_matrix):
        for shape in ((2, 12), (3,)):
            with pytest.raises(ValueError) as error:
                asked(np.zeros(shape))
            assert str(error.value) == f"q has shape {shape}; expected one sample, (12,)"


def test_a_response_at_a_pole_is_refused():
    at_rest = tree("rx90b").linearize(np.zeros(6))
    with pytest.raises(
        ValueError, match=r"hz: a pole is among the frequencies.* at 0 Hz.*expected frequencies above 0"
    ):
        tree("rx90b").with_effects([]).linearize([0.0] * 6).frf([0.0, 5.0])
    with pytest.raises(ValueError, match="hz: a frequency is not finite"):
        at_rest.frf([np.nan])


# ---- frequencies --------------------------------------------------------------------------------------------


def test_a_rigid_joint_on_a_spring_swings_at_its_natural_frequency():
    robot = tree("rx90b").with_effects([JointSpring(joint="joint_1", stiffness=1000.0, rest_angle=0.0)])
    q = np.array([0.0, 0.5, 0.5, 0, 0, 0])
    held = robot.restricted(["joint_1"])
    inertia = held.mass_matrix(np.zeros(1))[0, 0]
    assert held.linearize(q[:1]).frequencies_hz() == pytest.approx([np.sqrt(1000.0 / inertia) / (2 * np.pi)], rel=1e-12)


def test_a_pose_that_falls_has_frequency_zero_and_a_hanging_one_swings():
    up = tree("rx90b").restricted(["joint_2"]).with_effects([DriveInertia(joint="joint_2", inertia=1.0)])
    assert up.linearize(np.zeros(1)).frequencies_hz().tolist() == [0.0]
    hanging = up.linearize(np.array([np.pi]))
    assert hanging.frequencies_hz()[0] == pytest.approx(np.sqrt(hanging.K[0, 0] / hanging.M[0, 0]) / (2 * np.pi))


def test_one_flexible_drive_has_the_two_mass_resonance_and_antiresonance():
    k, inertia = 1e5, 1.3
    drive = DriveInertia(joint="joint_1", inertia=inertia)
    torsion = DriveFlexibility(joint="joint_1", stiffness=k, damping=0.0)
    robot = tree("rx90b").restricted(["joint_1"]).with_effects([drive, torsion])
    lin = robot.linearize(np.zeros(2))
    link = lin.links.M[1, 1]
    expected = np.sqrt(k * (1 / inertia + 1 / link)) / (2 * np.pi)
    np.testing.assert_allclose(lin.frequencies_hz(elastic_only=True), [0.0, expected], rtol=1e-9)
    np.testing.assert_allclose(lin.antiresonances_hz("joint_1"), [np.sqrt(k / link) / (2 * np.pi)], rtol=1e-9)


def test_elastic_frequencies_hold_one_zero_for_each_drive():
    found = stretched().frequencies_hz(elastic_only=True)
    assert found[:3].tolist() == [0.0, 0.0, 0.0]
    assert found[3] > 10
    assert (np.diff(found) >= 0).all()


def test_gravity_and_its_spring_move_no_flexible_frequency_by_more_than_a_thousandth():
    lin = stretched()
    np.testing.assert_allclose(lin.frequencies_hz()[3:], lin.frequencies_hz(elastic_only=True)[3:], rtol=1e-3)


def test_drive_stiffness_is_drive_inertia_times_the_traces_difference():
    """k_j = J_j (sum of squared resonances - sum of squared antiresonances), exact with all of them."""
    lin = stretched()
    squares = np.sum((2 * np.pi * lin.frequencies_hz(elastic_only=True)) ** 2)
    for joint, inertia, stiffness in zip(lin.joints, [3.10, 1.31, 0.79], [2.8e5, 2.7e5, 1.0e5], strict=True):
        locked = np.sum((2 * np.pi * lin.antiresonances_hz(joint, elastic_only=True)) ** 2)
        assert inertia * (squares - locked) == pytest.approx(stiffness, rel=1e-9)


def test_an_unknown_joint_has_no_antiresonances():
    with pytest.raises(ValueError, match="unknown joint 'joint_9'; did you mean"):
        stretched().antiresonances_hz("joint_9")


# ---- frequency response -------------------------------------------------------------------------------------


def test_the_frf_is_the_direct_solution_of_the_equations_of_motion():
    robot = load_robot("rx90b_3dof")
    lin = robot.linearize(*moving_state(robot, 5))
    hz = np.array([0.5, 14.8, 31.3, 120.0])
    for f, found in zip(hz, lin.frf(hz), strict=True):
        s = 2j * np.pi * f
        amplitude = np.linalg.inv(lin.M * s**2 + lin.D * s + lin.K) @ lin.input_matrix
        acceleration = s**2 * amplitude[[lin.coordinates.index(f"{j}:drive") for j in lin.joints]]
        np.testing.assert_allclose(found, acceleration, rtol=1e-9)


def test_the_undamped_frf_grows_at_resonances_and_vanishes_at_antiresonances():
    lin = undamped(stretched())
    at = lin.frequencies_hz()[3:]
    near, beside = (np.linalg.norm(lin.frf(at * (1 + d)), axis=(1, 2)) for d in (1e-8, 1e-3))
    assert (near > 1e3 * beside).all()
    for j, joint in enumerate(lin.joints):
        zeros = lin.antiresonances_hz(joint)[2:]
        # a step this small, because a mode that the drive hardly moves has its pole close to the zero
        below, above = (lin.frf(zeros * (1 + d))[:, j, j].real for d in (-1e-8, 1e-8))
        assert (np.sign(below) != np.sign(above)).all()


def test_the_frf_ends_at_the_rigid_mass_matrix_and_at_the_drive_inertia():
    lin = undamped(stretched())
    drives = [lin.coordinates.index(f"{j}:drive") for j in lin.joints]
    rigid = np.linalg.inv(lin.M[np.ix_(drives, drives)])
    np.testing.assert_allclose(lin.frf(np.array([1.0]))[0].real, rigid, rtol=0, atol=0.01 * rigid.max())
    np.testing.assert_allclose(lin.frf(np.array([1e5]))[0].real, np.diag(1 / np.array([3.10, 1.31, 0.79])), atol=1e-4)


def test_the_state_space_has_the_same_response():
    lin = stretched(0.11)
    system = lin.to_statespace()
    hz = np.array([1.0, 15.0, 40.0, 200.0])
    s = 2j * np.pi * hz
    angles = np.moveaxis(control.frequency_response(system, np.abs(s)).frdata, 2, 0)
    np.testing.assert_allclose(s[:, None, None] ** 2 * angles, lin.frf(hz), rtol=1e-6)
    assert system.input_labels == ["joint_1:torque", "joint_2:torque", "joint_3:torque"]
    assert system.output_labels == ["joint_1:angle", "joint_2:angle", "joint_3:angle"]
    assert system.nstates == 24


def test_modes_are_the_poles_of_the_state_space():
    lin = stretched(0.11)
    modes = lin.modes()
    poles = np.concatenate([modes.poles, modes.poles[modes.poles.imag > 0].conj()])
    expected = lin.to_statespace().poles()
    assert len(poles) == len(expected) == 24
    distance = np.abs(np.sort_complex(poles) - np.sort_complex(expected))
    assert distance.max() <= 1e-6 * np.abs(expected).max()
    for pole, shape in zip(modes.poles[3:], modes.shapes.T[3:], strict=True):
        left = (lin.M * pole**2 + lin.D * pole + lin.K) @ shape
        assert np.abs(left).max() <= 1e-6 * np.abs(lin.K).max()
    assert np.abs(modes.shapes).max(axis=0) == pytest.approx(1.0)


def test_damping_in_proportion_to_stiffness_gives_ratios_that_grow_with_the_frequency():
    """D = 1e-3 s times K: an elastic mode at w has the ratio w/2 of 1e-3 s, until it no longer swings."""
    lin = stretched()
    nothing = {n: dataclasses.replace(getattr(lin, n), D=0 * lin.M, K=0 * lin.M) for n in PARTS if n != "flexibility"}
    modes = dataclasses.replace(lin, **nothing).modes()
    w = 2 * np.pi * lin.frequencies_hz(elastic_only=True)[3:]
    ratios = 0.5e-3 * w
    swinging = modes.poles.imag > 1.0
    np.testing.assert_allclose(modes.damping_ratios[swinging], ratios[ratios < 1], rtol=1e-6)
    np.testing.assert_allclose(2 * np.pi * modes.frequencies_hz[swinging], w[ratios < 1], rtol=1e-6)
