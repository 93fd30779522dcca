from __future__ import annotations

import dataclasses
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from data_folder import tx40_folder
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rx90b_flex.signals import Campaign, Recording, load_campaign, save_recording, write_campaign

Array = NDArray[np.float64]
Write = Callable[..., Path]

CAMPAIGN = """
robot = "two.toml"
sample_rate_hz = 100.0
joints = ["a", "b"]
[signals]
motor_position = ["q1", "q2"]
torque = ["t1", "t2"]
[[recording]]
file = "run.csv"
role = "identification"
"""
HEADER = "time,q1,q2,t1,t2"


def rows(count: int = 50, rate: float = 100.0, time_format: str = ".9g") -> list[str]:
    t = np.arange(count) / rate
    return [f"{x:{time_format}},{np.sin(x)},{np.cos(x)},{2 * x},{-x}" for x in t]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a campaign file and a data file, and returns the campaign file's path."""

    def write_files(campaign: str = CAMPAIGN, data: list[str] | None = None, header: str = HEADER) -> Path:
        (tmp_path / "run.csv").write_text("\n".join([header, *(rows() if data is None else data)]) + "\n")
        path = tmp_path / "campaign.toml"
        path.write_text(campaign)
        return path

    return write_files


def message(path: Path) -> str:
    """The one line that a campaign is refused with; it names the campaign file."""
    with pytest.raises(ValueError) as caught:
        load_campaign(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text


def recording(**changes: object) -> Recording:
    rng = np.random.default_rng(1)
    made = Recording(
        name="run",
        role="identification",
        time=np.arange(200) / 500.0,
        sample_rate_hz=500.0,
        joints=("joint_1", "joint_2"),
        position=rng.normal(size=(200, 2)),
        torque=100.0 * rng.normal(size=(200, 2)),
    )
    return dataclasses.replace(made, **changes)  # type: ignore[arg-type]


def signals_of(item: Recording) -> dict[str, Array | None]:
    names = ["time", "position", "torque", "velocity", "link_position"]
    names += ["reference_position", "reference_velocity", "feedforward_torque"]
    return {name: getattr(item, name) for name in names}


def assert_same(found: Recording, expected: Recording) -> None:
    for name, value in signals_of(expected).items():
        other = getattr(found, name)
        if value is None:
            assert other is None
        else:
            np.testing.assert_array_equal(other, value)
    for name in ("name", "role", "sample_rate_hz", "joints", "period_s"):
        assert getattr(found, name) == getattr(expected, name)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_columns_become_joint_signals_in_the_order_of_the_joints(write: Write) -> None:
    run = load_campaign(write()).recordings[0]
    t = np.arange(50) / 100.0
    np.testing.assert_allclose(run.time, t)
    np.testing.assert_allclose(run.position, np.column_stack([np.sin(t), np.cos(t)]))
    np.testing.assert_allclose(run.torque, np.column_stack([2 * t, -t]))
    assert (run.name, run.role, run.joints) == ("run", "identification", ("a", "b"))
    assert (run.samples, run.duration_s, run.velocity, run.period_s) == (50, 0.5, None, None)


def test_time_comes_from_the_sample_rate_where_the_file_has_none(write: Write) -> None:
    path = write(data=[row.split(",", 1)[1] for row in rows()], header=HEADER.split(",", 1)[1])
    np.testing.assert_array_equal(load_campaign(path).recordings[0].time, np.arange(50) / 100.0)


def test_columns_that_are_not_asked_for_may_hold_anything(write: Write) -> None:
    path = write(data=[f"{row},text,,nan" for row in rows()], header=f"{HEADER},note,x,x")
    assert load_campaign(path).recordings[0].samples == 50


def test_blanks_about_names_and_numbers_and_a_byte_order_mark_do_no_harm(write: Write) -> None:
    path = write(data=[row.replace(",", " , ") for row in rows()], header="\ufeff" + HEADER.replace(",", " , "))
    np.testing.assert_allclose(load_campaign(path).recordings[0].time, np.arange(50) / 100.0)


@pytest.mark.parametrize("extension", ["csv.gz", "parquet"])
def test_compressed_and_parquet_files_hold_the_same_as_csv(write: Write, tmp_path: Path, extension: str) -> None:
    plain = load_campaign(write()).recordings[0]
    if extension == "csv.gz":
        (tmp_path / "run.csv.gz").write_bytes(gzip.compress((tmp_path / "run.csv").read_bytes()))
    else:
        values = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)
        pyarrow.parquet.write_table(pa.table(list(values.T), names=HEADER.split(",")), tmp_path / "run.parquet")
    assert_same(load_campaign(write(CAMPAIGN.replace("run.csv", f"run.{extension}"))).recordings[0], plain)


