"""Figures of a closed loop. Each function takes a result and returns a `matplotlib.figure.Figure`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import signal as signal_processing

from rx90b_flex.diagnose.close import ClosedLoop, Prediction
from rx90b_flex.diagnose.evidence import STANDSTILL, Dependence, at_rest, signals
from rx90b_flex.effects.motion import Array
from rx90b_flex.signals import lowpass
from rx90b_flex.view.axes import AFTER, BEFORE, FLOOR, MEASURED, REACHED, legend, new_figure

if TYPE_CHECKING:
    from rx90b_flex.simulate.closed_loop import Simulation

BINS = 32
CURVE = 0.5  # of the variance of what was added to a torque, from which a curve shows it best
SEGMENT_S = 2.0  # of the spectra's averaged parts; their lines lie 1 / SEGMENT_S apart
DECADES = 4.0  # shown of a spectrum
UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s²", "time": "s"}


def errors_by_joint(result: ClosedLoop, role: str = "validation") -> Figure:
    """Error of every joint before and after, as a part of its torque, with the noise floor if known.

    Both roles share one scale, so that their figures can be compared.
    """
    both = (result.before, result.after)
    errors = {r: [_percent(getattr(e, r).torque_rms, t) for e in both] for r, t in joint_torques(result).items()}
    before, after = errors[role]
    longest = float(np.max([*errors.values()]))
    figure, (ax,) = new_figure(1.0 + 0.42 * len(result.joints))
    y = _bars(ax, result.joints, [(before, BEFORE, "////", "before"), (after, AFTER, "", "after")], 0.38, 0.36)
    if result.noise_floor is not None:
        floor = _percent(result.noise_floor, joint_torques(result)[role])
        ax.vlines(floor, y - 0.42, y + 0.42, color=FLOOR, linewidth=1.6, label="noise floor")
    ax.set(xlim=(0, 1.05 * longest or 1.0), xlabel="error in % of the joint's torque (both root mean square)")
    legend(ax)
    return figure


Bars = tuple[Array, str, str, str]  # lengths, shape (names,), colour, hatch, label


def _bars(ax: Axes, names: Sequence[str], groups: Sequence[Bars], apart: float, thickness: float) -> Array:
    """Horizontal bars of several groups beside each other, the first name on top; returns the names' places, which are 1 apart."""
    y = np.arange(len(names), dtype=float)
    for k, (lengths, colour, hatch, label) in enumerate(groups):
        at = y + apart * (k - 0.5 * (len(groups) - 1))
        ax.barh(at, lengths, thickness, color=colour, hatch=hatch, edgecolor="white", label=label)
    ax.set_yticks(y, [_plain(name) for name in names])
    ax.invert_yaxis()
    ax.grid(axis="x", color="#dddddd", linewidth=0.6)
    return y


def explainable_by_joint(result: ClosedLoop) -> Figure:
    """Validation error of the declared model, after, and of a free-form model: of all joints together, and of each.

    Raises
    ------
    ValueError
        Nothing is known of what a free form explains.
    """
    known = result.explainable
    if known is None:
        raise ValueError(f"no free-form model to draw: {result.not_explainable}")
    torque = joint_torques(result)["validation"]
    figure, (ax,) = new_figure(1.2 + 0.5 * (1 + len(result.joints)))
    groups = [
        (np.r_[100 * errors.relative_error, _percent(errors.torque_rms, torque)], colour, hatch, label)
        for errors, colour, hatch, label in (
            (result.before.validation, BEFORE, "////", "declared"),
            (result.after.validation, AFTER, "", "after"),
            (known.validation, REACHED, "....", "free form"),
        )
    ]
    _bars(ax, ["all", *result.joints], groups, 0.27, 0.25)
    ax.set_xlabel("error in % of torque (both root mean square), validation")
    legend(ax)
    return figure


