"""Checking a Cartesian path: the curve, the plan and what it refuses, deviation and its causes, correction, files."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.effects import Effect
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import DriveFlexibility, JointFlexibility
from rx90b_flex.export import save_robot
from rx90b_flex.path import Deviation, PathCheck, PathOptions, PathPlan, Seam, check_path, load_seam, plan
from rx90b_flex.path.check import across_axes, deviation, sticking
from rx90b_flex.path.correct import Learner, tip_response
from rx90b_flex.path.output import RUNS, write_check
from rx90b_flex.path.planning import HOLD_S, rates
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import load_cs8, simulate
from rx90b_flex.simulate.command import controller_of, read_trajectory
from rx90b_flex.simulate.cs8 import drive_places
from rx90b_flex.tip import with_tip
from rx90b_flex.view.command import read_run
from rx90b_flex.view.path_report import write_path_report
from rx90b_flex.view.zoom import script

START = np.deg2rad([-11.3, 34.4, 68.8])
SHORT = Seam("short", np.array([[0.55, -0.02, 0.35], [0.55, 0.02, 0.35]]), speed=0.1, start=START)
L_SHAPE = np.array([[0.5, 0.0, 0.35], [0.7, 0.0, 0.35], [0.7, 0.2, 0.35]])


@cache
def robot(name: str = "rx90b_3dof") -> Robot:
    loaded = rf.load_robot(name)
    if (
        "panda" in name
    ):  # which keeps its speed limits along these paths where the tip is no further out than a finger's root
        loaded = with_tip(loaded, "panda_leftfinger")
    return loaded.restricted([j for j in loaded.joints if "finger" not in j])


@cache
def elastic() -> Robot:
    """Links, drives and hinges alone: nothing that is not linear in small motions."""
    return robot().with_effects([e for e in robot().effects if e.traits.in_drivetrain])


def planned(seam: Seam, of: Robot | None = None) -> PathPlan:
    of = of or robot()
    return plan(seam, of, controller_of(of, None))


@pytest.fixture(scope="module")
def checked() -> PathCheck:
    """A short line with friction and spring, corrected, every effect switched off in turn."""
    return check_path(SHORT, robot(), controller_of(robot(), None))


# ---- curve ------------------------------------------------------------------------------------------------------


def test_a_blended_path_is_smooth_and_leaves_its_corner_by_the_arc_s_sagitta() -> None:
    seam = Seam("bend", L_SHAPE, speed=0.05, corner="blend", blend=0.01)
    pieces = seam.pieces
    s = np.linspace(0.0, pieces.total, 20001)
    point, tangent = pieces.at(s)
    step = s[1] - s[0]
    np.testing.assert_allclose(np.gradient(point, s, axis=0)[1:-1], tangent[1:-1], atol=step / 0.01)  # curvature * step
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-12)
    assert pieces.total == pytest.approx(0.4 - 2 * 0.01 + 0.5 * np.pi * 0.01)  # a right angle: radius = blend
    np.testing.assert_allclose(point[-1], L_SHAPE[-1], atol=1e-12)
    nearest = np.linalg.norm(point - L_SHAPE[1], axis=1).min()
    assert nearest == pytest.approx(0.01 * (np.sqrt(2) - 1), rel=1e-4)
    assert seam.corner_distances()[1] == pytest.approx(0.5 * pieces.total)


def test_the_motion_keeps_speed_and_acceleration_and_rests_at_stops() -> None:
    seam = Seam("corner", L_SHAPE, speed=0.2, acceleration=1.5)
    time = np.linspace(0.0, seam.duration_s, 40001)
    h = time[1] - time[0]
    speed = np.gradient(seam.motion(time), h)
    acceleration = np.gradient(speed, h)
    assert seam.motion(time[-1:])[0] == pytest.approx(0.4)
    assert speed.max() == pytest.approx(0.2, rel=1e-6)
    assert np.abs(acceleration).max() == pytest.approx(1.5, rel=1e-3)
    assert abs(speed[20000]) < 1e-6 and seam.motion(time[20000:20001])[0] == pytest.approx(0.2)  # at rest in the corner
    assert seam.notes() == []
    slow = dataclasses.replace(seam, speed=1.0)  # needs 1.25 m to get there
    assert "too short for 1e+03 mm/s" in slow.notes()[0] or "too short for 1000 mm/s" in slow.notes()[0]
    time = np.linspace(0.0, slow.duration_s, 40001)
    assert np.abs(np.gradient(np.gradient(slow.motion(time), time), time)).max() == pytest.approx(1.5, rel=1e-3)


# ---- plan -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rx90b_4dof", "rx90b", "example-robot-data:ur10", "example-robot-data:panda"])
@pytest.mark.parametrize("orientation", ["free", "keep", "given"])
def test_the_planned_angles_carry_the_tip_along_the_path(name: str, orientation: str) -> None:
    of = robot(name)
    down = np.tile(Rotation.from_euler("x", 180, degrees=True).as_matrix(), (3, 1, 1))
    turned = Rotation.from_euler("z", [[0], [20], [40]], degrees=True).as_matrix() @ down
    rotations = turned if orientation == "given" else None
    seam = Seam("L", L_SHAPE * [0.8, 0.8, 1.0], 0.5, 4.0, orientation=orientation, rotations=rotations)  # type: ignore[arg-type]
    if len(of.joints) < 6 and orientation != "free":
        with pytest.raises(ValueError, match="an orientation needs 6 joints or more, rx90b_4dof has 4"):
            planned(seam, of)
        return
    found = planned(seam, of)
    data, tip = of.tree.createData(), of.tree.getFrameId(of.tip_frame)
    frames = seam.frames(found.distance)
    for k in range(0, len(found.time), 7):
        pin.framesForwardKinematics(of.tree, data, found.position[k])
        np.testing.assert_allclose(data.oMf[tip].translation, found.point[k], atol=1e-9)
        if frames is not None:
            np.testing.assert_allclose(data.oMf[tip].rotation, frames[k], atol=1e-9)
        if orientation == "keep" and k == 0:
            first = data.oMf[tip].rotation.copy()
        if orientation == "keep":
            np.testing.assert_allclose(data.oMf[tip].rotation, first, atol=1e-9)
    velocity = rates(found.position, found.rate_hz)
    k = len(velocity) // 3
    jacobian = pin.computeFrameJacobian(of.tree, data, found.position[k], tip, pin.LOCAL_WORLD_ALIGNED)[:3]
    ahead, behind = seam.motion(found.time[k] - HOLD_S + np.array([1e-4, -1e-4]))
    np.testing.assert_allclose(jacobian @ velocity[k], (ahead - behind) / 2e-4 * found.tangent[k], atol=1e-5)


REACH = 0.985  # m, of the RX90B about its shoulder, 0.42 m above the floor


def wrong_path(points: list[list[float]], **more: object) -> str:
    """What is said of a path that the robot cannot follow."""
    seam = Seam("wrong", np.array(points), **({"speed": 0.1, "start": START} | more))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^wrong: ") as error:
        planned(seam)
    text = str(error.value)
    assert "\n" not in text
    return text


def slides(folder: Path, *joints: tuple[str, str, float, float]) -> Robot:
    """Slides one on the other: name, axis, limits; of 10 kg each, with drives that give way."""
    text, below = "", "base"
    for name, axis, lower, upper in joints:
        limits = f'lower="{lower}" upper="{upper}" effort="2000" velocity="2"'
        text += f"""<link name="on_{name}"><inertial><mass value="10"/>
          <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="{name}" type="prismatic"><parent link="{below}"/><child link="on_{name}"/><axis xyz="{axis}"/>
          <limit {limits}/></joint>"""
        below = f"on_{name}"
    (folder / "slides.urdf").write_text(f'<robot name="slides"><link name="base"/>{text}</robot>')
    drives = [
        e
        for j, *_ in joints
        for e in (DriveInertia(joint=j, inertia=5.0), DriveFlexibility(joint=j, stiffness=1e6, damping=200.0))
    ]
    return rf.load_robot(folder / "slides.urdf").with_effects(drives)


def test_slides_called_x_y_and_z_leave_the_tip_its_columns(tmp_path: Path) -> None:
    machine = slides(tmp_path, ("x", "1 0 0", -1.0, 1.0), ("y", "0 1 0", -1.0, 1.0), ("z", "0 0 1", -1.0, 1.0))
    # the tip is where the slides are, but for the offset of the path's own start
    seam = Seam("cut", np.array([[0.3, 0.2, 0.1], [0.4, 0.2, 0.1]]), speed=0.1)
    result = check_path(seam, machine, controller_of(machine, None), PathOptions(contributions=False))
    write_check(result, tmp_path / "out")
    # references in the log are the planned ones, and the file says so
    assert "../corrected_joints.csv" in (tmp_path / "out" / "corrected" / "campaign.toml").read_text()
    table = pd.read_csv(tmp_path / "out" / "corrected_path.csv")
    np.testing.assert_allclose(table[["x", "y", "z"]].iloc[[0, -1]], seam.points, atol=2e-4)
    np.testing.assert_allclose(table[["joint_x", "joint_y", "joint_z"]], table[["x", "y", "z"]], atol=1e-9)
    angles = pd.read_csv(tmp_path / "out" / "corrected_joints.csv")
    assert list(angles) == ["time", "x", "y", "z"]


def test_where_the_best_joints_end_others_carry_the_tip(tmp_path: Path) -> None:
    machine = slides(
        tmp_path,
        ("x", "1 0 0", -1.0, 1.0),
        ("y", "0 1 0", -1.0, 1.0),
        ("z", "0 0 1", 0.0, 0.05),
        ("lift", "0 0 1", -1.0, 1.0),
    )
    seam = Seam("rise", np.array([[0.3, 0.2, 0.2], [0.3, 0.25, 0.5]]), speed=0.1)
    position = planned(seam, machine).position
    assert (position[:, 2] >= 0.0).all() and (position[:, 2] <= 0.05).all() and np.ptp(position[:, 3]) > 0.29
    narrow = slides(
        tmp_path,
        ("x", "1 0 0", -1.0, 1.0),
        ("y", "0 1 0", -1.0, 1.0),
        ("z", "0 0 1", 0.0, 0.05),
        ("lift", "0 0 1", 0.0, 0.3),
    )
    with pytest.raises(
        ValueError,
        match=r"outside its limits .* \(by x, y and (z|lift) alone, as no others that were tried get farther",
    ):
        planned(seam, narrow)


def test_a_path_out_of_reach_says_from_where() -> None:
    text = wrong_path([[0.6, 0.0, 0.4], [1.3, 0.0, 0.4]])
    assert "cannot reach" in text
    expected = 1e3 * (np.sqrt(REACH**2 - 0.02**2) - 0.6)
    assert float(text.split("at ")[1].split(" mm")[0]) == pytest.approx(expected, abs=0.5)  # mm, a sample is 0.4 mm
    assert "at 0.0 mm" in wrong_path([[1.6, 0.0, 0.4], [1.3, 0.0, 0.4]])


def test_a_path_outside_a_joint_s_limits_names_joint_angle_and_limits() -> None:
    # round the back: joint 1 follows the bearing of the tip, whose limit of 160 degrees is at y = 0.5 tan(20 degrees)
    start = np.deg2rad([120.0, 34.4, 68.8])
    text = wrong_path([[-0.5, 0.4, 0.5], [-0.5, 0.0, 0.5]], start=start)
    assert "needs joint_1 at 180°, outside its limits -160° to 160°" in text
    where = float(text.split("from ")[1].split(" to")[0])
    assert where == pytest.approx(1e3 * (0.4 - 0.5 * np.tan(np.deg2rad(20.0))), abs=0.5)


def test_a_path_through_a_singularity_says_where() -> None:
    text = wrong_path([[0.4, 0.0, 0.9], [-0.4, 0.0, 0.9]], start=np.deg2rad([0.0, 10.0, 80.0]))  # over joint 1's axis
    assert "singularity" in text
    begin, end = (float(x) for x in text.split("from ")[1].split(" mm")[0].split(" to "))
    assert 350.0 < begin < 400.0 < end < 450.0


def test_a_path_along_the_axis_of_a_joint_says_where_it_is_singular() -> None:
    seam = Seam("axis", np.array([[0.0, 0.0, 0.7], [0.05, 0.0, 0.7]]), speed=0.05)
    with pytest.raises(
        ValueError, match=r"^axis: at 0.0 mm of the path goes through a singularity: joint_1 would jump by"
    ):
        planned(seam, robot("rx90b_4dof"))
    assert "expected a path beside it, or another start_deg" in wrong_path([[0.4, 0.0, 0.9], [-0.4, 0.0, 0.9]])


def test_a_path_that_is_too_fast_names_the_joint_and_the_place() -> None:
    text = wrong_path([[0.35, -0.5, 0.35], [0.35, 0.5, 0.35]], speed=1.6, acceleration=30.0)
    assert "is too fast: joint_1 would turn at" in text and "over its limit of 4" in text
    # joint 1 turns at v x / (x^2 + y^2)
    y = np.sqrt(0.35 * 1.6 / 4.0 - 0.35**2)
    assert float(text.split("from ")[1].split(" to")[0]) == pytest.approx(1e3 * (0.5 - y), abs=1e3 * 1.6 / 250.0)
    text = wrong_path([[0.35, -0.4, 0.35], [0.35, 0.4, 0.35]], speed=1.0, acceleration=60.0)
    assert "would need" in text and "N m, over its limit of 450" in text


def test_a_corner_that_cannot_be_blended_says_which_and_how_much_it_needs() -> None:
    text = wrong_path(L_SHAPE.tolist(), corner="blend", blend=0.001, speed=0.25)
    assert "the corner at point 2 (200 mm along) is taken too fast" in text and "blend_mm of 62.5 or more" in text
    assert planned(Seam("wide", L_SHAPE, 0.25, corner="blend", blend=0.0625, start=START)).seam.notes()
    assert "200 mm are left on its sides" in wrong_path(L_SHAPE.tolist(), corner="blend", blend=0.3)
    back = [[0.5, 0.0, 0.35], [0.7, 0.0, 0.35], [0.5, 0.0, 0.35]]
    assert "turns back" in wrong_path(back, corner="blend", blend=0.01)


# ---- deviation --------------------------------------------------------------------------------------------------


def test_a_slow_tip_sags_by_what_its_weight_bends_the_hinges() -> None:
    seam = Seam("slow", np.array([[0.6, -0.004, 0.4], [0.6, 0.004, 0.4]]), speed=0.005, acceleration=0.05, start=START)
    found = planned(seam, elastic())
    before = deviation(found, simulate(elastic(), load_cs8().for_joints(elastic().joints), found.trajectory()))
    # each hinge turns by the weight's torque over its stiffness; the drives stay where they are told
    model, names = elastic().model, elastic().coordinates
    k = len(found.position) // 2
    q = np.zeros(model.nv)
    q[[names.index(f"{j}:drive") for j in elastic().joints]] = found.position[k]
    weight = pin.rnea(model, model.createData(), q, np.zeros(model.nv), np.zeros(model.nv))
    compliance = np.zeros(model.nv)
    for e in elastic().effects:
        if isinstance(e, DriveFlexibility):
            compliance[names.index(f"{e.joint}:torsion")] = 1.0 / e.stiffness
        if isinstance(e, JointFlexibility):
            compliance[[names.index(f"{e.joint}:bend_{i}") for i in (1, 2)]] = 1.0 / np.array(e.stiffness)
    data, tip = model.createData(), model.getFrameId(elastic().tip_frame)
    jacobian = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)[:3]
    sag = -1e3 * jacobian @ (compliance * weight)
    middle = len(before.up) // 2
    # to first order in angles of a milliradian; along y the path's direction
    expected = np.array([sag[1], -sag[0], sag[2]])
    shown = [before.along[middle], before.left[middle], before.up[middle]]
    np.testing.assert_allclose(shown, expected, atol=0.01 * np.linalg.norm(sag))
    assert before.up[middle] < -0.2


def test_each_millimetre_is_judged_by_its_worst_sample_and_one_not_reached_fails() -> None:
    place = np.array([0.0, 0.5, 1.2, 1.6, 2.4, 5.4])
    of = Deviation(
        place, 8.0, np.zeros(6), np.array([0.0, 0.3, 0.1, 0.1, 0.0, 0.0]), np.array([0.0, 0.4, 0, 0, 0.05, 0.05]), "why"
    )
    np.testing.assert_allclose(of.by_mm[:6], [0.5, 0.1, 0.05, 0.05, 0.05, 0.05])
    assert np.isinf(of.by_mm[6:]).all()
    assert not of.passes(10.0)
    assert [(a, b) for a, b, _ in of.failing(0.15)] == [(0, 1), (6, 8)]
    assert dataclasses.replace(of, ended=None).passes(0.5) and not dataclasses.replace(of, ended=None).passes(0.49)


def test_left_and_up_stand_across_any_direction() -> None:
    tangent = np.array([[1.0, 0, 0], [0, 1.0, 0], [0.6, 0, 0.8], [0, 0, 1.0], [0, 0, -1.0]])
    left, up = across_axes(tangent)
    for axis in (left, up):
        np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0)
        np.testing.assert_allclose(np.einsum("ki,ki->k", axis, tangent), 0.0, atol=1e-12)
    np.testing.assert_allclose(left[:2], [[0, 1, 0], [-1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(up[:2], [[0, 0, 1], [0, 0, 1]], atol=1e-12)
    assert (up[:3, 2] > 0.5).all() and (left[:3, 2] == 0.0).all()


def test_a_run_that_ends_early_fails_and_is_still_reported(checked: PathCheck, tmp_path: Path) -> None:
    whole, kept = checked.before, len(checked.before.along) // 2
    parts = (x[:kept] for x in (whole.along, whole.left, whole.up))
    short = Deviation(
        whole.distance_mm[:kept], whole.length_mm, *parts, ended="at t = 0.7 s the drive of joint_1 gave up"
    )
    failed = dataclasses.replace(checked, before=short, after=None, correction=None, contributions=(), wrong_model=())
    assert failed.verdict == "outside_tolerance" and "gave up" in failed.sentence
    write_check(failed, tmp_path / "out", lambda r, at: write_path_report(r, at / "report.html"))
    table = pd.read_csv(tmp_path / "out" / "seam.csv")
    assert table.across_before_mm.isna().sum() == 20 and set(table.before[20:]) == {"fail"}
    saved = json.loads((tmp_path / "out" / "path_check.json").read_text())
    assert saved["before"]["failing"][-1] == {"from_mm": 0, "to_mm": 40, "max_across_mm": None}
    assert "not reached" in (tmp_path / "out" / "report.html").read_text()


def test_the_effects_of_a_linear_robot_add_up() -> None:
    check = check_path(SHORT, elastic(), controller_of(elastic(), None), PathOptions(correct=False))
    done = [c for c in check.contributions if c.why_not is None]
    assert len(done) == 7 and done[0].name == "links and controller"  # and two kinds of hinges in three joints
    # sag and vibration are linear in the compliances but for the modes' frequencies: second order in what the hinges give
    assert check.left_over < 0.05 * check.before.rms_across
    assert [c.name for c in check.contributions if c.why_not is not None] == [
        f"drive inertia joint {i}" for i in (1, 2, 3)
    ]


def test_a_drive_that_stops_on_its_way_sticks_and_one_that_starts_or_turns_back_does_not() -> None:
    found = planned(SHORT)
    run = simulate(robot(), controller_of(robot(), None), found.trajectory())
    assert sticking(found, run) == ()
    assert (
        sticking(found, dataclasses.replace(run, v=np.zeros_like(run.v))) == ()
    )  # it never moved: stuck, but it does not slip
    jerky = run.v.copy()
    drives = drive_places(robot())
    on_its_way = np.flatnonzero(np.abs(run.v[:, drives[0]]) > 0.5 * np.abs(run.v[:, drives[0]]).max())
    for stop in np.array_split(on_its_way, 4):
        jerky[stop[1:3], drives[0]] = 0.0
    assert sticking(found, dataclasses.replace(run, v=jerky)) == (("joint_1", 4),)


# ---- correction -------------------------------------------------------------------------------------------------


def test_the_response_behind_the_correction_is_that_of_the_simulation() -> None:
    hz, size = 5.0, 1e-4  # m
    seam = Seam("slow", np.array([[0.6, -0.004, 0.4], [0.6, 0.004, 0.4]]), speed=0.005, acceleration=0.05, start=START)
    found = planned(seam, elastic())
    own = load_cs8().for_joints(elastic().joints).ideal()
    still = simulate(elastic(), own, found.trajectory())
    k = len(found.time) // 2
    predicted = tip_response(found, own, k, np.zeros(3), np.array([hz]))[0]
    window = np.abs(found.time - found.time[k]) < 0.4 - 1e-9  # four periods
    wave = np.exp(-2j * np.pi * hz * found.time)[window]
    for axis in range(3):
        displaced = np.outer(size * np.sin(2 * np.pi * hz * found.time), np.eye(3)[axis])
        run = simulate(elastic(), own, found.trajectory(displaced))
        moved = (run.tip - still.tip)[window, :3, 3]
        measured = wave @ moved / (wave @ displaced[window, axis])
        np.testing.assert_allclose(measured, predicted[:, axis], atol=0.02)  # the arm turns by 0.013 rad meanwhile


def test_what_does_not_stray_is_not_corrected_and_a_constant_is_taken_off_as_it_is() -> None:
    found = planned(SHORT, elastic())
    learner = Learner(found, load_cs8())
    zero = np.zeros_like(found.point)
    assert np.array_equal(learner(zero), zero)
    constant = np.tile([1e-4, -2e-4, 3e-4], (len(zero), 1))
    # the integrators have the drives follow exactly; hinges pass it on but for the change of their load, and r holds back 1 %
    np.testing.assert_allclose(learner(constant), constant, rtol=0.02)


def test_the_corrected_path_stays_within_tolerance_where_the_planned_one_did_not(checked: PathCheck) -> None:
    assert checked.verdict == "corrected_within_tolerance"
    assert checked.after is not None and not checked.before.passes(0.1) and checked.after.passes(0.1)
    assert checked.after.max_across < 0.5 * checked.before.max_across
    assert checked.after.rms_across < 0.1 * checked.before.rms_across
    assert min(i.max_across for i in checked.iterations) == checked.after.max_across
    assert [name for name, _ in checked.wrong_model] == ["friction", "stiffness and damping of hinges", "springs"]
    assert all(checked.after.rms_across < d.rms_across < checked.before.rms_across for _, d in checked.wrong_model)


def test_the_written_angles_simulate_to_the_corrected_path(checked: PathCheck, tmp_path: Path) -> None:
    write_check(checked, tmp_path / "out")
    own = controller_of(robot(), None)
    trajectory = read_trajectory(tmp_path / "out" / "corrected_joints.csv", robot(), own.reference_rate_hz)
    again = deviation(checked.plan, simulate(robot(), own, trajectory))
    assert checked.after is not None
    np.testing.assert_allclose(again.across, checked.after.across, atol=0.002)  # mm, a fiftieth of the tolerance
    table = pd.read_csv(tmp_path / "out" / "corrected_path.csv")
    np.testing.assert_allclose(table[list(robot().joints)], trajectory.position, atol=1e-9)
    shift = 1e3 * (table[["x", "y", "z"]].to_numpy() - checked.plan.point)
    np.testing.assert_allclose(table[[f"correction_{a}_mm" for a in "xyz"]], shift, atol=1e-5)


def test_both_runs_are_written_to_be_seen_with_deviations_from_the_planned_path(
    checked: PathCheck, tmp_path: Path
) -> None:
    write_check(checked, tmp_path / "out")
    for name, of in zip(RUNS, (checked.before, checked.after), strict=True):
        assert of is not None
        seen = read_run(str(tmp_path / "out" / name))
        table = pd.read_csv(tmp_path / "out" / name / "tip.csv")
        on = (seen.time >= HOLD_S) & (seen.time <= HOLD_S + SHORT.duration_s)
        size = np.linalg.norm(table[[f"deviation_{a}_mm" for a in "xyz"]].to_numpy(), axis=1)[on]
        # the reference is logged behind the filter before the log, which rounds its beginning and end
        np.testing.assert_allclose(size, np.hypot(of.along, of.across), atol=0.01)


def test_a_correction_moves_the_arm_and_leaves_the_wrist_to_the_orientation() -> None:
    found = planned(dataclasses.replace(SHORT, orientation="keep"), robot("rx90b"))
    assert np.ptp(found.position, axis=0)[3:].max() > 1e-3 and (found.pull[:, 3:] == 0.0).all()
    data, tip = found.robot.tree.createData(), found.robot.tree.getFrameId(found.robot.tip_frame)
    k = len(found.time) // 2
    jacobian = pin.computeFrameJacobian(found.robot.tree, data, found.position[k], tip, pin.LOCAL_WORLD_ALIGNED)[:3]
    np.testing.assert_allclose(jacobian @ found.pull[k], np.eye(3), atol=1e-9)


@pytest.mark.slow
def test_a_square_with_a_fixed_orientation_is_corrected_where_its_speed_has_the_wrist_slide() -> None:
    seam = dataclasses.replace(load_seam("square", 250.0), orientation="keep")
    check = check_path(seam, robot("rx90b"), controller_of(robot("rx90b"), None), PathOptions(contributions=False))
    assert check.verdict == "corrected_within_tolerance"


def test_a_correction_that_the_robot_could_not_follow_is_said(checked: PathCheck) -> None:
    why = "at t = 0.1 s joint_2 is at 2.4 rad, outside its limits -2.2 to 2.2 rad"
    ended = dataclasses.replace(checked, options=PathOptions(tolerance_mm=1e-6), correction_ended=why)
    assert ended.sentence.startswith("Fail") and f"The next step would end early: {why}." in ended.sentence


def test_a_correction_that_does_not_reach_the_tolerance_says_so() -> None:
    options = PathOptions(tolerance_mm=1e-4, contributions=False, iterations=1)
    check = check_path(SHORT, robot(), controller_of(robot(), None), options)
    assert check.verdict == "outside_tolerance"
    assert "correction in 1 steps brings" in check.sentence and "millimetres stay over 0.0001 mm" in check.sentence


@pytest.mark.parametrize("name", ["ur10", pytest.param("panda", marks=pytest.mark.slow)])
def test_another_robot_with_elastic_drives_is_corrected_too(name: str) -> None:
    rigid = robot(f"example-robot-data:{name}")
    effects: list[Effect] = [DriveInertia(joint=j, inertia=0.5) for j in rigid.joints]
    effects += [DriveFlexibility(joint=j, stiffness=2e4, damping=20.0) for j in rigid.joints]
    of = rigid.with_effects(effects)
    seam = Seam("short", np.array([[0.5, -0.03, 0.4], [0.5, 0.03, 0.4]]), speed=0.1)
    check = check_path(seam, of, controller_of(of, None), PathOptions(contributions=False))
    assert check.verdict == "corrected_within_tolerance"


# ---- files and command ------------------------------------------------------------------------------------------


POINTS = "points = [[0.5, 0, 0.35], [0.6, 0, 0.35]]\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (POINTS, "speed_mm_s: missing"),
        ("speed_mm_s = 50", "one of the keys 'points' and 'points_file' is expected"),
        (POINTS + "speed_mm_s = 50\nspeed = 3", "'speed': unknown key"),
        (POINTS + "speed_mm_s = '50'", "speed_mm_s: found '50', a finite number"),
        (POINTS + "speed_mm_s = -1", "speed_mm_s: found -1, a number above 0 is expected"),
        (POINTS + "speed_mm_s = 50\nacceleration = -1", "acceleration: found -1, a number above 0 is expected"),
        (POINTS + "speed_mm_s = 50\nblend_mm = -1", "blend_mm: found -1, a number of 0 or more is expected"),
        (POINTS + "speed_mm_s = 50\nunit = 'inch'", "unit: found 'inch', 'm' or 'mm' is expected"),
        (POINTS + "speed_mm_s = 50\ncorner = 'round'", "corner: found 'round'"),
        (POINTS + "speed_mm_s = 50\ncorner = 'blend'", "corner is 'blend' and blend_mm is 0"),
        (POINTS + "speed_mm_s = 50\norientation = 'down'", "orientation: found 'down'"),
        (POINTS + "speed_mm_s = 50\norientation = 'keep'\nrpy_deg = [[180, 0, 0]]", "choose one way"),
        (
            POINTS + "speed_mm_s = 50\nrpy_deg = [[180, 0, 0], [1, 2, 3], [1, 2, 3]]",
            "rpy_deg: has 3 rows; expected 1 or 2",
        ),
        (POINTS + "speed_mm_s = 50\nquaternion_xyzw = [[1, 1, 0, 0]]", "a quaternion has length other than 1"),
        ("points = [[0.5, 0, 0.35], [0.6, 0]]\nspeed_mm_s = 50", "a list of rows of 3 numbers is expected"),
        ("points = [[0.5, 0, 0.35]]\nspeed_mm_s = 50", "expected two or more"),
        ("points = [[0.5, 0, 0.35], [0.5, 0, 0.35]]\nspeed_mm_s = 50", "points 1 and 2 are the same"),
        ("points_file = 'none.csv'\nspeed_mm_s = 50", "none.csv: no such file"),
        ("points_file = 'a.csv'\nspeed_mm_s = 50", "a.csv: expected columns x, y, z (m) or x_mm, y_mm, z_mm"),
        ("points_file = 'b.csv'\nspeed_mm_s = 50", "b.csv: column 'y', row 2: no finite number"),
        ("points = [", "not a TOML file"),
    ],
)
def test_a_bad_path_file_is_refused_in_one_line(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y\n1,2\n")
    (tmp_path / "b.csv").write_text("x,y,z\n1,2,3\n1,,3\n")
    file = tmp_path / "path.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=r".") as error:
        load_seam(file)
    assert says in str(error.value) and str(tmp_path) in str(error.value) and "\n" not in str(error.value)


def test_tables_of_points_and_path_files_in_either_unit_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "mm.csv").write_text(
        "x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg\n500,0,350,180,0,0\n600,10,350,180,0,90\n"
    )
    (tmp_path / "m.csv").write_text("x,y,z,qx,qy,qz,qw\n0.5,0,0.35,1,0,0,0\n0.6,0.01,0.35,0.7071068,0.7071068,0,0\n")
    (tmp_path / "a.toml").write_text(
        "unit = 'mm'\npoints = [[500, 0, 350], [600, 10, 350]]\nspeed_mm_s = 20\nrpy_deg = [[180, 0, 0], [180, 0, 90]]"
    )
    (tmp_path / "b.toml").write_text("points_file = 'm.csv'\nspeed_mm_s = 20")
    same = "points = [[0.5, 0, 0.35], [0.6, 0, 0.35]]\nspeed_mm_s = 20\nrpy_deg = "
    for name, given in (("one", "[180, 0, 90]"), ("row", "[[180, 0, 90]]")):
        (tmp_path / f"{name}.toml").write_text(same + given)
    one, row = (load_seam(tmp_path / f"{name}.toml").rotations for name in ("one", "row"))
    assert one is not None and row is not None
    np.testing.assert_array_equal(one, row)
    seams = [load_seam(tmp_path / f"{n}.csv", 20.0) for n in ("mm", "m")] + [
        load_seam(tmp_path / f"{n}.toml") for n in "ab"
    ]
    for seam in seams:
        np.testing.assert_allclose(seam.points, [[0.5, 0, 0.35], [0.6, 0.01, 0.35]])
        assert seam.rotations is not None and seam.orientation == "given" and seam.speed == pytest.approx(0.02)
        np.testing.assert_allclose(seam.rotations, seams[0].rotations, atol=1e-6)
    with pytest.raises(ValueError, match="speed_mm_s is -5; expected more than 0"):
        load_seam("line", speed_mm_s=-5.0)
    with pytest.raises(ValueError, match="has no speed"):
        load_seam(tmp_path / "m.csv")
    with pytest.raises(ValueError, match="expected a path file"):
        load_seam("circle")


@dataclasses.dataclass
class Ran:
    status: int
    out: str
    err: str


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):  # type: ignore[no-untyped-def]
    def run(*arguments: object) -> Ran:
        monkeypatch.setattr("sys.argv", ["rx90b-flex", "check-path", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        said = capsys.readouterr()
        return Ran(int(end.value.code or 0), said.out, said.err)  # type: ignore[arg-type]

    return run


def test_the_command_writes_its_folder_and_its_status_is_the_verdict(command, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file, out = tmp_path / "seam.toml", tmp_path / "out"
    file.write_text(
        "robot = 'rx90b_3dof'\nunit = 'mm'\npoints = [[550, -10, 350], [550, 10, 350]]\nspeed_mm_s = 50\nstart_deg = [0, 34, 69]"
    )
    ran = command(file, "--out", out, "--no-contributions")
    assert ran.status == 0 and "Pass when corrected" in ran.out
    assert {p.name for p in out.iterdir()} == {
        "path_check.json", "report.html", "seam.csv", "corrected_path.csv", "corrected_joints.csv", *RUNS,
    }  # fmt: skip
    saved = json.loads((out / "path_check.json").read_text())
    assert saved["verdict"] == "corrected_within_tolerance" and saved["robot"] == "rx90b_3dof"
    assert saved["before"]["max_across_mm"] > 0.1 > saved["after"]["max_across_mm"]
    table = pd.read_csv(out / "seam.csv")
    assert (
        len(table) == 20
        and set(table.after) == {"pass"}
        and (table.across_before_mm > 0.1).equals(table.before == "fail")
    )
    ran = command(file, "--out", tmp_path / "as_planned", "--no-contributions", "--no-correct")
    assert ran.status == 1 and "Fail" in ran.out
    assert not (tmp_path / "as_planned" / "corrected_path.csv").exists()


def test_a_path_that_cannot_be_followed_is_refused_before_any_simulation(
    command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # type: ignore[no-untyped-def]
    def never(*_: object, **__: object) -> None:
        raise AssertionError("simulated")

    monkeypatch.setattr("rx90b_flex.path.check.simulate", never)
    file = tmp_path / "far.toml"
    file.write_text("points = [[0.6, 0, 0.4], [1.3, 0, 0.4]]\nspeed_mm_s = 200\nrobot = 'rx90b_3dof'")
    ran = command(file, "--out", tmp_path / "out")
    assert ran.status == 2 and ran.err.count("\n") == 1 and "mm of the path rx90b_3dof cannot reach" in ran.err
    assert not (tmp_path / "out").exists()
    assert command("line", "--out", tmp_path / "out", "--tolerance-mm", -1).status == 2
    assert command("nothing.toml", "--out", tmp_path / "out").status == 2


def test_the_robot_of_a_path_file_lies_beside_it(command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    file, cell = tmp_path / "cell" / "paths" / "far.toml", tmp_path / "cell"
    file.parent.mkdir(parents=True)
    save_robot(robot(), cell, allow_inconsistent=True)
    far = "points = [[0.6, 0, 0.4], [1.3, 0, 0.4]]\nspeed_mm_s = 200\nrobot = "
    monkeypatch.chdir(tmp_path)
    for named in (
        "../robot.toml",
        "cell/robot.toml",
        "rx90b_3dof",
    ):  # beside it, from here as it was before, of the catalogue
        file.write_text(f"{far}'{named}'")
        assert "mm of the path rx90b_3dof cannot reach" in command("cell/paths/far.toml", "--out", "out").err
    file.write_text(f"{far}'../robots.toml'")
    ran = command("cell/paths/far.toml", "--out", "out")
    assert ran.status == 2 and ran.err.count("\n") == 1 and "cell/paths/far.toml: robot: " in ran.err


@pytest.mark.parametrize("name", ["line", "square"])
def test_an_example_is_written_to_start_from_and_can_be_planned(command, name: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / f"{name}.toml"
    assert command(name, "--save-example", file).status == 0
    seam = load_seam(file)
    np.testing.assert_array_equal(seam.points, load_seam(name).points)
    assert seam.pieces.total == pytest.approx({"line": 1.7, "square": 0.8}[name])
    found = planned(dataclasses.replace(seam, speed=1.0), robot("rx90b_4dof"))
    assert found.moving.sum() == pytest.approx(seam_samples(found), abs=1)
    assert command(name, "--save-example", file).status == 2  # it is there already


def seam_samples(found: PathPlan) -> float:
    return found.seam.duration_s * found.rate_hz + 1


def test_the_report_tells_the_verdict_causes_and_correction_and_needs_no_network(
    checked: PathCheck, tmp_path: Path
) -> None:
    write_path_report(checked, tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text()
    for part in (
        "Pass when corrected",
        "Which effect causes how much",
        "gravity spring joint 2",
        "10 % lower",
        "seam.csv",
    ):
        assert part in html
    html = html.replace(script(), "")  # the figures' own
    assert "http://" not in html and "https://" not in html.replace("http://www.w3.org", "")
    assert html.count("<img ") == 4
