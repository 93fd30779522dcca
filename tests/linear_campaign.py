"""Campaigns of a linear robot without simulation: periods written line by line from its frequency response at each pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.excitation import minus_below_first, multisine
from rx90b_flex.export import save_robot
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording
from rx90b_flex.signals.recording import write_campaign

RATE, SAMPLES = 250.0, 1024
LINES = np.arange(33, 322, 8)
HZ = LINES * RATE / SAMPLES
SLOPES = (60.0, 32.0, 14.0)
BENT = (np.array([0.0, 0.5 * np.pi, 1.0]), np.array([0.4, 1.1, -0.8]))


def viscous_robot() -> Robot:
    """The 3-DOF robot with viscous friction, so that its linearisation is the truth."""
    robot = load_robot("rx90b_3dof")
    viscous = [ViscousFriction(joint=j, coefficient=c) for j, c in zip(robot.joints, SLOPES, strict=True)]
    return robot.with_effects([*(e for e in robot.effects if e.part != "friction"), *viscous])


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
) -> list[Recording]:
    """Both signs of every experiment in open loop; torque and angle with white noise, a part of their root mean square."""
    inputs = minus_below_first(len(robot.joints)) if matrix is None else matrix
    response = robot.linearize(robot.input_matrix @ pose).frf(HZ)
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
                        period_s=SAMPLES / RATE,
                    )
                )
    return runs


def write(folder: Path, robot: Robot, runs: Sequence[Recording]) -> Path:
    """The campaign file of these recordings and their robot."""
    return write_campaign(folder, save_robot(robot, folder, allow_inconsistent=True).name, runs)


def changed(runs: Sequence[Recording], which: Callable[[str], bool]) -> list[Recording]:
    """Those whose names are wanted."""
    return [r for r in runs if which(r.name)]
