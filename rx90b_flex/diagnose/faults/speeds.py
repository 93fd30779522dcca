"""Logged velocities that are not the rates of the logged positions: another unit, another sign, another joint's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.signals import Recording
from rx90b_flex.signals.data_fault import DataFault

SMOOTHED_S = 0.1  # mean rates over so long are compared: noise of single steps of a counter is none of theirs
ALIKE = 0.9  # correlation from which on a velocity is a rate
OFF = 0.2  # of the factor, below which filters of a drive may make it
NEAR = 0.05  # and within which it is that of a unit
SIGNAL, CURE = "motor_velocity", "`motor_velocity`, or leave velocities out, for rates of positions serve as well"
UNITS = {"deg/s": 180 / np.pi, "turns a minute": 30 / np.pi, "turns a second": 0.5 / np.pi, "mm/s": 1e3}


def speeds(recordings: Sequence[Recording], known: Sequence[DataFault] = ()) -> Iterator[DataFault]:
    """Of each joint whose velocity is logged and no rate of its position, where no known fault is one of positions or time."""
    logged = [r for r in recordings if r.velocity is not None]
    if not logged or any(f.kind == "sample_rate" or f.signal in ("motor_position", "all") for f in known):
        return
    pairs = [_mean_rates(r) for r in logged]
    rate, velocity = (np.concatenate(x) for x in zip(*pairs, strict=True))
    likeness, joints = _correlation(velocity, rate), logged[0].joints
    scaled: dict[str, dict[str, float]] = {}
    for j, joint in enumerate(joints):
        factor = float(velocity[:, j] @ rate[:, j] / max(rate[:, j] @ rate[:, j], 1e-300))
        like = [k for k in np.flatnonzero(np.abs(likeness[j]) > ALIKE) if k != j]
        if abs(likeness[j, j]) > ALIKE:
            if abs(factor - 1.0) > OFF:
                scaled.setdefault(_what(factor), {})[joint] = factor
        elif len(like) == 1 and not (like[0] < j and abs(likeness[like[0], j]) > ALIKE):  # of a pair once
            message = f"The velocity of {joint} is the rate of {joints[like[0]]}'s position: exchange their columns in {CURE}."
            yield DataFault("swapped_columns", SIGNAL, (joint, joints[like[0]]), message, usable=True)
    for what, of in scaled.items():
        message = f"The velocity of {', '.join(of)} {what} the rate of its position: correct {CURE}."
        factor = float(np.mean(list(of.values())))
        kind = "reversed_sign" if abs(factor + 1.0) < OFF else "unit"
        yield DataFault(kind, SIGNAL, tuple(of), message, usable=True, factor=factor)


def _what(factor: float) -> str:
    """What a velocity that is so many times a rate is, before the words for that."""
    if abs(factor + 1.0) < OFF:
        return "has the other sign than"
    unit = next((unit for unit, times in UNITS.items() if abs(abs(factor) / times - 1.0) < NEAR), None)
    return f"is {factor:.3g} times" + (f" (as in {unit}; rad/s or m/s are expected)" if unit else "")


def _mean_rates(recording: Recording) -> tuple[Array, Array]:
    """Of positions and of velocities, over parts of the time, (parts, n)."""
    assert recording.velocity is not None
    length = max(2, round(SMOOTHED_S * recording.sample_rate_hz))
    parts = recording.samples // length
    ends = recording.position[: parts * length + 1 : length]
    rate = np.diff(ends, axis=0) / length * recording.sample_rate_hz
    velocity = recording.velocity[: len(rate) * length].reshape(len(rate), length, -1).mean(axis=1)
    return rate, velocity


def _correlation(velocity: Array, rate: Array) -> Array:
    """Of each joint's velocity with each one's rate, (n, n); zero where either is."""
    size = np.outer(np.linalg.norm(velocity, axis=0), np.linalg.norm(rate, axis=0))
    return np.asarray(velocity.T @ rate / np.where(size > 0.0, size, np.inf))
