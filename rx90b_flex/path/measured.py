"""A measured tip against the predicted one: what laser tracker or camera saw on the path that a check simulated.

A table of the tip's places (.csv, .csv.gz, .parquet) in the robot's base frame has the columns

    x, y, z    m; or x_mm, y_mm, z_mm
    time       s; optional, its zero anywhere

With times both tips are compared at the same instant, after the clocks were brought together: the shift is the one that brings the
two tips closest. Without, each place is compared with the nearest one of the predicted tip, in whatever order the places are
(`pairing`), and the deviation along the path is not known.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.optimize import minimize_scalar

from rx90b_flex.effects.motion import Array
from rx90b_flex.files.keys import suggestion
from rx90b_flex.files.results import write_json
from rx90b_flex.path.check import Deviation, PathCheck, across_axes
from rx90b_flex.path.output import write_columns
from rx90b_flex.path.pairing import WINDOW, Indices, in_order, nearest_on_path, unmeasured
from rx90b_flex.path.planning import HOLD_S
from rx90b_flex.showing import Showing
from rx90b_flex.signals.tables import read_table

FEWEST = 10  # places
SHIFTS, SAMPLES = 401, 400  # of the first look for the clocks' shift
MANY = 10.0  # times the run's length: times that span more may be ms
FAR = 0.1  # of the path's length (m), and at least NEAR: a tip farther from the path was not on it, or in another frame
NEAR = 0.02  # m
BESIDE = 0.1  # part that distance across counts where what is beside a place is looked for
FINER = 20  # times the samples of the simulated tip
GRID = 20000  # places of the path among which the nearest is looked for
HOLES = 3  # stretches that were not measured that a sentence names
PAUSE = 5.0  # times the usual step of the clock: a longer one is a hole of the measurement

Aligned = Literal["time", "path"]


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredTip(Showing):
    """A measured tip, the predicted one, and the difference, at the same samples.

    Attributes
    ----------
    file : Path
    aligned : str
        By ``time`` or along the ``path``.
    shift_s : float or None
        The path's zero of time on the measurement's clock.
    measured, predicted, difference : Deviation
        From the planned path, and measured less predicted.
    tolerance_mm : float
    unmeasured_mm : tuple of (float, float)
        Stretches of the path that were not measured: its ends, and holes.
    """

    file: Path
    aligned: Aligned
    shift_s: float | None
    measured: Deviation
    predicted: Deviation
    difference: Deviation
    tolerance_mm: float
    unmeasured_mm: tuple[tuple[float, float], ...]

    @property
    def seen(self) -> float:
        """Part of the path that was measured."""
        return 1.0 - sum(b - a for a, b in self.unmeasured_mm) / self.measured.length_mm

    @property
    def tips(self) -> dict[str, Deviation]:
        """The three deviations by name."""
        return {"measured": self.measured, "predicted": self.predicted, "difference": self.difference}

    def columns(self) -> dict[str, Array]:
        """Every sample: its place along the path and the deviations, mm."""
        out = {"distance_mm": self.measured.distance_mm}
        for name, of in self.tips.items():
            out |= of.columns(f"_{name}")
        return out

    @property
    def agrees(self) -> bool:
        """Whether the tip was within the tolerance of where it was predicted, across the path, everywhere."""
        return self.difference.passes(self.tolerance_mm)

    @property
    def explained(self) -> float:
        """Part of the measured deviation's squares, across the path, that the prediction takes away; negative: it adds."""
        return 1.0 - (self.difference.rms_across / max(self.measured.rms_across, 1e-12)) ** 2

    @property
    def _part(self) -> str:
        holes = [f"{a:.0f} to {b:.0f}" for a, b in self.unmeasured_mm]
        named = ", ".join(holes[:HOLES]) + (f" and {len(holes) - HOLES} more" if len(holes) > HOLES else "")
        return f" on the {100 * self.seen:.0f} % of the path that were measured (not on {named} mm)"

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        of = self.difference
        verdict = "within" if self.agrees else "not within"
        part = self._part if self.unmeasured_mm else ""
        return (
            f"The measured tip is up to {of.max_across:.3g} mm across from where it was predicted (at {of.worst_at_mm:.0f} mm along "
            f"the path), {verdict} {self.tolerance_mm:g} mm{part}; it strays from the path by up to "
            f"{self.measured.max_across:.3g} mm, predicted {self.predicted.max_across:.3g} mm."
        )


