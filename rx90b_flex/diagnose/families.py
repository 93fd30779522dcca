"""One law on several joints: joints of one make are one hypothesis, however many they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from rx90b_flex.diagnose.loop import Addition
from rx90b_flex.diagnose.trial import SIGNIFICANCE, TorqueTrial

FAMILIES = 4  # laws that are tried on all joints together
MEMBER = 0.05  # p-value of one of a family, corrected for its own shapes alone, below which it counts as evidence of their law


def family(members: Sequence[TorqueTrial], joints: int, kinds: int) -> TorqueTrial:
    """Several trials as one: gains add up, p-values become that of their product, of so many `joints` and `kinds` that were tried."""
    touched_squares = sum(m.gain / m.share for m in members)
    gain = float(sum(m.gain for m in members))
    return dataclasses.replace(
        members[0],
        gain=gain,
        block_gains=np.sum([m.block_gains for m in members], axis=0),
        p_value=min(1.0, kinds * product_of_small([m.alone for m in members], joints)),
        size=sum(m.size for m in members),
        share=gain / touched_squares,
        colour=max(m.colour for m in members),
        lost=np.sum([m.lost for m in members], axis=0),
        by_chance=np.sum([m.by_chance for m in members], axis=0),
        members=tuple(members),
        acting=max(m.acting for m in members),
        left=sum(m.left for m in members),
    )


def product_of_small(p_values: Sequence[float], tried: int) -> float:
    """How likely the product of those p-values among so many that lie below `MEMBER` is as small as this one, by chance.

    Source: D. V. Zaykin, L. A. Zhivotovsky, P. H. Westfall, B. S. Weir, "Truncated product method for combining P-values",
    Genetic Epidemiology 22(2), 2002, equation 1.
    """
    small = np.array([p for p in p_values if p < MEMBER])
    if not len(small):
        return 1.0
    product, out = -float(np.log(np.maximum(small, 1e-300)).sum()), 0.0
    for k in range(1, tried + 1):
        # of k that are small the product over MEMBER^k is that of k uniform ones, its logarithm Erlang distributed
        likely = stats.binom.pmf(k, tried, MEMBER)
        out += float(likely * stats.gamma.sf(max(product + k * np.log(MEMBER), 0.0), k))
    return out


def sure_together(
    at: int, steps: Sequence[Addition[TorqueTrial]], worth: Callable[[int], TorqueTrial], joints: int
) -> bool:
    """Whether an addition that came as one of several joints' and those with its law are sure together, each worth what it says."""
    own = steps[at].trial
    if not own.of_family:
        return False
    law = own.effect.type_name()
    alike = (i for i, s in enumerate(steps) if s.trial.of_family and s.trial.effect.type_name() == law)
    several = [w for w in map(worth, alike) if w.belongs]
    return len(several) > 1 and family(several, joints, FAMILIES).p_value < SIGNIFICANCE
