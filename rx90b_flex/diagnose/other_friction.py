"""Whether friction of one recording is larger or smaller than that of the others: a warm drive rubs less than a cold one.

No law of the motion tells one recording from another, and no recording says how warm its drives were.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import Regression

LEAST = 0.015  # of the model's friction: what a change of a degree or two makes is not worth a word
SURE = 5.0  # standard deviations
TAKEN = 0.25  # of the squared error of the joint in the recording, at the least
# the change at low speeds over that at high ones, or the other way: a law that is wrong differs between them
ALIKE = 0.3
BLOCK_S, FEWEST_BLOCKS = 2.0, 8  # over which standard deviations are taken, as errors within one go together


@dataclass(frozen=True)
class OtherFriction:
    """Joints whose friction in one recording is not what the model has.

    Attributes
    ----------
    recording : str
        Name of the recording.
    joints : tuple of str
    changes, stds : tuple of float
        Of each joint: friction there over that of the model, less one; and its standard deviation.
    shares : tuple of float
        Of each joint: part of the squared error in that recording that this makes up, 0 to 1.
    """

    recording: str
    joints: tuple[str, ...]
    changes: tuple[float, ...]
    stds: tuple[float, ...]
    shares: tuple[float, ...]

    @property
    def words(self) -> str:
        """One caution."""
        each = ", ".join(
            f"of {joint} by {change:+.1%} (std {std:.1%}; {share:.0%} of the squared error left on it there)"
            for joint, change, std, share in zip(self.joints, self.changes, self.stds, self.shares, strict=True)
        )
        return (
            f"In recording {self.recording} friction differs from the model's, at low speeds as at high ones: {each}. A drive that "
            "was colder than in the other recordings rubs more, a warmer one less; no recording says how warm its drives were."
        )


def other_friction(
    model: Identification, names: Sequence[str], regression: Regression, residual: Array
) -> Iterator[OtherFriction]:
    """Those recordings of a regression, in which the torque left over goes with the model's own friction.

    Parameters
    ----------
    model : Identification
        Its friction and what it does not explain are compared.
    names : sequence of str
        Of the recordings, one a segment.
    regression : Regression
        Of these recordings.
    residual : array, (N, rows)
        Torque left over in its rows, N m (N).

    Yields
    ------
    OtherFriction
        One a recording that has such joints.
    """
    rubbing = [e for e in model.effects if _rubs(e)]
    if not rubbing:
        return
    seen = regression.with_model(model.link_parameters, model.effects)
    friction = np.zeros_like(residual)
    for effect in rubbing:
        friction += (seen.columns(effect) @ effect.known_coefficients())[:, : residual.shape[1]]
    for name, span, segment in zip(names, regression.spans, regression.segments, strict=True):
        speed = np.abs(segment.velocity)
        blocks = max(FEWEST_BLOCKS, int(len(speed) / segment.rate_hz / BLOCK_S))
        each = [
            (joint, *_change(friction[span, j], residual[span, j], speed[:, j], blocks))
            for j, joint in enumerate(regression.joints)
        ]
        told = [x for x in each if _is_told(*x[1:])]
        if told:
            joints, changes, stds, shares, _ = zip(*told, strict=True)
            yield OtherFriction(name, joints, changes, stds, shares)


def _rubs(effect: Effect) -> bool:
    """Whether it is a friction of one joint, by its motion."""
    traits = effect.traits
    by_motion = traits.in_dynamics and traits.repeats_with_motion and "level" not in traits.straight
    return effect.known and traits.is_friction and traits.on == "joint" and by_motion


def _change(friction: Array, left: Array, speed: Array, blocks: int) -> tuple[float, float, float, float]:
    """Of one joint in one recording: change of its friction, std, share of the squared error, and likeness between speeds."""
    size, squares = float(friction @ friction), float(left @ left)
    if size == 0.0 or squares == 0.0:
        return 0.0, np.inf, 0.0, 0.0
    change = float(friction @ left) / size
    pieces = zip(np.array_split(friction, blocks), np.array_split(left, blocks), strict=True)
    std = float(np.sqrt(sum((f @ (x - change * f)) ** 2 for f, x in pieces))) / size
    slow = speed <= np.median(speed[speed > 0.0]) if speed.any() else speed <= 0.0
    parts = []
    for rows in (slow, ~slow):
        own = float(friction[rows] @ friction[rows])
        parts.append(float(friction[rows] @ left[rows]) / own if own > 0.0 else 0.0)
    lower, higher = sorted(np.array(parts) * np.sign(change))
    return change, std, change**2 * size / squares, float(lower / higher) if higher > 0.0 else 0.0


def _is_told(change: float, std: float, share: float, alike: float) -> bool:
    return abs(change) > max(LEAST, SURE * std) and share > TAKEN and alike > ALIKE
