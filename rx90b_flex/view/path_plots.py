"""Figures of a path check. Each function takes the result and returns a `matplotlib.figure.Figure`."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from rx90b_flex.effects.motion import Array
from rx90b_flex.path.check import Deviation, PathCheck, across_axes
from rx90b_flex.view.axes import AFTER, BEFORE, FLOOR, MEASURED, REACHED, legend, new_figure

PART_COLOURS = {"links": "#8a8a8a", "friction": "#d55e00", "flexibility": "#0072b2", "spring": "#009e73"}
OTHER_COLOUR = "#cc79a7"
SHOWN_EFFECTS = 14
MAGNIFIED = 0.08  # of the picture's width: how long the largest deviation is drawn


def deviation_along_path(result: PathCheck) -> Figure:
    """Deviation across the path over its length, before and after, with the tolerance; below it the three components before."""
    figure, (top, bottom) = new_figure(4.6, rows=2, heights=(1.2, 1.0), sharex=True)
    tolerance, before, after = result.options.tolerance_mm, result.before, result.after
    top.axhspan(0.0, tolerance, color=REACHED, alpha=0.15, linewidth=0.0, label="tolerance")
    _steps(top, before, BEFORE, "as planned")
    if after is not None:
        _steps(top, after, AFTER, "corrected")
    top.set_ylim(0.0, 1.08 * max(before.max_across, tolerance))
    top.set_ylabel("largest deviation across\nin each millimetre, mm")
    legend(top)
    for values, colour, style, label in (
        (before.along, MEASURED, ":", "along"),
        (before.left, OTHER_COLOUR, "--", "left"),
        (before.up, "#56b4e9", "-", "up"),
    ):
        bottom.plot(before.distance_mm, values, color=colour, linestyle=style, linewidth=1.0, label=label)
    bottom.set(xlabel="distance along the path, mm", ylabel="deviation as planned,\nmm", xlim=(0.0, before.length_mm))
    legend(bottom)
    figure.align_ylabels()
    return figure


def _steps(ax: Axes, of: Deviation, colour: str, label: str) -> None:
    value = np.where(np.isfinite(of.by_mm), of.by_mm, np.nan)
    edges = np.append(np.arange(len(value)), of.length_mm)
    ax.plot(edges, np.append(value, value[-1]), drawstyle="steps-post", color=colour, linewidth=1.1, label=label)


def contributions(result: PathCheck) -> Figure:
    """What each effect does to the deviation, largest first: RMS across of the difference that switching it off makes."""
    shown = sorted((c for c in result.contributions if c.why_not is None), key=lambda c: -c.rms_across)[:SHOWN_EFFECTS]
    figure, (ax,) = new_figure(0.9 + 0.24 * len(shown))
    rows = np.arange(len(shown))
    colours = [PART_COLOURS.get(c.part, OTHER_COLOUR) for c in shown]
    ax.barh(rows, [c.rms_across for c in shown], 0.7, color=colours)
    ax.set_yticks(rows, [c.name for c in shown])
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    for part, colour in PART_COLOURS.items():
        if any(c.part == part for c in shown):
            ax.barh([0], [0], color=colour, label="links, controller" if part == "links" else part)
    ax.set_xlabel("contribution to the deviation across, RMS, mm")
    legend(ax)
    return figure


def path_picture(result: PathCheck) -> Figure:
    """The path from above and from the side, with the tip's deviation before and after drawn larger than it is."""
    pieces = result.plan.seam.pieces
    point, _ = pieces.at(np.linspace(0.0, pieces.total, 2000))
    point = 1e3 * point
    spread = np.ptp(point, axis=0)
    factor = _round_down(MAGNIFIED * float(spread.max()) / max(result.before.max_across, 1e-9))
    side = 0 if spread[0] > spread[1] else 1  # the horizontal axis along which the path is longer
    flat = spread[[1 - side, 2]].max() < 0.4 * spread[side]
    figure, axes = new_figure(4.2, rows=2 if flat else 1, columns=1 if flat else 2)
    for ax, (i, j) in zip(axes, ((side, 1 - side), (side, 2)), strict=True):
        ax.plot(point[:, i], point[:, j], color=FLOOR, linewidth=0.8, label="path")
        for of, colour, style, label in (
            (result.before, BEFORE, "-", "as planned"),
            (result.after, AFTER, "--", "corrected"),
        ):
            if of is not None:
                moved = _place(result, of, factor)
                ax.plot(moved[:, i], moved[:, j], color=colour, linestyle=style, linewidth=1.0, label=label)
        ax.plot(*point[0, [i, j]], marker="o", markersize=4, color=FLOOR, linestyle="none")
        ax.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm")
        ax.set_aspect("equal", adjustable="datalim")
    axes[0].set_title("from above", fontsize=9)
    axes[1].set_title("from the side", fontsize=9)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, [labels[0], *(f"{x} (deviation ×{factor:g})" for x in labels[1:])], fontsize=8, frameon=False,
                  loc="outside upper center", ncols=3)  # fmt: skip
    return figure


def _place(result: PathCheck, of: Deviation, factor: float) -> Array:
    """Tip with its deviation magnified, mm."""
    point, tangent = result.plan.seam.pieces.at(1e-3 * of.distance_mm)
    left, up = across_axes(tangent)
    moved = of.along[:, None] * tangent + of.left[:, None] * left + of.up[:, None] * up
    return np.asarray(1e3 * point + factor * moved)


def _round_down(value: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9)) * power)


def convergence(result: PathCheck) -> Figure:
    """Deviation across after each iteration of the correction."""
    figure, (ax,) = new_figure(2.2)
    steps = np.arange(len(result.iterations))
    largest, rms = zip(*result.iterations, strict=True)
    ax.semilogy(steps, largest, color=AFTER, marker="o", markersize=4, label="largest")
    ax.semilogy(steps, rms, color=MEASURED, marker="s", markersize=4, linestyle="--", label="RMS")
    ax.axhline(result.options.tolerance_mm, color=REACHED, linewidth=1.0, label="tolerance")
    ax.set_xticks(steps)
    for ticks in (ax.yaxis.set_major_formatter, ax.yaxis.set_minor_formatter):
        ticks(FuncFormatter(lambda value, _: f"{value:g}" if np.isclose(_round_down(value), value) else ""))
    ax.set(xlabel="iteration", ylabel="deviation across, mm")
    legend(ax)
    return figure
