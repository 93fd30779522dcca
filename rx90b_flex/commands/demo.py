"""``rx90b-flex demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from rx90b_flex.commands.close_loop import print_result
from rx90b_flex.commands.shared import Out, Overwrite, progress, say

if TYPE_CHECKING:
    from rx90b_flex.effects import Effect


def demo_command(
    out: Out = Path("rx90b-flex-demo"),
    seed: Annotated[int, Option(help="Seed of what is hidden, of the motion and of the noise.")] = 0,
    hidden: Annotated[
        str | None, Option(help="Effect type to hide, or 'none'; drawn from the seed where not given.")
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
    print_result(loops[0].result)
    what = "nothing" if demonstration.hidden is None else _describe(demonstration.hidden)
    say(f"What had been hidden: {what}")
    say(f"Recordings, model and report: {out}")


def _describe(effect: Effect) -> str:
    values = ", ".join(f"{name} {value:.4g} {unit}".removesuffix(" -") for name, unit, value in effect.public_values())
    return f"{effect.type_name()} on {' + '.join(effect.joints) or 'the robot'}: {values}"
