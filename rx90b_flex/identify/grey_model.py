"""The grey box's model: frequency responses as functions of drives, flexibilities, friction slopes and masses.

``Z(p) = s^2 M(p) + s D(p) + K(p)`` of (3.90) at the poses that were measured; see `rx90b_flex.identify.grey_box`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rx90b_flex.effects import Effect, close_match
from rx90b_flex.effects.friction import friction_port
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.hinge_places import with_hinges_moved
from rx90b_flex.identify.accelerometers import sensor_rows
from rx90b_flex.identify.frequency_response import ComplexArray
from rx90b_flex.robot import Robot
from rx90b_flex.signals.stated import Accelerometer

WEAK = 2.0  # standard deviation of a logarithm: a factor of 7 either way, which only matters where the data say nothing
KINDS = {
    "drive_inertia.inertia": "drive_inertia",
    "drive_flexibility.stiffness": "drive_stiffness",
    "drive_flexibility.damping": "drive_damping",
    "joint_flexibility.stiffness": "joint_stiffness",
    "joint_flexibility.damping": "joint_damping",
    "base_flexibility.stiffness": "base_stiffness",
    "base_flexibility.damping": "base_damping",
}
SLOPE, MASS = "friction_slope", "mass_factor"
DELAY, DELAY_UNIT = "robot.torque_delay", 1e-3  # fitted in thousandths of a second, beside logarithms
HINGE, AXES = "hinge", ("x", "y", "z")
HINGE_UNIT = 1e-2  # m, in which places of hinges are fitted
HINGE_STEP = 1e-3  # m, to either side, for derivatives; mass matrices are quadratic in it
USUAL_SPEED = 0.1  # rad/s, of such experiments
DELAY_STD = 2e-3  # s, of the delay before the data: a sample or so of usual logs


@dataclass(frozen=True)
class GreyParameter:
    """One fitted parameter; positive, and fitted as its logarithm. A delay and places of hinges may have either sign.

    Attributes
    ----------
    name : str
        Place and kind: ``joint_2.drive_stiffness``, ``joint_2.joint_stiffness_1`` (``bend_1``), ``joint_2.friction_slope``,
        ``link_2.mass_factor`` (all ten inertial parameters of the link are multiplied by it).
    unit : str
    declared : float
        Value of the robot; for a friction slope the one that its friction has on average where it moves.
    prior_std : float
        Of the number that is fitted, about the declared value.
    scale : float
        Of those with either sign, which are fitted as they are, in this unit; 0: as a logarithm.
    """

    name: str
    unit: str
    declared: float
    prior_std: float
    scale: float = 0.0

    @property
    def begin(self) -> float:
        """Where it stands in the vector of fitted numbers as declared."""
        return self.declared / self.scale if self.scale else math.log(self.declared)

    @property
    def words(self) -> str:
        """The name as it stands in a sentence."""
        place, kind = self.name.rsplit(".", 1)
        return f"{place} {kind.replace('_', ' ')}"


@dataclass(frozen=True)
class HingePlace:
    """Where a joint's hinges lie, from where they were declared, in the joint's frame at zero angle: m, each (3,)."""

    joint: str
    offset: tuple[float, ...]
    std: tuple[float, ...]
    declared_std: float


@dataclass(frozen=True)
class Delay:
    """By how much a log shows torques later than angles, with its standard deviation, s; negative: earlier."""

    value: float
    std: float


def late(hz: Array, delay: float) -> ComplexArray:
    """What a response over torques that were logged `delay` seconds late is over the true one, (F, 1, 1)."""
    return np.asarray(np.exp(2j * np.pi * delay * hz[:, None, None]))


@dataclass(frozen=True, eq=False)
class GreyPose:
    """Matrices at one pose: what is fixed, and what one unit of each parameter adds; each of shape (p + 1, n, n)."""

    M: Array
    D: Array
    K: Array
    drives: Array  # (n, joints), B
    # rows of accelerometers, each (3 * sensors, n): by acceleration, and by gravity of the angle
    sensors: tuple[Array, Array] | None

    def response(self, hz: Array, p: Array) -> ComplexArray:
        """P, and below it the accelerometers' responses, shape (F, joints + 3 * sensors, joints)."""
        s, inverse = self._inverse(hz, p)
        return self._measured(s, inverse) @ self.drives

    def derivatives(self, hz: Array, p: Array) -> ComplexArray:
        """dP/dp, shape (p, F, joints + 3 * sensors, joints)."""
        s, inverse = self._inverse(hz, p)
        left, right = self._measured(s, inverse), inverse @ self.drives
        out = np.zeros((len(p), len(hz), left.shape[1], self.drives.shape[1]), dtype=complex)
        for power, pattern in ((2, self.M), (1, self.D), (0, self.K)):
            for i in np.flatnonzero(pattern[1:].any(axis=(1, 2))):
                # most patterns touch one or two coordinates
                at = np.flatnonzero(pattern[i + 1].any(axis=0) | pattern[i + 1].any(axis=1))
                middle = pattern[i + 1][np.ix_(at, at)]
                out[i] -= s**power * (left[:, :, at] @ middle @ right[:, at])
        return out

    def _measured(self, s: ComplexArray, inverse: ComplexArray) -> ComplexArray:
        """What drives and sensors show per unit of force on each coordinate."""
        own = s**2 * (self.drives.T @ inverse)
        if self.sensors is None:
            return own
        linear, gravity = self.sensors
        return np.concatenate([own, s**2 * (linear @ inverse) + gravity @ inverse], axis=1)

    def _inverse(self, hz: Array, p: Array) -> tuple[ComplexArray, ComplexArray]:
        s: ComplexArray = np.asarray(2j * np.pi * hz[:, None, None], dtype=complex)
        weights = np.concatenate([[1.0], p])
        M, D, K = (np.tensordot(weights, x, axes=1) for x in (self.M, self.D, self.K))
        inverse: ComplexArray = np.asarray(np.linalg.inv(s**2 * M + s * D + K), dtype=complex)
        return s, inverse


