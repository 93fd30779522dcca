"""Claims about the command line: what it writes, and that bad input is one line, status 2 and nothing written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import independent as ind
import numpy as np
import pinocchio as pin
import pytest

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.commands.shared import show_table

RATE_HZ, CUTOFF_HZ = 100.0, 10.0
DECLARED = [{"type": t, "joint": j} for j in ("shoulder", "elbow") for t in ("coulomb_friction", "viscous_friction")]


def write_campaign(folder: Path) -> Path:
    """An arm of two joints with a constant torque at the elbow that its file does not declare."""
    folder.mkdir(exist_ok=True)
    arm, rng = ind.two_joints(folder), np.random.default_rng(1)
    torques = [ind.friction((2.0, 1.0), (3.0, 1.5)), ind.hidden("torque_offset", 1, {"torque": 0.7})]
    motions = [ind.harmonics(rng, 2, period_s=6.0, rate_hz=RATE_HZ) for _ in range(2)]
    runs = [
        ind.run(arm, role, m, torques, ind.white(rng, len(m.time), (0.2, 0.08)))
        for role, m in zip(("identification", "validation"), motions, strict=True)
    ]
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return write_campaign(tmp_path / "data")


@dataclass(frozen=True)
class Outcome:
    """What a command left: its exit status and what it printed."""

    status: int
    out: str
    err: str


class Command:
    """Calls the command line as the shell would, in this process."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capfd = monkeypatch, capfd

    def __call__(self, *arguments: object) -> Outcome:
        self._monkeypatch.setattr(sys, "argv", ["rx90b-flex", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        return Outcome(int(caught.value.code or 0), *self._capfd.readouterr())


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


def tree(folder: Path) -> dict[str, bytes | None]:
    """Every file with its content, and every folder, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


# ---- bad input ----------------------------------------------------------------------------------------------


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def rows(path: Path) -> list[str]:
    return path.read_text().splitlines()


def missing_column(folder: Path) -> None:
    edit(folder / "log_2.csv", "moment_1", "moment_9")


def wrong_number_of_joints(folder: Path) -> None:
    edit(folder / "campaign.toml", '["angle_0", "angle_1"]', '["angle_0"]')


def unknown_joint(folder: Path) -> None:
    edit(folder / "campaign.toml", '["shoulder", "elbow"]', '["shoulder", "wrist"]')


def not_a_number(folder: Path) -> None:
    lines = rows(folder / "log_1.csv")
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:2], "nan", *cells[3:]])
    (folder / "log_1.csv").write_text("\n".join(lines))


def text_in_a_cell(folder: Path) -> None:
    lines = rows(folder / "log_1.csv")
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:2], "bad", *cells[3:]])
    (folder / "log_1.csv").write_text("\n".join(lines))


def shuffled_time(folder: Path) -> None:
    lines = rows(folder / "log_1.csv")
    lines[20], lines[21] = lines[21], lines[20]
    (folder / "log_1.csv").write_text("\n".join(lines))


def missing_samples(folder: Path) -> None:
    lines = rows(folder / "log_1.csv")
    (folder / "log_1.csv").write_text("\n".join(lines[:50] + lines[55:]))


def unknown_effect(folder: Path) -> None:
    edit(folder / "robot_declared.toml", '"coulomb_friction"', '"coulom_friction"')


def unreadable_urdf(folder: Path) -> None:
    (folder / "two_joints.urdf").write_text("<robot name='two_joints'><link")


def missing_urdf(folder: Path) -> None:
    (folder / "two_joints.urdf").unlink()


def missing_robot(folder: Path) -> None:
    (folder / "robot_declared.toml").unlink()


def empty_file(folder: Path) -> None:
    (folder / "log_2.csv").write_text("")


def header_only(folder: Path) -> None:
    (folder / "log_2.csv").write_text(rows(folder / "log_2.csv")[0] + "\n")


def missing_file(folder: Path) -> None:
    (folder / "log_2.csv").unlink()


def shorter_than_the_filter(folder: Path) -> None:
    lines = rows(folder / "log_2.csv")
    (folder / "log_2.csv").write_text("\n".join(lines[:13]) + "\n")


def too_short_to_fit(folder: Path) -> None:
    lines = rows(folder / "log_1.csv")
    (folder / "log_1.csv").write_text("\n".join(lines[:25]) + "\n")


def too_short_to_hold_out_parts(folder: Path) -> None:
    lines = rows(folder / "log_1.csv")
    (folder / "log_1.csv").write_text("\n".join(lines[:100]) + "\n")


def no_validation(folder: Path) -> None:
    edit(folder / "campaign.toml", 'role = "validation"', 'role = "identification"')


def missing_campaign(folder: Path) -> None:
    (folder / "campaign.toml").unlink()


def campaign_that_is_no_toml(folder: Path) -> None:
    (folder / "campaign.toml").write_text("robot = = 3")


def campaign_that_is_empty(folder: Path) -> None:
    (folder / "campaign.toml").write_text("")


def no_torque_at_all(folder: Path) -> None:
    lines = rows(folder / "log_2.csv")
    (folder / "log_2.csv").write_text(
        "\n".join([lines[0], *(",".join([*line.split(",")[:3], "0", "0"]) for line in lines[1:])])
    )


BAD = {
    missing_column: ["log_2.csv", "moment_1"],
    wrong_number_of_joints: ["campaign.toml", "motor_position"],
    unknown_joint: ["campaign.toml", "wrist"],
    not_a_number: ["log_1.csv", "angle_1", "row 7"],
    text_in_a_cell: ["log_1.csv", "angle_1", "row 7"],
    shuffled_time: ["log_1.csv", "time", "row 21"],
    missing_samples: ["log_1.csv", "time", "row 50"],
    unknown_effect: ["robot_declared.toml", "effect 1", "coulom_friction", "did you mean 'coulomb_friction'?"],
    unreadable_urdf: ["robot_declared.toml", "two_joints.urdf"],
    missing_urdf: ["robot_declared.toml", "two_joints.urdf"],
    missing_robot: ["robot_declared.toml"],
    empty_file: ["log_2.csv", "empty"],
    header_only: ["log_2.csv", "no data rows"],
    missing_file: ["log_2.csv", "no such file"],
    shorter_than_the_filter: ["log_2.csv", "12 samples are too few"],
    too_short_to_fit: ["log_1.csv", "24 samples are too few"],
    too_short_to_hold_out_parts: ["campaign.toml", "identification", "0.99 s"],
    no_validation: ["campaign.toml", "validation"],
    missing_campaign: ["campaign.toml", "no such file"],
    campaign_that_is_no_toml: ["campaign.toml", "not a TOML file"],
    campaign_that_is_empty: ["campaign.toml", "missing"],
    no_torque_at_all: ["log_2.csv", "every torque is zero"],
}


@pytest.mark.parametrize(("spoil", "named"), BAD.items(), ids=[f.__name__ for f in BAD])
def test_bad_input_is_one_line_status_2_and_nothing_written(campaign, tmp_path, command, spoil, named):
    spoil(campaign.parent)
    before = tree(tmp_path)
    found = command("close-loop", campaign, "--out", tmp_path / "new" / "out")
    assert found.status == 2
    assert found.err.count("\n") == 1 and found.err.endswith("\n")
    for thing in named:
        assert thing in found.err
    assert found.out == ""
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", ["check", "identify", "close-loop"])
def test_an_empty_folder_name_is_refused(campaign, tmp_path, command, monkeypatch, name):
    """As a variable of a shell that is not set leaves it: nothing is written where the command is given."""
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    found = command(name, campaign, "--out", "")
    assert (found.status, found.err.count("\n")) == (2, 1)
    assert "'--out': is empty; expected a folder" in found.err
    assert tree(tmp_path) == before


def test_bad_input_leaves_earlier_results_as_they_are(campaign, tmp_path, command):
    out = tmp_path / "out"
    out.mkdir()
    (out / "closed_loop.json").write_text("earlier")
    not_a_number(campaign.parent)
    before = tree(tmp_path)
    assert command("close-loop", campaign, "--out", out).status == 2
    assert tree(tmp_path) == before


def test_an_output_folder_that_is_a_file_is_refused_and_the_file_kept(campaign, tmp_path, command):
    (tmp_path / "out").write_text("mine")
    before = tree(tmp_path)
    found = command("close-loop", campaign, "--out", tmp_path / "out")
    assert (found.status, found.err.count("\n")) == (2, 1)
    assert f"{tmp_path / 'out'}: is a file" in found.err
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", ["close-loop", "demo"])
def test_an_output_folder_below_a_file_is_refused_before_any_work(campaign, tmp_path, command, name, monkeypatch):
    (tmp_path / "file").write_text("mine")
    before = tree(tmp_path)
    arguments = [campaign] if name == "close-loop" else []
    monkeypatch.setattr("rx90b_flex.diagnose.close.close_loop", lambda *a, **k: pytest.fail("work was done"))
    found = command(name, *arguments, "--out", tmp_path / "file" / "out")
    assert (found.status, found.err.count("\n")) == (2, 1)
    assert str(tmp_path / "file") in found.err
    assert tree(tmp_path) == before


def test_a_failure_while_writing_leaves_nothing_and_keeps_earlier_results(campaign, tmp_path, command, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("earlier")
    before = tree(tmp_path)

    def full(*_: object) -> None:
        raise ValueError("report.html: disk full")

    monkeypatch.setattr("rx90b_flex.view.report.write_report", full)
    assert command("close-loop", campaign, "--out", out).status == 2
    assert command("close-loop", campaign, "--out", tmp_path / "new" / "out").status == 2
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["demo", "--hidden", "stribek_friction"], "did you mean 'stribeck_friction'?"),
        (["flexify", "rx90c"], "did you mean 'rx90b'?"),
        (["flexify", "rx90b", "--torsion", "joint_9"], "joint_9"),
    ],
)
def test_a_wrong_word_is_named_with_the_nearest_right_one(tmp_path, command, arguments, named):
    found = command(*arguments, "--out", tmp_path / "out")
    assert (found.status, found.err.count("\n"), named in found.err) == (2, 1, True)
    assert tree(tmp_path) == {}


# ---- what is written ----------------------------------------------------------------------------------------


def test_close_loop_writes_every_file_and_says_what_it_found(campaign, tmp_path, command):
    out = tmp_path / "new" / "out"
    found = command("close-loop", campaign, "--out", out)
    assert found.status == 0
    names = ["closed_loop.json", "motion.json", "prediction_log_2.csv", "report.html", "robot.toml", "robot.urdf"]
    assert sorted(p.name for p in out.iterdir()) == names
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["out"]
    content = json.loads((out / "closed_loop.json").read_text())
    assert [(e["type"], e["joint"]) for e in content["effects"]] == [("torque_offset", "elbow")]
    assert found.err == ""  # no bar and no empty line of one where nobody watches
    assert "torque_offset" in found.out and "elbow" in found.out and "explained" in found.out
    assert rf.load_robot(out / "robot.toml").joints == ("shoulder", "elbow")


def test_close_loop_replaces_its_own_files_and_keeps_others(campaign, tmp_path, command):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    (out / "closed_loop.json").write_text("earlier")
    assert command("close-loop", campaign, "--out", out).status == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert json.loads((out / "closed_loop.json").read_text())["schema"] == 1


def test_flexify_writes_a_urdf_with_the_virtual_joints_that_were_asked_for(tmp_path, command):
    path = tmp_path / "ur10.urdf"
    arguments = ["--torsion", "elbow_joint", "--bending", "elbow_joint", "--base"]
    assert command("flexify", "example-robot-data:ur10", "--out", path, *arguments).status == 0
    model = pin.buildModelFromUrdf(str(path))
    assert model.nv == 6 + 1 + 2 + 2
    assert sum(i.mass for i in model.inertias) == pytest.approx(
        sum(i.mass for i in ind.ur10().model.inertias), rel=1e-9
    )


def test_flexify_takes_the_flexibilities_that_a_robot_file_declares(tmp_path, command):
    path = tmp_path / "rx90b.urdf"
    assert command("flexify", "rx90b", "--out", path).status == 0
    assert pin.buildModelFromUrdf(str(path)).nv == rf.load_robot("rx90b").model.nv


@pytest.mark.parametrize("name", [[], ["close-loop"], ["demo"], ["flexify"]])
def test_help_names_every_argument(command, name):
    found = command(*name, "--help")
    assert (found.status, found.err) == (0, "")
    expected = {"": "close-loop", "close-loop": "CAMPAIGN", "demo": "--hidden", "flexify": "--torsion"}
    assert expected["".join(name)] in found.out
    assert "Traceback" not in found.out


def test_the_installed_command_fails_as_the_function_does(campaign, tmp_path):
    """Once through the shell's door: the entry point, and nothing on standard output."""
    script = Path(sys.executable).with_name("rx90b-flex")
    if not script.is_file():
        pytest.skip(f"the package is not installed beside {sys.executable}")
    empty_file(campaign.parent)
    done = subprocess.run(
        [script, "close-loop", campaign, "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "log_2.csv" in done.stderr
    assert not (tmp_path / "out").exists()


def test_names_in_a_table_are_not_cut(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    words = "coefficient 10.58 ± 0.45 N m (s/rad)^power, power 0.667 ± 0.023, turnover 0.000017 ± 0.000017 rad/s"
    rows = [("load_viscous_friction", "joint_2 + joint_3", words, "0.1416", "0.1347")]
    show_table("Effects", rows, ("found", "where", "values", "error before", "after"))
    shown = capsys.readouterr().out
    assert "load_viscous_friction" in shown and "0.1347" in shown and "…" not in shown
