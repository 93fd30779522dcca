"""Inertial parameters that a body can have: the pseudo-inertia, and a check.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", IEEE Robotics and Automation Letters 3(1), 2018. Ten parameters belong to some distribution
of mass if and only if their pseudo-inertia

    P = [[Sigma, s], [s', m]],    Sigma = tr(J) / 2 * I - J

is positive semidefinite: positive mass, positive moments, and the triangle inequality among them, all in one. Sigma is
the second moment of the mass, the integral of x x' dm, about the same point as J; the sign of P's eigenvalues does not
depend on that point.

Parameters of a body stand in the order of `rx90b_flex.robot.LINK_PARAMETERS`, about its joint frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array

# An eigenvalue this far below zero, as a part of the trace, is rounding: point masses and thin rods have zeros.
ROUNDING = 1e-12


def _moments(parameters: Array) -> Array:
    """J of ten parameters, shape (..., 3, 3)."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(parameters[..., 4:], -1, 0)
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(*parameters.shape[:-1], 3, 3)


def pseudo_inertia(parameters: Array) -> Array:
    """Pseudo-inertia of bodies.

    Parameters
    ----------
    parameters : array, shape (..., 10)
        m (kg), s (kg m), J (kg m^2: xx yy zz xy xz yz) about the joint frame.

    Returns
    -------
    array, shape (..., 4, 4)
        ``[[Sigma, s], [s', m]]``; kg m^2, kg m and kg.
    """
    parameters = np.asarray(parameters, dtype=float)
    moments = _moments(parameters)
    half_trace = 0.5 * np.trace(moments, axis1=-2, axis2=-1)
    out = np.empty((*parameters.shape[:-1], 4, 4))
    out[..., :3, :3] = half_trace[..., None, None] * np.eye(3) - moments
    out[..., :3, 3] = out[..., 3, :3] = parameters[..., 1:4]
    out[..., 3, 3] = parameters[..., 0]
    return out


def moments_about_centre(parameters: Array) -> tuple[Array, Array]:
    """Centre of mass c = s / m, shape (3,), and J about it (equation 3.34: ``J_c = J + m S(c) S(c)``), shape (3, 3).

    Parameters
    ----------
    parameters : array, shape (10,)
        Of one body, its mass not zero.
    """
    parameters = np.asarray(parameters, dtype=float)
    centre = parameters[1:4] / parameters[0]
    shift = np.dot(centre, parameters[1:4]) * np.eye(3) - np.outer(centre, parameters[1:4])
    return centre, _moments(parameters) - 0.5 * (shift + shift.T)


# ---- check --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Inconsistency:
    """A body whose inertial parameters no distribution of mass has.

    Attributes
    ----------
    link : str
    eigenvalue : float
        The smallest one of its pseudo-inertia about the joint frame (kg and m), below zero.
    message : str
        One line that names the link, the eigenvalue and what is wrong.
    """

    link: str
    eigenvalue: float
    message: str


def inconsistencies(link_parameters: Array, link_names: Sequence[str]) -> tuple[Inconsistency, ...]:
    """Bodies that are not physically consistent, in the order of the names; none if all are.

    Parameters
    ----------
    link_parameters : array, shape (10 * bodies,)
        As `Robot.link_parameters`. A body without mass and moments is consistent.
    link_names : sequence of str

    Raises
    ------
    ValueError
        The number of parameters is not ten a name, or one is not finite.
    """
    bodies = as_bodies(link_parameters, len(link_names), "link_parameters")
    found = []
    for name, parameters, matrix in zip(link_names, bodies, pseudo_inertia(bodies), strict=True):
        smallest = float(np.linalg.eigvalsh(matrix)[0])
        if smallest < -ROUNDING * np.abs(np.diag(matrix)).sum():
            text = f"{name}: the smallest eigenvalue of the pseudo-inertia is {smallest:.4g}; {_reason(parameters)}"
            found.append(Inconsistency(name, smallest, text))
    return tuple(found)


def _reason(parameters: Array) -> str:
    mass = parameters[0]
    if mass <= 0:
        return f"the mass is {mass:.4g} kg"
    low, middle, high = np.linalg.eigvalsh(moments_about_centre(parameters)[1])
    moments = f"the principal moments about the centre of mass are {low:.4g}, {middle:.4g}, {high:.4g} kg m^2"
    return f"{moments}: {'one is negative' if low < 0 else 'the largest exceeds the sum of the others'}"


def as_bodies(parameters: Array, bodies: int, what: str) -> Array:
    """Parameters as (bodies, 10), checked."""
    parameters = np.asarray(parameters, dtype=float)
    if parameters.shape != (10 * bodies,):
        raise ValueError(f"{what} has shape {parameters.shape}; expected ({10 * bodies},), ten a body")
    if not np.isfinite(parameters).all():
        first = int(np.argmin(np.isfinite(parameters)))
        raise ValueError(f"{what}[{first}], of body {first // 10 + 1}, is {parameters[first]}; expected a number")
    return parameters.reshape(bodies, 10)
