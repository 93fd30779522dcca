"""Errors in motion, apart from those at rest: a joint that stands still is held by friction, which follows no law of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.identify.segment import STANDING_S

AT_REST = 0.01  # of a joint's largest speed, below which it rests
AT_REST_RAD_S = 1e-3  # and below which any joint does; m/s for prismatic ones
RINGS = 1e-5  # of it, below which a velocity is none but a filter's
MOSTLY = 0.5  # of the squared error
FIRST_S = 1.0  # of a recording, in which what remembers the motion still acts as what was before has it
BEGINNING_S = 0.5  # from a joint's first move on: what friction does there depends on what was before the recording


@dataclass(frozen=True, eq=False)
class TorqueErrors:
    """Torques and what a model leaves of them in recordings of one role.

    Attributes
    ----------
    joints, names : sequence of str
        Of the columns, and of the recordings.
    rates_hz : sequence of float
        Sample rates.
    torque, left, velocity : sequences of arrays, each (N, joints)
        Torque and its error, N m (N), and velocity, rad/s (m/s).
    begins_s : sequence of float
        Time of each first row from its recording's beginning, s; zero where none is given.
    role : str
        Of the recordings, as words say it.
    """

    joints: Sequence[str]
    names: Sequence[str]
    rates_hz: Sequence[float]
    torque: Sequence[Array]
    left: Sequence[Array]
    velocity: Sequence[Array]
    begins_s: Sequence[float] = ()
    role: str = "held out"

    @cached_property
    def still(self) -> list[Mask]:
        """Rows in which each joint stands still."""
        return resting_each(self.velocity)

    @cached_property
    def since(self) -> list[Mask]:
        """Rows from when each joint first moved on (`begun`)."""
        return [begun(still, rate) for still, rate in zip(self.still, self.rates_hz, strict=True)]


@dataclass(frozen=True)
class MovingErrors:
    """Errors on validation over the rows in which the joint concerned moves.

    Attributes
    ----------
    before, after : float
        2-norm of the torque error over the 2-norm of the torque, both over those rows; zero where nothing moves.
    at_rest : float
        Share of the rows left out, 0 to 1.
    """

    before: float
    after: float
    at_rest: float

    @staticmethod
    def of(
        measured: Sequence[Array], before: Sequence[Array], after: Sequence[Array], velocity: Sequence[Array]
    ) -> MovingErrors:
        """From measured and predicted torque of every validation recording, and velocity; each (N, joints)."""
        masks = [~still for still in resting_each(velocity)]
        torque, *predicted = (
            np.concatenate([x[there] for x, there in zip(each, masks, strict=True)])
            for each in (measured, before, after)
        )
        size = float(np.linalg.norm(torque))
        less, more = (float(np.linalg.norm(torque - x)) / size if size > 0 else 0.0 for x in predicted)
        return MovingErrors(less, more, 1.0 - float(np.concatenate(masks).mean()))


def resting(velocity: Array) -> Mask:
    """Rows in which each joint stands still, for velocities (N, joints) of all recordings together."""
    speed = np.abs(velocity)
    return np.asarray(speed < np.maximum(AT_REST * speed.max(axis=0), AT_REST_RAD_S))


def resting_each(velocity: Sequence[Array]) -> list[Mask]:
    """The same for each recording, (N, joints)."""
    return np.split(resting(np.concatenate(velocity)), np.cumsum([len(v) for v in velocity])[:-1])


def begun(still: Mask, rate_hz: float) -> Mask:
    """Rows of one recording since half a second after each joint's first move, from where it rests, (N, joints)."""
    first = np.argmin(still, axis=0) + BEGINNING_S * rate_hz
    return np.asarray(np.arange(len(still))[:, None] >= first)


def unmoved(velocity: Array, rate_hz: float) -> Mask:
    """Rows of one recording in which a joint has hardly moved since it began, (N, joints): a creeping one has yet to break away."""
    return _longer(np.abs(velocity) < AT_REST_RAD_S, rate_hz)


def waiting(velocity: Array, rate_hz: float) -> Mask:
    """Rows of one recording in which a joint has stood still since it began, and of the half second after, (N, joints).

    What friction holds there follows from what was before. Velocities are zero where angles tell no motion (`segment.prepare`), but
    for what a filter lets ring before the first move.
    """
    speed = np.abs(velocity)
    still = _longer(speed <= RINGS * speed.max(axis=0), rate_hz)
    return np.asarray(~begun(still, rate_hz) & still[0])


def _longer(still: Mask, rate_hz: float) -> Mask:
    """Rows up to the first in which a joint does not stand still; none of a start on the way."""
    first = np.logical_and.accumulate(still, axis=0)
    return np.asarray(first & (first.sum(axis=0) > STANDING_S * rate_hz))


def held_at_first(measured: Sequence[Array], after: Sequence[Array], still: Sequence[Mask]) -> str:
    """A caution where most of the squared error lies where joints have not moved yet, or only just have; empty where it does not."""
    begins = np.concatenate(still)
    torque = np.concatenate(measured)
    squares = (torque - np.concatenate(after)) ** 2
    there, whole = float(squares[begins].sum()), float(squares.sum())
    if there <= MOSTLY * whole:
        return ""
    else_error = np.sqrt((whole - there) / max(float((torque[~begins] ** 2).sum()), 1e-300))
    return (
        f"{there / whole:.0%} of the squared error held out lies where joints stand as a recording begins, and in the half second "
        f"after: what friction holds before a first move nobody knows. Elsewhere the relative error is {else_error:.3g}."
    )
