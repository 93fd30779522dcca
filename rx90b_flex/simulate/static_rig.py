"""A simulated rig for dead-weight tests (section 4.1): a cable over a pulley pulls a flexible robot whose drives hold.

A hinge is loaded alone where lever and pull both lie across its axis. So the cable's end is put into the plane through
the hinge and square to its axis, where it is nearest to the robot's tip; a stiff bar from the last link carries it
there. The pull is square to axis and lever. Markers on the links before and behind the joint show a line each; the turn
of one line against the other, seen along the axis, is the deformation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import constants

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.robot import Robot
from rx90b_flex.signals.static_test import StaticTest

HEAVIEST_KG = 19.0  # section 4.1: 0 to 19 kg in seven steps
STEPS = 7
MARKER_STD = 0.014e-3 / 1.96  # m, in the camera's plane: 0.014 mm in 95 % of the readings
MARKER_DISTANCE = 0.5  # m, between the two markers of a link: the source's average
MARKER_ASIDE = 0.15  # m, from the hinge to the line of the link before it: choice, clear of the other line
SHORTEST_LEVER = 0.5  # m; where the tip lies nearer to the axis a bar reaches out: choice
PULLEY_DISTANCE = 2.0  # m, from the cable's end: choice, far enough for the pull to keep its direction to 1e-3

# Poses of rx90b's first joints, rad, in which the bar is short: choice. Straight up for the bendings of joint_1, tip at
# the height of joint_1's hinges for its torsion, arm stretched horizontally for the rest, and for the bending of
# joint_2 about the upper arm's own line the forearm folded back to the shoulder.
_STRETCHED = (0.0, np.pi / 2)
POSES: dict[str, tuple[float, ...]] = {
    "joint_1:torsion": (0.0, np.pi / 2 + np.arcsin(0.28 / 0.985)),
    "joint_1:bend_1": (),
    "joint_1:bend_2": (),
    "joint_2:bend_1": (0.0, 0.0, np.radians(140.0)),
}


@dataclass(frozen=True, eq=False)
class StaticRig:
    """Where cable, pulley and markers are for the test of one hinge. World frame, m; directions have length 1.

    Attributes
    ----------
    coordinate : str
    pose : array, shape (joints,), rad
        Angles at which the drives hold.
    axis, origin : array, shape (3,)
        Of the hinge.
    point, pulley : array, shape (3,)
        Where the cable ends, and the pulley it runs to.
    lever_arm : float
        m; moment about the axis per newton in the cable.
    bar : float
        m, from the tip to the cable's end.
    before, behind : array, shape (2, 3)
        Markers on the link before the joint and on the link behind it.
    """

    coordinate: str
    pose: Array
    axis: Array
    origin: Array
    point: Array
    pulley: Array
    lever_arm: float
    bar: float
    before: Array
    behind: Array

    @property
    def pull(self) -> Array:
        """Direction of the cable's pull, shape (3,)."""
        along = self.pulley - self.point
        return np.asarray(along / np.linalg.norm(along))

    @property
    def line(self) -> Array:
        """The two directions in which the lines are seen, across the pull and along it, shape (2, 3)."""
        return np.stack([np.cross(self.pull, self.axis), self.pull])


def hinges(robot: Robot) -> tuple[str, ...]:
    """Coordinates with a stiffness at a joint: torsions and bendings."""
    return tuple(c for c in robot.coordinates if not c.endswith(":drive") and not c.startswith("base:"))


def static_rig(robot: Robot, coordinate: str) -> StaticRig:
    """The rig that loads one hinge alone, in the pose of `POSES`, else with the arm stretched, ``(0, pi/2)``.

    Parameters
    ----------
    robot : Robot
    coordinate : str
        For example ``joint_2:bend_1``.

    Raises
    ------
    ValueError
        No such hinge.
    """
    known = hinges(robot)
    if coordinate not in known:
        hint = close_match(coordinate, known) if known else "none of its joints is flexible"
        raise ValueError(f"{robot.name} has no hinge {coordinate!r}; {hint}")
    given = POSES.get(coordinate, _STRETCHED)
    angles = np.zeros(len(robot.joints))
    angles[: len(given)] = given[: len(angles)]
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, robot.input_matrix @ angles)
    place = robot.coordinates.index(coordinate)
    hinge = data.oMi[place + 1]
    axis = hinge.rotation @ motion_axis(robot, place)
    origin = hinge.translation.copy()
    tip = data.oMf[model.getFrameId(robot.tip_frame)].translation
    reach = (tip - origin) - axis * (axis @ (tip - origin))
    lever = float(np.linalg.norm(reach))
    # where the tip lies on the axis, any direction across it
    across = reach / lever if lever > 1e-6 else np.linalg.svd(axis[None])[2][1]
    lever = max(lever, SHORTEST_LEVER)
    point, pull = origin + lever * across, np.cross(axis, across)
    markers = np.array([[0.0], [MARKER_DISTANCE]]) * across + origin
    return StaticRig(
        coordinate,
        angles,
        axis,
        origin,
        point,
        point + PULLEY_DISTANCE * pull,
        lever,
        float(np.linalg.norm(point - tip)),
        markers + MARKER_ASIDE * pull,
        markers,
    )