def test_robot_is_a_path_where_it_is_a_file_beside_the_campaign_and_else_a_name(write: Write, tmp_path: Path) -> None:
    path = write()
    assert load_campaign(path).robot_source == "two.toml"
    (tmp_path / "two.toml").write_text("")
    assert load_campaign(path).robot_source == tmp_path / "two.toml"
    assert load_campaign(write(CAMPAIGN.replace("two.toml", "example-robot-data:ur10"))).robot_source == (
        "example-robot-data:ur10"
    )


def test_stated_cutoff_noise_and_period_are_handed_on(write: Write) -> None:
    more = "[preprocessing]\ncutoff_hz = 20\n[noise]\ntorque_rms = [0.1, 0]\n[[recording]]"
    campaign = load_campaign(write(CAMPAIGN.replace("[[recording]]", more) + "period_s = 0.2\n"))
    assert (campaign.cutoff_hz, campaign.noise_torque) == (20.0, (0.1, 0.0))
    assert campaign.recordings[0].period_samples == 20


def test_start_and_end_take_a_half_open_part_by_the_files_own_time(write: Write) -> None:
    data = [f"{10 + k / 100:.2f},{k},0,0,0" for k in range(50)]
    parts = 'start_s = 10.1\nend_s = 10.3\n[[recording]]\nfile = "run.csv"\nrole = "validation"\nstart_s = 10.3\n'
    campaign = load_campaign(write(CAMPAIGN + parts, data))
    np.testing.assert_array_equal(campaign.identification[0].position[:, 0], np.arange(10, 30))
    np.testing.assert_array_equal(campaign.validation[0].position[:, 0], np.arange(30, 50))


def test_a_bad_row_outside_the_part_asked_for_does_not_matter(write: Write) -> None:
    data = rows()
    data[40] = "0.4,nan,0,0,0"
    assert load_campaign(write(CAMPAIGN + "end_s = 0.4\n", data)).recordings[0].samples == 40


def test_names_are_unique_within_a_role(write: Write) -> None:
    def entry(role: str) -> str:
        return f'[[recording]]\nfile = "run.csv"\nrole = "{role}"\n'

    more = entry("validation") + entry("identification") + entry("validation") + entry("identification")
    names = [(item.role[0], item.name) for item in load_campaign(write(CAMPAIGN + more)).recordings]
    assert names == [("i", "run"), ("v", "run"), ("i", "run_2"), ("v", "run_2"), ("i", "run_3")]


