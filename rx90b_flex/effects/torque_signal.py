"""What stands between a motor's torque and the log of it: delay, saturation, interference."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import interpolate

from rx90b_flex.effects.effect import Effect, JointEffect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.log_effect import LogEffect
from rx90b_flex.effects.motion import Array, Force, JointMotion, Motion, with_forces
from rx90b_flex.effects.parameters import derived, linear, shape
from rx90b_flex.effects.ripple import SineEffect, highest_peaks

LONG_S = 0.01  # filters of currents and cycles of buses take 1 to 8 ms together


@dataclass(frozen=True, kw_only=True)
class TorqueDelay(LogEffect, on="robot or joint", needs_model=True):
    """The logged torque is late: it shows what the motor gave `delay` ago; a negative delay: it is early, or the position is late.

    On one joint, or on all joints alike.

    Its column is the secant ``(tau(t - d) - tau(t)) / d`` of the present model's torque, d the present delay or, before there is
    one, a sample, which no step of dry friction slips through. The model is asked for the torque of the motion of d ago: between
    samples a step of friction has its own instant.

    Signature
    ---------
    Proportional to the torque's rate of change: where the torque jumps or rises, on all joints alike if one clock
    is at fault.

    Neighbours
    ----------
    `drive_inertia` follows the acceleration, `viscous_friction` the velocity; torque that changes with neither, as
    at a reversal of dry friction, tells.

    Source
    ------
    Not in Hardeman 2008; current measured, filtered and logged after the position.
    """

    SHORTEST: ClassVar[float] = 1e-4  # s
    SMALLEST_SAMPLES: ClassVar[float] = 0.2  # of the log's clock: less is named where it explains much
    MUCH: ClassVar[float] = 0.025  # of a joint's error, or a twentieth of its square
    LEAST_SAMPLES: ClassVar[float] = 0.05  # less is within what filters and differences of samples leave

    joint: str | None = None
    delay: float | None = linear("s")

    @property
    def joints(self) -> tuple[str, ...]:
        return () if self.joint is None else (self.joint,)

    def columns(self, motion: Motion) -> Array:
        step = _sample(motion) if self.delay is None else np.copysign(max(self.SHORTEST, abs(self.delay)), self.delay)
        # all joints ask for the same
        (change,) = motion.once((self.type_name(), repr(step)), lambda: (self._change(motion, step),))
        return self._own(motion, change / step)[:, :, None]

    def caution(self) -> str:
        """Of a delay that no drive has: the log's times may be at fault, which no recording of that log tells."""
        if not self.known or abs(self.known_coefficients()[0]) <= LONG_S:
            return ""
        seconds = float(self.known_coefficients()[0])
        when = "after" if seconds > 0 else "before"
        return (
            f"{self.label}: torques are logged {1000 * abs(seconds):.3g} ms {when} the positions they belong to, longer than "
            "filters and buses take. Two clocks, a filter of one column alone or rows that were shifted leave the same: "
            "compare both with one event, before this delay is taken for the robot's."
        )

    def logged(self, motion: Motion, torque: Array) -> Array:
        (delay,) = self.known_coefficients()
        return torque + self._own(motion, self._change(motion, delay))

    def _change(self, motion: Motion, delay: float) -> Array:
        """Torque of the model `delay` ago less that of now, (N, n)."""
        if len(motion) < 4 or not motion.time[1] > motion.time[0]:
            return np.zeros_like(motion.q)
        moved = motion.once_for_all(
            ("in time",), lambda: _in_time(np.hstack([motion.q, motion.v, motion.a]), motion.time)
        )
        q, v, a = np.split(_late(moved, motion.time, delay), 3, axis=1)
        stuck = None if motion.stuck is None else _late_sticks(motion.stuck, delay / (motion.time[1] - motion.time[0]))
        logged = motion.logged or motion
        ago = dataclasses.replace(motion, q=q, v=v, a=a, time=motion.time - delay, stuck=stuck, logged=logged)
        own = [e for e in motion.effects if not e.traits.needs_load]
        smooth, now = motion.once(("torque without delay",), lambda: self._without_delay(motion, own))
        out = with_forces(np.zeros_like(motion.q), own, ago) - now
        return np.asarray(out + _late(_in_time(smooth, motion.time), motion.time, delay) - smooth)

    @staticmethod
    def _without_delay(motion: Motion, own: Sequence[Force]) -> tuple[Array, Array]:
        """Torque that links and what loads them ask for, smooth enough for samples to hold it, and that of `own` effects; (N, n)."""
        loading = (e for e in motion.effects if e.traits.needs_load)
        smooth = with_forces(np.array(motion.on_tree.load()), loading, motion)
        return smooth, with_forces(np.zeros_like(motion.q), own, motion)

    def too_small(self, part: float, sample_s: float, motion: Motion) -> str:
        # a torque that changes fast shows any delay: its size in time counts, and down to some size what it explains
        samples = abs(self._delay) / sample_s
        if samples >= self.SMALLEST_SAMPLES or (samples >= self.LEAST_SAMPLES and part >= self.MUCH):
            return ""
        return f"it is {samples:.2g} of a sample, too little for a name"

    @property
    def _delay(self) -> float:
        return float(self.known_coefficients()[0])

    @property
    def history_s(self) -> float:
        if self._delay < 0:
            raise ValueError(
                f"{self.label}: delay is {self._delay:g} s; a simulation cannot log a torque before it is there"
            )
        return self._delay

    def logged_torque(self, joints: Sequence[str], time: Array, torque: Array) -> Array:
        late = interpolate.make_interp_spline(time, torque, k=1)(np.clip(time - self._delay, time[0], time[-1]))
        own = [self.joint in (None, joint) for joint in joints]
        return np.where(np.array(own)[:, None], late, torque)

    def _own(self, motion: Motion, change: Array) -> Array:
        if self.joint is None:
            return change
        return change * motion.coordinates.port(self.joint, "drive")

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(), *(cls(joint=j) for j in sites.joints)]


