"""Curves of no known law: friction over velocity, torque over the joint's own angle. Last resorts, and named as such."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np
from scipy.interpolate import CubicSpline

from rx90b_flex.effects.effect import Effect, JointForce
from rx90b_flex.effects.hints import Penalty, Sites
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import FRICTION, SPRING, Parameter, given, linear

KNOTS = 40  # of a curve that a search places: more than it has bends, so that the penalty says how smooth it is
NEAREST = 0.5 / KNOTS  # of their range: knots lie no nearer to each other, where samples crowd
FAST = 4  # power of the speed by which knots count: what is no viscous friction fades
STANDS = 1e-12  # rad or rad/s within which a joint has no curve: it does not move


class ManyCoefficients(JointForce):
    """An effect on a joint with as many coefficients of one kind, its `torques`, as are stated or as it has knots or elements."""

    torques: tuple[float, ...] | None

    @property
    @abstractmethod
    def count(self) -> int:
        """How many coefficients it has."""

    @property
    def coefficient_parameters(self) -> dict[str, Parameter]:
        return {f"torques_{i + 1}": self.parameters()["torques"] for i in range(self.count)}

    @property
    def coefficients(self) -> Array:
        return np.full(self.count, np.nan) if self.torques is None else np.array(self.torques)

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        known = not np.isnan(values).any()
        change: dict[str, Any] = {"torques": tuple(float(x) for x in values) if known else None}
        return dataclasses.replace(self, **change)


def along_curve(x: float, rate: float, parameters: Any, out: Any) -> None:
    """The law of a cubic spline over angle or rate, level beyond its ends.

    Parameters: 1 where it is over the rate, the number of knots, the knots, four coefficients a piece, highest power first.
    """
    over_rate, count = parameters[0], int(parameters[1])
    at = rate if over_rate > 0.0 else x
    first, last = parameters[2], parameters[1 + count]
    inside = min(max(at, first), last)
    piece = 0
    while piece < count - 2 and inside >= parameters[3 + piece]:
        piece += 1
    s, k = inside - parameters[2 + piece], 2 + count + 4 * piece
    c3, c2, c1, c0 = parameters[k], parameters[k + 1], parameters[k + 2], parameters[k + 3]
    slope = c1 + s * (2.0 * c2 + s * 3.0 * c3) if first <= at <= last else 0.0
    out[0] = c0 + s * (c1 + s * (c2 + s * c3))
    out[1] = 0.0 if over_rate > 0.0 else slope
    out[2] = slope if over_rate > 0.0 else 0.0


class _Curve(ManyCoefficients, last_resort=True, of_make=False):
    """A natural cubic spline through a torque at each knot, level beyond the last ones.

    A fit penalises how far it bends from knot to knot, ``integral h(x)^3 f''(x)^2 dx`` with the distance h of the two knots on
    either side: second differences, on knots that are not equally far apart. A straight line has none. How much that counts the
    data choose: blocks that are held out. What another effect of its joint has already, a level, a straight line or a V over
    velocity, is left to that.

    Source: P. H. C. Eilers, B. D. Marx, "Flexible smoothing with B-splines and penalties", Statistical Science 11(2), 1996;
    the integral of a natural cubic spline as in P. J. Green, B. W. Silverman, "Nonparametric Regression and Generalized Linear
    Models", 1994, chapter 2.
    """

    knots_name: ClassVar[str]
    axis: ClassVar[str]  # along which it is a curve, as in `Traits.straight`
    strength: float | None

    def __post_init__(self) -> None:
        if len(self.knots) and (len(self.knots) < 3 or (np.diff(self.knots) <= 0).any()):
            raise ValueError(
                f"{self.label}: {self.knots_name} is {list(self.knots)}; expected three or more, ascending"
            )
        if self.torques is not None and len(self.torques) != len(self.knots):
            raise ValueError(f"{self.label}: {len(self.torques)} torques for {len(self.knots)} {self.knots_name}")

    @property
    def knots(self) -> tuple[float, ...]:
        """Where its torques are stated."""
        return tuple(getattr(self, self.knots_name) or ())

    @property
    def count(self) -> int:
        return len(self.knots)

    def held_beside(self, others: Sequence[Effect], motions: Sequence[Motion]) -> Array:
        """The level, the straight line and the V, which other effects in its place have; not where it ends within the motion."""
        here = {what for e in others if e.place == self.place and e is not self for what in e.traits.straight}
        knots = np.array(self.knots)
        # each without what those before it have, which stay the curve's own where no other effect has them
        straight, has = {"level": np.ones(len(knots)), self.axis: knots}, {"level", self.axis} & here
        if self.axis == "velocity" and len(knots) and knots[0] < 0.0 < knots[-1]:
            straight["speed"], has = np.abs(knots), has | ({"speed"} & here)
        if not has or not self._covers(motions):
            return super().held_beside(others, motions)
        where = self.straight_at(knots)
        root = np.sqrt(where)
        apart, _ = np.linalg.qr(root[:, None] * np.array(list(straight.values())).T)
        held = [root * x for name, x in zip(straight, apart.T, strict=True) if name in has]
        return np.array([x / np.linalg.norm(x) for x in held]).T

    def _covers(self, motions: Sequence[Motion]) -> bool:
        every = [self.abscissa(m.joint(self.joint)) for m in motions]
        return self.knots[0] <= min(x.min() for x in every) and max(x.max() for x in every) <= self.knots[-1]

    def straight_at(self, knots: Array) -> Array:
        """How much each knot counts where what others have is to be all, shape (k,)."""
        return np.ones(len(knots))

    @property
    def penalty(self) -> Penalty | None:
        return Penalty(_roughness(self.knots), self.strength) if self.count else None

    def penalised(self, strength: float | None) -> Self:
        change: dict[str, Any] = {"strength": strength}
        return dataclasses.replace(self, **change)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        every = [cls(joint=j) for j in sites.joints]
        return [e.placed(sites.motions) for e in every] if sites.motions else every

    def placed(self, motions: Sequence[Motion]) -> Self:
        """With knots over what these motions cover, half of them evenly and half where there are samples; without any where the
        joint does not move.
        """
        at = np.concatenate([self.abscissa(m.joint(self.joint)) for m in motions])
        x = np.unique(at)  # a joint at rest has one velocity, however long it stands
        low, high = x[0], x[-1]
        change: dict[str, Any] = {self.knots_name: ()}
        if high - low > STANDS:
            evenly = np.linspace(low, high, len(x))
            knots = [float(low)]
            for knot in np.quantile(np.concatenate([x, evenly]), np.linspace(0.0, 1.0, KNOTS))[1:-1]:
                if min(knot - knots[-1], high - knot) > NEAREST * (high - low):
                    knots.append(float(knot))
            change = {self.knots_name: (*knots, float(high))}
        return dataclasses.replace(self, **change)

    @abstractmethod
    def abscissa(self, at: JointMotion) -> Array:
        """What the torque is a curve of, shape (N,)."""

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        pieces = CubicSpline(self.knots, self.known_coefficients(), bc_type="natural").c.T.ravel()
        over_rate = self.knots_name == "velocities"
        values = np.concatenate([[float(over_rate), float(self.count)], self.knots, pieces])
        port = motion.coordinates.port(self.joint, self.port_kind)
        return (Law(port, function=along_curve, parameters=values, stores=not over_rate),)

    def _spline(self, x: Array, order: int) -> Array:
        """Torque, or its derivative, per unit of each knot's; shape (N, k)."""
        if not self.count:
            return np.zeros((len(x), 0))
        inside = np.clip(x, self.knots[0], self.knots[-1])
        values = _of_each_knot(self.knots)(inside, order)
        return np.asarray(values if order == 0 else values * (inside == x)[:, None])

    def basis(self, at: JointMotion) -> Array:
        return self._spline(self.abscissa(at), 0)

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        slope = self._spline(self.abscissa(at), 1)
        zero = np.zeros_like(slope)
        return (zero, slope, zero) if self.axis == "velocity" else (slope, zero, zero)


