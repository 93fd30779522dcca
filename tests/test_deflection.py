"""Claims about flexible drives as torques over time show them, on logs integrated by `twisting.py` without the package."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import independent as ind
import numpy as np
import pytest
import twisting

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.flexibility import DriveFlexibility, JointFlexibility, StiffnessHardening
from rx90b_flex.effects.stand_in import as_in_files
from rx90b_flex.robot import Robot, load_robot

LAG = 5e-3  # s, damping over stiffness
RATE_HZ, SECONDS = 250.0, 5.0
ENDS = 15  # samples at either end where differences lack neighbours; a fit leaves as many out
SHOULDER, ELBOW = 0, 1
SOFT, STIFF = {SHOULDER: 400.0, ELBOW: 80.0}, {SHOULDER: 4e4, ELBOW: 8e3}


@dataclasses.dataclass(frozen=True)
class Bench:
    """The arm of two joints, its robot, and one motion of its motors from rest."""

    arm: ind.Arm
    robot: Robot
    time: np.ndarray
    motors: twisting.Motors
    motion: ind.Motion

    def measured(self, stiffness: Mapping[int, float], cubic: Mapping[int, float] = {}) -> np.ndarray:
        """What motors feel beyond the rigid arm, (N, 2), N m."""
        drives = {j: twisting.Drive(k, LAG * k, cubic.get(j, 0.0)) for j, k in stiffness.items()}
        return twisting.motor_torque(self.arm, self.motors, self.time, drives) - self.arm.torque(self.motion)

    def said(self, stiffness: Mapping[int, float], cubic: Mapping[int, float] = {}) -> np.ndarray:
        """What the package says of that."""
        names = self.robot.joints
        drives = [DriveFlexibility(joint=names[j], stiffness=k, damping=LAG * k) for j, k in stiffness.items()]
        harder = [StiffnessHardening(joint=names[j], cubic=c) for j, c in cubic.items()]
        rigid = self.robot.with_effects([*drives, *harder]).over_time()
        m = self.motion
        seen = rigid.on_links(rigid.motion(m.q, m.v, m.a, m.time), rigid.link_parameters, effects=rigid.effects)
        return np.sum([e.force(seen) for e in rigid.effects], axis=0)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder: Path = tmp_path_factory.mktemp("arm")
    arm = ind.two_joints(folder)
    motors = twisting.from_rest(twisting.harmonics(np.random.default_rng(3), 2, SECONDS, 12, 1.5), 2.0)
    time = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    q, v, a = (np.array(x) for x in zip(*(motors(t) for t in time), strict=True))
    return Bench(arm, load_robot(folder / "two_joints.urdf"), time, motors, ind.Motion(time, q, v, a))


@pytest.mark.parametrize(
    "stiffness", [pytest.param(STIFF, marks=pytest.mark.slow), SOFT, {SHOULDER: 400.0}, {ELBOW: 80.0}], ids=str
)
def test_the_torque_of_twisting_drives_is_that_of_two_inertias_with_a_spring_between(bench, stiffness):
    kept = slice(ENDS, -ENDS)
    true, ours = bench.measured(stiffness)[kept], bench.said(stiffness)[kept]
    # of large torsions what third order leaves, of small ones the steps' own error
    assert np.linalg.norm(ours - true) < 0.02 * np.linalg.norm(true)


@pytest.mark.parametrize(
    ("stiffness", "cubic"),
    [({SHOULDER: 400.0}, {SHOULDER: 1e5}), ({SHOULDER: 4000.0}, {SHOULDER: 1e7}), (SOFT, {ELBOW: 4e4})],
    ids=str,
)
def test_a_drive_that_gets_stiffer_as_it_twists_does_so_on_the_rigid_tree_too(bench, stiffness, cubic):
    """The first one's cubic part takes as much of the torque as its linear one."""
    kept = slice(ENDS, -ENDS)
    true, ours = bench.measured(stiffness, cubic)[kept], bench.said(stiffness, cubic)[kept]
    linear = bench.said(stiffness)[kept]
    assert np.linalg.norm(ours - true) < 0.02 * np.linalg.norm(true)
    assert np.linalg.norm(linear - true) > 0.05 * np.linalg.norm(true)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("joint", [SHOULDER, ELBOW])
def test_however_hard_a_drive_gets_its_torque_is_a_number(bench, joint):
    """A fit on its way asks for cubic parts that no drive has: one whose steps grew beyond numbers stopped the loop."""
    for stiffness in (2.0, SOFT[joint]):
        for cubic in np.geomspace(1e2, 1e16, 15):
            torque = bench.said({joint: stiffness}, {joint: float(cubic)})
            assert np.isfinite(torque).all()
            assert np.abs(torque).max() < 1e8


def test_a_stiff_drive_is_felt_in_proportion_to_its_compliance(bench):
    once, twice = (bench.said({SHOULDER: k})[ENDS:-ENDS] for k in (4e6, 2e6))
    assert np.linalg.norm(twice - 2 * once) < 1e-3 * np.linalg.norm(twice)


def test_a_declared_drive_stands_on_the_rigid_tree_and_goes_back_into_the_flexible_one():
    drive = DriveFlexibility(joint="joint_2", stiffness=2e5, damping=100.0)
    harder = StiffnessHardening(joint="joint_2", cubic=1e9)
    bending = JointFlexibility(joint="joint_2", stiffness=(1e5, 1e5), damping=(10.0, 10.0))
    robot = load_robot("rx90b").with_effects([drive, harder, bending])
    over_time = robot.over_time()
    standing: tuple[Effect, ...] = over_time.effects
    rest = over_time.motion(*np.zeros((3, over_time.model.nv)))
    assert [e.type_name() for e in standing] == ["drive_flexibility", "stiffness_hardening", "joint_flexibility"]
    assert as_in_files(standing, rest) == (drive, harder, bending)
    assert over_time.model.nv == robot.tree.nv


def test_noise_at_the_start_of_a_log_does_not_set_a_link_swinging(bench):
    plain = bench.said({SHOULDER: 400.0})
    rng = np.random.default_rng(0)
    rough = dataclasses.replace(bench.motion, a=bench.motion.a.copy())
    rough.a[:ENDS] += rng.normal(scale=0.3 * np.abs(bench.motion.a).max(), size=(ENDS, 2))
    noisy = dataclasses.replace(bench, motion=rough).said({SHOULDER: 400.0})
    # a third of the largest acceleration, off in the first samples alone
    later = slice(4 * ENDS, None)
    assert np.linalg.norm((noisy - plain)[later]) < 0.1 * np.linalg.norm(plain[later])
