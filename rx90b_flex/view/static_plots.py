"""Figures of dead-weight tests. Each function takes results and returns a `matplotlib.figure.Figure`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.identify.static_stiffness import StaticStiffness
from rx90b_flex.signals.static_test import StaticTest
from rx90b_flex.view.axes import AFTER, BEFORE, new_figure


def static_test_figure(tests: Sequence[StaticTest], found: Sequence[StaticStiffness], columns: int = 3) -> Figure:
    """Deformation over moment of each test, up and down, with a line for each direction: figure 4.2."""
    columns = min(columns, len(tests))
    rows = -(-len(tests) // columns)
    figure, axes = new_figure(0.5 + 2.2 * rows, rows, columns, width=1.0 + 2.7 * columns, labels=8, sharey=True)
    for ax in axes[len(tests) :]:
        ax.set_axis_off()
    for place, (ax, test, result) in enumerate(zip(axes, tests, found, strict=False)):
        for part, line, colour, mark, label in (
            (test.rising, result.loading, BEFORE, "o", "loading"),
            (~test.rising, result.unloading, AFTER, "x", "unloading"),
        ):
            at, turned = test.moment[part], 1e3 * test.deformation[part]
            ax.plot(at, turned, mark, color=colour, markersize=4, label=label)
            ends = np.array([test.moment.min(), test.moment.max()])
            lined = line.deformation + (ends - line.mean_moment) / line.stiffness
            ax.plot(ends, 1e3 * lined, color=colour, linewidth=0.8)
        low, high = (f"{k / 1e5:.2f}" for k in result.interval)
        ax.set_title(
            f"{result.coordinate}\n{result.stiffness / 1e5:.2f} ({low} to {high}) 10⁵ N m/rad, p = {result.p_value:.2g}",
            fontsize=8,
        )
        if place + columns >= len(tests):
            ax.set_xlabel("moment, N m")
    for ax in axes[::columns]:
        ax.set_ylabel("deformation, 10⁻³ rad")
    axes[0].legend(fontsize=7, frameon=False, loc="upper left")
    return figure
