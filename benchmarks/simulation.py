"""Speed of the nonlinear closed-loop simulation, in multiples of real time: python benchmarks/simulation.py [--quick]

rx90b_4dof, 16 coordinates, friction, spring, controller at 4 kHz, log at 250 Hz; beside MuJoCo's and Exudyn's bare
stepping of the same tree (no controller, no friction, no gravity spring; stiffness and damping of the hinges and drive
inertias alone): MuJoCo at the same 4 kHz by its linearly implicit method of first order, Exudyn (where it is installed:
extra `bench`) by the explicit midpoint rule, which is of second order as ours is, at 5 kHz: a hinge's damper here dies
away with 8900 /s, and at 4 kHz the rule, stable up to 2 a step, lets it grow without end. Both are checked to fall
alike. The campaign runs on two processes, one thread each.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
from joblib import Parallel, delayed
from lxml import etree

import rx90b_flex as rf
from rx90b_flex.plant import tree_of
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import Trajectory, load_cs8, multisine, simulate, simulate_lanes, square_wave, straight_line
from rx90b_flex.simulate.trajectories import FEEDFORWARD_LINES, FEEDFORWARD_PEAK

STRETCHED = (0.0, np.pi / 2, 0.0, 0.0)
LANES = 8  # runs a job
EXUDYN_HZ = 5000.0  # at which its explicit rule is stable


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
        elif effect.traits.virtual:
            stiffness, damping = np.split(effect.coefficients, 2)
            for kind, k, d in zip(effect.traits.virtual, stiffness, damping, strict=True):
                model.joint(f"{joint}_{kind}").stiffness[:] = k
                model.joint(f"{joint}_{kind}").damping[:] = d
    return model


def mujoco_speed(robot: Robot, start: np.ndarray) -> tuple[float, np.ndarray]:
    """Times real time, and where 0.1 s leads from the start."""
    model = bare_mujoco(robot)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    mujoco.mj_step(model, data, 400)
    early = data.qpos.copy()
    return 1.0 / median_s(lambda: mujoco.mj_step(model, data, 4000)), early


def bare_exudyn(robot: Robot, start: np.ndarray) -> tuple[Any, Any]:
    """The same tree in Exudyn: a kinematic tree, and on the same coordinates an object with the hinges' stiffness and
    damping and the drives' inertias.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    container = exu.SystemContainer()
    system = container.AddSystem()
    tree, n = tree_of(robot.model), robot.model.nv
    centres = tree.moment / np.where(tree.mass > 0.0, tree.mass, 1.0)[:, None]
    crosses = np.array([np.cross(np.eye(3), c) for c in centres])
    about_centres = tree.inertia + tree.mass[:, None, None] * crosses @ crosses
    kinds = (exu.JointType.RevoluteX, exu.JointType.RevoluteY, exu.JointType.RevoluteZ)
    assert not tree.prismatic.any() and (tree.axis.max(axis=1) == 1.0).all()
    node = system.AddNode(
        items.NodeGenericODE2(
            numberOfODE2Coordinates=n, referenceCoordinates=[0.0] * n, initialCoordinates=list(start),
            initialCoordinates_t=[0.0] * n,
        )
    )  # fmt: skip
    system.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node,
            gravity=list(tree.gravity),
            jointTypes=[kinds[a.argmax()] for a in tree.axis],
            linkParents=[int(p) for p in tree.parent],
            jointTransformations=exu.Matrix3DList(list(tree.rotation)),
            jointOffsets=exu.Vector3DList(list(tree.offset)),
            linkInertiasCOM=exu.Matrix3DList(list(about_centres)),
            linkCOMs=exu.Vector3DList(list(centres)),
            linkMasses=list(tree.mass),
        )
    )
    bare = robot.with_effects([e for e in robot.effects if e.traits.virtual or e.type_name() == "drive_inertia"])
    drives = np.zeros(n)
    drives[bare.plant.drives] = [e.coefficients[0] for e in bare.effects if e.type_name() == "drive_inertia"]
    hinges = np.zeros((2, n))
    for e in bare.effects:
        for kind, k, d in zip(e.traits.virtual, *np.split(e.coefficients, 2), strict=True) if e.traits.virtual else []:
            hinges[:, bare.layout.index(e.joints[0], kind)] = k, d
    matrices = {
        "massMatrix": np.diag(drives),
        "stiffnessMatrix": np.diag(hinges[0]),
        "dampingMatrix": np.diag(hinges[1]),
    }
    system.AddObject(items.ObjectGenericODE2(nodeNumbers=[node], **matrices))
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = False
    return system, settings


def exudyn_speed(robot: Robot, start: np.ndarray) -> tuple[float, np.ndarray] | None:
    """The same by Exudyn; None where it is not installed."""
    try:
        import exudyn as exu
    except ImportError:
        return None
    system, settings = bare_exudyn(robot, start)

    def steps(seconds: float) -> None:
        settings.timeIntegration.numberOfSteps = round(EXUDYN_HZ * seconds)
        settings.timeIntegration.endTime = seconds
        system.SolveDynamic(settings, solverType=exu.DynamicSolverType.ExplicitMidpoint)

    steps(0.1)
    early = np.array(system.systemData.GetODE2Coordinates())
    return 1.0 / median_s(lambda: steps(1.0), 3), early


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
    start_q = np.array(simulate(robot, controller, line.part(0.0, 0.02)).q[0])
    bare, there = mujoco_speed(robot, start_q)
    print(f"MuJoCo, bare stepping:    {bare:6.1f} x real time   ratio of ours to it: {single / bare:.2f}")
    other = exudyn_speed(robot, start_q)
    if other is None:
        print("Exudyn is not installed: pip install rx90b-flex[bench]")
    else:
        apart = np.abs(other[1] - there).max() / np.abs(there - start_q).max()
        assert apart < 0.05, "not the same tree"
        print(
            f"Exudyn, bare stepping:    {other[0]:6.1f} x real time   ratio of ours to it: {single / other[0]:.2f}",
            end="",
        )
        print(f"   (0.1 s of fall: {100 * apart:.2g} % from MuJoCo's)")

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
