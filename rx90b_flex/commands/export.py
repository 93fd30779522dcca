"""``rx90b-flex export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from rx90b_flex.commands.shared import RobotSource, say


def export_command(
    robot: RobotSource,
    file_format: Annotated[str, Option("--format", help="urdf, mjcf (MuJoCo) or sdf (Gazebo).")],
    out: Annotated[Path, Option("--out", help="File to write.")],
) -> None:
    """Write an identified robot for a simulator.

    With what the format holds; what it does not hold is printed, one line an effect.
    """
    from rx90b_flex.simulators import export_robot

    done = export_robot(robot, out, file_format)  # type: ignore[arg-type]  # what it is not, it says
    for lost in done.lost:
        say(f"Not held: {lost}")
    say(f"{done.format.upper()}: {out}")
