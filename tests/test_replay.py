"""Claims about replayed experiments: on a small simulated campaign on the 3-DOF robot, whose friction and parameters are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import resample

import rx90b_flex as rf
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import DriveFlexibility
from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse, estimate_frequency_response
from rx90b_flex.identify.grey_box import GreyBox, grey_box
from rx90b_flex.identify.grey_data import GreyBoxOptions
from rx90b_flex.identify.grey_model import grey_parameters, matrices_at, response_derivatives, slope_name
from rx90b_flex.identify.replay import (
    Less,
    PosesReplayed,
    Replay,
    _frictions,
    _with_friction,
    grey_box_by_replay,
    linear_response,
    shifts_between,
    sticking,
)
from rx90b_flex.identify.transfer_function import fit_transfer_functions
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording, load_campaign
from rx90b_flex.simulate import Noise, load_cs8, run_campaign, section_662
from rx90b_flex.simulate.filters import Filter

BAND_HZ = (8.0, 80.0)
SLOPES = {"joint_1": 60.0, "joint_2": 40.0, "joint_3": 16.0}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, ...]:
    """Three realisations of section 6.6.2's experiments, two periods of which one counts, with noise."""
    folder: Path = tmp_path_factory.mktemp("replay")
    noise = Noise(torque=0.1, position=1e-6, velocity=1e-4)
    plan = section_662(
        load_robot("rx90b_3dof"), load_cs8(), noise=noise, realisations=3, periods=2, method="perturbation", seed=3
    )
    result = run_campaign(plan, folder / "campaign")
    assert result.file is not None and not result.failed
    return load_campaign(result.file).identification


@pytest.fixture(scope="module")
def measured(recordings: tuple[Recording, ...]) -> MeasuredResponse:
    return estimate_frequency_response(recordings, band_hz=BAND_HZ)


@pytest.fixture(scope="module")
def replay(recordings: tuple[Recording, ...], measured: MeasuredResponse) -> Replay:
    return Replay.of(recordings, measured, load_cs8())


@pytest.fixture(scope="module")
def true_replayed(replay: Replay) -> np.ndarray:
    return replay.responses(load_robot("rx90b_3dof"))


def friction(robot: Robot) -> np.ndarray:
    return np.concatenate([e.coefficients for e in _frictions(robot, robot.joints)])


def test_replayed_on_the_true_robot_only_noise_is_left(measured: MeasuredResponse, true_replayed: np.ndarray) -> None:
    # the noise is 16 times weaker than the distortion in every drive point; what is left of realisations has no distortion in it
    before, after = (x.std(axis=0, ddof=1) for x in (measured.realisations, measured.realisations - true_replayed))
    ratio = np.median(after / before, axis=0)
    assert (np.diag(ratio) < 0.1).all()
    # mean of three realisations: the noise's own, complex normal; half of it on either side of the median
    left = np.abs((measured.realisations - true_replayed).mean(axis=0)) / (after / np.sqrt(3.0))
    assert 0.3 < np.median(left) < 2.0


def test_the_response_without_distortion_is_the_linear_one(
    measured: MeasuredResponse, true_replayed: np.ndarray
) -> None:
    robot = load_robot("rx90b_3dof")
    line = linear_response(robot, robot.joints, np.array([0.0, 0.5 * np.pi, 0.0]), SLOPES, measured.hz)
    less = Less(measured, true_replayed, line, np.array([0.0, 0.5 * np.pi, 0.0]))
    was, left = (np.median(np.abs(x - line) / np.abs(line), axis=0) for x in (measured.value, less.response.value))
    assert (np.diag(left) < 0.1 * np.diag(was)).all()
    assert np.mean(less.doubted.std() >= less.response.std()) > 0.9
    # what is left of a right robot's replay is noise, so that hardly more than the simulation's own error is doubted
    assert (less.left < 0.3).all()
    # what is stated of the mean's error is what it has, entries' correlations with it: unit variance, over 145 lines of 9 entries
    whitener = np.linalg.inv(np.linalg.cholesky(less.response.covariance))
    error = np.einsum("fab,fb->fa", whitener, (less.response.value - line).reshape(len(line), -1))
    assert 0.8 < np.sqrt(np.mean(np.abs(error) ** 2)) < 1.25


