"""Closed-loop simulation of the nonlinear flexible robot under its controller, many runs at once.

Between two samples of the controller the drive torques are constant, and the robot moves by a linearly implicit
(Rosenbrock-W) method of second order, L-stable, with the analytic Jacobian of all that is stiff: see
`rx90b_flex.kernels`. Steps end at the controller's samples, so that no step crosses a jump of the torque.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.kernels import Extra, Plant, no_extra
from rx90b_flex.robot import Robot
from rx90b_flex.signals.recording import Recording, Role
from rx90b_flex.simulate import stepping
from rx90b_flex.simulate.cs8 import CS8, drive_places
from rx90b_flex.simulate.stepping import Inputs, Lanes, Logs, Loop
from rx90b_flex.simulate.trajectories import Trajectory

Indices = NDArray[np.int64]

CHUNK_S = 0.256  # inputs and logs at the controller's rate are kept for so long; it bounds memory
FILTER_ATTENUATION_DB = 80.0
FILTER_TRANSITION = 0.22  # of the anti-alias filter, over its cutoff: 80 to 100 Hz about 90
TOLERANCE = 1e-8  # rad; a step along which the effects' laws bend more is taken in eight parts
SPEED_MARGIN = 1.5  # choice: over the URDF's speed limit by this, the controller's supervision stops the robot


@dataclass(frozen=True)
class Noise:
    """Standard deviations of white Gaussian noise at the controller's rate; one number, or one a joint.

    Position and velocity noise goes through the controller, as in the robot; torque noise (of the current sensors) is
    only logged.

    Attributes
    ----------
    torque : N m
    position : rad
    velocity : rad/s
    """

    torque: float | tuple[float, ...] = 0.0
    position: float | tuple[float, ...] = 0.0
    velocity: float | tuple[float, ...] = 0.0


@dataclass(frozen=True, eq=False)
class RawLog:
    """Measured signals at the controller's rate, before the anti-alias filter.

    Attributes
    ----------
    rate_hz : float
    position, velocity, torque : array, shape (N, joints)
        rad, rad/s, N m.
    """

    rate_hz: float
    position: Array
    velocity: Array
    torque: Array

    @property
    def time(self) -> Array:
        """s, shape (N,)."""
        return np.arange(len(self.position)) / self.rate_hz

    def rms_above(self, hz: float = 125.0) -> dict[str, Array]:
        """RMS of each signal above a frequency, by signal, each (joints,): what would alias into a slower log.

        Hann window, trends left out; the torque's holds the controller's quantisation.
        """
        return {name: np.sqrt(self._power(x, hz)) for name, x in self._signals().items()}

    def share_above(self, hz: float = 125.0) -> dict[str, Array]:
        """Part of each signal's power above a frequency; of little meaning for a joint that stands still."""
        out = {}
        for name, x in self._signals().items():
            total = self._power(x, 0.0)
            out[name] = np.divide(self._power(x, hz), total, out=np.zeros_like(total), where=total > 0)
        return out

    def _signals(self) -> dict[str, Array]:
        return {"position": self.position, "velocity": self.velocity, "torque": self.torque}

    def _power(self, x: Array, hz: float) -> Array:
        window = signal.windows.hann(len(x))
        power = np.abs(np.fft.rfft(signal.detrend(x, axis=0) * window[:, None], axis=0)) ** 2
        above = np.fft.rfftfreq(len(x), 1.0 / self.rate_hz) > hz
        return np.asarray(2.0 * power[above].sum(axis=0) / (len(x) * (window @ window)))


