"""What is wrong in one recording alone, which the others tell."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from rx90b_flex.diagnose.faults.columns_in_one import name_of
from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.rigid_fit import IMPOSSIBLE
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.diagnose.faults.warm import of_friction, rubs
from rx90b_flex.effects.motion import Array, Mask

OTHER = 1.1  # times what the other recordings ask for, from which a torque is looked at
ALIKE = 1.6  # times that all torques of a recording differ: then they have another unit together
WITHIN = 1.6  # times a first guess of a factor
AGAINST = 0.3  # correlation of velocity and torque: so much in all recordings, and so much against it in one


def reversed_in_one(look: Look) -> Iterator[Hypothesis]:
    """A joint's torque or position with the other sign in one recording."""
    places = list(_places(look))
    driven = _driven_in_one(look) if places else None
    for r, k, ratio in places:
        evident = IMPOSSIBLE if driven is not None and driven[r, k] else 0.0
        if ratio < 0 or evident:
            yield _reversed(look, "torque_scale", r, k, evident)
        yield _reversed(look, "scale", r, k, evident)


def scaled_in_one(look: Look) -> Iterator[Hypothesis]:
    """A joint's torque in another unit in one recording, but where its friction alone may be another, as it is when warm."""
    places = list(_places(look))
    for r in range(len(look.sample.tracks)):
        own = [ratio for at, _, ratio in places if at == r]
        if (
            len(own) > 1
            and min(own) > 0.0
            and max(own) < ALIKE * min(own)
            and abs(np.log(np.median(own))) > np.log(ALIKE)
        ):
            yield _scaled(look, r, range(len(own)), float(np.median(own)))
    friction = of_friction(look) if places else None
    for r, k, ratio in places:
        if friction is not None and friction.explains(r, k):
            continue
        if ratio > OTHER or 0 < ratio < 1 / OTHER:
            yield _scaled(look, r, [k], ratio)


def other_loads(look: Look) -> Iterator[Hypothesis]:
    """Another load on the flange in one recording."""
    if len(look.sample.tracks) < 2 or any(log.other_load for log in look.reading.logs):
        return
    for r in np.flatnonzero(~of_friction(look).warm).tolist():
        text = (
            f"{name_of(look, r)} was made with another load than the other recordings: state what each had on the flange, with "
            "`payload` in its [[recording]]."
        )
        reading = look.reading.changed_in(r, {"other_load": True})
        yield dataclasses.replace(Hypothesis.of("kinematics", None, (), text, reading), usable=True)


def _driven_in_one(look: Look) -> Mask:
    """Where the torque, and what of it the links do not ask for, drives a joint, while both brake it in every other recording;
    (recordings, joints).
    """
    sample, reading = look.sample, look.reading
    resisting = look.measured() - look.predicted() + rubs(look, look.fit().theta.mean(axis=0, keepdims=True))
    velocity = sample.seen(reading)[1] * sample.left_seen(reading)
    along = np.array([_along(sample.spans, velocity, x) for x in (resisting, look.measured())])
    drives, brakes = along.max(axis=(0, 1)), along.min(axis=(0, 1))
    others = np.array([np.delete(brakes, r, axis=0).min(axis=0) for r in range(len(brakes))])
    return np.asarray((drives < -AGAINST) & (others > AGAINST))


def _along(spans: Sequence[slice], velocity: Array, torque: Array) -> Array:
    """Correlation of each recording's and joint's torque, less its mean, with its velocity, one way and the other,
    (2, recordings, joints).
    """
    out = []
    for span in spans:
        v, swing = velocity[span], torque[span] - torque[span].mean(axis=0)
        ways = [(np.maximum(sign * v, 0.0), sign * swing) for sign in (1.0, -1.0)]
        out.append([(a * b).sum(axis=0) / np.maximum(_norm(a) * _norm(b * (a > 0)), 1e-300) for a, b in ways])
    return np.array(out).swapaxes(0, 1)


def _norm(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x, axis=0))


def _places(look: Look) -> Iterator[tuple[int, int, float]]:
    """Every recording and joint, and what `_ratios` says of them; none of a single recording."""
    if len(look.sample.tracks) > 1:
        yield from ((r, k, float(x)) for (r, k), x in np.ndenumerate(_ratios(look)))


def _ratios(look: Look) -> Array:
    """Each recording's torques over what the fit to the others predicts of them, (recordings, joints)."""
    predicted, measured = look.predicted_by_others, look.measured()
    along = [
        (predicted[s] * measured[s]).sum(axis=0) / ((predicted[s] ** 2).sum(axis=0) + 1e-300) for s in look.sample.spans
    ]
    return np.array(along)


def _reversed(look: Look, name: str, recording: int, joint: int, evident: float) -> Hypothesis:
    what, signal = ("torque", "torque") if name == "torque_scale" else ("position", "motor_position")
    said, where = look.sample.joints[joint], name_of(look, recording)
    text = (
        f"The {what} of {said} has the wrong sign in {where}, and not in the other recordings: change it in that log."
    )
    reading = look.reading.scaled_in(recording, name, [joint], -1.0)
    return dataclasses.replace(Hypothesis.of("reversed_sign", signal, (said,), text, reading), evident=evident)


def _scaled(look: Look, recording: int, joints: Sequence[int], factor: float) -> Hypothesis:
    names, where = tuple(look.sample.joints[k] for k in joints), name_of(look, recording)

    def reading(factor: float) -> Reading:
        return look.reading.scaled_in(recording, "torque_scale", joints, 1.0 / factor)

    whose = names[0] if len(names) == 1 else "every joint"
    text = f"The torque of {whose} in {where} is <factor> times what it is in the other recordings: bring that log to their unit."
    return Hypothesis("torque_gain", "torque", names, text, reading, factor, (factor / WITHIN, factor * WITHIN))
