"""Columns of many effects behind the low-pass in one go, as many as memory bears."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rx90b_flex.effects.motion import Array, Indices

if TYPE_CHECKING:
    from rx90b_flex.identify.segment import Segment

FILTERED_BYTES = 2e7  # of columns that go through a filter at once, where that is more


@dataclass(frozen=True, eq=False)
class Unfiltered:
    """Columns at the working rate: in each of `rows` the basis (N_working, k) times its weight, or (N_working, rows, k) as it is."""

    rows: Indices
    weight: Array | None
    basis: Array

    @property
    def width(self) -> int:
        """Columns that go through a filter."""
        return self.basis.size // len(self.basis)


def at_once(segment: Segment, width: int) -> int:
    """How many times so many columns memory bears at once behind the low-pass of a segment."""
    return max(1, int(FILTERED_BYTES / (8 * len(segment.motion) * width)))


def through(segment: Segment, columns: Iterable[Unfiltered]) -> list[tuple[Indices, Array]]:
    """Columns behind the low-pass at the fit's samples, many together, as many as memory bears: joints, and (N, rows, k) each."""
    most = at_once(segment, 1)
    out: list[tuple[Indices, Array]] = []
    group: list[Unfiltered] = []
    for c in columns:
        if group and sum(x.width for x in group) + c.width > most:
            out += _brought_together(segment, group)
            group = []
        group.append(c)
    return [*out, *_brought_together(segment, group)] if group else out


def _brought_together(segment: Segment, group: Sequence[Unfiltered]) -> Iterator[tuple[Indices, Array]]:
    together = segment.brought(np.concatenate([c.basis.reshape(len(c.basis), -1) for c in group], axis=1))
    ends = np.cumsum([c.width for c in group])
    for c, end in zip(group, ends, strict=True):
        x = together[:, end - c.width : end]
        if c.weight is None:
            yield c.rows, x.reshape(len(x), len(c.rows), c.basis.shape[2])
        else:
            yield c.rows, c.weight[None, :, None] * x[:, None, :]
