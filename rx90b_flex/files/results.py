"""JSON files of results, in which a number that JSON does not have is null."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any


def write_json(file: Path, content: Any, indent: int | None = 2, allow_nan: bool = False) -> None:
    """A JSON file.

    Raises
    ------
    ValueError
        A number that is not finite, unless that is allowed.
    """
    file.write_text(json.dumps(content, indent=indent, allow_nan=allow_nan) + "\n", encoding="utf-8")


def finite(value: float) -> float | None:
    """A number as JSON has it: None where it is not finite."""
    return float(value) if math.isfinite(value) else None
