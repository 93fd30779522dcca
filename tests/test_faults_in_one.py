"""Claims about columns that one recording alone has otherwise, on recordings that the package had no part in making."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from test_check import (
    ARM,
    CUTOFF_HZ,
    DECLARED,
    ELBOW,
    JOINTS,
    LIFT,
    PAN,
    WRIST_1,
    WRIST_2,
    Runs,
    checked,
    exchanged,
    scaled,
    sound,
    with_angles,
    with_torques,
)  # fmt: skip

import rx90b_flex as rf
from rx90b_flex.diagnose.residual import unlike_words
from rx90b_flex.view.check_report import facts_words

Change = Callable[[Runs], Runs]


def plus(joint: int, angle: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda q: q + angle * (np.arange(q.shape[1]) == joint)


def both_exchanged(runs: Runs) -> Runs:
    return with_torques(with_angles(runs, exchanged(WRIST_1, ELBOW)), exchanged(WRIST_1, ELBOW))


def in_one(runs: Runs, which: int, change: Change) -> Runs:
    return [*runs[:which], *change(runs[which : which + 1]), *runs[which + 1 :]]


FAULTS: dict[str, tuple[int, Change, str, str, tuple[int, ...], float | None]] = {
    "torques": (1, lambda r: with_torques(r, exchanged(LIFT, ELBOW)), "swapped_columns", "torque", (LIFT, ELBOW), None),
    "torques of the wrist": (
        2, lambda r: with_torques(r, exchanged(WRIST_1, WRIST_2)), "swapped_columns", "torque", (WRIST_1, WRIST_2), None,
    ),
    "positions": (
        0, lambda r: with_angles(r, exchanged(PAN, LIFT)), "swapped_columns", "motor_position", (PAN, LIFT), None,
    ),
    "both": (1, both_exchanged, "swapped_columns", "all", (ELBOW, WRIST_1), None),
    "zero": (2, lambda r: with_angles(r, plus(LIFT, 0.3)), "kinematics", "motor_position", (LIFT,), -0.3),
    "a zero far off": (0, lambda r: with_angles(r, plus(ELBOW, -1.2)), "kinematics", "motor_position", (ELBOW,), 1.2),
    "degrees": (1, lambda r: with_angles(r, np.degrees), "unit", "motor_position", tuple(range(6)), np.degrees(1.0)),
}  # fmt: skip
QUICK = ("zero",)


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in FAULTS])
def test_a_fault_of_one_log_is_named_with_that_log_and_nothing_else(tmp_path: Path, name: str) -> None:
    which, change, kind, signal, joints, factor = FAULTS[name]
    (fault,) = checked(tmp_path, in_one(sound(speed=0.6), which, change)).data_faults
    assert (fault.kind, fault.signal, set(fault.joints)) == (kind, signal, {JOINTS[j] for j in joints})
    assert f"log_{which + 1}" in fault.message and "not in the other recordings" in fault.message
    assert not fault.usable
    if factor is not None:
        assert fault.factor == pytest.approx(factor, rel=0.15)


@pytest.mark.slow
def test_a_log_stated_at_half_its_rate_is_named(tmp_path: Path) -> None:
    """Without time columns: each recording's motion is its own, but of one it is run through at twice the speed."""
    runs = sound()
    twice = runs[1].motion
    fast = dataclasses.replace(
        twice, q=twice.q[::2], v=twice.v[::2], a=twice.a[::2], time=twice.time[: len(twice.q[::2])]
    )
    runs[1] = dataclasses.replace(runs[1], motion=fast, torque=runs[1].torque[::2])
    path = ind.write_files(tmp_path, ARM, DECLARED, runs, cutoff_hz=0.5 * CUTOFF_HZ)
    (fault,) = rf.check(path).data_faults
    assert (fault.kind, fault.factor) == ("sample_rate", pytest.approx(2.0, rel=0.1))
    assert "log_2" in fault.message


@pytest.mark.slow
@pytest.mark.parametrize("joint", [ELBOW, pytest.param(LIFT, marks=pytest.mark.slow)])
def test_friction_that_is_less_in_one_log_is_no_fault_of_its_columns(tmp_path: Path, joint: int) -> None:
    """As after an hour's work: 40 % less of one joint's, or of every joint's."""
    runs = sound()
    for less in (np.arange(6) == joint, np.ones(6)):
        factor = tuple(0.4 * less)
        rub = ind.friction(tuple(np.multiply(factor, (8.0, 8.0, 5.0, 1.5, 1.2, 0.8))), (0.0,) * 6)
        warm = dataclasses.replace(runs[2], torque=runs[2].torque - rub(runs[2].motion, runs[2].torque))
        assert checked(tmp_path, [*runs[:2], warm]).data_faults == ()


