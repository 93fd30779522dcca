"""Work on a long signal piece by piece."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_ONCE = 50_000  # samples; a signal that is longer is a long one


def in_pieces(work: Callable[[Array], Array], x: Array, beside: int, at_once: int = AT_ONCE) -> Array:
    """What `work` makes of a long signal, worked out piece by piece, for all at once would take room.

    Parameters
    ----------
    work : callable, (M, ...) -> (M, ...)
        One row a sample, which no sample farther than `beside` has a part in.
    x : (N, ...) samples.
    beside : samples on either side that a piece sees more than it gives.
    at_once : samples of a piece.
    """
    if len(x) <= at_once + beside:
        return work(x)
    out = np.empty(0)
    for begin in range(0, len(x), at_once):
        first, end = max(0, begin - beside), begin + at_once
        part = work(x[first : end + beside])[begin - first : end - first]
        if begin == 0:
            out = np.empty((len(x), *part.shape[1:]))
        out[begin:end] = part
    return out
