"""Units as logs write them, in names of columns or in a row of their own, and what brings numbers to SI."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from typing import Literal

import numpy as np

Kind = Literal["angle", "length", "angle rate", "length rate", "torque", "force", "current", "time", "count", "other"]

DEGREE = np.pi / 180.0
_POUND = 4.4482216152605  # N
_INCH = 0.0254  # m
_KILOPOND = 9.80665  # N, which a kilogram weighs
# fmt: off
TIME_UNITS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6,
              "ns": 1e-9, "nsec": 1e-9}
_ANGLES = {"rad": 1.0, "rads": 1.0, "deg": DEGREE, "degs": DEGREE, "degree": DEGREE, "degrees": DEGREE, "grad": DEGREE,
           "mrad": 1e-3, "urad": 1e-6, "mdeg": 1e-3 * DEGREE, "gon": np.pi / 200.0, "rev": 2 * np.pi, "revs": 2 * np.pi,
           "turn": 2 * np.pi, "turns": 2 * np.pi}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": _INCH, "inch": _INCH, "inches": _INCH}
_TORQUES = {"nm": 1.0, "danm": 10.0, "cnm": 1e-2, "ncm": 1e-2, "mnm": 1e-3, "nmm": 1e-3, "knm": 1e3,
            **dict.fromkeys(("kgfm", "kgm", "kpm"), _KILOPOND), **dict.fromkeys(("kgfcm", "kgcm", "kpcm"), 1e-2 * _KILOPOND),
            **dict.fromkeys(("lbfft", "ftlbf", "lbft", "ftlb"), 12.0 * _POUND * _INCH),
            **dict.fromkeys(("lbfin", "inlbf", "lbin", "inlb"), _POUND * _INCH),
            **dict.fromkeys(("ozfin", "inozf", "ozin", "inoz"), _POUND * _INCH / 16.0)}
_UNITS: dict[Kind, dict[str, float]] = {
    "angle": _ANGLES,
    "length": _LENGTHS,
    "angle rate": {**{f"{u}/s": x for u, x in _ANGLES.items()}, **{f"{u}/min": x / 60.0 for u, x in _ANGLES.items()},
                   "dps": DEGREE, "rps": 2 * np.pi, "rpm": 2 * np.pi / 60.0},
    "length rate": {**{f"{u}/s": x for u, x in _LENGTHS.items()}, **{f"{u}/min": x / 60.0 for u, x in _LENGTHS.items()}},
    "torque": _TORQUES,
    "force": {"n": 1.0, "kn": 1e3, "lbf": _POUND},
    # which of its values a current states is a part of its torque constant
    "current": {"a": 1.0, "amp": 1.0, "amps": 1.0, "arms": 1.0, "apk": 1.0, "aeff": 1.0, "ma": 1e-3},
    "time": TIME_UNITS,
    "count": dict.fromkeys(("counts", "count", "cnt", "inc", "incs", "increments", "ticks", "tick", "pulses", "lsb"), 1.0),
    "other": dict.fromkeys(("v", "mv", "w", "kw", "k", "c", "degc", "hz", "khz", "bar", "kg", "g", "%", "pct", "percent", "pu", "1/s",
                            "mn", "nms",
                            *(f"{u}/s{again}" for u in (*_ANGLES, *_LENGTHS) for again in ("2", "/s"))), 1.0),
}
# words of names that are units without brackets, too
_WORDS = {"rad", "rads", "deg", "degs", "degree", "degrees", "mrad", "mdeg", "dps", "rpm", "mm", "nm", "cnm", "ncm", "mnm", "nmm",
          "knm", "counts", "ticks", "percent"}
# words that are units where they are of the kind that a signal has, and something else otherwise
_PERHAPS = {"grad", "rev", "revs", "turns", "cm", "kn", "ma"}
# fmt: on
UNIT_WORDS = _WORDS | _PERHAPS
_EXPECTED: dict[Kind, str] = {
    "angle": "rad, deg, mrad, rev",
    "length": "m, mm, cm",
    "angle rate": "rad/s, deg/s, rpm",
    "length rate": "m/s, mm/s",
    "torque": "Nm, daNm, cNm, Nmm, kNm, kgf.m, kgf.cm, lbf.ft, lbf.in",
    "force": "N, kN, lbf",
    "current": "A, mA",
}
_ONE: dict[Kind, str] = {
    "angle": "an angle",
    "angle rate": "the rate of an angle",
    "length rate": "the rate of a length",
}
_NONE = {"", "1", "none", "n/a"}


class ForeignUnit(ValueError):
    """A unit that a signal cannot have, or that is not known.

    Attributes
    ----------
    unit : as it is written.
    kind : what it is a unit of; None: not known.
    scale : what brings it to SI.
    """

    def __init__(self, message: str, unit: str) -> None:
        super().__init__(message)
        self.unit = unit
        known = unit_of(unit)
        self.kind: Kind | None = known[0] if known else None
        self.scale = known[1] if known else 1.0


def words_of(name: str) -> list[str]:
    """`jointPos_1 [deg]` gives joint, pos, 1, deg; the degree sign is a word, too."""
    plain = name.replace("°", " deg ").replace("µ", "u").replace("μ", "u")
    plain = re.sub(r"(?<![A-Za-z\d])(?:1|u|rev)\s*/\s*min(?![a-z])", "rpm", plain, flags=re.IGNORECASE)
    plain = re.sub(r"(?<![A-Za-z])(s|min)\s*\^\s*-1", r"per \1", plain.replace("⁻¹", "^-1"))
    plain = re.sub(r"\^\s*-?\d+", "", plain)  # which counts no joint
    # a newton and a metre, with whatever stands between them, are one word
    metres = re.sub(r"(?<![A-Za-z])([mkc]?)N[ ·⋅*.]?([cm]?m)(?![A-Za-z])", r"\1n\2", plain)
    joined = re.sub(r"(?<![A-Za-z])([mk])N(?=m|(?![A-Za-z]))", r"\1n", metres)
    joined = re.sub(r"(?<![A-Za-z])mA(?![A-Za-z])", "ma", joined)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", joined)
    return re.findall(r"[a-z]+|\d+", spaced.lower())


def kinds_of(signal: str, turns: bool = True, motor_side: bool = False) -> tuple[Kind, ...]:
    """What units of a signal may be of: of a joint that turns, else of one that slides; on the motor's side the motor may turn."""
    if signal == "motor_current":
        return ("current",)
    turning: Kind = "torque" if "torque" in signal else "angle rate" if "velocity" in signal else "angle"
    sliding: Kind = "force" if "torque" in signal else "length rate" if "velocity" in signal else "length"
    if not motor_side:
        return (turning if turns else sliding,)
    counted: tuple[Kind, ...] = () if "torque" in signal else ("count",)  # gears may be counts a rad
    return (*((turning,) if turns else (sliding, turning)), *counted)


