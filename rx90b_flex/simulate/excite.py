"""What ``rx90b-flex excite`` does: the references of an identification from motor signals, as files for a robot's controller.

One file a run: joint references of one period, to be repeated, and the torque to be fed forward; for controllers without an input for
it, references that vibrate instead. Beside them a campaign file that names the logs which the robot will bring, so that
``rx90b-flex frf`` needs nothing else; or, if asked for, simulated logs.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation import crest_factor, hadamard, identity, lines_in_band, minus_below_first, scaled, whitening
from rx90b_flex.export import save_robot
from rx90b_flex.flexify import UNLIMITED
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals.folders import CAMPAIGN, check_folder, fill_folder
from rx90b_flex.simulate.campaign import (
    PLAN_FILE,
    RUNS,
    By,
    CampaignPlan,
    Progress,
    RunFile,
    campaign_text,
    run_campaign,
)
from rx90b_flex.simulate.closed_loop import Noise
from rx90b_flex.simulate.cs8 import CS8, design_cs8, load_cs8, own_controller, save_cs8
from rx90b_flex.simulate.trajectories import PERIOD_S, SQUARE_SPEED, Trajectory, horizontal, square_wave

Matrix = Literal["ones", "hadamard", "identity"]
MATRICES: dict[Matrix, Callable[[int], Array]] = {"ones": minus_below_first, "hadamard": hadamard, "identity": identity}
SHARE = 0.1  # of a joint's torque limit, where no peak is given: the source's 45 N m on the RX90B's first joints
NOISE = Noise(torque=0.1, position=1e-6, velocity=1e-4)  # of a simulated log
LONGEST_PERIOD_S = 600.0  # lines 1/300 Hz apart: finer than any resonance is wide
MOST_DAYS = 7
FASTEST_HZ = 1e5
# What a robot's log must hold: what moves it tells excited lines, and when in the period the log began.
LOGGED: dict[By, tuple[str, ...]] = {
    "torque": ("motor_position", "torque", "feedforward_torque"),
    "reference": ("motor_position", "torque", "reference_position"),
    "both": ("motor_position", "torque", "reference_position", "feedforward_torque"),
}


@dataclass(frozen=True)
class ExciteRequest:
    """What the user asks for: as of `rx90b_flex.excite`, and what else the command asks.

    Attributes
    ----------
    robot : str
        As `load_robot` takes it.
    poses : tuple of tuples of float, rad, or m where a joint slides
        One angle a joint; by default the source's horizontal arm, joint 2 at 90 degrees.
    matrix : ``ones`` (6.50), ``hadamard`` or ``identity``
    peak : tuple of float, N m
        By default `SHARE` of each joint's torque limit.
    speed : float, rad/s
        Of the joints between two reversals.
    swings : int
        Odd number of times that the joints go to and fro in a period.
    white : bool
        Whether the spectrum is divided by the loop's sensitivity, so that the drive torques are white.
    controller : Path or None
        Controller file; else the one that the robot's file states, else gains designed for it.
    speed_peak : tuple of float, rad/s
        `speed` by default.
    rate_hz : float or None
        Of the references, where no controller file states it; 250 by default.
    """

    robot: str
    poses: tuple[tuple[float, ...], ...] = ()
    joints: tuple[str, ...] = ()
    matrix: Matrix = "ones"
    peak: tuple[float, ...] = ()
    band_hz: tuple[float, float] = (2.5, 80.0)
    period_s: float = PERIOD_S
    speed: float = SQUARE_SPEED
    swings: int = 1
    realisations: int = 16
    periods: int = 9
    both_signs: bool = True
    white: bool = False
    controller: Path | None = None
    seed: int = 0
    by: By = "torque"
    speed_peak: tuple[float, ...] = ()
    rate_hz: float | None = None


def excitation_plans(request: ExciteRequest, robot: Robot | None = None) -> tuple[CampaignPlan, ...]:
    """A plan for each pose; of the robot that the request names, where none is given.

    Raises
    ------
    ValueError
        One line that names what does not fit: a joint, a pose beyond its limits, a torque beyond its limit, lines beyond Nyquist.
    """
    _check_numbers(request)
    robot = load_robot(request.robot) if robot is None else robot
    joints = request.joints or robot.joints[:3]
    for joint in joints:
        if joint not in robot.joints:
            raise ValueError(f"joint {joint!r}: {close_match(joint, robot.joints)}")
    if request.matrix not in MATRICES:
        raise ValueError(f"matrix is {request.matrix!r}; expected {', '.join(MATRICES)}")
    controller = _controller(robot, request)
    low, high = request.band_hz
    nyquist = 0.5 * controller.reference_rate_hz
    lines = lines_in_band(low, high, request.period_s) if 0.0 < low < high < nyquist else ()
    if not lines:
        raise ValueError(
            f"the band is {low:g} to {high:g} Hz with lines {2.0 / request.period_s:.3g} Hz apart; expected odd lines between 0 and "
            f"{nyquist:g} Hz, half the references' rate"
        )
    matrix = scaled(MATRICES[request.matrix](len(joints)), _peaks(robot, joints, request.peak))
    plans = []
    for place, pose in enumerate(request.poses or (horizontal(robot),)):
        reference = _reference(robot, controller, joints, pose, request, f"pose {place + 1}")
        plan = CampaignPlan(
            robot,
            controller,
            reference,
            joints,
            tuple(map(tuple, matrix.tolist())),
            lines=lines,
            peak=1.0,
            by=request.by,
            speeds=_speeds(request, joints),
            signs=(1, -1) if request.both_signs else (1,),
            realisations=request.realisations,
            periods=request.periods,
            # poses get other multisines, as other realisations do
            seed=request.seed + 1000 * place,
        )
        plan = dataclasses.replace(plan, amplitudes=white_amplitudes(plan)) if request.white else plan
        _check_reach(robot, plan.period(plan.runs[0]), f"pose {place + 1}")
        plans.append(plan)
    return tuple(plans)


def _check_numbers(request: ExciteRequest) -> None:
    """Refuse numbers that cannot be meant, before arrays of their size are made."""
    for joint in request.joints:
        if request.joints.count(joint) > 1:
            raise ValueError(f"joints: {joint!r} is listed {request.joints.count(joint)} times")
    if not 0.0 < request.period_s <= LONGEST_PERIOD_S:
        raise ValueError(f"period_s is {request.period_s:g}; expected more than 0, up to {LONGEST_PERIOD_S:g}")
    if not request.speed > 0.0:
        raise ValueError(f"speed is {request.speed:g}; expected more than 0")
    for name, value in (("realisations", request.realisations), ("periods", request.periods)):
        if value < 1:
            raise ValueError(f"{name} is {value}; expected 1 or more")
    days = request.realisations * request.periods * request.period_s / 86400.0
    if days > MOST_DAYS:
        raise ValueError(
            f"period_s is {request.period_s:g}: {request.realisations} realisations of {request.periods} periods make "
            f"{days:.3g} days of motion; expected {MOST_DAYS} at most"
        )
    lists = (("peak", request.peak), ("speed_peak", request.speed_peak))
    for name, numbers in (*lists, *(("pose", pose) for pose in request.poses)):
        if not np.isfinite(numbers).all():
            raise ValueError(f"{name}: a number is not finite; expected finite ones")
    if min(request.speed_peak, default=1.0) <= 0.0:
        raise ValueError(f"speed_peak is {min(request.speed_peak):g}; expected more than 0")
    if request.rate_hz is not None and not 1.0 <= request.rate_hz <= FASTEST_HZ:
        raise ValueError(f"rate_hz is {request.rate_hz:g}; expected 1 to {FASTEST_HZ:g}")
    if request.by not in get_args(By):
        raise ValueError(f"by is {request.by!r}; expected {', '.join(get_args(By))}")
    if request.by != "torque" and not request.both_signs:
        raise ValueError(
            f"by is {request.by!r} with one sign alone: only both signs tell the excitation from the motion"
        )


def white_amplitudes(plan: CampaignPlan) -> tuple[tuple[float, ...], ...]:
    """Spectra of the multisines, one a moving joint, that reach the drives flat through the plan's loop (section 7.2)."""
    robot, reference = plan.robot, plan.reference
    speed = np.abs(reference.velocity).max(axis=0)
    at = robot.linearize(robot.input_matrix @ reference.position.mean(axis=0), v=robot.input_matrix @ speed)
    hz = np.array(plan.lines) / (reference.period_s or PERIOD_S)
    places = [robot.joints.index(joint) for joint in plan.moving]
    sensitivity = plan.controller.sensitivity(at, hz)[:, places][:, :, places]
    return tuple(map(tuple, whitening(sensitivity).tolist()))


