"""The report of a closed loop: one HTML file that opens offline, on paper and on a telephone; figures zoom where scripts run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex import __version__
from rx90b_flex.diagnose import evidence
from rx90b_flex.diagnose.close import ClosedLoop, FoundEffect
from rx90b_flex.diagnose.free_form import NO_FORM
from rx90b_flex.diagnose.motion import MotionErrors
from rx90b_flex.diagnose.refused import RefusedLoop
from rx90b_flex.diagnose.trial import GAIN_T, SIGNIFICANCE, SMALLEST_GAIN, TorqueTrial
from rx90b_flex.diagnose.verdict import ENOUGH, NEAR_FLOOR
from rx90b_flex.effects import Effect
from rx90b_flex.effects.hints import SMALLEST_PART
from rx90b_flex.identify.near_tree import KNOWN
from rx90b_flex.robot import LINK_PARAMETERS, LINK_UNITS
from rx90b_flex.signals.tables import write_whole
from rx90b_flex.view import plots
from rx90b_flex.view.advice import (
    MOSTLY,
    dependence_words,
    effect_estimates,
    effect_words,
    joined,
    next_measurements,
    place_words,
    standstill,
    why_noise_is_unknown,
)
from rx90b_flex.view.check_report import check_section, write_check_page
from rx90b_flex.view.deflection_section import gear_section
from rx90b_flex.view.estimates import counted, measured, measured_all, name_of, number, unit_text, values
from rx90b_flex.view.page import Image, PageTable, Section, image, render

MOVED = 2.0  # standard deviations from which a link parameter is listed as moved
WORSE = 1.005  # times the error before: an error after it that is marked
SHOWN_FINDINGS = 4  # joints with a figure beside their first finding; the residuals hold all
SHOWN_DEPENDENCES = 4  # plots of what remains; the table holds all

ROLES = {"validation": "data that was not fitted", "identification": "data that was fitted"}
VERDICTS = {
    "nothing_missing": "Nothing missing",
    "explained": "Explained",
    "partly_explained": "Partly explained",
    "unexplained": "Unexplained",
}


def write_report(result: ClosedLoop | RefusedLoop, path: Path, motion: MotionErrors | str | None = None) -> None:
    """Write the report of a result as one HTML file; it appears whole or not at all.

    Parameters
    ----------
    result : ClosedLoop or RefusedLoop
        Of the latter the look at the data is the report.
    path : Path
        The file; its folder exists.
    motion : MotionErrors or str, optional
        What `rx90b_flex.diagnose.motion.motion_errors` says of the result.
    """
    if isinstance(result, RefusedLoop):
        write_check_page(result.checked, path)
        return
    html = report_html(result, motion)
    write_whole(Path(path), lambda temporary: temporary.write_text(html, encoding="utf-8"))


def report_html(result: ClosedLoop, motion: MotionErrors | str | None = None) -> str:
    """The report as the text of an HTML page with all figures in it; `motion` as in `write_report`."""
    return render(
        "report.html",
        {
            "percent": percent, "p": p_value, "values": values,
            "place": place_words, "kind": _kind, "meaning": _meaning,
        },
        title=f"{result.robot}: closing the loop",
        zooms=True,
        source=f"{result.robot} · {result.campaign.path.name}",
        mostly=MOSTLY,
        result=result,
        verdict=VERDICTS[result.verdict],
        verdict_meaning=_verdict_meaning(result),
        headline=headline(result),
        error_tables=_error_tables(result),
        errors_figures=[
            _captioned(plots.errors_by_joint(result, role), f"Error of each joint on {role}, before and after") for role in ROLES
        ],
        steps_figure=_steps_figure(result),
        explainable_figure=_explainable_figure(result),
        explainable_words=explainable_words(result),
        standstill=standstill(result),
        at_rest=_at_rest(result),
        above_floor=_above_floor(result),
        step_note=step_note(result),
        floor=_floor_words(result),
        motion=_motion(result, motion),
        finding_figures=_finding_figures(result),
        residuals=Section("", *(_joint_residuals(result, joint) for joint in result.joints)),
        alternatives=_alternatives(result),
        tried=Section("", *_rounds(result)),
        gears=gear_section(result.deflection),
        data=check_section(result.checked),
        dependences=_dependences(result),
        dependence_figures=_dependence_figures(result),
        bands=_bands(result),
        band_figures=_band_figures(result),
        advice=next_measurements(result),
        parameters=_parameters(result),
        links=_links(result),
        moved_links=_moved_links(result),
        facts=PageTable(("what", "how"), _facts(result), "Settings", numbers=(), folds=False),
        evidence=evidence,
        segment_s=plots.SEGMENT_S,
    )  # fmt: skip


# ---- words ----------------------------------------------------------------------------------------------


def headline(result: ClosedLoop) -> str:
    """One sentence: what was found, the error before and after on data that was not fitted, what remains."""
    before, after = (percent(e.validation.relative_error) for e in (result.before, result.after))
    if not result.effects:
        found = {
            "nothing_missing": "No effect is missing from the model",
            "unexplained": "The model lacks something, but no effect in the catalogue explains it",
        }.get(result.verdict, "No effect was added to the model")
        return f"{found}: its torque error on data that was not fitted is {after}, and {_remains(result)}."
    places: dict[str, list[str]] = {}
    for e in result.effects:
        joints = e.effect.joints
        places.setdefault(_kind(e.effect), []).append("–".join(joints) if len(joints) > 1 else place_words(e.effect))
    named = "; ".join(f"{kind} on {joined(where)}" for kind, where in places.items())
    count = "an effect" if len(result.effects) == 1 else f"{len(result.effects)} effects"
    them = "it" if len(result.effects) == 1 else "them"
    change = "falls" if result.after.validation.relative_error < result.before.validation.relative_error else "goes"
    return (
        f"The model lacked {count} ({named}): with {them} the torque error on data that was not fitted {change} "
        f"from {before} to {after}{_since_words(result)}, and {_remains(result)}."
    )


def _since_words(result: ClosedLoop) -> str:
    """The same error but for rows before joints first move; empty where there are none."""
    before, after = result.before.validation.since_moved, result.after.validation.since_moved
    if before is None or after is None:
        return ""
    return f" (since joints first move, from {percent(before.relative_error)} to {percent(after.relative_error)})"


def step_note(result: ClosedLoop) -> str:
    """Which effect brings most on data that was not fitted, and which bring nothing there; empty for one effect."""
    steps = [e.before.relative_error**2 - e.after.relative_error**2 for e in result.effects]
    drop = sum(steps)
    if len(steps) < 2 or drop <= 0:
        return ""
    best = int(np.argmax(steps))
    note = f"On data that was not fitted, {effect_words(result.effects[best].effect)} brings the most"
    note += f" ({100 * steps[best] / drop:.0f} % of the drop of the squared error)."
    idle = [effect_words(e.effect) for e, step in zip(result.effects, steps, strict=True) if step <= 0]
    return f"{note} No lower error there: {joined(idle)}." if idle else note


def _floor_words(result: ClosedLoop) -> str:
    if result.noise_floor is None:
        return "not known"
    low, high = number(min(result.noise_floor)), number(max(result.noise_floor))
    unit = result.source.force_unit(result.joints)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def explainable_words(result: ClosedLoop) -> str:
    """How much of the error a free-form model explains, and how much of that the effects found do."""
    known = result.explainable
    if known is None:
        return result.not_explainable
    before, free = result.before.validation.relative_error, known.validation.relative_error
    if all(form == NO_FORM for form in known.forms):
        return (
            "A free-form model of the residual, fitted to the identification recordings, predicts the validation recordings no "
            "better than the declared model: by this measure nothing in them can be explained."
        )
    reached = (
        f"the effects found reach {100 * known.share:.0f} % of that drop" if result.effects else "no effect was found"
    )
    return (
        f"A free-form model of the residual, which names nothing, takes the error on validation from {percent(before)} to "
        f"{percent(free)}: {reached}. It was fitted to the identification recordings alone."
    )


def _verdict_meaning(result: ClosedLoop) -> str:
    if result.noise_floor is None and result.explainable is None:
        return "Neither the noise nor what can be explained at all is known, so nobody can say that nothing is left."
    if result.verdict == "unexplained":
        return "Something is left that is more than noise, and no effect that was tried explains it."
    if result.after.told.validation.relative_error >= result.before.told.validation.relative_error and result.effects:
        return "The effects found help on the recordings that were fitted, but not on those that were held out: they are doubtful."
    if result.after.validation.relative_error >= result.before.validation.relative_error and result.effects:
        return "The effects found help where joints move; what friction holds before they first do is left, which nobody knows."
    if result.verdict == "partly_explained":
        return "The effects found are significant, but something else is left that has no name yet."
    left = (
        "what is left is near what a free-form model leaves; how much of it is noise is not known"
        if result.noise_floor is None
        else f"what is left is noise, or within {NEAR_FLOOR:g} times it"
    )
    return f"{'The effects found explain the error' if result.effects else 'The declared model is enough'}: {left}."


def _remains(result: ClosedLoop) -> str:
    still = standstill(result).total_share
    if still > MOSTLY and result.noise_floor is None:
        return f"{100 * still:.0f} % of what is left (squared) arises while joints stand still"
    known = result.explainable
    if result.noise_floor is None and known is not None and known.share < ENOUGH:
        return f"a free-form model reaches {percent(known.validation.relative_error)}, so more can be explained"
    strongest = next(iter(result.unexplained.where), None)
    dependence = f" {dependence_words(strongest)}" if strongest else ""
    if result.noise_floor is None:
        return f"what is left{dependence}" if strongest else "what is left depends on none of the signals looked at"
    ratios = np.array(result.after.told.identification.torque_rms) / np.maximum(result.noise_floor, 1e-300)
    if ratios.max() <= NEAR_FLOOR:
        return "what is left is noise"
    joint = result.joints[int(ratios.argmax())]
    more = f"; what is left{dependence}" if strongest else ""
    return f"the error of {joint} is still {ratios.max():.1f} times its noise{more}"


def _kind(effect: Effect) -> str:
    return effect.type_name().replace("_", " ")


def _meaning(effect: Effect) -> str:
    """First sentence of an effect type's documentation."""
    first = (type(effect).__doc__ or "").strip().split("\n\n")[0]
    return " ".join(first.replace("`", "").split())


