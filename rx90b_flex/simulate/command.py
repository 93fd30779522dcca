"""What ``rx90b-flex simulate`` does: a trajectory from a file or a built-in one, one run, and its files."""

from __future__ import annotations

import csv
import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rx90b_flex.compiled.compile import told_of_compiling
from rx90b_flex.early import LONGEST_S
from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation import multisine
from rx90b_flex.export import save_robot
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals.recording import write_campaign
from rx90b_flex.signals.tables import read_table, refuse_separators, write_table
from rx90b_flex.simulate.closed_loop import Noise, Progress, Simulation, simulate
from rx90b_flex.simulate.cs8 import CS8, controller_of_joints, design_cs8, load_cs8, own_controller
from rx90b_flex.simulate.perturbation import perturb_lanes
from rx90b_flex.simulate.trajectories import (
    FEEDFORWARD_LINES,
    FEEDFORWARD_PEAK,
    PERIOD_S,
    Trajectory,
    harmonics,
    horizontal,
    sine_excitation,
    square_wave,
    straight_line,
)

OF_THE_RX90B = ("line", "excitation", "square-wave")
MOTIONS = (*OF_THE_RX90B, "harmonics")
COARSE_S = 0.5  # between samples of a trajectory: no controller is as slow, but one of 1 kHz in ms is
STATE_FILE = "state.parquet"  # time and every coordinate, exact: what a view of the deformations needs


@dataclass(frozen=True)
class RunRequest:
    """What the user asks for: as of `rx90b_flex.simulate`, robot, motion and controller by their names or files."""

    robot: str
    motion: str
    controller: Path | None = None
    periods: int = 1
    seed: int = 0
    noise: Noise = field(default_factory=Noise)
    perturbation: bool = False


@dataclass(frozen=True, eq=False)
class Prepared:
    """A request that was checked: everything that a run needs."""

    request: RunRequest
    robot: Robot
    controller: CS8
    trajectory: Trajectory


def check_motion(name: str) -> None:
    """Refuse the name of a motion that there is not; whatever has an ending, or is there, is a file.

    Raises
    ------
    ValueError
        One line that names all motions.
    """
    if name not in MOTIONS and not Path(name).suffix and not os.path.exists(name):
        raise ValueError(f"motion is {name!r}; expected {', '.join(MOTIONS)} or a table of a trajectory (.csv)")


def prepare(request: RunRequest, robot: Robot | None = None, trajectory: Trajectory | None = None) -> Prepared:
    """Read and check everything that a request names; robot and trajectory only where they are not given.

    Raises
    ------
    ValueError
        One line that names file and key or column.
    """
    for name in ("torque", "position", "velocity"):
        value = getattr(request.noise, name)
        if np.min(value) < 0.0 or not np.isfinite(value).all():
            raise ValueError(f"{name} noise is {value}; expected 0 or more")
    for what, number, least in (("periods", request.periods, 1), ("seed", request.seed, 0)):
        if number < least:
            raise ValueError(f"{what} is {number}; expected {least} or more")
    if request.periods * PERIOD_S > LONGEST_S:
        raise ValueError(f"periods is {request.periods}; expected {int(LONGEST_S / PERIOD_S)} at most, a day of motion")
    robot = load_robot(request.robot) if robot is None else robot
    for effect in robot.effects:
        effect.known_coefficients()
    controller = controller_of(robot, request.controller)
    if trajectory is None:
        try:
            trajectory = _trajectory(robot, controller, request)
        except ValueError as error:
            raise ValueError(f"{error}{_whose(request)}") from None
    if request.periods > 1 and trajectory.period_s is None:
        raise ValueError(f"periods is {request.periods}, but {trajectory.name!r} does not repeat")
    return Prepared(request, robot, controller, trajectory)


def controller_of(robot: Robot, file: Path | None) -> CS8:
    """The controller of a file; where none is named, the one that the robot's file states, else gains designed for the robot."""
    if file is not None:
        return controller_of_joints(load_cs8(file), robot, str(file))
    return own_controller(robot) or design_cs8(robot)


def _whose(request: RunRequest) -> str:
    """What to add where a motion that is the RX90B's does not suit another robot."""
    if request.motion not in OF_THE_RX90B:
        return ""
    default = " (taken where no motion is chosen)" if request.motion == "line" else ""
    return f": --{request.motion}{default} is made for the RX90B; --harmonics suits any robot"


