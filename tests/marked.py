"""Parameters of tests with the marks of what they cost."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def by_cost(names: Iterable[str], *, slow: Collection[str] = (), long: Collection[str] = ()) -> list[Any]:
    """Names of which some are tried with the slow tests, some by hand, and all others by default."""
    marks = [(pytest.mark.slow, slow), (pytest.mark.long, long)]
    return [pytest.param(name, marks=[mark for mark, its in marks if name in its]) for name in names]
