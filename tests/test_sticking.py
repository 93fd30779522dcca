"""Drives that stick at a reversal: told from the logged angle, and nothing of it is given a name.

Angles are written down here, or come from a mass under dry friction that stops and breaks away as a switch does (D. Karnopp, 1985),
which is no form of the package.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90b_flex.signals.sticking import held_part, sticks

Array = NDArray[np.float64]

RATE = 500.0
TIME = np.arange(int(4.0 * RATE)) / RATE


def swing(stand_s: float, noise: float = 0.0) -> Array:
    """An angle of 0.4 rad at 0.5 Hz that stands for some time at each turn, the first after half a second; rad."""
    turn = np.floor((TIME - 0.5) / (1.0 + stand_s))
    since = TIME - 0.5 - turn * (1.0 + stand_s)
    phase = 0.5 + turn + np.maximum(since - stand_s, 0.0)
    phase[turn < 0] = TIME[turn < 0]
    return 0.4 * np.sin(np.pi * phase) + noise * np.random.default_rng(5).standard_normal(len(TIME))


@pytest.mark.parametrize("stand_s", [0.03, 0.1, 0.2])
@pytest.mark.parametrize("noise", [0.0, 1e-7, 1e-6])
def test_a_stick_is_as_long_as_the_drive_stood(stand_s: float, noise: float) -> None:
    found = sticks(swing(stand_s, noise), RATE)
    turns = int((4.0 - 0.5) / (1.0 + stand_s)) + 1
    assert len(found) in (turns - 1, turns)  # the last one may be too near the end
    for begin, end, *_ in found:
        assert (end - begin) / RATE == pytest.approx(stand_s, abs=0.012)
    assert found[0][0] / RATE == pytest.approx(0.5, abs=0.012)
    assert [after for *_, after in found] == [-1.0, 1.0, -1.0, 1.0][
        : len(found)
    ]  # down after the first turn, up after the next


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-5, 1e-4])
def test_a_steady_reversal_is_no_stick(noise: float) -> None:
    assert sticks(swing(0.0, noise), RATE) == []


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_a_drive_that_pauses_on_its_way_holds_what_it_held(noise: float) -> None:
    q = 0.3 * TIME - 0.15 * np.sin(2.0 * TIME)  # slow at 0.942 rad
    q += noise * np.random.default_rng(3).standard_normal(len(TIME))
    assert sticks(q, RATE) == []
    standing = (q > 0.9415) & (
        q < 0.9435
    )  # it stops, and goes on when the motion that it was to follow is 2 mrad ahead
    q[standing] = q[standing][0]
    rest = np.flatnonzero(standing)
    q[rest[-1] + 1 : rest[-1] + 40] = np.linspace(q[rest[-1]], q[rest[-1] + 40], 40)[1:]
    ((begin, end, before, after),) = sticks(q, RATE)
    assert (before, after) == (1.0, 1.0)
    assert abs(begin - rest[0]) < 5 and abs(end - rest[-1]) < 5
    part = held_part(q[:, None], np.zeros((len(q), 1)), RATE)
    assert part is not None and (part[begin:end] == 1.0).all()


def test_a_rest_and_a_joint_that_never_moves_are_no_sticks() -> None:
    assert sticks(swing(0.7), RATE) == []
    assert sticks(np.zeros(500), RATE) == []
    assert sticks(1e-6 * np.random.default_rng(1).standard_normal(5000), RATE) == []
    assert sticks(np.zeros(2), RATE) == []


def test_what_is_held_goes_over_where_the_torque_does_and_not_where_it_turns_at_once() -> None:
    q = swing(0.1)
    found = sticks(q, RATE)[:3]
    rest = np.concatenate([np.arange(b, e) for b, e, *_ in found])
    even, at_once = np.sign(np.gradient(q)), np.sign(np.gradient(q))
    for begin, end, _, after in found:
        even[begin - 3 : end + 3] = after * np.clip(np.linspace(-1.06, 1.06, end - begin + 6), -1.0, 1.0)
        middle = (begin + end) // 2
        at_once[begin - 3 : middle], at_once[middle : end + 3] = -after, after
    part = held_part(np.stack([q, q], axis=1), np.stack([3.0 * even, 3.0 * at_once], axis=1), RATE)
    assert part is not None
    assert set(rest) <= set(np.flatnonzero(~np.isnan(part[:, 0])))
    assert np.abs(part[rest, 0] - even[rest]).max() < 0.1
    assert np.isnan(part[rest, 1]).all()
    smooth = swing(0.0)[:, None]
    assert held_part(smooth, np.sign(np.gradient(smooth, axis=0)), RATE) is None
