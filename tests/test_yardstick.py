"""Claims about the yardstick, errors in motion and the written robot, on recordings that the package had no part in making."""

from __future__ import annotations

import json
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from scipy import signal

import rx90b_flex as rf
from rx90b_flex.diagnose.output import closed_loop_json, write_result

RATE_HZ, CUTOFF_HZ, PERIOD_S = 100.0, 15.0, 20.0
NOISE = (0.2, 0.08)
SPRING = {"stiffness": 4.0, "rest_angle": 0.3}
COULOMB, VISCOUS = (2.0, 1.0), (3.0, 1.5)
DECLARED = [{"type": t, "joint": j} for j in ("shoulder", "elbow") for t in ("coulomb_friction", "viscous_friction")]


def angle_dependent(motion: ind.Motion, load: np.ndarray) -> np.ndarray:
    """Dry friction of the elbow that changes with the sine of twice its own angle."""
    out = np.zeros_like(load)
    out[:, 1] = 2.0 * np.sin(2.0 * motion.q[:, 1]) * np.sign(motion.v[:, 1])
    return out


def campaign(
    folder: Path,
    hidden: ind.Torque | None,
    recordings: int = 3,
    rest_s: float = 0.0,
    *,
    known: bool = False,
    joints: tuple[str, ...] | None = None,
) -> Path:
    """The arm of two joints; all but the last recording are to identify on; each begins with a rest."""
    folder.mkdir(exist_ok=True)
    arm, rng = ind.two_joints(folder), np.random.default_rng(4)
    runs = []
    for k in range(recordings):
        role = "validation" if k == recordings - 1 else "identification"
        moved = ind.harmonics(rng, 2, period_s=PERIOD_S, rate_hz=RATE_HZ)
        m = resting_first(moved, rest_s)
        torques = [ind.friction(COULOMB, VISCOUS), *([hidden] if hidden else [])]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE)))
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ, known=known, joints=joints)


def resting_first(motion: ind.Motion, rest_s: float) -> ind.Motion:
    """The motion after a rest in the pose where it starts, which it leaves along a quintic of a second's time."""
    if rest_s == 0.0:
        return motion
    still = round(rest_s * RATE_HZ)
    s = np.clip(motion.time, 0.0, 1.0)
    ease, rate, bend = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    start = motion.q[0]
    q = start + (motion.q - start) * ease[:, None]
    v = motion.v * ease[:, None] + (motion.q - start) * rate[:, None]
    a = motion.a * ease[:, None] + 2 * motion.v * rate[:, None] + (motion.q - start) * bend[:, None]
    zero = np.zeros((still, 2))
    time = np.arange(still + len(motion.time)) / RATE_HZ
    return ind.Motion(time, np.r_[np.tile(start, (still, 1)), q], np.r_[zero, v], np.r_[zero, a])


