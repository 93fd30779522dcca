"""Nonlinear distortion taken out of a frequency response by replaying the experiments on the fitted robot.

What a frequency response of a robot with dry friction differs by from a linear model depends on the excitation alone: repeat the
references and torques fed forward on a simulated robot that is nearly the right one, and its response has nearly the same distortion,
realisation by realisation. With `P_m` measured in realisation m, `S_m` simulated and `L` the response of the simulated robot with
viscous friction at the mean pose,

    P_m - (S_m - L)

is what the real robot would show if its friction were viscous and its pose constant, up to the product of a small distortion and
a small error of the simulated robot. Fitted again, that robot is the better one to replay. Friction is fitted, too: ``P_m - S_m``
changes with m as long as it is wrong, which no linear parameter does.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import joblib
import numpy as np
from scipy.signal import resample

from rx90b_flex.effects import Effect
from rx90b_flex.effects.friction import ViscousFriction, friction_side
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse, _over_realisations, estimate_frequency_response
from rx90b_flex.identify.grey_box import GreyBox, Progress, grey_box
from rx90b_flex.identify.grey_data import FRICTION_ERROR, SMOOTHED, GreyBoxOptions
from rx90b_flex.identify.grey_model import SLOPE, late, response_derivatives
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Recording
from rx90b_flex.signals.filters import periods
from rx90b_flex.simulate import CS8, Trajectory, design_cs8
from rx90b_flex.simulate.perturbation import NEAR_RAD, perturb_lanes
from rx90b_flex.simulate.trajectories import from_recording

STEP = 0.05  # relative, of a friction coefficient, for the derivative of the distortion
# Of the distortion's mean, what a replay is not trusted with: the perturbation method's is 2 to 16 % (by entry) off that of the full
# simulation on the campaign of section 6.6.2.
REPLAY_ERROR = 0.1
# A wrong form of friction leaves a part of the differences between realisations, which is seen, and of the mean, which is not: of
# the mean 1.3 times as large a part, root mean square over entries and forms, at worst 2.9 times (joint 1, which hardly
# vibrates); with Stribeck velocities or powers 30 % off on that campaign.
FORM_ERROR = 2.0
SETTLED = 0.1  # of its standard deviation: where no drive or flexibility parameter changes by more, rounds end
# Bandwidth of what leads a robot that logged torques drive: below the first lines, and settled within a period.
HELD_HZ = 5.0
EVERY = slice(None)  # realisation
FINER = 4  # points of such a torque a sample of the log: straight lines between samples would lose a third at the upper lines
AMPLE = 10.0  # torque limit over the largest torque in such a replay
LARGEST = 0.5  # relative change of a friction coefficient in one round


@dataclass(frozen=True, eq=False)
class Replay:
    """The experiments about one pose, ready to be repeated on a simulated robot without noise.

    Attributes
    ----------
    trajectories : tuple of Trajectory
        One period in which the transient dies and one that counts.
    recordings : tuple of Recording
        The measured ones, in that order; one period of each.
    measured : MeasuredResponse
        Their frequency response.
    controller : CS8
    """

    trajectories: tuple[Trajectory, ...]
    recordings: tuple[Recording, ...]
    measured: MeasuredResponse
    controller: CS8

    @classmethod
    def of(cls, recordings: Sequence[Recording], measured: MeasuredResponse, controller: CS8) -> Replay:
        """From recordings that hold their references.

        Raises
        ------
        ValueError
            No references in a recording, ones of different motions, or no period.
        """
        kept = _used(recordings, measured)
        for r in kept:
            if r.reference_position is None or r.reference_velocity is None or r.period_samples is None:
                raise ValueError(
                    f"recording {r.name!r} lacks references or a period; without them it cannot be replayed"
                )
        first = np.array(kept[0].reference_position)
        apart = [r.name for r in kept if not np.abs(np.array(r.reference_position) - first).max() <= NEAR_RAD]
        if apart:
            raise ValueError(
                f"recordings {kept[0].name!r} and {apart[0]!r} differ in their references; replay one motion at a time"
            )
        sent = tuple(_two_periods(_sent(r, controller.reference_rate_hz)) for r in kept)
        return cls(sent, tuple(_period(r, r, 0) for r in kept), measured, controller)

    @classmethod
    def from_torques(cls, recordings: Sequence[Recording], measured: MeasuredResponse, robot: Robot) -> Replay:
        """With the torques that were logged, whatever controller gave them: neither it nor references are needed.

        What is fed forward is the mean period of the logged torque. A robot that torques alone drive drifts away; so a controller of
        `HELD_HZ` leads it along the motion that was logged with them: it gives nothing where the robot is right.

        Raises
        ------
        ValueError
            A recording without a period.
        """
        kept = _used(recordings, measured)
        for r in kept:
            if r.period_samples is None:
                raise ValueError(f"recording {r.name!r} lacks a period; without it it cannot be replayed")
        samples, period = kept[0].period_samples or 0, kept[0].period_s or 0.0
        rate = FINER * kept[0].sample_rate_hz
        position = np.mean([_mean_period(r.position, samples) for r in kept], axis=0)
        spectrum, hz = np.fft.rfft(position, axis=0), np.arange(samples // 2 + 1)[:, None] / period
        slow = np.where(hz < measured.hz[0], spectrum, 0.0)
        path, speed = (
            _resampled(np.fft.irfft(x, samples, axis=0), FINER * samples) for x in (slow, 2j * np.pi * hz * slow)
        )
        largest = np.max([np.abs(r.torque).max(axis=0) for r in kept], axis=0)
        controller = _leading(robot, position.mean(axis=0), kept[0].sample_rate_hz, AMPLE * float(largest.max()))
        trajectories = []
        for r in kept:
            # all runs share references, as the perturbation method asks: what each differs from them by is fed forward
            apart = np.fft.rfft(_mean_period(r.position, samples), axis=0)[1:] - slow[1:]
            back = np.vstack([np.zeros(apart.shape[1]), _gains(controller, hz[1:, 0]) * apart])
            ordered = _mean_period(r.torque, samples) + np.fft.irfft(back, samples, axis=0)
            torque = _resampled(ordered, FINER * samples)
            once = Trajectory(r.name, r.joints, rate, path, speed, torque, period)
            trajectories.append(_two_periods(once))
        return cls(tuple(trajectories), tuple(_period(r, r, 0) for r in kept), measured, controller)

    def by_steps(self, response: Callable[[Array], ComplexArray]) -> ComplexArray:
        """What a simulation shows of a linear response: its steps end at the controller's samples, of h seconds.

        The implicit midpoint rule at a frequency w has the robot's compliance at tan(w h/2)/(h/2), over cos(w h/2) for a torque that
        is held along a step, and once more for one that is logged as the mean of the steps before and after.

        Parameters
        ----------
        response : of Hz, (F,), to drive accelerations over torques, (F, n, n)
        """
        half = np.pi * self.measured.hz * self.controller.period
        return response(np.tan(half) / (np.pi * self.controller.period)) * ((half / np.sin(half)) ** 2)[:, None, None]

    def responses(self, robot: Robot) -> ComplexArray:
        """Response of each realisation on that robot, shape (R, F, n, n)."""
        own = estimate_frequency_response(
            self._simulated(robot), joints=self.measured.joints, hz=self.measured.hz, places=self.measured.places
        )
        if own.realisations.shape != self.measured.realisations.shape:
            raise ValueError(
                f"replayed, {own.realisations.shape[:2]} realisations and lines are left of {self.measured.realisations.shape[:2]}"
            )
        return own.realisations

    def _simulated(self, robot: Robot) -> list[Recording]:
        runs = perturb_lanes(robot, self.controller, self.trajectories)
        for run in runs:
            if run.ended is not None:
                raise ValueError(f"replay of {run.trajectory.name!r} on the fitted robot: {run.ended}")
        return [_period(r, run.recording, 1) for r, run in zip(self.recordings, runs, strict=True)]

    def torques_off(self, robot: Robot, delay_s: float) -> Array:
        """How far each measured joint's torques on that robot are from those logged, at all lines, over these; (joints,).

        Logged torques are `delay_s` late. Apart from what is wrong with the robot it is what is wrong with the controller.
        """
        hz = self.measured.hz
        lines = np.rint(hz * (self.recordings[0].period_s or 0.0)).astype(int)
        columns = [self.recordings[0].joints.index(joint) for joint in self.measured.joints]
        pairs = zip(self._simulated(robot), self.recordings, strict=True)
        both = [[np.fft.rfft(x.torque[:, columns], axis=0)[lines] for x in pair] for pair in pairs]
        ordered, logged = np.moveaxis(np.array(both), 1, 0)
        logged = logged * late(hz, delay_s)[:, :, 0]
        apart, size = ((np.abs(x) ** 2).sum(axis=(0, 1)) for x in (ordered - logged, logged))
        return np.asarray(np.sqrt(apart / size))


def _used(recordings: Sequence[Recording], measured: MeasuredResponse) -> tuple[Recording, ...]:
    names = {p.recording for p in measured.places}
    return tuple(r for r in recordings if r.name in names)


def _mean_period(signal: Array, samples: int) -> Array:
    return np.asarray(periods(signal, samples).mean(axis=0))


def _two_periods(once: Trajectory) -> Trajectory:
    """Of one period: one in which the transient dies, one that counts, and a tail."""
    return dataclasses.replace(once.repeated(2).with_tail(), period_s=None)


def _leading(robot: Robot, pose: Array, log_hz: float, limit: float) -> CS8:
    """A slow controller without quantisation, whose log has a given rate."""
    designed = design_cs8(robot, pose, bandwidth_hz=HELD_HZ, integral_hz=0.1 * HELD_HZ).ideal()
    reference = FINER * log_hz
    return dataclasses.replace(
        designed,
        joints=tuple(dataclasses.replace(j, torque_limit=limit) for j in designed.joints),
        reference_rate_hz=reference,
        controller_rate_hz=reference * max(1, round(designed.controller_rate_hz / reference)),
        log_rate_hz=log_hz,
        log_cutoff_hz=0.4 * log_hz,
    )


def _gains(controller: CS8, hz: Array) -> ComplexArray:
    """Ordered torque over angle error, (F, joints)."""
    s = 2j * np.pi * hz[:, None]
    gains = (controller.column(f"{name}_gain") for name in ("position", "velocity", "integral"))
    position, velocity, integral = gains
    return np.asarray(position + velocity * s + integral / s)


def _sent(recording: Recording, rate_hz: float) -> Trajectory:
    """One period of what was sent, at the rate at which a controller takes references."""
    period, samples = recording.period_s or 0.0, recording.period_samples or 0
    count = round(period * rate_hz)
    if abs(period * rate_hz - count) > 1e-6 * max(count, 1):
        raise ValueError(
            f"recording {recording.name!r}: a period of {period:g} s holds no whole number of references at {rate_hz:g} Hz"
        )
    logged = from_recording(recording)
    parts = (logged.position, logged.velocity, logged.torque)
    position, velocity, torque = (_resampled(x[:samples], count) for x in parts)
    return Trajectory(recording.name, recording.joints, rate_hz, position, velocity, torque, period)


def _resampled(period: Array, count: int) -> Array:
    """One period (N, n) with so many samples, by its Fourier series."""
    return period if len(period) == count else np.asarray(resample(period, count, axis=0))


def _period(measured: Recording, of: Recording, number: int) -> Recording:
    """One period of angles and torques, as if the measured recording were no longer; at its rate."""
    samples, own = measured.period_samples or 0, round((measured.period_s or 0.0) * of.sample_rate_hz)
    rows = slice(number * own, (number + 1) * own)
    torque = measured.feedforward_torque
    position, moved = (_resampled(x[rows], samples) for x in (of.position, of.torque))
    return Recording(
        measured.name, measured.role, measured.time[:samples], measured.sample_rate_hz, measured.joints, position, moved,
        feedforward_torque=None if torque is None else torque[:samples], period_s=measured.period_s,
    )  # fmt: skip


def linear_response(
    robot: Robot, joints: Sequence[str], pose: Array, slopes: dict[str, float], hz: Array
) -> ComplexArray:
    """L: the robot at rest at a pose, its friction viscous with given slopes (N m s/rad); shape (F, n, n).

    Drives without a slope are held, as in the grey box.
    """
    viscous = [
        ViscousFriction(joint=joint, coefficient=slope, side=friction_side(robot.effects, joint))
        for joint, slope in slopes.items()
    ]
    line = robot.with_effects([*(e for e in robot.effects if not e.traits.is_friction), *viscous])
    at = line.linearize(line.input_matrix @ pose)
    held = [j not in slopes for j in line.joints]
    free = np.flatnonzero(~at.input_matrix[:, held].any(axis=1))
    drives = at.input_matrix[free][:, [line.joints.index(j) for j in joints]]
    M, D, K = (x[np.ix_(free, free)] for x in (at.M, at.D, at.K))
    s = 2j * np.pi * np.asarray(hz, dtype=float)[:, None, None]
    return np.asarray(s**2 * (drives.T @ np.linalg.solve(s**2 * M + s * D + K, drives.astype(complex)[None])))


@dataclass(frozen=True)
class FrictionEstimate:
    """A friction coefficient as the distortion tells it."""

    name: str
    unit: str
    declared: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class ReplayedGreyBox:
    """A grey box on a response without the distortion that a replay explains.

    Attributes
    ----------
    grey : GreyBox
        Its friction slopes belong to the viscous robot that stands for the response: `slopes` where friction is right. What a
        replay is not trusted with of the bias that it took out is part of the intervals.
    robot : Robot
        Drives, flexibilities and links as fitted, friction as told by the distortion.
    responses : tuple of FrequencyResponse
        Of each pose, without the distortion; the covariance holds noise, how far realisations still differ, and what of the
        distortion a replay is not trusted with (`REPLAY_ERROR`, `FORM_ERROR`).
    frictions : tuple of FrictionEstimate
    slopes : dict of joint to float
        N m s/rad, of L in the last round.
    before, after : array, shape (poses, n, n)
        Relative standard deviation of one realisation, median over the lines: as measured, and less the replay.
    torques_off : array, shape (poses, joints)
        `Replay.torques_off` on `robot`.
    rounds : int
    """

    grey: GreyBox
    robot: Robot
    responses: tuple[FrequencyResponse, ...]
    frictions: tuple[FrictionEstimate, ...]
    slopes: dict[str, float]
    before: Array
    after: Array
    torques_off: Array
    rounds: int


def grey_box_by_replay(
    robot: Robot,
    first: GreyBox,
    replay: Replay | Sequence[Replay],
    *,
    rounds: int = 4,
    fit_friction: bool = True,
    jobs: int = 1,
    progress: Progress | None = None,
) -> ReplayedGreyBox:
    """Refine a grey box by replaying its experiments.

    Parameters
    ----------
    robot : Robot
        As declared, the one that `first` was fitted to; all its friction must have values.
    first : GreyBox
        Of the responses as measured; its options hold on, but for starts and errors of model and friction, which are estimated.
    replay : Replay or sequence of them
        One a response of `first`, in that order. Friction is one, at all poses.
    rounds : int
        At most, of simulating, correcting and fitting; they end where parameters change no more (`SETTLED`).
    fit_friction : bool
        Fit the coefficients of the friction on the moving joints to the distortion. It takes one simulation more a coefficient.
    jobs : int
        Processes for simulations that do not wait for each other: those of the poses and of the friction coefficients.
    progress : callable, optional

    Raises
    ------
    ValueError
        A friction without value; replays that do not fit the responses; a replay that ends early.
    """
    if rounds < 1:
        raise ValueError(f"rounds is {rounds}; expected 1 or more")
    tell = progress or (lambda text, part: None)
    at = _poses_replayed(replay, first, jobs)
    joints = at.measured[0].joints
    declared = _frictions(robot, joints)
    friction = _known_friction(declared)
    std, grey, fit = np.zeros_like(friction), first, partial(grey_box, robot, options=_options(first, at.replays))
    by_friction: list[ComplexArray] | None = None
    for number in range(rounds):
        tell(f"replay {number + 1} of {rounds}", number / rounds)
        fitted = _with_friction(grey.robot, joints, friction)
        shifts = at.shifts(grey)
        together = at.simulated([fitted])[0]
        steps = [d * x for d, x in zip(at.by_steps(fitted), shifts, strict=True)]
        simulated = [s * x - d for s, d, x in zip(together, steps, shifts, strict=True)]
        if fit_friction and len(friction):
            if by_friction is None:  # changes little from round to round
                by_friction = at.friction_derivatives(fitted, friction, together)
            simulated, friction, std = at.with_friction_step(fitted, friction, simulated, by_friction, shifts)
        less = at.less(simulated, at.linear(linear_response, fitted, shifts))
        tell(f"fit {number + 1} of {rounds}", (number + 0.7) / rounds)
        last, grey = grey, fit([x.response for x in less], start=_start(grey, at.slopes))
        if _settled(last, grey):
            break
    estimates = _friction_estimates(robot, declared, friction, std)
    grey = _with_what_is_left(grey, less, steps, fit)
    own = {f"{joint}.drive_" for joint in sticking(robot, joints)}
    grey = grey.undetermined([e.name for e in grey.estimates if e.name.startswith(tuple(own))])
    return _refined(grey, at, less, estimates, number + 1)


def sticking(robot: Robot, excited: Sequence[str]) -> tuple[str, ...]:
    """Joints that were not excited and whose drives dry friction holds: what these creep hides what little shows of them."""
    dry = {
        joint
        for e in robot.effects
        if e.traits.is_friction and e.traits.in_dynamics and not e.traits.grows_with_speed
        for joint in e.joints
    }
    return tuple(joint for joint in robot.joints if joint in dry and joint not in excited)


def _poses_replayed(replay: Replay | Sequence[Replay], first: GreyBox, jobs: int) -> PosesReplayed:
    """One replay a response of the fit before, with the means of its poses and, over experiments, of its viscosities."""
    replays = (replay,) if isinstance(replay, Replay) else tuple(replay)
    if len(replays) != len(first.responses):
        raise ValueError(f"{len(replays)} replays; expected {len(first.responses)}, one a response of the grey box")
    slopes = _slopes(first, replays[0].measured.joints)
    return PosesReplayed(replays, tuple(r.pose for r in first.responses), slopes, jobs)


def _refined(
    grey: GreyBox, at: PosesReplayed, less: Sequence[Less], friction: tuple[FrictionEstimate, ...], rounds: int
) -> ReplayedGreyBox:
    """What the last fit found, with how much of the distortion its replay explained."""
    found = _with_friction(grey.robot, at.measured[0].joints, np.array([e.value for e in friction]))
    return ReplayedGreyBox(
        grey,
        found,
        tuple(x.doubted for x in less),
        friction,
        at.slopes,
        np.array([_spread(x.measured.realisations) for x in less]),
        np.array([_spread(x.rest) for x in less]),
        np.array([replay.torques_off(found, delay_of(grey)) for replay in at.replays]),
        rounds,
    )


def _options(first: GreyBox, replays: Sequence[Replay]) -> GreyBoxOptions:
    """Of the fits to all lines that are replayed, with one friction slope a joint."""
    band = min(float(r.measured.hz[0]) for r in replays), max(float(r.measured.hz[-1]) for r in replays)
    fixed = tuple(name for name in first.options.fixed if SLOPE not in name)
    return dataclasses.replace(
        first.options, band_hz=band, starts=0, fixed=fixed, model_error=None, friction_error=None
    )


@dataclass(frozen=True, eq=False)
class PosesReplayed:
    """Replays at all poses, and the linear robot that stands for each: at a pose, with viscous slopes (N m s/rad) by joint."""

    replays: tuple[Replay, ...]
    poses: tuple[Array, ...]
    slopes: dict[str, float]
    jobs: int = 1

    @property
    def measured(self) -> list[MeasuredResponse]:
        return [r.measured for r in self.replays]

    def shifts(self, grey: GreyBox) -> list[ComplexArray]:
        """What torques logged late multiply the response at each pose by; simulated signals are logged together."""
        return [late(m.hz, delay_of(grey)) for m in self.measured]

    def simulated(self, robots: Sequence[Robot]) -> list[list[ComplexArray]]:
        """Realisations' responses of each robot at each pose, (R, F, n, n)."""
        tasks = [joblib.delayed(Replay.responses)(replay, robot) for robot in robots for replay in self.replays]
        found = iter(joblib.Parallel(n_jobs=min(self.jobs, len(tasks)))(tasks))
        return [[next(found) for _ in self.replays] for _ in robots]

    def by_steps(self, robot: Robot) -> list[ComplexArray]:
        """What the simulation's steps add to a linear robot's response at each pose."""
        out = []
        for replay, pose in zip(self.replays, self.poses, strict=True):
            line = partial(linear_response, robot, replay.measured.joints, pose, self.slopes)
            out.append(replay.by_steps(line) - line(replay.measured.hz))
        return out

    def linear(
        self, response: Callable[..., ComplexArray], robot: Robot, shifts: Sequence[ComplexArray]
    ) -> list[ComplexArray]:
        """A linear response at each pose, as late as its torques were logged."""
        each = zip(self.poses, self.measured, shifts, strict=True)
        return [response(robot, m.joints, q, self.slopes, m.hz) * shift for q, m, shift in each]

    def less(self, simulated: Sequence[ComplexArray], lines: Sequence[ComplexArray]) -> list[Less]:
        return [Less(*each) for each in zip(self.measured, simulated, lines, self.poses, strict=True)]

    def friction_derivatives(self, robot: Robot, friction: Array, now: Sequence[ComplexArray]) -> list[ComplexArray]:
        """Derivatives of the realisations' responses by relative changes of friction coefficients, (c, R, F, n, n) at each pose."""
        joints = self.measured[0].joints
        changed = [
            _with_friction(robot, joints, friction + STEP * value * (np.arange(len(friction)) == place))
            for place, value in enumerate(friction)
        ]
        each = zip(now, zip(*self.simulated(changed), strict=True), strict=True)
        return [np.array([(other - at) / STEP for other in others]) for at, others in each]

    def with_friction_step(
        self,
        robot: Robot,
        friction: Array,
        simulated: Sequence[ComplexArray],
        by_friction: Sequence[ComplexArray],
        shifts: Sequence[ComplexArray],
    ) -> tuple[list[ComplexArray], Array, Array]:
        """What was simulated after `friction_step`; the coefficients then, and their standard deviations."""
        changes = [by * x for by, x in zip(by_friction, shifts, strict=True)]
        step, std = self.friction_step(simulated, changes, self.linear(_linear_changes, robot, shifts))
        after = [s + np.tensordot(step, by, 1) for s, by in zip(simulated, changes, strict=True)]
        return after, friction * (1.0 + step), friction * std

    def friction_step(
        self, simulated: Sequence[ComplexArray], by_friction: Sequence[ComplexArray], linear: Sequence[ComplexArray]
    ) -> tuple[Array, Array]:
        """Relative changes of the friction coefficients and their standard deviations, beside the linear parameters.

        Least squares on the realisations' ``P_m - S_m`` as torques, ``P^-1 (P_m - S_m)``: friction is one. A linear parameter adds
        the same to all realisations of a pose, one of `linear`, (p, F, n, n). Arguments hold one array a pose.
        """
        both = [_friction_rows(*each) for each in zip(self.measured, simulated, by_friction, linear, strict=True)]
        slopes, target = (np.concatenate(x) for x in zip(*both, strict=True))
        scale = np.linalg.norm(slopes, axis=0)
        scale[scale == 0.0] = 1.0  # the drive of a joint that is not excited: its inertia shows in no response
        step = np.linalg.lstsq(slopes / scale, target, rcond=1e-6)[0] / scale
        rest = target - slopes @ step
        covariance_of_step = np.linalg.pinv(slopes.T @ slopes) * (rest @ rest) / (len(rest) - len(step))
        own = slice(len(linear[0]), None)
        return np.clip(step[own], -LARGEST, LARGEST), np.sqrt(np.diag(covariance_of_step)[own])


