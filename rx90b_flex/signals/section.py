"""Tables of a campaign file: values are asked for by key and type, and every error names file and key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.files.keys import suggestion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CampaignSection:
    """A table of the campaign file whose values are asked for by key and type; every error names file and key."""

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

    def text(self, key: str) -> str:
        value = self._get(key)
        if not isinstance(value, str) or not value.strip():
            raise self.problem(key, f"found {shown(value)}, a text is expected")
        return value

    def number(self, key: str) -> float:
        return self.finite(key, self._get(key))

    def positive(self, key: str) -> float:
        value = self.number(key)
        if value <= 0.0:
            raise self.problem(key, f"found {value:g}, a number above 0 is expected")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        value = self._get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) and item for item in value):
            raise self.problem(key, f"found {shown(value)}, a list of texts is expected")
        return tuple(value)

    def numbers(self, key: str, count: int, meant: str = "joints lists") -> Array:
        """So many finite numbers; `meant` is what asks for as many."""
        value = self._get(key)
        if not isinstance(value, list):
            raise self.problem(key, f"found {shown(value)}, a list of {count} numbers is expected")
        if len(value) != count:
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

    def section(self, key: str) -> CampaignSection:
        value = self._get(key)
        if not isinstance(value, dict):
            raise self.problem(key, f"found {shown(value)}, a table [{key}] is expected")
        return CampaignSection(self.file, f"[{key}]", value)

    def sections(self, key: str) -> list[CampaignSection]:
        value = self._get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self.problem(key, f"found {shown(value)}, tables [[{key}]] are expected")
        return [CampaignSection(self.file, f"[[{key}]] {index + 1}", item) for index, item in enumerate(value)]

    def finite(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.problem(key, f"found {shown(value)}, a finite number is expected")
        return float(value)


def shown(value: object) -> str:
    """A value as a message shows it: on one line, cut where it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
