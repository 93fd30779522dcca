"""Claims about what ``import rx90b_flex as rf`` offers: verbs are functions, nothing else shows, and each example runs as printed."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from test_cli import write_campaign

import rx90b_flex as rf

VERBS = (
    "check",
    "check_path",
    "close_loop",
    "close_loop_many",
    "excite",
    "export_robot",
    "frf",
    "identify",
    "simulate",
    "view",
)
# excite writes what frf reads; both take a simulation
QUICK = (
    "load_robot",
    "check",
    "check_path",
    "close_loop",
    "close_loop_many",
    "export_robot",
    "identify",
    "simulate",
    "view",
)


@pytest.mark.parametrize("name", [*VERBS, "load_robot", "drive_parameters", "replay_errors"])
def test_a_verb_is_a_function_with_words_of_its_own(name: str) -> None:
    assert inspect.isfunction(getattr(rf, name))
    assert len((getattr(rf, name).__doc__ or "").split()) > 10


def test_dir_shows_the_public_names_and_nothing_else() -> None:
    assert sorted(dir(rf)) == sorted(rf.__all__)
    assert all(hasattr(rf, name) for name in dir(rf))
    others = [n for n in dir(rf) if n not in VERBS and inspect.isfunction(getattr(rf, n))]
    assert others == ["drive_parameters", "load_robot", "replay_errors"]


@pytest.mark.parametrize("name", ["identify", "simulate", "view"])
def test_a_verb_stays_one_whatever_is_imported_before(name: str) -> None:
    """The package has folders of these names, and an import puts a folder's module under its name."""
    inside = {"identify": "camera", "simulate": "closed_loop", "view": "page"}[name]
    code = (
        f"import rx90b_flex.{name}.{inside}\nimport rx90b_flex as rf, inspect, importlib\n"
        f"assert inspect.isfunction(rf.{name})\nimportlib.import_module('rx90b_flex.{name}')\nassert inspect.isfunction(rf.{name})\n"
        f"assert rx90b_flex.{name}.{inside}.__name__ == 'rx90b_flex.{name}.{inside}'\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert importlib.import_module(f"rx90b_flex.{name}").__name__ == f"rx90b_flex.{name}"


def test_verbs_go_to_other_processes() -> None:
    for name in VERBS:
        function = getattr(rf, name)
        assert pickle.loads(pickle.dumps(function)) is function


def run_examples(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As printed, from `folder`."""
    function = getattr(rf, name)
    (example,) = (t for t in doctest.DocTestFinder(recurse=False).find(function, name, globs={}) if t.examples)
    assert any(f"rf.{name}(" in e.source for e in example.examples)
    assert not any(e.options for e in example.examples), "no example is skipped"
    monkeypatch.chdir(folder)
    runner = doctest.DocTestRunner(optionflags=doctest.REPORT_ONLY_FIRST_FAILURE)
    said: list[str] = []
    runner.run(example, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a campaign of two joints, whose elbow has a constant torque that its file does not declare."""
    at = tmp_path_factory.mktemp("examples")
    write_campaign(at)
    return at


@pytest.mark.parametrize("name", QUICK)
def test_the_example_in_the_docstring_runs(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_examples(name, folder, monkeypatch)


@pytest.mark.slow
def test_the_examples_of_excite_and_frf_run_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_examples("excite", tmp_path, monkeypatch)
    run_examples("frf", tmp_path, monkeypatch)
