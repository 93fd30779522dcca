"""A path as joint references: inverse kinematics along it, and what stands in its way before anything is simulated."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from rx90b_flex.effects.motion import Array
from rx90b_flex.path.seam import Seam
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.cs8 import CS8
from rx90b_flex.simulate.trajectories import Trajectory
from rx90b_flex.tip import jacobian_at

HOLD_S = 0.5  # choice: at rest before and after the path, so that a correction can begin and a vibration end
REACHED = 1e-10  # m, or rad times the arm's length
STEPS = 60  # Newton steps from a first guess
TURN = 0.3  # rad; longest Newton step of a joint
# Choice: smallest over largest singular value of the tip's Jacobian; below it a joint turns 50 times as much.
SINGULAR = 0.02
AROUND = "expected a path beside it, or another start_deg"  # what to do about a singularity
JUMP = 0.2  # rad; between two samples: another way to reach the point
GUESSES = (-0.6, -0.2, 0.2, 0.6)  # of half a joint's range; first guesses of the first three joints
COARSE = 2e-3  # m along the path, between the samples at which ways to go are compared
TRIED = 6  # ways to reach the start that are followed,
SETS = 4  # each by so many sets of three joints
LONGEST_RANGE = np.pi  # rad either side; of a first guess


Kind = Literal["reach", "limits", "singularity", "speed", "torque"]
KINDS: tuple[Kind, ...] = get_args(Kind)


class Problem(NamedTuple):
    """What stands in the way, and where along the path, m; the kinds in the order in which they are looked for."""

    kind: Kind
    begin: float
    end: float
    why: str

    def __str__(self) -> str:
        at = f"at {1e3 * self.begin:.1f} mm"
        if self.end - self.begin > 1e-3:
            at = f"from {1e3 * self.begin:.1f} to {1e3 * self.end:.1f} mm"
        return f"{at} of the path {self.why}"


@dataclass(frozen=True, eq=False)
class PathPlan:
    """A path in joint angles, at the rate at which the controller takes references.

    Attributes
    ----------
    seam : Seam
    robot : Robot
    rate_hz : float
    distance : array, shape (N,), m
        Along the path; the tip rests for `HOLD_S` before and after.
    point, tangent : array, shape (N, 3)
        Planned tip, m, in the base frame, and the path's direction there.
    position : array, shape (N, joints), rad
    pull : array, shape (N, joints, 3), rad/m
        Joint angles per displacement of the tip, by the three joints that move it best: a correction that moved a wrist, too, would
        have to fight the friction that makes it stick.
    """

    seam: Seam
    robot: Robot
    rate_hz: float
    distance: Array
    point: Array
    tangent: Array
    position: Array
    pull: Array

    @property
    def time(self) -> Array:
        """s, shape (N,)."""
        return np.arange(len(self.distance)) / self.rate_hz

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Samples between the first and the last on the path, both included; shape (N,)."""
        return (self.time >= HOLD_S) & (self.time <= HOLD_S + self.seam.duration_s)

    def trajectory(self, correction: Array | None = None) -> Trajectory:
        """The references, with the tip displaced (N, 3), m, to first order."""
        position = self.position
        if correction is not None:
            position = position + np.einsum("kji,ki->kj", self.pull, correction)
        velocity = rates(position, self.rate_hz)
        return Trajectory(self.seam.name, self.robot.joints, self.rate_hz, position, velocity)


def rates(position: Array, rate_hz: float, order: int = 1) -> Array:
    """Time derivative of samples by a cubic spline that is at rest at both ends, shape of `position`."""
    time = np.arange(len(position)) / rate_hz
    return np.asarray(CubicSpline(time, position, axis=0, bc_type="clamped")(time, order))


