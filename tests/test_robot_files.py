"""Claims about what `load_robot` reads, and what it refuses and how it says so."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from independent import TWO_JOINTS, ur10

import rx90b_flex as rf
from rx90b_flex.effects import catalogue
from rx90b_flex.robot import robot_names, robots_folder

HEAD = 'name = "mine"\nurdf = "two_joints.urdf"\n'
COULOMB = '[[effects]]\ntype = "coulomb_friction"\njoint = "elbow"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the URDF of an arm of two joints."""
    (tmp_path / "two_joints.urdf").write_text(TWO_JOINTS)
    return tmp_path


def written(folder: Path, text: str) -> Path:
    path = folder / "robot.toml"
    path.write_text(text)
    return path


def refusal(source: Path | str) -> str:
    """The one line that a robot is refused with."""
    with pytest.raises(ValueError) as caught:
        rf.load_robot(source)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# ---- what is read -------------------------------------------------------------------------------------------


def test_a_name_is_a_robot_that_comes_with_the_package():
    assert "rx90b" in robot_names()
    robot = rf.load_robot("rx90b")
    assert (robot.name, robot.tip_frame) == ("rx90b", "tool0")
    assert robot.joints == tuple(f"joint_{i}" for i in range(1, 7))


@pytest.mark.parametrize("name", robot_names())
def test_every_robot_of_the_package_loads_and_has_dynamics(name):
    robot = rf.load_robot(name)
    assert robot.name == name
    assert np.isfinite(robot.inverse_dynamics(*np.zeros((3, robot.model.nv)))).all()


def test_a_robot_of_the_package_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert rf.load_robot("rx90b").joints == rf.load_robot(robots_folder() / "rx90b.toml").joints


def test_a_robot_file_gives_name_tip_and_effects_with_their_values(folder):
    text = HEAD + 'tip_frame = "lower"\ninertial_parameters = "known"\n' + COULOMB + "torque = 1.5\n"
    robot = rf.load_robot(written(folder, text))
    assert (robot.name, robot.tip_frame, robot.inertial_parameters) == ("mine", "lower", "known")
    assert [(e.label, e.torque) for e in robot.effects] == [("elbow.coulomb_friction", 1.5)]


def test_a_robot_file_needs_only_a_urdf(folder):
    robot = rf.load_robot(written(folder, 'urdf = "two_joints.urdf"\n'))
    assert (robot.name, robot.inertial_parameters, robot.effects) == ("robot", "fitted", ())
    assert robot.joints == ("shoulder", "elbow")


def test_the_urdf_of_a_robot_file_is_relative_to_the_file(folder, monkeypatch):
    (folder / "deeper").mkdir()
    path = written(folder / "deeper", 'urdf = "../two_joints.urdf"\n')
    monkeypatch.chdir("/")
    assert rf.load_robot(path).joints == ("shoulder", "elbow")


def test_a_value_that_is_left_out_is_not_a_number_until_identified(folder):
    robot = rf.load_robot(written(folder, HEAD + COULOMB))
    assert np.isnan(robot.parameters[robot.parameter_names.index("elbow.coulomb_friction.torque")])
    with pytest.raises(ValueError, match=r"elbow\.coulomb_friction: torque has no value; give it in the robot file"):
        robot.inverse_dynamics(*np.zeros((3, 2)))


def test_dry_frictions_of_a_joint_have_the_turnover_that_one_of_them_states(folder):
    fading = COULOMB.replace("coulomb", "stribeck")
    robot = rf.load_robot(written(folder, f"{HEAD}{COULOMB}turnover = 0.01\n{fading}"))
    assert [e.turnover for e in robot.effects] == [0.01, 0.01]
    line = refusal(written(folder, f"{HEAD}{COULOMB}turnover = 0.01\n{fading}turnover = 0.02\n"))
    assert "effect 2: elbow.stribeck_friction has turnover = 0.02, another effect there 0.01" in line


