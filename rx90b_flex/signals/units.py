"""Units as logs write them, in names of columns or in a row of their own, and what brings numbers to SI."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

DEGREE = np.pi / 180.0
# fmt: off
ANGLE_UNITS = {"deg": DEGREE, "degs": DEGREE, "degree": DEGREE, "degrees": DEGREE, "grad": DEGREE, "dps": DEGREE, "mrad": 1e-3,
               "rpm": 2 * np.pi / 60, "rev": 2 * np.pi, "revs": 2 * np.pi, "turns": 2 * np.pi,
               "mm": 1e-3, "cm": 1e-2}  # of joints that slide
TORQUE_UNITS = {"nmm": 1e-3, "ncm": 1e-2, "mnm": 1e-3, "knm": 1e3, "kn": 1e3}
TIME_UNITS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6,
              "ns": 1e-9, "nsec": 1e-9}
# fmt: on
_ROW = {
    "motor": {**ANGLE_UNITS, "rad": 1.0, "rads": 1.0, "m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "torque": {**TORQUE_UNITS, "nm": 1.0, "n": 1.0},
}
# of columns that are not read, and of rates
_OTHERS = {"a", "ma", "v", "mv", "w", "k", "c", "degc", "hz", "bar", "kg", "counts", "inc", "ticks", "g"}
_FOREIGN = {
    "%",
    "pct",
    "percent",
    "pu",
    "gon",
    "danm",
    "kgfcm",
    "kgfm",
    "kgcm",
    "kgm",
    "lbft",
    "ftlb",
    "lbin",
    "inlb",
    "ozin",
}
_NONE = {"", "-", "1", "none", "n/a"}
_SQUARED = re.compile(r"\^?2|²|/s/s")


def words_of(name: str) -> list[str]:
    """`jointPos_1 [deg]` gives joint, pos, 1, deg; the degree sign is a word, too."""
    plain = name.replace("°", " deg ").replace("µ", "u").replace("μ", "u")
    plain = re.sub(r"(?<![A-Za-z\d])(?:1|u|rev)\s*/\s*min(?![a-z])", "rpm", plain, flags=re.IGNORECASE)
    # a newton and a metre, with whatever stands between them, are one word
    metres = re.sub(r"(?<![A-Za-z])([mk]?)N[ ·⋅*.]?([cm]?m)(?![A-Za-z])", r"\1n\2", plain)
    joined = re.sub(r"(?<![A-Za-z])([mk])N(?=m|(?![A-Za-z]))", r"\1n", metres)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", joined)
    return re.findall(r"[a-z]+|\d+", spaced.lower())


def foreign_unit(name: str) -> str | None:
    """The unit in brackets at the end of a name that cannot be brought to SI, or not without knowing the robot; None: none."""
    found = re.search(r"[\[(]([^\[\]()]+)[\])]\s*$", name)
    return found[1] if found and re.sub(r"[\s·⋅*._/-]", "", found[1].lower()) in _FOREIGN else None


def unit_in_name(signal: str, words: Sequence[str]) -> float | None:
    """What brings a column to SI; None where its name says no unit."""
    units = TORQUE_UNITS if "torque" in signal else ANGLE_UNITS
    found = [units[w] for w in words if w in units] + [1.0] * bool({"rad", "nm"} & set(words))
    if "velocity" in signal and "min" in words and found:
        return found[0] / 60.0
    return found[0] if found else None


def unit_in_row(signal: str, text: str) -> float | None:
    """What brings a column to SI by the unit that stands under its name; None where there is none.

    Raises
    ------
    ValueError
        The unit is not one of the signal: what is expected.
    """
    if _bare(text) in _NONE:
        return None
    units = _ROW["torque" if "torque" in signal else "motor"]
    unit = _of_rate(text)
    if unit not in units or _SQUARED.search(text):
        expected = "Nm, Nmm, kNm, N" if "torque" in signal else "rad, deg, m, mm"
        raise ValueError(f"the unit below its name is {text!r}; expected {expected}")
    return units[unit]


def is_time_unit(text: str) -> bool:
    """Whether a unit is one of times."""
    return _bare(text) in TIME_UNITS


def time_unit_in_row(text: str) -> float | None:
    """Seconds of the unit that stands under the name of times; None where there is none.

    Raises
    ------
    ValueError
        It is no unit of times that is known: what is expected.
    """
    if _bare(text) in _NONE:
        return None
    if not is_time_unit(text):
        raise ValueError(f"the unit below its name is {text!r}; expected s, ms, us, ns")
    return TIME_UNITS[_bare(text)]


def are_units(cells: Sequence[str]) -> bool:
    """Whether cells are a row of units: no number among them, and at least half of what is written is a known unit."""
    written = [cell for cell in map(_bare, cells) if cell not in _NONE]
    known = {*TIME_UNITS, *_ROW["motor"], *_ROW["torque"], *_OTHERS}
    return bool(written) and 2 * sum(_of_rate(cell) in known for cell in written) >= len(written)


def _bare(text: str) -> str:
    """Without brackets and blanks, in lower case: `[Nm]` gives nm, `N·m` as well."""
    plain = text.replace("°", "deg").replace("µ", "u").replace("μ", "u")
    return re.sub(r"[\s\[\]().·*\"]", "", plain).lower()


def _of_rate(text: str) -> str:
    """A unit without the `/s` behind it."""
    return _bare(text).partition("/")[0]