def _sample(motion: Motion) -> float:
    """Time between samples, s; `TorqueDelay.SHORTEST` where they are not a motion in time."""
    step = float(motion.time[1] - motion.time[0]) if len(motion) > 1 else 0.0
    return max(step, TorqueDelay.SHORTEST)


def _late_sticks(stuck: Array, samples: float) -> Array:
    """`Motion.stuck` so many samples ago."""
    whole = round(samples)
    at = np.clip(np.arange(len(stuck)) - whole, 0, len(stuck) - 1)
    slope = np.nan_to_num(np.gradient(stuck, axis=0))
    return np.asarray(np.clip(stuck[at] - (samples - whole) * slope[at], -1.0, 1.0))


def _in_time(x: Array, time: Array) -> tuple[Array, Array]:
    """Smooth signals (N, m) between samples: knots and coefficients of their cubic spline."""
    spline = interpolate.make_interp_spline(time, x)
    return spline.t, spline.c


def _late(spline: tuple[Array, ...], time: Array, delay: float) -> Array:
    """Such signals of `delay` ago, (N, m); the first or last sample where there is none."""
    return np.asarray(interpolate.BSpline(*spline, k=3)(np.clip(time - delay, time[0], time[-1])))


@dataclass(frozen=True, kw_only=True)
class MotorSaturation(LogEffect, JointEffect, needs_model=True):
    """The motor gives ``tau - coefficient * tau^3`` where the log, which knows its current, says tau.

    Signature
    ---------
    Proportional to the third power of the logged torque: at the torque's peaks only, whatever causes them.

    Neighbours
    ----------
    A wrong motor constant scales all torques alike and cannot be told from the links' scale. `load_friction` needs
    motion and changes sign with the velocity.

    Source
    ------
    Not in Hardeman 2008; the first odd term by which a saturating motor falls short of its current.
    """

    acts_at: ClassVar[str] = "drive"

    coefficient: float | None = linear("1/(N m)^2", lower=0.0)

    def basis(self, at: JointMotion) -> Array:
        place = int(np.flatnonzero(at.port)[0])
        asked = self._asked(at.motion.model_torque[:, place])[:, None]
        return asked * asked * asked  # a third power of an array takes ten times as long

    def _asked(self, given: Array) -> Array:
        """Logged torque for a torque that the motor gives: Newton's method from the torque itself."""
        c = 0.0 if self.coefficient is None or self.coefficient <= 0 else self.coefficient
        if c == 0:
            return given
        top = 1.0 / np.sqrt(3.0 * c)  # beyond the top of the cubic no torque gives more
        asked = np.clip(given, -0.95 * top, 0.95 * top)
        for _ in range(30):
            bent = c * asked * asked
            before, step = asked, (asked - bent * asked - given) / (1.0 - 3.0 * bent)
            asked = np.clip(asked - step, -0.99 * top, 0.99 * top)
            if np.abs(asked - before).max(initial=0.0) <= 1e-15 * top:
                break
        return asked

    def logged(self, motion: Motion, torque: Array) -> Array:
        self.known_coefficients()
        place = int(np.flatnonzero(motion.coordinates.port(self.joint, "drive"))[0])
        out = torque.copy()
        out[:, place] = self._asked(torque[:, place])
        return out

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """What the motor gives beyond a torque x."""
        out[0] = -parameters[0] * x * x * x

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        port = motion.coordinates.port(self.joint, "drive")
        return (Law(port, function=self.law, parameters=self.known_coefficients(), at="motor"),)

    def motor_torque(self, joints: Sequence[str], torque: Array) -> Array:
        (c,) = self.known_coefficients()
        own = np.array([joint == self.joint for joint in joints])
        return np.where(own, torque - c * torque * torque * torque, torque)

    def commanded_torque(self, joints: Sequence[str], torque: Array) -> Array:
        self.known_coefficients()
        own = np.array([joint == self.joint for joint in joints])
        return np.where(own, self._asked(torque), torque)


