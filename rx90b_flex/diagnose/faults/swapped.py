"""Columns that stand under other joints' names."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from rx90b_flex.diagnose.faults.look import Hypothesis, Look

KEYS = {"torque_order": "torque", "order": "motor_position"}


def swapped(look: Look) -> Iterator[Hypothesis]:
    """Torque columns of two joints exchanged, or all moved on by one; the same of positions, and of both together."""
    n = len(look.sample.joints)
    for name in KEYS:
        before = getattr(look.reading, name)
        yield from (_of(look, (name,), order) for order in _exchanged(before))
        for step in (1, -1) if n > 2 else ():
            yield _of(look, (name,), tuple(before[(k + step) % n] for k in range(n)))
    both = look.reading.order
    if both == look.reading.torque_order:
        yield from (_of(look, tuple(KEYS), order) for order in _exchanged(both))


def _exchanged(order: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """With two places exchanged, each two in turn."""
    for i, j in combinations(range(len(order)), 2):
        after = list(order)
        after[i], after[j] = order[j], order[i]
        yield tuple(after)


def _of(look: Look, names: tuple[str, ...], order: tuple[int, ...]) -> Hypothesis:
    joints = look.sample.joints
    before = getattr(look.reading, names[0])
    moved = {joints[k]: joints[order[k]] for k in range(len(joints)) if order[k] != before[k]}
    signal = KEYS[names[0]] if len(names) == 1 else "all"
    what = {"torque": "torque", "motor_position": "position", "all": "position and torque"}[signal]
    fits = ", ".join(f"{joint}'s in that of {other}" for joint, other in moved.items())
    text = f"The {what} columns of {', '.join(moved)} are exchanged ({fits}): put them in the order of `joints`."
    reading = look.reading.with_entries(dict.fromkeys(names, order))
    return Hypothesis.of("swapped_columns", signal, tuple(moved), text, reading)
