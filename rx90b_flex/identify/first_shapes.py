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
AS_GOOD = 0.05  # of a joint's error, by which a smaller shape may leave more and yet be the one to begin with


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
    """A fit with those shapes that effects share, from where they are upwards, with which their joint leaves little: the smallest.

    From a start far off the error hardly bends: where a log resolves a turn-over that is a thousandth of the true one, steps end
    where they begin.
    """
    shapes = fit.shapes
    places = [i for i, key in enumerate(shapes.keys) if key in names]
    rows = [fit.regression.joints.index(shapes.keys[i][0]) for i in places]  # type: ignore[index]
    tried, left = [fit.shape], [fit.solution.sigma[rows]]
    while True:
        further = tried[-1].copy()
        further[places] *= np.where(TRIED_APART * further[places] < shapes.high[places], TRIED_APART, 1.0)
        if (further == tried[-1]).all():
            break
        tried.append(further)
        left.append(fit.with_shape(further).solution.sigma[rows])
    least = np.log(np.maximum(left, 1e-300))
    chosen = (least <= least.min(axis=0) + AS_GOOD).argmax(axis=0)
    best = fit.shape.copy()
    best[places] = np.array(tried)[chosen, places]
    return fit if (best == fit.shape).all() else fit.with_shape(best)