def test_what_a_replay_leaves_of_the_distortion_is_not_trusted(
    measured: MeasuredResponse, true_replayed: np.ndarray
) -> None:
    """A joint whose friction is replayed wrongly is trusted less, and the others as before; one that is not replayed, not at all."""
    robot = load_robot("rx90b_3dof")
    line = linear_response(robot, robot.joints, np.array([0.0, 0.5 * np.pi, 0.0]), SLOPES, measured.hz)
    torque = np.linalg.solve(line, true_replayed - line)

    def left(*factors: float) -> np.ndarray:
        simulated = line + line @ (np.array(factors)[:, None] * torque)
        return Less(measured, simulated, line, np.zeros(3)).left

    right = left(1.0, 1.0, 1.0)
    wrong = left(1.0, 0.8, 1.0)
    assert wrong[1] > 1.5 * right[1] and wrong[1] > 0.35
    np.testing.assert_allclose(wrong[[0, 2]], right[[0, 2]])
    np.testing.assert_allclose(left(0.0, 0.0, 0.0), 1.0)


def test_steps_of_a_slow_controller_are_known_and_no_distortion(replay: Replay) -> None:
    """At rest, with viscous friction, a simulation in steps of 1 ms shows a response that is known and not the robot's."""
    robot = load_robot("rx90b_3dof")
    viscous = [ViscousFriction(joint=j, coefficient=c, side="motor") for j, c in SLOPES.items()]
    robot = robot.with_effects([*(e for e in robot.effects if not e.traits.is_friction), *viscous])
    pose = np.array([0.0, 0.5 * np.pi, 0.0])
    resting = tuple(
        dataclasses.replace(t, position=np.tile(pose, (len(t.position), 1)), velocity=np.zeros_like(t.velocity))
        for t in replay.trajectories
    )
    controller = dataclasses.replace(load_cs8().for_joints(robot.joints), controller_rate_hz=1000.0).ideal()
    slow = dataclasses.replace(replay, trajectories=resting, controller=controller)
    shown = slow.responses(robot).mean(axis=0)

    def line(hz: np.ndarray) -> np.ndarray:
        return linear_response(robot, robot.joints, pose, SLOPES, hz)

    plain, known = (np.abs(shown - x) for x in (line(slow.measured.hz), slow.by_steps(line)))
    assert plain.max() > 0.02
    # the transient of the first period has died to 1e-4 in the second
    assert known.max() < 1e-3 * plain.max()


def test_torques_tell_a_controller_that_is_not_the_one(replay: Replay) -> None:
    """By its gains, or by a filter that its file leaves out."""
    robot = load_robot("rx90b_3dof")
    right = replay.torques_off(robot, 0.0)
    slow = [dataclasses.replace(j, velocity_filters=(Filter("low_pass", 20.0),)) for j in replay.controller.joints]
    soft = [dataclasses.replace(j, position_gain=0.5 * j.position_gain) for j in replay.controller.joints]
    filtered, weaker = (
        dataclasses.replace(replay, controller=dataclasses.replace(replay.controller, joints=tuple(x)))
        for x in (slow, soft)
    )
    assert (right < 0.05).all()
    assert (filtered.torques_off(robot, 0.0) > 5.0 * right).all()
    assert weaker.torques_off(robot, 0.0).max() > 3.0 * right.max()
    # torques that were logged a quarter of a millisecond late are brought back first
    late = replay.torques_off(robot, 2.5e-4)
    assert (late > right).all()


@pytest.mark.slow
def test_wrong_friction_is_found_from_the_distortion(replay: Replay) -> None:
    robot = load_robot("rx90b_3dof")
    true = friction(robot)
    wrong = true * (1.0 + 0.1 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0]))
    pose, found, by_friction = np.array([0.0, 0.5 * np.pi, 0.0]), wrong, None
    at = PosesReplayed((replay,), (pose,), SLOPES)
    for _ in range(3):
        off = _with_friction(robot, robot.joints, found)
        now = replay.responses(off)
        if by_friction is None:
            by_friction = at.friction_derivatives(off, found, [now])
        linear = response_derivatives(off, robot.joints, pose, SLOPES, replay.measured.hz)
        step, std = at.friction_step([now], by_friction, [linear])
        found = found * (1.0 + step)
    # reversals shift with the friction: a step leaves more than products of errors, at worst half of them, an eighth after three
    error = np.abs(found / true - 1.0)
    assert error[2:].max() < 0.1 / 8.0
    assert (error[:2] < 0.1).all()  # joint 1 hardly vibrates: its friction shows little, but comes nearer
    assert (std > 0).all()


