"""The command line: ``rx90b-flex``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
import typer.core

from rx90b_flex.commands import camera, check_path, export, fleet, static, view
from rx90b_flex.commands.shared import (
    Basics,
    Despite,
    Out,
    Overwrite,
    progress,
    say,
    show_table,
    without_types_of_flags,
)

if TYPE_CHECKING:
    from rx90b_flex.robot import Robot


class _Commands(typer.core.TyperGroup):
    """All commands."""

    def get_params(self, ctx: Any) -> list[Any]:
        return without_types_of_flags(super().get_params(ctx))


app = typer.Typer(
    name="rx90b-flex",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(asked: bool) -> None:
    if asked:
        from rx90b_flex import __version__

        say(f"rx90b-flex {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Industrial robots whose drives and joints bend: model, identify, and find what a model lacks."""


@app.command("close-loop")
def close_loop_command(
    campaigns: Annotated[
        list[Path],
        typer.Argument(
            help="Campaign file or modal table (TOML), or folder of `rx90b-flex frf`; several campaigns are a fleet, one a robot.",
            metavar="CAMPAIGN...",
        ),
    ],
    out: Out,
    seed: Annotated[int, typer.Option(help="Seed of the permutation test for what remains.")] = 0,
    robot: Annotated[str | None, typer.Option(help="Another robot; for modal tables and frequency responses.")] = None,
    model_error: Annotated[
        float | None, typer.Option(help="Relative error of the model to allow for; for the same two.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes for a fleet; 1 where not given.")] = None,
    dask: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler for a fleet, such as tcp://host:8786.")
    ] = None,
    basics: Basics = False,
    despite_faults: Despite = False,
    overwrite: Overwrite = False,
) -> None:
    """Find what the data hold and the model lacks; add it.

    Tries every effect of the catalogue on every joint of CAMPAIGN's robot, and keeps those that predict data they were not fitted to.
    With several campaigns, one a robot of one make: a folder a robot; fleet.html, fleet.csv, fleet.json say what they have in common
    and which robot stands out. The same command again goes on where it was stopped.
    """
    if model_error is not None and not model_error > 0.0:
        raise ValueError(f"model_error is {model_error:g}; expected more than 0")
    if len(campaigns) > 1:
        for name, value in (("--robot", robot), ("--model-error", model_error)):
            if value is not None:
                raise ValueError(
                    f"{name} goes with a modal table or a folder of `rx90b-flex frf`, not with several campaigns"
                )
        options = {"seed": seed, "basics": basics, "despite_faults": despite_faults, "overwrite": overwrite}
        fleet.close_fleet(campaigns, out, jobs, dask, options)
        return
    for name, given in (("--jobs", jobs), ("--dask", dask)):
        if given is not None:
            raise ValueError(f"{name} goes with several campaigns, one a robot; only {campaigns[0]} is given")
    campaign = campaigns[0]
    from rx90b_flex.diagnose.modal_files import speaks_of_frequency

    if speaks_of_frequency(campaign):
        _close_over_frequency(campaign, out, robot, model_error, overwrite)
        return
    for name, value in (("--robot", robot), ("--model-error", model_error)):
        if value is not None and campaign.exists():  # what is not there is said to be missing, further on
            raise ValueError(f"{name} goes with a modal table or a folder of `rx90b-flex frf`; {campaign} is neither")
    from rx90b_flex.closing import LoopOptions, close_campaign
    from rx90b_flex.signals.folders import CLOSED_LOOP, check_folder

    check_folder(out, CLOSED_LOOP, overwrite, [campaign])
    with progress() as tell:
        tell("reading", 0.0)
        closed = close_campaign(campaign, LoopOptions(seed, basics, despite_faults), tell)
        closed.write(out, overwrite)
    if closed.motion is None:
        _end_refused(closed.result.checked, out)
    _print_result(closed.result)
    say(f"Report: {out / 'report.html'}")