@dataclass(frozen=True, eq=False)
class Simulation:
    """One run.

    Attributes
    ----------
    robot : Robot
    trajectory : Trajectory
    time : array, shape (N,), s
        At the log's rate.
    q, v : array, shape (N, n)
        All coordinates and their rates at these instants, exact (not filtered, no noise).
    work : array, shape (N,), J
        Of the drive torques since the start.
    dissipated : array, shape (N,), J
        By friction and damping since the start.
    recording : Recording
        What the controller logs: measured and filtered.
    raw : RawLog or None
        Where it was asked for.
    ended : str or None
        Why, when and where the run ended early; None where it did not.
    """

    robot: Robot
    trajectory: Trajectory
    time: Array
    q: Array
    v: Array
    work: Array
    dissipated: Array
    recording: Recording
    raw: RawLog | None = None
    ended: str | None = None

    @cached_property
    def tip(self) -> Array:
        """Pose of the tip frame, shape (N, 4, 4), in the base frame, m."""
        return _tip_poses(self.robot.model, self.robot.tip_frame, self.q)

    @cached_property
    def reference_tip(self) -> Array:
        """Pose that the rigid robot's tip frame would have at the references, shape (N, 4, 4)."""
        reference = self.recording.reference_position
        assert reference is not None
        return _tip_poses(self.robot.tree, self.robot.tip_frame, reference)

    @cached_property
    def tip_deviation_mm(self) -> Array:
        """Tip less reference tip, base frame, mm, shape (N, 3)."""
        return 1e3 * (self.tip[:, :3, 3] - self.reference_tip[:, :3, 3])

    @cached_property
    def path_deviation_mm(self) -> Array:
        """Tip deviation along the path, across it in the horizontal plane (to the left), and up; mm, shape (N, 3).

        As in figure 4.7, whose (a) is the last column and (b) the second. The path's direction is that of the
        reference's horizontal motion; where it stands still, the direction that it had before (or will have first).
        """
        xy = np.gradient(self.reference_tip[:, :2, 3], axis=0)
        size = np.linalg.norm(xy, axis=1)
        moving = np.flatnonzero(size > 1e-9)
        if len(moving) == 0:
            xy, size, moving = np.tile([1.0, 0.0], (len(size), 1)), np.ones(len(size)), np.arange(len(size))
        last = moving[np.maximum(np.searchsorted(moving, np.arange(len(size)), side="right") - 1, 0)]
        along = xy[last] / size[last, None]
        x, y = self.tip_deviation_mm[:, 0], self.tip_deviation_mm[:, 1]
        across = along[:, 0] * y - along[:, 1] * x
        return np.stack([along[:, 0] * x + along[:, 1] * y, across, self.tip_deviation_mm[:, 2]], axis=1)

    @cached_property
    def energy(self) -> Array:
        """Kinetic and potential energy of links, drives and springs, shape (N,), J."""
        return np.array([self.robot.energy(q, v) for q, v in zip(self.q, self.v, strict=True)])

    @property
    def power_balance_error(self) -> float:
        """Largest ``|work - dissipated - change of energy|`` of the run over the largest of these, dimensionless."""
        stored = self.energy - self.energy[0]
        largest = max(float(np.abs(x).max()) for x in (self.work, self.dissipated, stored))
        return float(np.abs(self.work - self.dissipated - stored).max()) / largest if largest > 0.0 else 0.0


def simulate(
    robot: Robot,
    controller: CS8,
    trajectory: Trajectory,
    *,
    noise: Noise | None = None,
    rng: np.random.Generator | None = None,
    substeps: int = 1,
    raw: bool = False,
    role: Role = "identification",
) -> Simulation:
    """One run of a robot under its controller: `simulate_lanes` with one lane."""
    return simulate_lanes(robot, controller, [trajectory], noise=noise, rng=rng, substeps=substeps, raw=raw, role=role)[
        0
    ]


def simulate_lanes(
    robot: Robot,
    controller: CS8,
    trajectories: Sequence[Trajectory],
    *,
    noise: Noise | None = None,
    rng: np.random.Generator | None = None,
    substeps: int = 1,
    raw: bool = False,
    role: Role = "identification",
) -> list[Simulation]:
    """Several runs of one robot, advanced together.

    Each starts at its first reference, drives moving as it asks, hinges deformed as the weight deforms them and the
    controller's integrators holding that weight.

    Parameters
    ----------
    robot : Robot
    controller : CS8
        With a controller for each of the robot's joints.
    trajectories : sequence of Trajectory
        Of one length and rate, on the robot's joints.
    noise : Noise, optional
    rng : numpy.random.Generator, optional
        Needed with noise. Each lane draws from its own child of it, so that a run does not depend on its neighbours.
    substeps : int
        Steps of the integrator a period of the controller; its error falls with the square.
    raw : bool
        Whether to keep the log at the controller's rate as well.
    role : of the recordings.

    Returns
    -------
    list of Simulation
        One a trajectory. A run that cannot go on (torque at its limit, joint limit, overspeed, a jump in the reference,
        divergence) ends there: `Simulation.ended` says when and where, and what was simulated is kept.

    Raises
    ------
    ValueError
        Trajectories that do not fit the robot, the controller or each other.
    """
    _refuse(robot, controller, trajectories, noise, rng, substeps)
    job = _Job(robot, controller.for_joints(robot.joints), tuple(trajectories), noise or Noise(), substeps, raw, role)
    children = [] if rng is None else rng.spawn(len(trajectories))
    return _Runner(job, children).run()