def error_by_step(result: ClosedLoop) -> Figure:
    """Validation error of the declared model and after each effect that was added."""
    values = 100 * np.array(
        [result.before.validation.relative_error, *(e.after.relative_error for e in result.effects)]
    )
    figure, (ax,) = new_figure(2.1)
    steps = np.arange(len(values))
    ax.plot(steps, values, color=AFTER, marker="o", markersize=5, linewidth=1.2)
    ax.plot(steps[:1], values[:1], color=BEFORE, marker="s", markersize=7, linestyle="none")
    ax.set_xticks(steps, ["declared", *(str(i) for i in steps[1:])])
    ax.set(xlabel="effects added (numbers as in the table)", ylabel="validation error, %")
    ax.set_ylim(0, 1.1 * values.max() or 1.0)
    return figure


def residual_in_time(result: ClosedLoop, joint: str) -> Figure:
    """One joint's torque over time, measured and after; below it the residual before and after, on one scale."""
    column = result.joints.index(joint)
    figure, axes = new_figure(3.5, rows=3, sharex=True)
    pieces = list(_end_to_end(result.predictions))
    for time, p in pieces:
        tau, before, after = (x[:, column] for x in (p.torque, p.before, p.after))
        axes[0].plot(time, tau, color=MEASURED, linewidth=1.8, label="measured")
        axes[0].plot(time, after, color=AFTER, linewidth=0.7, label="final model")
        axes[1].plot(time, tau - before, color=BEFORE, linewidth=0.7, label="error before")
        axes[2].plot(time, tau - after, color=AFTER, linewidth=0.7, label="error after")
        for ax in axes if len(pieces) > 1 else ():
            ax.axvline(time[0], color=MEASURED, linewidth=0.6, linestyle=":")
    errors = [(p.torque - x)[_inside(result, p), column] for p in result.predictions for x in (p.before, p.after)]
    limit = 1.08 * max(float(np.abs(e).max()) for e in errors) or 1.0
    for ax, label in zip(axes[1:], ("error before", "error after"), strict=True):
        ax.set(ylim=(-limit, limit), ylabel=f"{label},\n{_force(result, joint)}")
        if result.noise_floor is not None:
            for sign in (-1, 1):
                ax.axhline(sign * result.noise_floor[column], color=FLOOR, linewidth=0.7, linestyle="--")
    axes[0].set_ylabel(f"torque,\n{_force(result, joint)}")
    axes[-1].set_xlabel("time, s" if len(pieces) == 1 else "time, s (recordings end to end)")
    figure.align_ylabels(axes)
    return figure


def residual_in_frequency(result: ClosedLoop, joint: str) -> Figure:
    """Amplitude spectrum of one joint's residual before and after, and of its torque, up to cutoff or Nyquist."""
    column = result.joints.index(joint)
    figure, (ax,) = new_figure(3.5)
    top = 0.0
    for kind, colour, width, label in (
        ("torque", MEASURED, 1.6, "torque"),
        ("before", BEFORE, 1.0, "error before"),
        ("after", AFTER, 1.0, "error after"),
    ):
        hz, amplitude = _spectrum(result, column, kind)
        top = max(top, float(amplitude.max()))
        style = "--" if kind == "before" else "-"
        ax.plot(hz, amplitude, color=colour, linewidth=width, linestyle=style, label=label)
    if top > 0:
        ax.set_yscale("log")
        ax.set_ylim(top / 10**DECADES, 2 * top)
    _spectral(ax, result, joint)
    return figure


def residual_against_position(result: ClosedLoop, joint: str) -> Figure:
    """Mean and spread of one joint's residual over its own position, before and after."""
    return _residual_against(result, joint, "position")


def residual_against_velocity(result: ClosedLoop, joint: str) -> Figure:
    """Mean and spread of one joint's residual over its own velocity, before and after."""
    return _residual_against(result, joint, "velocity")


def change_at_joint(result: ClosedLoop, joint: str) -> tuple[Figure, str]:
    """One joint's residual before and after where the difference shows best, and over what that is.

    Over its velocity or position where a curve over that holds most of what was added to the model's torque there; else over time.
    """
    column = result.joints.index(joint)
    added = np.concatenate([(p.after - p.before)[:, column] for p in result.predictions])
    shares = {kind: explained(_moved(result, column, kind), added) for kind in ("velocity", "position")}
    best = max(shares, key=lambda kind: shares[kind])
    if shares[best] < CURVE:
        return residual_in_time(result, joint), "time"
    return _residual_against(result, joint, best), best


