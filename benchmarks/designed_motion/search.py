"""Excitation designed for identification: periodic trajectories that tell the most about a robot's parameters.

The references are finite Fourier series of one period; each joint's speed is

    r'_j(t) = sum_h a_hj cos(h w t) + b_hj sin(h w t),     w = 2 pi / period,

and to a flexible robot a multisine is fed forward, whose lines stand on chosen frequencies. Offsets, a, b and each
line's amplitude and phase are chosen so that the regressor of equations 3.85-3.87 (columns scaled by a first guess, on
the parameters that can be told at all) has the smallest condition number, or the largest determinant, while angles,
speeds, torques and distances keep to their limits.

During the search the flexible motion is predicted, not simulated (`designed_motion.prediction`). The motion that
results is then simulated in full, and judged by that.

    import rx90b_flex as rf
    from designed_motion.search import design_excitation
    from rx90b_flex.simulate import load_cs8

    design = design_excitation(rf.load_robot("rx90b_4dof"), seed=0, controller=load_cs8())
    print(design.assess().condition, design.margins())
    references, feedforward = design.trajectory.position, design.trajectory.torque  # 250 Hz, one period
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal

from designed_motion.limits import Limits, Margins
from designed_motion.prediction import CandidateMotion, Frame, PrecisionPrediction
from designed_motion.regressor_slope import regressor_slope
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.closed_loop import Simulation, simulate
from rx90b_flex.simulate.cs8 import CS8, design_cs8, drive_places
from rx90b_flex.simulate.trajectories import PERIOD_S, RATE_HZ, Trajectory

Objective = Literal["condition", "information"]
Spectrum = Literal["below", "on_modes"]
Progress = Callable[[str, float], None]

HARMONICS = 5  # of the references; 1.2 Hz for 4.096 s, far below the lowest antiresonance, 14.8 Hz
BELOW = 0.5  # part of the lowest mode's frequency that "below" keeps under
MODE_WIDTH = 0.1  # lines "on_modes" reach so far to either side, of the mode's frequency: modes move with the pose
LINES_A_MODE = 5
TORQUE_PART = (0.03, 0.3)  # of the largest feed-forward torque, root mean square of a random multisine
TRIES = 1000  # random poses, until one keeps to the limits at rest
RANK_TOLERANCE = 1e-7  # directions below this part of the largest singular value count as not there (`essential_space`)
MEMORY = 30  # steps that the quasi-Newton method goes by
TRIES_SIMULATED = 24
SMALLER = 0.97  # amplitudes, from one try of the simulation to the next


@dataclass(frozen=True)
class Stage:
    """Part of a search.

    Attributes
    ----------
    sharpness : float
        Of the smooth condition number, and weight of the penalty for passing limits; see `_Problem.look`.
    samples : float
        Part of the instants. With few, hundreds of unknowns find a motion that is good at these instants alone.
    share : float
        Part of the evaluations.
    """

    sharpness: float
    samples: float
    share: float


STAGES = (Stage(6.0, 0.25, 0.2), Stage(15.0, 0.3125, 0.25), Stage(30.0, 0.5, 0.25), Stage(40.0, 1.0, 0.1))
AFTER_SIMULATION = (Stage(40.0, 1.0, 0.1), Stage(40.0, 1.0, 0.1))  # each with what the last simulation showed


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


# ---- what a search asks -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _DesignProblem:
    """What is designed, and how a vector of unknowns, each of order one, becomes a candidate.

    Attributes
    ----------
    moving : array, shape (joints,), bool
    scale : array, shape (p,)
    essential : array, shape (p, r)
    """

    frame: Frame
    moving: NDArray[np.bool_]
    scale: Array
    objective: Objective
    essential: Array

    @cached_property
    def _units(self) -> tuple[Array, Array]:
        """Of references, shape (1 + 2 H, joints), and of the multisine, shape (L, joints)."""
        frame, limits = self.frame, self.frame.limits
        speed = np.tile(limits.velocity / np.sqrt(2.0 * frame.harmonics), (2 * frame.harmonics, 1))
        torque = np.tile(limits.feedforward / np.sqrt(max(len(frame.hz), 1)), (len(frame.hz), 1))
        return np.vstack([np.ones_like(limits.velocity), speed]), torque

    def candidate(self, x: Array) -> CandidateMotion:
        """Unknowns in SI units."""
        of_motion = np.zeros(self._units[0].shape)
        of_torque = np.zeros(self._units[1].shape, dtype=complex)
        joints = int(self.moving.sum())
        motion, real, imaginary = np.split(x.reshape(-1, joints), np.cumsum([len(of_motion), len(of_torque)]))
        of_motion[:, self.moving], of_torque[:, self.moving] = motion, real + 1j * imaginary
        return CandidateMotion(of_motion * self._units[0], np.asarray(of_torque * self._units[1]))

    def unknowns(self, c: CandidateMotion) -> Array:
        """Of a candidate in SI units."""
        return self._in_order(c.motion / self._units[0], np.asarray(c.torque / self._units[1]))

    def _in_order(self, motion: Array, torque: NDArray[np.complex128]) -> Array:
        return np.concatenate([x[:, self.moving].ravel() for x in (motion, torque.real, torque.imag)])

    def draw(self, rng: np.random.Generator) -> Array:
        """Random unknowns: a centre where the robot may rest, smaller amplitudes at higher harmonics."""
        limits, joints = self.frame.limits, len(self.moving)
        middle = 0.5 * (limits.lower + limits.upper)
        half = np.minimum(0.5 * (limits.upper - limits.lower), np.pi)
        order = np.tile(np.arange(1, self.frame.harmonics + 1), 2)[:, None]
        for _ in range(TRIES):
            centre = middle + np.where(self.moving, 0.6 * half * rng.uniform(-1.0, 1.0, joints), 0.0)
            if self.rests_within(centre):
                break
        else:
            raise ValueError(f"{self.frame.robot.name}: no pose of {TRIES} random ones keeps to the limits at rest")
        speed = 0.5 * rng.normal(size=(2 * self.frame.harmonics, joints)) / np.sqrt(order)
        part = np.exp(rng.uniform(*np.log(TORQUE_PART)))
        torque = part * rng.normal(size=(2, len(self.frame.hz), joints))
        return self._in_order(np.vstack([centre, speed]), torque[0] + 1j * torque[1])

    def rests_within(self, centre: Array) -> bool:
        """Whether the robot may rest in a pose: then a motion about it that is small enough keeps to the limits."""
        pose, still = centre[None], np.zeros((1, len(centre)))
        torque = self.frame.rigid.inverse_dynamics(pose, still, still)
        distance = self.frame.limits.distances(self.frame.rigid.tree, pose)
        return bool((self.frame.limits.excess(pose, still, torque, distance) <= 0.0).all())

    def at(self, times: Array) -> _DesignProblem:
        """The same at other instants."""
        return dataclasses.replace(self, frame=dataclasses.replace(self.frame, times=times))

    def corrected(self, design: Design, c: CandidateMotion) -> _DesignProblem:
        """The same with what the simulation of a candidate's design has and its prediction does not."""
        frame = dataclasses.replace(self.frame, times=self.frame.every_instant, missed=None)
        simulated = (signal.resample(x, len(frame.times), axis=0) for x in steady_states(design.simulation))
        q, v, a = (one - other for one, other in zip(simulated, PrecisionPrediction(frame, c).motion, strict=True))
        return dataclasses.replace(self, frame=dataclasses.replace(frame, missed=(q, v, a)))

    def value(self, told: Assessment) -> float:
        """The plain objective, the smaller the better."""
        return (
            np.log(told.condition) if self.objective == "condition" else -told.information / len(told.singular_values)
        )

    def assess(self, c: CandidateMotion) -> Assessment:
        """By the predicted motion."""
        motion = PrecisionPrediction(self.frame, c).motion
        return assess(self.frame.robot.regressor(*motion), self.scale, self.essential)

    def excess(self, c: CandidateMotion) -> float:
        """Largest excess of any limit; see `Limits.excess`."""
        return float(PrecisionPrediction(self.frame, c).excess.max())

    def look(self, x: Array, sharpness: float) -> tuple[float, Array, float]:
        """Smooth objective with a penalty for passing limits, its gradient, and the plain objective with that penalty.

        The condition number has no gradient where singular values s meet. With

            (log sum s^k + log sum s^-k) / k,

        k the sharpness, every singular value has its say, and the more the nearer it is to either end; the sum tends to the logarithm
        of the condition number. The penalty is k times the sum of squared excesses of all limits and instants.
        """
        frame = self.frame
        predicted = PrecisionPrediction(frame, self.candidate(x))
        regressor = frame.robot.regressor(*predicted.motion)
        columns = (regressor * self.scale).reshape(-1, len(self.scale)) @ self.essential
        values, directions = np.linalg.eigh(columns.T @ columns / len(frame.times))
        values = np.maximum(values, 1e-300)
        logs = 0.5 * np.log(values)
        if self.objective == "information":
            plain = smooth = -float(logs.mean())
            by_logs = np.full(len(logs), -1.0 / len(logs))
        else:
            plain = float(logs[-1] - logs[0])
            large, small = np.exp(sharpness * (logs - logs[-1])), np.exp(-sharpness * (logs - logs[0]))
            smooth = plain + float(np.log(large.sum()) + np.log(small.sum())) / sharpness
            by_logs = large / large.sum() - small / small.sum()
        outside = np.maximum(predicted.excess, 0.0)
        penalty = sharpness * float(np.sum(outside**2))
        by_columns = columns @ (directions * (by_logs / values)) @ directions.T / len(frame.times)
        by_regressor = (by_columns @ self.essential.T * self.scale).reshape(regressor.shape)
        by_motion = regressor_slope(frame.robot, *predicted.motion, by_regressor)
        slope = predicted.slope(by_motion, 2.0 * sharpness * outside)
        gradient = self._in_order(slope.motion * self._units[0], slope.torque * self._units[1])
        return smooth + penalty, gradient, plain + penalty

    def cost(self, x: Array, sharpness: float) -> float:
        """The plain objective with its penalty, by which random excitations are ranked."""
        predicted = PrecisionPrediction(self.frame, self.candidate(x))
        told = assess(self.frame.robot.regressor(*predicted.motion), self.scale, self.essential)
        return float(self.value(told) + sharpness * np.sum(np.maximum(predicted.excess, 0.0) ** 2))


