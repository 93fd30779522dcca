"""What ``rx90b-flex frf`` does: from a campaign of motor signals to physical parameters, stage by stage.

Nonparametric frequency response, transfer functions with their validation, inverse eigenvalue problem, grey box. A stage that cannot
be done is left out with its reason; those that do not need it go on.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse, estimate_frequency_response
from rx90b_flex.identify.grey_box import Feedback, GreyBox, Progress, grey_box, poses_along
from rx90b_flex.identify.inverse_eigenvalue import DriveIdentification, identify_drives
from rx90b_flex.identify.transfer_function import TransferFit, fit_transfer_functions
from rx90b_flex.identify.validation import Validation, validate
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording, load_campaign
from rx90b_flex.signals.folders import fill_folder

if TYPE_CHECKING:
    from rx90b_flex.simulate.cs8 import CS8

T = TypeVar("T")

CONTROLLER = "controller.toml"  # beside the campaign file
LOW, HIGH = 0.3, 3.0  # a drive stiffness or inertia from poles and zeros this far from the declared one is no start


@dataclass(frozen=True)
class Options:
    """What the user may choose.

    Attributes
    ----------
    band_hz : (low, high)
        Lines used.
    controller : Path or None
        Controller file; else ``controller.toml`` beside the campaign, if there is one.
    link_mass_std : float
        Relative standard deviation of the links' masses; 0: known.
    bending_alike_std : float
        To which a joint is equally stiff about both its bending axes, as in table 4.1; 0: not assumed.
    starts, seed : int
        Of the grey box.
    modes : tuple of int
        Numbers of modes that the transfer functions try.
    """

    band_hz: tuple[float, float] = (8.0, 80.0)
    controller: Path | None = None
    link_mass_std: float = 0.0
    bending_alike_std: float = 0.1
    starts: int = 8
    seed: int = 0
    modes: tuple[int, ...] = tuple(range(2, 9))


@dataclass(frozen=True)
class LeftOut:
    """A stage that was not done."""

    stage: str
    why: str


@dataclass(frozen=True, eq=False)
class MotorIdentification:
    """All that a campaign of motor signals says.

    Attributes
    ----------
    campaign : Path
    robot : Robot
        As declared.
    options : Options
    measured : MeasuredResponse
    transfer, validation, drives, grey : results of the stages, None where left out
    left_out : tuple of LeftOut
    remarks : tuple of str
        What qualifies the results.
    seconds : dict of stage to float
        Wall time of each stage.
    """

    campaign: Path
    robot: Robot
    options: Options
    measured: MeasuredResponse
    transfer: TransferFit | None
    validation: Validation | None
    drives: DriveIdentification | None
    grey: GreyBox | None
    left_out: tuple[LeftOut, ...]
    remarks: tuple[str, ...]
    seconds: dict[str, float]


@dataclass
class _Stages:
    """Does stages one after the other, notes their time and what could not be done."""

    tell: Progress
    left_out: list[LeftOut] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def run(self, name: str, part: float, work: Callable[[], T], needs: Iterable[object] = ()) -> T | None:
        self.tell(name, part)
        if any(need is None for need in needs):
            self.left_out.append(LeftOut(name, "the stage that it builds on was left out"))
            return None
        began = time.perf_counter()
        try:
            return work()
        except ValueError as error:
            self.left_out.append(LeftOut(name, " ".join(str(error).split())))
            return None
        finally:
            self.seconds[name] = time.perf_counter() - began


def identify_from_motors(
    source: str | os.PathLike[str], options: Options | None = None, progress: Progress | None = None
) -> MotorIdentification:
    """Identify a robot from a campaign of periodic excitation about one pose: motor angles and torques only.

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
    options = options or Options()
    tell = progress or (lambda text, part: None)
    tell("reading", 0.0)
    campaign = load_campaign(Path(source))
    robot = load_robot(campaign.robot_source)
    controller = _controller(Path(source), options.controller)
    stages = _Stages(tell)
    tell("frequency response", 0.1)
    began = time.perf_counter()
    measured = estimate_frequency_response(campaign, band_hz=options.band_hz)
    stages.seconds["frequency response"] = time.perf_counter() - began
    transfer = stages.run("transfer functions", 0.3, lambda: fit_transfer_functions(measured, options.modes))
    validation = stages.run("validation", 0.6, lambda: validate(_there(transfer)), [transfer])
    drives = stages.run("inverse eigenvalue problem", 0.62, lambda: identify_drives(_there(transfer)), [transfer])
    remarks = list(measured.remarks)
    if controller is None:
        remarks.append(
            f"no controller file (no {CONTROLLER} beside the campaign): the poses are averaged as in open loop"
        )
    grey = stages.run(
        "grey box", 0.65, lambda: _grey_box(campaign.identification, robot, measured, drives, controller, options, tell)
    )
    return MotorIdentification(
        Path(source), robot, options, measured, transfer, validation, drives, grey,
        tuple(stages.left_out), tuple(remarks), stages.seconds,
    )  # fmt: skip


