"""Torques of one joint in another unit or with a wrong motor constant, told by the links that several joints carry."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.identify.torque_sensors import MOTOR_GAIN

GRID = (*np.geomspace(1 / 40, 40, 15), 1e3, 1e-3, 130.0, 1 / 130)
SMALL = 0.7, 1.4  # gains that a search finds without another unit
FEWEST_SHARED = 2  # joints: one alone has nothing that fixes its scale


def torque_gains(look: Look) -> Iterator[Hypothesis]:
    """The logged torque of one joint is so many times the true one."""
    joints = look.sample.joints
    for k, joint in enumerate(joints if len(joints) >= FEWEST_SHARED else ()):
        reading = partial(_scaled, look.reading, k)
        for gain in (float(g) for g in GRID if abs(np.log(g)) > 0.05):
            unit = not MOTOR_GAIN[0] < gain < MOTOR_GAIN[1]
            if unit:
                cure = "another unit, amperes, or the motor's side of the gear. Bring it to N m on the joint side."
            else:
                cure = "check its motor constant and gear ratio, or let torque_gain be identified."
            text = f"The torque of {joint} is <factor> times what the other joints' torques ask for: {cure}"
            kind, bounds = "unit" if unit else "torque_gain", (gain / 1.8, gain * 1.8)
            yield Hypothesis(kind, "torque", (joint,), text, reading, gain, bounds, usable=not unit)


def small_gain(look: Look, joint: str) -> Hypothesis:
    """The same of a gain that is a little off: no fault, but what another one must explain more than."""
    reading = partial(_scaled, look.reading, look.sample.joints.index(joint))
    return Hypothesis("torque_gain", "torque", (joint,), "", reading, 1.0, SMALL)


def _scaled(reading: Reading, joint: int, factor: float) -> Reading:
    return reading.changed("torque_scale", (joint,), lambda x: x / factor)
