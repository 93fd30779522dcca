"""The report of a path check: one HTML file that opens offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rx90b_flex.path.check import MODEL_ERROR, Deviation, PathCheck
from rx90b_flex.path.measured import MeasuredTip
from rx90b_flex.view import path_plots
from rx90b_flex.view.measured_section import measured_section
from rx90b_flex.view.page import PageTable, Section, image, write_page

SHOWN_SEGMENTS = 12


def write_path_report(result: PathCheck, path: Path, measured: MeasuredTip | None = None) -> None:
    """Write the report, of a measured tip first where there is one; it appears whole or not at all."""
    sections = [_deviation(result), _why(result), _corrected(result), _how(result)]
    lead = _lead(result)
    if measured is not None:
        sections = [measured_section(measured), *sections]
        lead = [measured.sentence, *lead]
    title = f"{result.plan.seam.name} with {result.plan.robot.name}"
    write_page(path, title, lead, [s for s in sections if s is not None])


def _lead(result: PathCheck) -> list[str]:
    seam = result.plan.seam
    out = [
        result.sentence,
        f"{1e3 * seam.pieces.total:.0f} mm at {1e3 * seam.speed:g} mm/s and up to {seam.acceleration:g} m/s², "
        f"{seam.duration_s:.2f} s; tolerance {result.options.tolerance_mm:g} mm across the path. All of this is what the "
        "model predicts.",
    ]
    return out + seam.notes()


def _deviation(result: PathCheck) -> Section:
    cases = [("as planned", result.before), *([("corrected", result.after)] if result.after is not None else [])]
    head = ("path", "across, largest, mm", "RMS, mm", "at, mm", "along, largest, mm", "millimetres that pass")
    tables = [PageTable(head, tuple(_row(name, of, result.options.tolerance_mm) for name, of in cases))]
    tables += [_segments(f"{name}: segments that fail", of, result.options.tolerance_mm) for name, of in cases]
    figures = (
        image(
            path_plots.deviation_along_path(result),
            "Deviation over the length of the path, with the tolerance",
            zoom=True,
        ),
        image(path_plots.path_picture(result), "The path and the tip's deviation from above and from the side"),
    )
    text = "Across is the distance from the path's tangent at the place where the tip should be; seam.csv has every millimetre."
    return Section("Deviation along the path", (text,), tuple(t for t in tables if t.rows), figures)


def _row(name: str, of: Deviation, tolerance_mm: float) -> tuple[str, ...]:
    within = of.within(tolerance_mm)
    numbers = (of.max_across, of.rms_across, of.worst_at_mm, of.max_along)
    texts = (f"{x:.0f}" if i == 2 else f"{x:.4f}" for i, x in enumerate(numbers))
    return name, *texts, f"{int(within.sum())} of {len(within)}"


def _segments(caption: str, of: Deviation, tolerance_mm: float) -> PageTable:
    failing = of.failing(tolerance_mm)
    worst = sorted(sorted(failing, key=lambda x: -x[2])[:SHOWN_SEGMENTS])
    rows = tuple((f"{a}", f"{b}", f"{c:.3f}" if np.isfinite(c) else "not reached") for a, b, c in worst)
    more = f" (the worst {SHOWN_SEGMENTS} of {len(failing)})" if len(failing) > SHOWN_SEGMENTS else ""
    return PageTable(("from, mm", "to, mm", "largest, mm"), rows, caption + more, (0, 1, 2))


def _why(result: PathCheck) -> Section | None:
    if not result.contributions:
        return None
    done = sorted((c for c in result.contributions if c.why_not is None), key=lambda c: -c.rms_across)
    rows = tuple(
        (c.name, f"{c.rms_across:.4f}", f"{c.max_across:.4f}", f"{c.max_along:.4f}", f"{c.rms_without:.4f}")
        for c in done
    )
    head = ("effect", "across, RMS, mm", "across, largest, mm", "along, largest, mm", "RMS across left without it, mm")
    tables = [PageTable(head, rows)]
    left = tuple((c.name, c.why_not or "") for c in result.contributions if c.why_not is not None)
    if left:
        tables.append(PageTable(("not switched off", "why"), left, numbers=()))
    text = (
        f"Each effect is switched off in turn; its contribution is what that changes. Its own size may exceed the whole: effects "
        f"cancel each other. Links and controller is what is left with all of them off. {result.left_over:.3g} mm RMS of the "
        f"{result.before.rms_across:.3g} mm is not the sum of these, but comes of effects that act together (weight bends hinges, a "
        "spring takes the weight off them)."
    )
    figure = image(path_plots.contributions(result), "Contribution of each effect to the deviation across")
    return Section("Which effect causes how much", (text,), tuple(tables), (figure,))


def _corrected(result: PathCheck) -> Section | None:
    if result.after is None or len(result.iterations) < 2:
        return None
    rows = tuple(
        _row(f"{name} {100 * MODEL_ERROR:.0f} % lower", of, result.options.tolerance_mm)
        for name, of in result.wrong_model
    )
    head = ("robot", "across, largest, mm", "RMS, mm", "at, mm", "along, largest, mm", "millimetres that pass")
    tables = (PageTable(head, rows, "The corrected path on a robot that differs from the model"),) if rows else ()
    text = (
        "The reference is displaced against the deviation that the model predicts, and this is repeated on the simulation. "
        "corrected_path.csv has the corrected reference in space and in joint angles, corrected_joints.csv the angles alone "
        "(rx90b-flex simulate ROBOT --trajectory corrected_joints.csv). Both runs move side by side, deformations magnified, with "
        "rx90b-flex view as_planned --beside corrected."
    )
    return Section(
        "Corrected path", (text,), tables, (image(path_plots.convergence(result), "Deviation over iterations"),)
    )


def _how(result: PathCheck) -> Section:
    rows = tuple((stage, f"{s:.1f}") for stage, s in result.seconds.items())
    text = (
        "Planned for the rigid robot; simulated with all declared effects under the joint controllers, without noise. The robot "
        "rests before and after the path."
    )
    return Section("How it was done", (text,), (PageTable(("stage", "time, s"), rows),))
