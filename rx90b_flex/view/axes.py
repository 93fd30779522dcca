"""How figures look: colours that stand for one thing everywhere, one way to make axes, and one kind of legend.

No figure knows of a window or of pyplot, so they can be made in any thread and saved with ``figure.savefig``. Before is always orange
with squares, after always blue with circles: colours that stay apart for colour-blind eyes, and marks that stay apart on paper.
"""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

BEFORE, AFTER, MEASURED, FLOOR = "#d55e00", "#0072b2", "#8a8a8a", "#000000"
REACHED = "#009e73"  # what can be reached: by a free-form model, or within a tolerance
WIDTH_IN = 5.4  # about the width of a column of the report, so that text keeps its size


def plain_axes(ax: Axes, labels: float = 9.0) -> None:
    """Small numbers and labels (points), no frame above and beside, a light grid behind what is drawn."""
    ax.tick_params(labelsize=8)
    ax.xaxis.label.set_fontsize(labels)
    ax.yaxis.label.set_fontsize(labels)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#e6e6e6", linewidth=0.5)
    ax.set_axisbelow(True)


def new_figure(
    height: float,
    rows: int = 1,
    columns: int = 1,
    *,
    width: float = WIDTH_IN,
    labels: float = 9.0,
    heights: Sequence[float] | None = None,
    sharex: bool = False,
    sharey: bool = False,
    dpi: float | None = None,
) -> tuple[Figure, list[Axes]]:
    """A figure (inches) and its plain axes, row by row; `labels` as in `plain_axes`, the others as in `Figure` and its `subplots`."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=dpi)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey, height_ratios=heights).ravel()
    for ax in axes:
        plain_axes(ax, labels)
    return figure, list(axes)


def legend(ax: Axes) -> None:
    """In a row above the axes, to the right."""
    ax.legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
