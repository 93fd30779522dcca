"""What ``rx90b-flex close-loop`` does with one campaign: read, close the loop, simulate it, write its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rx90b_flex.diagnose.close import ClosedLoop
    from rx90b_flex.diagnose.motion import MotionErrors
    from rx90b_flex.diagnose.refused import RefusedLoop


@dataclass(frozen=True)
class LoopOptions:
    """How a loop is closed: seed of the permutation test, whether basics are declared, whether faults of the data stop it, and by how
    many processes (`close_loop`).
    """

    seed: int = 0
    basics: bool = False
    despite_faults: bool = False
    jobs: int | None = None


@dataclass(frozen=True, eq=False)
class Closed:
    """A closed loop with its simulation, or one that the data did not allow."""

    result: ClosedLoop | RefusedLoop
    motion: MotionErrors | str | None

    def write(self, out: Path, overwrite: bool = False) -> None:
        """Write the folder with its report; all of it or nothing."""
        from rx90b_flex.diagnose.output import write_result
        from rx90b_flex.view.report import write_report

        report = [lambda r, folder: write_report(r, folder / "report.html", self.motion)]
        write_result(self.result, out, report, self.motion, overwrite)


def close_campaign(path: Path, options: LoopOptions, tell: Callable[[str, float], None] | None = None) -> Closed:
    """Close the loop on a campaign file and simulate the result.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.
    """
    from rx90b_flex.early import read_campaign

    told = tell or (lambda _text, _part: None)
    read = read_campaign(path)
    from rx90b_flex.diagnose.close import close_loop
    from rx90b_flex.diagnose.motion import motion_errors

    result = close_loop(
        read,
        basics=options.basics,
        seed=options.seed,
        progress=tell,
        despite_faults=options.despite_faults,
        jobs=options.jobs,
    )
    told("simulating the closed loop and writing the report", 1.0)
    return Closed(result, motion_errors(result))
