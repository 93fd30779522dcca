"""Closed-loop simulation of the nonlinear flexible robot under its controller, many runs at once.

Between two samples of the controller the drive torques are constant, and the robot moves by a linearly implicit
(Rosenbrock-W) method of second order, L-stable, with the analytic Jacobian of all that is stiff: see
`rx90b_flex.compiled.step`. Steps end at the controller's samples, so that no step crosses a jump of the torque.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

from rx90b_flex.compiled.controller import (
    DIVERGED,
    JUMP,
    OVERLOAD,
    OVERSPEED,
    RUNNING,
    Filters,
    Inputs,
    Lanes,
    Logs,
    Loop,
)
from rx90b_flex.compiled.loop import run
from rx90b_flex.effects.law import Law, links_ahead
from rx90b_flex.effects.log_effect import LogEffect, between, in_simulation
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.plant import Plant, Stepped, wide_of
from rx90b_flex.robot import Robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals.recording import Recording, Role
from rx90b_flex.simulate.by_parts import ByParts, measurement_errors
from rx90b_flex.simulate.cs8 import CS8, drive_places
from rx90b_flex.simulate.decimation import Decimator
from rx90b_flex.simulate.filters import at_rest
from rx90b_flex.simulate.trajectories import Trajectory

Indices = NDArray[np.int64]
Progress = Callable[[float], None]

CHUNK_S = 0.256  # inputs and logs at the controller's rate are kept for so long; it bounds memory
TOLERANCE = 3e-8  # rad; a step along which the effects' laws bend more is taken in eight parts
# A step of a static start's Newton iteration that is this much smaller than the last keeps its stiffness.
SHRINKS = 1e-2
TURNS_ON, SLIDES_ON = (
    1e-3,
    1e-4,
)  # rad, m; choice: a drive at rest at its limit gives way by less, and a run goes on there
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

    def share_above(self, hz: float = 125.0) -> dict[str, Array]:
        """Part of each signal's power above a frequency (Hann window, trends left out); of little meaning for a joint at rest."""
        window = signal.windows.hann(len(self.position))[:, None]
        lines = np.fft.rfftfreq(len(window), 1.0 / self.rate_hz)
        out = {}
        for name, x in (("position", self.position), ("velocity", self.velocity), ("torque", self.torque)):
            power = np.abs(np.fft.rfft(signal.detrend(x, axis=0) * window, axis=0)) ** 2
            above, total = (power[lines > at].sum(axis=0) for at in (hz, 0.0))
            out[name] = np.divide(above, total, out=np.zeros_like(total), where=total > 0)
        return out


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Showing):
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
        motion = self.robot.motion(self.q, self.v, np.zeros_like(self.v), self.time)
        laws = (law for effect in self.robot.effects for law in effect.laws(motion) or ())
        return tip_poses(self.robot.model, self.robot.tip_frame, links_ahead(laws, self.q))

    @cached_property
    def reference_tip(self) -> Array:
        """Pose that the rigid robot's tip frame would have at the references, shape (N, 4, 4)."""
        reference = self.recording.reference_position
        assert reference is not None
        return tip_poses(self.robot.tree, self.robot.tip_frame, reference)

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
    progress: Progress | None = None,
) -> Simulation:
    """One run of a robot under its controller: `simulate_lanes` with one lane."""
    (run,) = simulate_lanes(
        robot, controller, [trajectory], noise=noise, rng=rng, substeps=substeps, raw=raw, role=role, progress=progress
    )
    return run


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
    progress: Progress | None = None,
) -> list[Simulation]:
    """Several runs of one robot, advanced together.

    Each starts at its first reference, drives moving as it asks, hinges deformed as the weight deforms them and the
    controller's integrators holding that weight; a drive whose controller has no integral starts below its reference, as far as
    its position gain takes to hold the weight.

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
    progress : callable, optional
        Called with the part of the time that is simulated.

    Returns
    -------
    list of Simulation
        One a trajectory. A run that cannot go on (torque at its limit, joint limit, overspeed, a jump in the reference,
        divergence) ends there: `Simulation.ended` says when and where, and what was simulated is kept.

    Raises
    ------
    ValueError
        Trajectories that do not fit the robot, the controller or each other; a flexible drive without inertia.
    """
    _refuse(robot, controller, trajectories, noise, rng, substeps)
    robot, between = _as_simulated(robot)
    job = _Job(
        robot, between, controller.for_joints(robot.joints), tuple(trajectories), noise or Noise(), substeps, raw, role
    )
    children = [] if rng is None else rng.spawn(len(trajectories))
    return _Runner(job, children).run(progress)


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
    robot.check_drives()
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


