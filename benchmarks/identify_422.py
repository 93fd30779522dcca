"""The identification experiment of section 4.2.2: errors of all parameters beside table D.1's, and the tip on the line.

One run of 8.2 s of the robot rx90b_4dof under the CS8, every coordinate logged at 250 Hz, 78 parameters from a first
guess that is up to 20 % off. Three ways: the source's (differences at 250 Hz), least squares and re-weighted least
squares of this package's equations.

    python benchmarks/identify_422.py                   # tables
    python benchmarks/identify_422.py --figures FOLDER  # and the source's two plots for each way
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from all_coordinates import (
    CoordinatesFit,
    Equations,
    FullLog,
    full_log,
    indirect_inference,
    least_squares,
    logs_everything,
    other_periods,
    reweighted,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import rx90b_flex as rf
from rx90b_flex.effects.motion import Array
from rx90b_flex.export import with_parameters
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import Simulation, load_cs8, simulate, sine_excitation, straight_line
from rx90b_flex.view.axes import AFTER, BEFORE, FLOOR, MEASURED

GUESS = 0.2  # largest relative error of the first guess

# Table D.1, last column: errors in the essential space, %. By name's part, joints 1 to 4 (bendings: 1a 1b 2a 2b ...).
SOURCE = {
    "drive_inertia": (3.8, 2.8, 2.5, 4.7),
    "gravity_spring": (1.0, 0.2),
    "viscous": (0.2, 0.5, 0.3, 0.7),
    "drive_flexibility.stiffness": (0.7, 0.4, 0.5, 20.7),
    "joint_flexibility.stiffness": (0.2, 0.3, 0.5, 0.6, 0.6, 1.6, 0.5, 0.8),
    "drive_flexibility.damping": (6.1, 1.4, 1.4, 21.1),
    "joint_flexibility.damping": (0.9, 0.3, 2.9, 8.7, 0.7, 14.2, 0.6, 1.0),
}


def experiment(robot: Robot, seed: int, periods: int = 2) -> FullLog:
    """Logs of all coordinates at 250 Hz."""
    controller = logs_everything(load_cs8())
    trajectory = sine_excitation(robot, np.random.default_rng(seed), periods=periods)
    run = simulate(robot, controller, trajectory, raw=True)
    assert run.ended is None, run.ended
    return full_log(run).downsampled()


def errors(fit: CoordinatesFit, true: Array, part: str) -> list[float]:
    """Relative errors in the essential space of the parameters whose name holds `part`, %."""
    found, expected = fit.essential(fit.parameters), fit.essential(true)
    places = [i for i, name in enumerate(fit.equations.robot.parameter_names) if part in name]
    return [100 * abs(found[i] / expected[i] - 1) for i in places]


def print_noisy(robot: Robot, log: FullLog, start: Array, noise: float, seed: int) -> None:
    """Bias of least squares when every angle is noisy, and instruments against it."""
    true = robot.parameters
    rng = np.random.default_rng(seed + 2)
    pair = Equations.of(robot, [log.with_noise(noise, 0.0, rng) for _ in range(2)])
    run = simulate(
        with_parameters(robot, start, allow_inconsistent=True),
        logs_everything(load_cs8()),
        sine_excitation(robot, np.random.default_rng(seed), periods=2),
        raw=True,
    )
    simulated = Equations.of(robot, [full_log(run).downsampled()] * 2)
    ways = {"least squares": None, "other period": other_periods(pair), "simulated guess": simulated}
    fits = {name: least_squares(pair, start, instruments=z) for name, z in ways.items()}
    print(f"With white noise of {noise:g} rad on every angle at 250 Hz, two runs: errors, % (dimensions", end=" ")
    print(", ".join(str(f.dimension) for f in fits.values()) + ")")
    for part in ("drive_inertia", "drive_flexibility.stiffness", "joint_flexibility.stiffness"):
        print(f"  {part}")
        for name, fit in fits.items():
            print(f"    {name:16s}" + "".join(f"{x:8.3f}" for x in errors(fit, true, part)))


def tip_difference_mm(one: Simulation, other: Simulation) -> float:
    """Largest distance of two tips at one time, mm."""
    return 1e3 * float(np.linalg.norm(one.tip[:, :3, 3] - other.tip[:, :3, 3], axis=1).max())


def residual_by_dimension(fit: CoordinatesFit, true: Array | None = None) -> Figure:
    """Norm of the residual over the number of singular values kept: figure 4.4 of the source.

    Parameters
    ----------
    fit : Fit
    true : array, shape (p,), optional
        True parameters, where a simulation knows them: their residual is the noise.
    """
    figure, ax = _axes(fit, "norm of the weighted residual")
    dimensions = np.arange(len(fit.residual_norms))
    ax.semilogy(dimensions, fit.residual_norms, color=AFTER, linewidth=1.2, label="residual")
    ax.axhline(fit.noise_norm, color=FLOOR, linewidth=1.0, linestyle="--", label="noise, estimated")
    if true is not None:
        ax.axhline(fit.norm_of(true), color=MEASURED, linewidth=1.0, linestyle=":", label="true parameters")
    ax.legend(frameon=False, fontsize=8)
    return figure


def error_by_dimension(fit: CoordinatesFit, true: Array) -> Figure:
    """Largest error of a parameter in the essential space over the number of singular values kept: figure 4.5.

    Each over its first guess, so that units do not matter.
    """
    figure, ax = _axes(fit, "largest error in the essential\nspace, over the first guess")
    errors = fit.errors_by_dimension(true)[: fit.rank]
    ax.semilogy(1 + np.arange(len(errors)), errors, color=AFTER, linewidth=1.2, marker="o", markersize=2.5)
    return figure


def _axes(fit: CoordinatesFit, what: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.4, 2.8), layout="constrained")
    ax = figure.subplots()
    ax.axvline(fit.dimension, color=BEFORE, linewidth=0.8, linestyle=":")
    ax.text(fit.dimension, 1.01, str(fit.dimension), transform=ax.get_xaxis_transform(), ha="center", fontsize=8)
    ax.set_xlim(0, len(fit.start))
    ax.set_xlabel("number of singular values", fontsize=9)
    ax.set_ylabel(what, fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)
    ax.grid(color="#dddddd", linewidth=0.5)
    return figure, ax


def main() -> None:
    """Print the tables."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--noise", type=float, default=3e-6, help="of the angles in the last table, rad")
    arguments.add_argument("--figures", type=Path)
    options = arguments.parse_args()

    robot = rf.load_robot("rx90b_4dof")
    true = robot.parameters
    start = true * (1 + GUESS * np.random.default_rng(options.seed + 1).uniform(-1, 1, len(true)))
    log = experiment(robot, options.seed)
    own = Equations.of(robot, [log])
    ways: dict[str, Callable[[], CoordinatesFit]] = {
        "source's way": lambda: least_squares(Equations.of(robot, [log], upsampling=1), start),
        "least squares": lambda: least_squares(own, start),
        "re-weighted": lambda: reweighted(own, start),
        "indirect": lambda: indirect_inference(
            robot,
            [log],
            lambda logs: least_squares(Equations.of(robot, logs), start),
            lambda r: [experiment(r, options.seed)],
        ),
    }
    fits = {name: way() for name, way in ways.items()}

    print(
        "Essential dimension of 78 (source: 59): by the estimated noise, and where the true parameters' residual is crossed"
    )
    for name, fit in fits.items():
        crossed = int(np.argmax(fit.residual_norms <= fit.norm_of(true)))
        print(f"  {name:14s} {fit.dimension}, {crossed}; noise {fit.noise_norm:.4g}, true {fit.norm_of(true):.4g}")
    print("Relative error in the essential space, %")
    for part, printed in SOURCE.items():
        print(f"  {part}\n    {'table D.1':14s}" + "".join(f"{x:8.1f}" for x in printed))
        for name, fit in fits.items():
            print(f"    {name:14s}" + "".join(f"{x:8.3f}" for x in errors(fit, true, part)))

    line, controller = straight_line(robot), load_cs8()
    truth = simulate(robot, controller, line)
    print(
        f"Tip on the line: deviation {np.linalg.norm(truth.tip_deviation_mm, axis=1).max():.3g} mm; from the true model's, mm:"
    )
    asperity = [i for i, name in enumerate(robot.parameter_names) if "stribeck" in name]
    for name, fit in fits.items():
        replaced = fit.parameters.copy()
        replaced[asperity] = true[asperity]  # as the source does
        consistent, found = fit.consistent()
        robots = (fit.robot, with_parameters(robot, replaced, allow_inconsistent=True), consistent)
        distances = [tip_difference_mm(simulate(r, controller, line), truth) for r in robots]
        print(f"  {name:14s}" + "  ".join(f"{text} {x:.4f}" for text, x in zip(
            ("identified", "with the true asperity torques", "physically consistent"), distances, strict=True))
            + f" (p = {found.p_value:.3g})")  # fmt: skip

    print_noisy(robot, log, start, options.noise, options.seed)

    if options.figures is not None:
        options.figures.mkdir(parents=True, exist_ok=True)
        for name, fit in fits.items():
            stem = name.replace(" ", "_").replace("'", "")
            residual_by_dimension(fit, true).savefig(options.figures / f"residual_{stem}.png", dpi=120)
            error_by_dimension(fit, true).savefig(options.figures / f"error_{stem}.png", dpi=120)


if __name__ == "__main__":
    main()