def delay_of(grey: GreyBox) -> float:
    """Of the torques, s; 0 where the grey box has none."""
    return 0.0 if grey.torque_delay is None else grey.torque_delay.value


def _start(grey: GreyBox, slopes: dict[str, float]) -> dict[str, float]:
    """Values where a fit with one slope a joint begins: of the fit before, and those slopes."""
    own = {e.name: e.value for e in grey.estimates if f".{SLOPE}" not in e.name}
    return own | {f"{joint}.{SLOPE}": slope for joint, slope in slopes.items()}


def _known_friction(declared: Sequence[Effect]) -> Array:
    """Coefficients of all frictions, one after another."""
    values = np.array([c for e in declared for c in e.coefficients])
    if not np.isfinite(values).all():
        raise ValueError("a friction coefficient has no value; a replay needs all of them")
    return values


def _with_what_is_left(
    grey: GreyBox, less: Sequence[Less], steps: Sequence[ComplexArray], fit: Callable[..., GreyBox]
) -> GreyBox:
    """With the distortion that a replay is not trusted with in its intervals, and what a simulation's `steps` show.

    As errors of friction's slopes that no residual shows, for inertias take them up; and as what each joint's distortion moves the
    fit by, for itself: the mean square over two halves of the realisations, which holds how far these differ. The values stay those
    of the fit whose errors its residual shows.

    What torques and angles do between samples no log says. A real robot's are as a linear model has them, a simulated one's as its
    steps have them: both are possible.
    """
    left = float(np.sqrt(np.mean([x.left**2 for x in less])))
    friction_error = max(grey.friction_error, min(left, FRICTION_ERROR))
    options = dataclasses.replace(grey.options, model_error=grey.model_error, friction_error=friction_error)

    def again(responses: Sequence[FrequencyResponse]) -> GreyBox:
        return fit(responses, options=options, start={e.name: e.value for e in grey.estimates})

    base = again([x.response for x in less])
    out = grey.as_wide_as(base)
    for joint in range(len(less[0].measured.joints)):
        for first in (0, 1):
            moved = shifts_between(base, again([x.with_distortion_of(joint, slice(first, None, 2)) for x in less]))
            out = out.doubted({name: shift / math.sqrt(2.0) for name, shift in moved.items()})
    responses = [dataclasses.replace(x.response, value=x.response.value - d) for x, d in zip(less, steps, strict=True)]
    return out.doubted(shifts_between(base, again(responses)))


