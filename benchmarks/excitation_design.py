"""A designed excitation beside that of section 4.2.2: condition number, limits, and errors of what is identified from both.

rx90b_4dof under its CS8, one steady period of 4.096 s each. Both experiments are simulated in closed loop, get the same
noise (white, on every coordinate and drive torque, at the controller's 4 kHz), and go through the same plain least squares: angles
low-passed at 1 kHz and differentiated by their Fourier series, columns and torques at 115 Hz, columns scaled by the
first guess, pseudo-inverse on the essential space.

    python benchmarks/excitation_design.py [--seed 0] [--feedforward 45] [--evaluations 900]
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time

import numpy as np

import rx90b_flex as rf
from rx90b_flex.excitation.design import Design, design_excitation, periodic_derivative, simulated_margins
from rx90b_flex.excitation.limits import Limits
from rx90b_flex.identify.all_coordinates import logs_everything
from rx90b_flex.simulate import Simulation, Trajectory, load_cs8, simulate, sine_excitation

Array = np.ndarray
POSITION_CUTOFF_HZ, CUTOFF_HZ = 1000.0, 115.0  # friction turns within a millisecond; the fit needs only what is excited
POSITION_NOISE, TORQUE_NOISE = 1e-6, 0.5  # rad, N m
THESIS_RANK = 59


def steady(design: Design, trajectory: Trajectory) -> tuple[Array, Array]:
    """Coordinates and drive torques of the second period, at the controller's rate."""
    run = simulate(design.robot, logs_everything(design.controller), trajectory.repeated(2), raw=True)
    assert run.ended is None and run.raw is not None, run.ended
    count = round(trajectory.period_s * run.raw.rate_hz)
    return run.q[-count:], run.raw.torque[-count:]


def low_passed(x: Array, period_s: float, cutoff_hz: float = CUTOFF_HZ) -> Array:
    """One period without its lines above the cutoff."""
    lines = np.fft.rfft(x, axis=0)
    lines[round(cutoff_hz * period_s) :] = 0.0
    return np.fft.irfft(lines, n=len(x), axis=0)


def identified(design: Design, q: Array, torque: Array, rank: int | None = None) -> Array:
    """Scaled parameters, on the essential space, from one period; shape (p,)."""
    period = design.trajectory.period_s
    q = low_passed(q, period, POSITION_CUTOFF_HZ)
    v = periodic_derivative(q, period)
    regressor = design.robot.regressor(q, v, periodic_derivative(v, period)) * design.scale
    target = torque @ design.robot.input_matrix.T
    thin = slice(None, None, len(q) // round(2.0 * CUTOFF_HZ * period))
    columns, target = (low_passed(x, period)[thin] for x in (regressor, target))
    u, s, vt = np.linalg.svd(columns.reshape(-1, len(design.scale)) @ design.essential, full_matrices=False)
    kept = slice(0, rank)
    return design.essential @ (vt[kept].T @ ((u[:, kept].T @ target.ravel()) / s[kept]))


def errors(design: Design, trajectory: Trajectory, draws: int, rank: int | None = None) -> Array:
    """Errors of the scaled parameters, projected on the essential space, shape (draws, p)."""
    q, torque = steady(design, trajectory)
    truth = design.essential @ (design.essential.T @ (design.robot.parameters / design.scale))
    rng = np.random.default_rng(1)
    found = []
    for _ in range(draws):
        noisy = q + POSITION_NOISE * rng.standard_normal(q.shape)
        found.append(identified(design, noisy, torque + TORQUE_NOISE * rng.standard_normal(torque.shape), rank) - truth)
    return np.array(found)


def report(name: str, design: Design, run: Simulation, draws: int) -> Array:
    """Print one experiment's numbers; returns the root mean square error of each parameter."""
    told = design.assess(run)
    literal = np.where(design.robot.parameters == 0.0, 1.0, np.abs(design.robot.parameters))
    q, v, a = run.q[-1024:], run.v[-1024:], periodic_derivative(run.v[-1024:], design.trajectory.period_s)
    printed = np.linalg.svd((design.robot.regressor(q, v, a) * literal).reshape(-1, len(literal)), compute_uv=False)
    once = dataclasses.replace(
        run.trajectory.part(0.0, design.trajectory.duration_s), period_s=design.trajectory.period_s
    )
    found = errors(design, once, draws)
    error, scatter = np.sqrt(np.mean(found**2, axis=0)), np.std(found, axis=0)
    print(f"\n{name}\n  condition number {told.condition:.1f} on {len(told.singular_values)} directions; log determinant "
          f"{2 * told.information:.1f}; columns by table D.1 as printed: {printed[0] / printed[len(told.singular_values) - 1]:.3g}, "
          f"of the {THESIS_RANK} largest {printed[0] / printed[THESIS_RANK - 1]:.0f}")  # fmt: skip
    print(f"  {simulated_margins(design.limits, run)}")
    print(f"  error of the scaled parameters: rms {np.sqrt(np.mean(error**2)):.4f}, median {np.median(error):.5f}, "
          f"largest {error.max():.3f} ({design.robot.parameter_names[int(error.argmax())]}); "
          f"of which the noise's scatter: rms {np.sqrt(np.mean(scatter**2)):.4f}")  # fmt: skip
    return error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--feedforward", type=float, default=None, help="largest feed-forward torque, N m (45 in 4.2.2)"
    )
    parser.add_argument("--evaluations", type=int, default=450)
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--draws", type=int, default=4, help="of the noise")
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
    smaller = float(np.mean(after <= before))
    errors_ratio = np.linalg.norm(before) / np.linalg.norm(after)
    print(f"\ncondition number {ratio:.2f} times smaller; rms error {errors_ratio:.1f} times smaller; "
          f"median {np.median(before) / np.median(after):.1f}, largest {before.max() / after.max():.1f} times; "
          f"{smaller:.0%} of the parameters with a smaller error")  # fmt: skip


if __name__ == "__main__":
    main()
