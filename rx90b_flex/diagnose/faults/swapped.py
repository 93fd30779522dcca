"""Columns that stand under other joints' names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look, Motors
from rx90b_flex.diagnose.faults.sample import Reading

WHAT = {"torque": "torque", "motor_position": "position", "all": "position and torque"}
KEYS = {"torque_order": "torque", "order": "motor_position"}


def swapped(look: Look) -> Iterator[Hypothesis]:
    """Torque columns of two joints exchanged, or all moved on by one; the same of positions, and of both together."""
    n = len(look.sample.joints)
    for name in KEYS:
        before = getattr(look.reading, name)
        yield from (_of(look, (name,), order) for order in _exchanged(before))
        for step in (1, -1) if n > 2 else ():
            yield _of(look, (name,), tuple(before[(k + step) % n] for k in range(n)))
    both = look.reading.order
    if both == look.reading.torque_order:
        yield from (_of(look, tuple(KEYS), order) for order in _exchanged(both))
    plain = tuple(range(n))
    if look.motors is not None and both == look.reading.torque_order == plain and look.reading.torque_mix is None:
        yield from _of_motors(look, look.motors)


def _of_motors(look: Look, motors: Motors) -> Iterator[Hypothesis]:
    """The same of two motors' columns, which their gears bring to other angles and torques than those of the joints."""
    gear, reading = motors.gear, look.reading
    same = np.eye(len(gear))
    for i, j in combinations(range(len(gear)), 2):
        order = list(range(len(gear)))
        order[i], order[j] = j, i
        mix = gear.T @ same[order] @ np.linalg.inv(gear.T)
        torques: dict[str, object] = {"torque_mix": tuple(tuple(row) for row in mix.tolist())}
        angles = _angles_of_motors(reading, motors, i, j)
        # what the joints' own columns exchanged say, too, is theirs
        other_torques = motors.torques and not np.allclose(mix, same[order])
        other_angles = angles is not None and not _only_exchanged(reading, angles)
        if other_torques:
            yield _motors_hypothesis(look, (i, j), "torque", torques)
        if angles is not None and other_angles:
            yield _motors_hypothesis(look, (i, j), "motor_position", angles)
        if angles is not None and motors.torques and (other_torques or other_angles):
            yield _motors_hypothesis(look, (i, j), "all", torques | angles)


def _only_exchanged(reading: Reading, angles: Mapping[str, object]) -> bool:
    return all(np.allclose(np.array(angles[name]), getattr(reading, name)) for name in ("scale", "offset"))


def _angles_of_motors(reading: Reading, motors: Motors, i: int, j: int) -> dict[str, object] | None:
    """Entries of a reading in which two motors' angles are exchanged; None where another joint turns with either."""
    gear, offset = motors.gear, motors.offset
    alone = gear - np.diag(np.diag(gear))
    if alone[[i, j]].any() or alone[:, [i, j]].any():
        return None
    order, scale, zero = list(reading.order), list(reading.scale), list(reading.offset)
    for k, other in ((i, j), (j, i)):
        ratio = float(gear[other, other] / gear[k, k])
        order[k], scale[k] = other, ratio * reading.scale[k]
        zero[k] = reading.offset[k] + reading.scale[k] * float(offset[k] - ratio * offset[other])
    return {"order": tuple(order), "scale": tuple(scale), "offset": tuple(zero)}


def _motors_hypothesis(look: Look, which: tuple[int, int], signal: str, entries: Mapping[str, object]) -> Hypothesis:
    names = tuple(look.sample.joints[k] for k in which)
    text = (
        f"The {WHAT[signal]} columns of the motors of {' and '.join(names)} are exchanged: put them in the order of `joints` and of "
        "`gear_matrix`."
    )
    return Hypothesis.of("swapped_columns", signal, names, text, look.reading.with_entries(entries))


def _exchanged(order: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """With two places exchanged, each two in turn."""
    for i, j in combinations(range(len(order)), 2):
        after = list(order)
        after[i], after[j] = order[j], order[i]
        yield tuple(after)


def _of(look: Look, names: tuple[str, ...], order: tuple[int, ...]) -> Hypothesis:
    joints = look.sample.joints
    before = getattr(look.reading, names[0])
    moved = {joints[k]: joints[order[k]] for k in range(len(joints)) if order[k] != before[k]}
    signal = KEYS[names[0]] if len(names) == 1 else "all"
    what = WHAT[signal]
    fits = ", ".join(f"{joint}'s in that of {other}" for joint, other in moved.items())
    text = f"The {what} columns of {', '.join(moved)} are exchanged ({fits}): put them in the order of `joints`."
    reading = look.reading.with_entries(dict.fromkeys(names, order))
    return Hypothesis.of("swapped_columns", signal, tuple(moved), text, reading)