@pytest.mark.slow
def test_intervals_hold_the_truth_as_measured_and_by_replay(replay: Replay, measured: MeasuredResponse) -> None:
    """Friction's bias that the replay tells of is in the intervals of the fit that still has it."""
    robot = load_robot("rx90b_3dof")
    pose = np.array([0.0, 0.5 * np.pi, 0.0])
    options = GreyBoxOptions(starts=0, bending_alike_std=0.1)
    first = grey_box(robot, dataclasses.replace(measured, pose=pose), options)
    found = grey_box_by_replay(robot, first, replay, rounds=2, fit_friction=False)
    told = first.doubted(shifts_between(first, found.grey))

    def inside(grey: GreyBox) -> float:
        # declared values are the truth
        own = [e for e in grey.estimates if "slope" not in e.name]
        return float(np.mean([e.low <= e.start <= e.high for e in own]))

    # of 21 that depend on each other, at least 17: a share of 0.8
    assert inside(told) >= max(inside(first), 0.8)
    assert inside(found.grey) >= 0.8
    assert found.grey.torque_delay is not None
    assert abs(found.grey.torque_delay.value) < max(4.0 * found.grey.torque_delay.std, 1e-5)


@pytest.mark.slow
def test_a_joint_that_is_not_excited_does_not_stand_in_the_way(tmp_path: Path) -> None:
    # no response shows the drive inertia of the wrist, which is held
    robot = load_robot("rx90b_4dof")
    noise = Noise(torque=0.1, position=1e-6, velocity=1e-4)
    plan = section_662(robot, load_cs8(), noise=noise, realisations=3, periods=2, method="perturbation", seed=3)
    done = run_campaign(plan, tmp_path / "campaign")
    assert done.file is not None
    recordings = load_campaign(done.file).identification
    response = estimate_frequency_response(recordings, joints=robot.joints[:3], band_hz=BAND_HZ)
    pose = np.array([0.0, 0.5 * np.pi, 0.0, 0.0])
    at = PosesReplayed((Replay.of(recordings, response, load_cs8()),), (pose,), SLOPES)
    known = np.concatenate([e.coefficients for e in _frictions(robot, response.joints)])
    now = at.simulated([robot])[0]
    on_time = [np.ones((len(response.hz), 1, 1))]
    _, found, std = at.with_friction_step(robot, known, now, at.friction_derivatives(robot, known, now), on_time)
    assert found == pytest.approx(known, rel=0.1 / 8.0)  # as near as wrong friction is brought above
    assert (std > 0.0).all()
    assert at.replays[0].torques_off(robot, 0.0).shape == (3,)
    first = grey_box(robot, dataclasses.replace(response, pose=pose), GreyBoxOptions(BAND_HZ, starts=0))
    grey = grey_box_by_replay(robot, first, at.replays, rounds=2, fit_friction=False).grey
    # what the wrist's drive does is held against nothing that moves it
    assert not any(e.determined for e in grey.estimates if e.name.startswith("joint_4.drive_"))
    told = [e for e in grey.estimates if e.determined and "slope" not in e.name]
    inside = [e.low <= e.start <= e.high for e in told]
    # 95 % intervals that depend on each other
    assert len(told) > 15 and np.mean(inside) >= 0.8


def test_linear_derivatives_are_the_differences_of_linear_responses() -> None:
    robot, hz = load_robot("rx90b_3dof"), np.linspace(8.0, 80.0, 7)
    pose = np.array([0.0, 1.0, 0.5])
    by = response_derivatives(robot, robot.joints, pose, SLOPES, hz)
    coefficients = [
        (i, k) for i, e in enumerate(robot.effects) if e.traits.in_drivetrain for k in range(len(e.coefficients))
    ]
    assert len(by) == len(coefficients)
    step = 1e-4
    for told, (place, k) in zip(by, coefficients, strict=True):
        sides = []
        for sign in (1.0, -1.0):
            effects = list(robot.effects)
            factor = np.where(np.arange(len(effects[place].coefficients)) == k, np.exp(sign * step), 1.0)
            effects[place] = effects[place].with_coefficients(effects[place].coefficients * factor)
            sides.append(linear_response(robot.with_effects(effects), robot.joints, pose, SLOPES, hz))
        # central differences: second order in the step
        np.testing.assert_allclose((sides[0] - sides[1]) / (2 * step), told, atol=1e-6 * np.abs(told).max())


