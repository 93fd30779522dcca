"""How results show themselves: one table and one figure a kind of result, and both in a notebook's cell."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import singledispatch
from html import escape
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from rx90b_flex.diagnose.check import Checked
from rx90b_flex.diagnose.close import ClosedLoop
from rx90b_flex.diagnose.refused import RefusedLoop
from rx90b_flex.effects import close_match
from rx90b_flex.fleet.fleet import Fleet
from rx90b_flex.fleet.output import fleet_table
from rx90b_flex.identify.camera_command import CameraResult
from rx90b_flex.identify.command import Identified
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.identify.frf_command import MotorIdentification
from rx90b_flex.identify.grey_box import GreyBox
from rx90b_flex.identify.least_squares import Estimate
from rx90b_flex.identify.measured_stiffness import HingeStiffness
from rx90b_flex.identify.static_command import StaticResult
from rx90b_flex.linearize import Modes
from rx90b_flex.path.check import PathCheck
from rx90b_flex.path.measured import MeasuredTip
from rx90b_flex.simulate.closed_loop import Simulation
from rx90b_flex.view import frf_plots, grey_plots, path_plots, plots
from rx90b_flex.view.axes import plain_axes
from rx90b_flex.view.camera_report import deformation_figure
from rx90b_flex.view.fleet_report import fleet_figure, headline
from rx90b_flex.view.identify_plots import torque_fit
from rx90b_flex.view.measured_section import measured_along_path
from rx90b_flex.view.page import image, template
from rx90b_flex.view.static_plots import static_test_figure
from rx90b_flex.view.zoom import script, zoom_style

SHOWN_ROWS = 30  # of a table in a cell
INTERVAL = ("parameter", "value", "low", "high", "unit", "determined")
STILL_HZ = 0.01  # below it a mode is one of the rigid body, at rest
ESTIMATE = ("parameter", "value", "std", "unit")


@singledispatch
def table_of(result: object) -> pd.DataFrame:
    """Main table of a result.

    Raises
    ------
    TypeError
        A kind of result that has none.
    """
    raise TypeError(f"{type(result).__name__} has no table")


@singledispatch
def figure_of(result: object) -> Figure:
    """Figure of a result that matters most.

    Raises
    ------
    TypeError
        A kind of result that has none.
    """
    raise TypeError(f"{type(result).__name__} has no figure")


@singledispatch
def words_of(result: object) -> str:
    """A result in a sentence."""
    raise TypeError(f"{type(result).__name__} has no words")


def cell_of(result: object) -> str:
    """HTML of a notebook's cell: words, table, figure; its texts may hold anything and are escaped."""
    table = table_of(result)
    undetermined = 0
    if "value" in table.columns:  # a parameter without one has nothing to show
        undetermined = int(table["value"].isna().sum())
        table = table[table["value"].notna()]
    shown = table.head(SHOWN_ROWS).to_html(index=False, na_rep="", float_format=lambda x: f"{x:.4g}", border=0)
    more = f"<p>{len(table) - SHOWN_ROWS} more rows in .to_pandas()</p>" if len(table) > SHOWN_ROWS else ""
    if undetermined:
        more += f"<p>{undetermined} parameters are not determined by themselves</p>"
    parts: list[str] = [f"<p><b>{escape(words_of(result))}</b></p>", shown if len(table) else "", more]
    try:
        figure = figure_of(result)
    except ValueError:  # nothing to draw
        return "".join(parts)
    try:
        picture = image(figure, words_of(result), zoom=True)
    except ValueError:  # bars
        picture = image(figure, words_of(result))
    parts.append(str(template("parts.html").module.figure(picture)))  # type: ignore[attr-defined]
    if picture.zoom:
        parts.append(f"<style>{zoom_style()}</style><script>{script()}</script>")
    return "".join(parts)


