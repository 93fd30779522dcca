"""The sampling loop: controller and integrator of eight lanes, side by side in vectors."""

from __future__ import annotations

import numpy as np

from rx90b_flex.compiled.compile import Array, called, entry, inlined
from rx90b_flex.compiled.controller import RUNNING, Inputs, Lanes, Logs, Loop, control
from rx90b_flex.compiled.laws import Laws
from rx90b_flex.compiled.packed import Packed, unpack
from rx90b_flex.compiled.scratch import Scratch, scratch_in, scratch_size
from rx90b_flex.compiled.step import first_stage, second_stage
from rx90b_flex.compiled.tree import Tree
from rx90b_flex.compiled.vectors import WIDTH, aligned, as_vectors, lane_of

DIVISION = 8  # parts of a step along which the laws bend too much


@inlined
def dissipate(lanes: Lanes, lane: int, lost: float, h: float) -> None:
    """Count the power that is lost at a step's start: by the trapezoidal rule it closes the step before as well."""
    lanes.closed[lane] = lanes.dissipated[lane] + lanes.open[lane] * lost
    lanes.dissipated[lane] = lanes.closed[lane] + 0.5 * h * lost
    lanes.open[lane] = 0.5 * h


@inlined
def _load(lanes: Lanes, first: int, count: int, torque: Array, packed: Array) -> None:
    """States and torques of a pack of lanes side by side, (3, n, WIDTH); places without a running lane repeat
    another.
    """
    n = lanes.q.shape[1]
    spare = first
    for place in range(count):
        if lanes.status[first + place] == RUNNING:
            spare = first + place
    for place in range(WIDTH):
        lane = first + place if place < count and lanes.status[first + place] == RUNNING else spare
        for i in range(n):
            packed[0, i, place] = lanes.q[lane, i]
            packed[1, i, place] = lanes.v[lane, i]
            packed[2, i, place] = torque[lane - first, i]


@inlined
def _store(
    loop: Loop, lanes: Lanes, lane: int, place: int, torque: Array, packed: Array, lost: float, h: float
) -> None:
    """A lane's new state, with its share of work and dissipation."""
    dissipate(lanes, lane, lost, h)
    for j in range(len(loop.drive)):
        lanes.work[lane] -= torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]
    for i in range(lanes.q.shape[1]):
        lanes.q[lane, i] = packed[0, i, place]
        lanes.v[lane, i] = packed[1, i, place]
    for j in range(len(loop.drive)):
        lanes.work[lane] += torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]


@called
def _step(tree: Tree, laws: Laws, scratch: Scratch, state: Array, lost: Array, bend: Array, h: float) -> None:
    """A step of eight lanes: coordinates, rates and torques in `state` (3, n), of vectors.

    `lost` and `bend` (WIDTH,) receive the power dissipated at its start, W, and how much the laws bend along it, rad.
    """
    power = first_stage(tree, laws, scratch, None, 0, state[0], state[1], state[2], h)
    most = second_stage(tree, laws, scratch, None, None, 0, state[0], state[1], state[2], h)
    for place in range(WIDTH):
        lost[place], bend[place] = lane_of(power, place), lane_of(most, place)


@entry
def _run_pack(
    plant: Packed,
    size: int,
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    samples: int,
    first: int,
    count: int,
) -> None:
    """`run` of up to `WIDTH` lanes, with `size` numbers of working memory each; steps that must be divided are, lane by lane."""
    tree, laws = unpack(plant)
    n = lanes.q.shape[1]
    scratch = scratch_in(as_vectors(aligned(size)), n, len(laws.inertia))
    h = loop.period / loop.substeps
    torque, state = np.zeros((count, n)), aligned(3 * n).reshape((3, n, WIDTH))
    lost, bend = np.zeros(WIDTH), np.zeros(WIDTH)
    fine, fine_lost, fine_bend = aligned(3 * n).reshape((3, n, WIDTH)), np.zeros(WIDTH), np.zeros(WIDTH)
    vectors = as_vectors(state.reshape(state.size)).reshape((3, n))
    fine_vectors = as_vectors(fine.reshape(fine.size)).reshape((3, n))
    for k in range(samples):
        running = 0
        for place in range(count):
            if lanes.status[first + place] == RUNNING:
                control(loop, lanes, inputs, logs, first + place, k, torque[place])
            if lanes.status[first + place] == RUNNING:
                running += 1
        if running == 0:
            return
        for part in range(loop.substeps):
            _load(lanes, first, count, torque, state)
            laws.wanted[0] = count
            _step(tree, laws, scratch, vectors, lost, bend, h)
            for place in range(count):
                lane = first + place
                if lanes.status[lane] != RUNNING:
                    continue
                if part == 0 and k % logs.stride == 0:
                    at = logs.row + k // logs.stride
                    logs.dissipated[lane, at] = lanes.dissipated[lane] + lanes.open[lane] * lost[place]
                if not bend[place] > loop.tolerance:
                    _store(loop, lanes, lane, place, torque[place], state, lost[place], h)
                    continue
                laws.wanted[0] = 1
                lanes.divided[lane] += 1
                for _ in range(DIVISION):
                    _load(lanes, lane, 1, torque[place : place + 1], fine)
                    _step(tree, laws, scratch, fine_vectors, fine_lost, fine_bend, h / DIVISION)
                    _store(loop, lanes, lane, 0, torque[place], fine, fine_lost[0], h / DIVISION)


def run(plant: Packed, loop: Loop, lanes: Lanes, inputs: Inputs, logs: Logs, samples: int) -> None:
    """Advance all running lanes by that many samples, eight at a time; every effect has a compiled law."""
    size = scratch_size(int(plant.integers[0]), int(plant.integers[1]))
    for first in range(0, len(lanes.status), WIDTH):
        count = min(WIDTH, len(lanes.status) - first)
        _run_pack(plant, size, loop, lanes, inputs, logs, samples, first, count)
