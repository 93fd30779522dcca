"""The report of a path check: one HTML file that opens offline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rx90b_flex.path.check import MODEL_ERROR, Deviation, PathCheck
from rx90b_flex.path.measured import MeasuredTip
from rx90b_flex.view import path_plots
from rx90b_flex.view.measured_section import largest, measured_section
from rx90b_flex.view.page import PageTable, Section, image, seconds_table, write_page

SHOWN_SEGMENTS = 12


def write_path_report(result: PathCheck, path: Path, measured: MeasuredTip | None = None) -> None:
    """Write the report, of a measured tip first where there is one; it appears whole or not at all."""
    first, lead = (None, []) if measured is None else (measured_section(measured), [measured.sentence])
    sections = [first, _deviation(result), _why(result), _corrected(result), _how(result)]
    write_page(path, f"{result.plan.seam.name} with {result.plan.robot.name}", [*lead, *_lead(result)], sections)


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
    tolerance = result.options.tolerance_mm
    cases = [(name, of) for name, of in (("as planned", result.before), ("corrected", result.after)) if of is not None]
    return Section(
        "Deviation along the path",
        "Across is the distance from the path's tangent at the place where the tip should be; seam.csv has every millimetre.",
        _deviations("path", cases, tolerance),
        *(_segments(f"{name}: segments that fail", of, tolerance) for name, of in cases),
        image(
            path_plots.deviation_along_path(result),
            "Deviation over the length of the path, with the tolerance",
            zoom=True,
        ),
        image(path_plots.path_picture(result), "The path and the tip's deviation from above and from the side"),
    )


def _deviations(what: str, of: Sequence[tuple[str, Deviation]], tolerance_mm: float, caption: str = "") -> PageTable:
    """A row a named deviation."""
    head = (what, "across, largest, mm", "RMS, mm", "at, mm", "along, largest, mm", "millimetres that pass")
    rows = []
    for name, one in of:
        within = one.within(tolerance_mm)
        rows.append((name, *largest(one), f"{one.max_along:.4f}", f"{int(within.sum())} of {len(within)}"))
    return PageTable(head, rows, caption)


def _segments(caption: str, of: Deviation, tolerance_mm: float) -> PageTable | None:
    failing = of.failing(tolerance_mm)
    if not failing:
        return None
    worst = sorted(sorted(failing, key=lambda x: -x[2])[:SHOWN_SEGMENTS])
    rows = [(f"{a}", f"{b}", f"{c:.3f}" if np.isfinite(c) else "not reached") for a, b, c in worst]
    more = f" (the worst {SHOWN_SEGMENTS} of {len(failing)})" if len(failing) > SHOWN_SEGMENTS else ""
    return PageTable(("from, mm", "to, mm", "largest, mm"), rows, caption + more, (0, 1, 2))


def _why(result: PathCheck) -> Section | None:
    if not result.contributions:
        return None
    done = sorted((c for c in result.contributions if c.why_not is None), key=lambda c: -c.rms_across)
    rows = [(c.name, *(f"{x:.4f}" for x in (c.rms_across, c.max_across, c.max_along, c.rms_without))) for c in done]
    head = ("effect", "across, RMS, mm", "across, largest, mm", "along, largest, mm", "RMS across left without it, mm")
    left = [(c.name, c.why_not) for c in result.contributions if c.why_not is not None]
    return Section(
        "Which effect causes how much",
        f"Each effect is switched off in turn; its contribution is what that changes. Its own size may exceed the whole: effects "
        f"cancel each other. Links and controller is what is left with all of them off. {result.left_over:.3g} mm RMS of the "
        f"{result.before.rms_across:.3g} mm is not the sum of these, but comes of effects that act together (weight bends hinges, a "
        "spring takes the weight off them).",
        PageTable(head, rows),
        PageTable(("not switched off", "why"), left, numbers=()) if left else None,
        image(path_plots.contributions(result), "Contribution of each effect to the deviation across"),
    )


def _corrected(result: PathCheck) -> Section | None:
    if result.after is None or len(result.iterations) < 2:
        return None
    wrong = [(f"{name} {100 * MODEL_ERROR:.0f} % lower", of) for name, of in result.wrong_model]
    caption = "The corrected path on a robot that differs from the model"
    return Section(
        "Corrected path",
        "The reference is displaced against the deviation that the model predicts, and this is repeated on the simulation. "
        "corrected_path.csv has the corrected reference in space and in joint angles, corrected_joints.csv the angles alone "
        "(rx90b-flex simulate ROBOT --trajectory corrected_joints.csv). Both runs move side by side, deformations magnified, with "
        "rx90b-flex view as_planned --beside corrected.",
        _deviations("robot", wrong, result.options.tolerance_mm, caption) if wrong else None,
        image(path_plots.convergence(result), "Deviation over iterations"),
    )


def _how(result: PathCheck) -> Section:
    return Section(
        "How it was done",
        "Planned for the rigid robot; simulated with all declared effects under the joint controllers, without noise. The robot "
        "rests before and after the path.",
        seconds_table(result.seconds),
    )
