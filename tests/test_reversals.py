"""Claims about rows near reversals, where a log does not say how fast a joint turns, and about gains that come in bursts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rx90b_flex.diagnose.reversals import row_weights
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.trial import TorqueTrial
from rx90b_flex.effects import Sites
from rx90b_flex.effects.friction import CoulombFriction, ViscousFriction
from rx90b_flex.effects.presliding import PreslidingFriction
from rx90b_flex.effects.torque_gain import TorqueGain
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.physical import gains_again
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording

RATE_HZ, CUTOFF_HZ, DRY = 250.0, 20.0, 5.0
HARMONIC_HZ = 0.5


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    from independent import TWO_JOINTS

    folder = tmp_path_factory.mktemp("two")
    (folder / "two.urdf").write_text(TWO_JOINTS)
    return load_robot(folder / "two.urdf")


def with_memory(q: np.ndarray, deflection: float) -> np.ndarray:
    """Dahl's friction over its torque along angles q: it turns over within a deflection and rests where it came to."""
    out = np.zeros(len(q))
    for i, step in enumerate(np.diff(q)):
        sign = np.sign(step)
        out[i + 1] = sign - (sign - out[i]) * np.exp(-abs(step) / deflection)
    return out


def regression(
    robot: Robot, noise: float, deflection: float | None = None, count: float = 0.0, soft: float = 0.0
) -> Regression:
    """Joint 1 swings to and fro and sticks at the ends, where it may come to rest softly, joint 2 only goes one way; dry friction of
    joint 1 (a sign, or Dahl's of a deflection), white noise; angles are logged as they are, or in counts of so many rad.
    """
    time = np.arange(round(8.0 * RATE_HZ)) / RATE_HZ
    angle = 2 * np.pi * HARMONIC_HZ * time
    swing = np.tanh(soft * np.sin(angle)) if soft else np.clip(np.sin(angle), -0.95, 0.95)
    q = np.stack([0.5 * swing, 0.3 * time + 0.02 * np.sin(2 * angle)], axis=1)
    v = np.gradient(q, 1 / RATE_HZ, axis=0)
    a = np.gradient(v, 1 / RATE_HZ, axis=0)
    sign = [CoulombFriction(joint=robot.joints[0], torque=DRY)] if deflection is None else []
    rigid = robot.rigid().with_effects(sign)
    torque = np.array([rigid.inverse_dynamics(*row) for row in zip(q, v, a, strict=True)])
    if deflection is not None:
        torque[:, 0] += DRY * with_memory(q[:, 0], deflection)
    torque += noise * np.random.default_rng(0).standard_normal(torque.shape)
    recording = Recording(
        name="run",
        role="identification",
        time=time,
        sample_rate_hz=RATE_HZ,
        joints=robot.joints,
        position=np.round(q / count) * count if count else q,
        torque=torque,
    )
    return Regression.of(robot, [recording], CUTOFF_HZ)


def trusted(
    robot: Robot, noise: float, *kinds: type[CoulombFriction] | type[ViscousFriction]
) -> tuple[Regression, np.ndarray]:
    data = regression(robot, noise)
    model = identify(data, [kind(joint=robot.joints[0]) for kind in kinds], fit_links=False)
    return data, row_weights(data, model)


def test_rows_are_doubted_at_reversals_of_a_joint_with_dry_friction_and_nowhere_else(robot: Robot) -> None:
    data, known = trusted(robot, 0.01, CoulombFriction)
    (segment,) = data.segments
    # it starts to stick, or breaks away, where the sine passes 0.95; positions that end at 40 Hz show that 25 ms early or late
    wave = np.sin(2 * np.pi * HARMONIC_HZ * segment.time)
    edges = np.flatnonzero(np.diff(np.abs(wave) > 0.95))
    apart_s = np.abs(segment.time[:, None] - segment.time[edges]).min(axis=1)
    far = (apart_s > 0.15) & (np.abs(wave) < 0.95)
    assert (known[edges, 0] < 0.2).all()
    assert (known[far, 0] > 0.9).all()
    assert (known[:, 1] > 0.999).all()


def test_a_counted_angle_is_doubted_at_rest_by_what_hysteresis_makes_of_half_a_count(robot: Robot) -> None:
    deflection, count = 0.005, 1e-3
    exact, counted = (regression(robot, 0.05, deflection, step, soft=6.0) for step in (0.0, count))
    model = identify(
        exact, [PreslidingFriction(joint=robot.joints[0], torque=DRY, deflection=deflection)], fit_links=False
    )
    forth = np.linspace(0.0, 0.4, 4_000)
    # forth the torque is as large as it gets; back by the rounding's deviation it gives way by so much
    back = DRY * np.diff(with_memory(np.append(forth, forth[-1] - count / np.sqrt(12.0)), deflection))[-1]
    swing = np.abs(np.sin(2 * np.pi * HARMONIC_HZ * exact.segments[0].time))
    squares = []
    for data in (exact, counted):
        noise = 1.4826 * np.median(np.abs(model.residual_on(data)[:, 0]))
        doubt = noise * np.sqrt(row_weights(data, model)[:, 0] ** -2.0 - 1.0)
        assert np.median(doubt[swing < 0.4]) < 0.1 * noise
        squares.append(np.median(doubt[swing > 0.85]) ** 2)
    assert np.sqrt(squares) == pytest.approx([0.0, abs(back)], rel=0.3)


