"""Reference trajectories at the rate that the controller takes them, with the torques fed forward."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.excitation import harmonic_motion, multisine, smoothed_square
from rx90b_flex.robot import Robot
from rx90b_flex.signals.recording import Recording
from rx90b_flex.tip import jacobian_at

RATE_HZ = 250.0
PERIOD_S = 4.096  # of the experiments of sections 4.2.2 and 6.6.2
TAIL_S = 0.16  # simulated beyond the last period: more than half the length of the anti-alias filter


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What a robot is asked to do.

    Attributes
    ----------
    name : str
    joints : tuple of str
    rate_hz : float
    position, velocity : array, shape (N, joints)
        References r and r', rad and rad/s.
    feedforward : array, shape (N, joints), or None
        N m, joint side.
    period_s : float or None
        Where it repeats.
    note : str
        What whoever wrote it should look at; empty where there is nothing.
    """

    name: str
    joints: tuple[str, ...]
    rate_hz: float
    position: Array
    velocity: Array
    feedforward: Array | None = None
    period_s: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "feedforward"):
            value = getattr(self, name)
            if value is None:
                continue
            array = np.asarray(value, dtype=float)
            expected = (len(self.position), len(self.joints))
            if array.shape != expected or not np.isfinite(array).all():
                raise ValueError(
                    f"trajectory {self.name!r}: {name} has shape {array.shape}; expected {expected}, finite numbers"
                )
            object.__setattr__(self, name, array)

    @property
    def duration_s(self) -> float:
        """N sample periods, s."""
        return len(self.position) / self.rate_hz

    @property
    def torque(self) -> Array:
        """Feed-forward torque, zero where there is none, shape (N, joints)."""
        return np.zeros_like(self.position) if self.feedforward is None else self.feedforward

    def with_feedforward(self, feedforward: Array | None, name: str | None = None) -> Trajectory:
        """The same references with another torque fed forward."""
        return dataclasses.replace(self, feedforward=feedforward, name=self.name if name is None else name)

    def at(self, rows: slice | Indices) -> Trajectory:
        """Some of the samples, in that order."""
        torque = None if self.feedforward is None else self.feedforward[rows]
        return dataclasses.replace(self, position=self.position[rows], velocity=self.velocity[rows], feedforward=torque)

    def repeated(self, times: int) -> Trajectory:
        """The trajectory that many times in a row."""
        return self.at(np.tile(np.arange(len(self.position)), times))

    def with_tail(self) -> Trajectory:
        """The trajectory and, where it repeats, the start of another round: `TAIL_S`, into which a log's filter reaches."""
        if self.period_s is None:
            return self
        count = len(self.position)
        return self.at(np.arange(count + round(TAIL_S * self.rate_hz)) % count)

    def part(self, start_s: float, end_s: float) -> Trajectory:
        """The samples from start to end."""
        rows = slice(round(start_s * self.rate_hz), round(end_s * self.rate_hz))
        return dataclasses.replace(self.at(rows), period_s=None)


def from_recording(recording: Recording) -> Trajectory:
    """The references and feed-forward torques that a recording was made with."""
    if recording.reference_position is None or recording.reference_velocity is None:
        raise ValueError(f"recording {recording.name!r} has no reference_position and reference_velocity")
    return Trajectory(
        recording.name,
        recording.joints,
        recording.sample_rate_hz,
        recording.reference_position,
        recording.reference_velocity,
        recording.feedforward_torque,
        recording.period_s,
    )


# ---- the straight line of section 4.2.2 -----------------------------------------------------------------------

# The source prints the line's length, that it is horizontal, and (figures 4.6, 4.7) that it takes 2 s with joints 2 and 3
# reversing at 1 s. The rest is chosen. Half-way it passes across the robot's front, near enough for joint 1 to sweep through
# 135 degrees: that makes the reversal. Height and ramp are those at which the tip stays in the range of figure 4.7's axes,
# -1 to 0 mm up and 0 to 1 mm across, but for the first vibration: a shorter ramp or a higher line shakes it more (0.3 s and
# 0.55 m: by 1.9 mm), and with ramps of 0.3 s their ends kick the tip like the reversal, which the source does not mention.
LINE_LENGTH = 1.7  # m
LINE_TIME = 2.0  # s
LINE_DISTANCE = 0.35  # m, from joint 1's axis
LINE_HEIGHT = 0.35  # m, above the floor
# s of constant acceleration at either end; it starts with a jump in acceleration, which shakes the robot.
LINE_RAMP = 0.5