def read_measured(file: str | os.PathLike[str]) -> tuple[Array, Array | None]:
    """Places (N, 3) of a measured tip, m, and their times (N,), s, where the file has them.

    Raises
    ------
    ValueError
        One line that names the file and the column or row.
    """
    path = Path(file)
    metres, millimetres = ("x", "y", "z"), ("x_mm", "y_mm", "z_mm")
    table = read_table(path, [], optional=["time", *metres, *millimetres])
    names, scale = (millimetres, 1e-3) if "x_mm" in table.names else (metres, 1.0)
    for name in names:
        if name not in table.names:
            raise ValueError(
                f"{path}: no column {name!r}{suggestion(name, table.names)}; expected x, y, z or x_mm, y_mm, z_mm"
            )
    place = scale * table.finite(names)
    time = table.finite(["time"])[:, 0] if "time" in table.names else None
    if time is not None and (np.diff(time) <= 0.0).any():
        row = int(np.flatnonzero(np.diff(time) <= 0.0)[0]) + 2
        raise ValueError(f"{path}: column 'time', row {row}: does not grow")
    if len(place) < FEWEST:
        raise ValueError(f"{path}: {_places(len(place))}; expected at least {FEWEST}")
    return place, time


def compare_measured(result: PathCheck, file: str | os.PathLike[str]) -> MeasuredTip:
    """Compare a measured tip with that of a check's planned run.

    Parameters
    ----------
    result : PathCheck
    file : path
        A table as the module describes it.

    Raises
    ------
    ValueError
        One line that names the file: not such a table, far from the path, or too little of it.
    """
    place, time = read_measured(file)
    _refuse_far(result, Path(file), place)
    return _at_times(result, Path(file), place, time) if time is not None else _along(result, Path(file), place)


def _refuse_far(result: PathCheck, file: Path, place: Array) -> None:
    pieces = result.plan.seam.pieces
    on_path, _ = pieces.at(np.linspace(0.0, pieces.total, 500))
    nearest = np.array([np.linalg.norm(on_path - p, axis=1).min() for p in place[:: max(1, len(place) // 200)]])
    allowed = max(NEAR, FAR * pieces.total)
    if np.median(nearest) > allowed:
        raise ValueError(
            f"{file}: the tip is {1e3 * np.median(nearest):.0f} mm from the path (half of its places are farther); expected places "
            f"in the robot's base frame, m, within {1e3 * allowed:.0f} mm"
        )


# ---- with times -------------------------------------------------------------------------------------------------


def _at_times(result: PathCheck, file: Path, place: Array, time: Array) -> MeasuredTip:
    planned, run = result.plan, result.runs[0]
    shift = _shift(run.time, run.tip[:, :3, 3], place, time)
    on = time - shift - HOLD_S
    last = min(planned.seam.duration_s, float(run.time[-1]) - HOLD_S)
    inside = (on >= 0.0) & (on <= last)
    if inside.sum() < FEWEST:
        hint = _milliseconds(time, float(run.time[-1] - run.time[0]))
        raise ValueError(
            f"{file}: {_places(inside.sum())} while the tip is on its path; expected at least {FEWEST}{hint}"
        )
    distance = planned.seam.motion(on[inside])
    predicted = _interpolate(on[inside] + HOLD_S, run.time, run.tip[:, :3, 3])
    point, tangent = planned.seam.pieces.at(distance)
    missing = [1e3 * (tip - point) for tip in (place[inside], predicted)]
    return _comparison(result, file, "time", shift + HOLD_S, distance, tangent, missing)


def _places(count: int) -> str:
    return f"{count} place{'' if count == 1 else 's'}"


def _milliseconds(time: Array, run_s: float) -> str:
    """A hint where the times would fit the run if they were ms."""
    span = float(np.ptp(time))
    if not (span > MANY * run_s and run_s / MANY < 1e-3 * span < MANY * run_s):
        return ""
    return f"; column 'time' spans {span:.4g} s and the run lasts {run_s:.3g} s: look whether it is in ms"


def _shift(clock: Array, tip: Array, place: Array, time: Array) -> float:
    """Time of the measurement at which the run's is zero: the mean square distance of both tips is least."""
    few = _without_holes(np.linspace(time[0], time[-1], SAMPLES), time)
    seen = _interpolate(few, time, place)

    def cost(shift: float) -> float:
        return float(np.mean(np.sum((seen - _interpolate(few - shift, clock, tip)) ** 2, axis=1)))

    # from where the measurement ends as the path begins to where it begins as that ends
    shifts = np.linspace(time[0] - clock[-1], time[-1] - clock[0], SHIFTS)
    best = int(np.argmin([cost(s) for s in shifts]))
    low, high = shifts[max(best - 1, 0)], shifts[min(best + 1, SHIFTS - 1)]
    few = time if len(time) <= 20 * SAMPLES else _without_holes(np.linspace(time[0], time[-1], 20 * SAMPLES), time)
    seen = _interpolate(few, time, place)
    return float(minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-7}).x)


def _without_holes(at: Array, time: Array) -> Array:
    """Those instants at which the measurement does not pause: between its places it is no straight line."""
    step = np.diff(time)
    inside = step[np.clip(np.searchsorted(time, at) - 1, 0, len(step) - 1)] <= PAUSE * np.median(step)
    return at[inside] if inside.any() else time


def _interpolate(at: Array, time: Array, place: Array) -> Array:
    """Places at times, shape (K, 3); before the first and after the last it stands still."""
    return np.stack([np.interp(at, time, column) for column in place.T], axis=1)


# ---- without times ----------------------------------------------------------------------------------------------


def _along(result: PathCheck, file: Path, place: Array) -> MeasuredTip:
    pieces = result.plan.seam.pieces
    grid = np.linspace(0.0, pieces.total, GRID)
    on_path, _ = pieces.at(grid)
    nearest = nearest_on_path(on_path, place)
    # before the first and behind the last place of the path there is none beside it
    kept = (nearest > 0) & (nearest < GRID - 1)
    if kept.sum() < FEWEST:
        raise ValueError(f"{file}: {_places(kept.sum())} beside the path; expected at least {FEWEST}")
    place, nearest = place[kept], nearest[kept]
    point, tangent = pieces.at(grid[nearest])
    predicted = _beside(result, on_path, nearest, place, tangent)
    missing = [1e3 * (tip - point) for tip in (place, predicted)]
    return _comparison(result, file, "path", None, grid[nearest], tangent, missing)


def _beside(result: PathCheck, on_path: Array, nearest: Indices, place: Array, tangent: Array) -> Array:
    """Where the predicted tip was beside each place, (N, 3): distance across the path counts `BESIDE` of that along it."""
    run = result.runs[0]
    reached = np.maximum.accumulate(in_order(on_path, run.tip[:, :3, 3]))
    # with the rest before and after the path, for the tip lags; between its samples
    fine = np.linspace(run.time[0], run.time[-1], FINER * len(run.time))
    tip = _interpolate(fine, run.time, run.tip[:, :3, 3])
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))]
    there = length[np.minimum(np.searchsorted(np.interp(fine, run.time, reached), nearest), len(fine) - 1)]
    begins, ends = np.searchsorted(length, [there - WINDOW, there + WINDOW])
    found = np.empty_like(place)
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        off = tip[begin : end + 1] - place[k]
        along = (off @ tangent[k]) ** 2
        found[k] = tip[begin + np.argmin(along + BESIDE**2 * (np.sum(off**2, axis=1) - along))]
    return found


