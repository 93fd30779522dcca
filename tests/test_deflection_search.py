"""Claims about the loop over time on flexible drives and on springs of unknown geometry, on logs that others made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pytest
import twisting

import rx90b_flex as rf
from rx90b_flex.diagnose.output import closed_loop_robot
from rx90b_flex.effects.gravity_spring import GravitySpring

RATE_HZ, CUTOFF_HZ, SECONDS = 150.0, 15.0, 10.0
SHOULDER, ELBOW = 0, 1
COULOMB, VISCOUS, NOISE = np.array([2.0, 1.0]), np.array([3.0, 1.5]), np.array([0.12, 0.06])
FRICTION = ("coulomb_friction", "viscous_friction")
SLIDES_AT = 1e-3  # rad/s, of tanh(v / .)
STEP_RAD = 1e-5  # of the encoders
LAG = 3e-3  # s
SEEDS = (1, pytest.param(2, marks=pytest.mark.long))
DEVIATIONS = 4.0
Extra = Callable[[np.ndarray], np.ndarray]  # torque (N, 2) of the angles (N, 2)


def closed(
    folder: Path,
    drives: Mapping[int, float],
    seed: int,
    extra: Extra | None = None,
    known: bool = False,
    coulomb: float = 1.0,
    cubic: float = 0.0,
) -> rf.ClosedLoop:
    """The loop closed on three logs of the arm of two joints, some of whose drives twist.

    Drives that get stiffer by a `cubic` part are declared without it.
    """
    arm, rng = ind.two_joints(folder), np.random.default_rng(seed)
    time = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    runs: list[ind.Run] = []
    for role in ("identification", "identification", "validation"):
        motors = twisting.from_rest(twisting.harmonics(rng, 2, SECONDS, 14, 1.6), 2.0)
        q, v, a = (np.array(x) for x in zip(*(motors(t) for t in time), strict=True))
        springs = {j: twisting.Drive(k, LAG * k, cubic) for j, k in drives.items()}
        torque = twisting.motor_torque(arm, motors, time, springs)
        torque += coulomb * COULOMB * np.tanh(v / SLIDES_AT) + VISCOUS * v + rng.normal(size=q.shape) * NOISE
        torque += 0.0 if extra is None else extra(q)
        logged = ind.Motion(time, np.round(q / STEP_RAD) * STEP_RAD, v, a)
        runs.append(ind.Run(role, logged, torque))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in FRICTION[coulomb == 0.0 :]]
    if cubic:
        declared += [
            {"type": "drive_flexibility", "joint": arm.joints[j], "stiffness": k, "damping": LAG * k}
            for j, k in drives.items()
        ]
    return rf.close_loop(ind.write_files(folder, arm, declared, runs, cutoff_hz=CUTOFF_HZ, known=known))


def named(result: rf.ClosedLoop) -> Sequence[tuple[str, tuple[str, ...]]]:
    return [(e.effect.type_name(), e.effect.joints) for e in result.effects]


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [240.0, 1500.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_flexible_drive_is_named_on_its_joint_and_nothing_else_is(tmp_path, stiffness, seed):
    """The softer one has twelve times the torque that gravity asks of that joint, a radian."""
    result = closed(tmp_path, {SHOULDER: stiffness}, seed)
    assert named(result) == [("drive_flexibility", ("shoulder",))]
    assert result.after.validation.relative_error < result.before.validation.relative_error


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [240.0, 1500.0])
def test_without_dry_friction_the_stiffness_is_found_within_its_interval(tmp_path, stiffness):
    result = closed(tmp_path, {SHOULDER: stiffness}, 1, coulomb=0.0)
    assert named(result) == [("drive_flexibility", ("shoulder",))]
    estimate = {p.name: p for p in result.effects[0].parameters}["stiffness"]
    assert abs(estimate.value - stiffness) < DEVIATIONS * estimate.std
    assert estimate.std < 0.1 * stiffness


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_a_drive_that_gets_stiffer_as_it_twists_is_named(tmp_path, seed):
    cubic = 1e5
    result = closed(tmp_path, {SHOULDER: 400.0}, seed, cubic=cubic)
    assert named(result) == [("stiffness_hardening", ("shoulder",))]
    (estimate,) = result.effects[0].parameters
    assert abs(estimate.value - cubic) < DEVIATIONS * estimate.std and estimate.std < 0.1 * cubic
    assert result.after.validation.relative_error < 0.6 * result.before.validation.relative_error
    assert result.verdict in ("explained", "partly_explained")


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_where_drives_are_stiff_nothing_is_named(tmp_path, seed):
    assert named(closed(tmp_path, {SHOULDER: 2e5, ELBOW: 5e4}, seed)) == []


def two_levers(stiffness: float, rest: float, far: float, near: float, angle: float) -> Extra:
    """A spring between two points, one on the upper arm and one on the lower, by the law of cosines; on the elbow."""

    def torque(q: np.ndarray) -> np.ndarray:
        turn = q[:, ELBOW] - angle
        length = np.sqrt(far**2 + near**2 - 2 * far * near * np.cos(turn))
        out = np.zeros_like(q)
        out[:, ELBOW] = stiffness * (length - rest) * far * near * np.sin(turn) / length
        return out

    return torque


def test_a_spring_between_two_links_is_no_gear_ripple(tmp_path):
    spring = two_levers(250.0, 0.0, 0.3, 0.1, -0.8)
    result = closed(tmp_path, {}, 1, spring, known=True)
    assert named(result) == [("gravity_spring", ("elbow",))]
    written = next(e for e in closed_loop_robot(result).effects if isinstance(e, GravitySpring))
    q = np.zeros((50, 2))
    q[:, ELBOW] = np.linspace(-0.8, 0.8, 50)
    ours = written.force(closed_loop_robot(result).motion(q, 0 * q, 0 * q))
    true = spring(q)
    # up to a constant, which no declared torque_offset could take
    assert np.abs(ours - true).max() < 0.05 * np.abs(true).max()
