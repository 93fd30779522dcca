"""Figures of a frequency response: entries with their bands, differences, excitation, signal-to-noise ratios.

Each function takes results and returns a `matplotlib.figure.Figure`; none knows of a window or of pyplot. What was measured is
always blue with its band shaded, what it is compared with orange and dashed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse, Spectra, confidence_radius
from rx90b_flex.joint_units import TURNS, JointUnits, any_of, response_unit

MEASURED, MODEL, DISTORTION, NOISE = "#0072b2", "#d55e00", "#009e73", "#8a8a8a"
MARGINS_IN = (0.6, 0.42, 0.25)  # left, bottom and top of a grid of entries
FILL = 0.25  # opacity of a band
CELL_IN = (2.9, 2.1)  # width and height of one entry's axes
UNIT = response_unit([TURNS])

Draw = Callable[[Axes, int, int], None]  # axes, row, column of an entry
Comparison = tuple[Array, ComplexArray, str]  # hz, value (F, n, n), label


def bode(response: FrequencyResponse, others: Sequence[Comparison] = ()) -> Figure:
    """Magnitude of every entry, below it its phase in degrees, both as in `magnitude` and `phase`."""
    n = len(response.joints)
    figure = Figure(figsize=(CELL_IN[0] * n, 1.6 * CELL_IN[1] * n), layout="constrained")
    grid = figure.subplots(2 * n, n, squeeze=False, sharex=True, sharey=False, height_ratios=(2, 1) * n)
    size, angle = _draw_magnitude(response, others), _draw_phase(response, others)
    for j in range(n):
        for k in range(n):
            above, below = grid[2 * j, k], grid[2 * j + 1, k]
            size(above, j, k)
            angle(below, j, k)
            title = f"{response.joints[j]} over torque of {response.joints[k]}"
            _label(above, title, k == 0, f"|P|, {UNIT}", bottom=False)
            _label(below, "", k == 0, "phase, °", bottom=j == n - 1)
    grid[0, 0].legend(fontsize=6.5, frameon=False)
    return figure


def magnitude(response: FrequencyResponse, others: Sequence[Comparison] = (), unit: str = UNIT) -> Figure:
    """Magnitude of every entry over frequency, with its band; models or other estimates beside it (figure 6.4).

    The band is the circle about the entry in the complex plane that holds it with 95 %.

    Parameters
    ----------
    others : sequence of (hz, value, label)
    unit : str
        `response_unit` of the joints.
    """
    return _entries(response.joints, _draw_magnitude(response, others), f"|P|, {unit}")


def _draw_magnitude(response: FrequencyResponse, others: Sequence[Comparison]) -> Draw:
    radius = confidence_radius(response)

    def draw(ax: Axes, j: int, k: int) -> None:
        size = np.abs(response.value[:, j, k])
        # the band's lower edge where the circle holds zero: a tenth of the entry, so that the axis keeps its scale
        low = np.maximum(size - radius[:, j, k], 0.1 * size)
        _band(ax, response.hz, low, size + radius[:, j, k])
        ax.plot(response.hz, size, color=MEASURED, lw=0.9, label="estimate")
        for (hz, value, label), (colour, dash) in zip(others, _STYLES * len(others), strict=False):
            ax.plot(hz, np.abs(value[:, j, k]), color=colour, ls=dash, lw=1.0, label=label)
        _log(ax)

    return draw


def phase(response: FrequencyResponse, others: Sequence[Comparison] = ()) -> Figure:
    """Phase of every entry over frequency, degrees, with its band; where the band's circle holds zero it is all angles."""
    return _entries(response.joints, _draw_phase(response, others), "phase of P, °")


def _draw_phase(response: FrequencyResponse, others: Sequence[Comparison]) -> Draw:
    radius = confidence_radius(response)

    def draw(ax: Axes, j: int, k: int) -> None:
        value = response.value[:, j, k]
        angle = np.rad2deg(np.angle(value))
        share = np.clip(radius[:, j, k] / np.abs(value), 0.0, 1.0)
        half = np.where(share < 1.0, np.rad2deg(np.arcsin(share)), 180.0)
        _band(ax, response.hz, angle - half, angle + half)
        ax.plot(response.hz, angle, ".", color=MEASURED, ms=2.5, label="estimate")
        for (hz, other, label), (colour, _) in zip(others, _STYLES * len(others), strict=False):
            # points, or every turn from 180 to -180 degrees would draw a line
            ax.plot(hz, np.rad2deg(np.angle(other[:, j, k])), ".", ms=1.5, color=colour, label=label)
        ax.set_ylim(-200, 200)
        ax.set_yticks([-180, -90, 0, 90, 180])

    return draw


def difference(response: FrequencyResponse, value: ComplexArray, label: str = "model", unit: str = UNIT) -> Figure:
    """Magnitude of what parts every entry from a model or another estimate at the same lines, with the estimate's own uncertainty.

    If the model is right, 95 % of the lines lie under the band's line.

    Parameters
    ----------
    value : complex array, shape (F, n, n)
    """
    if np.shape(value) != response.value.shape:
        raise ValueError(f"value has shape {np.shape(value)}; expected {response.value.shape}, at the response's lines")
    radius = confidence_radius(response)
    apart = np.abs(response.value - value)
    below = np.mean(apart <= radius, axis=0)

    def draw(ax: Axes, j: int, k: int) -> None:
        ax.plot(response.hz, np.abs(response.value[:, j, k]), color=NOISE, lw=0.8, label="|P|")
        ax.plot(response.hz, apart[:, j, k], ".", color=MODEL, ms=3, label=f"|P − {label}|")
        ax.plot(response.hz, radius[:, j, k], color=MEASURED, lw=0.9, label="95 % band")
        _log(ax)
        ax.annotate(f"{100 * below[j, k]:.0f} % below", (0.97, 0.04), xycoords="axes fraction", ha="right", fontsize=7)

    return _entries(response.joints, draw, unit)


