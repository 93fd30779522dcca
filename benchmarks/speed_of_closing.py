"""Time and memory of closing the loop, one process a case, beside what was asked for.

    python benchmarks/speed_of_closing.py [CASE ...] [--cold]

Recordings are made by `tests/independent.py`; the TX40's are looked for where the tests look (`RX90B_FLEX_DATA`). Times: of the
processor (one thread) and of the clock, from the campaign file to the result, without making the data. The ratio is that of
the processor's time to what was asked for. With `--cold` nothing is compiled before.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import independent as ind
from data_folder import tx40_folder

import rx90b_flex as rf

COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
NOISE = (0.8, 1.0, 0.6, 0.12, 0.1, 0.06)  # N m
HIDDEN = [
    ("gear_ripple", 2, {"order": 18.0, "amplitude": 3.0, "phase": 0.7}),
    ("joint_coupling", (4, 5), {"inertia": 0.1, "viscous": 0.8, "coulomb": 0.6}),
    ("stribeck_friction", 0, {"torque": 10.0, "velocity": 0.15, "power": 1.2}),
    ("load_friction", 1, {"coefficient": 0.08}),
]
MAINS_HZ, MAINS = 50.0, 0.8  # N m, in joint 3's torque
FRICTION = ("coulomb_friction", "viscous_friction")


def mains(motion: ind.Motion, load: ind.Array) -> ind.Array:
    """A line of the mains in one joint's torque."""
    out = np.zeros_like(load)
    out[:, 2] = MAINS * np.sin(2 * np.pi * MAINS_HZ * motion.time + 0.4)
    return out


def six_joints(
    folder: Path,
    *,
    cutoff_hz: float | None,
    rate_hz: float = 500.0,
    declared: tuple[str, ...] = FRICTION,
    more: tuple[ind.Torque, ...] = (),
) -> Path:
    """A UR10 with four hidden effects, three recordings of two periods of 10 s."""
    arm, rng = ind.ur10(1.1), np.random.default_rng(0)
    tables = [{"type": k, "joint": j} for j in arm.joints for k in declared]
    torques = [ind.friction(COULOMB, VISCOUS), *(ind.hidden(*h) for h in HIDDEN), *more]
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 6, period_s=10.0, periods=2, rate_hz=rate_hz, lines=8)
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE), 10.0))
    return ind.write_files(folder, arm, tables, runs, cutoff_hz=cutoff_hz)


def repeated(m: ind.Motion, times: int) -> ind.Motion:
    """A period so many times."""
    step = m.time[1] - m.time[0]
    return ind.Motion(step * np.arange(times * len(m.time)), *(np.tile(x, (times, 1)) for x in (m.q, m.v, m.a)))


def one_hour(folder: Path) -> Path:
    """Two joints, one hour at 500 Hz in each role, with Stribeck friction hidden."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(0)
    tables = [{"type": k, "joint": j} for j in arm.joints for k in FRICTION]
    torques = [
        ind.friction((1.0, 0.6), (1.5, 0.8)),
        ind.hidden("stribeck_friction", 0, {"torque": 1.2, "velocity": 0.15, "power": 1.2}),
    ]
    runs = []
    for role in ("identification", "validation"):
        m = repeated(ind.harmonics(rng, 2, period_s=20.0, rate_hz=500.0, lines=14), 180)
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), (0.1, 0.05)), 20.0))
    return ind.write_files(folder, arm, tables, runs, cutoff_hz=20.0)


def tx40(folder: Path) -> Path:
    """The TX40's recording."""
    return tx40_folder() / "campaign.toml"


# campaign, and what was asked for: s of processor, GB
CASES: dict[str, tuple[Callable[[Path], Path], float, float]] = {
    "25 Hz low-pass": (lambda folder: six_joints(folder, cutoff_hz=25.0), 5.0, 0.6),
    "80 Hz low-pass, mains": (lambda folder: six_joints(folder, cutoff_hz=80.0, more=(mains,)), 20.0, 1.0),
    "no low-pass, bare URDF": (
        lambda folder: six_joints(folder, cutoff_hz=None, rate_hz=250.0, declared=()),
        20.0,
        1.0,
    ),
    "TX40": (tx40, 6.0, 1.0),
    "one hour": (one_hour, 180.0, 1.5),
}


def run(name: str) -> None:
    """One case, in this process."""
    _, seconds, memory = CASES[name]
    with tempfile.TemporaryDirectory() as folder:
        # in another process: neither the time nor the room that making the data takes is the loop's
        made = subprocess.run(
            [sys.executable, __file__, "--make", name, folder], check=True, stdout=subprocess.PIPE, text=True
        )
        path = made.stdout.splitlines()[-1]
        before, processor, clock = peak(), time.process_time(), time.perf_counter()
        result = rf.close_loop(path)
        processor, clock = time.process_time() - processor, time.perf_counter() - clock
    errors = [100 * e.validation.relative_error for e in (result.before, result.after)]
    print(
        f"{name}: {processor:.1f} s of processor (asked {seconds:g}, ratio {processor / seconds:.2f}), {clock:.1f} s of clock, "
        f"{peak():.2f} GB (asked {memory:g}; {before:.2f} before)\n"
        f"    {result.verdict}, {errors[0]:.3g} % -> {errors[1]:.3g} %: {', '.join(e.effect.label for e in result.effects)}"
    )


def peak() -> float:
    """Largest memory so far, GB (kB on Linux, bytes on macOS)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9


def main() -> None:
    match sys.argv[1:]:
        case ["--one", name]:
            run(name)
        case ["--make", name, folder]:
            print(CASES[name][0](Path(folder)))
        case arguments:
            names = [n for n in arguments if n != "--cold"]
            if unknown := [n for n in names if n not in CASES]:
                raise SystemExit(f"{unknown[0]!r}: no case; there are {', '.join(CASES)}")
            for name in names or CASES:
                with tempfile.TemporaryDirectory() as cache:
                    environment = os.environ | ({"NUMBA_CACHE_DIR": cache} if "--cold" in arguments else {})
                    # an installed package is not compiled at each start
                    environment.pop("PYTHONDONTWRITEBYTECODE", None)
                    subprocess.run([sys.executable, __file__, "--one", name], check=True, env=environment)


if __name__ == "__main__":
    main()
