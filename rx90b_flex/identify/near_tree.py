"""How near a fit keeps links to the values of the tree: as near as blocks of the log like it that are left out."""

from __future__ import annotations

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.normal_equations import NormalEquations, squares_held_out

KNOWN = 0.3  # of a body's mass, to which the tree's values are known at strength one
SMALLEST_M = 0.03  # of a radius of gyration
# Strengths that are tried: from next to nothing to masses that are known to 0.3 %.
STRENGTHS = (0.0, *np.geomspace(1e-2, 1e4, 13))
AS_GOOD = 1.02  # times the least squares held out, within which less strength is as good
SHOWN = 0.5  # of its deviation before the data, below which a parameter's value is the data's and not the tree's


def deviations(links: Array) -> Array:
    """Of links' parameters before the data, at strength one, (10 * bodies,); infinite for bodies without a mass.

    Lengths count by the robot's radius of gyration, and all inertias by the mean body's: drives' rotors, seen through the gears,
    are inertias too, and on wrists larger than the links'.

    Parameters
    ----------
    links : array, shape (10 * bodies,)
        The tree's: mass, first moments, inertias about the body's origin (diagonal first); kg, kg m, kg m^2.
    """
    bodies = links.reshape(-1, 10)
    mass = bodies[:, 0]
    solid = mass > 0.0
    if not solid.any():
        return np.full(len(links), np.inf)
    radius = np.sqrt(max(bodies[solid, 4:7].sum(), 0.0) / (2.0 * mass[solid].sum()))
    radius = max(float(radius), SMALLEST_M)
    each = np.column_stack([mass] + [mass * radius] * 3 + [np.full(len(mass), mass[solid].mean() * radius**2)] * 6)
    return np.asarray(np.where(solid[:, None], KNOWN * each, np.inf)).ravel()


def precision(links: Array, strength: float) -> Array:
    """Inverse variances (10 * bodies,) about the tree's values."""
    return np.asarray(strength * deviations(links) ** -2.0)


def chosen(normal: NormalEquations, sigma: Array, before: Array, links: Array) -> float:
    """The least strength that predicts blocks which are left out as well as any.

    Parameters
    ----------
    normal : NormalEquations
        By block, of the torque about the tree's values.
    sigma : array, shape (joints,)
    before : array, shape (p, p)
        Penalties of what is no link's.
    links : array, shape (10 * bodies,)
        The tree's, whose places are the first.
    """
    own, none = np.diag_indices(len(links)), np.zeros(len(before))
    left = []
    for strength in STRENGTHS:
        whole = before.copy()
        whole[own] = precision(links, strength)
        left.append(squares_held_out(normal, none, sigma, whole, none))
    squares = np.array(left)
    return float(STRENGTHS[np.flatnonzero(squares <= AS_GOOD * squares.min())[0]])


def pulled_to(links: Array, strength: float, size: int) -> Array:
    """What that precision pulls to, (size,): links with a strength to the tree's values, all else to zero."""
    out = np.zeros(size)
    if strength:
        out[: len(links)] = links
    return out
