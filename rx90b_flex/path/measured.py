"""A measured tip against the predicted one: what laser tracker or camera saw on the path that a check simulated.

A table of the tip's places (.csv, .csv.gz, .parquet) in the robot's base frame has the columns

    x, y, z    m; or x_mm, y_mm, z_mm
    time       s; optional, its zero anywhere

With times both tips are compared at the same instant, after the clocks were brought together: the shift is the one that brings the
two tips closest. Without, each place is compared with the nearest one of the predicted tip, and the deviation along the path is not
known.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from rx90b_flex.effects.motion import Array
from rx90b_flex.files.keys import suggestion
from rx90b_flex.files.results import write_json
from rx90b_flex.path.check import Deviation, PathCheck, across_axes
from rx90b_flex.path.output import write_columns
from rx90b_flex.path.planning import HOLD_S
from rx90b_flex.showing import Showing
from rx90b_flex.signals.tables import read_table

FEWEST = 10  # places
SHIFTS, SAMPLES = 401, 400  # of the first look for the clocks' shift
FAR = 0.1  # of the path's length (m), and at least NEAR: a tip farther from the path was not on it, or in another frame
NEAR = 0.02  # m
WINDOW = 0.005  # m, and three times the step: how far ahead on the path the next place is looked for
BESIDE = 0.1  # part that distance across counts where what is beside a place is looked for
FINER = 20  # times the samples of the simulated tip
GRID = 20000  # places of the path among which the nearest is looked for
SEEN = 0.95  # of the path: a measurement of less is said to be one of a part

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
    seen : float
        Part of the path that was measured.
    """

    file: Path
    aligned: Aligned
    shift_s: float | None
    measured: Deviation
    predicted: Deviation
    difference: Deviation
    tolerance_mm: float
    seen: float

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
    def sentence(self) -> str:
        """The verdict in words."""
        of = self.difference
        verdict = "within" if self.agrees else "not within"
        part = "" if self.seen >= SEEN else f" on the {100 * self.seen:.0f} % of the path that were measured"
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
        raise ValueError(f"{path}: {len(place)} places; expected at least {FEWEST}")
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
        raise ValueError(f"{file}: {inside.sum()} places while the tip is on its path; expected at least {FEWEST}")
    distance = planned.seam.motion(on[inside])
    predicted = _interpolate(on[inside] + HOLD_S, run.time, run.tip[:, :3, 3])
    point, tangent = planned.seam.pieces.at(distance)
    missing = [1e3 * (tip - point) for tip in (place[inside], predicted)]
    return _comparison(result, file, "time", shift + HOLD_S, distance, tangent, missing)


def _shift(clock: Array, tip: Array, place: Array, time: Array) -> float:
    """Time of the measurement at which the run's is zero: the mean square distance of both tips is least."""
    few = np.linspace(time[0], time[-1], SAMPLES)
    seen = _interpolate(few, time, place)

    def cost(shift: float) -> float:
        return float(np.mean(np.sum((seen - _interpolate(few - shift, clock, tip)) ** 2, axis=1)))

    # from where the measurement ends as the path begins to where it begins as that ends
    shifts = np.linspace(time[0] - clock[-1], time[-1] - clock[0], SHIFTS)
    best = int(np.argmin([cost(s) for s in shifts]))
    low, high = shifts[max(best - 1, 0)], shifts[min(best + 1, SHIFTS - 1)]
    few = time if len(time) <= 20 * SAMPLES else np.linspace(time[0], time[-1], 20 * SAMPLES)
    seen = _interpolate(few, time, place)
    return float(minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-7}).x)


def _interpolate(at: Array, time: Array, place: Array) -> Array:
    """Places at times, shape (K, 3); before the first and after the last it stands still."""
    return np.stack([np.interp(at, time, column) for column in place.T], axis=1)


# ---- without times ----------------------------------------------------------------------------------------------


def _along(result: PathCheck, file: Path, place: Array) -> MeasuredTip:
    pieces, run = result.plan.seam.pieces, result.runs[0]
    grid = np.linspace(0.0, pieces.total, GRID)
    on_path, _ = pieces.at(grid)
    nearest = _nearest(on_path, place)
    # before the first and behind the last place of the path there is none beside it
    kept = (nearest > 0) & (nearest < GRID - 1)
    if kept.sum() < FEWEST:
        raise ValueError(f"{file}: {kept.sum()} places beside the path; expected at least {FEWEST}, in their order")
    place, distance = place[kept], grid[nearest[kept]]
    point, tangent = pieces.at(distance)
    # with the rest before and after the path, for the tip lags; between its samples
    fine = np.linspace(run.time[0], run.time[-1], FINER * len(run.time))
    predicted = _interpolate(fine, run.time, run.tip[:, :3, 3])
    predicted = predicted[_nearest(predicted, place, tangent)]
    missing = [1e3 * (tip - point) for tip in (place, predicted)]
    return _comparison(result, file, "path", None, distance, tangent, missing)


def _nearest(curve: Array, place: Array, tangent: Array | None = None) -> NDArray[np.int64]:
    """Which point of a curve (G, 3) is nearest to each place (N, 3), looked for from the last one on; shape (N,).

    With the path's tangents (N, 3): which is beside it, so that distance across the path counts `BESIDE` of that along it.
    """
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    steps = np.r_[0.0, np.linalg.norm(np.diff(place, axis=0), axis=1)]
    # of a closed curve the first place is near both ends: it is in the first half
    half = np.searchsorted(length, 0.5 * length[-1]) + 1
    last = int(np.argmin(np.linalg.norm(curve[:half] - place[0], axis=1)))
    found = np.empty(len(place), dtype=np.int64)
    for k, (p, step) in enumerate(zip(place, steps, strict=True)):
        reach = WINDOW + 3.0 * step
        begin, end = np.searchsorted(length, [length[last] - reach / 3.0, length[last] + reach])
        off = curve[begin : end + 1] - p
        squares = np.sum(off**2, axis=1)
        if tangent is not None:
            along = (off @ tangent[k]) ** 2
            squares = along + BESIDE**2 * (squares - along)
        last = int(begin) + int(np.argmin(squares))
        found[k] = last
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
    seen = float(np.ptp(distance)) * 1e3 / length
    return MeasuredTip(file, aligned, shift, measured, predicted, difference, result.options.tolerance_mm, seen)


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
