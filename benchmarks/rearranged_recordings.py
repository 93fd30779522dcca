"""The real recordings otherwise arranged: other recordings held out, other low-passes and rates, nothing declared.

    python benchmarks/rearranged_recordings.py                             # all of them; an hour
    python benchmarks/rearranged_recordings.py --only kr300_holding_B tx40_bare --jobs 2 --out results

What a change does to the campaigns as they lie says little: they were looked at while the package was made. These ask the same
robots other questions. `_again` closes the loop a second time, with the robot that the first wrote: it should find nothing and
leave the error as it is. Errors as in `real_recordings.py`.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import joblib
import pandas as pd
from real_recordings import Row, closed, data_folder, table

from rx90b_flex.files.toml import toml_text

Table = dict[str, Any]


def with_roles(*roles: str) -> Callable[[Table], None]:
    """Roles of the recordings in their order: `i`dentification, `v`alidation, or none."""
    names = {"i": "identification", "v": "validation"}

    def change(campaign: Table) -> None:
        pairs = zip(campaign["recording"], roles, strict=True)
        campaign["recording"] = [{**r, "role": names[role]} for r, role in pairs if role]

    return change


def without(*keys: str) -> Callable[[Table], None]:
    """Without a key, or one of a table: `signals.link_position`."""

    def change(campaign: Table) -> None:
        for key in keys:
            table, _, last = key.rpartition(".")
            (campaign[table] if table else campaign).pop(last)

    return change


def with_values(**values: Any) -> Callable[[Table], None]:
    """With other values of keys, or with them where they are none."""
    return lambda campaign: campaign.update(values)


def with_cutoff(hz: float) -> Callable[[Table], None]:
    """With another low-pass."""
    return lambda campaign: campaign.update(preprocessing={"cutoff_hz": hz})


def with_rate(hz: float) -> Callable[[Table], None]:
    """As a slower logger would have written it: one row in so many, no low-pass."""

    def change(campaign: Table) -> None:
        campaign["keep_one_in"] = round(campaign["sample_rate_hz"] / hz)
        campaign["sample_rate_hz"] = hz
        campaign.pop("preprocessing")

    return change


def parts_of_tx40(campaign: Table) -> None:
    """The last six seconds fitted, the first ones held out."""
    file = campaign["recording"][0]["file"]
    campaign["recording"] = [
        {"file": file, "role": "identification", "start_s": 3.0},
        {"file": file, "role": "validation", "end_s": 3.0},
    ]


ARRANGED: dict[str, tuple[str, Callable[[Table], None]]] = {
    "kr300_holding_A": ("kr300_encoders", with_roles("v", "i", "i")),
    "kr300_holding_B": ("kr300_encoders", with_roles("i", "v", "i")),
    "kr300_without_encoders": ("kr300_encoders", without("signals.link_position")),
    "kr300_without_low_pass": ("kr300_encoders", without("preprocessing")),
    "kr300_5_hz_low_pass": ("kr300_encoders", with_cutoff(5.0)),
    "kr300_20_hz_low_pass": ("kr300_encoders", with_cutoff(20.0)),
    "kr300_10_hz": ("kr300_encoders", with_rate(10.0)),
    "kr300_bare": ("kr300_encoders", with_values(robot="kr300.urdf")),
    "ur10e_roles_exchanged": ("ur10e", with_roles("v", "v", "v", "i", "i")),
    "ur10e_points_fitted": ("ur10e", with_roles("v", "v", "v", "v", "i")),
    "ur10e_one_file": ("ur10e", with_roles("i", "", "", "v", "v")),
    "ur10e_10_hz": ("ur10e", with_rate(10.0)),
    "ur10e_without_low_pass": ("ur10e", without("preprocessing")),
    "ur10e_bare": ("ur10e", with_values(robot="ur10e.urdf")),
    "tx40_halves_exchanged": ("tx40", parts_of_tx40),
    "tx40_500_hz": ("tx40", with_rate(500.0)),
    "tx40_50_hz": ("tx40", with_rate(50.0)),
    "tx40_bare": ("tx40", with_values(robot="tx40.urdf")),
    "emps_roles_exchanged": ("emps", with_roles("v", "i")),
    "emps_60_hz_low_pass": ("emps", with_cutoff(60.0)),
    "emps_without_low_pass": ("emps", without("preprocessing")),
    "emps_bare": ("emps", with_values(robot="emps.urdf")),
    "dualarm_holding_52": ("dualarm_v2", with_roles("i", "v", "i")),
    "dualarm_without_low_pass": ("dualarm_v2", without("preprocessing")),
    "dualarm_bare": ("dualarm_v2", with_values(robot="dualarm.urdf")),
    "kr300_again": ("kr300_encoders", lambda _: None),
    "kr300_holding_B_again": ("kr300_encoders", with_roles("i", "v", "i")),
    "tx40_again": ("tx40", lambda _: None),
    "ur10e_again": ("ur10e", lambda _: None),
    "emps_again": ("emps", lambda _: None),
}


def arranged(name: str, folder: Path, robot: Path | None = None) -> Path:
    """Folder with the campaign otherwise arranged; its files are read where they lie."""
    source, change = ARRANGED[name]
    lies = data_folder() / source
    campaign = tomllib.loads((lies / "campaign.toml").read_text(encoding="utf-8"))
    change(campaign)
    campaign["robot"] = str(robot or (lies / campaign["robot"]).resolve())
    made = folder / name
    made.mkdir(parents=True)
    every = campaign.pop("keep_one_in", 1)
    for recording in campaign["recording"]:
        file = (lies / recording["file"]).resolve()
        if every > 1:
            thinned = made / file.name
            pd.read_csv(file).iloc[::every].to_csv(thinned, index=False)
            file = thinned
        recording["file"] = str(file)
    (made / "campaign.toml").write_text(toml_text(campaign), encoding="utf-8")
    return made


def run(name: str, out: Path | None) -> Row:
    """Arrange it and close the loop; of `_again` the second closing."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if not name.endswith("_again"):
            return closed(arranged(name, folder), out)
        closed(arranged(name, folder / "first"), folder / "written")
        return closed(arranged(name, folder / "again", folder / "written" / name / "robot.toml"), out)


def line(name: str, out: Path | None) -> str:
    """A row of the table, or what went wrong: the others are run all the same."""
    try:
        row = run(name, out)
    except Exception as error:
        return f"| {name} | failed: {error} |"
    return f"{table([row]).splitlines()[-1]} {row.processor_s:.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=sorted(ARRANGED), default=sorted(ARRANGED))
    parser.add_argument("--out", type=Path, help="folder for the results: reports, robots, predictions")
    parser.add_argument("--jobs", type=int, default=1, help="campaigns at a time")
    arguments = parser.parse_args()
    for said in joblib.Parallel(arguments.jobs, return_as="generator")(
        joblib.delayed(line)(name, arguments.out) for name in arguments.only
    ):
        print(said, flush=True)


if __name__ == "__main__":
    main()