def remaining_dependence(result: ClosedLoop, dependence: Dependence) -> Figure | None:
    """What is left of a joint's torque in motion, fitted and held out, over the signal that it still depends on.

    Over time, with the rests shaded, where that signal is standstill; over one cycle, where it is an order. None where the result
    does not hold the signal.
    """
    column = result.joints.index(dependence.joint)
    if dependence.signal == STANDSTILL:
        return _rests(result, column)
    order, name = dependence.order, dependence.signal
    if order is not None:
        name = f"{dependence.joint} position"
    values = [dict(signals(regression)).get(name) for regression, _ in result.unexplained.data]
    known = [v if order is None else (order * v / (2 * np.pi)) % 1.0 for v in values if v is not None]
    moving = ~np.concatenate([at_rest(regression) for regression, _ in result.unexplained.data])
    if len(known) < len(values) or not moving.any():
        return None
    residual = np.concatenate([left[:, column] for _, left in result.unexplained.data])
    binned = Binned(np.concatenate(known)[moving], residual[moving])
    figure, (ax,) = new_figure(2.7)
    ax.axhline(0.0, color="#555555", linewidth=0.6)
    x = binned.centre
    ax.fill_between(x, binned.low, binned.high, color=AFTER, alpha=0.12, linewidth=0, label="smallest, largest")
    ax.fill_between(x, *binned.band, color=AFTER, alpha=0.25, linewidth=0, label="± 1 std")
    ax.plot(x, binned.mean, color=AFTER, marker="o", markersize=3, linewidth=1.2, label="mean")
    cycle = f"part of a cycle, {_plain(dependence.signal)} (cycles a turn)"
    over = _with_unit(result, dependence.joint, dependence.signal) if order is None else cycle
    ax.set(xlabel=over, ylabel=f"error left, {_force(result, dependence.joint)}")
    legend(ax)
    return figure


def remaining_bands(result: ClosedLoop, joint: str) -> Figure:
    """Amplitude spectrum of what is left of a joint's torque, fitted and held out; bands in which it repeats are shaded."""
    column = result.joints.index(joint)
    figure, (ax,) = new_figure(2.7)
    for (regression, left), label in zip(result.unexplained.data, ("fitted", "held out"), strict=True):
        rate = min(s.rate_hz for s in regression.segments)
        parts = [left[span, column] for span in regression.spans]
        hz, amplitude = _welch(parts, rate)
        ax.plot(hz, amplitude, color=AFTER, linewidth=1.0, linestyle="-" if label == "fitted" else "--", label=label)
    for i, band in enumerate(b for b in result.unexplained.bands if b.joint == joint):
        ax.axvspan(band.low_hz, band.high_hz, color=BEFORE, alpha=0.18, linewidth=0, label=None if i else "repeats")
    ax.set_ylim(0, None)
    _spectral(ax, result, joint)
    return figure


def _spectral(ax: Axes, result: ClosedLoop, joint: str) -> None:
    ax.set(xlim=(0, _highest_hz(result)), xlabel="frequency, Hz", ylabel=f"amplitude, {_force(result, joint)}")
    legend(ax)


def _rests(result: ClosedLoop, column: int) -> Figure:
    """What is left of one joint over time, all recordings end to end; times when no joint moves are shaded."""
    figure, (ax,) = new_figure(2.7)
    at = 0.0
    for regression, left in result.unexplained.data:
        resting = at_rest(regression)
        for segment, span in zip(regression.segments, regression.spans, strict=True):
            time = at + np.arange(len(segment)) / segment.rate_hz
            bounds = ax.get_xaxis_transform()
            ax.fill_between(
                time, 0, 1, where=resting[span], transform=bounds, color=MEASURED, alpha=0.3, linewidth=0, step="mid"
            )
            ax.plot(time, left[span, column], color=AFTER, linewidth=0.7)
            ax.axvline(at, color=MEASURED, linewidth=0.6, linestyle=":")
            at += len(segment) / segment.rate_hz
    ax.axhline(0.0, color="#555555", linewidth=0.6)
    ylabel = f"error left, {_force(result, result.joints[column])}"
    ax.set(xlabel="time, s (recordings end to end; shaded: at rest)", ylabel=ylabel)
    return figure


