"""How far the tip strays from a path, which effect causes how much of it, and a corrected path."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from typing import Literal, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array
from rx90b_flex.path.correct import Learner
from rx90b_flex.path.planning import HOLD_S, PathPlan, plan, rates
from rx90b_flex.path.seam import Seam
from rx90b_flex.robot import Robot
from rx90b_flex.showing import Showing
from rx90b_flex.simulate.closed_loop import Simulation, simulate
from rx90b_flex.simulate.cs8 import CS8, drive_places

Verdict = Literal["within_tolerance", "corrected_within_tolerance", "outside_tolerance"]
Tell = Callable[[str, float], None]

ENOUGH = 0.5  # of the tolerance: a correction that is better is not improved any more
GAIN = 0.95  # an iteration that leaves more than this of the best one's largest deviation gains nothing
PATIENCE = 2  # iterations without gain before it ends
MODEL_ERROR = 0.1  # part by which the model is made wrong, to see what the correction is worth then
STICKS = 0.05  # of the speed that is planned: a slower drive sticks
SLOWEST = 1e-3  # rad/s; a drive that is planned to turn more slowly stands still
OFTEN = 3  # stops of a drive on its way, from which it is said to stick and slip
AXES = ("along", "left", "up", "across")  # of a deviation
PARTS = {"friction": "friction", "flexibility": "stiffness and damping of hinges", "spring": "springs"}


@dataclass(frozen=True)
class PathOptions:
    """What is asked of a check.

    Attributes
    ----------
    tolerance_mm : float
        Largest deviation across the path.
    correct : bool
        Whether a corrected path is looked for.
    contributions : bool
        Whether each effect is switched off in turn, one run each.
    iterations : int
        Of the correction, at most; one run each.
    jobs : int
        Processes for the runs of the contributions.
    """

    tolerance_mm: float = 0.1
    correct: bool = True
    contributions: bool = True
    iterations: int = 10
    jobs: int = 1

    def __post_init__(self) -> None:
        if not (isinstance(self.tolerance_mm, Real) and 0.0 < self.tolerance_mm < np.inf):
            raise ValueError(f"tolerance_mm is {self.tolerance_mm!r}; expected a number, more than 0")
        for name, value in (("iterations", self.iterations), ("jobs", self.jobs)):
            if not (isinstance(value, Integral) and value >= 1):
                raise ValueError(f"{name} is {value!r}; expected a whole number, 1 or more")


@dataclass(frozen=True, eq=False)
class Deviation:
    """Where the tip is, less where the plan has it at that time, from the first to the last instant on the path.

    Attributes
    ----------
    distance_mm : array, shape (N,)
        Planned, along the path.
    length_mm : float
        Of the path.
    along, left, up : array, shape (N,), mm
        Components: along the path, horizontally across it to the left, and across it upwards (on a vertical path: across it along y
        and along x).
    ended : str or None
        Why the run ended early.
    """

    distance_mm: Array
    length_mm: float
    along: Array
    left: Array
    up: Array
    ended: str | None = None

    @cached_property
    def across(self) -> Array:
        """Distance of the tip from the path's tangent, shape (N,), mm: what a weld sees."""
        return np.hypot(self.left, self.up)

    @property
    def max_across(self) -> float:
        """mm."""
        return float(self.across.max())

    @property
    def rms_across(self) -> float:
        """Root mean square over time, mm."""
        return float(np.sqrt(np.mean(self.across**2)))

    @property
    def max_along(self) -> float:
        """mm."""
        return float(np.abs(self.along).max())

    @property
    def worst_at_mm(self) -> float:
        """Where it is largest across."""
        return float(self.distance_mm[self.across.argmax()])

    def columns(self, name: str = "") -> dict[str, Array]:
        """Its four components by name and unit; `name` stands between these."""
        return {f"{axis}{name}_mm": getattr(self, axis) for axis in AXES}

    @cached_property
    def by_mm(self) -> Array:
        """Largest deviation across in each millimetre of the path, shape (ceil(length),), mm; infinite where the run did not get."""
        count = max(1, int(np.ceil(self.length_mm - 1e-6)))
        out = np.zeros(count)
        np.maximum.at(out, np.clip(self.distance_mm.astype(int), 0, count - 1), self.across)
        middle = np.arange(count) + 0.5  # a fast tip may have no sample within a millimetre
        out = np.maximum(out, np.interp(middle, self.distance_mm, self.across))
        if self.ended is not None:
            out[int(np.ceil(self.distance_mm[-1])) :] = np.inf
        return out

    def within(self, tolerance_mm: float) -> NDArray[np.bool_]:
        """Pass or fail of each millimetre."""
        return self.by_mm <= tolerance_mm

    def passes(self, tolerance_mm: float) -> bool:
        """Whether every millimetre does."""
        return self.ended is None and bool(self.within(tolerance_mm).all())

    def failing(self, tolerance_mm: float) -> list[tuple[int, int, float]]:
        """Segments that fail: first and last millimetre (as 0 to 1 for the first) and the largest deviation there."""
        bad = np.concatenate([[False], ~self.within(tolerance_mm), [False]]).astype(int)
        begins, ends = np.flatnonzero(np.diff(bad) == 1), np.flatnonzero(np.diff(bad) == -1)
        return [(int(a), int(b), float(self.by_mm[a:b].max())) for a, b in zip(begins, ends, strict=True)]