def test_a_file_used_twice_is_read_once(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    from rx90b_flex.signals import tables

    read, asked = tables.read_table, []

    def counting(path: Path, *arguments: object, **named: object) -> tables.Table:
        asked.append(path)
        return read(path, *arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(tables, "read_table", counting)
    load_campaign(write(CAMPAIGN + '[[recording]]\nfile = "run.csv"\nrole = "validation"\n'))
    assert len(asked) == 1


# --- motor side ------------------------------------------------------------------------------------------------------

MOTOR = "[motor]\ngear_matrix = [[50.0, 0.0], [30.0, -40.0]]\noffset = [0.5, -1.0]\n[[recording]]"
OPTIONAL = """
motor_velocity = ["v1", "v2"]
link_position = ["l1", "l2"]
reference_position = ["rq1", "rq2"]
reference_velocity = ["rv1", "rv2"]
feedforward_torque = ["f1", "f2"]
[[recording]]"""


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_motor_side_signals_come_back_on_the_joint_side(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gear, offset = np.array([[50.0, 0.0], [30.0, -40.0]]), np.array([0.5, -1.0])
    joint = {key: rng.normal(size=(30, 2)) for key in ("q", "t", "v", "l", "rq", "rv", "f")}
    columns: list[Array] = []
    for key, value in joint.items():
        for sample in value:
            if key in ("q", "rq"):
                columns.append(gear @ (sample - offset))
            elif key in ("v", "rv"):
                columns.append(gear @ sample)
            elif key in ("t", "f"):
                columns.append(np.linalg.solve(gear.T, sample))
            else:
                columns.append(sample)
    values = np.concatenate(np.array(columns).reshape(len(joint), 30, 2), axis=1)
    names = [f"{key}{index}" for key in joint for index in (1, 2)]
    folder = tmp_path_factory.mktemp("motor")
    pyarrow.parquet.write_table(pa.table(list(values.T), names=names), folder / "run.parquet")
    text = CAMPAIGN.replace("run.csv", "run.parquet").replace("[[recording]]", OPTIONAL)
    (folder / "campaign.toml").write_text(text.replace("[[recording]]", MOTOR))
    run = load_campaign(folder / "campaign.toml").recordings[0]
    # rounding times the gear's condition number, 2.5
    for key, found in (("q", run.position), ("t", run.torque), ("v", run.velocity), ("l", run.link_position)):
        np.testing.assert_allclose(found, joint[key], atol=1e-13)
    for key, found in (("rq", run.reference_position), ("rv", run.reference_velocity), ("f", run.feedforward_torque)):
        np.testing.assert_allclose(found, joint[key], atol=1e-13)


def test_power_is_the_same_on_both_sides_of_the_gears(write: Write) -> None:
    text = CAMPAIGN.replace("[[recording]]", 'motor_velocity = ["q1", "q2"]\n' + MOTOR)
    text = text.replace('motor_position = ["q1", "q2"]', 'motor_position = ["p1", "p2"]')
    run = load_campaign(write(text, [f"{row},0,0" for row in rows()], f"{HEADER},p1,p2")).recordings[0]
    t = np.arange(50) / 100.0
    assert run.velocity is not None
    motor_power = 2 * t * np.sin(t) - t * np.cos(t)
    np.testing.assert_allclose(np.sum(run.torque * run.velocity, axis=1), motor_power, atol=1e-14)


def test_a_motor_table_without_offset_has_none(write: Write) -> None:
    text = CAMPAIGN.replace("[[recording]]", "[motor]\ngear_matrix = [[2.0, 0.0], [0.0, 4.0]]\n[[recording]]")
    run = load_campaign(write(text)).recordings[0]
    t = np.arange(50) / 100.0
    np.testing.assert_allclose(run.position, np.column_stack([np.sin(t) / 2, np.cos(t) / 4]))
    np.testing.assert_allclose(run.torque, np.column_stack([4 * t, -4 * t]))


# --- what is refused in the campaign file ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("robot =", "robots =", "'robots': unknown key (did you mean 'robot'?); allowed here: robot, sample_rate_hz"),
        ("torque =", "torques =", "[signals] 'torques': unknown key (did you mean 'torque' or 'joint_torque'?)"),
        ("role =", "start = 1\nrole =", "[[recording]] 1 'start': unknown key (did you mean 'start_s'?)"),
        ("[[recording]]", "[preprocessing]\ncutoff = 3\n[[recording]]", "[preprocessing] 'cutoff': unknown key"),
        ("[[recording]]", "[motor]\noffset = [0.0, 0.0]\n[[recording]]", "[motor] gear_matrix: missing"),
        ('robot = "two.toml"', "", "robot: missing"),
        ("sample_rate_hz = 100.0", "", "sample_rate_hz: missing"),
        ("sample_rate_hz = 100.0", 'sample_rate_hz = "100"', "sample_rate_hz: found '100', a finite number"),
        ("sample_rate_hz = 100.0", "sample_rate_hz = true", "sample_rate_hz: found True, a finite number"),
        ("sample_rate_hz = 100.0", "sample_rate_hz = 0", "sample_rate_hz: found 0, a number above 0"),
        ("sample_rate_hz = 100.0", "sample_rate_hz = nan", "sample_rate_hz: found nan, a finite number"),
        ('["a", "b"]', '["a", "a"]', "joints: 'a' is listed 2 times"),
        ('["a", "b"]', '"a"', "joints: found 'a', a list of texts"),
        ('["q1", "q2"]', '["q1"]', "[signals] motor_position: lists 1 columns, joints lists 2"),
        ('["q1", "q2"]', '["q1", "t1"]', "[signals] torque: column 't1' is already used by motor_position"),
        ('["q1", "q2"]', '["q1_deg", "q2_deg"]', "[signals] motor_position: column 'q1_deg' seems to be in deg; SI"),
        ('["q1", "q2"]', '["q1 [RPM]", "q2"]', "column 'q1 [RPM]' seems to be in RPM"),
        ('["t1", "t2"]', '["t1_Nmm", "t2_Nmm"]', "[signals] torque: column 't1_Nmm' seems to be in Nmm"),
        ('["t1", "t2"]', '["i1_mA", "i2_mA"]', "[signals] torque: column 'i1_mA' seems to be in mA"),
        ('"identification"', '"identify"', "[[recording]] 1 role: found 'identify' (did you mean 'identification'?)"),
        ('"identification"', '"validation"', "recording: none has role"),
        ('"run.csv"', '"run.xlsx"', "run.xlsx: unknown kind of file; expected .csv, .csv.gz, .parquet"),
        ('"run.csv"', '"other.csv"', "other.csv: no such file"),
        ("[[recording]]", "[recording]", "recording: found {'file': 'run.csv', 'role': 'identification'}, tables"),
        ("[[recording]]", "[motor]\ngear_matrix = [[1.0]]\n[[recording]]", "gear_matrix: has 1 rows of 1 numbers"),
        ("[[recording]]", "[motor]\ngear_matrix = [[1, 2], [2, 4]]\n[[recording]]", "gear_matrix: is singular"),
        ("[[recording]]", "[motor]\ngear_matrix = [[1, 0], [0, 0]]\n[[recording]]", "gear_matrix: is singular"),
        (
            "[[recording]]",
            "[motor]\ngear_matrix = [[1, 0], [0, 1]]\noffset = [1]\n[[recording]]",
            "[motor] offset: lists 1 values, joints lists 2",
        ),
        (
            "[[recording]]",
            "[preprocessing]\ncutoff_hz = 50\n[[recording]]",
            "[preprocessing] cutoff_hz: found 50, below half of sample_rate_hz (50)",
        ),
        ("[[recording]]", "[noise]\ntorque_rms = [-1, 0]\n[[recording]]", "[noise] torque_rms: found -1"),
        ("robot =", "robot ==", "not a TOML file"),
    ],
)
def test_a_wrong_key_or_value_is_named(write: Write, old: str, new: str, expected: str) -> None:
    assert old in CAMPAIGN
    assert expected in message(write(CAMPAIGN.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("start_s = 0.3\nend_s = 0.3", "[[recording]] 1 end_s: found 0.3, more than start_s = 0.3"),
        ("start_s = 5", "start_s: 5 s is outside the file's 0 ... 0.49 s"),
        ("end_s = 0.6", "end_s: 0.6 s is outside"),
        ("start_s = -1", "start_s: -1 s is outside"),
        ("start_s = 0.49", "1 data row(s) in the part that [[recording]] 1 asks for"),
        ("period_s = 0.205", "[[recording]] 1 period_s: 0.205 is 20.5 sample periods at 100 Hz"),
        ("period_s = 0.6", "period_s: 0.6 is 60 samples, more than the recording's 50"),
        ("period_s = -1", "period_s: found -1, a number above 0"),
    ],
)
def test_a_part_or_period_that_cannot_be_is_named(write: Write, more: str, expected: str) -> None:
    assert expected in message(write(CAMPAIGN + more + "\n"))


@pytest.mark.parametrize("content", [None, b"\xff\xfe\x00x"])
def test_a_campaign_file_that_is_missing_or_no_text_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "campaign.toml"
    if content is not None:
        path.write_bytes(content)
    assert ("no such file" if content is None else "cannot be read") in message(path)


# --- what is refused in the data -------------------------------------------------------------------------------------


def replaced(row: int, text: str) -> list[str]:
    data = rows()
    data[row - 1] = text
    return data


@pytest.mark.parametrize(
    ("header", "data", "expected"),
    [
        ("time,q1,q2,t1,T_2", rows(), "run.csv: no column 't2' (did you mean 'T_2'"),
        ("time,alpha,q2,t1,t2", rows(), "no column 'q1'"),
        ("time,q1,q1,t1,t2", rows(), "column 'q1' is there 2 times"),
        (HEADER, [], "a header but no data rows"),
        (rows()[3], rows(), "the first line holds numbers, a line of column names is expected"),
        (HEADER.replace(",", ";"), rows(), "columns seem separated by semicolons"),
        (HEADER, replaced(7, "0.06,1,off,0,0"), "run.csv: column 'q2', row 7: 'off' is not a number"),
        (HEADER, replaced(7, "0.06,1,true,0,0"), "column 'q2', row 7: 'true' is not a number"),
        (HEADER, replaced(7, "0.06,1,,0,0"), "column 'q2', row 7: missing or NaN (1 such row in this column)"),
        (HEADER, replaced(7, "0.06,1,0,0,-inf"), "column 't2', row 7: -inf (1 such row"),
        (HEADER, [f"{k / 100},nan,1,1,1" for k in range(9)], "column 'q1', row 1: missing or NaN (9 such rows"),
        (HEADER, replaced(7, "nan,1,0,0,0"), "column 'time', row 7: missing or NaN"),
        (HEADER, replaced(7, "0.06,1,0,0"), "data row 7 has 4 cells, the header has 5"),
        (HEADER, replaced(7, "0.06,200.0,0,0,0"), "column 'q1': motor_position of 'a' reaches 200 rad"),
    ],
)
def test_bad_data_is_named_with_column_and_row(write: Write, header: str, data: list[str], expected: str) -> None:
    assert expected in message(write(header=header, data=data))


def test_an_angle_too_large_is_put_down_to_degrees_or_a_missing_gear_matrix(write: Write) -> None:
    text = message(write(data=replaced(7, "0.06,200.0,0,0,0")))
    assert "probably degrees, or motor side without a [motor] gear_matrix" in text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.csv", b""),
        ("run.csv.gz", b"no gzip"),
        ("run.csv.gz", gzip.compress(b"x" * 99, mtime=0)[:-9]),
        ("run.parquet", b"x"),
    ],
)
def test_an_empty_or_broken_file_is_named(write: Write, tmp_path: Path, name: str, content: bytes) -> None:
    path = write(CAMPAIGN.replace("run.csv", name))
    (tmp_path / name).write_bytes(content)
    assert str(tmp_path / name) in message(path)


