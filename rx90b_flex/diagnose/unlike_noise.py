"""Held-out errors that no noise of a torque has, however small beside the torque: a course over each recording, and bursts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from rx90b_flex.diagnose.moving import TorqueErrors
from rx90b_flex.effects.motion import Array

# cosines over a recording: of its course, and those of which noise without one has as much
FIRST, NEXT = slice(1, 3), slice(6, 26)
STEEP = 20.0  # times the mean power of the next cosines; of 1/f noise it is about ten
COURSE = 0.2  # of a joint's squared error
SHORTEST_S = 10.0  # of a recording: in less, noise that remembers for a quarter of a second looks so, too
RESTS = 0.2  # of the rows at rest, beyond which friction that holds makes any course
PART_S = 0.1  # length of the parts of time that are compared
FEW = 0.1  # of the parts in motion: of noise, white or coloured, they hold a quarter to two fifths of the squared error
BURSTS = 0.5  # of the squared error in them
LARGE = 0.05  # of the torque's standard deviation: friction's changes of sign leave as small ones


@dataclass(frozen=True)
class Course:
    """A joint whose torque error changes over each recording more than from second to second.

    Attributes
    ----------
    joint : str
    share : float
        Part of its squared error in the first two cosines over each recording, 0 to 1.
    """

    joint: str
    share: float

    @property
    def words(self) -> str:
        """One caution."""
        return (
            f"{self.share:.0%} of the squared error of {self.joint}, held out, is a course over each whole recording: noise has "
            "none. A zero that drifts with time (a sensor's, a temperature's) looks so."
        )


@dataclass(frozen=True)
class Bursts:
    """A joint whose torque error comes in bursts.

    Attributes
    ----------
    joint : str
    share : float
        Part of its squared error in motion in a tenth of the time, 0 to 1.
    part : float
        Its root mean square there over that of the torque's changes.
    """

    joint: str
    share: float
    part: float

    @property
    def words(self) -> str:
        """One caution."""
        return (
            f"{self.share:.0%} of the squared error that {self.joint} keeps in motion, held out, lies in a tenth of the time, and is "
            f"{self.part:.0%} of the torque's changes there: noise comes in no bursts. Play in a gear, something that hits, or "
            "friction that slips at once leaves such."
        )


def unlike_noise(errors: TorqueErrors) -> Iterator[Course | Bursts]:
    """What of held-out errors is no noise, from when joints first moved on."""
    size = np.concatenate(errors.torque).std(axis=0)
    for j, joint in enumerate(errors.joints):
        told, moving = [], []
        for still, since, rate, left in zip(errors.still, errors.since, errors.rates_hz, errors.left, strict=True):
            if len(left) >= SHORTEST_S * rate:
                told.append(left[since[:, j], j])
                moving.append((left[since[:, j] & ~still[:, j], j], rate))
        if not told:
            continue
        at_rest = 1.0 - float(np.concatenate([~still[:, j] for still in errors.still]).mean())
        share = _course(told) if at_rest < RESTS else 0.0
        if share > COURSE:
            yield Course(joint, share)
        squares = np.concatenate([_squares(x, rate) for x, rate in moving])
        most = np.sort(squares)[::-1][: int(FEW * len(squares))]
        share, rms = most.sum() / max(squares.sum(), 1e-300), np.sqrt(squares.mean() if len(squares) else 0.0)
        if share > BURSTS and rms > LARGE * size[j]:
            yield Bursts(joint, float(share), float(np.sqrt(most.mean()) / size[j]))


def _course(errors: Sequence[Array]) -> float:
    """Part of the squared error in the first cosines over each recording; zero where those that follow have as much."""
    powers = [fft.dct(x, norm="ortho") ** 2 for x in errors if len(x) > 2 * NEXT.stop]
    first, following = (sum(float(p[some].sum()) for p in powers) for some in (FIRST, NEXT))
    count = (NEXT.stop - NEXT.start) / (FIRST.stop - FIRST.start)
    whole = sum(float(p.sum()) for p in powers)
    return first / whole if powers and first * count > STEEP * following and whole > 0.0 else 0.0


def _squares(error: Array, rate_hz: float) -> Array:
    """Mean square of each part of a recording."""
    parts = np.array_split(error, max(1, round(len(error) / rate_hz / PART_S)))
    return np.array([float((x**2).mean()) for x in parts if len(x)])