@dataclass(frozen=True, kw_only=True)
class LineInterference(LogEffect, SineEffect, by_clock=True, repeats_with_motion=False, repeats=True, of_make=False):
    """Mains or another fixed frequency in the torque signal, ``amplitude * sin(2 pi frequency_hz t + phase)``.

    The time is the file's, so that recordings of one clock share the phase.

    Signature
    ---------
    One frequency in time, the same whether the robot moves or stands; a line in the residual's spectrum.

    Neighbours
    ----------
    `gear_ripple` and the angle errors change their frequency with the speed. At one constant speed they look alike.

    Source
    ------
    Not in Hardeman 2008; mains and switching in current sensors.
    """

    acts_at: ClassVar[str] = "drive"
    PEAKS: ClassVar[int] = 6

    frequency_hz: float | None = shape("Hz", start=50.0, lower=0.2, upper=2.0e4)
    amplitude: float | None = derived("N m", lower=0.0)
    phase: float | None = derived("rad")

    def basis(self, at: JointMotion) -> Array:
        (frequency,) = self.known_shape()
        angle = 2.0 * np.pi * frequency * at.time
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)

    def logged_torque(self, joints: Sequence[str], time: Array, torque: Array) -> Array:
        (frequency,), (sine, cosine) = self.known_shape(), self.known_coefficients()
        angle = 2.0 * np.pi * frequency * time
        own = np.array([joint == self.joint for joint in joints])
        return np.asarray(torque + np.multiply.outer(sine * np.sin(angle) + cosine * np.cos(angle), own)[:, :, None])

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """From the highest peaks of the residual's spectrum."""
        starts = super().shape_search(motion).starts if left is None else self._peaks(left.residual)
        spread = np.array([0.25 / max(float(np.ptp(motion.time)), 1e-3)])
        return ShapeSearch(starts, max(1, len(motion) // 2), spread=spread)

    def _peaks(self, residual: Sequence[tuple[Motion, Array]]) -> Array:
        """Of recordings added with the phases of their clock, (M, 1), Hz."""
        allowed = self.parameters()["frequency_hz"]
        step = min(m.time[1] - m.time[0] for m, _ in residual)
        # one grid for all recordings, fine enough for phases that turn between recordings far apart
        size = int(2 ** np.ceil(np.log2(4 * max(len(m) for m, _ in residual))))
        hz = np.fft.rfftfreq(size, step)
        total = np.zeros(len(hz), dtype=complex)
        for m, left in residual:
            total += np.fft.rfft(left, size) * np.exp(-2j * np.pi * hz * m.time[0])
        heard = (hz > allowed.lower) & (hz < allowed.upper)
        best = highest_peaks(np.where(heard, np.abs(total), 0.0), self.PEAKS)
        return hz[best][:, None]
