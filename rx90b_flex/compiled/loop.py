"""The sampling loop: controller and integrator of one lane, or of eight side by side in vectors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, counted, entry, inlined
from rx90b_flex.compiled.controller import RUNNING, Inputs, Lanes, Logs, Loop, control
from rx90b_flex.compiled.laws import Laws
from rx90b_flex.compiled.packed import LAWS, Packed, unpack
from rx90b_flex.compiled.scratch import Scratch, scratch_in, scratch_size
from rx90b_flex.compiled.step import begin, evaluate, first_stage, second_stage
from rx90b_flex.compiled.tree import Tree
from rx90b_flex.compiled.vectors import aligned, part_of, seen_as, spread, width_of, working_memory
from rx90b_flex.compiled.wide import Wide, deliver, load_room, room_size, show, store_room

# Parts of a step along which the laws bend too much. In them the Jacobian holds a law's chord to standstill where that is steeper
# than its tangent: dry friction's is flat beside its reversal, and throws a joint that should come to rest to and fro.
DIVISION = 8
FEW = 2  # up to so many lanes are quicker one after the other than as a vector


@inlined
def dissipate(lanes: Lanes, lane: int, lost: float, h: float) -> None:
    """Count the power that is lost at a step's start: by the trapezoidal rule it closes the step before as well."""
    lanes.closed[lane] = lanes.dissipated[lane] + lanes.open[lane] * lost
    lanes.dissipated[lane] = lanes.closed[lane] + 0.5 * h * lost
    lanes.open[lane] = 0.5 * h


@inlined
def _load(lanes: Lanes, pack: Integers, torque: Array, packed: Array) -> None:
    """States and torques (lanes, n) of a pack of lanes side by side, (3, n, width); places beyond it repeat its last one."""
    for place in range(packed.shape[2]):
        lane = pack[min(place, len(pack) - 1)]
        for i in range(packed.shape[1]):
            packed[0, i, place] = lanes.q[lane, i]
            packed[1, i, place] = lanes.v[lane, i]
            packed[2, i, place] = torque[lane, i]


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


@inlined
def _step(
    tree: Tree, laws: Laws, s: Scratch, wide: Wide | None, room: Array, state: Array, lost: Array, bend: Array, h: float
) -> None:
    """A step of one lane or eight: coordinates, rates and torques in `state` (3, n), of numbers or vectors.

    `lost` and `bend` (width,) receive the power dissipated at its start, W, and how much the laws bend along it, rad.
    """
    q, v, torque = state[0], state[1], state[2]
    begin(s, q, v)
    for stage in range(2):  # a loop, since what both evaluate is long code
        power = evaluate(tree, laws, s, wide, room)
        if stage == 0:
            spread(first_stage(tree, laws, s, wide, room, None, 0, q, v, torque, h, power), lost)
            laws.wanted[1] = 0  # the slopes are those of the first stage
        else:
            spread(second_stage(tree, laws, s, wide, room, None, None, 0, q, v, torque, h), bend)


class _Pack(NamedTuple):
    """Working memory of the step of some lanes."""

    numbers: Array  # (3, n, width) coordinates, rates, torques
    vectors: Array  # (3, n) the same
    lost: Array  # (width,)
    bend: Array  # (width,)


@counted
def _new_pack(n: int, like: Array) -> _Pack:
    width = width_of(like)
    numbers = aligned(3 * n)
    return _Pack(
        part_of(numbers, 0, (3, n, width)), part_of(seen_as(numbers, like), 0, (3, n)), np.zeros(width), np.zeros(width)
    )


@inlined
def _control_lanes(
    between: Wide | None, loop: Loop, lanes: Lanes, inputs: Inputs, logs: Logs, k: int, torque: Array, running: Integers
) -> int:
    """A sample of the lanes' controllers; `torque` (lanes, n) receives what the motors give. How many `running` ones there are."""
    count = 0
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            if between is not None:
                show(between, lanes, lane, inputs.noise[k if inputs.noise.shape[0] > 1 else 0])
            control(loop, lanes, inputs, logs, lane, k, torque[lane])
            if between is not None:
                deliver(between, loop, torque[lane])
        if lanes.status[lane] == RUNNING:
            running[count] = lane
            count += 1
    return count


@entry
def _run(
    plant: Packed,
    memory: int,
    torque: Array,
    chosen: Integers,
    alone: bool | None,
    wide: Wide | None,
    between: Wide | None,
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    samples: int,
) -> None:
    """`run` by `memory` vectors of working memory, eight lanes at a time, or by numbers where lanes are `alone`.

    `torque` (lanes, n) is for what the motors give; `chosen` (2 lanes,) for lanes that take a step, and behind them those that must
    divide it.
    """
    tree, laws = unpack(plant)
    n = lanes.q.shape[1]
    # made here, so that the compiler sees that nothing else writes to it
    scratch = scratch_in(working_memory(memory, alone), n, len(laws.inertia))
    pack, wide_size = _new_pack(n, scratch.a), 0
    if wide is not None:
        wide_size = room_size(wide, n)
    room, width = aligned(wide_size), len(pack.lost)
    period = loop.period / loop.substeps
    for k in range(samples):
        running = _control_lanes(between, loop, lanes, inputs, logs, k, torque, chosen)
        if running == 0:
            return
        for part in range(loop.substeps):
            logged = part == 0 and k % logs.stride == 0
            # all lanes, then `DIVISION` short steps of those whose laws bend too much; one loop, since the step is long code
            begin, end, rough = 0, running, 0
            for turn in range(1 + DIVISION):
                h, at = period, (inputs.first + k) * loop.period + part * period
                if turn > 0:
                    begin, end, h = running, running + rough, period / DIVISION
                    at += (turn - 1) * h
                for start in range(begin, end, width):
                    together = chosen[start : min(start + width, end)]
                    laws.wanted[0], laws.wanted[1] = len(together), turn > 0
                    _load(lanes, together, torque, pack.numbers)
                    if wide is not None:
                        load_room(wide, room, width, together, at)
                    _step(tree, laws, scratch, wide, room, pack.vectors, pack.lost, pack.bend, h)
                    for place in range(len(together)):
                        lane = together[place]
                        if turn == 0 and logged:
                            row = logs.row + k // logs.stride
                            logs.dissipated[lane, row] = lanes.dissipated[lane] + lanes.open[lane] * pack.lost[place]
                        if turn == 0 and pack.bend[place] > loop.tolerance:
                            chosen[running + rough] = lane
                            rough += 1
                            lanes.divided[lane] += 1
                            continue
                        _store(loop, lanes, lane, place, torque[lane], pack.numbers, pack.lost[place], h)
                        if wide is not None:
                            store_room(wide, room, width, lane, place)


def run(
    plant: Packed,
    wide: Wide | None,
    between: Wide | None,
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    samples: int,
) -> None:
    """Advance all running lanes by that many samples, eight at a time, or a few one by one; every effect is a compiled law.

    `wide` are laws of the robot, `between` those between its motors and the controller; None where there are none.
    """
    count, n = lanes.q.shape
    alone = True if count <= FEW else None  # vectors are not even compiled then
    memory, chosen = scratch_size(n, int(plant.integers[LAWS])), np.zeros(2 * count, dtype=np.int64)
    _run(plant, memory, np.zeros((count, n)), chosen, alone, wide, between, loop, lanes, inputs, logs, samples)
