"""Whether what the fitted recordings show too seldom for a name shows in those held out as well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.moving import unmoved
from rx90b_flex.effects import Effect, Sites, catalogue
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import Segment

THERE = 0.05  # of an effect's largest torque: rows with less of it tell nothing of it
TAKEN = 0.5  # of the squared error of those rows, at the least
TIMES = 2.0  # root mean square there over that elsewhere, at the least


@dataclass(frozen=True)
class Seldom:
    """An effect that the search had too little to try by, and that carries over.

    Attributes
    ----------
    effect : Effect
        With the values that the fitted recordings give it.
    share : float
        Part of the squared error that it takes off held-out rows which it acts in, 0 to 1.
    """

    effect: Effect
    share: float

    @property
    def words(self) -> str:
        """One caution."""
        values = ", ".join(f"{name} {value:.3g} {unit}" for name, unit, value in self.effect.public_values())
        return (
            f"{self.effect.label} ({values}): what the fitted recordings show of it takes {self.share:.0%} off the squared error "
            "where it acts in those held out. They show it too seldom for a name; one more such recording would tell."
        )


def shown_seldom(fitted: tuple[Regression, Array], held_out: tuple[Regression, Array]) -> tuple[Seldom, ...]:
    """Those of all effects that are told so (`Hints.too_seldom`), for the residuals (N, joints) of both roles' motors."""
    regression = fitted[0]
    motions = tuple(s.motion for s in regression.segments)
    sites = Sites(regression.joints, regression.robot.tip_frame, motions)
    tried = (effect for kind in catalogue().values() for effect in kind.too_seldom(sites))
    found = (_of(effect, fitted, held_out) for effect in tried)
    return tuple(f for f in found if f is not None)


def _of(effect: Effect, fitted: tuple[Regression, Array], held_out: tuple[Regression, Array]) -> Seldom | None:
    """With the shape and the coefficient, above its bound, that take the most off the fitted error."""
    regression, residual = fitted
    left = residual[:, regression.joints.index(effect.joints[0])]
    (parameter,) = effect.coefficient_parameters.values()
    best = 0.0, effect
    for shape in effect.shape_search(regression.longest).starts:
        one = effect.with_shape(shape).with_coefficients([1.0])
        column = _column(one, regression)
        size = float(column @ column)
        value = float(column @ left) / max(size, 1e-300)
        if value > parameter.lower:
            best = max(best, (value**2 * size, one.with_coefficients([value])), key=lambda x: x[0])
    if best[1] is effect:
        return None
    shares = [_share(best[1], *role) for role in (fitted, held_out)]
    return Seldom(best[1], shares[1]) if min(shares) > TAKEN else None


def _share(effect: Effect, regression: Regression, residual: Array) -> float:
    """Part of the squared error that an effect takes off where it acts; zero where that is little more than elsewhere."""
    column, left = _column(effect, regression), residual[:, regression.joints.index(effect.joints[0])]
    there = np.abs(column) > THERE * np.abs(column).max()
    if not there.any():
        return 0.0
    here, elsewhere = float((left[there] ** 2).mean()), float((left[~there] ** 2).sum()) / max((~there).sum(), 1)
    return 1.0 - float(((left - column)[there] ** 2).mean()) / here if here > TIMES**2 * elsewhere else 0.0


def _column(effect: Effect, regression: Regression) -> Array:
    """Torque on its joint behind the low-pass, (N,); zero until that has moved, for nobody knows what friction holds."""
    joint = regression.joints.index(effect.joints[0])
    return np.concatenate([_in_segment(effect, s, joint) for s in regression.segments])


def _in_segment(effect: Effect, s: Segment, joint: int) -> Array:
    still, force = (
        x[:: s.factor][s.kept, joint]
        for x in (unmoved(s.motion.v, s.rate_hz * s.factor), s.low_passed(effect.force(s.motion)))
    )
    return np.where(still, 0.0, force)
