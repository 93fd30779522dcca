"""The report of ``rx90b-flex check``: what is wrong with the data, and what the motion can tell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rx90b_flex.diagnose.check import Checked, check_json
from rx90b_flex.files.results import write_json
from rx90b_flex.view.page import Image, PageTable, Section, write_page

if TYPE_CHECKING:
    from rx90b_flex.diagnose.close import ClosedLoop


def write_check_report(checked: Checked, folder: Path, plots: bool = False) -> None:
    """Write ``check.json`` and ``check.html`` into a folder that exists."""
    write_json(folder / "check.json", check_json(checked))
    images: Sequence[Image] = ()
    if plots and checked.recordings:
        from rx90b_flex.view.preview import preview_images

        images = preview_images(checked.source)
    write_check_page(checked, folder / "check.html", images)


def write_check_page(checked: Checked, path: Path, images: Sequence[Image] = ()) -> None:
    """Write the page alone; a preview stands after the faults where there is one."""
    text = (
        "The declared model with the values that its files give, before anything is fitted; measured torque beside it."
    )
    sections = [
        _faults(checked),
        Section("Preview", text, *images) if images else None,
        _recordings(checked),
        _joints(checked),
        _parameters(checked),
    ]
    write_page(path, f"A look at the data of {checked.robot}", lead(checked), sections)


def check_section(checked: Checked | None) -> Section | None:
    """What a look at the data said, as a part of another report: faults, recordings, and what the motion can tell."""
    if checked is None:
        return None
    words = (*lead(checked), *facts_words(checked), *told_words(checked))
    return Section("The data, looked at first", *words, *_faults(checked).tables, *_recordings(checked).tables)


def lead(checked: Checked) -> list[str]:
    """The verdict, each fault in a sentence, and what goes with it."""
    return [checked.verdict, *(f.message for f in checked.data_faults), *basics_words(checked)]


def basics_words(of: Checked | ClosedLoop) -> tuple[str, ...]:
    """The offer to declare what every drive has, where the robot file does not; in one line."""
    if not of.undeclared_basics:
        return ()
    names = ", ".join(n.replace("_", " ") for n in of.undeclared_basics)
    return (f"Not declared on any joint, but the torques show it: {names}. Add --basics to have them identified.",)


def told_words(checked: Checked) -> tuple[str, ...]:
    """How many parameters the motion can tell, and which joints never move."""
    if not checked.parameters:
        return ()
    count = Counter(p.status for p in checked.parameters)
    out = [
        f"Of {len(checked.parameters)} parameters this motion tells {count['identifiable']} by themselves, {count['weak']} weakly; "
        f"{count['not']} only together with others or not at all"
        + (f", {count['known']} are known." if count["known"] else ".")
    ]
    if checked.never_move:
        out.append(f"Not told, for they never move: {', '.join(checked.never_move)}.")
    return tuple(out)


def facts_words(checked: Checked) -> tuple[str, ...]:
    """What a campaign file may state: a sensible low-pass, the noise, and what is odd about the torques' side of the gears."""
    out = []
    if checked.cutoff_hz is not None:
        out.append(f"A sensible low-pass for this motion: {checked.cutoff_hz:.3g} Hz (cutoff_hz).")
    if checked.noise_floor is not None:
        rms = ", ".join(f"{x:.3g}" for x in checked.noise_floor)
        out.append(
            f"Noise of the torques, from what differs between periods or as stated: {rms} {checked.torque_unit} a joint."
        )
    elif checked.recordings:
        out.append("The noise of the torques is not known: no motion repeats (period_s), and none is stated.")
    for r in checked.recordings:
        if r.stated_period_s is not None:
            does = "it does not repeat" if r.period_s is None else f"it does after {r.period_s:g} s"
            out.append(
                f"{r.file}: the motion does not repeat after period_s = {r.stated_period_s:g} s; {does}. Correct period_s."
            )
    side = checked.torque_side
    sides = {"motor": "of the motors", "joint": "of the motors, seen at the joints", "behind_gear": "behind the gears"}
    if side.message:
        out.append(side.message)
    elif side.found is not None:
        out.append(f"Torques are those {sides[side.stated or side.found]}{' (stated)' if side.stated else ''}.")
    return tuple(out)


def _faults(checked: Checked) -> Section:
    rows = [
        (
            f.kind,
            f.signal or "",
            ", ".join(f.joints),
            "" if f.factor is None else f"{f.factor:.4g}" + ("" if f.std is None else f" ± {f.std:.2g}"),
            "" if f.error_before is None else f"{100 * f.error_before:.3g} → {100 * (f.error_after or 0.0):.3g}",
            "usable" if f.usable else "not usable",
            f.message,
        )
        for f in checked.data_faults
    ]
    if not rows:
        return Section("Faults", "None was found.")
    head = ("kind", "signal", "joints", "factor", "held-out error, %", "data", "what to do")
    text = (
        "Each line is a hypothesis about the data that predicts rows it was not fitted to better than no fault does, or "
        "something that shows in the log itself. A factor is what is stated over what is true (seconds for a shift, rad for a zero)."
    )
    return Section("Faults", text, PageTable(head, rows, "What was found", numbers=(3, 4)))


def _recordings(checked: Checked) -> Section:
    rows = [
        (
            r.file, r.role, f"{r.duration_s:.4g}", f"{r.rate_hz:g}", f"{100 * r.at_rest:.3g}",
            "" if r.position_step_rad is None else f"{r.position_step_rad:.2g}", "" if r.period_s is None else f"{r.period_s:g}",
        )
        for r in checked.recordings
    ]  # fmt: skip
    head = ("file", "role", "duration, s", "rate, Hz", "at rest, %", "position step, rad", "period, s")
    return Section("Recordings", *facts_words(checked), PageTable(head, rows, numbers=range(2, 7)))


def _joints(checked: Checked) -> Section:
    rows = [(j, f"{100 * e:.3g}") for j, e in zip(checked.joints, checked.relative_error, strict=False)]
    text = (
        "Error of the rigid model with basic friction on rows that it was not fitted to, over the torque's standard deviation; "
        "100 % is what a constant leaves."
    )
    return Section("Joints", text, PageTable(("joint", "error, %"), rows) if rows else None)


def _parameters(checked: Checked) -> Section:
    rows = [(p.name, p.status) for p in checked.parameters]
    return Section(
        "What the motion can tell",
        *told_words(checked),
        "weak: the standard deviation is a third of the parameter's size or more; not: told only together with others.",
        PageTable(("parameter", "status"), rows, numbers=()) if rows else None,
    )
