"""Figures of fitted transfer functions: magnitude and errors with bands, correlation of residuals, stabilisation over orders."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray
from rx90b_flex.identify.stability import stable
from rx90b_flex.identify.transfer_function import TransferFit
from rx90b_flex.identify.validation import LEVEL, whiteness
from rx90b_flex.view.axes import plain_axes
from rx90b_flex.view.plots import AFTER, BEFORE, FLOOR, MEASURED, WIDTH_IN

PANEL_IN = 1.9  # height of a row
BAND = float(np.sqrt(-np.log(1 - LEVEL)))  # half width of a complex number's 95 % band in standard deviations


def differences(fit: TransferFit, truth: ComplexArray | None = None) -> Figure:
    """Estimate minus fit, with the 95 % bands of both (figure 6.12); with the truth, fit minus truth too."""
    hz, n = fit.response.hz, len(fit.response.joints)
    figure, axes = _grid(n)
    model = fit.model.frf(hz)
    left, own, data = np.abs(fit.response.value - model), BAND * fit.frf_std(hz), BAND * fit.response.std()
    for (j, k), ax in axes.items():
        ax.semilogy(hz, left[:, j, k], ".", color=MEASURED, markersize=3, label="estimate − fit")
        ax.semilogy(hz, data[:, j, k], ":", color=BEFORE, linewidth=1.1, label="band of the estimate")
        ax.semilogy(hz, own[:, j, k], "--", color=AFTER, linewidth=1.1, label="band of the fit")
        if truth is not None:
            ax.semilogy(hz, np.abs(model - truth)[:, j, k], color=FLOOR, linewidth=0.8, label="fit − truth")
        _title(ax, fit, j, k)
    _finish(figure, axes, "|ΔP|, rad/s² per N m")
    return figure


def residual_correlation(fit: TransferFit) -> Figure:
    """Correlation of the weighted residuals of each output over lines apart, with its 95 % bound (figures 6.6 and 6.13)."""
    white, joints = whiteness(fit), fit.response.joints
    figure = Figure(figsize=(WIDTH_IN, 1.3 * len(joints) + 0.6), layout="constrained")
    rows = figure.subplots(len(joints), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    for j, ax in enumerate(rows):
        plain_axes(ax)
        ax.plot([0, *white.lag], [1, *np.abs(white.correlation[:, j])], ".-", color=AFTER, markersize=3, linewidth=0.7)
        ax.plot(white.lag, white.bound, "--", color=BEFORE, linewidth=1.1, label="95 % bound")
        ax.set_title(f"{joints[j]}: {100 * white.inside[j]:.0f} % of lags within the bound", fontsize=9, loc="left")
        ax.set_ylabel("correlation", fontsize=9)
    rows[-1].set_xlabel("lines apart", fontsize=9)
    rows[0].legend(fontsize=8, frameon=False, loc="upper right")
    return figure


def stabilisation(fit: TransferFit) -> Figure:
    """Modes of the fits of every order over frequency, and behind them the mean response (root mean square of its entries)."""
    figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
    ax = figure.subplots()
    plain_axes(ax)
    behind = ax.twinx()
    hz = fit.response.hz
    behind.semilogy(
        hz, np.sqrt((np.abs(fit.response.value) ** 2).mean(axis=(1, 2))), color=MEASURED, alpha=0.35, linewidth=1.0
    )
    behind.set_ylabel("mean response, rad/s² per N m", fontsize=9)
    behind.tick_params(labelsize=8)
    behind.yaxis.set_minor_formatter(NullFormatter())
    behind.spines["top"].set_visible(False)
    ax.set_zorder(behind.get_zorder() + 1)
    ax.patch.set_visible(False)
    f = np.concatenate([one.resonances_hz for one in fit.candidates])
    std = np.concatenate([one.resonances_std_hz() for one in fit.candidates])
    order = np.concatenate([np.full(one.modes, one.modes) for one in fit.candidates])
    held = np.concatenate([stable(place, fit.candidates) for place in range(len(fit.candidates))])
    right = 1.1 * hz[-1]
    sure, rest = held & (f < right), ~held & (f < right)
    ax.errorbar(f[sure], order[sure], xerr=std[sure], fmt="o", color=AFTER, markersize=5, linewidth=0.8, label="stable")
    ax.plot(f[rest], order[rest], "x", color=BEFORE, markersize=5, label="not found again, or uncertain")
    ax.axhline(len(fit.resonances_hz), color=FLOOR, linewidth=0.8, linestyle=":", label="chosen")
    ax.set_xlim(0.9 * hz[0], right)
    ax.set_yticks([one.modes for one in fit.candidates])
    ax.set_xlabel("frequency, Hz (bars: one standard deviation of what is stable)", fontsize=9)
    ax.set_ylabel("modes of the fit", fontsize=9)
    ax.legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    return figure


def _grid(n: int) -> tuple[Figure, dict[tuple[int, int], Axes]]:
    """One panel an entry on and above the diagonal, the rest empty."""
    width = WIDTH_IN * max(1.0, n / 2)
    figure = Figure(figsize=(width, PANEL_IN * n + 0.4), layout="constrained")
    grid = figure.subplots(n, n, squeeze=False, sharex=True)
    for j in range(n):
        for k in range(j):
            grid[j, k].set_axis_off()
    axes = {(j, k): grid[j, k] for j in range(n) for k in range(j, n)}
    for ax in axes.values():
        plain_axes(ax)
    return figure, axes


def _finish(figure: Figure, axes: dict[tuple[int, int], Axes], label: str) -> None:
    for (j, k), ax in axes.items():
        if j == k:  # nothing stands below it or to its left
            ax.set_xlabel("frequency, Hz", fontsize=9)
            ax.set_ylabel(label, fontsize=9)
            ax.tick_params(labelbottom=True)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.02, 0.03))


def _title(ax: Axes, fit: TransferFit, j: int, k: int) -> None:
    names: Array | tuple[str, ...] = fit.response.joints
    ax.set_title(f"{names[j]} from {names[k]}", fontsize=9, loc="left")
