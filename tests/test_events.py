"""Claims about what happens once to a joint: it is told with its time, and no model that misses it is called complete."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from independent import Array, Motion, friction, harmonics, run, two_joints, white, write_files

import rx90b_flex as rf
from rx90b_flex.diagnose.events import events
from rx90b_flex.diagnose.moving import TorqueErrors, held_at_first, waiting

RATE_HZ, JOINTS = 200.0, ("waist", "elbow")
TIME = np.arange(int(20 * RATE_HZ)) / RATE_HZ
VELOCITY = np.column_stack([np.sin(0.9 * TIME + 0.3), np.cos(1.3 * TIME)])
NOISE = np.random.default_rng(3).normal(size=(len(TIME), 2))


def bump(at_s: float, size: float, lasts_s: float = 0.15) -> Array:
    return size * np.exp(-(((TIME - at_s) / lasts_s) ** 2))


def errors(left: Array, velocity: Array = VELOCITY) -> TorqueErrors:
    return TorqueErrors(JOINTS, ["a"], [RATE_HZ], [velocity], [left], [velocity])


def found(left: Array, velocity: Array = VELOCITY) -> list[str]:
    return [e.words(False) for e in events(errors(left, velocity))]


@pytest.mark.parametrize("seed", range(5))
def test_noise_holds_no_event(seed):
    white_noise = np.random.default_rng(seed).normal(size=NOISE.shape)
    assert found(white_noise) == []
    slow = np.apply_along_axis(lambda x: np.convolve(x, np.exp(-np.arange(400) / 40), "same"), 0, white_noise)
    assert found(slow) == []


@pytest.mark.parametrize("at_s", [6.0, 13.4])
def test_a_bump_is_told_with_joint_and_time(at_s):
    (words,) = found(NOISE + np.column_stack([0 * TIME, bump(at_s, 60.0)]))
    assert "elbow" in words and f"{at_s:.1f} s of a" in words.replace(f"{at_s + 0.1:.1f} s", f"{at_s:.1f} s")


def test_what_happens_often_belongs_to_the_motion():
    often = sum(bump(at, 60.0, 0.05) for at in np.arange(1.5, 19.0, 1.7))
    assert found(NOISE + np.column_stack([often, 0 * TIME])) == []


def test_neither_the_beginning_nor_rests_hold_events():
    assert found(NOISE + np.column_stack([bump(0.1, 60.0), 0 * TIME])) == []
    assert found(NOISE + np.column_stack([bump(20.0, 60.0), 0 * TIME])) == []
    stands_first = VELOCITY * (TIME > 1.0)[:, None]
    assert found(NOISE + np.column_stack([bump(1.2, 60.0), 0 * TIME]), stands_first) == []
    resting = VELOCITY * (np.abs(TIME - 9.0) > 1.0)[:, None]
    assert found(NOISE + np.column_stack([bump(9.0, 60.0), 0 * TIME]), resting) == []


def test_what_hysteresis_holds_as_a_recording_begins_is_no_event():
    for at_s, held in ((0.7, "presliding_friction"), (6.0, "")):
        left = NOISE + np.column_stack([0 * TIME, bump(at_s, 60.0)])
        (one,) = events(errors(left), {"elbow": "presliding_friction"})
        assert one.held_by == held
        assert ("what presliding_friction holds as a recording begins" in one.words(False)) == bool(held)


def test_an_error_that_lies_before_the_first_move_is_told_and_what_it_is_elsewhere():
    still = waiting(VELOCITY * (TIME > 1.0)[:, None], RATE_HZ)
    held = NOISE + 20.0 * (TIME < 1.0)[:, None]
    assert held_at_first([NOISE], [0 * NOISE], [still]) == ""
    assert held_at_first([held], [0 * held], [waiting(VELOCITY, RATE_HZ)]) == ""
    said = held_at_first([10.0 + held], [10.0 + 0 * held], [still])
    assert "96% of the squared error held out" in said and "relative error is 0.0999" in said


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [10.0, None], ids=["period stated", "no period"])
@pytest.mark.parametrize("seed", [61, 62, 63])
def test_a_touch_in_the_held_out_recording_is_no_explained_motion(tmp_path, seed, period_s):
    """A two-joint robot that something holds back once, for a third of a second, while it validates."""
    result = touched(tmp_path, seed, period_s, "validation")
    assert result.effects == ()
    assert result.verdict == "unexplained"
    assert [c for c in result.cautions if "elbow keeps in motion, held out, " in c and "something happened" in c]
    assert not [c for c in result.cautions if "shoulder keeps" in c]


@pytest.mark.parametrize("seed", [64, pytest.param(65, marks=pytest.mark.slow)])
def test_a_touch_in_fitted_recordings_is_told(tmp_path, seed):
    result = touched(tmp_path, seed, None, "identification")
    assert result.effects == ()
    assert [c for c in result.cautions if "elbow keeps in motion, in the recordings that were fitted, " in c]


def touched(tmp_path: Path, seed: int, period_s: float | None, where: str) -> rf.ClosedLoop:
    arm, runs = two_joints(tmp_path), []
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    rng = np.random.default_rng(seed)

    def touch(m: Motion, load: Array) -> Array:
        # while its second joint moves fast, so that neither a rest nor a reversal is near
        slow = np.abs(m.v[:, 1]) + 10.0 * (np.abs(m.time - m.time[-1] / 2) > m.time[-1] / 4)
        at = m.time[np.argmax(np.where(slow < 10.0, np.abs(m.v[:, 1]), 0.0))]
        return 3.0 * np.exp(-(((m.time - at) / 0.15) ** 2))[:, None] * [0.0, 1.0]

    for role in ("identification", "identification", "validation"):
        m = harmonics(rng, 2, period_s=10.0, periods=2)
        more = [touch] if role == where else []
        laws = [friction((1.0, 0.6), (2.0, 1.1)), *more]
        runs.append(run(arm, role, m, laws, white(rng, len(m.time), (0.05, 0.05)), period_s))
    return rf.close_loop(write_files(tmp_path, arm, declared, runs, cutoff_hz=15.0))
