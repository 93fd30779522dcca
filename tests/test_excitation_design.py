"""Designed excitations: limits, prediction, search."""

from __future__ import annotations

import dataclasses
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import CS8, Simulation, Trajectory, load_cs8, simulate, sine_excitation
from rx90b_flex.simulate.cs8 import drive_places

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from designed_motion.limits import Limits, capsules
from designed_motion.prediction import CandidateMotion, PrecisionPrediction
from designed_motion.regressor_slope import regressor_slope
from designed_motion.search import (
    Design,
    _DesignProblem,
    _on_own_modes,
    _problem,
    assess,
    column_scale,
    design_excitation,
    essential_space,
    periodic_derivative,
    simulated_margins,
    steady_states,
)

PERIOD = 4.096
pytestmark = pytest.mark.slow  # what they test is a benchmark's


@cache
def robot() -> Robot:
    return rf.load_robot("rx90b_4dof")


@cache
def controller() -> CS8:
    return load_cs8().for_joints(robot().joints)


@cache
def limits() -> Limits:
    return Limits.of(robot(), controller())


@cache
def problem(spectrum: str | None = None) -> _DesignProblem:
    rng = np.random.default_rng(0)
    return _problem(robot(), controller(), limits(), "condition", spectrum, PERIOD, 3, None, 256, 6, rng)  # type: ignore[arg-type]


@cache
def small() -> Design:
    told: list[float] = []
    design = design_excitation(
        robot(),
        seed=3,
        controller=controller(),
        harmonics=1,
        samples=96,
        points=3,
        draws=3,
        starts=1,
        evaluations=30,
        progress=lambda text, part: told.append(part),
    )
    assert len(told) > 6 and min(told) >= 0.0 and max(told) <= 1.0
    return design


@cache
def section_422() -> Simulation:
    return simulate(robot(), controller(), sine_excitation(robot(), np.random.default_rng(0)).repeated(2), raw=True)


# ---- limits -----------------------------------------------------------------------------------------------------


def test_an_arm_that_points_up_keeps_its_distance_and_one_that_reaches_below_the_floor_does_not() -> None:
    up, down = np.zeros(4), np.array([0.0, np.pi / 2, np.pi / 2, 0.0])
    distance = limits().distances(robot().tree, np.stack([up, down]))
    # nearest are the base's end and the upper arm's start: the hinges of joints 1 and 2, each with its radius
    assert distance[0].min() == pytest.approx(np.hypot(0.10, 0.28) - 0.2, abs=1e-6)
    # the forearm's capsule, radius 0.1 m, ends 0.535 m below the elbow, which is 0.42 m above the floor
    assert distance[1].min() == pytest.approx(0.42 - 0.535 - 0.1, abs=1e-6)


def test_a_folded_arm_is_stopped_by_its_own_column() -> None:
    folded = np.array([0.0, 2.3, 2.4, 0.0])
    watched = capsules(robot(), floor=None)
    free = dataclasses.replace(limits(), geometry=watched)
    assert free.distances(robot().tree, folded[None]).min() < 0.1


def test_bodies_on_one_joint_are_not_watched() -> None:
    tree, geometry = robot().tree, limits().geometry
    assert len(geometry.collisionPairs) > 0
    for pair in geometry.collisionPairs:
        a, b = (geometry.geometryObjects[i].parentJoint for i in (pair.first, pair.second))
        assert a != b and tree.parents[a] != b and tree.parents[b] != a


def test_margins_tell_what_is_left() -> None:
    position = np.zeros((3, 4))
    velocity, torque = np.full((3, 4), 0.5), np.full((3, 4), -10.0)
    left = limits().margins(robot().tree, position, velocity, torque)
    assert np.allclose(left.velocity, limits().velocity - 0.5)
    assert np.allclose(left.torque, limits().torque - 10.0)
    assert np.allclose(left.position, np.minimum(-limits().lower, limits().upper))
    assert left.kept
    assert not limits().margins(robot().tree, position, 100.0 * velocity, torque).kept


