"""What a measured response of drives cannot be: faults of columns that no model of a flexible robot should be fitted to."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.robot import Robot

LOW_HZ, FEWEST = 30.0, 8  # up to where responses are looked at, and so many lines at the least
LATE = 0.1  # of the period of the highest of these lines: so much later or sooner torques may be logged
SURE = 2.0  # standard deviations
MANY, NEXT_TO_NONE = 0.3, 0.02  # of the lines
LOWEST_HZ = 4.0  # below where arms resonate
TOO_LIGHT = 10.0  # times a drive may move more than its links without drives would


def check_response(measured: FrequencyResponse, robot: Robot) -> None:
    """Whether each drive's own response is one of a passive robot, and no lighter than its links.

    A drive's velocity over its own torque has a phase between -90 and 90 degrees at all lines, whatever bends behind it, but for
    what torques are logged too late. At the lowest lines the robot moves as if it were rigid.

    Raises
    ------
    ValueError
        A drive that moves against its torque, or whose angles are in degrees.
    """
    wrong = [j for i, j in enumerate(measured.joints) if _moves_against(measured, i)]
    if wrong:
        raise ValueError(
            f"{', '.join(wrong)}: the drive moves against its torque, as no robot does: its torque or its angle has the other sign"
        )
    light = [j for j, times in zip(measured.joints, _lighter(measured, robot), strict=True) if times > TOO_LIGHT]
    if light:
        raise ValueError(
            f"{', '.join(light)}: the drive moves more than {TOO_LIGHT:g} times as far as its torque moves its links alone: its "
            "angles look like degrees (rad are expected), or its torque is in another unit than N m"
        )


def _moves_against(measured: FrequencyResponse, joint: int) -> bool:
    """Whether a drive's mobility is that of a passive one with the other sign, and not its own, for any small delay."""
    low = measured.hz <= max(LOW_HZ, measured.hz[min(FEWEST, len(measured.hz)) - 1])
    omega = 2 * np.pi * measured.hz[low]
    mobility = measured.value[low, joint, joint] / (1j * omega)
    noise = SURE * measured.std()[low, joint, joint] / omega
    late = np.linspace(-LATE, LATE, 41) / measured.hz[low][-1]
    turned = (mobility * np.exp(1j * np.outer(late, omega))).real
    against, along = ((sign * turned < -noise).mean(axis=1).min() for sign in (1.0, -1.0))
    return bool(against > MANY and along < NEXT_TO_NONE)


def _lighter(measured: FrequencyResponse, robot: Robot) -> Array:
    """How far each drive moves at the lowest lines, over how far its links alone would; shape (n,)."""
    tree = robot.tree
    mass = pin.crba(tree, tree.createData(), np.asarray(measured.pose, dtype=float))
    mass = np.triu(mass) + np.triu(mass, 1).T
    at = [robot.joints.index(j) for j in measured.joints]
    alone = np.diag(np.linalg.inv(mass[np.ix_(at, at)]))
    own = np.abs(np.diagonal(measured.value[measured.hz <= LOWEST_HZ], axis1=1, axis2=2))
    if not len(own):
        return np.zeros(len(at))
    return np.asarray(np.median(own, axis=0) / alone)
