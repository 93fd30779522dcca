"""Speed of the nonlinear closed-loop simulation, in multiples of real time: python benchmarks/simulation.py [--quick]

rx90b_4dof, 16 coordinates, friction, spring, controller at 4 kHz, log at 250 Hz; beside MuJoCo's bare stepping of the
same tree (no controller, no friction, no spring; stiffness and damping of the hinges and drive inertias alone) at the
same 4 kHz. Runs on two processes, one thread each.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
from joblib import Parallel, delayed
from lxml import etree

import rx90b_flex as rf
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import Trajectory, load_cs8, multisine, simulate, simulate_lanes, square_wave, straight_line
from rx90b_flex.simulate.trajectories import FEEDFORWARD_LINES, FEEDFORWARD_PEAK

STRETCHED = (0.0, np.pi / 2, 0.0, 0.0)
LANES = 8  # runs a job


def median_s(call: Callable[[], object], times: int = 7) -> float:
    """Median duration, s, after one call that warms up."""
    call()
    durations = []
    for _ in range(times):
        start = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations)


def campaign(robot: Robot, runs: int, periods: int) -> list[Trajectory]:
    """Runs of section 6.6.2: one nominal motion, multisines of odd lines on joints 1 to 3."""
    nominal = square_wave(robot, STRETCHED, moving=robot.joints[:3])
    rng = np.random.default_rng(0)
    excited = np.array([1.0, 1.0, 1.0, 0.0])
    return [
        nominal.with_feedforward(
            multisine(FEEDFORWARD_LINES, 1024, FEEDFORWARD_PEAK, rng, 4) * excited, f"run_{i}"
        ).repeated(periods)
        for i in range(runs)
    ]


def job(trajectories: list[Trajectory]) -> tuple[float, int]:
    """Simulate some runs; returns seconds of robot time and the peak memory of this process, MB."""
    runs = simulate_lanes(rf.load_robot("rx90b_4dof"), load_cs8(), trajectories)
    assert all(run.ended is None for run in runs), [run.ended for run in runs]
    seconds = sum(run.recording.duration_s for run in runs)
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def bare_mujoco(robot: Robot) -> mujoco.MjModel:
    """The flexible tree in MuJoCo with its hinges' stiffness, damping and the drives' inertias; no friction, no
    spring.
    """
    root = etree.fromstring(robot.flexible_urdf.encode())
    etree.SubElement(etree.SubElement(root, "mujoco"), "compiler", balanceinertia="true", boundmass="1e-9",
                     boundinertia="1e-9", discardvisual="true", fusestatic="false")  # fmt: skip
    spec = mujoco.MjSpec.from_string(etree.tostring(root).decode())
    spec.option.timestep = 1.0 / 4000.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    for effect in robot.effects:
        joint = effect.joints[0]
        if effect.type_name() == "drive_inertia":
            model.joint(joint).armature[:] = effect.coefficients
        elif effect.virtual:
            stiffness, damping = np.split(effect.coefficients, 2)
            for kind, k, d in zip(effect.virtual, stiffness, damping, strict=True):
                model.joint(f"{joint}_{kind}").stiffness[:] = k
                model.joint(f"{joint}_{kind}").damping[:] = d
    return model


def mujoco_speed(robot: Robot, start: np.ndarray) -> float:
    model = bare_mujoco(robot)
    data = mujoco.MjData(model)
    data.qpos[:] = start

    def second() -> None:
        mujoco.mj_step(model, data, 4000)

    return 1.0 / median_s(second)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="12 runs of 2 periods instead of 96 of 9")
    quick = parser.parse_args().quick
    robot, controller = rf.load_robot("rx90b_4dof"), load_cs8()
    start = time.perf_counter()
    line = straight_line(robot)
    simulate(robot, controller, line.part(0.0, 0.02))
    print(f"start-up (compiled code from the cache, or compiled now): {time.perf_counter() - start:.2f} s")
    single = line.duration_s / median_s(lambda: simulate(robot, controller, line))
    print(f"one run, the 1.7 m line:  {single:6.1f} x real time   (asked: 5)")
    bare = mujoco_speed(robot, np.array(simulate(robot, controller, line.part(0.0, 0.02)).q[0]))
    print(f"MuJoCo, bare stepping:    {bare:6.1f} x real time   ratio of ours to it: {single / bare:.2f}")

    runs, periods = (12, 2) if quick else (96, 9)
    trajectories = campaign(robot, runs, periods)
    jobs = [trajectories[i : i + LANES] for i in range(0, runs, LANES)]
    with Parallel(n_jobs=2) as pool:
        pool(delayed(job)(campaign(robot, 1, 1)) for _ in range(2))
        start = time.perf_counter()
        done = pool(delayed(job)(part) for part in jobs)
        taken = time.perf_counter() - start
    seconds = sum(s for s, _ in done)
    memory = max(m for _, m in done)
    print(f"campaign of {runs} runs of {periods} periods, {seconds / 60:.1f} min of robot time, two processes:")
    speed = f"{seconds / taken:6.1f} x real time   (asked: 40)"
    print(f"                          {speed}, {taken:.0f} s, {memory} MB a process")


if __name__ == "__main__":
    main()