def test_the_excitation_of_section_422_passes_a_speed_limit_and_the_floor() -> None:
    """Its third harmonic asks 3.61 rad/s of joint_2, whose URDF allows 3.5; both arms level and down, the tool is below the floor."""
    left = simulated_margins(Limits.of(robot(), controller(), used=1.0, clearance=0.0), section_422())
    assert left.velocity[1] < 0.0 and (np.delete(left.velocity, 1) > 0.0).all()
    assert left.clearance < -0.1


# ---- the parts of a design --------------------------------------------------------------------------------------


def test_references_are_periodic_and_their_derivatives_are_each_other() -> None:
    rng = np.random.default_rng(1)
    c = CandidateMotion(rng.normal(size=(7, 4)), np.zeros((0, 4), complex))
    time = np.arange(64) / 64 * PERIOD
    r, v, a = c.references(time, PERIOD)
    assert np.allclose(periodic_derivative(r, PERIOD), v, atol=1e-11)
    assert np.allclose(periodic_derivative(v, PERIOD), a, atol=1e-10)
    assert np.allclose(r.mean(axis=0), c.centre)
    spectrum = np.abs(np.fft.rfft(v, axis=0)) / 64
    assert spectrum[4:].max() < 1e-12 and spectrum[0].max() < 1e-12


def test_the_column_scale_is_the_first_guess_of_a_parameters_group() -> None:
    scale, names = column_scale(robot()), robot().parameter_names
    value = dict(zip(names, scale, strict=True))
    assert value["joint_1.drive_inertia.inertia"] == 1.36
    assert value["link_2.s_x"] == value["link_2.s_z"] == pytest.approx(np.hypot(1.41, 3.50), rel=1e-6)
    assert value["link_4.J_yz"] == pytest.approx(0.915)


def test_what_no_motion_shows_is_not_in_the_essential_space() -> None:
    space = essential_space(problem(), np.random.default_rng(0), draws=2)
    assert np.allclose(space.T @ space, np.eye(space.shape[1]), atol=1e-12)
    assert space.shape == (78, 73)
    mass = robot().parameter_names.index("link_1.mass")
    assert np.abs(space[mass]).max() < 1e-9


def test_the_condition_number_does_not_depend_on_the_number_of_samples() -> None:
    rng = np.random.default_rng(0)
    block = rng.normal(size=(50, 3, 4))
    once, twice = (assess(x, np.ones(4), np.eye(4)) for x in (block, np.concatenate([block, block])))
    assert np.allclose(once.singular_values, twice.singular_values)
    assert once.condition == pytest.approx(np.linalg.cond(block.reshape(-1, 4)))


def test_slow_bending_is_predicted_as_simulated() -> None:
    """To what prediction leaves out: gravity's stiffness over the hinges', below 1 %, and (1.2 Hz / 14.8 Hz)^2 of their own inertia.

    Torsion is left out here: it follows friction's jumps, which ring in the simulation and are smoothed in the prediction.
    """
    motion = np.zeros((7, 4))
    motion[0], motion[1] = [0.0, 0.8, 0.6, 0.0], 0.3
    c = CandidateMotion(motion, np.zeros((0, 4), complex))
    q, _, _ = PrecisionPrediction(problem("below").at(np.arange(1024) / 250.0).frame, c).motion
    r, v, _ = c.references(np.arange(1024) / 250.0, PERIOD)
    slow = Trajectory("slow", robot().joints, 250.0, r, v, None, PERIOD)
    simulated, _, _ = steady_states(simulate(robot(), controller(), slow.repeated(2)))
    bending = [i for i, name in enumerate(robot().coordinates) if "bend" in name]
    error = np.linalg.norm(q[:, bending] - simulated[:, bending]) / np.linalg.norm(simulated[:, bending])
    assert error < 0.05


