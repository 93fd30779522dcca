"""What ``rx90b-flex view`` does: find what a name means, make the view, write or serve it."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from rx90b_flex.default_flexibility import default_words, with_default_flexibility, without_written_hinges
from rx90b_flex.early import campaign_path
from rx90b_flex.interrupts import calm
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals.recording import Campaign, Recording, load_campaign
from rx90b_flex.signals.tables import read_table
from rx90b_flex.simulate.closed_loop import Simulation
from rx90b_flex.simulate.command import STATE_FILE
from rx90b_flex.tip import tip_words, with_tip
from rx90b_flex.view.meshcat import MAGNIFY, Run, View, compare, show, show_modes


def view_of(
    source: str,
    beside: str | None = None,
    *,
    recording: str | None = None,
    magnify: float = MAGNIFY,
    modes: bool = False,
    pose: Sequence[float] | None = None,
    count: int = 6,
    flexible: bool = False,
    tip: str | None = None,
) -> View:
    """The view that is asked for.

    Parameters
    ----------
    source, beside, recording, magnify, count, flexible, tip
        As of `rx90b_flex.view`.
    modes : bool
        Whether mode shapes of a run's robot are wanted and not its motion.
    pose : sequence of float, optional
        Drive positions of the mode shapes, degrees (m where a joint slides).

    Raises
    ------
    ValueError
        One line that names the file, robot or option.
    """
    if not (np.isfinite(magnify) and magnify >= 0.0):
        raise ValueError(f"magnify is {magnify}; expected 0 or more")
    campaign = campaign_path(source)
    if modes or (campaign is None and beside is None and recording is None):
        if beside is not None:
            raise ValueError("--beside and --modes: choose one")
        robot = load_robot(source if campaign is None else load_campaign(campaign).robot_source)
        return modes_of(robot, pose, count, flexible, tip)
    if flexible:
        raise ValueError("flexible is of a robot's mode shapes; recordings have their own robot")
    if pose is not None:
        raise ValueError("--pose is of mode shapes; add --modes, or leave it out")
    run = read_run(source, recording, tip)
    if beside is not None:
        return compare(run, read_run(beside, recording, tip), magnify=magnify)
    view = show(run, magnify=magnify)
    return dataclasses.replace(view, notes=(tip_words(run.robot), *view.notes))


def modes_of(
    loaded: Robot, pose: Sequence[float] | None, count: int, flexible: bool = False, tip: str | None = None
) -> View:
    """Mode shapes of a robot, with what was taken for it in the notes.

    Parameters
    ----------
    loaded : Robot
    pose : sequence of float, degrees (m where a joint slides), or None
    count, flexible, tip
        As of `rx90b_flex.view`.

    Raises
    ------
    ValueError
        A robot in which nothing bends; no such frame; a pose of the wrong size.
    """
    loaded = loaded if tip is None else with_tip(loaded, tip)
    robot, torsion, bending, base = without_written_hinges(loaded)
    if torsion or bending or base:  # a URDF of flexify has hinges and no springs
        bends = with_default_flexibility(robot, torsion, bending, base)
    elif flexible:
        bends = with_default_flexibility(robot)
    elif not any(e.traits.virtual for e in robot.effects):
        raise ValueError(
            f"{robot.name}: nothing in it bends; --flexible gives it stated stiffnesses, a robot file its own"
        )
    else:
        bends = robot
    view = show_modes(bends, None if pose is None else bends.pose_of(pose), count=count)
    return dataclasses.replace(view, notes=(tip_words(bends), *default_words(bends, robot), *view.notes))


def read_run(source: str, recording: str | None = None, tip: str | None = None) -> Run:
    """The motion in a folder of `rx90b-flex simulate`, with all its coordinates, or of a campaign's recording.

    `tip` names the frame whose path is shown, where it is not the robot's own tip frame.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong.
    """
    path = campaign_path(source)
    if path is None:
        raise ValueError(
            f"{source}: no run and no campaign; expected a folder of `rx90b-flex simulate` or a campaign file"
        )
    campaign = load_campaign(path)
    chosen = campaign.recordings[0] if recording is None else _named(campaign, recording)
    robot = load_robot(campaign.robot_source)
    robot = robot if tip is None else with_tip(robot, tip)
    try:
        run = Run.of_recording(chosen, robot.restricted(chosen.joints))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    state = path.parent / STATE_FILE
    if not state.is_file():
        return run
    table = read_table(state, ["time", *robot.coordinates])
    q = table.finite(robot.coordinates)
    if len(q) != len(run.q):
        raise ValueError(f"{state}: {len(q)} rows; expected {len(run.q)}, as in recording {chosen.name!r}")
    return Run(run.name, robot, run.time, q, run.reference)


def check_options(source: Any, beside: Any, **options: Any) -> None:
    """Refuse what `rx90b_flex.view` cannot show, and options of something else than it is to show.

    Raises
    ------
    TypeError, ValueError
        One line that names the argument.
    """
    paths = [isinstance(x, str | os.PathLike) for x in (source, beside)]
    for name, x, kinds in (("source", source, "a robot, a run"), ("beside", beside, "a run")):
        known = isinstance(x, Run | Simulation | str | os.PathLike) or (name == "source" and isinstance(x, Robot))
        if not known and (name == "source" or x is not None):
            raise TypeError(f"{name} is {x!r}; expected {kinds} or the path of one")
    if isinstance(source, Robot):
        unused, why = {"beside": beside, "recording": options["recording"]}, "a robot's mode shapes are no run"
    elif paths[0] and (beside is None or paths[1]):
        return  # what a path names is known when it is read
    else:
        unused, why = dict(options), "a run is one motion, of its own robot"
        if any(paths):
            del unused["recording"]
    for name, value in unused.items():
        if value is not None and value is not False:
            raise ValueError(f"{name} is {value!r}; {why}: expected none")


def run_of(source: Simulation | Run | str | os.PathLike[str], recording: str | None, tip: str | None) -> Run:
    """The motion of a run, or of a path as `read_run` takes it; `tip` as there."""
    if isinstance(source, str | os.PathLike):
        return read_run(str(source), recording, tip)
    run = Run.of(source)
    return run if tip is None else dataclasses.replace(run, robot=with_tip(run.robot, tip))


def serve_until_interrupted(view: View, tell: Callable[[str], None], wait: Callable[[], object] | None = None) -> None:
    """Open the view in the browser and keep serving it until Ctrl-C (or until `wait` returns)."""
    visualizer = view.open()
    try:
        tell(visualizer.url())
        (wait or threading.Event().wait)()
    except KeyboardInterrupt:
        calm()
    finally:
        visualizer.window.server_proc.terminate()


def _named(campaign: Campaign, name: str) -> Recording:
    found = {recording.name: recording for recording in reversed(campaign.recordings)}
    if name not in found:
        raise ValueError(f"{campaign.path}: no recording {name!r}; it has {', '.join(reversed(found))}")
    return found[name]
