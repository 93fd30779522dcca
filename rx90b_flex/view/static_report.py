"""The report of dead-weight tests: one HTML file that opens offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rx90b_flex.identify.static_command import StaticResult
from rx90b_flex.identify.static_stiffness import ALIKE
from rx90b_flex.view.page import PageTable, Section, image, write_page
from rx90b_flex.view.static_plots import static_test_figure


def headline(result: StaticResult) -> list[str]:
    """What was found, a line a hinge, and what to look at."""
    lines: list[str] = []
    for h in result.hinges:
        tests = "" if h.measurements == 1 else f", {h.measurements} tests"
        lines.append(f"{h.coordinate}: {h.value:.4g} ± {h.std:.2g} N m/rad{tests}")
        if not h.determined:
            lines.append("That is no better than a fifth of itself: the declared value stays in the robot's file.")
        if h.p_value < ALIKE:
            lines.append(
                f"Its tests differ by more than their noise (p = {h.p_value:.2g}): another pose, slip, or a wrong lever."
            )
    for f in result.found:
        if f.differs and not f.backwards:
            lines.append(
                f"{f.coordinate}: loading and unloading differ (p = {f.p_value:.2g}): friction takes part, see `skip`."
            )
    return [*lines, *(f"{line}." for line in result.cautions)]


def write_static_report(result: StaticResult, path: Path) -> None:
    """Write the report; it appears whole or not at all."""
    head = ("hinge", "stiffness, N m/rad", "interval", "readings", "up = down, p", "loop, J")
    rows = []
    for f, t in zip(result.found, result.source.tests, strict=True):
        low, high = (f"{x:.4g}" if np.isfinite(x) else "open" for x in f.interval)
        rows.append((
            f.coordinate, f"{f.stiffness:.4g} ± {f.stiffness_std:.2g}", f"{low} to {high}", str(len(t)), f"{f.p_value:.1g}",
            f"{f.hysteresis_area:.2g} ± {f.hysteresis_std:.1g}",
        ))  # fmt: skip
    tests = Section(
        "Tests",
        "One slope for both directions and a height for each: hysteresis is not taken for noise. Intervals are Student's.",
        PageTable(head, rows),
        image(
            static_test_figure(result.source.tests, result.found), "Deformation over moment, up and down, with lines"
        ),
    )
    write_page(path, f"Dead-weight tests of {result.source.path.name}", headline(result), [tests])