def _refuse(
    robot: Robot,
    controller: CS8,
    trajectories: Sequence[Trajectory],
    noise: Noise | None,
    rng: np.random.Generator | None,
    substeps: int,
) -> None:
    if not trajectories:
        raise ValueError("no trajectory to simulate")
    if noise is not None and rng is None:
        raise ValueError("noise needs a numpy.random.Generator: pass rng")
    if substeps < 1:
        raise ValueError(f"substeps is {substeps}; expected 1 or more")
    first = trajectories[0]
    for t in trajectories:
        if t.joints != robot.joints:
            raise ValueError(f"trajectory {t.name!r} is of joints {t.joints}; expected {robot.joints} of {robot.name}")
        if t.rate_hz != controller.reference_rate_hz:
            raise ValueError(
                f"trajectory {t.name!r} has {t.rate_hz:g} Hz; the controller takes {controller.reference_rate_hz:g}"
            )
        if len(t.position) != len(first.position) or len(t.position) < 2:
            raise ValueError(
                f"trajectory {t.name!r} has {len(t.position)} samples; expected {len(first.position)}, at least 2"
            )


# ---- start ------------------------------------------------------------------------------------------------------


def static_start(robot: Robot, position: Array, velocity: Array) -> tuple[Array, Array, Array]:
    """Coordinates, rates and drive torques with drives at given angles and speeds and no acceleration.

    Parameters
    ----------
    position, velocity : array, shape (joints,)

    Returns
    -------
    q, v : array, shape (n,)
        The hinges' deformation is what weight and friction ask for.
    torque : array, shape (joints,), N m
    """
    n = robot.model.nv
    drives = drive_places(robot)
    free = np.setdiff1d(np.arange(n), drives)
    q, v, rest = np.zeros(n), np.zeros(n), np.zeros(n)
    q[drives], v[drives] = position, velocity
    for _ in range(20 if len(free) else 0):
        missing = robot.inverse_dynamics(q, v, rest)[free]
        step = np.linalg.solve(robot.linearize(q, v, rest).K[np.ix_(free, free)], missing)
        q[free] -= step
        if np.abs(step).max() < 1e-14:
            break
    return q, v, robot.input_matrix.T @ robot.inverse_dynamics(q, v, rest)


class _Jump(NamedTuple):
    """The last sample of a reference before it moves faster than the robot may."""

    sample: int
    joint: int
    speed: float


def _reference_jump(trajectory: Trajectory, speed: Array) -> _Jump | None:
    steps = np.abs(np.diff(trajectory.position, axis=0)) * trajectory.rate_hz
    rates = np.maximum(steps, np.abs(trajectory.velocity[1:]))
    over = np.argwhere(rates > speed)
    if len(over) == 0:
        return None
    sample, joint = int(over[0, 0]), int(over[0, 1])
    return _Jump(sample, joint, float(rates[sample, joint]))


def micro_interpolate(position: Array, velocity: Array, rows: Indices, up: int, rate_hz: float) -> tuple[Array, Array]:
    """References between samples: the cubic that has position and velocity of both ends.

    Parameters
    ----------
    position, velocity : array, shape (lanes, N, joints)
    rows : intervals, each from its sample to the next; behind the last sample the reference goes on with its last
    velocity. up : points an interval.

    Returns
    -------
    position, velocity : array, shape (lanes, len(rows) * up, joints)
    """
    lanes, count, joints = position.shape
    after = np.minimum(rows + 1, count - 1)
    x0, v0, v1 = position[:, rows, None], velocity[:, rows, None] / rate_hz, velocity[:, after, None] / rate_hz
    x1 = np.where((rows + 1 < count)[:, None, None], position[:, after, None], x0 + v0)
    s = (np.arange(up) / up)[:, None]
    # Hermite's form, in the unit interval
    more = x1 - x0 - v0
    bend = v1 - v0
    x = x0 + v0 * s + (3.0 * more - bend) * s**2 + (bend - 2.0 * more) * s**3
    v = v0 + 2.0 * (3.0 * more - bend) * s + 3.0 * (bend - 2.0 * more) * s**2
    shape = lanes, len(rows) * up, joints
    return np.ascontiguousarray(x.reshape(shape)), np.ascontiguousarray(rate_hz * v.reshape(shape))


