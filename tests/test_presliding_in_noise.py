"""Hysteresis along less than the noise of an angle: what nobody can tell is not named."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex import signals
from rx90b_flex.compiled.signals import dahl, maxwell
from rx90b_flex.diagnose.trial import added
from rx90b_flex.effects import Effect, Sites, effect_from_table
from rx90b_flex.effects.hints import LeftOver
from rx90b_flex.effects.maxwell_slip import MaxwellSlipFriction
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.presliding import PreslidingFriction
from rx90b_flex.effects.reversal import Resolution, last_direction
from rx90b_flex.identify.segment import prepare
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording

RATE_HZ, CUTOFF_HZ, SECONDS = 250.0, 20.0, 12.0


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("rx90b").rigid().restricted(["joint_1"])


def angle(rest: str) -> Array:
    """Two moves; between them the joint stands still, or creeps by ten times the noise."""
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    stop = (time > 4.0) & (time < 8.0)
    phase = np.clip(time, 0.0, 4.0) + np.clip(time - 8.0, 0.0, None)
    q = 0.5 * np.sin(np.pi * phase / 4.0) ** 2
    return q + (1e-5 * ((time - 4.0) / 4.0) ** 2 * stop if rest == "creeps" else 0.0)


def motion(robot: Robot, noise: float, seed: int, rest: str = "stands") -> Motion:
    clean = angle(rest)
    return moving(robot, clean + noise * np.random.default_rng(seed).normal(size=len(clean)))


def moving(robot: Robot, angles: Array) -> Motion:
    log = Recording(
        name="run",
        role="identification",
        time=np.arange(len(angles)) / RATE_HZ,
        sample_rate_hz=RATE_HZ,
        joints=("joint_1",),
        position=angles[:, None],
        torque=np.ones((len(angles), 1)),
    )
    return prepare(robot, log, CUTOFF_HZ).motion


@pytest.mark.parametrize("noise", [1e-6, 1e-5])
def test_at_rest_noise_takes_an_angle_along_some_of_its_deviations(robot: Robot, noise: float) -> None:
    for seed in range(5):
        moved = motion(robot, noise, seed)
        assert moved.angle_noise is not None  # what the low-pass leaves of it
        kept = float(moved.angle_noise[0])
        assert kept < noise and 3.0 * kept < Resolution.of(moved.joint("joint_1")).wander < 9.0 * kept


def test_what_creeps_is_no_noise(robot: Robot) -> None:
    stands, creeps = (
        Resolution.of(motion(robot, 1e-6, 0, rest).joint("joint_1")).wander for rest in ("stands", "creeps")
    )
    assert creeps < 1.5 * stands


@pytest.mark.parametrize("kind", ["one element", "two"])
def test_hysteresis_along_less_has_no_name_and_along_more_has_one(robot: Robot, kind: str) -> None:
    moved = motion(robot, 1e-6, 1)
    wander = Resolution.of(moved.joint("joint_1")).wander
    for times, named in ((1.0, False), (3.0, True), (100.0, True)):
        deflection = times * wander
        effect = (
            PreslidingFriction(joint="joint_1", torque=2.0, deflection=deflection)
            if kind == "one element"
            else MaxwellSlipFriction(joint="joint_1", torques=(1.0, 1.0), deflections=(0.3 * deflection, deflection))
        )
        why = effect.too_small(0.5, 1.0 / RATE_HZ, moved)
        assert (why == "") == named and (named or "noise" in why)


def test_a_slow_move_counts_as_the_last_one_where_it_goes_beyond_noise(robot: Robot) -> None:
    """A joint that comes to rest a little beyond where it stops has moved back last, however slowly."""
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    for back, last in ((2e-4, -1.0), (1e-6, 1.0)):  # further than noise takes it, and not as far
        rise = 0.5 * (1.0 - np.cos(np.pi * np.clip(time / 4.0, 0.0, 1.0)))
        return_ = 0.5 * (1.0 - np.cos(np.pi * np.clip((time - 4.2) / 2.0, 0.0, 1.0)))
        q = rise - back * return_ + 1e-6 * np.random.default_rng(3).normal(size=len(time))
        at = moving(robot, q).joint("joint_1")
        assert (np.abs(at.v[time > 4.2]) < 1e-3 * np.abs(at.v).max()).all()
        assert (last_direction(at)[time > 6.5] == last).all()


@pytest.mark.parametrize("noise", [0.0, 1e-8, 1e-6])
def test_what_creeps_back_less_than_friction_needs_to_turn_is_no_move_however_little_noise_there_is(
    robot: Robot, noise: float
) -> None:
    """A joint that settles: 1e-4 of its travel back after an overshoot counts, the 3e-6 that it creeps after that do not."""
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ

    def move(begin: float, length: float) -> Array:
        return 0.5 * (1.0 - np.cos(np.pi * np.clip((time - begin) / length, 0.0, 1.0)))

    q = move(0.0, 4.0) - 1e-4 * move(4.0, 0.5) + 3e-6 * move(6.0, 3.0)
    at = moving(robot, q + noise * np.random.default_rng(3).normal(size=len(time))).joint("joint_1")
    assert (last_direction(at)[time > 5.0] == -1.0).all()


@pytest.mark.parametrize("ratio", [2.0, 4.0, 15.0])
def test_two_elements_are_searched_near_those_that_one_smooth_one_stands_for(robot: Robot, ratio: float) -> None:
    """Whatever their ratio, a start lies near enough for steps to lead there."""
    moved = motion(robot, 1e-6, 1)
    pair = 1e-3 * np.array([1.0, ratio])
    at = moved.joint("joint_1")
    true = MaxwellSlipFriction(joint="joint_1", torques=(0.6, 0.4), deflections=tuple(pair))
    torque = true.basis(at) @ [0.6, 0.4]

    def left(effect: PreslidingFriction | MaxwellSlipFriction) -> float:
        basis = effect.basis(at)
        return float(np.sum((torque - basis @ np.linalg.lstsq(basis, torque, rcond=None)[0]) ** 2))

    smooth = [PreslidingFriction(joint="joint_1", torque=1.0, deflection=d) for d in 1e-3 * np.geomspace(0.5, 15.0, 60)]
    best = min(smooth, key=left)
    starts = true.shape_search(moved, LeftOver((), instead_of=best)).starts
    assert min(left(true.with_shape(start)) for start in starts) < 0.5 * left(best)


def test_a_third_element_is_searched_beside_two_and_takes_their_place(robot: Robot) -> None:
    moved = motion(robot, 1e-6, 1)
    at = moved.joint("joint_1")
    two = MaxwellSlipFriction(joint="joint_1", torques=(0.6, 0.4), deflections=(1e-3, 4e-3))
    torque = two.basis(at) @ [0.6, 0.4] + 0.2 * PreslidingFriction(joint="joint_1", deflection=0.03).basis(at)[:, 0]
    sites = Sites(robot.joints, robot.tip_frame)
    (more,) = (e for e in MaxwellSlipFriction.everywhere(sites) if len(e.shape_parameters) == 3)
    assert added([two], more) == (more,)

    def left(effect: Effect) -> float:
        basis = effect.columns(moved)[:, 0]
        return float(np.sum((torque - basis @ np.linalg.lstsq(basis, torque, rcond=None)[0]) ** 2))

    starts = more.shape_search(moved, LeftOver((), instead_of=two)).starts
    assert min(left(more.with_shape(start)) for start in starts) < 0.5 * left(two)


@pytest.mark.parametrize("declared", [1, 3, 4])
def test_beside_another_number_of_elements_the_search_still_has_its_starts(robot: Robot, declared: int) -> None:
    """A robot file may have any number, such as the three that an earlier search found."""
    moved = motion(robot, 1e-6, 1)
    known = MaxwellSlipFriction(
        joint="joint_1", torques=(1.0,) * declared, deflections=tuple(1e-3 * 3.0 ** np.arange(declared))
    )
    for effect in MaxwellSlipFriction.everywhere(Sites(robot.joints, robot.tip_frame)):
        starts = effect.shape_search(moved, LeftOver((), instead_of=known)).starts
        assert len(starts) > 1 and starts.shape[1] == len(effect.shape_parameters)


@pytest.mark.parametrize("law", [dahl, maxwell])
@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_where_a_log_begins_at_rest_noise_does_not_say_how_friction_stands(law, towards: float) -> None:
    """It stands as after a move towards where the joint goes first, whatever noise does before, and however often it is sampled."""
    clean = towards * np.concatenate([np.zeros(400), angle("stands")])
    begun = law(clean, 1e-3)
    for seed in range(10):
        noisy = clean + 1e-9 * np.random.default_rng(seed).normal(size=len(clean))
        for found, known in ((law(noisy, 1e-3), begun), (law(noisy[::2], 1e-3), begun[::2])):
            np.testing.assert_allclose(found, known, atol=0.01)
        assert begun[0] == towards
    # one that only stands never goes as far: its friction stays where it stands
    standing = 1e-9 * np.random.default_rng(0).normal(size=400)
    assert np.ptp(law(standing, 1e-3)) < 0.01 and abs(law(standing, 1e-3)[0]) == 1.0


def test_a_motion_with_times_holds_at_rest_what_it_last_overcame_and_wrong_times_are_refused(robot: Robot) -> None:
    """Dry friction of a joint that moves to and fro, and rests for four seconds on its way back."""
    table = {"type": "held_friction", "joint": "joint_1", "torque": 2.0}
    links, held = (robot.with_effects(e) for e in ([], [effect_from_table(table, "", robot.joints)]))
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    q, v, a = (np.asarray(x) for x in signals.motion(angle("stands")[:, None], RATE_HZ))
    rest = (time > 4.2) & (time < 7.8)
    v[rest] = a[rest] = 0.0
    alone = links.inverse_dynamics(q, v, a)
    np.testing.assert_array_equal(held.inverse_dynamics(q, v, a), alone)
    np.testing.assert_allclose((held.inverse_dynamics(q, v, a, time) - alone)[rest], -2.0)
    for wrong in (time[:-1], time[::-1], np.zeros_like(time)):
        with pytest.raises(ValueError, match=r"time has shape .*; expected \(3000,\), increasing"):
            held.inverse_dynamics(q, v, a, wrong)
