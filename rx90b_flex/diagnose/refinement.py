"""Shapes of a candidate on their way to its largest gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rx90b_flex.diagnose.base import Base, solve_beside
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.levenberg import Iterate

SETTLED = 1.0e-4  # part of the gain below which another step is not worth while


@dataclass(frozen=True, eq=False)
class LookAtShape:
    """A candidate at one shape: its gain, and the normal equations of its torque's derivatives by the shape."""

    gain: float
    gram: Array  # (s, s), of what neither the base nor the candidate's own columns explain
    score: Array  # (s,)

    @staticmethod
    def at(base: Base, rows: Indices, columns: Array, k: int, steps: Array) -> LookAtShape:
        """From columns (N, rows, (1 + s) k): at the shape, and a step further in each of its parameters."""
        if len(rows) == 0:
            return LookAtShape(0.0, np.eye(len(steps)), np.zeros(len(steps)))
        left, own, score = base.projected(rows, columns)
        beta = solve_beside(left[:k, :k], own[:k, :k], score[:k])
        # derivatives as combinations of the columns: what is left of them needs no second look at the data
        further = np.zeros((columns.shape[2], len(steps)))
        further[:k] = -beta[:, None] / steps
        for i, step in enumerate(steps):
            further[k * (i + 1) : k * (i + 2), i] = beta / step
        mixed = left[:k] @ further
        taken = np.array([solve_beside(left[:k, :k], own[:k, :k], m) for m in mixed.T]).T
        return LookAtShape(
            float(score[:k] @ beta),
            further.T @ left @ further - mixed.T @ taken,
            further.T @ score - taken.T @ score[:k],
        )


@dataclass(frozen=True, eq=False)
class Refinement(Iterate):
    """Shapes x of a candidate on their way to its largest gain."""

    x: Array
    looked_at: Callable[[Array], LookAtShape]
    after: Callable[[Array, Array], Array]  # a step within the range

    @cached_property
    def look(self) -> LookAtShape:
        return self.looked_at(self.x)

    @property
    def goal(self) -> float:
        return -self.look.gain

    @property
    def enough(self) -> float:
        return SETTLED * max(self.look.gain, 1.0)

    def equations(self) -> tuple[Array, Array]:
        return self.look.gram, self.look.score

    def moved(self, step: Array) -> Refinement:
        x = self.after(self.x, step)
        return self if np.array_equal(x, self.x) else replace(self, x=x)