def percent(value: float, decimals: int = 1) -> str:
    """A fraction in per cent, with more decimals for small ones."""
    return f"{100 * value:.{decimals}f} %" if value >= 0.01 or value == 0 else f"{100 * value:.{decimals + 1}g} %"


def p_value(value: float) -> str:
    """A probability; tiny ones by their power of ten."""
    if value >= 0.001:
        return f"{value:.2g}"
    return f"{value:.0e}".replace("e-0", "e-") if value > 0 else "< 1e-300"


# ---- tables ---------------------------------------------------------------------------------------------


def _error_tables(result: ClosedLoop) -> list[PageTable]:
    """Errors of each joint on the recordings of each role, N m and parts of its torque; a joint that got worse is marked."""
    torques = plots.joint_torques(result)
    over = ("after / floor",) if result.noise_floor else ()
    head = ("joint", "torque", "error before", "% of torque", "error after", "% of torque", "noise floor", *over)
    out = []
    for role, what in ROLES.items():
        before, after = getattr(result.before, role), getattr(result.after, role)
        rows, worse = [], ""
        for i, joint in enumerate(result.joints):
            torque, b, a = float(torques[role][i]), before.torque_rms[i], after.torque_rms[i]
            floor = result.noise_floor[i] if result.noise_floor else None
            mark = " ▲" if a > WORSE * b else ""
            worse = worse or (mark and " ▲: larger than before.")
            shares = [percent(e / torque) if torque > 0 else "–" for e in (b, a)]
            ratio = (number(a / floor if floor else None),) if over else ()
            known = "not known" if floor is None else number(floor)
            rows.append((joint, number(torque), number(b), shares[0], number(a) + mark, shares[1], known, *ratio))
        both = [percent(e.relative_error) for e in (before, after)]
        rows.append(("all", "", "", both[0], "", both[1], "", *("" for _ in over)))
        caption = f"{role.capitalize()}: {what}. Root mean square, {result.source.force_unit(result.joints)}.{worse}"
        out.append(PageTable(head, rows, caption))
    return out


