"""Logs as people have them become campaigns: the same numbers from every format, and one line for what cannot be."""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import independent as ind
import numpy as np
import pandas as pd
import pytest
from data_folder import tx40_folder
from scipy.io import savemat

from rx90b_flex import cli
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import Recording, load_campaign
from rx90b_flex.signals.facts import sensible_cutoff_hz
from rx90b_flex.signals.importers import Axes, Imported, ReadingOptions, import_logs

ROBOT = "rx90b_3dof"
JOINTS = ("joint_1", "joint_2", "joint_3")
AXES = Axes(JOINTS, (-2.8, -2.4, -2.5), (2.8, 2.4, 2.5))
RATE, SAMPLES = 250.0, 600
TIME = np.arange(SAMPLES) / RATE


def angle(time: np.ndarray) -> np.ndarray:
    return np.stack([0.9 * np.sin(2.0 * time), 0.5 + 0.4 * np.cos(3.0 * time), -0.8 * np.sin(time)], axis=1)


Q = angle(TIME)
V = np.stack([1.8 * np.cos(2.0 * TIME), -1.2 * np.sin(3.0 * TIME), -0.8 * np.cos(TIME)], axis=1)
TAU = np.stack([100.0 * np.cos(2.0 * TIME), 80.0 * np.sin(TIME), 30.0 * np.sin(3.0 * TIME)], axis=1)


def table(names: Sequence[str], *blocks: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame(np.column_stack(blocks), columns=list(names))


def numbered(*stems: str) -> list[str]:
    return [f"{stem}{k}" for stem in stems for k in (1, 2, 3)]


def whole(imported: Imported, field: str) -> np.ndarray:
    return np.concatenate([getattr(r, field) for r in imported.recordings])


def said(imported: Imported) -> str:
    return "\n".join(f"{where}: {finding}" for where, finding in imported.findings)


# ---- writers of every format ----------------------------------------------------------------------------------


def comma(folder: Path) -> Path:
    path = folder / "run.csv"
    table(["time", *numbered("q", "qd", "tau")], TIME, Q, V, TAU).to_csv(path, index=False)
    return path


def zipped(folder: Path) -> Path:
    path = folder / "run.csv.gz"
    names = ["t", *(f"{s}_{j}" for s in ("pos", "vel", "effort") for j in JOINTS)]
    table(names, TIME, Q, V, TAU).to_csv(path, index=False)
    return path


def german(folder: Path) -> Path:
    """Semicolons, decimal commas, degrees, milliseconds, a column of words."""
    path = folder / "run.csv"
    names = [
        "Time [ms]",
        *(f"Joint {k} {what}" for what in ("Position [deg]", "Velocity [deg/s]", "Torque [Nm]") for k in (1, 2, 3)),
    ]
    data = table(names, 1e3 * TIME, np.rad2deg(Q), np.rad2deg(V), TAU)
    data["Mode"] = "AUTO"
    data.to_csv(path, index=False, sep=";", decimal=",")
    return path


def tabbed(folder: Path) -> Path:
    """Joints counted from zero, a clock in nanoseconds."""
    path = folder / "run.tsv"
    names = [f"{what}_{k}" for what in ("actual_q", "actual_qd", "actual_torque") for k in (0, 1, 2)]
    data = table(names, Q, V, TAU)
    data.insert(0, "timestamp", 1_700_000_000_000_000_000 + (1e9 * TIME).round().astype(np.int64))
    data.to_csv(path, index=False, sep="\t")
    return path


def blanks(folder: Path) -> Path:
    """As NumPy's savetxt writes it."""
    path = folder / "run.txt"
    header = " ".join(["time", *numbered("q", "dq", "tau")])
    np.savetxt(path, np.column_stack([TIME, Q, V, TAU]), header=header)
    return path


def parquet(folder: Path) -> Path:
    path = folder / "run.parquet"
    names = [f"{j}_{what}" for what in ("position", "velocity", "torque") for j in JOINTS]
    data = table(names, Q, V, TAU)
    data.insert(0, "stamp", pd.to_datetime((1e9 * TIME).round().astype(np.int64)))
    data["joint_1_temperature"] = 40.0
    data.to_parquet(path)
    return path


def lerobot(folder: Path, episodes: int = 1) -> Path:
    """As version 2 has it, a file an episode; or version 3, several in a file, of which the longest is wanted."""
    path = folder / "data" / "chunk-000" / "episode_000000.parquet"
    path.parent.mkdir(parents=True)
    names = {"motors": [f"{j}.pos" for j in JOINTS]}
    features = {key: {"dtype": "float32", "shape": [3], "names": names} for key in ("observation.state", "action")}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": RATE, "features": features}))
    blocks = {"observation.state": Q, "observation.velocity": V, "observation.effort": TAU, "action": Q + 0.01}
    rows = [np.arange(40)] * (episodes - 1) + [np.arange(SAMPLES)]
    data = pd.DataFrame({key: [list(block[k]) for r in rows for k in r] for key, block in blocks.items()})
    data["timestamp"] = np.concatenate([TIME[r] for r in rows])
    data["episode_index"] = np.repeat(np.arange(episodes), [len(r) for r in rows])
    data["index"] = data["frame_index"] = data["task_index"] = np.arange(len(data))
    data.to_parquet(path)
    return path


def lerobot_episodes(folder: Path) -> Path:
    return lerobot(folder, episodes=3)


def matlab(folder: Path) -> Path:
    path = folder / "run.mat"
    log = {"t": TIME[:, None], "q": Q, "qd": V, "tau": TAU.T}  # a row a joint, as much a habit as a column
    savemat(path, {"log": log, "comment": "first run", "gains": np.eye(3), "Ts": 0.004})
    return path


def matlab_73(folder: Path) -> Path:
    h5py = pytest.importorskip("h5py")
    path = folder / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in (("t", TIME[:, None]), ("q", Q), ("qd", V), ("tau", TAU)):
            file[name] = array.T
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + bytes((0, 2)) + b"IM")
    return path


