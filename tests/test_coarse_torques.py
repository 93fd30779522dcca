"""Claims about torques in coarse steps and joints held at rest, which are sound, and about faults that show in them all the same."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf

RATE_HZ, CUTOFF_HZ = 100.0, 10.0
ROLES = ("identification", "validation")
COULOMB, VISCOUS = (1.5, 0.6), (0.8, 0.3)
SHOULDER, ELBOW = 0, 1
Change = Callable[[np.ndarray], np.ndarray]


def with_held(m: ind.Motion, joints: Collection[int]) -> ind.Motion:
    """The motion with some joints at rest at zero."""
    held = np.isin(np.arange(m.q.shape[1]), list(joints))
    return ind.Motion(m.time, *(np.where(held, 0.0, x) for x in (m.q, m.v, m.a)))


def checked(folder: Path, arm: ind.Arm, runs: list[ind.Run]) -> rf.Checked:
    declared = [{"type": kind, "joint": j} for j in arm.joints for kind in ("coulomb_friction", "viscous_friction")]
    return rf.check(ind.write_files(folder, arm, declared, runs, cutoff_hz=CUTOFF_HZ))


def recorded(arm: ind.Arm, noise: float = 0.0, held: Collection[int] = ()) -> list[ind.Run]:
    """Logs of an arm of two joints."""
    rng, runs = np.random.default_rng(5), []
    for role in ROLES:
        m = with_held(ind.harmonics(rng, 2, period_s=20.0, rate_hz=RATE_HZ, speed=0.8, lines=4), held)
        runs.append(ind.run(arm, role, m, [ind.friction(COULOMB, VISCOUS)], ind.white(rng, len(m.time), [noise] * 2)))
    return runs


def with_torques(runs: list[ind.Run], change: Change) -> list[ind.Run]:
    return [dataclasses.replace(r, torque=change(r.torque.copy())) for r in runs]


def in_steps(part: float) -> Change:
    """Rounded to a part of 20 and 8 N m."""
    step = part * np.array([20.0, 8.0])
    return lambda torque: np.round(torque / step) * step


def cut_off(torque: np.ndarray) -> np.ndarray:
    torque[:, SHOULDER] = np.minimum(torque[:, SHOULDER], 0.7 * torque[:, SHOULDER].max())
    return torque


def lost(torque: np.ndarray) -> np.ndarray:
    # where it changes most within that time
    change = np.abs(torque[60:-60, SHOULDER] - torque[:-120, SHOULDER])
    at = int(np.argmax(change))
    torque[at : at + 120, SHOULDER] = torque[at, SHOULDER]
    return torque


@pytest.mark.parametrize(("part", "noise"), [(0.01, 0.0), pytest.param(0.03, 0.0, marks=pytest.mark.slow), (0.02, 0.1)])
def test_a_torque_in_coarse_steps_is_neither_lost_nor_cut_off(tmp_path: Path, part: float, noise: float) -> None:
    arm = ind.two_joints(tmp_path)
    assert checked(tmp_path, arm, with_torques(recorded(arm, noise), in_steps(part))).data_faults == ()


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_coarse_torque_that_is_cut_off_is_named(tmp_path: Path, noise: float) -> None:
    arm = ind.two_joints(tmp_path)
    runs = with_torques(recorded(arm, noise), lambda t: in_steps(0.02)(cut_off(t)))
    (fault,) = checked(tmp_path, arm, runs).data_faults
    assert (fault.kind, fault.joints, fault.usable) == ("clipped", ("shoulder",), False)


@pytest.mark.parametrize("noise", [0.1, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.0, 0.8))])
def test_lost_samples_of_a_coarse_torque_are_named(tmp_path: Path, noise: float) -> None:
    arm = ind.two_joints(tmp_path)
    runs = recorded(arm, noise)
    faults = checked(tmp_path, arm, with_torques(runs, lambda t: lost(in_steps(0.02)(t)))).data_faults
    assert [(f.kind, f.signal, f.joints) for f in faults] == [("stuck", "torque", ("shoulder",))] * 2


def test_joints_held_at_rest_are_taken_as_held_whatever_noise_is_on_them(tmp_path: Path) -> None:
    """Four of six, whose loads hardly change: nearly all that their torques do is noise."""
    arm, rng, runs = ind.ur10(), np.random.default_rng(1), []
    for role in ROLES:
        m = with_held(ind.harmonics(rng, 6, period_s=8.0, rate_hz=50.0, speed=1.0), (1, 2, 4, 5))
        load = arm.torque(m)
        noise = ind.coloured(rng, len(m.time), 0.01 * np.abs(load).max(axis=0) + 0.01, 0.8)
        runs.append(ind.run(arm, role, m, [ind.friction([5.0] * 6, [2.0] * 6)], noise))
    result = checked(tmp_path, arm, runs)
    assert [(f.kind, f.usable) for f in result.data_faults] == [("stuck", True)] * 4
    assert result.never_move == tuple(arm.joints[j] for j in (1, 2, 4, 5))


@pytest.mark.parametrize("held", [1.0, 10.0])
def test_what_dry_friction_holds_of_a_load_is_no_motion(tmp_path: Path, held: float) -> None:
    """A drive at rest carries its load with play: friction may hold a part of what changes, or all of it."""
    arm = ind.two_joints(tmp_path)

    def through(torque: np.ndarray) -> np.ndarray:
        now = torque[0, ELBOW]
        for row in torque:
            now = row[ELBOW] = float(np.clip(now, row[ELBOW] - held, row[ELBOW] + held))
        return torque + 0.02 * np.random.default_rng(0).normal(size=torque.shape)

    runs = with_torques(recorded(arm, held=(ELBOW,)), through)
    (fault,) = checked(tmp_path, arm, runs).data_faults
    assert (fault.kind, fault.joints, fault.usable) == ("stuck", ("elbow",), True)


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_a_joint_that_moves_though_its_position_stands_is_named(tmp_path: Path, noise: float) -> None:
    arm = ind.two_joints(tmp_path)
    stood = [
        dataclasses.replace(r, motion=dataclasses.replace(r.motion, q=r.motion.q * [1.0, 0.0]))
        for r in recorded(arm, noise)
    ]
    stuck = [f for f in checked(tmp_path, arm, stood).data_faults if f.kind == "stuck"]
    assert [(f.joints, f.usable) for f in stuck] == [(("elbow",), False)]
