"""The sampling loop one part of a step at a time, for effects that Python works out in between."""

from __future__ import annotations

from rx90b_flex.compiled.compile import Array, entry, inlined
from rx90b_flex.compiled.controller import RUNNING, Inputs, Lanes, Logs, Loop, control
from rx90b_flex.compiled.laws import Laws
from rx90b_flex.compiled.loop import dissipate
from rx90b_flex.compiled.packed import Packed, unpack
from rx90b_flex.compiled.scratch import Scratch, scratch_in
from rx90b_flex.compiled.step import Extra, begin, evaluate, first_stage, second_stage
from rx90b_flex.compiled.tree import Tree


@inlined
def _begin(
    tree: Tree, laws: Laws, scratch: Scratch, loop: Loop, extra: Extra, lanes: Lanes, lane: int, torque: Array, h: float
) -> None:
    """First stage of a step of one lane, with its share of work and dissipation."""
    q, v = lanes.q[lane], lanes.v[lane]
    begin(scratch, q, v)
    power = evaluate(tree, laws, scratch, None, extra.lost)
    lost = first_stage(tree, laws, scratch, None, extra.lost, extra, lane, q, v, torque, h, power)
    dissipate(lanes, lane, lost, h)
    for j in range(len(loop.drive)):
        lanes.work[lane] -= torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]


@inlined
def _finish(
    tree: Tree,
    laws: Laws,
    scratch: Scratch,
    loop: Loop,
    extra: Extra,
    late: Array,
    lanes: Lanes,
    lane: int,
    torque: Array,
    h: float,
) -> float:
    """Second stage of a step of one lane."""
    evaluate(tree, laws, scratch, None, extra.lost)
    bend = second_stage(
        tree, laws, scratch, None, extra.lost, extra, late, lane, lanes.q[lane], lanes.v[lane], torque, h
    )
    for j in range(len(loop.drive)):
        lanes.work[lane] += torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]
    return bend


@entry
def control_all(loop: Loop, lanes: Lanes, inputs: Inputs, logs: Logs, k: int, torque: Array) -> None:
    """`control` of all running lanes; `torque` (lanes, n)."""
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            control(loop, lanes, inputs, logs, lane, k, torque[lane])


@entry
def begin_all(
    plant: Packed, memory: Array, loop: Loop, extra: Extra, lanes: Lanes, torque: Array, h: float, q: Array, v: Array
) -> None:
    """First stage of all running lanes; `q`, `v` and `lanes.a` receive the points where the second stage wants its
    forces.
    """
    tree, laws = unpack(plant)
    n = lanes.q.shape[1]
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            scratch = scratch_in(memory[lane], n, len(laws.inertia))
            _begin(tree, laws, scratch, loop, extra, lanes, lane, torque[lane], h)
            q[lane], v[lane], lanes.a[lane] = scratch.q, scratch.v, scratch.a


@entry
def finish_all(
    plant: Packed, memory: Array, loop: Loop, extra: Extra, late: Array, lanes: Lanes, torque: Array, h: float
) -> float:
    """Second stage of all running lanes; returns the largest bend."""
    tree, laws = unpack(plant)
    bend = 0.0
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            scratch = scratch_in(memory[lane], lanes.q.shape[1], len(laws.inertia))
            bend = max(bend, _finish(tree, laws, scratch, loop, extra, late, lanes, lane, torque[lane], h))
    return bend
