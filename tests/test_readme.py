"""Claims that the README's table of commands is as printed: each row runs, in their order, and leaves what it says."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_cli import Command, write_campaign
from test_first_hour import write_logs
from test_measured_stiffness import write_markers, write_test

import rx90b_flex as rf
from rx90b_flex.path import load_seam
from rx90b_flex.robot import robots_folder

README = Path(__file__).resolve().parents[1] / "README.md"
# minutes; and what reads what they leave
SLOW = (
    "check-path line --robot rx90b_4dof --out",
    "excite",
    "frf",
    "close-loop motors",
    "close-loop modes",
    "close-loop r1",
)


def rows() -> list[list[str]]:
    """Every command in the table, in its order."""
    table = README.read_text(encoding="utf-8").split("| to | run | takes |", 1)[1].split("\n\n", 1)[0]
    return [shlex.split(code)[1:] for code in re.findall(r"`(rx90b-flex [^`]+)`", table)]


def is_slow(words: list[str]) -> bool:
    return " ".join(words).startswith(SLOW)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a reader has before the first row: logs with a URDF, a campaign, modes, dead-weight tests, markers, a measured tip."""
    write_logs(tmp_path)
    (tmp_path / "my_robot.toml").write_text('urdf = "robot.urdf"\n')
    written = write_campaign(tmp_path / "written")
    for file in written.parent.iterdir():
        shutil.copy(file, tmp_path)
    if written.name != "campaign.toml":
        (tmp_path / written.name).rename(tmp_path / "campaign.toml")
    for name in ("r1", "r2", "r3"):
        shutil.copy(tmp_path / "campaign.toml", tmp_path / f"{name}.toml")
    shutil.copy(robots_folder() / "rx90b_table_6_4.toml", tmp_path / "modes.toml")
    file = write_test(tmp_path, "joint_2", 2.0e5, 1.0, np.random.default_rng(0))
    (tmp_path / "tests.toml").write_text(f'[[test]]\ncoordinate = "joint_2"\nfile = "{file}"\nlever_arm_m = 1.0\n')
    write_markers(tmp_path, rf.load_robot("rx90b_4dof"), "joint_2", 0)
    pieces = load_seam("line").pieces
    place, _ = pieces.at(np.linspace(0.0, pieces.total, 500))
    pd.DataFrame(dict(zip("xyz", place.T, strict=True))).to_csv(tmp_path / "tip.csv", index=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


def run(words: list[str], folder: Path, command: Command) -> None:
    found = command(*words)
    # check-path says by its status whether the tip keeps within the tolerance
    assert found.status in ((0, 1) if words[0] == "check-path" else (0,)), f"{words}: {found.err}"
    out = folder / words[words.index("--out") + 1]
    assert out.is_file() or any(out.iterdir()), words


@pytest.mark.slow
def test_the_rows_run_as_printed(folder: Path, command: Command) -> None:
    quick = [words for words in rows() if not is_slow(words)]
    assert len(quick) >= 10
    for words in quick:
        run(words, folder, command)


@pytest.mark.slow
@pytest.mark.long
def test_the_rows_that_take_minutes_run_as_printed(folder: Path, command: Command) -> None:
    slow = [words for words in rows() if is_slow(words)]
    # a row on what another one writes stands above it where both are about the same task
    order = ("check-path", "excite", "frf", "close-loop")
    for words in sorted(slow, key=lambda w: order.index(w[0])):
        run(words, folder, command)


def test_every_command_has_a_row() -> None:
    from typer.main import get_command

    from rx90b_flex.cli import app

    assert {words[0] for words in rows()} | {"demo"} == set(get_command(app).commands)  # type: ignore[attr-defined]
