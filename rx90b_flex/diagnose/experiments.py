"""Motions of one joint that are thought through to tell two explanations apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rx90b_flex.diagnose.search import Search
from rx90b_flex.effects.motion import Array, Motion

SECONDS, RATE_HZ = 20.0, 50.0  # of an experiment
TIME = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
SLOW, MEDIUM = 0.03, 0.3  # of the fastest speed in the data
SMALL = 0.01  # rad or m
LATER_S = 300.0  # between the parts of the experiment that repeats
WIDER = 1.3  # range of a joint over the data's, from which it is worth asking for


class _Moves:
    """How one joint moved in the data, from `low` to `high` and as fast as `fastest`, where all joints were on average, and how it
    could move.
    """

    def __init__(self, search: Search, joint: str) -> None:
        self.search, self.joint = search, joint
        self.column = search.regression.robot.layout.names.index(f"{joint}:drive")
        seen = [s.sampled for s in search.regression.segments]
        places, rates = np.concatenate([m.q for m in seen]), np.concatenate([m.v for m in seen])
        self.rest = np.asarray(np.median(places, axis=0))
        self.low, self.high = float(places[:, self.column].min()), float(places[:, self.column].max())
        self.fastest = float(np.abs(rates[:, self.column]).max())
        (self.unit,) = search.regression.robot.units_of([joint])

    def motion(self, x: Array, others: Array | None = None, at: Array = TIME) -> Motion:
        """Of the joint's angle as a function of time; the others as given, (N, n), or at rest."""
        robot, model = self.search.regression.robot, self.search.model
        places = np.broadcast_to(self.rest if others is None else others, (len(x), len(self.rest))).copy()
        places[:, self.column] = x
        v, a = np.zeros_like(places), np.zeros_like(places)
        v[:, self.column] = np.gradient(x, 1 / RATE_HZ)
        a[:, self.column] = np.gradient(v[:, self.column], 1 / RATE_HZ)
        return robot.on_links(robot.motion(places, v, a, at), model.link_parameters, effects=model.effects)

    def to_and_fro(self, speed: float, bottom: float | None = None, top: float | None = None) -> Array:
        """At one speed, with rounded turns, through the data's range if none is given."""
        bottom, top = self.low if bottom is None else bottom, self.high if top is None else top
        half = max(top - bottom, 1e-6) / speed
        x = np.interp((TIME / half) % 2.0, [0.0, 1.0, 2.0], [bottom, top, bottom])
        kernel = np.hanning(7) / np.hanning(7).sum()
        return np.convolve(np.pad(x, 3, mode="edge"), kernel, mode="valid")


def experiments(search: Search, joint: str) -> Iterator[tuple[str, Motion]]:
    """Motions of one joint, each as a sentence and as samples; the others rest where they were on average.

    Positions and speeds stay within those of the data, but for the last, which says so.
    """
    moves, segments = _Moves(search, joint), search.regression.segments
    slow, medium = SLOW * moves.fastest, MEDIUM * moves.fastest
    yield (
        f"{moves.unit.move.capitalize()} {joint} slowly, at {slow:.2g} {moves.unit.speed}, to and fro with the other joints at rest",
        moves.motion(moves.to_and_fro(slow)),
    )
    part = len(TIME) // 5
    steps = [moves.to_and_fro(s)[:part] for s in np.geomspace(slow, moves.fastest, 5)]
    yield (
        f"Run {joint} to and fro at five constant speeds from {slow:.2g} to {moves.fastest:.2g} {moves.unit.speed}, the other "
        "joints at rest",
        moves.motion(np.concatenate(steps)),
    )
    yield (
        f"Let {joint} swing by {SMALL:g} {moves.unit.position} twice a second, the other joints at rest: all of it is reversal",
        moves.motion(moves.rest[moves.column] + SMALL * np.sin(4 * np.pi * TIME)),
    )
    size = min(0.5 * (moves.high - moves.low), medium / (2 * np.pi * 0.2))
    hz = np.repeat([0.2, 0.5, 1.0, 2.0], len(TIME) // 4)
    swing = (moves.low + moves.high) / 2 + size * 0.2 / hz * np.sin(2 * np.pi * hz * TIME[: len(hz)])
    yield (
        f"Swing {joint} at 0.2, 0.5, 1 and 2 Hz with the same largest speed, {2 * np.pi * 0.2 * size:.2g} {moves.unit.speed}, "
        "the other joints at rest: speed stays, acceleration changes",
        moves.motion(swing, at=TIME[: len(hz)]),
    )
    load = np.concatenate([np.abs(s.motion.on_tree.load()[:, moves.column]) for s in segments])
    placed = np.concatenate([s.motion.q for s in segments])
    poses = np.where((TIME < SECONDS / 2)[:, None], placed[load.argmin()], placed[load.argmax()])
    yield (
        f"Run {joint} to and fro at {medium:.2g} {moves.unit.speed} twice, once with the other joints where it carries the "
        "least and once where it carries the most: speed stays, load changes",
        moves.motion(moves.to_and_fro(medium), poses),
    )
    yield (
        f"Repeat one motion of {joint} from a cold start for ten minutes: motion stays, temperature changes",
        moves.motion(moves.to_and_fro(medium), at=TIME + LATER_S * np.floor(3 * TIME / SECONDS)),
    )
    yield from _wider(moves, medium)


def _wider(moves: _Moves, medium: float) -> Iterator[tuple[str, Motion]]:
    """Through more of the joint's range than the data have, where there is much more."""
    model = moves.search.regression.robot.model
    bottom, top, fastest = (
        float(x[moves.column]) for x in (model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit)
    )
    if not (np.isfinite(top - bottom) and 0.9 * (top - bottom) > WIDER * (moves.high - moves.low)):
        return
    middle, reach, limit = (bottom + top) / 2, 0.45 * (top - bottom), 0.5 * fastest
    # there and back once, unless the joint is not that fast
    speed = max(medium, min(4 * reach / SECONDS, limit if limit > 0 else np.inf))
    unit = moves.unit
    yield (
        f"{unit.move.capitalize()} {moves.joint} at {speed:.2g} {unit.speed} through more of its range than so far, "
        f"{middle - reach:.2f} to {middle + reach:.2f} {unit.position} if nothing is in the way, the other joints at rest",
        moves.motion(moves.to_and_fro(speed, middle - reach, middle + reach)),
    )