def passed() -> float:
    """Root of the part of white noise's power that the low-pass leaves."""
    impulse = np.zeros(4001)
    impulse[2000] = 1.0
    sections = signal.butter(4, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    return float(np.linalg.norm(signal.sosfiltfilt(sections, impulse)))


@pytest.fixture(scope="module")
def spring(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, rf.ClosedLoop]:
    path = campaign(tmp_path_factory.mktemp("spring"), ind.hidden("joint_spring", 1, SPRING), rest_s=4.0)
    return path, rf.close_loop(path)


@pytest.fixture(scope="module")
def unnamed(tmp_path_factory: pytest.TempPathFactory) -> rf.ClosedLoop:
    return rf.close_loop(campaign(tmp_path_factory.mktemp("unnamed"), angle_dependent))


def test_a_free_form_explains_a_hidden_spring_nearly_down_to_the_noise(spring):
    _, r = spring
    assert r.explainable is not None
    before, free = (e.torque_rms[1] for e in (r.before.validation, r.explainable.validation))
    noise = NOISE[1] * passed()
    assert free**2 - noise**2 < 0.05 * (before**2 - noise**2)
    assert r.explainable.forms[1] != "none"


def test_the_effect_that_is_there_reaches_what_a_free_form_does(spring):
    _, r = spring
    assert [e.effect.type_name() for e in r.effects] == ["joint_spring"]
    assert r.noise_floor is None
    assert r.explainable.share > 0.95
    assert r.verdict == "explained"


def test_the_share_is_that_of_the_drop_of_the_validation_error(spring, unnamed):
    for r in (spring[1], unnamed):
        before, after, free = (
            e.relative_error for e in (r.before.validation, r.after.validation, r.explainable.validation)
        )
        assert after == pytest.approx(before - r.explainable.share * (before - free), rel=1e-9)


def test_where_nothing_is_hidden_there_is_nothing_to_explain(tmp_path):
    r = rf.close_loop(campaign(tmp_path / "data", None))
    assert (r.verdict, r.effects) == ("nothing_missing", ())
    assert r.explainable is not None and r.explainable.share == 1.0
    assert r.explainable.validation.relative_error == pytest.approx(r.before.validation.relative_error, rel=0.02)


def test_what_is_explainable_is_called_explained_only_where_it_is(unnamed):
    r = unnamed
    drop = r.before.validation.relative_error - r.explainable.validation.relative_error
    assert drop > 0.25 * r.before.validation.relative_error
    at_the_measure = r.after.validation.torque_rms[1] <= 1.3 * r.explainable.validation.torque_rms[1]
    assert (r.verdict == "explained") <= (r.explainable.share >= 0.8 and at_the_measure)


def test_little_data_has_no_measure_and_the_reason_is_given(tmp_path):
    """Two seconds of 100 Hz behind a low-pass of 4 Hz leave some tens of samples."""
    folder = tmp_path / "data"
    folder.mkdir()
    arm, rng = ind.two_joints(folder), np.random.default_rng(4)
    runs = []
    for role in ("identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=6.0, rate_hz=RATE_HZ)
        runs.append(ind.run(arm, role, m, [ind.friction(COULOMB, VISCOUS)], ind.white(rng, len(m.time), NOISE)))
    r = rf.close_loop(ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=4.0))
    assert r.explainable is None
    assert "Too little data" in r.not_explainable
    assert closed_loop_json(r)["explainable"] is None
    assert r.verdict not in ("explained", "nothing_missing")


def test_the_json_holds_the_measure_and_the_errors_in_motion(spring):
    _, r = spring
    content = json.loads(json.dumps(closed_loop_json(r)))
    assert content["explainable"] == {
        "validation": {"relative_error": r.explainable.validation.relative_error},
        "share": r.explainable.share,
    }
    assert content["moving"] == {
        "before": {"relative_error": r.moving.before},
        "after": {"relative_error": r.moving.after},
        "at_rest": r.moving.at_rest,
    }


def test_errors_in_motion_leave_out_the_rest_that_every_recording_begins_with(spring):
    _, r = spring
    rest = 4.0 / (4.0 + PERIOD_S)
    # besides, each joint passes zero velocity: a hundredth of its largest speed for at most that part of the time or little more
    assert rest < r.moving.at_rest < rest + 0.06
    (p,) = r.predictions
    moves = np.abs(p.velocity) > 0.02 * np.abs(p.velocity).max(axis=0)
    for predicted, stated in ((p.before, r.moving.before), (p.after, r.moving.after)):
        own = np.sqrt((((p.torque - predicted) ** 2) * moves).sum() / ((p.torque**2) * moves).sum())
        assert stated == pytest.approx(own, rel=0.02)


def test_without_rests_the_error_in_motion_is_the_error(unnamed):
    r = unnamed
    assert r.moving.at_rest < 0.05
    assert r.moving.after == pytest.approx(r.after.validation.relative_error, rel=0.05)


def test_the_written_robot_replayed_gives_the_stated_error(spring, tmp_path):
    path, r = spring
    write_result(r, tmp_path)
    content = json.loads((tmp_path / "closed_loop.json").read_text())
    for role in ("validation", "identification"):
        errors = rf.replay_errors(tmp_path / "robot.toml", path, role)
        assert errors.relative_error == pytest.approx(content["after"][role]["relative_error"], rel=1e-6)
        assert errors.torque_rms == pytest.approx(content["after"][role]["torque_rms"], rel=1e-6)


@pytest.mark.parametrize(
    ("joints", "known"),
    [
        pytest.param(("elbow",), True, id="one joint of two, links known", marks=pytest.mark.slow),
        pytest.param(("elbow", "shoulder"), False, id="another order, links fitted"),
        pytest.param(("elbow", "shoulder"), True, id="another order, links known", marks=pytest.mark.slow),
        pytest.param(("elbow",), False, id="one joint of two, links fitted", marks=pytest.mark.slow),
    ],
)
def test_that_holds_whatever_the_form_of_the_campaign(joints, known, tmp_path):
    """What the other joint does is missing where it is not logged; the written robot is the reported one all the same."""
    path = campaign(tmp_path / "data", ind.hidden("joint_spring", 1, SPRING), 2, known=known, joints=joints)
    r = rf.close_loop(path)
    write_result(r, tmp_path / "out")
    errors = rf.replay_errors(tmp_path / "out" / "robot.toml", path)
    assert errors.relative_error == pytest.approx(r.after.validation.relative_error, rel=1e-6)


def test_both_errors_are_stated_where_the_fitted_links_are_no_bodies(spring):
    """The fitted values do at least as well where they were fitted; the written ones are what is reported."""
    _, r = spring
    content = closed_loop_json(r)["fitted"]
    assert r.fitted is not None and content is not None
    for when in ("before", "after"):
        fitted, written = (getattr(x, when).identification.relative_error for x in (r.fitted, r))
        assert fitted < written * (1 + 1e-6)
        assert content[when]["identification"]["relative_error"] == fitted


def test_a_robot_with_a_value_left_open_cannot_be_replayed(spring):
    path, _ = spring
    with pytest.raises(ValueError, match="has no value"):
        rf.replay_errors(path.parent / "robot_declared.toml", path)


def test_a_role_that_no_recording_has_is_named(spring):
    path, _ = spring
    with pytest.raises(ValueError, match="no recording has role"):
        rf.replay_errors(path.parent / "robot_declared.toml", path, "test")  # type: ignore[arg-type]
