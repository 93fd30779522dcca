"""Claims about effects between robot and log, and about friction that remembers: each against its own definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, optimize

from rx90b_flex.compiled.signals import dahl as hysteresis
from rx90b_flex.effects import Effect, LeftOver, Motion, catalogue
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import lowpass
from rx90b_flex.simulate import Trajectory, load_cs8, perturb_lanes

RATE = 500.0
AT = 1  # joint that carries the effect
GAP = 1e-3  # rad, of lost motion


@pytest.fixture(scope="module")
def robot() -> Robot:
    """A robot with friction and drive inertia, its effects all known."""
    return load_robot("rx90b_rigid")


def moved(robot: Robot, seconds: float = 4.0, shift: float = 0.0) -> Motion:
    """A smooth motion with reversals, `shift` seconds ago, seen by the robot's own model."""
    time = np.arange(round(seconds * RATE)) / RATE
    n = robot.model.nv
    omega = 2.0 + 0.7 * np.arange(n)
    angle = (time[:, None] - shift) * omega + np.arange(n)
    motion = robot.motion(0.5 * np.sin(angle), 0.5 * omega * np.cos(angle), -0.5 * omega**2 * np.sin(angle), time)
    return robot.on_links(motion, robot.link_parameters, effects=robot.effects)


def effect_of(robot: Robot, kind: str, **values: float) -> Effect:
    return catalogue()[kind](joint=robot.joints[AT], **values)


def test_a_delayed_log_shows_the_torque_of_that_long_ago(robot):
    delay = 0.004
    smooth = robot.with_effects([e for e in robot.effects if e.type_name() != "coulomb_friction"])
    motion = moved(smooth)
    effect = catalogue()["torque_delay"](delay=delay)
    late = moved(smooth, shift=delay).model_torque
    after = slice(10, None)  # the log begins with what it does not have
    logged = effect.logged(motion, motion.model_torque)
    scale = np.abs(late).max()
    # cubic splines at 2 ms of a motion below 1 Hz: (2 pi f h)^4 of the torque
    np.testing.assert_allclose(logged[after], late[after], rtol=0, atol=1e-6 * scale)
    # at its own delay the secant column is exact
    np.testing.assert_allclose(motion.model_torque + effect.force(motion), logged, rtol=0, atol=1e-9 * scale)
    one = effect_of(robot, "torque_delay", delay=delay).logged(motion, motion.model_torque)
    np.testing.assert_array_equal(one[:, AT], logged[:, AT])
    np.testing.assert_array_equal(np.delete(one, AT, axis=1), np.delete(motion.model_torque, AT, axis=1))


def test_a_saturated_motor_gives_less_than_the_log_says(robot):
    motion = moved(robot)
    given = motion.model_torque[:, AT]
    coefficient = 0.1 / np.abs(given).max() ** 2  # a tenth short at the top
    effect = effect_of(robot, "motor_saturation", coefficient=coefficient)
    logged = effect.logged(motion, motion.model_torque)[:, AT]
    np.testing.assert_allclose(logged - coefficient * logged**3, given, rtol=0, atol=1e-9 * np.abs(given).max())
    at = int(np.argmax(np.abs(given)))
    asked = optimize.brentq(lambda x: x - coefficient * x**3 - given[at], -2 * abs(given[at]), 2 * abs(given[at]))
    assert logged[at] == pytest.approx(asked, rel=1e-9)
    np.testing.assert_allclose(motion.model_torque[:, AT] + effect.force(motion)[:, AT], logged, rtol=1e-9, atol=1e-9)


def test_interference_is_a_sine_of_the_files_time(robot):
    motion = moved(robot)
    effect = effect_of(robot, "line_interference", frequency_hz=50.0, amplitude=2.0, phase=0.3)
    added = effect.logged(motion, np.zeros_like(motion.q))
    np.testing.assert_allclose(added[:, AT], 2.0 * np.sin(2 * np.pi * 50.0 * motion.time + 0.3), atol=1e-12)
    assert not np.delete(added, AT, axis=1).any()


