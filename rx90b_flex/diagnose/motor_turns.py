"""Whether what repeats with a joint's angle repeats with the turns of its motor, where the campaign states the gears."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90b_flex.identify.least_squares import Estimate

MOST = 8  # times a turn of a motor: its poles come more often than its bearings and what its gear has on that side
NEAR = 2.0  # standard deviations of an order from one that is a motor's
BY_CHANCE = 0.05  # of all orders that lie as near to some whole number of turns, at the most, for it to say anything


def turns_of_motor(gear_matrix: Sequence[Sequence[float]] | None, joints: Sequence[str], joint: str) -> float | None:
    """Turns of a motor in one of its joint, of the one motor that turns with that joint alone; None where none is stated."""
    if gear_matrix is None or joint not in joints:
        return None
    gears = np.abs(np.array(gear_matrix, dtype=float))
    own = gears[(gears > 0).sum(axis=1) == 1, joints.index(joint)]
    own = own[own > 0]
    return float(own[0]) if len(own) == 1 and own[0] > 1.0 else None


def turns_words(label: str, joint: str, order: Estimate, ratio: float) -> str:
    """That an effect's order (cycles a joint turn, with its standard deviation) is one of its motor's; empty where it is not."""
    if order.value is None or order.std is None or 2.0 * NEAR * order.std > BY_CHANCE * ratio:
        return ""
    times = round(order.value / ratio)
    if not 1 <= times <= MOST or abs(order.value - times * ratio) > NEAR * order.std:
        return ""
    often = {1: "once", 2: "twice"}.get(times, f"{times} times")
    return (
        f"{label} repeats {often} a turn of {joint}'s motor (order {order.value:.4g} ± {order.std:.2g}, "
        f"gear {ratio:.4g}): most likely what turns with the motor makes it, not the joint's side of the gear."
    )