def _estimates(estimates: Sequence[Estimate]) -> pd.DataFrame:
    rows = [(e.name, e.value, e.std, e.unit) for e in estimates]
    return pd.DataFrame(rows, columns=list(ESTIMATE)).astype({"value": float, "std": float})


# ---- closing the loop -------------------------------------------------------------------------------------------


@table_of.register
def _(result: ClosedLoop) -> pd.DataFrame:
    """A row a parameter of each effect, in the order in which they were added."""
    rows = [
        (e.effect.type_name(), " + ".join(e.effect.joints) or "robot", p.name, p.value, p.std, p.unit, e.before.relative_error,
         e.after.relative_error, e.p_value)
        for e in result.effects for p in e.parameters
    ]  # fmt: skip
    columns = ["effect", "joint", *ESTIMATE, "error_before", "error_after", "p_value"]
    return pd.DataFrame(rows, columns=columns).astype({"value": float, "std": float})


figure_of.register(ClosedLoop, plots.errors_by_joint)


RESIDUALS = {
    "velocity": plots.residual_against_velocity,
    "position": plots.residual_against_position,
    "time": plots.residual_in_time,
    "frequency": plots.residual_in_frequency,
}


def residual_figure(result: ClosedLoop, joint: str, over: str) -> Figure:
    """A joint's residual on the validation recordings before and after, over one of `RESIDUALS`.

    Raises
    ------
    ValueError
        A joint or an axis that is not known.
    """
    if joint not in result.joints:
        raise ValueError(f"joint is {joint!r}; {close_match(joint, list(result.joints))}")
    if over not in RESIDUALS:
        raise ValueError(f"over is {over!r}; {close_match(over, list(RESIDUALS))}")
    return RESIDUALS[over](result, joint)


@words_of.register
def _(result: ClosedLoop) -> str:
    before, after = (f"{100 * x.validation.relative_error:.3g} %" for x in (result.before, result.after))
    return f"{result.robot}: {result.verdict.replace('_', ' ')}; held-out torque error {before} → {after}"


@table_of.register
def _(result: RefusedLoop) -> pd.DataFrame:
    return table_of(result.checked)


@figure_of.register
def _(result: RefusedLoop) -> Figure:
    return figure_of(result.checked)


@words_of.register
def _(result: RefusedLoop) -> str:
    return words_of(result.checked)


# ---- look at the data -------------------------------------------------------------------------------------------


@table_of.register
def _(result: Checked) -> pd.DataFrame:
    """A row a fault."""
    rows = [(f.kind, f.signal, ", ".join(f.joints), f.factor, f.std, f.message) for f in result.data_faults]
    columns = ["kind", "signal", "joints", "factor", "std", "message"]
    return pd.DataFrame(rows, columns=columns).astype({"factor": float, "std": float})


@figure_of.register
def _(result: Checked) -> Figure:
    """Error of the rigid model with basic friction on rows held out, joint by joint: what is unlike the others stands out."""
    if not len(result.relative_error) == len(result.joints):
        raise ValueError("no fit was possible")
    figure = Figure(figsize=(plots.WIDTH_IN, 0.9 + 0.3 * len(result.joints)), layout="constrained")
    ax = figure.subplots()
    rows = np.arange(len(result.joints))
    ax.barh(rows, [100 * x for x in result.relative_error], 0.6, color=plots.AFTER)
    ax.set_yticks(rows, list(result.joints))
    ax.invert_yaxis()
    ax.set_xlabel("held-out error of a rigid model with basic friction, %", fontsize=9)
    plain_axes(ax)
    return figure


@words_of.register
def _(result: Checked) -> str:
    return f"{result.robot}: {result.verdict}"


# ---- identification ---------------------------------------------------------------------------------------------


@table_of.register
def _(result: Identified) -> pd.DataFrame:
    """A row a parameter; no value where only combinations are determined."""
    return _estimates(result.parameters)


