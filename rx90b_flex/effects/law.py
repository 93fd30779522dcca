"""Scalar laws: effects in the form that a compiled simulation reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rx90b_flex.effects.motion import Array

LawFunction = Callable[[float, float, Any, Any], None]


@dataclass(frozen=True, eq=False)
class Law:
    """A torque that depends on one combination of the coordinates, ``x = port @ q``, and acts on it alike.

    ``torque = inertia * x'' + damping * x' + stiffness * x + function``, and ``port * torque`` is the generalised
    force.

    Attributes
    ----------
    port : array, shape (n,)
    inertia, damping, stiffness : float
        The linear part.
    function : callable or None
        ``function(x, rate, parameters, out)`` writes torque, slope by x and slope by rate to ``out[0:3]``. Plain
        arithmetic and functions of NumPy that take numbers and arrays alike, without branches and without calls to other
        functions: the simulation compiles it for numbers, `LawEffect` asks it for columns.
    parameters : array
        What the function reads.
    stores : bool
        Whether the function's torque is the gradient of the effect's `potential`; otherwise it dissipates.
    """

    port: Array
    inertia: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    function: LawFunction | None = None
    parameters: Array = field(default_factory=lambda: np.zeros(0))
    stores: bool = False


def constant(x: float, rate: float, parameters: Any, out: Any) -> None:
    """The law of a constant torque, ``parameters[0]``."""
    out[0] = parameters[0]
    out[1] = 0.0
    out[2] = 0.0
