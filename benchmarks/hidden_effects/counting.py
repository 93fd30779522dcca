"""What is counted in studies of hidden effects, and how their runs are kept, continued and shown."""

from __future__ import annotations

import argparse
import itertools
import json
import time as clock
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from scipy import stats

STRENGTHS = (1.0, 3.0, 10.0)
DEVIATIONS = 3.0
INTERVAL = 1.96  # standard deviations, of 95 %
NEAR_FLOOR = 1.2  # held-out error over the noise floor that is asked for
HYSTERESIS = ("presliding_friction", "maxwell_slip_friction")  # one smooth element, or several with corners
OWN_LAW = {"maxwell": (*HYSTERESIS, "held_friction")}  # what a form of dry friction is, beyond a sign that turns over
# found with a geometry of its own, for torques do not tell the scale of its levers: none of its values is that of the hidden one
OTHER_GEOMETRY = ("gravity_spring",)

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Case:
    """One run of a study; `name` is an effect type, two of them with a plus, or what is outside the catalogue."""

    study: str
    name: str
    strength: float
    seed: int
    robot: str = ""
    form: str = ""
    colour: str = "white"
    step_rad: float = 0.0
    period_stated: bool = True

    @property
    def key(self) -> str:
        parts = [self.study, self.name, *(x for x in (self.robot, self.form) if x), f"{self.strength:g}"]
        if self.robot:
            parts += [self.colour, f"{self.step_rad:g}", "period" if self.period_stated else "no_period"]
        return "/".join([*parts, str(self.seed)])

    @staticmethod
    def of(row: Row) -> Case:
        return Case(**{name: row[name] for name in Case.__dataclass_fields__ if name in row})


# ---- right and wrong -------------------------------------------------------------------------------------------------


def same(hidden: Row, found: Row) -> bool:
    return bool(hidden["type"] == found["type"] and hidden["joints"] == found["joints"])


def right(row: Row) -> bool:
    """Exactly what was hidden was found."""
    return len(row["found"]) == len(row["hidden"]) and all(any(same(h, f) for f in row["found"]) for h in row["hidden"])


def among(row: Row) -> bool:
    """What was hidden was found, whatever else was."""
    return all(any(same(h, f) for f in row["found"]) for h in row["hidden"])


def own_law(row: Row, found: Row) -> bool:
    """Whether what was found is no more than the law that this run's dry friction truly follows."""
    return found["type"] in OWN_LAW.get(row.get("form", ""), ())


def equivalent(hidden: Row, found: Row) -> bool:
    """Same place, and the same law under another name, or the result itself says that the data cannot tell the two apart."""
    if same(hidden, found):
        return True
    if hidden["joints"] == found["joints"] and {hidden["type"], found["type"]} <= set(HYSTERESIS):
        return True
    return [hidden["type"], hidden["joints"]] in found.get("alternatives", [])


def right_in_effect(row: Row) -> bool:
    """What was hidden, or what is declared equivalent to it, and beside it nothing but what dry friction truly is here.

    Dry friction that is hidden follows this run's law: the law's own name is right for it.
    """
    left = list(row["found"])
    for h in row["hidden"]:
        own = [f for f in left if h["type"] == "coulomb_friction" and h["joints"] == f["joints"] and own_law(row, f)]
        hit = next((f for f in left if same(h, f)), None) or next(
            (f for f in left if equivalent(h, f) or f in own), None
        )
        if hit is None:
            return False
        left.remove(hit)
    return all(own_law(row, f) for f in left)


def added(row: Row) -> list[Row]:
    """What was named with nothing there: all but the law that dry friction truly follows."""
    return [f for f in row["found"] if not own_law(row, f)]


def deviations(row: Row) -> list[float]:
    """Errors of the parameters of effects that were found where they are, over their standard deviations."""
    out = []
    for h in (h for h in row["hidden"] if h["type"] not in OTHER_GEOMETRY):
        for f in (f for f in row["found"] if same(h, f)):
            for name, true in h["values"].items():
                values = true if isinstance(true, list) else [true]
                names = [name] if len(values) == 1 else [f"{name}_{i + 1}" for i in range(len(values))]
                for n, x in zip(names, values, strict=True):
                    value, std = f["parameters"].get(n, (None, None))
                    if value is None or not std:
                        continue
                    error = value - x
                    error = (error + np.pi) % (2 * np.pi) - np.pi if n == "phase" else error
                    out.append(float(error / std))
            break
    return out


