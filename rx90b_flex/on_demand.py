"""Names of a package that are loaded when they are asked for, so that one name does not cost the libraries of all."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def names_of(package: str) -> Callable[[str], Any]:
    """A package's ``__getattr__``, from its ``__name__``: for names that it imports for type checkers alone.

    What stands under ``if TYPE_CHECKING:`` in the package's file never runs, and says of each name where it is.
    """

    @cache
    def homes() -> dict[str, str]:
        source = Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8")
        blocks = (node for node in ast.parse(source).body if isinstance(node, ast.If))
        imports = (node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom))
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes()[name]), name)

    return load