def test_bytes_that_are_no_text_are_named(write: Write, tmp_path: Path) -> None:
    path = write()
    (tmp_path / "run.csv").write_bytes(b"\xff\xfe\x00")
    assert "run.csv: cannot be read" in message(path)


# --- time ------------------------------------------------------------------------------------------------------------


def test_shuffled_rows_are_refused(write: Write) -> None:
    data = rows()
    data[10], data[11] = data[11], data[10]
    assert "column 'time', row 12: 0.1 s after 0.11 s; increasing times are expected" in message(write(data=data))


def test_a_repeated_time_is_refused(write: Write) -> None:
    assert "column 'time', row 7: 0.05 s after 0.05 s" in message(write(data=replaced(7, "0.05,0,0,0,0")))


@pytest.mark.parametrize(("rate", "time_format"), [(100.0, ".9g"), (100.0, ".2f"), (1000.0, ".3f"), (3000.0, ".3f")])
def test_a_lost_sample_is_refused_however_time_is_printed(write: Write, rate: float, time_format: str) -> None:
    data = rows(300, rate, time_format)
    del data[200]
    text = message(write(CAMPAIGN.replace("100.0", str(rate)), data))
    assert "column 'time', row 20" in text
    assert f"{1 / rate:.6g} s is expected" in text


