"""Units in names of columns and below them: brought to SI where a signal can have them, refused where it cannot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_importers import AXES, JOINTS, ROBOT, TAU, TIME, Q, V, numbered, said, table, whole

from rx90b_flex.importing import import_into
from rx90b_flex.signals import load_campaign
from rx90b_flex.signals.importers import ReadingOptions, import_logs

SLIDING = replace(AXES, prismatic=(True, True, True))
POUND_FOOT = 1.3558179483314004  # N m


def log(
    path: Path, position: str = "q{}", torque: str = "tau{}", velocity: str = "", scales: tuple = (1.0, 1.0, 1.0)
) -> Path:
    """A log whose values are Q, TAU and V times what is given."""
    names = ["time", *(name.format(k) for name in (position, torque, velocity) if name for k in (1, 2, 3))]
    blocks = [scale * values for scale, values in zip(scales, (Q, TAU, V), strict=True)]
    table(names, TIME, *blocks[: 3 if velocity else 2]).to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("cNm", 1e-2),
        ("Ncm", 1e-2),
        ("mN·m", 1e-3),
        ("kNm", 1e3),
        ("N-m", 1.0),
        ("lbf.ft", POUND_FOOT),
        ("ft-lb", POUND_FOOT),
        ("in.lbf", POUND_FOOT / 12),
        ("ozf.in", POUND_FOOT / 12 / 16),
    ],
)
def test_torques_are_brought_to_si_from_the_unit_in_their_names(tmp_path: Path, unit: str, size: float) -> None:
    for name in (f"tau{{}} [{unit}]", f"tau{{}} ({unit})"):
        path = log(tmp_path / "run.csv", torque=name, scales=(1.0, 1.0 / size, 1.0))
        np.testing.assert_allclose(whole(import_logs([path], AXES), "torque"), TAU, rtol=1e-9)


@pytest.mark.parametrize(
    ("angle", "rate", "size"),
    [
        ("deg", "deg/s", np.pi / 180),
        ("mdeg", "mdeg/s", 1e-3 * np.pi / 180),
        ("gon", "gon/s", np.pi / 200),
        ("rev", "rev/s", 2 * np.pi),
        ("mrad", "mrad s^-1", 1e-3),
    ],
)
def test_angles_and_their_rates_are_brought_to_si(tmp_path: Path, angle: str, rate: str, size: float) -> None:
    imported = import_logs(
        [log(tmp_path / "run.csv", f"q{{}} [{angle}]", "tau{}", f"qd{{}} [{rate}]", (1 / size, 1.0, 1 / size))], AXES
    )
    np.testing.assert_allclose(whole(imported, "position"), Q, atol=1e-12)
    np.testing.assert_allclose(whole(imported, "velocity"), V, atol=1e-12)


def test_joints_that_slide_have_lengths_and_forces(tmp_path: Path) -> None:
    path = log(tmp_path / "run.csv", "q{} [mm]", "tau{} [kN]", "qd{} [mm/s]", (1e3, 1e-3, 1e3))
    imported = import_logs([path], SLIDING)
    for field, values in (("position", Q), ("torque", TAU), ("velocity", V)):
        np.testing.assert_allclose(whole(imported, field), values, atol=1e-9)


@pytest.mark.parametrize(
    ("sliding", "position", "torque", "message"),
    [
        (False, "q{} [furlong]", "tau{}", "column 'q1 [furlong]' is in furlong, which import does not bring to SI; expected rad"),
        (False, "q{} [deg/s]", "tau{}", "column 'q1 [deg/s]' is in deg/s, which is no unit of an angle; expected rad"),
        (False, "q{} [mm]", "tau{}", "expected rad, deg, mrad, rev, for joint_1 turns"),
        (False, "q{}_mm", "tau{}", "column 'q1_mm' is in mm, which is no unit of an angle"),
        (False, "q{}_deg_s", "tau{}", "column 'q1_deg_s' is in deg/s, which is no unit of an angle"),
        (False, "q{} (W)", "tau{}", "column 'q1 (W)' is in W"),
        (False, "q{} [counts]", "tau{}", "column 'q1 [counts]' is in counts"),
        (False, "q{}", "tau{} [pdl.ft]", "column 'tau1 [pdl.ft]' is in pdl.ft, which import does not bring to SI; expected Nm"),
        (False, "q{}", "tau{} [N]", "column 'tau1 [N]' is in N, which is no unit of a torque"),
        (False, "q{}", "tau{} [MNm]", "column 'tau1 [MNm]' is in MNm"),
        (False, "q{}", "tau{} [%]", "column 'tau1 [%]' is in %, which import does not bring to SI"),
        (True, "q{} [deg]", "tau{}", "'q1 [deg]' is in deg, which is no unit of a length; expected m, mm, cm, for joint_1 slides"),
        (True, "q{}", "tau{} [Nm]", "column 'tau1 [Nm]' is in Nm, which is no unit of a force; expected N, kN"),
    ],
)  # fmt: skip
def test_a_unit_that_a_signal_cannot_have_is_refused(
    tmp_path: Path, sliding: bool, position: str, torque: str, message: str
) -> None:
    path = log(tmp_path / "run.csv", position, torque)
    with pytest.raises(ValueError) as caught:
        import_logs([path], SLIDING if sliding else AXES)
    assert str(caught.value).startswith(f"{path}: ") and message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_option_overrules_a_unit_that_is_not_known(tmp_path: Path) -> None:
    path = log(tmp_path / "run.csv", "q{} [furlong]", scales=(180 / np.pi, 1.0, 1.0))
    np.testing.assert_allclose(
        whole(import_logs([path], AXES, ReadingOptions(degrees=True)), "position"), Q, atol=1e-12
    )


def test_of_what_is_not_needed_a_foreign_unit_leaves_the_column_out(tmp_path: Path) -> None:
    imported = import_logs([log(tmp_path / "run.csv", velocity="qd{} [cm/s]")], AXES)
    assert imported.recordings[0].velocity is None
    assert "column 'qd1 [cm/s]': left out, for it is in cm/s" in said(imported)


@pytest.mark.parametrize(
    "aside", ["[{}]", "{} (actual)", "{} (raw)", "[A{}]", "(joint_{})", "{} [-]", "{} (link side)"]
)
def test_what_stands_in_brackets_and_is_no_unit_changes_nothing(tmp_path: Path, aside: str) -> None:
    torque = aside.replace("link", "motor")
    path = log(tmp_path / "run.csv", "q" + aside.replace("link", "motor"), "tau" + torque)
    np.testing.assert_allclose(whole(import_logs([path], AXES), "torque"), TAU)


@pytest.mark.parametrize(("unit", "size"), [("A", 1.0), ("mA", 1e-3)])
def test_torques_in_amperes_are_currents_where_there_are_no_others(tmp_path: Path, unit: str, size: float) -> None:
    path = log(tmp_path / "run.csv", torque=f"trq{{}} [{unit}]", scales=(1.0, 1.0 / size, 1.0))
    imported = import_logs([path], AXES)
    np.testing.assert_allclose(whole(imported, "motor_current"), TAU, rtol=1e-9)
    assert f"torques in {unit} are taken as currents (likely)" in said(imported) and "no torques, but currents" in said(
        imported
    )
    names = ["time", *numbered("q"), *(f"trq{k} [{unit}]" for k in (1, 2, 3)), *numbered("current")]
    table(names, TIME, Q, TAU, TAU).to_csv(path, index=False)
    with pytest.raises(ValueError, match=rf"column 'trq1 \[{unit}\]' is in {unit}, .*--columns motor_current=\.\.\."):
        import_logs([path], AXES)
    some = {"motor_current": tuple(numbered("current"))}
    np.testing.assert_allclose(whole(import_logs([path], AXES, ReadingOptions(some)), "motor_current"), TAU)


def test_motors_of_joints_that_slide_may_turn(tmp_path: Path) -> None:
    path = log(tmp_path / "run.csv", "q{} [deg]", "tau{} [Nm]", scales=(100 * 180 / np.pi, 1e-2, 1.0))
    imported = import_logs([path], SLIDING, ReadingOptions(gear=((100.0, 100.0, 100.0),)))
    np.testing.assert_allclose(whole(imported, "position"), Q, atol=1e-12)
    np.testing.assert_allclose(whole(imported, "torque"), TAU, rtol=1e-9)


def test_currents_in_ma_are_a_thousandth_with_brackets_and_without(tmp_path: Path) -> None:
    for name in ("i_mA_{}", "current{} [mA]"):
        path = log(tmp_path / "run.csv", torque=name, scales=(1.0, 1e3, 1.0))
        np.testing.assert_allclose(whole(import_logs([path], AXES), "motor_current"), TAU, rtol=1e-9)


# ---- which joint a number counts, and torque sensors -----------------------------------------------------------


def test_numbers_beside_joints_that_are_fewer_count_the_robot_s(tmp_path: Path) -> None:
    path = log(tmp_path / "run.csv", "J{} angle", "J{} torque")
    imported = import_logs([path], AXES, ReadingOptions(joints=JOINTS[::2]))
    np.testing.assert_allclose(whole(imported, "position"), Q[:, ::2])
    np.testing.assert_allclose(whole(imported, "torque"), TAU[:, ::2])
    assert "numbers are those of the robot's 3 joints" in said(imported) and "3 is joint_3" in said(imported)
    beside = ["tool_torque_3", "tcp_pos_3"]
    table(["time", "q1", "q2", "tau1", "tau2", *beside], TIME, Q[:, :2], TAU[:, :2], V[:, :2]).to_csv(path, index=False)
    two = import_logs([path], AXES, ReadingOptions(joints=JOINTS[1:]))
    np.testing.assert_allclose(whole(two, "position"), Q[:, :2])  # as many as are named: in their order
    assert two.recordings[0].joints == JOINTS[1:]


def test_numbers_that_fit_neither_those_joints_nor_the_robot_are_refused(tmp_path: Path) -> None:
    path = log(tmp_path / "run.csv", "J{} angle", "J{} torque")
    axes = replace(AXES, joints=(*JOINTS, "joint_4"), lower=(*AXES.lower, -3.0), upper=(*AXES.upper, 3.0))
    with pytest.raises(
        ValueError, match=r"run\.csv: columns are numbered 1, 2, 3, --joints names 2 of the robot's 4 joints"
    ):
        import_logs([path], axes, ReadingOptions(joints=("joint_1", "joint_4")))


@pytest.mark.parametrize("file_format", ["parquet", "csv"])
def test_torque_sensors_behind_the_gears_are_written_where_they_are_stated(tmp_path: Path, file_format: str) -> None:
    sensors = [f"A{k}_joint_torque [Nm]" for k in (1, 2, 3)]
    path = tmp_path / "run.csv"
    names = ["time", *(f"A{k}_{what}" for what in ("pos", "trq") for k in (1, 2, 3)), *sensors]
    table(names, TIME, Q, TAU, 1.1 * TAU).to_csv(path, index=False)
    with pytest.raises(ValueError, match=r"can both be torque of joint_1; .*--columns joint_torque=\.\.\."):
        import_logs([path], AXES)
    options = ReadingOptions({"joint_torque": tuple(sensors)})
    import_into(tmp_path / "data", [path], ROBOT, options, file_format)
    recordings = load_campaign(tmp_path / "data" / "campaign.toml").recordings
    for field, values in (("torque", TAU), ("joint_torque", 1.1 * TAU)):
        np.testing.assert_allclose(np.concatenate([getattr(r, field) for r in recordings]), values, rtol=1e-12)
    geared = import_logs([path], AXES, replace(options, gear=((2.0, 2.0, 2.0),)))
    np.testing.assert_allclose(whole(geared, "joint_torque"), 1.1 * TAU, rtol=1e-12)
    np.testing.assert_allclose(whole(geared, "torque"), 2.0 * TAU, rtol=1e-12)


def test_joint_torques_beside_those_of_motors_are_of_sensors(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    names = ["time", *numbered("q", "motor_torque_", "joint_torque_")]
    table(names, TIME, Q, TAU, 1.1 * TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    np.testing.assert_allclose(whole(imported, "torque"), TAU)
    np.testing.assert_allclose(whole(imported, "joint_torque"), 1.1 * TAU)
    table(names[:4] + names[7:], TIME, Q, TAU).to_csv(path, index=False)
    alone = import_logs([path], AXES)
    np.testing.assert_allclose(whole(alone, "torque"), TAU)
    assert alone.recordings[0].joint_torque is None
