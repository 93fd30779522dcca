"""Angles that are not what the log says: errors of the resolver and of the transmission, and backlash.

They act on the coordinates. To first order in the angle's error delta, the torque changes by the model's sensitivity to position,
velocity and acceleration times delta, delta' and delta''.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rx90b_flex.effects.effect import JointEffect, derived, linear
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.ripple import PeriodicEffect

LOAD_SCALE = 1.0  # N m; within about this much load the teeth change from one flank to the other


@dataclass(frozen=True, kw_only=True)
class _AngleError(PeriodicEffect):
    acts_on: ClassVar[str] = "signals"
    in_dynamics: ClassVar[bool] = False

    amplitude: float | None = derived("rad", lower=0.0)

    @abstractmethod
    def sensitivity(self, motion: Motion) -> tuple[Array, ...]:
        """Change of the torque per change of the angle, its rate, its second rate, each (N, n), and its slope, (N,)."""

    def columns(self, motion: Motion) -> Array:
        place = self._place(motion)
        in_phase, quarter = self._parts(motion)
        s, c = self._sine_and_cosine(motion.q[:, place])
        return np.stack([s * in_phase + c * quarter, c * in_phase - s * quarter], axis=2)

    def factors(self, motion: Motion) -> None:
        return None

    def leading(self, motion: Motion) -> tuple[Array, Array]:
        place = self._place(motion)
        in_phase, quarter = self._parts(motion, place)
        s, c = self._sine_and_cosine(motion.q[:, place])
        basis = np.concatenate([s * in_phase + c * quarter, c * in_phase - s * quarter], axis=1)
        return motion.coordinates.port(self.joint, "drive"), basis

    def _parts(self, motion: Motion, row: int | None = None) -> tuple[Array, Array]:
        """Torque in phase with sin and a quarter turn ahead of it; each (N, n), or (N, 1) for one row.

        With delta = sin(order q): delta' = order q' cos, delta'' = order q'' cos - (order q')^2 sin.
        """
        (order,) = self.known_shape()
        position, centripetal, ahead = motion.once((self.type_name(), self.joint), lambda: self._constant(motion))
        rows = slice(None) if row is None else slice(row, row + 1)
        return position[:, rows] - order**2 * centripetal[:, rows], order * ahead[:, rows]

    def _constant(self, motion: Motion) -> tuple[Array, ...]:
        """What of these does not depend on the order."""
        place = self._place(motion)
        by_q, by_v, by_a, ratio = self.sensitivity(motion)
        v, a = motion.v[:, place, None], motion.a[:, place, None]
        ahead = by_v * v + by_a * a
        ahead[:, place] += ratio
        return by_q, by_a * v**2, ahead

    def _place(self, motion: Motion) -> int:
        return int(np.flatnonzero(motion.coordinates.port(self.joint, "drive"))[0])

    def _sine_and_cosine(self, q: Array) -> tuple[Array, Array]:
        (order,) = self.known_shape()
        return np.sin(order * q)[:, None], np.cos(order * q)[:, None]

    def weights(self, at: JointMotion) -> tuple[Array, ...]:
        # gravity and ratio turn with the angle alone, the centripetal part also grows with the square of the speed
        return np.ones_like(at.q), at.v**2

    def basis(self, at: JointMotion) -> Array:
        return self.leading(at.motion)[1]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        raise TypeError(f"{self.type_name()} is no force of the robot")


@dataclass(frozen=True, kw_only=True)
class ResolverError(_AngleError):
    """The measured angle is wrong by ``amplitude * sin(order * q + phase)``.

    Link, drive and friction move by the true angle, so everything that the model makes of the measured one is wrong.

    Signature
    ---------
    A sine of the measured angle that grows with the square of the speed; friction and drive inertia follow the
    wrong angle too.

    Neighbours
    ----------
    `transmission_error` leaves friction and drive inertia alone; `gear_ripple` does not grow with speed. First
    order in the amplitude: an error that bends the velocity by a quarter shows harmonics.

    Source
    ------
    Not in Hardeman 2008; eccentricity and imbalance of resolvers, one and two cycles a turn of theirs.
    """

    needs_model: ClassVar[bool] = True

    def sensitivity(self, motion: Motion) -> tuple[Array, ...]:
        by_q, by_v, by_a = motion.model_sensitivity(self.joint)
        return -by_q, -by_v, -by_a, np.zeros(len(motion))


@dataclass(frozen=True, kw_only=True)
class TransmissionError(_AngleError):
    """The gear's ratio varies: the link turns by ``amplitude * sin(order * q + phase)`` more than the motor says.

    Only the links follow the error, not the drive; and the motor feels their torque times the varying ratio.

    Signature
    ---------
    A sine of the joint's angle that grows with the square of the speed and with the inertia behind the joint, and
    with the load.

    Neighbours
    ----------
    `gear_ripple` is as high at creeping speed. `resolver_error` also shows in the drive's inertia and friction,
    where the link alone follows a transmission error: told apart where the drive's part is large.

    Source
    ------
    Hardeman 2008, section 7.2, left open there: a gear ratio that depends on the angle.
    """

    needs_model: ClassVar[bool] = True

    def sensitivity(self, motion: Motion) -> tuple[Array, ...]:
        place = self._place(motion)
        links = (by[:, :, place] for by in motion.on_tree.derivatives())
        return (*links, motion.on_tree.load()[:, place])


@dataclass(frozen=True, kw_only=True)
class Backlash(JointEffect):
    """Lost motion: as the load changes sign the link goes from one end of the gap to the other.

    The link's angle is the motor's less ``gap / 2 * tanh(load / LOAD_SCALE)``; the load is the torque that the links ask for.

    Signature
    ---------
    Short kicks where the load through the gear changes sign, stronger where it changes quickly.

    Neighbours
    ----------
    `coulomb_friction` and `presliding_friction` act where the velocity changes sign. A joint that always carries weight
    one way shows no backlash: the motion must unload it.

    Source
    ------
    Not in Hardeman 2008; lost motion between the flanks of teeth, smoothed over a small load.
    """

    acts_on: ClassVar[str] = "signals"
    in_dynamics: ClassVar[bool] = False
    needs_model: ClassVar[bool] = True

    gap: float | None = linear("rad", lower=0.0)

    def columns(self, motion: Motion) -> Array:
        place = int(np.flatnonzero(motion.coordinates.port(self.joint, "drive"))[0])
        side = -0.5 * np.tanh(motion.on_tree.load()[:, place] / LOAD_SCALE)
        deltas: list[Array] = [side]
        for _ in range(2):
            deltas.append(_rate(deltas[-1], motion.time))
        by = motion.on_tree.derivatives()
        out = sum(slope[:, :, place] * delta[:, None] for slope, delta in zip(by, deltas, strict=True))
        return np.asarray(out)[:, :, None]

    def factors(self, motion: Motion) -> None:
        return None

    def leading(self, motion: Motion) -> None:
        return None

    def basis(self, at: JointMotion) -> Array:
        return self.columns(at.motion)[:, int(np.flatnonzero(at.port)[0])]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        raise TypeError(f"{self.type_name()} is no force of the robot")


def _rate(x: Array, time: Array) -> Array:
    """Derivative by time of uniform samples; zero where they are not a motion in time."""
    step = time[1] - time[0] if len(time) > 1 else 0.0
    return np.gradient(x, step) if step > 0 else np.zeros_like(x)
