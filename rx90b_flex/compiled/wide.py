"""Laws that know more than one angle and its rate: time, the load of their joint, another joint's angle, what they remember;
and laws that are no torque: of the links' angle behind a gear, of what a resolver shows, of what a motor gives.

In the sampling loop; laws are asked lane by lane. The load L depends on the acceleration, so that a law T(L) is taken
as ``T(L_0) + dT/dL (L - L_0)`` about the load at the acceleration of the step before, which makes it part of the mass matrix.

Such a law, or one that acts elsewhere than where it reads, leans: its part ``p u'`` of the system of a step is not symmetric. The
rest of the system is factored as ever, and each of these parts is put in by the formula of Sherman and Morrison.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, called, counted, inlined
from rx90b_flex.compiled.controller import Lanes, Loop
from rx90b_flex.compiled.laws import call_law
from rx90b_flex.compiled.linear import factor, solve
from rx90b_flex.compiled.scratch import Scratch
from rx90b_flex.compiled.tree import Tree, inverse_dynamics
from rx90b_flex.compiled.vectors import seen_as, width_of

KIND, ADDRESS, STORES, SLOT, LOADED, REMEMBERS, DRIVE, LEANS = range(8)  # rows of `whole`
ROWS = 8
FORCE, LINKS, MEASURED, MOTOR = range(4)  # kinds
ON, BY = 0, 1  # combination that a law acts on, and the one that it reads
LINKS_LOAD, BY_X, BY_RATE, BY_LOAD, SHARE = range(5)  # of `slopes`
Q, V, A, RATIO = range(4)  # of `links`
X, RATE, LOAD, ASKED = 0, 1, 2, 3  # where a law is asked: three vectors, then torque and slopes by x, rate and load
EXCHANGE = 7
SIZES = 4  # integers before the arrays


class Wide(NamedTuple):
    """The laws of all lanes in flat arrays."""

    integers: Integers  # number of laws, width of combinations, length of parameters, of memory; then `whole`, `place`
    numbers: Array  # s, at the start of the step; then `weight`, `parameters`, what a law writes
    memory: Array  # (lanes, m * memory + n) of the step before: x and what is remembered, law by law; accelerations


class WideView(NamedTuple):
    """The same as arrays, with the working memory of a step, which is of vectors."""

    whole: Integers  # (ROWS, m) kind, address, whether it stores, where in its parameters the time stands, coordinate whose load it
    # reads (-1: none), how many numbers it remembers, number of its drive, whether it leans
    place: Integers  # (2, m, w) coordinates of its combinations
    weight: Array  # (2, m, w)
    time: Array  # (1,)
    before: Array  # (n,) accelerations of the step before
    after: Array  # (n,) of this one
    row: Array  # (m, n) u; before, the row of the links' mass matrix of the coordinate whose load the law reads
    push: Array  # (m, n) what p does to the accelerations
    slopes: Array  # (5, m) the links' torque on that coordinate; slopes by x, rate and load; 1 / (1 + u' push)
    links: Array  # (4, n) the links' coordinates, rates, accelerations, and how fast they turn with the motors
    exchange: Array  # (EXCHANGE,)


def pack_wide(whole: Integers, place: Integers, weight: Array, parameters: Array, memory: Array, n: int) -> Wide:
    """Flat arrays of m laws; `memory` (lanes, m, k) at the start of a run on n coordinates."""
    sizes = np.array([whole.shape[1], place.shape[2], parameters.shape[1], memory.shape[2]], dtype=np.int64)
    integers = np.concatenate([sizes, whole.ravel(), place.ravel()])
    numbers = np.concatenate([np.zeros(1), weight.ravel(), parameters.ravel(), np.zeros(3 + memory.shape[2])])
    return Wide(integers, numbers, np.hstack([memory.reshape(len(memory), -1), np.zeros((len(memory), n))]))


@inlined
def room_size(wide: Wide, n: int) -> int:
    """Vectors that `view` needs for n coordinates: twice what is kept from step to step, and once more what is remembered."""
    m = wide.integers[0]
    return 3 * wide.memory.shape[1] + (2 * m + 4) * n + 5 * m + EXCHANGE


@counted
def view(wide: Wide, room: Array, like: Array) -> WideView:
    """The laws with working memory in `room` (numbers of `room_size` vectors, or of as many numbers), of what `like` (n,) is of."""
    m, w, n = wide.integers[0], wide.integers[1], len(like)
    place_from = SIZES + ROWS * m
    kept = wide.memory.shape[1]
    vectors = seen_as(room, like)
    row_from = 3 * kept
    push_from = row_from + m * n
    slopes_from = push_from + m * n
    links_from = slopes_from + 5 * m
    exchange_from = links_from + 4 * n
    return WideView(
        whole=wide.integers[SIZES:place_from].reshape((ROWS, m)),
        place=wide.integers[place_from:].reshape((2, m, w)),
        weight=wide.numbers[1 : 1 + 2 * m * w].reshape((2, m, w)),
        time=wide.numbers[:1],
        before=vectors[kept - n : kept],
        after=vectors[2 * kept - n : 2 * kept],
        row=vectors[row_from:push_from].reshape((m, n)),
        push=vectors[push_from:slopes_from].reshape((m, n)),
        slopes=vectors[slopes_from:links_from].reshape((5, m)),
        links=vectors[links_from:exchange_from].reshape((4, n)),
        exchange=vectors[exchange_from : exchange_from + EXCHANGE],
    )


@called
def _ask(wide: Wide, room: Array, side: int, n: int, m: int, lanes: int, time: float, stage: int) -> None:
    """Ask law m for lanes, `side` of which lie side by side: from x, rate and load in the exchange to its torque and slopes there.

    What it remembers goes from the first (stage 0) or second (1) block of the room to the next one.
    """
    integers, numbers = wide.integers, wide.numbers
    count, width, length, remembered = integers[0], integers[1], integers[2], integers[3]
    address, slot, remembers = (
        integers[SIZES + ADDRESS * count + m],
        integers[SIZES + SLOT * count + m],
        integers[SIZES + REMEMBERS * count + m],
    )
    row_from = 1 + 2 * count * width + m * length
    parameters, out = numbers[row_from : row_from + length], numbers[1 + count * (2 * width + length) :]
    exchange = room[side * (room_size(wide, n) - EXCHANGE) :]
    kept = room[side * (stage * wide.memory.shape[1] + m * remembered) :]
    onward = room[side * ((stage + 1) * wide.memory.shape[1] + m * remembered) :]
    parameters[slot] = time
    out[3] = 0.0
    for lane in range(lanes):
        x = exchange[side * X + lane]
        parameters[slot + 1] = exchange[side * LOAD + lane]
        for i in range(1 + remembers):
            parameters[slot + 2 + i] = kept[side * i + lane]
        call_law(address, x, exchange[side * RATE + lane], parameters, out)
        for i in range(4):
            exchange[side * (ASKED + i) + lane] = out[i]
        onward[lane] = x
        for i in range(remembers):
            onward[side * (1 + i) + lane] = out[4 + i]


# ---- within a step ---------------------------------------------------------------------------------------------


@inlined
def _along(w: WideView, which: int, m: int, x: Array) -> Any:
    """The combination of x that law m acts on or reads."""
    total = w.weight[which, m, 0] * x[w.place[which, m, 0]]
    for i in range(1, w.place.shape[2]):
        total += w.weight[which, m, i] * x[w.place[which, m, i]]
    return total


@inlined
def _act(w: WideView, m: int, torque: Any, out: Array) -> None:
    for i in range(w.place.shape[2]):
        out[w.place[ON, m, i]] += w.weight[ON, m, i] * torque


@called
def links_torques(
    tree: Tree, s: Scratch, wide: Wide, room: Array, w: WideView, lanes: int, q: Array, v: Array, a: Array
) -> None:
    """Generalised forces that the links need where they are behind their gears, and what of them laws read."""
    links, found = w.links, w.exchange
    for i in range(len(q)):
        links[Q, i], links[V, i], links[A, i], links[RATIO, i] = q[i], v[i], a[i], 0.0 * q[i] + 1.0
    for m in range(w.whole.shape[1]):
        if w.whole[KIND, m] == LINKS:
            i = w.place[ON, m, 0]
            found[X], found[RATE] = q[i], v[i]
            _ask(wide, room, width_of(q), len(q), m, lanes, 0.0, 1)
            slope, curvature = found[ASKED + 1], found[ASKED + 2]
            links[Q, i] += found[ASKED]
            links[V, i] += slope * v[i]
            links[A, i] += slope * a[i] + curvature * v[i] * v[i]
            links[RATIO, i] += slope
    inverse_dynamics(tree, s, links[Q], links[V], links[A], s.generalised)
    for i in range(len(q)):
        s.generalised[i] *= links[RATIO, i]
    for m in range(w.whole.shape[1]):
        if w.whole[LOADED, m] >= 0:
            w.slopes[LINKS_LOAD, m] = s.generalised[w.whole[LOADED, m]]


@inlined
def first_forces(s: Scratch, wide: Wide, room: Array, w: WideView, lanes: int, q: Array, v: Array) -> Any:
    """Bring the links' mass matrix to the motors and add the laws' forces without their part by accelerations.

    Returns the power that they dissipate, W.
    """
    n, lost, found = len(q), 0.0 * q[0], w.exchange
    for i in range(n):
        for k in range(i, n):
            s.system[i, k] *= w.links[RATIO, i] * w.links[RATIO, k]
    for m in range(w.whole.shape[1]):
        if w.whole[KIND, m] != FORCE:
            continue
        p, moved = w.whole[LOADED, m], 0.0 * q[0]
        found[X], found[RATE] = _along(w, BY, m, q), _along(w, BY, m, v)
        if p >= 0:
            for i in range(n):
                w.row[m, i] = s.system[p, i] if i >= p else s.system[i, p]
                moved += w.row[m, i] * w.before[i]
            found[LOAD] = w.slopes[LINKS_LOAD, m] + moved
        _ask(wide, room, width_of(q), n, m, lanes, w.time[0], 0)
        torque = found[ASKED]
        for i in range(BY_X, BY_LOAD + 1):
            w.slopes[i, m] = found[ASKED + i]
        _act(w, m, torque - w.slopes[BY_LOAD, m] * moved, s.generalised)
        if not w.whole[STORES, m]:
            lost += torque * _along(w, ON, m, v)
    return lost


@inlined
def first_system(s: Scratch, partner: Integers, w: WideView, gh: float, h: float, v: Array) -> None:
    """The laws' part of the system of a step, which it factors, and of its right side."""
    n = len(s.system)
    for m in range(w.whole.shape[1]):
        if w.whole[KIND, m] != FORCE:
            continue
        _act(w, m, -gh * h * w.slopes[BY_X, m] * _along(w, BY, m, v), s.right)
        value = gh * (w.slopes[BY_RATE, m] + gh * w.slopes[BY_X, m])
        if w.whole[LEANS, m]:
            loaded = w.whole[LOADED, m] >= 0
            for i in range(n):
                w.row[m, i] = w.slopes[BY_LOAD, m] * w.row[m, i] if loaded else 0.0 * value
            for a in range(w.place.shape[2]):
                w.row[m, w.place[BY, m, a]] += w.weight[BY, m, a] * value
            continue
        for a in range(w.place.shape[2]):
            for b in range(w.place.shape[2]):
                r, c = w.place[ON, m, a], w.place[ON, m, b]
                if r <= c:
                    s.system[r, c] += w.weight[ON, m, a] * w.weight[ON, m, b] * value
    factor(s.system, partner)
    for m in range(w.whole.shape[1]):
        if w.whole[LEANS, m]:
            for i in range(n):
                w.push[m, i] = 0.0 * gh
            for a in range(w.place.shape[2]):
                w.push[m, w.place[ON, m, a]] += w.weight[ON, m, a]
            solve_leaning(s, partner, w, w.push[m], m)
            total = w.row[m, 0] * w.push[m, 0]
            for i in range(1, n):
                total += w.row[m, i] * w.push[m, i]
            w.slopes[SHARE, m] = 1.0 / (1.0 + total)


