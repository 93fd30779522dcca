"""Positions that are not in rad, or not on the joint side."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.effects.motion import Mask

ANGLES = {"degrees": np.pi / 180, "mrad": 1e-3, "turns": 2 * np.pi}
LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m where the URDF has mm": 1e3}
GEARS = (5.0, 500.0)  # motor turns a joint turn that are looked at
BEYOND = 1.1  # times the range of a joint that no joint moves through
TURNS = 12 * np.pi  # range of a joint that has no limits; wider ones in a URDF stand for none


def other_units(look: Look) -> Iterator[Hypothesis]:
    """Degrees, milliradians, turns or millimetres, of all joints or of one; motor angles of one beyond its limits."""
    n = len(look.sample.joints)
    for name, scale in ANGLES.items():
        turning = [k for k in range(n) if not look.prismatic[k]]
        groups = [turning] if turning else []
        if name == "degrees" and len(turning) > 1:
            groups += [[k] for k in turning]
        for chosen in groups:
            # what becomes larger than the joint's range cannot be meant
            if scale < 1.0 or not outside(look, scale)[chosen].any():
                yield _of(look, chosen, scale, name)
    for name, scale in LENGTHS.items():
        for k in range(n):
            if look.prismatic[k] and (scale < 1.0 or not outside(look, scale)[k]):
                yield _of(look, [k], scale, name)
    for beyond in np.flatnonzero(outside(look, 1.0)):
        yield from _motor_side(look, int(beyond))


def outside(look: Look, scale: float) -> Mask:
    """Joints whose motion is wider than their range in the URDF, or than six turns, if positions are scaled so."""
    q = look.sample.seen(look.reading)[0] @ look.reading.to_joints.T
    reach = np.ptp(q, axis=0) * scale
    room = look.limits[1] - look.limits[0]
    return np.asarray(reach > BEYOND * np.where((room > 0) & (room < TURNS), room, TURNS))


def _motor_side(look: Look, k: int) -> Iterator[Hypothesis]:
    reach = np.ptp(look.sample.seen(look.reading)[0][:, k])
    room = float(np.clip(look.limits[1, k] - look.limits[0, k], 0.1, 4 * np.pi))
    joint = look.sample.joints[k]
    text = f"The position of {joint} seems to be the motor's, about <factor> turns a joint turn: state `gear_matrix`."

    def reading(factor: float) -> Reading:
        return look.reading.changed("scale", (k,), lambda x: x / factor)

    for gear in np.geomspace(max(GEARS[0], reach / room), GEARS[1], 10).tolist():
        yield Hypothesis("unit", "motor_position", (joint,), text, reading, gear, (gear / 1.6, gear * 1.6))


def _of(look: Look, chosen: list[int], scale: float, name: str) -> Hypothesis:
    joints = tuple(look.sample.joints[k] for k in chosen)
    text = f"The position of {', '.join(joints)} is in {name}: bring it to SI units (times {scale:.6g})."
    reading = look.reading.changed("scale", chosen, lambda x: x * scale)
    return Hypothesis.of("unit", "motor_position", joints, text, reading, 1.0 / scale)
