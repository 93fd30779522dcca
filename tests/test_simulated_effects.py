"""Every effect type in closed loop: the torque in the log is what the effect's definition makes of the motion that was simulated.

Definitions of what stands between robot and log, and of friction that remembers, are worked out here (as in `log_effects.py`), not by
the package.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import independent as ind
import log_effects
import numpy as np
import pytest
from drawn_effects import TYPES, draw_effect
from numpy.typing import NDArray

import rx90b_flex as rf
from rx90b_flex.effects import catalogue, effect_to_table
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import CS8, Simulation, simulate, simulate_lanes
from rx90b_flex.simulate.cs8 import design_cs8
from rx90b_flex.simulate.trajectories import Trajectory

Array = NDArray[np.float64]
ELBOW = 1
RATE_HZ = 1000.0
MIDDLE, SIZE = np.array([0.4, 0.9]), np.array([0.5, 0.45])
# N m. The mean over two samples is off from the middle by tau'' h^2 / 6 < 7e-4 of smooth torques (20 N m at 14 rad/s), and by
# a quarter of h times the change of slope at a kink: 2.5e-3 where load friction's load, at 100 N m/s, changes sign.
TOLERANCE = 3e-3
NEEDS_TORSION = ("backlash", "stiffness_hardening")
DRY = ("load_friction", "held_friction", "drive_efficiency")
DECLARED: list[dict[str, object]] = [
    {"type": "drive_inertia", "joint": "shoulder", "inertia": 0.4},
    {"type": "drive_inertia", "joint": "elbow", "inertia": 0.2},
    {"type": "viscous_friction", "joint": "shoulder", "coefficient": 2.0},
    {"type": "viscous_friction", "joint": "elbow", "coefficient": 1.0},
]
FLEXIBLE: dict[str, object] = {"type": "drive_flexibility", "joint": "elbow", "stiffness": 900.0, "damping": 0.6}
# Of what has a size of its own; other types of force, new ones too, have drawn values.
VALUES: dict[str, dict[str, object]] = {
    "load_friction": {"joint": "elbow", "coefficient": 0.1},
    "friction_drift": {"joint": "elbow", "coefficient": 1.5, "time_constant": 0.5},
    "presliding_friction": {"joint": "elbow", "torque": 0.8, "stiffness": 12.0},
    "gravity_spring": {
        "joint": "elbow",
        "stiffness": 200.0,
        "prestress": 8.0,
        "anchors": [0.0, 0.1, 0.2, 0.1, 0.0, 0.1],
    },
    "base_tilt": {"angle_x": 0.02, "angle_y": -0.03},
    "transmission_error": {"joint": "elbow", "order": 9.0, "amplitude": 0.004, "phase": -1.0},
    "backlash": {"joint": "elbow", "gap": 0.004},
    "drive_flexibility": FLEXIBLE,
    "joint_flexibility": {"joint": "elbow", "stiffness": [4000.0, 3000.0], "damping": [2.0, 2.0]},
    "base_flexibility": {"stiffness": [9000.0, 8000.0], "damping": [20.0, 20.0]},
    "stiffness_hardening": {"joint": "elbow", "cubic": 2.0e6},
    "motor_saturation": {"joint": "elbow", "coefficient": 5.0e-4},
    "torque_delay": {"joint": "elbow", "delay": 0.0123},
    "resolver_error": {"joint": "elbow", "order": 9.0, "amplitude": 0.002, "phase": 0.5},
    "line_interference": {"joint": "elbow", "frequency_hz": 16.7, "amplitude": 0.4, "phase": 1.2},
    "held_friction": {"joint": "elbow", "torque": 0.8},
    "breakaway_friction": {"joint": "elbow", "torque": 0.8, "distance": 0.4},
    # at the elbow's fastest, 3.15 rad/s, as much per load as the load friction above, which is what the tolerance is for
    "load_viscous_friction": {"joint": "elbow", "coefficient": 0.03},
    "drive_efficiency": {"joint": "elbow", "motoring": 0.06, "backdriving": 0.09},
    "maxwell_slip_friction": {"joint": "elbow", "torques": [0.5, 0.4], "stiffnesses": [1.5, 3.0]},
    "torque_gain": {"joint": "elbow", "gain": 1.2},
    "friction_curve": {"joint": "elbow", "velocities": [-4.0, -1.0, 1.0, 4.0], "torques": [-0.9, -0.6, 0.5, 0.8]},
}
UNSEEN = (
    "resolver_error",
    "held_friction",
)  # the torque of the true motion; and what a joint that never rests does not hold


@cache
def arm() -> ind.Arm:
    return ind.Arm("two_joints.urdf", ind.pin.buildModelFromXML(ind.TWO_JOINTS))


def robot_with(folder: Path, *effects: dict[str, object]) -> Robot:
    made = ind.two_joints(folder)
    types = catalogue()
    places = [(name, e.get("joint")) for e in effects for name in (e["type"], *types[str(e["type"])].traits.replaces)]
    declared = [d for d in DECLARED if (d["type"], d["joint"]) not in places]
    return rf.load_robot(ind.write_robot(folder, made, [*declared, *effects], known=True))


def sines(robot: Robot, phase: float = 0.0, samples: int = 200) -> Trajectory:
    """0.8 s; each joint reverses."""
    angle = np.array([5.0, 7.0]) * np.arange(samples)[:, None] / 250.0 + phase
    position, velocity = MIDDLE + SIZE * np.sin(angle), SIZE * [5.0, 7.0] * np.cos(angle)
    return Trajectory("sines", robot.joints, 250.0, position, velocity)


def controller_of(robot: Robot) -> CS8:
    """Without quantisation; everything is logged at its rate."""
    made = design_cs8(robot, MIDDLE, bandwidth_hz=6.0).ideal()
    rates = {"controller_rate_hz": RATE_HZ, "log_rate_hz": RATE_HZ, "log_cutoff_hz": 0.45 * RATE_HZ}
    return dataclasses.replace(made, **rates)  # type: ignore[arg-type]


def run_of(robot: Robot, samples: int = 200) -> Simulation:
    run = simulate(robot, controller_of(robot), sines(robot, samples=samples), raw=True)
    assert run.ended is None
    return run


@dataclasses.dataclass(frozen=True, eq=False)
class Moved:
    """What was simulated: all coordinates with their accelerations (N, n), and the drives alone as a motion (N, 2)."""

    run: Simulation
    time: Array
    q: Array
    v: Array
    a: Array
    drives: ind.Motion
    torque: Array  # (N, 2), as logged
    position: Array  # (N, 2), as logged

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Away from the ends, where a log has no past and the reference's acceleration jumps."""
        return (self.time > 0.02) & (self.time < self.run.time[-1] - 0.02)

    @staticmethod
    def of(run: Simulation) -> Moved:
        assert run.raw is not None
        # a logged torque is the mean over a period before and after its sample: so is this acceleration
        a = (run.v[2:] - run.v[:-2]) * 0.5 * RATE_HZ
        q, v, time = run.q[1:-1], run.v[1:-1], run.time[1:-1]
        at = [run.robot.layout.index(j) for j in run.robot.joints]
        drives = ind.Motion(time, q[:, at], v[:, at], a[:, at])
        return Moved(run, time, q, v, a, drives, run.raw.torque[1:-1], run.raw.position[1:-1])


