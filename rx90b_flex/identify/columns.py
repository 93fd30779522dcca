"""Columns of a regression, each joint's rows apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.robot import LINK_UNITS

DIGITS = 1.0e-5  # of the longest column of the same unit: what is shorter comes from the digits of the tree's angles


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
    def of_dense(places: Indices, rows: Iterable[Array]) -> ColumnsByJoint:
        """From each joint's columns (N, k) that stand in `places` (k,), without what is zero."""
        pairs = []
        for columns in rows:
            touched = columns.any(axis=0)
            pairs.append((places[touched], np.ascontiguousarray(columns[:, touched])))
            del columns  # of a long log, before the next one's are made
        return ColumnsByJoint(tuple(at for at, _ in pairs), tuple(x for _, x in pairs))

    def beside(self, *others: ColumnsByJoint) -> ColumnsByJoint:
        """These columns and others."""
        every = (self, *others)
        return ColumnsByJoint(
            tuple(np.concatenate(x) for x in zip(*(c.places for c in every), strict=True)),
            tuple(np.concatenate(x, axis=1) for x in zip(*(c.columns for c in every), strict=True)),
        )

    @cached_property
    def grams(self) -> tuple[Array, ...]:
        """Products with themselves, for each joint (m, m)."""
        return tuple(x.T @ x for x in self.columns)

    def merged(self) -> ColumnsByJoint:
        """With those of one place added."""
        pairs = []
        for places, columns in zip(self.places, self.columns, strict=True):
            own, at = np.unique(places, return_inverse=True)
            if len(own) == len(places):
                pairs.append((places, columns))
                continue
            out = np.zeros((len(columns), len(own)))
            for to, column in zip(at, columns.T, strict=True):
                out[:, to] += column
            pairs.append((own, out))
        return ColumnsByJoint(tuple(at for at, _ in pairs), tuple(x for _, x in pairs))

    def shifted(self, by: int) -> ColumnsByJoint:
        """In places so much further on."""
        return ColumnsByJoint(tuple(at + by for at in self.places), self.columns)

    def kept(self, which: Indices, count: int) -> ColumnsByJoint:
        """Those in some of `count` places, in the order of these."""
        order = np.full(count, -1)
        order[which] = np.arange(len(which))
        found = [order[at] for at in self.places]
        return ColumnsByJoint(
            tuple(at[at >= 0] for at in found),
            tuple(x if (at >= 0).all() else x[:, at >= 0] for at, x in zip(found, self.columns, strict=True)),
        )

    def at(self, samples: Indices) -> ColumnsByJoint:
        """At some of the samples."""
        return ColumnsByJoint(self.places, tuple(x[samples] for x in self.columns))

    def times(self, values: Array) -> Array:
        """With coefficients (count,) or (count, k); shape (joints, N) or (joints, N, k)."""
        return np.stack([x @ values[at] for at, x in zip(self.places, self.columns, strict=True)])

    def gram(self, weight: Array, count: int) -> Array:
        """Products with themselves, one weight a joint, (count, count); for columns of which each has its own place."""
        out = np.zeros((count, count))
        for w, at, own in zip(weight, self.places, self.grams, strict=True):
            out[np.ix_(at, at)] += w * own
        return out

    def dense(self, count: int) -> Array:
        """All in one array (N, joints, count); for columns of which each has its own place."""
        out = np.zeros((len(self.columns[0]), len(self.columns), count))
        for j, (at, x) in enumerate(zip(self.places, self.columns, strict=True)):
            out[:, j, at] = x
        return out


def beyond_digits(lengths: Array) -> Mask:
    """Which of the links' columns, of these lengths (10 * bodies,), are more than the digits of the tree's angles, or zero.

    A tree that writes a quarter turn as 1.5708 tilts its axes by 4e-6: a first moment that gravity should not turn then has a column,
    to which a fit would give millions of kg m.
    """
    kinds = np.array(LINK_UNITS * (len(lengths) // len(LINK_UNITS)))
    longest = {unit: lengths[kinds == unit].max() for unit in LINK_UNITS}
    return np.asarray((lengths == 0.0) | (lengths > DIGITS * np.array([longest[unit] for unit in kinds])))