@dataclass(frozen=True)
class Contribution:
    """What an effect does to the deviation: the difference between runs with and without it.

    Attributes
    ----------
    name : str
    part : str
        The group of the effect: friction, flexibility, spring, ...
    max_across, rms_across, max_along : float, mm
        Of the difference; NaN where the effect could not be switched off.
    rms_without : float, mm
        Deviation across that is left without it.
    why_not : str or None
        Why it could not be switched off.
    """

    name: str
    part: str
    max_across: float = float("nan")
    rms_across: float = float("nan")
    max_along: float = float("nan")
    rms_without: float = float("nan")
    why_not: str | None = None


class Sticking(NamedTuple):
    """A joint whose drive stops on its way again and again, and how often."""

    joint: str
    stops: int


class Iteration(NamedTuple):
    """Deviation across after a step of the correction, mm."""

    max_across: float
    rms_across: float


@dataclass(frozen=True, eq=False, repr=False)
class PathCheck(Showing):
    """The result.

    Attributes
    ----------
    plan : Plan
    options : Options
    before : Deviation
    after : Deviation or None
        Of the corrected path; None where none was asked for or the run ended early.
    correction : array, shape (N, 3), m, or None
        Displacement of the reference, for each sample of the plan.
    iterations : tuple of Iteration
        The first without correction.
    contributions : tuple of Contribution
        First that of links, drives and controller alone, then of each effect.
    left_over : float, mm
        RMS across of what those do only together: the deviation less the sum of all contributions; NaN without them.
    sticking : tuple of Sticking
        Joints that stick and slip on the planned path.
    runs : tuple of Simulation
        As planned; corrected, where a correction was found.
    wrong_model : tuple of (str, Deviation)
        The corrected path on a robot whose parameters of one kind are lower by `MODEL_ERROR`.
    seconds : dict of stage and its time, s
    correction_ended : str or None
        Why the robot did not follow the next step of the correction, which ended it; None where it did.
    """

    plan: PathPlan
    options: PathOptions
    before: Deviation
    after: Deviation | None
    correction: Array | None
    iterations: tuple[Iteration, ...]
    contributions: tuple[Contribution, ...]
    left_over: float
    wrong_model: tuple[tuple[str, Deviation], ...]
    seconds: dict[str, float]
    sticking: tuple[Sticking, ...] = ()
    runs: tuple[Simulation, ...] = ()
    correction_ended: str | None = None

    @property
    def verdict(self) -> Verdict:
        """Whether the path passes as it is, corrected, or not."""
        if self.before.passes(self.options.tolerance_mm):
            return "within_tolerance"
        corrected = self.after is not None and self.after.passes(self.options.tolerance_mm)
        return "corrected_within_tolerance" if corrected else "outside_tolerance"

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        tolerance = f"{self.options.tolerance_mm:g} mm"
        before, after = self.before, self.after
        if before.ended is not None:
            return f"The robot does not follow the path: {before.ended}"
        if self.verdict == "within_tolerance":
            return f"Pass: the tip strays by {before.max_across:.3g} mm at most, within {tolerance}."
        strays = f"the tip strays by {before.max_across:.3g} mm (at {before.worst_at_mm:.0f} mm along the path)"
        if after is None:
            return f"Fail: {strays}, tolerance {tolerance}."
        if self.verdict == "corrected_within_tolerance":
            return f"Pass when corrected: {strays}, on the corrected path by {after.max_across:.3g} mm, within {tolerance}."
        bad = int((~after.within(self.options.tolerance_mm)).sum())
        ended = f" The next step would end early: {self.correction_ended}." if self.correction_ended else ""
        return (
            f"Fail: {strays}; correction in {len(self.iterations) - 1} steps brings it to {after.max_across:.3g} mm, and {bad} of "
            f"{len(after.by_mm)} millimetres stay over {tolerance}.{ended}{self.sticking_words}"
        )

    @property
    def sticking_words(self) -> str:
        """What sticks and slips, and what helps; empty where nothing does."""
        if not self.sticking:
            return ""
        said = ", ".join(f"{s.joint} stops {s.stops} times on its way" for s in self.sticking)
        return (
            f" Drives stick and slip ({said}): a slip comes a little earlier or later each time, so no correction meets it. A higher "
            "speed, a free orientation or another pose avoids it."
        )


