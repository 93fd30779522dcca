"""The perturbation method: controller and robot for all lanes.

Lanes stand in the columns: a step of all of them is one product of matrices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90b_flex.compiled.about_mean import Ports, Steps
from rx90b_flex.compiled.compile import Array, Integers, entry, inlined
from rx90b_flex.compiled.controller import RUNNING, Inputs, Lanes, Logs, Loop, check, command, joint_in_loop
from rx90b_flex.compiled.laws import Laws, ask
from rx90b_flex.compiled.linear import product
from rx90b_flex.compiled.rate_table import LARGEST, from_table

NEWTON = 30  # iterations for one rate; one is usual, more where a joint sticks


class Perturbed(NamedTuple):
    """State of all lanes about the nominal motion."""

    y: Array  # (2 n + joints, lanes) dq', dq, drive torque
    middle: Array  # (n, lanes) dq' in the middle of a step
    torques: Array  # (ports, lanes) N m, of the step before
    angle: Array  # (joints, lanes) rad, of the drives at the sample before


@inlined
def port_torque(laws: Laws, ports: Ports, p: int, x: float, rate: float, half: float) -> tuple[float, float]:
    """Torque of the laws at port p, and its slope by the rate in the middle of a step, with which the angle moves by half a step."""
    torque, slope = 0.0, 0.0
    for place in range(ports.start[p], ports.start[p + 1]):
        own, by_x, by_rate = ask(laws, ports.law[place], x + half * rate, rate)
        torque += own
        slope += by_rate + half * by_x
    return torque, slope


@inlined
def _newton(
    rate: float, torque: float, slope: float, target: float, gain: float, bracket: tuple[float, float]
) -> tuple[float, bool, tuple[float, float]]:
    """Next guess of the rate with ``rate + gain * torque(rate) = target``, and whether it is near enough to be the last.

    Newton's method; where friction's steep reversal throws it out of the interval known to hold the root (`bracket`, (low, high)),
    halving.
    """
    low, high = bracket
    miss = rate + gain * torque - target
    if miss > 0.0:
        high = rate
    else:
        low = rate
    new = rate - miss / max(1.0 + gain * slope, 0.1)
    near = abs(new - rate) <= 0.01 * abs(rate) + 1e-6
    if new <= low or new >= high:
        near = not (np.isfinite(low) and np.isfinite(high))
        new = rate if near else 0.5 * (low + high)
    return new, near, (low, high)


@inlined
def _solve_by_table(table: Array, guess: float, target: float, gain: float) -> float:
    """The torque at the rate with ``rate + gain * torque(rate) = target``; not a number where a rate is beyond the table."""
    rate, bracket = guess, (-np.inf, np.inf)
    torque = np.nan
    for _ in range(NEWTON):
        if not abs(rate) < LARGEST:
            return np.nan
        torque, slope = from_table(table, rate)
        new, near, bracket = _newton(rate, torque, slope, target, gain, bracket)
        if near:
            return torque + slope * (new - rate)
        rate = new
    return torque


@inlined
def _solve_by_laws(
    laws: Laws, ports: Ports, p: int, x: float, guess: float, target: float, gain: float, half: float
) -> float:
    """The same with ``torque(x + half * rate, rate)`` from the laws themselves."""
    rate, bracket = guess, (-np.inf, np.inf)
    torque = 0.0
    for _ in range(NEWTON):
        torque, slope = port_torque(laws, ports, p, x, rate, half)
        new, near, bracket = _newton(rate, torque, slope, target, gain, bracket)
        if near:
            return torque + slope * (new - rate)
        rate = new
    return torque


@inlined
def _rub(
    laws: Laws,
    ports: Ports,
    steps: Steps,
    at: int,
    h: float,
    y: Array,
    middle: Array,
    torques: Array,
    memory: tuple[Array, Array, Array],
    running: Integers,
) -> None:
    """Correct the rates in the middle of a step for the exact laws of each lane.

    `torques` (ports, lanes) of the step before are a first guess that couples the ports; then each port in turn.
    `memory` is three arrays of a number a lane.
    """
    n, count = middle.shape
    number = torques.shape[0]
    target, angle, change = memory
    vector, push, gains = ports.vector, steps.push[at], steps.gain[at]
    port_x, port_rate = steps.port_x[at], steps.port_rate[at]
    for p in range(number):
        for i in range(n):
            each = push[i, p]
            for c in range(count):
                middle[i, c] -= each * torques[p, c]
    for p in range(number):
        tabulated, table, gain, nominal = ports.tabulated[p], ports.table[p], gains[p, p], port_rate[p]
        # the angle at the step's start; half a step of the rate is added to it
        x = port_x[p] - 0.5 * h * nominal
        for c in range(count):
            target[c], angle[c] = nominal, x
        for i in range(n):
            weight = vector[i, p]
            if weight != 0.0:
                for c in range(count):
                    target[c] += weight * middle[i, c]
                if not tabulated:
                    for c in range(count):
                        angle[c] += weight * y[n + i, c]
        if tabulated:
            for c in range(count):
                torque = _solve_by_table(table, target[c], target[c] + gain * torques[p, c], gain)
                change[c] = torque - torques[p, c]
        for c in range(count):
            if running[c] != RUNNING:
                change[c] = 0.0
            elif not tabulated or not np.isfinite(change[c]):
                right = target[c] + gain * torques[p, c]
                change[c] = _solve_by_laws(laws, ports, p, angle[c], target[c], right, gain, 0.5 * h) - torques[p, c]
        for c in range(count):
            torques[p, c] += change[c]
        for i in range(n):
            each = push[i, p]
            for c in range(count):
                middle[i, c] -= each * change[c]


@inlined
def _control_lanes(
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    j: int,
    k: int,
    angle: Array,
    speed: Array,
    torque: Array,
    wrong: Integers,
) -> None:
    """`control` of joint j for all lanes, whose drive angles and speeds are (lanes,); its torques go to `torque`.

    `wrong` (lanes,) is set where something must be looked at.
    """
    joint = joint_in_loop(loop, j)
    lower, upper, fastest, longest = loop.lower[j], loop.upper[j], loop.speed[j], loop.overload_samples
    row, part = k // inputs.up, (k % inputs.up) / inputs.up
    start, end = inputs.feedforward[row, j], inputs.feedforward[row + 1, j]
    references, rates = inputs.position[k, j], inputs.velocity[k, j]
    apart = 1 if len(references) > 1 else 0
    noise = inputs.noise[k if inputs.noise.shape[0] > 1 else 0]
    seen_angle, seen_speed, seen_torque = logs.measured[k, 0, j], logs.measured[k, 1, j], logs.measured[k, 2, j]
    integral, current, held, counts = lanes.integral[j], lanes.current[j], lanes.held[j], lanes.overloaded[j]
    for c in range(len(angle)):
        a, v = angle[c] + noise[0, j, c], speed[c] + noise[1, j, c]
        forward = start[c] + part * (end[c] - start[c])
        reference, rate = references[apart * c], rates[apart * c]
        a, v, whole, now, mean, limited = command(
            joint, loop.filters, lanes.filtered, j, c, a, v, reference, rate, forward, integral[c], current[c]
        )
        seen_angle[c], seen_speed[c], seen_torque[c] = a, v, 0.5 * (held[c] + mean)
        integral[c], current[c], held[c], torque[c] = whole, now, mean, mean
        counts[c] = counts[c] + 1 if limited else 0
        # not a number is not inside either
        inside = (abs(speed[c]) <= fastest) & (angle[c] >= lower) & (angle[c] <= upper) & (counts[c] < longest)
        wrong[c] += 0 if inside else 1


@inlined
def _stop(loop: Loop, lanes: Lanes, steps: Steps, y: Array, at: int, sample: int, wrong: Integers) -> None:
    """Look at the lanes where something is wrong, or whose reference jumps here."""
    n = steps.q.shape[1]
    for c in range(len(wrong)):
        if lanes.status[c] == RUNNING and (wrong[c] != 0 or sample >= lanes.stop[c, 0]):
            for i in range(n):
                lanes.v[c, i], lanes.q[c, i] = steps.v[at, i] + y[i, c], steps.q[at, i] + y[n + i, c]
            check(loop, lanes, c, sample)
        wrong[c] = 0


@inlined
def _log_states(lanes: Lanes, logs: Logs, steps: Steps, y: Array, at: int) -> None:
    q, v, work, log_q, log_v, log_work, status = lanes.q, lanes.v, lanes.work, logs.q, logs.v, logs.work, lanes.status
    n, row = steps.q.shape[1], logs.row + at // logs.stride
    for c in range(len(work)):
        if status[c] == RUNNING:
            for i in range(n):
                q[c, i], v[c, i] = steps.q[at, i] + y[n + i, c], steps.v[at, i] + y[i, c]
                log_q[c, row, i], log_v[c, row, i] = q[c, i], v[c, i]
            log_work[c, row] = work[c]


@entry
def advance(
    laws: Laws,
    ports: Ports,
    loop: Loop,
    lanes: Lanes,
    inputs: Inputs,
    logs: Logs,
    steps: Steps,
    state: Perturbed,
    samples: int,
) -> None:
    """Controller and robot for that many samples, all lanes."""
    y, middle, torques, last = state.y, state.middle, state.torques, state.angle
    n, number = middle.shape
    h, joints = loop.period, len(loop.drive)
    target, angle, speed = np.zeros(number), np.zeros(number), np.zeros(number)
    wrong = np.zeros(number, dtype=np.int64)
    work, status, first_stop = lanes.work, lanes.status, lanes.stop[:, 0].min()
    for at in range(samples):
        for j in range(joints):
            i = loop.drive[j]
            nominal_angle, nominal_speed, pull = steps.q[at, i], steps.v[at, i], y[2 * n + j]
            for c in range(number):
                angle[c], speed[c] = nominal_angle + y[n + i, c], nominal_speed + y[i, c]
                work[c] += pull[c] * (angle[c] - last[j, c]) if status[c] == RUNNING else 0.0
                last[j, c] = angle[c]
            _control_lanes(loop, lanes, inputs, logs, j, at, angle, speed, pull, wrong)
        if at % logs.stride == 0:
            _log_states(lanes, logs, steps, y, at)
        if wrong.any() or inputs.first + at >= first_stop:
            _stop(loop, lanes, steps, y, at, inputs.first + at, wrong)
            if status.all():
                return
        product(steps.move[at], y, steps.shift[at], middle)
        _rub(laws, ports, steps, at, h, y, middle, torques, (target, angle, speed), status)
        for i in range(n):
            for c in range(number):
                y[i, c] = 2.0 * middle[i, c] - y[i, c]
                y[n + i, c] += h * middle[i, c]