def write_bag(
    path: Path, storage: str, topics: Sequence[str] = ("/joint_states",), shuffled: bool = False, stamped: bool = True
) -> Path:
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    rng = np.random.default_rng(0)
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        for number, topic in enumerate(topics):
            kind = "sensor_msgs/msg/JointState"
            connection = writer.add_connection(topic, kind, typestore=store)
            for k in range(SAMPLES if number == 0 else 10):
                order = rng.permutation(3) if shuffled else np.arange(3)
                stamp = 1_700_000_000_000_000_000 + round(1e9 * TIME[k])
                seconds, nanoseconds = divmod(stamp if stamped else 0, 10**9)
                message = types[kind](
                    types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](seconds, nanoseconds), ""),
                    [JOINTS[j] for j in order],
                    Q[k, order],
                    V[k, order],
                    TAU[k, order],
                )
                writer.write(connection, stamp, store.serialize_cdr(message, kind))
    return path


def bag(folder: Path) -> Path:
    return write_bag(folder / "run", "SQLITE3", shuffled=True)


def mcap_folder(folder: Path) -> Path:
    return write_bag(folder / "run", "MCAP", stamped=False)


def mcap_file(folder: Path) -> Path:
    return next(write_bag(folder / "run", "MCAP").glob("*.mcap"))


@pytest.mark.parametrize(
    "write",
    [
        comma,
        zipped,
        german,
        tabbed,
        blanks,
        parquet,
        lerobot,
        lerobot_episodes,
        matlab,
        matlab_73,
        bag,
        mcap_folder,
        mcap_file,
    ],
)
def test_every_format_gives_the_same_recording(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    imported = import_logs([write(tmp_path)], AXES)
    first, second = imported.recordings
    assert (first.role, second.role) == ("identification", "validation")
    assert first.joints == JOINTS and first.sample_rate_hz == RATE
    assert (first.samples, second.samples) == (420, 180)  # 70 and 30 %
    # degrees and decimal text cost the last digit
    for field, wanted in (("position", Q), ("velocity", V), ("torque", TAU)):
        np.testing.assert_allclose(whole(imported, field), wanted, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(whole(imported, "time"), TIME, atol=1e-12)


# ---- what is worked out ---------------------------------------------------------------------------------------


def test_a_joint_that_slides_is_in_metres_where_the_others_are_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], TIME, np.column_stack([Q[:, 0], np.rad2deg(Q[:, 1:])]), TAU).to_csv(
        path, index=False
    )
    imported = import_logs([path], replace(AXES, prismatic=(True, False, False)), ReadingOptions())
    assert whole(imported, "position") == pytest.approx(Q, abs=1e-9)


@pytest.mark.parametrize("degrees", [None, True])
def test_a_joint_that_slides_may_be_in_millimetres(tmp_path: Path, degrees: bool | None) -> None:
    path = tmp_path / "run.csv"
    names = ["time", "q1_mm", "q2_deg", "q3_deg", *numbered("tau")]
    table(names, TIME, np.column_stack([1e3 * Q[:, 0], np.rad2deg(Q[:, 1:])]), TAU).to_csv(path, index=False)
    imported = import_logs([path], replace(AXES, prismatic=(True, False, False)), ReadingOptions(degrees=degrees))
    assert whole(imported, "position") == pytest.approx(Q, abs=1e-9)


