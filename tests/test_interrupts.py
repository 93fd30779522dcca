"""An interrupt ends a command with status 130 and nothing written; a kill leaves nothing that passes for a result."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_cli import tree, write_campaign

from rx90b_flex.interrupts import calm, interruptible
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign, tables

COMMAND = [sys.executable, "-c", "from rx90b_flex.cli import main; main()"]
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


def test_an_interrupt_that_somebody_swallows_comes_again() -> None:
    times = 0
    with pytest.raises(KeyboardInterrupt), interruptible():
        signal.raise_signal(signal.SIGINT) if times else None
        while times < 3:  # as a library's import that tries one thing after another
            try:
                if times == 0:
                    os.kill(os.getpid(), signal.SIGINT)
                time.sleep(60)
            except KeyboardInterrupt:
                times += 1
        time.sleep(60)
    assert times == 3


def test_who_tidies_up_is_left_alone() -> None:
    with pytest.raises(KeyboardInterrupt), interruptible():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60)
        except KeyboardInterrupt:
            calm()
            time.sleep(1.2)
            raise


SWALLOWS = """
import sys, types, importlib.abc, importlib.machinery
class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path, target=None):
        return importlib.machinery.ModuleSpec(name, self) if name == "rx90b_flex.diagnose.close" else None
    def create_module(self, spec):
        return None
    def exec_module(self, module):
        import os, signal, time
        print("importing", flush=True)
        try:
            time.sleep(60)
        except BaseException:
            pass
        time.sleep(60)
