"""``rx90b-flex import``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from rx90b_flex.commands.shared import ROBOT_HELP, Basics, CampaignOut, Overwrite, progress, say


def import_command(
    files: Annotated[
        list[Path],
        Argument(help="Logs: CSV, Parquet, MATLAB, MCAP, ROS 2 bags, or any with a reader; the last one validates."),
    ],
    robot: Annotated[str, Option(help=ROBOT_HELP)],
    out: CampaignOut,
    columns: Annotated[
        list[str] | None, Option(help="What a signal's columns are: torque=NAME,NAME; repeat for more signals.")
    ] = None,
    joints: Annotated[str | None, Option(help="Joints that the columns belong to, in order: NAME,NAME")] = None,
    rate: Annotated[float | None, Option(help="Sample rate, Hz; resamples where the file has another.")] = None,
    degrees: Annotated[bool | None, Option("--degrees/--radians", help="Unit of all angles.")] = None,
    gear: Annotated[
        str | None, Option(help="Motor turns a joint turn where columns are motor side: 32,45 or 32,0;0,45")
    ] = None,
    offset: Annotated[str | None, Option(help="Joint angles where the motor angles are zero, rad.")] = None,
    topic: Annotated[str | None, Option(help="JointState topic of a bag.")] = None,
    file_format: Annotated[str, Option("--format", help="parquet, csv or csv.gz.")] = "parquet",
    basics: Basics = False,
    overwrite: Overwrite = False,
) -> None:
    """Make a campaign of logs: CSV, Parquet, MATLAB, ROS 2, MCAP.

    Finds out columns, units and rate, and says how sure it is of each.
    """
    from rx90b_flex.importing import import_into, options_of

    options = options_of(columns or [], joints, rate, degrees, gear, offset, topic)
    with progress() as tell:
        tell("reading", 0.1)
        imported = import_into(out, files, robot, options, file_format, basics, overwrite)
    files_of: dict[str, list[str]] = {}
    for where, finding in imported.findings:
        files_of.setdefault(str(finding), []).append(where)
    for said, where_all in files_of.items():
        say(f"{', '.join(where_all)}: {said}")
    say(f"Campaign: {out / 'campaign.toml'}")
