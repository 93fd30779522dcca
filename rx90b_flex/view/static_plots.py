"""Figures of dead-weight tests. Each function takes results and returns a `matplotlib.figure.Figure`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.identify.static_stiffness import StaticStiffness
from rx90b_flex.signals.static_test import StaticTest
from rx90b_flex.view.axes import plain_axes

LOADING, UNLOADING = "#d55e00", "#0072b2"


def static_test_figure(tests: Sequence[StaticTest], found: Sequence[StaticStiffness], columns: int = 3) -> Figure:
    """Deformation over moment of each test, up and down, with a line for each direction: figure 4.2."""
    columns = min(columns, len(tests))
    rows = -(-len(tests) // columns)
    figure = Figure(figsize=(1.0 + 2.7 * columns, 0.5 + 2.2 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for ax in grid.ravel()[len(tests) :]:
        ax.set_axis_off()
    for ax, test, result in zip(grid.ravel(), tests, found, strict=False):
        for rows_, line, colour, mark, label in (
            (test.rising, result.loading, LOADING, "o", "loading"),
            (~test.rising, result.unloading, UNLOADING, "x", "unloading"),
        ):
            at, turned = test.moment[rows_], 1e3 * test.deformation[rows_]
            ax.plot(at, turned, mark, color=colour, markersize=4, label=label)
            ends = np.array([test.moment.min(), test.moment.max()])
            lined = line.deformation + (ends - line.mean_moment) / line.stiffness
            ax.plot(ends, 1e3 * lined, color=colour, linewidth=0.8)
        low, high = (f"{k / 1e5:.2f}" for k in result.interval)
        ax.set_title(
            f"{result.coordinate}\n{result.stiffness / 1e5:.2f} ({low} to {high}) 10⁵ N m/rad, p = {result.p_value:.2g}",
            fontsize=8,
        )
        plain_axes(ax)
    for ax in grid[:, 0]:
        ax.set_ylabel("deformation, 10⁻³ rad", fontsize=8)
    for place in range(len(tests)):
        if place + columns >= len(tests):
            grid.ravel()[place].set_xlabel("moment, N m", fontsize=8)
    grid[0, 0].legend(fontsize=7, frameon=False, loc="upper left")
    return figure
