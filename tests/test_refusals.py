"""What a wrong or odd input is told: one line, status 2, the file and the place named, nothing written."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pandas as pd
import pytest
from test_cli import Command, campaign, command, edit, tree, write_campaign

import rx90b_flex as rf

__all__ = ["campaign", "command"]  # fixtures


def change_logs(folder: Path, logs: Sequence[str] = ("log_1.csv", "log_2.csv"), **columns: float | np.ndarray) -> None:
    for name in logs:
        table = pd.read_csv(folder / name)
        table.assign(**columns).to_csv(folder / name, index=False)


def scale_logs(folder: Path, column: str, factor: float) -> None:
    for name in ("log_1.csv", "log_2.csv"):
        table = pd.read_csv(folder / name)
        table.assign(**{column: table[column] * factor}).to_csv(folder / name, index=False)


def hold_the_shoulder(folder: Path) -> None:
    """The same runs of the elbow with the shoulder at rest, from the arm's own dynamics."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(4)
    for name in ("log_1.csv", "log_2.csv"):
        moving = ind.harmonics(rng, 2, period_s=6.0, rate_hz=100.0)
        still = np.array([0.0, 1.0])
        held = ind.Motion(moving.time, moving.q * still + [0.3, 0.0], moving.v * still, moving.a * still)
        torque = arm.torque(held) + ind.friction((2.0, 1.0), (3.0, 1.5))(held, np.zeros_like(held.q))
        torque += ind.white(rng, len(held.time), (0.2, 0.08))
        columns = {f"angle_{j}": held.q[:, j] for j in range(2)} | {f"moment_{j}": torque[:, j] for j in range(2)}
        change_logs(folder, (name,), **columns)


def refused(command: Command, folder: Path, *arguments: object) -> str:
    before = tree(folder)
    found = command(*arguments)
    assert (found.status, found.out, found.err.count("\n")) == (2, "", 1)
    assert tree(folder) == before
    return found.err


