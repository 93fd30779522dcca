"""``rx90b-flex flexify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from rx90b_flex.commands.shared import RobotSource, say


def flexify_command(
    robot: RobotSource,
    out: Annotated[Path, Option("--out", help="URDF to write.")],
    torsion: Annotated[list[str] | None, Option(help="Joint whose drive twists; repeat for more.")] = None,
    bending: Annotated[list[str] | None, Option(help="Joint that bends; repeat for more.")] = None,
    base: Annotated[bool, Option("--base", help="A base that tilts about two axes.")] = False,
) -> None:
    """Write a URDF with virtual joints that twist and bend.

    Without --torsion, --bending and --base: those that its robot file declares; for a plain URDF, every joint
    twists and bends. A payload that the robot file declares goes into the link that carries it.
    """
    from rx90b_flex import flexify as virtual
    from rx90b_flex.robot import load_robot
    from rx90b_flex.signals.single import check_file
    from rx90b_flex.simulators.exporting import lost_followers
    from rx90b_flex.simulators.held import with_carried

    check_file(out, robot)
    loaded = load_robot(robot)
    places = loaded.flexible_places()
    if torsion or bending or base:
        places = (torsion or [], bending or [], base)
    elif not any(places):
        places = (list(loaded.joints), list(loaded.joints), False)
    loaded, carried, without = with_carried(loaded)
    flexible = virtual.flexify(virtual.read_xml(loaded.urdf), *places)
    virtual.write_urdf(virtual.with_continuous(flexible), out)
    for label in carried:
        say(f"In the links: {label}")
    for lost in (*without, *lost_followers(loaded)):
        say(f"Not held: {lost}")
    added = 2 * places[2] + len(places[0]) + 2 * len(places[1])
    say(f"{out}: {len(loaded.joints)} driven joints, {added} virtual ones")
