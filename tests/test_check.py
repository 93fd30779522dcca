"""Claims about the look at the data, on recordings that the package had no part in making (`independent.py`)."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from data_folder import data_folder
from marked import by_cost

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.diagnose.faults.sample import Reading, Sample, Track
from rx90b_flex.signals import Recording, load_campaign
from rx90b_flex.signals.data_fault import KINDS

RATE_HZ, CUTOFF_HZ, PERIOD_S = 100.0, 15.0, 10.0
ARM = ind.ur10(1.1)
JOINTS = tuple(ARM.joints)
PAN, LIFT, ELBOW, WRIST_1, WRIST_2, WRIST_3 = range(6)
COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
NOISE = (0.8, 1.0, 0.6, 0.12, 0.1, 0.06)
DECLARED = [{"type": kind, "joint": j} for j in JOINTS for kind in ("coulomb_friction", "viscous_friction")]
ROLES = ("identification", "identification", "validation")

Runs = list[ind.Run]


def sound(more: Sequence[ind.Torque] = (), speed: float = 1.2) -> Runs:
    rng = np.random.default_rng(0)
    runs = []
    for role in ROLES:
        m = ind.harmonics(rng, 6, period_s=PERIOD_S, rate_hz=RATE_HZ, speed=speed)
        noise = ind.white(rng, len(m.time), NOISE)
        runs.append(ind.run(ARM, role, m, [ind.friction(COULOMB, VISCOUS), *more], noise))
    return runs


def with_torques(runs: Runs, change: Callable[[np.ndarray], np.ndarray]) -> Runs:
    return [dataclasses.replace(r, torque=change(r.torque.copy())) for r in runs]


def with_angles(runs: Runs, change: Callable[[np.ndarray], np.ndarray]) -> Runs:
    return [dataclasses.replace(r, motion=dataclasses.replace(r.motion, q=change(r.motion.q.copy()))) for r in runs]


def exchanged(i: int, j: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x[:, [j if k == i else i if k == j else k for k in range(x.shape[1])]]


def scaled(joint: int, factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x * np.where(np.arange(x.shape[1]) == joint, factor, 1.0)


def checked(folder: Path, runs: Runs, declared: Sequence[dict[str, str]] = DECLARED) -> rf.Checked:
    return rf.check(ind.write_files(folder, ARM, declared, runs, cutoff_hz=CUTOFF_HZ))


# ---- sound data -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> rf.Checked:
    """Of sound data."""
    return checked(tmp_path_factory.mktemp("plain"), sound())


def test_sound_data_are_usable_and_nothing_is_found(plain: rf.Checked) -> None:
    assert plain.usable and plain.data_faults == ()
    assert max(plain.relative_error) < 0.2


# Coupled motors, Stribeck's friction and load's are looked at in test_close_loop.py, where the loop closes on them.
EFFECTS = {
    "ripple": [ind.hidden("gear_ripple", ELBOW, {"order": 18.0, "amplitude": 6.0, "phase": 0.7})],
    "spring": [ind.hidden("joint_spring", LIFT, {"stiffness": 30.0, "rest_angle": 0.3})],
    "tilted base": [ind.tilted(ARM, 0.05, -0.03)],
    "payload": [ind.carrying(ARM, "tool0", 4.0, (0.0, 0.05, 0.1))],
    "friction that differs by direction": [ind.hidden("asymmetric_friction", ELBOW, {"coefficient": 4.0})],
}  # fmt: skip


ALIKE = (
    "spring",
    "tilted base",
    "positions exchanged",
    "a torque in N mm",
    "a torque thirty times too large",
    "an encoder that slips",
    "a torque reversed",
    "every torque reversed",
    "an encoder that stands in one log",
    "a torque cut off",
)  # what others of their table are much like: looked at with the slow tests


@pytest.mark.parametrize("name", by_cost(EFFECTS, slow=ALIKE))
def test_a_physical_effect_is_not_called_a_fault_of_the_data(tmp_path: Path, name: str) -> None:
    assert checked(tmp_path, sound(EFFECTS[name])).data_faults == ()


def test_a_small_delay_is_left_to_the_loop(tmp_path: Path) -> None:
    late = with_torques(sound(), lambda x: np.roll(x, 2, axis=0))
    assert checked(tmp_path, [_cut(r, 3) for r in late]).data_faults == ()


@pytest.mark.parametrize(
    "name",
    [
        "tx40",
        "emps",
        "ur10e",
        *(pytest.param(long, marks=pytest.mark.slow) for long in ("kr300_encoders", "dualarm_v2")),
    ],
)
def test_real_recordings_are_usable(name: str) -> None:
    result = rf.check(data_folder(name) / "campaign.toml")
    assert result.usable
    gains = {f.joints[0] for f in result.data_faults if f.kind == "torque_gain"}
    # its torque sensors say that the currents' factors are wrong, above all on joint 4
    assert ("joint_4" in gains) if name == "dualarm_v2" else (result.data_faults == ())


def _piece(recording: Recording, rows: slice, every: int) -> Recording:
    """Some rows of a recording's angles and torques, to identify on."""
    time, position, torque = (x[rows][::every] for x in (recording.time, recording.position, recording.torque))
    rate = recording.sample_rate_hz / every
    return Recording(recording.name, "identification", time - time[0], rate, recording.joints, position, torque)


