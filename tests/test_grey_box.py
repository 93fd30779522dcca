"""Claims about the grey box: on responses of the linearised robot with noise, whose truth is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.identify.grey_box import GreyBox, grey_box
from rx90b_flex.identify.grey_data import REACH_HZ, GreyBoxOptions, PoseResponse, smoothed_covariance
from rx90b_flex.identify.grey_model import poses_along
from rx90b_flex.identify.grey_problem import grey_problem
from rx90b_flex.robot import Robot, load_robot

HZ = np.arange(33, 322, 2) / 4.096
SLOPES = (60.0, 32.0, 14.0)
STRETCHED, BENT = np.array([0.0, 0.5 * np.pi, 0.0]), np.array([0.0, 0.5 * np.pi, 1.0])
EXACT = GreyBoxOptions(starts=0, model_error=0.0, friction_error=0.0)


def robot() -> Robot:
    """The 3-DOF robot with viscous friction, so that its linearisation is the truth."""
    declared = load_robot("rx90b_3dof")
    viscous = [ViscousFriction(joint=j, coefficient=c) for j, c in zip(declared.joints, SLOPES, strict=True)]
    return declared.with_effects([*(e for e in declared.effects if not e.traits.is_friction), *viscous])


def response(true: Robot, pose: np.ndarray, noise: float, rng: np.random.Generator | None = None) -> FrequencyResponse:
    """Its response at a pose, each entry with independent noise of that part of its magnitude."""
    clean = true.linearize(true.input_matrix @ pose).frf(HZ)
    covariance = ((noise * np.abs(clean)).reshape(len(HZ), 9) ** 2)[:, :, None] * np.eye(9)
    drawn = np.zeros((2, *clean.shape)) if rng is None else rng.standard_normal((2, *clean.shape)) / np.sqrt(2.0)
    value = clean + noise * np.abs(clean) * (drawn[0] + 1j * drawn[1])
    return FrequencyResponse(HZ, value, covariance.astype(complex), true.joints, pose)


def wrong(true: Robot, spread: float, seed: int) -> Robot:
    """The same robot with drives and flexibilities declared wrong: logarithms off by that standard deviation."""
    rng = np.random.default_rng(seed)
    return true.with_effects([
        e.with_coefficients(e.coefficients * np.exp(spread * rng.standard_normal(len(e.coefficients))))
        if e.traits.in_drivetrain else e
        for e in true.effects
    ])  # fmt: skip


def truth(true: Robot) -> dict[str, float]:
    """By the grey box's names, from the effects themselves."""
    out = {}
    for e in true.effects:
        if e.type_name() == "drive_inertia":
            out[f"{e.joints[0]}.drive_inertia"] = e.inertia
        elif e.type_name() == "drive_flexibility":
            out[f"{e.joints[0]}.drive_stiffness"], out[f"{e.joints[0]}.drive_damping"] = e.stiffness, e.damping
        elif e.type_name() == "joint_flexibility":
            for i in (0, 1):
                out[f"{e.joints[0]}.joint_stiffness_{i + 1}"] = e.stiffness[i]
                out[f"{e.joints[0]}.joint_damping_{i + 1}"] = e.damping[i]
        elif e.type_name() == "viscous_friction":
            out[f"{e.joints[0]}.friction_slope"] = e.coefficient
    return out


def scores(grey: GreyBox, true: dict[str, float]) -> np.ndarray:
    """How many standard deviations each logarithm is from the truth."""
    return np.array([np.log(e.value / true[e.name]) * e.value / e.std for e in grey.estimates])


def test_the_model_is_the_linearised_robot():
    true = robot()
    problem = grey_problem(true, [PoseResponse(response(true, BENT, 0.03))], GreyBoxOptions(link_mass_std=0.02))
    np.testing.assert_allclose(problem.predicted(problem.declared)[0], problem.terms[0].response.value, rtol=1e-9)


