"""Claims about gaps that logs tell: a link moves smoothly, and its motor lies on the other flank as the load changes sign."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.effects import Effect, Motion, catalogue
from rx90b_flex.effects.crossings import Gap, between_crossings
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import prepare
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording

RATE, CUTOFF = 250.0, 20.0  # Hz
SECONDS = 15.7  # the load changes sign well before the end
AT = 1  # joint with the gap
GAP = 1e-3  # rad
PART = 0.02  # contact over the load's root mean square
TORQUE_NOISE = 0.02  # of the same
INNER = slice(250, -250)  # samples, away from the ends


@pytest.fixture(scope="module")
def robot() -> Robot:
    """Links alone."""
    return load_robot("rx90b_rigid").with_effects([])


def moved(robot: Robot) -> Motion:
    """Of the links."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    omega = 2.0 + 0.7 * np.arange(robot.model.nv)
    angle = time[:, None] * omega + np.arange(robot.model.nv)
    return robot.motion(0.5 * np.sin(angle), 0.5 * omega * np.cos(angle), -0.5 * omega**2 * np.sin(angle), time)


def logged(robot: Robot, angle_noise: float, rng: np.random.Generator) -> tuple[Recording, np.ndarray, float]:
    """The log of the motors, the load of the link behind the gap, (N,), and the gap's contact; rad, N m."""
    link = moved(robot)
    torque = robot.link_torque(link)
    load = torque[:, AT]
    usual = float(np.sqrt(np.mean(load**2)))
    position = link.q + angle_noise * rng.normal(size=link.q.shape)
    position[:, AT] += 0.5 * GAP * np.tanh(load / (PART * usual))
    noise = TORQUE_NOISE * np.sqrt(np.mean(torque**2, axis=0)) * rng.normal(size=torque.shape)
    recording = Recording("log", "identification", link.time, RATE, robot.joints, position, torque + noise)
    return recording, load, PART * usual


def backlash(robot: Robot, **values: float) -> Effect:
    return catalogue()["backlash"](joint=robot.joints[AT], **values)


@pytest.mark.parametrize("angle_noise", [1e-7, 3e-6])
def test_gap_and_contact_lie_within_their_intervals(robot: Robot, angle_noise: float) -> None:
    """Also where the noise of the angles asks for a low-pass of them far below that of the torque."""
    deviations, off = [], []
    for seed in range(4):
        recording, _, contact = logged(robot, angle_noise, np.random.default_rng(seed))
        model = identify(Regression.of(robot, [recording], CUTOFF), [backlash(robot)], fit_links=False)
        found = {e.name: e for e in model.estimates(0)}
        assert found["gap"].std < 0.05 * GAP
        pairs = [(found["gap"], GAP), (found["contact"], contact)]
        deviations += [(e.value - true) / e.std for e, true in pairs]
        off.append(found["gap"].value / GAP - 1.0)
    assert np.abs(deviations).max() < 3.5
    assert np.sqrt(np.mean(np.square(deviations))) < 2.0  # eight of unit variance stay below with 99.99 %
    assert np.abs(off).max() < 0.05


def test_a_known_gap_tells_how_the_load_goes_on_across_it(robot: Robot) -> None:
    recording, load, contact = logged(robot, 1e-7, np.random.default_rng(5))
    motion = prepare(robot, recording, CUTOFF).motion
    at_motor = np.asarray(motion.on_tree.load())[:, AT]
    guess = between_crossings(at_motor, motion.time)
    found = Gap(motion, AT, GAP, contact).load(guess)
    inside = np.abs(load[INNER]) < contact

    def off(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean((x - load)[INNER][inside] ** 2))) / contact

    assert off(at_motor) > 3.0  # kicks of the motor
    assert off(found) < min(0.05, 0.3 * off(guess))


def test_a_column_of_a_gap_is_seen_behind_the_low_pass_of_the_angles(robot: Robot) -> None:
    """What the model makes of the motors' angles and what the gap adds give the links' torque, kick for kick."""
    recording, load, contact = logged(robot, 3e-6, np.random.default_rng(6))
    motion = prepare(robot, recording, CUTOFF).motion
    kick = load - np.asarray(motion.on_tree.load())[:, AT]
    found = backlash(robot, gap=GAP, contact=contact).force(motion)[:, AT]
    left = (kick - found)[INNER]
    assert np.sum(kick[INNER] * found[INNER]) / np.sum(found[INNER] ** 2) == pytest.approx(1.0, abs=0.05)
    assert np.linalg.norm(left) < 0.3 * np.linalg.norm(kick[INNER])


@pytest.mark.parametrize("rate", [4.0, 5.0, 10.0, 20.0])
def test_a_load_of_which_a_log_has_few_samples_stays_what_it_is(rate: float) -> None:
    time = np.arange(200) / rate
    load = 100.0 * np.sin(2.0 * time)
    assert np.abs(between_crossings(load, time) - load).max() < 0.1