def _controller(robot: Robot, request: ExciteRequest) -> CS8:
    if request.controller is not None:
        known = load_cs8(request.controller).for_joints(robot.joints)
        if request.rate_hz not in (None, known.reference_rate_hz):
            raise ValueError(
                f"rate_hz is {request.rate_hz:g}; {request.controller} has reference_rate_hz = {known.reference_rate_hz:g}"
            )
        return known
    controller = own_controller(robot) or design_cs8(robot)
    if request.rate_hz is None:
        return controller
    rate = request.rate_hz
    up = max(1, round(controller.controller_rate_hz / rate))
    cutoff = controller.log_cutoff_hz / controller.log_rate_hz * rate
    return dataclasses.replace(
        controller, reference_rate_hz=rate, controller_rate_hz=up * rate, log_rate_hz=rate, log_cutoff_hz=cutoff
    )


def _speeds(request: ExciteRequest, joints: Sequence[str]) -> tuple[float, ...]:
    """Largest speed that is added to each joint's reference; empty where a controller file says what a reference orders."""
    if request.by == "torque" or (request.controller is not None and not request.speed_peak):
        return ()
    return tuple(_each(request.speed_peak or (request.speed,), joints, "speeds").tolist())


def _each(wanted: Sequence[float], joints: Sequence[str], what: str) -> Array:
    """One number for all joints, or one a joint, as the latter."""
    if len(wanted) not in (1, len(joints)):
        raise ValueError(f"{len(wanted)} peak {what} for {len(joints)} joints; expected one, or one a joint")
    return np.broadcast_to(np.asarray(wanted, dtype=float), len(joints))


