"""Samples that have nothing to do with their neighbours or drop out to zero, and angles that step."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy.ndimage import maximum_filter, median_filter

from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.signals import Recording
from rx90b_flex.signals.data_fault import DataFault

WINDOW = 5  # samples whose median a sample is held against
TIMES = 12.0  # the deviation that one sample in a hundred has
OF_TORQUE = 1.0  # of the range of the middle 99 %: friction that turns over, and noise, deviate by less
OF_POSITION = 0.02
EDGE = 0.8  # of that jump, from the sample before and to the one behind: a peak that others lead up to is the motion's
OF_FASTEST = 2.0  # of the fastest motion from a sample to the next: a step that is none of the motion
DROPPED_S = 0.02  # for which samples are lost at a time, or WINDOW of them
FROM_ZERO = 2.0  # of the step that one sample in a hundred has: noise and motion do not go to 0 and back so fast
DEAD_BAND = 0.25  # of the largest value: what is logged as 0 is not larger, in a torque that does not pass through 0
MILD = 5.0  # of the range of the middle 99 %: torques that noise of long tails has now and then
MILD_SHARE = 1e-3  # of a column's samples
FEW = 8  # steps that are larger than it at the most
BESIDE = [1, 1, 0, 1, 1]  # the steps that one is held against
TOGETHER = 0.25  # of the rows at which any joint steps, at which several do: else by chance
HELD = "the last sample before stands for lost ones; leave"
MISSING = "rows are missing; a time column tells how many, or leave"
TURNS = (2.0 * np.pi, 360.0)  # rad, degrees
OF_A_TURN, MUCH_OF_A_TURN = 0.02, 0.25  # that a joint moves beside within a sample that wraps round, and in any other
SHOWN = 20  # rows in a result
LABELS = {"torque": "torque", "position": "motor_position"}


def glitches(recordings: Sequence[Recording]) -> tuple[list[DataFault], list[Recording]]:
    """Faults, and the recordings with straight lines over the samples in question."""
    out, mended = [], []
    for logged in recordings:
        turned, recording = _turned(logged)
        out += turned
        changed: dict[str, Array] = {}
        for name, part in (("torque", OF_TORQUE), ("position", OF_POSITION)):
            values = getattr(recording, name)
            dropped = _dropped(values, max(WINDOW, round(DROPPED_S * recording.sample_rate_hz)))
            bad = _apart(values, part) | dropped
            if bad.any():
                changed[name] = _bridged(values, bad)
                out.append(_cells(recording, name, bad, dropped))
        out += _slips(recording)
        mended.append(dataclasses.replace(recording, **changed) if changed else recording)  # type: ignore[arg-type]
    return out, mended


def _cells(recording: Recording, name: str, bad: Mask, dropped: Mask) -> DataFault:
    """Wild cells of a recording; a few torques of a size that others nearly have do no harm to a fit."""
    values, rows = getattr(recording, name), np.flatnonzero(bad.any(axis=1)) + 1
    at = np.flatnonzero(bad.any(axis=0))
    joints = tuple(recording.joints[k] for k in at)
    counts = ", ".join(f"{recording.joints[k]} ({bad[:, k].sum()})" for k in at)
    low, high = np.quantile(values[:, at], [0.005, 0.995], axis=0)
    off = np.where(bad, np.abs(values - _bridged(values, bad)), 0.0)[:, at].max(axis=0)
    few = bad.sum(axis=0).max() <= max(1.0, MILD_SHARE * len(values))
    what = f"jump away from their neighbours (up to {np.abs(values[bad]).max():.4g})"
    zeros = "drop out to exactly 0"
    what = what if not dropped.any() else zeros if (bad == dropped).all() else f"{what} or {zeros}"
    message = (
        f"{recording.file_name}: {name} of {counts}: {len(rows)} row(s) {what}, row {_listed(map(str, rows))}: correct these cells, "
        "or leave the part out (start_s, end_s)."
    )
    usable = bool(name == "torque" and few and (off < MILD * (high - low)).all())
    return DataFault("glitch", LABELS[name], joints, message, usable, rows=tuple(rows[:SHOWN].tolist()))


def _listed(rows: Iterable[str]) -> str:
    """The first few."""
    every = list(rows)
    return ", ".join(every[:5]) + (" and others" if len(every) > 5 else "")


def _turned(recording: Recording) -> tuple[list[DataFault], Recording]:
    """Angles that wrap round by whole turns, and the recording with them unwrapped."""
    out, position = [], recording.position.copy()
    for k, joint in enumerate(recording.joints):
        step = np.diff(position[:, k])
        for turn in TURNS:
            wraps = np.abs(np.abs(step) - turn) < OF_A_TURN * turn
            if not wraps.any() or np.abs(step[~wraps]).max(initial=0.0) > MUCH_OF_A_TURN * turn:
                continue
            rows = np.flatnonzero(wraps) + 2
            shown = _listed(f"{row} by {step[row - 2]:.3g}" for row in rows)
            where = f"{recording.file_name}: position of {joint}"
            message = f"{where} wraps round by whole turns (row {shown}): unwrap it (numpy.unwrap)."
            out.append(DataFault("glitch", LABELS["position"], (joint,), message, rows=tuple(rows[:SHOWN].tolist())))
            position[1:, k] -= np.cumsum(np.where(wraps, np.sign(step) * turn, 0.0))
            break
    return out, dataclasses.replace(recording, position=position) if out else recording


def _slips(recording: Recording) -> Iterator[DataFault]:
    """Angles that step from one sample to the next and go on from there: an encoder that slips, or whose zero is set anew.

    Where several joints step at once, rows are missing, or the last one stands for them.
    """
    steps = {j: _steps(values) for j, values in zip(recording.joints, recording.position.T, strict=True)}
    steps = {joint: rows for joint, rows in steps.items() if len(rows)}
    rows, joints_there = np.unique(np.concatenate([[], *steps.values()]).astype(int), return_counts=True)
    together = rows[joints_there > 1]
    if len(together) > TOGETHER * len(rows):
        held = [i for i in together if i > 1 and not np.diff(recording.position[i - 2 : i + 1], axis=0).any()]
        lost = HELD if len(held) > TOGETHER * len(together) else MISSING
        message = (
            f"{recording.file_name}: positions of {', '.join(steps)} step at once and go on from there (row "
            f"{_listed(str(i + 2) for i in together)}): {lost} these parts out (start_s, end_s)."
        )
        yield DataFault("glitch", LABELS["position"], tuple(steps), message, rows=tuple((rows[:SHOWN] + 2).tolist()))
        return
    for joint, rows in steps.items():
        step = np.diff(recording.position[:, recording.joints.index(joint)])
        shown = _listed(f"{i + 2} by {step[i]:.3g}" for i in rows)
        message = (
            f"{recording.file_name}: position of {joint} steps and goes on from there (row {shown}): an encoder that slips, "
            "or a zero that was set anew; leave that part out (start_s, end_s)."
        )
        yield DataFault("glitch", LABELS["position"], (joint,), message, rows=tuple((rows[:SHOWN] + 2).tolist()))


def _steps(values: Array) -> Indices:
    """Samples (s,) behind which an angle (N,) steps and goes on from there."""
    step = np.diff(values)
    if len(step) < 4 * WINDOW:
        return np.zeros(0, dtype=np.intp)
    off = np.abs(step - median_filter(step, WINDOW, mode="nearest"))
    fastest = float(np.partition(np.abs(step), -FEW)[-FEW])
    limit = max(TIMES * np.quantile(off, 0.99), OF_FASTEST * fastest)
    # a joint that moves for a few samples of a slow log has others beside its fastest
    beside = maximum_filter(np.abs(step), footprint=BESIDE, mode="nearest")
    rows = np.flatnonzero((off > limit) & (off > OF_FASTEST * beside) & (limit > 0))
    # a single cell that is wrong steps there and back
    before, behind = values[np.maximum(rows - 2, 0)], values[np.minimum(rows + 3, len(step))]
    return rows[np.abs(behind - before) > 0.5 * limit]


def _apart(values: Array, part: float) -> Mask:
    """Samples far from the median of their neighbourhood, shape (N, joints)."""
    if len(values) < 4 * WINDOW:
        return np.zeros(values.shape, dtype=bool)
    off = np.abs(values - median_filter(values, (WINDOW, 1), mode="nearest"))
    low, high = np.quantile(values, [0.005, 0.995], axis=0)
    # a column that never moves has no range: the deviations that it does have are its measure
    limit = np.maximum(TIMES * np.quantile(off, 0.99, axis=0), part * (high - low))
    bad = np.asarray((off > limit) & (off > 1e-9 * (1.0 + np.abs(values).max(axis=0))) & (high > low))
    for k in np.flatnonzero(bad.any(axis=0)):
        steps = np.abs(np.diff(values[:, k], prepend=values[0, k], append=values[-1, k])) > EDGE * limit[k]
        at = np.flatnonzero(bad[:, k])
        for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
            first, last = run[0], run[-1] + 1
            bad[run, k] = (steps[first] or first == 0) and (steps[last] or last == len(values))
    return bad


def _dropped(values: Array, longest: int) -> Mask:
    """Samples that are exactly 0 in short runs, from and back to values of one sign far from it, shape (N, joints)."""
    bad = np.zeros(values.shape, dtype=bool)
    for k, x in enumerate(values.T):
        edges = np.flatnonzero(np.diff(x == 0.0))
        if x[0] == 0.0:
            edges = edges[1:]
        first, last = edges[: len(edges) // 2 * 2].reshape(-1, 2).T  # the samples before and at the end of each run
        before, behind = x[first], x[last + 1]
        back = before * behind > 0.0
        short = back & (last - first <= longest)
        if not short.any():
            continue
        # where what is small is logged as 0, or all in coarse steps, those beside are about the smallest that there are
        other = x[x != 0.0]
        smallest = np.abs(other).min()
        if back.all():
            smallest = min(smallest, DEAD_BAND * np.abs(other).max())
        limit = smallest + FROM_ZERO * np.quantile(np.abs(np.diff(other)), 0.99)
        for i in np.flatnonzero(short & (np.minimum(np.abs(before), np.abs(behind)) > limit)):
            bad[first[i] + 1 : last[i] + 1, k] = True
    return bad


def _bridged(values: Array, bad: Mask) -> Array:
    out = values.copy()
    at = np.arange(len(values))
    for k in np.flatnonzero(bad.any(axis=0)):
        good = ~bad[:, k]
        out[:, k] = np.interp(at, at[good], values[good, k])
    return out