def _as_simulated(robot: Robot) -> tuple[Robot, tuple[LogEffect, ...]]:
    """The robot with its forces as a simulation has them, and the effects that stand between it and the log."""
    try:
        forces = in_simulation(robot.effects)
    except ValueError as error:
        raise ValueError(f"{robot.name}: {error}") from None
    before_log = between(robot.effects)
    return (robot.with_effects(forces) if before_log else robot), before_log


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
    stiffness, last = np.eye(len(free)), 0.0
    for _ in range(20 if len(free) else 0):
        missing = robot.inverse_dynamics(q, v, rest)[free]
        step = np.linalg.solve(stiffness, missing)
        if not np.abs(step).max() < SHRINKS * last:
            stiffness = robot.linearize(q, v, rest).K[np.ix_(free, free)]
            step = np.linalg.solve(stiffness, missing)
        q[free] -= step
        last = np.abs(step).max()
        if last < 1e-14:
            break
    return q, v, robot.input_matrix.T @ robot.inverse_dynamics(q, v, rest)


class _Jump(NamedTuple):
    """The last sample of a reference before it moves faster than the robot may."""

    sample: int
    joint: int
    speed: float
    lasts: bool  # the samples before and after it are as fast, or nearly: no jump, that is


def _reference_jump(trajectory: Trajectory, speed: Array) -> _Jump | None:
    steps = np.abs(np.diff(trajectory.position, axis=0)) * trajectory.rate_hz
    rates = np.maximum(steps, np.abs(trajectory.velocity[1:]))
    over = np.argwhere(rates > speed)
    if len(over) == 0:
        return None
    sample, joint = int(over[0, 0]), int(over[0, 1])
    around = rates[max(sample - 1, 0) : sample + 2, joint]
    return _Jump(sample, joint, float(rates[sample, joint]), bool(around.min() > 0.5 * rates[sample, joint]))


