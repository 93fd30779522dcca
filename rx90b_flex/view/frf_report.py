"""The report of an identification from motor signals: one HTML file that opens offline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import joblib
import numpy as np

from rx90b_flex.identify.frf_command import ASSUMED, AtPose, MotorIdentification
from rx90b_flex.identify.grey_box import GreyBox
from rx90b_flex.identify.grey_model import SLOPE, Delay, HingePlace
from rx90b_flex.identify.replay import ReplayedGreyBox
from rx90b_flex.identify.transfer_function import TransferFit
from rx90b_flex.joint_units import response_unit
from rx90b_flex.view import frf_plots, grey_plots, transfer_plots
from rx90b_flex.view.estimates import unit_text
from rx90b_flex.view.page import PageTable, Section, image, seconds_table, write_page

SHOWN_STARTS = 6
LEAST_DELAY_US = 0.5  # a shorter one is not worth a word
UNDER = "If the model is right, 95 % of the dots lie under the line of the band."
SHOWN_DIRECTIONS = 4  # vaguest; frf.json has all


def write_frf_report(result: MotorIdentification, path: Path) -> None:
    """Write the report; it appears whole or not at all.

    Parameters
    ----------
    result : MotorIdentification
    path : Path
        The file; its folder exists.
    """
    at_poses = [section for p in result.poses for section in (_response(result, p), _modes(result, p))]
    sections = [_by_replay(result), _physical(result), *at_poses, _residuals(result), _how(result)]
    write_page(path, f"{result.robot.name} from motor signals", _lead(result), sections)


def _lead(result: MotorIdentification) -> list[str]:
    grey = result.grey if result.replayed is None else result.replayed.grey
    out = []
    if grey is not None:
        known = [e for e in grey.estimates if "stiffness" in e.name]
        good = [e for e in known if e.std < 0.1 * e.value]
        out.append(f"{len(good)} of {len(known)} stiffnesses are known to 10 % (one standard deviation) or better.")
        out.append(bias_words(grey) if result.replayed is None else _share_words(result.replayed))
    for p in result.poses:
        measured = p.measured
        out.append(
            f"{_named(result, p)}{measured.value.shape[1]} joints, {len(measured.hz)} lines from {measured.hz[0]:.3g} to "
            f"{measured.hz[-1]:.3g} Hz, {len(measured.realisations)} realisations of {measured.torque.shape[2]} experiments, "
            f"{measured.periods} periods each."
        )
    sensors = next((p.accelerations.sensors for p in result.poses if p.accelerations is not None), ())
    if sensors:
        links = ", ".join(dict.fromkeys(s.link.replace("_", " ") for s in sensors))
        out.append(f"{len(sensors)} accelerometers on {links} were fitted together with the motors' signals.")
    out += [f"Left out: {x.stage}: {x.why}." for x in result.left_out]
    return out


def _named(result: MotorIdentification, at: AtPose) -> str:
    """The pose and a colon where there are several."""
    return f"{at.name.capitalize()}: " if len(result.poses) > 1 else ""


def _angles(result: MotorIdentification, at: AtPose) -> str:
    both = zip(at.pose.tolist(), result.robot.units, strict=True)
    each = (u.place(q) if u.slides else f"{round(np.rad2deg(q), 1) + 0.0:.1f}°" for q, u in both)
    return ", ".join(
        f"{joint.replace('_', ' ')} {place}" for joint, place in zip(result.robot.joints, each, strict=True)
    )


def amounts(*values: float) -> tuple[str, ...]:
    """Numbers in full, all with the decimals that give the smallest of them two digits, none where all are large."""
    sizes = [abs(v) for v in values if v]
    decimals = max(0, 1 - int(np.floor(np.log10(min(sizes))))) if sizes else 0
    # a thin space parts thousands
    return tuple(f"{v:,.{min(decimals, 6)}f}".replace(",", "\u2009") for v in values)


def bias_words(grey: GreyBox) -> str:
    """Whether the model is enough for the data, and what that means for its intervals, in a sentence."""
    share = grey.cost / grey.expected_cost
    if grey.bias_detected:
        return (
            f"The model leaves {share:.2f} times the residual that noise, distortion and the stated model error give: something is "
            "missing in it, and the intervals are widened by that."
        )
    return f"The residual is {share:.2f} times what noise, distortion and the stated model error give: the model is enough."


def _share_words(replayed: ReplayedGreyBox) -> str:
    before, after = (np.median(np.diagonal(x, axis1=1, axis2=2)) for x in (replayed.before, replayed.after))
    return (
        f"Drive points of one realisation deviate from the others' mean by {100 * before:.2g} % as measured, and by "
        f"{100 * after:.2g} % less what the replay explains (medians over the lines)."
    )


def _by_replay(result: MotorIdentification) -> Section | None:
    replayed, first = result.replayed, result.grey
    if replayed is None or first is None:
        return None
    rows = []
    for e in replayed.grey.estimates:
        if SLOPE in e.name:
            continue
        was = first[e.name]
        # as many decimals as tell the ends of the narrower interval apart
        _, *values = amounts(e.std, was.value, was.low, was.high, e.value, e.low, e.high, e.start)
        note = "" if e.determined else "not determined by this data"
        rows.append(
            (_words(e.name), values[0], f"{values[1]} – {values[2]}", values[3], f"{values[4]} – {values[5]}", values[6],
             unit_text(e.unit), note)
        )  # fmt: skip
    head = ("parameter", "as measured", "95 % interval", "by replay", "95 % interval", "declared", "unit", "")
    frictions = [(_words(f.name), *amounts(f.value, f.std, f.declared), unit_text(f.unit)) for f in replayed.frictions]
    caption = (
        "Friction, from how the response changes with the excitation; its standard deviations hold if the form is right"
    )
    told = PageTable(("parameter", "value", "std", "declared", "unit"), frictions, caption, (1, 2, 3))
    return Section(
        "Physical parameters, friction's distortion removed",
        "Friction that reverses distorts the response. The experiments were simulated on the robot as fitted, and what they showed "
        "there beyond a robot with viscous friction was taken off the measured response; then the grey box was fitted again.",
        "As measured, the fit assumes nothing of friction's form, only how large an error it may leave. The replay assumes that "
        f"{ASSUMED}.",
        _share_words(replayed),
        f"The fit's residual is {replayed.grey.cost / replayed.grey.expected_cost:.2f} times what its intervals allow for.",
        *delay_words(replayed.grey.torque_delay),
        *hinge_words(replayed.grey.hinges),
        PageTable(head, rows, numbers=range(1, 6)),
        told if frictions else None,
        image(grey_plots.intervals(replayed.grey), "Intervals of all physical parameters", "95 % intervals, by replay"),
    )


def delay_words(delay: Delay | None) -> list[str]:
    """By how much torques were logged late, in a sentence; none where it was not asked, or is none within its uncertainty."""
    if delay is None:
        return []
    value, std = (1e6 * x for x in (delay.value, delay.std))
    if abs(value) < max(LEAST_DELAY_US, 2.0 * std):
        return []
    size, spread = amounts(abs(value), max(std, 0.01))
    return [
        f"Torques are logged {size} ± {spread} µs {'later' if value >= 0 else 'earlier'} than angles; that is taken out."
    ]


def hinge_words(hinges: Sequence[HingePlace]) -> list[str]:
    """Where hinges lie that were not taken as known, a sentence each."""
    out = []
    for h in hinges:
        each = zip("xyz", h.offset, h.std, strict=True)
        places = ", ".join(f"{axis} {1e3 * value:+.1f} ± {1e3 * std:.1f}" for axis, value, std in each)
        out.append(
            f"The hinges of {h.joint} lie {places} mm from where they are declared (± {1e3 * h.declared_std:g} mm before)."
        )
    return out


def _words(name: str) -> str:
    return name.replace(".", " ").replace("_", " ")


def _physical(result: MotorIdentification) -> Section | None:
    grey = result.grey
    if grey is None:
        return None
    rows = []
    for e in grey.estimates:
        note = "" if e.determined else "not determined by this data"
        value, std, low, high, start = amounts(e.value, e.std, e.low, e.high, e.start)
        rows.append((_words(e.name), value, std, f"{low} – {high}", start, unit_text(e.unit), note))
    columns = ("parameter", "value", "std", "95 % interval", "declared", "unit", "")
    tables = [PageTable(columns, rows, "Grey box: fitted to all poses together", range(1, 5))]
    if grey.directions:
        vague = [
            (d.words.rsplit(":", 1)[0], f"{100 * d.relative_std:.0f} %") for d in grey.directions[:SHOWN_DIRECTIONS]
        ]
        caption = "What the data say least: parameters that change together almost unseen, and how far (one standard deviation)"
        tables.append(PageTable(("combination", "std"), vague, caption))
    compared = [row for p in result.poses for row in _drive_rows(result, p, grey)]
    if compared:
        head = ("drive", "poles and zeros", "std", "grey box", "std", "unit")
        caption = (
            "Beside it the source's route, from poles and zeros: it counts the modes in the band alone. What lies above the band is "
            "missing in its stiffness, and its standard deviation does not know of that."
        )
        tables.append(PageTable(head, compared, caption, range(1, 5)))
    text = [
        "Fitted straight to the frequency responses; links and springs are as declared. All values are on the joint side.",
        "Drive stiffness and damping: torsion between motor and link. Joint stiffness and damping 1 and 2: bending about the two "
        "axes across the joint's own. Friction slope: friction torque over velocity, as small vibrations feel it, one for each "
        "experiment.",
    ]
    assumed = result.options.bending_alike_std
    if assumed > 0:
        text.append(
            f"Assumed: a joint is equally stiff about both its bending axes to {100 * assumed:.0f} % "
            "(the source has one number for both)."
        )
    if result.options.link_mass_std > 0:
        text.append(f"Links' masses are known to {100 * result.options.link_mass_std:.1f} %, and fitted.")
    text.append(
        "Friction that reverses is not viscous: its slopes are those that serve this motion, and what they leave over is part of the "
        "intervals as a model error."
    )
    text += delay_words(grey.torque_delay) + hinge_words(grey.hinges)
    figure = image(grey_plots.intervals(grey), "Intervals of all physical parameters", "95 % intervals")
    title = "Physical parameters" + ("" if result.replayed is None else ", as measured")
    return Section(title, *text, *tables, figure)


def _drive_rows(result: MotorIdentification, at: AtPose, grey: GreyBox) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    if at.drives is None:
        return rows
    units = result.robot.units_of(at.drives.joints)
    for joint, own, d in zip(at.drives.joints, units, at.drives.drives, strict=True):
        for kind, value, std, unit in (
            ("inertia", d.inertia, d.inertia_std, "kg m^2"),
            ("stiffness", d.stiffness, d.stiffness_std, "N m/rad"),
        ):
            best = grey[f"{joint}.drive_{kind}"]
            name = f"{_named(result, at)}{joint.replace('_', ' ')} {kind}"
            rows.append((name, *amounts(value, std), *amounts(best.value, best.std), unit_text(own.of(unit))))
    return rows


def _response(result: MotorIdentification, at: AtPose) -> Section:
    measured, units = at.measured, result.robot.units_of(at.measured.joints)
    unit = response_unit(units)
    others: list[frf_plots.Comparison] = []
    place = _place_in_grey(result, at)
    if result.grey is not None and place is not None:
        others.append((result.grey.responses[place].hz, result.grey.predicted[place], "grey box"))
    if at.transfer is not None:
        others.append((measured.hz, at.transfer.model.frf(measured.hz), "transfer functions"))
    pictures = [
        (frf_plots.magnitude(measured, others, unit=unit), "Magnitude of every entry", "Magnitude, with 95 % bands"),
        (frf_plots.phase(measured, others), "Phase of every entry", "Phase, with 95 % bands"),
    ]
    for hz, model, name in others:
        if len(hz) == len(measured.hz):
            apart = f"Difference from the {name}"
            pictures.append((frf_plots.difference(measured, model, name, unit=unit), apart, f"{apart}. {UNDER}"))
    signals = "Signal-to-noise ratio of the measured signals"
    pictures += [
        (
            frf_plots.signal_to_noise(measured),
            "Signal-to-noise ratio of every entry",
            "How far every entry stands out: of noise alone (more periods lower it), and of noise and nonlinear distortion "
            "(more realisations lower both)",
        ),
        (frf_plots.channel_signal_to_noise(measured), signals, signals),
        (
            frf_plots.excitation(measured.spectra, measured.joints, units),
            "Torque and acceleration at excited and other lines",
            "Torque and acceleration at the excited lines; at the others nonlinearity (mostly friction) answers",
        ),
    ]
    # grids of axes take seconds each to draw
    images = joblib.Parallel(n_jobs=result.options.jobs)(joblib.delayed(image)(*each, zoom=True) for each in pictures)
    text = f"Drive acceleration over drive torque, at a mean pose of {_angles(result, at)}."
    return Section(f"{_named(result, at)}Frequency response", text, *images)


def _place_in_grey(result: MotorIdentification, at: AtPose) -> int | None:
    """Which of the grey box's responses is this pose's."""
    fitted = [result.poses[i] for i in result.fitted]
    return next((k for k, p in enumerate(fitted) if p is at), None)


def _modes(result: MotorIdentification, at: AtPose) -> Section | None:
    fit, tests = at.transfer, at.validation
    if fit is None:
        return None
    tables = _mode_tables(fit)
    if tests is not None:
        rows = [(c.name, "pass" if c.passed else "fail", c.found, c.implies) for c in tests.checks]
        tables.append(PageTable(("test", "", "found", "what it implies"), rows, "Validation", ()))
    terms = {"restoring": "1/s²", "direct": "a constant", "slope": "s", "flexibility": "s² (residual flexibility)"}
    return Section(
        f"{_named(result, at)}Transfer functions",
        f"{sum(fit.counted)} modes count, of {len(fit.counted)} in the fit chosen from "
        f"{', '.join(str(c.modes) for c in fit.candidates)}. Beside them stand, for what lies beside the band: "
        f"{', '.join(terms[name] for name in fit.residual_terms)}.",
        "Standard deviations hold noise, distortion, and by how much fits with other numbers of modes and terms differ, as far "
        "as the data leave the choice open.",
        *tables,
        image(
            transfer_plots.residual_correlation(fit),
            "Correlation of residuals",
            "Correlation of the residuals along the lines",
            zoom=True,
        ),
        image(
            transfer_plots.stabilisation(fit, response_unit(result.robot.units_of(fit.response.joints))),
            "Modes of fits of several orders",
            "Stabilisation diagram: modes of the fits of every order that was tried, and the mean response",
        ),
    )


def _mode_tables(fit: TransferFit) -> list[PageTable]:
    """Resonances and antiresonances that count; those that do not, with their reasons."""
    resonances: list[tuple[str, ...]] = []
    zeros: list[tuple[str, ...]] = []
    refused: list[tuple[str, ...]] = []
    for f, s, z, z_std, why in fit.mode_rows():
        if why:
            refused.append(("mode", f"{f:.2f}", f"{s:.2g}", why))
        else:
            resonances.append((str(len(resonances) + 1), f"{f:.2f}", f"{s:.2g}", f"{z:.3f}", f"{z_std:.2g}"))
    for j, joint in enumerate(fit.response.joints):
        name = joint.replace("_", " ")
        for f, s, why in zip(*fit.antiresonances(j), fit.refused_antiresonances(j), strict=True):
            if why:
                refused.append((f"antiresonance of {name}", f"{f:.2f}", f"{s:.2g}", why))
            else:
                zeros.append((name, f"{f:.2f}", f"{s:.2g}"))
    head = ("mode", "resonance, Hz", "std, Hz", "damping ratio, -", "std, -")
    tables = [
        PageTable(head, resonances, "Resonances, undamped"),
        PageTable(("drive", "antiresonance, Hz", "std, Hz"), zeros, "Antiresonances, undamped"),
    ]
    if refused:
        caption = "Refused: terms of the fit that are no modes or antiresonances which the data show"
        tables.append(PageTable(("", "frequency, Hz", "std, Hz", "why"), refused, caption, (1, 2)))
    return tables


def _residuals(result: MotorIdentification) -> Section | None:
    grey = result.grey
    if grey is None:
        return None
    alike, followed = grey.ended_alike
    best = min(s.cost for s in grey.starts if s.cost is not None)
    costs = [(s.name, f"{s.cost - best:.2f}") for s in grey.starts if s.cost is not None]
    agree = f"{alike} of {followed} starts that were followed to the end agree"
    table = PageTable(("start", "cost at its end, above the lowest"), costs[:SHOWN_STARTS], agree)
    figures = []
    for k in range(len(grey.responses)):  # first of the motors at each pose, then of the accelerometers
        of_motors = k < len(result.fitted)
        name = _named(result, result.poses[result.fitted[k % len(result.fitted)]])
        alt = "Residuals of the grey box along frequency" + ("" if of_motors else ", accelerometers")
        caption = f"{name}residuals" + ("" if of_motors else " of the accelerometers")
        figures.append(image(grey_plots.residuals(grey, k), alt, caption, zoom=True))
    text = f"Cost {grey.cost:.0f}; {grey.expected_cost:.0f} expected, 95 % of right models below {grey.cost_limit:.0f}."
    return Section("Residuals of the grey box", text, bias_words(grey), table, *figures)


def _how(result: MotorIdentification) -> Section:
    left_out = (f"{x.stage}: left out: {x.why}." for x in result.left_out)
    return Section("How it was done", *result.remarks, *left_out, seconds_table(result.seconds))
