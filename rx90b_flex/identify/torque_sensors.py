"""What the torque sensors behind the gears have to do with their motors, and which of them a fit may use."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import CORRELATION_S
from rx90b_flex.identify.linear_fit import LinearFit
from rx90b_flex.signals import Campaign, Recording, lowpass, motion
from rx90b_flex.signals.filters import minimum_samples, noise_cutoff_hz

MOVING = 0.03  # of a joint's fastest velocity: below it the sign of friction is not known
# above which it does not change with it: friction rises over some speeds, and a fit that sees them puts it on the gain. What a gain
# changes by between the two is what it may still be off
SLIDING, NEARLY = 0.2, 0.1
EXPLAINED = 0.5  # share of a sensor's variance that the motor and the motion have to explain
EXCHANGED = 0.5  # of what is left with the joint's own motor: what another's motor has to come below
AHEAD = -0.05  # of a sensor's variation: friction that it shows ahead of its motor
COPY = 1e-6  # of the sensor: so little is left of two columns of one signal alone
ENOUGH = 20_000  # samples of one that tell whose a sensor is
FEWEST = 64  # samples of a recording that are looked at
# of a torque over another of the same joint, below and above which it is no motor constant: amperes or the motor's side of a gear,
# which are less, or N cm and N mm, which are 100 and 1000 times as much. In between the factor can be identified
MOTOR_GAIN = (1 / 18, 72.0)
CALIBRATION = 0.05  # relative error of a sensor's gain that is an ordinary one; more is worth a name of its own
DETERMINED = 3.0  # standard deviations by which a gain has to be off to be corrected


@dataclass(frozen=True)
class SensorFit:
    """A torque sensor as ``gain * motor torque - J a - viscous v - dry sign(v) + zero``.

    Attributes
    ----------
    joint : str
        Whose sensor it is.
    motor : str
        The joint whose motor and motion explain it.
    gain : float
        N m of the sensor per unit of the motor's torque.
    left : float
        Root mean square of the residual over the standard deviation of the sensor.
    drag : float
        Friction that the motor overcomes before the sensor, at the mean speed, over the same.
    """

    joint: str
    motor: str
    gain: float
    left: float
    drag: float


@dataclass(frozen=True)
class WrongSensor:
    """A torque sensor that a fit may not use.

    Attributes
    ----------
    kind : "swapped_columns", "reversed_sign", "unit" or "unrelated"
    joints : tuple of str
    factor : float or None
        For a unit, its size over the true one.
    message : str
        One sentence with the cure.
    """

    kind: str
    joints: tuple[str, ...]
    factor: float | None
    message: str


def sensed_joints(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Joints of which any recording has a torque sensor that changes."""
    sensed = [r.joint_torque for r in recordings if r.joint_torque is not None]
    moving = np.any([np.ptp(x, axis=0) > 0.0 for x in sensed], axis=0) if sensed else []
    return tuple(j for j, moves in zip(recordings[0].joints, moving, strict=False) if moves)


def sensors_to_use(campaign: Campaign) -> tuple[str, ...]:
    """Joints whose torque sensors fit their motors, so that a fit may use them beside the motors."""
    wrong = {j for w in wrong_sensors(campaign) for j in w.joints}
    return tuple(j for j in sensed_joints(campaign.identification) if j not in wrong)


def calibrated(campaign: Campaign) -> tuple[Campaign, tuple[str, ...]]:
    """A campaign whose torque sensors agree with their motors within the ordinary error of a calibration, and what was done.

    Two torques of one joint that differ by a small factor would otherwise leave a residual in both that follows the load, for
    which any effect with the load's shape would be a name. A larger difference stays: it is a `torque_gain` to be found.
    """
    gains = {j: told for j in sensors_to_use(campaign) if (told := sensor_gain(campaign.identification, j)) is not None}
    off = {j: g for j, (g, std) in gains.items() if DETERMINED * std < abs(g - 1.0) < CALIBRATION}
    if not off:
        return campaign, ()
    by = np.array([1.0 / off.get(j, 1.0) for j in campaign.joints])
    runs = tuple(
        r if r.joint_torque is None else dataclasses.replace(r, joint_torque=r.joint_torque * by)
        for r in campaign.recordings
    )
    words = tuple(
        f"The torque sensor of {j} reads {g:.4g} ± {gains[j][1]:.1g} times its motor's torque, within the {CALIBRATION:.0%} of a "
        "calibration: it is divided by that. Which of the two is off, the log does not say."
        for j, g in off.items()
    )
    return dataclasses.replace(campaign, recordings=runs), words


def wrong_sensors(campaign: Campaign) -> tuple[WrongSensor, ...]:
    """Torque sensors that do not belong to their motors, by recordings with role identification."""
    of_current = [j for j, c in zip(campaign.joints, campaign.torque_constants or (), strict=False) if c is None]
    found: dict[tuple[str, ...], WrongSensor] = {}
    for joint, fits in _fits(campaign.identification).items():
        if joint not in fits:
            continue
        own, best = fits[joint], min(fits.values(), key=lambda f: f.left)
        wrong = _exchanged(own, best) or _wrong(own, unit_known=joint not in of_current)
        if wrong is not None:
            found.setdefault(tuple(sorted(wrong.joints)), wrong)
    return tuple(found.values())


def _exchanged(own: SensorFit, best: SensorFit) -> WrongSensor | None:
    if not best.left < EXCHANGED * own.left:
        return None
    text = (
        f"The torque sensor of {own.joint} (joint_torque) follows the motor of {best.motor} and not its own: columns exchanged? "
        "Neither sensor is used."
    )
    return WrongSensor("swapped_columns", (own.joint, best.motor), None, text)