class _Decimator:
    """The anti-alias filter before the log: linear phase, its delay taken out, fed chunk by chunk.

    The ends are continued by odd reflection, so that value and slope go on.
    """

    def __init__(self, controller: CS8, stride: int) -> None:
        width = FILTER_TRANSITION * controller.log_cutoff_hz / (0.5 * controller.controller_rate_hz)
        taps, beta = signal.kaiserord(FILTER_ATTENUATION_DB, width)
        self.half = -(-taps // 2 // stride) * stride
        window = ("kaiser", beta)
        rate = controller.controller_rate_hz
        self.weights = signal.firwin(2 * self.half + 1, controller.log_cutoff_hz, window=window, fs=rate)
        self.stride = stride
        self.waiting: Array | None = None

    def push(self, samples: Array) -> Array:
        """Add (lanes, samples, channels), take what is ready, (lanes, outputs, channels)."""
        if self.waiting is None:
            ahead = np.minimum(np.arange(self.half, 0, -1), samples.shape[1] - 1)
            self.waiting = 2.0 * samples[:, :1] - samples[:, ahead]
        buffer = np.concatenate([self.waiting, samples], axis=1)
        ready = max(0, (buffer.shape[1] - len(self.weights)) // self.stride + 1)
        out = np.zeros((buffer.shape[0], ready, buffer.shape[2]))
        stepping.decimate(buffer, self.weights, self.stride, out)
        self.waiting = np.ascontiguousarray(buffer[:, ready * self.stride :])
        return out

    def finish(self) -> Array:
        """What the last samples still owe."""
        assert self.waiting is not None
        behind = np.maximum(self.waiting.shape[1] - 2 - np.arange(self.half), 0)
        return self.push(2.0 * self.waiting[:, -1:] - self.waiting[:, behind])


def _tip_poses(model: pin.Model, frame: str, q: Array) -> Array:
    data, tip = model.createData(), model.getFrameId(frame)
    out = np.empty((len(q), 4, 4))
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        out[k] = data.oMf[tip].homogeneous
    return out


# ---- the runner -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Job:
    robot: Robot
    controller: CS8
    trajectories: tuple[Trajectory, ...]
    noise: Noise
    substeps: int
    raw: bool
    role: Role


class _Runner:
    """Advances all lanes of a job chunk by chunk and gathers their logs."""

    def __init__(self, job: _Job, children: Sequence[np.random.Generator]) -> None:
        self.job = job
        self.children = children
        controller = job.controller
        self.up = round(controller.controller_rate_hz / controller.reference_rate_hz)
        self.stride = round(controller.controller_rate_hz / controller.log_rate_hz)
        self.samples = len(job.trajectories[0].position) * self.up
        self.loop = _loop(job.robot, controller, job.substeps)
        self.plant: Plant = job.robot.plant
        self.memory = self.plant.scratch(len(job.trajectories))
        self.position = np.stack([t.position for t in job.trajectories])
        self.velocity = np.stack([t.velocity for t in job.trajectories])
        self.torque = np.stack([t.torque for t in job.trajectories])
        self.jumps = [_reference_jump(t, self.loop.speed) for t in job.trajectories]
        self.lanes = self._start()
        self.last: Array = np.zeros(0)  # measured signals at the end of the last chunk
        self.late_q, self.late_v = np.zeros_like(self.lanes.q), np.zeros_like(self.lanes.q)

    def _start(self) -> Lanes:
        starts: dict[bytes, tuple[Array, Array, Array]] = {}
        found = []
        for r, w in zip(self.position[:, 0], self.velocity[:, 0], strict=True):
            key = np.r_[r, w].tobytes()
            if key not in starts:  # the runs of a campaign start alike
                starts[key] = static_start(self.job.robot, r, w)
            found.append(starts[key])
        q, v, torque = (np.stack(x) for x in zip(*found, strict=True))
        count, joints = torque.shape
        whole = [np.zeros(count, dtype=np.int64) for _ in range(3)]
        jumps = [(self.samples, 0) if jump is None else (jump.sample * self.up, jump.joint) for jump in self.jumps]
        return Lanes(
            q=q,
            v=v,
            a=np.zeros_like(q),
            integral=torque - self.torque[:, 0],
            current=torque.copy(),
            held=torque.copy(),
            overloaded=np.zeros((count, joints), dtype=np.int64),
            open=np.zeros(count),
            closed=np.zeros(count),
            divided=np.zeros(count, dtype=np.int64),
            work=np.zeros(count),
            dissipated=np.zeros(count),
            status=whole[0],
            joint=whole[1],
            sample=whole[2],
            stop=np.array(jumps, dtype=np.int64),
        )

    def run(self) -> list[Simulation]:
        """All chunks, then the results."""
        size = max(round(CHUNK_S * self.job.controller.controller_rate_hz) // (self.up * self.stride), 1)
        size *= self.up * self.stride
        joints = len(self.job.robot.joints)
        filtered = _Decimator(self.job.controller, self.stride)
        states: list[tuple[Array, ...]] = []
        raw: list[Array] = []
        logged: list[Array] = []
        for first in range(0, self.samples, size):
            samples = min(size, self.samples - first)
            inputs, logs = self._inputs(first, samples), self._logs(samples)
            self._advance(inputs, logs, samples)
            measured = np.concatenate([logs.position, logs.velocity, logs.torque], axis=2)
            self._add_torque_noise(measured[:, :, 2 * joints :])
            logged.append(filtered.push(self._held_at_end(measured, first, samples)))
            states.append((logs.q, logs.v, logs.work, logs.dissipated))
            if self.job.raw:
                raw.append(measured)
            if self.lanes.status.all():
                break
        logged.append(filtered.finish())
        parts = [np.concatenate(x, axis=1) for x in zip(*states, strict=True)]
        whole = np.concatenate(raw, axis=1) if raw else None
        log = np.concatenate(logged, axis=1)
        return [self._result(i, log[i], parts, whole) for i in range(len(self.jumps))]

    def _inputs(self, first: int, samples: int) -> Inputs:
        rows = np.arange(first // self.up, (first + samples) // self.up)
        position, velocity = micro_interpolate(
            self.position, self.velocity, rows, self.up, self.job.trajectories[0].rate_hz
        )
        after = np.minimum(rows + 1, self.torque.shape[1] - 1)
        part = (np.arange(self.up) / self.up)[:, None]
        torque = self.torque[:, rows, None] * (1.0 - part) + self.torque[:, after, None] * part
        noise = [self._noise(getattr(self.job.noise, name), samples) for name in ("position", "velocity")]
        shape = position.shape
        return Inputs(first, position, velocity, np.ascontiguousarray(torque.reshape(shape)), *noise)

    def _noise(self, deviation: float | tuple[float, ...], samples: int) -> Array:
        count, _, joints = self.position.shape
        if not np.any(deviation) and not np.any([self.job.noise.position, self.job.noise.velocity]):
            return np.zeros((count, 0, joints))
        return np.stack([child.standard_normal((samples, joints)) * deviation for child in self.children])

    def _add_torque_noise(self, torque: Array) -> None:
        if np.any(self.job.noise.torque):
            for lane, child in zip(torque, self.children, strict=True):
                lane += child.standard_normal(lane.shape) * self.job.noise.torque

    def _logs(self, samples: int) -> Logs:
        count, n = self.lanes.q.shape
        joints, states = len(self.loop.drive), -(-samples // self.stride)
        signals = (np.zeros((count, samples, joints)) for _ in range(3))
        return Logs(
            self.stride,
            *signals,
            *(np.zeros((count, states, n)) for _ in range(2)),
            *(np.zeros((count, states)) for _ in range(2)),
        )

    def _held_at_end(self, measured: Array, first: int, samples: int) -> Array:
        """Signals of lanes that have ended, held at their last value for the filter."""
        held = measured
        for lane in np.flatnonzero(self.lanes.status):
            last = int(self.lanes.sample[lane]) - first
            if last < samples:
                held = held.copy() if held is measured else held
                held[lane, max(last, 0) :] = measured[lane, last] if last >= 0 else self.last[lane]
        self.last = held[:, -1]
        return held

    # ---- advancing --------------------------------------------------------------------------------------

    def _advance(self, inputs: Inputs, logs: Logs, samples: int) -> None:
        if self.plant.others:
            self._advance_by_parts(inputs, logs, samples)
        else:
            tree, laws = self.plant.tree, self.plant.laws
            stepping.run(tree, laws, self.memory, self.loop, no_extra(), self.lanes, inputs, logs, samples)

    def _advance_by_parts(self, inputs: Inputs, logs: Logs, samples: int) -> None:
        """The loop of `stepping.run`, with the effects that have no compiled law asked for their forces in between."""
        lanes, loop = self.lanes, self.loop
        torque = np.zeros_like(lanes.q)
        h = loop.period / loop.substeps
        for k in range(samples):
            stepping.control_all(loop, lanes, inputs, logs, k, torque)
            if lanes.status.all():
                return
            for part in range(loop.substeps):
                kept = tuple(x.copy() for x in lanes)
                time = (inputs.first + k) * loop.period + part * h
                bend = self._step(torque, time, h)
                if part == 0 and k % logs.stride == 0:
                    running = lanes.status == stepping.RUNNING
                    logs.dissipated[running, k // logs.stride] = lanes.closed[running]
                if bend > loop.tolerance:
                    for now, before in zip(lanes, kept, strict=True):
                        now[:] = before
                    lanes.divided[:] += 1
                    fine = h / stepping.DIVISION
                    for i in range(stepping.DIVISION):
                        self._step(torque, time + i * fine, fine)

    def _step(self, torque: Array, time: float, h: float) -> float:
        """One step of all lanes; returns the largest bend of the laws."""
        tree, laws, lanes, loop, memory = self.plant.tree, self.plant.laws, self.lanes, self.loop, self.memory
        extra = self._extra(time)
        stepping.begin_all(tree, laws, memory, loop, extra, lanes, torque, h, self.late_q, self.late_v)
        late = self._force(self.late_q, self.late_v, lanes.a, time + h)
        return float(stepping.finish_all(tree, laws, memory, loop, extra, late, lanes, torque, h))

    def _force(self, q: Array, v: Array, a: Array, time: float) -> Array:
        motion = self.job.robot.motion(q, v, a, np.full(len(q), time))
        return np.ascontiguousarray(sum(effect.force(motion) for effect in self.plant.others))

    def _extra(self, time: float) -> Extra:
        """Forces and slopes of the effects without a compiled law, at the lanes' states."""
        robot, lanes = self.job.robot, self.lanes
        times = np.full(len(lanes.q), time)
        motion = robot.motion(lanes.q, lanes.v, lanes.a, times)
        still = robot.motion(lanes.q, np.zeros_like(lanes.v), np.zeros_like(lanes.v), times)
        count, n = lanes.q.shape
        force, lost = np.zeros((count, n)), np.zeros(count)
        slopes = [np.zeros((count, n, n)) for _ in range(3)]
        for effect in self.plant.others:
            own = effect.force(motion)
            force += own
            for total, slope in zip(slopes, effect.derivatives(motion), strict=True):
                total += slope
            lost += _dissipated(effect, own, motion, still)
        # the compiled step wants the part that does not depend on the acceleration
        force -= np.einsum("lij,lj->li", slopes[2], lanes.a)
        by_q, by_v, by_a = (np.ascontiguousarray(x) for x in slopes)
        return Extra(True, lost, force, by_a, by_v, by_q)

    # ---- results ----------------------------------------------------------------------------------------

    def _result(self, lane: int, logged: Array, parts: Sequence[Array], raw: Array | None) -> Simulation:
        job, trajectory = self.job, self.job.trajectories[lane]
        joints = len(job.robot.joints)
        ended = self._why(lane)
        end = self.samples if ended is None else int(self.lanes.sample[lane]) + 1
        count = -(-end // self.stride)
        time = np.arange(count) / job.controller.log_rate_hz
        q, v, work, dissipated = (part[lane, :count] for part in parts)
        at = np.minimum(np.arange(count) * self.stride, self.samples - 1)
        reference = self._references(lane, at)
        period = trajectory.period_s if ended is None else None
        recording = Recording(
            name=trajectory.name,
            role=job.role,
            time=time,
            sample_rate_hz=job.controller.log_rate_hz,
            joints=trajectory.joints,
            position=logged[:count, :joints],
            velocity=logged[:count, joints : 2 * joints],
            torque=logged[:count, 2 * joints :],
            reference_position=reference[0],
            reference_velocity=reference[1],
            feedforward_torque=None if trajectory.feedforward is None else reference[2],
            period_s=period,
        )
        own = None
        if raw is not None:
            split = np.split(raw[lane, :end], 3, axis=1)
            own = RawLog(job.controller.controller_rate_hz, *split)
        return Simulation(job.robot, trajectory, time, q, v, work, dissipated, recording, own, ended)

    def _references(self, lane: int, samples: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """References and feed-forward torque of a lane at samples of the controller, each (N, joints)."""
        rate = self.job.trajectories[0].rate_hz
        rows, part = np.divmod(samples, self.up)
        if not part.any():
            return self.position[lane, rows], self.velocity[lane, rows], self.torque[lane, rows]
        fine = micro_interpolate(self.position[lane : lane + 1], self.velocity[lane : lane + 1], rows, self.up, rate)
        place = np.arange(len(rows)) * self.up + part
        after, share = np.minimum(rows + 1, len(self.torque[lane]) - 1), part[:, None] / self.up
        torque = self.torque[lane, rows] * (1.0 - share) + self.torque[lane, after] * share
        return fine[0][0, place], fine[1][0, place], torque

    def _why(self, lane: int) -> str | None:
        status, joint = int(self.lanes.status[lane]), int(self.lanes.joint[lane])
        if status == stepping.RUNNING:
            return None
        at = f"at t = {self.lanes.sample[lane] / self.job.controller.controller_rate_hz:.4f} s"
        if status == stepping.DIVERGED:
            return f"{at} the motion diverged: coordinates are no longer finite"
        name, place = self.job.robot.joints[joint], int(self.loop.drive[joint])
        if status == stepping.JUMP:
            jump = self.jumps[lane]
            assert jump is not None
            return f"{at} the reference of {name} jumps: {jump.speed:.3g} rad/s, over {self.loop.speed[joint]:.3g}"
        if status == stepping.OVERLOAD:
            held, limit = 1e3 * self.job.controller.overload_time_s, self.loop.torque_limit[joint]
            return f"{at} the torque of {name} has been at its limit of {limit:g} N m for {held:g} ms"
        if status == stepping.OVERSPEED:
            speed_now = self.lanes.v[lane, place]
            return f"{at} {name} turns at {speed_now:.3g} rad/s, over {self.loop.speed[joint]:.3g}"
        limits = f"{self.loop.lower[joint]:.4g} to {self.loop.upper[joint]:.4g} rad"
        return f"{at} {name} is at {self.lanes.q[lane, place]:.4g} rad, outside its limits {limits}"


def _dissipated(effect: Effect, force: Array, motion: Motion, still: Motion) -> Array:
    """Power that an effect without a compiled law takes out of the motion for good, shape (lanes,), W.

    What it asks for beyond its force at rest (which its `potential` holds) and beyond what goes into kinetic energy.
    """
    if effect.part in ("links", "drives"):
        return np.zeros(len(motion))
    if not effect.needs_load:
        force = effect.force(dataclasses.replace(motion, a=np.zeros_like(motion.a)))
    return np.asarray(np.sum((force - effect.force(still)) * motion.v, axis=1))


def _loop(robot: Robot, controller: CS8, substeps: int) -> Loop:
    """The controller in numbers for the compiled loop."""
    tree = robot.tree
    return Loop(
        drive=drive_places(robot),
        period=controller.period,
        substeps=substeps,
        tolerance=TOLERANCE,
        position_gain=controller.column("position_gain"),
        velocity_gain=controller.column("velocity_gain"),
        integral_gain=controller.column("integral_gain"),
        position_step=controller.column("position_step"),
        velocity_step=controller.column("velocity_step"),
        torque_step=controller.column("torque_step"),
        torque_limit=controller.column("torque_limit"),
        current_mean=controller.current_loop[0],
        current_left=controller.current_loop[1],
        overload_samples=max(1, round(controller.overload_time_s * controller.controller_rate_hz)),
        lower=np.array(tree.lowerPositionLimit, dtype=float),
        upper=np.array(tree.upperPositionLimit, dtype=float),
        speed=SPEED_MARGIN * np.array(tree.upperVelocityLimit, dtype=float),
    )