@pytest.mark.slow
@pytest.mark.parametrize("which", [1, pytest.param(0, marks=pytest.mark.slow)])
def test_a_sign_of_one_log_is_told_though_it_bends_the_fit_to_all_of_them(tmp_path: Path, which: int) -> None:
    (fault,) = checked(tmp_path, in_one(sound(), which, lambda r: with_torques(r, scaled(LIFT, -1.0)))).data_faults
    assert (fault.kind, fault.joints) == ("reversed_sign", (JOINTS[LIFT],))
    assert f"log_{which + 1}" in fault.message


@pytest.mark.parametrize("joint", [PAN, pytest.param(WRIST_1, marks=pytest.mark.slow)])
def test_a_torque_that_keeps_one_value_while_its_joint_moves_on_is_named(tmp_path: Path, joint: int) -> None:
    def held(torque: np.ndarray) -> np.ndarray:
        torque[300:360, joint] = torque[300, joint]
        return torque

    (fault,) = checked(tmp_path, in_one(sound(), 1, lambda r: with_torques(r, held))).data_faults
    assert (fault.kind, fault.signal, fault.joints, fault.rows) == ("stuck", "torque", (JOINTS[joint],), (301,))
    assert "log_2" in fault.message


def test_a_torque_in_coarse_steps_is_not_called_stuck(tmp_path: Path) -> None:
    """Of a drive that reports a hundredth of its largest torque."""

    def coarse(torque: np.ndarray) -> np.ndarray:
        step = 0.01 * np.abs(torque).max(axis=0)
        return np.round(torque / step) * step

    assert "stuck" not in {f.kind for f in checked(tmp_path, with_torques(sound(), coarse)).data_faults}


@pytest.mark.slow
def test_a_torque_that_is_late_in_one_log_is_named_with_it(tmp_path: Path) -> None:
    def late(torque: np.ndarray) -> np.ndarray:
        torque[:, ELBOW] = np.roll(torque[:, ELBOW], 9)
        return torque

    (fault,) = checked(tmp_path, in_one(sound(), 0, lambda r: with_torques(r, late))).data_faults
    assert (fault.kind, fault.joints) == ("time_shift", (JOINTS[ELBOW],))
    assert fault.factor == pytest.approx(0.09, abs=0.02)
    assert "log_1" in fault.message


@pytest.mark.slow
def test_torques_of_one_log_a_little_late_are_named_with_it(tmp_path: Path) -> None:
    late = in_one(sound(), 1, lambda r: with_torques(r, lambda torque: np.roll(torque, 3, axis=0)))
    (fault,) = checked(tmp_path, late).data_faults
    assert (fault.kind, set(fault.joints)) == ("time_shift", set(JOINTS))
    assert fault.factor == pytest.approx(0.03, abs=0.005)
    assert "log_2" in fault.message


@pytest.mark.slow
def test_every_torque_of_one_log_in_another_unit_is_one_fault(tmp_path: Path) -> None:
    (fault,) = checked(tmp_path, in_one(sound(), 1, lambda r: with_torques(r, lambda t: 1000.0 * t))).data_faults
    assert (fault.kind, set(fault.joints), fault.factor) == (
        "torque_gain",
        set(JOINTS),
        pytest.approx(1000.0, rel=0.02),
    )
    assert "log_2" in fault.message and not fault.usable


def test_what_the_loop_leaves_of_one_recording_alone_is_said() -> None:
    rng = np.random.default_rng(0)
    torque = [rng.normal(size=(500, 2)) for _ in range(3)]
    left = [tau - size * rng.normal(size=tau.shape) for tau, size in zip(torque, (0.01, 0.2, 0.02), strict=True)]
    (text,) = unlike_words(["a.csv", "b.csv", "c.csv"], torque, left)
    assert text.startswith("Of b.csv 0.19 of the torques are left, of the other recordings 0.02")
    assert unlike_words(["a.csv", "c.csv"], torque[::2], left[::2]) == ()


@pytest.mark.slow
def test_a_period_that_the_motion_does_not_keep_is_told_and_is_no_noise(tmp_path: Path) -> None:
    path = ind.write_files(tmp_path, ARM, DECLARED, repeated(), cutoff_hz=CUTOFF_HZ)
    good = rf.check(path)
    path.write_text(re.sub(r"period_s = [\d.]+", "period_s = 7.3", path.read_text()))
    wrong = rf.check(path)
    assert wrong.noise_floor == pytest.approx(good.noise_floor, rel=0.05)
    assert {r.stated_period_s for r in wrong.recordings} == {7.3}
    assert any("does not repeat after period_s = 7.3 s; it does after 10 s" in text for text in facts_words(wrong))
    assert not any("repeat" in text for text in facts_words(good))


def repeated() -> Runs:
    rng = np.random.default_rng(0)
    runs = []
    for role in ("identification", "validation"):
        m = ind.harmonics(rng, 6, period_s=10.0, periods=2, rate_hz=100.0)
        runs.append(ind.run(ARM, role, m, [], ind.white(rng, len(m.time), (0.5,) * 6), 10.0))
    return runs