def _peaks(robot: Robot, joints: Sequence[str], peak: Sequence[float]) -> Array:
    limit = np.array([robot.tree.effortLimit[robot.joints.index(joint)] for joint in joints])
    if not peak:
        unknown = [joint for joint, size in zip(joints, limit, strict=True) if not 0.0 < size < UNLIMITED]
        if unknown:
            raise ValueError(f"joint {unknown[0]!r} has no torque limit in its URDF; give the peak torque")
        return np.asarray(SHARE * limit)
    wanted = _each(peak, joints, "torques")
    for joint, size, largest in zip(joints, wanted, limit, strict=True):
        unit = robot.units[robot.joints.index(joint)]
        if not size > 0.0 or (0.0 < largest < size):
            raise ValueError(
                f"peak {unit.effort} of {joint} is {size:g} {unit.force}; expected more than 0, up to its limit of {largest:g}"
            )
    return np.asarray(wanted)


def _reference(
    robot: Robot, controller: CS8, joints: Sequence[str], pose: Sequence[float], request: ExciteRequest, name: str
) -> Trajectory:
    if len(pose) != len(robot.joints):
        raise ValueError(f"{name} has {len(pose)} numbers; expected {len(robot.joints)}: {', '.join(robot.joints)}")
    reference = square_wave(
        robot,
        pose,
        speed=request.speed,
        moving=joints,
        rate_hz=controller.reference_rate_hz,
        period_s=request.period_s,
        swings=request.swings,
    )
    _check_reach(robot, reference, name)
    return reference


def _check_reach(robot: Robot, reference: Trajectory, name: str) -> None:
    """Refuse references beyond the joints' limits."""
    model = robot.tree
    for j, (joint, unit) in enumerate(zip(robot.joints, robot.units, strict=True)):
        reached = reference.position[:, j]
        low, high = model.lowerPositionLimit[j], model.upperPositionLimit[j]
        if low < high and not (low <= reached.min() and reached.max() <= high):
            least, most, lower, upper = (unit.place(x) for x in (reached.min(), reached.max(), low, high))
            raise ValueError(f"{name}: {joint} moves from {least} to {most}; its limits are {lower} and {upper}")
        fastest, allowed = np.abs(reference.velocity[:, j]).max(), model.velocityLimit[j]
        if 0.0 < allowed < fastest:
            raise ValueError(f"{joint} moves at {fastest:.3g} {unit.speed}; its limit is {allowed:.3g}")


# ---- files ----------------------------------------------------------------------------------------------------