@pytest.mark.parametrize("motion", ["one pose", "closed loop, three experiments"])
def test_the_jacobian_is_the_derivative(motion):
    true = robot()
    rng = np.random.default_rng(3)
    along, feedback, torques = None, None, None
    if motion != "one pose":
        along = STRETCHED + 0.1 * np.array([-1.0, 0.0, 1.0])[:, None]
        torques = rng.standard_normal((len(HZ), 3, 3)) + 1j * rng.standard_normal((len(HZ), 3, 3))

        def feedback(hz):
            s = 2j * np.pi * np.asarray(hz)[:, None, None]
            return (7e4 + 1.5e3 * s) / s**2 * np.eye(3)

    given = PoseResponse(response(true, STRETCHED, 0.03), along, torques, feedback)
    problem = grey_problem(true, [given], GreyBoxOptions(link_mass_std=0.02, bending_alike_std=0.1, hinge_std=0.02))
    problem = problem.with_bias(problem.declared, (0.01, 0.5))
    x = problem.declared + 0.1 * rng.standard_normal(len(problem.declared))
    jacobian = problem.jacobian(x[problem.free])
    direction = rng.standard_normal(len(x))
    step = 1e-4
    both = [problem.residual(x + sign * step * direction) for sign in (1, -1)]
    # central differences: error of the second order in the step, 1e-8 of the residual's third derivative
    np.testing.assert_allclose(
        (both[0] - both[1]) / (2 * step), jacobian @ direction, atol=1e-5 * np.abs(jacobian).max()
    )


def test_three_per_cent_of_noise_gives_stiffness_and_inertia():
    true = robot()
    data = response(true, BENT, 0.03, np.random.default_rng(0))
    grey = grey_box(wrong(true, 0.3, 1), data, dataclasses.replace(EXACT, starts=4))
    z = scores(grey, truth(true))
    # 24 standard normal numbers: one beyond 4 in 660 trials
    assert np.abs(z).max() < 4.0
    for e in grey.estimates:
        if "drive_stiffness" in e.name or "drive_inertia" in e.name:
            assert abs(e.value / truth(true)[e.name] - 1.0) < 0.03, e.name
    assert not grey.bias_detected
    assert grey.cost == pytest.approx(grey.expected_cost, rel=4.0 / np.sqrt(grey.expected_cost))
    fitted = {p: v for p, v in truth(grey.robot).items() if "slope" not in p}
    for name, value in fitted.items():
        assert value == pytest.approx(grey[name].value, rel=1e-12)


@pytest.mark.parametrize("delay", [1.25e-4, -1.25e-4, 0.0])
def test_torques_logged_late_are_told_as_that_and_move_nothing_else(delay):
    true = robot()
    data = response(true, BENT, 0.01, np.random.default_rng(6))
    skewed = dataclasses.replace(data, value=data.value * np.exp(2j * np.pi * HZ * delay)[:, None, None])
    grey = grey_box(wrong(true, 0.1, 1), skewed, EXACT)
    found = grey.torque_delay
    assert found.std < 5e-6 and abs(found.value - delay) < min(4.0 * found.std, 10e-6)
    assert np.abs(scores(grey, truth(true))).max() < 4.0
    assert not grey.bias_detected
    trusted = grey_box(true, skewed, dataclasses.replace(EXACT, delay_std=0.0))
    assert trusted.torque_delay is None
    assert bool(delay) == trusted.bias_detected


def test_a_bias_that_is_known_of_is_part_of_the_intervals_and_of_the_covariance():
    grey = grey_box(robot(), response(robot(), BENT, 0.03), EXACT)
    off = {"joint_1.drive_stiffness": 0.2, "joint_2.drive_inertia": -0.1}
    doubted = grey.doubted(off)
    for was, now in zip(grey.estimates, doubted.estimates, strict=True):
        assert now.value == was.value
        assert now.std / now.value == pytest.approx(np.hypot(was.std / was.value, off.get(now.name, 0.0)), rel=1e-12)
        assert now.low <= was.low * (1 + 1e-12) and now.high >= was.high * (1 - 1e-12)
    np.testing.assert_allclose(
        np.sqrt(np.diag(doubted.covariance)), [e.std / e.value for e in doubted.estimates], rtol=1e-9
    )


def test_values_stay_where_the_widths_are_those_of_a_fit_that_allows_for_more():
    data = response(robot(), BENT, 0.03, np.random.default_rng(3))
    narrow = grey_box(robot(), data, EXACT)
    wide = grey_box(robot(), data, dataclasses.replace(EXACT, friction_error=0.3))
    both = narrow.as_wide_as(wide)
    for own, width, now in zip(narrow.estimates, wide.estimates, both.estimates, strict=True):
        assert now.value == own.value
        assert now.std / now.value == pytest.approx(width.std / width.value, rel=1e-12)
        assert np.log(now.high / now.low) == pytest.approx(np.log(width.high / width.low), abs=1e-12)
        assert now.low <= now.value <= now.high
    inertias = [e.name for e in both.estimates if "inertia" in e.name]
    assert all(both[name].std > narrow[name].std for name in inertias)
    assert (both.friction_error, both.model_error) == (0.3, wide.model_error)
    np.testing.assert_array_equal(both.covariance, wide.covariance)


