"""Table 6.4: the modes of the model against those of the real RX90B, before and after what the data support; and how sure that is.

    python benchmarks/modes_table_6_4.py [--figure modes.png] [--quick]

Prints the search with everything allowed, mode by mode; the same with new hinges about as stiff as the declared ones; with the
changes that come to mind alone (drives 5 and 6, floor, softer joints); with a wrist three times as heavy; and, for each list in turn,
what a search without it finds and how well that predicts it. Two minutes on one core; --quick leaves out all but the first.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

from rx90b_flex.diagnose.modal import (
    ModalLoop,
    ModalTable,
    alone,
    close_modal,
    error_rms,
    in_order_rms,
    load_modal_table,
)
from rx90b_flex.export import with_link_parameters
from rx90b_flex.robot import Robot, load_robot, robots_folder
from rx90b_flex.view.modal_plots import ladder

OBVIOUS = (
    "joint_5.drive_flexibility", "joint_6.drive_flexibility", "base.base_flexibility", "all.drive_stiffness", "all.joint_stiffness",
    *(f"joint_{j}.{kind}_stiffness" for j in (1, 2, 3, 4) for kind in ("drive", "joint")),
)  # fmt: skip


def show(title: str, loop: ModalLoop, seconds: float) -> None:
    """What was found, and the errors before and after."""
    print(f"\n{title} ({seconds:.0f} s): {loop.verdict}")
    for found in loop.found:
        others = ", ".join(t.change.label for t in found.alternatives)
        print(f"  {found.words}; p {found.p_value:.1g}" + (f"; or {others}" if others else ""))
    for name, compared, left in (
        ("before", loop.before, loop.left_out_before),
        ("after", loop.after, loop.left_out_after),
    ):
        print(
            f"  {name:<7} RMS of log frequency: paired {100 * error_rms(compared):.1f} %, n-th with n-th "
            f"{100 * in_order_rms(compared):.1f} %, each from the others {100 * left:.1f} %; without a partner {alone(compared)}"
        )


def table(loop: ModalLoop) -> None:
    """Mode by mode."""
    for b, a in zip(loop.before, loop.after, strict=True):
        print(f"  {b.measured.name}\n    measured " + " ".join(f"{f:6.1f}" for f in b.measured.hz))
        for name, c in (("declared", b), ("found", a)):
            partner = dict(zip(c.pairing.measured.tolist(), c.model_hz[c.pairing.model], strict=True))
            print(
                f"    {name:<8} "
                + " ".join(f"{partner[i]:6.1f}" if i in partner else "     –" for i in range(len(c.measured.hz)))
            )


def timed(measured: ModalTable, robot: Robot, **options: object) -> tuple[ModalLoop, float]:
    """A closed loop and its seconds."""
    began = time.perf_counter()
    loop = close_modal(measured, robot, **options)  # type: ignore[arg-type]
    return loop, time.perf_counter() - began


def heavier_wrist(robot: Robot, factor: float) -> Robot:
    """All inertial parameters of the wrist's links (joints 5 and 6) multiplied."""
    links = robot.link_parameters.reshape(-1, 10).copy()
    links[-2:] *= factor
    return with_link_parameters(robot, links.ravel(), allow_inconsistent=True)


def without(measured: ModalTable, left_out: int) -> tuple[ModalTable, ModalTable]:
    """The table without one of its lists, and with that list as validation beside it."""
    (pose,) = measured.poses
    rest = tuple(m for i, m in enumerate(pose.lists) if i != left_out)
    fitted = dataclasses.replace(pose, lists=rest)
    held = dataclasses.replace(pose, lists=(pose.lists[left_out],), role="validation")
    return dataclasses.replace(measured, poses=(fitted,)), dataclasses.replace(measured, poses=(fitted, held))


def main() -> None:
    """Run all searches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    measured, robot = load_modal_table(robots_folder() / "rx90b_table_6_4.toml"), load_robot("rx90b")
    loop, seconds = timed(measured, robot)
    show("everything allowed", loop, seconds)
    table(loop)
    for doubt in loop.doubts():
        print(f"  {doubt}")
    for (found, other), separation in loop.separations.items():
        print(f"  to tell {found} from {other}: {separation.words}")
    if arguments.figure:
        ladder(loop.before, loop.after).savefig(arguments.figure, dpi=120)
    if arguments.quick:
        return
    show("new hinges within a factor of 3 of the declared ones", *timed(measured, robot, new_std=0.5))
    show("drives 5 and 6, floor and softer joints alone", *timed(measured, robot, only=OBVIOUS))
    heavy, seconds = timed(measured, heavier_wrist(robot, 3.0))
    show("a wrist three times as heavy", heavy, seconds)
    print("\neach list left out of the search, then predicted: RMS of log frequency")
    for i, name in enumerate(m.name for m in measured.poses[0].lists):
        _, split = without(measured, i)
        left, seconds = timed(split, robot)
        labels = ", ".join(f.change.label for f in left.found)
        before, after = (100 * error_rms(c) for c in (left.validation_before, left.validation_after))
        unpaired = alone(left.validation_before), alone(left.validation_after)
        print(
            f"  {name}: {before:.1f} % before, {after:.1f} % after, without a partner {unpaired[0]} and {unpaired[1]}"
        )
        print(f"    found: {labels} ({seconds:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
