"""Columns that one recording has otherwise than all others: exchanged, counted from another zero, in another unit or rate."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from rx90b_flex.diagnose.faults.kinematics import ZEROS
from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.rates import GRID, another_rate
from rx90b_flex.diagnose.faults.rigid_fit import FLOOR
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.diagnose.faults.swapped import WHAT
from rx90b_flex.diagnose.faults.units import ANGLES
from rx90b_flex.diagnose.faults.warm import of_friction
from rx90b_flex.effects.motion import Array

APART = 4.0  # summed log error that a recording's own fit leaves less than that to the others: one of them is unlike the rest
UNLIKE = 3.0  # the same by which the others predict one recording worse than another: it is unlike them by itself, too
WORST = 1.0  # the same by which one is predicted better by the others than that which is predicted worst, and still may be it
BETTER = 0.5  # summed log error that one recording leaves less with the fit to the others, if it is read otherwise
A_LITTLE = (-0.25, -0.08, 0.08, 0.25)  # rad, beside the larger zeros
NEAR = 0.8  # rad, within which a zero is refined
OTHER_RANGE = 10.0  # times the range of a joint in the other recordings: another unit
SMALLEST_ZERO = np.radians(1.0)  # less is no fault of the data


def exchanged_in_one(look: Look) -> Iterator[Hypothesis]:
    """Two joints' torques, positions, or both exchanged in one recording."""
    if len(look.sample.tracks) < 2:
        return
    for r, errors in enumerate(_errors(look, look.predicted_by_others)):
        log = np.log(errors + FLOOR)
        for i, j in combinations(range(len(errors)), 2):
            if log[i, i] + log[j, j] - log[i, j] - log[j, i] > BETTER:
                yield _exchanged(look, r, i, j, ("torque",))
    for r in standing_apart(look):
        of_one = _OfOne(look, r)
        for i, j in combinations(range(len(look.sample.joints)), 2):
            for signals in (("motor_position",), ("torque", "motor_position")):
                hypothesis = _exchanged(look, r, i, j, signals)
                if of_one.gain(hypothesis.reading) > BETTER:
                    yield hypothesis


def zeros_in_one(look: Look) -> Iterator[Hypothesis]:
    """A joint that counts from another zero in one recording."""
    for r in standing_apart(look):
        of_one = _OfOne(look, r)
        for k in range(len(look.sample.joints)):
            if not look.prismatic[k]:
                tried = [_zero(look, r, k, angle) for angle in (*ZEROS, *A_LITTLE)]
                gain, best = max(((of_one.gain(h.reading), h) for h in tried), key=lambda pair: pair[0])
                if gain > BETTER:
                    yield best


def rates_in_one(look: Look) -> Iterator[Hypothesis]:
    """One recording's sample rate is not the stated one."""
    for r in standing_apart(look):
        text = f"The stated sample rate of {name_of(look, r)} is <factor> times the true one, and that of the others is right."

        def reading(factor: float, r: int = r) -> Reading:
            return look.reading.changed_in(r, {"rate": look.reading.logs[r].rate / factor})

        of_one = _OfOne(look, r)
        for factor in GRID:
            if of_one.gain(reading(factor)) > BETTER:
                yield another_rate(text, reading, factor)


def units_in_one(look: Look) -> Iterator[Hypothesis]:
    """One recording's angles in degrees, milliradians or turns, or one joint's in degrees."""
    sample = look.sample
    turning = np.flatnonzero(~np.array(look.prismatic))
    if len(sample.tracks) < 2 or not len(turning):
        return
    reach = np.array([np.ptp(sample.seen(look.reading)[0][span][:, turning], axis=0) for span in sample.spans])
    for r in range(len(reach)):
        times = reach[r] / np.maximum(np.median(np.delete(reach, r, axis=0), axis=0), 1e-9)
        for unit, scale in ANGLES.items():
            beyond = times > OTHER_RANGE if scale < 1.0 else times < 1.0 / scale
            if beyond.mean() > 0.5:
                yield _unit(look, r, turning.tolist(), unit, scale)
            elif unit == "degrees":
                yield from (_unit(look, r, [k], unit, scale) for k in turning[beyond].tolist())


def name_of(look: Look, recording: int) -> str:
    """Of a recording's file, and which it is of several parts of one."""
    names = [t.name for t in look.sample.tracks]
    name = names[recording]
    return name if names.count(name) == 1 else f"{name} (recording {recording + 1})"


