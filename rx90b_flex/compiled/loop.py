"""The sampling loop: controller and integrator of eight lanes, side by side in vectors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90b_flex.compiled.compile import Array, called, entry, inlined
from rx90b_flex.compiled.controller import RUNNING, Inputs, Lanes, Logs, Loop, control
from rx90b_flex.compiled.laws import Laws
from rx90b_flex.compiled.packed import Packed, unpack
from rx90b_flex.compiled.scratch import Scratch, scratch_in, scratch_size
from rx90b_flex.compiled.step import first_stage, second_stage
from rx90b_flex.compiled.tree import Tree
from rx90b_flex.compiled.vectors import WIDTH, aligned, as_vectors, lane_of
from rx90b_flex.compiled.wide import Wide, deliver, load_room, room_size, show, store_room

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
def _step(
    tree: Tree,
    laws: Laws,
    scratch: Scratch,
    wide: Wide | None,
    room: Array,
    state: Array,
    lost: Array,
    bend: Array,
    h: float,
) -> None:
    """A step of eight lanes: coordinates, rates and torques in `state` (3, n), of vectors.

    `lost` and `bend` (WIDTH,) receive the power dissipated at its start, W, and how much the laws bend along it, rad.
    """
    power = first_stage(tree, laws, scratch, wide, room, None, 0, state[0], state[1], state[2], h)
    most = second_stage(tree, laws, scratch, wide, room, None, None, 0, state[0], state[1], state[2], h)
    for place in range(WIDTH):
        lost[place], bend[place] = lane_of(power, place), lane_of(most, place)


class _Pack(NamedTuple):
    """Working memory of the step of some lanes."""

    numbers: Array  # (3, n, WIDTH) coordinates, rates, torques
    vectors: Array  # (3, n) the same
    lost: Array  # (WIDTH,)
    bend: Array  # (WIDTH,)


@inlined
def _new_pack(n: int) -> _Pack:
    numbers = aligned(3 * n).reshape((3, n, WIDTH))
    vectors = as_vectors(numbers.reshape(numbers.size)).reshape((3, n))
    return _Pack(numbers, vectors, np.zeros(WIDTH), np.zeros(WIDTH))


@inlined
def _divided(
    tree: Tree,
    laws: Laws,
    scratch: Scratch,
    wide: Wide | None,
    room: Array,
    pack: _Pack,
    loop: Loop,
    lanes: Lanes,
    lane: int,
    torque: Array,
    time: float,
    h: float,
) -> None:
    """One lane's step, `DIVISION` short ones in its place; `torque` (1, n)."""
    laws.wanted[0] = 1
    lanes.divided[lane] += 1
    for i in range(DIVISION):
        _load(lanes, lane, 1, torque, pack.numbers)
        if wide is not None:
            load_room(wide, room, lane, 1, time + i * (h / DIVISION))
        _step(tree, laws, scratch, wide, room, pack.vectors, pack.lost, pack.bend, h / DIVISION)
        _store(loop, lanes, lane, 0, torque[0], pack.numbers, pack.lost[0], h / DIVISION)
        if wide is not None:
            store_room(wide, room, lane, 0)


@inlined
def _control_pack(
    between: Wide,
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    k: int,
    first: int,
    torque: Array,
) -> int:
    """A sample of the controllers of lanes from `first` on; `torque` (lanes, n) receives what the motors give. How many still run."""
    running = 0
    for place in range(len(torque)):
        lane = first + place
        if lanes.status[lane] == RUNNING:
            show(between, lanes, lane, inputs.noise[k if inputs.noise.shape[0] > 1 else 0])
            control(loop, lanes, inputs, logs, lane, k, torque[place])
            deliver(between, loop, torque[place])
        if lanes.status[lane] == RUNNING:
            running += 1
    return running


@entry
def _run_pack(
    plant: Packed,
    size: int,
    wide: Wide | None,
    between: Wide,
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
    torque, pack, fine = np.zeros((count, n)), _new_pack(n), _new_pack(n)
    wide_size = 0
    if wide is not None:
        wide_size = room_size(wide, n)
    room, fine_room = aligned(wide_size), aligned(wide_size)
    for k in range(samples):
        if _control_pack(between, loop, lanes, inputs, logs, k, first, torque) == 0:
            return
        for part in range(loop.substeps):
            time = (inputs.first + k) * loop.period + part * h
            _load(lanes, first, count, torque, pack.numbers)
            laws.wanted[0] = count
            if wide is not None:
                load_room(wide, room, first, count, time)
            _step(tree, laws, scratch, wide, room, pack.vectors, pack.lost, pack.bend, h)
            for place in range(count):
                lane = first + place
                if lanes.status[lane] != RUNNING:
                    continue
                if part == 0 and k % logs.stride == 0:
                    at = logs.row + k // logs.stride
                    logs.dissipated[lane, at] = lanes.dissipated[lane] + lanes.open[lane] * pack.lost[place]
                own = torque[place : place + 1]
                if pack.bend[place] > loop.tolerance:
                    _divided(tree, laws, scratch, wide, fine_room, fine, loop, lanes, lane, own, time, h)
                    continue
                _store(loop, lanes, lane, place, own[0], pack.numbers, pack.lost[place], h)
                if wide is not None:
                    store_room(wide, room, lane, place)


def run(
    plant: Packed,
    wide: Wide | None,
    between: Wide,
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    samples: int,
) -> None:
    """Advance all running lanes by that many samples, eight at a time; every effect is a compiled law.

    `wide` are laws of the robot, `between` those between its motors and the controller.
    """
    size = scratch_size(int(plant.integers[0]), int(plant.integers[1]))
    for first in range(0, len(lanes.status), WIDTH):
        count = min(WIDTH, len(lanes.status) - first)
        _run_pack(plant, size, wide, between, loop, lanes, inputs, logs, samples, first, count)
