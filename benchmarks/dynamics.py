"""Cost of forward dynamics and of regressors: python benchmarks/dynamics.py

One call of `Robot.forward_dynamics` of the 16-coordinate model, every effect included, beside plain `pin.aba` on the
same tree; and 10,000 stacked regressors of the 4-DOF model.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pinocchio as pin

import rx90b_flex as rf


def each_us(call: Callable[[], object], times: int = 2000, repeats: int = 11) -> list[float]:
    """Microseconds a call, one number a repeat."""
    call()
    out = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(times):
            call()
        out.append(1e6 * (time.perf_counter() - start) / times)
    return out


def main() -> None:
    robot = rf.load_robot("rx90b_4dof")
    model, data, rng = robot.model, robot.model.createData(), np.random.default_rng(0)
    q, v, torque = 0.1 * rng.normal(size=16), rng.normal(size=16), rng.normal(size=4)
    force = robot.input_matrix @ torque
    pairs = [
        (each_us(lambda: robot.forward_dynamics(q, v, torque), repeats=1)[0],
         each_us(lambda: pin.aba(model, data, q, v, force), repeats=1)[0])
        for _ in range(15)
    ]  # fmt: skip
    own, plain = (statistics.median(x) for x in zip(*pairs, strict=True))
    ratio = statistics.median(a / b for a, b in pairs)
    print(f"forward_dynamics {own:.1f} us, pin.aba {plain:.1f} us, ratio {ratio:.2f} (asked: 1.3)")
    samples = rng.normal(size=(3, 10_000, 16))
    stacked = each_us(lambda: robot.regressor(*samples), times=1, repeats=5)
    print(f"10,000 regressors of {len(robot.parameters)} columns: {1e-6 * statistics.median(stacked):.2f} s (asked: 1)")


if __name__ == "__main__":
    main()
