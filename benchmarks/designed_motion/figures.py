"""Figures of a designed excitation. Each function takes a design and returns a `matplotlib.figure.Figure`."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from designed_motion.search import Assessment, Design

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
BEFORE, AFTER = "#d55e00", "#0072b2"
WIDTH_IN = 5.4


def references(design: Design) -> Figure:
    """Angle, speed and feed-forward torque of each joint as parts of their limits, over one period."""
    trajectory, limits = design.trajectory, design.limits
    time = np.arange(len(trajectory.position)) / trajectory.rate_hz
    figure = Figure(figsize=(WIDTH_IN, 5.2), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
    shown = (
        ((trajectory.position - middle) / half, "angle"),
        (trajectory.velocity / limits.velocity, "speed"),
        (trajectory.torque / limits.torque, "feed-forward torque"),
    )
    for ax, (values, label) in zip(axes, shown, strict=True):
        for j, joint in enumerate(trajectory.joints):
            width = 0.5 if ax is axes[-1] else 1.2
            ax.plot(time, values[:, j], color=COLOURS[j % len(COLOURS)], linewidth=width, label=joint.replace("_", " "))
        for bound in (-1.0, 1.0):
            ax.axhline(bound, color="#000000", linewidth=0.8, linestyle="--")
        ax.set_ylim(-1.1, 1.1)
        ax.set_ylabel(f"{label},\npart of its limit", fontsize=9)
        ax.grid(color="#eeeeee", linewidth=0.6)
    axes[-1].set_xlabel("time, s", fontsize=9)
    axes[0].legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    return figure


def multisine_lines(design: Design) -> Figure:
    """Amplitude of each line of the feed-forward torque."""
    trajectory = design.trajectory
    amplitude = 2.0 * np.abs(np.fft.rfft(trajectory.torque, axis=0)) / len(trajectory.torque)
    figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
    ax = figure.subplots()
    lines = np.round(design.lines_hz * design.trajectory.duration_s).astype(int)
    marks = "os^Dv<>"
    for j, joint in enumerate(trajectory.joints):
        ax.plot(
            design.lines_hz,
            amplitude[lines, j],
            marker=marks[j % len(marks)],
            linestyle="none",
            markersize=4,
            color=COLOURS[j % len(COLOURS)],
            label=joint.replace("_", " "),
        )
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("frequency, Hz", fontsize=9)
    ax.set_ylabel("amplitude of a line, N m", fontsize=9)
    ax.grid(color="#eeeeee", linewidth=0.6)
    ax.legend(fontsize=8, frameon=False)
    return figure


def singular_values(design: Design, other: Assessment, other_name: str = "section 4.2.2") -> Figure:
    """Singular values of the regressor from simulated motion, beside those of another excitation."""
    figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
    ax = figure.subplots()
    for told, name, colour, mark in ((other, other_name, BEFORE, "s"), (design.assess(), "designed", AFTER, "o")):
        number = np.arange(1, len(told.singular_values) + 1)
        label = f"{name}: condition number {told.condition:.0f}"
        ax.semilogy(number, told.singular_values, color=colour, marker=mark, markersize=3, linewidth=0.8, label=label)
    ax.set_xlabel("number of the direction", fontsize=9)
    ax.set_ylabel("singular value, N m", fontsize=9)
    ax.grid(color="#eeeeee", linewidth=0.6)
    ax.legend(fontsize=8, frameon=False)
    return figure


def search(design: Design) -> Figure:
    """Cost of every evaluation: the predicted condition number, or minus the mean logarithm; each stage at other instants."""
    figure = Figure(figsize=(WIDTH_IN, 2.6), layout="constrained")
    ax = figure.subplots()
    start, used, cost = design.history.T
    conditions = bool(np.all(cost >= 0.0))
    for i in np.unique(start):
        own = start == i
        values = np.exp(np.minimum(cost[own], 50.0)) if conditions else cost[own]
        ax.plot(used[own], values, color=COLOURS[int(i) % len(COLOURS)], linewidth=1.2, label=f"start {int(i) + 1}")
    if conditions:
        ax.set_yscale("log")
        ax.set_ylim(top=min(ax.get_ylim()[1], 1e4))  # the first candidates pay for passing limits
    ax.set_xlabel("evaluation", fontsize=9)
    ax.set_ylabel("condition number,\nwith penalty" if conditions else "cost", fontsize=9)
    ax.grid(color="#eeeeee", linewidth=0.6, which="both")
    ax.legend(fontsize=8, frameon=False)
    return figure