def motion_axis(robot: Robot, place: int) -> Array:
    """Axis of a coordinate in its own frame, shape (3,)."""
    return np.array(np.ravel(robot.model.joints[place + 1].createData().S)[3:])


@dataclass(frozen=True, eq=False)
class RigStates:
    """The robot on the rig, load by load.

    Attributes
    ----------
    tension : array, shape (N,), N
        In the cable at the robot's end.
    load : array, shape (N,), N
        Weight on the other end.
    rising : bool array, shape (N,)
    q : array, shape (N, n)
    before, behind : array, shape (N, 2, 3)
        True positions of the markers, m.
    """

    tension: Array
    load: Array
    rising: Mask
    q: Array
    before: Array
    behind: Array


def load_robot_on_rig(
    robot: Robot,
    rig: StaticRig,
    *,
    heaviest_kg: float = HEAVIEST_KG,
    steps: int = STEPS,
    friction: Sequence[float] | Array | None = None,
    pulley_friction: float = 0.0,
) -> RigStates:
    """Equilibrium of the flexible robot at every load, up in steps and down again; the drives do not move.

    Parameters
    ----------
    robot, rig
    heaviest_kg, steps
        Loads are evenly spaced from 0.
    friction : array, shape (n,), N m, optional
        Dry friction at each coordinate, which holds a hinge until its share of the moment exceeds it, up or down:
        the loop of figures 4.2(b) and (e). `standstill_friction` has the model's. None by default.
    pulley_friction : float
        Share of the weight that the pulley takes away on the way up and adds on the way down.

    Raises
    ------
    ValueError
        No equilibrium.
    """
    climb = np.linspace(0.0, heaviest_kg * constants.g, steps + 1)
    load = np.concatenate([climb, climb[-2::-1]])
    rising = np.arange(len(load)) <= steps
    tension = load * np.where(rising, 1.0 - pulley_friction, 1.0 + pulley_friction)
    statics = _Statics(robot, rig)
    dry = np.zeros(robot.model.nv) if friction is None else np.asarray(friction, dtype=float)
    if dry.shape != (robot.model.nv,) or not (dry >= 0.0).all():
        raise ValueError(f"friction has shape {dry.shape}; expected ({robot.model.nv},), N m, 0 or more")
    if dry.any():
        q, held = statics.frictionless(tension[:1])[0], np.zeros(robot.model.nv)
        path = []
        for newton in tension:
            q, held = statics.settle(q, held, dry, float(newton))
            path.append(q)
        states = np.array(path)
    else:
        states = statics.frictionless(tension)
    before, behind = (statics.seen(states, markers, after) for markers, after in ((rig.before, 0), (rig.behind, 1)))
    return RigStates(tension, load, rising, states, before, behind)


def standstill_friction(robot: Robot) -> Array:
    """Dry friction of the model's joints just before they slide, at their torsions, shape (n,), N m."""
    out = np.zeros(robot.model.nv)
    for effect in robot.effects:
        place = robot.layout.index(effect.joints[0], "torsion") if len(effect.joints) == 1 else None
        if place is not None and effect.traits.breaks_away:
            out[place] += effect.known_coefficients().sum()
    return out


def read_markers(
    rig: StaticRig,
    states: RigStates,
    rng: np.random.Generator,
    *,
    marker_std: float | Sequence[float] = MARKER_STD,
    drift: float = 0.0,
    repeats: int = 1,
) -> list[StaticTest]:
    """What a camera that looks along the hinge's axis makes of the states: tests as data.

    Each marker of each reading has independent normal noise. The deformation is the turn of the line behind the joint
    less that of the line before it, since the first reading; the moment is lever arm times weight.

    Parameters
    ----------
    marker_std : float or two, m
        Across the pull and along it; the second is what turns the lines. About five times as much where the camera's
        depth lies there, as for the drives of joints 1 and 4 in the source.
    drift : float, rad
        By how much the lines drift apart from the first reading to the last, evenly: the source suspects the camera's
        temperature behind the loop of figure 4.2(a), which runs the wrong way round.
    repeats : int
        Tests with the same states and fresh noise.
    """
    std = np.broadcast_to(np.asarray(marker_std, dtype=float), (2,))
    shape = (repeats, len(states.load), 2, 2)
    turn = [line_angle(x @ rig.line.T + std * rng.standard_normal(shape)) for x in (states.before, states.behind)]
    deformation = turn[1] - turn[0] + drift * np.linspace(0.0, 1.0, len(states.load))
    deformation = deformation - deformation[:, :1]
    moment = rig.lever_arm * states.load
    each = float(2.0 * std[1] / MARKER_DISTANCE)
    return [
        StaticTest(rig.coordinate, moment, readings, states.rising, deformation_std=each) for readings in deformation
    ]