def excite_into(
    request: ExciteRequest,
    folder: Path,
    simulated: bool,
    tell: Progress,
    overwrite: bool = False,
    robot: Robot | None = None,
) -> list[str]:
    """Write references, robot and campaign file; nothing unless all of it. Returns what is worth knowing, one line each.

    Parameters
    ----------
    simulated : bool
        Whether the logs are simulated, too (perturbation method, noise `NOISE`).
    robot : Robot, optional
        In place of the one that the request names.
    """
    check_folder(folder, CAMPAIGN, overwrite, [request.robot, *([request.controller] if request.controller else [])])
    _keep_logs(folder)
    tell("designing", 0.0)
    plans = excitation_plans(request, robot)
    if simulated:
        plans = tuple(dataclasses.replace(p, noise=NOISE, method="perturbation") for p in plans)
    said: list[str] = []

    def fill(at: Path) -> None:
        files: list[RunFile] = []
        crests = []
        for place, plan in enumerate(plans):
            name = f"pose_{place + 1}" if len(plans) > 1 else "runs"
            (at / "references" / name).mkdir(parents=True)
            for k, key in enumerate(plan.runs):
                tell("writing references", (place + k / len(plan.runs)) / len(plans) * (0.3 if simulated else 1.0))
                moving = [plan.robot.joints.index(j) for j in plan.moving]
                crests.append(crest_factor(plan.torque(key)[:, moving]).max())
                write_reference(plan.period(key), at / "references" / name / f"{key.name}.csv")
                files.append(RunFile(f"logs/{name}/{key.name}.csv", plan.role(key)))
            if simulated:
                part = (0.3 + 0.7 * place / len(plans), 0.7 / len(plans))
                _simulate_logs(plan, at, name, lambda text, done, p=part: tell(text, p[0] + p[1] * done))  # type: ignore[misc]
        first = plans[0]
        save_robot(first.robot, at, allow_inconsistent=True)
        if request.controller is not None or simulated or first.robot.controller:
            save_cs8(first.controller, at / "controller.toml")
        (at / "logs").mkdir(exist_ok=True)
        (at / "campaign.toml").write_text(_campaign(plans, files, simulated), encoding="utf-8")
        said.extend(_words(plans, files, float(max(crests))))

    fill_folder(folder, fill, CAMPAIGN, overwrite)
    return said


def _simulate_logs(plan: CampaignPlan, at: Path, name: str, tell: Progress) -> None:
    """The logs of one pose in ``logs/<name>/``, as ``references/<name>/`` has their references, with their plan."""
    made, logs = at / ".simulated", at / "logs" / name
    result = run_campaign(plan, made, progress=tell)
    if result.failed:
        raise ValueError(f"{name}, {result.failed[0].run}: {result.failed[0].reason}")
    logs.parent.mkdir(exist_ok=True)
    (made / RUNS).replace(logs)
    (made / PLAN_FILE).replace(logs / PLAN_FILE)
    shutil.rmtree(made)


def _keep_logs(folder: Path) -> None:
    """Refuse a folder with logs that a robot may have brought: simulated ones are those that the plan beside them lists."""
    logs = folder / "logs"
    brought = {p for p in logs.rglob("*") if p.is_file()} if logs.is_dir() else set()
    for plan in logs.glob(f"*/{PLAN_FILE}"):
        try:
            runs = [f"{run}.parquet" for run in json.loads(plan.read_text(encoding="utf-8"))["runs"]]
        except (OSError, ValueError, KeyError, TypeError):
            continue
        # versions before had them a folder deeper, with the robot beside them
        names = (*runs, *(f"{RUNS}/{run}" for run in runs), PLAN_FILE, "campaign.toml", "controller.toml")
        brought -= {plan.parent / each for each in (*names, "robot.toml", "robot.urdf")}
    if brought:
        raise ValueError(
            f"{folder}: has {min(brought).relative_to(folder)}; give another folder, so that no logs are lost"
        )


def write_reference(trajectory: Trajectory, path: Path) -> None:
    """One period as a table: `time`, one column a joint (rad), `v_<joint>` (rad/s), `ff_<joint>` (N m).

    ``rx90b-flex simulate --trajectory`` reads it.
    """
    names = [
        "time",
        *trajectory.joints,
        *(f"v_{j}" for j in trajectory.joints),
        *(f"ff_{j}" for j in trajectory.joints),
    ]
    time = np.arange(len(trajectory.position)) / trajectory.rate_hz
    values = np.column_stack([time, trajectory.position, trajectory.velocity, trajectory.torque])
    rows = (",".join(f"{x:.10g}" for x in row) for row in values)
    path.write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")