def _trajectory(robot: Robot, controller: CS8, request: RunRequest) -> Trajectory:
    rate = controller.reference_rate_hz
    rng = np.random.default_rng(np.random.SeedSequence(request.seed, spawn_key=(0,)))
    if request.motion == "line":
        return straight_line(robot, rate_hz=rate)
    if request.motion == "excitation":
        return sine_excitation(robot, rng, periods=request.periods, rate_hz=rate)
    if request.motion == "harmonics":
        return harmonics(robot, rng, periods=request.periods, rate_hz=rate)
    if request.motion == "square-wave":
        moving = robot.joints[:3]
        feedforward = np.zeros((round(PERIOD_S * rate), len(robot.joints)))
        feedforward[:, : len(moving)] = multisine(FEEDFORWARD_LINES, len(feedforward), FEEDFORWARD_PEAK, rng)
        once = square_wave(robot, horizontal(robot), moving=moving, feedforward=feedforward, rate_hz=rate)
        return once.repeated(request.periods)
    return read_trajectory(Path(request.motion), robot, rate)


def read_trajectory(path: Path, robot: Robot, rate_hz: float) -> Trajectory:
    """A trajectory from a table: `time`, one column a joint (rad) and, where there are, `v_<joint>` (rad/s) and `ff_<joint>` (N m).

    Velocities that are not given are the positions' slopes.
    Joints without a column stay at zero. Samples at another rate than the controller's references are interpolated by cubic splines.

    Raises
    ------
    ValueError
        One line that names the file and the column.
    """
    from scipy.interpolate import CubicSpline

    forward = [f"ff_{joint}" for joint in robot.joints]
    speeds = [f"v_{joint}" for joint in robot.joints]
    header = _header(path)
    refuse_separators(path, header)
    for name in header:
        if name not in ("time", *robot.joints, *speeds, *forward):
            usual = ", ".join((*robot.joints, "v_<joint>", "ff_<joint>"))
            raise ValueError(f"{path}: column {name!r} is none of time, {usual}")
    joints = [joint for joint in robot.joints if joint in header]
    if not joints:
        raise ValueError(f"{path}: no column of a joint; expected one of {', '.join(robot.joints)}")
    fed, rates = ([name for name in names if name in header] for names in (forward, speeds))
    wanted = ["time", *joints, *rates, *fed]
    table = read_table(path, wanted)
    time = table.finite(wanted)[:, 0]
    steps = np.diff(time)
    if len(time) < 10 or not (steps > 0).all() or np.ptp(steps) > 1e-3 * steps.mean():
        raise ValueError(f"{path}: column 'time': expected 10 or more samples at even, rising times")
    places = [robot.joints.index(joint) for joint in joints]
    position, velocity = np.zeros((2, len(time), len(robot.joints)))
    position[:, places] = table.columns(joints)
    clock = np.arange(len(time)) * steps.mean()
    velocity[:, places] = CubicSpline(clock, position[:, places], axis=0)(clock, 1)
    velocity[:, [speeds.index(name) for name in rates]] = table.columns(rates) if rates else 0.0
    feedforward = np.zeros_like(position) if fed else None
    if feedforward is not None:
        feedforward[:, [forward.index(name) for name in fed]] = table.columns(fed)
    read = _at_rate(path, robot, (time - time[0], position, velocity, feedforward), rate_hz)
    if steps.mean() < COARSE_S:
        return read
    note = f"{path}: samples are {steps.mean():.3g} s apart; expected seconds in column 'time', not ms"
    return dataclasses.replace(read, note=note)


def _at_rate(path: Path, robot: Robot, parts: tuple[Array, Array, Array, Array | None], rate_hz: float) -> Trajectory:
    """The table at the controller's rate."""
    from scipy.interpolate import CubicHermiteSpline

    time, position, velocity, feedforward = parts
    wanted = np.arange(int(np.floor(time[-1] * rate_hz + 1e-6)) + 1) / rate_hz
    if not (len(wanted) == len(time) and np.allclose(wanted, time, atol=1e-4 / rate_hz)):
        curve = CubicHermiteSpline(time, position, velocity, axis=0)
        clipped = np.minimum(wanted, time[-1])
        position, velocity = curve(clipped), curve(clipped, 1)
        if feedforward is not None:
            feedforward = np.stack([np.interp(clipped, time, column) for column in feedforward.T], axis=1)
    return Trajectory(path.stem, robot.joints, rate_hz, position, velocity, feedforward)


