"""Friction of one joint that depends on its velocity alone (equations 3.53 and 3.54, and their special cases)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.compiled.in_laws import turned_over, turning
from rx90b_flex.effects.along_angle import AlongAngle
from rx90b_flex.effects.effect import Effect, JointEffect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.law_effect import LawEffect, SumOfLaws
from rx90b_flex.effects.motion import Array, Coordinates, JointMotion, Motion
from rx90b_flex.effects.parameters import FRICTION, choice, linear, shape
from rx90b_flex.effects.reversal import DryFriction, Resolution, log_speed, turnover_range, turnover_shape
from rx90b_flex.effects.stand_in import OfUsualShape

FADED = 0.5  # of a joint's speed within which a friction fades at the most: one that fades more slowly is a curve over all speeds
LONGEST_DRIFT = 30.0  # times a recording: what fades more slowly is a slope that stays
SHORTEST_DRIFT = 0.1  # of a recording: what fades faster is an event at its start
TINY = 1e-300  # rad/s, in place of standstill, where sign over speed counts for nothing
FADES = 4.0  # times the smallest turn-over that a log resolves: what fades faster is the turn-over itself


@dataclass(frozen=True, kw_only=True)
class SidedFriction(JointEffect):
    """Friction of one joint on either side of its drive's flexibility.

    Attributes
    ----------
    side : str
        ``joint``: it acts on the joint's velocity, that of e + eps1, as in (3.53). ``motor``: on the drive's, that of e: bearings
        and seals of the motor and of the gear's first stage.
    """

    side: str = choice("joint", "motor")

    @property
    def port_kind(self) -> str:
        return "drive" if self.side == "motor" else "joint"


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(SidedFriction, LawEffect, DryFriction, breaks_away=True):
    """Dry friction, ``torque * sign(v)``, its sign ``tanh(v / turnover)`` at reversal.

    Signature
    ---------
    Against velocity two levels, ``-torque`` and ``+torque``, with a jump at reversal.

    Neighbours
    ----------
    `viscous_friction` grows with speed and `stribeck_friction` fades with it; the jump of `load_friction` is higher
    where the joint carries more; `presliding_friction` turns over gradually, along an angle. At standstill dry
    friction holds any torque up to its own: where logs show that a drive sticks at a reversal, it is taken to go over evenly, and
    the samples there are given the weight of such a guess.

    Source
    ------
    Hardeman 2008, equations 3.53 and 3.54: the asperity torque that does not fade, its sign smoothed by a hyperbolic tangent in
    place of an arctangent.
    """

    torque: float | None = linear("N m", lower=0.0, rank=FRICTION)
    turnover: float | None = turnover_shape()

    def basis(self, at: JointMotion) -> Array:
        # as the law has it, without the slopes: fits ask for it most
        return self.direction(at)[:, None]

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        torque, turnover = parameters[0], parameters[1]
        sign = np.tanh(rate / turnover)
        out[0] = torque * sign
        out[1] = 0.0
        out[2] = torque * (1.0 - sign * sign) / turnover


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(SumOfLaws, SidedFriction, grows_with_speed=True, straight=("velocity",)):
    """Friction linear in velocity, ``coefficient * v``.

    Signature
    ---------
    A straight line through the origin against velocity.

    Neighbours
    ----------
    `viscous_power_friction` is a bent line, `asymmetric_friction` has another slope each way, `friction_drift`
    another slope early than late. A log that is late (`torque_delay`) follows the torque's rate of change, not the
    velocity.

    Source
    ------
    Hardeman 2008, equation 3.53 with delta_v = 0.
    """

    coefficient: float | None = linear("N m s/rad", lower=0.0, rank=FRICTION)

    def unit_laws(self, motion: Motion) -> tuple[Law, ...]:
        return (Law(motion.coordinates.port(self.joint, self.port_kind), damping=1.0),)


@dataclass(frozen=True, kw_only=True)
class AsymmetricFriction(SidedFriction, LawEffect, straight=("speed",)):
    """Viscous friction that differs by direction, ``coefficient * |v|``.

    Signature
    ---------
    A V against velocity: the residual has one sign whichever way the joint turns, and grows with speed.

    Neighbours
    ----------
    `torque_offset` has one sign too but does not grow with speed; `viscous_friction` changes sign. Needs both
    directions at several speeds.

    Source
    ------
    Not in Hardeman 2008; the even part of viscous friction that differs by direction.
    """

    coefficient: float | None = linear("N m s/rad", rank=FRICTION)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        out[0] = parameters[0] * np.abs(rate)
        out[1] = 0.0
        out[2] = parameters[0] * np.sign(rate)


@dataclass(frozen=True, kw_only=True)
class ViscousPowerFriction(
    SidedFriction, LawEffect, DryFriction, grows_with_speed=True, replaces=("viscous_friction",)
):
    """Viscous part of equation 3.53, ``coefficient * sign(v) * |v|^power``, power = 1 - delta_v.

    It stands in for `viscous_friction` at the same joint.

    Signature
    ---------
    An odd curve against velocity: with a power below one steep at low speed and flatter at high speed.

    Neighbours
    ----------
    Over a narrow range of speed it looks like `viscous_friction` with `coulomb_friction`; slow and fast passages
    together tell. `stribeck_friction` falls with speed before viscous friction takes over, this one only rises.

    Source
    ------
    Hardeman 2008, equation 3.53, where power is 1 - delta_v.
    """

    coefficient: float | None = linear("N m (s/rad)^power", lower=0.0, rank=FRICTION)
    power: float | None = shape("-", start=0.7, lower=0.1, upper=3.0)
    turnover: float | None = turnover_shape()

    def basis(self, at: JointMotion) -> Array:
        # as the law has it, without the slopes, which cost the most
        return (self.direction(at) * np.exp(self.known_shape()[0] * log_speed(at)))[:, None]

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        coefficient, power, turnover = parameters[0], parameters[1], parameters[2]
        size = np.abs(rate)
        sign = np.tanh(size / turnover)
        slope = (1.0 - sign * sign) / turnover
        grown = coefficient * size**power
        out[0] = np.copysign(grown * sign, rate)
        out[1] = 0.0
        out[2] = grown * (slope + power * (sign / np.maximum(size, TINY)))

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        return self.with_turnover(motion, np.array([[0.2], [0.4], [0.6], [0.8], [1.3], [1.8], [2.4]]), independent=3)


@dataclass(frozen=True, kw_only=True)
class StribeckFriction(SidedFriction, LawEffect, DryFriction, breaks_away=True):
    """Asperity part of equation 3.53, ``torque * exp(-(|v|/velocity)^power) * sign(v)``: it fades with speed.

    With a ``deflection`` (rad; in place of ``turnover``) its sign is that of `presliding_friction` with such a deflection: it turns
    over along that angle and is kept at rest.

    Signature
    ---------
    A bump at low speed on both sides of zero velocity, gone above a few times ``velocity``.

    Neighbours
    ----------
    `coulomb_friction` stays at all speeds. `presliding_friction` is also about reversals, but turns over along an
    angle whatever the speed, where this one depends on speed alone: slow and quick reversals tell them apart. Needs
    samples at low speed that are not reversals.

    Source
    ------
    Hardeman 2008, equation 3.53, asperity part; after R. Stribeck, 1902.
    """

    torque: float | None = linear("N m", lower=0.0, rank=FRICTION)
    velocity: float | None = shape("rad/s", start=0.1, lower=1e-9, upper=1e3, telling=True)
    power: float | None = shape("-", start=1.0, lower=0.3, upper=3.0, usual=True)
    turnover: float | None = turnover_shape()

    def own_range(self, motion: Motion) -> Array:
        at = motion.joint(self.joint, self.port_kind)
        low, _ = turnover_range(at)
        out = super().own_range(motion)
        out[:, 0] = FADES * low, max(FADED * Resolution.of(at).speed, 8.0 * FADES * low)
        return out

    def basis(self, at: JointMotion) -> Array:
        velocity, power = self.known_shape()[:2]
        return (self.direction(at) * np.exp(-np.exp(power * (log_speed(at) - np.log(velocity)))))[:, None]

    def possible(self) -> bool:
        """Friction that fades before its sign has turned over falls nowhere: it is how dry friction turns over."""
        return self.turnover is None or self.velocity is None or self.velocity >= self.turnover

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        torque, velocity, power, turnover = parameters[0], parameters[1], parameters[2], parameters[3]
        size = np.abs(rate)
        sign = np.tanh(size / turnover)
        slope = (1.0 - sign * sign) / turnover
        faded = (size / velocity) ** power
        left = torque * np.exp(-faded)
        out[0] = np.copysign(left * sign, rate)
        out[1] = 0.0
        out[2] = left * (slope - power * faded * (sign / np.maximum(size, TINY)))

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        low, high = self.own_range(motion)[:, 0]
        velocities = np.geomspace(1.5 * low, 0.35 * high, 7)
        starts = [[velocity, power] for velocity in velocities for power in (0.7, 1.0, 2.0)]
        return self.with_turnover(motion, np.array(starts), independent=5)


@dataclass(frozen=True, kw_only=True)
class _StribeckAlongAngle(AlongAngle, StribeckFriction, replaces=("stribeck_friction",)):
    """Stribeck friction whose sign turns over along an angle and is kept at rest, as that of `presliding_friction` beside it.

    Source: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, "A new model for control of systems with friction", IEEE
    Transactions on Automatic Control 40(3), 1995, whose bristles give way at a torque that fades with speed.
    """

    form_of: ClassVar[type[Effect]] = StribeckFriction

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """It remembers its direction: `dahl` from one step to the next."""
        torque, velocity, power, deflection = parameters[0], parameters[1], parameters[2], parameters[3]
        before, part = parameters[6], parameters[7]
        part = turned_over(x, before, part, deflection)
        size = np.abs(rate)
        faded = (size / velocity) ** power
        left = torque * np.exp(-faded)
        out[0] = left * part
        out[1] = left * turning(part, rate, deflection)
        out[2] = -left * part * power * faded / np.maximum(size, TINY) * np.sign(rate)
        out[4] = part


@dataclass(frozen=True, kw_only=True)
class _OfUsualPowerAlongAngle(OfUsualShape, _StribeckAlongAngle):
    """The same where a log does not tell how quickly it fades."""

    in_files: ClassVar[type[Effect]] = _StribeckAlongAngle


@dataclass(frozen=True, kw_only=True)
class _OfUsualPower(OfUsualShape, StribeckFriction):
    """How quickly it fades a log may not tell: with a lower power, more torque comes to the same above the slowest speeds."""

    in_files: ClassVar[type[Effect]] = StribeckFriction


@dataclass(frozen=True, kw_only=True)
class FrictionDrift(SidedFriction, LawEffect, repeats_with_motion=False):
    """Viscous friction that fades as the joint warms up, ``coefficient * exp(-t / time_constant) * v``.

    The time is the file's, from its start.

    Signature
    ---------
    Proportional to velocity, with a slope that decays from the start of a file: large early, gone late.

    Neighbours
    ----------
    `viscous_friction` has the same slope all through. Recordings must be long beside the time constant; over a
    fraction of it the drift is a constant slope.

    Source
    ------
    Not in Hardeman 2008; friction of a warming robot joint: A. C. Bittencourt, S. Gunnarsson, ASME Journal of
    Dynamic Systems, Measurement, and Control 134(5), 2012.
    """

    law_timed: ClassVar[bool] = True

    coefficient: float | None = linear("N m s/rad", rank=FRICTION)
    time_constant: float | None = shape("s", start=10.0, lower=0.05, upper=1.0e5)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        coefficient, time_constant, time = parameters[0], parameters[1], parameters[2]
        slope = coefficient * np.exp(-time / time_constant)
        out[0] = slope * rate
        out[1] = 0.0
        out[2] = slope

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        low, high = self.shape_range(motion)[:, 0]
        return ShapeSearch(np.geomspace(1.2 * low, min(30.0 * low, 0.5 * high), 6)[:, None], independent=3)

    def shape_range(self, motion: Motion) -> Array:
        low, high = super().shape_range(motion)
        # what is over within a tenth of the recording is an event at its start, no warming up; what hardly begins is none either
        seconds = float(np.ptp(motion.time))
        return np.stack([np.maximum(low, SHORTEST_DRIFT * seconds), np.minimum(high, LONGEST_DRIFT * seconds)])


def friction_side(effects: Iterable[Effect], joint: str) -> str:
    """Side of a joint's friction among these effects: ``motor`` where one of them acts there, else ``joint``."""
    own = (e for e in effects if isinstance(e, SidedFriction) and e.joint == joint)
    return "motor" if any(e.side == "motor" for e in own) else "joint"


def friction_port(effects: Iterable[Effect], coordinates: Coordinates, joint: str) -> Array:
    """Row of the coordinates that a joint's friction acts on, shape (n,): e + eps1, or e where it is the motor's."""
    return coordinates.port(joint, "drive" if friction_side(effects, joint) == "motor" else "joint")
