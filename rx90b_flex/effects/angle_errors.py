"""Angles that are not what the log says: errors of the resolver and of the transmission, and backlash.

They act on the coordinates. To first order in the angle's error delta, the torque changes by the model's sensitivity to position,
velocity and acceleration times delta, delta' and delta''.
"""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.effects.crossings import Gap, between_crossings
from rx90b_flex.effects.deflection import rates_in_time, time_step
from rx90b_flex.effects.effect import Effect, JointEffect, JointForce
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.law import Law, Where
from rx90b_flex.effects.log_effect import LogEffect
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import derived, linear, shape
from rx90b_flex.effects.ripple import PeriodicEffect

STEEPEST = 0.25  # change of the angle's error with the angle, up to which the first order says what happens
WIDEST_GAP = 0.1  # rad, up to which the first order says what lost motion does
TOGETHER_BYTES = 1.5e5  # of torques at several orders that are worked out together: what a processor has close at hand
# where it is not stated within which torque teeth change from one flank to the other:
LOAD_SCALE = 1.0  # N m, in a simulation
LOAD_PART = 0.03  # of the load's root mean square, in a log
SOFTEST_PART, HARDEST_PART = 0.3, 0.003  # of it, between which a log tells that torque


@dataclass(frozen=True, kw_only=True)
class _AngleError(LogEffect, PeriodicEffect):
    amplitude: float | None = derived("rad", lower=0.0)

    def possible(self) -> bool:
        (order,), (sine, cosine) = self.known_shape(), self.known_coefficients()
        return bool(order * np.hypot(sine, cosine) <= STEEPEST)

    @abstractmethod
    def sensitivity(self, motion: Motion) -> tuple[Array, ...]:
        """Change of the torque per change of the angle, its rate, its second rate, each (N, n), and its slope, (N,)."""

    def columns(self, motion: Motion) -> Array:
        return self._at_orders(motion, self.known_shape())

    def factors(self, motion: Motion, leading: bool = False) -> tuple[Array, Array] | None:
        return self._own_row(motion, self.known_shape()) if leading else None

    def _own_row(self, motion: Motion, orders: Array) -> tuple[Array, Array]:
        """What its own joint feels of it at some orders (M,), the larger part: the port (n,) and (N, 2 M)."""
        place = self._place(motion)
        basis = self._at_orders(motion, orders, slice(place, place + 1))[:, 0]
        return motion.coordinates.port(self.joint, "drive"), basis

    def side_by_side(
        self, effects: Sequence[Effect], motion: Motion, leading: bool = False
    ) -> tuple[Array | None, Array]:
        if any(type(e) is not type(self) or e.joints != self.joints for e in effects):
            return super().side_by_side(effects, motion, leading)
        orders = np.concatenate([e.known_shape() for e in effects])
        return self._own_row(motion, orders) if leading else (None, self._at_orders(motion, orders))

    def _at_orders(self, motion: Motion, orders: Array, rows: slice = slice(None)) -> Array:
        """Columns of sin and cos at some orders (M,), one pair behind the other, in some rows; (N, rows, 2 M).

        With delta = sin(order q): delta' = order q' cos, delta'' = order q'' cos - (order q')^2 sin.
        """
        position, centripetal, ahead = (x[:, rows, None] for x in self._constants(motion))
        angle = motion.q[:, self._place(motion), None]
        out = np.empty((*position.shape[:2], len(orders), 2))
        together = max(1, int(TOGETHER_BYTES / (8 * max(position.size, 1))))
        for some in (slice(i, i + together) for i in range(0, len(orders), together)):
            order = orders[some]
            s, c = np.sin(angle * order)[:, None], np.cos(angle * order)[:, None]
            in_phase, quarter = position - order**2 * centripetal, order * ahead
            out[:, :, some, 0], out[:, :, some, 1] = s * in_phase + c * quarter, c * in_phase - s * quarter
        return out.reshape(*position.shape[:2], -1)

    def _constants(self, motion: Motion) -> tuple[Array, ...]:
        """What of these does not depend on the order: what grows with its square, and what turns ahead with it; each (N, n)."""
        return motion.once((self.type_name(), self.joint), lambda: self._worked_out(motion))

    def _worked_out(self, motion: Motion) -> tuple[Array, ...]:
        place = self._place(motion)
        by_q, by_v, by_a, ratio = self.sensitivity(motion)
        v, a = motion.v[:, place, None], motion.a[:, place, None]
        ahead = by_v * v + by_a * a
        ahead[:, place] += ratio
        return by_q, by_a * v**2, ahead

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """The angle's error at an angle of the drive, and its first two derivatives by it."""
        sine, cosine, order = parameters[0], parameters[1], parameters[2]
        s, c = np.sin(order * x), np.cos(order * x)
        out[0] = sine * s + cosine * c
        out[1] = order * (sine * c - cosine * s)
        out[2] = -order * order * out[0]

    def _law_at(self, motion: Motion, at: Where) -> tuple[Law, ...]:
        values = np.concatenate([self.known_coefficients(), self.known_shape()])
        port = motion.coordinates.port(self.joint, "drive")
        return (Law(port, function=self.law, parameters=values, at=at),)

    def error(self, q: Array) -> tuple[Array, Array, Array]:
        """The angle's error at angles of the drive, and its first two derivatives by them; each of the shape of q."""
        error, slope, curvature = out = np.zeros((3, *q.shape))
        self.law(q, 0.0, [*self.known_coefficients(), *self.known_shape()], out)
        return error, slope, curvature

    def _place(self, motion: Motion) -> int:
        return int(np.flatnonzero(motion.coordinates.port(self.joint, "drive"))[0])

    def weights(self, at: JointMotion) -> tuple[Array, ...]:
        place = self._place(at.motion)
        return tuple(part[:, place] for part in self._constants(at.motion))

    def basis(self, at: JointMotion) -> Array:
        return self._own_row(at.motion, self.known_shape())[1]


