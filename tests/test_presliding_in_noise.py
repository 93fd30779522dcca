"""Hysteresis along less than the noise of an angle: what nobody can tell is not named."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.effects.maxwell_slip import MaxwellSlipFriction
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.presliding import PreslidingFriction
from rx90b_flex.effects.reversal import Resolution
from rx90b_flex.identify.regression import prepare
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording

RATE_HZ, CUTOFF_HZ, SECONDS = 250.0, 20.0, 12.0


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("rx90b").rigid().restricted(["joint_1"])


def angle(rest: str) -> Array:
    """Two moves; between them the joint stands still, or creeps by ten times the noise."""
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    stop = (time > 4.0) & (time < 8.0)
    phase = np.clip(time, 0.0, 4.0) + np.clip(time - 8.0, 0.0, None)
    q = 0.5 * np.sin(np.pi * phase / 4.0) ** 2
    return q + (1e-5 * ((time - 4.0) / 4.0) ** 2 * stop if rest == "creeps" else 0.0)


def motion(robot: Robot, noise: float, seed: int, rest: str = "stands") -> Motion:
    clean = angle(rest)
    q = (clean + noise * np.random.default_rng(seed).normal(size=len(clean)))[:, None]
    torque = np.ones((len(clean), 1))
    log = Recording(
        name="run",
        role="identification",
        time=np.arange(len(clean)) / RATE_HZ,
        sample_rate_hz=RATE_HZ,
        joints=("joint_1",),
        position=q,
        torque=torque,
    )
    return prepare(robot, log, CUTOFF_HZ).motion


@pytest.mark.parametrize("noise", [1e-6, 1e-5])
def test_at_rest_noise_takes_an_angle_along_some_of_its_deviations(robot: Robot, noise: float) -> None:
    for seed in range(5):
        moved = motion(robot, noise, seed)
        assert moved.angle_noise is not None  # what the low-pass leaves of it
        kept = float(moved.angle_noise[0])
        assert kept < noise and 3.0 * kept < Resolution.of(moved.joint("joint_1")).wander < 9.0 * kept


def test_what_creeps_is_no_noise(robot: Robot) -> None:
    stands, creeps = (
        Resolution.of(motion(robot, 1e-6, 0, rest).joint("joint_1")).wander for rest in ("stands", "creeps")
    )
    assert creeps < 1.5 * stands


@pytest.mark.parametrize("kind", ["one element", "two"])
def test_hysteresis_along_less_has_no_name_and_along_more_has_one(robot: Robot, kind: str) -> None:
    moved = motion(robot, 1e-6, 1)
    wander = Resolution.of(moved.joint("joint_1")).wander
    for times, named in ((1.0, False), (3.0, True), (100.0, True)):
        deflection = times * wander
        effect = (
            PreslidingFriction(joint="joint_1", torque=2.0, deflection=deflection)
            if kind == "one element"
            else MaxwellSlipFriction(joint="joint_1", torques=(1.0, 1.0), deflections=(0.3 * deflection, deflection))
        )
        why = effect.too_small(0.5, 1.0 / RATE_HZ, moved)
        assert (why == "") == named and (named or "noise" in why)