def line_angle(markers: Array) -> Array:
    """Angle of the line from the first to the second marker in the plane, (..., 2, 2) -> (...), rad."""
    along = markers[..., 1, :] - markers[..., 0, :]
    return np.asarray(np.arctan2(along[..., 1], along[..., 0]))


class _Statics:
    """The robot with its drives locked and a cable at a point of its last link."""

    def __init__(self, robot: Robot, rig: StaticRig) -> None:
        self.robot, self.rig = robot, rig
        self.model, self.data = robot.model, robot.model.createData()
        self.start = robot.input_matrix @ rig.pose
        self.stiffness = robot.linearize(self.start).K
        self.free = np.flatnonzero(robot.input_matrix.sum(axis=1) == 0.0)
        joint = rig.coordinate.rsplit(":", 1)[0]
        own = [i for i, name in enumerate(robot.coordinates) if name.rsplit(":", 1)[0] == joint]
        # joints that carry the links before and behind
        self.parents = (robot.model.parents[own[0] + 1], own[-1] + 1)
        pin.forwardKinematics(self.model, self.data, self.start)
        self.tip = self.model.frames[self.model.getFrameId(robot.tip_frame)].parentJoint
        self.point = self.data.oMi[self.tip].actInv(rig.point)
        self.nominal = [self.data.oMi[parent].copy() for parent in self.parents]

    def frictionless(self, tension: Array) -> Array:
        """Where the robot stands under its own weight and the cable, (N,) to (N, n)."""
        start = np.tile(self.start, (len(tension), 1))
        return self._solve(start, self.free, np.zeros(self.model.nv), tension)

    def settle(self, q: Array, held: Array, dry: Array, tension: float) -> tuple[Array, Array]:
        """The next equilibrium, and the friction in it: hinges stay where they are until friction is used up."""
        sliding = dry == 0.0
        force = held.copy()
        for _ in range(len(dry) + 1):
            free = np.intersect1d(self.free, np.flatnonzero(sliding))
            (trial,) = self._solve(q[None], free, force, np.array([tension]))
            stuck = np.setdiff1d(self.free, free)
            asked = -self._missing(trial[None], np.zeros_like(force), np.array([tension]))[0]
            beyond = stuck[np.abs(asked[stuck]) > dry[stuck]]
            force[stuck] = np.clip(asked[stuck], -dry[stuck], dry[stuck])
            if len(beyond) == 0:
                return trial, force
            sliding[beyond] = True
        raise ValueError(f"{self.robot.name}: no equilibrium with friction on the rig of {self.rig.coordinate}")

    def seen(self, q: Array, markers: Array, side: int) -> Array:
        """World positions of markers that were put on a link in the nominal pose, shape (N, markers, 3)."""
        local = [self.nominal[side].actInv(marker) for marker in markers]
        out = np.empty((len(q), len(markers), 3))
        for k, state in enumerate(q):
            pin.forwardKinematics(self.model, self.data, state)
            out[k] = [self.data.oMi[self.parents[side]].act(point) for point in local]
        return out

    def _solve(self, q: Array, free: Indices, friction: Array, tension: Array) -> Array:
        """Chord method for the free coordinates, others as in q: stiffness hardly changes over such deformations."""
        q = q.copy()
        slope = self.stiffness[np.ix_(free, free)]
        for _ in range(50):
            step = np.linalg.solve(slope, self._missing(q, friction, tension)[:, free].T).T
            q[:, free] -= step
            if np.abs(step).max(initial=0.0) < 1e-13:
                return q
        raise ValueError(f"{self.robot.name}: no equilibrium on the rig of {self.rig.coordinate}")

    def _missing(self, q: Array, friction: Array, tension: Array) -> Array:
        """Generalised forces that are not in balance, (N, n): what holds the robot there, less cable, and friction."""
        rest = np.zeros_like(q)
        force = self.robot.inverse_dynamics(q, rest, rest) + friction
        for k, (state, newton) in enumerate(zip(q, tension, strict=True)):
            pin.computeJointJacobians(self.model, self.data, state)
            end = self.data.oMi[self.tip].act(self.point)
            along = self.rig.pulley - end
            pull = newton * along / np.linalg.norm(along)
            # the Jacobian in the world takes forces and their moments about the world's origin
            jacobian = pin.getJointJacobian(self.model, self.data, self.tip, pin.WORLD)
            force[k] -= jacobian.T @ np.concatenate([pull, np.cross(end, pull)])
        return force
