"""How a number made of a regressor changes with the motion: the regressor's derivative, never written out.

A motion of N samples has a regressor of N n rows; its derivative by coordinates, rates and accelerations holds 3 n times
as much. A search wants only ``sum(weight * d regressor)``, which costs about as much as the regressor.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from rx90b_flex.effects.effect import Effect, JointForce
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.robot import Robot

Slopes = tuple[Array, Array, Array]  # by coordinates, rates and accelerations, each (N, n)


def regressor_slope(robot: Robot, q: Array, v: Array, a: Array, weight: Array) -> Slopes:
    """Change of ``sum(weight * robot.regressor(q, v, a))`` by each number of the motion.

    Parameters
    ----------
    q, v, a : array, shape (N, n)
    weight : array, shape (N, n, p)

    Returns
    -------
    by_q, by_v, by_a : array, shape (N, n)
    """
    motion = robot.motion(q, v, a)
    out = _of_links(robot, motion, weight[:, :, : len(robot.link_parameter_places)])
    for place, effect in enumerate(robot.forces):
        columns = {e.column: i for i, e in enumerate(robot.parameter_entries) if e.source == place}
        own = weight[:, :, [columns[k] for k in range(len(columns))]]
        for whole, part in zip(out, _of_effect(effect, motion, own), strict=True):
            whole += part
    return out


def _of_effect(effect: Effect, motion: Motion, weight: Array) -> Slopes:
    if isinstance(effect, JointForce):
        at = motion.joint(effect.joint, effect.port_kind)
        on_joint = np.einsum("tnk,n->tk", weight, at.port)
        by_q, by_v, by_a = (np.outer((on_joint * slope).sum(axis=1), at.port) for slope in effect.slopes(at))
        return by_q, by_v, by_a
    total = np.zeros((3, *motion.q.shape))
    for k, unit in enumerate(np.eye(weight.shape[2])):
        for out, by in zip(total, effect.with_coefficients(unit).derivatives(motion), strict=True):
            out += (weight[:, None, :, k] @ by)[:, 0]
    return total[0], total[1], total[2]


# ---- links ------------------------------------------------------------------------------------------------------
# A body's columns are J^T R, J its Jacobian (6, n) and R its wrench per parameter (6, 10), in its own frame:
#   R = sum_i d_i FORCE_i + alpha_i TURNING_i + sum_ij w_i w_j SPINNING_ij,
# with angular velocity w and acceleration alpha, and d the acceleration of the frame's origin, less gravity.


def _cross(x: Array) -> Array:
    """Matrices S with S y = x cross y, shape (..., 3, 3)."""
    zero = np.zeros_like(x[..., 0])
    rows = [[zero, -x[..., 2], x[..., 1]], [x[..., 2], zero, -x[..., 0]], [-x[..., 1], x[..., 0], zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _wrench_parts() -> tuple[Array, Array, Array]:
    """FORCE (3, 6, 10), TURNING (3, 6, 10) and SPINNING (3, 3, 6, 10); columns m, m s, then J as pinocchio orders it."""
    force, turning, spinning = np.zeros((3, 6, 10)), np.zeros((3, 6, 10)), np.zeros((3, 3, 6, 10))
    units = np.eye(3)
    inertia = np.zeros((3, 3, 6))  # J x = inertia[i] x_i @ (xx, xy, yy, xz, yz, zz)
    for column, (i, j) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]):
        inertia[j, i, column] = inertia[i, j, column] = 1.0
    turn = _cross(units)
    for i in range(3):
        force[i, :3, 0] = units[i]
        force[i, 3:, 1:4] = -turn[i]
        turning[i, :3, 1:4] = turn[i]
        turning[i, 3:, 4:] = inertia[i]
        for j in range(3):
            spinning[i, j, :3, 1:4] = turn[i] @ turn[j]
            spinning[i, j, 3:, 4:] = turn[i] @ inertia[j]
    return force, turning, spinning


FORCE, TURNING, SPINNING = _wrench_parts()


def _of_links(robot: Robot, motion: Motion, weight: Array) -> Slopes:
    model, data = robot.model, robot.model.createData()
    count, n = motion.q.shape
    bodies = [joint for _, joint in robot.bodies]
    size = (len(bodies), count)
    by_q, by_v, jacobian = np.empty((*size, 6, n)), np.empty((*size, 6, n)), np.empty((*size, 6, n))
    rate_by_q, twist, rate, down = (
        np.empty((*size, 6, n)),
        np.empty((*size, 6)),
        np.empty((*size, 6)),
        np.empty((*size, 3)),
    )
    gravity = model.gravity.linear
    derivatives, frame = pin.getJointAccelerationDerivatives, pin.ReferenceFrame.LOCAL
    for t, (q, v, a) in enumerate(zip(motion.q, motion.v, motion.a, strict=True)):
        pin.computeForwardKinematicsDerivatives(model, data, q, v, a)
        for b, joint in enumerate(bodies):
            found = derivatives(model, data, joint, frame)
            for out, part in zip((rate_by_q, by_q, by_v, jacobian), found, strict=True):
                out[b, t] = part.reshape(6, n)
            twist[b, t], rate[b, t] = data.v[joint].vector, data.a[joint].vector
            down[b, t] = data.oMi[joint].rotation.T @ gravity
    order = np.argsort(robot.link_parameter_places.reshape(-1, 10) % 10, axis=1)
    total = np.zeros((3, count, n))
    for b in range(len(bodies)):
        of_body = weight[:, :, 10 * b : 10 * (b + 1)][:, :, order[b]]
        jac, angular = jacobian[b], twist[b][:, 3:]
        origin = rate[b][:, :3] + np.cross(angular, twist[b][:, :3]) - down[b]
        on_wrench = (jac @ of_body).reshape(count, 60)
        by_origin, by_turning = (on_wrench @ part.reshape(3, 60).T for part in (FORCE, TURNING))
        squares = (on_wrench @ SPINNING.reshape(9, 60).T).reshape(count, 3, 3)
        by_spin = np.einsum("tij,tj->ti", squares + np.swapaxes(squares, 1, 2), angular)
        by_twist = np.hstack([np.cross(by_origin, angular), by_spin + np.cross(twist[b][:, :3], by_origin)])
        by_rate = np.hstack([by_origin, by_turning])
        by_down = np.hstack([np.zeros((count, 3)), -np.cross(by_origin, down[b])])
        spins = (angular[:, :, None] * angular[:, None]).reshape(count, 9)
        wrench = (
            origin @ FORCE.reshape(3, 60) + rate[b][:, 3:] @ TURNING.reshape(3, 60) + spins @ SPINNING.reshape(9, 60)
        )
        total[0] += _pulled(rate_by_q[b], by_twist) + _pulled(by_q[b], by_rate) + _pulled(jac, by_down)
        total[0] += _by_axes(jac, wrench.reshape(count, 6, 10) @ np.swapaxes(of_body, 1, 2))
        total[1] += _pulled(jac, by_twist) + _pulled(by_v[b], by_rate)
        total[2] += _pulled(jac, by_rate)
    return total[0], total[1], total[2]


def _pulled(matrix: Array, by: Array) -> Array:
    return np.asarray((by[:, None] @ matrix)[:, 0])


def _by_axes(jacobian: Array, weight: Array) -> Array:
    """Change of ``sum(weight * jacobian)``, both (N, 6, n), by each coordinate: it turns the axes before its own."""
    linear, angular = np.swapaxes(jacobian[:, :3], 1, 2), np.swapaxes(jacobian[:, 3:], 1, 2)
    by_linear, by_angular = np.swapaxes(weight[:, :3], 1, 2), np.swapaxes(weight[:, 3:], 1, 2)
    on_linear = np.cross(by_linear, angular)
    on_angular = np.cross(by_linear, linear) + np.cross(by_angular, angular)
    before = [np.cumsum(x, axis=1) - x for x in (on_linear, on_angular)]
    return np.asarray((linear * before[0] + angular * before[1]).sum(axis=2))
