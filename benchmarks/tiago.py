"""A recording that had no part in making the package: the arm of a TIAGo, as FIGAROH's sources bring it.

    pip download figaroh==1.0.2 --no-deps --no-binary :all: && tar xf figaroh-1.0.2.tar.gz
    python benchmarks/tiago.py figaroh-1.0.2

80 s at 100 Hz of a seven-axis arm and its lift: angles and motor currents, of which the drives of the last three axes report none.
What `check` says of the currents as they are and of those that are brought to N m, and what closing the loop finds in axes 1 to 4,
the last 30 % of the time held out.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pandas as pd

import rx90b_flex as rf

ARM = [f"arm_{i}_joint" for i in range(1, 8)]
CONSTANTS = dict(zip(ARM, (13.6, 13.6, -8.7, -8.7), strict=False))  # N m/A; other ones scale links and friction
HELD_OUT = 0.3
TYPES = ("drive_inertia", "coulomb_friction", "viscous_friction", "torque_offset")


def log(source: Path) -> pd.DataFrame:
    """Time, angles and currents, a column a signal and joint."""
    parts = []
    for signal in ("position", "effort"):
        table = pd.read_csv(source / "data" / "identification" / f"tiago_{signal}.csv")
        parts.append(table.rename(columns=lambda name: name.removeprefix("- ").strip()).set_index("t"))
    return pd.concat(parts, axis=1).reset_index()


def campaign(folder: Path, source: Path, joints: list[str], constants: dict[str, float]) -> Path:
    """Both parts of the log as a campaign of some joints."""
    table, step = log(source), 0.01
    time = pd.Series([k * step for k in range(int(table["t"].iloc[-1] / step))])
    even = pd.DataFrame({"time": time})
    for joint in joints:
        for signal, factor in (("position", 1.0), ("effort", constants.get(joint, 1.0))):
            known = pd.Series(table[f"{joint}_{signal}"].to_numpy() * factor, index=table["t"])
            both = known.reindex(known.index.union(pd.Index(time))).interpolate("index")
            even[f"{joint}_{signal}"] = both.reindex(pd.Index(time)).to_numpy()
    at = int((1.0 - HELD_OUT) * len(even))
    for name, part in (("fitted", even[:at]), ("held_out", even[at:])):
        part.to_csv(folder / f"{name}.csv", index=False)
    effects = "".join(f'[[effects]]\ntype = "{t}"\njoint = "{j}"\n' for j in joints for t in TYPES)
    (folder / "robot.toml").write_text(f'name = "tiago"\nurdf = "{source / "tiago.urdf"}"\n{effects}')
    columns = {
        key: [f"{j}_{signal}" for j in joints] for key, signal in (("motor_position", "position"), ("torque", "effort"))
    }
    path = folder / "campaign.toml"
    path.write_text(
        f'robot = "robot.toml"\nsample_rate_hz = {1 / step}\njoints = {joints}\n'
        f"[signals]\nmotor_position = {columns['motor_position']}\ntorque = {columns['torque']}\n[preprocessing]\ncutoff_hz = 20.0\n"
        '[[recording]]\nfile = "fitted.csv"\nrole = "identification"\n[[recording]]\nfile = "held_out.csv"\nrole = "validation"\n'
    )
    return path


def main() -> None:
    source = Path(sys.argv[1]).resolve() / "tests" / "fixtures" / "tiago"
    cases: tuple[tuple[str, list[str], dict[str, float]], ...] = (
        ("currents as torques, all axes", ARM, {}),
        ("currents as torques, axes 1 to 4", ARM[:4], {}),
        ("torques, axes 1 to 4", ARM[:4], CONSTANTS),
    )
    for name, joints, constants in cases:
        with tempfile.TemporaryDirectory() as made:
            path = campaign(Path(made), source, joints, constants)
            checked = rf.check(path)
            print(f"{name}: {'usable' if checked.usable else 'not usable'}")
            said = (*(f.message for f in checked.data_faults), checked.torque_side.message)
            print("".join(f"  {text}\n" for text in said if text), end="")
            if not checked.usable:
                continue
            result = rf.close_loop(path)
            before, after, moving = result.before.validation, result.after.validation, result.moving
            print(f"  {result.verdict}: held out {before.relative_error:.3f} -> {after.relative_error:.3f}, ", end="")
            print(
                f"in motion {moving.before:.3f} -> {moving.after:.3f}; "
                + ", ".join(e.effect.label for e in result.effects)
            )
            print("".join(f"  {c}\n" for c in result.cautions), end="")


if __name__ == "__main__":
    main()