def hermite(position: Array, velocity: Array, rows: Indices, part: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Cubic through positions and velocities of samples, at parts of the intervals that begin at `rows`.

    Parameters
    ----------
    position, velocity : array, shape (N, ...)
    rows : array, shape (R,)
        Behind the last sample the motion goes on with its last velocity.
    part : array, shape (P,), 0 to 1

    Returns
    -------
    position, velocity, acceleration : array, shape (R * P, ...)
    """
    after = np.minimum(rows + 1, len(position) - 1)
    x0, v0, v1 = position[rows, None], velocity[rows, None] / rate_hz, velocity[after, None] / rate_hz
    inside = (rows + 1 < len(position)).reshape(-1, *[1] * (x0.ndim - 1))
    x1 = np.where(inside, position[after, None], x0 + v0)
    s = np.reshape(part, (-1, *[1] * (position.ndim - 1)))
    more, bend = x1 - x0 - v0, v1 - v0
    square, cube = 3.0 * more - bend, bend - 2.0 * more
    x = x0 + v0 * s + square * s**2 + cube * s**3
    v = v0 + 2.0 * square * s + 3.0 * cube * s**2
    a = 2.0 * square + 6.0 * cube * s
    shape = len(rows) * len(s), *position.shape[1:]
    return x.reshape(shape), rate_hz * v.reshape(shape), rate_hz**2 * a.reshape(shape)


def tip_poses(model: pin.Model, frame: str, q: Array) -> Array:
    """Poses of a frame at positions (N, n), shape (N, 4, 4), in the base frame, m."""
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
    between: tuple[LogEffect, ...]  # robot and log
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
        self.position, self.velocity = (
            _lanes_last([getattr(t, x) for t in job.trajectories]) for x in ("position", "velocity")
        )
        self.forward = [controller.fed_forward(t.position, t.velocity, t.feedforward) for t in job.trajectories]
        self.jumps = [_reference_jump(t, self.loop.speed) for t in job.trajectories]
        self.lanes = self._start()
        self.last: Array = np.zeros(0)  # measured signals at the end of the last chunk
        rest = job.robot.motion(self.lanes.q, self.lanes.v, self.lanes.a)
        laws = self._laws(rest)
        self.parts: ByParts | None = None
        self.behind: Stepped | None = None  # coordinates that the lanes are in; None: the robot's
        if laws is None:
            self.parts = ByParts(job.robot, job.between, self.loop, self.lanes)
        else:
            self._step_compiled(laws)
        self.shows = any(e.measurement_error(rest) is not None for e in job.between)
        ahead = max((e.history_s for e in job.between), default=0.0)
        rows = int(np.ceil(ahead * controller.controller_rate_hz))
        # before the start the motors held the weight, as the controller's integrators do
        self.given: Array = np.tile(self.lanes.held, (rows, 1, 1))  # torques that `logged_torque` looks back on

    def _step_compiled(self, laws: Sequence[Law]) -> None:
        """Go over to the coordinates in which the plant is stepped, and take these laws beside those that it has."""
        self.behind = behind = self.plant.stepped
        self.lanes = self.lanes._replace(q=behind.of(self.lanes.q), v=behind.of(self.lanes.v))
        self.loop = self.loop._replace(drive=behind.order.drives)
        of_robot = [law for law in laws if law.at in ("force", "links")]
        of_motors = [law for law in laws if law.at in ("measured", "motor")]
        self.wide = wide_of(of_robot, self.plant, self.lanes.q) if of_robot else None
        self.between = wide_of(of_motors, self.plant, self.lanes.q) if of_motors else None

    def _start(self) -> Lanes:
        starts: dict[bytes, tuple[Array, Array, Array]] = {}
        found = []
        for t, forward in zip(self.job.trajectories, self.forward, strict=True):
            fed = np.zeros(len(self.loop.drive)) if forward is None else forward[0]
            key = np.r_[t.position[0], t.velocity[0], fed].tobytes()
            if key not in starts:  # the runs of a campaign start alike
                starts[key] = self._static_start(t.position[0], t.velocity[0], fed)
            found.append(starts[key])
        q, v, torque = (np.stack(x) for x in zip(*found, strict=True))
        torque = np.ascontiguousarray(torque.T)
        count, joints = len(q), len(torque)
        forward = np.stack([np.zeros(joints) if x is None else x[0] for x in self.forward], axis=1)
        whole = [np.zeros(count, dtype=np.int64) for _ in range(3)]
        speed = np.ascontiguousarray(v[:, self.loop.drive].T)
        chains = zip(self.job.controller.sections, (speed, torque), strict=True)
        jumps = [(self.samples, 0) if jump is None else (jump.sample * self.up, jump.joint) for jump in self.jumps]
        return Lanes(
            q=q,
            v=v,
            a=np.zeros_like(q),
            integral=np.where(self._sags[:, None], 0.0, torque - forward),
            filtered=np.concatenate([at_rest(*each) for each in chains], axis=1),
            current=torque.copy(),
            held=torque.copy(),
            overloaded=np.zeros((joints, count), dtype=np.int64),
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

    @property
    def _sags(self) -> Array:
        """Which joints have no integral that could hold a torque, shape (joints,), bool: their angle error orders it."""
        return (self.loop.integral_gain == 0.0) & (self.loop.position_gain > 0.0)

    def _static_start(self, position: Array, velocity: Array, forward: Array) -> tuple[Array, Array, Array]:
        """`static_start` where the controller is shown these angles, with the torques that it then orders.

        A joint whose controller has no integral stands below its reference, as far as its position gain takes to order what is
        not fed `forward`, (joints,).
        """

        def ordered(angle: Array) -> tuple[Array, Array, Array]:
            q, v, torque = static_start(self.job.robot, angle, velocity)
            for effect in self.job.between:
                torque = effect.commanded_torque(self.job.robot.joints, torque[None])[0]
            return q, v, torque

        # errors of angles, and sags, are small: each round leaves their square
        start, sags = ordered(position), self._sags
        for _ in range(3 if self.job.between or sags.any() else 0):
            q, v, torque = start
            off = (
                measurement_errors(self.job.robot, self.job.between, q[None], v[None])[0][0]
                if self.job.between
                else 0.0
            )
            sag = np.where(sags, (torque - forward) / np.where(sags, self.loop.position_gain, 1.0), 0.0)
            start = ordered(position - off - sag)
        return start

    def _laws(self, rest: Motion) -> list[Law] | None:
        """All that is more than a torque by one angle as laws; None where some of it has none, and is worked out in between."""
        laws = [self.plant.wide, *(e.laws(rest) for e in self.job.between)]
        known = [own for own in laws if own is not None]
        return [law for own in known for law in own] if len(known) == len(laws) else None

    def run(self, progress: Progress | None = None) -> list[Simulation]:
        """All chunks, then the results."""
        size = max(round(CHUNK_S * self.job.controller.controller_rate_hz) // (self.up * self.stride), 1)
        size *= self.up * self.stride
        count, n = self.lanes.q.shape
        joints, states = len(self.loop.drive), -(-self.samples // self.stride)
        filtered = Decimator(self.job.controller, self.stride, 3 * joints * count, size)
        logged = np.zeros((states, 3, joints, count))
        out = logged.reshape(states, -1)
        whole = [np.zeros((count, states, n)) for _ in range(2)] + [np.zeros((count, states)) for _ in range(2)]
        raw: list[Array] = []
        done = 0
        for first in range(0, self.samples, size):
            samples = min(size, self.samples - first)
            measured = filtered.inbox(samples).reshape(samples, 3, joints, count)
            logs = Logs(self.stride, first // self.stride, measured, *whole)
            self._advance(self._inputs(first, samples), logs, samples)
            self._note(measured[:, 2], first)
            self._add_torque_noise(measured[:, 2])
            self._hold_ended(measured, first)
            if self.job.raw:
                raw.append(measured.copy())
            done += filtered.push(samples, out[done:])
            if progress is not None:
                progress((first + samples) / self.samples)
            if self.lanes.status.all():
                break
        filtered.finish(out[done:])
        unfiltered = np.concatenate(raw) if raw else None
        if self.behind is not None:
            for lane in (lane for of_all in whole[:2] for lane in of_all):
                lane[:] = self.behind.robots(lane)
        return [self._result(i, logged[..., i], whole, unfiltered) for i in range(count)]

    def _inputs(self, first: int, samples: int) -> Inputs:
        rows = np.arange(first // self.up, (first + samples) // self.up)
        rate = self.job.trajectories[0].rate_hz
        position, velocity, _ = hermite(self.position, self.velocity, rows, np.arange(self.up) / self.up, rate)
        ends = np.minimum(np.append(rows, rows[-1] + 1), len(self.position) - 1)
        torque = np.zeros((len(ends), *self.lanes.held.shape))
        for lane, forward in enumerate(self.forward):
            if forward is not None:
                torque[..., lane] = forward[ends]
        return Inputs(first, self.up, position, velocity, torque, self._noise(samples))

    def _noise(self, samples: int) -> Array:
        """Of angles and speeds, (samples, 2, joints, lanes); one sample of zeros where there is none."""
        noise, (joints, count) = self.job.noise, self.lanes.held.shape
        if not np.any(noise.position) and not np.any(noise.velocity):
            return np.zeros((samples if self.shows else 1, 2, joints, count))
        return self._draw(samples, np.stack([np.broadcast_to(x, joints) for x in (noise.position, noise.velocity)]))

    def _note(self, torque: Array, first: int) -> None:
        """Let what stands before the log act on a chunk of torques (samples, joints, lanes), in place."""
        if not self.job.between:
            return
        logged, behind = np.concatenate([self.given, torque]), len(self.given)
        if behind:
            self.given = logged[-behind:].copy()
        time = (first - behind + np.arange(len(logged))) / self.job.controller.controller_rate_hz
        for effect in self.job.between:
            logged = effect.logged_torque(self.job.robot.joints, time, logged)
        torque[:] = logged[behind:]

    def _add_torque_noise(self, torque: Array) -> None:
        if np.any(self.job.noise.torque):
            torque += self._draw(len(torque), np.broadcast_to(self.job.noise.torque, torque.shape[1]))

    def _draw(self, samples: int, deviation: Array) -> Array:
        """White noise of each lane's own generator, (samples, *shape of `deviation`, lanes)."""
        drawn = np.empty((len(self.children), samples, *deviation.shape))
        for lane, child in zip(drawn, self.children, strict=True):
            child.standard_normal(out=lane)
        out = np.empty((*drawn.shape[1:], len(drawn)))
        return np.multiply(np.moveaxis(drawn, 0, -1), deviation[..., None], out=out)

    def _hold_ended(self, measured: Array, first: int) -> None:
        """Hold the signals of lanes that have ended at their last value, for the filter."""
        for lane in np.flatnonzero(self.lanes.status):
            last = int(self.lanes.sample[lane]) - first
            measured[max(last + 1, 0) :, ..., lane] = measured[last, ..., lane] if last >= 0 else self.last[..., lane]
        self.last = measured[-1].copy()

    # ---- advancing --------------------------------------------------------------------------------------

    def _advance(self, inputs: Inputs, logs: Logs, samples: int) -> None:
        if self.parts is not None:
            self.parts.advance(inputs, logs, samples)
        elif self.behind is not None:
            run(self.behind.packed, self.wide, self.between, self.loop, self.lanes, inputs, logs, samples)

    # ---- results ----------------------------------------------------------------------------------------

    def _result(self, lane: int, logged: Array, states: Sequence[Array], raw: Array | None) -> Simulation:
        job, trajectory = self.job, self.job.trajectories[lane]
        ended = self._why(lane)
        end = self.samples if ended is None else int(self.lanes.sample[lane]) + 1
        count = -(-end // self.stride)
        time = self._time[:count]
        q, v, work, dissipated = (state[lane, :count] for state in states)
        position, velocity, torque = np.moveaxis(logged[:count], 1, 0)
        reference_position, reference_velocity = (x[:count, :, lane % x.shape[2]] for x in self._references)
        recording = Recording(
            name=trajectory.name,
            role=job.role,
            time=time,
            sample_rate_hz=job.controller.log_rate_hz,
            joints=trajectory.joints,
            position=position,
            velocity=velocity,
            torque=torque,
            reference_position=reference_position,
            reference_velocity=reference_velocity,
            feedforward_torque=None if trajectory.feedforward is None else self._at_log(trajectory.feedforward)[:count],
            period_s=trajectory.period_s if ended is None else None,
        )
        own = (
            None if raw is None else RawLog(job.controller.controller_rate_hz, *np.moveaxis(raw[:end, ..., lane], 1, 0))
        )
        return Simulation(job.robot, trajectory, time, q, v, work, dissipated, recording, own, ended)

    @cached_property
    def _time(self) -> Array:
        return np.arange(-(-self.samples // self.stride)) / self.job.controller.log_rate_hz

    @cached_property
    def _references(self) -> tuple[Array, Array]:
        """References at the log's rate, each (N, joints, lanes or 1)."""
        if self.up == self.stride:
            return self.position, self.velocity
        rows, parts = np.arange(len(self.position)), np.arange(self.up) / self.up
        rate = self.job.trajectories[0].rate_hz
        fine = [x[:: self.stride] for x in hermite(self.position, self.velocity, rows, parts, rate)]
        return fine[0], fine[1]

    def _at_log(self, torque: Array) -> Array:
        """A feed-forward torque (N, joints), with straight lines between its samples, at the log's rate."""
        if self.up == self.stride:
            return torque
        rows, part = np.divmod(np.arange(len(self._time)) * self.stride, self.up)
        after, share = np.minimum(rows + 1, len(torque) - 1), part[:, None] / self.up
        return np.asarray(torque[rows] + share * (torque[after] - torque[rows]))

    def _why(self, lane: int) -> str | None:
        status, joint = int(self.lanes.status[lane]), int(self.lanes.joint[lane])
        if status == RUNNING:
            return None
        at = f"at t = {self.lanes.sample[lane] / self.job.controller.controller_rate_hz:.4f} s"
        if status == DIVERGED:
            return f"{at} the motion diverged: coordinates are no longer finite"
        name, place, unit = self.job.robot.joints[joint], int(self.loop.drive[joint]), self.job.robot.units[joint]
        if status == JUMP:
            jump = self.jumps[lane]
            assert jump is not None
            fast = "is too fast" if jump.lasts else "jumps"
            limit = self.loop.speed[joint]
            return f"{at} the reference of {name} {fast}: {jump.speed:.5g} {unit.speed}, over {limit:.5g}"
        if status == OVERLOAD:
            held, limit = 1e3 * self.job.controller.overload_time_s, self.loop.torque_limit[joint]
            return f"{at} the {unit.effort} of {name} has been at its limit of {limit:g} {unit.force} for {held:g} ms"
        if status == OVERSPEED:
            speed_now = self.lanes.v[lane, place]
            return f"{at} {name} {unit.move}s at {speed_now:.5g} {unit.speed}, over {self.loop.speed[joint]:.5g}"
        lower, upper = (getattr(self.job.robot.tree, f"{end}PositionLimit")[joint] for end in ("lower", "upper"))
        limits = f"{lower:.4g} to {upper:.4g} {unit.position}"
        return f"{at} {name} is at {self.lanes.q[lane, place]:.4g} {unit.position}, outside its limits {limits}"


def _lanes_last(signals: Sequence[Array]) -> Array:
    """Signals (N, joints) of all lanes as (N, joints, lanes), or (N, joints, 1) where the lanes share one."""
    first = signals[0]
    shared = all(x is first or np.array_equal(x, first) for x in signals)
    return np.ascontiguousarray(np.stack(signals[:1] if shared else signals, axis=-1))


def _loop(robot: Robot, controller: CS8, substeps: int) -> Loop:
    """The controller in numbers for the compiled loop."""
    tree, (speed, torque) = robot.tree, controller.sections
    give = np.array([SLIDES_ON if unit.slides else TURNS_ON for unit in robot.units])
    by_speed = controller.column("filtered_speed_gain") * controller.period
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
        filters=Filters(speed, torque, by_speed) if speed.size or torque.size else None,
        overload_samples=max(1, round(controller.overload_time_s * controller.controller_rate_hz)),
        lower=np.array(tree.lowerPositionLimit) - give,
        upper=np.array(tree.upperPositionLimit) + give,
        speed=SPEED_MARGIN * np.array(tree.upperVelocityLimit, dtype=float),
    )