def _with_basics(campaign: object) -> Robot:
    """The campaign's robot with what every drive has declared on all of the campaign's joints."""
    from rx90b_flex.closing import declared_robot
    from rx90b_flex.signals import Campaign

    assert isinstance(campaign, Campaign)
    return declared_robot(campaign, basics=True)


def _end_refused(checked: object, out: Path) -> NoReturn:
    """Say what was found and end with status 1."""
    _print_checked(checked)
    say("Nothing was fitted; --despite-faults goes on all the same.")
    say(f"Report: {out}")
    raise typer.Exit(1)


@app.command("check")
def check_command(
    campaign: Annotated[Path, typer.Argument(help="Campaign file (TOML).")],
    out: Out,
    plots: Annotated[
        bool, typer.Option("--plots", help="Each joint's torque against the declared model's, before any fit.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Look for what is wrong with the data.

    Columns, signs, units, times, the URDF; and what the motion can tell. Exit status: 0 usable, 1 a fault was found, 2 bad input.
    """
    from rx90b_flex.signals.folders import CHECKED, check_folder, fill_folder

    check_folder(out, CHECKED, overwrite, [campaign])
    with progress() as tell:
        tell("reading", 0.0)
        from rx90b_flex.diagnose.check import check
        from rx90b_flex.view.check_report import write_check_report

        checked = check(campaign, progress=tell)
        tell("writing the report", 0.95)
        fill_folder(out, lambda folder: write_check_report(checked, folder, plots), CHECKED, overwrite)
    _print_checked(checked)
    say(f"Report: {out / 'check.html'}")
    if not checked.usable:
        raise typer.Exit(1)


def _print_checked(checked: object) -> None:
    """A table of faults, and what the motion can tell."""
    from rx90b_flex.diagnose.check import Checked
    from rx90b_flex.view.check_report import basics_words, facts_words, told_words

    assert isinstance(checked, Checked)
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


def _close_over_frequency(
    source: Path, out: Path, robot: str | None, model_error: float | None, overwrite: bool
) -> None:
    from rx90b_flex.diagnose.close_flexible import close_over_frequency, write_loop
    from rx90b_flex.signals.folders import CLOSED_LOOP, check_folder
    from rx90b_flex.view.flexible_report import headline, write_flexible_report

    check_folder(out, CLOSED_LOOP, overwrite, [source])
    with progress() as tell:
        loop = close_over_frequency(source, robot, model_error, tell)
        tell("writing the report", 0.98)
        write_loop(loop, out, [lambda r, at: write_flexible_report(r, at / "report.html")], overwrite)
    say(f"{loop.source.name}: {loop.verdict.replace('_', ' ')}")
    for text in (*(f.words for f in loop.found), headline(loop), *loop.doubts()):
        say(text)
    say(f"Report: {out / 'report.html'}")


@app.command()
def demo(
    out: Out = Path("rx90b-flex-demo"),
    seed: Annotated[int, typer.Option(help="Seed of what is hidden, of the motion and of the noise.")] = 0,
    hidden: Annotated[
        str | None, typer.Option(help="Effect type to hide, or 'none'; drawn from the seed where not given.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Hide an effect in simulated recordings, then find it.

    The recordings, the campaign file and the report stay, to look at and to start from.
    """
    from rx90b_flex.signals.folders import DEMONSTRATION, check_folder, fill_folder

    check_folder(out, DEMONSTRATION, overwrite)
    from rx90b_flex.demo import check_hidden, make_demonstration

    check_hidden(hidden)
    from rx90b_flex.closing import Closed, LoopOptions, close_campaign
    from rx90b_flex.diagnose.output import write_result
    from rx90b_flex.view.report import write_report

    with progress() as tell:
        tell("making recordings", 0.0)
        demonstration = make_demonstration(seed, hidden)

        def fill(folder: Path) -> None:
            # the loop reads the campaign from disk, as it would read anyone's: it is not told what is hidden
            closed = close_campaign(demonstration.write(folder), LoopOptions(), tell)
            write_result(closed.result, folder, [lambda r, at: write_report(r, at / "report.html", closed.motion)])
            loops.append(closed)

        loops: list[Closed] = []
        fill_folder(out, fill, DEMONSTRATION, overwrite)
    _print_result(loops[0].result)
    what = "nothing" if demonstration.hidden is None else _describe(demonstration.hidden)
    say(f"What had been hidden: {what}")
    say(f"Recordings, model and report: {out}")


MOST_MODES = 30  # of transfer functions: more are no modes of a robot in any band


@app.command()
def frf(
    campaign: Annotated[
        Path, typer.Argument(help="Campaign file (TOML): periodic excitation with feed-forward torque.")
    ],
    out: Out,
    low_hz: Annotated[float, typer.Option(help="Lowest line.")] = 8.0,
    high_hz: Annotated[float, typer.Option(help="Highest line.")] = 80.0,
    controller: Annotated[
        Path | None, typer.Option(help="Controller file; controller.toml beside CAMPAIGN otherwise.")
    ] = None,
    link_mass_std: Annotated[float, typer.Option(help="Relative uncertainty of the links' masses; 0: known.")] = 0.0,
    bending_alike_std: Annotated[
        float, typer.Option(help="To which a joint is equally stiff about both bending axes; 0: not assumed.")
    ] = 0.1,
    hinge_std: Annotated[
        float, typer.Option(help="To which it is known where hinges that bend lie on their links, m; 0: known.")
    ] = 0.0,
    references: Annotated[
        Path | None,
        typer.Option(help="Folder references/ of `rx90b-flex excite`, where it is not beside the campaign."),
    ] = None,
    modes: Annotated[
        str, typer.Option(help="Numbers of modes that transfer functions try: LOWEST,HIGHEST, or one number.")
    ] = "2,8",
    start_hz: Annotated[
        str | None,
        typer.Option(
            help="Resonances that transfer functions of as many modes start from as well: F1,F2,...", show_default=False
        ),
    ] = None,
    delays: Annotated[
        str, typer.Option(help="Of torques in transfer functions: none, common (one for all) or each.")
    ] = "none",
    seed: Annotated[int, typer.Option(help="Seed of the grey box's starts.")] = 0,
    mains_hz: Annotated[
        float | None, typer.Option(help="50 or 60: take mains near that frequency out of the recordings.")
    ] = None,
    no_replay: Annotated[
        bool, typer.Option("--no-replay", help="Leave friction's distortion in: do not simulate the experiments.")
    ] = False,
    jobs: Annotated[int, typer.Option(help="Processes for the replay's simulations and the figures.")] = 2,
    overwrite: Overwrite = False,
) -> None:
    """Identify stiffness, damping and inertia from motor signals.

    CAMPAIGN is what `rx90b-flex excite` writes, with the logs of its motions.
    """
    from rx90b_flex.early import check_jobs, read_campaign
    from rx90b_flex.signals.folders import MOTOR_SIGNALS, check_folder

    check_folder(out, MOTOR_SIGNALS, overwrite, [campaign])
    if not 0.0 < low_hz < high_hz:
        raise ValueError(
            f"--low-hz and --high-hz are {low_hz:g} and {high_hz:g}; expected a low and a higher frequency above 0"
        )
    for name, std in (("link-mass", link_mass_std), ("bending-alike", bending_alike_std), ("hinge", hinge_std)):
        if not 0.0 <= std < float("inf"):
            raise ValueError(f"--{name}-std is {std:g}; expected 0 or more")
    check_jobs(jobs)
    ends = _numbers("modes", modes)
    if len(ends) > 2 or any(x != round(x) or not 1 <= x <= MOST_MODES for x in ends) or ends[0] > ends[-1]:
        raise ValueError(f"--modes is {modes!r}; expected one or two ascending whole numbers from 1 to {MOST_MODES}")
    starts = tuple(_numbers("start-hz", start_hz)) if start_hz else ()
    if starts and (not ends[0] <= len(starts) <= ends[-1] or not all(low_hz <= f <= 2 * high_hz for f in starts)):
        raise ValueError(
            f"--start-hz is {start_hz!r}; expected {modes.replace(',', ' to ')} resonances (--modes) "
            f"between {low_hz:g} and {2 * high_hz:g} Hz"
        )
    if delays not in ("none", "common", "each"):
        raise ValueError(f"--delays is {delays!r}; expected none, common or each")
    if mains_hz is not None and not mains_hz > 0.0:
        raise ValueError(f"--mains-hz is {mains_hz:g}; expected 50 or 60")
    read = read_campaign(campaign)
    from rx90b_flex.identify.frf_command import FrfOptions, identify_from_motors, write_motor_identification
    from rx90b_flex.view.frf_report import bias_words, delay_words, hinge_words, write_frf_report

    options = FrfOptions(
        (low_hz, high_hz), controller, link_mass_std, bending_alike_std, hinge_std, seed=seed, references=references,
        modes=tuple(range(int(ends[0]), int(ends[-1]) + 1)), start_hz=starts, delays=delays,
        mains_hz=mains_hz, replay=not no_replay, jobs=jobs,
    )  # fmt: skip
    with progress() as tell:
        result = identify_from_motors(read, options, tell)
        tell("writing the report", 0.97)
        write_motor_identification(result, out, [lambda r, at: write_frf_report(r, at / "report.html")], overwrite)
    if result.grey is not None:
        how = "as measured" if result.replayed is None else "less the distortion that a replay explains"
        rows = []
        best = result.grey if result.replayed is None else result.replayed.grey
        for e in best.estimates:
            said = f"{e.value:.4g}" if e.determined else "not determined"
            rows.append((e.name, said, f"{e.low:.4g} to {e.high:.4g}" if e.determined else "", e.unit))
        head = ("parameter", "value", "95 % interval", "unit")
        show_table(f"{result.robot.name}, from motor signals, {how}", rows, head, head[1:3])
        if best.bias_detected:
            say(f"Note: {bias_words(best)}")
        for text in [*delay_words(best.torque_delay), *hinge_words(best.hinges)]:
            say(text)
    for remark in result.remarks:
        say(f"Note: {remark}")
    for left in result.left_out:
        say(f"Left out: {left.stage}: {left.why}")
    say(f"Report: {out / 'report.html'}")


@app.command()
def excite(
    robot: Annotated[str, typer.Argument(help="Robot name, robot file, URDF, or example-robot-data:NAME.")],
    out: Out,
    pose: Annotated[list[str] | None, typer.Option(help="Degrees, one a joint: 0,90,0; repeat for more poses.")] = None,
    joints: Annotated[str | None, typer.Option(help="Joints to excite: NAME,NAME; the first three otherwise.")] = None,
    matrix: Annotated[
        str, typer.Option(help="Input matrix: ones (-1 down the diagonal), hadamard or identity.")
    ] = "ones",
    peak: Annotated[
        str | None, typer.Option(help="Largest torque, N m: one, or one a joint; 10 % of the limits otherwise.")
    ] = None,
    low_hz: Annotated[float, typer.Option(help="Lowest line.")] = 2.5,
    high_hz: Annotated[float, typer.Option(help="Highest line.")] = 80.0,
    period_s: Annotated[float, typer.Option(help="Period; a longer one has finer lines.")] = 4.096,
    speed: Annotated[float, typer.Option(help="Joint speed between reversals, rad/s.")] = 0.11,
    swings: Annotated[int, typer.Option(help="Times to and fro in a period; odd.")] = 1,
    realisations: Annotated[int, typer.Option(help="Multisines with other phases.")] = 16,
    periods: Annotated[int, typer.Option(help="Periods of a run; the first is for the transient.")] = 9,
    one_sign: Annotated[bool, typer.Option("--one-sign", help="Without the runs of opposite sign.")] = False,
    white: Annotated[
        bool, typer.Option("--white", help="Spectrum over the loop's sensitivity: drive torques are white.")
    ] = False,
    controller: Annotated[
        Path | None,
        typer.Option(
            help="Controller file (TOML): for --white, --simulate, references that order torques, and frf's replay."
        ),
    ] = None,
    by: Annotated[
        str, typer.Option(help="What carries the excitation: torque (fed forward), reference (motion alone) or both.")
    ] = "torque",
    speed_peak: Annotated[
        str | None,
        typer.Option(
            help="Largest speed added to references, rad/s, one or one a joint, where no controller file is given."
        ),
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option(help="Rate of the references; the controller file's otherwise.")
    ] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="Simulate the robot's logs, too.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of phases and noise.")] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Write the motions that frf needs, and the campaign file.

    With --simulate, the logs as well, of the robot as its file declares it.
    """
    import math

    from rx90b_flex.early import check_robot
    from rx90b_flex.signals.folders import CAMPAIGN, check_folder

    check_folder(out, CAMPAIGN, overwrite)
    check_robot(robot)
    from rx90b_flex.simulate.excite import ExciteRequest, excite_into

    poses = tuple(tuple(math.radians(x) for x in _numbers("pose", text)) for text in pose or [])
    request = ExciteRequest(
        robot, poses, tuple(joints.split(",")) if joints else (), matrix,  # type: ignore[arg-type]
        _numbers("peak", peak) if peak else (), (low_hz, high_hz), period_s, speed, swings, realisations, periods,
        not one_sign, white, controller, seed, by, _numbers("speed-peak", speed_peak) if speed_peak else (), rate_hz,  # type: ignore[arg-type]
    )  # fmt: skip
    with progress() as tell:
        said = excite_into(request, out, simulate, tell, overwrite)
    for text in said:
        say(text)
    say(f"{'Campaign' if simulate else 'References, and a campaign file for the logs'}: {out}")


def _numbers(name: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} is {text!r}; expected numbers with commas between them") from None


@app.command()
def flexify(
    robot: Annotated[str, typer.Argument(help="Robot name, robot file, URDF, or example-robot-data:NAME.")],
    out: Annotated[Path, typer.Option("--out", help="URDF to write.")],
    torsion: Annotated[list[str] | None, typer.Option(help="Joint whose drive twists; repeat for more.")] = None,
    bending: Annotated[list[str] | None, typer.Option(help="Joint that bends; repeat for more.")] = None,
    base: Annotated[bool, typer.Option("--base", help="A base that tilts about two axes.")] = False,
) -> None:
    """Write a URDF with virtual joints that twist and bend.

    Without --torsion, --bending and --base: those that its robot file declares; for a plain URDF, every joint
    twists and bends.
    """
    from rx90b_flex import flexify as virtual
    from rx90b_flex.robot import load_robot
    from rx90b_flex.signals.single import check_file

    check_file(out, robot)
    loaded = load_robot(robot)
    places = loaded.flexible_places()
    if torsion or bending or base:
        places = (torsion or [], bending or [], base)
    elif not any(places):
        places = (list(loaded.joints), list(loaded.joints), False)
    flexible = virtual.flexify(virtual.read_xml(loaded.urdf), *places)
    virtual.write_urdf(flexible, out)
    added = 2 * places[2] + len(places[0]) + 2 * len(places[1])
    say(f"{out}: {len(loaded.joints)} driven joints, {added} virtual ones")


@app.command("simulate")
def simulate_command(
    robot: Annotated[str, typer.Argument(help="Robot name, robot file, URDF, or example-robot-data:NAME.")],
    out: Out,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="Trajectory (CSV): time, one column a joint (rad), ff_<joint> (N m) if fed forward."),
    ] = None,
    line: Annotated[bool, typer.Option("--line", help="The 1.7 m horizontal line of section 4.2.2.")] = False,
    excitation: Annotated[bool, typer.Option("--excitation", help="The excitation of section 4.2.2.")] = False,
    square_wave: Annotated[bool, typer.Option("--square-wave", help="The square wave of section 6.6.2.")] = False,
    harmonics: Annotated[
        bool, typer.Option("--harmonics", help="Random harmonics of every joint, within any robot's limits.")
    ] = False,
    controller: Annotated[
        Path | None, typer.Option(help="Controller file (TOML); else the one that the robot's file states.")
    ] = None,
    periods: Annotated[int, typer.Option(help="Periods of an excitation that repeats.")] = 1,
    perturbation: Annotated[bool, typer.Option("--perturbation", help="Use the perturbation method.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of excitation and noise.")] = 0,
    torque_noise: Annotated[float, typer.Option(help="Standard deviation at the controller's rate, N m.")] = 0.0,
    position_noise: Annotated[float, typer.Option(help="The same of position, rad.")] = 0.0,
    velocity_noise: Annotated[float, typer.Option(help="The same of velocity, rad/s.")] = 0.0,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a flexible robot under its controller.

    Along a trajectory: recording, every coordinate, tip deviation, figure.

    The first simulation of a user compiles for about half a minute; later ones do not.
    """
    from rx90b_flex.early import check_robot
    from rx90b_flex.signals.folders import RUN, check_folder

    chosen = [*([str(trajectory)] if trajectory else []), *["line"] * line, *["excitation"] * excitation]
    chosen += [*["square-wave"] * square_wave, *["harmonics"] * harmonics]
    if len(chosen) > 1:
        raise ValueError(
            f"{' and '.join(chosen)}: choose one of --trajectory, --line, --excitation, --square-wave, --harmonics"
        )
    check_folder(out, RUN, overwrite)
    check_robot(robot)
    if trajectory is not None and not trajectory.is_file():
        raise ValueError(f"{trajectory}: no such trajectory file")
    from rx90b_flex.simulate.closed_loop import Noise
    from rx90b_flex.simulate.command import RunRequest, simulate_into, summary

    noise = Noise(torque_noise, position_noise, velocity_noise)
    request = RunRequest(robot, chosen[0] if chosen else "line", controller, periods, seed, noise, perturbation)
    with progress() as tell:
        result = simulate_into(request, out, tell, overwrite)
    for text in summary(result):
        say(text)
    say(f"Recording, tip.csv and figure: {out}")


@app.command("import")
def import_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Logs: CSV, Parquet, MATLAB, MCAP, ROS 2 bags, or any with a reader; the last one validates."
        ),
    ],
    robot: Annotated[str, typer.Option(help="Robot name, robot file, URDF, or example-robot-data:NAME.")],
    out: Out,
    columns: Annotated[
        list[str] | None, typer.Option(help="What a signal's columns are: torque=NAME,NAME; repeat for more signals.")
    ] = None,
    joints: Annotated[str | None, typer.Option(help="Joints that the columns belong to, in order: NAME,NAME")] = None,
    rate: Annotated[float | None, typer.Option(help="Sample rate, Hz; resamples where the file has another.")] = None,
    degrees: Annotated[bool | None, typer.Option("--degrees/--radians", help="Unit of all angles.")] = None,
    gear: Annotated[
        str | None, typer.Option(help="Motor turns a joint turn where columns are motor side: 32,45 or 32,0;0,45")
    ] = None,
    offset: Annotated[str | None, typer.Option(help="Joint angles where the motor angles are zero, rad.")] = None,
    topic: Annotated[str | None, typer.Option(help="JointState topic of a bag.")] = None,
    file_format: Annotated[str, typer.Option("--format", help="parquet, csv or csv.gz.")] = "parquet",
    basics: Basics = False,
    overwrite: Overwrite = False,
) -> None:
    """Make a campaign of logs: CSV, Parquet, MATLAB, ROS 2, MCAP.

    Finds out columns, units and rate, and says how sure it is of each.
    """
    from rx90b_flex.importing import ImportRequest, import_into, options_of

    request = ImportRequest(
        tuple(files),
        robot,
        options_of(columns or [], joints, rate, degrees, gear, offset, topic),
        file_format,
        basics,
    )
    with progress() as tell:
        tell("reading", 0.1)
        imported = import_into(request, out, overwrite)
    files_of: dict[str, list[str]] = {}
    for where, finding in imported.findings:
        files_of.setdefault(str(finding), []).append(where)
    for said, where_all in files_of.items():
        say(f"{', '.join(where_all)}: {said}")
    say(f"Campaign: {out / 'campaign.toml'}")