@dataclass(frozen=True, eq=False)
class GreyMotion:
    """Poses that a motion passes in one experiment, and the feedback that holds the robot to it.

    The robot changes slowly beside its vibrations, so that at each pose P_q holds. Torque and acceleration of an experiment are
    means over the poses, and in a loop ``u = S_q r``, ``y = P_q S_q r`` with ``S_q = (I + H P_q)^-1`` both change: what
    ``Y U^-1`` estimates is ``P = mean(P_q S_q) mean(S_q)^-1``.
    """

    poses: tuple[GreyPose, ...]
    feedback: ComplexArray | None  # H: torque against acceleration, (F, joints, joints)
    sensors: bool = False  # whether it is the accelerometers' responses that are asked for, which follow P

    def response(self, hz: Array, p: Array) -> ComplexArray:
        return self._asked(self._mean(hz, p)[0])

    def derivatives(self, hz: Array, p: Array) -> ComplexArray:
        """Shape (p, F, joints, joints)."""
        mean, each = self._mean(hz, p)
        out = np.zeros((len(p), *mean.shape), dtype=complex)
        for pose, (through_loop, right) in zip(self.poses, each, strict=True):
            change = pose.derivatives(hz, p)
            out += (change + through_loop @ change[:, :, : mean.shape[-1]]) @ right
        out /= len(self.poses)
        return self._asked(out)

    def _asked(self, rows: ComplexArray) -> ComplexArray:
        joints = rows.shape[-1]
        return rows[..., joints:, :] if self.sensors else rows[..., :joints, :]

    def _mean(self, hz: Array, p: Array) -> tuple[ComplexArray, list[tuple[ComplexArray, ComplexArray]]]:
        """All rows, and the factors that a change of each pose's rows comes with: of P's rows through the loop, and on the right."""
        responses: ComplexArray = np.array([pose.response(hz, p) for pose in self.poses])
        joints = responses.shape[-1]
        one = np.eye(joints, dtype=complex)
        if self.feedback is None or len(self.poses) == 1:
            plain: ComplexArray = np.asarray(responses.mean(axis=0), dtype=np.complex128)
            return plain, [(np.zeros((plain.shape[1], joints), dtype=complex), one)] * len(responses)
        sensitivity = np.linalg.inv(one + self.feedback @ responses[:, :, :joints])
        inverse = np.linalg.inv(sensitivity.mean(axis=0))
        mean = (responses @ sensitivity).mean(axis=0) @ inverse
        return mean, [
            ((mean - each) @ s @ self.feedback, s @ inverse) for each, s in zip(responses, sensitivity, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class GreyExperiments:
    """What ``Y U^-1`` estimates where each experiment k has its own friction: ``P = sum_k P_k u_k (U^-1)_k``."""

    motions: tuple[GreyMotion, ...]
    shares: tuple[ComplexArray | Array, ...]  # u_k (U^-1)_k of each, (F, joints, joints) or (joints, joints)

    def response(self, hz: Array, p: Array) -> ComplexArray:
        each = [motion.response(hz, p) @ share for motion, share in zip(self.motions, self.shares, strict=True)]
        return np.asarray(sum(each))

    def derivatives(self, hz: Array, p: Array) -> ComplexArray:
        """Shape (p, F, joints, joints)."""
        each = [motion.derivatives(hz, p) @ share for motion, share in zip(self.motions, self.shares, strict=True)]
        return np.asarray(sum(each))

    def of_sensors(self) -> GreyExperiments:
        """The same experiments as accelerometers show them."""
        return replace(self, motions=tuple(replace(m, sensors=True) for m in self.motions))

    def coarser(self, keep: slice) -> GreyExperiments:
        """Some of the lines, with each motion's middle pose alone."""
        motions = tuple(GreyMotion((m.poses[len(m.poses) // 2],), None, m.sensors) for m in self.motions)
        return GreyExperiments(motions, tuple(s[keep] if s.ndim == 3 else s for s in self.shares))


def shares_of(torques: ComplexArray | None, joints: int) -> tuple[ComplexArray | Array, ...]:
    """``u_k (U^-1)_k`` of each experiment's torques, (F, joints, experiments); one for all where these are not given."""
    if torques is None:
        return (np.eye(joints),)
    inverse = np.linalg.pinv(torques)
    return tuple(torques[:, :, k, None] * inverse[:, k, None, :] for k in range(torques.shape[2]))


def grey_parameters(robot: Robot, joints: Sequence[str], experiments: int, link_mass_std: float) -> list[GreyParameter]:
    """What is fitted of a robot: drives, flexibilities, a friction slope a joint and experiment, links' masses where these err."""
    out = []
    for effect in robot.effects:
        if effect.traits.in_drivetrain:
            named = zip(
                parameter_names(effect), effect.coefficient_parameters.values(), effect.coefficients, strict=True
            )
            for name, parameter, value in named:
                if not (np.isfinite(value) and value > 0):
                    raise ValueError(f"{effect.label}: {name} is {value:g}; expected a positive value to start from")
                out.append(GreyParameter(name, robot.unit_of(effect, parameter.unit), float(value), WEAK))
    for joint in joints:
        slope = _slope(robot, joint)
        unit = robot.units[robot.joints.index(joint)].of("N m s/rad")
        out += [GreyParameter(slope_name(joint, k, experiments), unit, slope, WEAK) for k in range(experiments)]
    if link_mass_std > 0.0:
        out += [GreyParameter(f"{link}.{MASS}", "-", 1.0, link_mass_std) for link, _ in robot.bodies]
    return out


def hinge_parameters(
    robot: Robot, hinge_std: float | Mapping[str, float], places: Mapping[str, Array] | None = None
) -> list[GreyParameter]:
    """Places of hinges, three a joint, to be fitted where they are not known: of all joints that bend, or of those named.

    `places` by joint, (3,), m, are those at which the robot has them already, of which nothing was known.

    Raises
    ------
    ValueError
        A joint that the robot does not have, a standard deviation below 0.
    """
    if not isinstance(hinge_std, Mapping):
        bending = {j for e in robot.effects if e.type_name() == "joint_flexibility" for j in e.joints}
        hinge_std = {joint: hinge_std for joint in robot.joints if joint in bending}
    out = []
    for joint, std in hinge_std.items():
        if joint not in robot.joints:
            raise ValueError(f"hinge_std: {robot.name} has no joint {joint!r}; {close_match(joint, robot.joints)}")
        if not 0.0 <= std < np.inf:
            raise ValueError(f"hinge_std: {joint} has {std:g} m; expected 0 or more")
        if std > 0.0:
            declared = -np.asarray((places or {}).get(joint, np.zeros(3)))
            names = [f"{joint}.{HINGE}_{x}" for x in AXES]
            unit = HINGE_UNIT
            out += [GreyParameter(n, "m", float(d), std / unit, unit) for n, d in zip(names, declared, strict=True)]
    return out


def moved_hinges(robot: Robot, parameters: Sequence[GreyParameter]) -> dict[str, tuple[Robot, Robot]]:
    """The robot with each hinge a step to one side and to the other, by the parameter's name."""
    out = {}
    for name in (p.name for p in parameters if f".{HINGE}_" in p.name):
        joint, axis = name.split(f".{HINGE}_")
        step = HINGE_STEP * np.eye(3)[AXES.index(axis)]
        out[name] = with_hinges_moved(robot, {joint: step}), with_hinges_moved(robot, {joint: -step})
    return out


def declared_parameters(robot: Robot) -> dict[str, float]:
    """Drive and flexibility parameters of a robot by the grey box's names, as they stand in `start` and `fixed`."""
    parts = [e for e in robot.effects if e.traits.in_drivetrain]
    return {name: float(value) for e in parts for name, value in zip(parameter_names(e), e.coefficients, strict=True)}


def parameter_names(effect: Effect) -> list[str]:
    """The grey box's names of an effect's coefficients."""
    place = "_".join(effect.joints) or "base"
    out = []
    for name in effect.coefficient_parameters:
        stem, _, digit = name.rpartition("_") if name[-1].isdigit() else (name, "", "")
        kind = KINDS.get(f"{effect.type_name()}.{stem}", f"{effect.type_name()}_{stem}")
        out.append(f"{place}.{kind}" + (f"_{digit}" if digit else ""))
    return out


def slope_name(joint: str, experiment: int, experiments: int) -> str:
    """Name of a joint's friction slope in an experiment, counted from 0."""
    return f"{joint}.{SLOPE}" + (f"_{experiment + 1}" if experiments > 1 else "")


def _slope(robot: Robot, joint: str) -> float:
    """Slope of the declared friction at a usual speed of such experiments; only a place to start from."""
    q = np.zeros(robot.model.nv)
    port = friction_port(robot.effects, robot.layout, joint)
    motion = robot.motion(q, USUAL_SPEED * robot.layout.port(joint, "drive"), q)
    frictions = [e for e in robot.effects if e.traits.is_friction and e.joints == (joint,) and e.traits.in_dynamics]
    slope = sum(float(port @ e.derivatives(motion)[1][0] @ port) / float(port @ port) ** 2 for e in frictions)
    return max(slope, 1.0)


def matrices_at(
    robot: Robot,
    slopes: Mapping[str, str],
    angles: Array,
    parameters: Sequence[GreyParameter],
    sensors: Sequence[Accelerometer] = (),
    moved: Mapping[str, tuple[Robot, Robot]] | None = None,
) -> GreyPose:
    """Matrices with the drives at some angles; drives without a slope stand still, held by their friction.

    Parameters
    ----------
    slopes : name of the friction slope of each joint that moves
    moved : `moved_hinges` of the parameters
    """
    joints = list(slopes)
    n, rest = robot.model.nv, np.zeros(robot.model.nv)
    q = robot.input_matrix @ angles
    motion = robot.motion(q, rest, rest)
    index = {p.name: i + 1 for i, p in enumerate(parameters)}
    M, D, K = (np.zeros((len(parameters) + 1, n, n)) for _ in range(3))

    def add(at: int, derivatives: tuple[Array, Array, Array], factor: float = 1.0) -> None:
        K[at] += factor * derivatives[0][0]
        D[at] += factor * derivatives[1][0]
        M[at] += factor * derivatives[2][0]

    for part in _fixed(robot, motion):
        add(0, part)
    for effect in robot.effects:
        if effect.traits.in_drivetrain:
            for k, name in enumerate(parameter_names(effect)):
                unit = np.eye(len(effect.coefficients))[k]
                add(index[name], effect.with_coefficients(unit).derivatives(motion))
    for name, sides in (moved or {}).items():
        for other, sign in zip(sides, (1.0, -1.0), strict=True):
            for part in _fixed(other, other.motion(q, rest, rest)):
                add(index[name], part, sign / (2.0 * HINGE_STEP))
    for joint in joints:
        port = friction_port(robot.effects, robot.layout, joint)
        D[index[slopes[joint]]] += np.outer(port, port)
    for b, (link, _) in enumerate(robot.bodies):
        if f"{link}.{MASS}" in index:
            of_link = _of_link(motion, link, robot.link_parameters[10 * b : 10 * b + 10])
            add(index[f"{link}.{MASS}"], of_link)
            add(0, of_link, -1.0)
    held = np.array([j not in joints for j in robot.joints])
    free = np.flatnonzero(~robot.input_matrix[:, held].any(axis=1))
    drives = robot.input_matrix[free][:, [robot.joints.index(j) for j in joints]]
    M, D, K = (x[:, free[:, None], free] for x in (M, D, K))
    rows = sensor_rows(robot, q, sensors) if sensors else None
    return GreyPose(M, D, K, drives, None if rows is None else (rows[0][:, free], rows[1][:, free]))


def _fixed(robot: Robot, motion: Motion) -> list[tuple[Array, Array, Array]]:
    """Derivatives of what is not fitted: links and springs."""
    others = [e for e in robot.effects if not (e.traits.in_drivetrain or e.traits.is_friction)]
    return [motion.on_tree.derivatives(), *(e.derivatives(motion) for e in others)]


def _of_link(motion: Motion, link: str, parameters: Array) -> tuple[Array, Array, Array]:
    if parameters[0] <= 0.0:
        zero = np.zeros((1, len(motion.coordinates), len(motion.coordinates)))
        return zero, zero, zero
    return motion.on_tree.body_derivatives(link, parameters)


def response_derivatives(
    robot: Robot, joints: Sequence[str], pose: Array, slopes: Mapping[str, float], hz: Array
) -> ComplexArray:
    """Derivatives of P at a pose by the logarithms of drive and flexibility parameters, (p, F, n, n); friction has viscous slopes."""
    parameters = grey_parameters(robot, joints, 1, 0.0)
    names = {joint: slope_name(joint, 0, 1) for joint in joints}
    values = np.array(
        [slopes[p.name.partition(".")[0]] if p.name in names.values() else p.declared for p in parameters]
    )
    own = np.array([p.name not in names.values() for p in parameters])
    by = matrices_at(robot, names, pose, parameters).derivatives(hz, values)
    return np.asarray((by * values[:, None, None, None])[own])


def poses_along(position: Array) -> Array:
    """Three poses that stand for a motion to and fro: means of equal parts along its main direction, with each joint's variance.

    For a motion along a line at constant speed they average polynomials up to the third degree exactly.

    Parameters
    ----------
    position : array, shape (N, joints), rad
        Whole periods, sampled evenly.

    Returns
    -------
    array, shape (3, joints)
    """
    mean = position.mean(axis=0)
    moved = position - mean
    main = np.linalg.svd(moved, full_matrices=False)[2][0]
    parts = np.array_split(moved[np.argsort(moved @ main)], 3)
    picked = np.array([part.mean(axis=0) for part in parts])
    picked -= picked.mean(axis=0)
    size = np.sqrt((picked**2).mean(axis=0))
    return np.asarray(mean + picked * np.divide(position.std(axis=0), size, out=np.zeros_like(size), where=size > 0))
