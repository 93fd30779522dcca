"""Friction of a joint that has stood for long, until it has slid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.compiled.in_laws import turned_over, turning
from rx90b_flex.compiled.signals import dahl
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.law_effect import RememberingLaw
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import FRICTION, linear, shape
from rx90b_flex.effects.reversal import SHARP, SLOWEST_PART, Resolution, reversal_slope

TURNS_ALONG = 0.03  # of the distance along which it fades: contacts bend by much less than they slide
RESOLVED = 4.0  # times the angle that a log resolves: the least distance that it tells
SHORTEST, LONGEST = (
    5e-4,
    0.1,
)  # of a joint's travel: what fades along less is held before the first move, along more it is no start
FEWEST_STARTS = 2  # logs that begin with the joint at rest: one start says nothing of the next


@dataclass(frozen=True, kw_only=True)
class BreakawayFriction(RememberingLaw, breaks_away=True, repeats_with_motion=False):
    """Friction that a joint has beside its own after it has stood for long: ``torque * exp(-s / distance) * sign(v)``.

    s is the farthest that the joint has been from where it stood as the log begins; the sign turns over along a small part of
    `distance`. A log that begins in motion shows nothing of it.

    Signature
    ---------
    As a log begins, a torque in the direction of the first move, larger than friction ever is later. It fades along an angle,
    however slowly the joint creeps along it, and does not come back when the joint reverses.

    Neighbours
    ----------
    `stribeck_friction` is there at every slow passage; `friction_drift` fades with time, in proportion to the velocity;
    `held_friction` and `presliding_friction` act at later rests and reversals too. Needs two logs or more that begin at rest, with
    a first move that is slow; where all first moves go the same way, a torque that settles as logs begin looks the same.

    Source
    ------
    Not in Hardeman 2008. Static friction grows while contacts rest, and is lost along a sliding distance of its own: E. Rabinowicz,
    "The intrinsic variables affecting the stick-slip process", Proceedings of the Physical Society 71(4), 1958; J. H. Dieterich,
    "Modeling of rock friction 1", Journal of Geophysical Research 84(B5), 1979.
    """

    law_remembers: ClassVar[int] = 3

    torque: float | None = linear("N m", lower=0.0, rank=FRICTION)
    distance: float | None = shape("rad", start=0.01, lower=1e-7, upper=1e2, telling=True)

    def basis(self, at: JointMotion) -> Array:
        if not stood(at):
            return np.zeros((len(at.q), 1))
        (distance,) = self.known_shape()
        farthest = at.of_number("farthest", 0.0, lambda: _farthest(at.q))
        return (np.exp(-farthest / distance) * dahl(at.q, TURNS_ALONG * distance))[:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        """By the velocity as of a sign that turns over at once."""
        zero = np.zeros((len(at.q), 1))
        if not stood(at):
            return zero, zero, zero
        left = np.exp(-_farthest(at.q) / self.known_shape()[0])
        return zero, (left * reversal_slope(at.v, SHARP))[:, None], zero

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """It remembers its sign, how far the joint is from where it began, and the farthest that it has been."""
        torque, distance = parameters[0], parameters[1]
        before, part, gone, farthest = parameters[4], parameters[5], parameters[6], parameters[7]
        along = TURNS_ALONG * distance
        part = turned_over(x, before, part, along)
        gone = gone + (x - before)
        farthest = np.maximum(farthest, np.abs(gone))
        left = torque * np.exp(-farthest / distance)
        out[0] = left * part
        out[1] = left * turning(part, rate, along)
        out[2] = 0.0
        out[4] = part
        out[5] = gone
        out[6] = farthest

    def shape_range(self, motion: Motion) -> Array:
        known = Resolution.of(motion.joint(self.joint))
        low = max(RESOLVED * known.angle, SHORTEST * known.travel)
        return np.array([[low], [max(LONGEST * known.travel, RESOLVED * low)]])

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        low, high = self.shape_range(motion)[:, 0]
        return ShapeSearch(np.geomspace(1.5 * low, 0.7 * high, 7)[:, None], independent=3, part=0.5)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        """Where it shows more than once, as far as motions are known."""
        return [cls(joint=j) for j in sites.joints if not sites.motions or _starts(j, sites) >= FEWEST_STARTS]

    @classmethod
    def too_seldom(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(joint=j) for j in sites.joints if 0 < _starts(j, sites) < FEWEST_STARTS]


def _starts(joint: str, sites: Sites) -> int:
    return sum(stood(m.joint(joint)) for m in sites.motions)


def stood(at: JointMotion) -> bool:
    """Whether a motion begins with the joint at rest."""
    return at.follows and bool(abs(at.v[0]) <= SLOWEST_PART * Resolution.of(at).speed)


def _farthest(q: Array) -> Array:
    """The farthest that an angle has been from where it began, (N,), rad.

    From the second sample: what the first one tells is the direction from which the joint came (`diagnose.reversals`).
    """
    return np.maximum.accumulate(np.abs(q - q[1]))
