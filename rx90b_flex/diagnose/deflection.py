"""What second encoders show of the gears: which give way, how much, and what beyond a straight line."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from rx90b_flex.diagnose.residual import ReplayedTorques
from rx90b_flex.diagnose.spring_look import spring_words
from rx90b_flex.diagnose.trial import GAIN_T, SIGNIFICANCE, SMALLEST_GAIN, TorqueTrial
from rx90b_flex.effects import Effect
from rx90b_flex.effects.flexibility import DAMPING_TIME, DriveFlexibility
from rx90b_flex.effects.motion import Array
from rx90b_flex.files.results import finite
from rx90b_flex.identify import deflection as gears
from rx90b_flex.identify.least_squares import Estimate, Identification
from rx90b_flex.identify.segment import prepare
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording, noise_cutoff_hz

SAME_RATIO = 0.02  # by which an encoder behind the gear may turn more or less than the motor's, joint side
KNOWN = 2.0  # standard deviations from zero at which a compliance is worth a stiffness
SURE = 3.0  # and at which a damping is
SLOW_RATE = 1 / 8  # of the sample rate: the low-pass where a campaign asks for none and positions show no noise


@dataclass(frozen=True)
class GearComparison:
    """Something beyond a straight line that was tried on a gear's deflection.

    Attributes
    ----------
    name : what it is.
    value, std, unit : its coefficient in terms of the gear.
    p_value : that nothing is there, corrected for what was tried on all gears.
    gain_share : of the squared error left on held-out blocks, its gain.
    shown : whether it is significant, lawful and gains on held-out blocks.
    """

    name: str
    value: float
    std: float
    unit: str
    p_value: float
    gain_share: float
    shown: bool


@dataclass(frozen=True)
class RecordedCompliance:
    """Compliance of a gear in one recording by itself, rad/(N m)."""

    recording: str
    role: str
    value: float
    std: float


@dataclass(frozen=True)
class GearErrors:
    """Root mean square of a gear's deflection, rad: as measured, before (all but the load) and after, in one role."""

    measured: float
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class GearDeflection:
    """What the second encoder of one joint shows.

    Attributes
    ----------
    joint : str
    message : str
        In a sentence.
    fit : GearFit or None
        On all recordings; None where there is nothing to fit.
    errors : mapping of role to GearErrors
        Of the validation recordings the load's part is predicted from the others.
    compliances : tuple of RecordedCompliance
        Each recording by itself.
    agreement : float
        Probability that recordings differ in compliance as much as these or more.
    trial : TorqueTrial or None
        The load's part, held-out blocks of all recordings.
    comparisons : tuple of GearComparison
    effect : Effect or None
        The flexibility that is missing from the declared robot.
    parameters : tuple of Estimate
        Of the flexibility, missing or declared.
    """

    joint: str
    message: str
    fit: gears.GearFit | None = None
    errors: dict[str, GearErrors] | None = None
    compliances: tuple[RecordedCompliance, ...] = ()
    agreement: float = np.nan
    trial: TorqueTrial | None = None
    comparisons: tuple[GearComparison, ...] = ()
    effect: Effect | None = None
    parameters: tuple[Estimate, ...] = ()


def gear_deflections(source: Robot, campaign: Campaign, model: Identification) -> tuple[GearDeflection, ...]:
    """Look at every joint's second encoder.

    Parameters
    ----------
    source : Robot
        As declared; a `drive_flexibility` that it has is not found once more.
    campaign : Campaign
    model : Identification
        Of the torques: what its links ask for is the torque that passes the gears.

    Returns
    -------
    tuple of GearDeflection
        One a joint; empty where no recording has second encoders.
    """
    recordings = [r for r in campaign.recordings if r.link_position is not None]
    if not recordings:
        return ()
    cutoff = campaign.cutoff_hz or _cutoff(recordings)
    torques = [_torques(model, r, campaign.cutoff_hz) for r in recordings]
    ratios = {joint: gears.encoder_ratio(recordings, joint) for joint in campaign.joints}
    own = [j for j, (ratio, widest) in ratios.items() if widest > 0.0 and abs(ratio - 1.0) <= SAME_RATIO]

    def of(place: int, joint: str) -> GearDeflection:
        if joint not in own:
            return GearDeflection(joint, _no_second(joint, *ratios[joint]))
        turning = _turns(source, joint)
        data = gears.gear_data(recordings, joint, cutoff, [t[:, place] for t in torques], turning)
        if data is None or not any(r.role == "identification" for r in data.runs):
            return GearDeflection(joint, f"{joint} moves too little for its second encoder to show its gear.")
        judged = _judged(data, len(own), source.effects, model.in_tree)
        spring = spring_words(model, joint) if turning else ""
        return dataclasses.replace(judged, message=f"{judged.message} {spring}".strip())

    return tuple(of(*numbered) for numbered in enumerate(campaign.joints))


