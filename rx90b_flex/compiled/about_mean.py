"""The perturbation method: the linear system about a nominal motion, a step a sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, entry, inlined
from rx90b_flex.compiled.laws import Laws, combine, scatter
from rx90b_flex.compiled.linear import invert
from rx90b_flex.compiled.scratch import Scratch, scratch_in
from rx90b_flex.compiled.tree import Tree, inverse_dynamics


class Along(NamedTuple):
    """The nominal motion of a chunk and the system about it."""

    nodes: Array  # (rows + 1, 3, n, n) M, D and K at the references' rate, without the compiled laws' functions
    q: Array  # (samples + 1, n) at the controller's rate
    v: Array  # (samples + 1, n)
    middle: Array  # (samples, 3, n) coordinates, rates, accelerations in the middle of a sample
    other: Array  # (samples, n) forces of the effects without a compiled law


class Steps(NamedTuple):
    """The linear system of a chunk, a step a sample, the same for all lanes.

    With y = (dq', dq, drive torque) the rate in the middle of a step is ``move @ y + shift - push @ port torques``.
    """

    q: Array  # (samples, n) nominal coordinates at the step's start
    v: Array  # (samples, n)
    move: Array  # (samples, n, 2 n + joints)
    shift: Array  # (samples, n) rad/s
    push: Array  # (samples, n, ports) rad/s per N m, of the exact laws
    port_x: Array  # (samples, ports) combination of the nominal coordinates in the middle of the step
    port_rate: Array  # (samples, ports)
    gain: Array  # (samples, ports, ports) ports.T @ push


class Ports(NamedTuple):
    """Combinations of the coordinates that exact laws depend on."""

    vector: Array  # (n, ports)
    start: Integers  # (ports + 1,) first law of each port in `law`
    law: Integers
    tabulated: Integers  # (ports,) whether the torque depends on the rate alone and is read from the table
    table: Array  # (ports, 2 * CELLS, 4) cubics of the torque by |rate| less the cell's start; negative rates second


@inlined
def _see_ports(ports: Ports, middle: Array, push: Array, port_x: Array, port_rate: Array, gain: Array) -> None:
    """What the ports of the exact laws see of the nominal motion, and how their torques move each other's rates."""
    n = middle.shape[1]
    for p in range(push.shape[1]):
        port_x[p], port_rate[p] = 0.0, 0.0
        for i in range(n):
            port_x[p] += ports.vector[i, p] * middle[0, i]
            port_rate[p] += ports.vector[i, p] * middle[1, i]
        for u in range(push.shape[1]):
            total = 0.0
            for i in range(n):
                total += ports.vector[i, u] * push[i, p]
            gain[u, p] = total


@inlined
def _between(low: Array, high: Array, part: float, mass: Array, damping: Array, stiffness: Array) -> None:
    """M, D and K so far on the way from one node to the next."""
    for i in range(len(mass)):
        for j in range(len(mass)):
            mass[i, j] = low[0, i, j] + part * (high[0, i, j] - low[0, i, j])
            damping[i, j] = low[1, i, j] + part * (high[1, i, j] - low[1, i, j])
            stiffness[i, j] = low[2, i, j] + part * (high[2, i, j] - low[2, i, j])


@inlined
def _solve_rate(
    inverse: Array,
    mass: Array,
    stiffness: Array,
    force: Array,
    drive: Integers,
    ports: Ports,
    h: float,
    move: Array,
    shift: Array,
    push: Array,
) -> None:
    """The rate in the middle of a step, as `Steps` has it, from the inverse of the step's system."""
    n = len(mass)
    for i in range(n):
        for j in range(2 * n):
            move[i, j] = 0.0
        constant = 0.0
        for m in range(n):
            x = inverse[i, m]
            y = -0.5 * h * x
            constant += y * force[m]
            for j in range(n):
                move[i, j] += x * mass[m, j]
            for j in range(n):
                move[i, n + j] += y * stiffness[m, j]
        shift[i] = constant
        for j in range(len(drive)):
            move[i, 2 * n + j] = 0.5 * h * inverse[i, drive[j]]
        for p in range(push.shape[1]):
            total = 0.0
            for m in range(n):
                total += inverse[i, m] * ports.vector[m, p]
            push[i, p] = 0.5 * h * total


@inlined
def _make_step(
    tree: Tree,
    laws: Laws,
    ports: Ports,
    scratch: Scratch,
    drive: Integers,
    h: float,
    up: int,
    along: Along,
    at: int,
    work: Array,
    steps: Steps,
) -> None:
    """Matrices of the step at a chunk's sample `at`."""
    row = at // up
    part = (at - row * up + 0.5) / up
    middle = along.middle[at]
    n = middle.shape[1]
    mass, damping, stiffness, system, inverse = work[0], work[1], work[2], work[3], work[4]
    _between(along.nodes[row], along.nodes[row + 1], part, mass, damping, stiffness)
    force = scratch.generalised
    inverse_dynamics(tree, scratch, middle[0], middle[1], middle[2], force)
    for m in range(len(laws.inertia)):
        torque = laws.stiffness[m] * combine(laws, m, middle[0]) + laws.damping[m] * combine(laws, m, middle[1])
        scatter(laws, m, torque + laws.inertia[m] * combine(laws, m, middle[2]), force)
    for i in range(n):
        force[i] += along.other[at, i]
        for j in range(n):
            system[i, j] = mass[i, j] + 0.5 * h * damping[i, j] + 0.25 * h * h * stiffness[i, j]
    invert(system, inverse)
    push = steps.push[at]
    _solve_rate(inverse, mass, stiffness, force, drive, ports, h, steps.move[at], steps.shift[at], push)
    _see_ports(ports, middle, push, steps.port_x[at], steps.port_rate[at], steps.gain[at])


@entry
def make_steps(
    tree: Tree, laws: Laws, ports: Ports, memory: Array, drive: Integers, h: float, up: int, along: Along, steps: Steps
) -> None:
    """Fill `steps` for all samples of a chunk, `up` of them between two nodes."""
    n = along.q.shape[1]
    scratch, work = scratch_in(memory, n, len(laws.inertia)), np.zeros((5, n, n))
    for at in range(len(along.middle)):
        for i in range(n):
            steps.q[at, i], steps.v[at, i] = along.q[at, i], along.v[at, i]
        _make_step(tree, laws, ports, scratch, drive, h, up, along, at, work, steps)
