"""The camera: rigid bodies, deformations of a joint, base calibration, and what spoils and saves the joint stiffness."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

import rx90b_flex as rf
from rx90b_flex.identify.camera import (
    calibrate_base,
    fit_joint,
    fit_rigid_body,
    fit_rigid_shape,
    hinge_angles,
    joint_frames,
    joint_turn,
    link_poses,
    links_beside,
    mismatched,
)
from rx90b_flex.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from camera_study.camera import Camera, CameraNoise, carried_motion, marker_positions
from camera_study.figures import error_map_figure, leak_figure
from camera_study.study import (
    ESTIMATORS,
    REQUIRED,
    TRIANGLE,
    Scene,
    Study,
    make_scene,
    make_study,
    regress_bending,
    rigid_bodies,
    sine_motion,
)

STD = np.array([0.02e-3, 0.02e-3, 0.10e-3])  # m, in about table C.2's ratio


@pytest.fixture(scope="module")
def robot() -> Robot:
    return rf.load_robot("rx90b_4dof")


@pytest.fixture(scope="module")
def scene(robot: Robot) -> Scene:
    return make_scene(robot, "joint_2", rate_hz=125.0)


@pytest.fixture(scope="module")
def study(scene: Scene) -> Study:
    return make_study(scene, 20, np.random.default_rng(0))


def turned(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rotation = Rotation.random(count, rng=rng).as_matrix()
    place = rng.standard_normal((count, 3))
    return rotation, place, np.einsum("nij,mj->nmi", rotation, TRIANGLE) + place[:, None]


# ---- noise ----------------------------------------------------------------------------------------------------


def test_noise_is_that_of_table_c_2_in_each_zone() -> None:
    rng = np.random.default_rng(0)
    for depth, xy, z in ((2.5, 0.007, 0.033), (3.5, 0.010, 0.050), (4.5, 0.022, 0.110), (5.5, 0.032, 0.161)):
        points = np.tile([0.1, -0.2, depth], (20000, 1))
        for factor in (1.0, 2.5):
            seen = CameraNoise().times(factor).read(points, rng)
            # 20000 draws tell a standard deviation to 0.5 %; rounding to 2 um adds less than 0.4 % in squares
            np.testing.assert_allclose(1e3 * seen.std(axis=0), factor * np.array([xy, xy, z]), rtol=0.02)


def test_readings_are_rounded_to_the_resolution() -> None:
    seen = CameraNoise().read(np.array([[0.1, 0.2, 3.0]]), np.random.default_rng(0))
    np.testing.assert_allclose(seen / 2e-6, np.round(seen / 2e-6), atol=1e-6)


def test_an_error_that_goes_with_the_position_is_the_same_at_the_same_place() -> None:
    noise = CameraNoise(correlation_length=0.3, resolution=0.0)
    near, far = np.array([0.0, 0.0, 3.5]), np.array([0.6, 0.0, 3.5])
    rng = np.random.default_rng(1)
    errors = np.array([noise.read(np.stack([near, near, far]), rng) - [near, near, far] for _ in range(2000)])
    np.testing.assert_array_equal(errors[:, 0], errors[:, 1])
    np.testing.assert_allclose(errors[:, 0].std(axis=0), noise.std(near), rtol=0.06)  # 1.6 % one sigma
    correlation = np.corrcoef(errors[:, 0, 0], errors[:, 2, 0])[0, 1]
    assert abs(correlation - np.exp(-0.5 * 2.0**2)) < 4 / np.sqrt(2000)


def test_markers_outside_the_working_volume_are_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.50 to 3\.00 m from the camera; expected 2 to 6 m"):
        CameraNoise().std(np.array([[0.0, 0.0, 1.5], [0.0, 0.0, 3.0]]))


def test_a_camera_sees_what_it_looks_at_on_its_axis() -> None:
    camera = Camera.looking((3.0, 1.0, 1.0), (0.0, 0.0, 0.5))
    np.testing.assert_allclose(camera.see(np.array([0.0, 0.0, 0.5]))[:2], 0.0, atol=1e-12)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
    assert camera.see(np.array([0.0, 0.0, 0.6]))[1] < 0.0  # y points down


# ---- rigid bodies ---------------------------------------------------------------------------------------------


def test_markers_without_noise_give_the_motion_exactly() -> None:
    rotation, place, markers = turned(50, np.random.default_rng(0))
    found = fit_rigid_body(TRIANGLE, markers, STD)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, place, atol=1e-12)


def test_covariance_and_chi_squared_are_those_of_many_draws() -> None:
    rng = np.random.default_rng(1)
    rotation, _, markers = turned(1, rng)
    markers = np.repeat(markers, 4000, axis=0)
    found = fit_rigid_body(TRIANGLE, markers + STD * rng.standard_normal(markers.shape), STD)
    errors = Rotation.from_matrix(found.rotation @ rotation[0].T).as_rotvec()
    expected = found.covariance[:, :3, :3].mean(axis=0)
    spread = np.cov(errors.T)
    size = np.sqrt(np.diag(expected))
    # entries of a covariance from 4000 draws, over their scale: 2.2 % one sigma
    np.testing.assert_allclose(spread / np.outer(size, size), expected / np.outer(size, size), atol=0.1)
    assert found.chi2.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / 4000))


def test_weights_make_the_turn_more_accurate_than_equal_ones() -> None:
    rng = np.random.default_rng(2)
    more = np.concatenate([TRIANGLE, [[0.1, 0.1, 0.3]]])
    rotation = Rotation.random(2000, rng=rng).as_matrix()
    markers = np.einsum("nij,mj->nmi", rotation, more) + STD * rng.standard_normal((2000, 4, 3))
    errors = [
        Rotation.from_matrix(fit_rigid_body(more, markers, std).rotation @ np.swapaxes(rotation, 1, 2)).magnitude()
        for std in (STD, 1.0)
    ]
    assert np.mean(errors[0] ** 2) < 0.9 * np.mean(errors[1] ** 2)


def test_errors_of_a_shape_that_is_fitted_along_turn_all_rows_together_as_is_stated() -> None:
    """Along the combination of the rows' turns that a wrong shape moves most, beside each row's own noise."""
    rng = np.random.default_rng(3)
    rotation, _, markers = turned(20, rng)
    turns = rotation[1:] @ rotation[0].T  # from row 0; in the camera's axes the reference drops out
    squares, expected = [], []
    for _ in range(500):
        found = fit_rigid_shape(markers + STD * rng.standard_normal(markers.shape), STD)
        assert found.shared is not None and found.shared.shape == (20, 3, 3)  # a triangle's shape has three numbers
        seen = found.rotation[1:] @ found.rotation[0].T @ np.swapaxes(turns, 1, 2)
        errors = Rotation.from_matrix(seen).as_rotvec().ravel()
        together = (found.shared[1:] - turns @ found.shared[0]).reshape(57, 3)
        first = turns.reshape(57, 3)
        own = block_diag(*found.covariance[1:, :3, :3]) + first @ found.covariance[0, :3, :3] @ first.T
        root = np.linalg.cholesky(own)
        u, s, _ = np.linalg.svd(np.linalg.solve(root, together), full_matrices=False)
        squares.append((u[:, 0] @ np.linalg.solve(root, errors)) ** 2)
        expected.append(1.0 + s[0] ** 2)
    assert np.mean(expected) > 1.5
    assert np.mean(squares) / np.mean(expected) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 500))


@pytest.mark.parametrize(
    ("reference", "said"),
    [(TRIANGLE[:2], "at least 3"), (np.outer([0.0, 1.0, 2.0], [1.0, 0.0, 0.0]), "one line")],
)
def test_markers_that_leave_the_turn_open_are_refused(reference: np.ndarray, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fit_rigid_body(reference, reference[None], STD)


# ---- hinges ---------------------------------------------------------------------------------------------------


def hinge_rotation(angles: np.ndarray) -> np.ndarray:
    """Three hinges in series, (N, 3) to (N, 3, 3)."""
    return Rotation.from_euler("XYZ", angles).as_matrix()


def test_hinge_angles_are_the_inverse_of_hinge_rotation() -> None:
    angles = np.random.default_rng(0).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (200, 3))
    np.testing.assert_allclose(hinge_angles(hinge_rotation(angles)), angles, atol=1e-12)


def test_equation_a_13_agrees_to_second_order_after_turning_its_bendings() -> None:
    rng = np.random.default_rng(0)
    angles = np.column_stack([rng.uniform(-2, 2, 100), 1e-3 * rng.standard_normal((100, 2))])
    x, y, z, w = Rotation.from_matrix(hinge_rotation(angles)).as_quat().T
    turn = 2 * np.arctan2(x, w)
    across = 2 * np.stack([w * y - x * z, w * z + x * y], axis=1)
    c, s = np.cos(turn), np.sin(turn)
    behind = np.stack([c * across[:, 0] + s * across[:, 1], c * across[:, 1] - s * across[:, 0]], axis=1)
    # squares of bendings of up to 3e-3 rad
    np.testing.assert_allclose(np.angle(np.exp(1j * (turn - angles[:, 0]))), 0.0, atol=3e-5)
    np.testing.assert_allclose(behind, angles[:, 1:], atol=3e-5)


def test_a_wrong_frame_leaks_the_joint_angle_into_the_bendings() -> None:
    angles = np.column_stack([np.linspace(-1.5, 1.5, 50), np.full(50, 2e-4), np.full(50, -1e-4)])
    before, behind = np.array([0.0, 1e-3, -2e-3]), np.array([0.0, 5e-4, 1e-3])
    seen = hinge_angles(mismatched(hinge_rotation(angles), before, behind))
    c, s = np.cos(angles[:, 0]), np.sin(angles[:, 0])
    back = np.stack([c * before[1] + s * before[2], c * before[2] - s * before[1]], axis=1)
    # second order: products of two errors of 2e-3 rad
    np.testing.assert_allclose(seen[:, 1:], angles[:, 1:] + behind[1:] - back, atol=1e-5)


@pytest.mark.parametrize("joint", ["joint_1", "joint_2", "joint_3", "joint_4"])
def test_exact_markers_give_the_coordinates_of_the_flexible_model(robot: Robot, joint: str) -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (20, robot.model.nv)) * (robot.input_matrix.sum(axis=1) + 1e-3)
    q[0] = 0.0  # the reference: undeformed, so that rigid kinematics give the frames
    camera = Camera.looking((3.0, 2.0, 1.0), (0.2, 0.2, 0.8))
    links = links_beside(robot, joint)
    seen = {link: camera.see(x) for link, x in marker_positions(robot, q, dict.fromkeys(links, TRIANGLE)).items()}
    bodies = [fit_rigid_body(seen[link][0], seen[link], STD) for link in links]
    frames = joint_frames(robot, joint, camera.rotation.T, np.zeros(4))
    found = hinge_angles(joint_turn(*bodies, *frames).rotation)
    names = [f"{joint}:{kind}" for kind in ("drive", "torsion", "bend_1", "bend_2")]
    drive, torsion, bend_1, bend_2 = (q[:, robot.coordinates.index(name)] for name in names)
    np.testing.assert_allclose(found, np.stack([drive + torsion, bend_1, bend_2], axis=1), atol=1e-9)


def test_a_joint_that_does_not_exist_is_named(robot: Robot) -> None:
    with pytest.raises(ValueError, match="joint_9"):
        links_beside(robot, "joint_9")


# ---- base -----------------------------------------------------------------------------------------------------


def tip_poses(robot: Robot, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    tree, data = robot.tree, robot.tree.createData()
    frame = tree.getFrameId(robot.tip_frame)
    rotation, position = np.empty((len(angles), 3, 3)), np.empty((len(angles), 3))
    for k, q in enumerate(angles):
        pin.framesForwardKinematics(tree, data, q)
        rotation[k], position[k] = data.oMf[frame].rotation, data.oMf[frame].translation
    return rotation, position


def test_the_base_is_found_within_its_standard_deviations(robot: Robot) -> None:
    rng = np.random.default_rng(4)
    camera = Camera.looking((3.0, 2.5, 1.0), (0.2, 0.2, 0.8))
    rotation, position = tip_poses(robot, rng.uniform(-0.8, 0.8, (25, 4)))
    exact = camera.see(np.einsum("nij,mj->nmi", rotation, TRIANGLE) + position[:, None])
    noise = CameraNoise().times(2.5)
    pulls = []
    for _ in range(60):
        found = calibrate_base(rotation, position, noise.read(exact, rng), noise.std(exact))
        error = Rotation.from_matrix(found.rotation @ camera.rotation).as_rotvec()
        pulls.append(error / found.rotation_std)
    # 180 numbers of variance 1: their mean square is 1 within 0.105 (one sigma)
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.42)
    np.testing.assert_allclose(found.markers, TRIANGLE, atol=1e-3)


def test_moving_joint_1_alone_leaves_the_base_open(robot: Robot) -> None:
    camera = Camera.looking((3.0, 2.5, 1.0), (0.2, 0.2, 0.8))
    rotation, position = tip_poses(
        robot, np.column_stack([np.linspace(-0.7, 0.7, 12), np.tile([0.5, 0.8, 0.0], (12, 1))])
    )
    exact = camera.see(np.einsum("nij,mj->nmi", rotation, TRIANGLE) + position[:, None])
    with pytest.raises(ValueError, match="one axis only"):
        calibrate_base(rotation, position, exact, STD)


# ---- motion ---------------------------------------------------------------------------------------------------


def test_the_carried_motion_is_in_balance_and_its_moments_are_those_of_the_rigid_robot(robot: Robot) -> None:
    position, velocity, acceleration = sine_motion(4, rate_hz=25.0)
    motion = carried_motion(robot, position, velocity, acceleration)
    drives = robot.input_matrix.any(axis=1)
    force = robot.inverse_dynamics(motion.q, velocity @ robot.input_matrix.T, acceleration @ robot.input_matrix.T)
    assert np.abs(force[:, ~drives]).max() < 1e-5  # 1e-12 rad times 4.4e5 N m/rad
    np.testing.assert_allclose(motion.q[:, drives], position, atol=1e-15)
    bend = robot.coordinates.index("joint_2:bend_2")
    # what the deformation itself turns of weight and inertia: deformations of up to 1e-3 rad on each lever
    np.testing.assert_allclose(
        motion.moment[:, bend], 2.4e5 * motion.q[:, bend], atol=0.01 * motion.moment[:, bend].max()
    )


def test_the_drives_torques_are_those_of_the_rigid_robot(robot: Robot) -> None:
    position, velocity, acceleration = sine_motion(4, rate_hz=25.0)
    motion = carried_motion(robot, position, velocity, acceleration)
    expected = robot.rigid().inverse_dynamics(position, velocity, acceleration)
    np.testing.assert_allclose(motion.moment @ robot.input_matrix, expected, atol=1e-8)


# ---- study ----------------------------------------------------------------------------------------------------


def test_without_noise_and_mismatch_every_estimator_is_right(study: Study) -> None:
    for estimator in ESTIMATORS:
        # moments of the rigid robot miss the deformation's own share, below 1e-3 of them per 1e-3 rad
        assert study.error(0.0, 0.0, estimator) < 5e-3, estimator


def test_noise_lowers_the_stiffness_of_the_thesis_regression_by_its_share_of_the_variance(study: Study) -> None:
    scene = study.scene
    found = 1.0 + study.errors(1.0, 0.0, ESTIMATORS[0]).mean(axis=0)
    for i in (0, 1):
        noise = np.mean(
            [
                np.square(hinge_angles(study.turn(t, 1.0, 0.0).rotation)[:, 1 + i] - scene.deformation[:, 1 + i]).mean()
                for t in range(20)
            ]
        )
        power = np.square(scene.deformation[:, 1 + i]).mean()
        # 20 x 512 samples: both variances to 1.4 %, and the covariance of noise and signal averages out
        assert found[i] == pytest.approx(power / (power + noise), rel=0.05)


def test_the_validated_camera_fails_and_a_mismatch_of_a_tenth_of_a_milliradian_spoils_a_perfect_one(
    study: Study,
) -> None:
    assert study.error(2.5, 0.0, ESTIMATORS[0]) > REQUIRED
    for estimator in ESTIMATORS[:2]:
        assert study.error(0.0, 1e-4, estimator) > REQUIRED


def test_fitting_the_frame_takes_the_mismatch_out(study: Study) -> None:
    for estimator in ESTIMATORS[2:]:
        assert study.error(0.0, 1e-2, estimator) < 5e-3, estimator


def test_standard_deviations_of_joint_and_frame_are_those_of_many_trials(study: Study) -> None:
    scene = study.scene
    pulls, frames = [], []
    for trial in range(20):
        found = fit_joint(study.turn(trial, 1.0, 3e-3), scene.drive_angle, scene.moment, frame_prior=3e-3)
        pulls.append((1.0 / found.stiffness - 1.0 / scene.stiffness) * found.stiffness**2 / found.stiffness_std)
        # about the two axes across the joint's own
        error = found.behind - 3e-3 * study.directions[trial, 1]
        frames.append((error / found.behind_std)[1:])
        assert found.chi2 / found.degrees_of_freedom == pytest.approx(1.0, abs=5 * np.sqrt(2 / (3 * 512)))
    # 60 and 40 numbers of variance 1: mean squares within four of their standard errors
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 60))
    assert np.mean(np.square(frames)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 40))


def test_frames_from_rigid_kinematics_spoil_the_stiffness_and_fitting_them_saves_it(robot: Robot) -> None:
    scene = make_scene(robot, "joint_1", rate_hz=125.0)
    noise = CameraNoise()
    bodies = rigid_bodies(scene, noise.read(scene.markers, np.random.default_rng(8)), noise)
    # the base is known exactly; the reference pose sags by up to 1e-3 rad, of which rigid kinematics know nothing
    frames = joint_frames(robot, "joint_1", scene.camera.rotation.T, sine_motion(4)[0][0])
    turn = joint_turn(*bodies, *frames)
    naive = regress_bending(turn, scene.moment[:, 1:], response="deformation")
    found = fit_joint(turn, scene.drive_angle, scene.moment)
    assert np.abs(naive / 4.4e5 - 1.0).max() > 0.5
    assert (np.abs(found.stiffness - scene.stiffness) < 4 * found.stiffness_std).all()
    assert (np.abs(found.deformation - scene.deformation).mean(axis=0) < 1e-4).all()  # noise of 7e-5 rad a link


def test_one_stiffness_for_both_bendings_is_more_accurate_than_two(study: Study) -> None:
    one = study.errors(1.0, 0.0, ESTIMATORS[3])
    np.testing.assert_array_equal(one[:, 0], one[:, 1])  # joint_2 is as stiff in both
    assert one.std() < study.errors(1.0, 0.0, ESTIMATORS[2]).std()


def test_errors_of_turns_are_linear_in_the_noise(scene: Scene) -> None:
    noise = CameraNoise(resolution=0.0)
    study = make_study(scene, 1, np.random.default_rng(7), noise)
    direct = noise.times(2.5)
    bodies = rigid_bodies(scene, direct.read(scene.markers, np.random.default_rng(7)), direct)
    expected = hinge_angles(joint_turn(*bodies, *scene.frames).rotation)
    found = hinge_angles(study.turn(0, 2.5, 0.0).rotation)
    largest = np.abs(expected - hinge_angles(study.turn(0, 0.0, 0.0).rotation)).max()
    assert np.abs(found - expected).max() < 2 * largest**2  # second order


def test_what_is_enough_is_where_the_error_passes_5_percent(study: Study) -> None:
    noise = study.enough(ESTIMATORS[1], mismatch=0.0)
    frame = study.enough(ESTIMATORS[1], factor=0.0)
    assert study.error(0.9 * noise, 0.0, ESTIMATORS[1]) < REQUIRED < study.error(1.1 * noise, 0.0, ESTIMATORS[1])
    assert study.error(0.0, 0.9 * frame, ESTIMATORS[1]) < REQUIRED < study.error(0.0, 1.1 * frame, ESTIMATORS[1])


@pytest.mark.parametrize("arguments", [{}, {"factor": 1.0, "mismatch": 0.0}])
def test_one_of_noise_and_mismatch_is_given(study: Study, arguments: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="one of them"):
        study.enough(ESTIMATORS[0], **arguments)


def test_a_moment_that_is_never_there_is_refused(scene: Scene, study: Study) -> None:
    moment = scene.moment * [1.0, 0.0, 1.0]
    with pytest.raises(ValueError, match="zero throughout"):
        fit_joint(study.turn(0, 1.0, 0.0), scene.drive_angle, moment)
    with pytest.raises(ValueError, match="response"):
        regress_bending(study.turn(0, 1.0, 0.0), scene.moment[:, 1:], response="both")


def test_links_of_the_scene_move_as_the_flexible_robot_does(robot: Robot) -> None:
    q = np.zeros((1, robot.model.nv))
    poses = link_poses(robot, q, ["link_4"])
    np.testing.assert_allclose(poses["link_4"][1][0], [0.0, 0.0, 0.94], atol=1e-12)


def test_figures_name_their_axes_with_units(study: Study) -> None:
    turn = study.turn(0, 2.5, 1e-3)
    fitted = fit_joint(turn, study.scene.drive_angle, study.scene.moment)
    leak = leak_figure(study.scene, turn, fitted, 125.0)
    assert [ax.get_ylabel().split(", ")[1] for ax in leak.axes] == ["rad", "10⁻³ rad", "10⁻³ rad"]
    errors = np.array([[[0.01, 0.1], [0.1, 1.0]]])
    shown = error_map_figure([0.1, 1.0], [1e-4, 1e-3], errors, ["estimator"], "joint_2")
    assert "10⁻³ rad" in shown.axes[0].get_ylabel()
