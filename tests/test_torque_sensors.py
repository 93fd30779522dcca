"""Torque sensors behind the gears: what they add to a fit, on an arm simulated without the package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.view.report import report_html

ZEROS = (0.7, -0.4)  # N m, of the sensors
ROTOR = (0.35, 0.12)  # kg m^2
RATE_HZ, PERIOD_S = 100.0, 10.0


def campaign(
    folder: Path,
    before: tuple[ind.Torque, ...] = (),
    behind: tuple[ind.Torque, ...] = (),
    gains: tuple[float, float] = (1.0, 1.0),
    sensors: str = "both",
) -> Path:
    """Two joints with friction and rotors; hidden torques before and behind the gears, sensors of some joints."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(5)
    rotors = [ind.hidden("drive_inertia", j, {"inertia": x}) for j, x in enumerate(ROTOR)]
    kinds = ("coulomb_friction", "viscous_friction", "drive_inertia")
    tables = [{"type": k, "joint": j} for j in arm.joints for k in kinds]
    runs, sensed = [], []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=PERIOD_S, rate_hz=RATE_HZ, lines=8)
        noise, own = (ind.white(rng, len(m.time), rms) for rms in ((0.08, 0.04), (0.05, 0.03)))
        passing = ind.run(arm, role, m, behind, np.zeros_like(own))
        sensed.append(passing.torque + own + ZEROS)
        whole = ind.run(arm, role, m, [ind.friction((1.0, 0.6), (1.5, 0.8)), *rotors, *before, *behind], noise)
        runs.append(ind.Run(role, m, whole.torque * gains))
    path = ind.write_files(folder, arm, tables, runs, cutoff_hz=15.0)
    for i, values in enumerate(sensed, start=1):
        file = folder / f"log_{i}.csv"
        table = np.column_stack([np.loadtxt(file, delimiter=",", skiprows=1), values])
        if sensors == "first joint":
            table[:, 6] = 0.0
        header = "time,angle_0,angle_1,moment_0,moment_1,sensor_0,sensor_1"
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")
    if sensors != "none":
        text = path.read_text()
        path.write_text(text.replace("[preprocessing]", 'joint_torque = ["sensor_0", "sensor_1"]\n[preprocessing]'))
    return path


def found(result: rf.ClosedLoop) -> list[str]:
    return [e.effect.label for e in result.effects]


def estimates(result: rf.ClosedLoop, label: str) -> dict[str, tuple[float | None, float | None]]:
    place = [e.label for e in result.model.effects].index(label)
    return {e.name: (e.value, e.std) for e in result.model.estimates(place)}


@pytest.mark.slow
def test_a_report_is_written_where_sensors_were_fitted_too(tmp_path: Path) -> None:
    told = rf.close_loop(campaign(tmp_path))
    assert isinstance(told, rf.ClosedLoop)
    assert told.model.regression.torque.shape[1] == 4
    assert "What to measure next" in report_html(told)


@pytest.mark.parametrize("sensors", [pytest.param("both", marks=pytest.mark.slow), "first joint"])
def test_with_a_sensor_the_rotor_is_told_from_the_first_link_and_without_it_is_not(
    tmp_path: Path, sensors: str
) -> None:
    for name in ("with", "without"):
        (tmp_path / name).mkdir()
    told = rf.close_loop(campaign(tmp_path / "with", sensors=sensors))
    untold = rf.close_loop(campaign(tmp_path / "without", sensors="none"))
    assert found(told) == found(untold) == []
    value, std = estimates(told, "shoulder.drive_inertia")["inertia"]
    assert value is not None and std is not None
    assert abs(value - ROTOR[0]) < 3.0 * std and std < 0.01 * ROTOR[0]
    assert estimates(untold, "shoulder.drive_inertia")["inertia"][1] is None
    for joint, dry in (("shoulder", 1.0), ("elbow", 0.6)):
        torque, off = estimates(told, f"{joint}.coulomb_friction")["torque"]
        assert torque is not None and off is not None and abs(torque - dry) < 4.0 * off + 0.01 * dry
    assert told.after.validation.relative_error == pytest.approx(untold.after.validation.relative_error, rel=0.02)


def test_a_motor_s_gain_is_named_that_links_would_swallow(tmp_path: Path) -> None:
    result = rf.close_loop(campaign(tmp_path, gains=(1.2, 1.0)), despite_faults=True)
    assert "shoulder.torque_gain" in found(result)
    value, std = estimates(result, "shoulder.torque_gain")["gain"]
    assert value is not None and std is not None and abs(value - 1.2) < max(4.0 * std, 0.005)