def test_a_drive_that_is_not_excited_is_held_in_the_linear_response() -> None:
    """As by an inertia that no vibration moves; and as the grey box has it that is fitted to what is left."""
    robot, hz = load_robot("rx90b_3dof"), np.linspace(8.0, 80.0, 7)
    pose, excited = np.array([0.0, 1.0, 0.5]), ("joint_1", "joint_2")
    slopes = {joint: SLOPES[joint] for joint in excited}
    held = linear_response(robot, excited, pose, slopes, hz)
    heavy = robot.with_effects(
        e.with_coefficients(1e9 * e.coefficients)
        if e.type_name() == "drive_inertia" and e.joints == ("joint_3",)
        else e
        for e in robot.effects
    )
    free = linear_response(heavy, robot.joints, pose, SLOPES, hz)[:, :2, :2]
    np.testing.assert_allclose(held, free, atol=1e-6 * np.abs(free).max())
    parameters = grey_parameters(robot, excited, 1, 0.0)
    names = {joint: slope_name(joint, 0, 1) for joint in excited}
    values = {p.name: p.declared for p in parameters} | {names[joint]: slopes[joint] for joint in excited}
    grey = matrices_at(robot, names, pose, parameters).response(hz, np.array([values[p.name] for p in parameters]))
    np.testing.assert_allclose(held, grey, rtol=1e-9)


def test_drives_that_are_not_excited_stick_by_dry_friction_only() -> None:
    robot = load_robot("rx90b_3dof")
    assert sticking(robot, robot.joints) == ()
    assert sticking(robot, robot.joints[:2]) == ("joint_3",)
    slopes = [ViscousFriction(joint=joint, coefficient=slope) for joint, slope in SLOPES.items()]
    viscous = robot.with_effects([*(e for e in robot.effects if not e.traits.is_friction), *slopes])
    assert sticking(viscous, robot.joints[:2]) == ()


def test_logged_torques_replay_the_experiments_without_controller_and_references(
    recordings: tuple[Recording, ...], measured: MeasuredResponse
) -> None:
    """Another controller than the robot's leads it; the distortion that realisations differ by is the same all the same."""
    bare = [dataclasses.replace(r, reference_position=None, reference_velocity=None, velocity=None) for r in recordings]
    robot = load_robot("rx90b_3dof")
    simulated = Replay.from_torques(bare, measured, robot).responses(robot)
    pose = np.array([0.0, 0.5 * np.pi, 0.0])
    line = linear_response(robot, robot.joints, pose, SLOPES, measured.hz)
    plain = Less(measured, simulated, line, pose).response
    before, after = (x.std(axis=0, ddof=1) for x in (measured.realisations, measured.realisations - simulated))
    was, left = (np.median(np.abs(x - line) / np.abs(line), axis=0) for x in (measured.value, plain.value))
    assert (np.diag(np.median(after / before, axis=0)) < 0.3).all()
    assert (np.diag(left) < 0.3 * np.diag(was)).all()
    with pytest.raises(ValueError, match="lacks a period"):
        Replay.from_torques([dataclasses.replace(bare[0], period_s=None), *bare[1:]], measured, robot)


def test_what_cannot_be_replayed_is_named(recordings: tuple[Recording, ...], measured: MeasuredResponse) -> None:
    bare = [dataclasses.replace(recordings[0], reference_position=None), *recordings[1:]]
    with pytest.raises(ValueError, match="lacks references"):
        Replay.of(bare, measured, load_cs8())
    reference = recordings[1].reference_position
    assert reference is not None
    other = [recordings[0], dataclasses.replace(recordings[1], reference_position=reference + 0.1), *recordings[2:]]
    with pytest.raises(ValueError, match=r"run_000_1_plus.*differ in their references"):
        Replay.of(other, measured, load_cs8())


def at_twice_the_rate(r: Recording) -> Recording:
    """The same log with a sample more between any two, by the Fourier series of its periods."""

    def finer(x: np.ndarray | None) -> np.ndarray | None:
        if x is None:
            return None
        periods = x.reshape(-1, r.period_samples or 0, x.shape[1])
        return np.concatenate([resample(one, 2 * len(one), axis=0) for one in periods])

    signals = {f: finer(getattr(r, f)) for f in SIGNALS}
    time = r.time[0] + np.arange(2 * len(r.time)) / (2.0 * r.sample_rate_hz)
    return dataclasses.replace(r, time=time, sample_rate_hz=2.0 * r.sample_rate_hz, **signals)  # type: ignore[arg-type]


SIGNALS = ("position", "velocity", "torque", "reference_position", "reference_velocity", "feedforward_torque")


def test_a_log_at_another_rate_than_the_controller_s_references_is_replayed_as_well(
    recordings: tuple[Recording, ...], measured: MeasuredResponse, true_replayed: np.ndarray
) -> None:
    finer = tuple(at_twice_the_rate(r) for r in recordings)
    twice = estimate_frequency_response(finer, joints=measured.joints, hz=measured.hz, places=measured.places)
    again = Replay.of(finer, twice, load_cs8()).responses(load_robot("rx90b_3dof"))
    # the last period still settles a little: its ends do not meet, where a Fourier series has them meet
    apart = np.linalg.norm(again - true_replayed, axis=1) / np.linalg.norm(true_replayed, axis=1)
    assert apart.max() < 0.01
    odd = tuple(dataclasses.replace(r, period_s=(r.period_s or 0.0) - 2e-3) for r in finer)
    with pytest.raises(ValueError, match=r"no whole number of references at 250 Hz"):
        Replay.of(odd, twice, load_cs8())


