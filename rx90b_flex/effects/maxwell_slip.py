"""Hysteresis of real gears: several elastic elements side by side, each of which slips at its own torque (Maxwell, Iwan)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rx90b_flex.compiled.signals import maxwell
from rx90b_flex.effects.curves import ManyCoefficients
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.law_effect import RememberingLaw
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import FRICTION, Parameter, derived, linear
from rx90b_flex.effects.presliding import DEFLECTION, deflection_range, lost_in_noise
from rx90b_flex.effects.reversal import SHARP, reversal, reversal_slope
from rx90b_flex.effects.stand_in import StandIn

ELEMENTS = 2  # where none are stated
AROUND = (0.7, 1.0, 1.4)  # times a smooth element's deflection: the middle of several that come to the same
APART = (2.5, 4.0, 6.0, 15.0)  # how many times the first one's deflection the last one's is


@dataclass(frozen=True, kw_only=True)
class MaxwellSlipFriction(ManyCoefficients, RememberingLaw, breaks_away=True, refines=("presliding_friction",)):
    """Several elastic elements side by side: each follows the angle with its stiffness and slips at its torque.

    An element's torque over its limit is ``w = clip(w + dq / deflection, -1, 1)``, deflection its torque over its
    stiffness. Where samples do not follow each other in time there is no memory, and it is what it comes to after sliding:
    ``torque * sign(v)``.

    Signature
    ---------
    After each reversal the torque turns over along an angle in straight pieces, whatever the speed, and small moves leave loops
    within loops that rest does not forget.

    Neighbours
    ----------
    `presliding_friction` is one smooth element. `coulomb_friction` turns over at once, `held_friction` only shows at rest.

    Source
    ------
    Not in Hardeman 2008; F. Al-Bender, V. Lampaert, J. Swevers, IEEE Transactions on Automatic Control 50(11), 2005.
    """

    torques: tuple[float, ...] | None = linear("N m", lower=0.0, rank=FRICTION, size=0)
    stiffnesses: tuple[float, ...] | None = derived("N m/rad", lower=0.0, size=0)
    deflections: tuple[float, ...] | None = None  # rad

    def __post_init__(self) -> None:
        if self.deflections is None and self.torques is not None and self.stiffnesses is not None:
            if len(self.torques) != len(self.stiffnesses):
                raise ValueError(
                    f"{self.label}: {len(self.torques)} torques and {len(self.stiffnesses)} stiffnesses; expected one for each"
                )
            parts = zip(self.torques, self.stiffnesses, strict=True)
            object.__setattr__(self, "deflections", tuple(t / max(k, 1e-300) for t, k in parts))

    @property
    def count(self) -> int:
        known = [x for x in (self.deflections, self.torques, self.stiffnesses) if x is not None]
        return len(known[0]) if known else ELEMENTS

    @property
    def shape_parameters(self) -> dict[str, Parameter]:
        return {f"deflections_{i + 1}": DEFLECTION for i in range(self.count)}

    @property
    def shape(self) -> Array:
        return np.full(self.count, np.nan) if self.deflections is None else np.array(self.deflections)

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        return self._consistent(self.coefficients, np.asarray(values, dtype=float))

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        return self._consistent(np.asarray(values, dtype=float), self.shape)

    def _consistent(self, torques: Array, deflections: Array) -> Self:
        def known(x: Array) -> tuple[float, ...] | None:
            return None if np.isnan(x).any() else tuple(x.tolist())

        stiffnesses = known(torques / deflections)
        return dataclasses.replace(
            self, torques=known(torques), stiffnesses=stiffnesses, deflections=known(deflections)
        )

    @property
    def turns_along(self) -> float | None:
        """That of a smooth element with the same area: the mean by torques, of which a fit on its way may have negative ones."""
        weights = np.maximum(self.coefficients, 0.0)
        return float(np.average(self.shape, weights=weights)) if weights.sum() > 0.0 else None

    def too_small(self, part: float, sample_s: float, motion: Motion) -> str:
        return super().too_small(part, sample_s, motion) or lost_in_noise(self.shape.max(), motion.joint(self.joint))

    def shape_range(self, motion: Motion) -> Array:
        return np.tile(np.array(deflection_range(motion.joint(self.joint)))[:, None], self.count)

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        low, high = deflection_range(motion.joint(self.joint))
        grid = np.geomspace(1.5 * low, 0.5 * high, 6)
        step = max(1, len(grid) // (self.count + 1))
        starts = [grid[i : i + step * self.count : step] for i in range(len(grid) - step * (self.count - 1))]
        replaced = np.zeros(0) if left is None or left.instead_of is None else left.instead_of.shape
        if 1 < len(replaced) == self.count - 1:
            starts = [np.sort(np.append(replaced, one)) for one in grid]
        elif len(replaced):
            # elements that break away before and after one smooth element does
            steps = np.linspace(-0.5, 0.5, self.count) if self.count > 1 else np.zeros(1)
            smooth = replaced[0]
            pairs = [smooth * middle * ratio**steps for middle in AROUND for ratio in APART]
            starts += [np.clip(pair, low, high) for pair in pairs]
        return ShapeSearch(np.array(starts), independent=4, part=0.5)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        """In the place of a smooth element, and with one element more in that of several."""
        return [form(joint=j) for form in (MaxwellSlipFriction, _OneMore) for j in sites.joints]

    def basis(self, at: JointMotion) -> Array:
        if not at.follows:
            return np.repeat(reversal(at.v, SHARP)[:, None], self.count, axis=1)
        return np.stack([maxwell(at.q, d) for d in self.known_shape()], axis=1)

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(at.q), self.count))
        return zero, np.repeat(reversal_slope(at.v, SHARP)[:, None], self.count, axis=1), zero

    def law_parameters(self, motion: Motion) -> Array:
        return np.stack([self.known_coefficients(), self.known_shape()], axis=1)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """Of one element, which remembers its torque over its limit."""
        torque, deflection, before, part = parameters[0], parameters[1], parameters[4], parameters[5]
        part = np.minimum(np.maximum(part + (x - before) / deflection, -1.0), 1.0)
        out[0] = torque * part
        out[1] = torque / deflection * (np.abs(part) < 1.0)
        out[2] = 0.0
        out[4] = part


@dataclass(frozen=True, kw_only=True)
class _OneMore(StandIn, MaxwellSlipFriction, replaces=("maxwell_slip_friction",), needs=("maxwell_slip_friction",)):
    """One element more than are looked for at first."""

    in_files: ClassVar[type[Effect]] = MaxwellSlipFriction

    @property
    def count(self) -> int:
        return ELEMENTS + 1