@pytest.mark.parametrize(
    ("some", "part", "every"),
    [
        ((0,), 1.0, 1),
        ((0, 1, 2), 0.35, 1),
        *(
            pytest.param(*x, marks=pytest.mark.slow)
            for x in (((1,), 1.0, 1), ((2,), 1.0, 1), ((0, 1, 2), 0.5, 1), ((0, 1, 2), 1.0, 5))
        ),
    ],
)
def test_too_little_of_a_sound_recording_is_not_a_fault(some: tuple[int, ...], part: float, every: int) -> None:
    # in so short a motion some wrong reading of the columns does better than the right one, but not all the time
    campaign = load_campaign(data_folder("kr300_encoders") / "campaign.toml")
    pieces = [(campaign.recordings[k], slice(0, int(part * campaign.recordings[k].samples))) for k in some]
    recordings = tuple(_piece(recording, rows, every) for recording, rows in pieces)
    rate = campaign.sample_rate_hz / every
    result = rf.check(dataclasses.replace(campaign, recordings=recordings, sample_rate_hz=rate, cutoff_hz=None))
    assert result.usable, [f.message for f in result.data_faults]


# ---- faults -----------------------------------------------------------------------------------------------------


def _cut(run: ind.Run, rows: int) -> ind.Run:
    """Without its first rows, its clock from zero."""
    m = run.motion
    part = ind.Motion(m.time[rows:] - m.time[rows], m.q[rows:], m.v[rows:], m.a[rows:])
    return ind.Run(run.role, part, run.torque[rows:])


def _wild(x: np.ndarray) -> np.ndarray:
    x[300, LIFT] = 1e6
    return x


def _slipped(x: np.ndarray) -> np.ndarray:
    x[400:, ELBOW] += 0.04
    return x


def _held(q: np.ndarray) -> np.ndarray:
    q[:, LIFT] = -0.3
    return q


def _standing(x: np.ndarray) -> np.ndarray:
    x[:, ELBOW] = 0.5
    return x


def _clipped(x: np.ndarray) -> np.ndarray:
    return np.where(np.arange(6) == PAN, np.clip(x, -20.0, 20.0), x)


def _repeated(runs: Runs) -> Runs:
    return [*runs[:2], dataclasses.replace(runs[0], role="validation")]


FAULTS: dict[str, tuple[Callable[[Runs], Runs], str, tuple[int, ...], float | None]] = {
    "positions exchanged": (lambda r: with_angles(r, exchanged(LIFT, ELBOW)), "swapped_columns", (LIFT, ELBOW), None),
    "every torque reversed": (lambda r: with_torques(r, np.negative), "reversed_sign", tuple(range(6)), None),
    "a position reversed": (lambda r: with_angles(r, scaled(ELBOW, -1.0)), "reversed_sign", (ELBOW,), None),
    "angles in degrees": (lambda r: with_angles(r, np.degrees), "unit", tuple(range(6)), np.degrees(1.0)),
    "a torque in N mm": (lambda r: with_torques(r, scaled(ELBOW, 1000.0)), "unit", (ELBOW,), 1000.0),
    "a wrong motor constant": (lambda r: with_torques(r, scaled(LIFT, 2.5)), "torque_gain", (LIFT,), 2.5),
    "a torque thirty times too large": (lambda r: with_torques(r, scaled(ELBOW, 30.0)), "torque_gain", (ELBOW,), 30.0),
    "torques a second late": (
        lambda r: [_cut(x, 100) for x in with_torques(r, lambda t: np.roll(t, 100, axis=0))],
        "time_shift", tuple(range(6)), 1.0,
    ),
    "a torque cut off": (lambda r: with_torques(r, _clipped), "clipped", (PAN,), None),
    "an encoder that stands": (lambda r: with_angles(r, _standing), "stuck", (ELBOW,), None),
    "an encoder that stands in one log": (lambda r: [*r[:1], *with_angles(r[1:2], _held), *r[2:]], "stuck", (LIFT,), None),
    "an encoder that slips": (lambda r: with_angles(r, _slipped), "glitch", (ELBOW,), None),
    "a wild cell": (lambda r: with_torques(r, _wild), "glitch", (LIFT,), None),
    "validation as fitted": (_repeated, "repeated_recording", (), None),
}  # fmt: skip


