"""``rx90b-flex view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from rx90b_flex.commands.shared import numbers, progress, say


def view_command(
    source: Annotated[
        str, Argument(help="Folder of `rx90b-flex simulate`, campaign file, or robot (its mode shapes).")
    ],
    beside: Annotated[str | None, Option(help="A second folder or campaign, shown as what came after.")] = None,
    recording: Annotated[str | None, Option(help="Name of the recording; the first where not given.")] = None,
    magnify: Annotated[float, Option(help="Factor of the deformations.")] = 100.0,
    modes: Annotated[bool, Option("--modes", help="Mode shapes of a run's robot instead of its motion.")] = False,
    pose: Annotated[
        str | None, Option(help="Drives of the mode shapes, degrees (m where a joint slides): 0,90,0")
    ] = None,
    count: Annotated[int, Option(help="How many modes.")] = 6,
    flexible: Annotated[
        bool, Option("--flexible", help="Bend a rigid robot: stiffnesses by a rule that is said, not identified.")
    ] = False,
    tip: Annotated[str | None, Option(help="Frame that counts as the tip; the robot file's otherwise.")] = None,
    out: Annotated[Path | None, Option("--out", help="HTML file to write, instead of a browser.")] = None,
) -> None:
    """Show the robot bend: its motion, two runs, or mode shapes.

    In a browser, or (--out) as one HTML file that opens offline.
    """
    from rx90b_flex.early import campaign_path, read_campaign
    from rx90b_flex.robot import load_robot
    from rx90b_flex.signals.single import check_file

    if beside == "":
        raise ValueError("--beside is ''; expected a folder of `rx90b-flex simulate` or a campaign file")
    for given in [source, *([beside] if beside and not modes else [])]:
        if out is not None:
            check_file(out, given)
        campaign = campaign_path(given)
        if campaign is None:
            load_robot(given)
        else:
            read_campaign(campaign)
    from rx90b_flex.view.command import serve_until_interrupted, view_of

    with progress() as tell:
        tell("reading", 0.1)
        angles = None if pose is None else numbers("--pose", pose)
        made = view_of(
            source, beside, recording=recording, magnify=magnify, modes=modes, pose=angles, count=count,
            flexible=flexible, tip=tip,
        )  # fmt: skip
    if out is not None:
        made.save_html(out)
    for line in (made.title, *made.notes):
        say(line)
    if out is not None:
        say(f"View: {out}")
        return
    serve_until_interrupted(made, lambda url: say(f"{url} shows it until Ctrl-C"))
