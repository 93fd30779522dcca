"""The section of a path report that compares a measured tip with the predicted one."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.effects.motion import Array
from rx90b_flex.path.check import Deviation
from rx90b_flex.path.measured import MeasuredTip
from rx90b_flex.view.axes import AFTER, BEFORE, MEASURED, REACHED, legend, new_figure
from rx90b_flex.view.page import PageTable, Section, image

NAMES = {"measured": "measured", "predicted": "predicted", "difference": "measured less predicted"}


def largest(of: Deviation) -> tuple[str, str, str]:
    """Largest deviation across, its root mean square, and where it is largest, in figures."""
    return f"{of.max_across:.4f}", f"{of.rms_across:.4f}", f"{of.worst_at_mm:.0f}"


def measured_section(of: MeasuredTip) -> Section:
    """Table and figure of a comparison."""
    head = ("tip", "across, largest, mm", "RMS, mm", "at, mm", "along, largest, mm")
    rows = [
        (NAMES[name], *largest(tip), f"{tip.max_along:.4f}" if of.aligned == "time" else "not known")
        for name, tip in of.tips.items()
    ]
    if of.aligned == "time":
        how = (
            f"Both tips at the same instant; the path begins at {of.shift_s:.4f} s of {of.file.name}, found as the shift that brings "
            "the tips closest, so that a mean lag along the path is not seen."
        )
    else:
        how = f"Each measured place beside the nearest predicted one, for {of.file.name} has no times."
    if of.explained > 0.0:
        part = f"{100 * of.explained:.0f} %"
        share = f"The prediction takes away {part} of the measured deviation's squares across the path."
    else:
        share = "Without the prediction the measured deviation would be smaller: the model does not explain it."
    figure = image(measured_along_path(of), "Measured and predicted deviation over the length of the path", zoom=True)
    return Section("Measured against predicted", f"{how} {share}", PageTable(head, rows), figure)


def measured_along_path(of: MeasuredTip) -> Figure:
    """Deviation to the left and upwards, measured and predicted, over the length of the path; below it their difference across."""
    figure, axes = new_figure(5.6, rows=3, heights=(1.0, 1.0, 0.9), sharex=True)
    for ax, part in zip(axes, ("left", "up"), strict=False):
        for name, tip, colour, style in (
            ("measured", of.measured, MEASURED, "-"),
            ("predicted", of.predicted, AFTER, "--"),
        ):
            ax.plot(*_drawn(of, tip, getattr(tip, part)), color=colour, linestyle=style, linewidth=1.1, label=name)
        ax.set_ylabel(f"deviation {part},\nmm")
        legend(ax)
    bottom = axes[2]
    bottom.axhspan(0.0, of.tolerance_mm, color=REACHED, alpha=0.15, linewidth=0.0, label="tolerance")
    off = of.difference
    bottom.plot(*_drawn(of, off, off.across), color=BEFORE, linewidth=1.1, label=NAMES["difference"])
    bottom.set(xlabel="distance along the path, mm", ylabel="across, mm", xlim=(0.0, off.length_mm))
    bottom.set_ylim(bottom=0.0)
    legend(bottom)
    figure.align_ylabels()
    return figure


def _drawn(of: MeasuredTip, tip: Deviation, values: Array) -> tuple[Array, Array]:
    """Places along the path, whatever the order of the measurement, and values there, with gaps where nothing was measured."""
    middle = np.array([(a + b) / 2.0 for a, b in of.unmeasured_mm])
    distance, values = np.r_[tip.distance_mm, middle], np.r_[values, np.full(len(middle), np.nan)]
    at = np.argsort(distance, kind="stable")
    return distance[at], values[at]