@pytest.mark.parametrize("cell", ["19,439.7", "194 N m"])
def test_a_torque_that_is_no_number_is_no_joint_without_torques(tmp_path: Path, cell: str) -> None:
    data = table(["time", *numbered("q", "tau")], TIME, Q, TAU)
    path = tmp_path / "run.csv"
    data.assign(tau2=cell).to_csv(path, index=False)
    with pytest.raises(ValueError, match=f"run.csv: column 'tau2' can be torque of joint_2, but holds '{cell}'"):
        import_logs([path], AXES, ReadingOptions())
    path = tmp_path / "run.parquet"
    data.assign(tau2=cell).to_parquet(path)
    with pytest.raises(ValueError, match=f"run.parquet: column 'tau2' can be torque of joint_2, but holds '{cell}'"):
        import_logs([path], AXES, ReadingOptions())


def test_times_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    data = table(["time", *numbered("q", "tau")], TIME, Q, TAU)
    data.assign(time="2026-11-27T08:00").to_csv(path, index=False)
    with pytest.raises(ValueError, match="column 'time' can be time, but holds '2026-11-27T08:00'"):
        import_logs([path], AXES, ReadingOptions())


def test_angles_that_fit_the_limits_only_in_degrees_are_degrees(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "v", "tau")], TIME, np.rad2deg(Q), np.rad2deg(V), TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    np.testing.assert_allclose(whole(imported, "position"), Q, atol=1e-12)
    np.testing.assert_allclose(whole(imported, "velocity"), V, atol=1e-12)
    assert "in degrees, for in rad they would leave the robot's limits (likely)" in said(imported)


def test_angles_that_fit_in_no_unit_are_refused_unless_gears_are_given(tmp_path: Path) -> None:
    path, gear = tmp_path / "run.csv", np.array([-120.0, 500.0, 300.0])
    table(["time", *numbered("q", "tau")], TIME, Q * gear, TAU / gear).to_csv(path, index=False)
    with pytest.raises(ValueError, match=r"run\.csv: column 'q\d' runs from .* motor side \(--gear\)\?"):
        import_logs([path], AXES)
    imported = import_logs([path], AXES, ReadingOptions(gear=(tuple(gear),)))
    np.testing.assert_allclose(whole(imported, "position"), Q, atol=1e-12)
    np.testing.assert_allclose(whole(imported, "torque"), TAU, atol=1e-10)


def test_references_feedforward_and_link_angles_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    stems = ("q_", "tau_", "v_", "link_", "ref_", "refv_", "ff_")  # as this package writes them
    blocks = [k + Q for k in np.linspace(0, 0.6, len(stems))]
    table(["time", *(s + j for s in stems for j in JOINTS)], TIME, *blocks).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    fields = (
        "position",
        "torque",
        "velocity",
        "link_position",
        "reference_position",
        "reference_velocity",
        "feedforward_torque",
    )
    for field, wanted in zip(fields, blocks, strict=True):
        np.testing.assert_allclose(whole(imported, field), wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("column", "signal"),
    [
        ("q1", "position"),
        ("pos_joint_1", "position"),
        ("joint1.encoder", "position"),
        ("TargetPos1", "reference_position"),
        ("cmd_vel_1", "reference_velocity"),
        ("dq[1]", "velocity"),
        ("qdot_1", "velocity"),
        ("Joint_1_Effort", "torque"),
        ("tau_ff_1", "feedforward_torque"),
        ("load_encoder_1", "link_position"),
        ("qdd1", None),
        ("motor_current_1", None),
        ("target_torque_1", None),
        ("temperature_1", None),
    ],
)
def test_names_are_understood(tmp_path: Path, column: str, signal: str | None) -> None:
    marked = np.cos(5.0 * TIME)
    blocks = {"time": TIME, "q1": Q[:, 0], "tau1": TAU[:, 0]}
    blocks = {k: v for k, v in blocks.items() if {"position": "q1", "torque": "tau1"}.get(signal or "") != k}
    path = tmp_path / "run.csv"
    pd.DataFrame(blocks | {column: marked}).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    fields = (
        "position",
        "torque",
        "velocity",
        "link_position",
        "reference_position",
        "reference_velocity",
        "feedforward_torque",
    )
    held = [
        f
        for f in fields
        if getattr(imported.recordings[0], f) is not None and np.allclose(whole(imported, f)[:, 0], marked)
    ]
    assert held == ([signal] if signal else [])
    assert "held at zero, for they have no columns: joint_2, joint_3" in said(imported)


