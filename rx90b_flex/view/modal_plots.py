"""Figures of measured modes beside a model's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from rx90b_flex.diagnose.modal import Compared

MEASURED, BEFORE, AFTER = "#0072b2", "#8a8a8a", "#d55e00"
ROWS = {"declared": 2.0, "measured": 1.0, "found": 0.0}
TICKS = (5, 7, 10, 14, 20, 28, 40, 56, 80, 110, 160, 220, 320)


def ladder(before: Sequence[Compared], after: Sequence[Compared]) -> Figure:
    """Each list's measured modes between those of the declared and of the changed model, on a logarithmic axis.

    Lines join partners; a measured mode without one has a ring, a model's mode without one stands alone. Error bars: two standard
    deviations.
    """
    figure = Figure(figsize=(8.2, 0.5 + 1.35 * len(before)), layout="constrained")
    axes = figure.subplots(len(before), 1, sharex=True, squeeze=False)[:, 0]
    everything = np.concatenate([c.measured.hz for c in before])
    low, high = 0.85 * everything.min(), 1.35 * everything.max()
    for ax, b, a in zip(axes, before, after, strict=True):
        for compared, row, colour in ((b, ROWS["declared"], BEFORE), (a, ROWS["found"], AFTER)):
            inside = compared.model_hz[(compared.model_hz > low) & (compared.model_hz < high)]
            ax.plot(inside, np.full(len(inside), row), "|", color=colour, ms=13, mew=1.6)
            for i, j in zip(compared.pairing.measured, compared.pairing.model, strict=True):
                ends = [compared.measured.hz[i], compared.model_hz[j]]
                ax.plot(ends, [ROWS["measured"], row], color=colour, lw=0.7, alpha=0.8)
        hz, std = b.measured.hz, b.measured.std_hz
        level = np.full(len(hz), ROWS["measured"])
        ax.errorbar(hz, level, xerr=2 * std, fmt="o", ms=4, color=MEASURED, elinewidth=1.4, capsize=2.5, zorder=3)
        left = np.setdiff1d(np.arange(len(hz)), a.pairing.measured)
        ax.plot(hz[left], level[left], "o", ms=9, mfc="none", mec=AFTER, zorder=4)
        ax.set_title(b.measured.name.replace("_", " "), fontsize=8, loc="left", pad=3)
        ax.set_ylim(-0.5, 2.5)
        ax.set_yticks(list(ROWS.values()), ["as declared", "measured", "as found"], fontsize=7)
        _log_axis(ax, low, high)
    axes[-1].set_xlabel("undamped frequency, Hz", fontsize=8)
    return figure


def errors(before: Sequence[Compared], after: Sequence[Compared], model_error: float) -> Figure:
    """Measured over model frequency of each pair, less one, in per cent, with two stated standard deviations."""
    figure = Figure(figsize=(8.2, 3.2), layout="constrained")
    axes = figure.subplots(1, len(before), sharey=True, squeeze=False)[0]
    for ax, b, a in zip(axes, before, after, strict=True):
        for compared, colour, marker, name in ((b, BEFORE, "x", "as declared"), (a, AFTER, "o", "as found")):
            hz = compared.measured.hz[compared.pairing.measured]
            std = np.sqrt(compared.measured.variance[compared.pairing.measured] + model_error**2)
            ax.errorbar(
                hz, 100 * np.expm1(compared.errors), yerr=200 * std, fmt=marker, ms=4, color=colour, lw=0.9, capsize=2,
                label=name,
            )  # fmt: skip
        ax.axhline(0.0, color="black", lw=0.5)
        ax.set_title(b.measured.name.replace("_", " ").replace("antiresonances of", "antires.,"), fontsize=8)
        ax.set_xlabel("Hz", fontsize=8)
        _log_axis(ax, 0.85 * b.measured.hz.min(), 1.15 * b.measured.hz.max())
        ax.tick_params(labelsize=7)
    axes[0].set_ylabel("measured over model, less 1, %", fontsize=8)
    axes[0].legend(fontsize=6.5, frameon=False)
    return figure


def _log_axis(ax: Axes, low: float, high: float) -> None:
    ax.set_xscale("log")
    ax.set_xlim(low, high)
    ax.xaxis.set_major_locator(FixedLocator([float(t) for t in TICKS if low <= t <= high]))
    ax.xaxis.set_major_formatter(ScalarFormatter())
    ax.xaxis.set_minor_locator(NullLocator())
    ax.tick_params(axis="x", labelsize=7)
    ax.grid(axis="x", color="#e4e4e4", lw=0.5)