def test_a_step_off_by_more_than_one_percent_is_refused(write: Write) -> None:
    assert "column 'time', row 7: a step of 0.01015 s, 0.01 s" in message(write(data=replaced(7, "0.06015,0,0,0,0")))
    load_campaign(write(data=replaced(7, "0.06005,0,0,0,0")))


@pytest.mark.parametrize(("rate", "found"), [(200.0, "200 Hz"), (99.5, "99.5"), (1.0, "1 Hz")])
def test_time_that_contradicts_the_sample_rate_is_refused(write: Write, rate: float, found: str) -> None:
    text = message(write(data=rows(400, rate)))
    assert "contradict" in text
    assert "sample_rate_hz = 100" in text
    assert found in text


@pytest.mark.parametrize("start", [0.0, 7.3, 1234.0])
@pytest.mark.parametrize(
    ("rate", "time_format"),
    [
        (5000.0, ".4f"),
        (3000.0, ".6f"),
        (3000.0, ".4f"),
        (3000.0, ".3f"),
        (1000.0, ".3f"),
        (1000.0, ".7g"),
        (250.0, ".6g"),
    ],
)
def test_times_rounded_by_their_print_are_accepted(write: Write, start: float, rate: float, time_format: str) -> None:
    data = [f"{start + k / rate:{time_format}},0,0,0,0" for k in range(4000)]
    run = load_campaign(write(CAMPAIGN.replace("100.0", str(rate)), data)).recordings[0]
    assert run.samples == 4000