sys.meta_path.insert(0, Finder())
from rx90b_flex.cli import main
main()
"""


HALF_LOADED = SWALLOWS.replace(
    "            pass\n        time.sleep(60)", "            raise NameError('_api') from None"
)


@pytest.mark.parametrize("source", [SWALLOWS, pytest.param(HALF_LOADED, marks=pytest.mark.slow)])
def test_an_interrupt_while_a_library_is_imported_ends_the_command(tmp_path: Path, source: str) -> None:
    campaign = write_campaign(tmp_path / "data")
    before = tree(tmp_path)
    arguments = [sys.executable, "-c", source, "close-loop", str(campaign), "--out", str(tmp_path / "out")]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None and run.stderr is not None
        run.stdout.readline()
        run.send_signal(signal.SIGINT)
        assert run.wait(60) == 130
        assert run.stderr.read() == "rx90b-flex: interrupted; nothing was written\n"
    assert tree(tmp_path) == before


# ---- at random instants ---------------------------------------------------------------------------------------


def commands(folder: Path) -> dict[str, list[str]]:
    """One call of each command that writes, without its --out."""
    campaign = write_campaign(folder / "data")
    return {
        "identify": ["identify", str(campaign)],
        "close-loop": ["close-loop", str(campaign)],
        "import": [
            "import",
            str(folder / "data" / "log_1.csv"),
            "--robot",
            str(folder / "data" / "robot_declared.toml"),
        ],
        "simulate": ["simulate", "rx90b_3dof", "--excitation"],
        "excite": ["excite", "rx90b_3dof", "--realisations", "2"],
        "check-path": [
            "check-path",
            "line",
            "--robot",
            "rx90b_3dof",
            "--speed-mm-s",
            "250",
            "--no-contributions",
            "--no-correct",
        ],
    }


def whole(name: str, out: Path) -> None:
    """What is there under its final name is all of a result."""
    if name in ("identify", "close-loop"):
        json.loads((out / {"identify": "identification.json", "close-loop": "closed_loop.json"}[name]).read_text())
        assert load_robot(out / "robot.toml").joints and (out / "report.html").read_text().rstrip().endswith("</html>")
        assert list(out.glob("prediction_*.csv"))
    elif name in ("import", "simulate"):
        assert load_campaign(out / "campaign.toml").recordings
    elif name == "excite":
        assert len(list((out / "references").rglob("*.csv"))) == 12 and (out / "campaign.toml").is_file()
    else:
        json.loads((out / "path_check.json").read_text())
        assert (out / "report.html").read_text().rstrip().endswith("</html>")


def killed(arguments: list[str], after_s: float, how: signal.Signals) -> int:
    with subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=ENVIRONMENT
    ) as run:
        time.sleep(after_s)
        run.send_signal(how)
        return run.wait(300)


@pytest.mark.long
@pytest.mark.parametrize("name", ["identify", "close-loop", "import", "simulate", "excite", "check-path"])
def test_killed_at_random_instants_no_half_of_a_result_is_taken_for_one_and_the_next_run_tidies_up(
    tmp_path: Path, name: str
) -> None:
    arguments = commands(tmp_path)[name]
    first, out = tmp_path / "first" / "out", tmp_path / "results" / "out"
    began = time.perf_counter()
    done = subprocess.run(
        [*COMMAND, *arguments, "--out", str(first)], capture_output=True, text=True, env=ENVIRONMENT, check=False
    )
    lasted = time.perf_counter() - began
    assert done.returncode in (0, 1), done.stderr
    rng = np.random.default_rng(len(name))
    # instants are drawn over the time that a run took; when exactly it is hit does not matter to the claim
    for instant in rng.uniform(0.1, 1.0, 20) * lasted:
        status = killed([*arguments, "--out", str(out)], float(instant), signal.SIGKILL)
        if out.exists():
            whole(name, out)
            if status == 0:
                for path in sorted(out.rglob("*"), reverse=True):
                    path.unlink() if not path.is_dir() else path.rmdir()
                out.rmdir()
    again = subprocess.run(
        [*COMMAND, *arguments, "--out", str(out), "--overwrite"],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        check=False,
    )
    assert again.returncode == done.returncode, again.stderr
    whole(name, out)
    assert [p.name for p in (tmp_path / "results").iterdir()] == ["out"]
    assert sorted(p.name for p in out.iterdir()) == sorted(p.name for p in first.iterdir())


@pytest.mark.long
@pytest.mark.parametrize("name", ["identify", "simulate", "excite"])
def test_interrupted_at_random_instants_it_ends_with_130_and_leaves_nothing(tmp_path: Path, name: str) -> None:
    arguments, out = commands(tmp_path)[name], tmp_path / "results" / "out"
    before = tree(tmp_path)
    began = time.perf_counter()
    subprocess.run(
        [*COMMAND, *arguments, "--out", str(tmp_path / "first")], capture_output=True, env=ENVIRONMENT, check=True
    )
    lasted = time.perf_counter() - began
    subprocess.run(["rm", "-r", str(tmp_path / "first")], check=True)
    rng = np.random.default_rng(len(name))
    for instant in rng.uniform(0.3, 0.8, 8) * lasted:
        status = killed([*arguments, "--out", str(out)], float(instant), signal.SIGINT)
        if status == 0:  # it was done before
            whole(name, out)
            subprocess.run(["rm", "-r", str(tmp_path / "results")], check=True)
        else:
            assert status in (130, -signal.SIGINT)  # the second: before the command line was loaded
        assert tree(tmp_path) == before


@pytest.mark.slow
def test_a_simulated_campaign_goes_on_where_it_was_killed(tmp_path: Path) -> None:
    script = """
