"""Joint and drive stiffness from accelerometers on the links: least squares in the frequency domain (section 7.2).

With the links' accelerations beside the drives', all coordinates are known at every line, and the rows of (3.90) that belong to the
hinges, on which no motor acts, hold

    (s^2 M + K_G) x + (k_i + s d_i) eps_i + s c_j theta_j = 0,      s = jw,

K_G being gravity and springs. They are linear in stiffness k and damping d of each hinge and in the friction slope c of each joint.
Since the coordinates are noisy on both sides of these equations, each line's equations are weighted with the covariance that the
noise gives them at the present parameters: maximum likelihood for constrained, noisy coordinates. No drive torque is needed, and
so no motor constant and no drive inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from scipy import optimize

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.least_squares import Estimate
from rx90b_flex.linearize import Linearization
from rx90b_flex.robot import Robot
from rx90b_flex.signals.stated import Accelerometer

CONDITION = 1e6  # of the sensors' matrix, columns scaled, beyond which they do not see every coordinate


@dataclass(frozen=True, eq=False)
class AccelerationResponse(FrequencyResponse):
    """What accelerometers show over drive torque, at some lines and one pose, beside the drives' own response.

    Attributes
    ----------
    value : complex array, shape (F, 3 * sensors, n)
        x, y and z of each sensor over the torque of each drive, m/s^2 per N m.
    covariance : complex array, shape (F, 3 * sensors * n, 3 * sensors * n)
    sensors : tuple of Accelerometer
    """

    sensors: tuple[Accelerometer, ...] = field(kw_only=True)

    @property
    def _rows(self) -> int:
        return 3 * len(self.sensors)

    def band(self, low_hz: float, high_hz: float) -> AccelerationResponse:
        """The lines between two frequencies, both included."""
        kept = (self.hz >= low_hz) & (self.hz <= high_hz)
        return replace(self, hz=self.hz[kept], value=self.value[kept], covariance=self.covariance[kept])


@dataclass(frozen=True, eq=False)
class AccelerometerFit:
    """What the hinges' equations say.

    Attributes
    ----------
    estimates : tuple of Estimate
        Stiffness, damping and friction slopes, in that order; ``joint_2.joint_stiffness_1`` is that of ``bend_1``.
    covariance : array, shape (p, p)
    cost, expected_cost : float
        Sum of squared whitened equation errors (complex), and what noise alone gives.
    """

    estimates: tuple[Estimate, ...]
    covariance: Array
    cost: float
    expected_cost: float

    def __getitem__(self, name: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise ValueError(f"no parameter {name!r}; {close_match(name, [e.name for e in self.estimates])}")


def sensor_matrix(robot: Robot, angles: Array, sensors: Sequence[Accelerometer], hz: Array) -> ComplexArray:
    """What drives and accelerometers measure per unit of each coordinate, at some drive angles.

    An accelerometer feels gravity: where its link turns, gravity turns in its frame the other way.

    Returns
    -------
    complex array, shape (F, joints + 3 * sensors, n)
        Rows: accelerations of the drives, rad/s^2; x, y, z of each sensor, m/s^2.
    """
    linear, gravity = sensor_rows(robot, robot.input_matrix @ np.asarray(angles, dtype=float), sensors)
    s2 = (2j * np.pi * np.asarray(hz, dtype=float))[:, None, None] ** 2
    return np.asarray(np.concatenate([s2 * robot.input_matrix.T, s2 * linear + gravity], axis=1))


def sensor_rows(robot: Robot, q: Array, sensors: Sequence[Accelerometer]) -> tuple[Array, Array]:
    """What accelerometers measure per unit of each coordinate's acceleration, and by gravity of its angle; each (3 * sensors, n)."""
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, q)
    joints = dict(robot.bodies)
    linear, gravity = [np.zeros((0, model.nv))], [np.zeros((0, model.nv))]
    for sensor in sensors:
        if sensor.link not in joints:
            raise ValueError(f"accelerometer on {sensor.link!r}; {close_match(sensor.link, list(joints))}")
        joint = joints[sensor.link]
        jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL)
        linear.append(jacobian[:3] - pin.skew(np.asarray(sensor.position, dtype=float)) @ jacobian[3:])
        weight = data.oMi[joint].rotation.T @ -model.gravity.linear  # what the sensor shows at rest
        gravity.append(pin.skew(weight) @ jacobian[3:])
    return np.concatenate(linear), np.concatenate(gravity)