def test_uneven_times_are_interpolated_and_it_says_so(tmp_path: Path) -> None:
    time = TIME + np.random.default_rng(3).uniform(-0.3, 0.3, SAMPLES) / RATE
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], time, angle(time), angle(time)).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    grid = whole(imported, "time")
    rate = imported.recordings[0].sample_rate_hz
    np.testing.assert_allclose(np.diff(grid), 1.0 / rate, rtol=1e-9)
    # cubic between points, its slopes off by at most h max|q''|, each with a weight of at most h / 8; q'' is 3.6 rad/s^2
    largest_step = np.diff(time).max()
    assert np.abs(whole(imported, "position") - angle(grid + time[0])).max() < largest_step**2 * 3.6 / 4.0
    assert "interpolated (PCHIP) at the mean rate" in said(imported)
    assert rate == RATE


@pytest.mark.parametrize("stated", [None, RATE])
def test_uneven_times_of_several_files_are_brought_to_one_rate(tmp_path: Path, stated: float | None) -> None:
    """Their medians differ by some hundredths of a percent, which no fraction of whole numbers brings together."""
    rng, paths = np.random.default_rng(4), []
    for k in range(3):
        time = TIME + rng.uniform(-0.1, 0.1, SAMPLES) / RATE
        paths.append(tmp_path / f"run_{k}.csv")
        table(["time", *numbered("q", "tau")], time, angle(time), angle(time)).to_csv(paths[-1], index=False)
    imported = import_logs(paths, AXES, ReadingOptions(rate_hz=stated))
    assert [r.sample_rate_hz for r in imported.recordings] == [RATE] * 3


@pytest.mark.parametrize("lost", [0.003, 0.05])
def test_lost_rows_leave_the_rate_as_it_is_and_are_told(tmp_path: Path, lost: float) -> None:
    kept = np.random.default_rng(5).uniform(size=SAMPLES) > lost
    kept[[0, 100, -1]] = True, False, True
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], TIME[kept], Q[kept], TAU[kept]).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    assert imported.recordings[0].sample_rate_hz == RATE
    assert f"{np.count_nonzero(~kept)} rows are missing" in said(imported)


def test_a_rate_that_is_no_round_number_is_no_jitter(tmp_path: Path) -> None:
    time, path = np.arange(SAMPLES) * 0.002016, tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], np.round(20 * time, 5) / 20, Q, TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    assert imported.recordings[0].sample_rate_hz == pytest.approx(1 / 0.002016, rel=1e-5)
    assert "interpolated" not in said(imported)


def test_the_low_pass_goes_by_motion_and_not_by_the_noise_of_a_joint_that_hardly_moves() -> None:
    rng, time = np.random.default_rng(6), np.arange(10_000) / 500.0
    q = np.outer(np.sin(2 * np.pi * 0.5 * time), [0.3, 0.02]) + 1e-5 * rng.standard_normal((10_000, 2))
    zero = np.zeros_like(q)
    assert sensible_cutoff_hz([Recording("run", "identification", time, 500.0, ("a", "b"), q, zero)]) < 6.0


def test_a_rate_is_a_round_number_although_the_clock_drifts(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], 1.000002 * TIME, Q, TAU).to_csv(path, index=False)
    assert import_logs([path], AXES).recordings[0].sample_rate_hz == RATE


def test_times_printed_coarsely_are_no_jitter(tmp_path: Path) -> None:
    time = np.arange(SAMPLES) / 400.0  # steps of 2.5 ms
    path = tmp_path / "run.csv"
    table(["time_ms", *numbered("q", "tau")], np.floor(1e3 * time), Q, TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    assert imported.recordings[0].sample_rate_hz == 400.0
    np.testing.assert_array_equal(whole(imported, "position"), Q)


def test_repeated_times_and_interruptions_are_left_out(tmp_path: Path) -> None:
    rows = np.r_[np.arange(150), 149, np.arange(200, SAMPLES)]
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], TIME[rows], Q[rows], TAU[rows]).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    np.testing.assert_allclose(whole(imported, "position"), Q[200:], atol=1e-14)
    assert "1 row with the time of the row before left out" in said(imported) and "1 interruption:" in said(imported)
    begin = imported.recordings[0].time[0]  # what warms up did so since the log began
    assert begin == pytest.approx(TIME[200], abs=1e-12)


SLIDING = replace(AXES, prismatic=(True, False, False))


