"""Figures of fitted transfer functions: correlation of residuals, stabilisation over orders."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from rx90b_flex.identify.stability import stable
from rx90b_flex.identify.transfer_function import TransferFit
from rx90b_flex.identify.validation import whiteness
from rx90b_flex.view.axes import AFTER, BEFORE, FLOOR, MEASURED, legend, new_figure
from rx90b_flex.view.frf_plots import UNIT


def residual_correlation(fit: TransferFit) -> Figure:
    """Correlation of the weighted residuals of each output over lines apart, with its 95 % bound (figures 6.6 and 6.13)."""
    white, joints = whiteness(fit), fit.response.joints
    figure, rows = new_figure(1.3 * len(joints) + 0.6, rows=len(joints), sharex=True, sharey=True)
    for j, ax in enumerate(rows):
        ax.plot([0, *white.lag], [1, *np.abs(white.correlation[:, j])], ".-", color=AFTER, markersize=3, linewidth=0.7)
        ax.plot(white.lag, white.bound, "--", color=BEFORE, linewidth=1.1, label="95 % bound")
        ax.set_title(f"{joints[j]}: {100 * white.inside[j]:.0f} % of lags within the bound", fontsize=9, loc="left")
        ax.set_ylabel("correlation")
    rows[-1].set_xlabel("lines apart")
    rows[0].legend(fontsize=8, frameon=False, loc="upper right")
    return figure


def stabilisation(fit: TransferFit, unit: str = UNIT) -> Figure:
    """Modes of the fits of every order over frequency, and behind them the mean response (root mean square of its entries)."""
    figure, (ax,) = new_figure(3.4)
    behind = ax.twinx()
    hz, mean = fit.response.hz, np.sqrt((np.abs(fit.response.value) ** 2).mean(axis=(1, 2)))
    behind.semilogy(hz, mean, color=MEASURED, alpha=0.35, linewidth=1.0)
    behind.set_ylabel(f"mean response, {unit}", fontsize=9)
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
    ax.set(xlabel="frequency, Hz (bars: one standard deviation of what is stable)", ylabel="modes of the fit")
    legend(ax)
    return figure
