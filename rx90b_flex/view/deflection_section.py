"""The part of a report about second encoders: what each gear does under load, in words, numbers and loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.diagnose.deflection import GearDeflection
from rx90b_flex.identify.deflection import GearFit, loops
from rx90b_flex.view.axes import AFTER, BEFORE, FLOOR, REACHED, new_figure
from rx90b_flex.view.page import PageTable, Section, image

COLOURS = (BEFORE, AFTER, REACHED, "#cc79a7", "#56b4e9", "#e69f00")
MARKS = ("s", "o", "^", "D", "v", "P")


def gear_section(found: Sequence[GearDeflection]) -> Section | None:
    """What each joint's second encoder shows; None where no joint has one."""
    return Section("Gears: what second encoders show", *map(_gear, found)) if found else None


def _gear(gear: GearDeflection) -> Section:
    shown = []
    if gear.errors:
        caption = (
            "Deflection, root mean square, µrad. Measured: link less motor. Before: less lag, direction and position errors. After: "
            "less the load's part too, on validation as the other recordings tell it."
        )
        parts = {role: (e.measured, e.before, e.after) for role, e in gear.errors.items()}
        errors = [(role, *(f"{1e6 * x:.3g}" for x in values)) for role, values in parts.items()]
        shown.append(PageTable(("recordings", "measured", "before", "after"), errors, caption))
    if gear.compliances:
        chance = f"; they differ as much as this, or more, with a probability of {gear.agreement:.2g} by chance"
        caption = f"Each recording by itself, nrad per N m{'' if np.isnan(gear.agreement) else chance}."
        rows = [(c.recording, c.role, f"{1e9 * c.value:.3g}", f"{1e9 * c.std:.2g}") for c in gear.compliances]
        head = ("recording", "role", "compliance", "standard deviation")
        shown.append(PageTable(head, rows, caption, numbers=(2, 3)))
    if gear.comparisons:
        tried = [
            (
                c.name, f"{c.value:.3g}", f"{c.std:.2g}", c.unit, f"{c.p_value:.2g}", f"{100 * c.gain_share:.1f} %",
                "yes" if c.shown else "no",
            )
            for c in gear.comparisons
        ]  # fmt: skip
        compared = ("what", "value", "standard deviation", "unit", "p-value", "gain held out", "shown")
        shown.append(PageTable(compared, tried, "Tried beyond a straight line.", numbers=(1, 2, 4, 5)))
    loop = None
    if gear.fit is not None:
        text = (
            "Left: link less motor as measured, over the motor's torque. Right: less the second encoder's lag and position "
            "errors, over the torque that passes the gear (the model's, less friction and rotor inertia), with the fitted line."
        )
        loop = image(loop_figure(gear.fit), f"Deflection of the gear of {gear.joint} over torque", text)
    return Section(gear.joint, gear.message, *shown, loop)


def loop_figure(fit: GearFit) -> Figure:
    """Deflection over torque before and after, one colour and mark a recording."""
    figure, (before, after) = new_figure(3.2, columns=2, width=8.0, labels=8, dpi=160)
    widest = 0.0
    for i, loop in enumerate(loops(fit)):
        colour, mark = COLOURS[i % len(COLOURS)], MARKS[i % len(MARKS)]
        for ax, torque, angle in ((before, loop.motor, loop.measured), (after, loop.through, loop.deflection)):
            # thousands of marks as one picture keep the report small
            (marks,) = ax.plot(torque, 1e3 * angle, mark, color=colour, markersize=2.0, label=loop.recording)
            marks.set_rasterized(True)
        widest = max(widest, float(np.abs(loop.through).max()))
    ends = np.array([-widest, widest])
    after.plot(ends, -1e3 * fit.compliance * ends, color=FLOOR, linewidth=1.2, label="fitted line")
    before.set_title("before", fontsize=9)
    after.set_title("after", fontsize=9)
    before.set(xlabel="motor torque, N m", ylabel="link less motor, mrad")
    after.set_xlabel("torque through the gear, less its mean, N m")
    after.legend(fontsize=7, frameon=False)
    return figure
