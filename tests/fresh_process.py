"""Code in a process of its own that imports this package anew, while the libraries below it are there already."""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

LIBRARIES = [
    "jinja2",
    "matplotlib.figure",
    "numba",
    "pandas",
    "pinocchio",
    "scipy.optimize",
    "scipy.signal",
    "typer",
    "yourdfpy",
]
CONTEXT = multiprocessing.get_context("forkserver")  # a server without threads, from which each process is forked
CONTEXT.set_forkserver_preload(LIBRARIES)


def python(code: str, at: Path, packages: Sequence[Path]) -> str:
    """Status and output of code that runs in a folder, with other packages to be found first."""
    with tempfile.TemporaryDirectory() as folder:
        outputs = [os.path.join(folder, name) for name in ("out", "err")]
        process = CONTEXT.Process(target=_run, args=(code, str(at), [str(p) for p in packages], outputs))
        process.start()
        process.join()
        return "\n".join([str(process.exitcode), "".join(Path(o).read_text() for o in outputs)])


def _run(code: str, at: str, packages: list[str], outputs: list[str]) -> None:
    assert not any(name.split(".")[0] == "rx90b_flex" for name in sys.modules)
    for number, path in enumerate(outputs, start=1):
        with open(path, "wb") as file:
            os.dup2(file.fileno(), number)
    os.chdir(at)
    sys.path[:0] = packages
    exec(code, {"__name__": "__main__"})