def plan(seam: Seam, robot: Robot, controller: CS8) -> PathPlan:
    """Find the joint references of a path, and refuse a path that the robot cannot follow.

    Parameters
    ----------
    seam : Seam
    robot : Robot
    controller : CS8
        Its rate and torque limits.

    Raises
    ------
    ValueError
        Where along the path, and why: out of reach, outside a joint's limits, through a singularity, too fast for a joint, too
        much torque (of the rigid robot with all its other effects).
    """
    held = HOLD_S + seam.duration_s
    time = np.arange(round((held + HOLD_S) * controller.reference_rate_hz) + 1) / controller.reference_rate_hz
    distance = seam.motion(time - HOLD_S)
    point, tangent = seam.pieces.at(distance)
    arm = _Arm(robot, seam)
    frames = seam.frames(distance)
    starts = arm.starts(point[0], None if frames is None else frames[0])
    if not starts:
        raise ValueError(f"{seam.name}: {arm.out_of_reach(0.0, point[0])}")

    def follow(way: _Way, rows: slice) -> PathPlan | Problem:
        start, joints = way
        arm.carry_by(joints)
        wanted = np.tile(arm.frame(start), (len(point), 1, 1)) if seam.orientation == "keep" else frames
        followed = arm.follow(start, distance[rows], point[rows], None if wanted is None else wanted[rows])
        if isinstance(followed, Problem):
            return followed
        position, pull, measure = followed
        rate = controller.reference_rate_hz / (rows.step or 1)
        found = PathPlan(seam, robot, rate, distance[rows], point[rows], tangent[rows], position, pull)
        return (
            _limits(found) or arm.singular(found.distance, measure, position) or _too_fast(found, controller) or found
        )

    # coarsely, which of several ways it can go, or which fails last: in kind, then in distance
    stride = max(1, int(COARSE / (seam.speed / controller.reference_rate_hz)))
    ways = arm.ways(starts[:TRIED])
    best, fails = ways[0], (-1, -1.0)
    for way in ways if len(ways) > 1 else ():
        found = follow(way, slice(None, None, stride))
        if isinstance(found, PathPlan):
            best = way
            break
        if (KINDS.index(found.kind), found.begin) > fails:
            best, fails = way, (KINDS.index(found.kind), found.begin)
    found = follow(best, slice(None))
    if isinstance(found, Problem):
        raise ValueError(f"{seam.name}: {found}{arm.who_carries()}")
    return found


class _Way(NamedTuple):
    """Angles at the start, and the joints that carry the tip from there."""

    start: Array
    joints: tuple[int, ...]