# ---- numbers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "sample_rate_hz = 100\n",
            "sample_rate_hz = 1" + "0" * 400 + "\n",
            "campaign.toml: sample_rate_hz: a number of 401 digits",
        ),
        ("sample_rate_hz = 100\n", "sample_rate_hz = 1" + "0" * 5000 + "\n", "campaign.toml: not a TOML file"),
        ("sample_rate_hz = 100\n", f"sample_rate_hz = {'[' * 5000}{']' * 5000}\n", "too deep"),
        ("sample_rate_hz = 100\n", f"sample_rate_hz = {'[' * 200}{']' * 200}\n", "too deep"),
        ("sample_rate_hz = 100\n", "sample_rate_hz = inf\n", "campaign.toml: sample_rate_hz: found inf"),
        ("cutoff_hz = 10.0", "cutoff_hz = 0.001", "log_1.csv: 600 samples are too few for a low-pass of 0.001 Hz"),
    ],
    ids=["400 digits", "5000 digits", "5000 deep", "200 deep", "inf", "a cutoff too low"],
)
def test_a_number_that_cannot_be_meant_is_named_in_a_campaign_file(
    campaign: Path, command: Command, tmp_path: Path, old: str, new: str, said: str
) -> None:
    edit(campaign, old, new)
    assert said in refused(command, tmp_path, "identify", campaign, "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["excite", "rx90b_3dof", "--period-s", "0"], "--period-s is 0"),
        (["excite", "rx90b_3dof", "--period-s", "1e6"], "--period-s is 1e+06"),
        (["excite", "rx90b_3dof", "--high-hz", "1e9"], "the band is 2.5 to 1e+09 Hz"),
        (["excite", "rx90b_3dof", "--speed", "0"], "--speed is 0"),
        (["excite", "rx90b_3dof", "--speed", "nan"], "--speed is nan"),
        (["excite", "rx90b_3dof", "--joints", "joint_1,joint_1"], "'joint_1' is listed 2 times"),
        (["excite", "rx90b_3dof", "--realisations", "1000000000"], "days of motion"),
        (["excite", "rx90b_3dof", "--peak", "inf"], "--peak"),
        (["demo", "--seed", "-1"], "--seed is -1"),
        (["simulate", "rx90b_3dof", "--excitation", "--periods", "1000000000"], "periods is 1000000000"),
        (["check-path", "line", "--speed-mm-s", "1e-9"], "takes more than 3600 s"),
        (["check-path", "line", "--tolerance-mm", "inf"], "--tolerance-mm is inf"),
        (["check-path", "line", "--jobs", "1000000"], "--jobs is 1000000"),
        (["close-loop"], "Missing argument"),
        (["close-lop"], "No such command"),
        (["demo", "--sed", "3"], "No such option"),
        (["demo", "--seed", "x"], "--seed"),
    ],
    ids=" ".join,
)
def test_an_option_that_cannot_be_meant_is_named(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    out = [] if arguments[0] == "close-lop" else ["--out", tmp_path / "out"]
    assert said in refused(command, tmp_path, *arguments, *out)


def test_brackets_in_names_are_printed_as_they_are(command: Command, tmp_path: Path) -> None:
    path = write_campaign(tmp_path / "data")
    for name in ("robot_declared.toml", "campaign.toml", "two_joints.urdf"):
        text = (path.parent / name).read_text()
        (path.parent / name).write_text(
            text.replace("elbow", "elbow[/bold]").replace('name = "declared"', 'name = "[red]arm"')
        )
    found = command("identify", path, "--out", tmp_path / "[b]out")
    assert (found.status, found.err) == (0, "")
    assert "[red]arm" in found.out and "elbow[/bold]" in found.out and "[b]out" in found.out


# ---- messages -------------------------------------------------------------------------------------------------


def test_known_links_and_no_effects_leave_nothing_to_identify_and_it_says_so(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    robot = campaign.parent / "robot_declared.toml"
    head = robot.read_text().split("[[effects]]")[0]
    robot.write_text(head.replace('"fitted"', '"known"'))
    said = refused(command, tmp_path, "identify", campaign, "--out", tmp_path / "out")
    assert "robot_declared.toml" in said and "nothing to identify" in said


def test_a_torque_beyond_measure_is_named_with_file_and_column(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    scale_logs(campaign.parent, "moment_0", 1e300)
    for name in ("identify", "close-loop"):
        assert "log_1.csv: column 'moment_0': torque of 'shoulder' reaches" in refused(
            command, tmp_path, name, campaign, "--out", tmp_path / "out"
        )


def test_a_mass_beyond_measure_is_named_with_file_and_joint(campaign: Path, command: Command, tmp_path: Path) -> None:
    urdf = campaign.parent / "two_joints.urdf"
    urdf.write_text(re.sub(r'mass value="[^"]*"', 'mass value="1e300"', urdf.read_text()))
    said = refused(command, tmp_path, "identify", campaign, "--out", tmp_path / "out")
    assert "two_joints.urdf" in said and "inertial parameter" in said


def test_recordings_to_fit_in_which_nothing_moves_are_a_fault_of_the_data(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    change_logs(campaign.parent, ("log_1.csv",), angle_0=0.3, angle_1=0.3)
    for name in ("check", "identify", "close-loop"):
        found = command(name, campaign, "--out", tmp_path / name)
        assert (found.status, found.err) == (1, "") and "No joint moves" in " ".join(found.out.split())


@pytest.mark.parametrize(
    ("column", "change", "said"),
    [
        ("time", lambda x: 0.0 * x, "1 rows at different times"),
        ("time", lambda x: 1e12 * x, "1e-10 samples a second; expected 0.1 to 1e+06"),
        ("time", lambda x: 1e-12 * x, "1e+14 samples a second; expected 0.1 to 1e+06"),
        ("moment_1", lambda x: 1e200 * x, "column 'moment_1', row 1: -1.84527e+200; expected below 1e+09"),
    ],
)
def test_a_log_in_no_unit_that_is_used_is_not_imported(
    campaign: Path, command: Command, tmp_path: Path, column: str, change: Callable[[np.ndarray], np.ndarray], said: str
) -> None:
    log = campaign.parent / "log_1.csv"
    change_logs(campaign.parent, ("log_1.csv",), **{column: change(pd.read_csv(log)[column].to_numpy())})
    robot = campaign.parent / "robot_declared.toml"
    assert said in refused(command, tmp_path, "import", log, "--robot", robot, "--out", tmp_path / "out")


def test_a_clock_that_stands_is_named(campaign: Path, command: Command, tmp_path: Path) -> None:
    change_logs(campaign.parent, ("log_1.csv",), time=1.0)
    said = refused(command, tmp_path, "identify", campaign, "--out", tmp_path / "out")
    assert "log_1.csv: column 'time': times that never change contradict sample_rate_hz = 100" in said


def test_no_second_folder_is_not_the_one_where_one_stands(campaign: Path, command: Command, tmp_path: Path) -> None:
    said = refused(command, tmp_path, "view", campaign, "--beside", "", "--out", tmp_path / "out.html")
    assert "--beside is ''; expected a folder" in said


def test_no_names_for_joints_are_no_joints(campaign: Path, command: Command, tmp_path: Path) -> None:
    log, robot = campaign.parent / "log_1.csv", campaign.parent / "robot_declared.toml"
    words = ("import", log, "--robot", robot, "--joints", ",")
    assert "--joints ,: expected names" in refused(command, tmp_path, *words, "--out", tmp_path / "out")


def test_a_number_in_a_trajectory_that_none_can_be_is_named(command: Command, tmp_path: Path) -> None:
    rows = [f"{k / 100:.2f},{'-1e308' if k == 10 else '0'}\n" for k in range(20)]
    (tmp_path / "swing.csv").write_text("time,joint_1\n" + "".join(rows))
    words = ("simulate", "rx90b_3dof", "--trajectory", tmp_path / "swing.csv")
    said = refused(command, tmp_path, *words, "--out", tmp_path / "out")
    assert "swing.csv: column 'joint_1', row 11: -1e+308; expected a number below 1e+09" in said


def test_rows_of_other_bytes_and_too_few_cells_are_one_line(campaign: Path, command: Command, tmp_path: Path) -> None:
    """A row that is no text reaches a callback of the reader, whose errors Python prints."""
    log = campaign.parent / "log_1.csv"
    log.write_bytes(
        b"\n".join(line if k != 250 else b"\xe6\xff" for k, line in enumerate(log.read_bytes().split(b"\n")))
    )
    assert "log_1.csv" in refused(command, tmp_path, "identify", campaign, "--out", tmp_path / "out")


@pytest.mark.slow
def test_a_joint_that_never_moves_is_no_reason_to_fail(campaign: Path, command: Command, tmp_path: Path) -> None:
    """The shoulder stands on its brake: its log has the torque that holds it, and no friction."""
    hold_the_shoulder(campaign.parent)
    assert command("identify", campaign, "--out", tmp_path / "out").status == 0
    assert command("close-loop", campaign, "--out", tmp_path / "closed").status == 0


def test_a_position_that_stands_while_its_torque_is_that_of_a_motion_is_a_fault_of_the_data(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    change_logs(campaign.parent, angle_0=0.3)
    for name in ("identify", "close-loop"):
        found = command(name, campaign, "--out", tmp_path / name)
        assert (found.status, found.err) == (1, "")
        assert "stuck" in found.out and "shoulder" in found.out
    assert command("identify", campaign, "--out", tmp_path / "all the same", "--despite-faults").status == 0


def test_a_robot_whose_drives_weigh_nothing_is_named(command: Command, tmp_path: Path) -> None:
    assert command("flexify", "rx90b", "--out", tmp_path / "flex.urdf").status == 0
    (tmp_path / "own.urdf").write_text(rf.load_robot("rx90b").urdf)
    drive = 'type = "drive_flexibility"\njoint = "joint_2"\nstiffness = 1e5\ndamping = 100.0\n'
    (tmp_path / "own.toml").write_text(f'urdf = "own.urdf"\n[[effects]]\n{drive}')
    said = refused(command, tmp_path, "view", tmp_path / "own.toml", "--out", tmp_path / "view.html")
    assert said.startswith(f"rx90b-flex: {tmp_path / 'own.toml'}: own: nothing with mass moves with ")
    assert "flex: " in refused(
        command, tmp_path, "simulate", tmp_path / "flex.urdf", "--harmonics", "--out", tmp_path / "run"
    )


def test_a_robot_shows_itself_in_a_line() -> None:
    assert repr(rf.load_robot("rx90b_3dof")) == "<Robot 'rx90b_3dof': 3 joints, 12 coordinates, 12 effects>".replace(
        "12 effects", f"{len(rf.load_robot('rx90b_3dof').effects)} effects"
    )


# ---- short logs -----------------------------------------------------------------------------------------------


def test_a_short_slow_log_becomes_a_campaign_that_runs_and_says_that_it_is_short(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    table = pd.read_csv(campaign.parent / "log_1.csv").iloc[::4]  # 6 s at 25 Hz
    again = [pd.DataFrame(np.array(table), columns=table.columns) for _ in range(2)]
    long = pd.concat(again, ignore_index=True)
    long["time"] = np.arange(len(long)) / 25.0
    long.to_csv(tmp_path / "log.csv", index=False)
    robot = campaign.parent / "robot_declared.toml"
    found = command("import", tmp_path / "log.csv", "--robot", robot, "--out", tmp_path / "imported")
    assert found.status == 0 and "parameters will be uncertain" in found.out
    for name in ("identify", "close-loop"):
        found = command(name, tmp_path / "imported" / "campaign.toml", "--out", tmp_path / name)
        assert found.status in (0, 1) and found.err == ""


# ---- the places of output -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x" * 300, "x" * 5000], ids=len)
def test_a_name_too_long_for_any_file_is_one_line(campaign: Path, command: Command, tmp_path: Path, name: str) -> None:
    assert "too long" in refused(command, tmp_path, "identify", campaign, "--out", tmp_path / name)
    assert "too long" in refused(command, tmp_path, "identify", tmp_path / name, "--out", tmp_path / "out")
    assert "too long" in refused(command, tmp_path, "flexify", "rx90b_3dof", "--out", tmp_path / f"{name}.urdf")


def test_a_path_through_a_file_and_a_dangling_link_are_one_line(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    through, link = campaign / "out", tmp_path / "link"
    link.symlink_to(tmp_path / "nowhere")
    for out in (through, link):
        for arguments in (["identify", campaign], ["demo"], ["check-path", "line"], ["excite", "rx90b_3dof"]):
            assert str(out) in refused(command, tmp_path, *arguments, "--out", out)


FILE_COMMANDS = (
    ("flexify", "robot_declared.toml"),
    ("view", "robot_declared.toml", "--flexible"),
    ("export", "rx90b_rigid", "--format", "urdf"),
)


@pytest.mark.parametrize("words", FILE_COMMANDS, ids=lambda words: words[0])
def test_a_file_never_takes_the_place_of_what_is_none_or_of_what_is_read(
    campaign: Path, command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: Sequence[str]
) -> None:
    monkeypatch.chdir(campaign.parent)
    os.mkfifo("pipe")  # as a device is
    Path("link").symlink_to("nowhere")
    own = ("robot_declared.toml", "two_joints.urdf") if words[1] in os.listdir() else ()
    for out in (".", "pipe", "link", "campaign.toml/x.urdf", *own):
        assert out in refused(command, tmp_path, *words, "--out", out)
    assert stat.S_ISFIFO(os.stat("pipe").st_mode)


def test_an_import_never_takes_the_place_of_a_log_that_it_reads(
    campaign: Path, command: Command, tmp_path: Path
) -> None:
    folder = campaign.parent
    (folder / "campaign.toml").unlink()
    logs, robot = [folder / "log_1.csv", folder / "log_2.csv"], folder / "robot_declared.toml"
    said = refused(
        command, tmp_path, "import", *logs, "--robot", robot, "--format", "csv", "--out", folder, "--overwrite"
    )
    assert "log_1.csv, which this run reads" in said


def test_a_full_device_for_what_is_printed_is_said(campaign: Path, tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", "from rx90b_flex.cli import main; main()", "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "No space left" in done.stderr
