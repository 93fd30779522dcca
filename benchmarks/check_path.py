"""Deviation of the tip on a 1.7 m line and a 200 mm square, before and after correction: python benchmarks/check_path.py

[--robot rx90b_4dof] [--speeds 50 100 250] [--paths line square] [--contributions]

Deviations are across the path, in millimetres; "wrong model" is the largest on the corrected path when friction, stiffness and
springs of the robot are in turn 10 % lower than the model says. Times are of this machine.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import rx90b_flex as rf
from rx90b_flex.path import PathCheck, PathOptions, check_path, load_seam
from rx90b_flex.simulate.command import controller_of

HEAD = (
    f"{'path':8}{'mm/s':>6}{'before max':>12}{'RMS':>8}{'after max':>11}{'RMS':>8}{'within':>13}{'steps':>7}"
    f"{'wrong model':>13}{'one run, s':>12}{'all, s':>8}"
)


def row(result: PathCheck, seconds: float) -> str:
    """One line of the table."""
    before, after = result.before, result.after
    assert after is not None
    within = after.within(result.options.tolerance_mm)
    wrong = max((d.max_across for _, d in result.wrong_model), default=float("nan"))
    return (
        f"{result.plan.seam.name:8}{1e3 * result.plan.seam.speed:6.0f}{before.max_across:12.3f}{before.rms_across:8.3f}"
        f"{after.max_across:11.3f}{after.rms_across:8.3f}{within.sum():>7d}/{len(within):<5d}{len(result.iterations) - 1:7d}"
        f"{wrong:13.3f}{result.seconds['one simulation']:12.1f}{seconds:8.1f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="rx90b_4dof")
    parser.add_argument("--speeds", type=float, nargs="+", default=[50.0, 100.0, 250.0])
    parser.add_argument("--paths", nargs="+", default=["line", "square"])
    parser.add_argument("--tolerance-mm", type=float, default=0.1)
    parser.add_argument("--contributions", action="store_true")
    given = parser.parse_args()
    robot = rf.load_robot(given.robot)
    controller = controller_of(robot, None)
    options = PathOptions(given.tolerance_mm, contributions=given.contributions)
    print(f"{robot.name}, tolerance {given.tolerance_mm:g} mm\n{HEAD}", flush=True)
    for path in given.paths:
        for speed in given.speeds:
            start = time.perf_counter()
            result = check_path(load_seam(path, speed), robot, controller, options)
            print(row(result, time.perf_counter() - start), flush=True)
            for c in sorted(result.contributions, key=lambda c: -c.rms_across if c.why_not is None else 1.0)[:6]:
                if c.why_not is None:
                    print(f"    {c.name:40}{c.rms_across:8.3f} mm RMS{c.max_across:8.3f} mm at most", flush=True)


if __name__ == "__main__":
    main()
