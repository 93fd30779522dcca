"""Compiled sampling loop: controller, current loop, checks and log around the integrator, for lanes of runs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.kernels import Integers, compiled, first_stage, scratch_in, second_stage

DIVISION = 8
RUNNING, OVERLOAD, ANGLE_LIMIT, OVERSPEED, DIVERGED, JUMP = range(6)


class Loop(NamedTuple):
    """The controller in numbers, one a joint unless said otherwise."""

    drive: Integers  # (joints,) coordinate of each drive
    period: float  # s
    substeps: int  # steps of the integrator a period
    tolerance: float  # rad; a step along which the laws bend more is divided
    position_gain: Array  # N m/rad
    velocity_gain: Array  # N m s/rad
    integral_gain: Array  # N m/(rad s)
    position_step: Array  # rad, 0 for no quantisation
    velocity_step: Array  # rad/s
    torque_step: Array  # N m
    torque_limit: Array  # N m
    current_mean: float  # share of the old current in the mean of a sample; 0 for an ideal current loop
    current_left: float  # what is left of the old current at the sample's end
    overload_samples: int
    lower: Array  # rad
    upper: Array  # rad
    speed: Array  # rad/s


class Lanes(NamedTuple):
    """State of all lanes between two samples."""

    q: Array  # (lanes, n)
    v: Array  # (lanes, n)
    a: Array  # (lanes, n) of the last stage, where effects ask for it
    integral: Array  # (lanes, joints) N m
    current: Array  # (lanes, joints) N m, behind the current loop, now
    held: Array  # (lanes, joints) N m, mean over the sample
    overloaded: Integers  # (lanes, joints) samples at the limit without a break
    open: Array  # (lanes,) s, half the last step: what its end still adds to the dissipation, per W
    work: Array  # (lanes,) J
    dissipated: Array  # (lanes,) J
    status: Integers  # (lanes,)
    joint: Integers  # (lanes,) where a lane ended
    sample: Integers  # (lanes,) when
    divided: Integers  # (lanes,) steps that were taken in `DIVISION` parts
    stop: Integers  # (lanes, 2) sample at which a lane's reference jumps, and the joint


class Inputs(NamedTuple):
    """A chunk of inputs at the controller's rate."""

    first: int  # number of the chunk's first sample
    position: Array  # (lanes, samples, joints) rad, reference
    velocity: Array  # (lanes, samples, joints) rad/s, reference
    feedforward: Array  # (lanes, samples, joints) N m
    position_noise: Array  # (lanes, samples, joints) rad; no samples where there is none
    velocity_noise: Array  # (lanes, samples, joints) rad/s


class Logs(NamedTuple):
    """A chunk of logs: measured signals at the controller's rate, states every `stride` samples."""

    stride: int
    position: Array  # (lanes, samples, joints) rad
    velocity: Array  # (lanes, samples, joints) rad/s
    torque: Array  # (lanes, samples, joints) N m, mean over one period centred on the sample
    q: Array  # (lanes, states, n)
    v: Array  # (lanes, states, n)
    work: Array  # (lanes, states) J
    dissipated: Array  # (lanes, states) J


@compiled
def _rounded(x, step):  # type: ignore[no-untyped-def]
    return x if step == 0.0 else step * math.floor(x / step + 0.5)


@compiled
def _end(lanes, lane, status, joint, sample):  # type: ignore[no-untyped-def]
    lanes.status[lane] = status
    lanes.joint[lane] = joint
    lanes.sample[lane] = sample


