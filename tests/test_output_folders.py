"""Folders that exist: earlier results are replaced as a whole, other things left alone; what killed runs leave goes with the next."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from test_cli import write_campaign

from rx90b_flex import cli
from rx90b_flex.signals.folders import (
    CAMPAIGN,
    CLOSED_LOOP,
    PATH_CHECK,
    RUN,
    Output,
    check_folder,
    files_read,
    fill_folder,
)
from rx90b_flex.signals.single import check_file


def writes(**files: str):  # type: ignore[no-untyped-def]
    """What fills a folder with files; a name with a slash in it makes a folder, too."""

    def fill(at: Path) -> None:
        for name, text in files.items():
            path = at / name.replace("__", "/").replace("_dot_", ".")
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)

    return fill


FIRST = writes(closed_loop_dot_json="1", report_dot_html="1", prediction_old_dot_csv="1")
SECOND = writes(closed_loop_dot_json="2", report_dot_html="2", prediction_new_dot_csv="2")


def tree(folder: Path) -> dict[str, str | None]:
    """Names and contents of everything in a folder, hidden things too; links as they are."""
    return {
        str(p.relative_to(folder)): os.readlink(p) if p.is_symlink() else p.read_text() if p.is_file() else None
        for p in sorted(folder.rglob("*"))
    }


def test_the_predictions_of_an_earlier_campaign_go_and_notes_stay(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fill_folder(out, FIRST, CLOSED_LOOP)
    (out / "notes.txt").write_text("mine")
    fill_folder(out, SECOND, CLOSED_LOOP)
    assert tree(tmp_path) == {
        "out": None, "out/closed_loop.json": "2", "out/notes.txt": "mine", "out/prediction_new.csv": "2", "out/report.html": "2",
    }  # fmt: skip


def test_folders_in_a_result_are_replaced_with_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fill_folder(
        out, writes(path_check_dot_json="1", corrected__tip_dot_csv="1", as_planned__tip_dot_csv="1"), PATH_CHECK
    )
    fill_folder(out, writes(path_check_dot_json="2", as_planned__tip_dot_csv="2"), PATH_CHECK)
    assert tree(out) == {"as_planned": None, "as_planned/tip.csv": "2", "path_check.json": "2"}


def test_the_result_of_another_command_with_names_in_common_goes_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fill_folder(out, writes(path_check_dot_json="1", report_dot_html="1", seam_dot_csv="1"), PATH_CHECK)
    fill_folder(out, SECOND, CLOSED_LOOP)
    assert sorted(tree(out)) == ["closed_loop.json", "prediction_new.csv", "report.html"]


def in_the_way_a_report(out: Path) -> None:
    (out / "report.html").write_text("mine")


def in_the_way_a_folder(out: Path) -> None:
    (out / "closed_loop.json").write_text("1")
    (out / "report.html").mkdir()
    (out / "report.html" / "x").write_text("mine")


def in_the_way_a_dangling_link(out: Path) -> None:
    (out / "closed_loop.json").write_text("1")
    (out / "report.html").symlink_to("nowhere")


@pytest.mark.parametrize("put", [in_the_way_a_report, in_the_way_a_folder, in_the_way_a_dangling_link])
def test_what_no_command_wrote_is_in_the_way_until_told_to_overwrite(tmp_path: Path, put) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "out"
    out.mkdir()
    put(out)
    before = tree(tmp_path)
    for refuses in (lambda: check_folder(out, CLOSED_LOOP), lambda: fill_folder(out, SECOND, CLOSED_LOOP)):
        with pytest.raises(ValueError, match=r"report\.html.*--overwrite") as caught:
            refuses()
        assert str(out) in str(caught.value)
    assert tree(tmp_path) == before
    check_folder(out, CLOSED_LOOP, overwrite=True)
    fill_folder(out, SECOND, CLOSED_LOOP, overwrite=True)
    assert sorted(tree(tmp_path)) == ["out", "out/closed_loop.json", "out/prediction_new.csv", "out/report.html"]


def test_the_recordings_of_an_earlier_simulation_go_with_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    one = writes(
        state_dot_parquet="1", line_dot_parquet="1", campaign_dot_toml='[[recording]]\nfile = "line.parquet"\n'
    )
    two = writes(
        state_dot_parquet="2", wave_dot_parquet="2", campaign_dot_toml='[[recording]]\nfile = "wave.parquet"\n'
    )
    fill_folder(out, one, RUN)
    (out / "mine.parquet").write_text("mine")
    fill_folder(out, two, RUN)
    assert sorted(tree(out)) == ["campaign.toml", "mine.parquet", "state.parquet", "wave.parquet"]


def test_a_campaign_is_never_replaced_untold(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fill_folder(out, writes(campaign_dot_toml="1", run_dot_csv="1"), CAMPAIGN)
    with pytest.raises(ValueError, match=r"campaign\.toml.*--overwrite"):
        fill_folder(out, writes(campaign_dot_toml="2", other_dot_csv="2"), CAMPAIGN)
    assert tree(out) == {"campaign.toml": "1", "run.csv": "1"}


def test_what_a_run_reads_is_not_replaced_by_what_it_writes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fill_folder(out, writes(state_dot_parquet="1", campaign_dot_toml="1", robot_dot_toml="1"), RUN)
    with pytest.raises(ValueError, match=r"campaign\.toml, which this run reads"):
        check_folder(out, CLOSED_LOOP, reads=[out / "campaign.toml"])
    check_folder(tmp_path / "other", CLOSED_LOOP, reads=[out / "campaign.toml"])


def test_nothing_that_a_campaign_names_is_replaced(tmp_path: Path) -> None:
    """Its robot file, which has the name of a result's, with URDF and controller, and a recording, also by --overwrite."""
    (tmp_path / "robot.toml").write_text('urdf = "robot.urdf"\ncontroller = "own.toml"\n')
    for name in ("robot.urdf", "own.toml", "prediction_test.csv"):
        (tmp_path / name).write_text("1")
    campaign = tmp_path / "mine.toml"
    campaign.write_text('robot = "robot.toml"\n[[recording]]\nfile = "prediction_test.csv"\n')
    reads = files_read(campaign)
    assert {p.name for p in reads} == {"mine.toml", "robot.toml", "robot.urdf", "own.toml", "prediction_test.csv"}
    with pytest.raises(ValueError, match="which this run reads; give another folder"):
        check_folder(tmp_path, CLOSED_LOOP, overwrite=True, reads=reads)
    for read in reads:
        with pytest.raises(ValueError, match="is what this run reads"):
            check_file(read, campaign)
    assert files_read(tmp_path / "robot.urdf") == [tmp_path / "robot.urdf"]