def rate(good: int, total: int) -> str:
    """Share with its 95 % interval (Clopper and Pearson)."""
    if not total:
        return "-"
    interval = stats.binomtest(good, total).proportion_ci()
    return f"{good}/{total} ({100 * interval.low:.0f}-{100 * interval.high:.0f} %)"


def mistakes(rows: Sequence[Row]) -> str:
    """What was named where it should not have been, most frequent first."""
    wrong = [[f["type"] for f in r["found"] if not any(same(h, f) for h in r["hidden"])] for r in rows if not right(r)]
    return counted((" + ".join(types) or "nothing" for types in wrong), 3)


def counted(names: Iterable[str], most: int | None = None) -> str:
    """Names with how often each stands there, most frequent first."""
    return ", ".join(f"{name} ({n})" for name, n in Counter(names).most_common(most))


def hidden_table(rows: Sequence[Row]) -> list[str]:
    """One line a type and strength, then one a strength over all types."""
    lines = [
        "| hidden | strength | right | among those found | within | held out | else named |",
        "|---|---|---|---|---|---|---|",
    ]
    singles = [r for r in rows if r["study"] == "hidden"]
    groups = sorted({(r["name"], r["strength"]) for r in singles})
    strengths = sorted({s for _, s in groups})
    for name, strength in [*groups, *(("all types", s) for s in strengths)]:
        these = [r for r in singles if r["strength"] == strength and name in (r["name"], "all types")]
        z = [x for r in these for x in deviations(r)]
        within = sum(abs(x) <= DEVIATIONS for x in z)
        held = sum(r["held_out"] <= NEAR_FLOOR for r in these)
        lines.append(
            f"| {name} | {strength:g} | {rate(sum(map(right, these)), len(these))} | {sum(map(among, these))}/{len(these)}"
            f" | {within}/{len(z)} | {held}/{len(these)} | {mistakes(these) if name != 'all types' else ''} |"
        )
    return lines


def left_out(rows: Sequence[Row]) -> list[str]:
    """What could not be hidden, a sentence each."""
    skipped = Counter(r["skipped"] for r in rows if "skipped" in r)
    return [f"Left out {n} times: {text}." for text, n in skipped.items()]


# ---- running ---------------------------------------------------------------------------------------------------------


def finished(path: Path) -> list[dict[str, Any]]:
    """Rows of a file of results; a last line that was cut is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.is_file() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def continued(
    path: Path, every: Iterator[Case], run: Callable[[Case], dict[str, Any]], limit: int, jobs: int
) -> list[dict[str, Any]]:
    """Rows of a file of results, with at most `limit` of the runs that it lacks added to it."""
    rows = finished(path)
    keys = {Case.of(r).key for r in rows}
    left = list(itertools.islice((c for c in every if c.key not in keys), limit))
    began = clock.monotonic()
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    for number, row in enumerate(parallel(joblib.delayed(run)(case) for case in left), start=1):
        rows.append(row)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        found = row.get("skipped") or [f"{f['type']}@{','.join(f['joints'])}" for f in row["found"]]
        print(f"{number}/{len(left)} {clock.monotonic() - began:.0f} s {Case.of(row).key} {found}", flush=True)
    return rows


def study_parser(doc: str | None, studies: Sequence[str], types: Iterable[str]) -> argparse.ArgumentParser:
    """What every study of hidden effects is asked."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="file of results, one JSON line a run; it is continued")
    parser.add_argument("--table", type=Path, help="file for the table, Markdown")
    parser.add_argument("--studies", nargs="+", default=list(studies), choices=list(studies))
    parser.add_argument("--types", nargs="+", default=list(types), choices=list(types))
    parser.add_argument("--strengths", nargs="+", type=float, default=list(STRENGTHS))
    parser.add_argument("--limit", type=int, default=10**9, help="runs at most, this time")
    parser.add_argument("--jobs", type=int, default=2)
    return parser


def show(table: str, file: Path | None) -> None:
    """Print a study's table, and write it where a file is given."""
    print(table)
    if file:
        file.write_text(table)
