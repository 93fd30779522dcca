"""What is wrong in one recording alone, which the others tell."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.effects.motion import Array

OTHER = 1.1  # times what the other recordings ask for, from which a torque is looked at
WITHIN = 1.6  # times a first guess of a factor


def reversed_in_one(look: Look) -> Iterator[Hypothesis]:
    """A joint's torque or position with the other sign in one recording."""
    for r, k, ratio in _places(look):
        if ratio < 0:
            yield _reversed(look, "torque_scale_in", r, k)
        yield _reversed(look, "scale_in", r, k)


def scaled_in_one(look: Look) -> Iterator[Hypothesis]:
    """A joint's torque in another unit in one recording."""
    for r, k, ratio in _places(look):
        if ratio > OTHER or 0 < ratio < 1 / OTHER:
            yield _scaled(look, r, k, ratio)


def other_loads(look: Look) -> Iterator[Hypothesis]:
    """Another load on the flange in one recording."""
    tracks = look.sample.tracks
    for r in range(len(tracks) if len(tracks) > 1 and not any(look.reading.other_load) else 0):
        text = (
            f"{_name(look, r)} was made with another load than the other recordings: state what each had on the flange, with "
            "`payload` in its [[recording]]."
        )
        reading = look.reading.with_entries({"other_load": tuple(i == r for i in range(len(tracks)))})
        yield dataclasses.replace(Hypothesis.of("kinematics", None, (), text, reading), usable=True)


def _places(look: Look) -> Iterator[tuple[int, int, float]]:
    """Every recording and joint, and what `_ratios` says of them; none of a single recording."""
    if len(look.sample.tracks) > 1:
        yield from ((r, k, float(x)) for (r, k), x in np.ndenumerate(_ratios(look)))


def _ratios(look: Look) -> Array:
    """Each recording's torques over what the present reading predicts of them, and over the other recordings'; (recordings, joints).

    Of a fit to all of them, which the wrong one bends: its sign and size beside the others' show all the same.
    """
    sample, reading = look.sample, look.reading
    predicted = look.columns(reading) @ look.fit().theta.mean(axis=0)
    measured = sample.torque_seen(reading)
    out = np.array(
        [
            (predicted[span] * measured[span]).sum(axis=0) / np.maximum((predicted[span] ** 2).sum(axis=0), 1e-300)
            for span in sample.spans
        ]
    )
    others = np.array([np.median(np.delete(out, r, axis=0), axis=0) for r in range(len(out))])
    return np.where(np.abs(others) > 1e-9, out / np.where(np.abs(others) > 1e-9, others, 1.0), 1.0)


def _name(look: Look, recording: int) -> str:
    """Of a recording's file, and which it is of several parts of one."""
    names = [t.name for t in look.sample.tracks]
    name = names[recording]
    return name if names.count(name) == 1 else f"{name} (recording {recording + 1})"


def _reversed(look: Look, name: str, recording: int, joint: int) -> Hypothesis:
    what, signal = ("torque", "torque") if name == "torque_scale_in" else ("position", "motor_position")
    said, where = look.sample.joints[joint], _name(look, recording)
    text = (
        f"The {what} of {said} has the wrong sign in {where}, and not in the other recordings: change it in that log."
    )
    return Hypothesis.of("reversed_sign", signal, (said,), text, look.reading.changed_in(name, recording, joint, -1.0))


def _scaled(look: Look, recording: int, joint: int, factor: float) -> Hypothesis:
    said, where = look.sample.joints[joint], _name(look, recording)

    def reading(factor: float) -> Reading:
        return look.reading.changed_in("torque_scale_in", recording, joint, 1.0 / factor)

    text = f"The torque of {said} in {where} is <factor> times what it is in the other recordings: bring that log to their unit."
    return Hypothesis("torque_gain", "torque", (said,), text, reading, factor, (factor / WITHIN, factor * WITHIN))
