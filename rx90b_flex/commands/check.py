"""``rx90b-flex check``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from typer import Option

from rx90b_flex.commands.shared import CampaignFile, Out, Overwrite, progress, say, show_table

if TYPE_CHECKING:
    from rx90b_flex.diagnose.check import Checked


def check_command(
    campaign: CampaignFile,
    out: Out,
    plots: Annotated[
        bool, Option("--plots", help="Each joint's torque against the declared model's, before any fit.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Look for what is wrong with the data.

    Columns, signs, units, times, the URDF; and what the motion can tell. Exit status: 0 usable, 1 a fault was found, 2 bad input.
    """
    from rx90b_flex.signals.folders import CHECKED, check_folder, files_read, fill_folder

    check_folder(out, CHECKED, overwrite, files_read(campaign))
    with progress() as tell:
        tell("reading", 0.0)
        from rx90b_flex.diagnose.check import check
        from rx90b_flex.view.check_report import write_check_report

        checked = check(campaign, progress=tell)
        tell("writing the report", 0.95)
        fill_folder(out, lambda folder: write_check_report(checked, folder, plots), CHECKED, overwrite)
    print_checked(checked)
    say(f"Report: {out / 'check.html'}")
    if not checked.usable:
        raise typer.Exit(1)


def print_checked(checked: Checked) -> None:
    """A table of faults, and what the motion can tell."""
    from rx90b_flex.view.check_report import basics_words, facts_words, told_words

    rows = [
        (
            f.kind,
            ", ".join(f.joints),
            "" if f.factor is None else f"{f.factor:.4g}" + (f" ± {f.std:.1g}" if f.std else ""),
            f.message,
        )
        for f in checked.data_faults
    ]
    if rows:
        show_table(checked.verdict, rows, ("found", "where", "factor", "what to do"), ("factor",))
    else:
        say(checked.verdict)
    for text in (*facts_words(checked), *told_words(checked), *basics_words(checked)):
        say(text)


def end_refused(checked: Checked, out: Path) -> NoReturn:
    """Say what was found and end with status 1."""
    print_checked(checked)
    say("Nothing was fitted; --despite-faults goes on all the same.")
    say(f"Report: {out}")
    raise typer.Exit(1)
