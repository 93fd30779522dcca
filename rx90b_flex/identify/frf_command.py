"""What ``rx90b-flex frf`` does: from a campaign of motor signals to physical parameters, stage by stage.

At each pose the nonparametric frequency response, transfer functions with their validation and the inverse eigenvalue problem; then
the grey box on all poses, and again without the distortion that a replay of the experiments explains. A stage that cannot be
done is left out with its reason; those that do not need it go on.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from scipy.signal import resample

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.files.results import finite, write_json
from rx90b_flex.identify.accelerometers import AccelerationResponse
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse, estimate_accelerations, estimate_frequency_response, group_poses
from rx90b_flex.identify.grey_box import GreyBox, Progress, grey_box
from rx90b_flex.identify.grey_data import Feedback, GreyBoxOptions, PoseResponse
from rx90b_flex.identify.inverse_eigenvalue import DriveIdentification, identify_drives
from rx90b_flex.identify.replay import Replay, ReplayedGreyBox, grey_box_by_replay, shifts_between, sticking
from rx90b_flex.identify.response_faults import check_response
from rx90b_flex.identify.stability import stable
from rx90b_flex.identify.transfer_function import TransferFit, fit_transfer_functions
from rx90b_flex.identify.validation import Validation, validate
from rx90b_flex.joint_units import flexibility_unit
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals import Campaign, Recording, load_campaign
from rx90b_flex.signals.filters import periods
from rx90b_flex.signals.folders import MOTOR_SIGNALS, fill_folder
from rx90b_flex.signals.stated import Accelerometer
from rx90b_flex.signals.tables import read_table

if TYPE_CHECKING:
    from rx90b_flex.simulate.cs8 import CS8

T = TypeVar("T")

TORQUES_OFF = 0.25  # of the logged torques: replayed ones that are farther from them are of another controller
CONTROLLER, REFERENCES = "controller.toml", "references"  # beside the campaign file
OTHER_TORQUES = 0.1  # relative, by which torques or references that were logged are not those of a file
LOW, HIGH = 0.3, 3.0  # a drive stiffness or inertia from poles and zeros this far from the declared one is no start


@dataclass(frozen=True)
class FrfOptions(GreyBoxOptions):
    """What the user may choose: of the grey box, whose lines are those of all stages, and of the others.

    Attributes
    ----------
    controller : Path or None
        Controller file; else ``controller.toml`` beside the campaign, if there is one.
    modes : tuple of int
        Numbers of modes that the transfer functions try.
    start_hz : tuple of float
        Resonances from which the transfer functions of as many modes set out as well, Hz.
    delays : str
        Of the transfer functions: ``none``, ``common`` or ``each`` (`fit_transfer_functions`).
    references : Path or None
        Folder of the files that were sent (`rx90b-flex excite`), where the logs do not hold the feed-forward torque.
    mains_hz : float or None
        About 50 or 60: mains near it are taken out of the recordings.
    replay : bool
        Simulate the experiments on the grey box's robot and fit again without the distortion that this explains.
    jobs : int
        Processes for these simulations, and for the report's figures.
    """

    starts: int = 8
    bending_alike_std: float = 0.1
    controller: Path | None = None
    modes: tuple[int, ...] = tuple(range(2, 9))
    start_hz: tuple[float, ...] = ()
    delays: str = "none"
    references: Path | None = None
    mains_hz: float | None = None
    replay: bool = True
    jobs: int = 1


@dataclass(frozen=True)
class LeftOut:
    """A stage that was not done."""

    stage: str
    why: str


@dataclass(frozen=True, eq=False)
class AtPose:
    """What the recordings about one pose say.

    Attributes
    ----------
    name : str
        ``pose 1``, in the order of the campaign file.
    pose : array, shape (joints of the robot,), rad
        Mean drive angles; zero where not recorded.
    recordings : tuple of Recording
    measured : MeasuredResponse
    transfer, validation, drives : results of the stages, None where left out
    accelerations : AccelerationResponse or None
        What the campaign's accelerometers showed; None where there are none.
    """

    name: str
    pose: Array
    recordings: tuple[Recording, ...]
    measured: MeasuredResponse
    transfer: TransferFit | None
    validation: Validation | None
    drives: DriveIdentification | None
    accelerations: AccelerationResponse | None = None


@dataclass(frozen=True, eq=False, repr=False)
class MotorIdentification(Showing):
    """All that a campaign of motor signals says.

    Attributes
    ----------
    campaign : Path
    robot : Robot
        As declared.
    options : Options
    poses : tuple of AtPose
        Those with a frequency response.
    grey : GreyBox or None
        Fitted to the responses of `fitted` together; None where left out.
    fitted : tuple of int
        Places in `poses` of the grey box's responses.
    replayed : ReplayedGreyBox or None
        The same without the distortion that a replay explains; None where left out.
    left_out : tuple of LeftOut
    remarks : tuple of str
        What qualifies the results.
    seconds : dict of stage to float
        Wall time of each stage.
    """

    campaign: Path
    robot: Robot
    options: FrfOptions
    poses: tuple[AtPose, ...]
    grey: GreyBox | None
    fitted: tuple[int, ...]
    replayed: ReplayedGreyBox | None
    left_out: tuple[LeftOut, ...]
    remarks: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def found(self) -> Robot | None:
        """The robot as identified, by replay where that was done; None without a grey box."""
        best = self.replayed or self.grey
        return None if best is None else best.robot


@dataclass
class _Stages:
    """Does stages one after the other, notes their time and what could not be done.

    Those of one pose have its name before theirs, and their parts lie within the pose's.
    """

    tell: Progress
    left_out: list[LeftOut] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    before: str = ""
    part: tuple[float, float] = (0.0, 1.0)

    def run(self, name: str, part: float, work: Callable[..., T], *needs: object) -> T | None:
        """What `work` makes of the results that it needs; None where one of these is missing, or it cannot be done."""
        name = self.before + name
        self.tell(name, self.part[0] + self.part[1] * part)
        if any(need is None for need in needs):
            self.left_out.append(LeftOut(name, "the stage that it builds on was left out"))
            return None
        began = time.perf_counter()
        try:
            return work(*needs)
        except ValueError as error:
            self.left_out.append(LeftOut(name, " ".join(str(error).split())))
            return None
        finally:
            self.seconds[name] = time.perf_counter() - began


def identify_from_motors(
    source: str | os.PathLike[str] | Campaign, options: FrfOptions | None = None, progress: Progress | None = None
) -> MotorIdentification:
    """Identify a robot from a campaign of periodic excitation about one or several poses: motor angles and torques only.

    Recordings are told apart by their mean angles (`group_poses`). Each pose has its own frequency response, transfer functions,
    poles and zeros; the grey box is fitted to all poses together.

    Parameters
    ----------
    source : path
        Campaign file; its recordings repeat (`period_s`) and hold the feed-forward torque.
    options : Options, optional
    progress : callable, optional

    Raises
    ------
    ValueError
        A campaign without a frequency response, or files that cannot be read. What fails later is in `left_out`.
    """
    options = options or FrfOptions()
    tell = progress or (lambda text, part: None)
    tell("reading", 0.0)
    campaign = source if isinstance(source, Campaign) else load_campaign(Path(source))
    robot = load_robot(campaign.robot_source)
    links = [link for link, _ in robot.bodies]
    for sensor in campaign.accelerometers:
        if sensor.link not in links:
            raise ValueError(f"{campaign.path}: accelerometer on {sensor.link!r}; {close_match(sensor.link, links)}")
    controller = _controller(campaign.path, options.controller)
    stages = _Stages(tell)
    remarks: list[str] = []
    groups = group_poses(with_references(campaign, options.references, remarks))
    poses = _at_poses(groups, robot, campaign.accelerometers, options, stages)
    several = len(groups) > 1
    remarks += [f"{at.name}: {remark}" if several else remark for at in poses for remark in at.measured.remarks]
    if controller is None:
        remarks.append(
            f"no controller file (no {CONTROLLER} beside the campaign): the poses are averaged as in open loop, and a replay is "
            "driven by the torques as logged"
        )
    fitted = _alike(poses, remarks)
    together = [poses[i] for i in fitted]
    grey = stages.run("grey box", 0.6, lambda: _grey_box(together, robot, controller, options, tell))
    replayed = None
    if options.replay:
        replayed = stages.run(
            "replay", 0.75, lambda fit: _replay(together, robot, fit, controller, options, tell), grey
        )
    if replayed is not None:
        remarks += [] if controller is None else _torques_off(replayed, together)
        remarks += _sticking_words(replayed, sticking(robot, together[0].measured.joints))
    if grey is not None and replayed is not None:
        grey = grey.doubted(shifts_between(grey, replayed.grey))  # a bias that is known of and still in it
    return MotorIdentification(
        campaign.path, robot, options, tuple(poses), grey, fitted if grey is not None else (), replayed,
        tuple(stages.left_out), tuple(remarks), stages.seconds,
    )  # fmt: skip


def with_references(campaign: Campaign, folder: Path | None, remarks: list[str]) -> tuple[Recording, ...]:
    """The recordings to identify on, with what was sent: from a folder that is given, or from that beside the campaign."""
    recordings = campaign.identification
    if folder is not None:
        return tuple(_with_speed(with_reference(r, folder)) for r in recordings)
    beside = campaign.path.parent / REFERENCES
    if beside.is_dir():
        try:
            recordings = tuple(with_reference(r, beside) for r in recordings)
        except ValueError as error:
            remarks.append(f"{beside} is left aside: {error}")
    return tuple(_with_speed(r) for r in recordings)


def _with_speed(recording: Recording) -> Recording:
    """With the slope of a reference that repeats and was logged without its speed."""
    asked, samples = recording.reference_position, recording.period_samples
    if asked is None or samples is None or recording.reference_velocity is not None:
        return recording
    slope = 2j * np.pi * np.arange(samples // 2 + 1)[:, None] / (recording.period_s or 1.0)
    speed = np.fft.irfft(slope * np.fft.rfft(asked[:samples], axis=0), samples, axis=0)
    return dataclasses.replace(recording, reference_velocity=np.resize(speed, asked.shape))


def with_reference(recording: Recording, folder: Path) -> Recording:
    """A log with what the file holds that was sent: of its name, in the folder or in one of its own folder's name.

    Where the torques fed forward were logged, or else the references, they say when in the period the log began. Where not, that does
    not matter, as long as all logs began alike.

    Raises
    ------
    ValueError
        No such file, one of another period, or with other torques or references than were logged.
    """
    fed = recording.feedforward_torque
    known = fed is not None and recording.reference_position is not None and recording.reference_velocity is not None
    if known or recording.period_samples is None or recording.source is None:
        return recording
    file = f"{recording.source.name.split('.')[0]}.csv"
    places = [folder / recording.source.parent.name / file, folder / file]
    found = next((path for path in places if path.is_file()), None)
    if found is None:
        raise ValueError(
            f"{folder}: no {file}, the reference of {recording.source.parent.name}/{recording.source.name}"
        )
    columns = ["time", *(f"{kind}{joint}" for kind in ("", "v_", "ff_") for joint in recording.joints)]
    values = read_table(found, columns).finite(columns)
    lasts = len(values) * float(values[-1, 0] - values[0, 0]) / (len(values) - 1)
    if abs(lasts - (recording.period_s or 0.0)) > 1e-3 * lasts:
        raise ValueError(
            f"{found}: lasts {lasts:.6g} s; expected one period_s of {recording.name}, {recording.period_s:g} s"
        )
    size = recording.period_samples
    wave = values[:, 1:] if len(values) == size else resample(values[:, 1:], size, axis=0)
    wave = _as_logged(recording, wave, found)
    position, velocity, torque = (np.resize(part, recording.torque.shape) for part in np.split(wave, 3, axis=1))
    return dataclasses.replace(
        recording,
        reference_position=position,
        reference_velocity=velocity,
        feedforward_torque=torque if fed is None else fed,
    )


def _as_logged(recording: Recording, wave: Array, file: Path) -> Array:
    """A period (N, 3 n) of positions, speeds and torques begun where the log shows them to begin."""
    fed, number, size = recording.feedforward_torque, len(recording.joints), len(wave)
    shown, own, what, how = recording.reference_position, slice(0, number), "references", "given"
    if fed is not None and np.ptp(fed[:size], axis=0).any():
        shown, own, what, how = fed, slice(2 * number, None), "torques", "fed"
    if shown is None:
        return wave
    rolled, off = _begun_with(shown[:size], wave, own)
    if off > OTHER_TORQUES:
        raise ValueError(f"{file}: its {what} are not those that {recording.name} was {how} ({off:.0%} off)")
    return rolled


def _begun_with(shown: Array, wave: Array, own: slice) -> tuple[Array, float]:
    """A period (N, k) begun where its own columns are those shown (N, n); and how much these then differ, means apart."""
    shown = shown - shown.mean(axis=0)
    product = (np.fft.rfft(shown, axis=0) * np.fft.rfft(wave[:, own], axis=0).conj()).sum(axis=1)
    product[0] = 0.0
    rolled = np.roll(wave, int(np.argmax(np.fft.irfft(product, len(shown)))), axis=0)
    left = rolled[:, own] - rolled[:, own].mean(axis=0) - shown
    return rolled, float(np.linalg.norm(left) / max(float(np.linalg.norm(shown)), 1e-300))


def _at_poses(
    groups: Sequence[tuple[Recording, ...]],
    robot: Robot,
    sensors: tuple[Accelerometer, ...],
    options: FrfOptions,
    stages: _Stages,
) -> list[AtPose]:
    """All stages of each pose that has a frequency response; one must."""
    count, poses = len(groups), []
    for place, group in enumerate(groups):
        name = f"pose {place + 1}"
        before, part = f"{name}: " if count > 1 else "", (0.1 + 0.5 * place / count, 0.5 / count)
        own = dataclasses.replace(stages, before=before, part=part)
        at = _at_pose(name, group, robot, sensors, options, own)
        poses += [] if at is None else [at]
    if not poses:
        first = stages.left_out[0].why
        raise ValueError(first if count == 1 else f"{count} poses, none has a response; the first: {first}")
    return poses


def _at_pose(
    name: str,
    recordings: tuple[Recording, ...],
    robot: Robot,
    sensors: tuple[Accelerometer, ...],
    options: FrfOptions,
    stages: _Stages,
) -> AtPose | None:
    """All stages of one pose; None without a frequency response."""

    def response() -> MeasuredResponse:
        found = estimate_frequency_response(recordings, band_hz=options.band_hz, mains_hz=options.mains_hz)
        check_response(found, robot)
        return found

    measured = stages.run("frequency response", 0.0, response)
    if measured is None:
        return None
    transfer = stages.run(
        "transfer functions",
        0.3,
        lambda: fit_transfer_functions(measured, options.modes, delays=options.delays, start_hz=options.start_hz),
    )
    validation = stages.run("validation", 0.9, validate, transfer)
    drives = stages.run("inverse eigenvalue problem", 0.95, identify_drives, transfer)
    accelerations = None
    if sensors:
        accelerations = stages.run(
            "accelerometers", 0.97, lambda: estimate_accelerations(recordings, measured, sensors)
        )
    pose = mean_motion(recordings, robot.joints).mean(axis=0)
    return AtPose(name, pose, recordings, measured, transfer, validation, drives, accelerations)


def _alike(poses: Sequence[AtPose], remarks: list[str]) -> tuple[int, ...]:
    """Places of the poses that the grey box can fit together: those at which most excite the same joints."""
    joints = Counter(p.measured.joints for p in poses).most_common(1)[0][0]
    for p in poses:
        if p.measured.joints != joints:
            there, usual = ", ".join(p.measured.joints), ", ".join(joints)
            remarks.append(f"{p.name}: the grey box leaves it out, it excites {there}; other poses {usual}")
    return tuple(i for i, p in enumerate(poses) if p.measured.joints == joints)


def _controller(campaign: Path, file: Path | None) -> CS8 | None:
    from rx90b_flex.simulate.cs8 import load_cs8

    beside = campaign.parent / CONTROLLER
    return load_cs8(file or beside) if file is not None or beside.exists() else None


def feedback_of(controller: CS8, joints: tuple[str, ...]) -> Feedback:
    """Feedback torque against drive acceleration: the controllers' response to angles over ``s^2``, hold and filters included."""
    own = controller.for_joints(joints)

    def feedback(hz: Array) -> ComplexArray:
        s = 2j * np.pi * np.asarray(hz, dtype=float)[:, None]
        return np.asarray((own.frequency_response(hz) / s**2)[:, :, None] * np.eye(len(joints)))

    return feedback