@pytest.mark.parametrize("unit", ["N", "kN"])
def test_the_force_of_a_joint_that_slides_is_its_torque_and_a_tool_s_is_none(tmp_path: Path, unit: str) -> None:
    path = tmp_path / "run.csv"
    sized = TAU * np.array([1e-3 if unit == "kN" else 1.0, 1.0, 1.0])
    names = ["time", *numbered("q"), f"force1 [{unit}]", "torque2", "torque3", "force2", "force3"]
    table(names, TIME, Q, sized, TAU[:, 1:] + 7.0).to_csv(path, index=False)
    np.testing.assert_allclose(whole(import_logs([path], SLIDING), "torque"), TAU, rtol=1e-12)
    turning = import_logs([path], AXES)
    assert turning.recordings[0].joints == JOINTS[1:]
    text = "held at zero though there are columns of them: joint_1: no column can be their torque"
    assert f"{text}; choose with --columns torque=..." in said(turning)


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("kN·m", 1e-3),
        ("kN m", 1e-3),
        ("kN.m", 1e-3),
        ("N·mm", 1e3),
        ("mN·m", 1e3),
        ("N m", 1.0),
        ("daNm", 0.1),
        ("kgf·m", 1 / 9.80665),
        ("kgf cm", 100 / 9.80665),
    ],
)
def test_a_newton_and_a_metre_are_one_unit_whatever_stands_between(tmp_path: Path, unit: str, size: float) -> None:
    path = tmp_path / "run.csv"
    names = ["time", *numbered("q"), *(f"tau{k} [{unit}]" for k in (1, 2, 3))]
    table(names, TIME, Q, size * TAU).to_csv(path, index=False)
    np.testing.assert_allclose(whole(import_logs([path], AXES), "torque"), TAU, rtol=1e-12)


@pytest.mark.parametrize("unit", ["%", "V", "pu"])
def test_a_unit_that_cannot_be_brought_to_si_is_said_and_its_column_left_out(tmp_path: Path, unit: str) -> None:
    path = tmp_path / "run.csv"
    foreign = [f"torque{k} [{unit}]" for k in (1, 2, 3)]
    table(["time", *numbered("q", "tau"), *foreign], TIME, Q, TAU, 0.1 * TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    np.testing.assert_array_equal(whole(imported, "torque"), TAU)
    assert f"column 'torque1 [{unit}]': left out, for it is in {unit}" in said(imported)
    with pytest.raises(ValueError, match="which import does not bring to SI"):
        import_logs([path], AXES, ReadingOptions(columns={"torque": tuple(foreign)}))


@pytest.mark.parametrize("beside", ["ft_torque_", "tcp_pos_", "tool_torque_"])
def test_columns_beside_that_count_from_zero_do_not_move_the_joints(tmp_path: Path, beside: str) -> None:
    path = tmp_path / "run.csv"
    names = ["time", *numbered("q", "tau"), *(f"{beside}{k}" for k in (0, 1, 2))]
    table(names, TIME, Q, TAU, TAU + 5.0).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    assert imported.recordings[0].joints == JOINTS
    np.testing.assert_array_equal(whole(imported, "torque"), TAU)


@pytest.mark.parametrize("names", ["joint_control_output_", "motor_load_", "torque_limit_", "external_torque_"])
def test_what_a_controller_logs_beside_is_no_signal(tmp_path: Path, names: str) -> None:
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau", names)], TIME, Q, TAU, 0.1 * Q).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    assert imported.recordings[0].link_position is None
    np.testing.assert_array_equal(whole(imported, "torque"), TAU)


def test_a_clock_that_ticks_less_often_than_rows_come_loses_none(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], np.floor(TIME / 0.0156) * 0.0156, Q, TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES)
    assert whole(imported, "position").shape == Q.shape and imported.recordings[0].sample_rate_hz == pytest.approx(
        RATE, rel=2e-3
    )
    assert "times in ticks of 15.6 ms, of several rows each" in said(imported)


