"""``rx90b-flex identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from rx90b_flex.commands.check import end_refused
from rx90b_flex.commands.shared import (
    Basics,
    CampaignFile,
    Despite,
    Out,
    Overwrite,
    progress,
    say,
    show_table,
    value_words,
)


def identify_command(
    campaign: CampaignFile,
    out: Out,
    basics: Basics = False,
    estimator: Annotated[
        str, Option(help="least_squares; huber, which bumps hardly move; or one of another package.")
    ] = "least_squares",
    despite_faults: Despite = False,
    overwrite: Overwrite = False,
) -> None:
    """Fit the declared robot's parameters to a campaign.

    Parameters with standard deviations, robot file and URDF, predictions, report.

    Exit status: 0 done, 1 the data cannot be used (the folder then holds what `check` writes), 2 bad input, with nothing written.
    """
    from rx90b_flex.early import read_campaign
    from rx90b_flex.signals.folders import CHECKED, IDENTIFIED, check_folder, files_read, fill_folder

    check_folder(out, IDENTIFIED, overwrite, files_read(campaign))
    if estimator != "least_squares":  # the usual one is there, and its libraries take a while
        from rx90b_flex.identify.estimators.estimator import estimator_named

        estimator_named(estimator)
    with progress() as tell:
        tell("reading", 0.0)
        read = read_campaign(campaign)
        from rx90b_flex.diagnose.basics import declared_robot
        from rx90b_flex.diagnose.check import check
        from rx90b_flex.identify.command import identify_campaign, write_identified
        from rx90b_flex.view.check_report import basics_words, write_check_report
        from rx90b_flex.view.identify_report import headline, write_identify_report

        declared = declared_robot(read, basics)
        checked = check(read, robot=declared)
        if not (checked.usable or despite_faults):
            fill_folder(out, lambda folder: write_check_report(checked, folder), CHECKED, overwrite)
            end_refused(checked, out)
        result = identify_campaign(read, robot=declared, estimator=estimator, progress=tell)
        tell("writing the report", 0.95)

        def fill(folder: Path) -> None:
            write_identified(result, folder)
            write_identify_report(result, folder / "report.html")

        fill_folder(out, fill, IDENTIFIED, overwrite)
    rows = [(e.name, value_words("", e.value, e.std, e.unit).strip()) for e in result.parameters if e.value is not None]
    show_table(result.source.name, rows, ("parameter", "value"))
    if checked.never_move:
        say(f"Not told, for they never move: the parameters of {', '.join(checked.never_move)}.")
    for text in dict.fromkeys((*headline(result), *(f.message for f in checked.data_faults), *basics_words(checked))):
        say(text)
    say(f"Report: {out / 'report.html'}")