@pytest.mark.parametrize("as_text", [False, True])
def test_times_kept_in_single_precision_are_accepted(write: Write, tmp_path: Path, as_text: bool) -> None:
    time = (300.0 + np.arange(3000) / 1000.0).astype(np.float32)  # spacing 3 % of the sample period
    text = CAMPAIGN.replace("100.0", "1000.0")
    if as_text:
        path = write(text, [f"{t},0,0,0,0" for t in time])
    else:
        table = pa.table([time, *np.zeros((4, len(time)))], names=HEADER.split(","))
        pyarrow.parquet.write_table(table, tmp_path / "run.parquet")
        path = write(text.replace("run.csv", "run.parquet"))
    assert load_campaign(path).recordings[0].samples == 3000


# --- writing ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file_format", ["parquet", "csv", "csv.gz"])
def test_a_written_campaign_reads_back_the_same(tmp_path: Path, file_format: str) -> None:
    rng = np.random.default_rng(2)
    extra = {
        name: rng.normal(size=(200, 2))
        for name in ("velocity", "link_position", "reference_position", "reference_velocity", "feedforward_torque")
    }
    made = [recording(period_s=0.1, **extra), recording(name="other", role="validation", **extra)]
    path = write_campaign(
        tmp_path / "new",
        "rx90b",
        made,
        cutoff_hz=30.0,
        noise_torque=[0.1, 0.2],
        file_format=file_format,  # type: ignore[arg-type]
    )
    campaign = load_campaign(path)
    for found, expected in zip(campaign.recordings, made, strict=True):
        assert_same(found, expected)
    assert (campaign.robot, campaign.robot_source) == ("rx90b", "rx90b")
    assert (campaign.cutoff_hz, campaign.noise_torque) == (30.0, (0.1, 0.2))


def test_a_name_used_in_both_roles_is_kept(tmp_path: Path) -> None:
    path = write_campaign(tmp_path, "rx90b", [recording(), recording(role="validation", torque=np.ones((200, 2)))])
    campaign = load_campaign(path)
    assert [(item.name, item.role) for item in campaign.recordings] == [
        ("run", "identification"),
        ("run", "validation"),
    ]
    np.testing.assert_array_equal(campaign.validation[0].torque, 1.0)