def test_values_that_do_not_go_together_are_refused_with_file_and_effect(folder):
    pairs = "torques = [1.0, 2.0]\nstiffnesses = [100.0]\n"
    line = refusal(written(folder, HEAD + COULOMB.replace("coulomb_friction", "maxwell_slip_friction") + pairs))
    assert "robot.toml: effect 1" in line and "2 torques and 1 stiffnesses" in line


def test_a_plain_urdf_is_a_robot_without_effects(folder):
    robot = rf.load_robot(folder / "two_joints.urdf")
    assert (robot.name, robot.effects, robot.tip_frame) == ("two_joints", (), "lower")


def test_a_named_example_robot_is_the_tree_of_example_robot_data():
    robot, model = rf.load_robot("example-robot-data:ur10"), ur10().model
    assert robot.joints == tuple(model.names)[1:]
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-1, 1, (3, 6))
    expected = pin.rnea(model, model.createData(), q, v, a)
    np.testing.assert_allclose(robot.inverse_dynamics(q, v, a), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_robot_file_may_name_an_example_robot(folder):
    robot = rf.load_robot(written(folder, 'urdf = "example-robot-data:ur10"\n'))
    assert robot.joints[2] == "elbow_joint"


def test_effects_of_one_type_may_repeat_on_other_joints(folder):
    robot = rf.load_robot(written(folder, HEAD + COULOMB + COULOMB.replace("elbow", "shoulder")))
    assert [e.label for e in robot.effects] == ["elbow.coulomb_friction", "shoulder.coulomb_friction"]


def test_gear_ripple_may_repeat_on_one_joint_with_other_orders(folder):
    ripple = '[[effects]]\ntype = "gear_ripple"\njoint = "elbow"\norder = {}\namplitude = 1.0\nphase = 0.0\n'
    robot = rf.load_robot(written(folder, HEAD + ripple.format(3) + ripple.format(5)))
    names = robot.parameter_names
    assert len(set(names)) == len(names) and len(robot.effects) == 2


# ---- what is refused ----------------------------------------------------------------------------------------


def effect(type_name: str, **values: object) -> str:
    lines = "".join(f"{key} = {value}\n" for key, value in values.items())
    return f'[[effects]]\ntype = "{type_name}"\n{lines}'


REFUSED = {
    "an unknown key": ('tipframe = "x"\n', "unknown key 'tipframe'; did you mean 'tip_frame'?"),
    "a key of the wrong kind": ("tip_frame = 3\n", "tip_frame is 3; expected a string"),
    "an unknown frame": ('tip_frame = "lowr"\n', "unknown tip_frame 'lowr'; did you mean 'lower'?"),
    "inertias neither known nor fitted": (
        'inertial_parameters = "guess"\n',
        "inertial_parameters is 'guess'; expected 'fitted' or 'known'",
    ),
    "effects that are no tables": ("effects = 3\n", "effects is int; expected [[effects]] tables"),
    "an effect that is no table": ("effects = [3]\n", "effect 1 is 3; expected a table"),
    "an effect without a type": ('[[effects]]\njoint = "elbow"\n', "effect 1: key 'type' is missing"),
    "an unknown effect type": (
        effect("stribek_friction", joint='"elbow"'),
        "effect 1: unknown effect type 'stribek_friction'; did you mean 'stribeck_friction'?",
    ),
    "an effect type that is no text": (
        "[[effects]]\ntype = 3\n",
        "effect 1: unknown effect type 3; expected one of: angle_curve",
    ),
    "an effect type that is a list": (
        '[[effects]]\ntype = ["coulomb_friction"]\n',
        "effect 1: unknown effect type ['coulomb_friction']",
    ),
    "an unknown joint": (
        effect("coulomb_friction", joint='"elbwo"'),
        "effect 1 (coulomb_friction): unknown joint 'elbwo'; did you mean 'elbow'?",
    ),
    "a joint that is nothing like one": (
        effect("coulomb_friction", joint='"xyz"'),
        "unknown joint 'xyz'; expected one of: shoulder, elbow",
    ),
    "a joint that is a list": (effect("coulomb_friction", joint='["elbow"]'), "unknown joint ['elbow']"),
    "an effect without its joint": (effect("coulomb_friction"), "effect 1 (coulomb_friction): key 'joint' is missing"),
    "an unknown parameter": (
        effect("coulomb_friction", joint='"elbow"', torqe=1),
        "effect 1 (coulomb_friction): unknown key 'torqe'; did you mean 'torque'?",
    ),
    "joints for an effect on one joint": (
        effect("coulomb_friction", joints='["elbow", "shoulder"]'),
        "unknown key 'joints'; did you mean 'joint'?",
    ),
    "one joint for an effect on two": (
        effect("joint_coupling", joints='"elbow"'),
        "joints is 'elbow'; expected two different joints [a, b]",
    ),
    "the same joint twice": (
        effect("joint_coupling", joints='["elbow", "elbow"]'),
        "joints is ['elbow', 'elbow']; expected two different joints [a, b]",
    ),
    "an unknown joint of two": (
        effect("joint_coupling", joints='["elbow", "shouldr"]'),
        "unknown joint 'shouldr'; did you mean 'shoulder'?",
    ),
    "an unknown frame of an effect": (
        effect("payload", frame='"uper"'),
        "effect 1 (payload): unknown frame 'uper'; did you mean 'upper'?",
    ),
    "a value that is text": (
        effect("coulomb_friction", joint='"elbow"', torque='"1"'),
        "effect 1 (coulomb_friction): torque is '1'; expected one finite number in N m",
    ),
    "a value that is a truth value": (
        effect("coulomb_friction", joint='"elbow"', torque="true"),
        "torque is True; expected one finite number in N m",
    ),
    "a value that is not finite": (
        effect("coulomb_friction", joint='"elbow"', torque="nan"),
        "torque is nan; expected one finite number in N m",
    ),
    "a list for one number": (
        effect("coulomb_friction", joint='"elbow"', torque="[1.0]"),
        "torque is [1.0]; expected one finite number in N m",
    ),
    "one number for a list": (
        effect("payload", frame='"lower"', mass=1, centre=0.1),
        "centre is 0.1; expected 3 finite numbers in m",
    ),
    "negative friction": (
        effect("coulomb_friction", joint='"elbow"', torque=-1.0),
        "torque is -1.0; expected at least 0 N m",
    ),
    "a power that is out of range": (
        effect("viscous_power_friction", joint='"elbow"', coefficient=1, power=5),
        "power is 5; expected 0.1 to 3",
    ),
    "a Stribeck velocity of zero": (
        effect("stribeck_friction", joint='"elbow"', torque=1, velocity=0, power=1),
        "velocity is 0; expected 1e-09 to 1000 rad/s",
    ),
    "a load friction that turns over along an angle of less than none": (
        effect("load_friction", joint='"elbow"', coefficient=0.1, deflection=-0.001),
        "load_friction): deflection is -0.001; expected at least 1e-09 rad",
    ),
    "a position friction that turns over along an angle and within a velocity": (
        effect("position_friction", joint='"elbow"', order=2, amplitude=1, phase=0, deflection=0.001, turnover=0.01),
        "position_friction): unknown key 'turnover'; expected one of: type, joint, order, amplitude, phase, deflection",
    ),
    "a Stribeck friction that turns over along no angle": (
        effect("stribeck_friction", joint='"elbow"', torque=1, velocity=0.1, power=1, deflection=0),
        "deflection is 0; expected at least 1e-09 rad",
    ),
    "a Stribeck friction that turns over in two ways": (
        effect("stribeck_friction", joint='"elbow"', torque=1, deflection=0.001, turnover=0.01),
        "unknown key 'turnover'",
    ),
    "an effect that is declared twice": (
        COULOMB + COULOMB,
        "effect 2: elbow.coulomb_friction is declared twice",
    ),
    "two effects that stand in for each other": (
        effect("viscous_friction", joint='"elbow"') + effect("viscous_power_friction", joint='"elbow"'),
        "effect 2: viscous_power_friction and viscous_friction exclude each other on one joint",
    ),
    "two effects that stand in for each other, the other way round": (
        effect("viscous_power_friction", joint='"elbow"') + effect("viscous_friction", joint='"elbow"'),
        "effect 2: viscous_friction and viscous_power_friction exclude each other on one joint",
    ),
    "a file that is no TOML": ("name = = 3\n", "not a TOML file"),
}


@pytest.mark.parametrize(("text", "expected"), REFUSED.values(), ids=REFUSED.keys())
def test_a_robot_file_is_refused_with_a_line_that_names_file_and_thing(folder, text, expected):
    path = written(folder, 'urdf = "two_joints.urdf"\n' + text)
    message = refusal(path)
    assert message.startswith(f"{path}: ")
    assert expected in message


def test_the_number_of_a_wrong_effect_counts_from_the_first(folder):
    path = written(folder, HEAD + COULOMB + effect("viscous_friction", joint='"elbow"') + effect("nonsense"))
    assert f"{path}: effect 3: unknown effect type 'nonsense'" in refusal(path)


@pytest.mark.parametrize("name", [n for n, c in catalogue().items() if c.traits.on == "joint"])
def test_every_effect_type_on_a_joint_refuses_a_joint_that_is_not_there(folder, name):
    path = written(folder, HEAD + effect(name, joint='"wrist"'))
    assert f"{path}: effect 1 ({name}): unknown joint 'wrist'" in refusal(path)


def test_a_robot_file_without_urdf_is_refused(folder):
    assert refusal(path := written(folder, 'name = "x"\n')) == f"{path}: key 'urdf' is missing"


def test_a_urdf_that_is_not_there_is_named_with_the_robot_file(folder):
    message = refusal(path := written(folder, 'urdf = "other.urdf"\n'))
    assert message.startswith(f"{path}: urdf: ") and "other.urdf" in message


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no XML",
        "<robot",
        "<robot name='x'><link name='a'/><link name='a'/></robot>",
        "<html><body/></html>",
        "<robot name='x'></robot>",
        "<robot name='x'><link name='a'/></robot>",
        TWO_JOINTS.replace('<child link="lower"/>', '<child link="hand"/>'),
        TWO_JOINTS.replace('<mass value="4"/>', '<mass value="heavy"/>'),
        TWO_JOINTS.replace('<mass value="4"/>', '<mass value="nan"/>'),
        TWO_JOINTS.replace('type="revolute"', 'type="ball"'),
        TWO_JOINTS.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'),
    ],
    ids=[
        "empty",
        "text",
        "cut off",
        "a link twice",
        "another XML",
        "no link",
        "no moving joint",
        "a link that is not there",
        "a mass that is no number",
        "a mass that is not finite",
        "an unknown kind of joint",
        "an axis of no length",
    ],
)
def test_an_unreadable_urdf_is_refused_with_one_line_that_names_it(tmp_path, text, capfd):
    path = tmp_path / "broken.urdf"
    path.write_text(text)
    assert str(path) in refusal(path)
    assert capfd.readouterr() == ("", "")  # no parser complains beside it


def test_an_unknown_name_is_refused_with_the_nearest_one():
    assert refusal("rx90c") == "unknown robot 'rx90c': no such file, and did you mean 'rx90b'?"


def test_an_unknown_example_robot_is_named():
    message = refusal("example-robot-data:ur11")
    assert "example-robot-data:ur11" in message
    assert re.search(r"ur10|expected|no such|unknown", message)


def test_a_robot_file_that_is_not_there_is_named(tmp_path):
    assert refusal(tmp_path / "none.toml") == f"{tmp_path / 'none.toml'}: no such robot file"


def test_a_folder_is_no_robot(tmp_path):
    assert refusal(tmp_path) == f"{tmp_path} is a folder; expected a robot file or a URDF"


def test_a_binary_robot_file_is_refused(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    assert refusal(path).startswith(f"{path}: cannot be read: ")
