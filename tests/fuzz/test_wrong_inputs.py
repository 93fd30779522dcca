"""Whatever is wrong with an input: status 2, one or two lines that name it, nothing written, no word of a library; or a result."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

import pytest
import typer.main
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from test_cli import tree
from wrong_inputs import CALLS, SLOW_CALLS, Call, Case, cases, laid_out, write_inputs

from rx90b_flex import cli
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs") / "data"
    write_inputs(folder)
    return folder


def called(words: list[str]) -> tuple[int, str, str]:
    """Status and output of the command line, in this process, with what libraries write past Python."""
    kept = [os.dup(1), os.dup(2)]
    sys.stdout.flush()
    sys.stderr.flush()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        before, sys.argv = sys.argv, ["rx90b-flex", *words]
        streams = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = os.fdopen(os.dup(1), "w"), os.fdopen(os.dup(2), "w")
        status = -1
        try:
            cli.main()
        except SystemExit as end:
            status = int(end.code or 0)
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.close()
            sys.stdout, sys.stderr = streams
            sys.argv = before
            for number, fd in enumerate(kept, start=1):
                os.dup2(fd, number)
                os.close(fd)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode(errors="replace"))
    return status, texts[0], texts[1]


def no_number(word: str) -> None:
    """What JSON has no word for."""
    pytest.fail(f"a result holds {word}")


def check_result(case: Case, status: int, out: Path) -> None:
    """What was written can be used: JSON without nan, robots and campaigns that load."""
    for path in out.rglob("*.json") if out.is_dir() else ():
        json.loads(path.read_text(), parse_constant=no_number)
    if case.call.words[0] == "import":
        load_campaign(out / "campaign.toml")
    elif case.call.words[0] in ("identify", "simulate") and status == 0:
        load_robot(out / "robot.toml")


def judged(case: Case, inputs: Path) -> None:
    """The oracle."""
    home = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        laid_out(case, inputs, home / "data")
        before = tree(home)
        here = os.getcwd()
        os.chdir(home / "data")
        try:
            status, said, complained = called([*case.call.words, "--out", str(home / case.call.out), *case.words])
        finally:
            os.chdir(here)
        lines = complained.splitlines()
        if status == 2:
            assert 1 <= len(lines) <= 2 and said == "", (said, complained)
            assert lines[0].startswith("rx90b-flex: ") and "Traceback" not in complained, complained
            assert tree(home) == before
            if case.file is not None:
                named = {case.file, *case.call.words, "nowhere", "robot_declared"}  # the robot's file leads to the URDF
                assert any(Path(name).stem in complained for name in named), complained
            else:
                option, _, value = case.words[0].partition("=")
                meant = (
                    option.split("-")[2],
                    value or "''",
                    "band",
                    *(Path(name).stem for name in case.call.words[1:2]),
                )
                assert any(word[:200] in complained for word in meant), complained
        else:
            assert status in (0, 1), (status, complained)
            assert complained == "", complained
            check_result(case, status, home / case.call.out)
    finally:
        shutil.rmtree(home)


PARTS = [pytest.param(0, 40, CALLS, id="40")] + [
    pytest.param(part, 500, (*CALLS * 4, *SLOW_CALLS), id=f"2000, part {part}", marks=mark)
    for part, mark in enumerate([pytest.mark.slow] + [pytest.mark.long] * 3, start=1)
]


@pytest.mark.parametrize(("part", "examples", "calls"), PARTS)
def test_a_wrong_input_is_refused_in_a_line_or_gives_a_result(
    inputs: Path, monkeypatch: pytest.MonkeyPatch, part: int, examples: int, calls: tuple[Call, ...]
) -> None:
    monkeypatch.setattr(typer.main, "get_command", cache(typer.main.get_command))  # 20 ms a case

    @seed(part)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
    )
    @given(st.data())
    def run(data: st.DataObject) -> None:
        judged(data.draw(cases(inputs, calls)), inputs)

    run()
