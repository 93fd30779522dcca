"""Claims about controller files of cascades: what they order is a position loop around a velocity loop."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from rx90b_flex.export import save_robot
from rx90b_flex.robot import load_robot
from rx90b_flex.simulate import design_cs8, load_cs8, save_cs8, simulate, square_wave
from rx90b_flex.simulate.closed_loop import hermite
from rx90b_flex.simulate.command import controller_of

HEAD = "reference_rate_hz = 500.0\ncontroller_rate_hz = 4000.0\nlog_rate_hz = 500.0\nlog_cutoff_hz = 180.0\n"
LOOPS = {"position_loop": 25.0, "velocity_loop": 900.0, "integral_time_s": 0.04, "torque_limit": 900.0}


def controller_file(folder: Path, **numbers: float) -> Path:
    joints = ("joint_1", "joint_2", "joint_3")
    lines = "\n".join(f"{key} = {value}" for key, value in (LOOPS | numbers).items())
    file = folder / "controller.toml"
    file.write_text(HEAD + "".join(f'[[cascade]]\nname = "{j}"\n{lines}\n' for j in joints))
    return file


@pytest.mark.parametrize("numbers", [{}, {"velocity_feedforward": 0.6, "inertia_feedforward": 3.0}])
def test_the_torque_is_what_two_loops_order(tmp_path: Path, numbers: dict[str, float]) -> None:
    """Of the angles and speeds that a run shows, by the loops as they stand in the file, sample by sample."""
    controller = load_cs8(controller_file(tmp_path, **numbers))
    robot = load_robot("rx90b_3dof")
    reference = square_wave(robot, [0.0, 0.5 * np.pi, 1.0], moving=robot.joints, rate_hz=500.0).part(0.0, 1.5)
    run = simulate(robot, controller, reference, raw=True)
    assert run.ended is None and run.raw is not None
    rows = np.arange(len(reference.position))
    position, speed, _ = hermite(reference.position, reference.velocity, rows, np.arange(8) / 8, 500.0)
    acceleration = np.gradient(speed, 1.0 / 4000.0, axis=0)
    f, inertia = numbers.get("velocity_feedforward", 0.0), numbers.get("inertia_feedforward", 0.0)
    asked = LOOPS["position_loop"] * (position - run.raw.position) + f * speed - run.raw.velocity
    integral = np.cumsum(asked, axis=0) / 4000.0
    torque = LOOPS["velocity_loop"] * (asked + integral / LOOPS["integral_time_s"]) + inertia * acceleration
    apart = (torque - run.raw.torque)[:-8]  # behind the last reference there is none to be interpolated to
    # the integrator's start is a constant; sums differ from integrals by half a sample of the speeds' change
    half = 0.5 / 4000.0 * LOOPS["velocity_loop"] / LOOPS["integral_time_s"] * np.ptp(run.raw.velocity, axis=0)
    # a straight line between two references' accelerations is off by no more than their own change
    bend = inertia * np.abs(np.diff(acceleration[::8], axis=0)).max(axis=0)
    assert (np.abs(apart - apart[0]).max(axis=0) < 2.0 * half + bend + 1e-6).all()
    assert (np.ptp(run.raw.torque, axis=0) > 10.0 * (2.0 * half + bend)).all()  # a loop left out would be seen


def test_a_robot_has_the_controller_that_its_file_states_and_none_by_its_name(tmp_path: Path) -> None:
    own = controller_file(tmp_path)
    robot = load_robot("rx90b_3dof")
    stating = save_robot(
        dataclasses.replace(robot, controller="controller.toml"), tmp_path, "stating.toml", allow_inconsistent=True
    )
    silent = save_robot(dataclasses.replace(robot, controller=""), tmp_path, "silent.toml", allow_inconsistent=True)
    assert controller_of(load_robot(stating), None) == load_cs8(own)
    assert controller_of(load_robot(silent), None) == design_cs8(robot)
    again = save_robot(robot, tmp_path / "elsewhere", allow_inconsistent=True)  # the package's own goes by name
    assert controller_of(load_robot(again), None) == load_cs8().for_joints(robot.joints)


def test_a_robot_whose_file_states_another_robot_s_controller_is_one_line(tmp_path: Path) -> None:
    own = controller_file(tmp_path)
    with pytest.raises(ValueError, match=r"controller.toml: the controller has no joint 'joint_4'"):
        controller_of(dataclasses.replace(load_robot("rx90b_4dof"), controller=str(own)), None)


def test_a_cascade_that_is_saved_comes_back(tmp_path: Path) -> None:
    controller = load_cs8(controller_file(tmp_path, velocity_feedforward=0.5))
    save_cs8(controller, tmp_path / "again.toml")
    assert load_cs8(tmp_path / "again.toml") == controller


def test_a_wrong_cascade_is_one_line_that_names_file_and_key(tmp_path: Path) -> None:
    for numbers, words in (
        ({"velocity_feedforward": 1.5}, r"\[\[cascade\]\] 1: velocity_feedforward is 1.5; expected 0 to 1"),
        ({"velocity_lop": 1.0}, r"controller.toml: \[\[cascade\]\] 1 'velocity_lop': unknown key"),
        ({"integral_time_s": -1.0}, "integral_time_s: found -1, a number of 0 or more"),
    ):
        with pytest.raises(ValueError, match=words):
            load_cs8(controller_file(tmp_path, **numbers))


def test_a_joint_that_a_controller_file_names_twice_is_refused(tmp_path: Path) -> None:
    """The last of its tables was taken, silently."""
    file = controller_file(tmp_path)
    file.write_text(file.read_text().replace("joint_3", "joint_1"))
    expected = (
        r"controller.toml: \[\[cascade\]\] 3 name: 'joint_1' stands in a table before; one \[\[cascade\]\] a joint"
    )
    with pytest.raises(ValueError, match=expected):
        load_cs8(file)
