"""The report of a loop closed on modes or frequency responses: one HTML file that opens offline."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path

import numpy as np

from rx90b_flex.diagnose.flexible import FlexibleLoop
from rx90b_flex.diagnose.modal import ModalLoop, alone, error_rms, in_order_rms
from rx90b_flex.diagnose.response import ResponseLoop
from rx90b_flex.joint_units import response_unit
from rx90b_flex.view import frf_plots, modal_plots
from rx90b_flex.view.estimates import number, unit_text
from rx90b_flex.view.frf_report import delay_words
from rx90b_flex.view.page import PageTable, Section, image, write_page
from rx90b_flex.view.report import p_value, percent

VERDICTS = {
    "nothing_missing": "The declared model is enough: it differs from the data by no more than their stated errors.",
    "explained": "What was found explains the data to their stated errors.",
    "partly_explained": "What was found explains a part; more is left than the stated errors.",
    "unexplained": "The declared model does not explain the data, and no change that was tried does.",
}
SHOWN = 8  # refused changes; the best


def write_flexible_report(loop: FlexibleLoop, path: Path) -> None:
    """Write the report; it appears whole or not at all."""
    sections = [_found(loop), _sure(loop), _data(loop), _alternatives(loop), _refused(loop), _how(loop)]
    lead = [VERDICTS[loop.verdict], *(f"Found: {f.words}." for f in loop.found), headline(loop)]
    write_page(path, f"{loop.source.name}: what its {loop.kind} say", lead, sections)


@singledispatch
def headline(loop: FlexibleLoop) -> str:
    """Errors before and after, in a sentence."""
    raise TypeError(f"no headline for {type(loop).__name__}")


@singledispatch
def _data(loop: FlexibleLoop) -> Section:
    """The data beside both models."""
    raise TypeError(f"no section for {type(loop).__name__}")


@headline.register
def _(loop: ModalLoop) -> str:
    before, after = (_share(error_rms(c)) for c in (loop.before, loop.after))
    left = alone(loop.before), alone(loop.after)
    said = (
        f"Root mean square error of the frequencies: {before} before, {after} after; measured modes without a "
        f"partner: {left[0]} before, {left[1]} after."
    )
    if loop.validation_before:
        old, new = (_share(error_rms(c)) for c in (loop.validation_before, loop.validation_after))
        said += f" At poses that were not fitted: {old} before, {new} after."
    return said


@headline.register
def _(loop: ResponseLoop) -> str:
    pairs = zip(loop.held_out_before or loop.errors_before, loop.held_out_after or loop.errors_after, strict=True)
    held = "what was not fitted" if loop.held_out_before else "the fitted lines"
    both = ", ".join(f"{percent(b.relative)} before, {percent(a.relative)} after" for b, a in pairs)
    return f"Error of the frequency response on {held}: {both}."


def _share(value: float) -> str:
    return percent(value) if np.isfinite(value) else "no pair"


def _found(loop: FlexibleLoop) -> Section:
    rows = []
    for f in loop.found:
        c = f.change
        for name, unit, value, std in zip(c.names, c.units, f.values, f.stds, strict=True):
            what = name.replace("_", " ") if c.adds else f"{name.replace('_', ' ')} over declared"
            rows.append((
                ("added: " if c.adds else "changed: ") + c.type.replace("_", " "), c.place.replace("_", " "), what,
                number(float(value)), number(float(std)), unit_text(unit) if c.adds else "", f"{f.gain:.1f}", p_value(f.p_value),
            ))  # fmt: skip
    if not rows:
        return Section("What was found", "Nothing was added.")
    head = ("change", "where", "parameter", "value", "std", "unit", "gain", "chance")
    text = (
        "Gain: how much smaller -2 log likelihood is with it, everything else fitted again. Chance: that it explains nothing, "
        f"corrected for {loop.result.tried} changes that might have been tried."
    )
    return Section("What was found", text, PageTable(head, rows, "What the data support", (3, 4, 6, 7)))


def _sure(loop: FlexibleLoop) -> Section:
    chance = (
        f"Probability of such a misfit if the model were right to its stated errors: {p_value(loop.result.chance_before)} before, "
        f"{p_value(loop.result.chance_after)} after."
    )
    return Section("How sure", *loop.doubts(), chance)


@_data.register
def _(loop: ModalLoop) -> Section:
    rows = []
    for b, a in zip(loop.before, loop.after, strict=True):
        partners = [dict(zip(c.pairing.measured, c.model_hz[c.pairing.model], strict=True)) for c in (b, a)]
        for i, (hz, std) in enumerate(zip(b.measured.hz, b.measured.std_hz, strict=True)):
            model = [p.get(i) for p in partners]
            errors = ["–" if m is None else f"{100 * (hz / m - 1):+.1f}" for m in model]
            shown = ["–" if m is None else f"{m:.1f}" for m in model]
            name = "resonance" if b.measured.locked is None else b.measured.locked.replace("_", " ")
            rows.append((name, str(b.pose + 1), f"{hz:.1f}", f"{std:.2f}", shown[0], errors[0], shown[1], errors[1]))
    head = ("list", "pose", "measured, Hz", "std, Hz", "declared, Hz", "error, %", "found, Hz", "error, %")
    figures = []
    for pose in range(len(loop.residual.structure.poses)):
        before, after = ([c for c in both if c.pose == pose] for both in (loop.before, loop.after))
        name = f"pose {pose + 1}"
        words = f"{name}: partners are joined; a ring marks a measured mode without one"
        apart = modal_plots.errors(before, after, loop.residual.smallest_error)
        figures.append(image(modal_plots.ladder(before, after), f"Modes of {name}, measured and modelled", words))
        figures.append(image(apart, f"Errors of {name}", name))
    caption = "Partners; beside a joint: its antiresonances. Errors: measured over model"
    text = (
        f"With the n-th measured mode as the model's n-th: {_share(in_order_rms(loop.before))} before, "
        f"{_share(in_order_rms(loop.after))} after. Each mode predicted from the others (to first order): "
        f"{_share(loop.left_out_before)} before, {_share(loop.left_out_after)} after."
    )
    return Section("Modes, before and after", text, PageTable(head, rows, caption), *figures)


@_data.register
def _(loop: ResponseLoop) -> Section:
    figures = []
    for k, response in enumerate(loop.responses):
        units = zip(loop.source.units, response.pose.tolist(), strict=True)
        pose = ", ".join(u.place(a) if u.slides else f"{np.rad2deg(a):.0f}°" for u, a in units)
        words = f"at {pose}" + ("" if k < loop.fitted else " (not fitted)")
        others = [(response.hz, loop.before[k], "as declared"), (response.hz, loop.after[k], "as found")]
        drawn = frf_plots.magnitude(response, others, unit=response_unit(loop.source.units_of(loop.joints)))
        figures.append(image(drawn, f"Magnitude of every entry {words}", words, zoom=True))
    rows = [
        (name, percent(b.relative), percent(a.relative), f"{b.weighted:.3g}", f"{a.weighted:.3g}")
        for name, before, after in (
            ("fitted lines", loop.errors_before, loop.errors_after),
            ("held out", loop.held_out_before, loop.held_out_after),
        )
        for b, a in zip(before, after, strict=True)
    ]
    head = ("lines", "error before", "after", "over stated errors, before", "after")
    table = PageTable(head, rows, "Errors")
    return Section("Frequency responses, before and after", *delay_words(loop.torque_delay), table, *figures)


def _alternatives(loop: FlexibleLoop) -> Section | None:
    rows = []
    for found in loop.found:
        for t in found.alternatives:
            apart = loop.separation(found, t)
            rows.append((found.change.words, t.change.words, f"{t.criterion - found.criterion:.1f}", apart))
    if not rows:
        return None
    text = "The data cannot tell these from what was found: odds better than 1 to 20. Worse by: of the information criterion."
    table = PageTable(("found", "instead", "worse by", "what would tell them apart"), rows, numbers=(2,))
    return Section("Alternatives", text, table)


def _refused(loop: FlexibleLoop) -> Section | None:
    rows = [(t.change.words, f"{t.gain:.1f}", p_value(t.p_value)) for t in loop.result.refused[:SHOWN]]
    if not rows:
        return None
    return Section("What was refused", "The best of the last round.", PageTable(("change", "gain", "chance"), rows))


def _how(loop: FlexibleLoop) -> Section:
    moved = ", ".join(j.replace("_", " ") for j in loop.joints)
    return Section(
        "Method",
        f"Drives of {moved} move, the others are held. The robot is linearised at rest in each pose; a change multiplies "
        "declared values or adds an effect, and its values are fitted from several starts with those of all others found.",
        f"Beside the stated errors a model error of at least {percent(loop.residual.smallest_error)} is allowed for, and its "
        "size is estimated. Of the fits, the extended Bayesian information criterion chooses.",
    )