@lru_cache(maxsize=64)
def _of_each_knot(knots: tuple[float, ...]) -> CubicSpline:
    """Natural splines that are one at a knot and zero at all others."""
    return CubicSpline(knots, np.eye(len(knots)), bc_type="natural")


@lru_cache(maxsize=64)
def _roughness(knots: tuple[float, ...]) -> Array:
    """Integral of the squared second derivative, as a form in the values at the knots, (k, k)."""
    bent = _of_each_knot(knots)(knots, 2)
    # a second derivative goes straight from knot to knot: the integral of its square by Simpson's rule
    begin, end = bent[:-1], bent[1:]
    weight = np.diff(knots) ** 4 / 6.0
    ends = begin.T @ (weight[:, None] * begin) + end.T @ (weight[:, None] * end)
    middle = begin + end
    out = ends + middle.T @ (weight[:, None] * middle)
    out.setflags(write=False)
    return np.asarray(out)


@dataclass(frozen=True, kw_only=True)
class FrictionCurve(_Curve):
    """Friction of no known form: a smooth curve over velocity through `torques` at `velocities`.

    Signature
    ---------
    A residual that follows the joint's own velocity in a way that no law of the catalogue has, and does so on other recordings too.

    Neighbours
    ----------
    `stribeck_friction`, `viscous_power_friction` and every other law of friction: it is tried only where none of them is
    significant. It says how large friction is, and nothing of why.

    Source
    ------
    Not in Hardeman 2008; a natural cubic spline that is penalised for its bends: P. H. C. Eilers, B. D. Marx, Statistical Science
    11(2), 1996.
    """

    knots_name: ClassVar[str] = "velocities"
    axis: ClassVar[str] = "velocity"

    velocities: tuple[float, ...] = given("rad/s", size=0)
    torques: tuple[float, ...] | None = linear("N m", rank=FRICTION, size=0)
    strength: float | None = None  # of the penalty in a fit, 1/(N m)^2

    def straight_at(self, knots: Array) -> Array:
        return np.abs(knots) ** FAST

    def abscissa(self, at: JointMotion) -> Array:
        return at.v