# ---- gradients --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rx90b_4dof", "example-robot-data:ur10"])
def test_the_regressors_slope_is_that_of_finite_differences(name: str) -> None:
    """Central ones: their error is of second order in the step and of rounding over it, both below 1e-8 of the largest."""
    any_robot, rng, step = rf.load_robot(name), np.random.default_rng(0), 1e-6
    n = any_robot.model.nv
    motion = rng.normal(size=(3, 2, n))
    weight = rng.normal(size=(2, n, len(any_robot.parameter_names)))
    slopes = np.array(regressor_slope(any_robot, *motion, weight))
    expected = np.zeros_like(slopes)
    for order in range(3):
        for i in range(n):
            change = np.zeros_like(motion)
            change[order, :, i] = step
            apart = any_robot.regressor(*(motion + change)) - any_robot.regressor(*(motion - change))
            expected[order, :, i] = (apart * weight).sum(axis=(1, 2)) / (2.0 * step)
    assert np.allclose(slopes, expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("objective", ["condition", "information"])
def test_the_searchs_gradient_is_that_of_finite_differences(objective: str) -> None:
    """Of a motion that passes limits; forward differences inside, of 1e-6, leave about as much of the gradient."""
    p = dataclasses.replace(problem(), objective=objective)
    rng = np.random.default_rng(1)
    x = 2.0 * p.draw(rng)
    direction = rng.normal(size=len(x))
    direction /= np.linalg.norm(direction)
    _, gradient, _ = p.look(x, 8.0)
    assert p.excess(p.candidate(x)) > 0.0
    step = 1e-5
    there, back = (p.look(x + sign * step * direction, 8.0)[0] for sign in (1.0, -1.0))
    assert (there - back) / (2.0 * step) == pytest.approx(gradient @ direction, abs=1e-4 * np.linalg.norm(gradient))


# ---- designs ----------------------------------------------------------------------------------------------------


def test_a_design_keeps_to_the_limits_in_simulation() -> None:
    assert small().simulation.ended is None
    assert small().margins().kept


def test_the_multisine_has_its_lines_alone_and_the_references_theirs() -> None:
    trajectory, design = small().trajectory, small()
    lines = np.round(design.lines_hz * PERIOD).astype(int)
    amplitude = np.abs(np.fft.rfft(trajectory.torque, axis=0)) / 512
    other = np.setdiff1d(np.arange(len(amplitude)), lines)
    assert amplitude[other].max() < 1e-9 < amplitude[lines].max()
    speed = np.abs(np.fft.rfft(trajectory.velocity, axis=0))
    assert speed[2:].max() < 1e-9 * speed.max()


def test_lines_on_modes_stand_within_a_tenth_of_them() -> None:
    """Of those at the centre of a motion, and half a step of the period's grid."""
    p, rng = problem(), np.random.default_rng(2)
    x = p.draw(rng)
    placed, own = _on_own_modes(p, x, rng)
    assert np.array_equal(placed.candidate(own).motion, p.candidate(x).motion)
    pose = np.zeros(16)
    pose[drive_places(robot())] = p.candidate(x).centre
    modes = robot().linearize(pose).frequencies_hz(elastic_only=True)
    modes = modes[(modes > 1.0) & (modes < 110.0)]
    apart = np.abs(placed.frame.hz[:, None] - modes)
    assert np.all((apart <= 0.1 * modes + 0.5 / PERIOD + 1e-9).any(axis=1))
    assert np.all(apart.min(axis=0) <= 0.5 / PERIOD + 1e-9)  # and one on each


def test_the_search_improves_on_what_it_starts_from() -> None:
    cost = small().history[:, 2]
    assert cost[-1] < cost[0]


def test_the_same_seed_gives_the_same_design() -> None:
    kwargs = {"harmonics": 1, "samples": 32, "points": 2, "draws": 2, "starts": 1, "evaluations": 2}
    one, two = (
        design_excitation(robot(), seed=5, controller=controller(), **kwargs)
        for _ in range(2)  # type: ignore[arg-type]
    )
    assert np.array_equal(one.trajectory.position, two.trajectory.position)
    assert np.array_equal(one.trajectory.torque, two.trajectory.torque)


def test_below_the_modes_nothing_is_fed_forward() -> None:
    design = design_excitation(
        robot(),
        seed=0,
        controller=controller(),
        spectrum="below",
        samples=64,
        points=2,
        draws=2,
        starts=1,
        evaluations=4,
    )
    assert design.trajectory.feedforward is None and len(design.lines_hz) == 0


def test_a_rigid_robot_of_any_urdf_is_excited() -> None:
    ur10 = rf.load_robot("example-robot-data:ur10")
    own = Limits.of(ur10, radius=0.05)
    design = design_excitation(
        ur10, seed=1, limits=own, objective="information", harmonics=2, samples=96, draws=6, starts=1, evaluations=40
    )
    assert design.margins().kept
    assert design.essential.shape[1] == 36  # base parameters of a six-axis arm, a link at a time, without friction
    cost = design.history[:, 2]
    assert cost[-1] < cost[0]


def turntable(folder: Path, inertia: float, friction: float) -> Robot:
    """One joint about the vertical, which only its drive's inertia and viscous friction resist."""
    (folder / "turntable.urdf").write_text(
        """<robot name="turntable"><link name="base"/><link name="disc"><inertial><mass value="1e-6"/>
        <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="turn" type="revolute"><parent link="base"/><child link="disc"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" velocity="3" effort="100"/></joint></robot>"""
    )
    (folder / "turntable.toml").write_text(
        f"""name = "turntable"
urdf = "turntable.urdf"
tip_frame = "disc"
inertial_parameters = "known"
[[effects]]
type = "drive_inertia"
joint = "turn"
inertia = {inertia}
[[effects]]
type = "viscous_friction"
joint = "turn"
coefficient = {friction}
"""
    )
    return rf.load_robot(folder / "turntable.toml")


def test_the_search_finds_the_best_where_it_is_known(tmp_path: Path) -> None:
    """Inertia 1 and friction c: columns a and c v are orthogonal over a period, so the condition number is the ratio of their sizes,
    h w / c for harmonic h alone. For c = 2 w, harmonics 1 and 3 alone leave 2 and 1.5; the best is 1, by any mixture whose mean
    square of h is 4 or by the second harmonic.
    """
    w = 2.0 * np.pi / PERIOD
    table = turntable(tmp_path, 1.0, 2.0 * w)
    design = design_excitation(table, seed=0, harmonics=3, draws=3, starts=1, evaluations=60)
    assert design.margins().kept
    # the links' millionths, and the sampling of a period by 1024 instants, change less than the simulation's tracking
    assert design.predicted.condition == pytest.approx(1.0, abs=0.01)
    v = design.trajectory.velocity
    assert np.std(periodic_derivative(v, PERIOD)) / np.std(2.0 * w * v) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"moving": ("joint_9",)}, "unknown joint 'joint_9'"),
        ({"objective": "trace"}, "objective is 'trace'"),
        ({"spectrum": "above"}, "spectrum is 'above'"),
        ({"spectrum": np.array([0.0, 10.0])}, "above 0 and below 125"),
        ({"harmonics": 0}, "harmonics is 0; expected 1 or more"),
        ({"draws": 1}, "starts is 3 of 1 draws"),
    ],
)
def test_choices_that_do_not_fit_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        design_excitation(robot(), seed=0, controller=controller(), **changes)  # type: ignore[arg-type]


def test_a_rigid_robot_has_no_modes() -> None:
    with pytest.raises(ValueError, match="is rigid"):
        design_excitation(rf.load_robot("example-robot-data:ur10"), seed=0, spectrum="on_modes")


def test_a_parameter_without_value_is_refused() -> None:
    effects = [
        dataclasses.replace(e, inertia=np.nan) if e.type_name() == "drive_inertia" else e for e in robot().effects
    ]
    with pytest.raises(ValueError, match=r"joint_1\.drive_inertia\.inertia has no value"):
        column_scale(robot().with_effects(effects))


@pytest.mark.long  # it is what the benchmark prints
def test_a_designed_excitation_is_conditioned_five_times_better_than_that_of_section_422() -> None:
    """At equal duration, within limits that the other does not keep; by simulated motion of both."""
    design = design_excitation(robot(), seed=0, controller=controller())
    assert design.margins().kept
    other = design.assess(section_422())
    assert other.condition / design.assess().condition >= 5.0