def _comparison(
    result: PathCheck, file: Path, aligned: Aligned, shift: float | None, distance: Array, tangent: Array, missing: list[Array]
) -> MeasuredTip:  # fmt: skip
    left, up = across_axes(tangent)
    order = np.argsort(distance, kind="stable")
    length = 1e3 * result.plan.seam.pieces.total

    def split(off: Array) -> Deviation:
        along, aside, above = (np.einsum("ki,ki->k", axis, off)[order] for axis in (tangent, left, up))
        return Deviation(1e3 * distance[order], length, along, aside, above)

    measured, predicted = (split(off) for off in missing)
    parts = {name: getattr(measured, name) - getattr(predicted, name) for name in ("along", "left", "up")}
    difference = dataclasses.replace(measured, **parts)
    missed = tuple(unmeasured(1e3 * distance, length))
    return MeasuredTip(file, aligned, shift, measured, predicted, difference, result.options.tolerance_mm, missed)


# ---- files ------------------------------------------------------------------------------------------------------


def write_measured(of: MeasuredTip, folder: Path) -> None:
    """Write `measured.json`, and `measured.csv` with every sample: its place along the path and the three deviations, mm."""
    write_json(folder / "measured.json", as_json(of), indent=1, allow_nan=True)
    write_columns(folder / "measured.csv", of.columns(), digits=6)


def as_json(of: MeasuredTip) -> dict[str, Any]:
    """Everything but the samples."""
    return {
        "schema": 1,
        "file": of.file.name,
        "aligned": of.aligned,
        "shift_s": of.shift_s,
        "tolerance_mm": of.tolerance_mm,
        "agrees": of.agrees,
        "explained": of.explained,
        "seen": of.seen,
        "unmeasured_mm": [list(part) for part in of.unmeasured_mm],
        "samples": len(of.measured.distance_mm),
        **{
            name: {
                "max_across_mm": part.max_across,
                "rms_across_mm": part.rms_across,
                "worst_at_mm": part.worst_at_mm,
                "max_along_mm": part.max_along if of.aligned == "time" else None,
            }
            for name, part in of.tips.items()
        },
    }
