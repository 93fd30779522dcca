"""Working memory of compiled dynamics, laid out in one flat array."""

from __future__ import annotations

from typing import NamedTuple

from rx90b_flex.compiled.compile import Array, counted
from rx90b_flex.compiled.vectors import part_of


class Scratch(NamedTuple):
    """Working memory of one lane."""

    rotation: Array  # (n, 3, 3)
    axis: Array  # (n, 3) world
    arm: Array  # (n, 3) from the parent's origin to the joint's, world
    spin: Array  # (n, 3) angular velocity
    turn: Array  # (n, 3) angular acceleration
    lift: Array  # (n, 3) acceleration of the origin less gravity
    force: Array  # (n, 3)
    torque: Array  # (n, 3)
    mass: Array  # (n,) of everything that hangs on the joint
    moment: Array  # (n, 3)
    inertia: Array  # (n, 3, 3)
    torques: Array  # (m,) of the laws
    late_torques: Array  # (m,)
    by_x: Array  # (m,) slopes of the laws
    by_rate: Array  # (m,)
    late_by_x: Array  # (m,)
    late_by_rate: Array  # (m,)
    system: Array  # (n, n)
    generalised: Array  # (n,)
    right: Array  # (n,)
    k_q: Array  # (n,)
    k_v: Array  # (n,)
    q: Array  # (n,)
    v: Array  # (n,)
    a: Array  # (n,)


# Blocks of arrays of one shape, in this order, and how many arrays each has.
MATRICES, VECTORS, NUMBERS, OF_LAWS = 2, 8, 8, 6


def scratch_size(n: int, laws: int) -> int:
    """Numbers that `scratch_in` needs for n coordinates and that many laws."""
    return (9 * MATRICES + 3 * VECTORS + NUMBERS) * n + n * n + OF_LAWS * laws


@counted
def scratch_in(memory: Array, n: int, m: int) -> Scratch:
    """Working memory for n coordinates and m laws in a flat array of `scratch_size` numbers."""
    vectors_from = 9 * MATRICES * n
    laws_from = vectors_from + 3 * VECTORS * n
    system_from = laws_from + OF_LAWS * m
    numbers_from = system_from + n * n
    return Scratch(
        rotation=part_of(memory, 0, (n, 3, 3)),
        inertia=part_of(memory, 9 * n, (n, 3, 3)),
        axis=part_of(memory, vectors_from, (n, 3)),
        arm=part_of(memory, vectors_from + 3 * n, (n, 3)),
        spin=part_of(memory, vectors_from + 6 * n, (n, 3)),
        turn=part_of(memory, vectors_from + 9 * n, (n, 3)),
        lift=part_of(memory, vectors_from + 12 * n, (n, 3)),
        force=part_of(memory, vectors_from + 15 * n, (n, 3)),
        torque=part_of(memory, vectors_from + 18 * n, (n, 3)),
        moment=part_of(memory, vectors_from + 21 * n, (n, 3)),
        torques=part_of(memory, laws_from, (m,)),
        late_torques=part_of(memory, laws_from + m, (m,)),
        by_x=part_of(memory, laws_from + 2 * m, (m,)),
        by_rate=part_of(memory, laws_from + 3 * m, (m,)),
        late_by_x=part_of(memory, laws_from + 4 * m, (m,)),
        late_by_rate=part_of(memory, laws_from + 5 * m, (m,)),
        system=part_of(memory, system_from, (n, n)),
        mass=part_of(memory, numbers_from, (n,)),
        generalised=part_of(memory, numbers_from + n, (n,)),
        right=part_of(memory, numbers_from + 2 * n, (n,)),
        k_q=part_of(memory, numbers_from + 3 * n, (n,)),
        k_v=part_of(memory, numbers_from + 4 * n, (n,)),
        q=part_of(memory, numbers_from + 5 * n, (n,)),
        v=part_of(memory, numbers_from + 6 * n, (n,)),
        a=part_of(memory, numbers_from + 7 * n, (n,)),
    )
