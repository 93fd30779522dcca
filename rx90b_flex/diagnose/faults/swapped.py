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
        before = list(getattr(look.reading, name))
        for i, j in combinations(range(n), 2):
            after = before.copy()
            after[i], after[j] = before[j], before[i]
            yield _of(look, (name,), tuple(after))
        for step in (1, -1) if n > 2 else ():
            yield _of(look, (name,), tuple(before[(k + step) % n] for k in range(n)))
    both = list(look.reading.order)
    if both == list(look.reading.torque_order):
        for i, j in combinations(range(n), 2):
            after = both.copy()
            after[i], after[j] = both[j], both[i]
            yield _of(look, tuple(KEYS), tuple(after))


def _of(look: Look, names: tuple[str, ...], order: tuple[int, ...]) -> Hypothesis:
    joints = look.sample.joints
    before = getattr(look.reading, names[0])
    moved = tuple(joints[k] for k in range(len(joints)) if order[k] != before[k])
    signal = KEYS[names[0]] if len(names) == 1 else "all"
    what = "torque" if signal == "torque" else "position" if signal == "motor_position" else "position and torque"
    fits = ", ".join(
        f"{joints[k]}'s in that of {joints[order[k]]}" for k in range(len(joints)) if order[k] != before[k]
    )
    return Hypothesis(
        "swapped_columns",
        signal,
        moved,
        look.reading.with_entries(dict.fromkeys(names, order)),
        f"The {what} columns of {', '.join(moved)} are exchanged ({fits}): put them in the order of `joints`.",
    )
