"""``rx90b-flex close-loop``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from rx90b_flex.commands import fleet
from rx90b_flex.commands.check import end_refused
from rx90b_flex.commands.shared import Basics, Despite, Out, Overwrite, progress, say, show_table, value_words

# options that take several lines
Sources = Annotated[
    list[Path],
    Argument(
        help="Campaign file or modal table (TOML), or folder of `rx90b-flex frf`; several campaigns are a fleet, one a robot.",
        metavar="CAMPAIGN...",
    ),
]
ModelError = Annotated[float | None, Option(help="Relative error of the model to allow for; for the same two.")]
DaskScheduler = Annotated[str | None, Option(help="Address of a Dask scheduler for a fleet, such as tcp://host:8786.")]


def close_loop_command(
    campaigns: Sources,
    out: Out,
    seed: Annotated[int, Option(help="Seed of the permutation test for what remains.")] = 0,
    robot: Annotated[str | None, Option(help="Another robot; for modal tables and frequency responses.")] = None,
    model_error: ModelError = None,
    jobs: Annotated[
        int | None, Option(help="Processes; not given: 1, or for one long log and 4 cores or more one a core.")
    ] = None,
    dask: DaskScheduler = None,
    basics: Basics = False,
    despite_faults: Despite = False,
    overwrite: Overwrite = False,
) -> None:
    """Find what the data hold and the model lacks; add it.

    Tries every effect of the catalogue on every joint of CAMPAIGN's robot, and keeps those that predict data they were not fitted to.
    With several campaigns, one a robot of one make: a folder a robot; fleet.html, fleet.csv, fleet.json say what they have in common
    and which robot stands out. The same command again goes on where it was stopped.

    Exit status: 0 done, 1 the data cannot be used (of several campaigns: one was left out), 2 bad input, with nothing written.
    """
    if model_error is not None and not model_error > 0.0:
        raise ValueError(f"model_error is {model_error:g}; expected more than 0")
    of_frequency = [name for name, given in (("--robot", robot), ("--model-error", model_error)) if given is not None]
    goes = f"{of_frequency[0]} goes with a modal table or a folder of `rx90b-flex frf`" if of_frequency else ""
    if len(campaigns) > 1:
        if goes:
            raise ValueError(f"{goes}, not with several campaigns")
        options = {"seed": seed, "basics": basics, "despite_faults": despite_faults, "overwrite": overwrite}
        fleet.close_fleet(campaigns, out, jobs, dask, options)
        return
    if dask is not None:
        raise ValueError(f"--dask goes with several campaigns, one a robot; only {campaigns[0]} is given")
    campaign = campaigns[0]
    from rx90b_flex.diagnose.modal_files import speaks_of_frequency
    from rx90b_flex.early import check_jobs

    if jobs is not None:
        check_jobs(jobs)
    if speaks_of_frequency(campaign):
        if jobs is not None:
            raise ValueError(f"--jobs goes with recordings; {campaign} is a modal table or frequency responses")
        _close_over_frequency(campaign, out, robot, model_error, overwrite)
        return
    if goes and campaign.exists():  # what is not there is said to be missing, further on
        raise ValueError(f"{goes}; {campaign} is neither")
    from rx90b_flex.closing import LoopOptions, close_campaign
    from rx90b_flex.signals.folders import CLOSED_LOOP, check_folder, files_read

    check_folder(out, CLOSED_LOOP, overwrite, files_read(campaign))
    with progress() as tell:
        tell("reading", 0.0)
        closed = close_campaign(campaign, LoopOptions(seed, basics, despite_faults, jobs), tell)
        closed.write(out, overwrite)
    from rx90b_flex.diagnose.refused import RefusedLoop

    if isinstance(closed.result, RefusedLoop):
        end_refused(closed.result.checked, out)
    print_result(closed.result)
    say(f"Report: {out / 'report.html'}")


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


def print_result(result: Any) -> None:
    """What was found, the errors before and after, what is left, and what to beware of."""
    from rx90b_flex.view.check_report import basics_words

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
        since = ""
        if first.since_moved and last.since_moved:
            since = f" (since joints first move {first.told.relative_error:.4f} -> {last.told.relative_error:.4f})"
        say(f"Relative torque error, {role}{held}: {first.relative_error:.4f} -> {last.relative_error:.4f}{since}")
    for text in result.motor_turns:
        say(text)
    if result.noise_floor is not None:
        rms = ", ".join(f"{x:.3g}" for x in result.noise_floor)
        say(f"Noise floor: {rms} {result.source.force_unit(result.joints)} a joint")
    for gone in result.last_round.taken_out:
        say(f"Taken out again: {gone.label}, for {gone.refusal}")
    for d in result.unexplained.where[:3]:
        say(f"Left: the residual of {d.joint} depends on {d.signal} ({100 * d.score:.0f} % of its power)")
    if text := _more_to_explain(result):
        say(text)
    for gear in result.deflection:
        say(gear.message)
    for caution in result.cautions:
        say(f"Beware: {caution}")
    for text in (*(f.message for f in result.data_faults), *basics_words(result)):
        say(text)


def _more_to_explain(result: Any) -> str:
    """Of which joints a free form leaves less; empty where all is explained, or a free form leaves as much."""
    from rx90b_flex.diagnose.verdict import NEAR_FREE

    known = result.explainable
    if known is None or result.verdict in ("explained", "nothing_missing"):
        return ""
    joints = known.less_of(result.joints, result.after.validation, 1.0 / NEAR_FREE)
    if not joints:
        return ""
    in_all = f"{known.validation.told.relative_error:.4f} in all"
    return f"Left: a free form of the motion, which names nothing, leaves less of {', '.join(joints)} ({in_all})"


def _values(parameters: Sequence[Any]) -> Iterator[str]:
    """Of an effect, a curve's together; what of it is not determined is said once."""
    from rx90b_flex.view.estimates import counted, measured_all, name_of, untold_names

    for some in counted([p for p in parameters if p.value is not None]):
        first = some[0]
        if len(some) > 1 or first.value is None:
            yield f"{name_of(some)} {measured_all(some, first.unit)}"
        else:
            yield value_words(first.name, first.value, first.std, first.unit)
    missing = [p.name for p in parameters if p.value is None]
    if missing:
        yield f"{untold_names(missing)} not determined"
