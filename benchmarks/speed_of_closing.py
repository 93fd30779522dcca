"""Time and memory of closing the loop on a six-joint robot: three recordings of 20 s at 500 Hz, four hidden effects.

    python benchmarks/speed_of_closing.py

Recordings are made by `tests/independent.py`. Times: of the processor (one thread) and of the clock, without making the data.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import independent as ind

import rx90b_flex as rf

COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
NOISE = (0.8, 1.0, 0.6, 0.12, 0.1, 0.06)  # N m
HIDDEN = [
    ("gear_ripple", 2, {"order": 18.0, "amplitude": 3.0, "phase": 0.7}),
    ("joint_coupling", (4, 5), {"inertia": 0.1, "viscous": 0.8, "coulomb": 0.6}),
    ("stribeck_friction", 0, {"torque": 10.0, "velocity": 0.15, "power": 1.2}),
    ("load_friction", 1, {"coefficient": 0.08}),
]
RATE_HZ, PERIOD_S, PERIODS, CUTOFF_HZ = 500.0, 10.0, 2, 25.0


def make(folder: Path) -> Path:
    """The campaign in files."""
    arm, rng = ind.ur10(1.1), np.random.default_rng(0)
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    torques = [ind.friction(COULOMB, VISCOUS), *(ind.hidden(*h) for h in HIDDEN)]
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 6, period_s=PERIOD_S, periods=PERIODS, rate_hz=RATE_HZ, lines=8)
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE), PERIOD_S))
    return ind.write_files(folder, arm, declared, runs, cutoff_hz=CUTOFF_HZ)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = make(Path(folder))
        processor, clock = time.process_time(), time.perf_counter()
        result = rf.close_loop(path)
        processor, clock = time.process_time() - processor, time.perf_counter() - clock
    # in kB on Linux, bytes on macOS
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    print(f"{processor:.1f} s of processor, {clock:.1f} s of clock, {peak / 1e9:.2f} GB; {result.verdict}")
    before, after = result.before.validation.relative_error, result.after.validation.relative_error
    print(f"validation error {100 * before:.2f} % -> {100 * after:.2f} %")
    for found in result.effects:
        print(f"  {found.effect.label}: " + ", ".join(f"{p.name} = {p.value:.4g}" for p in found.parameters if p.value))


if __name__ == "__main__":
    main()
