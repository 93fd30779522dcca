"""Machine code kept on disk: a change of any file of the compiled folder has it made again."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rx90b_flex

FOLDER = Path(rx90b_flex.__file__).parent / "compiled"
CALLER = """
from {name}.compile import entry
from {name}.callee import number

@entry
def doubled(x):
    return 2.0 * number(x)
"""
CALLEE = """
from {name}.compile import inlined

@inlined
def number(x):
    return x + {number}
"""
RUN = """
from {name}.caller import doubled
print(doubled(1.0), sum(doubled.stats.cache_hits.values()))
"""


def doubled(folder: Path) -> tuple[float, int]:
    """What a new process says, and how many functions it took from the disk."""
    command = [sys.executable, "-c", RUN.format(name=folder.name)]
    caches = str(folder.parents[1] / "caches")
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(folder.parent), "NUMBA_CACHE_DIR": caches}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    value, hits = done.stdout.split()
    return float(value), int(hits)


def package(parent: Path) -> Path:
    """A folder of compiled functions, one of which calls another."""
    folder = parent / "copied"
    folder.mkdir(parents=True)
    shutil.copy(FOLDER / "compile.py", folder)
    (folder / "caller.py").write_text(CALLER.format(name="copied"))
    (folder / "callee.py").write_text(CALLEE.format(name="copied", number=1.0))
    return folder


@pytest.mark.slow
def test_a_caller_is_compiled_again_when_the_file_of_what_it_calls_changes(tmp_path: Path) -> None:
    folder = package(tmp_path / "here")
    assert doubled(folder) == (4.0, 0)
    # another environment with the same files compiles nothing
    assert doubled(package(tmp_path / "there")) == (4.0, 1)
    (folder / "callee.py").write_text(CALLEE.format(name="copied", number=3.0))
    assert doubled(folder) == (8.0, 0)
    assert doubled(folder) == (8.0, 1)


def test_every_compiled_function_is_kept_that_way() -> None:
    for path in FOLDER.glob("*.py"):
        if path.name != "compile.py":
            assert "njit" not in path.read_text(encoding="utf-8"), f"{path.name} goes past compile.py"


LAW = """
from numba import types
from numba.core.ccallback import CFunc
from {name}.compile import LawCache
from {name}.callee import number

def law(x):
    return 2.0 * number(x)

compiled = CFunc(law, ((types.float64,), types.float64), {{}}, {{}})
compiled._cache = LawCache(law)
compiled.compile()
print(compiled.ctypes(1.0), compiled._cache_hits)
"""


@pytest.mark.slow
def test_so_is_a_law_that_lies_elsewhere(tmp_path: Path) -> None:
    folder = package(tmp_path / "here")
    script = tmp_path / "law.py"
    script.write_text(LAW.format(name="copied"))

    def said() -> tuple[float, int]:
        environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(folder.parent)}
        done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=True)
        value, hits = done.stdout.split()
        return float(value), int(hits)

    assert said() == (4.0, 0)
    assert said() == (4.0, 1)
    (folder / "callee.py").write_text(CALLEE.format(name="copied", number=3.0))
    assert said() == (8.0, 0)
