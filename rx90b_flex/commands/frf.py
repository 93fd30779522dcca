"""``rx90b-flex frf``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from rx90b_flex.commands.shared import HighHz, LowHz, Out, Overwrite, numbers, progress, say, show_table

if TYPE_CHECKING:
    from rx90b_flex.identify.frf_command import MotorIdentification

MOST_MODES = 30  # of transfer functions: more are no modes of a robot in any band

# options that take several lines
PeriodicCampaign = Annotated[Path, Argument(help="Campaign file (TOML): periodic excitation with feed-forward torque.")]
ControllerFile = Annotated[Path | None, Option(help="Controller file; controller.toml beside CAMPAIGN otherwise.")]
BendingAlikeStd = Annotated[
    float, Option(help="To which a joint is equally stiff about both bending axes; 0: not assumed.")
]
HingeStd = Annotated[float, Option(help="To which it is known where hinges that bend lie on their links, m; 0: known.")]
References = Annotated[
    Path | None, Option(help="Folder references/ of `rx90b-flex excite`, where it is not beside the campaign.")
]
Modes = Annotated[str, Option(help="Numbers of modes that transfer functions try: LOWEST,HIGHEST, or one number.")]
StartHz = Annotated[
    str | None,
    Option(
        help="Resonances that transfer functions of as many modes start from as well: F1,F2,...", show_default=False
    ),
]
Delays = Annotated[str, Option(help="Of torques in transfer functions: none, common (one for all) or each.")]
MainsHz = Annotated[
    float | None,
    Option(
        help="Take mains out of the recordings: about 50 or 60, or any other frequency of at least 0.2, found within 0.2."
    ),
]
NoReplay = Annotated[
    bool, Option("--no-replay", help="Leave friction's distortion in: do not simulate the experiments.")
]


def frf_command(
    campaign: PeriodicCampaign,
    out: Out,
    low_hz: LowHz = 8.0,
    high_hz: HighHz = 80.0,
    controller: ControllerFile = None,
    link_mass_std: Annotated[float, Option(help="Relative uncertainty of the links' masses; 0: known.")] = 0.0,
    bending_alike_std: BendingAlikeStd = 0.1,
    hinge_std: HingeStd = 0.0,
    references: References = None,
    modes: Modes = "2,8",
    start_hz: StartHz = None,
    delays: Delays = "none",
    seed: Annotated[int, Option(help="Seed of the grey box's starts.")] = 0,
    mains_hz: MainsHz = None,
    no_replay: NoReplay = False,
    jobs: Annotated[int, Option(help="Processes for the replay's simulations and the figures.")] = 2,
    overwrite: Overwrite = False,
) -> None:
    """Identify stiffness, damping and inertia from motor signals.

    CAMPAIGN is what `rx90b-flex excite` writes, with the logs of its motions.
    """
    from rx90b_flex.early import check_jobs, read_campaign
    from rx90b_flex.signals.folders import MOTOR_SIGNALS, check_folder, files_read

    check_folder(out, MOTOR_SIGNALS, overwrite, files_read(campaign))
    if not 0.0 < low_hz < high_hz:
        raise ValueError(
            f"--low-hz and --high-hz are {low_hz:g} and {high_hz:g}; expected a low and a higher frequency above 0"
        )
    for name, std in (("link-mass", link_mass_std), ("bending-alike", bending_alike_std), ("hinge", hinge_std)):
        if not 0.0 <= std < float("inf"):
            raise ValueError(f"--{name}-std is {std:g}; expected 0 or more")
    check_jobs(jobs)
    tried, starts = _modes(modes, start_hz, (low_hz, 2 * high_hz))
    if delays not in ("none", "common", "each"):
        raise ValueError(f"--delays is {delays!r}; expected none, common or each")
    read = read_campaign(campaign)
    from rx90b_flex.identify.frf_command import FrfOptions, identify_from_motors, write_motor_identification
    from rx90b_flex.view.frf_report import write_frf_report

    options = FrfOptions(
        (low_hz, high_hz), controller=controller, link_mass_std=link_mass_std, bending_alike_std=bending_alike_std,
        hinge_std=hinge_std, seed=seed, references=references, modes=tried, start_hz=starts, delays=delays, mains_hz=mains_hz,
        replay=not no_replay, jobs=jobs,
    )  # fmt: skip
    with progress() as tell:
        result = identify_from_motors(read, options, tell)
        tell("writing the report", 0.97)
        write_motor_identification(result, out, [lambda r, at: write_frf_report(r, at / "report.html")], overwrite)
    _say(result)
    say(f"Report: {out / 'report.html'}")


def _modes(
    modes: str, start_hz: str | None, between_hz: tuple[float, float]
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Numbers of modes to try, and resonances to start from."""
    ends = numbers("modes", modes)
    if len(ends) > 2 or any(x != round(x) or not 1 <= x <= MOST_MODES for x in ends) or ends[0] > ends[-1]:
        raise ValueError(f"--modes is {modes!r}; expected one or two ascending whole numbers from 1 to {MOST_MODES}")
    starts = numbers("start-hz", start_hz) if start_hz else ()
    low, high = between_hz
    if starts and (not ends[0] <= len(starts) <= ends[-1] or not all(low <= f <= high for f in starts)):
        raise ValueError(
            f"--start-hz is {start_hz!r}; expected {modes.replace(',', ' to ')} resonances (--modes) "
            f"between {low:g} and {high:g} Hz"
        )
    return tuple(range(int(ends[0]), int(ends[-1]) + 1)), starts


def _say(result: MotorIdentification) -> None:
    """Values with their intervals, by replay where that was done, and what qualifies them."""
    from rx90b_flex.view.frf_report import amounts, bias_words, delay_words, hinge_words

    best = result.grey if result.replayed is None else result.replayed.grey
    if best is not None:
        how = "as measured" if result.replayed is None else "less the distortion that a replay explains"
        rows = []
        for e in best.estimates:
            # without the page's thin spaces, for whoever copies a number
            value, low, high = (x.replace("\u2009", "") for x in amounts(e.std, e.value, e.low, e.high)[1:])
            told = (value, f"{low} to {high}") if e.determined else ("not determined", "")
            rows.append((e.name, *told, e.unit))
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
