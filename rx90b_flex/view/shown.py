"""How results show themselves: in words, as one table and one figure a kind of result, and all of them in a notebook's cell."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial, singledispatch
from html import escape

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
from rx90b_flex.identify.measured_stiffness import HingeStiffness
from rx90b_flex.identify.static_command import StaticResult
from rx90b_flex.joint_units import response_unit
from rx90b_flex.linearize import Modes
from rx90b_flex.path.check import PathCheck
from rx90b_flex.path.measured import MeasuredTip
from rx90b_flex.simulate.closed_loop import Simulation
from rx90b_flex.view import frf_plots, grey_plots, path_plots, plots
from rx90b_flex.view.axes import AFTER, new_figure
from rx90b_flex.view.camera_report import deformation_figure
from rx90b_flex.view.fleet_report import fleet_figure, headline
from rx90b_flex.view.identify_plots import torque_fit
from rx90b_flex.view.measured_section import measured_along_path
from rx90b_flex.view.page import image, template
from rx90b_flex.view.static_plots import static_test_figure
from rx90b_flex.view.zoom import script, zoom_style

SHOWN_ROWS = 30  # of a table in a cell
STILL_HZ = 0.01  # below it a mode is one of the rigid body, at rest
ESTIMATE = ("parameter", "value", "std", "unit")
INTERVAL = ("parameter", "value", "low", "high", "unit", "determined")


@dataclass(frozen=True)
class Appearance:
    """How one result shows itself.

    Attributes
    ----------
    words : str
        It in a sentence.
    table : callable
        Makes its main table.
    figure : callable
        Makes the figure that matters most, or raises ValueError where there is nothing to draw.
    """

    words: str
    table: Callable[[], pd.DataFrame]
    figure: Callable[[], Figure]


@singledispatch
def appearance_of(result: object) -> Appearance:
    """How a result shows itself.

    Raises
    ------
    TypeError
        A kind of result that does not.
    """
    raise TypeError(f"{type(result).__name__} has no table, no figure and no words")


def cell_of(result: object) -> str:
    """HTML of a notebook's cell: words, table, figure; its texts may hold anything and are escaped."""
    looks = appearance_of(result)
    table = looks.table()
    undetermined = 0
    if "value" in table.columns:  # a parameter without one has nothing to show
        undetermined = int(table["value"].isna().sum())
        table = table[table["value"].notna()]
    shown = table.head(SHOWN_ROWS).to_html(index=False, na_rep="", float_format=lambda x: f"{x:.4g}", border=0)
    more = f"<p>{len(table) - SHOWN_ROWS} more rows in .to_pandas()</p>" if len(table) > SHOWN_ROWS else ""
    if undetermined:
        more += f"<p>{undetermined} parameters are not determined by themselves</p>"
    parts: list[str] = [f"<p><b>{escape(looks.words)}</b></p>", shown if len(table) else "", more]
    try:
        figure = looks.figure()
    except ValueError:  # nothing to draw
        return "".join(parts)
    try:
        picture = image(figure, looks.words, zoom=True)
    except ValueError:  # bars
        picture = image(figure, looks.words)
    parts.append(str(template("parts.html").module.figure(picture)))  # type: ignore[attr-defined]
    if picture.zoom:
        parts.append(f"<style>{zoom_style()}</style><script>{script()}</script>")
    return "".join(parts)


def _table(rows: Iterable[tuple[object, ...]], columns: Sequence[str], floats: Sequence[str] = ()) -> pd.DataFrame:
    """Rows under names; columns of numbers that may be missing stay numbers."""
    return pd.DataFrame(list(rows), columns=list(columns)).astype(dict.fromkeys(floats, float))


# ---- torques ----------------------------------------------------------------------------------------------------


@appearance_of.register
def _(result: ClosedLoop) -> Appearance:
    """A row a parameter of each effect, in the order in which they were added."""
    before, after = (f"{100 * x.validation.relative_error:.3g} %" for x in (result.before, result.after))
    rows = (
        (e.effect.type_name(), " + ".join(e.effect.joints) or "robot", p.name, p.value, p.std, p.unit, e.before.relative_error,
         e.after.relative_error, e.p_value)
        for e in result.effects for p in e.parameters
    )  # fmt: skip
    columns = ("effect", "joint", *ESTIMATE, "error_before", "error_after", "p_value")
    return Appearance(
        f"{result.robot}: {result.verdict.replace('_', ' ')}; held-out torque error {before} → {after}",
        lambda: _table(rows, columns, ("value", "std")),
        lambda: plots.errors_by_joint(result),
    )


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
    for name, value, known in (("joint", joint, result.joints), ("over", over, RESIDUALS)):
        if value not in known:
            raise ValueError(f"{name} is {value!r}; {close_match(value, list(known))}")
    return RESIDUALS[over](result, joint)


