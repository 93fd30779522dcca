"""A plant in two flat arrays, which cross from Python faster than twenty, and its accelerations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, counted, entry, inlined
from rx90b_flex.compiled.laws import Laws, add_laws_to_system, law_forces
from rx90b_flex.compiled.linear import factor, solve
from rx90b_flex.compiled.scratch import scratch_in
from rx90b_flex.compiled.tree import Tree, body_columns, inverse_dynamics, mass_matrix, move, place
from rx90b_flex.compiled.vectors import WIDTH, aligned, as_vectors, part_of

# Integers before the arrays: coordinates of the tree, of all, and of drives beside it; laws, width of their combinations, length of
# their parameters; how many lanes of a vector are asked for their laws, and whether for chords.
JOINTS, COORDINATES, BESIDE, LAWS, BREADTH, LENGTH, WANTED, CHORDS = range(8)
SIZES = 8
OF_JOINT, OF_LAW = 5, 3  # integers a joint, and a law beside its places


class Packed(NamedTuple):
    """All integers and all numbers of a plant."""

    integers: Integers
    numbers: Array


class Order(NamedTuple):
    """Where a plant's coordinates lie among the robot's."""

    source: Integers  # (n,) the robot's coordinate
    added: Integers  # (n,) another one that is added to it; -1: none
    drives: Integers  # (joints,) the plant's coordinates that drives turn


def pack(tree: Tree, laws: Laws, order: Order) -> Packed:
    """The arrays one behind the other, in the order in which `unpack` takes them."""
    integers = [tree.parent, tree.prismatic, tree.turned, tree.shifted, tree.heavy, tree.partner]
    integers += [order.source, order.added, laws.place, laws.width, laws.address, laws.stores, order.drives]
    numbers = [tree.rotation, tree.inertia, tree.offset, tree.axis, tree.moment, tree.mass, tree.gravity]
    numbers += [laws.weight, laws.inertia, laws.damping, laws.stiffness, laws.parameters, laws.out]
    joints, beside = len(tree.parent), len(tree.partner)
    sizes = [joints, joints + beside, beside, *laws.place.shape, laws.parameters.shape[1], WIDTH, 0]
    return Packed(
        np.concatenate([np.array(sizes, dtype=np.int64), *(x.ravel() for x in integers)]),
        np.concatenate([x.ravel() for x in numbers]),
    )


@inlined
def _places_from(integers: Integers) -> int:
    """Where the places of the laws begin."""
    return SIZES + OF_JOINT * integers[JOINTS] + integers[BESIDE] + 2 * integers[COORDINATES]


@counted
def unpack(packed: Packed) -> tuple[Tree, Laws]:
    """Tree and laws as views of what `pack` made."""
    integers, numbers = packed
    n, m, width, length = integers[JOINTS], integers[LAWS], integers[BREADTH], integers[LENGTH]
    partner_from = SIZES + OF_JOINT * n
    place_from = _places_from(integers)
    law_from = place_from + m * width
    vectors_from = 2 * 9 * n
    mass_from = vectors_from + 3 * 3 * n
    gravity_from = mass_from + n
    weight_from = gravity_from + 3
    linear_from = weight_from + m * width
    parameters_from = linear_from + 3 * m
    out_from = parameters_from + m * length
    tree = Tree(
        parent=part_of(integers, SIZES, (n,)),
        prismatic=part_of(integers, SIZES + n, (n,)),
        turned=part_of(integers, SIZES + 2 * n, (n,)),
        shifted=part_of(integers, SIZES + 3 * n, (n,)),
        heavy=part_of(integers, SIZES + 4 * n, (n,)),
        partner=part_of(integers, partner_from, (integers[BESIDE],)),
        rotation=part_of(numbers, 0, (n, 3, 3)),
        inertia=part_of(numbers, 9 * n, (n, 3, 3)),
        offset=part_of(numbers, vectors_from, (n, 3)),
        axis=part_of(numbers, vectors_from + 3 * n, (n, 3)),
        moment=part_of(numbers, vectors_from + 6 * n, (n, 3)),
        mass=part_of(numbers, mass_from, (n,)),
        gravity=part_of(numbers, gravity_from, (3,)),
    )
    laws = Laws(
        place=part_of(integers, place_from, (m, width)),
        weight=part_of(numbers, weight_from, (m, width)),
        inertia=part_of(numbers, linear_from, (m,)),
        damping=part_of(numbers, linear_from + m, (m,)),
        stiffness=part_of(numbers, linear_from + 2 * m, (m,)),
        width=part_of(integers, law_from, (m,)),
        address=part_of(integers, law_from + m, (m,)),
        stores=part_of(integers, law_from + 2 * m, (m,)),
        parameters=part_of(numbers, parameters_from, (m, length)),
        out=part_of(numbers, out_from, (3,)),
        wanted=part_of(integers, WANTED, (2,)),
    )
    return tree, laws


@entry
def accelerations(integers: Integers, numbers: Array, memory: Array, q: Array, v: Array, drive_torque: Array) -> Array:
    """Accelerations of what was packed, under drive torques; not finite where the mass matrix is singular.

    q, v and what is returned (n,) are in the robot's own coordinates.
    """
    tree, laws = unpack(Packed(integers, numbers))
    n, order_from = len(q), SIZES + OF_JOINT * integers[JOINTS] + integers[BESIDE]
    drives_from = _places_from(integers) + integers[LAWS] * (integers[BREADTH] + OF_LAW)
    s = scratch_in(memory, n, len(laws.inertia))
    for i in range(n):
        source, added = integers[order_from + i], integers[order_from + n + i]
        s.q[i], s.v[i], s.a[i], s.right[i] = q[source], v[source], 0.0, 0.0
        if added >= 0:
            s.q[i] += q[added]
            s.v[i] += v[added]
    inverse_dynamics(tree, s, s.q, s.v, s.a, s.generalised)
    law_forces(laws, s, s.q, s.v, s.a, s.torques, s.by_x, s.by_rate, s.generalised)
    mass_matrix(tree, s, s.system)
    add_laws_to_system(laws, s, 0.0, 0.0, s.system)
    for j in range(len(drive_torque)):
        s.right[integers[drives_from + j]] = drive_torque[j]
    for i in range(n):
        s.right[i] -= s.generalised[i]
    factor(s.system, tree.partner)
    solve(s.system, tree.partner, s.right)
    out = np.empty(n)
    for i in range(n):  # what is added stands among the first
        source, added = integers[order_from + i], integers[order_from + n + i]
        out[source] = s.right[i] - out[added] if added >= 0 else s.right[i]
    return out


@inlined
def _next_samples(k: int, count: int, q: Array, v: Array, a: Array, state: Array) -> None:
    """Samples k to k + count of a motion into the first lanes of `state` (3, n, WIDTH)."""
    for lane in range(count):
        for i in range(q.shape[1]):
            state[0, i, lane], state[1, i, lane], state[2, i, lane] = q[k + lane, i], v[k + lane, i], a[k + lane, i]


@entry
def link_torques(integers: Integers, numbers: Array, size: int, q: Array, v: Array, a: Array) -> Array:
    """Generalised forces that the links of what was packed need at samples of motion, each (N, n); eight samples at a time.

    With `size` numbers of working memory.
    """
    tree, _ = unpack(Packed(integers, numbers))
    n = q.shape[1]
    s = scratch_in(as_vectors(aligned(size)), n, 0)
    state, force = aligned(3 * n).reshape((3, n, WIDTH)), aligned(n)
    vectors, forces = as_vectors(state.reshape(state.size)).reshape((3, n)), as_vectors(force)
    out = np.empty(q.shape)
    for k in range(0, len(q), WIDTH):
        count = min(WIDTH, len(q) - k)
        _next_samples(k, count, q, v, a, state)
        inverse_dynamics(tree, s, vectors[0], vectors[1], vectors[2], forces)
        for lane in range(count):
            for i in range(n):
                out[k + lane, i] = force[i * WIDTH + lane]
    return out


@entry
def link_columns(
    integers: Integers, numbers: Array, size: int, bodies: Integers, out: Array, q: Array, v: Array, a: Array
) -> None:
    """Generalised forces per unit of each link parameter at samples of motion, into the first columns of `out` (N, n, ...) of zeros.

    `bodies` are the coordinates that carry them. Parameters as in a robot file: mass, first moment, xx, yy, zz, xy, xz, yz. Eight
    samples at a time, with `size` numbers of working memory.
    """
    tree, _ = unpack(Packed(integers, numbers))
    n, width = q.shape[1], 10 * len(bodies)
    s = scratch_in(as_vectors(aligned(size)), n, 0)
    state, block = aligned(3 * n).reshape((3, n, WIDTH)), aligned(n * width)
    vectors, columns = as_vectors(state.reshape(state.size)).reshape((3, n)), as_vectors(block).reshape((n, width))
    for k in range(0, len(q), WIDTH):
        count = min(WIDTH, len(q) - k)
        _next_samples(k, count, q, v, a, state)
        place(tree, s, vectors[0])
        move(tree, s, vectors[1], vectors[2])
        for b in range(len(bodies)):
            body_columns(tree, s, bodies[b], columns, 10 * b)
        for lane in range(count):
            for i in range(n):
                for c in range(width):
                    out[k + lane, i, c] = block[(i * width + c) * WIDTH + lane]
