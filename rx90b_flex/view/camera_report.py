"""The report of a camera's markers: one HTML file that opens offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.identify.camera_command import KINDS, CameraResult
from rx90b_flex.identify.measured_stiffness import HingeStiffness
from rx90b_flex.view.axes import AFTER, MEASURED, new_figure
from rx90b_flex.view.page import PageTable, Section, image, write_page


def headline(result: CameraResult) -> list[str]:
    """What was found, a line a hinge, and what to look at."""
    lines = [f"{h.coordinate}: {_value(h)} N m/rad" for h in result.hinges if h.determined]
    lines += [
        f"{h.coordinate}: not determined, {_bounds(h)}; the declared value stays"
        for h in result.hinges
        if not h.determined
    ]
    lines += [f"{line}." for line in result.cautions]
    if result.fit.loudness > 1.0:
        lines.append(
            f"What is left is {result.fit.loudness:.2g} times what the stated noise makes: the standard deviations are widened by "
            f"{np.sqrt(result.fit.loudness):.2g} for that, and markers that slip, vibration or wrong links may be in it."
        )
    return lines


def _value(hinge: HingeStiffness) -> str:
    return f"{hinge.value:.4g} ± {hinge.even_std:.2g}" if hinge.determined else "not determined"


def _bounds(hinge: HingeStiffness) -> str:
    """What the markers tell of a stiffness that they do not determine."""
    low, high = hinge.interval
    if not np.isfinite(low):
        return (
            "for it turns against its moment, which no hinge does: look for an angle of the other sign or a wrong link"
        )
    known = f"at least {low:.3g}" if not np.isfinite(high) else f"between {low:.3g} and {high:.3g}"
    return f"for its moment bends it little beyond the noise: {known} N m/rad (95 %)"


def _interval(hinge: HingeStiffness) -> str:
    low, high = (f"{x:.4g}" if np.isfinite(x) else "open" for x in hinge.interval)
    return f"{low} to {high}"


def write_camera_report(result: CameraResult, path: Path) -> None:
    """Write the report; it appears whole or not at all."""
    fit = result.fit
    axes = ("about the joint's axis", "about the first bending's", "about the second bending's")
    frame = [
        (axis, *(f"{1e3 * x[i]:.3f}" for x in (fit.before, fit.before_std, fit.behind, fit.behind_std)))
        for i, axis in enumerate(axes)
    ]
    hinges = Section(
        "Hinges",
        "The joint's frame is fitted with the stiffnesses: an error of it leaks the joint's large angle into the bendings. Moments "
        "are those of the robot's links along the motion.",
        PageTable(
            ("hinge", "stiffness, N m/rad", "interval of 95 %"),
            [(h.coordinate, _value(h), _interval(h)) for h in result.hinges],
        ),
        PageTable(("error of the joint's frame, mrad", "before", "std", "behind", "std"), frame),
        image(deformation_figure(result), "Deformation of each hinge over its moment, with the fitted line"),
    )
    write_page(path, f"{result.source.joint} of {result.robot.name}, by camera", headline(result), [hinges])


def deformation_figure(result: CameraResult) -> Figure:
    """Deformation of each hinge over its moment, after the frame's errors were taken out, with its line."""
    figure, axes = new_figure(2.7, columns=3, width=7.2, labels=8)
    fit = result.fit
    for ax, kind, moment, seen, k in zip(axes, KINDS, result.moment.T, fit.deformation.T, fit.stiffness, strict=True):
        ax.plot(moment, 1e3 * seen, ".", color=MEASURED, markersize=2)
        ends = np.array([moment.min(), moment.max()])
        ax.plot(ends, 1e3 * ends / k, color=AFTER, linewidth=1.2)
        ax.set_title(f"{kind}, {k:.3g} N m/rad", fontsize=8)
        ax.set_xlabel("moment, N m")
    axes[0].set_ylabel("deformation, 10⁻³ rad")
    return figure