def test_interference_is_looked_for_where_the_residuals_of_all_recordings_peak_together(robot):
    rng = np.random.default_rng(0)
    effect = effect_of(robot, "line_interference")
    rest = np.zeros(robot.model.nv)
    times = [np.arange(2000) / RATE, 7.3 + np.arange(1500) / RATE]
    left = [
        (robot.motion(np.zeros((len(t), len(rest))), rest, rest, t), np.sin(2 * np.pi * 33.2 * t + 1.0)) for t in times
    ]
    noisy = LeftOver([(m, x + rng.normal(size=len(x))) for m, x in left])
    starts = effect.shape_search(moved(robot), noisy).starts
    assert np.abs(starts[0, 0] - 33.2) < 0.1


def perturbed(robot: Robot, motion: Motion, order: float, amplitude: float, phase: float, sign: float) -> Motion:
    """The motion with the angle of one joint in error, its rates with it."""
    q, v, a = motion.q.copy(), motion.v.copy(), motion.a.copy()
    x = order * q[:, AT] + phase
    q[:, AT] += sign * amplitude * np.sin(x)
    v[:, AT] += sign * amplitude * order * np.cos(x) * motion.v[:, AT]
    a[:, AT] += sign * amplitude * order * (np.cos(x) * motion.a[:, AT] - order * np.sin(x) * motion.v[:, AT] ** 2)
    return robot.motion(q, v, a, motion.time)


def test_a_resolver_error_is_to_first_order_the_torque_of_the_true_motion_less_that_of_the_measured_one(robot):
    motion, order, phase = moved(robot), 12.0, 0.4
    clear = np.abs(motion.v[:, AT]) > 0.05  # dry friction at reversal is no matter of first order

    def error(amplitude: float) -> float:
        true = perturbed(robot, motion, order, amplitude, phase, -1.0)
        exact = robot.inverse_dynamics(true.q, true.v, true.a) - motion.model_torque
        effect = effect_of(robot, "resolver_error", order=order, amplitude=amplitude, phase=phase)
        left = (effect.force(motion) - exact)[clear]
        return float(np.linalg.norm(left) / np.linalg.norm(exact[clear]))

    assert error(1e-5) < 1e-3
    assert error(1e-5) / error(1e-6) == pytest.approx(10.0, rel=0.3)  # what is left is of second order


def test_a_transmission_error_turns_the_links_and_not_the_drive(robot):
    motion, order, phase = moved(robot), 12.0, 0.4

    def error(amplitude: float) -> float:
        links = perturbed(robot, motion, order, amplitude, phase, 1.0)
        load = robot.link_torque(links)
        load[:, AT] *= 1.0 + amplitude * order * np.cos(order * motion.q[:, AT] + phase)  # virtual work
        exact = load - robot.link_torque(motion)
        effect = effect_of(robot, "transmission_error", order=order, amplitude=amplitude, phase=phase)
        return float(np.linalg.norm(effect.force(motion) - exact) / np.linalg.norm(exact))

    assert error(1e-5) < 1e-3
    assert error(1e-5) / error(1e-6) == pytest.approx(10.0, rel=0.3)


def test_the_first_look_at_an_angle_error_is_its_own_joints_row(robot):
    motion = moved(robot)
    for kind in ("resolver_error", "transmission_error"):
        effect = effect_of(robot, kind, order=9.0, amplitude=1.0, phase=0.0)
        port, basis = effect.factors(motion, leading=True)
        assert np.flatnonzero(port).tolist() == [AT]
        np.testing.assert_allclose(basis, effect.columns(motion)[:, AT], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("part", "off"), [(0.01, 0.05), (0.03, 0.05), (0.1, 0.15)])