def _above_floor(result: ClosedLoop) -> str:
    if not result.noise_floor:
        return "How much of it is noise is not known."
    rms = zip(result.joints, result.after.identification.torque_rms, result.noise_floor, strict=True)
    loud = [joint for joint, error, floor in rms if floor and error > NEAR_FLOOR * floor]
    if loud:
        return f"It is above {NEAR_FLOOR} times the noise floor, where fitted, at {', '.join(loud)}."
    return f"At every joint it is within {NEAR_FLOOR} times the noise floor, where fitted."


def _motion(result: ClosedLoop, motion: MotionErrors | str | None) -> Section | None:
    """The simulated motion before and after beside the measured one."""
    if not isinstance(motion, MotionErrors):
        return None if motion is None else Section("", motion)
    sides = {"motor": motion.motor_rms_mrad, "link": motion.link_rms_mrad}
    columns = {f"{side}, {when}": x for side, both in sides.items() if both for when, x in both._asdict().items()}
    rows = [(j, *(number(float(x[i])) for x in columns.values())) for i, j in enumerate(result.joints)]
    part = f"{motion.seconds:.3g} s"
    if motion.seconds < motion.of_s:
        part = f"the first {part} of {motion.of_s:.3g} s"
    caption = (
        f"Simulated less measured angle under the references of {motion.recording}, {part} of validation. RMS, mrad."
    )
    if motion.tip_rms_mm is not None:
        before, after = (number(x) for x in motion.tip_rms_mm)
        tip = (
            f"The tip is {before} mm before and {after} mm after from where the measured "
            "link angles put it (root mean square; bending of hinges is not measured)."
        )
    else:
        tip = (
            "No link side was measured: where the tip really was is not known. The tips of the two simulations are "
            f"{number(motion.tip_apart_rms_mm)} mm apart (root mean square)."
        )
    return Section("", tip, PageTable(("joint", *columns), rows, caption))


