"""Laws that read load, time, another joint's angle or what they remember, and those between motors and controller.

Compiled, they come to what the loop comes to that asks effects for their forces between the parts of each step.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import independent as ind
import numpy as np
import pytest
from drawn_effects import TYPES, draw_effect
from test_simulated_effects import FLEXIBLE, NEEDS_TORSION, VALUES, controller_of, robot_with, sines

from rx90b_flex.effects import catalogue, effect_to_table
from rx90b_flex.effects.effect import JointEffect
from rx90b_flex.effects.friction import FrictionDrift
from rx90b_flex.effects.law import Law, constant
from rx90b_flex.effects.law_effect import SumOfLaws
from rx90b_flex.effects.parameters import linear
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import Simulation, closed_loop, simulate_lanes

KINDS = sorted({*VALUES, *TYPES})
LOADED = ("load_friction", "load_viscous_friction", "drive_efficiency")
# shoulder and elbow, of every kind of law that stands beside others; a turn-over that steps resolve
MANY = [
    {"type": "load_friction", "joint": "shoulder", "coefficient": 0.1, "turnover": 0.05},
    {"type": "load_friction", "joint": "elbow", "coefficient": 0.2, "turnover": 0.05},
    {"type": "load_viscous_friction", "joint": "elbow", "coefficient": 0.02},
    {"type": "friction_drift", "joint": "shoulder", "coefficient": 1.5, "time_constant": 0.5},
    {"type": "presliding_friction", "joint": "elbow", "torque": 0.8, "stiffness": 12.0},
    {"type": "maxwell_slip_friction", "joint": "shoulder", "torques": [0.5, 0.4], "stiffnesses": [1.5, 3.0]},
    {"type": "cable_torque", "joints": ["shoulder", "elbow"], "coefficients": [2.0, 1.0]},
    {"type": "coulomb_friction", "joint": "shoulder", "torque": 2.0},
    {"type": "motor_saturation", "joint": "elbow", "coefficient": 5.0e-4},
    {"type": "resolver_error", "joint": "shoulder", "order": 9.0, "amplitude": 0.002, "phase": 0.5},
]


@cache
def robot_of(kind: str) -> Robot:
    """The arm with one effect, its load friction with a turn-over that steps resolve; or with many."""
    with TemporaryDirectory() as folder:
        if kind == "many":
            effects = MANY
        elif kind in VALUES:
            own = {"type": kind, **VALUES[kind]}
            if kind in ("load_friction", "drive_efficiency"):
                own["turnover"] = 0.05
            effects = [*([FLEXIBLE] if kind in NEEDS_TORSION else []), own]
        else:
            drawn = draw_effect(kind, robot_with(Path(folder)), np.random.default_rng(0))
            effects = [effect_to_table(e) for e in drawn]
        return robot_with(Path(folder), *effects)


def runs(robot: Robot, monkeypatch: pytest.MonkeyPatch, by_parts: bool, phases=(0.0,), substeps=1) -> list[Simulation]:
    with monkeypatch.context() as patched:
        if by_parts:
            patched.setattr(closed_loop._Runner, "_laws", lambda self, rest: None)
        trajectories = [sines(robot, phase, samples=100) for phase in phases]
        found = simulate_lanes(robot, controller_of(robot), trajectories, substeps=substeps, raw=True)
    assert all(run.ended is None for run in found)
    return found


def apart(a: Simulation, b: Simulation) -> float:
    return float(np.abs(a.q - b.q).max())


@pytest.mark.parametrize("kind", KINDS)
def test_no_type_of_the_package_is_worked_out_in_between(kind, monkeypatch):
    monkeypatch.setattr(closed_loop, "ByParts", None)
    runs(robot_of(kind), monkeypatch, by_parts=False)


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in LOADED])
def test_compiled_laws_are_what_is_worked_out_in_between(kind, monkeypatch):
    (quick,), (slow,) = (runs(robot_of(kind), monkeypatch, by_parts) for by_parts in (False, True))
    assert apart(quick, slow) < 1e-12
    assert np.abs(quick.raw.torque - slow.raw.torque).max() < 1e-9
    assert np.abs(quick.raw.position - slow.raw.position).max() < 1e-12
    np.testing.assert_allclose(quick.dissipated, slow.dissipated, rtol=0, atol=1e-10)
    np.testing.assert_allclose(quick.work, slow.work, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", [*LOADED, pytest.param("many", marks=pytest.mark.slow)])
def test_with_the_load_they_come_together_with_the_square_of_the_step(kind, monkeypatch):
    """Between the parts the slope of the load by angles and rates helps to make the step, compiled it does not."""
    between = []
    for substeps in (1, 4):
        (quick,), (slow,) = (
            runs(robot_of(kind), monkeypatch, by_parts, substeps=substeps) for by_parts in (False, True)
        )
        between.append(apart(quick, slow))
        np.testing.assert_allclose(quick.dissipated, slow.dissipated, rtol=1e-4)
    assert between[0] < 1e-6
    assert between[1] < between[0] / 8.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["many", "transmission_error"])
def test_lanes_and_chunks_leave_each_other_alone(kind, monkeypatch):
    phases = tuple(0.1 * np.arange(10))  # a full vector and a part of one
    together = runs(robot_of(kind), monkeypatch, by_parts=False, phases=phases)
    for i in (0, 7, 9):
        (alone,) = runs(robot_of(kind), monkeypatch, by_parts=False, phases=phases[i : i + 1])
        assert np.array_equal(alone.q, together[i].q)
        assert np.array_equal(alone.dissipated, together[i].dissipated)


def test_a_type_without_a_law_is_worked_out_in_between_and_so_are_all_beside_it(monkeypatch):
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class _Uncompiled(catalogue()["viscous_friction"]):  # type: ignore[misc]
        def laws(self, motion):
            return None

    robot = robot_of("many")
    slow = robot.with_effects([*robot.effects, _Uncompiled(joint="elbow", coefficient=0.5)])
    quick = robot.with_effects([*robot.effects, catalogue()["viscous_friction"](joint="elbow", coefficient=0.5)])
    assert slow.plant.wide is None and quick.plant.wide
    a, b = (simulate_lanes(r, controller_of(robot), [sines(robot, samples=50)])[0] for r in (slow, quick))
    assert apart(a, b) < 1e-6


def test_load_is_the_links_where_a_payload_hangs_on_them():
    """What a payload asks for is in no column of load friction: such a robot is worked out in between."""
    robot = robot_of("load_friction")
    load = catalogue()["payload"](frame=robot.tip_frame, mass=1.0, centre=(0.0, 0.0, 0.1))
    assert robot.plant.wide and robot.with_effects([*robot.effects, load]).plant.wide is None


@pytest.mark.slow
def test_joints_that_slide_are_stepped_alike(tmp_path, monkeypatch):
    slides = ind.TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="prismatic"')
    slides = slides.replace('effort="50"', 'effort="500"')
    monkeypatch.setattr(ind, "TWO_JOINTS", slides)
    bearable = [e for e in MANY if e["type"] != "motor_saturation"]  # whose motor lifts no 20 N and more
    robot = robot_with(tmp_path, *bearable)
    assert robot.plant.tree.prismatic.any()
    between = []
    for substeps in (1, 4):
        (quick,), (slow,) = (runs(robot, monkeypatch, by_parts, substeps=substeps) for by_parts in (False, True))
        between.append(apart(quick, slow))
    assert between[0] < 1e-6
    assert between[1] < between[0] / 8.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Warming(SumOfLaws, JointEffect):
    """Viscous friction of which a part fades."""

    steady: float | None = linear("N m s/rad")
    fading: float | None = linear("N m s/rad")

    def unit_laws(self, motion):
        port = motion.coordinates.port(self.joint)
        return Law(port, damping=1.0), Law(
            port, function=FrictionDrift.law, parameters=np.array([1.0, 0.5]), timed=True
        )


def test_a_linear_part_beside_a_law_that_reads_time_is_not_lost():
    robot, types = robot_of("viscous_friction"), catalogue()
    parts = (
        types["viscous_friction"](joint="elbow", coefficient=1.5),
        types["friction_drift"](joint="elbow", coefficient=2.0, time_constant=0.5),
    )
    others = [e for e in robot.effects if e.label != "elbow.viscous_friction"]
    whole = robot.with_effects([*others, _Warming(joint="elbow", steady=1.5, fading=2.0)])
    a, b = (
        simulate_lanes(r, controller_of(robot), [sines(robot, samples=50)])[0]
        for r in (robot.with_effects([*others, *parts]), whole)
    )
    assert apart(a, b) < 1e-12
    np.testing.assert_allclose(a.dissipated, b.dissipated, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("stated", "refused"),
    [
        ({"reads": np.array([0.0, 1.0]), "damping": 1.0, "function": constant}, "no linear part"),
        ({"timed": True}, "has a function"),
        ({"at": "measured", "function": constant, "timed": True}, "depends on one coordinate alone"),
        ({"at": "motor", "function": constant, "port": np.array([1.0, 1.0])}, "depends on one coordinate alone"),
    ],
)
def test_a_law_that_no_simulation_could_step_is_refused(stated, refused):
    with pytest.raises(ValueError, match=refused):
        Law(**{"port": np.array([1.0, 0.0]), **stated})


def test_a_law_that_reads_what_it_does_not_state_is_refused():
    """Compiled code would read beyond its parameters."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class _Timeless(FrictionDrift):
        law_timed = False

    own = _Timeless(joint="elbow", coefficient=2.0, time_constant=0.5)
    with pytest.raises(ValueError, match=r"FrictionDrift\.law reads or writes more than its law states"):
        robot_of("viscous_friction").with_effects([own]).plant.laws  # noqa: B018
