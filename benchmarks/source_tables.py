"""Drive parameters from the source's tables of frequencies, beside those that it prints.

Each difference stands beside what the rounding of the printed frequencies can do: a standard deviation, every frequency printed to
0.1 Hz being off by a uniform error. The numbers are those of `tests/test_inverse_eigenvalue.py`.

    python benchmarks/source_tables.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from rx90b_flex import drive_parameters

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import test_inverse_eigenvalue as source

SPREAD_HZ = 0.1 / np.sqrt(12.0)
TABLE_6_2 = ((3.25, 1.49), (1.50, 2.16), (0.79, 0.98))  # kg m^2, 1e5 N m/rad
TABLE_6_5 = ((3.54, 1.39), (3.63, 1.68), (1.47, 0.62))


def line(what: str, printed: float, found: float, std: float) -> str:
    """One number, to the digits that the source prints."""
    off = round(found, 2) - printed
    words = "as printed" if abs(off) < 0.005 else f"{off:+.2f}, rounding {std:.3f}"
    return f"  {what:28s} printed {printed:5.2f}  found {found:7.4f}  {words}"


def main() -> None:
    """Print all tables."""
    print("Table 5.1, all nine modes -> drive stiffness, 1e5 N m/rad (true values: table 4.1)")
    spread = {"resonances_std_hz": [SPREAD_HZ] * 9, "antiresonances_std_hz": [SPREAD_HZ] * 9}
    for j, (zeros, inertia, true) in enumerate(
        zip(source.ANTIRESONANCES, source.INERTIAS, source.STIFFNESSES, strict=True)
    ):
        found = drive_parameters(source.RESONANCES, zeros, drive_inertia=inertia, **spread)
        print(line(f"joint {j + 1} stiffness", true / 1e5, found.stiffness / 1e5, found.stiffness_std / 1e5))

    print("\nTable 5.2, truncated: inertias kg m^2, then stiffnesses 1e5 N m/rad of joints 1, 2, 3")
    print("   N   printed                              the source's convention              low-frequency gain kept")
    for modes, row in source.TABLE_5_2.items():
        both = []
        for convention in ("source", "exact"):
            found_all = [
                source.truncated_drive_parameters(source.RESONANCES, zeros, inertia, modes - 1, convention)
                for zeros, inertia in zip(source.ANTIRESONANCES, source.INERTIAS, strict=True)
            ]
            both.append([f.inertia for f in found_all] + [f.stiffness / 1e5 for f in found_all])
        print(f"  {modes:2d}  " + "  |  ".join(" ".join(f"{x:5.2f}" for x in values) for values in (row, *both)))

    print("\nTables 6.1 and 6.3 -> 6.2")
    spread = {"resonances_std_hz": [SPREAD_HZ] * 5, "antiresonances_std_hz": [SPREAD_HZ] * 5}
    rigid = 1.0 / np.diag(np.linalg.inv(source.RIGID_MASS))
    for j, (zeros, (inertia, stiffness)) in enumerate(zip(source.ESTIMATED_ZEROS, TABLE_6_2, strict=True)):
        found = drive_parameters(source.ESTIMATED, zeros, rigid_inertia=float(rigid[j]), **spread)
        print(line(f"joint {j + 1} inertia", inertia, found.inertia, found.inertia_std))
        print(line(f"joint {j + 1} stiffness", stiffness, found.stiffness / 1e5, found.stiffness_std / 1e5))

    print("\nTable 6.4 -> 6.5, with its inertias")
    spread = {"resonances_std_hz": [SPREAD_HZ] * 9, "antiresonances_std_hz": [SPREAD_HZ] * 9}
    for j, (zeros, (inertia, stiffness)) in enumerate(zip(source.MEASURED_ZEROS, TABLE_6_5, strict=True)):
        found = drive_parameters(
            source.MEASURED, zeros, drive_inertia=inertia, inertia_std=0.01 / np.sqrt(12.0), **spread
        )
        print(line(f"joint {j + 1} stiffness", stiffness, found.stiffness / 1e5, found.stiffness_std / 1e5))


if __name__ == "__main__":
    main()
