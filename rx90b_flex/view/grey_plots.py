"""Figures of a grey box.

Each function takes results and returns a `matplotlib.figure.Figure`; none knows of a window or of pyplot.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.identify.grey_box import GreyBox

ESTIMATE, DECLARED, BOUND = "#0072b2", "#d55e00", "#8a8a8a"
WIDTH_IN = 8.7  # that of a three by three grid of responses


def intervals(grey: GreyBox) -> Figure:
    """95 % intervals of stiffness and inertia, over the estimates, with the declared values."""
    shown = [e for e in grey.estimates if e.name.rsplit(".", 1)[1].startswith(("drive_", "joint_", "base_"))]
    shown = sorted(shown, key=lambda e: ("damping" in e.name, "stiffness" in e.name))
    figure = Figure(figsize=(WIDTH_IN, 0.8 + 0.2 * len(shown)), layout="constrained")
    ax = figure.subplots()
    y = np.arange(len(shown))
    value = np.array([e.value for e in shown])
    low, high, start = (np.array([getattr(e, name) for e in shown]) / value for name in ("low", "high", "start"))
    ax.hlines(y, low, high, color=ESTIMATE, lw=3, alpha=0.6, label="95 % interval")
    ax.plot(np.ones(len(y)), y, "|", color=ESTIMATE, ms=8, label="estimate")
    ax.plot(start, y, "D", color=DECLARED, ms=4, label="declared")
    ax.set_xscale("log")
    ax.set_yticks(y, [e.name.replace(".", " ").replace("_", " ") for e in shown], fontsize=7)
    ax.invert_yaxis()
    span = np.clip([min(low.min(), start.min()), max(high.max(), start.max())], 0.3, 3.0)
    ax.set_xlim(0.97 * span[0], 1.03 * span[1])
    ticks = [t for t in (0.3, 0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5, 2.0, 3.0) if span[0] <= t <= span[1]]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks], minor=False)
    ax.minorticks_off()
    ax.tick_params(axis="x", labelsize=7)
    ax.set_xlabel("over the estimate, -", fontsize=8)
    ax.grid(axis="x", color="#e4e4e4", lw=0.5)
    ax.legend(fontsize=7, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return figure


def residuals(grey: GreyBox, response: int = 0) -> Figure:
    """Size of the whitened residuals at each line (1 where noise and distortion explain them), with 95 % of what chance gives."""
    error = grey.errors[response].reshape(len(grey.responses[response].hz), -1)
    size = (np.abs(error) ** 2).mean(axis=1)
    figure = Figure(figsize=(WIDTH_IN, 2.4), layout="constrained")
    ax = figure.subplots()
    entries = error.shape[1]
    ax.plot(grey.responses[response].hz, size, ".-", color=ESTIMATE, lw=0.7, ms=3, label="mean square over the entries")
    # the mean of so many squares of circular normal errors has the relative deviation 1 / sqrt(entries)
    ax.axhline(1.0, color=BOUND, lw=0.8)
    ax.axhline(1.0 + 1.645 / np.sqrt(entries), color=BOUND, lw=0.8, ls="--", label="95 % of right models below")
    ax.set_ylim(0.0, max(3.0, 1.1 * float(np.percentile(size, 98))))
    ax.set_xlabel("frequency, Hz", fontsize=8)
    ax.set_ylabel("squared residual over its variance, -", fontsize=8)
    ax.tick_params(labelsize=7)
    ax.grid(color="#e4e4e4", lw=0.5)
    ax.legend(fontsize=6.5, frameon=False)
    return figure
