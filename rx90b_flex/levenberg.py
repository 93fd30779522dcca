"""Levenberg and Marquardt's descent, of all fits that SciPy's does not serve.

SciPy's takes residuals and Jacobian. These fits have normal equations instead (of logs of any length, or with coefficients projected
out), weights that follow from where they stand, or steps that end at a bound.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST, MOST = 1e-10, 1e7  # damping
# Length of a parameter's column over the longest one's below which there is nothing but rounding in it.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Damping:
    """Of the first step, over each parameter's own curvature, and its factors after a step that does not help and one that does."""

    begin: float = 1e-3
    rise: float = 8.0
    fall: float = 8.0


class Iterate(ABC):
    """Where a descent stands."""

    @property
    @abstractmethod
    def goal(self) -> float:
        """What is to become smaller: a sum of squares, or nearly one."""

    @property
    @abstractmethod
    def enough(self) -> float:
        """A gain that is worth no further step; below zero where weights are on their way: then none is the last."""

    @abstractmethod
    def equations(self) -> tuple[Array, Array]:
        """``J^T J``, (s, s), and ``-J^T r``, (s,): half of how the goal bends, and of how it falls."""

    @abstractmethod
    def moved(self, step: Array) -> Self:
        """After a step (s,), or what there is room for of it."""

    def renewed(self) -> Self:
        """The same place with weights that follow from it."""
        return self


USUAL = Damping()
SURELY = 10.0  # times what a step is from one that lost, it would have to change of that for it to be worth a try
Place = TypeVar("Place", bound=Iterate)


def descent(at: Place, evaluations: int, damping: Damping = USUAL, patience: int = 1) -> Iterator[Place]:
    """The places on the way down, from where it begins to where no step helps, or so many in a row were worth too little."""
    at, now, idle = at.renewed(), damping.begin, 0
    yield at
    while evaluations > 0 and idle < patience and np.isfinite(at.goal):  # from no number there is no way down
        curvature, fall = at.equations()
        better, enough = at, at.enough
        failed: tuple[Array, float] | None = None  # the latest step that did not help, and what it lost
        while evaluations > 0 and now < MOST:
            step = damped_step(curvature, fall, now)
            evaluations -= 1
            if failed is None or not _as_bad(step, *failed, curvature, fall):
                other = at.moved(step)
                if other.goal < at.goal:
                    better = other
                    break
                failed = step, other.goal - at.goal
            if enough < 0.0 or step @ (2.0 * fall - curvature @ step) <= enough:  # no other try is worth while
                break
            now *= damping.rise
        if better is at and enough >= 0.0:
            break
        idle = idle + 1 if at.goal - better.goal <= better.enough else 0
        now = damping.begin if better is at else max(now / damping.fall, LEAST)
        at = better.renewed()
        yield at


def _as_bad(step: Array, other: Array, lost: float, curvature: Array, fall: Array) -> bool:
    """Whether a step is so near to another one, which lost something, that it cannot but lose too: it need not be tried."""
    apart = step - other
    part = np.sqrt(max(float(apart @ curvature @ apart), 0.0) / max(float(other @ curvature @ other), 1e-300))
    missed = lost + float(other @ (2.0 * fall - curvature @ other))  # what its gain was to be, too
    return bool(SURELY * part * missed < lost)


def damped_step(curvature: Array, fall: Array, damping: float) -> Array:
    """Marquardt's step, shape (s,), of normal equations (s, s) and (s,); a parameter that the data does not tell stays."""
    size = np.sqrt(np.maximum(np.diag(curvature), 0.0))
    scale = np.where(size > ROUNDING * size.max(initial=0.0), size, np.inf)
    normal = curvature / np.outer(scale, scale) + damping * np.eye(len(scale))
    return np.asarray(np.linalg.solve(normal, fall / scale) / scale)


def lowest(at: Place, evaluations: int, damping: Damping = USUAL, patience: int = 1) -> Place:
    """Where a descent ends."""
    *_, last = descent(at, evaluations, damping, patience)
    return last