def test_a_robot_path_is_written_relative_to_the_campaign(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text("")
    campaign = load_campaign(write_campaign(tmp_path / "data", tmp_path / "robot.toml", [recording()]))
    assert campaign.robot == "../robot.toml"
    assert Path(campaign.robot_source).is_file()


def test_written_columns_are_named_for_signal_and_joint(tmp_path: Path) -> None:
    save_recording(recording(velocity=np.zeros((200, 2))), tmp_path / "x.csv")
    header = (tmp_path / "x.csv").read_text().splitlines()[0].replace('"', "")
    assert header == "time,q_joint_1,q_joint_2,tau_joint_1,tau_joint_2,v_joint_1,v_joint_2"


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rx90b_flex.signals import tables

    target = tmp_path / "x.parquet"
    save_recording(recording(), target)
    before = target.read_bytes()

    def broken(_table: object, path: Path) -> None:
        path.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(tables.pa_parquet, "write_table", broken)
    with pytest.raises(OSError, match="disk full"):
        save_recording(recording(torque=np.zeros((200, 2))), target)
    assert target.read_bytes() == before
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("recordings", "expected"),
    [
        ([], "at least one recording"),
        ([recording(), recording(name="b", velocity=np.zeros((200, 2)))], "differ in the signals"),
        ([recording(), recording(name="b", sample_rate_hz=250.0)], "differ in joints or sample rate"),
        ([recording(), recording()], "two identification recordings are called 'run'"),
        ([recording(name="../run")], "a file name without folder or extension"),
    ],
)
def test_recordings_that_do_not_fit_one_campaign_are_refused(
    tmp_path: Path, recordings: list[Recording], expected: str
) -> None:
    with pytest.raises(ValueError, match=expected):
        write_campaign(tmp_path, "rx90b", recordings)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"torque": np.zeros((200, 3))}, r"torque has shape \(200, 3\), \(200, 2\)"),
        ({"velocity": np.zeros(200)}, r"velocity has shape \(200,\)"),
        ({"role": "test"}, "role 'test'"),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz = 0.0"),
        ({"period_s": 0.0031}, "1.55 sample periods"),
    ],
)
def test_a_recording_whose_parts_do_not_fit_cannot_be_made(changes: dict[str, object], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        recording(**changes)


# --- a real robot ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tx40() -> Campaign:
    return load_campaign(tx40_folder() / "campaign.toml")


def test_the_tx40_recording_is_split_in_two_parts_without_overlap(tx40: Campaign) -> None:
    assert [item.samples for item in tx40.recordings] == [30_000, 15_000]
    assert tx40.identification[0].time[-1] < tx40.validation[0].time[0] == 6.0
    assert (tx40.cutoff_hz, tx40.robot) == (40.0, "tx40.toml")
    assert Path(tx40.robot_source).is_file()


def test_the_tx40_joint_angles_stay_within_the_makers_range(tx40: Campaign) -> None:
    # TX40 data sheet: ±180, ±125, ±138, ±270, -120..133.5, ±270 degrees
    limits = np.deg2rad([180.0, 125.0, 138.0, 270.0, 133.5, 270.0])
    for item in tx40.recordings:
        assert np.all(np.abs(item.position) < limits)


def test_the_tx40_wrist_coupling_is_undone(tx40: Campaign) -> None:
    # motor 6 = 32 (joint 5 + joint 6): its torque acts on both joints
    values = np.genfromtxt(tx40_folder() / "tx40.csv.gz", delimiter=",", skip_header=1, max_rows=30_000)
    item = tx40.identification[0]
    np.testing.assert_allclose(item.torque[:, 5], 32.0 * values[:, 12], atol=1e-12)
    np.testing.assert_allclose(item.torque[:, 4], 45.0 * values[:, 11] + 32.0 * values[:, 12], atol=1e-12)
    np.testing.assert_allclose(item.position[:, 4] + item.position[:, 5], values[:, 6] / 32.0, atol=1e-12)
    np.testing.assert_allclose(item.position[:, 1], values[:, 2] / 32.0 - np.pi / 2, atol=1e-12)