@called
def solve_leaning(s: Scratch, partner: Integers, w: WideView, x: Array, laws: int) -> None:
    """Solve with the system of a step and the first of the laws that lean, in place."""
    solve(s.system, partner, x)
    n = len(x)
    for m in range(laws):
        if w.whole[LEANS, m]:
            total = w.row[m, 0] * x[0]
            for i in range(1, n):
                total += w.row[m, i] * x[i]
            total *= w.slopes[SHARE, m]
            for i in range(n):
                x[i] -= w.push[m, i] * total


@inlined
def second_forces(s: Scratch, wide: Wide, room: Array, w: WideView, lanes: int, h: float) -> None:
    """Add the laws' forces at y + k_1."""
    found = w.exchange
    for m in range(w.whole.shape[1]):
        if w.whole[KIND, m] == FORCE:
            found[X], found[RATE] = _along(w, BY, m, s.q), _along(w, BY, m, s.v)
            found[LOAD] = w.slopes[LINKS_LOAD, m]
            _ask(wide, room, width_of(s.q), len(s.q), m, lanes, w.time[0] + h, 1)
            _act(w, m, found[ASKED], s.generalised)
    for i in range(len(s.q)):
        w.after[i] = s.a[i]


@inlined
def second_system(s: Scratch, partner: Integers, w: WideView, gh: float) -> None:
    """The laws' part of the right side, and its solution."""
    for m in range(w.whole.shape[1]):
        if w.whole[KIND, m] == FORCE:
            rate, x = _along(w, BY, m, s.k_v), _along(w, BY, m, s.q)
            _act(w, m, gh * (w.slopes[BY_RATE, m] * rate + w.slopes[BY_X, m] * (gh * rate - x)), s.right)
    solve_leaning(s, partner, w, s.right, w.whole.shape[1])


