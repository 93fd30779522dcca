"""Damped poles and zeros of the source's example (table 5.1) beside the robot files', and the real robot's damping (table 6.4).

Poles are eigenvalues of the arm stretched out horizontally and turning at 0.11 rad/s, zeros those with one drive locked. Compared:
`rx90b_3dof` as it is, the same with friction on the joints, and with table D.1's damping.

    python benchmarks/poles_and_zeros.py
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

import rx90b_flex as rf
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import test_rx90b as source

TABLE_6_4 = (  # resonances of the real RX90B and real parts of its poles, Hz
    (28.4, 30.3, 32.5, 41.0, 44.7, 62.6, 64.1, 67.1, 69.3),
    (-0.8, -1.3, -1.3, -3.5, -3.2, -0.6, -18.5, -2.3, -3.9),
)
BAND_HZ = 75.0


def variants() -> dict[str, Robot]:
    """The example, and what it would be otherwise."""
    example = rf.load_robot("rx90b_3dof")
    at_joints = [dataclasses.replace(e, side="joint") if e.traits.is_friction else e for e in example.effects]  # type: ignore[call-arg]
    table_d1 = [
        e.with_coefficients(np.r_[stiffness := np.split(e.coefficients, 2)[0], 1e-3 * stiffness])
        if e.traits.part == "flexibility"
        else e
        for e in example.effects
    ]
    return {
        "as it is": example,
        "friction on the joints": example.with_effects(at_joints),
        "damping 1e-3 s of stiffness": example.with_effects(table_d1),
    }


def factors(found: dict[str, Array], table: dict[str, list[float]], part: str) -> Array:
    """By which factor `part` (``frequency``, ``real``) of the poles and zeros differs from the table, larger than 1."""
    both = []
    for name, expected in table.items():
        values = np.abs(found[name]) if part == "frequency" else -found[name].real
        both += [v / abs(e) for v, e in zip(values, expected, strict=False)]  # what is overdamped is missing at the end
    return np.exp(np.abs(np.log(both)))


def main() -> None:
    """Print the tables."""
    robots = variants()
    poles = {name: source.poles_and_zeros(robot) for name, robot in robots.items()}
    found, _ = poles["as it is"]
    print("Table 5.1, Hz: printed | rx90b_3dof")
    print("mode" + "".join(f"{name:>30}" for name in source.TABLE_5_1))
    for mode in range(9):
        row = ""
        for name, hz in source.TABLE_5_1.items():
            pole = found[name][mode]
            row += f"  {source.REAL_PARTS[name][mode]:7.1f}{hz[mode]:7.1f} |{pole.real:7.1f}{abs(pole):7.1f}"
        print(f"{mode + 1:4}{row}")
    print("\nFactor between printed and found, median and worst; three rigid-body poles, Hz")
    print(f"  {'printed':28s}{'':46s}" + "".join(f"{p:7.2f}" for p in source.RIGID_POLES))
    for name, (found, rigid) in poles.items():
        frequency, real = factors(found, source.TABLE_5_1, "frequency"), factors(found, source.REAL_PARTS, "real")
        print(
            f"  {name:28s}frequency {np.median(frequency):4.2f} {frequency.max():4.2f}"
            f"   real part {np.median(real):5.2f} {real.max():5.2f}   " + "".join(f"{p:7.2f}" for p in rigid[:3])
        )
    print(f"\nDamping ratios of the poles below {BAND_HZ:g} Hz: median, smallest, largest")
    hz, real = (np.array(x) for x in TABLE_6_4)
    lines = {"real RX90B, table 6.4": -real / hz}
    lines |= {"table 5.1": -np.array(source.REAL_PARTS["resonance"]) / source.TABLE_5_1["resonance"]}
    lines["table 5.1"] = lines["table 5.1"][np.array(source.TABLE_5_1["resonance"]) < BAND_HZ]
    for name, (found, _) in poles.items():
        own = found["resonance"]
        lines[f"rx90b_3dof, {name}"] = (-own.real / np.abs(own))[np.abs(own) < BAND_HZ]
    for name, ratios in lines.items():
        print(f"  {name:44s}" + "".join(f"{100 * x:7.1f} %" for x in (np.median(ratios), ratios.min(), ratios.max())))


if __name__ == "__main__":
    main()
