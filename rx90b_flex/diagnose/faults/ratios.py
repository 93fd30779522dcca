"""Angles of one joint that were converted with a wrong gear ratio or a wrong number of counts, and its torque with them or not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading

RATIOS = (0.5, 0.7, 0.8, 0.87, 0.93, 0.97, 1.03, 1.08, 1.15, 1.25, 1.4, 2.0)  # a logged angle over the true one
WITHIN = 1.2  # times a first guess
SMALLEST = 0.02  # below it a link a little longer, a tilted base or a torque's law do as well
STILL_FAR = 0.3**2  # squared error of its own torque, above which something else is missing there


def gear_ratios(look: Look) -> Iterator[Hypothesis]:
    """A joint's angle is s times too large and its torque 1/s of the true one: power is the same on both sides of a gear."""
    return iter(_best_of_each(look)[0])


def angle_scales(look: Look) -> Iterator[Hypothesis]:
    """A joint's angle is s times too large, its torque is right."""
    return iter(_best_of_each(look)[1])


def _best_of_each(look: Look) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Of every joint with the factor that fits best, its torque with it and not: neighbours of one joint's true factor would keep out
    the other joints. One motion does for both.
    """
    if look.reading not in look.ratios:
        near = look.fit()
        each = [
            [[_of(look, k, r, torque) for torque in (True, False)] for r in RATIOS]
            for k in range(len(look.sample.joints))
        ]
        scores = [[[look.fit(h.reading, near).score for h in both] for both in of_joint] for of_joint in each]
        best = np.argmin(scores, axis=1)  # (joints, 2)
        chosen = [[of_joint[i][t] for of_joint, i in zip(each, best[:, t], strict=True)] for t in (0, 1)]
        look.ratios[look.reading] = chosen[0], chosen[1]
    return look.ratios[look.reading]


def _of(look: Look, k: int, ratio: float, torque: bool) -> Hypothesis:
    joint = look.sample.joints[k]
    zero = float(look.motors.offset[k]) if look.motors is not None else 0.0  # where a motor counts none

    def reading(factor: float) -> Reading:
        angles = look.reading.changed("scale", (k,), lambda x: x / factor)
        angles = angles.changed("offset", (k,), lambda x: zero + (x - zero) / factor)
        return angles.changed("torque_scale", (k,), lambda x: x * factor) if torque else angles

    text = f"The position of {joint} is <factor> times the true one, "
    if torque:
        text += (
            "and its torque that much too small: both were converted with a wrong gear ratio. Multiply it (the joint's entry in "
            "`gear_matrix`) by that, or divide the position's column by it and multiply the torque's."
        )
    else:
        text += "its torque is not: divide the column by that, or correct the ratio or counts a turn that it was converted with."
    return Hypothesis(
        "unit", "all" if torque else "motor_position", (joint,), text, reading, ratio, (ratio / WITHIN, ratio * WITHIN),
        smallest=SMALLEST, far=STILL_FAR, neutral=1.0, by_links=False,
    )  # fmt: skip
