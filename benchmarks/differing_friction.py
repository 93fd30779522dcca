"""Hidden effects beside a friction that differs from recording to recording, as drives are warmer in one than in another.

    python benchmarks/differing_friction.py [--first-seed 0] [--seeds 56] [--same] [--jobs 2]

A UR10, UR5, RX90B or Panda (in turn) has none to two effects that its file does not declare; two to four recordings of 10 s at
250 Hz are fitted, one is held out. In each, all friction is another by about 13 % (one standard deviation, log-normal), each
joint's by 4 % more, viscous friction by another 6 %; with `--same` none differs. Recordings are made by `tests/independent.py`. A
seed is a campaign; prints each with what was missed and what was found that is not there, and the sums.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import joblib
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import independent as ind

import rx90b_flex as rf

ARMS: dict[str, Callable[[], ind.Arm]] = {
    "ur10": lambda: ind.ur10(1.1),
    "ur5": ind.ur5,
    "rx90b": ind.rx90b,
    "panda": ind.panda,
}
DECLARED = ("coulomb_friction", "viscous_friction")
WARMTH, OF_A_JOINT, VISCOUS = 0.13, 0.04, 0.06  # standard deviations of the logarithm of friction


class Found(NamedTuple):
    """Of one campaign: effects that were hidden and found, hidden and not found, and found that are not there."""

    seed: int
    arm: str
    fitted: int
    right: list[str]
    missed: list[str]
    false: list[str]
    verdict: str
    before: float
    after: float


def hidden_effects(rng: np.random.Generator, size: ind.Array) -> list[tuple[str, int, dict[str, float]]]:
    """None to two, each on a joint of its own; `size` is each joint's torque, N m."""
    # in the order of the table below, which every draw takes from the generator
    kinds = rng.permutation(
        ["gear_ripple", "stribeck_friction", "load_friction", "asymmetric_friction", "joint_spring"]
        + ["viscous_power_friction", "torque_offset"]
    )
    count = int(rng.integers(0, 3))
    out = []
    for kind, joint in zip(kinds[:count], rng.permutation(len(size))[:count], strict=True):
        s = float(size[joint])
        values = {
            "gear_ripple": {"order": float(rng.integers(8, 40)), "amplitude": 0.15 * s, "phase": rng.uniform(0, 6)},
            "stribeck_friction": {
                "torque": 0.25 * s,
                "velocity": rng.uniform(0.08, 0.2),
                "power": rng.uniform(0.8, 1.6),
            },
            "load_friction": {"coefficient": rng.uniform(0.08, 0.15)},
            "asymmetric_friction": {"coefficient": 0.12 * s},
            "joint_spring": {"stiffness": 0.3 * s, "rest_angle": rng.uniform(-0.5, 0.5)},
            "viscous_power_friction": {"coefficient": 0.2 * s, "power": rng.uniform(0.4, 0.6)},
            "torque_offset": {"torque": 0.1 * s},
        }
        out.append((str(kind), int(joint), values[str(kind)]))
    return out


def closed(seed: int, same: bool) -> Found:
    """One campaign, made and closed."""
    warnings.simplefilter("ignore")
    rng, name = np.random.default_rng(seed), list(ARMS)[seed % len(ARMS)]
    arm = ARMS[name]()
    n = len(arm.joints)
    size = np.sqrt((arm.torque(ind.harmonics(rng, n, period_s=10.0, rate_hz=100.0, lines=8)) ** 2).mean(axis=0))
    size = np.maximum(size, 0.03 * size.max())
    coulomb, viscous = (0.25 * size * rng.uniform(0.5, 1.5, n) for _ in range(2))
    hidden = hidden_effects(rng, size)
    fitted = int(rng.integers(2, 5))
    runs = []
    for r in range(fitted + 1):
        m = ind.harmonics(rng, n, period_s=10.0, rate_hz=250.0, lines=8)
        dry = np.exp(WARMTH * rng.normal()) * np.exp(OF_A_JOINT * rng.normal(size=n))
        wet = dry * np.exp(VISCOUS * rng.normal(size=n))
        rubs = ind.friction(coulomb, viscous) if same else ind.friction(coulomb * dry, viscous * wet)
        noise = ind.white(rng, len(m.time), 0.02 * size)
        role = "identification" if r < fitted else "validation"
        runs.append(ind.run(arm, role, m, [rubs, *(ind.hidden(*h) for h in hidden)], noise))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in DECLARED]
    with tempfile.TemporaryDirectory() as folder:
        result = rf.close_loop(ind.write_files(Path(folder), arm, declared, runs, cutoff_hz=20.0))
    there, found = [f"{arm.joints[j]}.{kind}" for kind, j, _ in hidden], [e.effect.label for e in result.effects]
    errors = [e.validation.relative_error if e is not None else np.nan for e in (result.before, result.after)]
    right, missed = ([x for x in there if (x in found) is known] for known in (True, False))
    return Found(seed, name, fitted, right, missed, [x for x in found if x not in there], str(result.verdict), *errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=56)
    parser.add_argument("--same", action="store_true", help="the same friction in all recordings")
    parser.add_argument("--jobs", type=int, default=1)
    o = parser.parse_args()
    seeds = range(o.first_seed, o.first_seed + o.seeds)
    rows: list[Found] = []
    for f in joblib.Parallel(n_jobs=o.jobs, return_as="generator")(joblib.delayed(closed)(s, o.same) for s in seeds):
        rows.append(f)
        words = [f"{what} {', '.join(x)}" for what, x in (("missed", f.missed), ("false", f.false)) if x]
        errors = f"{f.before:.2%} -> {f.after:.2%}"
        print(f"{f.seed} {f.arm}, {f.fitted} fitted: {', '.join(f.right) or 'nothing'}; {f.verdict}, {errors}", *words)
    right, missed, false = (sum(len(getattr(f, what)) for f in rows) for what in ("right", "missed", "false"))
    print(
        f"\nFound {right} of {right + missed} hidden effects, and {false} that are not there, in {len(rows)} campaigns."
    )


if __name__ == "__main__":
    main()
