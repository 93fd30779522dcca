"""Whether friction of one recording is larger or smaller than that of the others: a warm drive rubs less than a cold one.

No law of the motion tells one recording from another, and no recording says how warm its drives were. Left in the residual, such a
change makes every candidate unsure, and some seem to explain it: so candidates are held against a model whose frictions are free to
differ between recordings (`with_changes`), where the residual asks for that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import Segment

LEAST = 0.015  # of the model's friction: what a change of a degree or two makes is not worth a word
SURE = 5.0  # standard deviations
TAKEN = 0.25  # of the squared error of the joint in the recording, at the least
# the change at low speeds over that at high ones, or the other way: a law that is wrong differs between them
ALIKE = 0.3
USUAL = 0.1  # of the model's friction: what that of one recording differs by, before the data say so
FEW = 8  # recordings: as many are free where one differs
BLOCK_S, FEWEST_BLOCKS = 2.0, 8  # over which standard deviations are taken


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
    frictions = _frictions(model, regression.with_model(model.link_parameters, model.effects))
    if not frictions:
        return
    friction = np.zeros((len(residual), len(regression.rows)))
    for rows, torque in frictions:
        friction[:, rows] += torque
    for name, span, segment in zip(names, regression.spans, regression.segments, strict=True):
        speed = np.abs(segment.velocity)
        each = [
            (joint, *_change(friction[span, j], residual[span, j], speed[:, j], _blocks(segment)))
            for j, joint in enumerate(regression.joints)
        ]
        told = [x for x in each if _is_told(*x[1:])]
        if told:
            joints, changes, stds, shares, _ = zip(*told, strict=True)
            yield OtherFriction(name, joints, changes, stds, shares)


def with_changes(model: Identification, count: int) -> tuple[ColumnsByJoint, Array]:
    """Columns of a model with changes of its frictions from recording to recording behind them.

    None where no friction differs in any recording. A robot that is warmer is so in all its drives: if one differs, all may. The sum
    of a friction's changes over all recordings is zero: what these have in common is the model's.

    Parameters
    ----------
    model : Identification
    count : int
        Columns that it has, shapes' too.

    Returns
    -------
    columns : ColumnsByJoint
    precision : array, shape (k, k)
        Of the k changes before the data, inverse variance.
    """
    frictions = _frictions(model, model.regression)
    apart = _apart(model, frictions)
    if not len(apart):
        return model.derivatives, np.zeros((0, 0))
    spans = model.regression.spans
    parts = []
    for number, (rows, torque) in enumerate(frictions):
        own = np.full((*torque.shape, len(apart)), -1.0 / len(spans))
        for i, r in enumerate(apart):
            own[spans[r], :, i] += 1.0
        parts.append((count + len(apart) * number + np.arange(len(apart)), rows, own * torque[:, :, None]))
    more = ColumnsByJoint.of(parts, *model.residual.T.shape)
    return model.derivatives.beside(more), USUAL**-2.0 * np.eye(len(apart) * len(frictions))


def helps_beside_it(added: Identification, without: Identification, held_out: Regression) -> bool:
    """Whether a model leaves less than another one of recordings that were not fitted, where the friction of each is free.

    False where no friction of the recordings that were fitted differs: then that of the others is no excuse.
    """
    if not len(_apart(without, _frictions(without, without.regression))):
        return False
    frictions = _frictions(without, held_out.with_model(without.link_parameters, without.effects))
    left = []
    for model in (added, without):
        residual = model.residual_on(held_out)
        for span in held_out.spans:
            for j in range(residual.shape[1]):
                own = [torque[span, at] for rows, torque in frictions for at in np.flatnonzero(rows == j)]
                columns = np.array([f for f in own if f.any()]).reshape(-1, span.stop - span.start).T
                residual[span, j] -= columns @ np.linalg.lstsq(columns, residual[span, j], rcond=None)[0]
        left.append(float((residual**2).sum()))
    return left[0] < left[1]


def _frictions(model: Identification, regression: Regression) -> list[tuple[Indices, Array]]:
    """Torque of each friction of a model in the rows of a regression: which joints, and (N, r), N m."""
    rubbing = [e for e in model.effects if _rubs(e)]
    each = zip(regression.each(rubbing), rubbing, strict=True)
    return [(rows, columns @ e.known_coefficients()) for (rows, columns), e in each]


def _apart(model: Identification, frictions: Sequence[tuple[Indices, Array]]) -> Indices:
    """Recordings in which any friction stands out: of few recordings all, of many those in which one does so most.

    All but one, whose changes those of the others say.
    """
    recordings = list(zip(model.regression.spans, model.regression.segments, strict=True))
    by = np.zeros(len(recordings))
    if len(recordings) < 2:
        return np.zeros(0, dtype=np.intp)
    for rows, torque in frictions:
        left = model.residual[:, rows]
        parts = [_part(torque[span].ravel(), left[span].ravel(), _blocks(s)) for span, s in recordings]
        by = np.maximum(by, [abs(change) / max(LEAST, SURE * std) for change, std in parts])
    if not (by > 1.0).any():
        return np.zeros(0, dtype=np.intp)
    most = np.argsort(-by)[: min(FEW, len(by) - 1)]
    return np.sort(most if len(by) <= FEW else most[by[most] > 1.0])


def _rubs(effect: Effect) -> bool:
    """Whether it is a friction of one joint, by its motion."""
    traits = effect.traits
    by_motion = traits.in_dynamics and traits.repeats_with_motion and "level" not in traits.straight
    return effect.known and traits.is_friction and traits.on == "joint" and by_motion


def _blocks(segment: Segment) -> int:
    """How many pieces of a recording say a standard deviation: errors within one go together."""
    return max(FEWEST_BLOCKS, int(len(segment.velocity) / segment.rate_hz / BLOCK_S))


def _part(torque: Array, left: Array, blocks: int) -> tuple[float, float]:
    """How much of a torque (N,) goes on in what is left (N,), and the standard deviation of that."""
    size = float(torque @ torque)
    if size == 0.0:
        return 0.0, np.inf
    part = float(torque @ left) / size
    pieces = zip(np.array_split(torque, blocks), np.array_split(left, blocks), strict=True)
    return part, float(np.sqrt(sum((f @ (x - part * f)) ** 2 for f, x in pieces))) / size


def _change(friction: Array, left: Array, speed: Array, blocks: int) -> tuple[float, float, float, float]:
    """Of one joint in one recording: change of its friction, std, share of the squared error, and likeness between speeds."""
    squares = float(left @ left)
    change, std = _part(friction, left, blocks)
    if std == np.inf or squares == 0.0:
        return 0.0, np.inf, 0.0, 0.0
    slow = speed <= np.median(speed[speed > 0.0]) if speed.any() else speed <= 0.0
    lower, higher = sorted(np.array([_part(friction[at], left[at], 1)[0] for at in (slow, ~slow)]) * np.sign(change))
    share = change**2 * float(friction @ friction) / squares
    return change, std, share, float(lower / higher) if higher > 0.0 else 0.0


def _is_told(change: float, std: float, share: float, alike: float) -> bool:
    return abs(change) > max(LEAST, SURE * std) and share > TAKEN and alike > ALIKE