def _header(path: Path) -> list[str]:
    if path.suffix != ".csv":
        raise ValueError(f"{path}: expected a trajectory file (.csv) with time and one column a joint")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return [name.strip() for name in next(csv.reader(file), [])]
    except FileNotFoundError:
        raise ValueError(f"{path}: no such trajectory file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None


# ---- the run and its files ------------------------------------------------------------------------------------


def run(prepared: Prepared, progress: Progress | None = None) -> Simulation:
    """The run that a request asks for, with its raw log; `progress` is called with the part that is done."""
    request = prepared.request
    noise = request.noise
    noisy = any(np.any(x) for x in (noise.torque, noise.position, noise.velocity))
    rng = np.random.default_rng(np.random.SeedSequence(request.seed, spawn_key=(1,)))
    robot, controller, trajectory = prepared.robot, prepared.controller, prepared.trajectory
    given = noise if noisy else None
    if request.perturbation:
        return perturb_lanes(robot, controller, [trajectory], noise=given, rng=rng, raw=True, progress=progress)[0]
    return simulate(robot, controller, trajectory, noise=given, rng=rng, raw=True, progress=progress)


def write_run(result: Simulation, folder: Path) -> None:
    """Recording, campaign file, robot, coordinates and the tip's table into a folder."""
    robot_file = save_robot(result.robot, folder, allow_inconsistent=True)
    write_campaign(folder, robot_file.name, [result.recording])
    write_table(folder / STATE_FILE, ["time", *result.robot.coordinates], np.column_stack([result.time, result.q]))
    deviation, path = result.tip_deviation_mm, result.path_deviation_mm
    names = ["time", "x", "y", "z", "deviation_x_mm", "deviation_y_mm", "deviation_z_mm"]
    names += ["along_mm", "across_mm", "up_mm"]
    values = np.column_stack([result.time, result.tip[:, :3, 3], deviation, path])
    lines = [",".join(names), *(",".join(repr(float(x)) for x in row) for row in values)]
    (folder / "tip.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def degrees_hint(trajectory: Trajectory, robot: Robot) -> str:
    """What to add where a trajectory is far beyond the robot's limits, and would be within them if it were in degrees."""
    turning = [j for j, unit in enumerate(robot.units) if not unit.slides]
    low, high = (np.array(x)[turning] for x in (robot.tree.lowerPositionLimit, robot.tree.upperPositionLimit))
    angle = np.abs(trajectory.position[:, turning]).max(axis=0)
    place = angle / np.clip(np.maximum(-low, high), 1e-6, 2.0 * np.pi)
    # a speed says something where it lasts, which that of a jump does not, and of angles that are no few degrees anyhow
    usual = np.quantile(np.abs(trajectory.velocity[:, turning]), 0.99, axis=0)
    speed = np.where(angle > 1.0, usual / np.array(robot.tree.upperVelocityLimit)[turning], 0.0)
    beyond = np.maximum(place, speed)
    if not 2.0 < beyond.max(initial=0.0) < np.rad2deg(1.0):
        return ""
    worst = int(beyond.argmax())
    return f"; its angles look like degrees ({robot.joints[turning[worst]]} goes to {angle[worst]:.4g}); expected rad"


def summary(result: Simulation, from_file: bool = False) -> list[str]:
    """What is printed after a run, one line each; of a trajectory that somebody wrote in which unit it may be."""
    size = np.linalg.norm(result.tip_deviation_mm, axis=1)
    where = result.time[size.argmax()]
    lines = [
        f"{result.recording.name}: {result.time[-1]:.3f} s of {result.robot.name}, {len(result.robot.coordinates)} coordinates",
        f"Tip deviation: {size.max():.3g} mm at most (at {where:.3f} s), {np.sqrt(np.mean(size**2)):.3g} mm root mean square",
    ]
    assert result.raw is not None
    if len(result.raw.position) > 8:
        shares = result.raw.share_above(125.0)
        for name in ("torque", "velocity"):
            each = ", ".join(f"{j} {100 * x:.2g} %" for j, x in zip(result.robot.joints, shares[name], strict=True))
            lines.append(f"Power above 125 Hz in the raw log, {name}: {each}")
    lines += [f"Note: {result.trajectory.note}"] if result.trajectory.note else []
    hint = degrees_hint(result.trajectory, result.robot) if from_file else ""
    lines.append(f"The run ended early: {result.ended}{hint}" if result.ended else "The run went to its end")
    return lines


def simulate_into(
    request: RunRequest, folder: Path, tell: Callable[[str, float], None], overwrite: bool = False
) -> Simulation:
    """Check a request, run it and write its files; nothing is written unless all of it is."""
    from rx90b_flex.signals.folders import RUN, check_folder, fill_folder
    from rx90b_flex.view.plots import tip_deviation

    reads = [request.robot, request.motion, *([str(request.controller)] if request.controller else [])]
    check_folder(folder, RUN, overwrite, reads)
    prepared = prepare(request)
    what = f"simulating {prepared.trajectory.name}"
    tell(what, 0.0)
    with told_of_compiling(lambda: tell("compiling, once on this machine", 0.0)):
        result = run(prepared, lambda part: tell(what, 0.95 * part))
    if len(result.time) < 2:
        hint = _whose(request) or degrees_hint(prepared.trajectory, prepared.robot)
        raise ValueError(
            f"{prepared.robot.name}: {prepared.trajectory.name} ended at once: {result.ended or 'it has no samples'}; expected a "
            f"robot whose drives and links have inertia, and a reference that begins where it rests{hint}"
        )
    tell("writing", 0.95)

    def fill(at: Path) -> None:
        write_run(result, at)
        figure = tip_deviation(result)
        for ending in ("png", "svg"):
            figure.savefig(at / f"tip.{ending}", dpi=150)

    fill_folder(folder, fill, RUN, overwrite)
    return result