class _Arm:
    """Inverse kinematics of the rigid robot's tip by Newton's method.

    Where the orientation is free, the three joints that move the tip best at the start do it, or where these cannot others, and the
    rest stand still: asked for a little motion, they would stick. With an orientation, all turn, redundant ones as little as need be.
    """

    def __init__(self, robot: Robot, seam: Seam) -> None:
        self.robot, self.seam = robot, seam
        self.model, self.data = robot.tree, robot.tree.createData()
        self.tip = self.model.getFrameId(robot.tip_frame)
        self.size = max(sum(float(np.linalg.norm(x.translation)) for x in self.model.jointPlacements), 0.1)  # m
        self.lower, self.upper = (np.asarray(x) for x in (self.model.lowerPositionLimit, self.model.upperPositionLimit))
        self.used = self.carries = np.ones(self.model.nv)
        if seam.orientation != "free" and self.model.nv < 6:
            raise ValueError(
                f"{seam.name}: an orientation needs 6 joints or more, {robot.name} has {self.model.nv}; expected orientation 'free'"
            )

    def ways(self, starts: Sequence[Array]) -> list[_Way]:
        """From each start with the joints that move the tip best there, then with those next to them."""
        sets = list(itertools.combinations(range(self.model.nv), min(3, self.model.nv)))
        by_start = []
        for start in starts:
            jacobian = jacobian_at(self.model, self.data, start, self.tip)[:3]
            least = [float(np.linalg.svd(jacobian[:, list(joints)], compute_uv=False)[-1]) for joints in sets]
            order = sorted(range(len(sets)), key=lambda i: -least[i])[: SETS if self.seam.orientation == "free" else 1]
            by_start.append([_Way(start, sets[i]) for i in order])
        return [way for same in itertools.zip_longest(*by_start) for way in same if way is not None]

    def who_carries(self) -> str:
        """Of a problem, which joints alone were to move; empty where all were."""
        if self.used.all():
            return ""
        joints = [j for j, used in zip(self.robot.joints, self.used, strict=True) if used]
        return f" (by {', '.join(joints[:-1])} and {joints[-1]} alone, as no others that were tried get farther)"

    def carry_by(self, joints: tuple[int, ...]) -> None:
        """Choose the joints that carry the tip."""
        self.carries = np.isin(np.arange(self.model.nv), joints).astype(float)
        if self.seam.orientation == "free":
            self.used = self.carries

    def frame(self, q: Array) -> Array:
        """Rotation of the tip frame."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return np.array(self.data.oMf[self.tip].rotation)

    def task(self, q: Array, point: Array, frame: Array | None) -> tuple[Array, Array]:
        """What is missing, and its Jacobian; turns are counted in metres at the end of the arm."""
        jacobian = jacobian_at(self.model, self.data, q, self.tip) * self.used
        pin.updateFramePlacement(self.model, self.data, self.tip)
        at = self.data.oMf[self.tip]
        missing = point - at.translation
        if frame is None:
            return missing, jacobian[:3]
        turn = self.size * pin.log3(frame @ at.rotation.T)
        return np.concatenate([missing, turn]), np.concatenate([jacobian[:3], self.size * jacobian[3:]])

    def solve(
        self, q: Array, point: Array, frame: Array | None, within_limits: bool = False
    ) -> tuple[Array, Array] | None:
        """Angles near `q` that reach a place, and the Jacobian there; if asked for, with no joint beyond its limits on the way."""
        for _ in range(STEPS):
            missing, jacobian = self.task(q, point, frame)
            if np.abs(missing).max() < REACHED:
                return q, jacobian
            step = _step(jacobian, missing)
            if within_limits:
                ends = ((q <= self.lower) & (step < 0.0)) | ((q >= self.upper) & (step > 0.0))
                step = _step(jacobian * ~ends, missing)
            q = q + step * min(1.0, TURN / max(float(np.abs(step).max()), 1e-12))
            if within_limits:
                q = np.clip(q, self.lower, self.upper)
        return None

    def starts(self, point: Array, frame: Array | None) -> list[Array]:
        """Ways to reach the start, those farthest from the joints' limits first; the given one alone where there is one."""
        low, high = np.maximum(self.lower, -LONGEST_RANGE), np.minimum(self.upper, LONGEST_RANGE)
        rest = np.where((low < 0.0) & (high > 0.0), 0.0, 0.5 * (low + high))
        if self.seam.start is not None:
            if len(self.seam.start) > len(rest):
                raise ValueError(
                    f"{self.seam.name}: start_deg has {len(self.seam.start)} angles; {self.robot.name} has {len(rest)} joints"
                )
            rest[: len(self.seam.start)] = self.seam.start
            guesses: Sequence[tuple[float, ...]] = [()]
        else:
            guesses = list(itertools.product(GUESSES, repeat=min(3, len(rest))))
        found: list[Array] = []
        for guess in guesses:
            q, moved = rest.copy(), len(guess)
            q[:moved] = 0.5 * (low + high)[:moved] + np.array(guess) * 0.5 * (high - low)[:moved]
            solved = self.solve(q, point, frame)
            if solved is not None:
                # a turn more or less is the same place
                turns = np.round((solved[0] - 0.5 * (low + high)) / (2.0 * np.pi))
                angle = solved[0] - 2.0 * np.pi * np.where(self._beyond(solved[0]), turns, 0.0)
                if self._beyond(angle).any():
                    inside = self.solve(np.clip(q, self.lower, self.upper), point, frame, within_limits=True)
                    angle = angle if inside is None else inside[0]
                if not any(np.abs(angle - other).max() < 1e-3 for other in found):
                    found.append(angle)
        return sorted(found, key=lambda angle: -float(np.min(np.minimum(angle - low, high - angle) / (high - low))))

    def _beyond(self, q: Array) -> NDArray[np.bool_]:
        return np.asarray((q < self.lower) | (q > self.upper))

    def out_of_reach(self, distance: float, point: Array) -> Problem:
        """A point that no angles reach."""
        where = ", ".join(f"{1e3 * x:.1f}" for x in point)
        oriented = "" if self.seam.orientation == "free" else " in its orientation"
        why = f"{self.robot.name} cannot reach ({where}) mm with {self.robot.tip_frame}{oriented}"
        return Problem("reach", distance, distance, why)

    def follow(
        self, start: Array, distance: Array, point: Array, frames: Array | None
    ) -> tuple[Array, Array, Array] | Problem:
        """Angles (N, joints), their pull (N, joints, 3) and the measure of singularity (N,) along the path."""
        position, measure = np.empty((len(point), len(start))), np.empty(len(point))
        pull: list[Array] = []
        still = np.append(False, np.diff(distance) == 0.0)
        for k, x in enumerate(point):
            if still[k]:
                position[k], measure[k] = position[k - 1], measure[k - 1]
                pull.append(pull[-1])
                continue
            guess = start if k == 0 else position[k - 1]
            solved = self.solve(guess, x, None if frames is None else frames[k])
            if solved is None:
                return self.out_of_reach(distance[k], x)
            position[k], jacobian = solved
            s = np.linalg.svd(jacobian, compute_uv=False)
            measure[k] = s[-1] / s[0]
            if k > 0 and np.abs(position[k] - guess).max() > JUMP:
                far = int(np.abs(position[k] - guess).argmax())
                by = self.robot.units[far].place(abs(position[k][far] - guess[far]))
                why = f"goes through a singularity: {self.robot.joints[far]} would jump by {by}; {AROUND}"
                return Problem("singularity", distance[k - 1], distance[k], why)
            pull.append(np.asarray(np.linalg.pinv(jacobian[:3] * self.carries, rcond=SINGULAR), dtype=float))
        return position, np.stack(pull), measure

    def singular(self, distance: Array, measure: Array, position: Array) -> Problem | None:
        """Where a direction of the tip is nearly lost."""
        where = _first(measure < SINGULAR)
        if where is None:
            return None
        worst = where[0] + int(measure[where[0] : where[1] + 1].argmin())
        places = ", ".join(unit.place(q) for unit, q in zip(self.robot.units, position[worst], strict=True))
        why = (
            f"passes a singularity: one direction of the tip needs {1.0 / max(measure[worst], 1e-6):.0f} times the joint motion of "
            f"another (limit {1.0 / SINGULAR:.0f}), worst at {1e3 * distance[worst]:.1f} mm with joints at {places}; {AROUND}"
        )
        return Problem("singularity", float(distance[where[0]]), float(distance[where[1]]), why)