def friction_and_drives(m: ind.Motion) -> Array:
    """What `DECLARED` asks for."""
    return m.a * [0.4, 0.2] + m.v * [2.0, 1.0]


def plain(m: ind.Motion) -> Array:
    """Torque of the arm as declared."""
    return arm().torque(m) + friction_and_drives(m)


def elbow(x: Array) -> Array:
    return np.outer(x, [0.0, 1.0])


def dahl(m: Moved, torque: float, stiffness: float) -> Array:
    """Dahl's equation by explicit Euler, forty steps a sample, from rest."""
    fine = np.linspace(m.run.time[0], m.run.time[-1], 40 * (len(m.run.time) - 1) + 1)
    q = np.interp(fine, m.run.time, m.run.q[:, ELBOW])
    f = np.zeros(len(fine))
    for k, step in enumerate(np.diff(q)):
        f[k + 1] = f[k] + stiffness * (step - f[k] / torque * abs(step))
    return f[::40][1:-1]


def breaking_away(m: Moved, torque: float, distance: float) -> Array:
    """Friction that fades with the farthest from the start, its sign as Dahl's along 3 % of the distance."""
    away = np.abs(m.run.q[:, ELBOW] - m.run.q[0, ELBOW])
    left = np.exp(-np.maximum.accumulate(away) / distance)[1:-1]
    return torque * left * dahl(m, 1.0, 1.0 / (0.03 * distance))