def _campaign(plans: Sequence[CampaignPlan], files: Sequence[RunFile], simulated: bool) -> str:
    first = plans[0]
    if simulated:
        return campaign_text(first, [RunFile(Path(f.file).with_suffix(".parquet").as_posix(), f.role) for f in files])
    return "".join(f"# {line}\n" for line in _how(first)) + campaign_text(first, files, LOGGED[first.by])


def _how(plan: CampaignPlan) -> list[str]:
    """What to do with the references, as the head of a campaign file tells it."""
    joint, rate = plan.robot.joints[0], plan.reference.rate_hz
    units = [(unit.position, unit.speed, unit.force) for unit in plan.robot.units]
    place, speed, force = (" or ".join(dict.fromkeys(each)) for each in zip(*units, strict=True))
    meant = {
        "motor_position": f"q_{joint}, ... (motor angles, {place}, joint side)",
        "torque": f"tau_{joint}, ... (motor torques, {force}, joint side)",
        "reference_position": f"ref_{joint}, ... (joint references as sent, {place})",
        "feedforward_torque": f"ff_{joint}, ... (feed-forward torques as sent, {force})",
    }
    forward = "zero" if plan.by == "reference" else force
    sent = f"{joint}, ... ({place}), v_{joint}, ... ({speed}), ff_{joint}, ... ({forward})"
    optional = " and ".join(LOGGED[plan.by][2:])
    return [
        f"Run each file of references/ over and over without a pause, {plan.periods} periods of {plan.reference.period_s:g} s; the",
        "first one, in which the transient dies, is left out below.",
        f"Columns: {sent}; rows at {rate:g} Hz.",
        "Between rows references go along the cubic through their positions and speeds, torques along a straight line.",
        "Log at even steps into the file of the same name under logs/, with the columns",
        *(f"  {meant[key]}" for key in LOGGED[plan.by]),
        "Other names: change them in [signals]; another rate: in sample_rate_hz; motor side: add [motor] with gear_matrix.",
        "Torques: what the current loop is asked for, or what it measures. Best at the angles' instants; by how much they are",
        "early or late is identified (torque_delay), as long as it is the same for all joints and runs.",
        "Filter torques and angles alike against aliasing before the log's rate.",
        f"A log without {optional} will do, too: take that out of [signals], and begin all logs at the same instant of the",
        "period; frf takes what is missing from references/.",
        "controller.toml here is taken for the robot's controller; without it the experiments are replayed by the logged torques.",
        "Then: rx90b-flex frf campaign.toml --out results",
    ]


def _words(plans: Sequence[CampaignPlan], files: Sequence[RunFile], crest: float) -> list[str]:
    first = plans[0]
    period = first.reference.period_s or PERIOD_S
    minutes = len(files) * first.periods * period / 60.0
    once = first.period(first.runs[0])
    said = []
    units = first.robot.units
    scale = np.array([unit.scale for unit in units])
    for what, names, x in (
        ("Feed-forward torque", [unit.force for unit in units], once.torque),
        ("Vibration of references", [unit.given for unit in units], scale * (once.position - first.reference.position)),
        ("Its speed", [unit.speed for unit in units], once.velocity - first.reference.velocity),
    ):
        peaks = zip(first.robot.joints, np.abs(x).max(axis=0), names, strict=True)
        each = ", ".join(f"{j} {p:.3g} {name}" for j, p, name in peaks if p > 0.0)
        said += [f"{what} at most: {each}"] if each else []
    swing = np.ptp(first.reference.position, axis=0)
    swings = dict.fromkeys(unit.place(x) for unit, x in zip(units, swing, strict=True) if x > 0.0)
    return [
        f"{len(files)} runs of {first.periods} periods of {period:g} s: {minutes:.0f} min of motion; "
        f"{len(plans)} pose{'s' if len(plans) > 1 else ''}",
        f"{len(first.lines)} odd lines from {first.lines[0] / period:.3g} to {first.lines[-1] / period:.3g} Hz, "
        f"{2.0 / period:.3g} Hz apart; crest factor at most {crest:.2f}",
        *said,
        f"Joints swing by {' or '.join(swings)}",
    ]