def unit_of(text: str) -> tuple[Kind, float] | None:
    """What a text is a unit of, and what brings that to SI; None: no unit that is known."""
    key = _key(text)
    return next(((kind, units[key]) for kind, units in _UNITS.items() if key in units), None)


def unit_in_name(name: str, kinds: Sequence[Kind], no_units: Collection[str] = ()) -> float | None:
    """What brings a column to SI; None where its name says no unit.

    Parameters
    ----------
    name : of the column: a unit in brackets goes first, then its words.
    kinds : what its unit may be of, as `kinds_of` gives them.
    no_units : words that stand in brackets and are no units.

    Raises
    ------
    ForeignUnit
        The unit is of another kind or not known: what is expected.
    """
    text = _in_brackets(name, no_units)
    if text is not None:
        return _scale(text, kinds, _wrong(text, kinds))
    words = words_of(name)
    for k, word in enumerate(words):
        if word not in UNIT_WORDS:
            continue
        behind = [w for w in words[k + 1 :] if w != "per"]
        rates = bool({"angle rate", "length rate"} & set(kinds))
        if rates and "min" in words:
            unit = f"{word}/min"
        elif behind[:1] == ["s"] or (rates and unit_of(f"{word}/s")):  # names of speeds often leave out the second
            unit = f"{word}/s"
        else:
            unit = word
        known = unit_of(unit) or unit_of(word)
        if known and known[0] in kinds:
            return known[1]
        if word in _WORDS:
            shown = unit if unit_of(unit) else word
            raise _foreign(shown, kinds, _wrong(shown, kinds))
    return None