def check_path(
    seam: Seam, robot: Robot, controller: CS8, options: PathOptions | None = None, tell: Tell | None = None
) -> PathCheck:
    """Plan a path, simulate it, split its deviation into effects, and correct it.

    Parameters
    ----------
    seam : Seam
    robot : Robot
    controller : CS8
    options : Options, optional
    tell : callable, optional
        Called with what is being done and the part that is done.

    Raises
    ------
    ValueError
        A path that the robot cannot follow (see `plan`), before anything is simulated; a robot that cannot be simulated.
    """
    options, tell = options or PathOptions(), tell or (lambda text, part: None)
    seconds: dict[str, float] = {}
    begun = time.perf_counter()

    def lap(stage: str) -> None:
        seconds[stage] = time.perf_counter() - begun - sum(seconds.values())

    tell("planning", 0.0)
    planned = plan(seam, robot, controller)
    lap("inverse kinematics and checks")
    tell("simulating", 0.05)
    run = simulate(robot, controller, planned.trajectory())
    before = deviation(planned, run)
    lap("one simulation")
    runs: tuple[Simulation, ...] = (run,)
    after: Deviation | None = None
    correction: Array | None = None
    iterations: tuple[Iteration, ...] = (Iteration(before.max_across, before.rms_across),)
    ended: str | None = None
    if options.correct and before.ended is None:
        after, correction, iterations, corrected, ended = _correct(planned, controller, run, options, tell)
        runs = (run, corrected) if np.any(correction) else runs
        lap("correction")
    wrong: tuple[tuple[str, Deviation], ...] = ()
    if after is not None and correction is not None and np.any(correction):
        tell("with a wrong model", 0.5)
        wrong = tuple(_wrong_models(planned, controller, correction))
        lap("corrected path with a wrong model")
    contributions: tuple[Contribution, ...] = ()
    left_over = float("nan")
    if options.contributions and before.ended is None:
        contributions, left_over = _contributions(planned, controller, before, options.jobs, tell)
        lap("contributions")
    return PathCheck(
        planned, options, before, after, correction, iterations, contributions, left_over, wrong, seconds,
        sticking(planned, run), runs, ended,
    )  # fmt: skip


def deviation(planned: PathPlan, run: Simulation) -> Deviation:
    """Split the tip's distance from its planned place by the path's direction there."""
    on = run.time - HOLD_S
    inside = (on >= 0.0) & (on <= planned.seam.duration_s)
    if not inside.any():
        inside[0] = True  # the run ended before the path began
    distance = planned.seam.motion(on[inside])
    point, tangent = planned.seam.pieces.at(distance)
    missing = 1e3 * (run.tip[inside, :3, 3] - point)
    left, up = across_axes(tangent)
    along, aside, above = (np.einsum("ki,ki->k", axis, missing) for axis in (tangent, left, up))
    return Deviation(1e3 * distance, 1e3 * planned.seam.pieces.total, along, aside, above, run.ended)