def mean_motion(recordings: Iterable[Recording], joints: tuple[str, ...]) -> Array:
    """One period of the drives' mean motion over recordings, shape (N, joints of the robot), rad; joints not recorded at zero."""
    each = []
    for r in recordings:
        each.append(periods(r.position, r.period_samples or r.samples).mean(axis=0))
        names = r.joints
    mean = np.mean(each, axis=0)
    out = np.zeros((len(mean), len(joints)))
    out[:, [joints.index(name) for name in names]] = mean
    return out


def _grey_box(
    poses: Sequence[AtPose], robot: Robot, controller: CS8 | None, options: FrfOptions, tell: Progress
) -> GreyBox:
    feedback = None if controller is None else feedback_of(controller, poses[0].measured.joints)
    sensed = all(p.accelerations is not None for p in poses)
    measured = [
        PoseResponse.of(
            p.measured, mean_motion(p.recordings, robot.joints), feedback, p.accelerations if sensed else None
        )
        for p in poses
    ]
    start = _start(robot, [p.drives for p in poses if p.drives is not None])
    return grey_box(robot, measured, options, start=start, progress=lambda text, part: tell(text, 0.6 + 0.15 * part))


def _replay(
    poses: Sequence[AtPose], robot: Robot, grey: GreyBox, controller: CS8 | None, options: FrfOptions, tell: Progress
) -> ReplayedGreyBox:
    if len(grey.responses) > len(poses):
        raise ValueError(
            "friction's distortion of accelerometers' signals is not replayed; the fit as measured uses them"
        )
    return grey_box_by_replay(
        robot,
        grey,
        [
            Replay.from_torques(p.recordings, p.measured, robot)
            if controller is None
            else Replay.of(p.recordings, p.measured, controller)
            for p in poses
        ],
        jobs=options.jobs,
        progress=lambda text, part: tell(text, 0.75 + 0.2 * part),
    )


