"""Static stiffness: table 4.1 from the simulated rig, honest intervals, hysteresis, and dead-weight tests as files."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from scipy import stats

import rx90b_flex as rf
from rx90b_flex.identify.static_command import fit_tests, read_static_tests
from rx90b_flex.identify.static_stiffness import StaticStiffness, fit_static_stiffness, hysteresis_area
from rx90b_flex.robot import Robot
from rx90b_flex.signals.static_test import StaticTest, read_static_table
from rx90b_flex.simulate.static_rig import (
    RigStates,
    StaticRig,
    hinges,
    load_robot_on_rig,
    read_markers,
    standstill_friction,
    static_rig,
)
from rx90b_flex.view.static_plots import static_test_figure
from rx90b_flex.view.static_report import headline

# Table 4.1, N m/rad: torsion, then the two bendings.
TABLE_4_1 = {
    f"joint_{j}:{kind}": k
    for j, values in enumerate([(2.8e5, 4.4e5), (2.7e5, 2.4e5), (1.0e5, 2.1e5), (0.9e5, 1.6e5)], start=1)
    for kind, k in zip(("torsion", "bend_1", "bend_2"), (values[0], values[1], values[1]), strict=True)
}

Loaded = dict[str, tuple[StaticRig, RigStates]]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return rf.load_robot("rx90b_4dof")


@pytest.fixture(scope="module")
def loaded(robot: Robot) -> Loaded:
    rigs = {coordinate: static_rig(robot, coordinate) for coordinate in TABLE_4_1}
    return {coordinate: (rig, load_robot_on_rig(robot, rig)) for coordinate, rig in rigs.items()}


def table(noise: float, rng: np.random.Generator, stiffness: float = 2.0e5, lag: float = 0.0) -> StaticTest:
    """Seven steps of 25 N m up and down; unloading lags by that moment."""
    moment = 25.0 * np.concatenate([np.arange(8), np.arange(6, -1, -1)])
    rising = np.arange(15) < 8
    deformation = (moment + np.where(rising, 0.0, lag)) / stiffness
    return StaticTest("hinge", moment, deformation + noise * rng.standard_normal(15), rising)


# ---- the rig --------------------------------------------------------------------------------------------------


def test_the_robot_has_the_twelve_hinges_of_table_4_1(robot: Robot) -> None:
    assert hinges(robot) == tuple(TABLE_4_1)


@pytest.mark.parametrize("coordinate", TABLE_4_1)
def test_the_rig_loads_one_hinge_of_its_joint_alone(robot: Robot, loaded: Loaded, coordinate: str) -> None:
    rig, states = loaded[coordinate]
    moment = np.cross(rig.point - rig.origin, rig.pull)
    np.testing.assert_allclose(moment, rig.lever_arm * rig.axis, atol=1e-12)
    joint = coordinate.split(":")[0]
    own = [i for i, name in enumerate(robot.coordinates) if name.startswith(joint + ":") and name in TABLE_4_1]
    change = np.abs(states.q[7] - states.q[0])[own]
    loaded = [robot.coordinates[i] for i in own].index(coordinate)
    # the others see what deformations of 1e-3 rad elsewhere turn of the load: a few per mille
    assert np.delete(change, loaded).max() < 0.01 * change[loaded]


@pytest.mark.parametrize("coordinate", TABLE_4_1)
def test_the_rigs_states_are_equilibria_of_the_flexible_model(robot: Robot, loaded: Loaded, coordinate: str) -> None:
    rig, states = loaded[coordinate]
    rest = np.zeros_like(states.q)
    # the cable's share by virtual work: how much nearer to the pulley each coordinate brings its end
    force = robot.inverse_dynamics(states.q, rest, rest)
    step = 1e-6
    for row in (7,):
        for i, name in enumerate(robot.coordinates):
            if name.endswith(":drive"):
                continue
            moved = [states.q[row].copy() for _ in range(2)]
            moved[0][i] += step
            moved[1][i] -= step
            nearer = (cable_length(robot, rig, moved[1]) - cable_length(robot, rig, moved[0])) / (2 * step)
            # 1e-3 N m: central differences of lengths of 2 m at 1e-6 rad are good to 1e-9 m
            assert abs(force[row, i] - states.tension[row] * nearer) < 1e-3


def cable_length(robot: Robot, rig: StaticRig, q: np.ndarray) -> float:
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.input_matrix @ rig.pose)
    last = model.njoints - 1
    local = data.oMi[last].actInv(rig.point)
    pin.forwardKinematics(model, data, q)
    return float(np.linalg.norm(rig.pulley - data.oMi[last].act(local)))


def test_table_4_1_is_recovered_and_covered_by_95_percent_of_the_intervals(loaded: Loaded) -> None:
    rng = np.random.default_rng(4)
    for coordinate, stiffness in TABLE_4_1.items():
        found = [fit_static_stiffness(t) for t in read_markers(*loaded[coordinate], rng, repeats=200)]
        covered = np.mean([f.interval[0] <= stiffness <= f.interval[1] for f in found])
        assert 0.90 <= covered <= 1.0, (coordinate, covered)
        # the slopes' mean lies within four of its standard errors
        slopes = np.array([1.0 / f.stiffness for f in found])
        assert abs(slopes.mean() * stiffness - 1.0) < 4.0 * slopes.std() * stiffness / np.sqrt(200.0), coordinate


def test_without_noise_the_rig_gives_the_stiffness_but_for_the_weight_that_the_bending_lifts(loaded: Loaded) -> None:
    for coordinate, stiffness in TABLE_4_1.items():
        (test,) = read_markers(*loaded[coordinate], np.random.default_rng(0), marker_std=0.0)
        # upright on joint 1, 89 kg at 0.8 m or less push over what bends: m g h / k < 2e-3; elsewhere less
        assert abs(fit_static_stiffness(test).stiffness / stiffness - 1.0) < 2e-3, coordinate


def test_the_angle_of_0_6e_4_rad_is_that_of_four_markers_at_0_5_m(robot: Robot) -> None:
    rig = static_rig(robot, "joint_2:torsion")
    states = load_robot_on_rig(robot, rig, heaviest_kg=0.0)
    tests = read_markers(rig, states, np.random.default_rng(0), repeats=400)
    spread = np.std([t.deformation[1:] - t.deformation[1:].mean() for t in tests]) * np.sqrt(14 / 13)
    assert 1.96 * spread == pytest.approx(0.6e-4, rel=0.1)  # the source rounds 0.56e-4 to one digit


def test_friction_of_the_model_opens_a_loop_at_the_drive_and_none_at_the_bearings(robot: Robot) -> None:
    friction = standstill_friction(robot)
    rng = np.random.default_rng(1)
    rig = static_rig(robot, "joint_3:torsion")
    (test,) = read_markers(rig, load_robot_on_rig(robot, rig, friction=friction), rng)
    found = fit_static_stiffness(test)
    assert found.p_value < 1e-3
    assert found.hysteresis_area > 3 * found.hysteresis_std
    # as in figures 4.2(b) and (e): smaller with rising load
    assert found.loading.deformation < found.unloading.deformation
    bend = static_rig(robot, "joint_3:bend_2")
    (test,) = read_markers(bend, load_robot_on_rig(robot, bend, friction=friction), rng)
    assert abs(fit_static_stiffness(test).hysteresis_area) < 4 * fit_static_stiffness(test).hysteresis_std


def test_skipping_what_sticks_takes_the_friction_out_of_the_stiffness(robot: Robot) -> None:
    friction = standstill_friction(robot)
    rig = static_rig(robot, "joint_3:torsion")
    states = load_robot_on_rig(robot, rig, friction=friction)
    (test,) = read_markers(rig, states, np.random.default_rng(0), marker_std=0.0)
    place = robot.coordinates.index("joint_3:torsion")
    # one step of the load is 14 N m; 8.1 N m of friction slide within one step up, 16.2 within two down
    skip = int(np.ceil(2 * friction[place] / np.diff(test.moment)[0]))
    assert abs(fit_static_stiffness(test, skip=skip).stiffness / 1.0e5 - 1.0) < 1e-3
    assert fit_static_stiffness(test).stiffness / 1.0e5 - 1.0 > 0.01


def test_the_loop_of_dry_friction_has_its_area(robot: Robot) -> None:
    rig = static_rig(robot, "joint_3:torsion")
    place = robot.coordinates.index("joint_3:torsion")
    friction = standstill_friction(robot) * (np.arange(robot.model.nv) == place)
    states = load_robot_on_rig(robot, rig, friction=friction, steps=35)
    (test,) = read_markers(rig, states, np.random.default_rng(0), marker_std=0.0)
    torque, k = friction[place], 1.0e5
    top = test.moment.max()
    # slides by (top - torque) / k up and by (top - 2 torque) / k down; friction keeps torque^2 / 2k of the spring's
    # energy at the end. Polygons cut corners: step^2 / 2k each, 3e-3 of the area for steps of 2.8 N m
    lost = torque * (2 * top - 3 * torque) / k + 0.5 * torque**2 / k
    assert hysteresis_area(test)[0] == pytest.approx(lost, rel=6e-3)


def test_friction_of_the_pulley_tilts_the_two_directions_apart(robot: Robot) -> None:
    rig = static_rig(robot, "joint_2:torsion")
    states = load_robot_on_rig(robot, rig, pulley_friction=0.05)
    (test,) = read_markers(rig, states, np.random.default_rng(0), marker_std=0.0)
    found = fit_static_stiffness(test)
    assert found.loading.stiffness / found.unloading.stiffness == pytest.approx(1.05 / 0.95, rel=1e-3)


def test_a_drift_of_the_camera_opens_a_loop_that_runs_the_wrong_way_round(loaded: Loaded) -> None:
    rng = np.random.default_rng(9)
    (test,) = read_markers(*loaded["joint_1:torsion"], rng, drift=-2e-4)
    found = fit_static_stiffness(test)
    assert found.p_value < 1e-3
    assert found.hysteresis_area < -3 * found.hysteresis_std
    assert found.loading.deformation > found.unloading.deformation


def test_a_hinge_that_the_robot_lacks_is_named(robot: Robot) -> None:
    with pytest.raises(ValueError, match=r"joint_2:bend_3.*joint_2:bend"):
        static_rig(robot, "joint_2:bend_3")


# ---- the fit --------------------------------------------------------------------------------------------------


def test_p_values_of_one_line_are_evenly_spread() -> None:
    rng = np.random.default_rng(2)
    found = [fit_static_stiffness(table(3e-5, rng)) for _ in range(500)]
    for name in ("p_value", "slope_p_value"):
        # a true hypothesis fails this in one of 1000
        assert stats.kstest([getattr(f, name) for f in found], "uniform").pvalue > 1e-3, name


@pytest.mark.parametrize("response", ["deformation", "moment"])
def test_rounding_is_no_friction(response: Literal["deformation", "moment"]) -> None:
    """Readings that lie on a line but for their last binary digit."""
    load = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 50.0, 40.0, 30.0, 20.0, 10.0, 0.0])
    test = StaticTest("hinge", 0.5 * load, np.round(1e-4 * load, 6), np.arange(12) < 6)
    found = fit_static_stiffness(test, response=response)
    assert found.stiffness == pytest.approx(5000.0)
    assert (found.p_value, found.slope_p_value) == (1.0, 1.0)


def test_a_lag_is_found_and_leaves_the_stiffness_alone() -> None:
    rng = np.random.default_rng(3)
    found = [fit_static_stiffness(table(1e-5, rng, lag=20.0)) for _ in range(200)]
    assert max(f.p_value for f in found) < 1e-3
    assert np.mean([f.slope_p_value < 0.05 for f in found]) < 0.1
    assert np.mean([f.interval[0] <= 2.0e5 <= f.interval[1] for f in found]) >= 0.90


def test_the_area_of_a_lag_is_moment_times_slip_with_its_noise() -> None:
    rng = np.random.default_rng(5)
    found = [fit_static_stiffness(table(1e-5, rng, lag=10.0)) for _ in range(400)]
    areas = np.array([f.hysteresis_area for f in found])
    # a parallelogram of 10 N m / k by 175 N m, less the corner between the top and the first reading down
    assert areas.mean() == pytest.approx(10.0 / 2.0e5 * (175.0 - 12.5), abs=4 * areas.std() / 20)
    assert np.mean([f.hysteresis_std for f in found]) == pytest.approx(areas.std(), rel=0.15)


def test_the_fit_goes_in_the_direction_of_the_less_noisy_variable() -> None:
    rng = np.random.default_rng(6)
    exact = table(0.0, rng)
    moments = [exact.moment + 15.0 * rng.standard_normal(15) for _ in range(300)]
    tests = [StaticTest("hinge", m, exact.deformation, exact.rising, 15.0, 1e-6) for m in moments]
    found = [fit_static_stiffness(t) for t in tests]
    assert {f.response for f in found} == {"moment"}
    assert 0.91 <= np.mean([f.interval[0] <= 2.0e5 <= f.interval[1] for f in found]) <= 0.99  # 95 % of 300: 1.3 % std
    flattened = [fit_static_stiffness(t, response="deformation").stiffness for t in tests]
    # the wrong direction sees (15 / spread)^2 too small a slope
    assert np.mean(flattened) > 1.03 * np.mean([f.stiffness for f in found])


def test_an_interval_without_upper_end_says_so() -> None:
    rng = np.random.default_rng(8)
    lost: list[StaticStiffness] = []
    for _ in range(40):
        try:
            lost.append(fit_static_stiffness(table(1e-3, rng)))
        except ValueError as error:
            assert "does not grow" in str(error)
    assert any(np.isinf(f.interval[1]) for f in lost)
    assert all(f.interval[0] < f.stiffness < f.interval[1] for f in lost)


def test_too_few_readings_are_refused() -> None:
    test = table(0.0, np.random.default_rng(0))
    few = StaticTest("hinge", test.moment[:10], test.deformation[:10], test.rising[:10])
    with pytest.raises(ValueError, match="'down' has 2 readings"):
        fit_static_stiffness(few)


# ---- files ----------------------------------------------------------------------------------------------------


def write(test: StaticTest, path: Path) -> Path:
    direction = np.where(test.rising, "up", "down")
    frame = {"moment_nm": test.moment, "deformation_rad": test.deformation, "direction": direction}
    pd.DataFrame(frame).to_csv(path, index=False)
    return path


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    test = table(1e-5, np.random.default_rng(0))
    read = read_static_table(write(test, tmp_path / "hinge.csv"), "hinge")
    assert read.coordinate == "hinge"
    for name in ("moment", "deformation", "rising"):
        np.testing.assert_array_equal(getattr(read, name), getattr(test, name))


def test_a_file_of_tests_gives_the_lever_arm(tmp_path: Path) -> None:
    rows = "\n".join(f"{n},{n * 1e-6},{way}" for n, way in ((0, "up"), (50, "up"), (100, "up"), (50, "Down")))
    (tmp_path / "a.csv").write_text(f"load_n,deformation_rad,direction\n{rows}\n")
    (tmp_path / "a.toml").write_text(
        '[[test]]\ncoordinate = "joint_2:bend_1"\nfile = "a.csv"\nlever_arm_m = 0.5\ndeformation_std_rad = 2.8e-5\n'
    )
    (test,) = read_static_tests(tmp_path / "a.toml").tests
    assert test.coordinate == "joint_2:bend_1"
    np.testing.assert_allclose(test.moment, [0.0, 25.0, 50.0, 25.0])
    assert test.rising.tolist() == [True, True, True, False]
    assert test.deformation_std == 2.8e-5


@pytest.mark.parametrize(
    ("head", "row", "toml", "said"),
    [
        ("moment_nm,deformation_rad", "1,1", None, "direction"),
        ("moment_nm,deformation_rad,direction", "1,1,left", None, r"direction.*row 1.*left"),
        ("moment_nm,deformation_rad,direction", "1,x,up", None, r"deformation_rad.*row 1"),
        ("moment_nm,deformation_rad,direction", "1,,up", None, r"deformation_rad.*row 1"),
        ("moment_nm,deformation,direction", "1,1,up", None, r"deformation_rad.*did you mean"),
        ("deformation_rad,direction", "1,up", None, "neither moment_nm nor load_n"),
        ("load_n,moment_nm,deformation_rad,direction", "1,1,1,up", None, "both"),
        ("load_n,deformation_rad,direction", "1,1,up", None, "lever_arm_m"),
        ("load_n,deformation_rad,direction", "1,1,up", 'file = "a.csv"\nlever_arm = 1', "did you mean 'lever_arm_m'"),
        ("load_n,deformation_rad,direction", "1,1,up", 'file = "a.csv"\nlever_arm_m = -1', "lever_arm_m: found -1"),
        ("load_n,deformation_rad,direction", "1,1,up", "lever_arm_m = 1", "file: missing"),
        ("load_n,deformation_rad,direction", "1,1,up", 'file = "b.csv"', "b.csv: no such file"),
    ],
)
def test_bad_files_are_refused_by_file_and_place(
    tmp_path: Path, head: str, row: str, toml: str | None, said: str
) -> None:
    (tmp_path / "a.csv").write_text(f"{head}\n{row}\n")
    (tmp_path / "a.toml").write_text(f'[[test]]\ncoordinate = "joint_2:bend_1"\n{toml}\n')
    with pytest.raises(ValueError, match=said) as error:
        if toml is None:
            read_static_table(tmp_path / "a.csv", "joint_2:bend_1")
        else:
            read_static_tests(tmp_path / "a.toml")
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_the_figure_names_its_axes_with_units(loaded: Loaded) -> None:
    (test,) = read_markers(*loaded["joint_2:torsion"], np.random.default_rng(0))
    figure = static_test_figure([test], [fit_static_stiffness(test)])
    axis = figure.axes[0]
    assert "N m" in axis.get_xlabel()
    assert "rad" in axis.get_ylabel()


@pytest.mark.parametrize(
    ("cell", "said"), [("-1e308", "row 2: -1e+308; expected a number below 1e+09"), ("inf", "row 2: no finite number")]
)
def test_a_reading_that_cannot_be_is_named(tmp_path: Path, cell: str, said: str) -> None:
    file = tmp_path / "weights.csv"
    write(table(1e-6, np.random.default_rng(0)), file)
    lines = file.read_text().splitlines()
    place = lines[0].split(",").index("moment_nm")
    cells = lines[2].split(",")
    lines[2] = ",".join([*cells[:place], cell, *cells[place + 1 :]])
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError) as refused:
        read_static_table(file, "hinge")
    assert str(refused.value) == f"{file}: column 'moment_nm', {said}"


# ---- what does not fit --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [0, 5, 14])
@pytest.mark.parametrize("skip", [0, 1])
def test_a_reading_that_stands_out_is_named(place: int, skip: int) -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        test = table(1e-6, rng)
        test.deformation[place] += 2e-5  # twenty standard deviations
        assert fit_static_stiffness(test, skip=skip).outlier == (None if skip and place == 0 else place)


@pytest.mark.parametrize("seed", range(3))
def test_sound_readings_seldom_hold_one_that_stands_out(seed: int) -> None:
    """In 1 % at most; 13 or more of 500 in one of 1000 cases."""
    rng = np.random.default_rng(seed)
    assert sum(fit_static_stiffness(table(1e-6, rng, lag=5.0)).outlier is not None for _ in range(500)) < 13


@pytest.mark.parametrize(
    ("factor", "lever", "named"),
    [
        (1.0, 1.0, None),
        (1.0, 985.0, "a.toml: [[test]] 1 lever_arm_m: 985 is taken as m; a lever of 985 mm is 0.985 there"),
        (57.3, 1.0, "57.3 times below the declared"),
        (9.81, 1.0, "look whether load_n is in kg"),
        (57.3, 1.0, "column 'deformation_rad' spans"),
        (1e-3, 1.0, "times above the declared"),
    ],
)
def test_units_that_can_hardly_be_are_said(tmp_path: Path, factor: float, lever: float, named: str | None) -> None:
    load = np.array([*np.linspace(0.0, 300.0, 6), *np.linspace(250.0, 0.0, 6)])
    seen = factor * (load / 2.4e5 + 1e-6 * np.random.default_rng(0).standard_normal(12))
    frame = {"load_n": load, "deformation_rad": seen, "direction": np.where(np.arange(12) < 6, "up", "down")}
    pd.DataFrame(frame).to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "a.toml").write_text(
        f'robot = "rx90b_4dof"\n[[test]]\ncoordinate = "joint_2:bend_1"\nfile = "a.csv"\nlever_arm_m = {lever}\n'
    )
    cautions = fit_tests(read_static_tests(tmp_path / "a.toml")).cautions
    assert any(named in line for line in cautions) if named else cautions == ()


def test_the_row_and_file_of_a_reading_that_stands_out_are_said(tmp_path: Path) -> None:
    test = table(1e-6, np.random.default_rng(0))
    test.deformation[4] += 1e-4
    write(test, tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text('[[test]]\ncoordinate = "hinge"\nfile = "a.csv"\n')
    (line,) = fit_tests(read_static_tests(tmp_path / "a.toml")).cautions
    assert line.startswith("a.csv, row 5: ")


@pytest.mark.parametrize("way", [1, -1])
def test_a_loop_that_runs_the_wrong_way_round_is_said_to_be_a_drift(way: int, tmp_path: Path) -> None:
    write(table(1e-5, np.random.default_rng(1), lag=way * 20.0), tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text('[[test]]\ncoordinate = "hinge"\nfile = "a.csv"\n')
    result = fit_tests(read_static_tests(tmp_path / "a.toml"))
    said = " ".join(headline(result))
    assert ("friction takes part" in said) == (way == 1)
    assert ("a.csv: the loop of loading and unloading runs the wrong way round" in said) == (way == -1)
    assert len(result.cautions) == (way == -1)


def test_a_lever_beside_moments_is_said_to_be_unused(tmp_path: Path) -> None:
    write(table(1e-6, np.random.default_rng(0)), tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text('[[test]]\ncoordinate = "hinge"\nfile = "a.csv"\nlever_arm_m = 0.985\n')
    (line,) = fit_tests(read_static_tests(tmp_path / "a.toml")).cautions
    assert line == "a.toml: [[test]] 1 lever_arm_m: is not used, for a.csv gives moment_nm"