@compiled
def _check(loop, lanes, lane, sample):  # type: ignore[no-untyped-def]
    for i in range(lanes.q.shape[1]):
        if not (math.isfinite(lanes.q[lane, i]) and math.isfinite(lanes.v[lane, i])):
            _end(lanes, lane, DIVERGED, -1, sample)
            return
    for j in range(len(loop.drive)):
        angle, speed = lanes.q[lane, loop.drive[j]], lanes.v[lane, loop.drive[j]]
        if abs(speed) > loop.speed[j]:
            _end(lanes, lane, OVERSPEED, j, sample)
        elif angle < loop.lower[j] or angle > loop.upper[j]:
            _end(lanes, lane, ANGLE_LIMIT, j, sample)
        elif lanes.overloaded[lane, j] >= loop.overload_samples:
            _end(lanes, lane, OVERLOAD, j, sample)
    if sample >= lanes.stop[lane, 0]:
        _end(lanes, lane, JUMP, lanes.stop[lane, 1], sample)


@compiled
def control(loop, lanes, inputs, logs, lane, k, torque):  # type: ignore[no-untyped-def]
    """One sample of the controller for one lane: measure, command, current loop, log, check.

    `torque` (n,) receives the drive torques that act until the next sample.
    """
    for j in range(len(loop.drive)):
        i = loop.drive[j]
        angle, speed = lanes.q[lane, i], lanes.v[lane, i]
        if inputs.position_noise.shape[1] > 0:
            angle += inputs.position_noise[lane, k, j]
            speed += inputs.velocity_noise[lane, k, j]
        angle, speed = _rounded(angle, loop.position_step[j]), _rounded(speed, loop.velocity_step[j])
        error = inputs.position[lane, k, j] - angle
        more = loop.integral_gain[j] * loop.period * error
        command = loop.position_gain[j] * error + loop.velocity_gain[j] * (inputs.velocity[lane, k, j] - speed)
        command += lanes.integral[lane, j] + more + inputs.feedforward[lane, k, j]
        limit = loop.torque_limit[j]
        if abs(command) > limit:
            # the integrator waits, unless it would help out of the limit
            if command * more < 0.0:
                lanes.integral[lane, j] += more
            command = math.copysign(limit, command)
            lanes.overloaded[lane, j] += 1
        else:
            lanes.integral[lane, j] += more
            lanes.overloaded[lane, j] = 0
        command = _rounded(command, loop.torque_step[j])
        before = lanes.held[lane, j]
        missing = lanes.current[lane, j] - command
        lanes.held[lane, j] = command + loop.current_mean * missing
        lanes.current[lane, j] = command + loop.current_left * missing
        torque[i] = lanes.held[lane, j]
        logs.position[lane, k, j], logs.velocity[lane, k, j] = angle, speed
        logs.torque[lane, k, j] = 0.5 * (before + lanes.held[lane, j])
    if k % logs.stride == 0:
        at = k // logs.stride
        for i in range(lanes.q.shape[1]):
            logs.q[lane, at, i], logs.v[lane, at, i] = lanes.q[lane, i], lanes.v[lane, i]
        # the end of the last step's trapezoid is not known yet; `dissipated` is put right from `power` below
        logs.work[lane, at], logs.dissipated[lane, at] = lanes.work[lane], lanes.dissipated[lane]
    _check(loop, lanes, lane, inputs.first + k)


@compiled
def begin(tree, laws, scratch, loop, extra, lanes, lane, torque, h):  # type: ignore[no-untyped-def]
    """First stage of a step of one lane, with its share of work and dissipation."""
    lost = first_stage(tree, laws, scratch, extra, lane, lanes.q[lane], lanes.v[lane], torque, h)
    # the trapezoidal rule: each step's start closes the step before
    lanes.dissipated[lane] += lanes.open[lane] * lost + 0.5 * h * lost
    lanes.open[lane] = 0.5 * h
    for j in range(len(loop.drive)):
        lanes.work[lane] -= torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]
    return lost


@compiled
def finish(tree, laws, scratch, loop, extra, late, lanes, lane, torque, h):  # type: ignore[no-untyped-def]
    """Second stage of a step of one lane."""
    bend = second_stage(tree, laws, scratch, extra, late, lane, lanes.q[lane], lanes.v[lane], torque, h)
    for j in range(len(loop.drive)):
        lanes.work[lane] += torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]
    return bend