# ---- between steps ---------------------------------------------------------------------------------------------


@inlined
def load_room(wide: Wide, room: Array, side: int, pack: Integers, time: float) -> None:
    """What a pack of lanes keeps from the step before, `side` of them side by side."""
    wide.numbers[0] = time
    for place in range(len(pack)):
        for i in range(wide.memory.shape[1]):
            room[side * i + place] = wide.memory[pack[place], i]


@inlined
def store_room(wide: Wide, room: Array, side: int, lane: int, place: int) -> None:
    """What a lane keeps at the end of its step."""
    kept = wide.memory.shape[1]
    for i in range(kept):
        wide.memory[lane, i] = room[side * (kept + i) + place]


@called
def _at_once(wide: Wide, m: int, x: float, rate: float) -> tuple[float, float]:
    """What law m, which is no torque, writes first."""
    count, width, length = wide.integers[0], wide.integers[1], wide.integers[2]
    parameters, out = (
        wide.numbers[1 + 2 * count * width + m * length :],
        wide.numbers[1 + count * (2 * width + length) :],
    )
    call_law(wide.integers[SIZES + ADDRESS * count + m], x, rate, parameters, out)
    return out[0], out[1]


@called
def show(wide: Wide, lanes: Lanes, lane: int, noise: Array) -> None:
    """Add what the resolvers show beyond a lane's angles and speeds to `noise` (2, joints, lanes)."""
    count = wide.integers[0]
    for m in range(count):
        if wide.integers[SIZES + KIND * count + m] == MEASURED:
            i, j = wide.integers[SIZES + ROWS * count + m * wide.integers[1]], wide.integers[SIZES + DRIVE * count + m]
            more, slope = _at_once(wide, m, lanes.q[lane, i], lanes.v[lane, i])
            noise[0, j, lane] += more
            noise[1, j, lane] += slope * lanes.v[lane, i]


@called
def deliver(wide: Wide, loop: Loop, torque: Array) -> None:
    """Torques (n,) that the motors give, in place of those that they were asked for."""
    count = wide.integers[0]
    for m in range(count):
        if wide.integers[SIZES + KIND * count + m] == MOTOR:
            i = loop.drive[wide.integers[SIZES + DRIVE * count + m]]
            torque[i] += _at_once(wide, m, torque[i], 0.0)[0]