def unit_in_row(signal: str, text: str, kinds: Sequence[Kind] = ()) -> float | None:
    """What brings a column to SI by the unit that stands under its name; None where there is none.

    Raises
    ------
    ForeignUnit
        The unit is not one of the signal (of `kinds`, or of a joint that turns): what is expected.
    """
    return _scale(text, kinds or kinds_of(signal), f"the unit below its name is {text!r}")


def is_time_unit(text: str) -> bool:
    """Whether a unit is one of times."""
    return _key(text) in TIME_UNITS


def time_unit_in_row(text: str) -> float | None:
    """Seconds of the unit that stands under the name of times; None where there is none.

    Raises
    ------
    ForeignUnit
        It is no unit of times that is known: what is expected.
    """
    if _key(text) in _NONE:
        return None
    if not is_time_unit(text):
        raise ForeignUnit(f"the unit below its name is {text!r}; expected s, ms, us, ns", text)
    return TIME_UNITS[_key(text)]


def are_units(cells: Sequence[str]) -> bool:
    """Whether cells are a row of units: no number among them, and at least half of what is written is a known unit."""
    written = [cell for cell in cells if _key(cell) not in _NONE]
    known = [cell for cell in written if unit_of(cell) or unit_of(cell.partition("/")[0])]
    return bool(written) and 2 * len(known) >= len(written)


def _scale(text: str, kinds: Sequence[Kind], found: str) -> float | None:
    """What brings a unit of one of some kinds to SI; None for a text that says there is none."""
    if _key(text) in _NONE:
        return None
    known = unit_of(text)
    if known is None or known[0] not in kinds:
        raise _foreign(text, kinds, found)
    return known[1]


def _wrong(text: str, kinds: Sequence[Kind]) -> str:
    """What is wrong with a unit in a name."""
    known, one = unit_of(text), _ONE.get(kinds[0], f"a {kinds[0]}")
    foreign = known is None or known[0] == "other"
    return f"is in {text}, which {'import does not bring to SI' if foreign else f'is no unit of {one}'}"


def _foreign(text: str, kinds: Iterable[Kind], found: str) -> ForeignUnit:
    expected = ", ".join(_EXPECTED[kind] for kind in kinds if kind in _EXPECTED)
    return ForeignUnit(f"{found}; expected {expected}", text)


def _in_brackets(name: str, no_units: Collection[str]) -> str | None:
    """The unit in brackets in a name: one that is known, or at the end of the name what can be nothing else; None: none."""
    found = list(re.finditer(r"[\[(]([^\[\]()]+)[\])]", name))
    for bracket in reversed(found):
        text = bracket[1].strip()
        # a letter alone is a unit as it is written: A are amperes, a may be anything
        if unit_of(text) and (len(text) > 1 or text in "msgANVWKC%°"):
            return text
    if not found or not re.fullmatch(r"[\s_\d]*", name[found[-1].end() :]):
        return None
    text = found[-1][1].strip()
    words = words_of(text)
    unknown = len(text) > 1 and any(w.isalpha() for w in words) and not re.search(r"\d", re.sub(r"\^-?\d", "", text))
    return text if unknown and not set(words) & set(no_units) else None


def _key(text: str) -> str:
    """A unit as the tables have it: `[N·m]` gives nm, `deg s^-1` deg/s, `U/min` rpm."""
    plain = text.replace("°", "deg").replace("µ", "u").replace("μ", "u").replace("²", "2").replace("⁻¹", "^-1")
    plain = re.sub(r"[\[\]()\"]", "", plain).strip()
    plain = re.sub(r"(?<!\w)MN", "mega N", plain)  # which is no mN
    plain = re.sub(r"\s+per\s+|_per_", "/", plain.lower())
    plain = re.sub(r"[\s·⋅*.]*(?<![a-z])(s|sec|min)\s*\^?\s*[-−]\s*1$", r"/\1", plain)
    plain = re.sub(r"(?<=[a-z])[ _]s$", "/s", plain)
    plain = re.sub(r"[\s·⋅*.^_-]", "", plain)
    plain = re.sub(r"/(sec|second|seconds)$", "/s", plain)
    return "rpm" if plain in ("1/min", "u/min", "r/min", "rev/min", "/min") else plain
