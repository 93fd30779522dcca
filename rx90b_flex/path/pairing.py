"""Which place of a path belongs to each measured place that has no time.

The nearest one; where a path crosses itself or comes near itself, the one that follows from the order of the places: along the path
or against it, from any start, on a closed path past its beginning. Places in no such order get the nearest one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from rx90b_flex.effects.motion import Array

Indices = NDArray[np.int64]

WINDOW = 0.005  # m, and three times the step (the usual one at least): how far ahead on the path the next place may be
SLACK = WINDOW / 3.0  # m: how far from its place in the order the nearest one is looked for
COARSE, PLACES = 2000, 1000  # of the path and of the measurement, for the look along the whole order
STRIDE = 0.002  # m: shorter moves do not count as such, they may be noise
DISORDER = 2.0  # times the path's length that places move from one to the next, above which they are in no order
CLEAR = 0.001  # m, and twice the usual distance: farther than the nearest place by more than that is a wrong pair
FEW = 0.02  # part of the pairs that may be wrong


def nearest_on_path(path: Array, place: Array) -> Indices:
    """Which point of a path (G, 3), evenly spaced, belongs to each place (N, 3); shape (N,)."""
    nearest, plain = cKDTree(path).query(place)
    if _travelled(place, path) > DISORDER * _length(path):
        return np.asarray(plain, dtype=np.int64)
    closed = bool(np.linalg.norm(path[-1] - path[0]) < CLEAR)
    for around in (False, True) if closed else (False,):
        for way in (1, -1):
            found = in_order(path, place[::way], around)[::way]
            farther = np.linalg.norm(path[found] - place, axis=1) - nearest
            if np.mean(farther > CLEAR + 2.0 * np.median(nearest)) <= FEW:
                return found
    return np.asarray(plain, dtype=np.int64)


def in_order(path: Array, place: Array, around: bool = False) -> Indices:
    """The same for places that run along the path, which may pass the beginning of a closed one (`around`).

    Of all orders that never turn back, the one with the least sum of distances; then the nearest point about each of its places.
    """
    last = len(path) - 1
    coarse = np.unique(np.linspace(0, last, COARSE).round().astype(np.int64))
    if around:
        coarse = np.r_[coarse[:-1], last + coarse]
    few = np.unique(np.linspace(0, len(place) - 1, min(PLACES, len(place))).round().astype(np.int64))
    spacing = _length(path) / last
    ordered = coarse[_least(path[coarse % last if around else coarse], place[few], spacing * float(coarse[1]))]
    every = np.arange(len(place))
    after = np.searchsorted(few, every)
    slack = int(np.ceil(max(SLACK / spacing, 2.0 * coarse[1])))
    low, high = ordered[np.where(few[after] == every, after, after - 1)] - slack, ordered[after] + slack
    found = np.empty(len(place), dtype=np.int64)
    for k, (a, b) in enumerate(zip(low, high, strict=True)):
        about = np.arange(a, b + 1) % last if around else np.arange(max(a, 0), min(b, last) + 1)
        found[k] = about[np.argmin(np.sum((path[about] - place[k]) ** 2, axis=1))]
    return found


def _least(path: Array, place: Array, spacing: float) -> Indices:
    """Points of a path in growing order, no farther apart than the places allow, with the least sum of distances."""
    off = cdist(place, path)
    step = np.linalg.norm(np.diff(place, axis=0), axis=1)
    # about a sharp turn the next place is near but far along the path
    step = np.maximum(step, np.median(step))
    reach = np.minimum(np.ceil((WINDOW + 3.0 * step) / spacing), len(path) - 1).astype(int)
    for k, ahead in enumerate(reach):
        # of the points from that far behind to this one
        off[k + 1] += minimum_filter1d(off[k], ahead + 1, origin=ahead // 2, mode="constant", cval=np.inf)
    found = np.empty(len(place), dtype=np.int64)
    found[-1] = np.argmin(off[-1])
    for k in range(len(place) - 2, -1, -1):
        begin = max(int(found[k + 1]) - int(reach[k]), 0)
        found[k] = begin + np.argmin(off[k, begin : found[k + 1] + 1])
    return found


def _travelled(place: Array, path: Array) -> float:
    """Way from place to place, moves that are shorter than `STRIDE` left out, m."""
    stride = min(STRIDE, 0.02 * _length(path))
    here, way = place[0], 0.0
    for p in place[1:]:
        step = float(np.linalg.norm(p - here))
        if step > stride:
            here, way = p, way + step
    return way


def _length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def unmeasured(distance: Array, length: float) -> list[tuple[float, float]]:
    """Stretches of a path without a place: far longer than the others between neighbours, at the ends, too.

    Parameters
    ----------
    distance : array, shape (N,)
        Of the places along the path; in any order and unit.
    length : float
        Of the path, in the same unit.
    """
    inner = np.diff(np.sort(distance))
    usual = float(np.quantile(inner[inner > 0.0], 0.9, method="lower")) if (inner > 0.0).any() else 0.0
    edges = np.r_[0.0, np.sort(distance), length]
    wide = np.flatnonzero(np.diff(edges) > max(3.0 * usual, 0.02 * length))
    return [(float(edges[k]), float(edges[k + 1])) for k in wide]
