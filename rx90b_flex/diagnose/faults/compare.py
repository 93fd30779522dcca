"""Hypotheses about the data compete with each other and with no fault."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.faults.gains import torque_gains
from rx90b_flex.diagnose.faults.kinematics import axes, lengths, mountings, zeros
from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.rates import sample_rates
from rx90b_flex.diagnose.faults.rigid_fit import RigidFit
from rx90b_flex.diagnose.faults.shifts import shifted
from rx90b_flex.diagnose.faults.signs import reversed_axes, reversed_positions, reversed_torques
from rx90b_flex.diagnose.faults.swapped import swapped
from rx90b_flex.diagnose.faults.units import other_units, outside

# in the order in which one is believed where several do equally well
KINDS: tuple[Callable[[Look], Iterator[Hypothesis]], ...] = (
    reversed_torques, swapped, other_units, shifted, reversed_positions, torque_gains, zeros, reversed_axes, axes, lengths,
    sample_rates, mountings,
)  # fmt: skip
ON_TORQUES_ALONE = (reversed_torques, torque_gains, shifted)
GAIN = 1.0  # of the summed log error: a joint's squared error falls to 37 %, or several joints' a little less each
MODEST = 0.5  # the same where the joints that gain end with a small error: a good model does not gain by chance
SMALL = 0.15**2
GAINING = 0.9  # of its squared error before: a joint that gains
TIE = 0.15  # within which the earlier kind is believed
THIN = 3  # rows of a first look at every hypothesis: one in so many
SECOND_LOOKS = 2  # of each kind, at all rows and with the factor refined
PROMISING = 0.3  # of the best gain of a first look, and this much of the log error itself
MOST = 4  # faults that are looked for behind one another
GOOD = 0.04**2  # squared relative error of every joint: whatever the columns are, they go together


@dataclass(frozen=True, eq=False)
class Found:
    """A hypothesis that does better than no fault, with the fits without and with it."""

    hypothesis: Hypothesis
    std: float | None
    before: RigidFit
    after: RigidFit


def faults_of(look: Look) -> tuple[tuple[Found, ...], Look]:
    """Faults of columns, units, times and kinematics, one behind the other, and the look with them mended."""
    found: list[Found] = []
    for _ in range(MOST):
        best = _best(look)
        if best is None:
            break
        found.append(best)
        look = dataclasses.replace(look, reading=best.hypothesis.reading)
    return tuple(found), look


def _best(look: Look) -> Found | None:
    base = look.fit()
    everything = bool((base.error > GOOD).any() or base.impossible.any() or outside(look, 1.0).any())
    promising: list[tuple[float, int, Hypothesis]] = []
    quick = dataclasses.replace(look, sample=look.sample.thinned(THIN), _columns={}, _products={})
    quick_base = quick.fit().score
    for rank, kind in enumerate(KINDS):
        if not (everything or kind in ON_TORQUES_ALONE):
            continue
        tried = sorted(((quick_base - quick.fit(h.reading).score, rank, h) for h in kind(quick)), key=lambda t: -t[0])
        promising += [t for t in tried[:SECOND_LOOKS] if t[0] > PROMISING]
    promising.sort(key=lambda t: -t[0])
    finals: list[tuple[float, int, Hypothesis]] = []
    for quick_gain, rank, hypothesis in promising:
        if quick_gain < PROMISING * promising[0][0]:
            break
        finals.append((base.score - look.fit(hypothesis.reading).score, rank, hypothesis))
    # what has a factor is compared at its best one; what falls far behind cannot be brought to win by it
    best = max((gain for gain, *_ in finals), default=0.0)
    refined: list[tuple[float, int, Hypothesis, float | None]] = []
    for gain, rank, hypothesis in finals:
        if gain > PROMISING * max(best, MODEST):
            better, std = look.refined(hypothesis)
            refined.append((base.score - look.fit(better.reading).score, rank, better, std))
    top = max((gain for gain, *_ in refined), default=0.0)
    if top < MODEST:
        return None
    gain, _, chosen, std = min((f for f in refined if f[0] >= top - TIE), key=lambda f: (f[1], -f[0]))
    after = look.fit(chosen.reading)
    gaining = after.error < GAINING * base.error
    if gain < GAIN and (after.error[gaining] > SMALL).any():
        return None
    return Found(chosen, std, base, after)


def relative_errors(fit: RigidFit) -> tuple[float, ...]:
    """Held-out error over the torque's standard deviation, a joint."""
    return tuple(float(x) for x in np.sqrt(fit.error))
