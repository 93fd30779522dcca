"""A designed excitation beside that of section 4.2.2: condition number, limits, and errors of what is identified from both.

rx90b_4dof under its CS8, two steady periods of 4.096 s each, simulated in closed loop, with the same noise (white, on every
coordinate and drive torque, at the controller's 4 kHz), logged at 500 Hz. Both go through the same two ways: re-weighted least
squares on the essential space, and that freed of its bias by repeating the experiment on the identified robot
(`indirect_inference`): friction turns faster than any log resolves.

    python benchmarks/excitation_design.py [--seed 0] [--feedforward 45] [--evaluations 900]
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
from all_coordinates import CoordinatesFit, Equations, FullLog, indirect_inference, logs_everything, reweighted
from designed_motion.limits import Limits
from designed_motion.search import Design, design_excitation, periodic_derivative, simulated_margins

import rx90b_flex as rf
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import Simulation, Trajectory, load_cs8, simulate, sine_excitation

Array = np.ndarray
LOG_RATE_HZ = 500.0
POSITION_NOISE, TORQUE_NOISE = 1e-6, 0.5  # rad, N m
EDGE_S = 0.3  # of a log beyond its period, for the filters
THESIS_RANK = 59
KINDS = (
    "drive_inertia",
    "viscous",
    "stribeck",
    "drive_flexibility.stiffness",
    "joint_flexibility.stiffness",
    "damping",
)


def logs(robot: Robot, trajectory: Trajectory, rng: np.random.Generator | None = None) -> list[FullLog]:
    """The second and third period, with noise where a generator is given."""
    run = simulate(robot, logs_everything(load_cs8().for_joints(robot.joints)), trajectory.repeated(4), raw=True)
    assert run.ended is None and run.raw is not None, run.ended
    whole, period = FullLog(run.raw.rate_hz, run.q, run.raw.torque), trajectory.period_s
    parts = [whole.part(k * period - EDGE_S, (k + 1) * period + EDGE_S) for k in (1, 2)]
    if rng is not None:
        parts = [part.with_noise(POSITION_NOISE, TORQUE_NOISE, rng) for part in parts]
    return [part.downsampled(LOG_RATE_HZ) for part in parts]


def errors(design: Design, trajectory: Trajectory, draws: int) -> dict[str, Array]:
    """Errors of the scaled parameters, projected on the essential space, shape (draws, p), by way of identification."""
    robot, space = design.robot, design.essential

    def estimate(measured: Sequence[FullLog]) -> CoordinatesFit:
        return reweighted(Equations.of(robot, measured), design.scale, dimension=space.shape[1])

    ways: dict[str, Callable[[list[FullLog]], CoordinatesFit]] = {
        "re-weighted": estimate,
        "without bias": lambda x: indirect_inference(robot, x, estimate, lambda r: logs(r, trajectory)),
    }
    found: dict[str, list[Array]] = {way: [] for way in ways}
    for draw in range(draws):
        measured = logs(robot, trajectory, np.random.default_rng(1 + draw))
        for way, fit in ways.items():
            off = (fit(measured).parameters - robot.parameters) / design.scale
            found[way].append(space @ (space.T @ off))
    return {way: np.array(x) for way, x in found.items()}


def report(name: str, design: Design, run: Simulation, draws: int) -> dict[str, Array]:
    """Print one experiment's numbers; returns the root mean square error of each parameter by way."""
    told, names = design.assess(run), design.robot.parameter_names
    literal = np.where(design.robot.parameters == 0.0, 1.0, np.abs(design.robot.parameters))
    q, v, a = run.q[-1024:], run.v[-1024:], periodic_derivative(run.v[-1024:], design.trajectory.period_s)
    printed = np.linalg.svd((design.robot.regressor(q, v, a) * literal).reshape(-1, len(literal)), compute_uv=False)
    once = dataclasses.replace(
        run.trajectory.part(0.0, design.trajectory.duration_s), period_s=design.trajectory.period_s
    )
    count = len(told.singular_values)
    print(f"\n{name}\n  condition number {told.condition:.1f} on {count} directions; smallest singular value "
          f"{told.singular_values[-1]:.3g} N m; columns by table D.1 as printed: {printed[0] / printed[count - 1]:.3g}, "
          f"of the {THESIS_RANK} largest {printed[0] / printed[THESIS_RANK - 1]:.0f}")  # fmt: skip
    print(f"  {simulated_margins(design.limits, run)}")
    rms = {way: np.sqrt(np.mean(x**2, axis=0)) for way, x in errors(design, once, draws).items()}
    for way, error in rms.items():
        print(f"  {way}: rms {np.sqrt(np.mean(error**2)):.4f}, median {np.median(error):.5f}, largest {error.max():.3f} "
              f"({names[int(error.argmax())]}); by kind "
              + ", ".join(f"{kind} {np.sqrt(np.mean(error[_of(names, kind)] ** 2)):.5f}" for kind in KINDS), flush=True)  # fmt: skip
    return rms


def _of(names: Sequence[str], kind: str) -> list[int]:
    return [i for i, name in enumerate(names) if kind in name]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--feedforward", type=float, default=None, help="largest feed-forward torque, N m (45 in 4.2.2)"
    )
    parser.add_argument("--evaluations", type=int, default=450)
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--draws", type=int, default=2, help="of the noise")
    options = parser.parse_args()
    robot, controller = rf.load_robot("rx90b_4dof"), load_cs8()
    limits = Limits.of(robot, controller, feedforward=options.feedforward)

    def tell(text: str, part: float) -> None:
        print(f"\r{part:4.0%} {text:50s}", end="", file=sys.stderr)

    start = time.process_time()
    design = design_excitation(
        robot,
        seed=options.seed,
        controller=controller,
        limits=limits,
        evaluations=options.evaluations,
        starts=options.starts,
        progress=tell,
    )
    print(
        f"\ndesigned in {time.process_time() - start:.0f} s of processor time; predicted condition {design.predicted.condition:.1f}"
    )
    source = sine_excitation(robot, np.random.default_rng(0))
    base = simulate(robot, controller, source.repeated(2), raw=True)
    before = report("section 4.2.2", design, base, options.draws)
    after = report("designed", design, design.simulation, options.draws)
    ratio = design.assess(base).condition / design.assess().condition
    print(f"\ncondition number {ratio:.2f} times smaller")
    for way in before:
        one, other = before[way], after[way]
        norms, medians = np.linalg.norm(one) / np.linalg.norm(other), np.median(one) / np.median(other)
        print(
            f"{way}: rms error {norms:.1f} times smaller, median {medians:.1f}, largest {one.max() / other.max():.1f} times; "
            f"{np.mean(other <= one):.0%} of the parameters with a smaller error"
        )


if __name__ == "__main__":
    main()
