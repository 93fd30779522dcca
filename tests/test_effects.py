"""Claims about every effect type of the catalogue, and about the flexible, spring, payload and tilt effects."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from drawn_effects import ALL_TYPES, ROBOTS, TYPES, draw_effect, draw_state, tree, with_drawn_effects
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90b_flex.effects import catalogue, effect_from_table, effect_to_table
from rx90b_flex.effects.base_tilt import BaseTilt
from rx90b_flex.effects.flexibility import BaseFlexibility, DriveFlexibility, JointFlexibility, StiffnessHardening
from rx90b_flex.effects.gravity_spring import GravitySpring
from rx90b_flex.effects.payload import Payload
from rx90b_flex.robot import Robot, load_robot

STEP = 1e-6  # of central differences; their error is STEP^2 of a third derivative and 1e-16 / STEP of the force


def seeds() -> st.SearchStrategy[int]:
    return st.integers(0, 2**32 - 1)


def assert_linear_in_parameters(robot: Robot, rng: np.random.Generator) -> None:
    state = [np.stack(x) for x in zip(*(draw_state(robot, rng) for _ in range(3)), strict=True)]
    force = robot.inverse_dynamics(*state)
    error = robot.regressor(*state) @ robot.parameters - force
    assert np.abs(error).max() <= 1e-10 * np.abs(force).max()


@pytest.mark.parametrize("source", ROBOTS)
@pytest.mark.parametrize("kind", TYPES)
def test_the_regressor_times_the_parameters_is_the_inverse_dynamics_for_every_effect_type(kind, source):
    rng = np.random.default_rng(1)
    assert_linear_in_parameters(with_drawn_effects(tree(source), [kind], rng), rng)


@settings(max_examples=40)
@given(st.sampled_from(ROBOTS), st.lists(st.sampled_from(TYPES), min_size=2, max_size=8), seeds())
def test_the_regressor_times_the_parameters_is_the_inverse_dynamics_for_any_combination(source, kinds, seed):
    rng = np.random.default_rng(seed)
    assert_linear_in_parameters(with_drawn_effects(tree(source), kinds, rng), rng)


@pytest.mark.parametrize("source", ROBOTS)
@pytest.mark.parametrize("kind", TYPES)
def test_analytic_derivatives_of_every_effect_are_finite_differences_of_its_force(kind, source):
    rng = np.random.default_rng(2)
    robot = with_drawn_effects(tree(source), [kind], rng)
    effect = robot.effects[-1]
    state = draw_state(robot, rng)
    force = effect.force(robot.motion(*state))
    steps = STEP * np.eye(robot.model.nv)
    for place, found in enumerate(effect.derivatives(robot.motion(*state))):
        moved = [[x + sign * steps if i == place else x for i, x in enumerate(state)] for sign in (1.0, -1.0)]
        up, down = (effect.force(robot.motion(*m)) for m in moved)
        expected = (up - down).T / (2 * STEP)
        rounding = 1e-15 / STEP * np.abs(force).max()
        np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-7 * np.abs(expected).max() + 10 * rounding)


@pytest.mark.parametrize("source", ROBOTS)
# a cable reacts outside the robot; a drawn curve over velocity is not zero at rest
@pytest.mark.parametrize("kind", [k for k in TYPES if k not in ("cable_torque", "friction_curve")])
def test_the_force_of_every_effect_at_rest_is_the_gradient_of_its_potential(kind, source):
    rng = np.random.default_rng(3)
    robot = with_drawn_effects(tree(source), [kind], rng)
    effect = robot.effects[-1]
    q = draw_state(robot, rng)[0]
    rest = np.zeros_like(q)
    steps = 1e-5 * np.eye(len(q))
    up, down = (effect.potential(robot.motion(q + s * steps, rest, rest)) for s in (1.0, -1.0))
    force = effect.force(robot.motion(q, rest, rest))[0]
    scale = max(np.abs(force).max(), np.abs(up).max())
    np.testing.assert_allclose((up - down) / 2e-5, force, rtol=0, atol=1e-8 * scale)


@pytest.mark.parametrize("kind", ALL_TYPES)
def test_every_effect_comes_back_from_its_table(kind):
    robot = tree("rx90b")
    frames = [f.name for f in robot.tree.frames]
    for effect in draw_effect(kind, robot, np.random.default_rng(4)):
        back = effect_from_table(effect_to_table(effect), "here", robot.joints, frames)
        assert back == effect


# ---- friction's side --------------------------------------------------------------------------------------------


def test_friction_on_the_motor_follows_the_drive_alone_and_leaves_the_hinge_alone():
    declared = load_robot("rx90b_4dof")
    rng = np.random.default_rng(5)
    q, v, a = rng.uniform(-1, 1, (3, declared.model.nv))
    v *= 1e-3  # within the turn-over, where dry friction has a slope
    motion = declared.motion(q, v, a)
    for kind in (
        "coulomb_friction",
        "viscous_friction",
        "viscous_power_friction",
        "stribeck_friction",
        "friction_drift",
    ):
        (effect,) = draw_effect(kind, declared, rng)
        on = {side: dataclasses.replace(effect, side=side) for side in ("joint", "motor")}
        drive, torsion = (declared.coordinates.index(f"{effect.joint}:{k}") for k in ("drive", "torsion"))
        motor, joint = (on[side].force(motion)[0] for side in ("motor", "joint"))
        assert motor[drive] != 0.0 and np.count_nonzero(motor) == 1, kind
        assert joint[drive] == joint[torsion] != motor[drive], kind
        slope = on["motor"].derivatives(motion)[1][0]
        assert slope[drive, drive] != 0.0 and np.count_nonzero(slope) == 1, kind
        assert effect_to_table(on["motor"])["side"] == "motor"
        assert "side" not in effect_to_table(on["joint"])
        back = effect_from_table(effect_to_table(on["motor"]), "here", declared.joints)
        assert back == on["motor"]
    # without a flexible drive there is no difference
    rigid = declared.rigid()
    one = [rigid.with_effects([dataclasses.replace(effect, side=side)]) for side in ("joint", "motor")]
    state = rng.uniform(-1, 1, (3, 4))
    np.testing.assert_array_equal(one[0].inverse_dynamics(*state), one[1].inverse_dynamics(*state))


def test_a_side_that_there_is_not_is_refused():
    table = {"type": "viscous_friction", "joint": "joint_2", "side": "motors"}
    with pytest.raises(ValueError, match=r"here \(viscous_friction\): side is 'motors'; did you mean 'motor'\?"):
        effect_from_table(table, "here", ["joint_1", "joint_2"])


# ---- flexibilities ------------------------------------------------------------------------------------------


def test_each_flexibility_adds_its_coordinates_in_tree_order():
    robot = tree("example-robot-data:ur10").with_effects(
        [
            DriveFlexibility(joint="elbow_joint"),
            JointFlexibility(joint="elbow_joint"),
            DriveFlexibility(joint="wrist_1_joint"),
            BaseFlexibility(),
        ]
    )
    added = [name for name in robot.coordinates if not name.endswith(":drive")]
    assert added == [
        *("base:bend_1", "base:bend_2"),
        *("elbow_joint:torsion", "elbow_joint:bend_1", "elbow_joint:bend_2", "wrist_1_joint:torsion"),
    ]


def test_hardening_without_a_flexible_drive_is_refused_by_the_robot_file(tmp_path):
    path = tmp_path / "robot.toml"
    entry = '[[effects]]\ntype = "stiffness_hardening"\njoint = "elbow_joint"\ncubic = 1.0\n'
    path.write_text('urdf = "example-robot-data:ur10"\n' + entry)
    with pytest.raises(ValueError, match=r"robot\.toml: effect 1: elbow_joint\.stiffness_hardening needs a drive_flex"):
        load_robot(path)


def test_hardening_without_a_flexible_drive_is_refused_in_python():
    robot = tree("rx90b").with_effects([StiffnessHardening(joint="joint_2", cubic=1.0)])
    with pytest.raises(ValueError, match="'joint_2' has no coordinate 'torsion'"):
        robot.inverse_dynamics(*np.zeros((3, 6)))


# ---- gravity spring -----------------------------------------------------------------------------------------


def test_a_gravity_spring_without_anchors_is_refused():
    table = {"type": "gravity_spring", "joint": "a", "stiffness": 1.0, "prestress": 1.0}
    with pytest.raises(ValueError, match=r"here \(gravity_spring\): key 'anchors' is missing"):
        effect_from_table(table, "here", ["a"])
    robot = tree("rx90b").with_effects([GravitySpring(joint="joint_2", stiffness=1.0, prestress=1.0)])
    with pytest.raises(ValueError, match=r"joint_2\.gravity_spring: anchors have no value"):
        robot.inverse_dynamics(*np.zeros((3, 6)))


def test_a_gravity_spring_pulls_its_anchors_together_with_the_stated_force():
    anchors = np.array([[0.1, -0.2, 0.3], [0.2, 0.1, 0.4]])
    spring = GravitySpring(joint="joint_2", stiffness=2e3, prestress=50.0, anchors=tuple(anchors.ravel()))
    robot = tree("rx90b").with_effects([spring])
    q = np.array([0.3, 0.7, 0.1, 0.2, -0.4, 0.5])
    rest = np.zeros(6)
    fixed, moving = anchors[0], pin.AngleAxis(0.7, np.array([0.0, 1.0, 0.0])).matrix() @ anchors[1]
    line = moving - fixed
    pull = 2e3 * (np.linalg.norm(line) - np.linalg.norm(anchors[1] - anchors[0])) + 50.0
    torque = np.cross(moving, -pull * line / np.linalg.norm(line))[1]  # what the spring does to the child
    force = spring.force(robot.motion(q, rest, rest))[0]
    np.testing.assert_allclose(force, [0, -torque, 0, 0, 0, 0], rtol=1e-12, atol=1e-12)


# ---- payload and base tilt ----------------------------------------------------------------------------------


def test_a_payload_adds_its_kinetic_energy_and_its_weight():
    centre, mass = np.array([0.03, -0.05, 0.12]), 2.5
    bare = tree("rx90b")
    robot = bare.with_effects([Payload(frame="tool0", mass=mass, centre=tuple(centre))])
    q = np.array([0.3, 0.7, 0.1, 0.2, -0.4, 0.5])
    data = bare.model.createData()
    jacobian = pin.computeFrameJacobian(bare.model, data, q, bare.model.getFrameId("tool0"), pin.LOCAL_WORLD_ALIGNED)
    arm = data.oMf[bare.model.getFrameId("tool0")].rotation @ centre
    velocity = jacobian[:3] - pin.skew(arm) @ jacobian[3:]
    added = robot.mass_matrix(q) - bare.mass_matrix(q)
    np.testing.assert_allclose(added, mass * velocity.T @ velocity, rtol=0, atol=1e-12 * np.abs(added).max())
    weight = robot.inverse_dynamics(q, 0 * q, 0 * q) - bare.inverse_dynamics(q, 0 * q, 0 * q)
    np.testing.assert_allclose(weight, mass * 9.81 * velocity[2], rtol=0, atol=1e-12 * np.abs(weight).max())


def test_base_tilt_is_the_gravity_of_a_turned_base_up_to_the_square_of_the_angle():
    angles = np.array([0.01, -0.02])
    bare = tree("rx90b")
    robot = bare.with_effects([BaseTilt(angle_x=angles[0], angle_y=angles[1])])
    q = np.array([0.3, 0.7, 0.1, 0.2, -0.4, 0.5])
    model = bare.model.copy()
    model.gravity.linear = pin.exp3(np.array([*angles, 0.0])).T @ np.array([0.0, 0.0, -9.81])
    exact = pin.computeGeneralizedGravity(model, model.createData(), q)
    level = bare.inverse_dynamics(q, 0 * q, 0 * q)
    tilted = robot.inverse_dynamics(q, 0 * q, 0 * q)
    assert np.abs(exact - tilted).max() <= 0.5 * (angles @ angles) * np.abs(level).max() * 1.1
    assert np.abs(exact - level).max() > 10 * np.abs(exact - tilted).max()


def test_a_tilted_base_turns_the_weight_of_what_is_carried():
    """Against pinocchio with the mass in its tree and gravity turned, to first order in the angles as here."""
    x, y, mass, centre = 0.02, -0.05, 4.0, np.array([0.03, -0.05, 0.12])
    bare = tree("rx90b")
    tilt, load = BaseTilt(angle_x=x, angle_y=y), Payload(frame="tool0", mass=mass, centre=tuple(centre))
    robot = bare.with_effects([tilt, load])
    model = bare.model.copy()
    place = model.frames[model.getFrameId("tool0")]
    model.appendBodyToJoint(place.parentJoint, pin.Inertia(mass, centre, np.zeros((3, 3))), place.placement)
    model.gravity.linear = 9.81 * np.array([y, -x, -1.0])
    data = model.createData()
    rng = np.random.default_rng(4)
    q, v, a = rng.normal(size=(3, 6))
    torque = pin.rnea(model, data, q, v, a)
    np.testing.assert_allclose(robot.inverse_dynamics(q, v, a), torque, rtol=0, atol=1e-10 * np.abs(torque).max())
    pin.computeRNEADerivatives(model, data, q, v, a)
    slope = robot.linearize(q, v, a).K
    np.testing.assert_allclose(slope, data.dtau_dq, rtol=0, atol=1e-10 * np.abs(slope).max())
    energy = pin.computeMechanicalEnergy(model, data, q, v) - pin.computeMechanicalEnergy(model, data, 0 * q, v)
    assert robot.energy(q, v) - robot.energy(0 * q, v) == pytest.approx(energy, rel=1e-10)
    # what a fit has found is carried, and not what the robot file declares
    motion = bare.with_effects([dataclasses.replace(load, mass=9.0)]).on_links(
        bare.motion(q, v, a), bare.link_parameters, effects=[load]
    )
    np.testing.assert_allclose(tilt.force(motion), tilt.force(robot.motion(q, v, a)), rtol=1e-10)
    assert np.abs(tilt.force(motion) - tilt.force(bare.motion(q, v, a))).max() > 0.1


def test_effects_that_move_coordinates_or_need_others_say_so():
    types = catalogue()
    assert [n for n, c in types.items() if c.traits.virtual] == [
        "base_flexibility",
        "drive_flexibility",
        "joint_flexibility",
    ]
    assert types["stiffness_hardening"].traits.needs == ("drive_flexibility",)


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (
            ("payload", {"frame": "tol0", "mass": 1.0, "centre": (0.0, 0.0, 0.0)}),
            r"tol0\.payload: unknown frame 'tol0'",
        ),
        (
            ("coulomb_friction", {"joint": "joint_7", "torque": 1.0}),
            r"joint_7\.coulomb_friction: unknown joint 'joint_7'",
        ),
        (("joint_coupling", {"joint_pair": ("joint_1", "joint_7")}), r"joint_coupling: unknown joint 'joint_7'"),
    ],
    ids=lambda x: x[0] if isinstance(x, tuple) else "",
)
def test_an_effect_on_what_the_robot_does_not_have_is_refused_before_the_engine_is_asked(effect, told):
    """The engine would read beyond its frames, and take the interpreter with it."""
    robot, (name, values) = load_robot("rx90b"), effect
    with pytest.raises(ValueError, match=told):
        robot.with_effects([*robot.effects, catalogue()[name](**values)])