def test_friction_that_is_small_against_the_noise_costs_no_row(robot: Robot) -> None:
    _, known = trusted(robot, 200.0 * DRY, CoulombFriction)
    assert (known > 0.99).all()


def test_a_model_without_a_step_doubts_no_row(robot: Robot) -> None:
    _, known = trusted(robot, 0.01, ViscousFriction)
    assert (known > 0.99).all()


def test_a_gain_is_fitted_again_where_links_were_moved(robot: Robot) -> None:
    """A log of twice the torque: the gain is two with the true links, and four with half of them."""
    data = regression(robot, 0.0)
    (segment,) = data.segments
    twice = dataclasses.replace(data, segments=(dataclasses.replace(segment, torque=2.0 * segment.torque),))
    effects = [CoulombFriction(joint=robot.joints[0]), *(TorqueGain(joint=j) for j in robot.joints)]
    model = identify(twice, effects, fit_links=False)
    first = len(model.theta) - 2
    assert model.theta[first:] == pytest.approx(1.0, rel=1e-2)
    half = dataclasses.replace(
        model,
        link_parameters=0.5 * model.link_parameters,
        effects=tuple(
            e.with_coefficients(0.5 * e.coefficients) if not e.traits.multiplies else e for e in model.effects
        ),
    )
    assert gains_again(half)[first:] == pytest.approx(3.0, rel=1e-2)


# ---- gains from block to block --------------------------------------------------------------------------------------


def trial(gains: list[float], colour: float = 1.0, lost: list[float] | None = None) -> TorqueTrial:
    block_gains, lost_there = np.array(gains), np.array(lost or [])
    return TorqueTrial(
        CoulombFriction(joint="a", torque=1.0), float(block_gains.sum()), block_gains, 1e-9, 1, 0.5, True, colour,
        lost=lost_there, by_chance=np.full(len(lost_there), 20.0 * colour),
    )  # fmt: skip


def test_an_effect_that_half_of_the_blocks_show_is_accepted_though_its_gains_spread() -> None:
    burst = trial([400.0, 0.0, 0.0, 90.0, -1.0, 30.0, 0.0, 1.0])
    assert burst.gain_t < 2.0 and burst.accepted


def test_one_block_is_no_replication() -> None:
    assert not trial([400.0, 0.0, 0.0, 5.0, -1.0, 3.0, 0.0, 1.0]).accepted


def test_two_blocks_are_enough_where_an_effect_acts_in_no_other() -> None:
    """A load that changes sign twice shows a gear's backlash twice."""
    twice = trial([400.0, 0.0, 0.0, 390.0, -1.0, 2.0, 0.0, 1.0])
    assert not twice.accepted
    assert dataclasses.replace(twice, acting=2).accepted
    assert not dataclasses.replace(twice, acting=5).accepted
    assert not dataclasses.replace(trial([400.0, 0.0, 0.0, 5.0, -1.0, 3.0, 0.0, 1.0]), acting=1).accepted


def test_one_block_of_each_recording_is_replication() -> None:
    """Friction held at rest shows where a recording rests, which may be once."""
    rests = [400.0, 0.0, -1.0, 3.0, 1.0, 300.0, 0.0, -2.0]
    assert trial(rests, lost=[-390.0, -310.0]).accepted
    assert not trial(rests, lost=[-700.0, -15.0]).accepted


def test_blocks_that_lose_more_than_noise_does_refuse_an_effect() -> None:
    assert not trial([400.0, -150.0, 0.0, 90.0, -1.0, 30.0, 0.0, 1.0]).accepted


def test_coloured_noise_asks_for_larger_gains() -> None:
    assert not trial([400.0, 0.0, 0.0, 90.0, -1.0, 30.0, 0.0, 1.0], colour=3.0).accepted


@pytest.mark.parametrize("deflection", (None, 0.02))
def test_friction_that_holds_at_rest_takes_a_sign_s_place_and_adds_no_parameter(
    robot: Robot, deflection: float | None
) -> None:
    data = regression(robot, 0.1, deflection)
    model = identify(data, [CoulombFriction(joint=robot.joints[0])], fit_links=False)
    search = Search(model, Sites(robot.joints, robot.tip_frame))
    trials = [t for t in search.run() if "coulomb_friction" in t.effect.traits.stands_for]
    held = [t for t in trials if t.accepted]
    if deflection is None:
        assert not held  # a true sign needs no memory
    else:
        assert held[0].size == 0 and held[0].share > 0.5
        assert held[0].effect.coefficients == pytest.approx([DRY], rel=0.05)
        assert held[0].effect.shape == pytest.approx([deflection], rel=0.1)
