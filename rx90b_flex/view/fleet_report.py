"""The page of a fleet: who stands out, what the make has in common, and every robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.fleet.fleet import Fleet
from rx90b_flex.fleet.make import MakeParameter, RobotValue
from rx90b_flex.fleet.robots import REFUSED
from rx90b_flex.fleet.statistics import CHANGED, FEWEST_OTHERS, STANDS_OUT
from rx90b_flex.view.axes import MEASURED
from rx90b_flex.view.page import PageTable, Section, image, write_page

SHOWN_OUT = 3  # parameters of a robot that a sentence names
NO_BREAK = "\N{NO-BREAK SPACE}"
DRAWN = 12  # parameters that the figure shows
CAPTION = "Each robot with its 95 % interval, orange where it stands out; mean and twice the standard deviation of the others."


def write_fleet_report(fleet: Fleet, path: Path) -> None:
    """Write the page; it appears whole or not at all."""
    makes = sorted({o.robot for o in fleet.robots if o.robot})
    title = f"{len(fleet.robots)} robots: {', '.join(makes)}"
    write_page(path, title, headline(fleet), [_standing_out(fleet), _make(fleet), _robots(fleet), _how()])


NOT_ASKED = f"whether one stands out is asked of {FEWEST_OTHERS + 1} or more."


def headline(fleet: Fleet) -> list[str]:
    """How many robots stand out, then each of them and each that is not compared, a line each."""
    out = [o.name for o in fleet.robots if fleet.standing_out(o.name)]
    compared = len(fleet.compared)
    first = f"{len(out)} of {compared} robots stand out" + (f": {', '.join(out)}." if out else ".")
    if compared <= FEWEST_OTHERS:
        first = f"{compared} robot{' is' if compared == 1 else 's are'} compared; {NOT_ASKED}"
    return [first, *(robot_words(fleet, name) for name in out), *not_compared_words(fleet)]


def not_compared_words(fleet: Fleet) -> list[str]:
    """Each robot that is not compared, with its reason."""
    return [f"{o.name}: {o.verdict.replace('_', ' ')}: {o.reason}" for o in fleet.robots if o.reason]


def robot_words(fleet: Fleet, name: str) -> str:
    """By what a robot stands out, and since when where that is known."""
    own = fleet.standing_out(name)
    words = [_words(p, v) for p, v in own[:SHOWN_OUT]]
    more = f"; and {len(own) - SHOWN_OUT} more" if len(own) > SHOWN_OUT else ""
    return f"{name}: {'; '.join(words)}{more}"


def _words(p: MakeParameter, v: RobotValue) -> str:
    return f"{_label(p)} {_number(v.value, v.std, p.unit)} (make {p.summary.mean:.3g}){_when(v)}"


def _when(v: RobotValue) -> str:
    """Since or until when, with the value before the change."""
    if v.before is None:
        return ""
    return f", {_day(v)}, {'before' if v.since else 'then'} {v.before:.4g}"


def _day(v: RobotValue) -> str:
    return f"since {v.since}" if v.since else f"until {v.until}" if v.until else ""


def _label(p: MakeParameter) -> str:
    return f"{p.type.replace('_', ' ')} of {p.place}, {p.parameter}"


def _number(value: float, std: float, unit: str) -> str:
    return f"{value:.4g} ± {std:.2g} {unit}".removesuffix(" -")


def _standing_out(fleet: Fleet) -> Section:
    rows = [
        (o.name, _label(p), _number(v.value, v.std, p.unit), _number(p.summary.mean, p.summary.between_std or 0.0, ""),
         f"{v.p_value:.1g}", _day(v), "" if v.before is None or v.before_std is None else _number(v.before, v.before_std, p.unit))
        for o in fleet.robots for p, v in fleet.standing_out(o.name)
    ]  # fmt: skip
    head = ("robot", "parameter", "value", "the others", "p-value", "when", "value before")
    figure = fleet_figure(fleet)
    if figure is None:
        asked = len(fleet.compared) > FEWEST_OTHERS
        return Section("Which robots stand out", "None does." if asked else f"Not asked: {NOT_ASKED}")
    return Section(
        "Which robots stand out",
        "Values are those after a robot's last change, ± one standard deviation; of the others the mean and the standard "
        "deviation between robots. A day stands where recordings carry dates and the value changed between two of them.",
        PageTable(head, rows, numbers=range(2, 7)),
        image(figure, "Values of every robot beside the make's mean", CAPTION),
    )


def _between(p: MakeParameter) -> str:
    over = p.summary
    if over.between_std is None:
        return ""
    return f"{over.between_std:.2g} ({over.between_low:.2g} to {over.between_high:.2g})"


def _make(fleet: Fleet) -> Section:
    rows = [
        (_label(p), f"{p.present} of {len(p.values)}", f"{p.summary.mean:.4g}", f"{p.summary.low:.4g} to {p.summary.high:.4g}",
         _between(p), p.unit.replace(" ", NO_BREAK))
        for p in fleet.parameters if p.present or any(v.stands_out for v in p.values)
    ]  # fmt: skip
    head = ("parameter", "robots that have it", "mean", "95 % interval", "between robots (interval)", "unit")
    text = (
        "Mean over the robots that do not stand out with its 95 % interval, and the standard deviation between robots with its own, "
        "which is zero where values differ no more than their own standard deviations let expect. A robot without an effect counts "
        "with what its data hold of it, which is zero within a standard deviation. What a loop found on some robot and the second "
        "fit shows on none is left out here; fleet.csv has it."
    )
    return Section("What the make has in common", text, PageTable(head, rows, numbers=range(1, 5)) if rows else None)


def _robots(fleet: Fleet) -> Section:
    rows = []
    for o in fleet.robots:
        errors = ("", "") if o.before is None or o.after is None else (
            f"{100 * o.before.validation.relative_error:.3g}", f"{100 * o.after.validation.relative_error:.3g}",
        )  # fmt: skip
        report = "" if o.verdict == REFUSED else f"{o.name}/report.html"
        found = ", ".join(e.label for e in o.found)
        recorded = " to ".join(dict.fromkeys([*o.dates[:1], *o.dates[-1:]]))
        rows.append((o.name, o.verdict.replace("_", " "), *errors, found, recorded, o.reason or report))
    head = ("robot", "verdict", "error before, %", "after, %", "found", "recorded", "report, or why there is none")
    return Section("Every robot", PageTable(head, rows, numbers=(2, 3)))


def _how() -> Section:
    return Section(
        "How it was done",
        "The loop is closed on each robot by itself. Then each is fitted again, to all its recordings, with the effects that more "
        "than half of them have and with what its own loop found beside these and still shows.",
        "Mean and standard deviation between robots: random effects, restricted maximum likelihood (Viechtbauer 2005). Intervals: of "
        "the mean after Hartung and Knapp (2001) with a factor not below one, of the standard deviation by the profile of Q "
        "(Viechtbauer 2007).",
        "A robot stands out where its value is not one that the other robots predict (Higgins, Thompson and Spiegelhalter 2009): "
        f"p-value below {STANDS_OUT:g} after Bonferroni's correction for all robots and parameters. Others that stand out do not "
        f"count among those that predict. It takes {FEWEST_OTHERS + 1} robots; shapes (turn-over, power) are not tested.",
        "Since when: two levels over the dates against one (Quandt 1960), for every coefficient of a robot's effects; p-value below "
        f"{CHANGED:g} after correction for robots, coefficients and dates. A robot that changed is fitted apart for the days before "
        "and after, and compared as it is now; it stands out until a day where it did so before its last change only.",
    )


def fleet_figure(fleet: Fleet) -> Figure | None:
    """Each robot's value of the parameters by which one stands out, beside mean and spread of the make; None where none does."""
    shown = [p for p in fleet.parameters if any(v.stands_out for v in p.values)][:DRAWN]
    if not shown:
        return None
    columns = min(3, len(shown))
    lines = -(-len(shown) // columns)
    names = [o.name for o in fleet.compared]
    figure = Figure(figsize=(3.6 * columns, 1.0 + 1.9 * lines), layout="constrained")
    for ax, p in zip(figure.subplots(lines, columns, squeeze=False).ravel(), shown, strict=False):
        places = np.array([names.index(v.robot) for v in p.values])
        out = np.array([v.stands_out for v in p.values])
        values, stds = (np.array([getattr(v, field) for v in p.values]) for field in ("value", "std"))
        for mask, colour in ((~out, MEASURED), (out, "#b34a00")):
            ax.errorbar(places[mask], values[mask], 1.96 * stds[mask], fmt="o", ms=3.5, lw=1, color=colour)
        ax.axhline(p.summary.mean, color="#005f96", linewidth=1)
        between = p.summary.between_std or 0.0
        ax.axhspan(p.summary.mean - 2 * between, p.summary.mean + 2 * between, color="#005f96", alpha=0.12, lw=0)
        ax.set_title(_label(p), fontsize=7)
        ax.set_ylabel(p.unit, fontsize=7)
        ax.tick_params(labelsize=7)
        ax.set_xticks(places[out], [names[i] for i in places[out]], rotation=30, ha="right")
        ax.set_xlim(-0.7, len(names) - 0.3)
        ax.spines[["top", "right"]].set_visible(False)
    for ax in figure.axes[len(shown) :]:
        ax.remove()
    figure.supxlabel("robot, in the order given", fontsize=7)
    return figure
