"""How near a fit keeps links to the values of the tree, as far as parts of the log that are left out like it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.identify.normal_equations import NormalEquations, squares_held_out

KNOWN = 0.3  # of a body's mass, to which the tree's values are known at strength one; lengths by its radius of gyration
SMALLEST_M = 0.03  # of such a radius
# Strengths that are tried: from next to nothing to masses that are known to 0.3 %.
STRENGTHS = (0.0, *np.geomspace(1e-2, 1e4, 13))
AS_GOOD = 1.01  # times the least squares held out, within which less strength is as good
SHOWN = 0.5  # of its deviation before the data, below which a parameter's value is the data's and not the tree's


def deviations(links: Array) -> Array:
    """Of links' parameters before the data, at strength one, (10 * bodies,); infinite for bodies without a mass.

    Parameters
    ----------
    links : array, shape (10 * bodies,)
        The tree's: mass, first moments, inertias about the body's origin; kg, kg m, kg m^2.
    """
    bodies = links.reshape(-1, 10)
    mass, trace = bodies[:, 0], bodies[:, 4:7].sum(axis=1)
    solid = mass > 0.0
    square = np.where(solid, np.maximum(trace, 0.0) / (2.0 * np.where(solid, mass, 1.0)), 0.0)
    radius = np.maximum(np.sqrt(square), SMALLEST_M)
    each = np.stack([np.ones_like(radius), *[radius] * 3, *[radius**2] * 6], axis=1)
    return np.asarray(np.where(solid, KNOWN * mass, np.inf)[:, None] * each).ravel()


def precision(links: Array, strength: float) -> Array:
    """Inverse variances (10 * bodies,) about the tree's values."""
    return np.asarray(strength * deviations(links) ** -2.0)


def chosen(
    normal: NormalEquations, parts: Sequence[Indices], sigma: Array, before: Array, links: Array
) -> tuple[float, float]:
    """The strength that predicts best what is left out, the least of those that do as well, and its error over that of none.

    Parameters
    ----------
    normal : NormalEquations
        By block, of the torque about the tree's values.
    parts : sequence of arrays of int
        Blocks that are left out together.
    sigma : array, shape (joints,)
    before : array, shape (p, p)
        Penalties of what is no link's.
    links : array, shape (10 * bodies,)
        The tree's, whose places are the first.
    """
    grouped, own, none = normal.grouped(parts), np.diag_indices(len(links)), np.zeros(len(before))
    left = []
    for strength in STRENGTHS:
        whole = before.copy()
        whole[own] = precision(links, strength)
        left.append(squares_held_out(grouped, none, sigma, whole, none))
    squares = np.array(left)
    best = int(np.flatnonzero(squares <= AS_GOOD * squares.min())[0])
    return float(STRENGTHS[best]), float(np.sqrt(squares[best] / squares[0]))
