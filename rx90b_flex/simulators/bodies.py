"""Bodies as simulators take them: mass, centre, principal moments that a distribution of mass has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90b_flex.bodies import moments_about_centre
from rx90b_flex.effects.motion import Array
from rx90b_flex.simulators.held import Lost

SMALLEST_MASS = 1e-12  # kg, and kg m^2: of a body without any, for simulators divide by it
ROOM = 1e-11  # of the second moments, so that rounding does not take a thin rod for a body that cannot be
TOLD = 1e-9  # relative change of the moments that is worth a line


@dataclass(frozen=True)
class Body:
    """A body as a simulator takes it.

    Attributes
    ----------
    mass : float
        kg.
    centre : array, shape (3,)
        In the frame of its joint, m.
    moments : array, shape (3, 3)
        About the centre, kg m^2.
    """

    mass: float
    centre: Array
    moments: Array

    def principal(self) -> tuple[Array, Array]:
        """Principal moments (3,), and their axes as the columns of a rotation (3, 3)."""
        moments, axes = np.linalg.eigh(self.moments)
        if np.linalg.det(axes) < 0:
            axes[:, 2] = -axes[:, 2]
        return moments, axes


def possible_body(robot: str, link: str, parameters: Array) -> tuple[Body, Lost | None]:
    """The nearest body that simulators take, with the same mass and the same centre: gravity stays what it is.

    Second moments about the centre, ``tr(J) / 2 - J``, are raised to zero where they are below (P. M. Wensing, S. Kim, J.-J. E.
    Slotine, IEEE Robotics and Automation Letters 3(1), 2018: no distribution of mass has others).

    Parameters
    ----------
    robot, link : str
    parameters : array, shape (10,)
        About the link's joint, in the order of `rx90b_flex.robot.LINK_PARAMETERS`.

    Returns
    -------
    body : Body
    lost : Lost or None
        What was changed, where it was more than rounding.

    Raises
    ------
    ValueError
        No or a negative mass and yet a first moment: no body has that.
    """
    mass = float(parameters[0])
    if mass < 0 or (mass == 0 and parameters[1:4].any()):
        raise ValueError(f"{robot}: {link}: the mass is {mass:.4g} kg; expected one that a body has")
    centre, moments = moments_about_centre(parameters if mass else np.r_[1.0, parameters[1:]])
    second, axes = np.linalg.eigh(0.5 * np.trace(moments) * np.eye(3) - moments)
    raised = np.maximum(second, ROOM * np.abs(second).sum() + SMALLEST_MASS)
    squares = (axes * raised) @ axes.T
    changed = np.trace(squares) * np.eye(3) - squares
    body = Body(max(mass, SMALLEST_MASS), centre, 0.5 * (changed + changed.T))
    off = float(np.abs(body.moments - moments).max())
    if off <= max(TOLD * np.abs(moments).max(), 10 * SMALLEST_MASS):
        return body, None
    largest = float(np.linalg.eigvalsh(moments)[-1])
    why = (
        f"no body has its moments of inertia, and simulators refuse it: changed by up to {off:.3g} kg m^2 (the largest is "
        f"{largest:.3g}); mass and centre are kept"
    )
    return body, Lost(link, why)