def maxwell(m: Moved, torques: list[float], stiffnesses: list[float]) -> Array:
    """Elements that stick and slip, forty steps a sample, from rest."""
    fine = np.linspace(m.run.time[0], m.run.time[-1], 40 * (len(m.run.time) - 1) + 1)
    q = np.interp(fine, m.run.time, m.run.q[:, ELBOW])
    f = np.zeros((len(fine), len(torques)))
    for k, step in enumerate(np.diff(q)):
        f[k + 1] = np.clip(f[k] + np.array(stiffnesses) * step, -np.array(torques), torques)
    return f.sum(axis=1)[::40][1:-1]


def transmission(m: Moved, p: dict[str, float]) -> Array:
    links = arm().torque(log_effects._in_error(m.drives, ELBOW, p, 1.0))
    links[:, ELBOW] *= 1 + p["amplitude"] * p["order"] * np.cos(p["order"] * m.drives.q[:, ELBOW] + p["phase"])
    return links + friction_and_drives(m.drives)


def saturated(m: Moved, p: dict[str, float]) -> Array:
    """Logged torques, from what the motors must have given."""
    given = plain(m.drives)
    ordered = [np.roots([-p["coefficient"], 0.0, 1.0, -g]) for g in given[:, ELBOW]]
    given[:, ELBOW] = [float(x[np.argmin(np.abs(x))].real) for x in ordered]
    return given


def delayed(m: Moved, p: dict[str, float]) -> Array:
    now = plain(m.drives)
    late = np.interp(m.time - p["delay"], m.time, now[:, ELBOW])
    return np.stack([now[:, 0], late], axis=1)


EXPECTED: dict[str, Callable[[Moved, dict[str, float]], Array]] = {
    "friction_drift": lambda m, p: (
        plain(m.drives) + elbow(p["coefficient"] * np.exp(-m.time / p["time_constant"]) * m.drives.v[:, ELBOW])
    ),
    "presliding_friction": lambda m, p: plain(m.drives) + elbow(dahl(m, p["torque"], p["stiffness"])),
    "breakaway_friction": lambda m, p: plain(m.drives) + elbow(breaking_away(m, p["torque"], p["distance"])),
    "load_friction": lambda m, p: (
        plain(m.drives)
        + elbow(p["coefficient"] * np.abs(arm().torque(m.drives)[:, ELBOW]) * np.sign(m.drives.v[:, ELBOW]))
    ),
    "maxwell_slip_friction": lambda m, p: plain(m.drives) + elbow(maxwell(m, p["torques"], p["stiffnesses"])),
    "held_friction": lambda m, p: plain(m.drives),
    "torque_gain": lambda m, p: plain(m.drives) * [1.0, p["gain"]],
    "transmission_error": transmission,
    "resolver_error": lambda m, p: plain(m.drives),
    "motor_saturation": saturated,
    "torque_delay": delayed,
    "line_interference": lambda m, p: (
        plain(m.drives) + elbow(p["amplitude"] * np.sin(2 * np.pi * p["frequency_hz"] * m.time + p["phase"]))
    ),
}