@app.command("identify")
def identify_command(
    campaign: Annotated[Path, typer.Argument(help="Campaign file (TOML).")],
    out: Out,
    basics: Basics = False,
    estimator: Annotated[
        str, typer.Option(help="least_squares; huber, which bumps hardly move; or one of another package.")
    ] = "least_squares",
    despite_faults: Despite = False,
    overwrite: Overwrite = False,
) -> None:
    """Fit the declared robot's parameters to a campaign.

    Parameters with standard deviations, robot file and URDF, predictions, report.
    """
    from rx90b_flex.early import read_campaign
    from rx90b_flex.signals.folders import CHECKED, IDENTIFIED, check_folder, fill_folder

    check_folder(out, IDENTIFIED, overwrite, [campaign])
    if estimator != "least_squares":  # the usual one is there, and its libraries take a while
        from rx90b_flex.identify.estimators.estimator import estimator_named

        estimator_named(estimator)
    with progress() as tell:
        tell("reading", 0.0)
        read = read_campaign(campaign)
        from rx90b_flex.diagnose.check import check
        from rx90b_flex.identify.command import identify_campaign, write_identified
        from rx90b_flex.view.check_report import basics_words, write_check_report
        from rx90b_flex.view.identify_report import headline, write_identify_report

        declared = _with_basics(read) if basics else None
        checked = check(read, robot=declared)
        if not (checked.usable or despite_faults):
            fill_folder(out, lambda folder: write_check_report(checked, folder), CHECKED, overwrite)
            _end_refused(checked, out)
        result = identify_campaign(read, robot=declared, estimator=estimator, progress=tell)
        tell("writing the report", 0.95)

        def fill(folder: Path) -> None:
            write_identified(result, folder)
            write_identify_report(result, folder / "report.html")

        fill_folder(out, fill, IDENTIFIED, overwrite)
    rows = [(e.name, _value("", e.value, e.std, e.unit).strip()) for e in result.parameters if e.value is not None]
    show_table(result.source.name, rows, ("parameter", "value"))
    if checked.never_move:
        say(f"Not told, for they never move: the parameters of {', '.join(checked.never_move)}.")
    for text in dict.fromkeys((*headline(result), *(f.message for f in checked.data_faults), *basics_words(checked))):
        say(text)
    say(f"Report: {out / 'report.html'}")


