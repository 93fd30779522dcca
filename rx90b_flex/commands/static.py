"""``rx90b-flex static``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from rx90b_flex.commands.shared import Out, Overwrite, fitted_into


def static_command(
    tests: Annotated[Path, Argument(help="File of dead-weight tests (TOML).")],
    out: Out,
    overwrite: Overwrite = False,
) -> None:
    """Find joint stiffnesses from dead-weight tests.

    Loads up and down again, deformations, and where the lever is not given the pose: stiffnesses with their standard deviations, in
    the robot's file, too.
    """
    from rx90b_flex.signals.folders import STATIC, check_folder, files_read

    check_folder(out, STATIC, overwrite, files_read(tests))
    from rx90b_flex.identify.static_command import fit_tests, read_static_tests, write_static
    from rx90b_flex.view.static_report import headline, write_static_report

    fitted_into(
        out, STATIC, overwrite, lambda: fit_tests(read_static_tests(tests)), write_static, write_static_report, headline
    )