def fit_accelerations(
    robot: Robot,
    angles: Array,
    hz: Array,
    measured: ComplexArray,
    covariance: ComplexArray,
    sensors: Sequence[Accelerometer],
) -> AccelerometerFit:
    """Stiffness and damping of all hinges, and friction slopes, from measured accelerations of drives and links.

    Parameters
    ----------
    robot : Robot
        Links and springs known; its declared stiffness, damping and friction are where the fit starts.
    angles : array, shape (joints,), rad
        Of the drives.
    hz : array, shape (F,)
    measured : complex array, shape (F, joints + 3 * sensors, E)
        Spectra at these lines, rows as in `sensor_matrix`, of E experiments.
    covariance : complex array, shape (F, m, m)
        Of the noise of one experiment's spectra, ``E[d d^H]``.
    sensors : sequence of Accelerometer

    Raises
    ------
    ValueError
        Shapes that do not fit, or sensors that do not see every coordinate.
    """
    hz, measured, covariance = np.asarray(hz, dtype=float), np.asarray(measured), np.asarray(covariance)
    seen = sensor_matrix(robot, angles, sensors, hz)
    lines, rows = seen.shape[:2]
    if measured.ndim != 3 or measured.shape[:2] != (lines, rows):
        raise ValueError(f"measured has shape {measured.shape}; expected ({lines}, {rows}, experiments)")
    if covariance.shape != (lines, rows, rows):
        raise ValueError(f"covariance has shape {covariance.shape}; expected ({lines}, {rows}, {rows})")
    _refuse_unseen(robot, seen)
    equations = _equations(robot, np.asarray(angles, dtype=float))
    x, spread = _coordinates(seen, measured, covariance)
    s = (2j * np.pi * hz)[:, None, None]
    known = s**2 * equations.inertia + equations.stiffness
    start = equations.start

    def white(p: Array) -> Array:
        z = known + np.tensordot(p[: equations.split], equations.by_stiffness, axes=1)
        z = z + s * np.tensordot(p[equations.split :], equations.by_damping, axes=1)
        factor = np.linalg.cholesky(z @ spread @ z.conj().swapaxes(1, 2))
        error = np.sqrt(2.0) * np.linalg.solve(factor, z @ x).ravel()
        return np.concatenate([error.real, error.imag])

    found = optimize.least_squares(lambda r: white(start * r), np.ones(len(start)), "3-point", method="lm", xtol=1e-10)
    covariance_p = np.linalg.inv(found.jac.T @ found.jac) * np.outer(start, start)
    values, deviations = start * found.x, np.sqrt(np.diag(covariance_p))
    estimates = tuple(
        Estimate(name, float(v), float(d), unit)
        for name, unit, v, d in zip(equations.names, equations.units, values, deviations, strict=True)
    )
    count = found.fun.size / 2
    return AccelerometerFit(estimates, covariance_p, float(found.cost), count - 0.5 * len(start))


@dataclass(frozen=True, eq=False)
class _Equations:
    """Rows of the hinges: what is known, and one matrix a parameter, each of shape (hinges, n)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    start: Array
    split: int  # parameters before it multiply positions, from it on velocities
    inertia: Array
    stiffness: Array
    by_stiffness: Array
    by_damping: Array


def _coordinates(
    seen: ComplexArray, measured: ComplexArray, covariance: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Coordinates from the sensors, best for their noise, (F, n, E), and the covariance that it leaves in them, (F, n, n)."""
    weighted = np.linalg.solve(covariance, seen).conj().swapaxes(1, 2)
    spread = np.asarray(np.linalg.inv(weighted @ seen))
    return spread @ weighted @ measured, spread


def _equations(robot: Robot, angles: Array) -> _Equations:
    n = robot.model.nv
    at = robot.linearize(robot.input_matrix @ angles)
    free = np.flatnonzero(~robot.input_matrix.any(axis=1))
    names, stiffness, damping = [], np.diag(at.flexibility.K)[free], np.diag(at.flexibility.D)[free]
    for i in free:
        place, kind = robot.coordinates[i].rsplit(":", 1)
        if not at.flexibility.K[i, i] > 0.0:
            raise ValueError(f"coordinate {robot.coordinates[i]!r} has no declared stiffness to start from")
        names.append(f"{place}.drive_{{}}" if kind == "torsion" else f"{place}.joint_{{}}_{kind[-1]}")
    hinges = np.zeros((len(free), len(free), n))
    hinges[np.arange(len(free)), np.arange(len(free)), free] = 1.0
    twisting = [j for j in robot.joints if robot.layout.index(j, "torsion") is not None]
    ports = [robot.layout.port(j) for j in twisting]
    slopes = [np.outer(port, port)[free] for port in ports]
    moving = _slopes(robot, angles)
    return _Equations(
        (*(x.format("stiffness") for x in names), *(x.format("damping") for x in names), *(f"{j}.friction_slope" for j in twisting)),
        ("N m/rad",) * len(free) + ("N m s/rad",) * (len(free) + len(twisting)),
        np.concatenate([stiffness, np.maximum(damping, 1e-6 * stiffness), [moving[j] for j in twisting]]),
        len(free), _known(at, "M")[free], _known(at, "K")[free], hinges, np.stack([*hinges, *slopes]),
    )  # fmt: skip


def _known(at: Linearization, name: str) -> Array:
    return np.asarray(getattr(at.links, name) + getattr(at.drives, name) + getattr(at.spring, name))


def _slopes(robot: Robot, angles: Array, speed: float = 0.1) -> dict[str, float]:
    """Declared friction's slope at a usual speed of such experiments: where the fit starts."""
    at = robot.linearize(robot.input_matrix @ angles, robot.input_matrix @ np.full(len(robot.joints), speed))
    places = [robot.layout.index(j) for j in robot.joints]
    return {j: max(float(at.F0[i, i]), 1.0) for j, i in zip(robot.joints, places, strict=True) if i is not None}


def _refuse_unseen(robot: Robot, seen: ComplexArray) -> None:
    middle = np.abs(seen[len(seen) // 2])  # only its scale
    matrix = seen[len(seen) // 2] / np.maximum(np.linalg.norm(middle, axis=0), 1e-300)
    if matrix.shape[0] >= matrix.shape[1]:
        _, values, vectors = np.linalg.svd(matrix)
        if values[-1] * CONDITION > values[0]:
            return
    else:
        vectors = np.linalg.svd(matrix)[2]
    name = robot.coordinates[int(np.argmax(np.abs(vectors[-1])))]
    raise ValueError(
        f"the accelerometers do not see every coordinate: {name} is one that they miss; expected more sensors, or elsewhere"
    )
