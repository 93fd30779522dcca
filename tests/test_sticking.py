"""Drives that stick at a reversal: told from the logged angle, and nothing of it is given a name.

Angles are written down here, or come from a mass under dry friction that stops and breaks away as a switch does (D. Karnopp, 1985),
which is no form of the package.
"""

from __future__ import annotations

import numpy as np
import pytest
from independent import TWO_JOINTS
from numpy.typing import NDArray

from rx90b_flex.effects.motion import STICKS
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording
from rx90b_flex.signals.sticking import LONGEST_S, held_part, sticks

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
def test_a_drive_that_pauses_on_its_way_holds_less_and_less_and_then_more_and_more(noise: float) -> None:
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
    part = held_part(q[:, None], RATE)
    assert part is not None and part[begin] == part[end - 1] == 1.0
    held, way = part[begin:end, 0], np.abs(np.linspace(-1.0, 1.0, end - begin))
    assert held.min() == pytest.approx(1.0 - 2.0 * ((end - begin) / RATE / LONGEST_S) ** 2, abs=0.05)
    assert np.array_equal(np.sign(np.diff(held)), np.sign(np.diff(way)))


def test_a_rest_and_a_joint_that_never_moves_are_no_sticks() -> None:
    assert sticks(swing(0.7), RATE) == []
    assert sticks(np.zeros(500), RATE) == []
    assert sticks(1e-6 * np.random.default_rng(1).standard_normal(5000), RATE) == []
    assert sticks(np.zeros(2), RATE) == []


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("two")
    (folder / "two.urdf").write_text(TWO_JOINTS)
    return load_robot(folder / "two.urdf")


def fitted(robot: Robot, q: Array, dry: Array) -> Regression:
    """A log of both joints, whose dry friction is 3 N m times `dry`."""
    v, a = np.gradient(q, 1 / RATE, axis=0), np.gradient(np.gradient(q, 1 / RATE, axis=0), 1 / RATE, axis=0)
    torque = np.array([robot.rigid().inverse_dynamics(*row) for row in zip(q, v, a, strict=True)]) + 3.0 * dry
    torque += 0.05 * np.random.default_rng(2).standard_normal(torque.shape)
    recording = Recording(
        name="run",
        role="identification",
        time=TIME,
        sample_rate_hz=RATE,
        joints=robot.joints,
        position=q,
        torque=torque,
    )
    return Regression.of(robot, [recording], 20.0)


@pytest.mark.parametrize("held", ["first", "second", "both", "none"])
def test_joints_are_told_whose_friction_goes_over_in_sticks(robot: Robot, held: str) -> None:
    """The other's is away as long as its drive stands still, which is how a simulated sign or an unloaded drive looks."""
    q = np.stack([swing(0.1, 1e-6), swing(0.15, 1e-6)], axis=1)
    part = held_part(q, RATE)
    assert part is not None
    there = {"first": [True, False], "second": [False, True], "both": [True, True], "none": [False, False]}[held]
    dry = np.where(np.isnan(part), np.sign(np.gradient(q, axis=0)), np.where(there, part, 0.0))
    of_joints = zip(robot.joints, there, strict=True)  # pauses, of which this log has none, go with the turns
    told = tuple((j, where) for j, sticks_too in of_joints if sticks_too for where in STICKS)
    assert fitted(robot, q, dry).sticking == told


@pytest.mark.parametrize("holds", [True, False])
def test_what_a_drive_holds_in_a_pause_is_asked_beside_its_turns(robot: Robot, holds: bool) -> None:
    paused = np.zeros(len(TIME), dtype=bool)
    paused[520:580] = paused[1130:1190] = True  # 0.12 s on the way, twice
    one = swing(0.1)[np.cumsum(~paused) - 1]
    q = np.stack([one, one], axis=1) + 1e-6 * np.random.default_rng(4).standard_normal((len(TIME), 2))
    part = held_part(q, RATE)
    assert part is not None and not np.isnan(part[paused]).mean() > 0.1
    dry = np.where(np.isnan(part), np.sign(np.gradient(q, axis=0)), part)
    if not holds:
        dry[paused] = 0.0
    told = tuple((j, where) for j in robot.joints for where in (STICKS if holds else STICKS[:1]))
    assert fitted(robot, q, dry).sticking == told
