"""``rx90b-flex view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rx90b_flex.commands.shared import progress, say


def view_command(
    source: Annotated[
        str, typer.Argument(help="Folder of `rx90b-flex simulate`, campaign file, or robot (its mode shapes).")
    ],
    beside: Annotated[str | None, typer.Option(help="A second folder or campaign, shown as what came after.")] = None,
    recording: Annotated[str | None, typer.Option(help="Name of the recording; the first where not given.")] = None,
    magnify: Annotated[float, typer.Option(help="Factor of the deformations.")] = 100.0,
    modes: Annotated[bool, typer.Option("--modes", help="Mode shapes of a run's robot instead of its motion.")] = False,
    pose: Annotated[str | None, typer.Option(help="Drive angles of the mode shapes, degrees: 0,90,0")] = None,
    count: Annotated[int, typer.Option(help="How many modes.")] = 6,
    flexible: Annotated[
        bool, typer.Option("--flexible", help="Bend a rigid robot: stiffnesses by a rule that is said, not identified.")
    ] = False,
    tip: Annotated[str | None, typer.Option(help="Frame that counts as the tip; the robot file's otherwise.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="HTML file to write, instead of a browser.")] = None,
) -> None:
    """Show the robot bend: its motion, two runs, or mode shapes.

    In a browser, or (--out) as one HTML file that opens offline.
    """
    from rx90b_flex.early import check_robot, read_campaign
    from rx90b_flex.signals.single import check_file

    if beside == "":
        raise ValueError("--beside is ''; expected a folder of `rx90b-flex simulate` or a campaign file")
    if out is not None:
        for given in [source, *([beside] if beside else [])]:
            check_file(out, given)
    for given in [source, *([beside] if beside else [])]:
        inside = Path(given) / "campaign.toml" if Path(given).is_dir() else Path(given)
        if inside.is_file() and inside.suffix == ".toml" and b"[[recording]]" in inside.read_bytes():
            read_campaign(inside)
        elif not Path(given).is_dir():
            check_robot(given)
    from rx90b_flex.view.command import Wanted, serve_until_interrupted, view_of, write_view

    wanted = Wanted(source, beside, recording, magnify, modes, pose, count, flexible, tip)
    with progress() as tell:
        tell("reading", 0.1)
        made = view_of(wanted)
    if out is not None:
        write_view(made, out)
    for line in (made.title, *made.notes):
        say(line)
    if out is not None:
        say(f"View: {out}")
        return
    serve_until_interrupted(made, lambda url: say(f"{url} shows it until Ctrl-C"))