def test_angles_beside_a_slide_in_millimetres_are_looked_at_for_degrees(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    values = np.column_stack([1e3 * Q[:, 0], np.rad2deg(Q[:, 1:])])
    table(["time", "q1 [mm]", "q2", "q3", *numbered("tau")], TIME, values, TAU).to_csv(path, index=False)
    np.testing.assert_allclose(whole(import_logs([path], SLIDING), "position"), Q, atol=1e-12)


def test_a_current_turns_with_its_motor(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    gears = np.array([50.0, -60.0, 70.0])
    table(["time", *numbered("q"), *numbered("current")], TIME, Q * gears, TAU).to_csv(path, index=False)
    imported = import_logs([path], AXES, ReadingOptions(gear=((50.0, -60.0, 70.0),)))
    np.testing.assert_allclose(whole(imported, "position"), Q, atol=1e-12)
    np.testing.assert_allclose(whole(imported, "motor_current"), TAU * np.sign(gears), atol=1e-12)
    assert "coupled" not in said(imported)


def test_columns_are_one_a_joint_of_those_that_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    table(["time", "a", "b", "c", "u", "v", "w"], TIME, Q, TAU).to_csv(path, index=False)
    some = {"motor_position": ("a", "c"), "torque": ("u", "v", "w")}
    with pytest.raises(ValueError, match="--columns motor_position lists 2 columns; expected 3, one a joint"):
        import_logs([path], AXES, ReadingOptions(columns=some, joints=JOINTS))
    with pytest.raises(
        ValueError, match="--columns torque lists 3 columns, motor_position 2; expected one each a joint"
    ):
        import_logs([path], AXES, ReadingOptions(columns=some))


def test_of_several_files_the_last_validates(tmp_path: Path) -> None:
    files = []
    for name in ("a", "b", "c"):
        path = tmp_path / f"{name}.csv"
        names = [*numbered("q", "tau"), *(numbered("v") if name == "a" else [])]
        table(["time", *names], TIME, Q, TAU, *([V] if name == "a" else [])).to_csv(path, index=False)
        files.append(path)
    imported = import_logs(files, AXES)
    assert [(r.name, r.role) for r in imported.recordings] == [
        ("a", "identification"), ("b", "identification"), ("c", "validation"),
    ]  # fmt: skip
    assert all(r.velocity is None for r in imported.recordings) and "velocity: left out" in said(imported)


def test_another_rate_is_reached_by_filtering(tmp_path: Path) -> None:
    hum = np.sin(2 * np.pi * 110.0 * TIME)[:, None]  # above half of the new rate
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], TIME, Q, hum + np.zeros(3)).to_csv(path, index=False)
    imported = import_logs([path], AXES, ReadingOptions(rate_hz=125.0))
    assert imported.recordings[0].sample_rate_hz == 125.0
    assert np.abs(whole(imported, "torque")[20:-20]).max() < 1e-2
    np.testing.assert_allclose(whole(imported, "position")[20:-20], Q[::2][20:-20], atol=1e-3)


def test_a_bag_with_several_topics_takes_the_longest_or_the_one_asked_for(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", "SQLITE3", ("/joint_states", "/leader/joint_states"))
    imported = import_logs([path], AXES)
    assert whole(imported, "position").shape == (SAMPLES, 3) and "other topics" in said(imported)
    with pytest.raises(ValueError, match=r"10 samples; too few"):
        import_logs([path], AXES, ReadingOptions(topic="/leader/joint_states"))
    with pytest.raises(ValueError, match="no topic '/nothing'"):
        import_logs([path], AXES, ReadingOptions(topic="/nothing"))


# ---- what cannot be -------------------------------------------------------------------------------------------


def spoiled(**changes: Any) -> pd.DataFrame:
    return table(["time", *numbered("q", "tau")], TIME, Q, TAU).assign(**changes)


BACKWARDS = np.r_[TIME[:300], TIME[200:500]]
HOLE = np.where(np.arange(SAMPLES) == 6, np.nan, Q[:, 1])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (spoiled(time=BACKWARDS), "row 301: time runs backwards"),
        (spoiled(q2=HOLE), "column 'q2', row 7: empty or NaN"),
        (spoiled(q2=np.where(np.isnan(HOLE), np.inf, HOLE)), "column 'q2', row 7: infinite"),
        (spoiled(tau2=["1.0", *["x1"] * (SAMPLES - 1)]), "column 'tau2', row 2: 'x1' is not a number"),
        (spoiled().drop(columns="time"), "no time column; expected one named time, or --rate"),
        (spoiled().rename(columns={f"tau{k}": f"voltage{k}" for k in (1, 2, 3)}), "no column can be torque"),
        (spoiled().rename(columns={f"q{k}": f"x{k}" for k in (1, 2, 3)}), "no column can be motor_position"),
        (spoiled(pos1=Q[:, 0]), "columns 'q1' and 'pos1' can both be motor_position of joint_1; choose with --columns"),
        (spoiled()[["time", "q1", "tau2"]], "no joint has both position and torque"),
        (spoiled().iloc[:5], "5 rows"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_column(tmp_path: Path, data: pd.DataFrame, message: str) -> None:
    path = tmp_path / "run.csv"
    data.to_csv(path, index=False)
    with pytest.raises(ValueError) as caught:
        import_logs([path], AXES)
    assert str(caught.value).startswith(str(path)) and message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("run.mat", b"not a MATLAB file at all" * 20, "cannot be read"),
        ("run.parquet", b"PAR1 no", "cannot be read"),
        ("run.mcap", b"no mcap" * 10, "cannot be read"),
        ("run.csv", b"", "the file is empty"),
        ("run.csv", b"1,2,3\n4,5,6\n", "the first line holds numbers"),
        ("run.csv", b"time,q1,tau1\n0,1,2\n0.1,1\n", "row 2 has 2 cells, the header has 3"),
        ("run.csv", b"time,q1,q1\n0,1,2\n0.1,1,3\n", "column 'q1' is there 2 times"),
        ("run.csv.gz", b"not zipped", "cannot be read"),
        ("run.xls", b"x", "unknown kind of file"),
    ],
)
def test_files_that_cannot_be_read_are_one_line(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    if name.endswith(".mcap"):
        pytest.importorskip("rosbags")
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError) as caught:
        import_logs([path], AXES)
    assert str(caught.value).startswith(str(path)) and message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("module", "write", "message"), [("rosbags.highlevel", None, "rx90b-flex[ros]"), ("h5py", matlab_73, "needs h5py")]
)
def test_a_missing_reader_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, write: Callable[[Path], Path] | None, message: str
) -> None:
    path = tmp_path / "run.mcap" if write is None else write(tmp_path)
    if write is None:
        path.write_bytes(b"something")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ValueError) as caught:
        import_logs([path], AXES)
    assert message in str(caught.value)