class Binned:
    """Mean, standard deviation and range of `y` in bins of `x` that hold about equally many samples.

    Attributes
    ----------
    centre, mean, std, count, low, high : array, shape (bins,)
    band : pair of array, shape (bins,)
        Mean less and plus one standard deviation.
    """

    def __init__(self, x: Array, y: Array, bins: int = BINS) -> None:
        order = np.argsort(x, kind="stable")
        x, y = x[order], y[order]
        # a joint at rest fills many quantiles with one value: its samples then belong in one bin
        # and bins far narrower than a mark would pile up
        kept = [x[0]]
        for edge in np.quantile(x, np.linspace(0, 1, bins + 1)[1:-1]):
            if edge - kept[-1] > (x[-1] - x[0]) / (2 * bins):
                kept.append(edge)
        starts = np.unique(np.concatenate([[0], np.searchsorted(x, kept[1:])])).astype(int)
        counts = np.diff(np.append(starts, len(x)))
        self.centre = np.add.reduceat(x, starts) / counts
        self.mean = np.add.reduceat(y, starts) / counts
        self.std = np.sqrt(np.add.reduceat((y - np.repeat(self.mean, counts)) ** 2, starts) / counts)
        self.count = counts
        self.low = np.minimum.reduceat(y, starts)
        self.high = np.maximum.reduceat(y, starts)
        self.band = (self.mean - self.std, self.mean + self.std)


def explained(x: Array, y: Array) -> float:
    """Share of the variance of `y` that a curve over `x` holds."""
    curve = Binned(x, y)
    return 1.0 - float(curve.count @ curve.std**2) / max(len(y) * float(y.var()), 1e-300)


def tip_deviation(result: Simulation) -> Figure:
    """Tip deviation over time, up and across the path, as in figure 4.7; below both along the path."""
    figure, axes = new_figure(4.2, rows=3, sharex=True)
    places = {"up": 2, "across (left)": 1, "along": 0}
    for ax, (name, column) in zip(axes, places.items(), strict=True):
        ax.axhline(0.0, color="#555555", linewidth=0.6)
        ax.plot(result.time, result.path_deviation_mm[:, column], color=AFTER, linewidth=1.0)
        ax.set_ylabel(f"{name}, mm")
    axes[-1].set_xlabel("time, s")
    axes[0].set_title(f"tip deviation, {_plain(result.recording.name)}", fontsize=9, loc="left")
    return figure


def joint_torques(result: ClosedLoop) -> dict[str, Array]:
    """Root mean square of each joint's measured torque after the low-pass, for both roles; each (joints,), N m."""
    cutoff, rate = result.campaign.cutoff_hz, result.campaign.sample_rate_hz
    fitted = [r.torque if cutoff is None else lowpass(r.torque, cutoff, rate) for r in result.campaign.identification]
    return {"validation": rms([p.torque for p in result.predictions]), "identification": rms(fitted)}


def rms(recordings: Sequence[Array]) -> Array:
    """Root mean square a joint over all samples of several recordings, each (N, joints)."""
    return np.sqrt((np.concatenate(recordings) ** 2).mean(axis=0))


