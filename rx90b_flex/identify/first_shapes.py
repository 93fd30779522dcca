"""Where shape parameters begin that nobody gave a value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.effects.effect import shared_shapes
from rx90b_flex.identify.regression import Regression

if TYPE_CHECKING:
    from rx90b_flex.identify.least_squares import _Fit

TRIED_APART = 10.0  # times the one before, that a shape is which is tried
# largest over smallest value that a log seems to tell: from there on a start may lie where the error does not bend
WIDE = 1e4
MUCH_LESS = 0.7  # of a joint's error at the start


def with_starts(effects: Sequence[Effect], regression: Regression) -> tuple[Effect, ...]:
    """Effects whose shape parameters all have values: their own, those that they share with others, or a start."""
    known = shared_values(effects)
    out = []
    for effect in effects:
        shape = np.array(
            [
                x if key is None else known.get(key, x)
                for key, x in zip(shared_shapes(effect), effect.shape, strict=True)
            ]
        )
        if np.isnan(shape).any():
            starts = effect.shape_search(regression.longest).starts
            shape = np.where(np.isnan(shape), starts[len(starts) // 2], shape)
            known.update((k, x) for k, x in zip(shared_shapes(effect), shape, strict=True) if k is not None)
        out.append(effect.with_shape(shape) if len(shape) else effect)
    return tuple(out)


def shared_values(effects: Sequence[Effect]) -> dict[tuple[str, ...], float]:
    """Values of the shape parameters that effects share, where they are known."""
    pairs = ((key, x) for e in effects for key, x in zip(shared_shapes(e), e.shape, strict=True) if key is not None)
    return {key: float(x) for key, x in pairs if not np.isnan(x)}


def without_value(effects: Sequence[Effect]) -> set[tuple[str, ...]]:
    """Names of the shape parameters that effects share and that have no value."""
    pairs = ((key, x) for e in effects for key, x in zip(shared_shapes(e), e.shape, strict=True) if key is not None)
    return {key for key, x in pairs if np.isnan(x)}


def begun(fit: _Fit, names: set[tuple[str, ...]]) -> _Fit:
    """A fit with those shapes that effects share larger, in tens, where a joint's error is much less then.

    Where a log seems to tell a turn-over that is a thousandth of the true one, for its rests are exact, steps from there end where
    they begin.
    """
    shapes = fit.shapes
    wide = shapes.high > WIDE * np.maximum(shapes.low, 1e-300)
    named = [(i, key[0]) for i, key in enumerate(shapes.keys) if key is not None and key in names and wide[i]]
    open_ = np.array([i for i, _ in named], dtype=np.intp)
    rows = np.array([fit.regression.joints.index(joint) for _, joint in named], dtype=np.intp)
    tried, best = fit.shape.copy(), fit.shape.copy()
    while True:
        room = TRIED_APART * tried[open_] < shapes.high[open_]
        open_, rows = open_[room], rows[room]
        if not len(open_):
            return fit if (best == fit.shape).all() else fit.with_shape(best)
        tried[open_] *= TRIED_APART
        less = fit.with_shape(tried).solution.sigma[rows] < MUCH_LESS * fit.solution.sigma[rows]
        best[open_[less]] = tried[open_[less]]
        open_, rows = open_[~less], rows[~less]