def _torques_off(replayed: ReplayedGreyBox, poses: Sequence[AtPose]) -> list[str]:
    """What is said of a controller that does not order what was logged."""
    off = replayed.torques_off.max(axis=0)
    joints = [j for j, x in zip(poses[0].measured.joints, off.tolist(), strict=True) if x > TORQUES_OFF]
    if not joints:
        return []
    return [
        f"replay: under the controller file the torques of {', '.join(joints)} are up to {100.0 * off.max():.0f} % off those logged "
        "(2 to 6 % are usual where all is as declared): its gains, filters or rates, friction or the robot are others; without a "
        "controller file the logged torques drive the replay"
    ]


def _sticking_words(replayed: ReplayedGreyBox, joints: Sequence[str]) -> list[str]:
    """Why own drive parameters of joints that were not excited are not called determined."""
    own = {e.name.partition(".")[0] for e in replayed.grey.estimates if ".drive_" in e.name}
    named = [joint for joint in joints if joint in own]
    if not named:
        return []
    each = ", ".join(named)
    return [
        f"replay: drive inertia, stiffness and damping of {each} are called not determined: not excited, the drive sticks by dry "
        "friction, and a replay's errors of it are as large as what shows of them; excite the joint to know them"
    ]


def _start(robot: Robot, found: Sequence[DriveIdentification]) -> dict[str, float]:
    """Drive stiffness and inertia from poles and zeros, where they could be right; of several poses the median."""
    declared = {(e.type_name(), e.joints): e.coefficients[0] for e in robot.effects if len(e.coefficients)}
    values: dict[str, list[float]] = {}
    for drives in found:
        for joint, drive in zip(drives.joints, drives.drives, strict=True):
            for kind, effect, value in (
                ("drive_stiffness", "drive_flexibility", drive.stiffness),
                ("drive_inertia", "drive_inertia", drive.inertia),
            ):
                usual = declared.get((effect, (joint,)))
                if usual is not None and LOW * usual < value < HIGH * usual:
                    values.setdefault(f"{joint}.{kind}", []).append(float(value))
    return {name: float(np.median(each)) for name, each in values.items()}


