"""``rx90b-flex check-path``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from rx90b_flex.commands.shared import Overwrite, progress, say, show_table

if TYPE_CHECKING:
    from rx90b_flex.path.check import PathCheck
    from rx90b_flex.path.measured import MeasuredTip

# options that take several lines
PathSource = Annotated[
    str, Argument(help="Path file (TOML), table of points (CSV, with --speed-mm-s), or an example: line, square.")
]
RobotOfPath = Annotated[
    str | None, Option(help="Robot name, robot file or URDF; the path file's, or rx90b, otherwise.")
]
Contributions = Annotated[bool, Option("--contributions/--no-contributions", help="Switch each effect off in turn.")]
MeasuredFile = Annotated[
    Path | None,
    Option(
        help="Measured places of the tip (CSV: x, y, z, time if known) to compare with the predicted ones, and nothing else."
    ),
]
SaveExample = Annotated[
    Path | None, Option(help="Write the example PATH to this file, to start from, and do nothing else.")
]


def check_path_command(
    path: PathSource,
    out: Annotated[Path, Option("--out", help="Folder for the results.")] = Path("rx90b-flex-path"),
    tolerance_mm: Annotated[float, Option(help="Largest deviation across the path.")] = 0.1,
    robot: RobotOfPath = None,
    speed_mm_s: Annotated[float | None, Option(help="Instead of the path file's.")] = None,
    controller: Annotated[
        Path | None,
        Option(help="Controller file (TOML); the robot file's, or gains designed for the robot, otherwise."),
    ] = None,
    correct: Annotated[bool, Option("--correct/--no-correct", help="Look for a corrected path.")] = True,
    contributions: Contributions = True,
    measured: MeasuredFile = None,
    iterations: Annotated[int, Option(help="Of the correction, at most.")] = 10,
    jobs: Annotated[int, Option(help="Processes for the effects' runs.")] = 1,
    save_example: SaveExample = None,
    overwrite: Overwrite = False,
) -> None:
    """Check whether the tip keeps to a seam; correct the path.

    Where it strays, which effect is why, and a corrected path. With --measured: whether the tip was where it was predicted.

    Exit status: 0 within tolerance, as planned or corrected, or measured where predicted; 1 not within tolerance; 2 bad input, or a
    path that the robot cannot follow (out of reach, outside limits, through a singularity, too fast), with nothing written.
    """
    from rx90b_flex.signals.folders import PATH_CHECK, check_folder

    if save_example is None:
        check_folder(out, PATH_CHECK, overwrite, [str(x) for x in (path, robot, controller, measured) if x])
    from rx90b_flex.early import check_jobs

    check_jobs(jobs)
    if save_example is None:
        _check_robot(path, speed_mm_s, robot)
    if save_example is not None:
        from rx90b_flex.path.output import write_example

        write_example(path, save_example)
        say(f"Path file: {save_example}")
        return
    from rx90b_flex.path.measured import compare_measured, read_measured
    from rx90b_flex.verbs import check_path

    if measured is not None:
        read_measured(measured)  # before anything is simulated
        correct = contributions = False
    with progress() as tell:
        result = check_path(
            path, robot=robot, tolerance_mm=tolerance_mm, speed_mm_s=speed_mm_s, controller=controller, correct=correct,
            contributions=contributions, iterations=iterations, jobs=jobs, progress=tell,
        )  # fmt: skip
        found = None if measured is None else compare_measured(result, measured)
        tell("writing the report", 0.98)
        _write(result, found, out, overwrite)
    if found is None:
        _say(result, out)
    else:
        _say_measured(result, found, out)
    failed = result.verdict == "outside_tolerance" if found is None else not found.agrees
    if failed:
        raise typer.Exit(1)


def _check_robot(path: str, speed_mm_s: float | None, robot: str | None) -> None:
    """Whether the robot is there that is asked for, or else that which the path file names."""
    from rx90b_flex.files.toml import named_in
    from rx90b_flex.path.seam import load_seam
    from rx90b_flex.robot import load_robot

    named = load_seam(path, speed_mm_s).robot
    if robot:
        load_robot(robot)
    elif named:
        with named_in(Path(path), "robot"):
            load_robot(named)


def _write(result: PathCheck, found: MeasuredTip | None, out: Path, overwrite: bool) -> None:
    from rx90b_flex.path.measured import write_measured
    from rx90b_flex.path.output import write_check
    from rx90b_flex.view.path_report import write_path_report

    def more(result: PathCheck, folder: Path) -> None:
        if found is not None:
            write_measured(found, folder)
        write_path_report(result, folder / "report.html", found)

    write_check(result, out, more, overwrite)


def _say(result: PathCheck, out: Path) -> None:
    say(result.sentence)
    causes = sorted((c for c in result.contributions if c.why_not is None), key=lambda c: -c.rms_across)[:3]
    if causes:
        said = ", ".join(f"{c.name} {c.rms_across:.3f}" for c in causes)
        say(f"Largest contributions across, RMS, mm: {said}")
    say(f"Report: {out / 'report.html'}")
    beside = f" --beside {out / 'corrected'}" if (out / "corrected").is_dir() else ""
    say(f"In motion: rx90b-flex view {out / 'as_planned'}{beside}")


def _say_measured(result: PathCheck, found: MeasuredTip, out: Path) -> None:
    from rx90b_flex.view.measured_section import NAMES, largest

    head = ("tip", "across, largest, mm", "RMS, mm", "at, mm")
    rows = [(NAMES[name], *largest(of)) for name, of in found.tips.items()]
    show_table(f"{result.plan.seam.name} with {result.plan.robot.name}", rows, head, head[1:])
    say(found.sentence)
    say(f"Report: {out / 'report.html'}")
