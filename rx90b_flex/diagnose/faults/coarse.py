"""Torques that are logged in coarse steps: what keeps one value, or has many samples at its largest, because of its resolution."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.signals import Recording
from rx90b_flex.signals.facts import counter_steps

BESIDE = 2.0  # times what the rigid model leaves of a torque anywhere: that much it may leave in a stretch, too
LOOKED_AT = 12  # rows of a stretch


class Run(NamedTuple):
    """Rows from `start` to `end` of a torque column that keep one value."""

    recording: int
    column: int
    start: int
    end: int


@dataclass(frozen=True, eq=False)
class Coarse:
    """The steps of a campaign's torques, and what the rigid model says that the torques were between them.

    A torque on a grid keeps one value as long as it changes by less than a step, and its largest value stands for half a step
    more. Where samples were lost or cut off, the motion asks for the torque all the same: the model's goes by more than that.
    """

    look: Look
    recordings: Sequence[Recording]

    @cached_property
    def steps(self) -> Array:
        """Grid of each torque column, zero where there is none, shape (columns,), N m."""
        return np.asarray(np.max([counter_steps(r.torque) for r in self.recordings], axis=0))

    def may_keep(self, runs: Collection[Run]) -> set[Run]:
        """Those in which the torque that the motion asks for stays within a step, as far as the model tells."""
        runs = [r for r in runs if self.steps[r.column] > 0.0]
        if not runs:
            return set()
        rows = [_rows([r for r in runs if r.recording == i]) for i in range(len(self.recordings))]
        sample = self.look.sample.with_rows(self.recordings, rows)
        closer = dataclasses.replace(self.look, sample=sample, _columns={}, _products={}, ratios={})
        left = closer.measured() - closer.columns(self.look.reading) @ self.look.fit().theta.mean(axis=0)
        out = set()
        for run in runs:
            joint, own = self._joint(run.column), sample.tracks[run.recording].rows
            inside = left[sample.spans[run.recording], joint][(own >= run.start) & (own <= run.end)]
            usual = np.sqrt((self._left[:, joint] ** 2).mean())
            if len(inside) and np.ptp(inside) <= self._steps_read[joint] + BESIDE * usual:
                out.add(run)
        return out

    def may_end(self, column: int, sign: float) -> bool:
        """Whether the torque that the motion asks for goes no further than half a step beyond the column's largest value.

        Of the smallest value, with -1. On the average of the samples there, as far as the model tells.
        """
        joint = self._joint(column)
        read = np.concatenate([x[:, joint] for x in self._read])
        sign *= float(np.sign(self.look.reading.torque_scale[joint]))
        rows = np.concatenate([x[t.rows, joint] for x, t in zip(self._read, self.look.sample.tracks, strict=True)])
        slack = 1e-6 * np.ptp(read)
        at = sign * rows >= (sign * read).max() - slack
        between: Mask = ~at & (sign * rows > (sign * read).min() + slack)
        if not (at.any() and between.any()):
            return False
        beyond = sign * (self.look.predicted()[:, joint] - rows)[at]
        usual = np.sqrt((self._left[between, joint] ** 2).mean())
        return bool(beyond.mean() <= 0.5 * self._steps_read[joint] + usual)

    def _joint(self, column: int) -> int:
        """The joint whose torque a column is."""
        return self.look.reading.torque_order.index(column)

    @cached_property
    def _left(self) -> Array:
        return self.look.measured() - self.look.predicted()

    @cached_property
    def _read(self) -> list[Array]:
        """Torques of each recording as the look reads its columns, not low-passed."""
        return self.look.sample.as_read(self.look.reading, [r.torque for r in self.recordings])

    @cached_property
    def _steps_read(self) -> Array:
        return np.asarray(np.max([counter_steps(x) for x in self._read], axis=0))


def _rows(runs: Collection[Run]) -> Indices:
    some = [np.linspace(r.start, r.end, LOOKED_AT).astype(int) for r in runs]
    return np.concatenate(some) if some else np.zeros(0, dtype=int)
