"""Campaigns of a linear robot without simulation: periods written line by line from its frequency response at each pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.excitation import minus_below_first, multisine
from rx90b_flex.export import save_robot
from rx90b_flex.identify.accelerometers import sensor_matrix
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording
from rx90b_flex.signals.recording import write_campaign
from rx90b_flex.signals.stated import Accelerometer

RATE, SAMPLES = 250.0, 1024
LINES = np.arange(33, 322, 8)
HZ = LINES * RATE / SAMPLES
SLOPES = (60.0, 32.0, 14.0)
BENT = (np.array([0.0, 0.5 * np.pi, 1.0]), np.array([0.4, 1.1, -0.8]))


def viscous_robot() -> Robot:
    """The 3-DOF robot with viscous friction, so that its linearisation is the truth."""
    robot = load_robot("rx90b_3dof")
    viscous = [ViscousFriction(joint=j, coefficient=c) for j, c in zip(robot.joints, SLOPES, strict=True)]
    return robot.with_effects([*(e for e in robot.effects if not e.traits.is_friction), *viscous])


def recordings_at(
    robot: Robot,
    pose: np.ndarray,
    rng: np.random.Generator,
    *,
    realisations: int = 4,
    periods: int = 2,
    noise: float = 0.0,
    torque_noise: float = 0.0,
    matrix: np.ndarray | None = None,
    name: str = "run",
    sensors: Sequence[Accelerometer] = (),
    sensor_noise: float = 0.0,
) -> list[Recording]:
    """Both signs of every experiment in open loop; every signal with white noise, a part of its root mean square."""
    inputs = minus_below_first(len(robot.joints)) if matrix is None else matrix
    response = robot.linearize(robot.input_matrix @ pose).frf(HZ)
    at = robot.linearize(robot.input_matrix @ pose)
    s = 2j * np.pi * HZ[:, None, None]
    coordinates = np.linalg.solve(at.K + s * at.D + s**2 * at.M, robot.input_matrix.astype(complex)[None])
    shaken = (sensor_matrix(robot, pose, sensors, HZ) @ coordinates)[:, len(pose) :]
    runs = []
    for m in range(realisations):
        wave = multisine(LINES.tolist(), SAMPLES, 20.0, rng)[:, 0]
        for k, column in enumerate(inputs.T):
            for sign in (1, -1):
                fed = sign * np.outer(wave, column)
                lines = np.fft.rfft(fed, axis=0)[LINES]
                angle = np.zeros((SAMPLES // 2 + 1, len(pose)), complex)
                angle[LINES] = np.einsum("fjk,fk->fj", response, lines) / -((2.0 * np.pi * HZ[:, None]) ** 2)
                both = [np.tile(x, (periods, 1)) for x in (fed, np.fft.irfft(angle, SAMPLES, axis=0))]
                torque, position = (
                    x + size * x.std() * rng.standard_normal(x.shape)
                    for x, size in zip(both, (noise + torque_noise, noise), strict=True)
                )
                felt = np.zeros((SAMPLES // 2 + 1, 3 * len(sensors)), complex)
                felt[LINES] = np.einsum("fjk,fk->fj", shaken, lines)
                acceleration = np.tile(np.fft.irfft(felt, SAMPLES, axis=0), (periods, 1))
                acceleration += (
                    sensor_noise * acceleration.std() * rng.standard_normal(acceleration.shape) if sensors else 0.0
                )
                runs.append(
                    Recording(
                        f"{name}_{m:03d}_{k + 1}_{'plus' if sign > 0 else 'minus'}",
                        "identification",
                        np.arange(len(torque)) / RATE,
                        RATE,
                        robot.joints,
                        position + pose,
                        torque,
                        feedforward_torque=np.tile(fed, (periods, 1)),
                        acceleration=acceleration if sensors else None,
                        period_s=SAMPLES / RATE,
                    )
                )
    return runs


def write(folder: Path, robot: Robot, runs: Sequence[Recording], sensors: Sequence[Accelerometer] = ()) -> Path:
    """The campaign file of these recordings and their robot."""
    robot_file = save_robot(robot, folder, allow_inconsistent=True).name
    return write_campaign(folder, robot_file, runs, accelerometers=sensors)


def changed(runs: Sequence[Recording], which: Callable[[str], bool]) -> list[Recording]:
    """Those whose names are wanted."""
    return [r for r in runs if which(r.name)]
