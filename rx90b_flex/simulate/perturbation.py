"""The perturbation method: a rigid nominal motion, and the linear time-varying system of the vibration about it (section 3.4).

With the nominal motion ``q0 = (e0, 0)`` and ``q = q0 + dq``, equation 3.65 becomes, to first order,

    M(t) d(q'') + D(t) d(q') + K(t) dq = B tau - f(q0, q0', q0''),

with M, D and K of equation 3.90 along the nominal motion and f the inverse dynamics there. tau is the controller's own torque: it
samples nominal + perturbation, with its quantisation, limits and current loop, as in the nonlinear simulation.

All excitations of one nominal motion share M, D and K: the implicit midpoint rule,

    (M + h/2 D + h^2/4 K) v_m = M v + h/2 (B tau - f - K q),   v <- 2 v_m - v,   q <- q + h v_m,

is put into one matrix a step, and a step of all runs is one product of that matrix with the array of their states.

Friction may stay as it is (``friction="exact"``): its torque depends on one rate a joint, so that the linear step leaves one scalar
equation a joint and step, ``rate + c torque(rate) = b``. With ``friction="linear"`` its chord along the nominal motion is part of D.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.kernels import (
    RUNNING,
    Inputs,
    Logs,
    _call,
    _check,
    combine,
    compiled,
    inverse_dynamics,
    scatter,
    scratch_in,
)
from rx90b_flex.robot import Robot
from rx90b_flex.signals.recording import Role
from rx90b_flex.simulate import closed_loop
from rx90b_flex.simulate.closed_loop import Noise, Simulation, micro_interpolate, simulate
from rx90b_flex.simulate.cs8 import CS8, drive_places
from rx90b_flex.simulate.trajectories import Trajectory

Indices = NDArray[np.int64]
Nominal = Literal["rigid", "reference"]
Friction = Literal["exact", "linear"]

NEWTON = 30  # iterations for one rate; one is usual, more where a joint sticks
# Friction is read from a table over the rate, whose cells are 1/16 of an octave: a cell's number is the leading bits of the
# floating-point number, and a cubic in each leaves relative errors of 1e-8.
LOWEST, OCTAVES, FINE = (
    -30,
    38,
    16,
)  # from 2^-30 rad/s, 1e-9; below, the torque is linear; up to 2^8, beyond, it is called
CELLS = OCTAVES * FINE
SMALLEST, LARGEST = 2.0**LOWEST, 2.0 ** (LOWEST + OCTAVES)
KNOWN = 32  # chunks whose matrices are kept in case the motion repeats: 13 MB for 16 coordinates
NO_NOISE = 2  # samples of an array of noise that is not there; a chunk of noise has more
PROBES = (-1.3, -0.21, 0.0, 0.37, 2.9)  # rad; a torque that is the same at these angles does not depend on the angle


def perturb_lanes(
    robot: Robot,
    controller: CS8,
    trajectories: Sequence[Trajectory],
    *,
    noise: Noise | None = None,
    rng: np.random.Generator | None = None,
    raw: bool = False,
    role: Role = "identification",
    nominal: Nominal = "reference",
    friction: Friction = "exact",
) -> list[Simulation]:
    """Several runs of one nominal motion by the perturbation method, advanced together.

    Parameters
    ----------
    robot : Robot
    controller : CS8
    trajectories : sequence of Trajectory
        All with the same references; the torques fed forward are the excitations.
    noise, rng, raw, role
        As in `simulate_lanes`.
    nominal : str
        ``reference``: the references themselves, which the rigid robot follows if its controller is ideal; ``rigid``: a simulation of
        the rigid robot under this controller, without excitation, noise and quantisation. The difference is of second order.
    friction : str
        ``exact``: effects that are compiled laws of one rate or angle (friction, hardening) keep their nonlinearity;
        ``linear``: all is linear in the perturbation, as in (3.90).

    Returns
    -------
    list of Simulation
        One a trajectory, nominal + perturbation. `Simulation.dissipated` is not known: NaN.

    Raises
    ------
    ValueError
        Trajectories with different references, or that do not fit robot and controller; a nominal motion that ends early.
    """
    closed_loop._refuse(robot, controller, trajectories, noise, rng, 1)
    first = trajectories[0]
    for t in trajectories:
        if not (np.array_equal(t.position, first.position) and np.array_equal(t.velocity, first.velocity)):
            raise ValueError(
                f"trajectory {t.name!r} has other references than {first.name!r}; "
                "the perturbation method takes excitations of one nominal motion"
            )
    own = controller.for_joints(robot.joints)
    position, velocity = _nominal_motion(robot, own, first, nominal)
    job = closed_loop._Job(robot, own, tuple(trajectories), noise or Noise(), 1, raw, role)
    children = [] if rng is None else rng.spawn(len(trajectories))
    return _PerturbationRunner(job, children, position, velocity, friction == "exact").run()


def _nominal_motion(robot: Robot, controller: CS8, trajectory: Trajectory, nominal: Nominal) -> tuple[Array, Array]:
    """Drive angles and speeds of the nominal motion at the references' rate, each (N, joints)."""
    if nominal == "reference" or controller.log_rate_hz != controller.reference_rate_hz:
        return trajectory.position, trajectory.velocity
    run = simulate(robot.rigid(), controller.ideal(), trajectory.with_feedforward(None))
    if run.ended is not None:
        raise ValueError(f"nominal motion of {trajectory.name!r}: {run.ended}")
    return run.q, run.v