def _print_result(result: Any) -> None:
    from rx90b_flex.view.check_report import basics_offer

    rows = []
    for e in result.effects:
        values = ", ".join(_values(e.parameters))
        where = " + ".join(e.effect.joints) or "robot"
        before, after = (f"{x.relative_error:.4f}" for x in (e.before, e.after))
        rows.append((e.effect.type_name(), where, values, before, after))
    head = ("found", "where", "values", "error before", "after")
    show_table(
        f"{result.robot}: {result.verdict.replace('_', ' ')}", rows or [("nothing", "", "", "", "")], head, head[3:]
    )
    for role in ("validation", "identification"):
        first, last = getattr(result.before, role), getattr(result.after, role)
        held = " (held out)" if role == "validation" else ""
        say(f"Relative torque error, {role}{held}: {first.relative_error:.4f} -> {last.relative_error:.4f}")
    if result.noise_floor is not None:
        rms = ", ".join(f"{x:.3g}" for x in result.noise_floor)
        say(f"Noise floor: {rms} N m a joint")
    for gone in result.last_round.taken_out:
        say(f"Taken out again: {gone.label}, for {gone.refusal}")
    for d in result.unexplained.where[:3]:
        say(f"Left: the residual of {d.joint} depends on {d.signal} ({100 * d.score:.0f} % of its power)")
    for caution in result.cautions:
        say(f"Beware: {caution}")
    for text in (*(f.message for f in result.data_faults), *basics_offer(result.undeclared_basics)):
        say(text)


