"""Dry friction at reversal: the sign of a velocity, which turns over within some velocity of its own (compare equation 3.54).

The source smooths the sign by an arctangent, whose tail fades like 1/v: at ten times its velocity 6 % are missing. No robot's
friction does that, so the sign is a hyperbolic tangent here; in simulations without a stated turn-over both are as good as a step.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d

from rx90b_flex.compiled.signals import maxwell
from rx90b_flex.effects.effect import Effect, JointForce
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import shape
from rx90b_flex.effects.stand_in import forms_of

# Where no turn-over is stated, rad/s. The source asks for a c_a that is "sufficiently high" and prints none.
SHARP = 2.0e-4
# Of a joint's speed, within which dry friction turns over at the most: wider, it is one with the viscous.
FASTEST_PART = 1.0
WIDER_PART = 0.01  # the same from which a search begins again that ended at less
QUICK_PART = 0.05  # the same of most robots, and of a joint in whose model nothing grows with the velocity
FINEST = 0.04  # of the velocity's change within a sample at a reversal: what turns over within less is a step
NARROW = 0.3  # of such a start: what lies near it would be found from it
LEAST = 1e-9  # rad/s, of any turn-over: logs without noise resolve less
WINDOW_S, WINDOW_SAMPLES = 0.2, 5  # over which a joint at rest shows how much its velocity is off
QUIET = 0.02  # part of the windows that count as the quietest
SLOWEST = 1e-300  # rad/s, in place of standstill
NOISY = 2.0  # standard deviations of an angle's noise within which nothing is known of a deflection
MOST_HELD = 0.9999  # of the friction
# Of a joint's travel: along less, dry friction winds up and does not turn, however little noise there is.
SHORTEST_MOVE = 3e-6
SLOWEST_PART = 0.02  # of a joint's speed above which it moves, whatever the log's noise


def turnover_shape() -> Any:
    """Field of a dry friction: velocity within which it turns over, one value a joint."""
    return shape("rad/s", start=SHARP, lower=LEAST, upper=1e3, shared=True)


def reversal(v: Array, turnover: float) -> Array:
    """tanh(v/turnover): the sign of v, smooth at reversal."""
    return np.tanh(v / turnover)


def reversal_slope(v: Array, turnover: float) -> Array:
    """Derivative of `reversal` by v, s/rad."""
    return (1.0 - np.tanh(v / turnover) ** 2) / turnover


def log_speed(at: JointMotion) -> Array:
    """Logarithm of the speed, shape (N,): at rest that of next to nothing. Powers of the speed follow from it."""
    return at.of_number("log speed", 0.0, lambda: np.log(np.maximum(np.abs(at.v), SLOWEST)))


@dataclass(frozen=True)
class Resolution:
    """What a log tells of a joint's slow motion.

    Attributes
    ----------
    velocity : float
        By which the velocity changes from one sample to the next at a reversal, rad/s.
    noise : float
        Largest velocity in the quietest part of the log, rad/s: below it nobody knows whether the joint moves.
    speed : float
        95th percentile of the speed, rad/s.
    angle : float
        By which the angle changes within a sample beside a reversal, or is off by noise, rad.
    travel : float
        Range of the angle, rad.
    wander : float
        Largest range of the angle within a rest, beside what creeps, rad: noise moves it so far.
    """

    velocity: float
    noise: float
    speed: float
    angle: float
    travel: float
    wander: float

    @staticmethod
    def of(at: JointMotion) -> Resolution:
        """From a joint's motion in time, worked out once."""
        key = ("resolution", *(str(i) for i in np.flatnonzero(at.port)))
        log = at.motion.logged or at.motion
        off = None if log.angle_noise is None else float(np.linalg.norm(at.port * log.angle_noise))
        (values,) = log.once_for_all(key, lambda: (_resolution(log.q @ at.port, log.v @ at.port, log.time, off),))
        return Resolution(*(float(x) for x in values))


def _resolution(q: Array, v: Array, time: Array, off: float | None) -> Array:
    speed, travel = float(np.percentile(np.abs(v), 95)), float(np.ptp(q))
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if len(v) < 2 * WINDOW_SAMPLES or step <= 0:
        return np.array([SHARP, SHARP, max(speed, SHARP), 1e-6, travel, 1e-12])
    window = max(WINDOW_SAMPLES, round(WINDOW_S / step))
    whole = len(v) // window * window
    if whole == 0:
        window = whole = len(v)
    largest = np.abs(v[:whole]).reshape(-1, window).max(axis=1)
    quietest = np.sort(largest)[: max(1, int(QUIET * len(largest)))]
    noise = min(float(quietest.mean()), SLOWEST_PART * speed)
    # where a joint stands and only noise crosses zero, nothing reverses
    moving = maximum_filter1d(np.abs(v), 2 * window + 1) > 3.0 * noise
    turns = np.flatnonzero((v[1:] * v[:-1] < 0) & moving[1:])
    change = np.abs(np.diff(v))[turns]
    velocity = 0.5 * float(np.median(change)) if len(change) else 1e-3 * speed
    if off is None:
        # third differences of a smooth motion hold little but noise, whose variance they multiply by 20
        off = float(np.median(np.abs(np.diff(q, 3)))) / np.sqrt(20.0)
    angle = max(0.5 * velocity * step, NOISY * off)
    return np.maximum([velocity, noise, speed, angle, travel, _wander(q, v)], 1e-12)


