"""Signals whose sign is the other way round."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from itertools import combinations

from rx90b_flex.diagnose.faults.look import Hypothesis, Look


def reversed_torques(look: Look) -> Iterator[Hypothesis]:
    """Torques of one joint, of two, of all, or of all but one."""
    n = len(look.sample.joints)
    sets: list[tuple[int, ...]] = [(k,) for k in range(n)]
    sets += list(combinations(range(n), 2)) if n > 2 else []
    sets += [tuple(range(n))] if n > 1 else []
    sets += [tuple(j for j in range(n) if j != k) for k in range(n)] if n > 3 else []
    for chosen in sets:
        yield _of(look, chosen, ("torque_scale",), "torque")


def reversed_positions(look: Look) -> Iterator[Hypothesis]:
    """Positions of one joint, or of all."""
    n = len(look.sample.joints)
    for chosen in [*((k,) for k in range(n)), *([tuple(range(n))] if n > 1 else [])]:
        yield _of(look, chosen, ("scale",), "motor_position")


def reversed_axes(look: Look) -> Iterator[Hypothesis]:
    """Position and torque of one joint: the URDF's axis points the other way."""
    for k in range(len(look.sample.joints)):
        yield _of(look, (k,), ("scale", "torque_scale"), "all")


def _of(look: Look, chosen: Sequence[int], names: tuple[str, ...], signal: str) -> Hypothesis:
    joints = tuple(look.sample.joints[k] for k in chosen)
    reading, said = look.reading, ", ".join(joints)
    for name in names:
        reading = reading.changed(name, chosen, operator.neg)
    if signal == "all":
        text = (
            f"The URDF's axis of {said} points the other way than the log counts: turn the axis round, or both signs "
            "(-1 in `gear_matrix`)."
        )
        return Hypothesis.of("kinematics", signal, joints, text, reading)
    what = "torque" if signal == "torque" else "position"
    text = f"The {what} of {said} has the wrong sign: change it in the log."
    return Hypothesis.of("reversed_sign", signal, joints, text, reading)
