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
SLOW = [pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.long)]


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


@pytest.mark.slow
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
    path.write_text(
        "".join(x for x in path.read_text().splitlines(True) if not x.startswith(("[motor]", "gear_matrix")))
    )
    checked = rf.check(path)
    (fault,) = checked.data_faults
    assert (fault.kind, fault.joints) == ("kinematics", ("shoulder_lift_joint", "elbow_joint")) and not fault.usable
    assert fault.factor == pytest.approx(factor, rel=0.05)
    assert fault.signal == ("all" if torque else "motor_position")
    assert ("gear_matrix" in fault.message) == torque


def _with_torque(run: ind.Run, change: Callable[[np.ndarray], None]) -> ind.Run:
    torque = run.torque.copy()
    change(torque)
    return dataclasses.replace(run, torque=torque)


@pytest.mark.parametrize("seed", [1, *SLOW])
def test_torques_that_drop_out_to_zero_are_told_with_joint_and_number(tmp_path: Path, seed: int) -> None:
    """One to five samples at a time, on the two joints that carry most, where their torque is more than its noise."""
    lost: list[dict[int, int]] = []

    def dropping(rng: np.random.Generator, run: ind.Run) -> ind.Run:
        def drop(torque: np.ndarray) -> None:
            lost.append({})
            for joint in (LIFT, ELBOW):
                far = np.abs(torque[:, joint]) > 0.5 * np.abs(torque[:, joint]).max()
                starts = [i for i in rng.permutation(np.arange(10, len(torque) - 15, 10)) if far[i - 1 : i + 6].all()]
                lengths = rng.integers(1, 6, len(starts[:10]))
                for start, length in zip(starts, lengths, strict=False):
                    torque[start : start + length, joint] = 0.0
                lost[-1][joint] = int(lengths.sum())

        return _with_torque(run, drop)

    checked = rf.check(written(tmp_path, seed, change=dropping))
    assert [f.kind for f in checked.data_faults] == ["glitch"] * 3 and not checked.usable
    for fault, numbers in zip(checked.data_faults, lost, strict=True):
        told = f"shoulder_lift_joint ({numbers[LIFT]}), elbow_joint ({numbers[ELBOW]})"
        assert told in fault.message and "drop out to exactly 0" in fault.message


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize("step", [0.0, 2.0])
def test_a_torque_that_passes_through_zero_does_not_drop_out(tmp_path: Path, step: float, seed: int) -> None:
    """Logged in steps, or as 0 where it is small, it is often exactly 0."""

    def logged(_rng: np.random.Generator, run: ind.Run) -> ind.Run:
        t = run.torque
        return dataclasses.replace(run, torque=step * np.round(t / step) if step else np.where(np.abs(t) < 1.0, 0.0, t))

    assert not [f for f in rf.check(written(tmp_path, seed, change=logged)).data_faults if f.kind == "glitch"]


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize(("ranges", "usable"), [(2.0, True), (20.0, False)])
def test_one_cell_beyond_the_torques_range_is_told_and_stops_nothing_but_where_no_torque_is_so_large(
    tmp_path: Path, ranges: float, usable: bool, seed: int
) -> None:
    def wild(rng: np.random.Generator, run: ind.Run) -> ind.Run:
        def change(torque: np.ndarray) -> None:
            torque[rng.integers(100, len(torque) - 100), ELBOW] += ranges * np.ptp(torque[:, ELBOW])

        return _with_torque(run, change) if run.role == "validation" else run

    checked = rf.check(written(tmp_path, seed, change=wild))
    (fault,) = checked.data_faults
    assert (fault.kind, fault.joints, len(fault.rows)) == ("glitch", ("elbow_joint",), 1)
    assert fault.usable == checked.usable == usable


