"""Cost of each effect type in a simulation: python benchmarks/effects.py [--robot NAME] [--seconds S] [--in-between] [TYPE ...]

Processor time of a run of a six-joint robot under its controller with one effect of each type at joint 2, over that of the run with
`coulomb_friction` in its place; all six axes move on sines. With `--in-between` all that is not a torque by one angle is worked out
in Python between the parts of each step, as for an effect without a law.
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import rx90b_flex as rf
from rx90b_flex.effects import Effect, catalogue
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import Trajectory, closed_loop, load_cs8, simulate

BESIDE = "coulomb_friction"
# of a size that leaves the motion much as it is
VALUES: dict[str, dict[str, Any]] = {
    "angle_curve": {"angles": (-0.5, 0.0, 0.5), "torques": (-2.0, 0.0, 3.0)},
    "asymmetric_friction": {"coefficient": 2.0},
    "backlash": {"gap": 1e-4},
    "base_flexibility": {"stiffness": (2e6, 2e6), "damping": (2e3, 2e3)},
    "base_tilt": {"angle_x": 0.01, "angle_y": -0.01},
    "breakaway_friction": {"torque": 10.0, "distance": 0.01},
    "cable_torque": {"bends": (3.0, 1.0)},
    "coulomb_friction": {"torque": 10.0},
    "drive_efficiency": {"motoring": 0.06, "backdriving": 0.04},
    "drive_flexibility": {"stiffness": 2e5, "damping": 200.0},
    "drive_inertia": {"inertia": 1.0},
    "friction_curve": {"velocities": (-2.0, 0.0, 2.0), "torques": (-9.0, 0.0, 8.0)},
    "friction_drift": {"coefficient": 10.0, "time_constant": 3.0},
    "gear_ripple": {"order": 20.0, "amplitude": 2.0, "phase": 0.3},
    "gravity_spring": {"stiffness": 2e3, "prestress": 100.0, "anchors": (0.0, 0.0, 0.3, 0.0, 0.0, 0.1)},
    "held_friction": {"torque": 5.0},
    "joint_coupling": {"inertia": 0.05, "viscous": 1.0, "coulomb": 0.5},
    "joint_flexibility": {"stiffness": (4e5, 4e5), "damping": (400.0, 400.0)},
    "joint_spring": {"stiffness": 20.0, "rest_angle": 0.2},
    "line_interference": {"frequency_hz": 50.0, "amplitude": 0.8, "phase": 0.4},
    "load_friction": {"coefficient": 0.05},
    "load_viscous_friction": {"coefficient": 0.05},
    "maxwell_slip_friction": {"torques": (5.0, 4.0), "stiffnesses": (5e3, 1e3)},
    "motor_saturation": {"coefficient": 1e-6},
    "payload": {"mass": 5.0, "centre": (0.0, 0.0, 0.1)},
    "position_friction": {"order": 5.0, "amplitude": 6.0, "phase": 0.3},
    "presliding_friction": {"torque": 10.0, "stiffness": 1e4},
    "resolver_error": {"order": 2.0, "amplitude": 1e-4, "phase": 0.5},
    "stiffness_hardening": {"cubic": 1e9},
    "stribeck_friction": {"torque": 10.0, "velocity": 0.05, "power": 1.0},
    "torque_delay": {"delay": 1e-3},
    "torque_gain": {"gain": 1.1},
    "torque_offset": {"torque": 4.0},
    "transmission_error": {"order": 20.0, "amplitude": 1e-4, "phase": 0.5},
    "viscous_friction": {"coefficient": 20.0},
    "viscous_power_friction": {"coefficient": 20.0, "power": 0.7},
}


def effect_of(kind: str, robot: Robot) -> Effect:
    """One effect with its values, at joint 2."""
    cls = catalogue()[kind]
    place = {
        "joint": {"joint": robot.joints[1]},
        "joints": {"joint_pair": robot.joints[1:3]},
        "frame": {"frame": robot.tip_frame},
        "robot or joint": {"joint": robot.joints[1]},
        "robot": {},
    }[cls.traits.on]
    return cls(**place, **VALUES[kind])


def with_effect(robot: Robot, kind: str) -> Robot:
    """The robot with it in place of what stands there."""
    effect = effect_of(kind, robot)
    there = (kind, *effect.traits.stands_for)
    kept = [e for e in robot.effects if not (e.type_name() in there and e.place == effect.place)]
    needed = (*effect.traits.needs, *(["drive_flexibility"] if kind == "backlash" else []))
    absent = [n for n in needed if not any(e.type_name() == n and e.place == effect.place for e in kept)]
    return robot.with_effects([*kept, *(effect_of(n, robot) for n in absent), effect])


def sines(robot: Robot, seconds: float) -> Trajectory:
    """Sines of 0.2 rad, 0.3 to 0.55 Hz, about a pose with bent elbow, begun at rest."""
    joints = len(robot.joints)
    time_s = np.arange(round(250 * seconds)) / 250.0
    pace = 2.0 * np.pi * (0.3 + 0.05 * np.arange(joints))
    middle = 0.5 * (np.arange(joints) == 1) + 0.8 * (np.arange(joints) == 2)
    angle = pace * time_s[:, None]
    return Trajectory("sines", robot.joints, 250.0, middle - 0.2 * np.cos(angle), 0.2 * pace * np.sin(angle))


def processor_s(robot: Robot, trajectory: Trajectory, times: int) -> float:
    """Least processor time of several runs, after a short one that compiles, s."""
    controller, taken = load_cs8(), []
    robot.plant  # noqa: B018  # made once, as in every call of a user's
    simulate(robot, controller, trajectory.part(0.0, 0.1))
    for _ in range(times):
        start = time.process_time()
        run = simulate(robot, controller, trajectory)
        taken.append(time.process_time() - start)
        assert run.ended is None, run.ended
    return min(taken)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("types", nargs="*", default=[])
    parser.add_argument("--robot", default="rx90b")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--in-between", action="store_true")
    stated = parser.parse_args()
    robot = rf.load_robot(stated.robot)
    trajectory = sines(robot, stated.seconds)
    beside = processor_s(with_effect(robot, BESIDE), trajectory, stated.times)
    print(f"{stated.robot}, {stated.seconds:g} s with {BESIDE}: {beside:.2f} s of processor")
    if stated.in_between:
        closed_loop._Runner._laws = lambda self, rest: None  # type: ignore[method-assign]
    for kind in stated.types or sorted(VALUES):
        taken = processor_s(with_effect(robot, kind), trajectory, stated.times)
        print(f"{kind:24s} {taken:7.2f} s, {taken / beside:6.2f} times", flush=True)


if __name__ == "__main__":
    main()
