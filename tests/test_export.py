"""Claims about robots written to files."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest

from rx90b_flex.bodies import pseudo_inertia
from rx90b_flex.effects import Effect, effect_from_table
from rx90b_flex.export import save_robot, with_link_parameters
from rx90b_flex.files.toml import toml_text
from rx90b_flex.robot import Robot, load_robot


def scaled_error(found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest error of a body's parameters over its largest parameter."""
    found, wanted = found.reshape(-1, 10), wanted.reshape(-1, 10)
    size = np.abs(wanted).max(axis=1)
    return float((np.abs(found - wanted).max(axis=1) / np.where(size > 0, size, 1.0)).max())


def random_bodies(rng: np.random.Generator, bodies: int) -> np.ndarray:
    """Ten parameters a body, from random positive definite pseudo-inertias."""
    to_matrix = pseudo_inertia(np.eye(10)).reshape(10, 16).T
    out = []
    for _ in range(bodies):
        root = rng.normal(size=(4, 4)) * np.array([0.3, 0.2, 0.5, 2.0])[:, None]
        out.append(np.linalg.lstsq(to_matrix, (root @ root.T).ravel(), rcond=None)[0])
    return np.concatenate(out)


def states(robot: Robot, seed: int = 0, samples: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q, v, a = rng.uniform(-1, 1, (3, samples, robot.model.nv))
    return q, v, a


def effects_for(robot: Robot) -> tuple[Effect, ...]:
    """Effects of every form of place and value: joint, pair, list of values, unknown value."""
    a, b = robot.joints[:2]
    tables = [
        {"type": "drive_inertia", "joint": a, "inertia": 1.0 / 3.0},
        {"type": "stribeck_friction", "joint": b, "torque": 1e-5, "velocity": 0.1 + 0.2, "power": 1.0},
        {"type": "joint_coupling", "joints": [a, b], "inertia": 0.1, "viscous": 2, "coulomb": 1e17},
        {"type": "gear_ripple", "joint": a, "order": 7, "amplitude": 0.3, "phase": -2.0},
        {"type": "gear_ripple", "joint": a, "order": 9, "amplitude": 0.1, "phase": 1.0},
        {"type": "viscous_friction", "joint": b, "coefficient": 66.3},
    ]
    return tuple(effect_from_table(t, "test", robot.joints) for t in tables)


# ---- inertias into the URDF ---------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["example-robot-data:ur10", "example-robot-data:panda", "rx90b_rigid"])
def test_the_new_robot_has_the_given_parameters(source: str) -> None:
    robot = load_robot(source)
    wanted = random_bodies(np.random.default_rng(1), len(robot.bodies))
    changed = with_link_parameters(robot, wanted)
    assert scaled_error(changed.link_parameters, wanted) < 1e-12
    assert changed.bodies == robot.bodies
    assert changed.effects == robot.effects
    assert robot.link_parameters is not changed.link_parameters


def test_the_inverse_dynamics_are_those_of_the_regressor() -> None:
    robot = load_robot("example-robot-data:ur10")
    wanted = random_bodies(np.random.default_rng(2), len(robot.bodies))
    motion = states(robot)
    torque = with_link_parameters(robot, wanted).inverse_dynamics(*motion)
    np.testing.assert_allclose(torque, robot.regressor(*motion) @ wanted, rtol=0, atol=1e-12 * np.abs(torque).max())


def test_links_behind_fixed_joints_are_counted_once() -> None:
    # panda's hand is fixed to its last link
    robot = load_robot("example-robot-data:panda")
    same = with_link_parameters(robot, robot.link_parameters)
    assert scaled_error(same.link_parameters, robot.link_parameters) < 1e-12
    assert same.urdf.count("<inertial>") <= robot.urdf.count("<inertial>")
    twice = with_link_parameters(same, same.link_parameters)
    assert scaled_error(twice.link_parameters, robot.link_parameters) < 1e-12


def test_a_body_of_ten_zeros_is_written_without_inertia() -> None:
    robot = load_robot("example-robot-data:ur10")
    wanted = robot.link_parameters.copy()
    wanted[-10:] = 0.0
    assert not with_link_parameters(robot, wanted).link_parameters[-10:].any()


def test_a_rotor_without_mass_keeps_its_moments() -> None:
    robot = load_robot("example-robot-data:ur10")
    wanted = robot.link_parameters.copy()
    wanted[-10:] = [0, 0, 0, 0, 0.1, 0.2, 0.25, 0.01, 0, 0]
    assert scaled_error(with_link_parameters(robot, wanted).link_parameters, wanted) < 1e-12


def test_inconsistent_links_are_refused_with_link_and_eigenvalue() -> None:
    robot = load_robot("rx90b_rigid")
    smallest = [np.linalg.eigvalsh(pseudo_inertia(robot.link_parameters[i : i + 10]))[0] for i in (0, 10)]
    with pytest.raises(ValueError) as error:
        with_link_parameters(robot, robot.link_parameters)
    message = str(error.value)
    assert "\n" not in message
    for link, eigenvalue in zip(("link_1", "link_2"), smallest, strict=True):
        assert f"{link}: the smallest eigenvalue of the pseudo-inertia is {eigenvalue:.4g}" in message
    assert "link_3" not in message
    allowed = with_link_parameters(robot, robot.link_parameters, allow_inconsistent=True)
    assert scaled_error(allowed.link_parameters, robot.link_parameters) < 1e-12


@pytest.mark.parametrize("mass", [0.0, -0.1])
def test_a_mass_that_a_urdf_cannot_hold_is_refused_even_if_inconsistency_is_allowed(mass: float) -> None:
    robot = load_robot("example-robot-data:ur10")
    wanted = robot.link_parameters.copy()
    wanted[20:24] = [mass, 0.1, 0.0, 0.0]
    link = robot.bodies[2][0]
    with pytest.raises(ValueError, match=rf"{link}: a URDF holds .* a mass of {mass:g} kg cannot be written"):
        with_link_parameters(robot, wanted, allow_inconsistent=True)


def test_a_wrong_number_of_parameters_is_refused() -> None:
    robot = load_robot("example-robot-data:ur10")
    with pytest.raises(ValueError, match=r"shape \(59,\); expected \(60,\)"):
        with_link_parameters(robot, robot.link_parameters[:-1])


# ---- robot files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["example-robot-data:ur10", "example-robot-data:panda", "rx90b_rigid"])
def test_a_saved_robot_comes_back(source: str, tmp_path: Path) -> None:
    robot = load_robot(source)
    robot = with_link_parameters(robot, random_bodies(np.random.default_rng(3), len(robot.bodies)))
    robot = dataclasses.replace(robot.with_effects(effects_for(robot)), inertial_parameters="known")
    path = save_robot(robot, tmp_path / "new" / "folder")
    assert sorted(p.name for p in path.parent.iterdir()) == ["robot.toml", "robot.urdf"]
    back = load_robot(path)
    for name in ("name", "tip_frame", "inertial_parameters", "effects", "parameter_names", "bodies", "joints"):
        assert getattr(back, name) == getattr(robot, name)
    np.testing.assert_array_equal(back.link_parameters, robot.link_parameters)
    np.testing.assert_array_equal(back.parameters, robot.parameters)
    motion = states(robot)
    torque = robot.inverse_dynamics(*motion)
    np.testing.assert_allclose(back.inverse_dynamics(*motion), torque, rtol=0, atol=1e-12 * np.abs(torque).max())


def test_a_robot_saved_twice_gives_the_same_files(tmp_path: Path) -> None:
    robot = load_robot("example-robot-data:ur10")
    first = save_robot(robot, tmp_path / "a", "arm.toml")
    second = save_robot(load_robot(first), tmp_path / "b", "arm.toml")
    assert first.read_text() == second.read_text()
    assert first.with_suffix(".urdf").read_text() == second.with_suffix(".urdf").read_text()


def test_values_that_are_not_known_stay_unknown(tmp_path: Path) -> None:
    robot = load_robot("example-robot-data:ur10")
    table = {"type": "viscous_friction", "joint": robot.joints[0]}
    robot = robot.with_effects([effect_from_table(table, "test", robot.joints)])
    back = load_robot(save_robot(robot, tmp_path))
    assert np.isnan(back.effects[0].coefficients).all()


def test_a_robot_that_cannot_exist_is_refused_or_says_so_in_its_file(tmp_path: Path) -> None:
    robot = load_robot("rx90b_rigid")
    with pytest.raises(ValueError, match=r"rx90b.*link_1: the smallest eigenvalue of the pseudo-inertia is -0\.0"):
        save_robot(robot, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    path = save_robot(robot, tmp_path / "out", allow_inconsistent=True)
    first, second = path.read_text().splitlines()[:2]
    assert first.startswith("# not physically consistent") and "link_1" in first and "link_2" in second
    assert scaled_error(load_robot(path).link_parameters, robot.link_parameters) < 1e-12


@pytest.mark.parametrize("file_name", ["robot", "robot.urdf", "../robot.toml"])
def test_a_file_name_that_would_not_load_is_refused(file_name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="file_name is"):
        save_robot(load_robot("example-robot-data:ur10"), tmp_path, file_name)


def test_a_folder_that_cannot_be_written_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").mkdir()  # a folder where the URDF should go
    with pytest.raises(ValueError, match="cannot be written"):
        save_robot(load_robot("example-robot-data:ur10"), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["robot.urdf"]


@pytest.mark.parametrize(
    "value",
    [
        'quote " and \\ backslash',
        "tab\tnewline\nDEL\x7fzero\x00",
        "ü 関節",
        [[0.0, 0.1], [1e-300, -3.0]],
        True,
        7,
        1e22,
    ],
)
def test_toml_values_come_back(value: object) -> None:
    back = tomllib.loads(toml_text({"x": value}))["x"]
    assert back == value and type(back) is type(value)


def test_names_with_quotes_and_backslashes_survive(tmp_path: Path) -> None:
    robot = dataclasses.replace(load_robot("example-robot-data:ur10"), name='the "left"\\arm')
    assert load_robot(save_robot(robot, tmp_path)).name == robot.name