@compiled
def _keep(lanes, lane, kept):  # type: ignore[no-untyped-def]
    n = lanes.q.shape[1]
    for i in range(n):
        kept[i], kept[n + i] = lanes.q[lane, i], lanes.v[lane, i]
    kept[2 * n], kept[2 * n + 1], kept[2 * n + 2] = lanes.work[lane], lanes.dissipated[lane], lanes.open[lane]


@compiled
def _put_back(lanes, lane, kept):  # type: ignore[no-untyped-def]
    n = lanes.q.shape[1]
    for i in range(n):
        lanes.q[lane, i], lanes.v[lane, i] = kept[i], kept[n + i]
    lanes.work[lane], lanes.dissipated[lane], lanes.open[lane] = kept[2 * n], kept[2 * n + 1], kept[2 * n + 2]


@compiled
def run(tree, laws, memory, loop, extra, lanes, inputs, logs, samples):  # type: ignore[no-untyped-def]
    """Advance all running lanes by that many samples; every effect has a compiled law."""
    n = lanes.q.shape[1]
    torque, kept = np.zeros(n), np.zeros(2 * n + 3)
    scratch = scratch_in(memory[0], n, len(laws.inertia))
    h = loop.period / loop.substeps
    for lane in range(len(lanes.status)):
        for k in range(samples):
            if lanes.status[lane] == RUNNING:
                control(loop, lanes, inputs, logs, lane, k, torque)
            if lanes.status[lane] != RUNNING:
                break
            for _ in range(loop.substeps):
                _keep(lanes, lane, kept)
                begin(tree, laws, scratch, loop, extra, lanes, lane, torque, h)
                bend = finish(tree, laws, scratch, loop, extra, extra.force, lanes, lane, torque, h)
                if bend > loop.tolerance:
                    lanes.divided[lane] += 1
                    _put_back(lanes, lane, kept)
                    for _ in range(DIVISION):
                        begin(tree, laws, scratch, loop, extra, lanes, lane, torque, h / DIVISION)
                        finish(tree, laws, scratch, loop, extra, extra.force, lanes, lane, torque, h / DIVISION)


# The same, one part of a step at a time, for effects that Python works out in between.


@compiled
def control_all(loop, lanes, inputs, logs, k, torque):  # type: ignore[no-untyped-def]
    """`control` of all running lanes; `torque` (lanes, n)."""
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            control(loop, lanes, inputs, logs, lane, k, torque[lane])


@compiled
def begin_all(tree, laws, memory, loop, extra, lanes, torque, h, q, v):  # type: ignore[no-untyped-def]
    """`begin` of all running lanes; `q`, `v` and `lanes.a` receive the points where the second stage wants its forces."""
    n = lanes.q.shape[1]
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            scratch = scratch_in(memory[lane], n, len(laws.inertia))
            begin(tree, laws, scratch, loop, extra, lanes, lane, torque[lane], h)
            q[lane], v[lane], lanes.a[lane] = scratch.q, scratch.v, scratch.a


@compiled
def finish_all(tree, laws, memory, loop, extra, late, lanes, torque, h):  # type: ignore[no-untyped-def]
    """`finish` of all running lanes; returns the largest bend."""
    bend = 0.0
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            scratch = scratch_in(memory[lane], lanes.q.shape[1], len(laws.inertia))
            bend = max(bend, finish(tree, laws, scratch, loop, extra, late, lanes, lane, torque[lane], h))
    return bend


@compiled
def decimate(buffer, weights, stride, out):  # type: ignore[no-untyped-def]
    """Every `stride`-th sample of a filtered signal: buffer (lanes, samples, channels), out (lanes, outputs, channels)."""
    for lane in range(out.shape[0]):
        for k in range(out.shape[1]):
            for c in range(out.shape[2]):
                out[lane, k, c] = 0.0
            for t in range(len(weights)):
                for c in range(out.shape[2]):
                    out[lane, k, c] += weights[t] * buffer[lane, k * stride + t, c]
