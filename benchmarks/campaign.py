"""Time of a campaign (section 6.6.2) beside real time, by the nonlinear simulation and by the perturbation method.

One job through joblib on the given number of processes, saving to disk included; compiled code is loaded before the clock starts.

    python benchmarks/campaign.py                        # 96 runs of 9 periods: 59 minutes of robot time
    python benchmarks/campaign.py --runs 12 --periods 1  # a short one
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import joblib

import rx90b_flex as rf
from rx90b_flex.simulate import load_cs8
from rx90b_flex.simulate.campaign import CampaignPlan, run_campaign, section_662
from rx90b_flex.simulate.excite import NOISE


def measure(plan: CampaignPlan, jobs: int) -> tuple[float, float]:
    """Wall time in s and robot time in s of a campaign into a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        result = run_campaign(plan, Path(folder) / "campaign", jobs=jobs)
        wall = time.perf_counter() - start
    assert not result.failed, result.failed[0]
    return wall, len(plan.runs) * plan.periods * (plan.reference.period_s or 0.0)


def _peak(_: int) -> float:
    time.sleep(0.2)  # so that every worker answers
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Print both methods' times real time and the workers' largest memory."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--robot", default="rx90b_4dof")
    arguments.add_argument("--runs", type=int, default=96, help="a multiple of 6: three inputs, both signs")
    arguments.add_argument("--periods", type=int, default=9)
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--method", choices=("nonlinear", "perturbation", "both"), default="both")
    arguments.add_argument("--crest", choices=("random", "clipping", "lp"), default="lp", help="of the multisine")
    options = arguments.parse_args()

    robot = rf.load_robot(options.robot)
    methods = ("perturbation", "nonlinear") if options.method == "both" else (options.method,)
    for method in methods:
        sizes = {"periods": options.periods, "realisations": max(1, options.runs // 6)}
        same = {"noise": NOISE, "method": method, "crest": options.crest}
        plan = section_662(robot, load_cs8(), **same, **sizes)
        short = section_662(robot, load_cs8(), **same, periods=1, realisations=1)
        measure(short, options.jobs)
        wall, robot_time = measure(plan, options.jobs)
        peak = max(joblib.Parallel(n_jobs=options.jobs)(joblib.delayed(_peak)(i) for i in range(options.jobs)))
        print(
            f"{method:12s} {len(plan.runs)} runs, {len(robot.coordinates)} coordinates, {robot_time:.0f} s of robot time: "
            f"{wall:.1f} s, {robot_time / wall:.0f} times real time on {options.jobs} processes; "
            f"largest process {peak:.0f} MB",
            flush=True,
        )


if __name__ == "__main__":
    main()