def test_starts_half_off_end_in_one_minimum():
    true = robot()
    data = response(true, BENT, 0.03, np.random.default_rng(0))
    here = grey_box(true, data, EXACT)
    far = grey_box(wrong(true, 0.5, 7), data, dataclasses.replace(EXACT, starts=6))
    # the declared values are also the centre of a prior with a standard deviation of 2, hardly felt
    assert far.cost == pytest.approx(here.cost, abs=1.0)


def test_a_stretched_arm_hardly_tells_where_it_rolls_and_says_so():
    # stretched out, joint_2 and joint_3 both bend about the arm's own axis; what parts them is link 2 between them
    true = robot()
    stretched = grey_box(true, response(true, STRETCHED, 0.03), EXACT)
    names = {name for d in stretched.directions for name, _ in d.parts}
    assert {"joint_2.joint_damping_1", "joint_3.joint_damping_1"} <= names
    assert "joint 2 joint damping 1" in " ".join(d.words for d in stretched.directions)
    rolling = ("joint_2.joint_stiffness_1", "joint_3.joint_stiffness_1")
    others = [e.std / e.value for e in stretched.estimates if "stiffness" in e.name and e.name not in rolling]
    # a second pose tells them apart, as does the assumption that bearings are round
    both = grey_box(true, [response(true, pose, 0.03) for pose in (STRETCHED, BENT)], EXACT)
    alike = grey_box(true, response(true, STRETCHED, 0.03), dataclasses.replace(EXACT, bending_alike_std=0.05))
    for name in rolling:
        assert stretched[name].std > 5 * max(others) * stretched[name].value
        assert both[name].std < 0.5 * stretched[name].std
        assert alike[name].std < stretched[name].std
    for name in ("joint_2.joint_damping_1", "joint_3.joint_damping_1"):
        assert alike[name].std < 0.3 * stretched[name].std
    assert all(d.relative_std >= 0.1 for d in stretched.directions)


def test_wrong_masses_are_within_the_intervals_where_a_prior_allows_for_them():
    from rx90b_flex.export import with_link_parameters

    true = robot()
    off = np.array([1.02, 0.98, 1.02])[: len(true.bodies)]
    heavier = with_link_parameters(true, np.repeat(off, 10) * true.link_parameters, allow_inconsistent=True)
    data = response(true, BENT, 0.03, np.random.default_rng(2))
    stated = grey_box(heavier, data, dataclasses.replace(EXACT, link_mass_std=0.02))
    trusted = grey_box(heavier, data, EXACT)
    known = truth(true)
    stiff = [j for j, e in enumerate(stated.estimates) if "stiffness" in e.name]
    z = [
        np.abs(np.log(e.value / known[e.name]) * e.value / e.std)
        for g in (stated, trusted)
        for e in np.array(g.estimates)[stiff]
    ]
    assert max(z[: len(stiff)]) < 4.0 < max(z[len(stiff) :])
    for e in stated.estimates:
        if "drive_stiffness" in e.name:
            assert abs(e.value / known[e.name] - 1.0) < 0.05, e.name


def test_friction_of_each_experiment_is_told_apart():
    true = robot()
    rng = np.random.default_rng(4)
    torques = rng.standard_normal((len(HZ), 3, 3)) + 1j * rng.standard_normal((len(HZ), 3, 3))
    slopes = np.outer([1.0, 1.5, 2.5], SLOPES)  # of each experiment
    columns = []
    for k, own in enumerate(slopes):
        viscous = [ViscousFriction(joint=j, coefficient=c) for j, c in zip(true.joints, own, strict=True)]
        rubbed = true.with_effects([*(e for e in true.effects if not e.traits.is_friction), *viscous])
        columns.append(rubbed.linearize(rubbed.input_matrix @ BENT).frf(HZ) @ torques[:, :, k, None])
    value = np.concatenate(columns, axis=2) @ np.linalg.inv(torques)
    data = dataclasses.replace(response(true, BENT, 0.01), value=value)
    grey = grey_box(true, [PoseResponse(data, torques=torques)], EXACT)
    assert (
        grey.cost < 1e-3 * grey.expected_cost
    )  # no noise in it; the weak prior of the slopes' start is all that is left
    for k, own in enumerate(slopes):
        for joint, slope in zip(true.joints, own, strict=True):
            assert grey[f"{joint}.friction_slope_{k + 1}"].value == pytest.approx(slope, rel=0.01)


