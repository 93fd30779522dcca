"""Working memory of compiled dynamics, laid out in one flat array."""

from __future__ import annotations

from typing import NamedTuple

from rx90b_flex.compiled.compile import Array, counted


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
    matrices = memory[:vectors_from].reshape((MATRICES, n, 3, 3))
    vectors = memory[vectors_from:laws_from].reshape((VECTORS, n, 3))
    of_laws = memory[laws_from:system_from].reshape((OF_LAWS, m))
    numbers = memory[numbers_from : numbers_from + NUMBERS * n].reshape((NUMBERS, n))
    return Scratch(
        rotation=matrices[0],
        inertia=matrices[1],
        axis=vectors[0],
        arm=vectors[1],
        spin=vectors[2],
        turn=vectors[3],
        lift=vectors[4],
        force=vectors[5],
        torque=vectors[6],
        moment=vectors[7],
        torques=of_laws[0],
        late_torques=of_laws[1],
        by_x=of_laws[2],
        by_rate=of_laws[3],
        late_by_x=of_laws[4],
        late_by_rate=of_laws[5],
        system=memory[system_from:numbers_from].reshape((n, n)),
        mass=numbers[0],
        generalised=numbers[1],
        right=numbers[2],
        k_q=numbers[3],
        k_v=numbers[4],
        q=numbers[5],
        v=numbers[6],
        a=numbers[7],
    )