def _wrong(fit: SensorFit, *, unit_known: bool) -> WrongSensor | None:
    name = f"The torque sensor of {fit.joint} (joint_torque)"
    if not fit.left**2 < 1.0 - EXPLAINED:
        text = (
            f"{name} has little to do with its motor's torque and motion, which leave {fit.left:.0%} of it: check that the column "
            "is this joint's torque behind the gear, and of the same run. It is not used."
        )
        return WrongSensor("unrelated", (fit.joint,), None, text)
    if fit.left < COPY:
        text = (
            f"{name} is its motor's torque over again, and tells nothing about the gear between them. It is not used."
        )
        return WrongSensor("swapped_columns", (fit.joint,), None, text)
    if fit.gain < 0.0:
        text = f"{name} has the sign of its motor's torque reversed: give its column as -column. It is not used."
        return WrongSensor("reversed_sign", (fit.joint,), -1.0, text)
    if fit.drag < AHEAD:
        text = (
            f"{name} shows friction that its motor's torque lacks, although the gear lies between them: are the columns of torque "
            "and joint_torque exchanged? It is not used."
        )
        return WrongSensor("swapped_columns", (fit.joint,), None, text)
    if unit_known and not MOTOR_GAIN[0] < fit.gain < MOTOR_GAIN[1]:
        text = f"{name} is {fit.gain:.3g} times its motor's torque: another unit. Bring it to N m. It is not used."
        return WrongSensor("unit", (fit.joint,), fit.gain, text)
    return None


def sensor_gain(recordings: Sequence[Recording], joint: str) -> tuple[float, float] | None:
    """N m of a joint's torque sensor per unit of its motor's torque, and its standard deviation; None where the motion tells none."""
    place = recordings[0].joints.index(joint)
    runs = _filtered(recordings)
    rows, slower = (_rows(runs, place, place, least) for least in (SLIDING, NEARLY))
    if rows is None or slower is None:
        return None
    columns, sensor, spans = rows
    fit = LinearFit.of(columns, sensor)
    covariance = fit.coloured_covariance(spans, int(CORRELATION_S * runs[0].rate_hz))
    changed = fit.theta[0] - LinearFit.of(*slower[:2]).theta[0]
    return float(fit.theta[0]), float(np.sqrt(max(covariance[0, 0], 0.0) + changed**2))


def _fits(recordings: Sequence[Recording]) -> dict[str, dict[str, SensorFit]]:
    """Of each torque sensor with each motor of a joint that has one; nothing where the motion does not tell."""
    sensed = sensed_joints(recordings)
    runs = [r.thinned() for r in _filtered(recordings)] if sensed else []
    joints = recordings[0].joints
    out: dict[str, dict[str, SensorFit]] = {}
    for sensor in sensed:
        for motor in sensed:
            rows = _rows(runs, joints.index(motor), joints.index(sensor))
            if rows is not None:
                fit = LinearFit.of(*rows[:2])
                left = float(np.sqrt(np.mean(fit.residual**2)) / np.std(rows[1]))
                drag = -(fit.theta[2] * np.abs(rows[0][:, 2]).mean() + fit.theta[3]) / np.std(rows[1])
                found = SensorFit(sensor, motor, float(fit.theta[0]), left, float(drag))
                out.setdefault(sensor, {})[motor] = found
    return out


@dataclass(frozen=True, eq=False)
class _Filtered:
    """A recording that has torque sensors, low-passed: torques, sensors, velocities and accelerations, each (N, joints)."""

    torque: Array
    sensor: Array
    velocity: Array
    acceleration: Array
    rate_hz: float

    def thinned(self) -> _Filtered:
        """Of a long recording not every sample, which is all that a comparison needs."""
        step = 1 + len(self.torque) // ENOUGH
        torque, sensor = self.torque[::step], self.sensor[::step]
        return _Filtered(torque, sensor, self.velocity[::step], self.acceleration[::step], self.rate_hz / step)


def _filtered(recordings: Sequence[Recording]) -> list[_Filtered]:
    """Those that have sensors and are long enough for the filter."""
    out = []
    for r in recordings:
        rate = r.sample_rate_hz
        if r.joint_torque is None or len(r.position) < FEWEST:
            continue
        cutoff = min(noise_cutoff_hz(r.position, rate) or np.inf, rate / 10.0)
        if len(r.position) < minimum_samples(cutoff, rate):
            continue
        moved = motion(r.position, rate, cutoff)
        torque, sensor = (lowpass(x, cutoff, rate) for x in (r.torque, r.joint_torque))
        out.append(_Filtered(torque, sensor, moved.velocity, moved.acceleration, rate))
    return out


def _rows(
    runs: Sequence[_Filtered], motor: int, sensor: int, least: float = MOVING
) -> tuple[Array, Array, tuple[slice, ...]] | None:
    """Columns (N, 5) and a sensor (N,) at the samples where a joint moves by this part of its speed, and those of each recording.

    None where the joint never moves or the sensor never changes.
    """
    columns, target, ends = [], [], [0]
    for r in runs:
        v = r.velocity[:, motor]
        moving = np.abs(v) > least * np.abs(v).max()
        if not moving.any() or not np.ptp(r.sensor[:, sensor]) > 0.0:
            continue
        x = np.column_stack([r.torque[:, motor], r.acceleration[:, motor], v, np.sign(v), np.ones(len(v))])
        columns.append(x[moving])
        target.append(r.sensor[moving, sensor])
        ends.append(ends[-1] + len(target[-1]))
    if not target or not np.ptp(together := np.concatenate(target)) > 0.0:
        return None
    return np.concatenate(columns), together, tuple(slice(a, b) for a, b in pairwise(ends))