def _alternatives(result: ClosedLoop) -> PageTable | None:
    rows, robot = [], result.model.regression.robot
    for found in result.effects:
        for other in found.alternatives:
            more = other.size - found.trial.size
            extra = f" ({more} more parameter{'s' if more > 1 else ''})" if more > 0 else ""
            values = (f"{n} = {number(v)} {unit_text(unit)}".rstrip() for n, unit, v in robot.values_of(other.effect))
            rows.append((
                effect_words(found.effect), effect_words(other.effect) + extra, "; ".join(values), f"{100 * other.share:.1f}",
                f"{other.behind:.1f}", other.advice,
            ))  # fmt: skip
    head = (
        "found", "could also be", "with", "explains, % of found", "behind, standard errors", "what would tell them apart",
    )  # fmt: skip
    return PageTable(head, rows, "Alternatives", numbers=(3, 4)) if rows else None


def _rounds(result: ClosedLoop) -> list[Section]:
    """What was tried in each round of the search, and what came of it."""
    out = []
    for i, found in enumerate(result.effects):
        same = [a.effect.label for a in found.alternatives]
        gain = found.trial.gain
        rows = [_tried(found.trial, "100 %", "added")]
        for t in found.rivals:
            outcome = "cannot be told from the winner" if t.effect.label in same else _outcome(t, result.effects, i)
            rows.append(_tried(t, f"{100 * t.gain / gain:.0f} %" if gain > 0 else percent(t.share), outcome))
        out.append(_round(f"{i + 1}: {effect_words(found.effect)}", "gain, % of winner", rows))
    gone = result.last_round.taken_out
    if gone:
        rows = [_tried(t, percent(t.share), t.refusal) for t in gone]
        out.append(_round("Taken out again: does not carry over", "share of squared error", rows))
    trials = result.last_round.trials
    if trials:
        rows = [_tried(t, percent(t.share), _outcome(t, (), 0)) for t in trials]
        out.append(_round("Last round: nothing more was added", "share of squared error", rows))
    elif result.noise_floor is not None:
        out.append(Section("Last round", "Not needed: the error had reached the noise floor."))
    return out


