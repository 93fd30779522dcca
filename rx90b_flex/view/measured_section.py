"""The section of a path report that compares a measured tip with the predicted one."""

from __future__ import annotations

from matplotlib.figure import Figure

from rx90b_flex.path.measured import MeasuredTip
from rx90b_flex.view.page import PageTable, Section, image
from rx90b_flex.view.plots import AFTER, BEFORE, MEASURED, _figure, _legend


def measured_section(of: MeasuredTip) -> Section:
    """Table and figure of a comparison."""
    head = ("tip", "across, largest, mm", "RMS, mm", "at, mm", "along, largest, mm")
    rows = []
    for name, part in (
        ("measured", of.measured), ("predicted", of.predicted), ("measured less predicted", of.difference)
    ):  # fmt: skip
        along = f"{part.max_along:.4f}" if of.aligned == "time" else "not known"
        rows.append((name, f"{part.max_across:.4f}", f"{part.rms_across:.4f}", f"{part.worst_at_mm:.0f}", along))
    if of.aligned == "time":
        how = (
            f"Both tips at the same instant; the path begins at {of.shift_s:.4f} s of {of.file.name}, found as the shift that brings "
            "the tips closest, so that a mean lag along the path is not seen."
        )
    else:
        how = f"Each measured place beside the nearest predicted one, for {of.file.name} has no times."
    if of.explained > 0.0:
        share = (
            f"The prediction takes away {100 * of.explained:.0f} % of the measured deviation's squares across the path."
        )
    else:
        share = "Without the prediction the measured deviation would be smaller: the model does not explain it."
    text = (f"{how} {share}",)
    figure = image(measured_along_path(of), "Measured and predicted deviation over the length of the path", zoom=True)
    return Section("Measured against predicted", text, (PageTable(head, tuple(rows)),), (figure,))


def measured_along_path(of: MeasuredTip) -> Figure:
    """Deviation to the left and upwards, measured and predicted, over the length of the path; below it their difference across."""
    figure, axes = _figure(3, 5.6, heights=(1.0, 1.0, 0.9), sharex=True)
    for ax, part in zip(axes, ("left", "up"), strict=False):
        for name, tip, colour, style in (
            ("measured", of.measured, MEASURED, "-"),
            ("predicted", of.predicted, AFTER, "--"),
        ):
            ax.plot(tip.distance_mm, getattr(tip, part), color=colour, linestyle=style, linewidth=1.1, label=name)
        ax.set_ylabel(f"deviation {part},\nmm" if part == "left" else "deviation up,\nmm", fontsize=9)
        _legend(ax)
    bottom = axes[2]
    bottom.axhspan(0.0, of.tolerance_mm, color="#009e73", alpha=0.15, linewidth=0.0, label="tolerance")
    bottom.plot(
        of.difference.distance_mm, of.difference.across, color=BEFORE, linewidth=1.1, label="measured less predicted"
    )
    bottom.set_ylabel("across, mm", fontsize=9)
    bottom.set_xlabel("distance along the path, mm", fontsize=9)
    bottom.set_xlim(0.0, of.measured.length_mm)
    bottom.set_ylim(bottom=0.0)
    _legend(bottom)
    figure.align_ylabels()
    return figure