@cache
def moved(kind: str) -> Moved:
    """A run of the arm with one effect, made once; a type of force that has no values here has drawn ones."""
    with tempfile.TemporaryDirectory() as folder:
        if kind in VALUES:
            effects = [*([FLEXIBLE] if kind in NEEDS_TORSION else []), {"type": kind, **VALUES[kind]}]
        else:
            effects = [
                effect_to_table(e) for e in draw_effect(kind, robot_with(Path(folder)), np.random.default_rng(0))
            ]
        robot = robot_with(Path(folder), *effects)
    return Moved.of(run_of(robot))


def test_every_type_between_robot_and_log_is_here():
    assert {kind for kind, cls in catalogue().items() if not cls.traits.in_dynamics} <= set(VALUES)


@pytest.mark.parametrize("kind", sorted({*VALUES, *TYPES}))
def test_a_log_holds_the_torque_that_the_effect_makes_of_the_motion(kind):
    m = moved(kind)
    if kind in EXPECTED:
        expected = EXPECTED[kind](m, VALUES[kind])
    else:  # a force of the robot
        forces = m.run.robot.inverse_dynamics(m.q, m.v, m.a)
        expected = forces[:, [m.run.robot.layout.index(j) for j in m.run.robot.joints]]
    # within a sample of a reversal the mean over two samples says nothing about dry friction at the middle one
    rates = np.column_stack([m.drives.v, m.drives.v.sum(axis=1)])
    dry = kind in DRY or kind not in VALUES
    turning = (np.abs(rates) < 2 * np.abs(np.gradient(rates, axis=0)) + 0.1).any(axis=1) & dry
    kept = ~turning & m.inside
    assert kept.mean() > 0.5
    assert np.abs(m.torque - expected)[kept].max() < TOLERANCE
    if kind not in UNSEEN:
        assert np.abs(expected - plain(m.drives)).max() > 20 * TOLERANCE  # the effect shows


@pytest.mark.parametrize(
    ("kind", "values", "size"),
    [
        ("load_friction", {"coefficient": 0.1}, lambda m, part: 0.1 * np.abs(arm().torque(m.drives)[:, ELBOW])),
        (
            "drive_efficiency",
            {"motoring": 0.12, "backdriving": 0.05},
            lambda m, part: (
                (load := arm().torque(m.drives)[:, ELBOW]) * np.where(load * part > 0.0, 0.12, 0.05) * np.sign(load)
            ),
        ),
        (
            "position_friction",
            {"order": 5.0, "amplitude": 0.5, "phase": 0.3},
            lambda m, part: 0.5 * np.sin(5.0 * m.drives.q[:, ELBOW] + 0.3),
        ),
        (
            "stribeck_friction",
            {"torque": 0.9, "velocity": 0.8, "power": 2.0},
            lambda m, part: 0.9 * np.exp(-((m.drives.v[:, ELBOW] / 0.8) ** 2)),
        ),
    ],
)
def test_friction_along_an_angle_turns_over_in_a_simulation_as_its_law_says(kind, values, size, tmp_path):
    effect = {"type": kind, "joint": "elbow", "deflection": 0.06, **values}
    m = Moved.of(run_of(robot_with(tmp_path, effect)))
    part = dahl(m, 1.0, 1.0 / 0.06)
    friction = elbow(size(m, part) * part)
    assert np.abs(m.torque - plain(m.drives) - friction)[m.inside].max() < TOLERANCE
    assert np.abs(friction).max() > 20 * TOLERANCE


