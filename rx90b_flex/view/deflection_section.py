"""The part of a report about second encoders: what each gear does under load, in words, numbers and loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.diagnose.deflection import GearDeflection
from rx90b_flex.identify.deflection import GearFit, loops
from rx90b_flex.view.axes import plain_axes
from rx90b_flex.view.page import Image, PageTable, Section, image

COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
MARKS = ("s", "o", "^", "D", "v", "P")


def gear_section(found: Sequence[GearDeflection]) -> Section | None:
    """What each joint's second encoder shows; None where no joint has one."""
    return Section("Gears: what second encoders show", parts=tuple(map(_gear, found))) if found else None


def _gear(gear: GearDeflection) -> Section:
    tables = []
    if gear.errors:
        caption = (
            "Deflection, root mean square, µrad. Measured: link less motor. Before: less lag, direction and position errors. After: "
            "less the load's part too, on validation as the other recordings tell it."
        )
        parts = {role: (e.measured, e.before, e.after) for role, e in gear.errors.items()}
        rows = tuple((role, *(f"{1e6 * x:.3g}" for x in values)) for role, values in parts.items())
        tables.append(PageTable(("recordings", "measured", "before", "after"), rows, caption))
    if gear.compliances:
        chance = f"; they differ as much as this, or more, with a probability of {gear.agreement:.2g} by chance"
        caption = f"Each recording by itself, nrad per N m{'' if np.isnan(gear.agreement) else chance}."
        rows = tuple((c.recording, c.role, f"{1e9 * c.value:.3g}", f"{1e9 * c.std:.2g}") for c in gear.compliances)
        head = ("recording", "role", "compliance", "standard deviation")
        tables.append(PageTable(head, rows, caption, numbers=(2, 3)))
    if gear.comparisons:
        rows = tuple(
            (
                c.name, f"{c.value:.3g}", f"{c.std:.2g}", c.unit, f"{c.p_value:.2g}", f"{100 * c.gain_share:.1f} %",
                "yes" if c.shown else "no",
            )
            for c in gear.comparisons
        )  # fmt: skip
        compared = ("what", "value", "standard deviation", "unit", "p-value", "gain held out", "shown")
        tables.append(PageTable(compared, rows, "Tried beyond a straight line.", numbers=(1, 2, 4, 5)))
    images: tuple[Image, ...] = ()
    if gear.fit is not None:
        text = (
            "Left: link less motor as measured, over the motor's torque. Right: less the second encoder's lag and position "
            "errors, over the torque that passes the gear (the model's, less friction and rotor inertia), with the fitted line."
        )
        images = (image(loop_figure(gear.fit), f"Deflection of the gear of {gear.joint} over torque", text),)
    return Section(gear.joint, (gear.message,), tuple(tables), images)


def loop_figure(fit: GearFit) -> Figure:
    """Deflection over torque before and after, one colour and mark a recording."""
    figure = Figure(figsize=(8.0, 3.2), layout="constrained", dpi=160)
    before, after = figure.subplots(1, 2)
    widest = 0.0
    for i, loop in enumerate(loops(fit)):
        style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKS[i % len(MARKS)], "label": loop.recording}
        for ax, torque, angle in (
            (before, loop.motor, loop.measured),
            (after, loop.through, loop.deflection),
        ):
            # thousands of marks as one picture keep the report small
            ax.plot(torque, 1e3 * angle, linestyle="none", markersize=2.0, rasterized=True, **style)
        widest = max(widest, float(np.abs(loop.through).max()))
    ends = np.array([-widest, widest])
    after.plot(ends, -1e3 * fit.compliance * ends, color="#000000", linewidth=1.2, label="fitted line")
    for ax, title, label in (
        (before, "before", "motor torque, N m"),
        (after, "after", "torque through the gear, less its mean, N m"),
    ):
        ax.set_title(title, fontsize=9)
        ax.set_xlabel(label, fontsize=8)
        plain_axes(ax)
    before.set_ylabel("link less motor, mrad", fontsize=8)
    after.legend(fontsize=7, frameon=False)
    return figure