# ---- the command ----------------------------------------------------------------------------------------------


def call(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "import", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0)  # type: ignore[arg-type]


@pytest.mark.parametrize("file_format", ["parquet", "csv"])
def test_the_command_writes_a_campaign_that_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], file_format: str
) -> None:
    out = tmp_path / "out"
    assert call(comma(tmp_path), "--robot", ROBOT, "--out", out, "--format", file_format, monkeypatch=monkeypatch) == 0
    campaign = load_campaign(out / "campaign.toml")
    assert campaign.robot_source == ROBOT and len(campaign.identification) == len(campaign.validation) == 1
    np.testing.assert_array_equal(campaign.identification[0].position, Q[:420])
    text = capsys.readouterr().out
    for part in ("motor_position: q1, q2, q3 for joint_1, joint_2, joint_3 (likely)", "250 Hz", "Campaign:"):
        assert part in text


def test_columns_rate_and_joints_can_be_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.csv"
    table(["alpha", "beta", "u", "w"], Q[:, 1:], TAU[:, 1:]).to_csv(path, index=False)
    said = (
        "--columns",
        "motor_position=alpha,beta",
        "--columns",
        "torque=u,w",
        "--joints",
        "joint_2,joint_3",
        "--rate",
        250,
    )
    assert call(path, "--robot", ROBOT, "--out", tmp_path / "o", *said, monkeypatch=monkeypatch) == 0
    recording = load_campaign(tmp_path / "o" / "campaign.toml").identification[0]
    assert recording.joints == JOINTS[1:] and recording.sample_rate_hz == RATE
    np.testing.assert_array_equal(recording.torque, TAU[:420, 1:])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("FILE", "--robot", "rx90c"), "unknown robot 'rx90c'"),
        (("nothing.csv", "--robot", ROBOT), "nothing.csv: no such file"),
        (("FILE", "--robot", ROBOT, "--columns", "torque"), "--columns torque: expected SIGNAL=NAME"),
        (("FILE", "--robot", ROBOT, "--columns", "torqe=tau1"), "did you mean 'torque'"),
        (("FILE", "--robot", ROBOT, "--columns", "torque=tau9"), "run.csv: no column 'tau9'"),
        (("FILE", "--robot", ROBOT, "--joints", "joint_7"), "--joints joint_7: no such joint"),
        (("FILE", "--robot", ROBOT, "--gear", "1,a"), "--gear 1,a: expected numbers"),
        (("FILE", "--robot", ROBOT, "--gear", "1,2"), "--gear: expected 3 numbers, or 3 rows"),
        (("FILE", "--robot", ROBOT, "--gear", "1,0,0;0,1,0;1,0,0"), "--gear: singular"),
        (("FILE", "--robot", ROBOT, "--offset", "1,2,3"), "--offset is of motor angles"),
        (("FILE", "--robot", ROBOT, "--rate", "-5"), "--rate -5"),
        (
            ("FILE", "--robot", ROBOT, "--gear", "1,1,1e-4"),
            "of joint_3 reaches 8000 rad, below 100 is expected; motor side",
        ),
        (("FILE", "--robot", ROBOT, "--topic", "/x"), "only bags have topics"),
        (("FILE", "--robot", ROBOT, "--format", "xls"), "--format xls"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    message: str,
) -> None:
    path, out = comma(tmp_path), tmp_path / "out"
    given = [str(path) if a == "FILE" else a for a in arguments]
    assert call(*given, "--out", out, monkeypatch=monkeypatch) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and message in lines[0]
    assert not out.exists()


