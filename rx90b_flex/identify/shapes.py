"""The shape parameters of a list of effects, those that several effects share taken once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects import Effect, Motion
from rx90b_flex.effects.effect import shared_shapes
from rx90b_flex.effects.motion import Array, Indices, Mask

FARTHEST = 1.0  # step of a fit in a shape parameter's logarithm at the most
USUAL = 0.4  # standard deviation of the logarithm of a shape that is held at what is usual: two of them from 0.45 to 2.2 times it
AT_BOUND = 1.0e-3  # distance from an end of its range, in logarithms, within which a shape lies at that end


@dataclass(frozen=True, eq=False)
class Shapes:
    """Where the shape parameters of effects stand in one vector, and between which values a log can tell them.

    A fit works on logarithms of those that are positive, for their ranges span decades.

    Attributes
    ----------
    places : tuple of array of int
        For each effect, where its shape parameters stand.
    keys : tuple of (tuple of str or None)
        Name of the value that effects share, one a place.
    low, high : array, shape (s,)
    held : array of bool, shape (s,)
        Which a fit leaves as they are.
    """

    places: tuple[Indices, ...]
    keys: tuple[tuple[str, ...] | None, ...]
    low: Array
    high: Array
    held: Mask

    @staticmethod
    def of(effects: Sequence[Effect], motion: Motion) -> Shapes:
        """Of effects that act on a motion."""
        places, keys = [], []
        low: list[float] = []
        high: list[float] = []
        held: list[bool] = []
        for effect in effects:
            ends = effect.shape_range_beside(motion, effects)
            here = []
            own = effect.shape_parameters.values()
            for key, p, a, b in zip(shared_shapes(effect), own, *ends, strict=True):
                if key is None or key not in keys:
                    keys.append(key)
                    low.append(float(a))
                    high.append(float(b))
                    held.append(p.held)
                    here.append(len(keys) - 1)
                else:
                    here.append(keys.index(key))
            places.append(np.array(here, dtype=np.intp))
        return Shapes(tuple(places), tuple(keys), np.array(low), np.array(high), np.array(held, dtype=bool))

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def positive(self) -> Mask:
        """Which are fitted by their logarithm, shape (s,), bool."""
        return self.low > 0

    def values(self, effects: Sequence[Effect]) -> Array:
        """Present values, shape (s,)."""
        out = np.full(len(self), np.nan)
        for effect, at in zip(effects, self.places, strict=True):
            out[at] = effect.shape
        return np.clip(out, self.low, self.high)

    def put(self, effects: Sequence[Effect], values: Array) -> tuple[Effect, ...]:
        """The effects with these values (s,)."""
        pairs = zip(effects, self.places, strict=True)
        return tuple(e.with_shape(values[at]) if len(at) else e for e, at in pairs)

    def moved(self, values: Array, step: Array) -> Array:
        """Values (s,) after a step in fitted coordinates, within the range."""
        step = np.clip(step, -FARTHEST, FARTHEST)
        out = np.where(self.positive, values * np.exp(np.where(self.positive, step, 0.0)), values + step)
        return np.clip(out, self.low, self.high)

    def per_step(self, values: Array) -> Array:
        """Change of the values per step in fitted coordinates, shape (s,)."""
        return np.where(self.positive, values, 1.0)

    def precision(self, values: Array) -> Array:
        """What is known of them before the data, inverse variances, shape (s,)."""
        return np.where(self.held, (USUAL * self.per_step(values)) ** -2.0, 0.0)

    def at_bound(self, values: Array) -> Mask:
        """Which lie at an end of their range, shape (s,), bool."""
        near = AT_BOUND * np.where(self.positive, np.abs(values), self.high - self.low)
        return np.asarray((values <= self.low + near) | (values >= self.high - near))