@appearance_of.register
def _(result: RefusedLoop) -> Appearance:
    return appearance_of(result.checked)


@appearance_of.register
def _(result: Checked) -> Appearance:
    """A row a fault; error of the rigid model with basic friction on rows held out: a joint that is unlike the others stands out."""
    rows = ((f.kind, f.signal, ", ".join(f.joints), f.factor, f.std, f.message) for f in result.data_faults)
    columns = ("kind", "signal", "joints", "factor", "std", "message")

    def draw() -> Figure:
        if not len(result.relative_error) == len(result.joints):
            raise ValueError("no fit was possible")
        figure, (ax,) = new_figure(0.9 + 0.3 * len(result.joints))
        places = np.arange(len(result.joints))
        ax.barh(places, [100 * x for x in result.relative_error], 0.6, color=AFTER)
        ax.set_yticks(places, list(result.joints))
        ax.invert_yaxis()
        ax.set_xlabel("held-out error of a rigid model with basic friction, %")
        return figure

    words = f"{result.robot}: {result.verdict}".removeprefix(": ")
    return Appearance(words, lambda: _table(rows, columns, ("factor", "std")), draw)


@appearance_of.register
def _(result: Identified) -> Appearance:
    """A row a parameter, without a value where only combinations are determined; the torque of the joint with the largest error."""
    held = "" if result.validation is None else f", held out {100 * result.validation.relative_error:.3g} %"
    rows = ((e.name, e.value, e.std, e.unit) for e in result.parameters)

    def draw() -> Figure:
        first = result.predictions[0]
        left = first.measured - first.predicted
        k = int(np.argmax(np.sqrt(np.mean(left**2, axis=0)) / np.std(first.measured, axis=0).clip(1e-12)))
        joint = first.recording.joints[k]
        unit = result.source.units_of([joint])[0].force
        return torque_fit(first.recording.time, first.measured[:, k], first.predicted[:, k], joint, unit=unit)

    return Appearance(
        f"{result.source.name}: torque error fitted {100 * result.identification.relative_error:.3g} %{held}",
        lambda: _table(rows, ESTIMATE, ("value", "std")),
        draw,
    )


# ---- frequency responses ----------------------------------------------------------------------------------------


@appearance_of.register
def _(result: MotorIdentification) -> Appearance:
    """A row a physical parameter with its 95 % interval; the first pose's response, and that of the identified robot."""
    lost = f"; left out: {', '.join(x.stage for x in result.left_out)}" if result.left_out else ""
    best = result.grey if result.replayed is None else result.replayed.grey

    def draw() -> Figure:
        if not result.poses:
            raise ValueError("no frequency response")
        others: list[frf_plots.Comparison] = []
        if result.grey is not None and 0 in result.fitted:
            place = result.fitted.index(0)
            others = [(result.grey.responses[place].hz, result.grey.predicted[place], "identified robot")]
        measured = result.poses[0].measured
        unit = response_unit(result.robot.units_of(measured.joints))
        return frf_plots.magnitude(measured, others, unit=unit)

    return Appearance(
        f"{result.robot.name} from motor signals, {len(result.poses)} pose(s){lost}",
        (lambda: _table([], INTERVAL)) if best is None else appearance_of(best).table,
        draw,
    )


@appearance_of.register
def _(result: GreyBox) -> Appearance:
    """A row a physical parameter with its 95 % interval."""
    told = f"{sum(e.determined for e in result.estimates)} of {len(result.estimates)} physical parameters told"
    rows = ((e.name, e.value, e.low, e.high, e.unit, e.determined) for e in result.estimates)
    return Appearance(
        f"{told} by {len(result.responses)} frequency response(s)",
        lambda: _table(rows, INTERVAL),
        lambda: grey_plots.intervals(result),
    )


