"""Torques that are logged in coarse steps: what keeps one value, or has many samples at its largest, because of its resolution."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.signals import Recording
from rx90b_flex.signals.facts import counter_steps

BESIDE = 3.0  # times what the rigid model leaves of a torque anywhere: that much it may leave in a stretch, too
FAR = 8.0  # times the same: no model goes by that much without a cause
LEAVES = 1.5  # steps to the next value: what stays within a step goes on by one
EDGE = 0.25  # of a stretch at the most that is left out at each end
LOOKED_AT = 12  # rows of a stretch


class Stretch(NamedTuple):
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

    def may_keep(self, runs: Collection[Stretch]) -> set[Stretch]:
        """Those in which the torque that the motion asks for stays within a step, as far as the model tells.

        Where the value after it is the next one of the grid, the torque has not gone elsewhere meanwhile, and the model is not
        believed unless it says so by far.
        """
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
            edge = self._edge(run)
            inside = left[sample.spans[run.recording], joint][(own >= run.start + edge) & (own <= run.end - edge)]
            usual = np.sqrt((self._left[:, joint] ** 2).mean())
            beside = (BESIDE if self._jumps(run) else FAR) * usual
            if len(inside) == 0 or np.ptp(inside) <= self._steps_read[joint] + beside:
                out.add(run)
        return out

    def _edge(self, run: Stretch) -> int:
        """Rows at each end of a run into which the low-pass carries what is beyond: friction that turns over there, say."""
        rate = self.recordings[run.recording].sample_rate_hz
        return min(round(0.5 * rate / self.look.sample.cutoff_hz), round(EDGE * (run.end - run.start)))

    def _jumps(self, run: Stretch) -> bool:
        """Whether the value behind a run is no neighbour of its own."""
        torque = self.recordings[run.recording].torque[:, run.column]
        after = torque[min(run.end + 1, len(torque) - 1)]
        return bool(abs(after - torque[run.end]) > LEAVES * self.steps[run.column])

    def may_end(self, column: int, sign: float) -> bool:
        """Whether the torque that the motion asks for goes no further than half a step beyond the column's largest value.

        Of the smallest value, with -1. On the average of the samples there, as far as the model tells.
        """
        joint = self._joint(column)
        read = np.concatenate([x[:, joint] for x in self._read])
        sign *= float(np.sign(self.look.reading.torque_scale[joint]))
        rows = np.concatenate([x[t.rows, joint] for x, t in zip(self._read, self.look.sample.tracks, strict=True)])
        slack = 1e-6 * np.ptp(read)
        counts = self.look.sample.left_seen(self.look.reading)[:, joint]
        at = counts & (sign * rows >= (sign * read).max() - slack)
        between = counts & ~at & (sign * rows > (sign * read).min() + slack)
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


def _rows(runs: Collection[Stretch]) -> Indices:
    some = [np.linspace(r.start, r.end, LOOKED_AT).astype(int) for r in runs]
    return np.concatenate(some) if some else np.zeros(0, dtype=int)