def _cutoff(recordings: Sequence[Recording]) -> float:
    """Low-pass where the campaign asks for none."""
    rate = recordings[0].sample_rate_hz
    found = noise_cutoff_hz(recordings[0].position, rate) if recordings[0].samples >= 256 else None
    return min(found or rate * SLOW_RATE, rate * SLOW_RATE)


def _torques(model: Identification, recording: Recording, cutoff_hz: float | None) -> Array:
    """Torque that the model asks of the drives without friction, and whole, (N, joints, 2), N m."""
    robot = model.regression.robot
    replay = ReplayedTorques(robot, prepare(robot, recording, cutoff_hz, thin=False))
    smooth = [e for e in model.effects if not e.traits.is_friction and e.traits.in_dynamics]
    return np.stack([replay.predict(x, model.link_parameters) for x in (smooth, model.effects)], axis=2)


def _turns(source: Robot, joint: str) -> bool:
    try:
        source.rigid().motion(*np.zeros((3, 1, source.rigid().model.nv))).on_tree.joint_axis(joint)
    except ValueError:
        return False
    return True


def _no_second(joint: str, ratio: float, widest: float) -> str:
    if not widest > 0.0:
        return f"The second encoder of {joint} repeats the motor's: it shows nothing of the gear."
    return (
        f"The second encoder of {joint} turns {ratio:.4g} times as far as the motor, joint side; it is not used "
        "(its sign, unit or gear is another)."
    )


# ---- one gear -------------------------------------------------------------------------------------------------------


def _judged(
    data: gears.GearData, tests: int, declared: Sequence[Effect], identified: Sequence[Effect]
) -> GearDeflection:
    fitted = data.only("identification")
    fit = gears.fit_gear(data).lawful()
    learned = gears.fit_gear(fitted).lawful()
    trial = _trial(data, fit, tests)
    each = tuple(
        RecordedCompliance(f.data.runs[0].name, f.data.runs[0].role, f.compliance, f.std("torque"))
        for f in gears.each_recording(data)
    )
    errors = {role: _errors(data.only(role), learned) for role in dict.fromkeys(r.role for r in data.runs)}
    carried = all(e.after < e.before for e in errors.values())
    sure = fit.compliance > KNOWN * fit.std("torque") and fit.strength > gears.WEAKEST
    shown = trial.accepted and carried and sure
    comparisons = _comparisons(fit, tests) if shown else ()
    parameters = _parameters(fit) if shown else ()
    known, told = (
        next((e for e in effects if "torsion" in e.traits.virtual and e.joints == (data.joint,)), None)
        for effects in (declared, identified)
    )
    effect = None
    if shown and told is None and (known is None or _without_values(known)):
        stiffness, damping = (float(p.value or 0.0) for p in parameters)
        effect = DriveFlexibility(joint=data.joint, stiffness=stiffness, damping=damping)
    agree = gears.agreement([(c.value, c.std) for c in each]) if len(each) > 1 else np.nan
    words = _words(fit, shown, _beside(known, told), comparisons)
    return GearDeflection(data.joint, words, fit, errors, each, agree, trial, comparisons, effect, parameters)


def _trial(data: gears.GearData, fit: gears.GearFit, tests: int) -> TorqueTrial:
    """The load's part against lag, direction and position errors alone, as a trial of the flexibility."""
    names = (*gears.LOAD, *gears.BASE)
    less, more = data.stacked(gears.BASE), data.stacked(names)
    gains, before = gears.held_out_gains(data, less, more)
    # how well the torque's own scale is known does not matter to whether anything follows it
    load, plain = [names.index(n) for n in gears.LOAD], gears.fit_columns(data, names, more)
    theta, covariance = plain.theta[load], plain.covariance[np.ix_(load, load)]
    p_value = float(stats.chi2.sf(theta @ np.linalg.pinv(covariance) @ theta, len(load)))
    variance = max(fit.rms**2, 1e-300)
    return TorqueTrial(
        DriveFlexibility(joint=data.joint),
        float(gains.sum() / variance),
        gains / variance,
        min(1.0, p_value * tests),
        len(load),
        float(gains.sum() / max(float(before.sum()), 1e-300)),
        fit.compliance > 0.0,
        data.rows / max(1.0, 2.0 * data.runs[0].cutoff_hz * data.rows / data.runs[0].rate_hz),
    )