def line_profile(time: Array, length: float, duration: float, ramp: float) -> tuple[Array, Array]:
    """Distance and speed along a line: constant acceleration, constant speed, constant deceleration."""
    speed = length / (duration - ramp)
    t = np.clip(time, 0.0, duration)
    rate = speed * np.clip(np.minimum(t, duration - t) / ramp, 0.0, 1.0)
    early, late = 0.5 * speed * t**2 / ramp, length - 0.5 * speed * (duration - t) ** 2 / ramp
    middle = speed * (t - 0.5 * ramp)
    return np.where(t < ramp, early, np.where(t > duration - ramp, late, middle)), rate


def straight_line(
    robot: Robot,
    start: Sequence[float] = (LINE_DISTANCE, -0.5 * LINE_LENGTH, LINE_HEIGHT),
    end: Sequence[float] = (LINE_DISTANCE, 0.5 * LINE_LENGTH, LINE_HEIGHT),
    *,
    duration: float = LINE_TIME,
    ramp: float = LINE_RAMP,
    guess: Sequence[float] = (-1.18, 0.6, 1.2),
    rate_hz: float = RATE_HZ,
) -> Trajectory:
    """The tip along a straight line; by default the 1.7 m horizontal line of figure 4.6.

    The first three joints move the tip, by inverse kinematics of the rigid robot; the others stay at zero.

    Parameters
    ----------
    start, end : three numbers, m, in the base frame
    duration, ramp : float, s
        The speed rises and falls over `ramp` with constant acceleration.
    guess : three angles near the start, rad; decides between elbow up and down.

    Raises
    ------
    ValueError
        A point that the robot cannot reach.
    """
    a, b = (np.asarray(x, dtype=float) for x in (start, end))
    length = float(np.linalg.norm(b - a))
    count = round(duration * rate_hz) + 1
    distance, speed = line_profile(np.arange(count) / rate_hz, length, duration, ramp)
    along = (b - a) / length
    points = a + distance[:, None] * along
    position, velocity = inverse_kinematics(robot, points, speed[:, None] * along, guess)
    return Trajectory("line", robot.joints, rate_hz, position, velocity)


def inverse_kinematics(robot: Robot, points: Array, rates: Array, guess: Sequence[float]) -> tuple[Array, Array]:
    """Angles and speeds of the first three joints that carry the rigid robot's tip along points; others zero.

    Parameters
    ----------
    points, rates : array, shape (N, 3), m and m/s

    Returns
    -------
    position, velocity : array, shape (N, joints)
    """
    model = robot.tree
    data = model.createData()
    tip = model.getFrameId(robot.tip_frame)
    moving = min(3, model.nv)
    q = np.zeros(model.nv)
    q[:moving] = np.asarray(guess, dtype=float)[:moving]
    position, velocity = np.zeros((len(points), model.nv)), np.zeros((len(points), model.nv))
    for k, (point, rate) in enumerate(zip(points, rates, strict=True)):
        for _ in range(50):
            jacobian = jacobian_at(model, data, q, tip)[:3, :moving]
            pin.updateFramePlacements(model, data)
            missing = point - data.oMf[tip].translation
            if np.abs(missing).max() < 1e-12:
                break
            step = np.linalg.lstsq(jacobian, missing, rcond=None)[0]
            q[:moving] += step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        else:
            if np.abs(missing).max() > 1e-9:
                where = ", ".join(f"{x:.3f}" for x in point)
                raise ValueError(f"{robot.name} cannot reach the point ({where}) m with {robot.tip_frame!r}")
        position[k] = q
        velocity[k, :moving] = np.linalg.lstsq(jacobian, rate, rcond=None)[0]
    return position, velocity


# ---- excitation of section 4.2.2 ------------------------------------------------------------------------------

SINE_HARMONICS = (2, 3, 2, 3)
SINE_AMPLITUDE = math.pi / 4
MULTISINE_LINES = 72
MULTISINE_BAND_HZ = (1.0, 110.0)


