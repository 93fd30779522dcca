"""Claims about joints that bend, in torques over time: declared, they leave nothing that would be given another name."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.effects.flexibility import BaseFlexibility, JointFlexibility
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import Recording
from rx90b_flex.simulate import Noise, harmonics, load_cs8, simulate

CUTOFF_HZ = 5.0  # a third of what its links swing at with the drives held
MIDDLE = slice(0.25, 0.75)  # of a log: its simulation begins with a jump, and its end lacks neighbours for the filters


def simulated(robot: rf.Robot, seed: int, noise: Noise, role: str = "identification") -> Recording:
    """A log of the nonlinear simulation with all hinges."""
    rng = np.random.default_rng(seed)
    run = simulate(
        robot,
        load_cs8().for_joints(robot.joints),
        harmonics(robot, rng, period_s=8.192),
        noise=noise,
        rng=rng,
        role=role,
    )  # type: ignore[arg-type]
    return dataclasses.replace(run.recording, name=f"run_{seed}")


def left(robot: rf.Robot, recording: Recording) -> Array:
    """Logged torque less what the declared values say on the log's motion, (N, joints)."""
    regression = Regression.of(robot, [recording], CUTOFF_HZ)
    (segment,) = regression.segments
    motion = dataclasses.replace(segment.motion, effects=regression.robot.forces)
    said = motion.on_tree.load() + sum(e.force(motion) for e in regression.robot.effects)
    return (segment.torque - segment.brought(said[:, regression.rows]))[
        int(MIDDLE.start * len(segment)) : int(MIDDLE.stop * len(segment))
    ]


@pytest.fixture(scope="module")
def robot() -> rf.Robot:
    """Three joints, each with a drive that twists and a link that bends, without friction: what is left is the hinges'."""
    declared = rf.load_robot("rx90b_3dof")
    quiet = [e for e in declared.effects if "friction" not in e.type_name()]
    return dataclasses.replace(declared.with_effects(quiet), inertial_parameters="known")


def without(robot: rf.Robot, kind: type) -> rf.Robot:
    return robot.with_effects([e for e in robot.effects if not isinstance(e, kind)])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_bending_as_declared_leaves_hardly_any_of_what_is_left_without(robot: rf.Robot, seed: int) -> None:
    log = simulated(robot, seed, Noise(torque=0.0, position=0.0))
    with_, none = left(robot, log).std(axis=0), left(without(robot, JointFlexibility), log).std(axis=0)
    assert np.linalg.norm(with_) < 0.05 * np.linalg.norm(none), (with_, none)


def test_a_floor_that_tilts_does_too(robot: rf.Robot) -> None:
    floor = BaseFlexibility(stiffness=(1.5e6, 1.5e6), damping=(1500.0, 1500.0))
    tilting = without(robot, JointFlexibility).with_effects([*without(robot, JointFlexibility).effects, floor])
    log = simulated(tilting, 3, Noise(torque=0.0, position=0.0))
    with_, none = left(tilting, log).std(axis=0), left(without(tilting, BaseFlexibility), log).std(axis=0)
    assert np.linalg.norm(with_) < 0.05 * np.linalg.norm(none), (with_, none)