def _errors(data: gears.GearData, learned: gears.GearFit) -> GearErrors:
    """Errors on the recordings of one role, the load's part as `learned` has it, lag and direction fitted anew."""
    beside = data.stacked(gears.BASE)
    load = data.stacked(gears.LOAD) @ np.array([learned.value(n) for n in gears.LOAD])

    def left(target: Array) -> float:
        rest = target - beside @ np.linalg.lstsq(beside, target, rcond=1e-10)[0]
        return float(np.sqrt((rest[: data.rows] ** 2).mean()))

    late = [r.deflection[r.used] - data.lag_s * r.velocity[r.used] for r in data.runs]
    raw = np.concatenate([x - x.mean() for x in late])  # with the lag that was taken out
    return GearErrors(float(np.sqrt((raw**2).mean())), left(data.target), left(data.target - load))


def _parameters(fit: gears.GearFit) -> tuple[Estimate, ...]:
    """Stiffness and damping; one that does not stand out is the usual one, of which that it may be none is the uncertainty."""
    c = fit.compliance
    rate = gears.with_more(fit, "rate", gears.rate_of_torque)
    damping, spread = rate.value("rate") / c**2, rate.std("rate") / c**2
    if damping <= SURE * spread:
        damping = DAMPING_TIME / c
        spread = float(np.hypot(spread, damping))
    return (
        Estimate("stiffness", 1.0 / c, fit.std("torque") / c**2, "N m/rad"),
        Estimate("damping", damping, spread, "N m s/rad"),
    )


@dataclass(frozen=True)
class _More:
    """A column that may be missing from the straight line, and what its coefficient means."""

    name: str
    unit: str
    column: gears.More
    factor: float  # of the coefficient, in powers of the compliance
    power: int
    positive: bool  # whether its value must be


_MORE = (
    *(
        _More(f"hysteresis within {part:g} of the torque", "rad/(N m)", gears.hysteresis(part), -1.0, 0, True)
        for part in (0.05, 0.15, 0.4)
    ),
    _More("lost motion between the flanks", "rad", gears.lost_motion, -2.0, 0, True),
    _More("cubic hardening", "N m/rad^3", gears.hardening, 1.0, -4, True),
    _More("friction behind the gear that grows with its load", "-", gears.loaded_friction, 1.0, -1, True),
)


def _comparisons(fit: gears.GearFit, tests: int) -> tuple[GearComparison, ...]:
    """Everything of `_MORE` against the straight line, on all recordings; best first."""
    straight = fit.data.stacked(fit.names)
    out = []
    for more in _MORE:
        again = gears.with_more(fit, more.name, more.column)
        scale = more.factor * fit.compliance**more.power
        value, std = scale * again.value(more.name), abs(scale) * again.std(more.name)
        column = fit.data.apart([more.column(r, fit) for r in fit.data.runs])
        gains, before = gears.held_out_gains(fit.data, straight, np.column_stack([straight, column]))
        p_value = min(1.0, 2.0 * float(stats.norm.sf(abs(value) / max(std, 1e-300))) * len(_MORE) * tests)
        share = float(gains.sum() / max(float(before.sum()), 1e-300))
        t = gains.mean() / max(float(gains.std(ddof=1)) / np.sqrt(len(gains)), 1e-300)
        shown = p_value < SIGNIFICANCE and share > SMALLEST_GAIN and t > GAIN_T and (value > 0.0 or not more.positive)
        out.append(GearComparison(more.name, value, std, more.unit, p_value, share, bool(shown)))
    return tuple(sorted(out, key=lambda x: -x.gain_share))


def _without_values(effect: Effect) -> bool:
    return bool(np.isnan(effect.coefficients).all())


def _beside(declared: Effect | None, identified: Effect | None) -> str:
    """What the robot file and the torques by themselves say of a flexibility that a second encoder shows."""
    if declared is not None and not _without_values(declared):
        return " The robot file declares this flexibility."
    if identified is not None:
        return f" The torques by themselves say {identified.coefficients[0]:.3g} N m/rad, which the robot takes."
    return " The robot file declares this flexibility without a stiffness." if declared else ""