@dataclass(frozen=True, kw_only=True)
class ResolverError(_AngleError, needs_model=True):
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

    def sensitivity(self, motion: Motion) -> tuple[Array, ...]:
        by_q, by_v, by_a = motion.model_sensitivity(self.joint)
        return -by_q, -by_v, -by_a, np.zeros(len(motion))

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        return self._law_at(motion, "measured")

    def measurement_error(self, motion: Motion) -> tuple[Array, Array]:
        port = motion.coordinates.port(self.joint, "drive")
        error, slope, _ = self.error(motion.q @ port)
        return np.outer(error, port), np.outer(slope * (motion.v @ port), port)


@dataclass(frozen=True, kw_only=True)
class TransmissionError(_AngleError, behind_gear=True, needs_model=True):
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

    def sensitivity(self, motion: Motion) -> tuple[Array, ...]:
        place = self._place(motion)
        links = (by[:, :, place] for by in motion.on_tree.derivatives())
        return (*links, motion.on_tree.load()[:, place])

    def simulated(self, beside: Sequence[Effect]) -> Effect:
        return _VaryingRatio(error=self)


@dataclass(frozen=True, kw_only=True)
class _VaryingRatio(Effect, adds_inertia=True, part="links"):
    """A transmission error as a force, to all orders: what the links ask for beyond what they would at the motor's angle."""

    error: TransmissionError

    def _moved(self, motion: Motion) -> tuple[Motion, Array]:
        """Motion of the links, and how fast they turn with the motor along each coordinate, (N, n)."""
        port = motion.coordinates.port(self.error.joint, "drive")
        error, slope, curvature = self.error.error(motion.q @ port)
        v, a = motion.v @ port, motion.a @ port
        moved = dataclasses.replace(
            motion,
            q=motion.q + np.outer(error, port),
            v=motion.v + np.outer(slope * v, port),
            a=motion.a + np.outer(slope * a + curvature * v**2, port),
        )
        return moved, 1.0 + np.outer(slope, port)

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        return self.error._law_at(motion, "links")

    def columns(self, motion: Motion) -> Array:
        moved, ratio = self._moved(motion)
        return np.asarray(ratio * moved.on_tree.load() - motion.on_tree.load())[:, :, None]

    def force(self, motion: Motion) -> Array:
        return np.asarray(self.columns(motion)[:, :, 0])

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        """By acceleration; by q and v it is nothing that an integrator need know."""
        moved, ratio = self._moved(motion)
        by_a = ratio[:, :, None] * moved.on_tree.derivatives()[2] * ratio[:, None, :] - motion.on_tree.derivatives()[2]
        return np.zeros_like(by_a), np.zeros_like(by_a), by_a

    def potential(self, motion: Motion) -> Array:
        down = np.array([0.0, 0.0, -1.0])
        moved, _ = self._moved(motion)
        return moved.on_tree.gravity_potential(down) - motion.on_tree.gravity_potential(down)