def _there(result: T | None) -> T:
    assert result is not None
    return result


def _controller(campaign: Path, file: Path | None) -> CS8 | None:
    from rx90b_flex.simulate.cs8 import load_cs8

    beside = campaign.parent / CONTROLLER
    if file is not None:
        return load_cs8(file)
    return load_cs8(beside) if beside.exists() else None


def feedback_of(controller: CS8, joints: tuple[str, ...]) -> Feedback:
    """Feedback torque against drive acceleration of independent PID controllers, ``(K_p + K_v s + K_i / s) / s^2``.

    With the current loop's lag and half a period of the zero-order hold.
    """
    own = controller.for_joints(joints).joints
    position, velocity, integral = (
        np.array([getattr(j, f"{x}_gain") for j in own]) for x in ("position", "velocity", "integral")
    )

    def feedback(hz: Array) -> ComplexArray:
        s = 2j * np.pi * np.asarray(hz, dtype=float)[:, None]
        lag = np.exp(-0.5 * controller.period * s)
        if controller.current_bandwidth_hz > 0.0:
            lag = lag / (1.0 + s / (2.0 * np.pi * controller.current_bandwidth_hz))
        gain = (position + velocity * s + integral / s) / s**2 * lag
        return np.asarray(gain[:, :, None] * np.eye(len(joints)))

    return feedback


def mean_motion(recordings: Iterable[Recording], joints: tuple[str, ...]) -> Array:
    """One period of the drives' mean motion over recordings, shape (N, joints of the robot), rad; joints not recorded at zero."""
    periods = []
    for r in recordings:
        size = r.period_samples or r.samples
        whole = r.samples // size * size
        periods.append(r.position[:whole].reshape(-1, size, len(r.joints)).mean(axis=0))
        names = r.joints
    mean = np.mean(periods, axis=0)
    out = np.zeros((len(mean), len(joints)))
    out[:, [joints.index(name) for name in names]] = mean
    return out


def _grey_box(
    recordings: tuple[Recording, ...],
    robot: Robot,
    measured: MeasuredResponse,
    drives: DriveIdentification | None,
    controller: CS8 | None,
    options: Options,
    tell: Progress,
) -> GreyBox:
    motion = mean_motion(recordings, robot.joints)
    plain = {f.name: getattr(measured, f.name) for f in dataclasses.fields(FrequencyResponse)}
    response = FrequencyResponse(**{**plain, "pose": motion.mean(axis=0)})
    return grey_box(
        robot,
        response,
        band_hz=options.band_hz,
        start=_start(robot, drives),
        starts=options.starts,
        seed=options.seed,
        link_mass_std=options.link_mass_std,
        bending_alike_std=options.bending_alike_std,
        along=[poses_along(motion)],
        feedback=None if controller is None else feedback_of(controller, measured.joints),
        torques=[measured.torque],
        progress=lambda text, part: tell(text, 0.65 + 0.3 * part),
    )


def _start(robot: Robot, drives: DriveIdentification | None) -> dict[str, float]:
    """Drive stiffness and inertia from poles and zeros, where they could be right."""
    out: dict[str, float] = {}
    if drives is None:
        return out
    declared = {(e.type_name(), e.joints): e.coefficients[0] for e in robot.effects if len(e.coefficients)}
    for joint, found in zip(drives.joints, drives.drives, strict=True):
        for kind, effect, value in (
            ("drive_stiffness", "drive_flexibility", found.stiffness),
            ("drive_inertia", "drive_inertia", found.inertia),
        ):
            usual = declared.get((effect, (joint,)))
            if usual is not None and LOW * usual < value < HIGH * usual:
                out[f"{joint}.{kind}"] = float(value)
    return out