# ---- the system along the nominal motion ----------------------------------------------------------------------


class Step(NamedTuple):
    """One step of the linear system, the same for all lanes.

    With y = (dq', dq, drive torque) the rate in the middle of a step is ``move @ y + shift - push @ port torques``.
    """

    move: Array  # (n, 2 n + joints)
    shift: Array  # (n,) rad/s
    push: Array  # (n, ports) rad/s per N m, of the exact laws
    port_x: Array  # (ports,) combination of the nominal coordinates in the middle of the step
    port_rate: Array  # (ports,)
    gain: Array  # (ports, ports) ports.T @ push


class Along(NamedTuple):
    """The nominal motion of a chunk and the system about it."""

    nodes: Array  # (rows + 1, 3, n, n) M, D and K at the references' rate, without the compiled laws' functions
    q: Array  # (samples + 1, n) at the controller's rate
    v: Array  # (samples + 1, n)
    middle: Array  # (samples, 3, n) coordinates, rates, accelerations in the middle of a sample
    other: Array  # (samples, n) forces of the effects without a compiled law


class Ports(NamedTuple):
    """Combinations of the coordinates that exact laws depend on."""

    vector: Array  # (n, ports)
    start: NDArray[np.int64]  # (ports + 1,) first law of each port in `law`
    law: NDArray[np.int64]
    tabulated: NDArray[np.int64]  # (ports,) whether the torque depends on the rate alone and is read from the table
    table: Array  # (ports, 2 * CELLS, 4) cubics of the torque by |rate| less the cell's start; negative rates second


def _ports(robot: Robot, exact: bool) -> Ports:
    """The ports of the laws that keep their nonlinearity; none unless `exact`."""
    laws, n = robot.plant.laws, robot.model.nv
    found: dict[tuple[bytes, int], tuple[Array, list[int]]] = {}
    for m in np.flatnonzero(laws.address) if exact else []:
        port = np.zeros(n)
        np.add.at(port, laws.place[m], laws.weight[m])
        # friction and springs apart, so that friction depends on the rate alone
        found.setdefault((port.tobytes(), int(laws.stores[m])), (port, []))[1].append(int(m))
    # springs first: what they change is then part of what friction, which may hold a joint, answers to
    ordered = [found[key] for key in sorted(found, key=lambda key: -key[1])]
    vectors = [port for port, _ in ordered]
    lists = [own for _, own in ordered]
    start = np.cumsum([0, *(len(own) for own in lists)])
    law = np.array([m for own in lists for m in own], dtype=np.int64)
    vector = np.stack(vectors, axis=1) if vectors else np.zeros((n, 0))
    start = np.asarray(start, dtype=np.int64)
    tabulated, table = np.zeros(len(lists), dtype=np.int64), np.zeros((len(lists), 2 * CELLS, 4))
    fill_tables(laws, start, law, np.array(PROBES), tabulated, table)
    return Ports(np.ascontiguousarray(vector), start, law, tabulated, table)