@dataclass(frozen=True, kw_only=True)
class Backlash(LogEffect, JointEffect, behind_gear=True, needs_model=True):
    """Lost motion: as the load changes sign the link goes from one end of the gap to the other.

    The link's angle is the motor's less ``gap / 2 * tanh(load / contact)``; the load is the torque that the links ask for, `contact`
    a small part of it, within which the teeth change from one flank to the other. A robot file may state it; left out it is
    identified. How much wider than the gap teeth are pressed under load is a matter of `drive_flexibility`.

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

    gap: float | None = linear("rad", lower=0.0)
    # shared: it may be as sharp as can be, then a log tells no more than that
    contact: float | None = shape("N m", start=LOAD_SCALE, lower=1e-9, upper=1e9, shared=True)

    def shape_range(self, motion: Motion) -> Array:
        return self._link_load(motion)[1] * np.array([[HARDEST_PART], [SOFTEST_PART]])

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        starts = self._link_load(motion)[1] * np.array([[0.01], [LOAD_PART], [0.1]])
        return ShapeSearch(starts, self.independent_shapes(motion))

    def independent_shapes(self, motion: Motion) -> int:
        return 3

    def possible(self) -> bool:
        return bool(self.known_coefficients()[0] <= WIDEST_GAP)

    def _link_load(self, motion: Motion) -> tuple[Array, float]:
        """Torque that the link asks for, (N,), without what the motor's way across the gap makes of it; its root mean square."""
        place = int(np.flatnonzero(motion.coordinates.port(self.joint, "drive"))[0])

        def make() -> tuple[Array, ...]:
            return (between_crossings(np.asarray(motion.on_tree.load())[:, place], motion.time),)

        (load,) = motion.once(("link_load", self.joint), make)
        return load, max(float(np.sqrt(np.mean(load**2))), 1e-9)

    def columns(self, motion: Motion) -> Array:
        place = int(np.flatnonzero(motion.coordinates.port(self.joint, "drive"))[0])
        load, usual = self._link_load(motion)
        contact = LOAD_PART * usual if self.contact is None else self.contact
        gap = float(self.coefficients[0])
        if 0.0 < gap <= WIDEST_GAP and time_step(motion.time) > 0:
            # a fit that knows its gap so far asks how the link moved behind it
            guess, behind = load, Gap(motion, place, gap, contact)
            load = motion.joint(self.joint, "drive").of_number(
                f"load behind {gap!r}", contact, lambda: behind.load(guess)
            )
        side = motion.as_angles(-0.5 * np.tanh(load / contact))
        deltas = (side, *rates_in_time(side, motion.time))
        by = motion.on_tree.derivatives()
        out = sum(slope[:, :, place] * delta[:, None] for slope, delta in zip(by, deltas, strict=True))
        return np.asarray(out)[:, :, None]

    def factors(self, motion: Motion, leading: bool = False) -> None:
        return None

    def basis(self, at: JointMotion) -> Array:
        return self.columns(at.motion)[:, int(np.flatnonzero(at.port)[0])]

    def simulated(self, beside: Sequence[Effect]) -> Effect:
        springs = [e for e in beside if "torsion" in e.traits.virtual and e.joints == self.joints]
        if not springs:
            raise ValueError(
                f"{self.label} cannot be simulated without the drive_flexibility of its joint: rigid teeth would meet at no time"
            )
        stiffness, _ = springs[0].known_coefficients()
        (contact,) = self.known_shape()
        gap = float(self.known_coefficients()[0])
        return _LostMotion(joint=self.joint, gap=gap, stiffness=float(stiffness), contact=float(contact))


@dataclass(frozen=True, kw_only=True)
class _LostMotion(JointForce, part="flexibility"):
    """Backlash in series with a drive's torsion spring: what it takes from the spring's torque.

    The torque F through both follows ``torsion = F / stiffness + gap / 2 * tanh(F / contact)``, with F against the load.
    """

    acts_at: ClassVar[str] = "torsion"

    gap: float
    stiffness: float
    contact: float

    @property
    def coefficients(self) -> Array:
        return np.ones(1)

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        port = motion.coordinates.port(self.joint, self.port_kind)
        values = np.array([self.gap, self.stiffness, self.contact])
        return (Law(port, function=self.law, parameters=values, stores=True),)

    @staticmethod
    def law(x: float, rate: float, parameters: Any, out: Any) -> None:
        half, stiffness, scale = 0.5 * parameters[0], parameters[1], parameters[2]
        size = abs(x)
        # both bounds lie below the torque; from below, Newton's steps on a concave curve stay there
        torque = max(stiffness * (size - half), size / (1.0 / stiffness + half / scale))
        slope = 1.0
        for _ in range(60):
            part = math.tanh(torque / scale)
            slope = 1.0 / stiffness + half / scale * (1.0 - part * part)
            step = (size - torque / stiffness - half * part) / slope
            torque += step
            if abs(step) <= 1e-12 * torque:
                break
        out[0] = math.copysign(torque, x) - stiffness * x
        out[1] = 1.0 / slope - stiffness
        out[2] = 0.0

    def _asked(self, at: JointMotion) -> tuple[Array, Array]:
        """Law and its slope, each (N,)."""
        out = np.zeros((len(at.q), 3))
        for x, row in zip(at.q, out, strict=True):
            self.law(float(x), 0.0, (self.gap, self.stiffness, self.contact), row)
        return out[:, 0], out[:, 1]

    def potential(self, motion: Motion) -> Array:
        at = motion.joint(self.joint, self.port_kind)
        torque = self._asked(at)[0] + self.stiffness * at.q
        part = torque / self.contact
        # log(cosh) without overflow
        in_gap = 0.5 * self.gap * (torque * np.tanh(part) - self.contact * (np.logaddexp(part, -part) - math.log(2.0)))
        return np.asarray(0.5 * torque**2 / self.stiffness + in_gap - 0.5 * self.stiffness * at.q**2)

    def basis(self, at: JointMotion) -> Array:
        return self._asked(at)[0][:, None]

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(at.q), 1))
        return self._asked(at)[1][:, None], zero, zero
