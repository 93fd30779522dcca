"""The perturbation method: it agrees with the nonlinear simulation, and its parts do what they say."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.compiled.perturbed import port_torque
from rx90b_flex.compiled.rate_table import from_table
from rx90b_flex.simulate import (
    Noise,
    Trajectory,
    load_cs8,
    multisine,
    simulate,
    simulate_lanes,
    square_wave,
    straight_line,
)
from rx90b_flex.simulate.closed_loop import hermite
from rx90b_flex.simulate.perturbation import _ports, perturb_lanes

ROBOT = rf.load_robot("rx90b_4dof")
CONTROLLER = load_cs8()


def excited(count: int, seconds: float) -> list[Trajectory]:
    """The start of the experiments of section 6.6.2 with that many excitations."""
    rng = np.random.default_rng(0)
    feedforward = np.zeros((count, 1024, 4))
    for one in feedforward:
        one[:, :3] = multisine(range(11, 322, 2), 1024, 45.0, rng, 3)
    wave = square_wave(ROBOT, [0.0, np.pi / 2, 0.0, 0.0], moving=ROBOT.joints[:3])
    return [wave.with_feedforward(one, f"run_{i}").part(0.0, seconds) for i, one in enumerate(feedforward)]


def test_the_line_agrees_with_the_nonlinear_simulation_within_1_percent_of_its_deviation() -> None:
    line = straight_line(ROBOT)
    true = simulate(ROBOT, CONTROLLER, line).tip_deviation_mm
    found = perturb_lanes(ROBOT, CONTROLLER, [line])[0].tip_deviation_mm
    # what is left is of second order in deformations of some mrad
    assert np.linalg.norm(found - true, axis=1).max() < 0.01 * np.linalg.norm(true, axis=1).max()


def test_excitations_agree_with_the_nonlinear_simulation() -> None:
    trajectories = excited(2, 0.5)
    true = simulate_lanes(ROBOT, CONTROLLER, trajectories)
    found = perturb_lanes(ROBOT, CONTROLLER, trajectories)
    calm = perturb_lanes(ROBOT, CONTROLLER, [trajectories[0].with_feedforward(None)])[0]
    for a, b in zip(true, found, strict=True):
        for signal in ("position", "torque"):
            x, y, z = (getattr(run.recording, signal) for run in (a, b, calm))
            assert np.linalg.norm(x - y) < 0.01 * np.linalg.norm(x - z)
        assert b.work[-1] == pytest.approx(a.work[-1], rel=1e-3)


def test_a_run_does_not_depend_on_its_neighbours() -> None:
    trajectories = excited(3, 0.2)
    together = perturb_lanes(ROBOT, CONTROLLER, trajectories)
    alone = perturb_lanes(ROBOT, CONTROLLER, trajectories[2:])[0]
    np.testing.assert_allclose(together[2].q, alone.q, rtol=0, atol=1e-12)


def test_noise_goes_through_the_controller_as_in_the_nonlinear_simulation() -> None:
    noise, trajectories = Noise(0.5, 1e-5, 1e-3), excited(1, 0.2)
    options = {"noise": noise, "raw": True}
    a = simulate_lanes(ROBOT, CONTROLLER, trajectories, rng=np.random.default_rng(3), **options)[0]  # type: ignore[arg-type]
    b = perturb_lanes(ROBOT, CONTROLLER, trajectories, rng=np.random.default_rng(3), **options)[0]  # type: ignore[arg-type]
    assert a.raw is not None and b.raw is not None
    # the same noise: the difference is far below it
    assert np.std(a.raw.torque - b.raw.torque) < 0.2
    assert np.std(a.raw.position - b.raw.position) < 2e-6


def test_a_torque_at_its_limit_ends_the_run_and_says_when() -> None:
    good, bad = excited(2, 0.3)
    strong = bad.torque.copy()
    strong[25:, 0] = 3000.0
    strict = dataclasses.replace(CONTROLLER, overload_time_s=0.002)
    runs = perturb_lanes(ROBOT, strict, [good, bad.with_feedforward(strong)])
    true = simulate(ROBOT, strict, bad.with_feedforward(strong))
    assert runs[0].ended is None
    assert runs[1].ended is not None and runs[1].ended == true.ended
    assert len(runs[1].time) == len(true.time)


def test_references_that_vibrate_are_excitations_like_torques() -> None:
    plain = [t.with_feedforward(None) for t in excited(2, 0.5)]
    time = np.arange(len(plain[0].position))[:, None] / plain[0].rate_hz
    wave = 2e-4 * np.sin(2.0 * np.pi * np.array([11.0, 17.0, 23.0, 0.0]) * time)  # joint 4 is at rest
    slope = np.gradient(wave, 1.0 / plain[0].rate_hz, axis=0)
    shaken = [
        dataclasses.replace(t, position=t.position + sign * wave, velocity=t.velocity + sign * slope)
        for sign, t in zip((1.0, -1.0), plain, strict=True)
    ]
    true, found = [simulate(ROBOT, CONTROLLER, t) for t in shaken], perturb_lanes(ROBOT, CONTROLLER, shaken)
    moved = true[0].recording.position - true[1].recording.position
    apart = found[0].recording.position - found[1].recording.position
    assert np.linalg.norm(apart - moved) < 0.02 * np.linalg.norm(moved)
    for t, run in zip(shaken, found, strict=True):
        assert np.array_equal(run.recording.reference_position, t.position)


def test_excitations_of_different_motions_are_refused() -> None:
    a, b = excited(1, 0.2)[0], straight_line(ROBOT).part(0.0, 0.2)
    with pytest.raises(ValueError, match="other references"):
        perturb_lanes(ROBOT, CONTROLLER, [a, b])


def test_an_effect_without_a_compiled_law_takes_part() -> None:
    types = rf.effects.catalogue()
    heavy = ROBOT.with_effects(
        [*ROBOT.effects, types["payload"](frame=ROBOT.tip_frame, mass=5.0, centre=(0.0, 0.0, 0.1))]
    )
    line = straight_line(ROBOT).part(0.0, 0.1)
    true, found = simulate(heavy, CONTROLLER, line), perturb_lanes(heavy, CONTROLLER, [line])[0]
    deviation = np.abs(true.tip_deviation_mm).max()
    assert np.abs(true.tip_deviation_mm - found.tip_deviation_mm).max() < 0.02 * deviation


def test_the_table_of_the_friction_is_the_friction() -> None:
    ports, laws = _ports(ROBOT), ROBOT.plant.laws
    by_table = numba.njit(lambda table, rate: from_table(table, rate))
    by_laws = numba.njit(lambda laws, ports, p, rate: port_torque(laws, ports, p, 0.0, rate, 0.0))
    for p in np.flatnonzero(ports.tabulated):
        for rate in (-2.3, -0.11, -1e-3, -2e-4, -1e-7, 3e-7, 1e-4, 0.04, 0.9, 7.0):
            torque, slope = by_table(ports.table[p], rate)
            true, true_slope = by_laws(laws, ports, p, rate)
            assert torque == pytest.approx(true, rel=1e-6)
            assert slope == pytest.approx(true_slope, rel=2e-3, abs=0.01)


def test_the_nominal_motion_is_a_cubic_through_its_samples() -> None:
    time = np.arange(4) / 250.0
    rows, part = np.array([0, 1, 2]), np.array([0.0, 0.3])
    at = ((rows[:, None] + part) / 250.0).ravel()
    position, velocity = (time**3)[:, None], (3 * time**2)[:, None]
    x, v, a = hermite(position, velocity, rows, part, 250.0)
    np.testing.assert_allclose(x[:, 0], at**3, atol=1e-15)
    np.testing.assert_allclose(v[:, 0], 3 * at**2, atol=1e-13)
    np.testing.assert_allclose(a[:, 0], 6 * at, atol=1e-9)


@pytest.mark.slow
def test_a_whole_period_of_excitation_agrees_with_the_nonlinear_simulation() -> None:
    trajectories = excited(2, 4.096)
    true, found = simulate_lanes(ROBOT, CONTROLLER, trajectories), perturb_lanes(ROBOT, CONTROLLER, trajectories)
    for a, b in zip(true, found, strict=True):
        error = np.linalg.norm(a.tip_deviation_mm - b.tip_deviation_mm)
        assert error < 0.01 * np.linalg.norm(a.tip_deviation_mm)


def test_a_frozen_manipulator_answers_alike_at_every_place_of_the_motion() -> None:
    """Links linear and time-invariant (section 6.6.6): the same push has the same answer early and late in the motion."""
    # the spring's law of one angle keeps its nonlinearity, as friction does
    robot = ROBOT.with_effects([e for e in ROBOT.effects if e.traits.part not in ("friction", "spring")])
    wave = square_wave(robot, [0.0, np.pi / 2, 0.0, 0.0], moving=robot.joints[:3])
    count = 400
    pushes = np.zeros((3, count, 4))
    pushes[1, 100:110, 1] = pushes[2, 300:310, 1] = 20.0
    runs = [wave.part(0.0, count / 250).with_feedforward(push) for push in pushes]
    differences = {}
    for manipulator in ("moving", "frozen"):
        q = [run.q for run in perturb_lanes(robot, CONTROLLER.ideal(), runs, manipulator=manipulator)]
        early, late = (q[1] - q[0])[100:190], (q[2] - q[0])[300:390]
        differences[manipulator] = np.abs(early - late).max() / np.abs(early).max()
    assert differences["frozen"] < 1e-6 < 1e-3 < differences["moving"]
