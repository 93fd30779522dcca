"""Close the loop on data over frequency, whichever it is, and write what that gives."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from rx90b_flex.diagnose.flexible import FlexibleLoop
from rx90b_flex.diagnose.loop import Progress
from rx90b_flex.diagnose.modal import MODEL_ERROR, close_modal
from rx90b_flex.diagnose.response import MODEL_ERROR as RESPONSE_ERROR
from rx90b_flex.diagnose.response import close_response, load_frequency_responses
from rx90b_flex.export import save_robot
from rx90b_flex.files.results import write_json
from rx90b_flex.signals.folders import CLOSED_LOOP, fill_folder


def write_loop(
    loop: FlexibleLoop,
    folder: str | os.PathLike[str],
    extra: Iterable[Callable[[FlexibleLoop, Path], None]] = (),
    overwrite: bool = False,
) -> Path:
    """Write ``closed_loop.json``, the robot with what was found, and what else is given; all of it or nothing."""
    folder = Path(folder)

    def fill(at: Path) -> None:
        write_json(at / "closed_loop.json", loop.as_json(), indent=1)
        save_robot(loop.robot, at, allow_inconsistent=True)
        for write in extra:
            write(loop, at)

    fill_folder(folder, fill, CLOSED_LOOP, overwrite)
    return folder


def close_over_frequency(
    source: str | os.PathLike[str],
    robot: str | None = None,
    model_error: float | None = None,
    progress: Progress | None = None,
) -> FlexibleLoop:
    """Close the loop on a modal table or on a folder of ``rx90b-flex frf``: `close_modal` or `close_response`.

    A folder's robot is the one of that name, unless another is given.
    """
    if Path(source).is_dir():
        responses, name = load_frequency_responses(source)
        return close_response(responses, robot or name, model_error=model_error or RESPONSE_ERROR, progress=progress)
    return close_modal(source, robot, model_error=model_error or MODEL_ERROR, progress=progress)
