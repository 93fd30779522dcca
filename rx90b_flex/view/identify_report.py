"""The report of ``rx90b-flex identify``: one HTML file that opens offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rx90b_flex.identify.command import Identified, RoleError
from rx90b_flex.identify.least_squares import Estimate
from rx90b_flex.view.estimates import number, unit_text
from rx90b_flex.view.identify_plots import relative_stds, torque_fit
from rx90b_flex.view.page import PageTable, Section, image, write_page

LARGEST_BARS = 40  # parameters in the figure of standard deviations; the table holds all


def write_identify_report(result: Identified, path: Path) -> None:
    """Write the report of an identification; it appears whole or not at all."""
    sections = [_errors(result), _parameters(result), _base(result), _consistency(result), _facts(result)]
    write_page(path, f"Identification of {result.source.name}", headline(result), sections)


def headline(result: Identified) -> list[str]:
    """The main result in a sentence, then what qualifies it."""
    told = [e for e in result.parameters if e.value is not None]
    error = result.validation or result.identification
    where = "on data that was not fitted" if result.validation else "on the data of the fit (no validation recording)"
    lead = [
        f"The identified model's torque error is {100 * error.relative_error:.3g} % {where}.",
        f"The data determine {len(result.base)} combinations of {len(result.model.theta)} parameters; "
        f"{len(told)} of {len(result.parameters)} values are told by themselves.",
    ]
    if result.estimator != "least_squares":
        lead.append(f"Estimated by {result.estimator.replace('_', ' ')}; least squares is what is usual.")
    lead += [consistency_words(result), *bound_words(result), *result.cautions]
    return lead


def bound_words(result: Identified) -> list[str]:
    """Which bounds hold, and what a wrong sign is likely to come from; empty where nothing was out of bounds."""
    consistency = result.consistency
    out = []
    if consistency.held:
        out.append(f"Held at their physical bounds: {', '.join(consistency.held)}.")
    if consistency.wrong_sign:
        out.append(
            f"Fitted far below zero, which nothing can have: {', '.join(consistency.wrong_sign)}. Either a torque or position "
            "column has the wrong sign, which check looks for, or the model lacks an effect there, such as friction that falls with "
            "speed, which close-loop looks for."
        )
    return out


def consistency_words(result: Identified) -> str:
    """A sentence on whether the identified links can exist."""
    found = result.consistency.found
    if not result.model.links_fitted:
        return "The links' inertias were known and are kept."
    if not found:
        return "The identified links are physically consistent."
    links = ", ".join(f.link for f in found)
    after, before = (
        100 * x for x in (result.consistency.relative_error_after, result.consistency.relative_error_before)
    )
    return (
        f"Links as estimated could not exist ({links}); they were replaced by the nearest that can, which moves the error "
        f"on the data of the fit from {before:.4g} % to {after:.4g} %."
    )


def _errors(result: Identified) -> Section:
    roles: list[tuple[str, RoleError]] = [("identification", result.identification)]
    if result.validation is not None:
        roles.append(("validation", result.validation))
    joints = result.campaign.joints
    rows = [(role, f"{100 * e.relative_error:.4g}", *(f"{x:.4g}" for x in e.torque_rms)) for role, e in roles]
    units = [u.force for u in result.source.units_of(joints)]
    head = ("recordings", "relative error, %", *(f"{j}, {u}" for j, u in zip(joints, units, strict=True)))
    first = result.predictions[0]
    images = (
        image(
            torque_fit(first.recording.time, first.measured[:, i], first.predicted[:, i], joint, unit=units[i]),
            f"Torque of {joint}, measured and predicted",
            f"{joint}: recording {first.recording.name} ({first.recording.role})",
            zoom=True,
        )
        for i, joint in enumerate(joints)
    )
    text = "Of the robot as it is exported. Signals are compared after the campaign's low-pass, where it has one."
    return Section("Errors", text, PageTable(head, rows, "Error, and its root mean square a joint"), *images)


def _parameters(result: Identified) -> Section:
    told = [e for e in result.parameters if e.value is not None]
    free = {f.name: f.value for f in result.fitted}
    rows = [(e.name, number(e.value), number(e.std), unit_text(e.unit), _moved(e, free[e.name])) for e in told]
    head = ("parameter", "value", "std", "unit", "fitted without bounds")
    figure = None
    sized = [(e.name, abs(e.std / e.value)) for e in result.parameters if e.value and e.std]
    if sized:
        names, relative = zip(*sorted(sized, key=lambda pair: -pair[1])[:LARGEST_BARS], strict=True)
        caption = "Standard deviation over value, least certain first; dashed: 10 %"
        figure = image(relative_stds(names, np.array(relative)), "Relative standard deviations", caption)
    text = (
        "Values of the robot that is written, which can exist. Standard deviations are those of the fit and allow for residuals that "
        "are correlated in time; they count noise, not what the model lacks."
    )
    bodies = tuple(f"{body}." for body, _ in result.model.regression.robot.bodies)
    silent = [e.name for e in result.parameters if e.value is None and not e.name.startswith(bodies)]
    untold = f"Not told: {', '.join(silent)}." if silent else None
    table = PageTable(head, rows, "Parameters by themselves", numbers=(1, 2, 4))
    return Section("Parameters", text, untold, table, figure)


def _moved(estimate: Estimate, fitted: float | None) -> str:
    """The fitted value where a possible robot has another one."""
    if fitted is None or estimate.value is None or abs(fitted - estimate.value) <= 1e-9 * abs(fitted):
        return ""
    return number(fitted)


def _base(result: Identified) -> Section:
    rows = [(b.text, number(b.value), number(b.std), unit_text(b.unit)) for b in result.base]
    table = PageTable(("combination", "value", "std", "unit"), rows, "Base parameters", numbers=(1, 2))
    text = "The smallest set of combinations that the torques depend on; each is led by a parameter that stands in no other."
    return Section("Base parameters", text, table)


def _consistency(result: Identified) -> Section:
    consistency = result.consistency
    text = [consistency_words(result)]
    if consistency.found or consistency.held:
        text.append(
            f"Base parameters moved by {consistency.largest_shift_std:.3g} of their standard deviations at the most. "
            "More than about 3 says that the model lacks something."
        )
    rows = [(f.link, f"{f.eigenvalue:.4g}", f.message) for f in consistency.found]
    table = PageTable(("link", "smallest eigenvalue", "reason"), rows, "Links as estimated", numbers=(1,))
    return Section("Physical consistency", *text, *bound_words(result), table if rows else None)


def _facts(result: Identified) -> Section:
    campaign = result.campaign
    rows = [(r.name, r.role, f"{r.duration_s:.4g}", str(r.samples)) for r in campaign.recordings]
    table = PageTable(("recording", "role", "duration, s", "samples"), rows, numbers=(2, 3))
    cutoff = "no low-pass" if campaign.cutoff_hz is None else f"low-pass at {campaign.cutoff_hz:g} Hz"
    flexible = sorted({e.type_name() for e in result.source.effects if e.traits.virtual})
    text = [f"{campaign.sample_rate_hz:g} Hz, {cutoff}. Weighted least squares, one weight a joint."]
    if flexible:
        text.append(f"Kept as declared, since motor signals at low frequency do not tell them: {', '.join(flexible)}.")
    return Section("Data and method", *text, table)