def test_backlash_is_what_motors_feel_of_a_link_that_crosses_the_gap_as_its_load_changes_sign(robot, part, off):
    link = moved(robot)
    load = robot.link_torque(link)[:, AT]
    assert load.min() < -10.0 < 10.0 < load.max()
    # the link moves smoothly, its motor on the other flank whenever the load has changed sign
    contact = part * np.sqrt(np.mean(load**2))
    side = 0.5 * GAP * np.tanh(load / contact)
    q, v, a = link.q.copy(), link.v.copy(), link.a.copy()
    q[:, AT] += side
    v[:, AT] += np.gradient(side, 1 / RATE)
    a[:, AT] += np.gradient(np.gradient(side, 1 / RATE), 1 / RATE)
    motor = robot.motion(q, v, a, link.time)
    change = lowpass(robot.link_torque(link) - robot.link_torque(motor), 20.0, RATE)
    found = lowpass(effect_of(robot, "backlash", gap=GAP, contact=contact).force(motor), 20.0, RATE)
    # what crossings hide of the load moves them, soft teeth more than hard ones; with it the kicks would give one of the wrong sign
    assert np.sum(found * change) / np.sum(found * found) == pytest.approx(1.0, abs=off)
    assert np.linalg.norm(found - change) < 2.0 * off * np.linalg.norm(change)


def test_presliding_friction_is_dahls_equation():
    torque, stiffness = 8.0, 900.0
    time = np.linspace(0.0, 6.0, 3001)
    q = 0.05 * np.sin(2 * time) + 0.02 * np.sin(7.1 * time)
    v = 0.1 * np.cos(2 * time) + 0.142 * np.cos(7.1 * time)

    def dahl(t: float, f: list[float]) -> list[float]:
        speed = 0.1 * np.cos(2 * t) + 0.142 * np.cos(7.1 * t)
        return [stiffness * (1 - f[0] / torque * np.sign(speed)) * speed]

    exact = integrate.solve_ivp(dahl, (0, 6), [torque * np.sign(v[0])], t_eval=time, max_step=1e-3).y[0]
    found = torque * hysteresis(q, torque / stiffness)
    # at each reversal the samples miss the turning point by up to v'' dt^2 / 8 of travel
    assert np.abs(found - exact).max() < 5 * stiffness * 8.0 * (time[1] ** 2) / 8


def test_presliding_friction_keeps_its_torque_at_rest_and_has_no_memory_without_time(robot):
    effect = effect_of(robot, "presliding_friction", torque=8.0, stiffness=900.0)
    q = np.repeat([0.0, 0.1, 0.1, 0.1], [1, 1, 20, 1])
    assert hysteresis(q, 8.0 / 900.0)[-1] == pytest.approx(1.0, abs=1e-4)
    state = np.zeros((3, robot.model.nv)), np.full((3, robot.model.nv), -0.3), np.zeros((3, robot.model.nv))
    np.testing.assert_allclose(effect.force(robot.motion(*state))[:, AT], -8.0, rtol=1e-3)


@pytest.mark.parametrize("kind", ["torque_delay", "presliding_friction"])
def test_what_the_perturbation_method_cannot_simulate_is_named_before_any_simulation(robot, kind):
    effect = catalogue()[kind](joint="joint_2")
    flawed = robot.with_effects([*robot.effects, effect])
    still = Trajectory("still", robot.joints, 250.0, np.zeros((10, 6)), np.zeros((10, 6)))
    with pytest.raises(ValueError, match=rf"rx90b_rigid: joint_2\.{kind} is beyond the perturbation method"):
        perturb_lanes(flawed, load_cs8(), [still])


def test_a_delay_may_stand_on_the_robot_or_on_a_joint(tmp_path, robot):
    head = 'urdf = "example-robot-data:ur10"\n'
    on_robot = '[[effects]]\ntype = "torque_delay"\ndelay = 0.002\n'
    on_joint = '[[effects]]\ntype = "torque_delay"\njoint = "elbow_joint"\n'
    path = tmp_path / "robot.toml"
    path.write_text(head + on_robot + on_joint)
    loaded = load_robot(path)
    assert [e.joints for e in loaded.effects] == [(), ("elbow_joint",)]
    state = np.full((3, 6), 0.1)
    bare = loaded.with_effects([])
    np.testing.assert_array_equal(loaded.inverse_dynamics(*state), bare.inverse_dynamics(*state))
    assert loaded.parameter_names == bare.parameter_names
    path.write_text(head + '[[effects]]\ntype = "torque_delay"\njoint = "knee"\n')
    with pytest.raises(ValueError, match="unknown joint 'knee'"):
        load_robot(path)