@dataclass(frozen=True, kw_only=True)
class AngleCurve(_Curve, part="spring", straight=("level",)):
    """A torque of no known form over the joint's own angle: a smooth curve through `torques` at `angles`.

    Signature
    ---------
    A residual that follows the joint's own angle, at rest and in motion, whatever the other joints do.

    Neighbours
    ----------
    `joint_spring`, `gravity_spring` and `gear_ripple` are curves with a law; it is tried only where none of them is significant.

    Source
    ------
    Not in Hardeman 2008; a natural cubic spline that is penalised for its bends: P. H. C. Eilers, B. D. Marx, Statistical Science
    11(2), 1996.
    """

    knots_name: ClassVar[str] = "angles"
    axis: ClassVar[str] = "angle"

    angles: tuple[float, ...] = given("rad", size=0)
    torques: tuple[float, ...] | None = linear("N m", rank=SPRING, size=0)
    strength: float | None = None  # of the penalty in a fit, 1/(N m)^2

    def abscissa(self, at: JointMotion) -> Array:
        return at.q

    def potential(self, motion: Motion) -> Array:
        q = motion.joint(self.joint).q
        spline = _of_each_knot(self.knots)
        stored, ends = spline.antiderivative(), np.array([self.knots[0], self.knots[-1]])
        inside = np.clip(q, *ends)
        beyond = (q - inside)[:, None] * spline(inside)
        return np.asarray((stored(inside) + beyond) @ self.known_coefficients())