def _residual_against(result: ClosedLoop, joint: str, kind: str) -> Figure:
    column = result.joints.index(joint)
    # one scale for both kinds, so that the two figures of a joint can be compared
    left = [np.concatenate(_residuals(result, column, which)) for which in ("before", "after")]
    curves = {k: [Binned(_moved(result, column, k), y) for y in left] for k in ("position", "velocity")}
    limit = max(float((np.abs(c.mean) + c.std).max()) for pair in curves.values() for c in pair) * 1.08 or 1.0
    figure, (ax,) = new_figure(2.7)
    ax.axhline(0.0, color="#555555", linewidth=0.6)
    for curve, colour, mark, style, label in zip(
        curves[kind], (BEFORE, AFTER), ("s", "o"), ("--", "-"), ("before", "after"), strict=True
    ):
        x, line = curve.centre, f"{mark}{style}"
        ax.fill_between(x, *curve.band, color=colour, alpha=0.16, linewidth=0)
        ax.plot(x, curve.mean, line, color=colour, markersize=3, linewidth=1.1, label=label)
    xlabel = f"joint {_with_unit(result, joint, kind)}"
    ax.set(ylim=(-limit, limit), xlabel=xlabel, ylabel=f"error, {_force(result, joint)}")
    legend(ax)
    return figure


def _moved(result: ClosedLoop, column: int, kind: str) -> Array:
    """Position or velocity of a joint over all validation recordings."""
    return np.concatenate(
        [(p.recording.position if kind == "position" else p.velocity)[:, column] for p in result.predictions]
    )


def _residuals(result: ClosedLoop, column: int, which: str) -> list[Array]:
    return [(p.torque - (p.before if which == "before" else p.after))[:, column] for p in result.predictions]


def _spectrum(result: ClosedLoop, column: int, kind: str) -> tuple[Array, Array]:
    """Amplitude of a sine at each frequency: Welch's average over all validation recordings, Hann window."""
    rate = result.campaign.sample_rate_hz
    parts = [p.torque[:, column] for p in result.predictions] if kind == "torque" else _residuals(result, column, kind)
    hz, amplitude = _welch(parts, rate)
    shown = hz <= _highest_hz(result)
    return hz[shown], amplitude[shown]


def _welch(parts: Sequence[Array], rate: float) -> tuple[Array, Array]:
    """Amplitude of a sine at each frequency, averaged over recordings of one joint, each (N,)."""
    samples = max(2, min(round(SEGMENT_S * rate), *(len(x) for x in parts)))
    power = np.zeros(samples // 2 + 1)
    for x in parts:
        hz, density = signal_processing.welch(x, rate, nperseg=samples, scaling="spectrum", detrend="constant")
        power += density * len(x) / sum(len(y) for y in parts)
    return hz, np.sqrt(2 * power)


def _highest_hz(result: ClosedLoop) -> float:
    nyquist = result.campaign.sample_rate_hz / 2
    return nyquist if result.campaign.cutoff_hz is None else min(nyquist, result.campaign.cutoff_hz)


def _inside(result: ClosedLoop, p: Prediction) -> slice:
    """Samples away from the ends of a recording, where filter and differences lack neighbours and errors are spikes."""
    cutoff = result.campaign.cutoff_hz
    edge = 4 if cutoff is None else round(p.recording.sample_rate_hz / cutoff)
    return slice(edge, -edge) if 4 * edge < len(p.torque) else slice(None)


def _end_to_end(predictions: Sequence[Prediction]) -> Iterator[tuple[Array, Prediction]]:
    """Each recording with its time; several follow each other, one alone keeps its own."""
    at = 0.0
    for p in predictions:
        time = p.recording.time
        yield (time if len(predictions) == 1 else time - time[0] + at), p
        at += p.recording.duration_s


def _percent(part: Sequence[float], whole: Array) -> Array:
    return 100 * np.divide(part, whole, out=np.zeros(len(whole)), where=whole > 0)


def _force(result: ClosedLoop, joint: str) -> str:
    return result.source.units_of([joint])[0].force


def _with_unit(result: ClosedLoop, joint: str, signal: str) -> str:
    """A signal's name and unit; of the joint that it names, or of the one given."""
    named, _, kind = signal.rpartition(" ")
    unit = UNITS.get(kind)
    (of,) = result.source.units_of([named if named in result.joints else joint])
    return _plain(f"{signal}, {of.of(unit)}" if unit else signal)


def _plain(text: str) -> str:
    """A name as it is: matplotlib would read dollars as mathematics."""
    return text.replace("$", r"\$")