import sys
from rx90b_flex.robot import load_robot
from rx90b_flex.simulate import load_cs8, run_campaign, section_662
robot = load_robot("rx90b_3dof")
plan = section_662(robot, load_cs8().for_joints(robot.joints), realisations=1, periods=1, method="perturbation")
result = run_campaign(plan, sys.argv[1], batch=1, progress=lambda text, part: print(text, flush=True))
print(len(result.done), len(result.resumed), flush=True)
"""
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
    ) as run:
        assert run.stdout is not None
        while not run.stdout.readline().startswith("3 of 6"):
            pass
        run.kill()
    kept = {p.name: p.read_bytes() for p in (tmp_path / "runs").glob("run_*.parquet")}
    assert len(kept) >= 3
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, env=ENVIRONMENT, check=True
    )
    total, resumed = map(int, done.stdout.splitlines()[-1].split())
    assert (total, resumed) == (6, len(kept))
    for name, content in kept.items():
        assert (tmp_path / "runs" / name).read_bytes() == content
    assert len(load_campaign(tmp_path / "campaign.toml").recordings) == 6
    assert not [p for p in tmp_path.rglob(".*")]


# ---- a full disk ----------------------------------------------------------------------------------------------

FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
size = int(sys.argv.pop(1))
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
from rx90b_flex.cli import main
main()
"""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("import", marks=pytest.mark.slow),
        *(pytest.param(n, marks=pytest.mark.long) for n in ("identify", "close-loop", "simulate", "excite")),
    ],
)
def test_a_disk_that_is_full_at_any_size_of_file_is_one_line_and_leaves_nothing(tmp_path: Path, name: str) -> None:
    arguments, out = commands(tmp_path)[name], tmp_path / "results" / "out"
    first = tmp_path / "first"
    subprocess.run([*COMMAND, *arguments, "--out", str(first)], capture_output=True, env=ENVIRONMENT, check=True)
    sizes = sorted({p.stat().st_size for p in first.rglob("*") if p.is_file()})
    subprocess.run(["rm", "-r", str(first)], check=True)
    before = tree(tmp_path)
    for size in sizes:  # each file in turn is the first that does not fit
        done = subprocess.run(
            [sys.executable, "-c", FULL, str(size - 1), *arguments, "--out", str(out)],
            capture_output=True,
            text=True,
            env={**ENVIRONMENT, "PYTHONDONTWRITEBYTECODE": "1"},
            check=False,
        )
        assert done.returncode == 2 and done.stderr.count("\n") == 1 and "out" in done.stderr, done.stderr
        assert tree(tmp_path) == before


# ---- no memory ------------------------------------------------------------------------------------------------

SHORT = """
import resource, sys
import yourdfpy  # with all that it loads: a library that is short of memory while it loads may end the process
from rx90b_flex import cli, importing
with open("/proc/self/statm") as file:
    taken = int(file.read().split()[0]) * resource.getpagesize()
limit = taken + (int(sys.argv.pop(1)) << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
cli.main()
"""


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log of 160 MB in five columns."""
    folder = tmp_path_factory.mktemp("heavy")
    write_campaign(folder / "data")
    time_s = np.arange(4_000_000) / 100.0
    names = ("time", "angle_0", "angle_1", "moment_0", "moment_1")
    columns = (time_s, *(np.round(np.sin(time_s * k), 2) for k in (1, 2, 3, 4)))
    pd.DataFrame(dict(zip(names, columns, strict=True))).to_parquet(folder / "log.parquet")
    return folder


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="how much memory a process has is asked of Linux")
@pytest.mark.slow
@pytest.mark.parametrize("megabytes", [40, 120, 250])
def test_a_log_for_which_there_is_no_memory_is_one_line(heavy: Path, megabytes: int) -> None:
    before = set(os.listdir(heavy))
    words = ["import", str(heavy / "log.parquet"), "--robot", str(heavy / "data" / "robot_declared.toml")]
    done = subprocess.run(
        [sys.executable, "-c", SHORT, str(megabytes), *words, "--out", str(heavy / "out")],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        check=False,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1, (done.returncode, done.stderr)
    assert "memory" in done.stderr or "log.parquet" in done.stderr
    assert set(os.listdir(heavy)) == before


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="how much memory a process has is asked of Linux")
@pytest.mark.slow
@pytest.mark.parametrize("megabytes", [60, 130, 290])
def test_nor_does_a_recording_without_memory_end_the_process(heavy: Path, megabytes: int) -> None:
    path = heavy / "run.csv"
    if not path.exists():
        log = pd.read_parquet(heavy / "log.parquet").iloc[:1_000_000]
        tables.write_table(path, list(log.columns), log.to_numpy())
    read = SHORT.replace(
        "cli.main()", "cli.app = lambda **_: tables.read_table(Path(sys.argv[1]), ['time', 'moment_1'])\ncli.main()"
    )
    imports = "from pathlib import Path\nfrom rx90b_flex.signals import tables\n"
    done = subprocess.run(
        [sys.executable, "-c", imports + read, str(megabytes), str(path)], capture_output=True, text=True, check=False
    )
    said = (
        [] if done.returncode == 0 and megabytes > 256 else [f"rx90b-flex: {path}: cannot be read: not enough memory"]
    )
    assert (done.returncode, done.stderr.splitlines()) == (2 if said else 0, said)
