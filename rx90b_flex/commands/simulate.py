"""``rx90b-flex simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from rx90b_flex.commands.shared import Out, Overwrite, RobotSource, progress, say


def simulate_command(
    robot: RobotSource,
    out: Out,
    trajectory: Annotated[
        Path | None,
        Option(
            help="Trajectory (CSV): time, one column a joint (rad; m if it slides), ff_<joint> (N m) if fed forward."
        ),
    ] = None,
    line: Annotated[bool, Option("--line", help="The 1.7 m horizontal line of section 4.2.2.")] = False,
    excitation: Annotated[bool, Option("--excitation", help="The excitation of section 4.2.2.")] = False,
    square_wave: Annotated[bool, Option("--square-wave", help="The square wave of section 6.6.2.")] = False,
    harmonics: Annotated[
        bool, Option("--harmonics", help="Random harmonics of every joint, within its range and speed.")
    ] = False,
    controller: Annotated[
        Path | None, Option(help="Controller file (TOML); else the one that the robot's file states.")
    ] = None,
    periods: Annotated[int, Option(help="Periods of an excitation that repeats.")] = 1,
    perturbation: Annotated[bool, Option("--perturbation", help="Use the perturbation method.")] = False,
    seed: Annotated[int, Option(help="Seed of excitation and noise.")] = 0,
    torque_noise: Annotated[float, Option(help="Standard deviation at the controller's rate, N m.")] = 0.0,
    position_noise: Annotated[float, Option(help="The same of position, rad.")] = 0.0,
    velocity_noise: Annotated[float, Option(help="The same of velocity, rad/s.")] = 0.0,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a flexible robot under its controller.

    Along a trajectory, the RX90B's line where none is given: recording, every coordinate, tip deviation, figure.

    The first simulation of a user compiles for a quarter of a minute; later ones do not.

    Exit status: 0 the run is written, also one that ended early, which is said; 2 bad input, or a run that ended at once, with
    nothing written.
    """
    from rx90b_flex.robot import load_robot
    from rx90b_flex.signals.folders import RUN, check_folder

    chosen = [*([str(trajectory)] if trajectory else []), *["line"] * line, *["excitation"] * excitation]
    chosen += [*["square-wave"] * square_wave, *["harmonics"] * harmonics]
    if len(chosen) > 1:
        raise ValueError(
            f"{' and '.join(chosen)}: choose one of --trajectory, --line, --excitation, --square-wave, --harmonics"
        )
    check_folder(out, RUN, overwrite)
    load_robot(robot)  # what is wrong in it is said before the libraries of the work are loaded
    if trajectory is not None and not trajectory.is_file():
        raise ValueError(f"{trajectory}: no such trajectory file")
    from rx90b_flex.simulate.closed_loop import Noise
    from rx90b_flex.simulate.command import RunRequest, simulate_into, summary

    noise = Noise(torque_noise, position_noise, velocity_noise)
    request = RunRequest(robot, chosen[0] if chosen else "line", controller, periods, seed, noise, perturbation)
    with progress() as tell:
        result = simulate_into(request, out, tell, overwrite)
    if not chosen:
        say("No motion was given: the straight line of the RX90B (--line). --harmonics suits any robot.")
    for text in summary(result, from_file=trajectory is not None):
        say(text)
    say(f"Recording, tip.csv and figure: {out}")