def _values(parameters: Sequence[Any]) -> Iterator[str]:
    """Of an effect; what of it is not determined is said once."""
    yield from (_value(p.name, p.value, p.std, p.unit) for p in parameters if p.value is not None)
    missing = [p.name for p in parameters if p.value is None]
    if missing:
        from rx90b_flex.view.report import untold_names

        yield f"{untold_names(missing)} not determined"


def _value(name: str, value: float, std: float | None, unit: str) -> str:
    return f"{name} {value:.4g} ± {std:.2g} {unit}" if unit != "-" else f"{name} {value:.4g} ± {std:.2g}"


def _describe(effect: object) -> str:
    from rx90b_flex.effects import Effect

    assert isinstance(effect, Effect)
    values = ", ".join(f"{name} {value:.4g} {unit}".removesuffix(" -") for name, unit, value in effect.public_values())
    return f"{effect.type_name()} on {' + '.join(effect.joints) or 'the robot'}: {values}"


_FILE_NAME = re.compile(r"\.(toml|urdf|csv|gz|txt|tsv|parquet|mat|mcap|db3|json|xml|sdf)\b")


class _Command(typer.core.TyperCommand):
    """A command whose numbers are finite, and whose seeds a generator takes."""

    def get_params(self, ctx: Any) -> list[Any]:
        return without_types_of_flags(super().get_params(ctx))

    def invoke(self, ctx: Any) -> Any:
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            if isinstance(value, float) and not abs(value) < 1e300:
                raise ValueError(f"{parameter.opts[0]} is {value}; expected a finite number")
            if isinstance(value, int) and not isinstance(value, bool) and not -(2**63) <= value < 2**63:
                raise ValueError(f"{parameter.opts[0]} is a number of {len(str(value))} digits; expected a smaller one")
            if parameter.name == "seed" and isinstance(value, int) and value < 0:
                raise ValueError(f"{parameter.opts[0]} is {value}; expected 0 or more")
        try:
            return super().invoke(ctx)
        except ValueError as error:
            raise ValueError(_with_its_place(str(error), ctx)) from error


