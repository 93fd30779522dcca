"""The one reader of TOML files, for which whatever is wrong with one is a line that names it; and values as TOML."""

from __future__ import annotations

import datetime
import json
import math
import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rx90b_flex.files.keys import shortened

LARGEST = 64 * 2**20  # bytes: files that people write are some thousand
DEEPEST = 100  # arrays and tables within each other; where the parser itself ends depends on who calls it


def read_toml(path: Path, what: str, missing: str = "") -> dict[str, Any]:
    """The tables of a TOML file.

    Parameters
    ----------
    path : Path
    what : str
        What kind of file it is, for messages: ``robot file``.
    missing : str
        What is said where there is none; by default ``no such robot file``.

    Raises
    ------
    ValueError
        One line that names the file: not there, not readable, not TOML, too deep, numbers that no computer's arithmetic holds.
    """
    if path.is_dir():
        raise ValueError(f"{path}: a folder; a {what} (TOML) is expected")
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"{path}: {path.stat().st_size} bytes; a {what} (TOML) is expected")
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        _check_numbers(table, path)
    except FileNotFoundError:
        raise ValueError(f"{path}: {missing or f'no such {what}'}") from None
    except OSError as error:
        raise ValueError(f"{shortened(path)}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: cannot be read: no text in UTF-8 (byte {error.start + 1}); a {what} (TOML) is expected"
        ) from None
    except RecursionError:
        raise ValueError(f"{path}: not a TOML file that can be read: tables or arrays too deep in each other") from None
    except ValueError as error:  # the parser's own, and Python's on integers of thousands of digits
        text = " ".join(str(error).split())
        raise ValueError(text if text.startswith(str(path)) else f"{path}: not a TOML file: {text}") from None
    return table


def _check_numbers(table: dict[str, Any], path: Path) -> None:
    for place, value in _leaves(table, ""):
        if isinstance(value, int) and not isinstance(value, bool):
            try:
                float(value)
            except OverflowError:
                digits = int(math.log10(abs(value))) + 1
                raise ValueError(f"{path}: {place}: a number of {digits} digits; a smaller one is expected") from None


def _leaves(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Everything that is no table or array, with the keys and numbers that lead to it."""
    waiting: list[tuple[str, Any, int]] = [(place, value, 0)]
    while waiting:
        at, item, depth = waiting.pop()
        if depth > DEEPEST:
            raise RecursionError
        if isinstance(item, dict):
            waiting += [(f"{at} {key}".strip(), inner, depth + 1) for key, inner in item.items()]
        elif isinstance(item, list):
            waiting += [(f"{at}, item {i}", inner, depth + 1) for i, inner in enumerate(item, start=1)]
        else:
            yield at, item


def named_beside(path: Path, name: str) -> Path | str:
    """What a file calls its robot: the path from the file's folder where there is such a file, else the name as it is."""
    beside = path.parent / name
    # unlike the path's own method, no error where the name is too long
    return beside if os.path.isfile(beside) else name


@contextmanager
def named_in(path: Path | str, key: str = "") -> Iterator[None]:
    """While what a file, or a key of it, names is read: whatever is wrong with that is told with the file and the key.

    Raises
    ------
    ValueError
        As it was raised, with ``path: key:`` before it where the file is not named yet.
    """
    try:
        yield
    except ValueError as error:
        text = str(error)
        where = f"{path}: {key}" if key else str(path)
        raise ValueError(text if text.startswith(str(path)) else f"{where}: {text}") from None


def toml_text(content: Mapping[str, Any]) -> str:
    """A TOML file: values, then each mapping as a table and each list of mappings as an array of tables. What is None is left out.

    Numbers read back as the same doubles. Tables inside a table stand on one line.
    """
    parts = [_toml_lines({key: value for key, value in content.items() if _tables(value) is None})]
    for key, value in content.items():
        head = f"[{key}]" if isinstance(value, Mapping) else f"[[{key}]]"
        parts += [f"{head}\n{_toml_lines(table)}" for table in _tables(value) or []]
    return "\n".join(parts)


def _tables(value: Any) -> list[Mapping[str, Any]] | None:
    """The tables, or none of them, that a value of a file is; None for any other value."""
    items = list(value) if isinstance(value, list | tuple) else [value]
    return items if all(isinstance(item, Mapping) for item in items) else None


def _toml_lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{key} = {_toml_value(value)}\n" for key, value in table.items() if value is not None)


def _toml_value(value: Any) -> str:
    """A string, number, truth value, date, (nested) list or table as TOML.

    Raises
    ------
    TypeError
        Anything else.
    """
    if isinstance(value, str):
        # JSON's escapes are TOML's too, but JSON leaves the control character DEL as it is
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml_value(v)}" for key, v in value.items()) + " }"
    raise TypeError(f"{value!r} has no form in TOML")