# ---- which recording it may be ----------------------------------------------------------------------------------


def standing_apart(look: Look) -> list[int]:
    """Recordings that the fit to the others predicts worst, where that is far worse than one of the rest, or any goes much better by
    itself: one that is unlike bends the others' fits. None that is only warmer.
    """
    if len(look.sample.tracks) < 2 or any(log.other_load for log in look.reading.logs):
        return []
    others, own = (
        np.log(np.diagonal(_errors(look, x), axis1=1, axis2=2) + FLOOR).sum(axis=1)
        for x in (look.predicted_by_others, look.predicted_by_own)
    )
    if not ((others - own).max() > APART or np.ptp(others) > UNLIKE):
        return []
    return np.flatnonzero((others > others.max() - WORST) & ~of_friction(look).warm).tolist()


def _errors(look: Look, predicted: Array) -> Array:
    """Squared error of each recording with what is predicted of joint i beside the torque of joint j, over the variance of that
    torque, (recordings, i, j).
    """
    measured = look.measured()
    apart = (predicted[:, :, None] - measured[:, None, :]) ** 2
    return np.array([apart[span].mean(axis=0) for span in look.sample.spans]) / (measured.var(axis=0) + 1e-300)


class _OfOne:
    """One recording beside the fit to all others, which stays as it is."""

    def __init__(self, look: Look, recording: int) -> None:
        at = look.sample.spans[recording].start
        self._which, self._theta = recording, look.theta_by_others[at]
        self._variance = look.measured().var(axis=0) + 1e-300
        own = look.sample.only(recording)
        self._alone = dataclasses.replace(look, sample=own, _columns={}, _products={}, ratios={})
        self._before = self._error(look.reading)

    def gain(self, reading: Reading) -> float:
        """Summed log error that it leaves less, read so."""
        return self._before - self._error(reading)

    def _error(self, reading: Reading) -> float:
        alone = dataclasses.replace(self._alone, reading=reading.with_entries({"logs": (reading.logs[self._which],)}))
        left = alone.columns(alone.reading) @ self._theta - alone.measured()
        return float(np.log((left**2).mean(axis=0) / self._variance + FLOOR).sum())


# ---- what it may be ---------------------------------------------------------------------------------------------


def _exchanged(look: Look, r: int, i: int, j: int, signals: tuple[str, ...]) -> Hypothesis:
    present, entries = look.reading, {}
    for name, common in (("order", present.order), ("torque_order", present.torque_order)):
        if ("motor_position" if name == "order" else "torque") in signals:
            order = list(getattr(present.logs[r], name))
            a, b = common[i], common[j]
            order[a], order[b] = order[b], order[a]
            entries[name] = tuple(order)
    signal = signals[0] if len(signals) == 1 else "all"
    joints = (look.sample.joints[i], look.sample.joints[j])
    text = (
        f"The {WHAT[signal]} columns of {' and '.join(joints)} are exchanged in {name_of(look, r)}, and not in the other recordings: "
        "put them in the order of `joints` in that log."
    )
    return Hypothesis.of("swapped_columns", signal, joints, text, present.changed_in(r, entries))


def _zero(look: Look, r: int, k: int, angle: float) -> Hypothesis:
    joint, present = look.sample.joints[k], look.reading

    def reading(angle: float) -> Reading:
        offset = list(present.logs[r].offset)
        offset[present.order[k]] += angle / present.scale[k]
        return present.changed_in(r, {"offset": tuple(offset)})

    text = (
        f"The zero of {joint} is <factor>° off in {name_of(look, r)}, and not in the other recordings: its angle is that log's plus "
        "that. Leave that recording out, or correct its column."
    )
    bounds = (angle - NEAR, angle + NEAR)
    return Hypothesis(
        "kinematics", "motor_position", (joint,), text, reading, angle, bounds, shown=float(np.degrees(1.0)),
        smallest=float(SMALLEST_ZERO),
    )  # fmt: skip


def _unit(look: Look, r: int, chosen: list[int], unit: str, scale: float) -> Hypothesis:
    joints = tuple(look.sample.joints[k] for k in chosen)
    text = (
        f"The position of {', '.join(joints)} is in {unit} in {name_of(look, r)}, and not in the other recordings: bring it to SI "
        f"units (times {scale:.6g})."
    )
    reading = look.reading.scaled_in(r, "scale", chosen, scale)
    return Hypothesis.of("unit", "motor_position", joints, text, reading, 1.0 / scale)
