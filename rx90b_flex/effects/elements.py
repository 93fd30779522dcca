"""Effects that are one mechanical element as a whole, as a compiled simulation and other simulators have it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array


@dataclass(frozen=True, eq=False)
class PointMass:
    """A point mass (kg) on a frame, its centre (3,) in the frame's coordinates, m."""

    frame: str
    mass: float
    centre: Array


def unit_body(centre: Array) -> Array:
    """Ten inertial parameters of a point mass of 1 kg, (10,): m, s, J xx yy zz xy xz yz, in the axes of its centre (3,), m."""
    moments = centre @ centre * np.eye(3) - np.outer(centre, centre)
    return np.r_[1.0, centre, moments[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]]


@dataclass(frozen=True, eq=False)
class GravityChange:
    """What is added to the direction of gravity on the links and what they carry, (3,), in parts of its size."""

    direction: Array


@dataclass(frozen=True, eq=False)
class AnchoredSpring:
    """A spring between a point of the link before a joint and one of the link behind it.

    Attributes
    ----------
    fixed, moving : array, shape (3,)
        Its ends, both in the joint's own frame at zero angle, m.
    stiffness : float, N/m
    prestress : float
        Its pull at zero angle, N.
    """

    fixed: Array
    moving: Array
    stiffness: float
    prestress: float


Element = PointMass | GravityChange | AnchoredSpring
