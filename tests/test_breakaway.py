"""Claims about joints that have stood for long: what friction has more of until a joint has slid is found, and only there."""

from __future__ import annotations

from pathlib import Path

import independent as ind
import numpy as np
import pytest
from real_loops import kr300_closed
from test_first_moves import COULOMB, CUTOFF_HZ, DECLARED, NOISE, RATE_HZ, STRIBECK, VISCOUS, dry, started

import rx90b_flex as rf
from rx90b_flex.effects import Sites, effect_from_table
from rx90b_flex.effects.breakaway import BreakawayFriction

RAMP_S = 2.0  # of a first move
STOOD_S = 4 * 3600.0  # for how long joints have stood
SLIP = np.array([0.004, 0.006])  # rad, along which contacts are renewed
GROWS = np.array([0.12, 0.08])  # N m a factor of e in age
YOUNG_S = 0.5  # age of contacts that counts for nothing


def aging(held: ind.Array, *, stood_s: float = STOOD_S) -> ind.Torque:
    """Friction that grows with the logarithm of the age of its contacts, which sliding renews (Dieterich 1979, Ruina's form of it);
    before the first move it holds a part of its own.
    """

    def torque(m: ind.Motion, load: ind.Array) -> ind.Array:
        age, ages, step = np.full(2, stood_s), np.empty_like(m.q), m.time[1] - m.time[0]
        for k, v in enumerate(np.abs(m.v)):
            # exact for a constant speed: d age / dt = 1 - |v| age / slip
            part = np.exp(-v * step / SLIP)
            age = np.where(v > 0, SLIP / np.maximum(v, 1e-12) * (1 - part) + age * part, age + step)
            ages[k] = age
        size = COULOMB + GROWS * np.log1p(ages / YOUNG_S)
        sign = np.where(np.cumsum(np.abs(m.v), axis=0) == 0, held, np.sign(m.v))
        return size * sign

    return torque


def closed(
    folder: Path, seed: int, roles: tuple[str, ...], *, stood_s: float = STOOD_S, hidden: tuple = ()
) -> rf.ClosedLoop:
    arm, rng, runs = ind.two_joints(folder), np.random.default_rng(seed), []
    for role in roles:
        m, wait = started(rng, RAMP_S)
        friction = aging(rng.uniform(-0.5, 0.5, 2), stood_s=stood_s) if stood_s else dry(rng, wait)
        torques = [ind.friction((0.0, 0.0), VISCOUS), friction, *(ind.hidden(*h) for h in hidden)]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE)))
    result = rf.close_loop(ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ))
    assert isinstance(result, rf.ClosedLoop)
    return result


THREE, TWO = ("identification", "identification", "validation"), ("identification", "validation")
SEEDS = [11, pytest.param(12, marks=pytest.mark.slow), pytest.param(13, marks=pytest.mark.long)]