@pytest.mark.slow
def test_the_loop_closes_on_an_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs with columns angle_0, moment_0, ...: nothing is said but the robot."""
    arm, rng = ind.two_joints(tmp_path), np.random.default_rng(1)
    runs = [
        ind.run(arm, "identification", ind.harmonics(rng, 2, period_s=5.0, rate_hz=100.0), [], np.zeros(2))
        for _ in "ab"
    ]
    ind.write_files(tmp_path, arm, [], runs)
    logs, data = [tmp_path / f"log_{k}.csv" for k in (1, 2)], tmp_path / "data"
    assert call(*logs, "--robot", tmp_path / "robot_declared.toml", "--out", data, monkeypatch=monkeypatch) == 0
    monkeypatch.setattr(
        "sys.argv", ["rx90b-flex", "close-loop", str(data / "campaign.toml"), "--out", str(tmp_path / "o")]
    )
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    result = json.loads((tmp_path / "o" / "closed_loop.json").read_text())
    # without friction and noise the rigid model leaves only what differentiation leaves
    assert result["effects"] == [] and result["before"]["validation"]["relative_error"] < 1e-3


def test_the_tx40_log_is_read_as_its_campaign_says() -> None:
    folder = tx40_folder()
    campaign = load_campaign(folder / "campaign.toml")
    tree = load_robot(folder / "tx40.toml").tree
    axes = Axes(campaign.joints, tuple(tree.lowerPositionLimit), tuple(tree.upperPositionLimit))
    motor = tomllib.loads((folder / "campaign.toml").read_text())["motor"]
    options = ReadingOptions(gear=tuple(map(tuple, motor["gear_matrix"])), offset=tuple(motor["offset"]))
    imported = import_logs([folder / "tx40.csv.gz"], axes, options)
    assert imported.recordings[0].sample_rate_hz == campaign.sample_rate_hz
    for field in ("position", "torque"):
        wanted = np.concatenate([getattr(r, field) for r in campaign.recordings])
        np.testing.assert_allclose(whole(imported, field), wanted, rtol=1e-12, atol=1e-12)


# ---- what is refused, and what is found out for the campaign file --------------------------------------------------


def three_logs(folder: Path, *scales: float) -> list[Path]:
    """Logs whose angles are multiplied so, each with a motion of its own."""
    files = []
    for k, scale in enumerate(scales):
        path = folder / f"log_{k}.csv"
        table(["time", *numbered("q", "tau")], TIME, scale * angle(TIME + 3.0 * k), TAU + k).to_csv(path, index=False)
        files.append(path)
    return files


def test_units_that_differ_from_file_to_file_are_refused(tmp_path):
    files = three_logs(tmp_path, 180.0 / np.pi, 1.0, 180.0 / np.pi)
    with pytest.raises(ValueError, match=r"log_1\.csv: angles in rad; those of .*log_0\.csv are in degrees"):
        import_logs(files, AXES)


def test_a_log_given_twice_is_refused(tmp_path):
    first, second = three_logs(tmp_path, 1.0, 1.0)
    with pytest.raises(ValueError, match=r"log_0\.csv: given twice"):
        import_logs([first, second, first], AXES)


def test_a_column_chosen_twice_is_refused(tmp_path):
    columns = {"motor_position": ("q1", "q2", "q3"), "torque": ("tau1", "q2", "tau3")}
    with pytest.raises(ValueError, match="--columns torque: column 'q2' is already used by motor_position"):
        import_logs(three_logs(tmp_path, 1.0), AXES, ReadingOptions(columns))


def test_an_imported_campaign_says_its_period_and_a_low_pass_that_keeps_the_motion(tmp_path, monkeypatch):
    time = np.arange(5000) / RATE
    hz = 0.5  # the slowest of the harmonics: the motion repeats every two seconds
    q = np.stack(
        [np.sin(2 * np.pi * hz * time), 0.5 * np.cos(4 * np.pi * hz * time), 0.3 * np.sin(6 * np.pi * hz * time)], 1
    )
    path = tmp_path / "run.csv"
    table(["time", *numbered("q", "tau")], time, q, np.cos(q)).to_csv(path, index=False)
    monkeypatch.setattr(
        sys, "argv", ["rx90b-flex", "import", str(path), "--robot", ROBOT, "--out", str(tmp_path / "out")]
    )
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    made = tomllib.loads((tmp_path / "out" / "campaign.toml").read_text())
    assert [r["period_s"] for r in made["recording"]] == [2.0, 2.0]
    assert 6 * hz / 2 < made["preprocessing"]["cutoff_hz"] < 25.0