@figure_of.register
def _(result: Identified) -> Figure:
    """Measured and predicted torque of the joint with the largest error, on the first recording that was not fitted."""
    first = result.predictions[0]
    error = np.sqrt(np.mean((first.measured - first.predicted) ** 2, axis=0)) / np.std(first.measured, axis=0).clip(
        1e-12
    )
    k = int(np.argmax(error))
    return torque_fit(first.recording.time, first.measured[:, k], first.predicted[:, k], first.recording.joints[k])


@words_of.register
def _(result: Identified) -> str:
    held = "" if result.validation is None else f", held out {100 * result.validation.relative_error:.3g} %"
    return f"{result.source.name}: torque error fitted {100 * result.identification.relative_error:.3g} %{held}"


@table_of.register
def _(result: MotorIdentification) -> pd.DataFrame:
    """A row a physical parameter with its 95 % interval; empty without a grey box."""
    best = result.grey if result.replayed is None else result.replayed.grey
    return pd.DataFrame(columns=list(INTERVAL)) if best is None else table_of(best)


@figure_of.register
def _(result: MotorIdentification) -> Figure:
    """Magnitude of the first pose's frequency response with its band, and that of the identified robot."""
    if not result.poses:
        raise ValueError("no frequency response")
    measured = result.poses[0].measured
    others: list[Any] = []
    if result.grey is not None and 0 in result.fitted:
        place = result.fitted.index(0)
        others = [(result.grey.responses[place].hz, result.grey.predicted[place], "identified robot")]
    return frf_plots.magnitude(measured, others)


@words_of.register
def _(result: MotorIdentification) -> str:
    lost = f"; left out: {', '.join(x.stage for x in result.left_out)}" if result.left_out else ""
    return f"{result.robot.name} from motor signals, {len(result.poses)} pose(s){lost}"


@table_of.register
def _(result: GreyBox) -> pd.DataFrame:
    """A row a physical parameter with its 95 % interval."""
    rows = [(e.name, e.value, e.low, e.high, e.unit, e.determined) for e in result.estimates]
    return pd.DataFrame(rows, columns=list(INTERVAL))


figure_of.register(GreyBox, grey_plots.intervals)


@words_of.register
def _(result: GreyBox) -> str:
    told = sum(e.determined for e in result.estimates)
    return (
        f"{told} of {len(result.estimates)} physical parameters told by {len(result.responses)} frequency response(s)"
    )


@table_of.register
def _(result: FrequencyResponse) -> pd.DataFrame:
    """A row a line and entry."""
    lines, n = len(result.hz), len(result.joints)
    return pd.DataFrame(
        {
            "hz": np.repeat(result.hz, n * n),
            "acceleration": np.tile(np.repeat(result.joints, n), lines),
            "torque": np.tile(result.joints, lines * n),
            "real": result.value.real.ravel(),
            "imag": result.value.imag.ravel(),
            "std": result.std().ravel(),
        }
    )


figure_of.register(FrequencyResponse, frf_plots.magnitude)


@words_of.register
def _(result: FrequencyResponse) -> str:
    lines = f"{len(result.hz)} lines from {result.hz[0]:.3g} to {result.hz[-1]:.3g} Hz"
    return f"Frequency response of {', '.join(result.joints)}, {lines}"


# ---- stiffnesses and modes --------------------------------------------------------------------------------------


def _hinges(hinges: Sequence[HingeStiffness]) -> pd.DataFrame:
    rows = [(h.coordinate, h.value, h.std, "N m/rad", h.determined) for h in hinges]
    return pd.DataFrame(rows, columns=["hinge", *ESTIMATE[1:], "determined"])


def _told(hinges: Sequence[HingeStiffness]) -> str:
    return f"{sum(h.determined for h in hinges)} of {len(hinges)} hinges told"


@table_of.register
def _(result: StaticResult) -> pd.DataFrame:
    """A row a hinge."""
    return _hinges(result.hinges)


@figure_of.register
def _(result: StaticResult) -> Figure:
    return static_test_figure(result.source.tests, result.found)


