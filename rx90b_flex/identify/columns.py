"""Columns of a regression, each joint's rows apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array, Indices


@dataclass(frozen=True, eq=False)
class ColumnsByJoint:
    """Columns, each joint's rows apart and only those that touch them.

    Attributes
    ----------
    places : tuple of array of int
        For each joint, which columns these are among all.
    columns : tuple of array, shape (N, m)
    """

    places: tuple[Indices, ...]
    columns: tuple[Array, ...]

    @staticmethod
    def of(parts: Iterable[tuple[Indices, Indices, Array]], joints: int, samples: int) -> ColumnsByJoint:
        """From parts of (their places (k,), joints (r,), columns (samples, r, k))."""
        places: list[list[Indices]] = [[np.zeros(0, dtype=np.intp)] for _ in range(joints)]
        columns: list[list[Array]] = [[np.zeros((samples, 0))] for _ in range(joints)]
        for at, rows, part in parts:
            for i, j in enumerate(rows):
                places[j].append(at)
                columns[j].append(part[:, i])
        stacked = (np.concatenate(x, axis=1) for x in columns)
        return ColumnsByJoint(tuple(np.concatenate(x) for x in places), tuple(stacked))

    @staticmethod
    def of_dense(places: Indices, columns: Array) -> ColumnsByJoint:
        """From columns (N, joints, k) that stand in `places` (k,), without what is zero."""
        touched = columns.any(axis=0)
        pairs = [(places[t], np.ascontiguousarray(columns[:, j, t])) for j, t in enumerate(np.atleast_2d(touched))]
        return ColumnsByJoint(tuple(at for at, _ in pairs), tuple(x for _, x in pairs))

    def beside(self, other: ColumnsByJoint) -> ColumnsByJoint:
        """These columns and others."""
        pairs = zip(self.columns, other.columns, strict=True)
        return ColumnsByJoint(
            tuple(np.concatenate(x) for x in zip(self.places, other.places, strict=True)),
            tuple(np.concatenate(x, axis=1) for x in pairs),
        )

    @cached_property
    def grams(self) -> tuple[Array, ...]:
        """Products with themselves, for each joint (m, m)."""
        return tuple(x.T @ x for x in self.columns)

    def summed(self, count: int) -> Array:
        """All in one array (N, joints, count), those of one place added."""
        out = np.zeros((len(self.columns[0]), len(self.columns), count))
        for j, (places, columns) in enumerate(zip(self.places, self.columns, strict=True)):
            for place, column in zip(places, columns.T, strict=True):
                out[:, j, place] += column
        return out