def _tried(trial: TorqueTrial, share: str, outcome: str) -> tuple[str, ...]:
    effect = trial.effect
    return _kind(effect), place_words(effect), share, f"{trial.gain_t:.1f}", p_value(trial.p_value), outcome


def _round(title: str, share: str, rows: Sequence[tuple[str, ...]]) -> Section:
    head = ("effect", "where", share, "held-out gain t", "p-value", "outcome")
    return Section(title, PageTable(head, rows, numbers=(2, 3, 4)))


def _outcome(trial: TorqueTrial, effects: Sequence[FoundEffect], at: int) -> str:
    for i, later in enumerate(effects):
        if i > at and type(later.effect) is type(trial.effect) and later.effect.place == trial.effect.place:
            return f"added later, as no. {i + 1}"
    if trial.refusal:
        return trial.refusal
    return "significant, but less sure than the winner" if effects else "no better once all is fitted again"


def _at_rest(result: ClosedLoop) -> PageTable:
    still, rms = standstill(result), result.after.validation.torque_rms
    shares, errors = (still.time_share, still.error_share), (rms, still.moving_rms)
    rows = [
        (joint, *(percent(x[i]) for x in shares), *(number(x[i]) for x in errors))
        for i, joint in enumerate(result.joints)
    ]
    unit = result.source.force_unit(result.joints)
    head = ("joint", "at rest, % of time", "% of squared error", f"error, {unit}", f"error in motion, {unit}")
    caption = (
        "What is left on validation, at rest and in motion. At rest: a joint slower than 1 % of its largest speed."
    )
    return PageTable(head, rows, caption)


def _dependences(result: ClosedLoop) -> PageTable:
    rows = [(d.joint, d.signal, f"{d.score:.3f}", p_value(d.p_value)) for d in result.unexplained.where]
    caption = (
        "What is left of a joint's torque (fitted and held-out recordings) and the signals that it still depends on."
    )
    return PageTable(("error of", "depends on", "score", "p-value"), rows, caption, numbers=(2, 3))


def _bands(result: ClosedLoop) -> PageTable:
    rows = [
        (b.joint, number(b.low_hz), number(b.high_hz), percent(b.score), p_value(b.p_value))
        for b in result.unexplained.bands
    ]
    caption = (
        "Frequencies in which what is left repeats with the motion, beyond the noise that differs between periods: there the model "
        "lacks something."
    )
    return PageTable(("error of", "from, Hz", "to, Hz", "share of its power", "p-value"), rows, caption)


def _parameters(result: ClosedLoop) -> PageTable:
    """Each identified parameter of the final model, its value in the declared one, and what the robot file gives."""
    declared = {
        (effect.type_name(), effect.place, e.name): measured(e)
        for i, effect in enumerate(result.declared.effects)
        for e in result.declared.estimates(i)
    }
    given = {
        (effect.type_name(), effect.place, name): value
        for effect in result.source.effects
        for name, _, value in effect.public_values()
        if not np.isnan(value)
    }
    new = [e.effect for e in result.effects]
    rows = []
    for effect, estimates in effect_estimates(result):
        kind = _kind(effect) + (" (added)" if any(effect is e for e in new) else "")
        for some in counted(estimates):
            key = (effect.type_name(), effect.place, some[0].name)
            before = (declared.get(key, "–"), number(given.get(key))) if len(some) == 1 else ("–", "–")
            rows.append(
                (kind, place_words(effect), name_of(some), measured_all(some), unit_text(some[0].unit), *before)
            )
    head = (
        "effect", "where", "parameter", "value ± standard deviation", "unit", "identified before", "in the robot file"
    )  # fmt: skip
    return PageTable(head, rows, "Parameters of the effects", numbers=(3, 5, 6))


