"""Claims about a flexible drive's damping on logs whose angles are noisy, made without the package.

The link's motion is given; the motor turns further by the twist x of ``k x + d dx/dt = load``, solved line by line of a period.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from scipy import stats

from rx90b_flex.effects.calm import Calm
from rx90b_flex.effects.flexibility import DriveFlexibility
from rx90b_flex.effects.hints import Sites
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording

RATE_HZ, CUTOFF_HZ, PERIOD_S = 250.0, 20.0, 10.0
SHOULDER = 0
STIFFNESS, LAG = 2000.0, 1e-3  # N m/rad; s, damping over stiffness
ANGLE_NOISE, TORQUE_NOISE = 3e-6, 0.005  # rad; of the torque
SEEDS = range(6)
CHANCE = 1e-3


@dataclass(frozen=True)
class Bench:
    """One period of the arm of two joints whose first drive twists."""

    robot: Robot
    angle: np.ndarray
    torque: np.ndarray
    time: np.ndarray

    def regression(self, seed: int, angle_noise: float) -> Regression:
        rng = np.random.default_rng(seed)
        recording = Recording(
            name=f"run_{seed}",
            role="identification",
            time=self.time,
            sample_rate_hz=RATE_HZ,
            joints=self.robot.joints,
            position=self.angle + angle_noise * rng.normal(size=self.angle.shape),
            torque=self.torque + TORQUE_NOISE * self.torque.std(axis=0) * rng.normal(size=self.torque.shape),
            period_s=None,
        )
        return Regression.of(self.robot, [recording], CUTOFF_HZ)

    def identified(self, seed: int, angle_noise: float) -> Identification:
        regression = self.regression(seed, angle_noise)
        (drive,) = DriveFlexibility.everywhere(Sites((self.robot.joints[SHOULDER],), self.robot.tip_frame))
        return identify(regression, [drive.with_shape([STIFFNESS, LAG])], fit_links=True)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder: Path = tmp_path_factory.mktemp("arm")
    arm = ind.two_joints(folder)
    link = ind.harmonics(np.random.default_rng(5), 2, period_s=PERIOD_S, rate_hz=RATE_HZ, speed=2.0, lines=8)
    load = arm.torque(link)
    omega = 2 * np.pi * np.fft.rfftfreq(len(load), 1 / RATE_HZ)
    twist = np.fft.irfft(np.fft.rfft(load[:, SHOULDER]) / (STIFFNESS * (1 + 1j * omega * LAG)), len(load))
    angle = link.q.copy()
    angle[:, SHOULDER] += twist
    return Bench(load_robot(folder / "two_joints.urdf"), angle, load, link.time)


@pytest.mark.parametrize("angle_noise", [ANGLE_NOISE, 0.0])
def test_intervals_of_stiffness_and_damping_hold_the_truth(bench: Bench, angle_noise: float) -> None:
    """A fit to noisy angles would damp the swing that their noise excites."""
    off = []
    for seed in SEEDS:
        model = bench.identified(seed, angle_noise)
        estimates = {e.name: e for e in model.estimates(0)}
        true = {"stiffness": STIFFNESS, "damping": LAG * STIFFNESS}
        off.append([(estimates[name].value - x) / estimates[name].std for name, x in true.items()])
    assert (np.square(off).sum(axis=0) < stats.chi2.isf(CHANCE, len(off))).all(), np.round(off, 2)


def test_a_drive_twists_under_its_load_and_not_under_the_noise_of_angles(bench: Bench) -> None:
    noisy, clean = (bench.regression(1, noise).segments[0].motion for noise in (ANGLE_NOISE, 0.0))
    load = np.array(noisy.on_tree.load())
    calm = Calm.of(noisy, load)
    assert calm is not None
    true = np.array(clean.on_tree.load())
    inside = slice(len(load) // 16, -len(load) // 16)
    before, after = (np.std((x - true)[inside], axis=0) for x in (load, calm(load)))
    assert (after < 0.3 * before).all()


def test_what_stands_out_of_the_noise_by_itself_is_left(bench: Bench) -> None:
    """A blow of a tenth of a second, much less than the noise over the whole log."""
    motion = bench.regression(1, ANGLE_NOISE).segments[0].motion
    load = np.array(motion.on_tree.load())
    quiet = Calm.of(motion, load)
    assert quiet is not None
    blow = (
        10.0 * np.std(load - quiet(load), axis=0) * np.exp(-0.5 * ((motion.time - 0.5 * PERIOD_S) / 0.03) ** 2)[:, None]
    )
    calm = Calm.of(motion, load + blow)
    assert calm is not None
    everywhere = Calm(calm.gain, np.zeros_like(calm.kept))
    there = np.abs(motion.time - 0.5 * PERIOD_S) < 0.03
    lost, lost_everywhere = (np.abs(c(load + blow) - load - blow)[there].max(axis=0) for c in (calm, everywhere))
    assert (lost < 0.8 * lost_everywhere).all()
