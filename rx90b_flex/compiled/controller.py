"""The controller of one lane: measure, command, log, check."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, called, inlined

RUNNING, OVERLOAD, ANGLE_LIMIT, OVERSPEED, DIVERGED, JUMP = range(6)
Three = tuple[float, float, float]
JointInLoop = tuple[Three, Three, float, float, float]


class Filters(NamedTuple):
    """Chains of second-order sections ``b0, b1, b2, a1, a2``, shape (joints, sections, 5)."""

    speed: Array  # of the measured speed
    torque: Array  # of the torque that is asked for
    by_speed: Array  # (joints,) N m/rad * s, of the integrator a sample, over what the filter adds to the speed


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
    filters: Filters | None  # None: without any, for which nothing is compiled
    overload_samples: int
    lower: Array  # rad
    upper: Array  # rad
    speed: Array  # rad/s


class Lanes(NamedTuple):
    """State of all lanes between two samples."""

    q: Array  # (lanes, n)
    v: Array  # (lanes, n)
    a: Array  # (lanes, n) of the last stage, where effects ask for it
    integral: Array  # (joints, lanes) N m
    filtered: Array  # (joints, sections of speed and torque, 2, lanes) what the filters remember
    current: Array  # (joints, lanes) N m, behind the current loop, now
    held: Array  # (joints, lanes) N m, mean over the sample
    overloaded: Integers  # (joints, lanes) samples at the limit without a break
    open: Array  # (lanes,) s, half the last step: what its end still adds to the dissipation, per W
    work: Array  # (lanes,) J
    dissipated: Array  # (lanes,) J
    status: Integers  # (lanes,)
    joint: Integers  # (lanes,) where a lane ended
    sample: Integers  # (lanes,) when
    closed: Array  # (lanes,) J, dissipated up to the last step's start
    divided: Integers  # (lanes,) steps that were taken in `DIVISION` parts
    stop: Integers  # (lanes, 2) sample at which a lane's reference jumps, and the joint


class Inputs(NamedTuple):
    """A chunk of inputs. Lanes come last, so that what acts on all of them lies side by side."""

    first: int  # number of the chunk's first sample
    up: int  # samples of the controller between two of the feed-forward torque
    position: Array  # (samples, joints, lanes or 1) rad, reference; 1: the lanes share it
    velocity: Array  # (samples, joints, lanes or 1) rad/s, reference
    feedforward: Array  # (samples / up + 1, joints, lanes) N m, straight lines between
    noise: Array  # (samples or 1, 2, joints, lanes) of angle and speed, rad and rad/s; or one sample for all


class Logs(NamedTuple):
    """Signals of a chunk as the controller sees them, and the states of the whole run, every `stride` samples."""

    stride: int
    row: int  # of the chunk's first state
    measured: Array  # (samples, 3, joints, lanes) rad, rad/s, and the torque's mean over a period centred on the sample
    q: Array  # (lanes, all states, n)
    v: Array  # (lanes, all states, n)
    work: Array  # (lanes, all states) J
    dissipated: Array  # (lanes, all states) J


@inlined
def _rounded(x: float, step: float) -> float:
    return x if step == 0.0 else step * np.floor(x / step + 0.5)


@inlined
def joint_in_loop(loop: Loop, j: int) -> JointInLoop:
    """The numbers of one joint that `command` reads; numbers, since looking into arrays costs more than arithmetic."""
    gains = loop.position_gain[j], loop.velocity_gain[j], loop.integral_gain[j] * loop.period
    steps = loop.position_step[j], loop.velocity_step[j], loop.torque_step[j]
    return gains, steps, loop.torque_limit[j], loop.current_mean, loop.current_left


@inlined
def _through(sections: Array, memory: Array, first: int, lane: int, x: float) -> float:
    """A sample's way through sections (n, 5), whose memory begins at `first` of (all the joint's sections, 2, lanes)."""
    for s in range(len(sections)):
        b0, b1, b2, a1, a2 = sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3], sections[s, 4]
        own = memory[first + s]
        y = b0 * x + own[0, lane]
        own[0, lane] = b1 * x - a1 * y + own[1, lane]
        own[1, lane] = b2 * x - a2 * y
        x = y
    return x


@inlined
def command(
    joint: JointInLoop,
    filters: Filters | None,
    filtered: Array,
    j: int,
    lane: int,
    angle: float,
    speed: float,
    reference: float,
    rate: float,
    feedforward: float,
    integral: float,
    current: float,
) -> tuple[float, float, float, float, float, bool]:
    """One sample of joint j's controller and current loop; `filtered` (joints, sections, 2, lanes) is what its filters remember.

    Returns angle and speed as the resolver shows them, the new integral and current, the torque that acts until the next
    sample (its mean), and whether the command was at its limit.
    """
    (position_gain, velocity_gain, integral_gain), (position_step, velocity_step, torque_step), limit, mean, left = (
        joint
    )
    angle, speed = _rounded(angle, position_step), _rounded(speed, velocity_step)
    error = reference - angle
    more = integral_gain * error
    slow = speed
    if filters is not None:
        slow = _through(filters.speed[j], filtered[j], 0, lane, speed)
        more -= filters.by_speed[j] * (slow - speed)
    command = position_gain * error + velocity_gain * (rate - slow) + (integral + more + feedforward)
    if filters is not None:
        command = _through(filters.torque[j], filtered[j], filters.speed.shape[1], lane, command)
    limited = abs(command) > limit
    # at the limit the integrator waits, unless it would help out of it
    integral += 0.0 if limited & (command * more >= 0.0) else more
    command = limit if command > limit else (-limit if command < -limit else command)
    command = _rounded(command, torque_step)
    missing = current - command
    return angle, speed, integral, command + left * missing, command + mean * missing, limited


@inlined
def _why(loop: Loop, lanes: Lanes, lane: int, j: int) -> int:
    """Why drive j ends a lane; `RUNNING` where it does not."""
    angle, speed, found = lanes.q[lane, loop.drive[j]], lanes.v[lane, loop.drive[j]], RUNNING
    if abs(speed) > loop.speed[j]:
        found = OVERSPEED
    elif angle < loop.lower[j] or angle > loop.upper[j]:
        found = ANGLE_LIMIT
    elif lanes.overloaded[j, lane] >= loop.overload_samples:
        found = OVERLOAD
    return found


@inlined
def check(loop: Loop, lanes: Lanes, lane: int, sample: int) -> None:
    """End a lane that is no longer finite, turns too fast or is beyond its limits."""
    status, joint = RUNNING, -1
    for j in range(len(loop.drive)):
        found = _why(loop, lanes, lane, j)
        if found != RUNNING:
            status, joint = found, j
    if sample >= lanes.stop[lane, 0]:
        status, joint = JUMP, lanes.stop[lane, 1]
    for i in range(lanes.q.shape[1]):
        if not (math.isfinite(lanes.q[lane, i]) and math.isfinite(lanes.v[lane, i])):
            status, joint = DIVERGED, -1
    if status != RUNNING:
        lanes.status[lane], lanes.joint[lane], lanes.sample[lane] = status, joint, sample


@called
def control(loop: Loop, lanes: Lanes, inputs: Inputs, logs: Logs, lane: int, k: int, torque: Array) -> None:
    """One sample of the controller for one lane: measure, command, log, check.

    `torque` (n,) receives the drive torques that act until the next sample.
    """
    row, part = k // inputs.up, (k % inputs.up) / inputs.up
    own, noise = lane if inputs.position.shape[2] > 1 else 0, k if inputs.noise.shape[0] > 1 else 0
    for j in range(len(loop.drive)):
        i = loop.drive[j]
        angle, speed = lanes.q[lane, i], lanes.v[lane, i]
        angle += inputs.noise[noise, 0, j, lane]
        speed += inputs.noise[noise, 1, j, lane]
        start, end = inputs.feedforward[row, j, lane], inputs.feedforward[row + 1, j, lane]
        angle, speed, integral, current, held, limited = command(
            joint_in_loop(loop, j),
            loop.filters,
            lanes.filtered,
            j,
            lane,
            angle,
            speed,
            inputs.position[k, j, own],
            inputs.velocity[k, j, own],
            start + part * (end - start),
            lanes.integral[j, lane],
            lanes.current[j, lane],
        )
        lanes.overloaded[j, lane] = lanes.overloaded[j, lane] + 1 if limited else 0
        logs.measured[k, 0, j, lane], logs.measured[k, 1, j, lane] = angle, speed
        logs.measured[k, 2, j, lane] = 0.5 * (lanes.held[j, lane] + held)
        lanes.integral[j, lane], lanes.current[j, lane], lanes.held[j, lane] = integral, current, held
        torque[i] = held
    if k % logs.stride == 0:
        at = logs.row + k // logs.stride
        for i in range(lanes.q.shape[1]):
            logs.q[lane, at, i], logs.v[lane, at, i] = lanes.q[lane, i], lanes.v[lane, i]
        # what the last step's end adds to the dissipation is known in the next `begin`, which logs it again
        logs.work[lane, at], logs.dissipated[lane, at] = lanes.work[lane], lanes.dissipated[lane]
    check(loop, lanes, lane, inputs.first + k)