def _step(jacobian: Array, missing: Array) -> Array:
    """Newton's, damped by what is missing, so that it neither runs away out of reach nor slows down at the end."""
    square = jacobian @ jacobian.T + min(1e-3, float(missing @ missing)) * np.eye(len(missing))
    try:
        return np.asarray(jacobian.T @ np.linalg.solve(square, missing))
    except np.linalg.LinAlgError:  # a direction is lost, and hardly anything is missing: as far as the others go
        return np.asarray(np.linalg.pinv(jacobian) @ missing)


def _first(wrong: NDArray[np.bool_]) -> tuple[int, int] | None:
    """First and last sample of the first segment that is wrong."""
    if not wrong.any():
        return None
    begin = int(np.argmax(wrong))
    rest = wrong[begin:]
    return begin, begin + (len(rest) if rest.all() else int(np.argmin(rest))) - 1


def _beyond(
    plan: PathPlan, kind: Kind, value: Array, low: Array, high: Array, why: Callable[[int, float], str]
) -> Problem | None:
    """The first joint along the path that leaves its range; `why` says so of its place and its worst value."""
    found = []
    for j in range(len(plan.robot.joints)):
        over = np.maximum(value[:, j] - high[j], low[j] - value[:, j])
        where = _first(over > 0.0)
        if where is not None:
            begin, end = where
            worst = value[begin + int(over[begin : end + 1].argmax()), j]
            found.append(Problem(kind, float(plan.distance[begin]), float(plan.distance[end]), why(j, float(worst))))
    return min(found, key=lambda problem: problem.begin, default=None)


def _limits(plan: PathPlan) -> Problem | None:
    low, high = (np.asarray(x) for x in (plan.robot.tree.lowerPositionLimit, plan.robot.tree.upperPositionLimit))

    def why(j: int, worst: float) -> str:
        at, least, most = (plan.robot.units[j].place(x) for x in (worst, low[j], high[j]))
        return f"needs {plan.robot.joints[j]} at {at}, outside its limits {least} to {most}"

    return _beyond(plan, "limits", plan.position, low, high, why)


def _too_fast(plan: PathPlan, controller: CS8) -> Problem | None:
    limit = np.asarray(plan.robot.tree.upperVelocityLimit, dtype=float)
    joints, units, velocity = plan.robot.joints, plan.robot.units, rates(plan.position, plan.rate_hz)

    def turns(j: int, worst: float) -> str:
        return f"is too fast: {joints[j]} would {units[j].move} at {worst:.3g} {units[j].speed}, over its limit of {limit[j]:g}"

    found = _beyond(plan, "speed", velocity, -limit, limit, turns)
    if found is not None:
        return found
    most = controller.for_joints(joints).column("torque_limit")

    def needs(j: int, worst: float) -> str:
        return f"is too fast: {joints[j]} would need {worst:.4g} {units[j].force}, over its limit of {most[j]:g}"

    torque = plan.robot.rigid().inverse_dynamics(plan.position, velocity, rates(plan.position, plan.rate_hz, 2))
    return _beyond(plan, "torque", torque, -most, most, needs)