@pytest.mark.parametrize("seed", SEEDS)
def test_friction_of_contacts_that_have_aged_is_found_on_both_joints_and_nothing_else(tmp_path, seed):
    result = closed(tmp_path, seed, THREE)
    assert {e.effect.label for e in result.effects} == {"shoulder.breakaway_friction", "elbow.breakaway_friction"}
    before, after = result.before.told.validation, result.after.told.validation
    assert after.relative_error < 0.3 * before.relative_error
    # what it grew by while the joints stood
    for e, grows in zip(sorted(result.effects, key=lambda e: e.effect.label, reverse=True), GROWS, strict=True):
        assert e.effect.known_coefficients()[0] == pytest.approx(grows * np.log1p(STOOD_S / YOUNG_S), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_joints_that_break_away_at_what_slides_get_no_name_for_it(tmp_path, seed):
    result = closed(tmp_path, seed, THREE, stood_s=0.0, hidden=(STRIBECK,))
    assert {e.effect.label for e in result.effects} == {"elbow.stribeck_friction"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_single_start_gets_no_name_and_is_told(tmp_path, seed):
    result = closed(tmp_path, seed, TWO)
    assert not result.effects
    assert result.verdict == "unexplained"
    for joint in ("shoulder", "elbow"):
        assert any(f"{joint}.breakaway_friction" in c and "too seldom" in c for c in result.cautions)


def test_single_starts_of_sound_joints_are_not_told(tmp_path):
    result = closed(tmp_path, 11, TWO, stood_s=0.0)
    assert result.verdict == "nothing_missing"
    assert not any("too seldom" in c for c in result.cautions)


def test_it_is_tried_where_several_logs_begin_at_rest(tmp_path):
    robot = rf.load_robot(ind.write_robot(tmp_path, ind.two_joints(tmp_path), DECLARED, known=True))
    waiting, _ = started(np.random.default_rng(0))
    moving = ind.harmonics(np.random.default_rng(1), 2, period_s=20.0, rate_hz=RATE_HZ)
    moving = ind.Motion(moving.time, moving.q, moving.v + 0.1 * np.abs(moving.v).max(axis=0), moving.a)
    logs = [robot.motion(m.q, m.v, m.a, m.time) for m in (waiting, moving, waiting)]
    tried = [
        [e.joint for e in BreakawayFriction.everywhere(Sites(robot.joints, robot.tip_frame, tuple(some)))]
        for some in (logs, logs[:2], logs[1:])
    ]
    assert tried == [["shoulder", "elbow"], [], []]
    effect = BreakawayFriction(joint="elbow", torque=1.0, distance=0.01)
    assert not effect.force(logs[1]).any()


def test_a_law_steps_as_its_columns_say(tmp_path):
    robot = rf.load_robot(ind.write_robot(tmp_path, ind.two_joints(tmp_path), DECLARED, known=True))
    m, wait = started(np.random.default_rng(2), RAMP_S)
    effect = effect_from_table(
        {"type": "breakaway_friction", "joint": "elbow", "torque": 2.0, "distance": 0.05}, "", ["shoulder", "elbow"]
    )
    moving = robot.motion(m.q, m.v, m.a, m.time)
    memory, stepped = effect.memory(moving.part(slice(0, 1))), []
    for k in range(len(m.q)):
        at = moving.part(slice(k, k + 1))
        stepped.append(effect.remembered(memory, at)[0][0, 1])
        memory = effect.onward(memory, at)
    moved = np.abs(m.q[:, 1] - m.q[0, 1]) > 0.03 * 0.05 * 10
    later = np.flatnonzero(moved)[0]  # whatever its sign was before the first move
    assert effect.force(moving)[later:, 1] == pytest.approx(np.array(stepped)[later:], abs=2e-4)
    assert np.abs(stepped[later:]).max() > 1.0
    assert m.time[later] > wait[1]


@pytest.mark.slow
@pytest.mark.xdist_group("kr300_encoders")
@pytest.mark.parametrize("recordings", ["AC", pytest.param("ABC", marks=pytest.mark.long)])
def test_each_recording_of_a_real_robot_tells_how_the_others_break_away(recordings):
    """Axes 2 and 3 of a KR300, whichever of its three recordings is held out."""
    found = []
    for held_out in recordings:
        result = kr300_closed(held_out)
        assert result.after.validation.relative_error < 0.55 * result.before.validation.relative_error
        assert result.moving.after < 0.75 * result.moving.before
        own = {e.effect.joints[0]: e.effect for e in result.effects if e.effect.type_name() == "breakaway_friction"}
        found.append([[own[j].torque, own[j].distance] for j in ("A2", "A3")])
    values = np.array(found)
    assert (values[..., 0].max(axis=0) < 1.3 * values[..., 0].min(axis=0)).all()  # N m
    assert (values[..., 1].max(axis=0) < 2.0 * values[..., 1].min(axis=0)).all()  # rad
