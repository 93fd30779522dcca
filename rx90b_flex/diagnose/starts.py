"""Whether a first move held out shows the friction of joints that have stood, where too few fitted logs begin at rest for a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.moving import unmoved
from rx90b_flex.effects.breakaway import FEWEST_STARTS, BreakawayFriction, stood
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import Segment

THERE = 0.05  # of what it begins with: where less is left, a first move is over
TAKEN = 0.5  # of the squared error of a first move, at the least
TIMES = 2.0  # root mean square there over that elsewhere, at the least


@dataclass(frozen=True)
class FirstMove:
    """Torque that a joint needs beside a model's as it first moves, held out as fitted.

    Attributes
    ----------
    effect : BreakawayFriction
        With its values.
    share : float
        Part of the held-out first moves' squared error that it takes off, 0 to 1.
    """

    effect: BreakawayFriction
    share: float

    @property
    def words(self) -> str:
        """One caution."""
        effect = self.effect
        return (
            f"{effect.joint} needs {effect.torque:.3g} N m more as it first moves, and less the farther it has been from where it "
            f"stood (along {effect.distance:.2g} rad): what a fitted recording says of that takes {self.share:.0%} off the squared "
            f"error of first moves held out. {effect.type_name()} looks so, and one fitted recording that begins at rest is too few "
            "for a name: a second one would tell."
        )


def first_moves(fitted: tuple[Regression, Array], held_out: tuple[Regression, Array]) -> tuple[FirstMove, ...]:
    """Those of joints whose first moves a search has too few of to try that effect.

    Parameters
    ----------
    fitted, held_out : (regression, residual (N, joints))
        Of the motors.
    """
    found = []
    for j in range(len(fitted[0].joints)):
        own, others = ([p for p in _starts(*role, j) if p.stood] for role in (fitted, held_out))
        if others and 0 < len(own) < FEWEST_STARTS:
            found.append(_of(own, others))
    return tuple(f for f in found if f is not None)


@dataclass(frozen=True, eq=False)
class _Start:
    """One joint in one recording, and what is left of its torque, (N,)."""

    segment: Segment
    joint: int
    left: Array

    @property
    def name(self) -> str:
        return self.segment.motion.coordinates.joints[self.joint]

    @property
    def stood(self) -> bool:
        return stood(self.segment.motion.joint(self.name))

    def column(self, effect: BreakawayFriction) -> Array:
        """Its force behind the low-pass, (N,); zero until the joint has moved."""
        s = self.segment
        still, force = (
            x[:: s.factor][s.kept, self.joint]
            for x in (unmoved(s.motion.v, s.rate_hz * s.factor), s.low_passed(effect.force(s.motion)))
        )
        return np.where(still, 0.0, force)


def _starts(regression: Regression, left: Array, joint: int) -> list[_Start]:
    edges = np.cumsum([len(s) for s in regression.segments])[:-1]
    return [_Start(s, joint, x[:, joint]) for s, x in zip(regression.segments, np.split(left, edges), strict=True)]


def _of(own: Sequence[_Start], others: Sequence[_Start]) -> FirstMove | None:
    left = np.concatenate([p.left for p in own])
    plain = BreakawayFriction(joint=own[0].name, torque=1.0)
    candidates = []
    for shape in plain.shape_search(own[0].segment.motion).starts:
        column = np.concatenate([p.column(plain.with_shape(shape)) for p in own])
        size = float(column @ column)
        torque = float(column @ left) / max(size, 1e-300)
        if torque > 0:
            candidates.append((torque**2 * size, plain.with_shape(shape).with_coefficients([torque])))
    if not candidates:
        return None
    _, effect = max(candidates, key=lambda c: c[0])
    shares = [_share(effect, parts) for parts in (own, others)]
    return FirstMove(effect, shares[1]) if min(shares) > TAKEN else None


def _share(effect: BreakawayFriction, parts: Sequence[_Start]) -> float:
    """Part of the squared error of first moves that an effect takes off; zero where these err little more than the rest."""
    column, left = (np.concatenate(x) for x in ([p.column(effect) for p in parts], [p.left for p in parts]))
    there = np.abs(column) > THERE * np.abs(column).max()
    here, elsewhere = float((left[there] ** 2).mean()), float((left[~there] ** 2).mean())
    return 1.0 - float(((left - column)[there] ** 2).mean()) / here if here > TIMES**2 * elsewhere else 0.0
