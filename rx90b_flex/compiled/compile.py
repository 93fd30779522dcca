"""How functions of this folder are compiled and kept on disk.

numba keeps a function's machine code beside the function's own file and as long as that file stays as it is, also where
that code holds functions of other files. Here it is kept among the user's caches, one folder for what all files of this
folder hold: it is good as long as they stay as they are, and in every environment that has the same.

No reordering of sums: runs repeat to the bit.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.misc.appdirs import AppDirs
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def sources_stamp() -> str:
    """Of the content of all files of this folder."""
    known = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        known.update(path.name.encode() + path.read_bytes())
    return known.hexdigest()


@cache
def kept_in() -> str | None:
    """Folder of the machine code of these sources; None where it cannot be written, and numba finds a place of its own."""
    caches: str = config.CACHE_DIR or AppDirs("rx90b_flex", False).user_cache_dir  # type: ignore[attr-defined, no-untyped-call]
    folder = os.path.join(caches, f"compiled_{sources_stamp()[:16]}")
    try:
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    return folder


class _Located:
    """Where numba keeps a function, and what tells it that the sources are still those that were compiled."""

    def __init__(self, locator: Any) -> None:
        self.locator = locator

    def __getattr__(self, name: str) -> Any:
        return getattr(self.locator, name)

    def get_cache_path(self) -> Any:
        return kept_in() or self.locator.get_cache_path()

    def get_source_stamp(self) -> Any:
        return sources_stamp()


class _Kept(CompileResultCacheImpl):
    @property
    def locator(self) -> _Located:
        return _Located(super().locator)


class _Cache(FunctionCache):
    _impl_class = _Kept


class _FirstTime(event.Listener):
    """Calls back when something is compiled for the first time."""

    def __init__(self, begins: Callable[[], None]) -> None:
        self.begins = begins
        self.begun = False

    def on_start(self, event: Any) -> None:
        if not self.begun:
            self.begun = True
            self.begins()

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def told_of_compiling(begins: Callable[[], None]) -> Iterator[None]:
    """Within it, `begins` is called once where something has to be compiled, which may take a while."""
    with event.install_listener("numba:compile", _FirstTime(begins)):
        yield


def _compiler(**options: Any) -> Callable[[Function], Function]:
    def decorate(function: Function) -> Function:
        # nothing calls these functions as C functions, and what makes them such takes long to compile
        njit: Any = numba.njit
        compiled: Function = njit(error_model="numpy", no_cfunc_wrapper=True, **options)(function)
        compiled._cache = _Cache(function)  # type: ignore[attr-defined, no-untyped-call]
        return compiled

    return decorate


# What Python calls.
entry = _compiler()
# Called from compiled code: large functions, which keeps the time that the compiler takes in bounds.
called = _compiler(no_cpython_wrapper=True)
# Put into what calls it: a call would copy the hundreds of words that describe the arrays.
inlined = _compiler(no_cpython_wrapper=True, forceinline=True)