def _wander(q: Array, v: Array) -> float:
    """Largest range of an angle, beside a parabola, while its velocity counts as zero: what creeps is no noise."""
    edges = np.flatnonzero(np.diff(v == 0.0, prepend=False, append=False))
    rests = [q[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= WINDOW_SAMPLES]
    return max((float(np.ptp(x - _parabola(x))) for x in rests), default=0.0)


def _parabola(x: Array) -> Array:
    at = np.linspace(-1.0, 1.0, len(x))
    return np.polynomial.Polynomial.fit(at, x, 2)(at)


def turnover_range(at: JointMotion) -> tuple[float, float]:
    """Smallest and largest turn-over that a log can tell, rad/s: below the first it is a step, above the second no dry friction."""
    known = Resolution.of(at)
    if known.speed < SHARP:  # what is left of a joint that stands is rounding, which tells no velocity
        return SHARP, 4.0 * SHARP
    low = max(FINEST * known.velocity, LEAST)
    return low, max(FASTEST_PART * known.speed, 4.0 * low)


def quick_range(at: JointMotion) -> tuple[float, float]:
    """The lower part of that range, which most robots' friction has."""
    low, high = turnover_range(at)
    return low, min(high, max(QUICK_PART * Resolution.of(at).speed, 4.0 * low))


def turnover_start(at: JointMotion) -> float:
    """In the lower part of what most robots have, rad/s: where a search begins."""
    low, high = quick_range(at)
    return float(np.exp(0.7 * np.log(low) + 0.3 * np.log(high)))


def last_direction(at: JointMotion) -> Array:
    """Direction of the last move, kept across rests, before the first that of it, shape (N,); zero where there is none.

    A move is what has a velocity that the log knows, or, however slow, goes farther than noise takes a joint at rest and than dry
    friction needs to turn.
    """
    return at.of_number("last direction", 0.0, lambda: _last_direction(at))


def _last_direction(at: JointMotion) -> Array:
    known = Resolution.of(at)
    moving = np.abs(at.v) > max(known.noise, 1e-3 * known.speed)
    way = maxwell(at.q, max(2.0 * known.wander, 4.0 * known.angle, SHORTEST_MOVE * known.travel))
    moved = moving | (np.abs(way) >= 1.0)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(at.v)), -1))
    direction = np.where(moving, np.sign(at.v), np.sign(way))
    return np.where(last >= 0, direction[np.maximum(last, 0)], 0.0)


class DryFriction(JointForce):
    """Friction of one joint that changes sign with its velocity. Its `turnover`, declared last, is the joint's."""

    turnover: float | None

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        """In all its forms: by direction alone, and those that stand beside something."""
        return [form(joint=j) for form in forms_of(cls) for j in sites.joints]

    def at(self, motion: Motion) -> JointMotion:
        """With a velocity that gives the part of the friction which a drive that sticks is taken to hold."""
        at = super().at(motion)
        if motion.stuck is None:
            return at
        stuck = motion.stuck[:, motion.coordinates.joints.index(self.joint)]

        def velocity() -> Array:
            creeping = self.sharpness * np.arctanh(np.clip(stuck, -MOST_HELD, MOST_HELD))
            return np.where(np.isnan(stuck), at.v, creeping)

        return at.creeping(self.sharpness, velocity)

    @property
    def sharpness(self) -> float:
        """The turn-over, rad/s; a step where it is not known."""
        return SHARP if self.turnover is None else self.turnover

    def direction(self, at: JointMotion) -> Array:
        """Sign of the velocity with this joint's turn-over, shape (N,)."""
        return at.of_number("direction", self.sharpness, lambda: reversal(at.v, self.sharpness))

    def direction_slope(self, v: Array) -> Array:
        """Derivative of `direction` by the velocity, s/rad."""
        return reversal_slope(v, self.sharpness)

    def shape_range(self, motion: Motion) -> Array:
        """The turn-over's from what the log resolves; of other shapes what `own_range` says."""
        out = self.own_range(motion)
        out[:, -1] = turnover_range(motion.joint(self.joint, self.port_kind))
        return out

    def shape_range_beside(self, motion: Motion, others: Sequence[Effect]) -> Array:
        """Wide turn-overs only where viscous friction is in the model: where it is missing they play its part."""
        out = self.shape_range(motion)
        if not any(e.place == self.place and e.traits.grows_with_speed for e in others):
            out[1, -1] = min(out[1, -1], quick_range(motion.joint(self.joint, self.port_kind))[1])
        return out

    def own_range(self, motion: Motion) -> Array:
        """Range of the shapes before the turn-over, which this motion can tell; (2, s), its last column not used."""
        return super().shape_range(motion)

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        return self.with_turnover(motion, super().shape_search(motion, left).starts[:, :-1])

    def with_turnover(self, motion: Motion, own: Array, independent: int = 1) -> ShapeSearch:
        """Starts of the shapes before the turn-over, (M, s - 1), each with one in the lower part of its range."""
        start = turnover_start(motion.joint(self.joint, self.port_kind))
        return ShapeSearch(np.concatenate([own, np.full((len(own), 1), start)], axis=1), independent)


def begun_wider(effects: Sequence[Effect], motion: Motion, joints: Collection[str]) -> tuple[Effect, ...]:
    """Effects with the turn-over of dry friction on some joints set to a wider one, from which a fit may begin; none where all are
    as wide.
    """
    out = []
    for effect in effects:
        if isinstance(effect, DryFriction) and effect.turnover is not None and effect.joint in joints:
            at = motion.joint(effect.joint, effect.port_kind)
            wider = float(np.clip(WIDER_PART * Resolution.of(at).speed, *quick_range(at)))
            if effect.turnover < NARROW * wider:
                effect = effect.with_shape(np.append(effect.shape[:-1], wider))
        out.append(effect)
    return tuple(out) if any(a is not b for a, b in zip(out, effects, strict=True)) else ()
