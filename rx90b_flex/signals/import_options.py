"""What an import is told and what it says: the robot's joints, the user's options, and what was worked out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rx90b_flex.signals.recording import SIGNALS

Sureness = Literal["stated", "sure", "likely"]

FIELDS = {s.key: s.field for s in SIGNALS}  # key of a campaign file -> field of a recording


@dataclass(frozen=True)
class Axes:
    """What an import needs to know of the robot.

    Attributes
    ----------
    joints : names, in tree order.
    lower, upper : position limits, rad, one a joint.
    prismatic : whether a joint's positions are in m, one a joint; empty: none's are.
    """

    joints: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    prismatic: tuple[bool, ...] = ()

    def turns(self, joint: str) -> bool:
        """Whether a joint's positions are angles."""
        return not self.prismatic or not self.prismatic[self.joints.index(joint)]


@dataclass(frozen=True)
class ReadingOptions:
    """What the user says, and so is not worked out.

    Attributes
    ----------
    columns : signal of a campaign file -> one column a joint, in the order of `joints`.
    joints : joints of the robot that the columns belong to, in their order; empty: by names and numbers.
    rate_hz : sample rate; needed where there is no time column, otherwise the rate to resample to.
    degrees : whether angles and their rates are in degrees; None: by names and by the robot's limits.
    gear : one row of motor turns a joint turn, or a row a motor where joints are coupled: the columns are motor side, and motor
        angle = gear @ (joint angle - offset). Empty: joint side.
    offset : rad, one a joint; empty: none.
    topic : of a bag.
    """

    columns: Mapping[str, Sequence[str]] = dataclasses.field(default_factory=dict)
    joints: tuple[str, ...] = ()
    rate_hz: float | None = None
    degrees: bool | None = None
    gear: tuple[tuple[float, ...], ...] = ()
    offset: tuple[float, ...] = ()
    topic: str | None = None


@dataclass(frozen=True)
class Finding:
    """Something worked out: what, and how sure that is.

    Stated: an option says so. Sure: names or the format say so. Likely: numbers in names, sizes or limits suggest it.
    """

    what: str
    sure: Sureness

    def __str__(self) -> str:
        return f"{self.what} ({self.sure})"


class Findings(list[Finding]):
    """What is worked out, in the order in which it is."""

    def add(self, what: str, sure: Sureness = "sure") -> None:
        self.append(Finding(what, sure))