def shifts_between(before: GreyBox, after: GreyBox) -> dict[str, float]:
    """By how much drives and flexibilities moved from one fit to another, logarithms by parameter."""
    now = {e.name: e.value for e in after.estimates if SLOPE not in e.name}
    return {e.name: math.log(now[e.name] / e.value) for e in before.estimates if e.name in now}


def _linear_changes(
    robot: Robot, joints: Sequence[str], pose: Array, slopes: dict[str, float], hz: Array
) -> ComplexArray:
    """Derivatives of L by linear parameters and, last, by a delay of so many milliseconds, (p + 1, F, n, n)."""
    by_delay = 2e-3j * np.pi * hz[:, None, None] * linear_response(robot, joints, pose, slopes, hz)
    return np.concatenate([response_derivatives(robot, joints, pose, slopes, hz), by_delay[None]])


def _settled(before: GreyBox, now: GreyBox) -> bool:
    return all(
        abs(np.log(e.value / before[e.name].value)) <= SETTLED * e.std / e.value
        for e in now.estimates
        if SLOPE not in e.name
    )


def _friction_estimates(
    robot: Robot, declared: Sequence[Effect], values: Array, std: Array
) -> tuple[FrictionEstimate, ...]:
    """Coefficients of frictions beside their declared values."""
    known = [
        (f"{e.label} {name}", robot.unit_of(e, p.unit), float(c))
        for e in declared
        for (name, p), c in zip(e.coefficient_parameters.items(), e.coefficients, strict=True)
    ]
    return tuple(FrictionEstimate(*k, v, s) for k, v, s in zip(known, values.tolist(), std.tolist(), strict=True))


