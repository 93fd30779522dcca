"""Excitation designed for identification: periodic trajectories that tell the most about a robot's parameters.

The references are finite Fourier series of one period; each joint's speed is

    r'_j(t) = sum_h a_hj cos(h w t) + b_hj sin(h w t),     w = 2 pi / period,

and to a flexible robot a multisine is fed forward, whose lines stand on chosen frequencies. Offsets, a, b and the
lines' amplitudes are chosen so that the regressor of equations 3.85-3.87 (columns scaled by a first guess, on the
parameters that can be told at all) has the smallest condition number, or the largest determinant, while angles, speeds,
torques and distances keep to their limits.

During the search the flexible motion is predicted, not simulated: the drives follow their references, the hinges'
deformation is the one which inverse dynamics asks for along them (their own inertia left out), and the vibration is the
linear response to the multisine, in closed loop, about points along the motion. The motion that results is then
simulated in full, and judged by that.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation.limits import Limits, Margins
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.closed_loop import Simulation, simulate
from rx90b_flex.simulate.cs8 import CS8, design_cs8, drive_places
from rx90b_flex.simulate.trajectories import PERIOD_S, RATE_HZ, Trajectory

ComplexArray = NDArray[np.complex128]
Objective = Literal["condition", "information"]
Spectrum = Literal["below", "on_modes"]
Progress = Callable[[str, float], None]

HARMONICS = 5  # of the references; 1.2 Hz for 4.096 s, far below the lowest antiresonance, 14.8 Hz
BELOW = 0.5  # part of the lowest mode's frequency that "below" keeps under
MODE_WIDTH = 0.1  # lines "on_modes" reach so far to either side, of the mode's frequency: modes move with the pose
LINES_A_MODE = 5
STEADY_SPEED = 0.15  # rad/s; friction's slope in the linear response is at this speed or more, not at reversal
PENALTY = 100.0
TRIES = 1000  # random poses, until one keeps to the limits at rest
RANK_TOLERANCE = 1e-7  # directions below this part of the largest singular value count as not there (`essential_space`)
STEP = 1e-5  # of finite differences
CLIPPINGS = 60  # of a multisine, for low peaks
ENDS = 24  # smallest and largest singular values that a search for the condition number watches


# ---- what is optimised ------------------------------------------------------------------------------------------


def column_scale(robot: Robot) -> Array:
    """First guess that the regressor's columns are scaled by, shape (p,).

    Section 4.2.2 divides each column by a first guess of its parameter. For first moments and moments of inertia it is the largest of
    their link here: the declared 0.2 g m of an offset that might be zero says nothing about how well it is to be known. 1 where the
    robot declares nothing.

    Raises
    ------
    ValueError
        A parameter without value.
    """
    scale = np.abs(robot.parameters)
    missing = [name for name, value in zip(robot.parameter_names, scale, strict=True) if np.isnan(value)]
    if missing:
        raise ValueError(f"{robot.name}: {missing[0]} has no value; an excitation is designed about a first guess")
    for link in scale[: 10 * len(robot.bodies)].reshape(-1, 10):
        link[1:4] = np.linalg.norm(link[1:4])
        link[4:] = link[4:7].max()
    return np.where(scale > 0.0, scale, 1.0)


@dataclass(frozen=True, eq=False)
class Assessment:
    """How much a motion tells about a robot's parameters.

    Attributes
    ----------
    singular_values : array, shape (r,)
        Of the regressor, columns scaled, on the essential space, over the root of the number of samples; descending, N m.
    """

    singular_values: Array

    @property
    def condition(self) -> float:
        """Condition number."""
        return float(self.singular_values[0] / self.singular_values[-1])

    @property
    def information(self) -> float:
        """Half the log determinant of a sample's mean information, for a unit error of every row."""
        return float(np.log(self.singular_values).sum())


def assess(regressor: Array, scale: Array, essential: Array) -> Assessment:
    """Singular values of a regressor, shape (N, n, p), on an essential space, shape (p, r)."""
    columns = (regressor * scale).reshape(-1, len(scale)) @ essential
    return Assessment(np.linalg.svd(columns, compute_uv=False) / np.sqrt(len(regressor)))


def periodic_derivative(x: Array, period_s: float) -> Array:
    """Derivative of one period of a motion, shape (N, ...), by its Fourier series."""
    lines = np.fft.rfftfreq(len(x), 1.0 / len(x)).reshape(-1, *[1] * (x.ndim - 1))
    return np.fft.irfft(2j * np.pi / period_s * lines * np.fft.rfft(x, axis=0), n=len(x), axis=0)


