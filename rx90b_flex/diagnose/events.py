"""Whether what is left of held-out torques lies in a few short times: something that happened, which no law of motion holds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.moving import FIRST_S, TorqueErrors

PART_S = 0.25  # length of the parts of time that are compared; the last one, where a low-pass has no neighbours, is not
REST_S = 0.05  # where a joint rests for longer, its friction depends on what was before, and any model errs
SHORT = 0.05  # of the time in which a joint moves: what lasts longer is no event
LARGE = 0.5  # of a joint's squared error: so much in so short a time is one
TIMES = 5.0  # root mean square there over that elsewhere, at the least
FEW = 3  # what happens oftener belongs to the motion


@dataclass(frozen=True)
class Events:
    """Short times in which a joint's torque is far from the model's.

    Attributes
    ----------
    joint : str
    at : tuple of (str, float)
        Recording and middle of each time, s from its beginning; the largest error first.
    share : float
        Part of the joint's squared error in motion that lies in them, 0 to 1.
    times : float
        Root mean square there over that elsewhere.
    held_by : str
        The effect of the joint that remembers what was before, where all these times are the first of a recording; else empty.
    role : str
        Of the recordings, as words say it.
    """

    joint: str
    at: tuple[tuple[str, float], ...]
    share: float
    times: float
    held_by: str = ""
    role: str = "held out"

    def words(self, follows_motion: bool) -> str:
        """One caution; other words where a free form of the motion leaves much less of the joint's error."""
        where = " and ".join(f"{time:.1f} s of {name}" for name, time in self.at)
        why = (
            f"what {self.held_by} holds as a recording begins follows from the motion before, which no log tells."
            if self.held_by
            else "smooth curves of its motion leave much less of it, so that it is a law which shows there, and has no name here."
            if follows_motion
            else "something happened there (it touched something, its encoder slipped, samples are wrong), or a law shows that no "
            "other part of these recordings does."
        )
        return (
            f"{self.share:.0%} of the squared error that {self.joint} keeps in motion, {self.role}, lies around {where} alone, "
            f"{self.times:.0f} times the error elsewhere: {why}"
        )


def events(errors: TorqueErrors, remembering: Mapping[str, str] | None = None) -> tuple[Events, ...]:
    """Those of all joints, one entry a joint.

    Parameters
    ----------
    errors : TorqueErrors
        In every recording of one role.
    remembering : mapping of str to str
        Joint -> name of what acts there and remembers the motion before.
    """
    begins = errors.begins_s or [0.0] * len(errors.names)
    out = []
    for j, joint in enumerate(errors.joints):
        parts = [
            _Part(name, begin + (edges[0] + edges[-1]) / 2 / rate, float((left[edges, j] ** 2).sum()), len(edges))
            for name, rate, begin, left, there, still in zip(
                errors.names, errors.rates_hz, begins, errors.left, errors.since, errors.still, strict=True
            )
            for edges in np.array_split(np.arange(len(left)), max(1, round(len(left) / rate / PART_S)))[:-1]
            if len(edges) and there[edges[0], j] and still[edges, j].sum() <= REST_S * rate
        ]
        found = _of(joint, parts)
        if found is not None:
            first = all(time < FIRST_S for _, time in found.at)
            held_by = (remembering or {}).get(joint, "") if first else ""
            out.append(dataclasses.replace(found, held_by=held_by, role=errors.role))
    return tuple(out)


@dataclass(frozen=True)
class _Part:
    """A part of a recording in which a joint moves."""

    recording: str
    middle_s: float
    squares: float
    samples: int


def _of(joint: str, parts: Sequence[_Part]) -> Events | None:
    squares, samples = np.array([p.squares for p in parts]), np.array([p.samples for p in parts])
    largest = np.argsort(-squares)[: int(SHORT * len(parts))]
    if len(largest) == 0 or squares.sum() <= 0:
        return None
    # the fewest parts that hold so much of it
    held = np.cumsum(squares[largest]) / squares.sum()
    largest = largest[: int(np.searchsorted(held, LARGE)) + 1]
    share = float(squares[largest].sum() / squares.sum())
    groups = _together([parts[i] for i in largest])
    if share < LARGE or len(groups) > FEW:
        return None
    elsewhere = np.setdiff1d(np.arange(len(parts)), largest)
    inside, outside = (squares[at].sum() / samples[at].sum() for at in (largest, elsewhere))
    times = float(np.sqrt(inside / max(outside, 1e-300)))
    return Events(joint, tuple((p.recording, p.middle_s) for p in groups), share, times) if times > TIMES else None


def _together(parts: Sequence[_Part]) -> list[_Part]:
    """The largest of parts that follow each other, largest first."""
    out: list[_Part] = []
    for part in parts:  # they come largest first
        if all(p.recording != part.recording or abs(p.middle_s - part.middle_s) > 2 * PART_S for p in out):
            out.append(part)
    return out