def test_the_size_of_a_smooth_error_is_estimated():
    true, rng = robot(), np.random.default_rng(11)
    data = response(true, BENT, 0.003, rng)
    alike = np.exp(-0.5 * ((HZ[:, None] - HZ) / REACH_HZ) ** 2)
    values, vectors = np.linalg.eigh(alike)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = rng.standard_normal((2, len(HZ), 9)) / np.sqrt(2.0)
    smooth = (root @ (drawn[0] + 1j * drawn[1])).reshape(data.value.shape)
    size = 0.02
    off = dataclasses.replace(data, value=data.value + size * np.abs(data.value) * smooth)
    # some 14 independent values an entry, of 9 entries: 126 complex numbers, less 24 real parameters
    estimated = dataclasses.replace(EXACT, model_error=None)
    assert grey_box(true, off, estimated).model_error == pytest.approx(size, rel=0.3)
    none = grey_box(true, data, estimated)
    assert none.model_error < 0.003  # not above the noise


def test_covariances_of_few_degrees_of_freedom_are_smoothed_and_an_interfering_line_kept():
    rng = np.random.default_rng(5)
    errors = (rng.standard_normal((2, 15, len(HZ), 9)) / np.sqrt(2.0)).transpose(0, 2, 1, 3)
    errors = errors[0] + 1j * errors[1]
    errors[70] *= 30.0
    covariance = np.einsum("fra,frb->fab", errors, errors.conj()) / 15
    data = dataclasses.replace(response(robot(), BENT, 0.03), covariance=covariance, degrees_of_freedom=15.0)
    smooth, freedom = smoothed_covariance(data)
    assert freedom >= 8 * 9 * 0.9
    assert np.linalg.cond(smooth[30]) < np.linalg.cond(covariance[30]) / 3
    np.testing.assert_allclose(np.diag(smooth[70]).real, np.diag(covariance[70]).real, rtol=1e-9)


def test_three_poses_have_the_moments_of_a_motion_to_and_fro():
    position = np.concatenate([np.linspace(-0.1, 0.1, 500), np.linspace(0.1, -0.1, 500)])[:, None] * [1.0, 1.0, 0.0]
    poses = poses_along(STRETCHED + position)
    np.testing.assert_allclose(poses.mean(axis=0), STRETCHED, atol=1e-12)
    np.testing.assert_allclose(poses.std(axis=0), position.std(axis=0), atol=1e-12)
    assert poses[2, 0] - poses[0, 0] == pytest.approx(np.sqrt(2.0) * 0.1, rel=1e-2)


def test_bad_input_is_named():
    true, data = robot(), response(robot(), BENT, 0.03)
    cases = [
        ({"band_hz": (200.0, 300.0)}, "0 lines between 200 and 300 Hz"),
        ({"fixed": ("joint_2.drive_stifness",)}, r"no parameter 'joint_2.drive_stifness'.*drive_stiffness"),
    ]
    for chosen, message in cases:
        with pytest.raises(ValueError, match=message):
            grey_box(true, data, GreyBoxOptions(**chosen))
    with pytest.raises(ValueError, match=r"joint_1\.drive_stiffness is -1"):
        grey_box(true, data, start={"joint_1.drive_stiffness": -1.0})
    with pytest.raises(ValueError, match="torques has shape"):
        PoseResponse(data, torques=np.ones((3, 3, 3)))
    with pytest.raises(ValueError, match="pose has shape"):
        grey_box(true, dataclasses.replace(data, pose=np.zeros(0)))
    with pytest.raises(ValueError, match=r"not positive definite at 8\.06 Hz"):
        grey_box(true, dataclasses.replace(data, covariance=0.0 * data.covariance))
    blank = true.with_effects(
        [e.with_coefficients([np.nan]) if e.type_name() == "drive_inertia" else e for e in true.effects]
    )
    with pytest.raises(ValueError, match=r"joint_1.drive_inertia: joint_1.drive_inertia is nan"):
        grey_box(blank, data)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    true, inside = robot(), []
    for seed in range(40):
        data = response(true, BENT, 0.03, np.random.default_rng(seed))
        grey = grey_box(true, data, EXACT)
        inside.append(np.abs(scores(grey, truth(true))) < 1.96)
    # intervals of one seed depend on each other: their mean over a seed is one number, with a deviation found over the seeds
    each = np.mean(inside, axis=1)
    assert np.mean(each) == pytest.approx(0.95, abs=3.0 * max(np.std(each), 0.03) / np.sqrt(len(each)))
