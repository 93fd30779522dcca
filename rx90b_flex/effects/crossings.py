"""The load of a link that crosses a gap, from the motion of its motor.

As the load F changes sign the link goes from one flank to the other, by ``x = -gap / 2 * tanh(F / contact)`` beside its motor.
The tree tells the load G of a link that moves as its motor does; the link's own is ``F = G + K x + D x' + M x''``, with the tree's
derivatives K, D and M, and kicks of many times the contact's torque lie in G where F is small. F is as smooth as the link's motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import fft, sparse
from scipy.interpolate import BSpline
from scipy.ndimage import minimum_filter1d
from scipy.sparse.linalg import splu

from rx90b_flex.effects.deflection import SECOND, rates_in_time, time_step
from rx90b_flex.effects.motion import Array, Indices, Motion
from rx90b_flex.pieces import in_pieces

KICK_S = 0.05  # over which a load is smoothed: as the motor crosses the gap its acceleration is not the link's
CROSSING = 0.3  # of it, within which a sample says little of the link's load
BESIDE_S = 0.02  # nor does one within this time of such samples
CLEARED = 2  # times that crossings are looked for in what the one before has cleared
LEFT_OF_IT = 1.0e-3  # weight of what lies within a crossing
KNOTS_S = 2.0 * KICK_S  # between those of a spline that a link's load is
CUBIC, FEWEST_OF_SPAN = 3, 4  # its degree; samples between its knots
FEWEST_ASIDE = 2  # samples of a parabola's on either side: at the ends there are three in all
GIVEN_BACK = 2  # times that a smoothed load gets back what the gap took from it, before
STEPS = 3  # of Gauss and Newton's method,
PARTS = (1.0, 0.3, 0.1)  # each as far as it leaves less
OVER = 1.0e-3  # of its largest value, where a filter's response counts as over
STEEPEST = 50.0  # times the contact's torque, beyond which teeth lie on a flank altogether


def between_crossings(load: Array, time: Array) -> Array:
    """A load (N,), uniform in time, by local parabolas over `KICK_S` that hardly see where it changes sign.

    As the motor crosses the gap its acceleration is not the link's, and the load that its angle gives has a kick there; how a
    link's load goes on from one flank to the other its course before and after tells. As it is where samples are no motion in time.
    """
    step = time_step(time)
    if step <= 0:
        return load
    crossing = CROSSING * max(float(np.sqrt(np.mean(load**2))), 1e-9)
    smooth = smoothed(load, time)
    for _ in range(CLEARED):
        clear = np.tanh(smooth / crossing) ** 2
        smooth = smoothed(load, time, LEFT_OF_IT + minimum_filter1d(clear, 2 * round(BESIDE_S / step) + 1))
    return smooth


def smoothed(load: Array, time: Array, weight: Array | None = None) -> Array:
    """A load (N,), uniform in time, by local parabolas over `KICK_S`; its samples count by a weight (N,) or alike.

    As it is where samples are so far apart that at its ends too few lie on a parabola.
    """
    weight = np.ones_like(load) if weight is None else weight
    reach = round(4.0 * KICK_S / time_step(time))
    if reach < FEWEST_ASIDE:
        return load
    return in_pieces(partial(_parabolas, reach=reach), np.column_stack([weight, weight * load]), reach)


def _parabolas(weighted: Array, reach: int) -> Array:
    """Of weights and weighted samples (N, 2) the values in the middle of local parabolas, so many samples to either side."""
    lags = np.arange(-reach, reach + 1) * (4.0 / reach)
    powers = np.exp(-0.5 * lags**2) * lags ** np.arange(5)[:, None]
    size = fft.next_fast_len(len(weighted) + 2 * reach, real=True)
    windows = fft.rfft(powers, size).conj()
    parts = fft.rfft(np.pad(weighted.T, ((0, 0), (reach, reach))), size)
    spectra = np.concatenate([parts[0] * windows, parts[1] * windows[:3]])
    m0, m1, m2, m3, m4, r0, r1, r2 = fft.irfft(spectra, size)[:, : len(weighted)]
    # by Cramer's rule
    c0, c1, c2 = m2 * m4 - m3**2, m2 * m3 - m1 * m4, m1 * m3 - m2**2
    return np.asarray((r0 * c0 + r1 * c1 + r2 * c2) / (m0 * c0 + m1 * c1 + m2 * c2))


@dataclass(frozen=True, eq=False)
class Gap:
    """A gap at one place of a motion that is uniform in time: its width (rad) and the torque of its contact (N m)."""

    motion: Motion
    place: int
    width: float
    contact: float

    def load(self, start: Array) -> Array:
        """The link's load (N,) from a guess at it: the spline that leaves least of what the motor's motion gives."""
        if not np.isfinite(start).all():
            return start  # values from which a fit turns back
        load = start
        for _ in range(GIVEN_BACK):
            load = smoothed(load + self._left(load), self.motion.time)
        spline, inside = self._spline, self._inside
        load = spline @ splu((spline.T @ spline).tocsc()).solve(spline.T @ load)
        left = inside * self._left(load)
        for _ in range(STEPS):
            slopes = self._slopes(load)
            further = spline @ splu((slopes.T @ slopes).tocsc()).solve(slopes.T @ left)
            for part in PARTS:
                less = inside * self._left(load + part * further)
                if less @ less < left @ left:
                    load, left = load + part * further, less
                    break
            else:
                break
        return np.asarray(load)

    def _left(self, load: Array) -> Array:
        side = -0.5 * np.tanh(load / self.contact)
        return np.asarray(self._at_motor + self.width * self._felt(side[:, None])[:, 0] - load)

    @cached_property
    def _at_motor(self) -> Array:
        return np.asarray(self.motion.on_tree.load())[:, self.place]

    @cached_property
    def _by(self) -> tuple[Array, ...]:
        return tuple(by[:, self.place, self.place, None] for by in self.motion.on_tree.derivatives())

    def _felt(self, turns: Array) -> Array:
        """Torque of its own joint, of turns of the link (N, k) rad as the log of the motor shows them."""
        seen = self.motion.as_angles(turns)
        return np.asarray(
            sum(by * x for by, x in zip(self._by, (seen, *rates_in_time(seen, self.motion.time)), strict=True))
        )

    @cached_property
    def _spans(self) -> int:
        """Of the spline."""
        samples = max(FEWEST_OF_SPAN, KNOTS_S / time_step(self.motion.time))
        return max(1, int((len(self.motion) - 1) / samples))

    @cached_property
    def _at(self) -> Array:
        """Where the samples lie among the spans, (N,)."""
        return np.linspace(0.0, self._spans, len(self.motion))

    @cached_property
    def _spline(self) -> sparse.csr_array:
        """Values at the samples per coefficient of a cubic spline, (N, m)."""
        knots = np.arange(-CUBIC, self._spans + CUBIC + 1.0)
        return BSpline.design_matrix(self._at, knots, CUBIC)

    @cached_property
    def _reach(self) -> int:
        """Samples over which the low-pass of angles and their differences answer to one, to either side."""
        pulse = np.zeros(len(self.motion))
        pulse[len(pulse) // 2] = 1.0
        answer = np.abs(self.motion.as_angles(pulse))
        beside = np.abs(np.flatnonzero(answer > OVER * answer.max()) - len(pulse) // 2)
        return int(beside.max()) + len(SECOND) // 2

    @cached_property
    def _inside(self) -> Array:
        """Of samples (N,) one, at the ends zero: what the low-pass has made of a kick there is not known, and the guess stands."""
        from_end = np.minimum(np.arange(len(self.motion)), np.arange(len(self.motion))[::-1])
        return (from_end >= self._reach).astype(float)

    @cached_property
    def _apart(self) -> int:
        """Coefficients between two whose answers, behind the low-pass of angles, do not meet."""
        return 1 + CUBIC + 2 * int(np.ceil(self._reach * self._at[1]))

    def _slopes(self, load: Array) -> sparse.csr_array:
        """Change of the spline less what the motor feels of it, per coefficient, (N, m): of many in one go that do not meet."""
        spline, many = self._spline, self._spline.shape[1]
        apart = min(self._apart, many)
        members = sparse.csr_array((np.ones(many), (np.arange(many), np.arange(many) % apart)), shape=(many, apart))
        teeth = -0.5 / self.contact / np.cosh(np.clip(load / self.contact, -STEEPEST, STEEPEST)) ** 2
        felt = self._inside[:, None] * self.width * self._felt(teeth[:, None] * (spline @ members).toarray())
        rows = np.broadcast_to(np.arange(len(load))[:, None], felt.shape)
        return spline - sparse.csr_array((felt.ravel(), (rows.ravel(), self._whose(apart).ravel())), shape=spline.shape)

    def _whose(self, apart: int) -> Indices:
        """The coefficient that answers at each sample, of those that go together, (N, apart)."""
        many, together = self._spline.shape[1], np.arange(apart)
        nearest = self._at[:, None] + 0.5 * (CUBIC - 1) - together
        last = (many - 1 - together) // apart
        return np.asarray(together + apart * np.clip(np.round(nearest / apart), 0, last), dtype=np.intp)
