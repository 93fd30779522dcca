"""Angles of motors that other joints carry along, as behind a parallelogram or in a wrist, taken for the joints'."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading

WITHIN = 1.5  # times a first guess of a factor


def carried_motors(look: Look) -> Iterator[Hypothesis]:
    """A joint's angle, and its torque or not, is that of a motor that also turns with the joint before it, or against it."""
    joints = look.sample.joints
    for (a, b), torque, factor in product(pairwise(range(len(joints))), (True, False), (1.0, -1.0)):
        if look.prismatic[a] != look.prismatic[b]:
            continue
        text = (
            f"The position of {joints[b]} is that of a motor that also turns with {joints[a]}, <factor> times its angle (a "
            "parallelogram, a coupled wrist)"
        )
        text += (
            f", and so is the torque: state `gear_matrix`, that factor in row {joints[b]}, column {joints[a]}."
            if torque
            else f"; the torque is the joint's: take so much of {joints[a]} from the column."
        )

        def reading(factor: float, more: tuple[int, int] = (a, b), torque: bool = torque) -> Reading:
            return look.reading.with_entries({"carried": (*look.reading.carried, (*more, factor, torque))})

        bounds = min(factor / WITHIN, factor * WITHIN), max(factor / WITHIN, factor * WITHIN)
        signal = "all" if torque else "motor_position"
        yield Hypothesis("kinematics", signal, (joints[a], joints[b]), text, reading, factor, bounds)
