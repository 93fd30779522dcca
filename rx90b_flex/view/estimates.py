"""Identified values in words: rounded to what is known of them, a curve's in one."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import groupby

from rx90b_flex.identify.least_squares import Estimate

MANY = 10  # values that only count: with so many they are a curve's


def number(value: float | None) -> str:
    """Three digits that mean something."""
    if value is None:
        return "–"
    return f"{value:#.3g}".rstrip(".") if value and abs(value) < 1e5 else f"{value:.3g}"


def unit_text(unit: str) -> str:
    """A unit as it is printed: superscripts where there are some, nothing for a pure number."""
    return "" if unit == "-" else unit.replace("^2", "²").replace("^3", "³")


def values(parameters: Sequence[Estimate]) -> list[str]:
    """Of an effect, one a line, a curve's in one; what of it is not determined is said once."""
    told = counted([p for p in parameters if p.value is not None])
    out = [f"{name_of(some)} = {measured_all(some, unit_text(some[0].unit))}" for some in told]
    untold = untold_names([p.name for p in parameters if p.value is None])
    return [*out, f"{untold}: not determined by this data"] if untold else out


def counted(parameters: Sequence[Estimate]) -> list[list[Estimate]]:
    """Estimates, those of a curve together: `MANY` in a row that only count, or more."""
    out: list[list[Estimate]] = []
    for _, some in groupby(parameters, key=lambda p: (re.sub(r"_\d+$", "", p.name), p.value is None)):
        row = list(some)
        out += [row] if len(row) >= MANY else [[p] for p in row]
    return out


def name_of(estimates: Sequence[Estimate]) -> str:
    """Of one, or of a curve's."""
    return estimates[0].name if len(estimates) == 1 else untold_names([e.name for e in estimates])


def measured_all(estimates: Sequence[Estimate], unit: str = "") -> str:
    """`measured` of one; of a curve's the smallest and the largest value, and the largest standard deviation."""
    known = [e.value for e in estimates if e.value is not None]
    if len(estimates) == 1 or not known:
        return f"{measured(estimates[0])} {unit}".rstrip()
    least = max((e.std for e in estimates if e.std is not None), default=0.0)
    values = f"{min(known):.3g} to {max(known):.3g} {unit}".rstrip()
    return f"{values}, each ± {least:.2g} or less" if least > 0 else values


def untold_names(names: Sequence[str]) -> str:
    """Names in a row, those that only count by the first and the last; empty for none."""
    only_count = len({re.sub(r"_\d+$", "", name) for name in names}) == 1 < len(names)
    return f"{names[0]} to {names[-1]}" if only_count else ", ".join(names)


def measured(estimate: Estimate) -> str:
    """Value ± standard deviation, rounded to two digits of the latter; ``not determined`` where it has no value."""
    value, std = estimate.value, estimate.std
    if value is None:
        return "not determined by this data"
    if std is None or not math.isfinite(std) or std <= 0:
        return number(value)
    digits = 1 - math.floor(math.log10(std))
    if digits > 6 or max(abs(value), std) >= 1e6:
        return f"{value:.3g} ± {std:.1e}"
    return f"{value:.{max(digits, 0)}f} ± {std:.{max(digits, 0)}f}"
