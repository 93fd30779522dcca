"""Data that a link of another length, or a torque at another time, would explain a little: `check` names the cause, or none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf

COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
NOISE = (0.8, 1.0, 0.6, 0.12, 0.1, 0.06)
LIFT, ELBOW = 1, 2
SLOW = [pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4)]


def written(
    folder: Path,
    seed: int,
    *,
    heavier: float = 1.0,
    known: bool = False,
    gear_matrix: np.ndarray | None = None,
    change: Callable[[np.random.Generator, ind.Run], ind.Run] = lambda _rng, run: run,
    rate_hz: float = 100.0,
) -> Path:
    """Three recordings of a UR10 with dry and viscous friction of its motors, its links so many times as heavy as its URDF says."""
    arm, rng = ind.ur10(heavier), np.random.default_rng(seed)
    gear = np.eye(6) if gear_matrix is None else gear_matrix

    def friction(m: ind.Motion, load: np.ndarray) -> np.ndarray:
        motors = dataclasses.replace(m, v=m.v @ gear.T)
        return ind.friction(COULOMB, VISCOUS)(motors, load) @ gear

    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 6, period_s=10.0, rate_hz=rate_hz)
        noise = ind.white(rng, len(m.time), NOISE)
        runs.append(change(rng, ind.run(arm, role, m, [friction], noise)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    return ind.write_files(folder, arm, declared, runs, cutoff_hz=15.0, gear_matrix=gear_matrix, known=known)


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize("heavier", [1 / 1.3, pytest.param(1.3, marks=pytest.mark.slow)])
def test_known_links_of_other_masses_are_no_links_of_another_length(tmp_path: Path, heavier: float, seed: int) -> None:
    assert rf.check(written(tmp_path, seed, heavier=heavier, known=True)).data_faults == ()


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize("factor", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("torque", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_motor_that_another_joint_carries_is_told_with_its_factor(
    tmp_path: Path, torque: bool, factor: float, seed: int
) -> None:
    """As behind a parallelogram: its angle is the sum of two joints', and its torque acts on both."""
    gear = np.eye(6)
    gear[ELBOW, LIFT] = factor

    def position_alone(_rng: np.random.Generator, run: ind.Run) -> ind.Run:
        return run if torque else dataclasses.replace(run, torque=run.torque @ gear)

    path = written(tmp_path, seed, gear_matrix=gear, change=position_alone)
    path.write_text("".join(x for x in path.read_text().splitlines(True) if not x.startswith(("[motor]", "gear_matrix"))))
    checked = rf.check(path)
    (fault,) = checked.data_faults
    assert (fault.kind, fault.joints) == ("kinematics", ("shoulder_lift_joint", "elbow_joint")) and not fault.usable
    assert fault.factor == pytest.approx(factor, rel=0.05)
    assert fault.signal == ("all" if torque else "motor_position")
    assert ("gear_matrix" in fault.message) == torque