@pytest.mark.parametrize("name", by_cost(FAULTS, slow=ALIKE))
def test_a_fault_is_named_on_its_joints(tmp_path: Path, name: str) -> None:
    change, kind, joints, factor = FAULTS[name]
    result = checked(tmp_path, change(sound()))
    fault = next(f for f in result.data_faults if f.kind == kind)
    assert set(fault.joints) == {JOINTS[j] for j in joints}
    assert kind in KINDS
    assert fault.usable == result.usable == (kind == "torque_gain")
    if factor is not None:
        assert fault.factor == pytest.approx(factor, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_of_torques_that_have_nothing_to_do_with_the_motion_nothing_else_is_said(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = with_torques(sound(), lambda x: x.mean(axis=0) + x.std(axis=0) * rng.normal(size=x.shape))
    result = checked(tmp_path, noise)
    (fault,) = result.data_faults
    assert (fault.kind, fault.joints) == ("unrelated", JOINTS)
    assert not fault.usable and not result.usable


@pytest.mark.parametrize(
    ("joints", "seen"), [((ELBOW,), 0.0), *(pytest.param((4, 5), x, marks=pytest.mark.slow) for x in (0.0, 0.25))]
)
def test_a_torque_that_is_zero_in_motion_is_said_not_to_be_measured(
    tmp_path: Path, joints: tuple[int, ...], seen: float
) -> None:
    """Nothing but zeros, or zeros with some noise in between, as of drives without a current sensor."""
    rng = np.random.default_rng(0)

    def change(x: np.ndarray) -> np.ndarray:
        size = len(x), len(joints)
        x[:, list(joints)] = 0.05 * rng.normal(size=size) * (rng.random(size) < seen)
        return x

    result = checked(tmp_path, with_torques(sound(), change))
    (fault,) = result.data_faults
    assert (fault.kind, fault.joints) == ("unrelated", tuple(JOINTS[j] for j in joints))
    assert "measured" in fault.message and not result.usable
    assert result.torque_side.message == ""  # no size of a torque that is none


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_wrong_axis_is_told_though_a_third_of_every_torque_is_noise(tmp_path: Path, seed: int) -> None:
    """A large gain at all times is no chance, whatever is left; and noise alone is no fault."""
    rng = np.random.default_rng(seed)
    noisy = with_torques(sound(), lambda x: x + 0.6 * x.std(axis=0) * rng.normal(size=x.shape))
    path = ind.write_files(tmp_path, ARM, DECLARED, noisy, cutoff_hz=CUTOFF_HZ)
    assert rf.check(path).data_faults == ()
    file = tmp_path / "robot_declared.toml"
    tree = ElementTree.fromstring(rf.load_robot(file).urdf)
    axis = next(j for j in tree.iter("joint") if j.get("name") == JOINTS[LIFT]).find("axis")
    assert axis is not None
    axis.set("xyz", "0 0 1")
    (tmp_path / "turned.urdf").write_bytes(ElementTree.tostring(tree))
    file.write_text(re.sub('urdf = ".*"', 'urdf = "turned.urdf"', file.read_text()))
    (fault,) = rf.check(path).data_faults
    assert (fault.kind, fault.joints) == ("kinematics", (JOINTS[LIFT],))


@pytest.mark.slow
@pytest.mark.parametrize("low", [(LIFT, ELBOW), range(6)])
def test_torques_far_below_what_links_ask_for_are_said_whose_and_how_far(tmp_path: Path, low: Sequence[int]) -> None:
    """Amperes in the place of torques fit links that are lighter: no fault for certain, yet nothing to pass over."""

    def change(x: np.ndarray) -> np.ndarray:
        x[:, list(low)] /= 12.0
        return x

    result = checked(tmp_path, with_torques(sound(), change))
    said = [*(f.message for f in result.data_faults), result.torque_side.message]
    assert any((JOINTS[LIFT] in x and JOINTS[ELBOW] in x) or "gear_matrix" in x for x in said), said


@pytest.mark.slow
@pytest.mark.parametrize("joint", [ELBOW, WRIST_2])
def test_a_reversed_torque_is_named_where_joints_move_one_after_another(tmp_path: Path, joint: int) -> None:
    rng, runs = np.random.default_rng(0), []
    for role in ROLES:
        m = one_after_another(ind.harmonics(rng, 6, period_s=5.0, rate_hz=RATE_HZ, speed=1.0))
        runs.append(ind.run(ARM, role, m, [ind.friction(COULOMB, VISCOUS)], ind.white(rng, len(m.time), NOISE)))
    assert checked(tmp_path, runs).data_faults == ()
    turned = np.where(np.arange(6) == joint, -1.0, 1.0)
    found = checked(tmp_path, with_torques(runs, lambda x: turned * x)).data_faults
    assert [(f.kind, f.signal, f.joints) for f in found] == [("reversed_sign", "torque", (JOINTS[joint],))]


def one_after_another(m: ind.Motion) -> ind.Motion:
    """A motion of all joints as one of each in turn, which begins and ends at rest while the others stand."""
    step, n = m.time[1] - m.time[0], len(m.time)
    part = m.time / m.time[-1]
    rise, fall = (10 * x**3 - 15 * x**4 + 6 * x**5 for x in np.clip([part / 0.2, (1 - part) / 0.2], 0, 1))
    q, v, a = np.tile(m.q[0], (6 * n, 1)), np.zeros((6 * n, 6)), np.zeros((6 * n, 6))
    for k in range(6):
        own = slice(k * n, (k + 1) * n)
        way = (m.q[:, k] - m.q[0, k]) * rise * fall
        speed = np.gradient(way, step)
        q[own, k], v[own, k], a[own, k] = m.q[0, k] + way, speed, np.gradient(speed, step)
    return ind.Motion(step * np.arange(6 * n), q, v, a)


def test_what_is_fitted_twice_is_told(tmp_path: Path) -> None:
    runs = sound()
    result = checked(tmp_path, [runs[0], runs[0], *runs[1:]])
    (fault,) = result.data_faults
    assert (fault.kind, fault.usable) == ("repeated_recording", True) and "fitted twice" in fault.message


def test_a_joint_that_is_held_in_one_log_is_no_sensor_that_stands(tmp_path: Path) -> None:
    """The others move it, and it needs torque for that."""
    runs = sound()
    rng = np.random.default_rng(8)
    held = runs[0].motion
    q, v, a = (x.copy() for x in (held.q, held.v, held.a))
    q[:, ELBOW], v[:, ELBOW], a[:, ELBOW] = 0.4, 0.0, 0.0
    motion = dataclasses.replace(held, q=q, v=v, a=a)
    still = ind.run(
        ARM, "identification", motion, [ind.friction(COULOMB, VISCOUS)], ind.white(rng, len(motion.time), NOISE)
    )
    assert not [f for f in checked(tmp_path, [*runs, still]).data_faults if f.kind == "stuck"]


@pytest.mark.slow
def test_rows_that_are_missing_are_no_encoders_that_slip(tmp_path: Path) -> None:
    """Of a log without a time column, five times a tenth of a second."""
    kept = np.ones(len(sound()[0].motion.time), dtype=bool)
    for begin in np.linspace(0.15, 0.8, 5) * len(kept):
        kept[int(begin) : int(begin) + 10] = False
    path = ind.write_files(tmp_path, ARM, DECLARED, sound(), cutoff_hz=CUTOFF_HZ)
    for log in tmp_path.glob("log_*.csv"):
        head, *rows = [row.split(",", 1)[1] for row in log.read_text().splitlines()]
        log.write_text("\n".join([head, *(row for row, keep in zip(rows, kept, strict=True) if keep)]) + "\n")
    slips = [f for f in rf.check(path).data_faults if f.kind == "glitch"]
    assert len(slips) == 3
    assert all("rows are missing" in f.message and len(f.joints) > 1 for f in slips)


@pytest.mark.slow
def test_samples_that_are_held_where_others_were_lost_are_said_and_no_link_is_too_long(tmp_path: Path) -> None:
    """Four drop-outs of a bus in each log, of 50 to 110 ms, in which every column stands."""
    path = ind.write_files(tmp_path, ARM, DECLARED, sound(), cutoff_hz=CUTOFF_HZ)
    for number, log in enumerate(sorted(tmp_path.glob("log_*.csv"))):
        rows = np.loadtxt(log, delimiter=",", skiprows=1)
        rng, rate = np.random.default_rng(number), 1.0 / np.median(np.diff(rows[:, 0]))
        for begin in (rng.uniform(0.1, 0.9, 4) * len(rows)).astype(int):
            end = begin + int(rng.uniform(0.05, 0.11) * rate)
            rows[begin:end, 1:] = rows[begin, 1:]
        header = log.read_text().splitlines()[0]
        np.savetxt(log, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    faults = rf.check(path).data_faults
    assert {f.kind for f in faults} == {"glitch"}
    assert all("the last sample before stands for lost ones" in f.message for f in faults)


@pytest.mark.slow
def test_torques_turned_round_in_one_recording_are_not_called_late(tmp_path: Path) -> None:
    *fitted, validated = sound()
    found = checked(tmp_path, [*fitted, *with_torques([validated], lambda x: -x)]).data_faults
    assert "time_shift" not in {f.kind for f in found}


def test_an_angle_that_wraps_round_is_to_be_unwrapped_and_no_more_is_said_of_it(tmp_path: Path) -> None:
    """Also where it wraps oftener than an encoder would slip; the fits go on with the angle unwrapped."""

    def wrapped(x: np.ndarray) -> np.ndarray:
        out = x.copy()
        out[:, PAN] = (x[:, PAN] - x[:, PAN].mean()) % (2 * np.pi) - np.pi
        return out

    found = checked(tmp_path, with_angles(sound(), wrapped)).data_faults
    assert {(f.kind, f.joints) for f in found} == {("glitch", (JOINTS[PAN],))}
    assert all("wraps round by whole turns" in f.message for f in found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_friction_that_winds_up_is_no_torque_that_comes_late(tmp_path: Path, seed: int) -> None:
    """Dahl's law over 4 mrad in the first joint, which carries no weight: there it is most of the torque."""
    rng, runs = np.random.default_rng(seed), []
    beside = ind.friction((0.0, *COULOMB[1:]), VISCOUS)
    for role in ROLES:
        m = ind.harmonics(rng, 6, period_s=10.0, periods=2, rate_hz=RATE_HZ, lines=8, speed=0.4)
        wound = np.zeros(len(m.time))
        for k in range(1, len(wound)):
            step = m.q[k, PAN] - m.q[k - 1, PAN]
            wound[k] = wound[k - 1] + (1.0 - wound[k - 1] * np.sign(step)) * step / 4e-3
            wound[k] = np.clip(wound[k], -1.0, 1.0)
        hysteresis = 12.0 * wound[:, None] * (np.arange(6) == PAN)
        runs.append(
            ind.run(ARM, role, m, [beside, lambda m, load, x=hysteresis: x], ind.white(rng, len(m.time), NOISE), 10.0)
        )
    assert checked(tmp_path, runs).data_faults == ()


@pytest.mark.slow
def test_angles_in_degrees_are_named_though_they_could_be_radians(tmp_path: Path) -> None:
    runs = with_angles(sound(speed=0.6), np.degrees)
    assert max(float(np.abs(r.motion.q).max()) for r in runs) < 100.0  # what the reader refuses begins there
    (fault,) = checked(tmp_path, runs).data_faults
    assert (fault.kind, fault.joints, fault.signal) == ("unit", JOINTS, "motor_position")
    assert fault.factor == pytest.approx(180.0 / np.pi)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kept", [pytest.param(0.5, marks=pytest.mark.slow), 1.0]
)  # of the motion: with all of it the low-pass comes near half the stated rate
def test_a_stated_rate_of_half_the_true_one_is_named_without_a_time_column(tmp_path: Path, kept: float) -> None:
    rng = np.random.default_rng(1)
    counted = with_angles(sound(), lambda q: q + 1e-5 * rng.normal(size=q.shape))
    path = ind.write_files(tmp_path, ARM, DECLARED, counted, cutoff_hz=kept * CUTOFF_HZ)
    for log in tmp_path.glob("log_*.csv"):
        rows = log.read_text().splitlines()
        log.write_text("\n".join(row.split(",", 1)[1] for row in rows) + "\n")
    path.write_text(path.read_text().replace("sample_rate_hz = 100", "sample_rate_hz = 50"))
    (fault,) = rf.check(path).data_faults
    assert fault.kind == "sample_rate"
    assert fault.factor == pytest.approx(0.5, rel=0.1)


def test_a_stated_rate_that_the_time_column_contradicts_is_named(tmp_path: Path) -> None:
    path = ind.write_files(tmp_path, ARM, DECLARED, sound(), cutoff_hz=CUTOFF_HZ)
    path.write_text(path.read_text().replace("sample_rate_hz = 100", "sample_rate_hz = 200"))
    (fault,) = rf.check(path).data_faults
    assert (fault.kind, fault.usable) == ("sample_rate", False)
    assert fault.factor == pytest.approx(2.0, rel=1e-3)


# ---- gear ratios --------------------------------------------------------------------------------------------------


def with_ratio(runs: Runs, joint: int, factor: float, torque: float) -> Runs:
    """A joint's angle logged so many times too large, and its torque."""
    return with_torques(with_angles(runs, scaled(joint, factor)), scaled(joint, torque))


@pytest.mark.parametrize(
    ("joint", "factor"),
    [
        (LIFT, 1.1),
        *(
            pytest.param(*x, marks=pytest.mark.slow)
            for x in ((LIFT, 0.9), (LIFT, 1.05), (ELBOW, 0.8), (ELBOW, 1.1), (ELBOW, 1.25))
        ),
    ],
)
def test_a_wrong_gear_ratio_is_told_with_its_joint_and_factor(tmp_path: Path, joint: int, factor: float) -> None:
    """The angle too large and the torque too small by it: power is the same on both sides of a gear."""
    result = checked(tmp_path, with_ratio(sound(), joint, factor, 1.0 / factor))
    (fault,) = result.data_faults
    assert (fault.kind, fault.signal, fault.joints) == ("unit", "all", (JOINTS[joint],))
    assert fault.factor == pytest.approx(factor, rel=0.01) and fault.std is not None
    assert "gear ratio" in fault.message and not result.usable
    assert max(result.relative_error) < 0.2  # with it mended


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.1, pytest.param(0.9, marks=pytest.mark.slow)])
def test_an_angle_in_another_scale_is_told_where_the_torque_is_right(tmp_path: Path, factor: float) -> None:
    (fault,) = checked(tmp_path, with_ratio(sound(), ELBOW, factor, 1.0)).data_faults
    assert (fault.kind, fault.signal, fault.joints) == ("unit", "motor_position", (JOINTS[ELBOW],))
    assert fault.factor == pytest.approx(factor, rel=0.01)


@pytest.mark.slow
def test_an_angle_and_a_torque_that_are_both_off_by_their_own_factors_are_told_apart(tmp_path: Path) -> None:
    found = checked(tmp_path, with_ratio(sound(), ELBOW, 1.1, 2.5)).data_faults
    factors = {f.kind: f.factor for f in found if f.joints == (JOINTS[ELBOW],)}
    assert len(found) == 2
    assert factors["unit"] == pytest.approx(1.1, rel=0.01)
    expected = 2.5 * (1.1 if found[0].signal == "all" else 1.0)
    assert factors["torque_gain"] == pytest.approx(
        expected, rel=0.1
    )  # so much are the links heavier than the URDF says


def test_a_wrong_gear_ratio_of_the_joint_that_stands_upright_is_not_named(tmp_path: Path) -> None:
    """No torque depends on its angle, and another inertia and other friction stand for its scale."""
    assert checked(tmp_path, with_ratio(sound(), PAN, 1.1, 1.0 / 1.1)).data_faults == ()


@pytest.mark.parametrize("joint", [LIFT, pytest.param(ELBOW, marks=pytest.mark.slow)])
def test_a_zero_of_the_urdf_that_is_some_degrees_off_is_no_gear_ratio(tmp_path: Path, joint: int) -> None:
    off = with_angles(sound(), lambda q: q + 0.08 * (np.arange(6) == joint))
    assert not [f for f in checked(tmp_path, off).data_faults if f.kind == "unit"]


# ---- what the motion can tell -----------------------------------------------------------------------------------


def test_what_never_moves_is_not_told_and_what_is_held_is_no_fault(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    runs = []
    for role in ROLES:
        m = ind.harmonics(rng, 6, period_s=PERIOD_S, rate_hz=RATE_HZ)
        q, v, a = m.q.copy(), m.v.copy(), m.a.copy()
        q[:, WRIST_1], v[:, WRIST_1], a[:, WRIST_1] = 0.4, 0.0, 0.0
        m = ind.Motion(m.time, q, v, a)
        runs.append(ind.run(ARM, role, m, [ind.friction(COULOMB, VISCOUS)], ind.white(rng, len(q), NOISE)))
    result = checked(tmp_path, runs)
    (fault,) = result.data_faults
    assert (fault.kind, fault.joints, fault.usable) == ("stuck", (JOINTS[WRIST_1],), True)
    assert result.never_move == (JOINTS[WRIST_1],)
    status = {p.name: p.status for p in result.parameters}
    assert status[f"{JOINTS[WRIST_1]}.viscous_friction.coefficient"] == "not"
    assert status[f"{JOINTS[LIFT]}.viscous_friction.coefficient"] == "identifiable"


def test_parameters_of_known_links_are_known(tmp_path: Path) -> None:
    path = ind.write_files(tmp_path, ind.ur10(), DECLARED, sound(), cutoff_hz=CUTOFF_HZ, known=True)
    statuses = [p.status for p in rf.check(path).parameters]
    assert statuses.count("known") == 60


def test_base_links_mass_is_not_told(plain: rf.Checked) -> None:
    status = {p.name: p.status for p in plain.parameters}
    assert status["shoulder_link.mass"] == "not"  # it turns about a vertical axis: nothing holds its mass


def test_friction_that_a_bare_urdf_lacks_is_offered(plain: rf.Checked, tmp_path: Path) -> None:
    basics = checked(tmp_path, sound(), declared=[]).undeclared_basics
    assert {"coulomb_friction", "viscous_friction"} <= set(basics)
    assert plain.undeclared_basics == ()


# ---- command ----------------------------------------------------------------------------------------------------


def run_command(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["rx90b-flex", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


@pytest.mark.parametrize("name", [pytest.param(None, marks=pytest.mark.slow), "positions exchanged"])
def test_the_command_writes_what_it_says_and_ends_with_its_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str | None
) -> None:
    runs = sound() if name is None else FAULTS[name][0](sound())
    path = ind.write_files(tmp_path, ARM, DECLARED, runs, cutoff_hz=CUTOFF_HZ)
    out = tmp_path / "out"
    status = run_command(monkeypatch, "check", str(path), "--out", str(out), "--plots")
    content = json.loads((out / "check.json").read_text())
    assert status == (0 if name is None else 1)
    assert content["schema"] == 1 and content["usable"] is (name is None)
    assert [f["kind"] for f in content["data_faults"]] == ([] if name is None else ["swapped_columns"])
    assert {r["role"] for r in content["recordings"]} == {"identification", "validation"}
    assert (out / "check.html").read_text().startswith("<!DOCTYPE html>")


def test_bad_input_is_one_line_and_status_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_command(monkeypatch, "check", str(tmp_path / "none.toml"), "--out", str(tmp_path / "out")) == 2
    assert not (tmp_path / "out").exists()


# ---- before anything else ---------------------------------------------------------------------------------------


def test_closing_the_loop_refuses_data_with_a_fault_and_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ind.write_files(tmp_path, ARM, DECLARED, with_torques(sound(), exchanged(LIFT, ELBOW)), cutoff_hz=CUTOFF_HZ)
    out = tmp_path / "out"
    assert run_command(monkeypatch, "close-loop", str(path), "--out", str(out)) == 1
    content = json.loads((out / "closed_loop.json").read_text())
    assert content["verdict"] == "data_fault" and content["effects"] == []
    assert [f["kind"] for f in content["data_faults"]] == ["swapped_columns"]
    assert content["data_faults"][0]["joints"] == [JOINTS[LIFT], JOINTS[ELBOW]]
    assert not (out / "robot.toml").exists()


@pytest.mark.slow
def test_identifying_refuses_data_with_a_fault_unless_told_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ind.write_files(tmp_path, ARM, DECLARED, with_torques(sound(), scaled(WRIST_1, -1.0)), cutoff_hz=CUTOFF_HZ)
    out = tmp_path / "out"
    assert run_command(monkeypatch, "identify", str(path), "--out", str(out)) == 1
    (fault,) = json.loads((out / "check.json").read_text())["data_faults"]
    assert (fault["kind"], fault["joints"]) == ("reversed_sign", [JOINTS[WRIST_1]])
    assert not (out / "identification.json").exists()
    assert run_command(monkeypatch, "identify", str(path), "--out", str(tmp_path / "on"), "--despite-faults") == 0
    assert (tmp_path / "on" / "identification.json").exists()


@pytest.mark.slow
def test_basics_are_identified_where_they_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ind.write_files(tmp_path, ARM, [], sound(), cutoff_hz=CUTOFF_HZ)
    assert run_command(monkeypatch, "identify", str(path), "--out", str(tmp_path / "bare")) == 0
    assert "--basics" in capsys.readouterr().out
    assert run_command(monkeypatch, "identify", str(path), "--out", str(tmp_path / "basics"), "--basics") == 0
    assert "--basics" not in capsys.readouterr().out
    found = json.loads((tmp_path / "basics" / "identification.json").read_text())
    values = {p["name"]: p["value"] for p in found["parameters"]}
    for joint, dry, viscous in zip(JOINTS, COULOMB, VISCOUS, strict=True):
        assert values[f"{joint}.coulomb_friction.torque"] == pytest.approx(dry, rel=0.1)
        assert values[f"{joint}.viscous_friction.coefficient"] == pytest.approx(viscous, rel=0.1)


def test_torques_at_other_times_are_those_of_their_columns_rows_and_logs():
    rng = np.random.default_rng(0)
    logs = [rng.normal(size=(50, 3)), rng.normal(size=(40, 3))]
    rows = [np.arange(12, 38, 3), np.arange(10, 30, 4)]
    tracks = tuple(Track(t, r, 10.0) for t, r in zip(logs, rows, strict=True))
    empty = np.zeros((14, 3))
    left, fold = np.ones((14, 3), dtype=bool), np.zeros(14, dtype=int)
    sample = Sample(("a", "b", "c"), *[empty] * 4, np.zeros((14, 3, 3)), left, tracks, fold, 1.0)
    plain = Reading.of(rf.load_robot("rx90b_3dof"), 3, 2)
    reading = dataclasses.replace(
        plain,
        torque_order=(2, 0, 1),
        torque_scale=(1.0, -2.0, 0.5),
    )
    for which, late in ((0, 0.3), (2, -0.2)):
        reading = reading.later(np.tile(np.arange(3) == which, (2, 1)), late)
    reading = reading.later(np.array([[False], [True]]) * np.ones(3, dtype=bool), 0.4)
    lags = np.array([-1.0, 0.0, 0.6, 9.0])
    expected = np.empty((3, len(lags), 14))
    for j, (column, scale, shift) in enumerate(zip((2, 0, 1), (1.0, -2.0, 0.5), (3, 0, -2), strict=True)):
        for k, lag in enumerate((-10, 0, 6, 90)):
            at = [np.clip(r + shift + lag + more, 0, len(t) - 1) for r, t, more in zip(rows, logs, (0, 4), strict=True)]
            expected[j, k] = scale * np.concatenate([t[i, column] for t, i in zip(logs, at, strict=True)])
    np.testing.assert_array_equal(sample.torque_later(reading, lags), expected)
    np.testing.assert_array_equal(sample.torque_seen(reading), expected[:, 1].T)
    torque, inside = sample.torque_of(reading)
    assert inside.all()
    np.testing.assert_array_equal(torque[:, [2, 0, 1]] * reading.torque_scale, expected[:, 1].T)
    assert not sample.torque_of(reading.later(np.tile([True, False, False], (2, 1)), 9.0))[1].any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_limits_of_the_urdf_that_are_narrower_than_the_robot_s_are_told_from_degrees(tmp_path: Path, seed: int) -> None:
    arm, rng, runs = ind.panda(), np.random.default_rng(seed), []
    n = len(arm.joints)
    for role in ROLES:
        m = ind.harmonics(rng, n, period_s=20.0, rate_hz=RATE_HZ, lines=4, speed=1.2)
        load = arm.torque(m).std(axis=0)
        rubs = ind.friction(tuple(0.2 * load + 0.1), tuple(0.2 * load + 0.1))
        runs.append(ind.run(arm, role, m, [rubs], ind.white(rng, len(m.time), tuple(0.02 * load + 0.01))))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    fourth = arm.joints[3]  # -3.07 to -0.07 rad in its URDF
    (narrow,) = rf.check(ind.write_files(tmp_path, arm, declared, runs, cutoff_hz=10.0)).data_faults
    assert narrow.usable and fourth in narrow.joints and "limits are narrower than the robot's" in narrow.message
    in_degrees = with_angles(runs, scaled(3, 180.0 / np.pi))
    checked = rf.check(ind.write_files(tmp_path, arm, declared, in_degrees, cutoff_hz=10.0))
    assert not checked.usable
    assert [(f.kind, f.joints) for f in checked.data_faults if not f.usable] == [("unit", (fourth,))]
