"""What to measure next: facts of a closed loop that a new recording would change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.close import ClosedLoop
from rx90b_flex.diagnose.evidence import STANDSTILL, Dependence, signals
from rx90b_flex.diagnose.moving import resting
from rx90b_flex.diagnose.verdict import NEAR_FLOOR
from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import Estimate
from rx90b_flex.view.estimates import counted, name_of
from rx90b_flex.view.plots import rms

HARDLY_MOVES_RAD = 0.05
FEW_REVERSALS = 4
OUTSIDE_SHARE = 0.05  # of validation samples beyond the range that was fitted
FASTER = 1.1  # speed in validation over speed in identification
CARRIES_OVER = 1.5  # error on validation over error on identification
MOSTLY = 0.5
UNCERTAIN = 0.3  # standard deviation over value


@dataclass(frozen=True)
class Advice:
    """One thing to measure: why (a fact of this data), and what to do."""

    why: str
    what: str


def next_measurements(result: ClosedLoop) -> tuple[Advice, ...]:
    """Advice that follows from the result; empty where nothing asks for more data."""
    rules = (_noise, _rests, _motion, _carries_over, _coverage, _remaining, _alternatives, _undetermined, _uncertain)
    return tuple(advice for rule in rules for advice in rule(result))


@dataclass(frozen=True)
class Standstill:
    """How much of what is left on the validation data arises while joints stand still.

    Attributes
    ----------
    time_share : tuple of float
        Part of the samples at which each joint stands still.
    error_share : tuple of float
        Part of each joint's squared error in them.
    moving_rms : tuple of float
        Root mean square error of each joint while it moves, N m; zero where it never does.
    total_share : float
        Part of the squared error of all joints.
    """

    time_share: tuple[float, ...]
    error_share: tuple[float, ...]
    moving_rms: tuple[float, ...]
    total_share: float


def standstill(result: ClosedLoop) -> Standstill:
    """Split the validation error after into rest and motion: friction at rest follows no law of motion."""
    error = np.concatenate([p.torque - p.after for p in result.predictions]) ** 2
    rest = resting(np.concatenate([p.velocity for p in result.predictions]))
    at_rest, whole = (error * rest).sum(axis=0), error.sum(axis=0)
    moving = (whole - at_rest) / np.maximum((~rest).sum(axis=0), 1)
    return Standstill(
        tuple(rest.mean(axis=0).tolist()),
        tuple((at_rest / np.maximum(whole, 1e-300)).tolist()),
        tuple(np.sqrt(np.maximum(moving, 0.0)).tolist()),
        float(at_rest.sum() / max(whole.sum(), 1e-300)),
    )


def dependence_words(dependence: Dependence) -> str:
    """What is left of a joint and on what it depends, as a sentence goes on after "what is left"."""
    if dependence.signal == STANDSTILL:
        return f"of {dependence.joint} is larger while the robot stands still"
    joint, _, order = dependence.signal.partition(" order ")
    if order:
        return f"of {dependence.joint} still repeats {order} times a turn of {joint}"
    return f"of {dependence.joint} still depends on {dependence.signal}"


def effect_words(effect: Effect) -> str:
    """An effect by type and place, as in ``coulomb friction on joint_2``."""
    return f"{effect.type_name().replace('_', ' ')} on {place_words(effect)}"


def place_words(effect: Effect) -> str:
    """Where an effect sits: its joints, its frame, or the robot."""
    return joined(effect.joints or effect.place or ("the robot",))


def joined(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else list(names))


def why_noise_is_unknown(result: ClosedLoop) -> str:
    """Why nobody knows how much of the error is noise, in words."""
    periods = found_periods_s(result)
    if not periods:
        return "no recording repeats and no noise is stated"
    return f"the campaign states neither noise nor a period, though motions repeat after {joined([f'{p:g} s' for p in periods])}"


def found_periods_s(result: ClosedLoop) -> list[float]:
    """Periods after which motions of the identification recordings repeat, s, shortest first."""
    facts = (r for r in result.checked.recordings if r.role == "identification" and r.period_s is not None)
    return sorted({float(f"{r.period_s:.4g}") for r in facts})


def _noise(result: ClosedLoop) -> Iterator[Advice]:
    if result.noise_floor is None:
        way = (
            "Give period_s"
            if found_periods_s(result)
            else "Record at least two whole periods of a repeating motion and give period_s"
        )
        yield Advice(
            f"How much of the error is noise is not known: {why_noise_is_unknown(result)}.",
            f"{way} in the campaign file: what differs between periods is noise, what repeats is the model's.",
        )


def _rests(result: ClosedLoop) -> Iterator[Advice]:
    rest = standstill(result)
    if rest.total_share > MOSTLY or any(d.signal == STANDSTILL for d in result.unexplained.where):
        yield Advice(
            f"{100 * rest.total_share:.0f} % of the squared error that is left on validation arises while the joint "
            "concerned stands still.",
            "At rest, friction takes whatever value holds the joint, so no law of motion tells the torque. Leave rests "
            "out of the recordings (start_s and end_s in the campaign file), or keep the joints moving slowly instead.",
        )


def _motion(result: ClosedLoop) -> Iterator[Advice]:
    fitted = dict(signals(result.model.regression))
    still, few = [], []
    for joint in result.joints:
        if float(np.ptp(fitted[f"{joint} position"])) < HARDLY_MOVES_RAD:
            still.append(joint)
        elif _reversals(fitted[f"{joint} velocity"], result.model.regression.spans) < FEW_REVERSALS:
            few.append(joint)
    if still:
        yield Advice(
            f"{joined(still)} hardly {_s(still, 'move')} in the identification recordings.",
            "Move every joint through most of its range: the friction and inertia of a joint at rest cannot be seen.",
        )
    if few:
        yield Advice(
            f"{joined(few)} {_s(few, 'turn')} back fewer than {FEW_REVERSALS} times in the identification recordings.",
            "Let each joint go back and forth many times, at several speeds: friction shows where motion reverses, and "
            "without reversals it looks like a constant torque.",
        )


def _carries_over(result: ClosedLoop) -> Iterator[Advice]:
    fitted = np.array(result.after.identification.torque_rms)
    # rests are told apart by a rule of their own
    held_out = np.minimum(result.after.validation.torque_rms, standstill(result).moving_rms)
    torque_fitted = rms(
        [result.model.regression.torque[:, : len(result.joints)]]
    )  # beyond them: sensors behind the gears
    torque_held_out = rms([p.torque for p in result.predictions])
    # a joint that works harder errs more, and one that works less errs more for its torque: only both together tell
    worse = (held_out > CARRIES_OVER * fitted) & (held_out * torque_fitted > CARRIES_OVER * fitted * torque_held_out)
    if result.noise_floor is not None:
        worse &= held_out > NEAR_FLOOR * np.array(result.noise_floor)
    if worse.any():
        units = result.source.units_of(result.joints)
        numbers = [
            f"{result.joints[i]} ({fitted[i]:.3g} {units[i].force} where fitted, {held_out[i]:.3g} {units[i].force} moving where not)"
            for i in np.flatnonzero(worse)
        ]
        yield Advice(
            f"The error is much larger on new data than on the data of the fit at {joined(numbers)}.",
            "Record longer and more varied identification runs, and the same motion once cold and once warm: either "
            "the fit took chance for physics, or something changed between the recordings.",
        )


def _coverage(result: ClosedLoop) -> Iterator[Advice]:
    fitted = dict(signals(result.model.regression))
    outside, faster = [], []
    for column, joint in enumerate(result.joints):
        position = fitted[f"{joint} position"]
        seen = np.concatenate([p.recording.position[:, column] for p in result.predictions])
        share = float(((seen < position.min()) | (seen > position.max())).mean())
        if share > OUTSIDE_SHARE:
            outside.append(f"{joint} ({100 * share:.0f} % of the time)")
        speed = float(np.abs(fitted[f"{joint} velocity"]).max())
        top = max(float(np.abs(p.velocity[:, column]).max()) for p in result.predictions)
        if top > FASTER * speed:
            (unit,) = result.source.units_of([joint])
            faster.append(f"{joint} ({top:.2g} instead of {speed:.2g} {unit.speed})")
    if outside or faster:
        parts = [f"goes where the fit never was at {joined(outside)}"] if outside else []
        parts += [f"is faster than the fit ever saw at {joined(faster)}"] if faster else []
        yield Advice(
            f"The validation motion {joined(parts)}.",
            "Let the identification recordings cover all positions and speeds that the model will be used for.",
        )


def _remaining(result: ClosedLoop) -> Iterator[Advice]:
    seen: set[str] = set()
    for dependence in result.unexplained.where:
        if dependence.joint in seen or dependence.signal == STANDSTILL:
            continue  # the strongest of a joint says what to do, the others follow from it; rests have their own rule
        seen.add(dependence.joint)
        yield Advice(
            f"What is left {dependence_words(dependence)} ({100 * dependence.score:.0f} % of its power).",
            _experiment(dependence),
        )


def _experiment(dependence: Dependence) -> str:
    joint, _, kind = dependence.signal.rpartition(" ")
    if joint.endswith(" order"):
        joint = joint.removesuffix(" order")
        return (
            f"Turn {joint} slowly at two constant speeds over its range, both ways: what comes {kind} times a turn at both "
            "sits on its gears, its motor or its resolver; count teeth, poles and ratios for that number."
        )
    if dependence.signal == "time":
        return "Repeat one motion over and over from a cold start to a warm robot: drift then stands apart."
    alone = f"with {dependence.joint} at rest" if joint != dependence.joint else "with the other joints at rest"
    if kind == "position":
        return f"Turn {joint} slowly at one speed through its range, both ways, {alone}: only position changes then."
    if kind == "velocity":
        return (
            f"Run {joint} back and forth at eight or more constant speeds, from very slow to its fastest, {alone}: the "
            "torque at constant speed is friction and gravity alone."
        )
    if kind == "acceleration":
        return (
            f"Move {joint} with equal speeds but different accelerations, {alone}: inertia then stands apart from "
            "friction."
        )
    return f"Vary {dependence.signal} while all else repeats."


def _alternatives(result: ClosedLoop) -> Iterator[Advice]:
    for found in result.effects:
        for other in found.alternatives:
            yield Advice(
                f"This data cannot tell {effect_words(found.effect)} from {effect_words(other.effect)}.", other.advice
            )


def _undetermined(result: ClosedLoop) -> Iterator[Advice]:
    names = [
        f"{e.label}.{name_of(some)}"
        for e, estimates in effect_estimates(result)
        for some in counted(estimates)
        if some[0].value is None
    ]
    if names:
        links = " What only shows together with the links stays undetermined unless these are known."
        yield Advice(
            f"This data does not determine {joined(names)}.",
            "Move the joints concerned in other ways (more of their range, other speeds, one joint at a time)."
            + (links if result.model.links_fitted else ""),
        )


def _uncertain(result: ClosedLoop) -> Iterator[Advice]:
    names = [
        f"{found.effect.label}.{p.name}"
        for found in result.effects
        for some in counted(found.parameters)
        for p in some
        if len(some) == 1
        and p.unit != "rad"
        and p.value is not None
        and p.std is not None
        and p.std > UNCERTAIN * abs(p.value)
    ]
    if names:
        yield Advice(
            f"Known to no better than {100 * UNCERTAIN:.0f} %: {joined(names)}.",
            "Faster or wider motion of the joints concerned does most; more of the same halves a standard deviation "
            "for four times the length.",
        )


def effect_estimates(result: ClosedLoop) -> list[tuple[Effect, tuple[Estimate, ...]]]:
    """Effects of the final model with their estimates."""
    return [(effect, result.model.estimates(i)) for i, effect in enumerate(result.model.effects)]


def _reversals(velocity: Array, spans: Sequence[slice]) -> int:
    """Changes of direction, not counting those within noise about zero."""
    moving = np.abs(velocity) > 0.05 * float(np.abs(velocity).max())
    directions = (np.sign(velocity[span][moving[span]]) for span in spans)
    return sum(int((np.diff(direction) != 0).sum()) for direction in directions)


def _s(names: Sequence[str], verb: str) -> str:
    return verb if len(names) > 1 else f"{verb}s"