JITTER = [2e-4, pytest.param(1e-3, marks=pytest.mark.slow)]  # s, at 500 Hz


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize("std", JITTER)
def test_samples_that_come_early_and_late_are_no_torques_at_another_time(tmp_path: Path, std: float, seed: int) -> None:
    """What a clock that jitters does to angles outweighs the acceleration above a few Hz, far below the stated low-pass."""

    def jittered(rng: np.random.Generator, run: ind.Run) -> ind.Run:
        t = run.motion.time
        late = np.sort(np.clip(t + std * rng.standard_normal(len(t)), 0.0, t[-1]))
        q, torque = (np.stack([np.interp(late, t, x) for x in y.T], axis=1) for y in (run.motion.q, run.torque))
        return dataclasses.replace(run, torque=torque, motion=dataclasses.replace(run.motion, q=q))

    checked = rf.check(written(tmp_path, seed, change=jittered, rate_hz=500.0))
    assert checked.data_faults == ()
    assert max(checked.relative_error) < 0.2


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize("std", [5e-5, 2e-4, 1e-3])
def test_time_stamps_that_jitter_are_no_other_rate(tmp_path: Path, std: float, seed: int) -> None:
    def stamped(rng: np.random.Generator, run: ind.Run) -> ind.Run:
        t = run.motion.time
        late = np.unique(t + std * rng.standard_normal(len(t)))
        return dataclasses.replace(run, motion=dataclasses.replace(run.motion, time=late))

    path = written(tmp_path, seed, change=stamped, rate_hz=500.0)
    text = path.read_text().splitlines()
    path.write_text("\n".join("sample_rate_hz = 500" if x.startswith("sample_rate_hz") else x for x in text) + "\n")
    (fault,) = rf.check(path).data_faults
    assert (fault.kind, fault.factor) == ("sample_rate", None) and "jitter" in fault.message
    assert "contradict" not in fault.message


@pytest.mark.parametrize("constant", ["nan", "1.0"])
def test_the_gain_of_a_current_whose_constant_is_left_out_is_no_fault(tmp_path: Path, constant: str) -> None:
    def change(_rng: np.random.Generator, run: ind.Run) -> ind.Run:
        return dataclasses.replace(run, torque=run.torque * np.where(np.arange(6) == ELBOW, 0.4, 1.0))

    path = written(tmp_path, 1, change=change)
    constants = ", ".join(constant if k == ELBOW else "1.0" for k in range(6))
    text = path.read_text().replace("\ntorque = ", "\nmotor_current = ")
    path.write_text(text.replace("[preprocessing]", f"[motor]\ntorque_constant = [{constants}]\n[preprocessing]"))
    kinds = [f.kind for f in rf.check(path).data_faults]
    assert kinds == ([] if constant == "nan" else ["torque_gain"])


@pytest.mark.slow
def test_torques_of_no_joint_that_have_to_do_with_the_motion_are_of_no_other_load(tmp_path: Path) -> None:
    def change(rng: np.random.Generator, run: ind.Run) -> ind.Run:
        return dataclasses.replace(run, torque=0.3 * np.cumsum(rng.normal(size=run.torque.shape), axis=0))

    assert {f.kind for f in rf.check(written(tmp_path, 1, change=change)).data_faults} == {"unrelated"}


def test_a_robot_is_given_by_its_file_and_a_reversed_torque_is_cured_in_the_log(tmp_path: Path) -> None:
    def change(_rng: np.random.Generator, run: ind.Run) -> ind.Run:
        return dataclasses.replace(run, torque=run.torque * np.where(np.arange(6) == LIFT, -1.0, 1.0))

    path = written(tmp_path, 1, change=change)
    (fault,) = rf.check(path, robot=tmp_path / "robot_declared.toml").data_faults
    assert (fault.kind, fault.signal) == ("reversed_sign", "torque")
    assert "in the log" in fault.message and "gear_matrix" not in fault.message


@pytest.mark.slow
def test_a_joint_that_stands_elsewhere_in_each_recording_is_no_torque_of_another_run(tmp_path: Path) -> None:
    """A brake holds it: its torque is noise."""

    def change(rng: np.random.Generator, run: ind.Run) -> ind.Run:
        q, v, a = (x.copy() for x in (run.motion.q, run.motion.v, run.motion.a))
        q[:, 5], v[:, 5], a[:, 5] = rng.uniform(-1.5, 1.5), 0.0, 0.0
        torque = run.torque.copy()
        torque[:, 5] = rng.normal(scale=0.06, size=len(torque))
        return dataclasses.replace(run, motion=dataclasses.replace(run.motion, q=q, v=v, a=a), torque=torque)

    assert all(f.usable for f in rf.check(written(tmp_path, 1, change=change)).data_faults)
