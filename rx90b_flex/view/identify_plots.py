"""Figures of an identification, each a function that returns one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.effects.motion import Array
from rx90b_flex.view.axes import plain_axes
from rx90b_flex.view.plots import AFTER, FLOOR, MEASURED

WIDTH = 6.4  # inches


def torque_fit(time: Array, measured: Array, predicted: Array, joint: str, model: str = "identified model") -> Figure:
    """Torque of one joint, measured and predicted, and below it what is left; each (N,), s and N m."""
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(time, measured, color=MEASURED, linewidth=1.8, label="measured")
    above.plot(time, predicted, color=AFTER, linewidth=0.8, label=model)
    below.plot(time, measured - predicted, color=AFTER, linewidth=0.8, label="error")
    below.axhline(0.0, color=FLOOR, linewidth=0.6)
    above.set_ylabel(f"{joint}\ntorque, N m", fontsize=9)
    below.set_ylabel("error, N m", fontsize=9)
    below.set_xlabel("time, s", fontsize=9)
    above.legend(frameon=False, fontsize=8, ncols=2)
    for ax in (above, below):
        plain_axes(ax)
    figure.align_ylabels((above, below))
    return figure


def relative_stds(names: Sequence[str], relative: Array) -> Figure:
    """Standard deviation of each parameter over its value, in percent; bars in the order given."""
    figure = Figure(figsize=(WIDTH, 0.7 + 0.19 * len(names)), layout="constrained")
    ax = figure.subplots()
    rows = np.arange(len(names))
    ax.barh(rows, 100 * relative, color=AFTER, height=0.6)
    ax.set_yticks(rows, list(names))
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.axvline(10.0, color=FLOOR, linewidth=0.8, linestyle="--")
    ax.set_xlabel("standard deviation over value, %", fontsize=9)
    plain_axes(ax)
    return figure