def essential_space(problem: _DesignProblem, rng: np.random.Generator, draws: int = 4) -> Array:
    """Orthonormal directions, in scaled parameters, that some motion of this kind tells; shape (p, r).

    Every direction that a few random excitations together leave below `RANK_TOLERANCE` is taken as not there: what no
    motion shows, and what shows only in products of two deformations.
    """
    parts = []
    for _ in range(draws):
        motion = PrecisionPrediction(problem.frame, problem.candidate(problem.draw(rng))).motion
        parts.append((problem.frame.robot.regressor(*motion) * problem.scale).reshape(-1, len(problem.scale)))
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
    history : array, shape (evaluations, 3)
        Start, evaluation, and the logarithm of the predicted condition number (or minus the mean logarithm of the singular values),
        with the penalty for passing limits.
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
    samples: int = 1024,
    points: int = 8,
    draws: int = 200,
    starts: int = 3,
    evaluations: int = 450,
    progress: Progress | None = None,
) -> Design:
    """Design a periodic excitation for a robot, flexible or rigid.

    The best of some random excitations are improved by a quasi-Newton method on a smooth objective, the best of these further, ever
    nearer to the plain one (`STAGES`). Limits are then met exactly, by making the motion smaller about its centre where
    the prediction passes one, and the multisine where the simulation does. What the simulation shows beside the prediction is
    added to it, and the search goes on from there; the best of the simulated designs is returned.

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
        Instants of the regressor in the last stage, and points of the linear response, in a period.
    draws, starts, evaluations : int
        Random excitations; how many of them are improved in the first stage; gradients in all.
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
    controller = design_cs8(robot) if controller is None else controller
    controller = controller.for_joints(robot.joints)
    limits = Limits.of(robot, controller) if limits is None else limits
    for name, count in (("harmonics", harmonics), ("samples", samples), ("points", points), ("draws", draws)):
        if count < 1:
            raise ValueError(f"{name} is {count}; expected 1 or more")
    if not 1 <= starts <= draws or evaluations < starts:
        raise ValueError(
            f"starts is {starts} of {draws} draws and {evaluations} evaluations; expected 1 or more, and no more than either"
        )
    problem = _problem(
        robot, controller, limits, objective, spectrum, period_s, harmonics, moving, samples, points, rng
    )
    drawn = []
    for k in range(draws):
        tell("random excitations", 0.05 * k / draws)
        x = problem.draw(rng)
        drawn.append((problem.cost(x, STAGES[0].sharpness), k, x))
    placed = len(problem.frame.hz) > 0 and (spectrum is None or isinstance(spectrum, str))
    search = _DesignSearch(evaluations, samples, rng, tell)
    found = []
    for start, (_, _, x) in enumerate(sorted(drawn)[:starts]):
        own, x = _on_own_modes(problem, x, rng) if placed else (problem, x)
        found.append((*search.improve(own, start, x, STAGES[0], 1.0 / starts), start, own))
    _, x, start, problem = min(found, key=lambda four: four[0])
    for stage in STAGES[1:]:
        _, x = search.improve(problem, start, x, stage)
    best = latest = _simulated_within(problem, problem.candidate(x), search, tell)
    for stage in AFTER_SIMULATION:
        problem = problem.corrected(*latest)
        _, x = search.improve(problem, start, problem.unknowns(latest[1]), stage)
        latest = _simulated_within(problem, problem.candidate(x), search, tell)
        best = min(best, latest, key=lambda two: problem.value(two[0].assess()))
    return best[0]


def _jittered(samples: int, period_s: float, rng: np.random.Generator) -> Array:
    """Instants of a period, at random, so that no line of the multisine is always met in one phase."""
    return (np.arange(samples) + rng.uniform(0.0, 1.0, samples)) / samples * period_s


def _on_own_modes(problem: _DesignProblem, x: Array, rng: np.random.Generator) -> tuple[_DesignProblem, Array]:
    """The problem with its lines on the modes at the centre of a motion, and the unknowns of that motion with them."""
    frame, centre = problem.frame, problem.candidate(x).centre
    hz, _ = _spectrum(frame.robot, frame.controller, centre, "on_modes", frame.period_s, frame.harmonics)
    moved = dataclasses.replace(problem, frame=dataclasses.replace(frame, hz=hz))
    motion = int(problem.moving.sum()) * (1 + 2 * frame.harmonics)
    return moved, np.concatenate([x[:motion], moved.draw(rng)[motion:]])


class _DesignSearch:
    """Searches that share a number of evaluations."""

    def __init__(self, evaluations: int, samples: int, rng: np.random.Generator, tell: Progress) -> None:
        self.evaluations, self.samples, self.rng, self.tell = evaluations, samples, rng, tell
        self.history: list[tuple[float, float, float]] = []

    @property
    def part(self) -> float:
        """That is done of the design."""
        return 0.05 + 0.95 * min(1.0, len(self.history) / self.evaluations)

    def improve(
        self, problem: _DesignProblem, start: int, x: Array, stage: Stage, part: float = 1.0
    ) -> tuple[float, Array]:
        """Best value and unknowns of a part of a stage, from x."""
        period_s = problem.frame.period_s
        count = max(1, round(stage.samples * self.samples))
        instants = problem.frame.every_instant
        times = instants if count == len(instants) else _jittered(count, period_s, self.rng)
        problem = problem.at(times)
        budget = max(1, round(part * stage.share * self.evaluations))
        best = (np.inf, x)

        def value(y: Array) -> tuple[float, Array]:
            nonlocal best
            smooth, gradient, plain = problem.look(y, stage.sharpness)
            best = min(best, (smooth, y.copy()), key=lambda two: two[0])
            self.history.append((start, len(self.history) + 1, plain))
            self.tell(f"start {start + 1}: {_shown(problem, plain)}", self.part)
            return smooth, gradient

        options = {"maxfun": budget, "maxiter": budget, "maxcor": MEMORY}
        optimize.minimize(value, x, jac=True, method="L-BFGS-B", options=options)
        return best


def _shown(problem: _DesignProblem, cost: float) -> str:
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
) -> _DesignProblem:
    if objective not in ("condition", "information"):
        raise ValueError(f"objective is {objective!r}; expected 'condition' or 'information'")
    for name in moving or ():
        if name not in robot.joints:
            raise ValueError(f"moving: unknown joint {name!r} of {robot.name}; it has {', '.join(robot.joints)}")
    if limits.joints != robot.joints:
        raise ValueError(f"limits are of {limits.joints}; expected {robot.joints} of {robot.name}")
    moves = np.array([moving is None or joint in moving for joint in robot.joints])
    middle = 0.5 * (limits.lower + limits.upper)
    hz, harmonics = _spectrum(robot, controller, middle, spectrum, period_s, harmonics)
    times = _jittered(max(1, round(STAGES[0].samples * samples)), period_s, rng)
    frame = Frame(robot, controller, limits, period_s, harmonics, hz, times, points)
    scale = column_scale(robot)
    problem = _DesignProblem(frame, moves, scale, objective, np.eye(len(scale)))
    return dataclasses.replace(problem, essential=essential_space(problem, rng))


def _spectrum(
    robot: Robot, controller: CS8, pose: Array, spectrum: Spectrum | Array | None, period_s: float, harmonics: int
) -> tuple[Array, int]:
    """Lines of the multisine, and the harmonics that the references may have; modes are those of a pose."""
    flexible = robot.model.nv > len(robot.joints)
    highest = min(controller.log_cutoff_hz / 0.9 + 10.0, 0.49 * RATE_HZ)
    if spectrum is None:
        spectrum = "on_modes" if flexible else "below"
    if not flexible:
        if not isinstance(spectrum, str) or spectrum != "below":
            raise ValueError(f"{robot.name} is rigid: it has no modes to place lines on; expected spectrum 'below'")
        return np.zeros(0), harmonics
    q = np.zeros(robot.model.nv)
    q[drive_places(robot)] = pose
    if isinstance(spectrum, str):
        modes = robot.linearize(q).frequencies_hz(elastic_only=True)
        modes = modes[modes > 1.0 / period_s]  # the rigid-body modes are zero
        lowest = BELOW * float(modes[0])
        if spectrum == "below":
            return np.zeros(0), max(1, min(harmonics, int(lowest * period_s)))
        if spectrum != "on_modes":
            raise ValueError(f"spectrum is {spectrum!r}; expected 'below', 'on_modes' or frequencies in Hz")
        modes = modes[modes < highest]
        hz = np.unique(np.concatenate([m * np.linspace(1 - MODE_WIDTH, 1 + MODE_WIDTH, LINES_A_MODE) for m in modes]))
    else:
        hz = np.unique(np.asarray(spectrum, dtype=float))
        if hz.ndim != 1 or not len(hz) or hz[0] <= 0.0 or hz[-1] >= 0.5 * RATE_HZ:
            raise ValueError(f"spectrum: expected frequencies above 0 and below {0.5 * RATE_HZ:g} Hz")
    lines = np.unique(np.round(hz * period_s))
    lines = lines[(lines > harmonics) & (lines / period_s < 0.5 * RATE_HZ)]
    return lines / period_s, harmonics


def _within(problem: _DesignProblem, c: CandidateMotion) -> CandidateMotion:
    """The largest of the same shape that keeps to the limits, as predicted."""

    def outside(share: float) -> bool:
        return problem.excess(c.scaled(share, share)) > 0.0

    if not outside(1.0):
        return c
    low, high = 0.0, 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if outside(middle) else (middle, high)
    return c.scaled(low, low)


def _simulated_within(
    problem: _DesignProblem, c: CandidateMotion, search: _DesignSearch, tell: Progress
) -> tuple[Design, CandidateMotion]:
    """Simulate; as long as the robot passes a limit, make the multisine smaller, then the motion too."""
    problem = problem.at(problem.frame.every_instant)
    name, flexible = problem.frame.robot.name, len(problem.frame.hz) > 0
    c = _within(problem, c)
    for attempt in range(TRIES_SIMULATED):
        tell("simulation", search.part)
        design = _design(problem, c, np.array(search.history))
        run = design.simulation
        if run.ended is None and design.margins().kept:
            return design, c
        c = c.scaled(1.0 if flexible and 2 * attempt < TRIES_SIMULATED else SMALLER, SMALLER)
    raise ValueError(f"{name}: the simulated robot passes a limit on every try; {design.margins()}")


def _design(problem: _DesignProblem, c: CandidateMotion, history: Array) -> Design:
    frame = problem.frame
    time = frame.every_instant
    position, velocity, _ = c.references(time, frame.period_s)
    trajectory = Trajectory(
        "designed",
        frame.robot.joints,
        RATE_HZ,
        position,
        velocity,
        c.feedforward(time, frame.hz) if len(frame.hz) else None,
        frame.period_s,
    )
    return Design(
        frame.robot,
        frame.controller,
        frame.limits,
        trajectory,
        frame.hz,
        problem.assess(c),
        problem.essential,
        problem.scale,
        history,
    )