@pytest.mark.parametrize(
    ("side", "hidden", "named"),
    [
        (
            "before",
            ind.hidden("stribeck_friction", 0, {"torque": 0.5, "velocity": 0.15, "power": 1.2}),
            "stribeck_friction",
        ),
        ("behind", ind.hidden("joint_spring", 0, {"stiffness": 3.0, "rest_angle": 0.1}), "joint_spring"),
    ],
)
def test_what_hides_on_either_side_of_the_gear_is_named(
    tmp_path: Path, side: str, hidden: ind.Torque, named: str
) -> None:
    result = rf.close_loop(campaign(tmp_path, **{side: (hidden,)}))
    assert found(result) == [f"shoulder.{named}"]


def test_the_final_error_of_each_sensor_is_said_and_the_log_may_lack_one_in_a_recording(tmp_path: Path) -> None:
    path = campaign(tmp_path)
    file = tmp_path / "log_2.csv"
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[:, 5:] = 0.0
    header = "time,angle_0,angle_1,moment_0,moment_1,sensor_0,sensor_1"
    np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")
    result = rf.close_loop(path)
    assert found(result) == []
    said = [c for c in result.cautions if "torque sensor of" in c]
    assert len(said) == 2 and "shoulder" in said[0] and "elbow" in said[1]
    value, std = estimates(result, "shoulder.drive_inertia")["inertia"]
    assert value is not None and std is not None and abs(value - ROTOR[0]) < 3.0 * std


@pytest.mark.parametrize("estimator", ["least_squares", "huber"])
def test_identify_uses_them_as_well(tmp_path: Path, estimator: str) -> None:
    result = rf.identify(campaign(tmp_path), estimator=estimator)
    (rotor,) = (e for e in result.robot.effects if e.label == "shoulder.drive_inertia")
    assert rotor.coefficients[0] == pytest.approx(ROTOR[0], rel=0.01)


def _minus(shoulder: np.ndarray) -> np.ndarray:
    return shoulder * [-1.0, 1.0]


def _milli(both: np.ndarray) -> np.ndarray:
    return both * 1e3


def _exchanged(both: np.ndarray) -> np.ndarray:
    return both[:, ::-1]


def _noise(both: np.ndarray) -> np.ndarray:
    return np.column_stack([np.random.default_rng(3).normal(size=len(both)), both[:, 1]])


@pytest.mark.parametrize(
    ("wrong", "kind", "joints"),
    [
        (_minus, "reversed_sign", {"shoulder"}),
        (_milli, "unit", {"shoulder", "elbow"}),
        (_exchanged, "swapped_columns", {"shoulder", "elbow"}),
        (_noise, "unrelated", {"shoulder"}),
        ("motor", "swapped_columns", {"shoulder", "elbow"}),
    ],
)
def test_a_wrong_sensor_is_told_and_not_used(
    tmp_path: Path, wrong: Callable[[np.ndarray], np.ndarray] | str, kind: str, joints: set[str]
) -> None:
    path = campaign(tmp_path)
    for file in sorted(tmp_path.glob("log_*.csv")):
        header = file.read_text().splitlines()[0]
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        table[:, 5:] = table[:, 3:5] if isinstance(wrong, str) else wrong(table[:, 5:])
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")
    result = rf.close_loop(path)
    assert found(result) == [] and result.after.validation.relative_error < 0.005
    faults = [f for f in result.data_faults if f.signal == "joint_torque"]
    assert {f.kind for f in faults} == {kind} and {j for f in faults for j in f.joints} == joints
    assert all(f.usable for f in faults)
    used = {j for j in ("shoulder", "elbow") if any(f"sensor of {j} was fitted" in c for c in result.cautions)}
    assert used == {"shoulder", "elbow"} - joints
    identified = rf.identify(path)
    assert identified.validation is not None and identified.validation.relative_error < 0.005
    assert [j for j in ("shoulder", "elbow") if any(f"sensor of {j}" in c for c in identified.cautions)]


def test_sound_sensors_have_no_fault_and_motor_and_sensor_that_disagree_are_said_to(tmp_path: Path) -> None:
    assert rf.check(campaign(tmp_path)).data_faults == ()
    result = rf.close_loop(campaign(tmp_path, gains=(1.2, 1.0)), despite_faults=True)
    assert any("does not say which of them" in c for c in result.cautions)


@pytest.mark.parametrize("scale", [0.97, 1.02])
def test_a_sensor_off_within_its_calibration_makes_no_effect_and_is_told_of(tmp_path: Path, scale: float) -> None:
    path = campaign(tmp_path)
    for file in sorted(tmp_path.glob("log_*.csv")):
        header = file.read_text().splitlines()[0]
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        table[:, 5] *= scale
        np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")
    result = rf.close_loop(path)
    assert found(result) == [] and result.after.validation.relative_error < 0.005
    (said,) = [c for c in result.cautions if "within the 5% of a calibration" in c]
    assert "torque sensor of shoulder" in said
    value, std = estimates(result, "shoulder.drive_inertia")["inertia"]
    assert value is not None and std is not None and abs(value - ROTOR[0]) < 3.0 * std
    assert any("within the 5%" in c for c in rf.identify(path).cautions)
