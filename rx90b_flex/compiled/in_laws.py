"""What laws of effects have in common: called by compiled laws on numbers, and by Python on arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable


@register_jitable  # type: ignore[untyped-decorator, unused-ignore]
def turned_over(x: Any, before: Any, part: Any, deflection: Any) -> Any:
    """Sign of a friction that turns over along a deflection, as Dahl's: at x, rad, where it was `part` at `before`."""
    direction = np.sign(x - before)
    return direction - (direction - part) * np.exp(-np.abs(x - before) / deflection)


@register_jitable  # type: ignore[untyped-decorator, unused-ignore]
def turning(part: Any, rate: Any, deflection: Any) -> Any:
    """Derivative of such a sign by x, 1/rad."""
    return (1.0 - part * np.sign(rate)) / deflection


@register_jitable  # type: ignore[untyped-decorator, unused-ignore]
def put_friction_of_load(coefficient: Any, load: Any, part: Any, rate: Any, deflection: Any, out: Any) -> None:
    """Into `out`: friction by the load's size with such a sign, its slopes by x, rate and load, and the sign to remember."""
    size = coefficient * np.abs(load)
    out[0] = size * part
    out[1] = size * turning(part, rate, deflection)
    out[2] = 0.0
    out[3] = coefficient * np.sign(load) * part
    out[4] = part