# ---- files ----------------------------------------------------------------------------------------------------


def frf_json(result: MotorIdentification) -> dict[str, Any]:
    """The content of ``frf.json``.

    Of each pose, ``frequency_response`` holds lists over lines, then rows (accelerations), then columns (torques), rad/s^2 per N m
    (m and N of joints that slide);
    ``replayed_response`` the same without the distortion that the replay explains, null without one; what of that the replay is not
    trusted with is part of its ``std``. Of ``transfer_functions``,
    ``refused`` has modes and antiresonances that do not count, each with its reason, and ``stabilisation`` the modes of every order.
    ``transfer_functions``, ``drives``, ``grey_box`` and ``replay`` are null where ``left_out`` says why (``replay`` also where it
    was not wanted). Each parameter has value, std and unit; of the grey box also its 95 % interval and whether the data determine
    it. ``grey_box`` is fitted to the responses as measured, ``replay`` to them without the distortion that the replay explains.
    ``hinges`` holds the places of those that were not taken as known, ``torques_off`` how far a replay's torques are from those
    logged, by pose and joint.
    """
    return {
        "schema": 1,
        "campaign": result.campaign.name,
        "robot": result.robot.name,
        "joints": list(result.robot.joints),
        "band_hz": list(result.options.band_hz),
        "accelerometers": [
            {"link": s.link, "position": list(s.position)}
            for p in result.poses[:1]
            for s in (() if p.accelerations is None else p.accelerations.sensors)
        ],
        "poses": [
            {
                "name": p.name,
                "pose_rad": p.pose.tolist(),
                "recordings": [r.name for r in p.recordings],
                "frequency_response": _response_json(p.measured),
                "replayed_response": _replayed_json(result, k),
                "transfer_functions": _transfer_json(result.robot, p.transfer, p.validation),
                "drives": _drives_json(result.robot, p.drives),
            }
            for k, p in enumerate(result.poses)
        ],
        "grey_box": None if result.grey is None else _grey_json(result, result.grey),
        "replay": None if result.replayed is None else _replay_json(result, result.replayed),
        "left_out": [{"stage": x.stage, "why": x.why} for x in result.left_out],
        "remarks": list(result.remarks),
    }