def across_axes(tangent: Array) -> tuple[Array, Array]:
    """Unit vectors to the left of directions (horizontal) and up from them, each (N, 3); along y and x of a vertical one."""
    vertical = np.abs(tangent[:, 2]) > 0.999
    left = np.cross(np.where(vertical[:, None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), tangent)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    return left, np.cross(tangent, left)


def sticking(planned: PathPlan, run: Simulation) -> tuple[Sticking, ...]:
    """Joints whose drives stop `OFTEN` or more times while the plan has them turn on the same way."""
    wanted = rates(planned.position, planned.rate_hz)[: len(run.v)]
    way = np.sign(wanted) * (np.abs(wanted) > SLOWEST)
    forward = run.v[: len(wanted), drive_places(planned.robot)] * way
    sticks = (way != 0) & (np.abs(forward) < STICKS * np.abs(wanted))
    # a drive that has not broken away yet, or still moves the other way, does not stop
    moves = (way != 0) & (forward >= STICKS * np.abs(wanted))
    stops = (moves[:-1] & sticks[1:] & (way[1:] == way[:-1])).sum(axis=0)
    return tuple(Sticking(j, int(n)) for j, n in zip(planned.robot.joints, stops, strict=True) if n >= OFTEN)


# ---- correction -------------------------------------------------------------------------------------------------


def _correct(
    planned: PathPlan, controller: CS8, run: Simulation, options: PathOptions, tell: Tell
) -> tuple[Deviation, Array, tuple[Iteration, ...], Simulation, str | None]:
    """The best correction that was found: its deviation, the displacement of the reference, the steps to it, its run, and why the
    next step's ended early.
    """
    correction = np.zeros_like(planned.point)
    best, kept, best_run = deviation(planned, run), correction, run
    steps = [Iteration(best.max_across, best.rms_across)]
    if best.max_across <= ENOUGH * options.tolerance_mm:
        return best, kept, tuple(steps), best_run, None
    learner = Learner(planned, controller)
    idle = 0
    for k in range(options.iterations):
        tell(f"correcting, {best.max_across:.3f} mm", 0.1 + 0.4 * k / options.iterations)
        correction = correction - learner(_at_plan(planned, run))
        run = simulate(planned.robot, controller, planned.trajectory(correction))
        if run.ended is not None:
            break  # asked too much of the robot
        found = deviation(planned, run)
        steps.append(Iteration(found.max_across, found.rms_across))
        idle = 0 if found.max_across < GAIN * best.max_across else idle + 1
        if found.max_across < best.max_across:
            best, kept, best_run = found, correction, run
        if best.max_across <= ENOUGH * options.tolerance_mm or idle == PATIENCE:
            break
    return best, kept, tuple(steps), best_run, run.ended


def _at_plan(planned: PathPlan, run: Simulation) -> Array:
    """Tip less planned tip at the plan's samples, m, shape (N, 3)."""
    tip = np.stack([np.interp(planned.time, run.time, x) for x in run.tip[:, :3, 3].T], axis=1)
    return tip - planned.point


def _wrong_models(planned: PathPlan, controller: CS8, correction: Array) -> list[tuple[str, Deviation]]:
    out = []
    trajectory = planned.trajectory(correction)
    for part, words in PARTS.items():
        effects = [
            e.with_coefficients((1.0 - MODEL_ERROR) * e.coefficients) if e.traits.part == part else e
            for e in planned.robot.effects
        ]
        if any(e.traits.part == part for e in effects):
            run = simulate(planned.robot.with_effects(effects), controller, trajectory)
            out.append((words, deviation(planned, run)))
    return out


# ---- contributions ----------------------------------------------------------------------------------------------


def _contributions(
    planned: PathPlan, controller: CS8, before: Deviation, jobs: int, tell: Tell
) -> tuple[tuple[Contribution, ...], float]:
    """Each effect switched off in turn, and what is there without any; then what they do only together."""
    effects = planned.robot.effects
    off = [e for e in effects if e.traits.part != "drives"]
    drives = [e for e in effects if e.traits.part == "drives"]
    cases: list[Sequence[Effect]] = [drives]
    cases += [[e for e in effects if e is not one] for one in off]
    work = (delayed(_run_without)(planned, controller, case) for case in cases)
    runs: list[Deviation | str] = []
    for k, found in enumerate(Parallel(n_jobs=jobs, return_as="generator")(work)):
        tell(f"effects, {k + 1} of {len(cases)}", 0.5 + 0.48 * (k + 1) / len(cases))
        runs.append(found)
    total = _components(before)
    sum_of_all, out = np.zeros_like(total), []
    names = [("links and controller", "links"), *((_name(e), e.traits.part) for e in off)]
    for (name, part), case in zip(names, runs, strict=True):
        if isinstance(case, str) or case.ended is not None:
            why = case if isinstance(case, str) else f"without it the run ends: {case.ended}"
            out.append(Contribution(name, part, why_not=why))
            continue
        own = _components(case) if part == "links" and not out else total - _components(case)
        sum_of_all += own
        of = Deviation(before.distance_mm, before.length_mm, *own)
        out.append(Contribution(name, part, of.max_across, of.rms_across, of.max_along, case.rms_across))
    out += [Contribution(_name(e), e.traits.part, why_not="the drive needs it to move") for e in drives]
    rest = total - sum_of_all
    return tuple(out), float(np.sqrt(np.mean(rest[1] ** 2 + rest[2] ** 2)))


def _run_without(planned: PathPlan, controller: CS8, effects: Sequence[Effect]) -> Deviation | str:
    """The path on the same tree with some of the effects; in words why it cannot be simulated."""
    try:
        run = simulate(planned.robot.with_effects(effects), controller, planned.trajectory())
    except ValueError as error:
        return " ".join(str(error).split())
    return deviation(planned, run)


def _components(of: Deviation) -> Array:
    return np.stack([of.along, of.left, of.up])


def _name(effect: Effect) -> str:
    where = " + ".join(effect.joints) or "robot"
    return f"{effect.type_name()} {where}".replace("_", " ")