def test_a_page_does_not_replace_a_file_of_the_run_that_it_shows(tmp_path: Path) -> None:
    run = tmp_path / "run"
    listed = '[[recording]]\nfile = "line.parquet"\n'
    fill_folder(run, writes(state_dot_parquet="1", line_dot_parquet="1", campaign_dot_toml=listed), RUN)
    for name in ("state.parquet", "line.parquet", "campaign.toml"):
        with pytest.raises(ValueError, match="is what this run reads"):
            check_file(run / name, run)
    check_file(run / "view.html", run)


COMMANDS = {  # that write one file, and the first element of what they write
    "flexify rx90b_3dof": "robot",
    "export rx90b_3dof --format urdf": "robot",
    "export rx90b_3dof --format mjcf": "mujoco",
    "export rx90b_3dof --format sdf": "sdf",
    "view rx90b_3dof --count 1": "html",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_of_another_kind_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    out, kind = tmp_path / "out", COMMANDS[command]

    def run() -> int:
        monkeypatch.setattr("sys.argv", ["rx90b-flex", *command.split(), "--out", str(out)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return int(ended.value.code or 0)

    for text in ("notes of a year\n", "<svg/>", f"\n# <{kind}>"):
        out.write_text(text)
        assert run() == 2
        assert f"{out}: a file that does not begin with <{kind}> is there" in capsys.readouterr().err
        assert out.read_text() == text and list(tmp_path.iterdir()) == [out]
    mine = f"\ufeff<?xml version='1.0'?>\n<!-- mine -->\n<{kind.upper()} name='a'/>"
    if kind == "html":  # any report is one, too
        out.write_text(mine)
        assert run() == 2 and "a page that is no scene of rx90b-flex view is there" in capsys.readouterr().err
        mine += '<meta name="generator" content="scene of rx90b-flex view">'
    for text in ("", mine):
        out.write_text(text)
        assert run() == 0
    assert run() == 0 and f"<{kind}" in out.read_text()  # over a file of its own


def test_a_link_to_nothing_is_no_folder_and_one_to_a_folder_is(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with pytest.raises(ValueError, match=r"link.*does not exist"):
        fill_folder(tmp_path / "link", SECOND, CLOSED_LOOP)
    assert tree(tmp_path) == {"link": str(tmp_path / "there")}
    (tmp_path / "there").mkdir()
    fill_folder(tmp_path / "link", SECOND, CLOSED_LOOP)
    assert (tmp_path / "there" / "closed_loop.json").read_text() == "2"


@pytest.mark.parametrize(
    "name", ["x" * 250, "x" * 300, "x" * 5000, "file/out", "file/a/b"], ids=lambda n: n[:8] + str(len(n))
)
def test_a_place_that_cannot_be_is_one_line(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("mine")
    for refuses in (lambda out: check_folder(out, CLOSED_LOOP), lambda out: fill_folder(out, SECOND, CLOSED_LOOP)):
        with pytest.raises(ValueError) as caught:
            refuses(tmp_path / name)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
    assert tree(tmp_path) == {"file": "mine"}


def test_a_folder_can_be_filled_within_one_that_is_being_filled(tmp_path: Path) -> None:
    def fill(at: Path) -> None:
        FIRST(at)
        fill_folder(at, SECOND, CLOSED_LOOP)
        fill_folder(at / "within", FIRST, CLOSED_LOOP)

    fill_folder(tmp_path / "out", fill, CLOSED_LOOP)
    assert (tmp_path / "out" / "closed_loop.json").read_text() == "2"
    assert not [p for p in tmp_path.rglob(".*")]


def test_a_failure_while_results_are_put_in_place_brings_the_earlier_ones_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    fill_folder(out, FIRST, CLOSED_LOOP)
    before = tree(tmp_path)
    real, calls = os.replace, [0]
    for fails_at in range(1, 7):
        calls[0] = 0

        def fails(a: object, b: object, at: int = fails_at) -> None:
            calls[0] += 1
            if calls[0] == at:
                raise OSError(28, "No space left on device")
            real(a, b)  # type: ignore[arg-type]

        monkeypatch.setattr(os, "replace", fails)
        with pytest.raises(ValueError, match=r"out: cannot be written: No space left on device"):
            fill_folder(out, SECOND, CLOSED_LOOP)
        assert tree(tmp_path) == before


# ---- killed runs and runs beside each other -------------------------------------------------------------------

KILLED = """
import os, signal, sys, time
from pathlib import Path
from rx90b_flex.signals.folders import CLOSED_LOOP, fill_folder
def fill(at):
    (at / "closed_loop.json").write_text("half")
    print("filling", flush=True)
    time.sleep(600)
fill_folder(Path(sys.argv[1]), fill, CLOSED_LOOP)
"""


@pytest.mark.parametrize("exists", [False, True], ids=["new", "replaced"])
def test_what_a_killed_run_leaves_goes_with_the_next_and_a_running_one_is_left_alone(
    tmp_path: Path, exists: bool
) -> None:
    out = tmp_path / "out"
    if exists:
        fill_folder(out, FIRST, CLOSED_LOOP)
    with subprocess.Popen([sys.executable, "-c", KILLED, str(out)], stdout=subprocess.PIPE) as run:
        assert run.stdout is not None
        run.stdout.readline()
        home = out if exists else tmp_path
        left = [p for p in home.iterdir() if p.name.startswith(".out-")]
        assert len(left) == 1
        fill_folder(tmp_path / "out-of-this", FIRST, CLOSED_LOOP)
        assert left[0].is_dir()  # it is being filled
        run.send_signal(signal.SIGKILL)
        run.wait()
    assert left[0].is_dir() and (not exists or (out / "closed_loop.json").read_text() == "1")
    fill_folder(out, SECOND, CLOSED_LOOP)
    assert sorted(tree(out)) == ["closed_loop.json", "prediction_new.csv", "report.html"]
    assert not [p for p in tmp_path.rglob(".*")]


def test_a_folder_that_only_looks_like_what_a_killed_run_leaves_stays(tmp_path: Path) -> None:
    (tmp_path / ".out-backup").mkdir()
    fill_folder(tmp_path / "out", FIRST, CLOSED_LOOP)
    assert (tmp_path / ".out-backup").is_dir()


PLACE = """
import os, sys
from pathlib import Path
from rx90b_flex.signals import folders
real, count = os.replace, 0
def dies(a, b):
    global count
    count += 1
    if count == int(sys.argv[2]):
        os.kill(os.getpid(), 9)
    real(a, b)
os.replace = dies
def fill(at):
    for name in ("closed_loop.json", "report.html", "prediction_new.csv"):
        (at / name).write_text("2")
folders.fill_folder(Path(sys.argv[1]), fill, folders.CLOSED_LOOP)
"""


@pytest.mark.parametrize("at", range(1, 7))
def test_a_run_killed_while_it_replaces_results_leaves_none_that_is_half_of_each(tmp_path: Path, at: int) -> None:
    out = tmp_path / "out"
    fill_folder(out, FIRST, CLOSED_LOOP)
    ended = subprocess.run([sys.executable, "-c", PLACE, str(out), str(at)], check=False)
    assert ended.returncode == -signal.SIGKILL
    seen = {p.name: p.read_text() for p in out.iterdir() if p.is_file()}
    if "closed_loop.json" in seen:  # the mark: whatever lies beside it belongs to it
        assert set(seen.values()) == {seen["closed_loop.json"]}
    fill_folder(out, SECOND, CLOSED_LOOP)
    assert tree(out) == {"closed_loop.json": "2", "prediction_new.csv": "2", "report.html": "2"}


def test_of_runs_with_one_folder_at_once_the_last_stays_whole(tmp_path: Path) -> None:
    out, barrier = tmp_path / "out", threading.Barrier(8)
    output = Output("mark", ("part_*",))

    def run(number: int) -> None:
        def fill(at: Path) -> None:
            for name in ("mark", f"part_{number}", "part_x"):
                (at / name).write_text(str(number))
            barrier.wait(60)
            time.sleep(0.001 * number)

        fill_folder(out, fill, output)

    threads = [threading.Thread(target=run, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    left = tree(out)
    assert len(set(left.values())) == 1 and sorted(left) == ["mark", f"part_{left['mark']}", "part_x"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def _mounts() -> bool:
    """Whether this user may mount something in a name space of its own."""
    tried = ["unshare", "-rm", "mount", "-t", "tmpfs", "-o", "ro", "none", "/mnt"]
    return bool(shutil.which("unshare")) and subprocess.run(tried, capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(not _mounts(), reason="nothing may be mounted read-only here")
@pytest.mark.parametrize(
    "command", ["check {campaign} --out {out}", "excite rx90b_3dof --out {out}", "view rx90b --out {out}.html"]
)
def test_a_disk_that_is_mounted_to_be_read_is_refused_before_any_work(tmp_path: Path, command: str) -> None:
    campaign = write_campaign(tmp_path)
    (tmp_path / "disk").mkdir()
    line = command.format(campaign=campaign, out=tmp_path / "disk" / "out")
    script = f"mount -t tmpfs -o ro none {tmp_path / 'disk'} && exec {sys.executable} -m rx90b_flex {line}"
    ended = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1, ended.stderr
    assert f"{tmp_path / 'disk' / 'out'}" in ended.stderr and "Read-only file system" in ended.stderr


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a place where nothing can be made is asked of Linux")
def test_a_place_where_nothing_can_be_made_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match=r"^/proc/x: cannot be written"):
        check_folder(Path("/proc/x"), CLOSED_LOOP)
    with pytest.raises(ValueError, match=r"^/proc/x\.html: cannot be written"):
        check_file(Path("/proc/x.html"))
