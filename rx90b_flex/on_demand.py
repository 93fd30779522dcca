"""Names of a package that are loaded when they are asked for, so that one name does not cost the libraries of all."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def names_of(package: str, file: str) -> Callable[[str], Any]:
    """A package's ``__getattr__``: it loads what the package imports under ``if TYPE_CHECKING``, so that these imports stand once.

    Parameters
    ----------
    package, file : str
        Its ``__name__`` and its ``__file__``.
    """

    @cache
    def homes() -> dict[str, str]:
        blocks = (n for n in ast.parse(Path(file).read_text(encoding="utf-8")).body if isinstance(n, ast.If))
        imports = (n for block in blocks for n in block.body if isinstance(n, ast.ImportFrom))
        return {name.name: each.module or "" for each in imports for name in each.names}

    def load(name: str) -> Any:
        if name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes()[name]), name)

    return load