def _moved_links(result: ClosedLoop) -> PageTable:
    """Link parameters that what was added moved by more than `MOVED` standard deviations."""
    rows = []
    if result.effects and result.model.links_fitted:
        robot = result.model.regression.robot
        names = [(b, *named) for b, _ in robot.bodies for named in zip(LINK_PARAMETERS, LINK_UNITS, strict=True)]
        before, after = result.declared.link_estimates(), result.model.link_estimates()
        given = result.source.rigid().restricted(result.joints).link_parameters
        for (link, name, unit), g, b, a in zip(names, given, before, after, strict=True):
            moved = None if b.value is None or a.value is None or not b.std else (a.value - b.value) / b.std
            if moved is not None and abs(moved) > MOVED:
                rows.append((link, name, unit_text(unit), number(float(g)), measured(b), measured(a), f"{moved:+.1f}"))
    head = ("link", "parameter", "unit", "in the URDF", "identified before", "after", "moved, standard deviations")
    caption = f"Link parameters that moved by more than {MOVED:g} standard deviations when the effects were added."
    return PageTable(head, rows, caption, numbers=range(3, 7))


def _links(result: ClosedLoop) -> PageTable:
    texts = ["–" if e.value is None else measured(e) for e in result.model.link_estimates()]
    size = len(LINK_PARAMETERS)
    links = result.model.regression.robot.bodies
    rows = [(name, *texts[size * i : size * (i + 1)]) for i, (name, _) in enumerate(links)]
    units = (f"{name}, {unit_text(unit)}" for name, unit in zip(LINK_PARAMETERS, LINK_UNITS, strict=True))
    return PageTable(("link", *units), rows, "Parameters of the links")


def _facts(result: ClosedLoop) -> list[tuple[str, str]]:
    """How it was done: name and value of every setting."""
    campaign, regression = result.campaign, result.model.regression
    rates = sorted({s.rate_hz for s in regression.segments})
    blocks = regression.blocks()
    seconds = sum(len(s) / s.rate_hz for s in regression.segments)
    if result.noise_floor is None:
        floor = f"not known: {why_noise_is_unknown(result)}"
    elif any(r.period_s is not None for r in campaign.identification):
        floor = "from what differs between the periods of the identification recordings"
    else:
        floor = "from the sensor noise that the campaign file states, after the low-pass"
    low_pass = "none" if campaign.cutoff_hz is None else f"{campaign.cutoff_hz:g} Hz, zero phase, on every signal"
    asked = f"p < {SIGNIFICANCE:g}, corrected for {result.last_round.tests} independent trials a round"
    declared = "; ".join(effect_words(e) for e in result.source.effects)
    links = "identified, over base parameters" if result.model.links_fitted else "known: kept from the URDF"
    if result.model.links_near:
        deviation = KNOWN / np.sqrt(result.model.links_near)
        links += (
            f"; near the URDF's values, masses to {deviation:.1%} where the recordings say little: "
            "blocks that are left out are predicted better so"
        )
    return [
        ("Campaign", campaign.path.name),
        ("Robot", result.robot),
        *((f"Recording {r.name}", f"{r.role}, {r.samples} samples, {r.duration_s:.3g} s") for r in campaign.recordings),
        ("Sample rate of the recordings", f"{campaign.sample_rate_hz:g} Hz"),
        ("Low-pass", low_pass),
        ("Sample rate of the fit", f"{joined([f'{r:g}' for r in rates])} Hz, {len(regression)} samples a joint"),
        ("Declared effects", declared or "none: the rigid tree alone"),
        ("Inertial parameters of the links", links),
        ("Held-out blocks", f"{len(blocks)} of about {seconds / len(blocks):.2g} s of the identification recordings"),
        ("Tried in the last round", f"{result.last_round.candidates} effects (types and places)"),
        ("Significance", asked),
        (
            "Also asked of an effect",
            f"held-out gain above {GAIN_T:g} standard errors and above {100 * SMALLEST_GAIN:g} % of the "
            f"squared error of its joints; {100 * SMALLEST_PART:g} % off the error of one of them (of a delay: a part of a "
            "sample); values that its physics allows",
        ),
        ("Noise floor", floor),
        ("Seed", f"{result.seed} (of the permutation test for what remains)"),
        ("Software", f"rx90b_flex {__version__}"),
    ]