def _spread(realisations: ComplexArray) -> Array:
    deviation = realisations.std(axis=0, ddof=1) / np.abs(realisations.mean(axis=0))
    return np.asarray(np.median(deviation, axis=0))


@dataclass(frozen=True, eq=False)
class Less:
    """A pose's measured response less the distortion that its replay showed.

    Attributes
    ----------
    measured : MeasuredResponse
    simulated : complex array, shape (R, F, n, n)
    line : complex array, shape (F, n, n)
        L.
    pose : array, rad
    """

    measured: MeasuredResponse
    simulated: ComplexArray
    line: ComplexArray
    pose: Array

    @cached_property
    def rest(self) -> ComplexArray:
        """Realisations with L in place of what was simulated."""
        return self.measured.realisations - self.simulated + self.line

    @cached_property
    def left(self) -> Array:
        """Of each joint's distortion, the share that the replay is not trusted with, (n,).

        It is `FORM_ERROR` times the share that it leaves of the differences between realisations, as torques and beyond noise, and
        `REPLAY_ERROR` besides. Where noise hides the distortion, it is all.
        """
        inverse, count = np.linalg.inv(self.line), len(self.rest)
        noise: Array | float = 0.0
        if self.measured.noise_covariance is not None:
            each = self.measured.noise_covariance.reshape(-1, *2 * self.line.shape[1:])
            noise = count * np.einsum("fja,fakbk,fjb->j", inverse, each, inverse.conj()).real

        def size(x: ComplexArray) -> Array:
            return np.maximum(
                (np.abs(inverse @ (x - x.mean(axis=0))) ** 2).sum(axis=(0, 1, 3)) / (count - 1) - noise, 0.0
            )

        after, before = size(self.rest), size(self.measured.realisations)
        share = np.divide(after, before, out=np.ones_like(after), where=before > after)
        return np.minimum(np.sqrt(FORM_ERROR**2 * share + REPLAY_ERROR**2), 1.0)

    @cached_property
    def response(self) -> FrequencyResponse:
        """Their mean. Its covariance is of what each realisation and line has for itself, noise among it.

        As many lines count as give the degrees of freedom that a grey box asks for: compared as torques, unlike responses, they are
        alike across resonances.
        """
        m, (count, _, n, _) = self.measured, self.rest.shape
        neighbours = max(math.ceil((SMOOTHED * n * n / (count - 1) - 1) / 2), _neighbours(m))
        covariance, freedom = _over_realisations(self.rest, neighbours)
        return FrequencyResponse(
            m.hz, self.rest.mean(axis=0), covariance, m.joints, self.pose, m.noise_covariance, freedom
        )

    @property
    def doubted(self) -> FrequencyResponse:
        """The same, its covariance with what the replay is not trusted with of each joint's distortion."""
        covariance = self.response.covariance.copy()
        for joint in range(len(self.left)):
            distortion = self.distortion_of(joint).reshape(len(covariance), -1)
            covariance += distortion[:, :, None] * distortion.conj()[:, None, :]
        return dataclasses.replace(self.response, covariance=covariance)

    def distortion_of(self, joint: int, which: slice = EVERY) -> ComplexArray:
        """What the replay is not trusted with of one joint's distortion, as mean of some realisations, (F, n, n)."""
        torque = np.linalg.solve(self.line, self.simulated[which].mean(axis=0) - self.line)
        return np.asarray(self.left[joint] * self.line[:, :, [joint]] * torque[:, [joint], :])

    def with_distortion_of(self, joint: int, which: slice) -> FrequencyResponse:
        """The response with that in it."""
        return dataclasses.replace(self.response, value=self.response.value + self.distortion_of(joint, which))


