"""``rx90b-flex close-loop`` with several campaigns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from rx90b_flex.commands.shared import progress, say, show_table
from rx90b_flex.endings import Stopped
from rx90b_flex.interrupts import calm, is_interrupt


def close_fleet(
    campaigns: Sequence[Path], out: Path, jobs: int | None, dask: str | None, options: Mapping[str, Any]
) -> None:
    """Close the loop on each campaign, compare the robots, and say what was found; status 1 where one was not compared."""
    if jobs is not None and dask is not None:
        raise ValueError(
            "--jobs and --dask: give the one or the other; how many processes a cluster has is its own matter"
        )
    with progress() as tell:
        tell("reading", 0.0)
        from rx90b_flex.fleet.fleet import close_loop_many
        from rx90b_flex.view.fleet_report import headline

        try:
            fleet = close_loop_many(
                campaigns, jobs=1 if jobs is None else jobs, dask=dask, out=out, progress=tell, **options
            )
        except BaseException as error:
            if not is_interrupt(error):
                raise
            calm()
            raise Stopped("interrupted; robots that were done are kept, and the same command goes on") from None
    rows = [
        (
            o.name,
            o.verdict.replace("_", " "),
            ", ".join(e.label for e in o.found),
            "yes" if fleet.standing_out(o.name) else "",
        )
        for o in fleet.robots
    ]
    show_table(f"{len(fleet)} robots", rows, ("robot", "verdict", "found", "stands out"))
    for line in headline(fleet):
        say(line)
    say(f"Report: {out / 'fleet.html'}")
    if fleet.not_compared:
        raise typer.Exit(1)