@pytest.mark.parametrize("kind", [k for k, cls in catalogue().items() if cls.traits.virtual or k in NEEDS_TORSION])
def test_coordinates_without_a_motor_stay_without_a_force(kind):
    m = moved(kind)
    forces = m.run.robot.inverse_dynamics(m.q, m.v, m.a)[m.inside]
    free = np.flatnonzero(~m.run.robot.input_matrix.any(axis=1))
    assert len(free) and np.abs(forces[:, free]).max() < TOLERANCE


@pytest.mark.parametrize("kind", ["resolver_error", "transmission_error"])
def test_a_wrong_resolver_deceives_log_and_controller_and_a_transmission_does_not(kind):
    m = moved(kind)
    p = VALUES[kind]
    wave = elbow(p["amplitude"] * np.sin(p["order"] * m.drives.q[:, ELBOW] + p["phase"]))  # type: ignore[operator]
    expected = wave if kind == "resolver_error" else 0.0 * wave
    np.testing.assert_allclose(m.position - m.drives.q, expected, rtol=0, atol=1e-12)


def test_lost_motion_is_what_the_gap_and_the_spring_leave_to_the_load():
    m = moved("backlash")
    model = m.run.robot.model
    data, at = model.createData(), m.run.robot.layout.index("elbow", "torsion")
    links = np.array([ind.pin.rnea(model, data, q, v, a)[at] for q, v, a in zip(m.q, m.v, m.a, strict=True)])
    drive = m.run.robot.layout.index("elbow")
    through = -links - 0.6 * m.v[:, at] - 1.0 * (m.v[:, at] + m.v[:, drive])  # damping, then friction behind the drive
    torsion = through / 900.0 + 0.5 * 0.004 * np.tanh(through / 1.0)
    # a torque that is off by the tolerance moves the teeth by that over the stiffness within the gap
    assert np.abs(m.q[:, at] - torsion)[m.inside].max() < TOLERANCE * (1 / 900.0 + 0.002)
    assert np.ptp(m.q[:, at]) > 0.004


def test_the_tip_follows_the_link_and_not_the_motor():
    m, p = moved("transmission_error"), VALUES["transmission_error"]
    run, model = m.run, m.run.robot.model
    q = run.q.copy()
    q[:, ELBOW] += p["amplitude"] * np.sin(p["order"] * q[:, ELBOW] + p["phase"])  # type: ignore[operator]
    data, frame = model.createData(), model.getFrameId(run.robot.tip_frame)
    for k in (100, 500):
        ind.pin.framesForwardKinematics(model, data, q[k])
        np.testing.assert_allclose(run.tip[k], data.oMf[frame].homogeneous, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["transmission_error", "backlash", "presliding_friction"])
def test_energy_is_neither_made_nor_lost(kind, tmp_path):
    needed = [FLEXIBLE] if kind == "backlash" else []
    run = run_of(robot_with(tmp_path, *needed, {"type": kind, **VALUES[kind]}), samples=60)
    # second order in steps of 1 ms: (7 rad/s * 1 ms)^2 / 6 of the energy that comes and goes
    assert run.power_balance_error < 1e-5


def test_backlash_of_a_rigid_joint_is_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r"declared: elbow\.backlash cannot be simulated without the drive_flexibility"
    ):
        run_of(robot_with(tmp_path, {"type": "backlash", **VALUES["backlash"]}))


def test_memory_survives_lanes_and_chunks(tmp_path):
    """Two lanes with other motions each keep their own: alone they come to the same."""
    robot = robot_with(tmp_path, {"type": "presliding_friction", **VALUES["presliding_friction"]})
    one, other = (sines(robot, phase, samples=80) for phase in (0.0, 1.0))
    controller = controller_of(robot)
    together = simulate_lanes(robot, controller, [one, other])
    for trajectory, run in zip((one, other), together, strict=True):
        alone = simulate(robot, controller, trajectory)
        np.testing.assert_allclose(run.q, alone.q, rtol=0, atol=1e-9)