def hermite(position: Array, velocity: Array, rows: Indices, part: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Cubic through positions and velocities of samples, at parts of the intervals that begin at `rows`.

    Parameters
    ----------
    position, velocity : array, shape (N, joints)
    rows : array, shape (R,)
        Behind the last sample the motion goes on with its last velocity.
    part : array, shape (P,), 0 to 1

    Returns
    -------
    position, velocity, acceleration : array, shape (R * P, joints)
    """
    after = np.minimum(rows + 1, len(position) - 1)
    x0, v0, v1 = position[rows, None], velocity[rows, None] / rate_hz, velocity[after, None] / rate_hz
    x1 = np.where((rows + 1 < len(position))[:, None, None], position[after, None], x0 + v0)
    s = np.asarray(part)[:, None]
    more, bend = x1 - x0 - v0, v1 - v0
    square, cube = 3.0 * more - bend, bend - 2.0 * more
    x = x0 + v0 * s + square * s**2 + cube * s**3
    v = v0 + 2.0 * square * s + 3.0 * cube * s**2
    a = 2.0 * square + 6.0 * cube * s
    shape = len(rows) * len(s), position.shape[1]
    return x.reshape(shape), rate_hz * v.reshape(shape), rate_hz**2 * a.reshape(shape)


class _Along:
    """M, D, K and the nominal motion, chunk by chunk."""

    def __init__(self, robot: Robot, position: Array, velocity: Array, rate_hz: float, up: int) -> None:
        self.robot, self.rate_hz, self.up = robot, rate_hz, up
        self.position, self.velocity = position, velocity
        self.drives = drive_places(robot)
        self.acceleration = np.gradient(velocity, 1.0 / rate_hz, axis=0)
        laws, n = robot.plant.laws, robot.model.nv
        self.known: dict[bytes, tuple[Array, Array, Array]] = {}
        self.constant = [np.zeros((n, n)) for _ in range(3)]
        for m in range(len(laws.inertia)):
            port = np.zeros(n)
            np.add.at(port, laws.place[m], laws.weight[m])
            for total, value in zip(self.constant, (laws.stiffness, laws.damping, laws.inertia), strict=True):
                total += value[m] * np.outer(port, port)

    def nodes(self, rows: Indices) -> tuple[Array, Array, Array]:
        """M, D and K without the compiled laws' functions at samples of the nominal motion, each (len(rows), n, n)."""
        rows = np.minimum(rows, len(self.position) - 1)
        points = [x[rows] for x in (self.position, self.velocity, self.acceleration)]
        key = b"".join(x.tobytes() for x in points)
        if key in self.known:  # a motion that repeats comes back to the same points
            return self.known[key]
        motion = self.robot.motion(*(self._whole(x) for x in points))
        totals = [own + fixed for own, fixed in zip(motion.on_tree.derivatives(), self.constant, strict=True)]
        for effect in self.robot.plant.others:
            for total, own in zip(totals, effect.derivatives(motion), strict=True):
                total += own
        by_q, by_v, by_a = (np.ascontiguousarray(x) for x in totals)
        if len(self.known) < KNOWN:
            self.known[key] = by_a, by_v, by_q
        return by_a, by_v, by_q

    def at_samples(self, rows: Indices) -> tuple[Array, Array]:
        """Nominal coordinates and rates at the controller's samples and at the end, each (len(rows) * up + 1, n)."""
        x, v, _ = hermite(self.position, self.velocity, rows, np.arange(self.up) / self.up, self.rate_hz)
        end_x, end_v, _ = hermite(self.position, self.velocity, rows[-1:], np.ones(1), self.rate_hz)
        return self._whole(np.concatenate([x, end_x])), self._whole(np.concatenate([v, end_v]))

    def between(self, rows: Indices) -> tuple[Array, Array, Array]:
        """Coordinates, rates and accelerations in the middle of each sample, each (len(rows) * up, n)."""
        part = (np.arange(self.up) + 0.5) / self.up
        x, v, a = (self._whole(y) for y in hermite(self.position, self.velocity, rows, part, self.rate_hz))
        return x, v, a

    def other_forces(self, x: Array, v: Array, a: Array, first: int, period: float) -> Array:
        """Forces of the effects without a compiled law along the nominal motion, shape of x."""
        if not self.robot.plant.others:
            return np.zeros_like(x)
        time = np.asarray((first + np.arange(len(x)) + 0.5) * period, dtype=np.float64)
        motion = self.robot.motion(x, v, a, time)
        return np.ascontiguousarray(sum(effect.force(motion) for effect in self.robot.plant.others))

    def _whole(self, of_drives: Array) -> Array:
        out = np.zeros((len(of_drives), self.robot.model.nv))
        out[:, self.drives] = of_drives
        return out


# ---- compiled -------------------------------------------------------------------------------------------------


@compiled
def _invert(matrix, out):  # type: ignore[no-untyped-def]
    """Inverse by Gauss and Jordan without pivots: the mass matrix dominates."""
    n = len(matrix)
    for i in range(n):
        for j in range(n):
            out[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        scale = 1.0 / matrix[k, k]
        for j in range(k, n):
            matrix[k, j] *= scale
        for j in range(k + 1):
            out[k, j] *= scale
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                if factor != 0.0:
                    for j in range(k, n):
                        matrix[i, j] -= factor * matrix[k, j]
                    for j in range(k + 1):
                        out[i, j] -= factor * out[k, j]


@compiled
def _law(laws, m, x, rate, out):  # type: ignore[no-untyped-def]
    _call(laws.address[m], x, rate, laws.parameters[m].ctypes.data, out.ctypes.data)


@compiled
def _add_linear_laws(laws, x, v, before, after, damping, stiffness, force, out):  # type: ignore[no-untyped-def]
    """Add the laws' functions along the nominal motion: torque, slope by the angle, chord over the step by the rate."""
    for m in range(len(laws.inertia)):
        if laws.address[m] == 0:
            continue
        angle, rate = combine(laws, m, x), combine(laws, m, v)
        _law(laws, m, angle, rate, out)
        torque, by_x, by_rate = out[0], out[1], out[2]
        low, high = combine(laws, m, before), combine(laws, m, after)
        if abs(high - low) > 1e-9:
            _law(laws, m, angle, high, out)
            upper = out[0]
            _law(laws, m, angle, low, out)
            by_rate = (upper - out[0]) / (high - low)
        scatter(laws, m, torque, force)
        for w in range(laws.place.shape[1]):
            for u in range(laws.place.shape[1]):
                weight = laws.weight[m, w] * laws.weight[m, u]
                damping[laws.place[m, w], laws.place[m, u]] += weight * by_rate
                stiffness[laws.place[m, w], laws.place[m, u]] += weight * by_x


@compiled
def _make_step(tree, laws, ports, scratch, drive, h, up, along, at, work, step, exact):  # type: ignore[no-untyped-def]
    """Matrices of the step at a chunk's sample `at`."""
    row = at // up
    part = (at - row * up + 0.5) / up
    middle, low, high = along.middle[at], along.nodes[row], along.nodes[row + 1]
    n = middle.shape[1]
    mass, damping, stiffness, system, inverse = work[0], work[1], work[2], work[3], work[4]
    for i in range(n):
        for j in range(n):
            mass[i, j] = low[0, i, j] + part * (high[0, i, j] - low[0, i, j])
            damping[i, j] = low[1, i, j] + part * (high[1, i, j] - low[1, i, j])
            stiffness[i, j] = low[2, i, j] + part * (high[2, i, j] - low[2, i, j])
    force = scratch.generalised
    inverse_dynamics(tree, scratch, middle[0], middle[1], middle[2], force)
    for m in range(len(laws.inertia)):
        torque = laws.stiffness[m] * combine(laws, m, middle[0]) + laws.damping[m] * combine(laws, m, middle[1])
        scatter(laws, m, torque + laws.inertia[m] * combine(laws, m, middle[2]), force)
    if not exact:
        _add_linear_laws(laws, middle[0], middle[1], along.v[at], along.v[at + 1], damping, stiffness, force, laws.out)
    for i in range(n):
        force[i] += along.other[at, i]
        for j in range(n):
            system[i, j] = mass[i, j] + 0.5 * h * damping[i, j] + 0.25 * h * h * stiffness[i, j]
    _invert(system, inverse)
    move, push = step.move, step.push
    for i in range(n):
        for j in range(2 * n):
            move[i, j] = 0.0
        shift = 0.0
        for m in range(n):
            x = inverse[i, m]
            y = -0.5 * h * x
            shift += y * force[m]
            for j in range(n):
                move[i, j] += x * mass[m, j]
            for j in range(n):
                move[i, n + j] += y * stiffness[m, j]
        step.shift[i] = shift
        for j in range(len(drive)):
            move[i, 2 * n + j] = 0.5 * h * inverse[i, drive[j]]
        for p in range(push.shape[1]):
            total = 0.0
            for m in range(n):
                total += inverse[i, m] * ports.vector[m, p]
            push[i, p] = 0.5 * h * total
    for p in range(push.shape[1]):
        step.port_x[p], step.port_rate[p] = 0.0, 0.0
        for i in range(n):
            step.port_x[p] += ports.vector[i, p] * middle[0, i]
            step.port_rate[p] += ports.vector[i, p] * middle[1, i]
        for u in range(push.shape[1]):
            total = 0.0
            for i in range(n):
                total += ports.vector[i, u] * push[i, p]
            step.gain[u, p] = total


@compiled
def _product(matrix, y, shift, out):  # type: ignore[no-untyped-def]
    """out = matrix @ y + shift, lanes in the columns."""
    rows, inner = matrix.shape
    lanes = y.shape[1]
    for i in range(rows):
        for c in range(lanes):
            out[i, c] = shift[i]
        j = 0
        while j + 4 <= inner:
            a0, a1, a2, a3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            for c in range(lanes):
                out[i, c] += a0 * y[j, c] + a1 * y[j + 1, c] + a2 * y[j + 2, c] + a3 * y[j + 3, c]
            j += 4
        while j < inner:
            a0 = matrix[i, j]
            for c in range(lanes):
                out[i, c] += a0 * y[j, c]
            j += 1


@compiled
def fill_tables(laws, start, law, probes, tabulated, table):  # type: ignore[no-untyped-def]
    """Cubics with the torque and slope of each cell's ends, for ports whose laws depend on the rate alone."""
    out = np.zeros(3)
    for p in range(len(tabulated)):
        depends = False
        for cell in range(2 * CELLS):
            sign, at = (1.0, cell) if cell < CELLS else (-1.0, cell - CELLS)
            low = 2.0 ** (LOWEST + at // FINE) * (1.0 + (at % FINE) / FINE)
            width = 2.0 ** (LOWEST + at // FINE) / FINE
            ends = np.zeros((2, 2))
            for place in range(start[p], start[p + 1]):
                for end in range(2):
                    rate = sign * (low + end * width)
                    _law(laws, law[place], 0.0, rate, out)
                    torque = out[0]
                    ends[end, 0] += torque
                    ends[end, 1] += out[2] * sign * width
                    depends = depends or out[1] != 0.0
                    for x in probes:
                        _law(laws, law[place], x, rate, out)
                        depends = depends or out[0] != torque
            more = ends[1, 0] - ends[0, 0]
            table[p, cell, 0], table[p, cell, 1] = ends[0, 0], ends[0, 1] / width
            table[p, cell, 2] = (3.0 * more - 2.0 * ends[0, 1] - ends[1, 1]) / width**2
            table[p, cell, 3] = (ends[0, 1] + ends[1, 1] - 2.0 * more) / width**3
        tabulated[p] = not depends


@compiled
def _from_table(table, rate):  # type: ignore[no-untyped-def]
    """Torque and slope by the rate; the rate within the table."""
    size = abs(rate)
    sign, base = (1.0, 0) if rate >= 0.0 else (-1.0, CELLS)
    if size < SMALLEST:
        # from here through the torque of either side's first point
        middle, span = 0.5 * (table[0, 0] + table[CELLS, 0]), 0.5 * (table[0, 0] - table[CELLS, 0])
        return middle + span * rate / SMALLEST, span / SMALLEST
    # exponent and first bits of the mantissa number the cell, the other bits are the place in it
    leading = np.float64(size).view(np.int64) >> 48
    s = size - np.int64(leading << 48).view(np.float64)
    cell = base + leading - ((1023 + LOWEST) << 4)
    c0, c1, c2, c3 = table[cell, 0], table[cell, 1], table[cell, 2], table[cell, 3]
    return c0 + s * (c1 + s * (c2 + s * c3)), sign * (c1 + s * (2.0 * c2 + s * 3.0 * c3))


@compiled
def _port_torque(laws, ports, p, x, rate, half, out):  # type: ignore[no-untyped-def]
    """Torque of the laws at port p, and its slope by the rate in the middle of a step, with which the angle moves by half a step."""
    torque, slope = 0.0, 0.0
    for place in range(ports.start[p], ports.start[p + 1]):
        _law(laws, ports.law[place], x + half * rate, rate, out)
        torque += out[0]
        slope += out[2] + half * out[1]
    return torque, slope


@compiled
def _newton(rate, torque, slope, target, gain, bracket):  # type: ignore[no-untyped-def]
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


@compiled
def _solve_by_table(table, guess, target, gain):  # type: ignore[no-untyped-def]
    """The torque at the rate with ``rate + gain * torque(rate) = target``; not a number where a rate is beyond the table."""
    rate, bracket = guess, (-np.inf, np.inf)
    torque = np.nan
    for _ in range(NEWTON):
        if not abs(rate) < LARGEST:
            return np.nan
        torque, slope = _from_table(table, rate)
        new, near, bracket = _newton(rate, torque, slope, target, gain, bracket)
        if near:
            return torque + slope * (new - rate)
        rate = new
    return torque


@compiled
def _solve_by_laws(laws, ports, p, x, guess, target, gain, half, out):  # type: ignore[no-untyped-def]
    """The same with ``torque(x + half * rate, rate)`` from the laws themselves."""
    rate, bracket = guess, (-np.inf, np.inf)
    torque = 0.0
    for _ in range(NEWTON):
        torque, slope = _port_torque(laws, ports, p, x, rate, half, out)
        new, near, bracket = _newton(rate, torque, slope, target, gain, bracket)
        if near:
            return torque + slope * (new - rate)
        rate = new
    return torque


@compiled
def _rub(laws, ports, step, h, y, middle, torques, memory, running, out):  # type: ignore[no-untyped-def]
    """Correct the rates in the middle of a step for the exact laws of each lane.

    `torques` (ports, lanes) of the step before are a first guess that couples the ports; then each port in turn.
    `memory` is three arrays of a number a lane.
    """
    n, count = middle.shape
    number = torques.shape[0]
    target, angle, change = memory
    vector, push, gains, port_x, port_rate = ports.vector, step.push, step.gain, step.port_x, step.port_rate
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
                change[c] = (
                    _solve_by_laws(laws, ports, p, angle[c], target[c], right, gain, 0.5 * h, out) - torques[p, c]
                )
        for c in range(count):
            torques[p, c] += change[c]
        for i in range(n):
            each = push[i, p]
            for c in range(count):
                middle[i, c] -= each * change[c]


@compiled
def _nearest(x, step):  # type: ignore[no-untyped-def]
    return x if step == 0.0 else step * np.floor(x / step + 0.5)


@compiled
def _control_joint(gains, limits, given, noise, logs, state, counts, angle, speed, at, drive_torque, wrong):  # type: ignore[no-untyped-def]
    """`kernels.control` of one joint at sample `at`, all lanes; arrays instead of tuples, which cost a count a look.

    `angle`, `speed` (lanes,) of the drive; the torque of the next sample goes to `drive_torque` (lanes,), and `wrong` (lanes,) is set
    where something must be looked at.
    """
    position_gain, velocity_gain, integral_gain, position_step, velocity_step, torque_step = gains
    limit, lower, upper, fastest, mean, left, longest = limits
    references, rates, feedforward = given
    angle_noise, speed_noise = noise
    log_position, log_velocity, log_torque = logs
    integral, current, held = state
    for c in range(len(angle)):
        true_angle, true_speed = angle[c], speed[c]
        seen_angle, seen_speed = true_angle, true_speed
        if angle_noise.shape[1] > NO_NOISE:
            seen_angle += angle_noise[c, at]
            seen_speed += speed_noise[c, at]
        seen_angle, seen_speed = _nearest(seen_angle, position_step), _nearest(seen_speed, velocity_step)
        error = references[c, at] - seen_angle
        more = integral_gain * error
        command = position_gain * error + velocity_gain * (rates[c, at] - seen_speed)
        command += integral[c] + more + feedforward[c, at]
        if abs(command) > limit:
            # the integrator waits, unless it would help out of the limit
            if command * more < 0.0:
                integral[c] += more
            command = math.copysign(limit, command)
            counts[c] += 1
        else:
            integral[c] += more
            counts[c] = 0
        command = _nearest(command, torque_step)
        missing = current[c] - command
        before = held[c]
        now = command + mean * missing
        held[c] = now
        current[c] = command + left * missing
        drive_torque[c] = now
        log_position[c, at], log_velocity[c, at], log_torque[c, at] = seen_angle, seen_speed, 0.5 * (before + now)
        inside = abs(true_speed) <= fastest and lower <= true_angle <= upper and counts[c] < longest
        if not inside:  # not a number is not inside either
            wrong[c] = 1


@compiled
def _stop(loop, lanes, along, y, at, sample, wrong):  # type: ignore[no-untyped-def]
    """Look at the lanes where something is wrong, or whose reference jumps here."""
    n = along.q.shape[1]
    for c in range(len(wrong)):
        if lanes.status[c] == RUNNING and (wrong[c] != 0 or sample >= lanes.stop[c, 0]):
            for i in range(n):
                lanes.v[c, i], lanes.q[c, i] = along.v[at, i] + y[i, c], along.q[at, i] + y[n + i, c]
            _check(loop, lanes, c, sample)
        wrong[c] = 0


@compiled
def _log_states(lanes, logs, along, y, at):  # type: ignore[no-untyped-def]
    q, v, work, log_q, log_v, log_work, status = lanes.q, lanes.v, lanes.work, logs.q, logs.v, logs.work, lanes.status
    n, row = along.q.shape[1], at // logs.stride
    for c in range(len(work)):
        if status[c] == RUNNING:
            for i in range(n):
                q[c, i], v[c, i] = along.q[at, i] + y[n + i, c], along.v[at, i] + y[i, c]
                log_q[c, row, i], log_v[c, row, i] = q[c, i], v[c, i]
            log_work[c, row] = work[c]


@compiled
def advance(tree, laws, ports, memory, loop, lanes, inputs, logs, along, up, state, work, step, exact):  # type: ignore[no-untyped-def]
    """Controller and robot for all samples of a chunk, all lanes."""
    y, middle, torques, last = state
    n, number = middle.shape
    h, joints = loop.period, len(loop.drive)
    out, target, angle, speed = np.zeros(3), np.zeros(number), np.zeros(number), np.zeros(number)
    wrong = np.zeros(number, dtype=np.int64)
    scratch = scratch_in(memory, n, len(laws.inertia))
    total, status, first_stop = lanes.work, lanes.status, lanes.stop[:, 0].min()
    for at in range(len(along.middle)):
        _make_step(tree, laws, ports, scratch, loop.drive, h, up, along, at, work, step, exact)
        for j in range(joints):
            i = loop.drive[j]
            for c in range(number):
                angle[c], speed[c] = along.q[at, i] + y[n + i, c], along.v[at, i] + y[i, c]
                if status[c] == RUNNING:
                    total[c] += y[2 * n + j, c] * (angle[c] - last[j, c])
                last[j, c] = angle[c]
            _control_joint(
                (
                    loop.position_gain[j],
                    loop.velocity_gain[j],
                    loop.integral_gain[j] * h,
                    loop.position_step[j],
                    loop.velocity_step[j],
                    loop.torque_step[j],
                ),
                (
                    loop.torque_limit[j],
                    loop.lower[j],
                    loop.upper[j],
                    loop.speed[j],
                    loop.current_mean,
                    loop.current_left,
                    loop.overload_samples,
                ),
                (inputs.position[:, :, j], inputs.velocity[:, :, j], inputs.feedforward[:, :, j]),
                (inputs.position_noise[:, :, j], inputs.velocity_noise[:, :, j]),
                (logs.position[:, :, j], logs.velocity[:, :, j], logs.torque[:, :, j]),
                (lanes.integral[:, j], lanes.current[:, j], lanes.held[:, j]),
                lanes.overloaded[:, j],
                angle,
                speed,
                at,
                y[2 * n + j],
                wrong,
            )
        if at % logs.stride == 0:
            _log_states(lanes, logs, along, y, at)
        if wrong.any() or inputs.first + at >= first_stop:
            _stop(loop, lanes, along, y, at, inputs.first + at, wrong)
            if status.all():
                return
        _product(step.move, y, step.shift, middle)
        _rub(laws, ports, step, h, y, middle, torques, (target, angle, speed), status, out)
        for i in range(n):
            for c in range(number):
                y[i, c] = 2.0 * middle[i, c] - y[i, c]
                y[n + i, c] += h * middle[i, c]


def _padded(lanes: int, samples: int, joints: int) -> Array:
    """Zeros of this shape that are a part of a larger array.

    So lanes do not lie a power of two apart, where they would fall on each other in the processor's cache, and compiled code meets
    one kind of array whatever the number of lanes.
    """
    return np.zeros((lanes, samples + 5, joints + 1))[:, :samples, :joints]


# ---- the runner -----------------------------------------------------------------------------------------------


class _PerturbationRunner(closed_loop._Runner):
    """The nonlinear runner with its integrator replaced: inputs, noise, filter, log and results are the same."""

    def __init__(
        self,
        job: closed_loop._Job,
        children: Sequence[np.random.Generator],
        position: Array,
        velocity: Array,
        exact: bool,
    ) -> None:
        super().__init__(job, children)
        self.exact = exact
        self.ports = _ports(job.robot, exact)
        self.along = _Along(job.robot, position, velocity, job.trajectories[0].rate_hz, self.up)
        n, joints, lanes = job.robot.model.nv, len(job.robot.joints), len(job.trajectories)
        q, v = self.along.at_samples(np.array([0]))
        self.y = np.zeros((2 * n + joints, lanes))
        self.y[:n], self.y[n : 2 * n] = (self.lanes.v - v[0]).T, (self.lanes.q - q[0]).T
        self.y[2 * n :] = self.lanes.held.T
        self.last_angle = np.ascontiguousarray(self.lanes.q[:, self.loop.drive].T)
        self.middle = np.zeros((n, lanes))
        ports = self.ports.vector.shape[1]
        self.torques = np.zeros((ports, lanes))
        self.work = np.zeros((5, n, n))
        self.step = Step(
            np.zeros((n, 2 * n + joints)),
            np.zeros(n),
            np.zeros((n, ports)),
            np.zeros(ports),
            np.zeros(ports),
            np.zeros((ports, ports)),
        )

    def _inputs(self, first: int, samples: int) -> Inputs:
        """As in the nonlinear runner; the references, which all lanes share, are interpolated once."""
        rows = np.arange(first // self.up, (first + samples) // self.up)
        rate = self.job.trajectories[0].rate_hz
        lanes, _, joints = self.torque.shape
        references = micro_interpolate(self.position[:1], self.velocity[:1], rows, self.up, rate)
        position, velocity, torque = (_padded(lanes, samples, joints) for _ in range(3))
        position[:], velocity[:] = references
        after = np.minimum(rows + 1, self.torque.shape[1] - 1)
        part = (np.arange(self.up) / self.up)[:, None]
        start = self.torque[:, rows, None]
        torque[:] = (start + (self.torque[:, after, None] - start) * part).reshape(lanes, samples, joints)
        noise = [self._noise(getattr(self.job.noise, name), samples) for name in ("position", "velocity")]
        return Inputs(first, position, velocity, torque, *noise)

    def _noise(self, deviation: float | tuple[float, ...], samples: int) -> Array:
        noise = super()._noise(deviation, samples)
        lanes, count, joints = noise.shape
        out = _padded(lanes, max(count, NO_NOISE), joints)
        if count > 0:
            out[:] = noise
        return out

    def _logs(self, samples: int) -> Logs:
        logs = super()._logs(samples)
        shape = logs.position.shape
        return logs._replace(position=_padded(*shape), velocity=_padded(*shape), torque=_padded(*shape))

    def _advance(self, inputs: Inputs, logs: Logs, samples: int) -> None:
        plant, along = self.plant, self.along
        rows = np.arange(inputs.first // self.up, (inputs.first + samples) // self.up)
        nodes = np.ascontiguousarray(np.stack(along.nodes(np.append(rows, rows[-1] + 1)), axis=1))
        q, v = along.at_samples(rows)
        middle = np.stack(along.between(rows), axis=1)
        other = along.other_forces(middle[:, 0], middle[:, 1], middle[:, 2], inputs.first, self.loop.period)
        chunk = Along(nodes, q, v, middle, other)
        state = self.y, self.middle, self.torques, self.last_angle
        advance(
            plant.tree, plant.laws, self.ports, self.memory[0], self.loop, self.lanes, inputs, logs, chunk, self.up,
            state, self.work, self.step, self.exact,
        )  # fmt: skip

    def _result(self, *args: object) -> Simulation:
        result = super()._result(*args)  # type: ignore[arg-type]
        return dataclasses.replace(result, dissipated=np.full_like(result.dissipated, np.nan))
