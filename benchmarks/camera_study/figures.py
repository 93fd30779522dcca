"""Figures of the camera's study. Each function takes results and returns a `matplotlib.figure.Figure`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from camera_study.study import REQUIRED, Scene
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.camera import JointFit, JointTurn, hinge_angles

TRUE, SEEN, FITTED = "#000000", "#d55e00", "#0072b2"


def leak_figure(scene: Scene, turn: JointTurn, fitted: JointFit, rate_hz: float, title: str = "") -> Figure:
    """One joint along the motion: its angle; below, its bendings as they are, as the camera shows them in the assumed
    frames, and after the fit of frame and stiffness. Compare figure 4.9.
    """
    seen = hinge_angles(turn.rotation)
    time = np.arange(len(seen)) / rate_hz
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    axes[0].plot(time, scene.drive_angle, color=TRUE, linewidth=1.0)
    axes[0].set_ylabel("drive angle, rad", fontsize=8)
    axes[0].set_title(title, fontsize=9)
    for i in (1, 2):
        for values, colour, width, label in (
            (seen, SEEN, 0.5, "as seen"),
            (fitted.deformation, FITTED, 0.5, "frame fitted"),
            (scene.deformation, TRUE, 1.2, "true"),
        ):
            axes[i].plot(time, 1e3 * values[:, i], color=colour, linewidth=width, label=label)
        axes[i].set_ylabel(f"bending {i}, 10⁻³ rad", fontsize=8)
    axes[2].set_xlabel("time, s", fontsize=8)
    axes[1].legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    for ax in axes:
        ax.tick_params(labelsize=8)
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="#e6e6e6", linewidth=0.5)
    figure.align_ylabels(axes)
    return figure


def error_map_figure(
    factors: Sequence[float], mismatches: Sequence[float], errors: Array, titles: Sequence[str], joint: str
) -> Figure:
    """Error of the bending stiffness over camera noise and frame mismatch, one map an estimator, with the 5 % line.

    Parameters
    ----------
    factors : of table C.2's noise, ascending, above 0
    mismatches : rad, ascending, above 0
    errors : array, shape (estimators, mismatches, factors)
        Relative, as `Study.error` gives them.
    titles : one an estimator
    """
    figure = Figure(figsize=(1.2 + 2.5 * len(titles), 3.4), layout="constrained")
    axes = figure.subplots(1, len(titles), squeeze=False, sharey=True)[0]
    logs = np.log10(np.maximum(errors, 1e-6))
    for ax, title, level in zip(axes, titles, logs, strict=True):
        drawn = ax.pcolormesh(factors, 1e3 * np.asarray(mismatches), level, vmin=-3, vmax=1, cmap="cividis_r")
        if level.min() < np.log10(REQUIRED) < level.max():
            at = np.log10(REQUIRED)
            ax.contour(factors, 1e3 * np.asarray(mismatches), level, [at], colors=SEEN, linestyles="solid")
        ax.axvline(1.0, color="white", linewidth=0.8, linestyle=":")
        ax.axvline(2.5, color="white", linewidth=0.8, linestyle="--")
        ax.set(xscale="log", yscale="log")
        ax.set_title(title, fontsize=9)
        ax.set_xlabel("noise over table C.2", fontsize=8)
        ax.tick_params(labelsize=8)
    handles = [
        Line2D([], [], color=SEEN, label="5 %"),
        Line2D([], [], color="#8a8a8a", linestyle=":", label="table C.2"),
        Line2D([], [], color="#8a8a8a", linestyle="--", label="2.5 times table C.2"),
    ]
    figure.legend(handles=handles, fontsize=8, frameon=False, ncols=3, loc="outside lower center")
    axes[0].set_ylabel(f"frame mismatch of {joint}, 10⁻³ rad", fontsize=8)
    bar = figure.colorbar(drawn, ax=axes, ticks=[-3, -2, -1, 0, 1])
    bar.ax.set_yticklabels(["0.1", "1", "10", "100", "1000"], fontsize=8)
    bar.set_label("error of bending stiffness, % (95 % of trials)", fontsize=8)
    return figure
