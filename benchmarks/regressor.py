"""Time to build the regressor of a whole recording, beside figaroh's `build_regressor_basic`, in one run.

Both get the same robot, the same samples and the same columns: links, viscous and dry friction, drive inertia and
torque offset of each joint. Needs the extra `bench`:

    pip install -e ".[bench]" && python benchmarks/regressor.py
"""

from __future__ import annotations

import argparse
import statistics
import time
from types import SimpleNamespace

import numpy as np
from figaroh.tools.regressor import build_regressor_basic

import rx90b_flex as rf
from rx90b_flex.effects import catalogue

COLUMNS = ("viscous_friction", "coulomb_friction", "drive_inertia", "torque_offset")


def main() -> None:
    """Print the medians of both and their ratio."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--robot", default="rx90b_rigid")
    arguments.add_argument("--samples", type=int, default=20_000)
    arguments.add_argument("--rounds", type=int, default=7)
    options = arguments.parse_args()

    robot = rf.load_robot(options.robot).rigid()
    types = catalogue()
    robot = robot.with_effects([types[name](joint=joint) for name in COLUMNS for joint in robot.joints])
    n = len(robot.joints)
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, options.samples, n))

    peer = SimpleNamespace(model=robot.tree, data=robot.tree.createData())
    config = {"act_idxv": list(range(n)), "has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True}

    ours, theirs = [], []
    for _ in range(options.rounds):  # in turn, so that a change of the machine's speed meets both
        start = time.perf_counter()
        own = robot.regressor(q, v, a)
        middle = time.perf_counter()
        other = build_regressor_basic(peer, q, v, a, config)
        end = time.perf_counter()
        ours.append(middle - start)
        theirs.append(end - middle)
    assert own.size == other.size, "the two regressors do not hold the same columns"

    per_sample = 1e6 / options.samples
    print(f"{options.robot}: {options.samples} samples, {own.shape[2]} columns, median of {options.rounds} rounds")
    print(f"rx90b_flex  {statistics.median(ours) * per_sample:6.1f} us a sample")
    print(f"figaroh     {statistics.median(theirs) * per_sample:6.1f} us a sample")
    ratios = [t / o for t, o in zip(theirs, ours, strict=True)]
    print(f"ratio       {statistics.median(ratios):6.2f} (from {min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
