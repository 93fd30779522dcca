"""What ``rx90b-flex close-loop`` does with one campaign: read, close the loop, simulate it, write its folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rx90b_flex.diagnose.close import ClosedLoop
    from rx90b_flex.diagnose.motion import MotionErrors
    from rx90b_flex.diagnose.refused import RefusedLoop
    from rx90b_flex.robot import Robot
    from rx90b_flex.signals import Campaign


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


def declared_robot(campaign: Campaign, basics: bool, robot: Robot | str | os.PathLike[str] | None = None) -> Robot:
    """The campaign's robot, or another one; with `basics`, what every drive has is declared on all of the campaign's joints."""
    from rx90b_flex.diagnose.basics import with_basics
    from rx90b_flex.robot import load_robot

    declared = load_robot(campaign.robot_source if robot is None else robot)
    if not basics:
        return declared
    joints = [j for j in campaign.joints if j in declared.joints]
    return with_basics(declared, joints, campaign.torque_side == "behind_gear")


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

    robot = declared_robot(read, options.basics)
    result = close_loop(
        read, robot=robot, seed=options.seed, progress=tell, despite_faults=options.despite_faults, jobs=options.jobs
    )
    told("simulating the closed loop and writing the report", 1.0)
    return Closed(result, motion_errors(result))