# ---- files ----------------------------------------------------------------------------------------------------


def frf_json(result: MotorIdentification) -> dict[str, Any]:
    """The content of ``frf.json``.

    ``frequency_response``: lists over lines, then rows (accelerations), then columns (torques), rad/s^2 per N m.
    ``transfer_functions``, ``drives`` and ``grey_box`` are null where ``left_out`` says why. Each parameter has value, std and unit;
    of the grey box also its 95 % interval and whether the data determine it.
    """
    measured, options = result.measured, result.options
    noise = measured.noise_covariance
    return {
        "schema": 1,
        "campaign": result.campaign.name,
        "robot": result.robot.name,
        "joints": list(measured.joints),
        "pose_rad": measured.pose.tolist(),
        "band_hz": list(options.band_hz),
        "frequency_response": {
            "hz": measured.hz.tolist(),
            "real": measured.value.real.tolist(),
            "imag": measured.value.imag.tolist(),
            "std": measured.std().tolist(),
            "noise_std": None if noise is None else _std(noise, measured.value.shape).tolist(),
            "degrees_of_freedom": measured.degrees_of_freedom if np.isfinite(measured.degrees_of_freedom) else None,
            "realisations": len(measured.realisations),
            "periods": measured.periods,
            "experiments": int(measured.torque.shape[2]),
        },
        "transfer_functions": _transfer_json(result),
        "drives": _drives_json(result.drives),
        "grey_box": _grey_json(result.grey),
        "left_out": [{"stage": x.stage, "why": x.why} for x in result.left_out],
        "remarks": list(result.remarks),
    }


def _std(covariance: ComplexArray, shape: tuple[int, ...]) -> Array:
    return np.asarray(np.sqrt(np.einsum("faa->fa", covariance).real).reshape(shape))


def _quantity(value: float, std: float, unit: str) -> dict[str, Any]:
    return {"value": float(value), "std": float(std), "unit": unit}


def _transfer_json(result: MotorIdentification) -> dict[str, Any] | None:
    fit, tests = result.transfer, result.validation
    if fit is None:
        return None
    zeros = {}
    for j, joint in enumerate(fit.response.joints):
        hz, std = fit.antiresonances(j)
        zeros[joint] = [_quantity(f, s, "Hz") for f, s in zip(hz, std, strict=True)]
    both = zip(fit.resonances_hz, fit.resonances_std_hz(), fit.model.damping_ratio, strict=True)
    return {
        "resonances": [{**_quantity(f, s, "Hz"), "damping_ratio": float(z)} for f, s, z in both],
        "antiresonances": zeros,
        "cost": float(fit.cost),
        "validation": None
        if tests is None
        else [{"test": c.name, "passed": bool(c.passed), "found": c.found, "implies": c.implies} for c in tests.checks],
    }


def _drives_json(drives: DriveIdentification | None) -> dict[str, Any] | None:
    if drives is None:
        return None
    return {
        joint: {
            "inertia": _quantity(d.inertia, d.inertia_std, "kg m^2"),
            "stiffness": _quantity(d.stiffness, d.stiffness_std, "N m/rad"),
            "modes": int(modes),
        }
        for joint, d, modes in zip(drives.joints, drives.drives, drives.modes, strict=True)
    }


def _grey_json(grey: GreyBox | None) -> dict[str, Any] | None:
    if grey is None:
        return None
    return {
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
) -> Path:
    """Write ``frf.json``, the robot with the grey box's values, and what else is given; all or nothing."""
    from rx90b_flex.export import save_robot

    folder = Path(folder)

    def fill(at: Path) -> None:
        (at / "frf.json").write_text(json.dumps(frf_json(result), allow_nan=False) + "\n", encoding="utf-8")
        if result.grey is not None:
            save_robot(result.grey.robot, at, allow_inconsistent=True)
        for write in extra:
            write(result, at)

    fill_folder(folder, fill)
    return folder