# ---- figures --------------------------------------------------------------------------------------------


def _captioned(figure: Figure, caption: str, zoom: bool = False) -> Image:
    return image(figure, caption, caption, zoom)


def _explainable_figure(result: ClosedLoop) -> Image | None:
    if result.explainable is None:
        return None
    text = "Error of the declared model, after, and of a free-form model on validation"
    return _captioned(plots.explainable_by_joint(result), text)


def _steps_figure(result: ClosedLoop) -> Image | None:
    if len(result.effects) < 2:
        return None
    return image(plots.error_by_step(result), "Validation error after each added effect")


def _finding_figures(result: ClosedLoop) -> list[Image | None]:
    """Beside each finding the joint of its place whose error fell most; a joint once."""
    fell = np.square(result.before.validation.torque_rms) - np.square(result.after.validation.torque_rms)
    shown: set[str] = set()
    out: list[Image | None] = []
    for found in result.effects:
        own = [joint for joint in found.effect.joints if joint in result.joints]
        joint = max(own or result.joints, key=lambda name: fell[result.joints.index(name)])
        if joint in shown or len(shown) == SHOWN_FINDINGS:
            out.append(None)
            continue
        shown.add(joint)
        figure, over = plots.change_at_joint(result, joint)
        text = f"{joint} before and after, over {over if over == 'time' else f'its {over}'}"
        out.append(image(figure, f"Error of {text}", text, zoom=True))
    return out


def _joint_residuals(result: ClosedLoop, joint: str) -> Section:
    kinds = (
        (plots.residual_in_time, "In time: measured torque (grey) and final model (blue); error before; error after"),
        (plots.residual_in_frequency, "In frequency: amplitude spectrum of measured torque and error"),
        (plots.residual_against_position, "Against the joint's position: mean and ± 1 standard deviation"),
        (plots.residual_against_velocity, "Against the joint's velocity: mean and ± 1 standard deviation"),
    )
    return Section(
        joint, *(image(draw(result, joint), f"Error of {joint}. {text}", text, zoom=True) for draw, text in kinds)
    )


def _dependence_figures(result: ClosedLoop) -> list[Image]:
    out = []
    for d in result.unexplained.where[:SHOWN_DEPENDENCES]:
        figure = plots.remaining_dependence(result, d)
        if figure is not None:
            over = "over time" if d.signal == evidence.STANDSTILL else f"against {d.signal}, in motion"
            over = f"over one of the {d.signal.rpartition(' ')[2]} cycles of a turn, in motion" if d.order else over
            text = f"Error left of {d.joint} {over} ({percent(d.score)} of its power)"
            out.append(_captioned(figure, text, zoom=True))
    return out


def _band_figures(result: ClosedLoop) -> list[Image]:
    text = "Spectrum of the error left of {}; shaded: where it repeats with the motion"
    joints = dict.fromkeys(b.joint for b in result.unexplained.bands[:SHOWN_DEPENDENCES])
    return [_captioned(plots.remaining_bands(result, joint), text.format(joint), zoom=True) for joint in joints]
