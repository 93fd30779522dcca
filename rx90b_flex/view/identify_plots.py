"""Figures of an identification, each a function that returns one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.effects.motion import Array
from rx90b_flex.view.axes import AFTER, FLOOR, MEASURED, legend, new_figure

WIDTH = 6.4  # inches


def torque_fit(
    time: Array, measured: Array, predicted: Array, joint: str, model: str = "identified model", unit: str = "N m"
) -> Figure:
    """Torque of one joint, measured and predicted, and below it what is left; each (N,), s and `unit`."""
    figure, (above, below) = new_figure(3.2, rows=2, width=WIDTH, heights=(2, 1), sharex=True)
    above.plot(time, measured, color=MEASURED, linewidth=1.8, label="measured")
    above.plot(time, predicted, color=AFTER, linewidth=0.8, label=model)
    below.plot(time, measured - predicted, color=AFTER, linewidth=0.8, label="error")
    below.axhline(0.0, color=FLOOR, linewidth=0.6)
    above.set_ylabel(f"{joint}\ntorque, {unit}")
    below.set(xlabel="time, s", ylabel=f"error, {unit}")
    legend(above)
    figure.align_ylabels((above, below))
    return figure


def relative_stds(names: Sequence[str], relative: Array) -> Figure:
    """Standard deviation of each parameter over its value, in percent; bars in the order given."""
    figure, (ax,) = new_figure(0.7 + 0.19 * len(names), width=WIDTH)
    rows = np.arange(len(names))
    ax.barh(rows, 100 * relative, color=AFTER, height=0.6)
    ax.set_yticks(rows, list(names))
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.axvline(10.0, color=FLOOR, linewidth=0.8, linestyle="--")
    ax.set_xlabel("standard deviation over value, %")
    return figure
