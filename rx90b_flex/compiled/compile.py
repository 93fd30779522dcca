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
from typing import Any, ClassVar, TypeVar

import numba
import numpy as np
from numba.core import config, event, ir, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.typed_passes import AnnotateTypes
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


class _LocatedLaw(_Located):
    """The same for a law of an effect, which lies elsewhere: it holds functions of this folder."""

    def get_cache_path(self) -> Any:
        return self.locator.get_cache_path()

    def get_source_stamp(self) -> Any:
        return self.locator.get_source_stamp(), sources_stamp()


class _KeptLaw(CompileResultCacheImpl):
    @property
    def locator(self) -> _LocatedLaw:
        return _LocatedLaw(super().locator)


class LawCache(FunctionCache):
    """Of a law's machine code."""

    _impl_class = _KeptLaw


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


class _NeverRun:
    """Stands for the code generator where a library is asked for it behind its lowering."""

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: code that is never run by itself has no place for its environment."""


class _LinkedOnly(JITCodeLibrary):
    """A function that is part of what calls it: neither optimised nor made machine code by itself, which would only take time."""

    @property
    def codegen(self) -> _NeverRun:
        return _NeverRun()

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        return 0


@register_pass(mutates_CFG=False, analysis_only=True)  # type: ignore[no-untyped-call]
class _LinkOnly(AnalysisPass):
    """Gives a function such a library before it is lowered."""

    _name = "rx90b_flex_link_only"

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]

    def run_pass(self, state: Any) -> bool:
        codegen = state.targetctx.codegen()
        state.library = _LinkedOnly(codegen, state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        return False


@register_pass(mutates_CFG=False, analysis_only=True)  # type: ignore[no-untyped-call]
class _OnlyBorrows(AnalysisPass):
    """Refuses a function that would have to count references to arrays and does not: it returns one, or calls what does."""

    _name = "rx90b_flex_only_borrows"

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]

    def run_pass(self, state: Any) -> bool:
        def holds_arrays(kind: Any) -> bool:
            return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())

        calls = [(e, s) for e, s in state.calltypes.items() if isinstance(e, ir.Expr) and e.op == "call"]
        made = [e for e, s in calls if holds_arrays(s.return_type)]
        made = [e for e in made if not isinstance(state.typemap[e.func.name], types.NamedTupleClass)]
        if not state.flags.nrt and (made or holds_arrays(state.return_type)):
            raise TypeError(f"{state.func_id.func_qualname} returns arrays or calls what does: it is to be `counted`")
        return False


class _BorrowingCompiler(CompilerBase):
    """numba's own compiler, with that look at references."""

    looks: ClassVar[tuple[type[AnalysisPass], ...]] = (_OnlyBorrows,)

    def define_pipelines(self) -> Any:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)  # type: ignore[no-untyped-call]
        for look in self.looks:
            passes.add_pass_after(look, AnnotateTypes)
        passes.finalize()
        return [passes]


class _PartCompiler(_BorrowingCompiler):
    """The same, with the library of what is part of others."""

    looks = (_LinkOnly, _OnlyBorrows)


def _compiler(kept: bool = True, **options: Any) -> Callable[[Function], Function]:
    def decorate(function: Function) -> Function:
        # nothing calls these functions as C functions, and what makes them such takes long to compile
        njit: Any = numba.njit
        compiled: Function = njit(error_model="numpy", no_cfunc_wrapper=True, **options)(function)
        if kept:
            compiled._cache = _Cache(function)  # type: ignore[attr-defined, no-untyped-call]
        return compiled

    return decorate


# What Python calls. Where it is not said whether references are counted, numba does as the caller does.
entry = _compiler(_nrt=True)
# Called from compiled code: large functions, which keeps the time that the compiler takes in bounds. As the inlined ones, they do
# not count references to arrays, for these are their caller's, and counting takes the compiler long to take out again.
called = _compiler(no_cpython_wrapper=True, _nrt=False, pipeline_class=_BorrowingCompiler)
# Put into what calls it, and compiled with it alone: a call would copy the hundreds of words that describe the arrays.
_PART: dict[str, Any] = {"no_cpython_wrapper": True, "forceinline": True, "pipeline_class": _PartCompiler}
inlined = _compiler(kept=False, _nrt=False, **_PART)
# The same, of what returns arrays or calls what does.
counted = _compiler(kept=False, _nrt=True, **_PART)
