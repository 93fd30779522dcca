"""Table 4.1 from simulated dead-weight tests: python benchmarks/static_stiffness.py [--figure FILE]

For each of the twelve hinges: lever arm, true stiffness, one test with its 95 % interval, the mean half-width of 200
tests' intervals, how many of them cover the true value, and the bias that is left without noise. Then what a camera that
sees the hinge from the side makes of it (five times the noise), and what the model's friction does to the drives.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import rx90b_flex as rf
from rx90b_flex.identify.static_stiffness import StaticStiffness, fit_static_stiffness
from rx90b_flex.robot import Robot
from rx90b_flex.signals.static_test import StaticTest
from rx90b_flex.simulate.static_rig import (
    MARKER_STD,
    hinges,
    load_robot_on_rig,
    read_markers,
    standstill_friction,
    static_rig,
)
from rx90b_flex.view.static_plots import static_test_figure

REPEATS = 200


def stiffnesses(robot: Robot) -> dict[str, float]:
    """The robot's own, N m/rad."""
    return {
        f"{effect.joints[0]}:{kind}": float(value)
        for effect in robot.effects
        if effect.traits.virtual and effect.joints
        for kind, value in zip(effect.traits.virtual, np.split(effect.coefficients, 2)[0], strict=True)
    }


def coverage(found: list[StaticStiffness], stiffness: float) -> tuple[float, float]:
    """Share of the intervals that hold the true value, and their mean half-width over it (of the finite ones)."""
    ends = np.array([f.interval for f in found])
    width = 0.5 * (ends[:, 1] - ends[:, 0]) / stiffness
    return float(np.mean((ends[:, 0] <= stiffness) & (stiffness <= ends[:, 1]))), float(np.median(width))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--figure", type=Path, help="file for a figure like 4.2 with the model's friction")
    figure = parser.parse_args().figure
    robot = rf.load_robot("rx90b_4dof")
    true = stiffnesses(robot)
    rng = np.random.default_rng(0)
    states = {c: (rig, load_robot_on_rig(robot, rig)) for c in hinges(robot) for rig in [static_rig(robot, c)]}

    print(f"0 to 19 kg in 7 steps up and down, markers +-0.014 mm (95 %), {REPEATS} tests; stiffness in 1e5 N m/rad")
    print("hinge            lever m  bar m   true   one test (95 % interval)   half-width  cover  bias without noise")
    for c, (rig, state) in states.items():
        found = [fit_static_stiffness(t) for t in read_markers(rig, state, rng, repeats=REPEATS)]
        (exact,) = read_markers(rig, state, rng, marker_std=0.0)
        cover, width = coverage(found, true[c])
        low, high = (k / 1e5 for k in found[0].interval)
        print(
            f"{c:<16} {rig.lever_arm:6.3f} {rig.bar:6.2f}  {true[c] / 1e5:5.2f}"
            f"   {found[0].stiffness / 1e5:5.2f} ({low:5.2f} to {high:5.2f})      {100 * width:9.1f} %"
            f"  {100 * cover:4.1f} %  {100 * (fit_static_stiffness(exact).stiffness / true[c] - 1):+.3f} %"
        )

    print("\nseen from the side (five times the noise along the pull), as drives 1 and 4 in the source:")
    for c in ("joint_1:torsion", "joint_4:torsion"):
        tests = read_markers(*states[c], rng, marker_std=(MARKER_STD, 5 * MARKER_STD), repeats=REPEATS)
        found = []
        for test in tests:
            try:
                found.append(fit_static_stiffness(test))
            except ValueError:  # the slope comes out negative
                continue
        cover, width = coverage(found, true[c])
        endless = np.mean([np.isinf(f.interval[1]) for f in found])
        print(
            f"{c:<16} cover {100 * cover:4.1f} %, median half-width {100 * width:.0f} %, without upper end {100 * endless:.0f} %,"
            f" no positive slope in {REPEATS - len(found)} of {REPEATS}"
        )

    print("\nwith the model's friction in the drives (p: loading and unloading alike by chance; area in J):")
    friction = standstill_friction(robot)
    drawn: tuple[list[StaticTest], list[StaticStiffness]] = ([], [])
    for c, (rig, _) in states.items():
        (test,) = read_markers(rig, load_robot_on_rig(robot, rig, friction=friction), rng)
        all_readings = fit_static_stiffness(test)
        drawn[0].append(test)
        drawn[1].append(all_readings)
        torque = friction[robot.coordinates.index(c)]
        if torque == 0.0:
            continue
        skip = int(np.ceil(2.0 * torque / np.diff(test.moment)[0]))
        slid = fit_static_stiffness(test, skip=skip)
        print(
            f"{c:<16} friction {torque:4.1f} N m, p {all_readings.p_value:.1e},"
            f" area {all_readings.hysteresis_area:.3f} +- {all_readings.hysteresis_std:.3f},"
            f" stiffness {all_readings.stiffness / 1e5:.2f}; without {skip} readings a direction"
            f" {slid.stiffness / 1e5:.2f} ({slid.interval[0] / 1e5:.2f} to {slid.interval[1] / 1e5:.2f})"
        )
    if figure is not None:
        static_test_figure(*drawn).savefig(figure, dpi=100)


if __name__ == "__main__":
    main()