@appearance_of.register
def _(result: FrequencyResponse) -> Appearance:
    """A row a line and entry."""
    lines, n = len(result.hz), len(result.joints)
    columns = {
        "hz": np.repeat(result.hz, n * n),
        "acceleration": np.tile(np.repeat(result.joints, n), lines),
        "torque": np.tile(result.joints, lines * n),
        "real": result.value.real.ravel(),
        "imag": result.value.imag.ravel(),
        "std": result.std().ravel(),
    }
    said = f"{lines} lines from {result.hz[0]:.3g} to {result.hz[-1]:.3g} Hz"
    return Appearance(
        f"Frequency response of {', '.join(result.joints)}, {said}",
        partial(pd.DataFrame, columns),
        lambda: frf_plots.magnitude(result),
    )


# ---- stiffnesses and modes --------------------------------------------------------------------------------------


def _hinges(words: str, hinges: Sequence[HingeStiffness], draw: Callable[[], Figure]) -> Appearance:
    """A row a hinge."""
    rows = ((h.coordinate, h.value, h.std, "N m/rad", h.determined) for h in hinges)
    told = f"{sum(h.determined for h in hinges)} of {len(hinges)} hinges told"
    return Appearance(f"{words}: {told}", lambda: _table(rows, ("hinge", *ESTIMATE[1:], "determined")), draw)


@appearance_of.register
def _(result: StaticResult) -> Appearance:
    words = f"Stiffnesses from {len(result.found)} dead-weight tests"
    return _hinges(words, result.hinges, lambda: static_test_figure(result.source.tests, result.found))


@appearance_of.register
def _(result: CameraResult) -> Appearance:
    words = f"Stiffnesses of {result.source.joint} from markers"
    return _hinges(words, result.hinges, lambda: deformation_figure(result))


@appearance_of.register
def _(result: Modes) -> Appearance:
    """A row a mode; damping ratio over frequency, a point a mode, those that stand still left out."""
    hz, ratios = result.frequencies_hz, result.damping_ratios

    def draw() -> Figure:
        kept = hz > STILL_HZ
        figure, (ax,) = new_figure(2.6)
        ax.semilogx(hz[kept], 100 * ratios[kept], "o", color=AFTER, markersize=4)
        ax.set(xlabel="frequency, Hz", ylabel="damping ratio, %")
        return figure

    words = f"{len(hz)} modes from {hz.min():.3g} to {hz.max():.3g} Hz" if len(hz) else "no modes"
    return Appearance(words, lambda: pd.DataFrame({"frequency_hz": hz, "damping_ratio": ratios}), draw)


# ---- paths, runs and fleets -------------------------------------------------------------------------------------


@appearance_of.register
def _(result: PathCheck) -> Appearance:
    """A row an effect, largest contribution first; the deviation itself where none was switched off."""

    def table() -> pd.DataFrame:
        if not result.contributions:
            of = result.before
            return pd.DataFrame({"distance_mm": of.distance_mm} | of.columns())
        effects = pd.DataFrame([dataclasses.asdict(c) for c in result.contributions])
        return effects.sort_values("rms_across", ascending=False, ignore_index=True)

    words = f"{result.plan.seam.name}: {result.sentence}"
    return Appearance(words, table, lambda: path_plots.deviation_along_path(result))


@appearance_of.register
def _(result: MeasuredTip) -> Appearance:
    """A row a sample."""
    return Appearance(result.sentence, lambda: pd.DataFrame(result.columns()), lambda: measured_along_path(result))


@appearance_of.register
def _(result: Simulation) -> Appearance:
    """A row an instant: time (s), every coordinate (rad) and the tip's place (m)."""
    ended = f"; ended early: {result.ended}" if result.ended else ""
    columns = {"time": result.time} | dict(zip(result.robot.coordinates, result.q.T, strict=True))
    columns |= {f"tip_{axis}": result.tip[:, i, 3] for i, axis in enumerate("xyz")}
    return Appearance(
        f"{result.trajectory.name} of {result.robot.name}, {result.time[-1]:.3g} s{ended}",
        partial(pd.DataFrame, columns),
        lambda: plots.tip_deviation(result),
    )


@appearance_of.register
def _(result: Fleet) -> Appearance:
    def draw() -> Figure:
        figure = fleet_figure(result)
        if figure is None:
            raise ValueError("no robot stands out; there is nothing to draw")
        return figure

    return Appearance(headline(result)[0], lambda: fleet_table(result), draw)