def _with_its_place(message: str, ctx: Any) -> str:
    """A message that names an option (what the package calls ``count`` is ``--count`` here) or a file.

    Where it does neither, what the command works on stands before it.
    """
    for option in (parameter.opts[0] for parameter in ctx.command.params):
        word = option.removeprefix("--").replace("-", "_")
        if option.startswith("--") and re.match(rf"{word}( is |: )", message):
            return option + message.removeprefix(word)
    values = [ctx.params.get(parameter.name) for parameter in ctx.command.params]
    given = [x for v in values for x in (v if isinstance(v, list | tuple) else [v]) if isinstance(x, str | Path)]
    if not given or "--" in message or _FILE_NAME.search(message) or any(str(x) in message for x in given):
        return message
    return f"{given[0]}: {message}"


for _module in (camera, check_path, export, static, view):
    _module.add(app)

for _info in app.registered_commands:
    _info.cls = _Command

# in the order in which a user meets them
_ORDER = (
    "demo", "import", "check", "identify", "close-loop", "simulate", "view", "check-path", "excite", "frf", "static", "camera",
    "flexify", "export",
)  # fmt: skip
app.registered_commands.sort(key=lambda c: _ORDER.index(c.name or getattr(c.callback, "__name__", "")))


def main() -> None:
    """The command line; see `rx90b_flex.endings.run` for how it ends."""
    from rx90b_flex.endings import run

    usage_error: type[Exception] = typer.BadParameter.__bases__[0]  # the library has it under a name of its own
    sys.exit(run(app, usage_error, "rx90b-flex"))