@words_of.register
def _(result: StaticResult) -> str:
    return f"Stiffnesses from {len(result.found)} dead-weight tests: {_told(result.hinges)}"


@table_of.register
def _(result: CameraResult) -> pd.DataFrame:
    """A row a hinge."""
    return _hinges(result.hinges)


figure_of.register(CameraResult, deformation_figure)


@words_of.register
def _(result: CameraResult) -> str:
    return f"Stiffnesses of {result.source.joint} from markers: {_told(result.hinges)}"


@table_of.register
def _(result: Modes) -> pd.DataFrame:
    """A row a mode."""
    return pd.DataFrame({"frequency_hz": result.frequencies_hz, "damping_ratio": result.damping_ratios})


@figure_of.register
def _(result: Modes) -> Figure:
    """Damping ratio over frequency, a point a mode; those that stand still are left out."""
    kept = result.frequencies_hz > STILL_HZ
    figure = Figure(figsize=(plots.WIDTH_IN, 2.6), layout="constrained")
    ax = figure.subplots()
    ax.semilogx(result.frequencies_hz[kept], 100 * result.damping_ratios[kept], "o", color=plots.AFTER, markersize=4)
    ax.set_xlabel("frequency, Hz", fontsize=9)
    ax.set_ylabel("damping ratio, %", fontsize=9)
    plain_axes(ax)
    return figure


@words_of.register
def _(result: Modes) -> str:
    hz = result.frequencies_hz
    return f"{len(hz)} modes from {hz.min():.3g} to {hz.max():.3g} Hz" if len(hz) else "no modes"


# ---- paths and runs ---------------------------------------------------------------------------------------------


@table_of.register
def _(result: PathCheck) -> pd.DataFrame:
    """A row an effect, largest contribution first; the deviation itself where none was switched off."""
    if not result.contributions:
        of = result.before
        axes = {f"{name}_mm": getattr(of, name) for name in ("along", "left", "up", "across")}
        return pd.DataFrame({"distance_mm": of.distance_mm} | axes)
    table = pd.DataFrame([dataclasses.asdict(c) for c in result.contributions])
    return table.sort_values("rms_across", ascending=False, ignore_index=True)


figure_of.register(PathCheck, path_plots.deviation_along_path)


@words_of.register
def _(result: PathCheck) -> str:
    return f"{result.plan.seam.name}: {result.sentence}"


@table_of.register
def _(result: MeasuredTip) -> pd.DataFrame:
    """A row a sample."""
    columns = {"distance_mm": result.measured.distance_mm}
    for name in ("measured", "predicted", "difference"):
        columns |= {
            f"{axis}_{name}_mm": getattr(getattr(result, name), axis) for axis in ("along", "left", "up", "across")
        }
    return pd.DataFrame(columns)


figure_of.register(MeasuredTip, measured_along_path)


@words_of.register
def _(result: MeasuredTip) -> str:
    return result.sentence


@table_of.register
def _(result: Simulation) -> pd.DataFrame:
    """A row an instant: time (s), every coordinate (rad) and the tip's place (m)."""
    columns = {"time": result.time} | dict(zip(result.robot.coordinates, result.q.T, strict=True))
    return pd.DataFrame(columns | {f"tip_{axis}": result.tip[:, i, 3] for i, axis in enumerate("xyz")})


figure_of.register(Simulation, plots.tip_deviation)


@words_of.register
def _(result: Simulation) -> str:
    ended = f"; ended early: {result.ended}" if result.ended else ""
    return f"{result.trajectory.name} of {result.robot.name}, {result.time[-1]:.3g} s{ended}"


# ---- a fleet ----------------------------------------------------------------------------------------------------


table_of.register(Fleet, fleet_table)


@figure_of.register
def _(result: Fleet) -> Figure:
    figure = fleet_figure(result)
    if figure is None:
        raise ValueError("no robot stands out; there is nothing to draw")
    return figure


@words_of.register
def _(result: Fleet) -> str:
    return headline(result)[0]