def _words(fit: gears.GearFit, shown: bool, beside: str, comparisons: Sequence[GearComparison]) -> str:
    joint, lag = fit.data.joint, 1e3 * fit.data.lag_s
    late = f"Its second encoder is read {abs(lag):.2f} ms {'later' if lag > 0.0 else 'earlier'} than the motor's"
    if not shown:
        most = fit.compliance + 1.96 * fit.std("torque")
        limit = f": it turns by no more than {1e6 * most:.2g} µrad per N m" if most > 0.0 and np.isfinite(most) else ""
        return (
            f"The gear of {joint} shows no deflection by its load that stands out in these recordings{limit}. {late}."
        )
    c, std = fit.compliance, fit.std("torque")
    more = [x.name for x in comparisons if x.shown]
    beyond = f" Beyond a straight line: {', '.join(more)}." if more else " Nothing beyond a straight line stands out."
    return (
        f"The gear of {joint} turns by {1e6 * c:.3g} ± {1e6 * std:.2g} µrad per N m ({1.0 / c:.3g} N m/rad).{beside} "
        f"{late}, viscous friction behind the gear included.{beyond}"
    )


# ---- what becomes of it ---------------------------------------------------------------------------------------------


def with_gears(robot: Robot, found: Sequence[GearDeflection]) -> Robot:
    """A robot with the flexibilities that second encoders showed; values that its own lack are filled in."""
    effects = list(robot.effects)
    for gear in found:
        own = [i for i, e in enumerate(effects) if "torsion" in e.traits.virtual and e.joints == (gear.joint,)]
        if gear.effect is not None:
            at = own[0] if own else len(effects)
            effects[at : at + 1] = [gear.effect]
        elif gear.parameters:
            measured = np.array([p.value for p in gear.parameters], dtype=float)
            for i in own:
                declared = effects[i].coefficients
                if not _without_values(effects[i]):
                    effects[i] = effects[i].with_coefficients(np.where(np.isnan(declared), measured, declared))
    return robot.with_effects(effects)


def not_in_torques(found: GearDeflection) -> GearDeflection:
    """The same where the torques say nothing of a flexibility that only makes them worse: told, but not in the robot."""
    if found.effect is None:
        return found
    words = (
        "It is not in the robot file, for on the validation recordings the torques fit worse with it than as declared."
    )
    return dataclasses.replace(found, effect=None, message=f"{found.message} {words}")


def deflection_json(found: Sequence[GearDeflection]) -> list[dict[str, Any]]:
    """The content of ``deflection`` in ``closed_loop.json``, one entry a joint."""
    return [{"joint": gear.joint, "message": gear.message, **_measures(gear)} for gear in found]


def _measures(gear: GearDeflection) -> dict[str, Any]:
    fit = gear.fit
    if fit is None or gear.errors is None or gear.trial is None:
        return {}
    return {
        "rms": {role: dataclasses.asdict(e) for role, e in gear.errors.items()},
        "compliance": {"value": fit.compliance, "std": fit.std("torque"), "unit": "rad/(N m)"},
        "parameters": estimates_json(gear.parameters),
        "drive_inertia": finite(fit.inertia),
        "lag_s": fit.data.lag_s,
        "position_error_orders": list(fit.data.orders),
        "p_value": gear.trial.p_value,
        "recordings": [
            {
                "recording": c.recording,
                "role": c.role,
                "compliance": {"value": c.value, "std": c.std},
                "stiffness": _stiffness(c),
            }
            for c in gear.compliances
        ],
        "recordings_agree_p": finite(gear.agreement),
        "comparisons": [dataclasses.asdict(c) for c in gear.comparisons],
    }


def estimates_json(estimates: Sequence[Estimate]) -> dict[str, Any]:
    """Parameters as ``closed_loop.json`` has them, by name."""
    return {e.name: {"value": e.value, "std": e.std, "unit": e.unit} for e in estimates}


def _stiffness(compliance: RecordedCompliance) -> dict[str, float | None]:
    """The ends of a 95 % interval of the stiffness; none above where a rigid gear is not excluded."""
    low, high = (compliance.value + x * 1.96 * compliance.std for x in (-1.0, 1.0))
    return {
        "value": 1.0 / compliance.value if low > 0.0 else None,
        "low": 1.0 / high if high > 0.0 else None,
        "high": 1.0 / low if low > 0.0 else None,
    }
