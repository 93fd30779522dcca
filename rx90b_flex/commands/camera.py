"""``rx90b-flex camera``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from rx90b_flex.commands.shared import Out, Overwrite, fitted_into


def camera_command(
    markers: Annotated[Path, Argument(help="File of markers (TOML).")], out: Out, overwrite: Overwrite = False
) -> None:
    """Find joint stiffnesses from markers before a camera.

    On the links beside a joint, along a motion or in poses at rest: torsion and both bendings with their standard deviations, in the
    robot's file, too.
    """
    from rx90b_flex.signals.folders import CAMERA, check_folder, files_read

    check_folder(out, CAMERA, overwrite, files_read(markers))
    from rx90b_flex.identify.camera_command import fit_markers, read_markers, write_camera
    from rx90b_flex.view.camera_report import headline, write_camera_report

    fitted_into(
        out, CAMERA, overwrite, lambda: fit_markers(read_markers(markers)), write_camera, write_camera_report, headline
    )