def _response_json(measured: MeasuredResponse) -> dict[str, Any]:
    noise = measured.noise_std()
    return {
        **_values_json(measured),
        "noise_std": None if noise is None else noise.tolist(),
        "degrees_of_freedom": finite(measured.degrees_of_freedom),
        "realisations": len(measured.realisations),
        "periods": measured.periods,
        "experiments": int(measured.torque.shape[2]),
    }


def _replayed_json(result: MotorIdentification, place: int) -> dict[str, Any] | None:
    """A pose's response without the distortion that the replay explains."""
    if result.replayed is None or place not in result.fitted:
        return None
    replayed = result.replayed.responses[result.fitted.index(place)]
    return {**_values_json(replayed), "degrees_of_freedom": finite(replayed.degrees_of_freedom)}


def _values_json(response: FrequencyResponse) -> dict[str, Any]:
    return {
        "joints": list(response.joints),
        "hz": response.hz.tolist(),
        "real": response.value.real.tolist(),
        "imag": response.value.imag.tolist(),
        "std": response.std().tolist(),
    }


def _quantity(value: float, std: float, unit: str) -> dict[str, Any]:
    return {"value": float(value), "std": float(std), "unit": unit}


def _transfer_json(robot: Robot, fit: TransferFit | None, tests: Validation | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    # each with why it does not count
    resonances = [(_mode_json(*row), why) for *row, why in fit.mode_rows()]
    zeros = {
        joint: [
            (_quantity(f, s, "Hz"), why)
            for f, s, why in zip(*fit.antiresonances(j), fit.refused_antiresonances(j), strict=True)
        ]
        for j, joint in enumerate(fit.response.joints)
    }
    refused = [{"kind": "resonance", **one, "why": why} for one, why in resonances if why]
    refused += [
        {"kind": "antiresonance", "joint": joint, **one, "why": why}
        for joint, each in zeros.items()
        for one, why in each
        if why
    ]
    return {
        "resonances": [one for one, why in resonances if not why],
        "antiresonances": {joint: [one for one, why in each if not why] for joint, each in zeros.items()},
        "refused": refused,
        "residual_terms": list(fit.residual_terms),
        "residual_flexibility": _flexibility_json(robot, fit),
        "stabilisation": _stabilisation_json(fit),
        # one for all torques, or one a torque in the order of the joints; null where none was fitted
        "torque_delays": [_quantity(value, std, "s") for value, std in zip(*fit.torque_delays(), strict=True)] or None,
        "cost": float(fit.cost),
        "validation": None
        if tests is None
        else [{"test": c.name, "passed": bool(c.passed), "found": c.found, "implies": c.implies} for c in tests.checks],
    }


def _mode_json(hz: float, std: float, damping: float, damping_std: float) -> dict[str, Any]:
    return {**_quantity(hz, std, "Hz"), "damping_ratio": float(damping), "damping_ratio_std": float(damping_std)}


def _flexibility_json(robot: Robot, fit: TransferFit) -> dict[str, Any] | None:
    """Of the modes above the band, rows and columns in the order of the response's joints; null where the term does not pay."""
    if "flexibility" not in fit.residual_terms:
        return None
    value, std = fit.residual_flexibility()
    return {"value": value.tolist(), "std": std.tolist(), "unit": flexibility_unit(robot.units_of(fit.response.joints))}


def _stabilisation_json(fit: TransferFit) -> list[dict[str, Any]]:
    """Modes of each order that was tried, and which of them are known well enough and found again at the next order."""
    return [
        {
            "modes": one.modes,
            "poles": [
                {**_mode_json(*row), "stable": bool(held)}
                for *row, held in zip(*one.modes_told(), stable(place, fit.candidates), strict=True)
            ],
        }
        for place, one in enumerate(fit.candidates)
    ]


def _drives_json(robot: Robot, drives: DriveIdentification | None) -> dict[str, Any] | None:
    if drives is None:
        return None
    return {
        joint: {
            "inertia": _quantity(d.inertia, d.inertia_std, own.of("kg m^2")),
            "stiffness": _quantity(d.stiffness, d.stiffness_std, own.of("N m/rad")),
            "modes": int(modes),
        }
        for joint, own, d, modes in zip(
            drives.joints, robot.units_of(drives.joints), drives.drives, drives.modes, strict=True
        )
    }


ASSUMED = (
    "friction has the form that the robot file declares, coefficients apart, and what drives the robot is as given"
)


def _replay_json(result: MotorIdentification, replayed: ReplayedGreyBox) -> dict[str, Any]:
    deviation = {"as_measured": replayed.before, "less_replay": replayed.after}
    return {
        "assumes": ASSUMED,
        **_grey_json(result, replayed.grey),
        "friction": {f.name: {**_quantity(f.value, f.std, f.unit), "declared": f.declared} for f in replayed.frictions},
        "realisations_deviate": {name: x.tolist() for name, x in deviation.items()},
        "torques_off": replayed.torques_off.tolist(),
        "rounds": replayed.rounds,
    }


def _grey_json(result: MotorIdentification, grey: GreyBox) -> dict[str, Any]:
    return {
        "poses": [result.poses[i].name for i in result.fitted],
        "parameters": {
            e.name: {
                **_quantity(e.value, e.std, e.unit),
                "low": e.low,
                "high": e.high,
                "declared": e.start,
                "determined": e.determined,
            }
            for e in grey.estimates
        },
        "torque_delay": None
        if grey.torque_delay is None
        else _quantity(grey.torque_delay.value, grey.torque_delay.std, "s"),
        "hinges": [{**dataclasses.asdict(h), "unit": "m"} for h in grey.hinges],
        "vague_directions": [{"relative_std": d.relative_std, "parts": dict(d.parts)} for d in grey.directions],
        "cost": grey.cost,
        "expected_cost": grey.expected_cost,
        "bias_detected": bool(grey.bias_detected),
        "starts": [{"name": s.name, "cost": s.cost} for s in grey.starts],
    }


def write_motor_identification(
    result: MotorIdentification,
    folder: str | os.PathLike[str],
    extra: Iterable[Callable[[MotorIdentification, Path], None]] = (),
    overwrite: bool = False,
) -> Path:
    """Write ``frf.json``, the robot as identified (by replay where that was done), and what else is given; all or nothing."""
    from rx90b_flex.export import save_robot

    folder = Path(folder)

    def fill(at: Path) -> None:
        write_json(at / "frf.json", frf_json(result), indent=None)
        if result.found is not None:
            save_robot(result.found, at, allow_inconsistent=True)
        for write in extra:
            write(result, at)

    fill_folder(folder, fill, MOTOR_SIGNALS, overwrite)
    return folder