def steady_states(run: Simulation) -> tuple[Array, Array, Array]:
    """Coordinates, rates and accelerations of a run's last period, each (N, n)."""
    period = run.trajectory.period_s
    if period is None:
        raise ValueError(f"trajectory {run.trajectory.name!r} has no period")
    count = round(period * run.recording.sample_rate_hz)
    q, v = run.q[-count:], run.v[-count:]
    return q, v, periodic_derivative(v, period)


# ---- a candidate ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidate:
    """An excitation as numbers.

    Attributes
    ----------
    centre : array, shape (joints,), rad
        Mean of the references.
    cosine, sine : array, shape (H, joints), rad/s
        Amplitudes of the speed's harmonics.
    torque : complex array, shape (L, joints), N m
        Amplitude of each line of the multisine.
    """

    centre: Array
    cosine: Array
    sine: Array
    torque: ComplexArray

    def scaled(self, motion: float, torque: float) -> Candidate:
        """Smaller or larger motion about the same centre, smaller or larger multisine."""
        return Candidate(self.centre, motion * self.cosine, motion * self.sine, torque * self.torque)

    def references(self, time: Array, period_s: float) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration of the references, each (N, joints)."""
        w = 2.0 * np.pi / period_s * np.arange(1, len(self.cosine) + 1)
        c, s = np.cos(np.outer(time, w)), np.sin(np.outer(time, w))
        position = self.centre + (s / w) @ self.cosine - (c / w) @ self.sine
        return position, c @ self.cosine + s @ self.sine, (c * w) @ self.sine - (s * w) @ self.cosine

    def feedforward(self, time: Array, hz: Array) -> Array:
        """Feed-forward torque, shape (N, joints), N m."""
        return np.real(np.exp(2j * np.pi * np.outer(time, hz)) @ self.torque)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Robot, limits and spectrum of a design, and how a vector of unknowns becomes a candidate.

    Attributes
    ----------
    hz, groups : array, shape (L,)
        Lines of the multisine; lines of one group share an amplitude a joint.
    phase : array, shape (L, joints), rad
    moving : array, shape (joints,), bool
    times : array, shape (N,), s
        Where the regressor is taken: jittered, so that no line of the multisine is always met in one phase.
    """

    robot: Robot
    controller: CS8
    limits: Limits
    period_s: float
    harmonics: int
    hz: Array
    groups: NDArray[np.int64]
    phase: Array
    moving: NDArray[np.bool_]
    times: Array
    points: int
    scale: Array
    objective: Objective
    essential: Array = field(default_factory=lambda: np.zeros((0, 0)))
    memory: dict[bytes, tuple[Array, ...]] = field(default_factory=dict, repr=False)

    # ---- unknowns ---------------------------------------------------------------------------------------

    @property
    def sizes(self) -> tuple[int, int]:
        """Unknowns of the references and of the multisine."""
        moving = int(self.moving.sum())
        return moving * (1 + 2 * self.harmonics), moving * (int(self.groups.max(initial=-1)) + 1)

    def candidate(self, x: Array) -> Candidate:
        """Unknowns, each of order one, in SI units."""
        motion, _ = self.sizes
        joints, moving = len(self.moving), int(self.moving.sum())
        of_motion = np.zeros((1 + 2 * self.harmonics, joints))
        of_motion[:, self.moving] = x[:motion].reshape(-1, moving)
        of_torque = np.zeros((int(self.groups.max(initial=-1)) + 1, joints))
        of_torque[:, self.moving] = x[motion:].reshape(-1, moving)
        speed = of_motion[1:] * self.limits.velocity / np.sqrt(2.0 * self.harmonics)
        amplitude = of_torque[self.groups] * self.limits.feedforward / np.sqrt(max(len(self.hz), 1))
        return Candidate(
            self._middle + of_motion[0],
            speed[: self.harmonics],
            speed[self.harmonics :],
            amplitude * np.exp(1j * self.phase),
        )

    @cached_property
    def _middle(self) -> Array:
        return 0.5 * (self.limits.lower + self.limits.upper)

    def draw(self, rng: np.random.Generator) -> Array:
        """Random unknowns: a centre where the robot may rest, smaller amplitudes at higher harmonics."""
        for _ in range(TRIES):
            x = self._draw(rng)
            if self.rests_within(x):
                return x
        raise ValueError(f"{self.robot.name}: no pose of {TRIES} random ones keeps to the limits at rest")

    def _draw(self, rng: np.random.Generator) -> Array:
        torque = self.sizes[1]
        moving = int(self.moving.sum())
        half = np.minimum(0.5 * (self.limits.upper - self.limits.lower), np.pi)[self.moving]
        centre = 0.6 * half * rng.uniform(-1.0, 1.0, moving)
        order = np.tile(np.arange(1, self.harmonics + 1), 2)[:, None]
        speed = rng.normal(size=(2 * self.harmonics, moving)) / np.sqrt(order)
        return np.concatenate([centre, 0.5 * speed.ravel(), 0.3 * np.abs(rng.normal(size=torque)) + 0.1])

    # ---- prediction -------------------------------------------------------------------------------------

    def motion(self, c: Candidate) -> tuple[Array, Array, Array]:
        """Predicted coordinates, rates and accelerations at `times`, each (N, n)."""
        r, v, a = c.references(self.times, self.period_s)
        n = self.robot.model.nv
        drives = drive_places(self.robot)
        whole = [np.zeros((len(self.times), n)) for _ in range(3)]
        for out, of_drives in zip(whole, (r, v, a), strict=True):
            out[:, drives] = of_drives
        if n > len(drives):
            for out, slow in zip(whole, self._deformation(c), strict=True):
                out += slow
            for out, fast in zip(whole, self._vibration(c), strict=True):
                out += fast
        return whole[0], whole[1], whole[2]

    def _remembered(self, kind: bytes, c: Candidate, make: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        """Parts that depend on the references alone stay the same while the multisine is varied."""
        key = kind + c.centre.tobytes() + c.cosine.tobytes() + c.sine.tobytes()
        if key not in self.memory:
            if len(self.memory) > 6:
                self.memory.clear()
            self.memory[key] = make()
        return self.memory[key]

    def _deformation(self, c: Candidate) -> tuple[Array, ...]:
        """Deformation of the hinges along the references, with its derivatives, at `times`."""
        return self._remembered(b"slow", c, lambda: self._make_deformation(c))

    def _make_deformation(self, c: Candidate) -> tuple[Array, ...]:
        robot, drives = self.robot, drive_places(self.robot)
        n = robot.model.nv
        count = 16 * self.harmonics
        grid = np.arange(count) / count * self.period_s
        q, v, a = (np.zeros((count, n)) for _ in range(3))
        q[:, drives], v[:, drives], a[:, drives] = c.references(grid, self.period_s)
        free = np.setdiff1d(np.arange(n), drives)
        stiffness = robot.linearize(np.zeros(n)).flexibility.K[np.ix_(free, free)]
        deformation = -np.linalg.solve(stiffness, robot.inverse_dynamics(q, v, a)[:, free].T).T
        lines = np.fft.rfft(deformation, axis=0)[: count // 4] / count  # friction's jumps have no derivative
        lines[1:] *= 2.0
        jw = 2j * np.pi / self.period_s * np.arange(len(lines))
        wave = np.exp(np.outer(self.times, jw))
        out = []
        for power in range(3):
            whole = np.zeros((len(self.times), n))
            whole[:, free] = np.real((wave * jw**power) @ lines)
            out.append(whole)
        return tuple(out)

    def _vibration(self, c: Candidate) -> tuple[Array, ...]:
        """Linear response to the multisine in closed loop, with its derivatives, at `times`."""
        if not len(self.hz):
            return tuple(np.zeros((len(self.times), self.robot.model.nv)) for _ in range(3))
        here = self._blended(np.einsum("plnj,lj->pln", self._response(c), c.torque), self.times)
        jw = 2j * np.pi * self.hz
        wave = np.exp(np.outer(self.times, jw))
        return tuple(np.real(np.einsum("tl,tln->tn", wave * jw**power, here)) for power in range(3))

    def _response(self, c: Candidate) -> ComplexArray:
        (compliance,) = self._remembered(b"fast", c, lambda: (self._compliance(c),))
        return np.asarray(compliance)

    def _blended(self, at_points: ComplexArray, time: Array) -> ComplexArray:
        """What is known at the points along the motion, shape (points, ...), at any time, shape (N, ...)."""
        place = time / self.period_s * self.points
        before = place.astype(int) % self.points
        share = (place - place.astype(int)).reshape(-1, *[1] * (at_points.ndim - 1))
        return np.asarray((1.0 - share) * at_points[before] + share * at_points[(before + 1) % self.points])

    def _compliance(self, c: Candidate) -> Array:
        """Coordinates over feed-forward torque in closed loop, shape (points, L, n, joints)."""
        robot, drives = self.robot, drive_places(self.robot)
        b = robot.input_matrix
        s = 2j * np.pi * self.hz[:, None, None]
        control = b @ (self.controller.frequency_response(self.hz)[:, :, None] * b.T)
        r, v, _ = c.references(np.arange(self.points) / self.points * self.period_s, self.period_s)
        q, rate, rest = (np.zeros((self.points, len(b))) for _ in range(3))
        q[:, drives] = r
        rate[:, drives] = np.where(v < 0.0, -1.0, 1.0) * np.maximum(np.abs(v), STEADY_SPEED)
        motion = robot.motion(q, rate, rest)
        parts = [motion.on_tree.derivatives(), *(effect.derivatives(motion) for effect in robot.effects)]
        by_q, by_v, by_a = (np.sum([part[i] for part in parts], axis=0)[:, None] for i in range(3))
        dynamic = by_a * s**2 + by_v * s + by_q + control
        return np.asarray(np.linalg.solve(dynamic, np.broadcast_to(b.astype(complex), (*dynamic.shape[:2], *b.shape))))

    # ---- cost -------------------------------------------------------------------------------------------

    def assess(self, c: Candidate) -> Assessment:
        """By the predicted motion."""
        return assess(self.robot.regressor(*self.motion(c)), self.scale, self.essential)

    def excess(self, c: Candidate) -> Array:
        """How far the predicted motion is outside each limit, over a period; see `Limits.excess`."""
        r, v, torque, distance = self._remembered(b"limits", c, lambda: self._along(c))
        if not len(self.hz):
            return self.limits.excess(r, v, torque, distance).max(axis=0)
        drive = self._response(c)[:, :, drive_places(self.robot)]
        angle = np.einsum("pljk,lk->plj", drive, c.torque)
        fed_back = self.controller.frequency_response(self.hz) * angle
        jw = 2j * np.pi * self.hz
        speed, loop, given = (
            np.real(np.einsum("tl,tlj->tj", self._waves, self._blended(x, self._dense)))
            for x in (jw[:, None] * angle, c.torque - fed_back, np.broadcast_to(c.torque, angle.shape))
        )
        repeated = np.repeat(np.arange(len(r)), len(self._dense) // len(r))
        outside = self.limits.excess(r[repeated], v[repeated] + speed, torque[repeated] + loop, distance[repeated])
        return np.concatenate([outside.max(axis=0), (np.abs(given) / self.limits.feedforward - 1.0).max(axis=0)])

    @cached_property
    def _dense(self) -> Array:
        count = round(self.period_s * RATE_HZ)
        return np.arange(count) / count * self.period_s

    @cached_property
    def _waves(self) -> ComplexArray:
        return np.exp(2j * np.pi * np.outer(self._dense, self.hz))

    def _along(self, c: Candidate) -> tuple[Array, ...]:
        """References, the rigid robot's torque and the shapes' distances, on every so many of the period's instants."""
        every = max(1, 2 ** int(np.log2(len(self._dense) / (12 * self.harmonics))))
        r, v, a = c.references(self._dense[::every], self.period_s)
        return r, v, self._rigid.inverse_dynamics(r, v, a), self.limits.distances(self._rigid.tree, r)

    @cached_property
    def _rigid(self) -> Robot:
        return self.robot.rigid()

    def look(self, x: Array) -> tuple[Array, Array]:
        """Logarithms of the regressor's singular values, ascending, and the largest excess of each limit; see `excess`."""
        c = self.candidate(x)
        columns = (self.robot.regressor(*self.motion(c)) * self.scale).reshape(-1, len(self.scale)) @ self.essential
        values = np.linalg.eigvalsh(columns.T @ columns / len(self.times))
        return 0.5 * np.log(np.maximum(values, 1e-300)), self.excess(c)

    def cost(self, logs: Array, excess: Array) -> float:
        """What candidates are ranked by: the objective, and a penalty where they pass a limit."""
        value = -logs.mean() if self.objective == "information" else logs[-1] - logs[0]
        return float(value + PENALTY * np.sum(np.maximum(excess, 0.0) ** 2))

    def rests_within(self, x: Array) -> bool:
        """Whether the robot may rest in the centre of the motion: then a motion small enough keeps to the limits."""
        pose = self.candidate(x).centre[None]
        still = np.zeros_like(pose)
        torque = self._rigid.inverse_dynamics(pose, still, still)
        distance = self.limits.distances(self._rigid.tree, pose)
        return bool((self.limits.excess(pose, still, torque, distance) <= 0.0).all())

    def slopes(self, x: Array, here: tuple[Array, Array]) -> tuple[Array, Array]:
        """Forward differences of `look`; the multisine's first, while what the references give is remembered."""
        by_x = tuple(np.empty((len(value), len(x))) for value in here)
        for i in reversed(range(len(x))):
            moved = x.copy()
            moved[i] += STEP
            for slope, there, value in zip(by_x, self.look(moved), here, strict=True):
                slope[:, i] = (there - value) / STEP
        return by_x[0], by_x[1]


def essential_space(problem: _Problem, rng: np.random.Generator, draws: int = 4) -> Array:
    """Orthonormal directions, in scaled parameters, that some motion of this kind tells; shape (p, r).

    Every direction that a few random excitations together leave below `RANK_TOLERANCE` is taken as not there: what no
    motion shows, and what shows only in products of two deformations.
    """
    parts = []
    for _ in range(draws):
        q, v, a = problem.motion(problem.candidate(problem.draw(rng)))
        parts.append((problem.robot.regressor(q, v, a) * problem.scale).reshape(-1, len(problem.scale)))
    _, values, directions = np.linalg.svd(np.concatenate(parts), full_matrices=False)
    return directions[values > RANK_TOLERANCE * values[0]].T


# ---- the search -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Design:
    """A designed excitation.

    Attributes
    ----------
    robot : Robot
    controller : CS8
    limits : Limits
    trajectory : Trajectory
        One period.
    lines_hz : array, shape (L,)
        Lines of the multisine.
    predicted : Assessment
        By the predicted motion, which the search goes by.
    essential : array, shape (p, r)
        Directions in scaled parameters that the assessments count; `essential_space`.
    scale : array, shape (p,)
        See `column_scale`.
    history : array, shape (steps, 3)
        Of all starts: start, evaluations so far, cost.
    """

    robot: Robot
    controller: CS8
    limits: Limits
    trajectory: Trajectory
    lines_hz: Array
    predicted: Assessment
    essential: Array
    scale: Array
    history: Array

    @cached_property
    def simulation(self) -> Simulation:
        """Two periods of the excitation in closed loop; the second is steady."""
        return simulate(self.robot, self.controller, self.trajectory.repeated(2), raw=True)

    def assess(self, run: Simulation | None = None) -> Assessment:
        """By simulated motion: this excitation's, or any run's of the same robot and period."""
        regressor = self.robot.regressor(*steady_states(self.simulation if run is None else run))
        return assess(regressor, self.scale, self.essential)

    def margins(self, run: Simulation | None = None) -> Margins:
        """What simulated motion leaves to the limits."""
        return simulated_margins(self.limits, self.simulation if run is None else run)


def simulated_margins(limits: Limits, run: Simulation) -> Margins:
    """What a run's drives leave to limits; torques and speeds before the log's filter, where the run has them."""
    drives = drive_places(run.robot)
    velocity = run.v[:, drives] if run.raw is None else run.raw.velocity
    torque = run.recording.torque if run.raw is None else run.raw.torque
    return limits.margins(run.robot.tree, run.q[:, drives], velocity, torque)


def design_excitation(
    robot: Robot,
    *,
    seed: int,
    controller: CS8 | None = None,
    limits: Limits | None = None,
    objective: Objective = "condition",
    spectrum: Spectrum | Array | None = None,
    period_s: float = PERIOD_S,
    harmonics: int = HARMONICS,
    moving: tuple[str, ...] | None = None,
    samples: int = 96,
    points: int = 8,
    draws: int = 24,
    starts: int = 2,
    evaluations: int = 5000,
    progress: Progress | None = None,
) -> Design:
    """Design a periodic excitation for a robot, flexible or rigid.

    The best of some random excitations is improved by sequential quadratic programming, with the limits as constraints.
    They are then met exactly, by making the motion smaller about its centre where the prediction passes one, and the
    multisine where the simulation does.

    Parameters
    ----------
    robot : Robot
        Its values are the first guess.
    seed : int
    controller : CS8, optional
        Whose closed loop it is; `design_cs8` without.
    limits : Limits, optional
        ``Limits.of(robot, controller)`` without.
    objective : str
        ``condition``: smallest condition number; ``information``: largest determinant of the information matrix.
    spectrum : str or array, Hz
        ``on_modes``: the multisine's lines stand on and about the elastic modes below the log's cutoff, of the pose that a start's
        motion is centred on; ``below``: no multisine, and the
        references stay under half the lowest mode; an array: lines there, on the grid of the period. Without one, ``on_modes`` for a
        flexible robot; a rigid one takes ``below`` alone.
    period_s, harmonics : of the references.
    moving : names of the joints that move; all by default.
    samples, points : int
        Instants of the regressor, and of the linear response, in a period.
    draws, starts, evaluations : int
        Random excitations; how many of them are improved; predicted regressors in all, for that.
    progress : callable, optional
        Told what is being done and the part that is done, 0 to 1.

    Returns
    -------
    Design

    Raises
    ------
    ValueError
        A choice that does not fit the robot, or a robot on which no motion keeps to the limits.
    """
    tell = progress or (lambda text, part: None)
    rng = np.random.default_rng(seed)
    controller = design_cs8(robot, np.zeros(len(robot.joints))) if controller is None else controller
    controller = controller.for_joints(robot.joints)
    limits = Limits.of(robot, controller) if limits is None else limits
    problem = _problem(
        robot, controller, limits, objective, spectrum, period_s, harmonics, moving, samples, points, rng
    )
    problem = dataclasses.replace(problem, essential=essential_space(problem, rng))
    drawn = []
    for k in range(draws):
        tell("random excitations", 0.05 * k / draws)
        x = problem.draw(rng)
        drawn.append((problem.cost(*problem.look(x)), x))
    drawn.sort(key=lambda pair: pair[0])
    search = _Search(evaluations, tell)
    found = []
    for i, (_, x) in enumerate(drawn[:starts]):
        own, x = _on_own_modes(problem, x, spectrum, rng)
        own = _with_low_crest(own, x)
        found.append((*search.improve(own, i, x, (i + 1) / starts), own))
    _, best, problem = min(found, key=lambda three: three[0])
    tell("limits", 0.95)
    candidate = _within(problem, problem.candidate(best))
    return _simulated_within(problem, candidate, np.array(search.history), tell)


def _on_own_modes(
    problem: _Problem, x: Array, spectrum: Spectrum | Array | None, rng: np.random.Generator
) -> tuple[_Problem, Array]:
    """The problem with its lines on the modes at the centre of a motion."""
    robot, motion = problem.robot, problem.sizes[0]
    pose = problem.candidate(x).centre
    hz, groups, harmonics = _spectrum(robot, problem.controller, pose, spectrum, problem.period_s, problem.harmonics)
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(hz), len(pose)))
    moved = dataclasses.replace(problem, hz=hz, groups=groups, harmonics=harmonics, phase=phase, memory={})
    return moved, np.concatenate([x[:motion], moved.draw(rng)[motion:]])


def _with_low_crest(problem: _Problem, x: Array) -> _Problem:
    """The problem with phases that make the multisine's peaks low for the amplitudes of x.

    As in section 6.6.2: the waveform is clipped, the clipped waveform's phases are taken, again and again.
    """
    if not len(problem.hz):
        return problem
    spectrum = problem.candidate(x).torque
    size, lines = np.abs(spectrum), np.round(problem.hz * problem.period_s).astype(int)
    time = problem._dense
    best, lowest = problem.phase, np.inf
    phase = np.angle(spectrum)
    for share in np.linspace(0.7, 0.95, CLIPPINGS):
        wave = np.real(np.exp(2j * np.pi * np.outer(time, problem.hz)) @ (size * np.exp(1j * phase)))
        peak = np.abs(wave).max(axis=0)
        crest = float(np.sum(peak / np.maximum(wave.std(axis=0), 1e-12)))
        if crest < lowest:
            best, lowest = phase, crest
        clipped = np.clip(wave, -share * peak, share * peak)
        phase = np.angle(np.fft.rfft(clipped, axis=0)[lines])
    return dataclasses.replace(problem, phase=best, memory={})


class _Search:
    """Searches that share a budget of predicted regressors."""

    def __init__(self, evaluations: int, tell: Progress) -> None:
        self.evaluations, self.tell, self.used = evaluations, tell, 0
        self.history: list[tuple[float, float, float]] = []

    def improve(self, problem: _Problem, start: int, x: Array, share: float) -> tuple[float, Array]:
        """Search from x until `share` of the budget is used: sequential quadratic programming.

        The condition number has no gradient where singular values meet. As bounds ``low <= log s_i <= high`` with ``high - low`` to
        be made small, each singular value has its own, and so does each limit.
        """
        look = _Remembering(problem)
        last = int(share * self.evaluations)
        best: tuple[float, Array] = (np.inf, x.copy())
        ends = min(ENDS, len(problem.scale) // 2)
        count = len(x)

        def at(y: Array) -> tuple[Array, Array]:
            nonlocal best
            if not look.knows(y[:count]):
                if self.used >= last:
                    raise StopIteration
                self.used += 1
            found = look.value(y[:count])
            cost = problem.cost(*found)
            if cost < best[0] and problem.rests_within(y[:count]):
                best = cost, y[:count].copy()
            return found

        def slopes(y: Array) -> tuple[Array, Array]:
            here = at(y)
            if not look.knows_slopes(y[:count]):
                self.used += count
                self.history.append((start, self.used, best[0]))
                part = min(1.0, self.used / self.evaluations)
                self.tell(f"start {start + 1}: {_shown(problem, best[0])}", 0.05 + 0.9 * part)
            return look.slopes(y[:count], here)

        if problem.objective == "information":
            y = x

            def aim(y: Array) -> float:
                return -float(at(y)[0].mean())

            def aim_slope(y: Array) -> Array:
                return -slopes(y)[0].mean(axis=0)

            def inside(y: Array) -> Array:
                return -at(y)[1]

            def inside_slope(y: Array) -> Array:
                return -slopes(y)[1]
        else:
            logs = problem.look(x)[0]
            y = np.concatenate([x, [logs[0], logs[-1]]])
            by_bounds = np.concatenate([np.zeros(count), [-1.0, 1.0]])

            def aim(y: Array) -> float:
                return float(y[-1] - y[-2])

            def aim_slope(y: Array) -> Array:
                return by_bounds

            def inside(y: Array) -> Array:
                logs, excess = at(y)
                return np.concatenate([logs[:ends] - y[-2], y[-1] - logs[-ends:], -excess])

            def inside_slope(y: Array) -> Array:
                by_x, of_excess = slopes(y)
                bounds = np.zeros((2 * ends + len(of_excess), 2))
                bounds[:ends, 0], bounds[ends : 2 * ends, 1] = -1.0, 1.0
                return np.hstack([np.vstack([by_x[:ends], -by_x[-ends:], -of_excess]), bounds])

        with contextlib.suppress(StopIteration):
            optimize.minimize(
                aim,
                y,
                jac=aim_slope,
                method="SLSQP",
                constraints={"type": "ineq", "fun": inside, "jac": inside_slope},
                options={"maxiter": 1000, "ftol": 1e-6},
            )
        return best


class _Remembering:
    """`_Problem.look` and its slopes at the last point: the solver asks for each of them twice."""

    def __init__(self, problem: _Problem) -> None:
        self.problem = problem
        self.at: bytes = b""
        self.at_slopes: bytes = b""

    def knows(self, x: Array) -> bool:
        return x.tobytes() == self.at

    def knows_slopes(self, x: Array) -> bool:
        return x.tobytes() == self.at_slopes

    def value(self, x: Array) -> tuple[Array, Array]:
        if not self.knows(x):
            self.found, self.at = self.problem.look(x), x.tobytes()
        return self.found

    def slopes(self, x: Array, here: tuple[Array, Array]) -> tuple[Array, Array]:
        if not self.knows_slopes(x):
            self.found_slopes, self.at_slopes = self.problem.slopes(x, here), x.tobytes()
        return self.found_slopes


def _shown(problem: _Problem, cost: float) -> str:
    if problem.objective == "information":
        return f"log determinant {-2.0 * cost * problem.essential.shape[1]:.1f}"
    return f"condition number about {np.exp(min(cost, 50.0)):.0f}"


def _problem(
    robot: Robot,
    controller: CS8,
    limits: Limits,
    objective: Objective,
    spectrum: Spectrum | Array | None,
    period_s: float,
    harmonics: int,
    moving: tuple[str, ...] | None,
    samples: int,
    points: int,
    rng: np.random.Generator,
) -> _Problem:
    if objective not in ("condition", "information"):
        raise ValueError(f"objective is {objective!r}; expected 'condition' or 'information'")
    for name in moving or ():
        if name not in robot.joints:
            raise ValueError(f"moving: unknown joint {name!r} of {robot.name}; it has {', '.join(robot.joints)}")
    if limits.joints != robot.joints:
        raise ValueError(f"limits are of {limits.joints}; expected {robot.joints} of {robot.name}")
    moves = np.array([moving is None or joint in moving for joint in robot.joints])
    middle = 0.5 * (limits.lower + limits.upper)
    hz, groups, harmonics = _spectrum(robot, controller, middle, spectrum, period_s, harmonics)
    jitter = rng.uniform(0.0, 1.0, samples)
    return _Problem(
        robot,
        controller,
        limits,
        period_s,
        harmonics,
        hz,
        groups,
        rng.uniform(0.0, 2.0 * np.pi, (len(hz), len(moves))),
        moves,
        (np.arange(samples) + jitter) / samples * period_s,
        points,
        column_scale(robot),
        objective,
    )


def _spectrum(
    robot: Robot, controller: CS8, pose: Array, spectrum: Spectrum | Array | None, period_s: float, harmonics: int
) -> tuple[Array, NDArray[np.int64], int]:
    """Lines of the multisine, their groups, and the harmonics that the references may have; modes are those of a pose."""
    nothing = np.zeros(0), np.zeros(0, dtype=np.int64)
    flexible = robot.model.nv > len(robot.joints)
    highest = min(controller.log_cutoff_hz / 0.9 + 10.0, 0.49 * RATE_HZ)
    if spectrum is None:
        spectrum = "on_modes" if flexible else "below"
    if not flexible:
        if not isinstance(spectrum, str) or spectrum != "below":
            raise ValueError(f"{robot.name} is rigid: it has no modes to place lines on; expected spectrum 'below'")
        return *nothing, harmonics
    q = np.zeros(robot.model.nv)
    q[drive_places(robot)] = pose
    if isinstance(spectrum, str):
        modes = robot.linearize(q).frequencies_hz(elastic_only=True)
        modes = modes[modes > 1.0 / period_s]  # the rigid-body modes are zero
        lowest = BELOW * float(modes[0])
        if spectrum == "below":
            return *nothing, max(1, min(harmonics, int(lowest * period_s)))
        if spectrum != "on_modes":
            raise ValueError(f"spectrum is {spectrum!r}; expected 'below', 'on_modes' or frequencies in Hz")
        modes = modes[modes < highest]
        hz = np.unique(np.concatenate([m * np.linspace(1 - MODE_WIDTH, 1 + MODE_WIDTH, LINES_A_MODE) for m in modes]))
    else:
        modes = hz = np.unique(np.asarray(spectrum, dtype=float))
        if hz.ndim != 1 or not len(hz) or hz[0] <= 0.0 or hz[-1] >= 0.5 * RATE_HZ:
            raise ValueError(f"spectrum: expected frequencies above 0 and below {0.5 * RATE_HZ:g} Hz")
        if len(modes) > 24:
            modes = np.geomspace(hz[0], hz[-1], 12)
    lines = np.unique(np.round(hz * period_s))
    lines = lines[(lines > harmonics) & (lines / period_s < 0.5 * RATE_HZ)]
    groups = np.abs(np.log(lines[:, None] / period_s / modes)).argmin(axis=1)
    return lines / period_s, np.unique(groups, return_inverse=True)[1], harmonics


def _within(problem: _Problem, c: Candidate) -> Candidate:
    """The largest of the same shape that keeps to the limits, as predicted."""

    def outside(share: float) -> bool:
        return bool((problem.excess(c.scaled(share, share)) > 0.0).any())

    if not outside(1.0):
        return c
    low, high = 0.0, 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if outside(middle) else (middle, high)
    return c.scaled(low, low)


def _simulated_within(problem: _Problem, c: Candidate, history: Array, tell: Progress) -> Design:
    """Simulate; as long as the robot passes a limit, make the multisine smaller, then the motion too."""
    for attempt in range(12):
        tell("simulation", 0.95 + 0.004 * attempt)
        design = _design(problem, c, history)
        run = design.simulation
        if run.ended is None and design.margins().kept:
            return design
        c = c.scaled(1.0 if attempt < 6 and len(problem.hz) else 0.95, 0.9)
    raise ValueError(f"{problem.robot.name}: the simulated robot passes a limit on every try; {design.margins()}")


def _design(problem: _Problem, c: Candidate, history: Array) -> Design:
    time = np.arange(round(problem.period_s * RATE_HZ)) / RATE_HZ
    position, velocity, _ = c.references(time, problem.period_s)
    trajectory = Trajectory(
        "designed",
        problem.robot.joints,
        RATE_HZ,
        position,
        velocity,
        c.feedforward(time, problem.hz) if len(problem.hz) else None,
        problem.period_s,
    )
    return Design(
        problem.robot,
        problem.controller,
        problem.limits,
        trajectory,
        problem.hz,
        problem.assess(c),
        problem.essential,
        problem.scale,
        history,
    )
