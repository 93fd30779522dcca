"""Logs as loggers and spreadsheets write them: characters, comments, rows of units, dates with times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_importers import AXES, ROBOT, SAMPLES, TAU, TIME, Q, V, numbered, said, table, whole, write_bag

from rx90b_flex.identify.camera_command import read_markers
from rx90b_flex.importing import import_into
from rx90b_flex.path.measured import read_measured
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.signals.importers import Axes, ReadingOptions, import_logs
from rx90b_flex.signals.tables import read_table
from rx90b_flex.signals.units import unit_in_row, words_of
from rx90b_flex.simulate.command import read_trajectory

NAMES = ["t", *numbered("q", "tau")]


def written(path: Path, before: str = "", names: str = "", units: str = "", **changes: object) -> Path:
    """A log with lines before its names, and below them."""
    rows = table(NAMES, TIME, Q, TAU).assign(**changes).to_csv(index=False, header=False)
    path.write_text(before + (names or ",".join(NAMES)) + "\n" + units + rows)
    return path


def check(path: Path, atol: float = 1e-12) -> str:
    imported = import_logs([path], AXES)
    np.testing.assert_allclose(whole(imported, "position"), Q, rtol=0, atol=atol)
    np.testing.assert_allclose(whole(imported, "torque"), TAU, rtol=0, atol=100 * atol)
    assert imported.recordings[0].sample_rate_hz == 250.0
    return said(imported)


def test_a_file_that_is_no_utf_8_is_read_as_cp1252_and_it_says_so(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    names = [f"Achse{k}.{what}" for what in ("Istposition (°)", "Drehmoment (Nm)") for k in (1, 2, 3)]
    data = table(["Zeit (s)", *names], TIME, np.rad2deg(Q), TAU)
    data.to_csv(path, index=False, sep=";", decimal=",", encoding="latin-1")
    assert "no UTF-8: read as CP1252 (Latin-1) (likely)" in check(path)
    for encoding in ("utf-8", "utf-16"):
        data.to_csv(path, index=False, sep=";", decimal=",", encoding=encoding)
        assert "CP1252" not in check(path)


def test_bytes_that_are_no_text_are_told(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(b"time,q1,tau1\n\xff\x81\x00,1,2\n")
    with pytest.raises(ValueError, match=r"run\.csv: cannot be read: no text; line 2 holds byte 0xff"):
        import_logs([path], AXES)


@pytest.mark.parametrize(
    ("before", "names"),
    [
        ("# robot log\n# date 2026\n", ""),
        ("# robot log, 7 columns\n#\n", ""),
        ("# robot log\n", "# " + ",".join(NAMES)),
        ("#" + ",".join(NAMES) + "\n", "# s,rad,rad,rad,Nm,Nm,Nm"),
    ],
)
def test_comments_stand_above_the_names_or_hold_them(tmp_path: Path, before: str, names: str) -> None:
    check(written(tmp_path / "run.csv", before, names))


@pytest.mark.parametrize(
    ("units", "scales"),
    [
        ("s,rad,rad,rad,Nm,Nm,Nm", (1.0, 1.0, 1.0)),
        ("[ms],[deg],[deg],[deg],[kNm],[kNm],[kNm]", (1e3, 180 / np.pi, 1e-3)),
        ("ms,°,°,°,N·m,N.m,mNm", (1e3, 180 / np.pi, (1.0, 1.0, 1e3))),
        ("s,-,-,-,Nm,,", (1.0, 1.0, 1.0)),
    ],
)
def test_a_row_of_units_gives_the_units(tmp_path: Path, units: str, scales: tuple) -> None:
    time, angle, torque = scales
    path, rows = tmp_path / "run.csv", table(NAMES, time * TIME, angle * Q, TAU * torque)
    path.write_text(",".join(NAMES) + "\n" + units + "\n" + rows.to_csv(index=False, header=False))
    assert "a row of units below the names" in check(path)


def test_a_unit_of_something_else_is_refused_and_one_in_the_name_goes_first(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv", units="s,counts,rad,rad,Nm,Nm,Nm\n")
    with pytest.raises(ValueError, match=r"run\.csv: column 'q1': the unit below its name is 'counts'; expected rad"):
        import_logs([path], AXES)
    written(path, units="min,rad,rad,rad,Nm,Nm,Nm\n")
    with pytest.raises(ValueError, match=r"run\.csv: column 't': the unit below its name is 'min'; expected s, ms"):
        import_logs([path], AXES)
    names = ",".join(NAMES).replace("q1", "q1_rad")
    check(written(path, names=names, units="s,deg,rad,rad,Nm,Nm,Nm\n"))


def test_units_in_names_keep_their_capitals() -> None:
    assert words_of("tau1 [mNm]") == ["tau", "1", "mnm"] and words_of("jointTorque_kNm")[-1] == "knm"
    assert unit_in_row("torque", "mNm") == 1e-3 and unit_in_row("motor_velocity", "[rad/s]") == 1.0
    with pytest.raises(ValueError, match="expected rad"):
        unit_in_row("motor_velocity", "rad/s^2")


@pytest.mark.parametrize(
    "style", ["%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f+02:00"]
)
def test_dates_with_times_are_seconds_from_the_first(tmp_path: Path, style: str) -> None:
    stamps = pd.Timestamp("2026-03-02 23:59:59.5") + pd.to_timedelta(TIME, unit="s")
    assert "column 't': dates with times" in check(written(tmp_path / "run.csv", t=stamps.strftime(style)))


def test_dates_with_times_as_pandas_writes_its_index(tmp_path: Path) -> None:
    data = table(NAMES[1:], Q, TAU)
    data.index = pd.Timestamp("2026-01-02 03:04:05") + pd.to_timedelta(TIME, unit="s")
    data.to_csv(tmp_path / "run.csv")
    assert "column 'time': dates with times" in check(tmp_path / "run.csv")
    data.to_csv(tmp_path / "run.csv", sep=";", decimal=",")
    check(tmp_path / "run.csv")


def test_a_column_of_dates_is_the_time_whatever_its_name(tmp_path: Path) -> None:
    stamps = (pd.Timestamp("2026-03-02") + pd.to_timedelta(TIME, unit="s")).strftime("%Y-%m-%d %H:%M:%S.%f")
    check(written(tmp_path / "run.csv", names=",".join(["Datum", *NAMES[1:]]), t=stamps))


def test_a_date_that_is_none_is_told_with_its_row(tmp_path: Path) -> None:
    stamps = np.array(["2026-01-02T03:04:05.5"] * SAMPLES, dtype=object)
    stamps[2] = "2026-02-30 03:04:05"
    path = written(tmp_path / "run.csv", t=stamps)
    with pytest.raises(ValueError, match=r"run\.csv: column 't', row 3: '2026-02-30 03:04:05' is no date with time"):
        import_logs([path], AXES)


@pytest.mark.parametrize(("separator", "word"), [(";", "semicolons"), ("\t", "tabs")])
def test_tables_that_are_not_between_commas_are_told_alike(tmp_path: Path, separator: str, word: str) -> None:
    path, markers = tmp_path / "table.csv", tmp_path / "markers.toml"
    table(["time", "x", "y", "z"], TIME, Q).to_csv(path, index=False, sep=separator, decimal=",")
    markers.write_text('robot = "rx90b_3dof"\njoint = "joint_2"\nfile = "table.csv"\nstd_mm = [0.1, 0.1, 0.1]\n')
    robot = load_robot("rx90b_3dof")
    for read in (
        lambda: read_table(path, ["time"]),
        lambda: read_table(path, [], optional=["time"]),
        lambda: read_trajectory(path, robot, 250.0),
        lambda: read_measured(path),
        lambda: read_markers(markers),
    ):
        with pytest.raises(
            ValueError, match=rf"table\.csv: columns seem separated by {word}, commas are expected; save"
        ):
            read()


def test_currents_without_torques_make_a_campaign_whose_torque_constants_are_identified(tmp_path: Path) -> None:
    path = tmp_path / "rtde.csv"
    names = [f"{stem}_{k}" for stem in ("actual_q", "actual_current", "target_current") for k in range(3)]
    table(["timestamp", *names], TIME, Q, TAU, 0 * TAU).to_csv(path, index=False)
    imported = import_into(tmp_path / "data", [path], ROBOT, ReadingOptions())
    assert "no torques, but currents" in said(imported)
    campaign = load_campaign(tmp_path / "data" / "campaign.toml")
    assert campaign.torque_constants == (None, None, None)
    np.testing.assert_allclose(np.concatenate([r.motor_current for r in campaign.recordings]), TAU)
    for file in (tmp_path / "data").glob("*.parquet"):  # amperes are nowhere called torques
        assert pd.read_parquet(file).columns.tolist() == [
            "time",
            *(f"{s}_{j}" for s in ("q", "i") for j in AXES.joints),
        ]


@pytest.mark.parametrize("names", [["header.stamp.sec", "header.stamp.nanosec"], ["secs", "nsecs"]])
def test_a_stamp_in_two_columns_is_one_time(tmp_path: Path, names: list[str]) -> None:
    nanoseconds = 1_700_000_000_000_000_000 + np.round(1e9 * TIME).astype(np.int64)
    data = table(numbered("q", "tau"), Q, TAU)
    for name, part in zip(names, (nanoseconds // 10**9, nanoseconds % 10**9), strict=True):
        data[name] = part
    data.to_csv(tmp_path / "run.csv", index=False)
    text = check(tmp_path / "run.csv")
    assert f"columns '{names[0]}' and '{names[1]}', in s and ns" in text and "recorded on 2023-11-14" in text


DAY_S = 1_772_495_999.5  # 2026-03-02 23:59:59.5 UTC
ISO = pd.Timestamp(DAY_S, unit="s") + pd.to_timedelta(TIME, unit="s")


@pytest.mark.parametrize(
    ("name", "time", "day"),
    [
        ("time", DAY_S + TIME, "2026-03-02"),
        ("t_us", np.round(1e6 * (DAY_S + TIME)).astype(np.int64), "2026-03-02"),
        ("stamp", np.round(1e9 * (DAY_S + TIME)).astype(np.int64), "2026-03-02"),
        ("t", ISO.strftime("%Y-%m-%d %H:%M:%S.%f"), "2026-03-02"),
        ("t", ISO.strftime("%Y-%m-%dT%H:%M:%S.%fZ"), "2026-03-02"),
        ("t", ISO.strftime("%Y-%m-%dT%H:%M:%S.%f-02:00"), "2026-03-02"),  # the log's own day, not that of UTC
        ("Zeit", ISO.strftime("%d.%m.%Y %H:%M:%S.%f"), "2026-03-02"),
        ("t", (ISO - pd.Timedelta("1h")).strftime("%H:%M:%S.%f"), None),
        ("time", TIME, None),
        ("time", 1e6 + TIME, None),
        ("t_ms", 1e3 * (1e5 + TIME), None),
    ],
)
def test_the_day_that_a_log_tells_is_written(tmp_path: Path, name: str, time: object, day: str | None) -> None:
    data = table(NAMES[1:], Q, TAU)
    data.insert(0, name, time)
    data.to_csv(tmp_path / "run.csv", index=False)
    imported = import_into(tmp_path / "data", [tmp_path / "run.csv"], ROBOT, ReadingOptions())
    assert [r.date for r in load_campaign(tmp_path / "data" / "campaign.toml").recordings] == [day, day]
    assert (f"recorded on {day}" in said(imported)) == ("recorded on" in said(imported)) == (day is not None)


def test_the_day_is_that_of_the_rows_that_are_used(tmp_path: Path) -> None:
    later = np.where(np.arange(SAMPLES) < 20, 0.0, 86400.0)
    data = table(["time", *NAMES[1:]], DAY_S + TIME + later, Q, TAU)
    data.to_csv(tmp_path / "run.csv", index=False, float_format="%.4f")
    imported = import_logs([tmp_path / "run.csv"], AXES)
    assert {r.date for r in imported.recordings} == {"2026-03-03"}


def test_dates_beside_a_time_from_zero_tell_the_day(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table(NAMES, TIME, Q, TAU).assign(Datum=ISO.strftime("%Y-%m-%d %H:%M:%S.%f")).to_csv(path, index=False)
    assert {r.date for r in import_logs([path], AXES).recordings} == {"2026-03-02"}


def test_tables_of_time_stamps_and_bags_tell_their_day(tmp_path: Path) -> None:
    data = table(NAMES[1:], Q, TAU)
    data.insert(0, "stamp", ISO)
    data.to_parquet(tmp_path / "run.parquet")
    assert {r.date for r in import_logs([tmp_path / "run.parquet"], AXES).recordings} == {"2026-03-02"}
    for stamped in (True, False):  # by the headers, by the recorder
        bag = write_bag(tmp_path / f"bag_{stamped}", "SQLITE3", stamped=stamped)
        assert {r.date for r in import_logs([bag], AXES).recordings} == {"2023-11-14"}


def test_columns_of_rostopic_belong_to_the_joints_that_it_names(tmp_path: Path) -> None:
    order = [2, 0, 1]
    names = [f"field.{what}{k}" for what in ("position", "effort") for k in range(3)]
    data = table(["%time", *names], np.round(1e9 * TIME), Q[:, order], TAU[:, order])
    for k, joint in enumerate(order):
        data[f"field.name{k}"] = f"joint_{joint + 1}"
    data.to_csv(tmp_path / "run.csv", index=False)
    check(tmp_path / "run.csv")


@pytest.mark.parametrize("position", ["AxisAct.A{} [deg]", "J{} Ang(deg)", "AIPos.A{} [deg]"])
def test_names_of_controllers_are_understood(tmp_path: Path, position: str) -> None:
    names = [position.format(k) for k in (1, 2, 3)] + [f"JTRQ{k}" for k in (1, 2, 3)]
    table(["time", *names], TIME, np.rad2deg(Q), TAU).to_csv(tmp_path / "run.csv", index=False)
    check(tmp_path / "run.csv")


@pytest.mark.parametrize(
    ("time", "position", "torque"),
    [
        ("Zeit", "Istposition_A{}", "Motormoment_A{}"),
        ("Zeitstempel [s]", "Drehwinkel_J{} [rad]", "Drehmoment_J{}_Nm"),
        ("Temps (s)", "Position axe {} (rad)", "Couple axe {} (N.m)"),
        ("Time", "$AXIS_ACT_MEAS.A{}", "$TORQUE_AXIS_ACT[{}]"),
        ("t [s]", "q{} [rad]", "M{} [Nm]"),
    ],
)  # fmt: skip
def test_names_of_other_tongues_and_units_are_understood(tmp_path: Path, time: str, position: str, torque: str) -> None:
    names = [time, *(name.format(k) for name in (position, torque) for k in (1, 2, 3))]
    check(written(tmp_path / "run.csv", names=",".join(f'"{n}"' for n in names)))


def test_columns_that_count_from_zero_are_not_those_of_a_joint_that_is_called_1(tmp_path: Path) -> None:
    axes = Axes(("j1", "j2", "j3"), AXES.lower, AXES.upper)
    names = ["time", *(f"{stem}[{k}]" for stem in ("q", "tau_J") for k in range(3))]
    imported = import_logs([written(tmp_path / "run.csv", names=",".join(names))], axes)
    np.testing.assert_allclose(whole(imported, "position"), Q, atol=1e-12)
    np.testing.assert_allclose(whole(imported, "torque"), TAU, atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "scale"),
    [("U/min", 30 / np.pi), ("1/min", 30 / np.pi), ("rpm", 30 / np.pi), ("deg/min", 60 * 180 / np.pi)],
)
def test_speeds_by_the_minute_are_brought_to_the_second(tmp_path: Path, unit: str, scale: float) -> None:
    path = tmp_path / "run.csv"
    speed = [f"speed {k} [{unit}]" for k in (1, 2, 3)]
    table([*NAMES, *speed], TIME, Q, TAU, scale * V).to_csv(path, index=False)
    np.testing.assert_allclose(whole(import_logs([path], AXES), "velocity"), V, atol=1e-9)


def test_currents_and_slides_are_known_by_their_units(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    names = ["time", "J1 [deg]", "J2 [deg]", "J3 [mm]", "T1 [Nm]", "T2 [Nm]", "F3 [N]", "I1 [A]", "I2 [A]", "I3 [A]"]
    position = Q * [180 / np.pi, 180 / np.pi, 1e3]
    table(names, TIME, position, TAU, 0.1 * TAU).to_csv(path, index=False)
    axes = Axes(AXES.joints, AXES.lower, AXES.upper, (False, False, True))
    imported = import_logs([path], axes)
    for field, expected in (("position", Q), ("torque", TAU)):
        np.testing.assert_allclose(whole(imported, field), expected, atol=1e-9)
    table([*names[:4], *names[7:]], TIME, position, 0.1 * TAU).to_csv(path, index=False)
    assert "no torques, but currents" in said(import_logs([path], axes))


def test_the_separator_that_excel_is_told_is_no_row(tmp_path: Path) -> None:
    check(written(tmp_path / "run.csv", before="sep=,\n"))


@pytest.mark.parametrize("style", ["%d.%m.%Y %H:%M:%S.%f", "%H:%M:%S.%f"])
def test_german_dates_and_times_of_day_are_seconds_from_the_first(tmp_path: Path, style: str) -> None:
    stamps = pd.Timestamp("2026-03-02 10:11:12") + pd.to_timedelta(TIME, unit="s")
    check(written(tmp_path / "run.csv", t=stamps.strftime(style)))


def test_columns_of_a_joint_that_is_not_there_are_told(tmp_path: Path) -> None:
    names = ["t", *(f"{what}{k}" for what in ("q", "tau") for k in (1, 2, 3, 4))]
    path = tmp_path / "run.csv"
    table(names, TIME, np.c_[Q, Q[:, 0]], np.c_[TAU, TAU[:, 0]]).to_csv(path, index=False)
    assert "left out, for joints are counted to 3: q4, tau4" in check(path)


@pytest.mark.parametrize("asked", [False, True])
def test_of_currents_and_torques_one_is_used_and_the_other_told(tmp_path: Path, asked: bool) -> None:
    names = ["t", *numbered("q", "tau", "current")]
    path = tmp_path / "run.csv"
    table(names, TIME, Q, TAU, 2.0 * TAU).to_csv(path, index=False)
    options = ReadingOptions(columns={"motor_current": numbered("current")} if asked else {})
    imported = import_logs([path], AXES, options)
    np.testing.assert_allclose(whole(imported, "torque"), 2.0 * TAU if asked else TAU)
    left, used, of = ("torque", "currents", "tau") if asked else ("motor_current", "torques", "current")
    assert f"{left}: left out, for {used} are used: {', '.join(numbered(of))}" in said(imported)
    assert ("--columns motor_current=..." in said(imported)) == (not asked)


@pytest.mark.parametrize(
    ("before", "count"),
    [
        ("Robot: KR10\nProgram: test.src\n\nChannels: 13\n", 3),
        ("Robot,KR10\nProgram,test.src\n", 2),
        ("trace file\nRobot: KR10, R1100\nSample time: 4 ms\n", 3),
        ("Robot,KR10,,,,,\nProgram,test.src,,,,,\n", 2),
    ],
)
@pytest.mark.parametrize("units", ["", "s,rad,rad,rad,Nm,Nm,Nm\n"])
def test_lines_above_the_names_are_left_out_and_told(tmp_path: Path, before: str, count: int, units: str) -> None:
    for change in (str, lambda text: text.replace(",", ";")):
        path = written(tmp_path / "run.csv", before, units=units)
        path.write_text(change(path.read_text()))
        assert f"{count} lines before the header left out (likely)" in check(path)


def test_rows_above_the_names_are_not_lost_without_a_word(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv", before="0,1,2,3,4,5,6\n")
    with pytest.raises(ValueError, match="the first line holds numbers"):
        import_logs([path], AXES)
    path.write_text("a,b\nc,d\n" + ",".join(NAMES) + "\n" + "0,1,2,3,4,5,6,7\n" * 20)
    with pytest.raises(
        ValueError, match="the line of column names was not found: put # before lines that stand above it"
    ):
        import_logs([path], AXES)


@pytest.mark.parametrize("end", [",,,\n", ",,,,,,\n,,,,,,\n", ",\n"])
def test_empty_rows_at_the_end_are_left_out(tmp_path: Path, end: str) -> None:
    path = written(tmp_path / "run.csv")
    path.write_text(path.read_text() + end)
    assert f"{end.count(chr(10))} empty rows at the end left out" in check(path)


def test_empty_cells_beyond_the_last_column_are_left_out(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv")
    names, *rows = path.read_text().splitlines()
    path.write_text("\n".join([names, *(row + "," for row in rows)]))
    assert f"empty cells beyond the last column left out, in {SAMPLES} rows" in check(path)
    path.write_text("\n".join([names + ",,", *rows]))
    check(path)
    path.write_text("\n".join([names, *rows, "1,2,3"]))
    with pytest.raises(ValueError, match=f"row {SAMPLES + 1} has 3 cells, the header has 7"):
        import_logs([path], AXES)


@pytest.mark.parametrize("name", ["Status", "tau1", "t"])
def test_a_name_that_is_there_twice_is_refused_only_where_it_can_be_used(tmp_path: Path, name: str) -> None:
    path = written(tmp_path / "run.csv")
    first, *rows = path.read_text().splitlines()
    twice = name if name in NAMES else f"{name},{name}"
    path.write_text("\n".join([f"{first},{twice}", *(f"{row},1" + (",2" if name == "Status" else "") for row in rows)]))
    if name == "Status":
        assert "column 'Status': left out, for it is there 2 times" in check(path)
        with pytest.raises(ValueError, match="column 'Status' is there 2 times"):
            import_logs([path], AXES, ReadingOptions({"motor_velocity": ("Status", "q2", "q3")}))
        return
    with pytest.raises(ValueError, match=rf"run\.csv: column '{name}' is there 2 times"):
        import_logs([path], AXES)


def test_a_file_for_each_joint_is_to_be_put_into_one_table(tmp_path: Path) -> None:
    path, some = tmp_path / "joint_1.csv", ReadingOptions(joints=AXES.joints[1:])
    table(["time", "position", "effort"], TIME, Q[:, :1], TAU[:, :1]).to_csv(path, index=False)
    told = r"column 'position' can be motor_position, but of which joint of joint_2, joint_3\? .* one table, .*position_joint_2"
    with pytest.raises(ValueError, match=told):
        import_logs([path], AXES, some)
    assert import_logs([path], AXES, ReadingOptions(joints=("joint_2",))).recordings[0].joints == ("joint_2",)
    table(["time", "alpha", "effort"], TIME, Q[:, :1], TAU[:, :1]).to_csv(path, index=False)
    with pytest.raises(ValueError, match=r"no column can be motor_position.*\(one a joint of joint_2, joint_3\)"):
        import_logs([path], AXES, some)


@pytest.mark.parametrize(("seconds", "needs"), [(3.5, True), (8.4, False)])
def test_a_short_log_says_how_long_it_should_be(tmp_path: Path, seconds: float, needs: bool) -> None:
    time = np.arange(round(seconds / 0.7 * 250.0)) / 250.0
    rows = np.resize(np.column_stack([Q, TAU]), (len(time), 6))
    table(NAMES, time, rows).to_csv(tmp_path / "run.csv", index=False)
    text = said(import_logs([tmp_path / "run.csv"], AXES))
    assert f"only {seconds:g} s are for identification, so parameters will be uncertain: record more than 10 s" in text
    assert ("close-loop needs 4 s at least" in text) == needs


def test_a_log_that_begins_anew_says_what_to_do(tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv", t=np.r_[TIME[:300], TIME[: SAMPLES - 300]])
    with pytest.raises(
        ValueError, match=r"row 301: time runs backwards.*; cut the file there into two logs, and import both"
    ):
        import_logs([path], AXES)