# ---- signals between robot and log -------------------------------------------------------------------------------------


def changed(recordings: tuple[Recording, ...], torque: Callable[[int, Recording], np.ndarray]) -> FrequencyResponse:
    """Response of the recordings with other logged torques; more neighbours, for three realisations are few."""
    logged = [dataclasses.replace(r, torque=torque(i, r)) for i, r in enumerate(recordings)]
    return estimate_frequency_response(logged, band_hz=BAND_HZ, neighbours=6)


@pytest.mark.slow
def test_a_delay_put_into_the_logged_torques_comes_back(recordings: tuple[Recording, ...]) -> None:
    delay = np.array([0.0, 1.0e-3, 2.5e-3])  # of the robot against the log

    def ahead(_: int, r: Recording) -> np.ndarray:
        spectrum = np.fft.rfft(r.torque, axis=0)
        hz = np.fft.rfftfreq(r.samples, 1.0 / r.sample_rate_hz)
        return np.fft.irfft(spectrum * np.exp(2j * np.pi * hz[:, None] * delay), n=r.samples, axis=0)

    plain = fit_transfer_functions(changed(recordings, lambda _, r: r.torque), 4, delays="each")
    late = fit_transfer_functions(changed(recordings, ahead), start=plain.model, delays="each")
    std = np.sqrt(np.diag(late.covariance)[-3:])
    # both climbs stop a tenth of a standard deviation from their tops; friction's distortion is in both alike
    assert (np.abs(late.model.delay - plain.model.delay - delay) < 0.5 * std + 1e-5).all()
    zeros = late.antiresonance_zeros(2)
    assert (zeros.real < 0).all()  # a drive point has none in the right half plane, and the delay has not become one


@pytest.mark.slow
def test_a_fixed_frequency_in_the_torque_signal_costs_its_line_and_no_more(recordings: tuple[Recording, ...]) -> None:
    rng = np.random.default_rng(9)
    line_hz = 205 / 4.096  # one of the multisine's; what is no whole number of cycles leaks into its neighbours
    phases = rng.uniform(0.0, 2.0 * np.pi, (len(recordings), 3))

    def hum(i: int, r: Recording) -> np.ndarray:
        return r.torque + 0.5 * np.sin(2.0 * np.pi * line_hz * r.time[:, None] + phases[i])

    clean, struck = changed(recordings, lambda _, r: r.torque), changed(recordings, hum)
    place = int(np.argmin(np.abs(clean.hz - line_hz)))
    moved = np.abs(struck.value - clean.value) / clean.std()
    assert np.median(moved[place]) > 5.0 * np.median(moved)
    left_out = [(line_hz, 0.1)]
    # of as many modes as the data ask for: four leave seven times the residual of noise, and say little of their deviations
    before = fit_transfer_functions(clean, leave_out_hz=left_out)
    after = fit_transfer_functions(struck, start=before.model, leave_out_hz=left_out)
    seen = before.in_band(before.resonances_hz)
    shift = np.abs(after.resonances_hz - before.resonances_hz)[seen]
    assert (shift < np.maximum(before.resonances_std_hz(), after.resonances_std_hz())[seen]).all()


ONE_JOINT = """<robot name="one"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="10"/>
    <inertia ixx="0.1" iyy="0.8" izz="0.8" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="500" velocity="2"/></joint></robot>"""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_intervals_hold_where_neither_noise_nor_friction_hides_the_simulation_s_steps(
    tmp_path: Path, seed: int
) -> None:
    (tmp_path / "one.urdf").write_text(ONE_JOINT)
    robot = load_robot(tmp_path / "one.urdf").with_effects(
        [DriveInertia(joint="turn", inertia=2.0), DriveFlexibility(joint="turn", stiffness=5e4, damping=5.0)]
    )
    rf.excite(robot, tmp_path / "runs", poses_deg=[[0.0]], periods=4, simulate=True, seed=seed)
    found = rf.frf(tmp_path / "runs" / "campaign.toml")
    estimates = {e.name: e for e in found.replayed.grey.estimates if e.determined}
    for name, true in (("turn.drive_inertia", 2.0), ("turn.drive_stiffness", 5e4), ("turn.drive_damping", 5.0)):
        assert estimates[name].low <= true <= estimates[name].high
        assert estimates[name].std < 0.01 * true