def signal_to_noise(response: MeasuredResponse) -> Figure:
    """Every entry's magnitude over its standard deviation, dB: of noise alone, and of noise and distortion together."""
    noise, total = response.noise_std(), response.std()

    def draw(ax: Axes, j: int, k: int) -> None:
        size = np.abs(response.value[:, j, k])
        if noise is not None:
            ax.plot(response.hz, _db(size / noise[:, j, k]), color=NOISE, lw=0.9, label="noise")
        ax.plot(response.hz, _db(size / total[:, j, k]), color=DISTORTION, lw=0.9, label="noise and distortion")
        ax.axhline(0.0, color="black", lw=0.5)

    return _entries(response.joints, draw, "|P| over its deviation, dB")


def channel_signal_to_noise(response: MeasuredResponse) -> Figure:
    """Torque and acceleration of each joint over the noise of one period, and over one realisation's distortion, dB."""
    count = len(response.joints)
    figure = Figure(figsize=(CELL_IN[0] * count, 1.3 * CELL_IN[1]), layout="constrained")
    axes = figure.subplots(1, count, squeeze=False, sharey=True)[0]
    for j, (ax, joint) in enumerate(zip(axes, response.joints, strict=True)):
        spectra = response.spectra
        ax.plot(response.hz, _db(spectra.torque_snr[:, j]), color=MEASURED, lw=0.9, label="torque, noise")
        ax.plot(response.hz, _db(spectra.acceleration_snr[:, j]), color=NOISE, lw=0.9, label="acceleration, noise")
        distortion = _db(response.acceleration_distortion[:, j])
        ax.plot(response.hz, distortion, color=DISTORTION, lw=0.9, label="acceleration, noise and distortion")
        _label(ax, joint, j == 0, "signal over noise, dB")
    axes[0].legend(fontsize=6.5, frameon=False)
    return figure


def excitation(spectra: Spectra, joints: Sequence[str], units: Sequence[JointUnits] = (TURNS,)) -> Figure:
    """Torque and acceleration at the excited lines, at the others, and the noise of one period, for each joint of these units."""
    figure = Figure(figsize=(CELL_IN[0] * len(joints), 2 * CELL_IN[1]), layout="constrained")
    grid = figure.subplots(2, len(joints), squeeze=False, sharex=True, sharey="row")
    rows = (
        (spectra.torque, spectra.torque_noise, f"torque, {any_of(u.force for u in units)}"),
        (
            spectra.acceleration,
            spectra.acceleration_noise,
            f"acceleration, {any_of(f'{u.position}/s²' for u in units)}",
        ),
    )
    for row, (axes, (signal, noise, label)) in enumerate(zip(grid, rows, strict=True)):
        for j, (ax, joint) in enumerate(zip(axes, joints, strict=True)):
            for lines, colour, size, name in (
                (spectra.excited, MEASURED, 3, "excited lines"),
                (~spectra.excited, DISTORTION, 1.5, "other lines"),
            ):
                ax.plot(spectra.hz[lines], signal[lines, j], ".", color=colour, ms=size, label=name)
            if np.isfinite(noise).all():
                ax.plot(spectra.hz, noise[:, j], color=NOISE, lw=0.7, label="noise of a period")
            _log(ax)
            _label(ax, joint, j == 0, label, bottom=row == 1)
    grid[0, 0].legend(fontsize=6.5, frameon=False)
    return figure


# ---- shared ---------------------------------------------------------------------------------------------------

_STYLES = ((MODEL, "--"), (DISTORTION, ":"), ("black", "-."))


def _entries(joints: Sequence[str], draw: Draw, label: str) -> Figure:
    """One axes an entry: rows are accelerations, columns torques."""
    n = len(joints)
    size = CELL_IN[0] * n, CELL_IN[1] * n
    figure = Figure(figsize=size)
    # margins in inches: a constrained layout of so many axes takes as long as drawing them
    left, bottom, top = MARGINS_IN[0] / size[0], MARGINS_IN[1] / size[1], 1.0 - MARGINS_IN[2] / size[1]
    figure.subplots_adjust(left, bottom, 1.0 - 0.05 / size[0], top, wspace=0.04, hspace=0.16)
    grid = figure.subplots(n, n, squeeze=False, sharex=True, sharey=True)
    for j in range(n):
        for k in range(n):
            draw(grid[j, k], j, k)
            _label(grid[j, k], f"{joints[j]} over torque of {joints[k]}", k == 0, label, bottom=j == n - 1)
    grid[0, 0].legend(fontsize=6.5, frameon=False)
    return figure


def _band(ax: Axes, hz: Array, low: Array, high: Array) -> None:
    ax.fill_between(hz, low, high, color=MEASURED, alpha=FILL, lw=0, label="95 % band")


def _label(ax: Axes, title: str, left: bool, label: str, bottom: bool = True) -> None:
    ax.set_title(title.replace("_", " "), fontsize=8)
    ax.tick_params(labelsize=7)
    ax.grid(color="#e4e4e4", lw=0.5)
    if left:
        ax.set_ylabel(label, fontsize=8)
    if bottom:
        ax.set_xlabel("frequency, Hz", fontsize=8)


def _log(ax: Axes) -> None:
    """Decades alone: ticks between them in nine axes take most of a figure's time."""
    ax.set_yscale("log")
    ax.yaxis.set_minor_locator(NullLocator())


def _db(ratio: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(ratio))