def sine_excitation(
    robot: Robot, rng: np.random.Generator, *, periods: int = 1, rate_hz: float = RATE_HZ
) -> Trajectory:
    """The identification experiment of section 4.2.2.

    Joints 1-4 follow the 2nd, 3rd, 2nd and 3rd harmonic of a sine of 4.096 s, amplitude and offset pi/4; a multisine of
    72 equally spaced lines from 1 to 110 Hz (on the grid of the period) is fed forward to each. Its peak is not printed for
    this experiment: that of section 6.6.2.
    """
    samples = round(PERIOD_S * rate_hz)
    harmonic = np.resize(SINE_HARMONICS, len(robot.joints)) * (np.arange(len(robot.joints)) < len(SINE_HARMONICS))
    angle = 2.0 * np.pi * harmonic * np.arange(samples)[:, None] / samples
    moves = harmonic > 0
    position = SINE_AMPLITUDE * (np.sin(angle) + moves)
    velocity = SINE_AMPLITUDE * np.cos(angle) * 2.0 * np.pi * harmonic / PERIOD_S
    lines = np.round(np.linspace(*MULTISINE_BAND_HZ, MULTISINE_LINES) * PERIOD_S).astype(int)
    feedforward = multisine(list(lines), samples, 1.0, rng, len(robot.joints)) * FEEDFORWARD_PEAK * moves
    once = Trajectory("excitation", robot.joints, rate_hz, position, velocity, feedforward, PERIOD_S)
    return once.repeated(periods)


# ---- for any arm ----------------------------------------------------------------------------------------------


def harmonics(
    robot: Robot,
    rng: np.random.Generator,
    *,
    speed: float = 0.5,
    period_s: float = 10.0,
    periods: int = 1,
    rate_hz: float = RATE_HZ,
) -> Trajectory:
    """A periodic motion within the limits of any robot: random harmonics of every joint (`harmonic_motion`).

    Parameters
    ----------
    speed : float
        Largest velocity over the joint's limit in the URDF.
    """
    time = np.arange(round(period_s * rate_hz)) / rate_hz
    position, velocity, _ = harmonic_motion(robot.tree, time, rng, period_s=period_s, speed=speed)
    return Trajectory("harmonics", robot.joints, rate_hz, position, velocity, None, period_s).repeated(periods)


# ---- square wave in velocity of section 6.6.2 -----------------------------------------------------------------


def horizontal(robot: Robot) -> tuple[float, ...]:
    """The source's pose, one angle a joint, rad: the arm stretched out horizontally, joint 2 at 90 degrees if it turns."""
    return tuple(0.5 * np.pi if k == 1 and not unit.slides else 0.0 for k, unit in enumerate(robot.units))


SQUARE_SPEED = 0.11  # rad/s
SQUARE_ODD_LINES = 9  # choice: odd lines of the velocity that are kept; they give the flanks their slope
FEEDFORWARD_LINES = tuple(2 * k + 1 for k in range(5, 161))
FEEDFORWARD_PEAK = 45.0  # N m


def square_wave(
    robot: Robot,
    pose: Sequence[float] | Array,
    *,
    speed: float = SQUARE_SPEED,
    moving: Sequence[str] | None = None,
    feedforward: Array | None = None,
    rate_hz: float = RATE_HZ,
    period_s: float = PERIOD_S,
    swings: int = 1,
) -> Trajectory:
    """The references of section 6.6.2: a smoothed square wave in velocity about a pose, of odd lines of 1 / 4.096 s
    alone.

    The position swings evenly about `pose`; see `rx90b_flex.excitation.smoothed_square`.

    Parameters
    ----------
    pose : array, shape (joints,), rad
        A stretched horizontal arm in the source: joint_2 at 90 degrees.
    moving : names of the joints that move; all by default.
    feedforward : array, shape (samples of one period, joints), N m, or None
        For example ``multisine(FEEDFORWARD_LINES, ...)``.
    period_s : float, s
        A whole number of samples; a longer one has finer lines.
    swings : int
        To and fro in a period; odd, so that the lines stay odd. More keep the swing of a long period small.
    """
    if swings < 1 or swings % 2 == 0:
        raise ValueError(f"swings is {swings}; expected an odd number, 1 or more")
    samples, least = round(period_s * rate_hz), 4 * swings * SQUARE_ODD_LINES
    if abs(samples - period_s * rate_hz) > 1e-6 * samples or samples < least:
        raise ValueError(
            f"period_s is {period_s:g}: expected a whole number of samples at {rate_hz:g} Hz, {least} or more with swings = {swings}"
        )
    place = np.arange(samples) * swings % samples
    velocity, position = (wave[place] for wave in smoothed_square(samples, SQUARE_ODD_LINES))
    velocity, position = speed * velocity, speed * period_s / (2.0 * np.pi * swings) * position
    moves = np.array([moving is None or joint in moving for joint in robot.joints], dtype=float)
    return Trajectory(
        "square_wave",
        robot.joints,
        rate_hz,
        np.asarray(pose, dtype=float) + position[:, None] * moves,
        velocity[:, None] * moves,
        feedforward,
        period_s,
    )
