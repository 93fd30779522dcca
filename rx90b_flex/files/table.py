"""Tables of files that people write: values are asked for by key and type, and every error names file and key."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from rx90b_flex.files.keys import suggestion
from rx90b_flex.pieces import Array

T = TypeVar("T")


@dataclass(frozen=True)
class TomlTable:
    """A table of a TOML file whose values are asked for by key and type.

    Each question raises a ValueError, one line that names file, table and key, where the value is missing or of another type.

    Attributes
    ----------
    file : str
    name : str
        Of the table in it; empty for the file's own keys.
    values : mapping
    """

    file: str
    name: str
    values: Mapping[str, Any]

    def problem(self, key: str, what: str) -> ValueError:
        where = f"{self.name} {key}" if self.name else key
        return ValueError(f"{self.file}: {where}: {what}")

    def allow(self, *keys: str) -> None:
        for key in self.values:
            if key not in keys:
                hint = suggestion(key, keys)
                raise self.problem(repr(key), f"unknown key{hint}; allowed here: {', '.join(keys)}")

    def has(self, key: str) -> bool:
        return key in self.values

    def _get(self, key: str) -> Any:
        if key not in self.values:
            raise self.problem(key, "missing")
        return self.values[key]

    def optional(self, key: str, read: Callable[[str], T]) -> T | None:
        """What `read`, one of the questions, says of a key; None where the table has no such key."""
        return read(key) if self.has(key) else None

    def one_of(self, key: str, allowed: Sequence[str]) -> str:
        """One of some words; the first where the table has no such key."""
        value = self.values.get(key, allowed[0])
        if value not in allowed:
            raise self.problem(key, f"found {shown(value)}, {' or '.join(map(repr, allowed))} is expected")
        return str(value)

    def flag(self, key: str) -> bool:
        """True or false; false where the table has no such key."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            raise self.problem(key, f"found {shown(value)}, true or false is expected")
        return value

    def whole(self, key: str, least: int, most: int | None = None) -> int:
        value = self._get(key)
        wrong = isinstance(value, bool) or not isinstance(value, int) or value < least
        if wrong or (most is not None and value > most):
            up_to = "" if most is None else f" and at most {most}"
            raise self.problem(key, f"found {shown(value)}, a whole number of at least {least}{up_to} is expected")
        return int(value)

    def text(self, key: str) -> str:
        value = self._get(key)
        if not isinstance(value, str) or not value.strip():
            raise self.problem(key, f"found {shown(value)}, a text is expected")
        return value

    def number(self, key: str) -> float:
        return self.finite(key, self._get(key))

    def positive(self, key: str) -> float:
        return self._such(key, lambda x: x > 0.0, "above 0")

    def not_negative(self, key: str) -> float:
        return self._such(key, lambda x: x >= 0.0, "of 0 or more")

    def share(self, key: str) -> float:
        return self._such(key, lambda x: 0.0 < x < 1.0, "between 0 and 1")

    def _such(self, key: str, allowed: Callable[[float], bool], which: str) -> float:
        value = self.number(key)
        if not allowed(value):
            raise self.problem(key, f"found {value:g}, a number {which} is expected")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        value = self._get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) and item for item in value):
            raise self.problem(key, f"found {shown(value)}, a list of texts is expected")
        return tuple(value)

    def numbers(self, key: str, count: int | None = None, meant: str = "joints lists") -> Array:
        """So many finite numbers, or at least one; `meant` is what asks for as many."""
        value = self._get(key)
        if not isinstance(value, list) or not (value or count):
            raise self.problem(
                key, f"found {shown(value)}, a list of {'' if count is None else f'{count} '}numbers is expected"
            )
        if count is not None and len(value) != count:
            raise self.problem(key, f"lists {len(value)} values, {meant} {count}")
        return np.array([self.finite(key, item) for item in value])

    def square(self, key: str, count: int) -> Array:
        value = self._get(key)
        expected = f"{count} rows of {count} numbers, one a joint, are expected"
        if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
            raise self.problem(key, f"found {shown(value)}, {expected}")
        lengths = [len(row) for row in value]
        if lengths != [count] * count:
            found = "/".join(str(length) for length in sorted(set(lengths)))
            raise self.problem(key, f"has {len(value)} rows of {found} numbers, {expected}")
        return np.array([[self.finite(key, item) for item in row] for row in value])

    def rows(self, key: str, width: int, one: bool = False) -> Array:
        """Rows of so many finite numbers; if `one` will do, it may stand alone."""
        value = self._get(key)
        if one and isinstance(value, list) and len(value) == width and not any(isinstance(x, list) for x in value):
            value = [value]
        if not isinstance(value, list) or not value or not all(isinstance(x, list) and len(x) == width for x in value):
            raise self.problem(key, f"found {shown(value)}, a list of rows of {width} numbers is expected")
        return np.array([[self.finite(key, item) for item in row] for row in value])

    def section(self, key: str) -> TomlTable:
        value = self._get(key)
        if not isinstance(value, dict):
            raise self.problem(key, f"found {shown(value)}, a table [{key}] is expected")
        return TomlTable(self.file, f"{self.name} {key}" if self.name else f"[{key}]", value)

    def section_or_empty(self, key: str) -> TomlTable:
        """A table that may be left out: without a key then."""
        return self.section(key) if self.has(key) else TomlTable(self.file, f"[{key}]", {})

    def sections(self, key: str) -> list[TomlTable]:
        value = self._get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self.problem(key, f"found {shown(value)}, tables [[{key}]] are expected")
        return [TomlTable(self.file, f"[[{key}]] {index + 1}", item) for index, item in enumerate(value)]

    def finite(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.problem(key, f"found {shown(value)}, a finite number is expected")
        return float(value)


def shown(value: object) -> str:
    """A value as a message shows it: on one line, cut where it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
