"""Whether the torque of a joint whose position stands is that of a joint at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.signals import Recording

UNEXPLAINED = 0.5  # of a torque's standard deviation: what friction and load leave of it where it is not at rest
# times the noise above the motion's frequencies: noise that is not white has a few times as much below them
CLEARLY = 4.0
HELD = (0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)  # dry friction tried, of half the load's range: from none to all of it


@dataclass(frozen=True, eq=False)
class AtRest:
    """What a joint at rest would leave of each torque, could it be one.

    A drive at rest carries its load less what dry friction holds of it, which is anything within the breakaway torque: its torque
    follows the load with play, and may swing by less than the load, or not at all, but by no more. What is beyond that, and
    clearly beyond the noise that shows above the motion's frequencies, comes of a joint that moves.

    Attributes
    ----------
    left : array, shape (frictions, recordings, joints)
        Sums of squares that the load and each dry friction leave.
    swing : array, shape (recordings, joints)
        Sums of squares of the torque about its mean in each recording.
    noise : array, shape (recordings, joints)
        Sums of squares that as many rows of noise have.
    """

    left: Array
    swing: Array
    noise: Array

    @staticmethod
    def of(look: Look, recordings: Sequence[Recording]) -> AtRest:
        measured, fit = look.measured(), look.fit()
        # of a fit to other rows; and of the URDF's links, for a joint that moves unseen bends the fitted ones
        columns = look.columns(look.reading)
        known = look.fit_of_known_links()
        loads = [np.einsum("rjp,rp->rj", columns, f.theta[look.sample.fold]) for f in (fit, known)]
        left, swing = [], []
        for span in look.sample.spans:
            y = measured[span]
            left.append(np.minimum(*(_left(y, load[span]) for load in loads)))
            swing.append(_squares(y))
        rows = np.array([[span.stop - span.start] for span in look.sample.spans])
        return AtRest(np.stack(left, axis=1), np.array(swing), rows * _noise(look, recordings) ** 2)

    def moved(self) -> Mask:
        """Joints that were not at rest in all recordings together, shape (joints,)."""
        return _beyond(self.left.sum(axis=1).min(axis=0), self.swing.sum(axis=0), self.noise.sum(axis=0))

    def moved_in(self) -> Mask:
        """The same of each recording by itself, shape (recordings, joints)."""
        return _beyond(self.left.min(axis=0), self.swing, self.noise)


def _beyond(left: Array, swing: Array, noise: Array) -> Mask:
    return np.asarray((left > UNEXPLAINED**2 * swing) & (left > CLEARLY**2 * noise))


def _squares(x: Array) -> Array:
    """Sums of squares about the mean of the rows."""
    return np.asarray(((x - x.mean(axis=0)) ** 2).sum(axis=0))


def _left(torque: Array, load: Array) -> Array:
    """Squares that a load (R, joints) leaves of a torque through each dry friction, shape (frictions, joints)."""
    half = 0.5 * np.ptp(load, axis=0)
    # what friction holds as a recording begins is left from how the joint got there: anything between its bounds
    widths, starts = np.meshgrid(HELD, (-1.0, 0.0, 1.0), indexing="ij")
    width = widths[:, :, None] * half
    through = np.empty((len(load), *width.shape))
    now = load[0] + starts[:, :, None] * width
    for row, asked in enumerate(load):
        now = np.clip(now, asked - width, asked + width)
        through[row] = now
    return np.asarray(_squares(torque[:, None, None, :] - through).min(axis=1))


def _noise(look: Look, recordings: Sequence[Recording]) -> Array:
    """Standard deviation of each torque above the low-pass, that of most of the rows, shape (recordings, joints), N m."""
    above = [r.torque - t.torque for r, t in zip(recordings, look.sample.tracks, strict=True)]
    # by the median: friction that turns over leaves a few large ones, which are no noise
    return np.array([np.median(np.abs(x), axis=0) / 0.6745 for x in look.sample.as_read(look.reading, above)])