def _neighbours(measured: MeasuredResponse) -> int:
    """Lines on either side over which the measured covariance was averaged."""
    return round((measured.degrees_of_freedom / (len(measured.realisations) - 1) - 1) / 2)


def _frictions(robot: Robot, joints: Sequence[str]) -> list[Effect]:
    return [e for e in robot.effects if _is_friction(e, joints)]


def _is_friction(effect: Effect, joints: Sequence[str]) -> bool:
    return effect.traits.is_friction and effect.traits.in_dynamics and set(effect.joints) <= set(joints)


def _with_friction(robot: Robot, joints: Sequence[str], coefficients: Array) -> Robot:
    rest, out = coefficients, []
    for e in robot.effects:
        if _is_friction(e, joints):
            own, rest = np.split(rest, [len(e.coefficients)])
            e = e.with_coefficients(own)
        out.append(e)
    return robot.with_effects(out)


def _slopes(grey: GreyBox, joints: Sequence[str]) -> dict[str, float]:
    """Viscous slope of each joint, the geometric mean over experiments."""
    return {
        j: float(np.exp(np.mean([np.log(e.value) for e in grey.estimates if e.name.startswith(f"{j}.{SLOPE}")])))
        for j in joints
    }


def _friction_rows(
    measured: MeasuredResponse, simulated: ComplexArray, by_friction: ComplexArray, linear: ComplexArray
) -> tuple[Array, Array]:
    """Slopes and target of one pose, real and imaginary parts below each other."""
    left = measured.realisations - simulated
    inverse = np.linalg.inv(measured.value)
    # each joint's by one number: weights from so few realisations would be made of what they are to weigh
    size = np.sqrt(np.mean(np.abs(inverse @ left) ** 2, axis=(0, 1, 3)))[:, None]

    def rows(x: ComplexArray) -> Array:
        scaled = (inverse @ x / size).ravel()
        return np.concatenate([scaled.real, scaled.imag])

    return np.column_stack([rows(np.broadcast_to(c, left.shape)) for c in (*linear, *by_friction)]), rows(left)
