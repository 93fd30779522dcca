"""Claims about what somebody meets first: versions, help, names that are nearly right, how to cite and to contribute."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from test_cli import Command
from typer.main import get_command

import rx90b_flex as rf
from rx90b_flex.cli import app

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


def test_the_version_is_that_of_the_package(command: Command) -> None:
    found = command("--version")
    assert (found.status, found.out, found.err) == (0, f"rx90b-flex {rf.__version__}\n", "")


@pytest.mark.parametrize("name", ["", *sorted(get_command(app).commands)])  # type: ignore[attr-defined]
def test_help_says_no_type_where_there_is_nothing_to_write(name: str, command: Command) -> None:
    found = command(*name.split(), "--help")
    assert (found.status, found.err) == (0, "")
    assert "bool" not in found.out


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("ur5", "example-robot-data:ur5"),
        ("pandas", "example-robot-data:panda"),
        ("xarm", "example-robot-data:xarm7"),
        ("rx9", "'rx90b'"),
        ("kuka", "example-robot-data:NAME"),
    ],
)
def test_a_robot_that_is_unknown_leads_to_those_there_are(name: str, near: str) -> None:
    with pytest.raises(ValueError) as error:
        rf.load_robot(name)
    assert near in str(error.value) and "\n" not in str(error.value)


def test_the_citation_is_of_this_version_and_licence() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    own = project["license"].split(" AND ")[0]  # after it those of what the package carries
    for key, value in (("version", project["version"]), ("license", own)):
        assert re.search(rf"^{key}: {re.escape(value)}$", text, re.MULTILINE)


def test_what_the_contribution_page_names_is_there() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w./]+/[\w./]*|[A-Z]+\.md)`", text)
    assert len(named) >= 5
    for path in named:
        assert (ROOT / path).exists(), path
