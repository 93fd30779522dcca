"""Look-alikes: what else would explain as much as an effect that was named, and the experiment that tells the two apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.diagnose.base import Base
from rx90b_flex.diagnose.experiments import RATE_HZ, SECONDS, experiments
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.trial import JUST_AS_GOOD, TorqueTrial
from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.identify.coloured import scatter
from rx90b_flex.identify.normal_equations import solve_weighted

MOST_OF_IT = 0.5  # of the named effect's gain that a look-alike explains at the least
APART = 2.0  # standard errors between two explanations above which the data has decided


@dataclass(frozen=True, eq=False)
class Alternative:
    """An effect that the data cannot tell from the one that was named.

    Attributes
    ----------
    effect : Effect
        With the values that fit best in the place of the named one.
    share : float
        Its gain on held-out blocks over the named effect's.
    size : int
        Parameters that it adds to the model.
    behind : float
        How much less it explains on held-out blocks, over the standard error of that.
    experiment : str
        The motion that would tell the two apart best, as a sentence; empty where none of those thought through would.
    apart : float
        Standard errors between the two after that motion, if the named effect is the right one.
    """

    effect: Effect
    share: float
    size: int
    behind: float
    experiment: str
    apart: float

    @property
    def advice(self) -> str:
        """What to record, and what that would bring."""
        if not self.experiment or self.apart <= APART:
            return (
                "No motion of one joint within the ranges of this data tells the two apart in "
                f"{SECONDS:g} s: the difference is of little consequence there."
            )
        return f"{self.experiment}: {SECONDS:g} s of that set the two {self.apart:.1f} standard errors apart."


def worth_comparing(search: Search, named: Effect, winner: TorqueTrial, rivals: Sequence[TorqueTrial]) -> list[Effect]:
    """Rivals of a round that touch what the named effect touches, explained much of it, and are not in the model by now."""
    present = [(type(e), e.place) for e in search.model.effects]
    others = [e for e in search.model.effects if e is not named and e.place]
    out = []
    for rival in rivals:
        effect = rival.effect
        near = not effect.joints or not named.joints or bool(set(effect.joints) & set(named.joints))
        free = (type(effect), effect.place) not in present
        shut_out = any(
            e.place == effect.place
            and (effect.type_name() in e.traits.stands_for or e.type_name() in effect.traits.stands_for)
            for e in others
        )
        if near and free and not shut_out and rival.gain >= MOST_OF_IT * winner.gain:
            out.append(effect)
    return out


@dataclass(frozen=True, eq=False)
class Comparison:
    """The final model with a rival that would be accepted in the place of an effect that was named; all coefficients fitted again.

    Attributes
    ----------
    named, rival : TorqueTrial
        Both beside the model without either.
    behind : float
        Held-out error with the rival less that with the named effect, over its standard error: the larger of the one from
        coloured noise and the one from block to block. Negative where the rival explains more.
    noise_over_white : float
        Variance of the difference of the two explanations over what white noise would give.
    """

    named: TorqueTrial
    rival: TorqueTrial
    behind: float
    noise_over_white: float

    @property
    def undecided(self) -> bool:
        """Whether both explain much the same, and neither does so better than chance allows."""
        mostly = self.rival.gain >= MOST_OF_IT * self.named.gain
        # a freer form of the same law, which holds it as a special case, is no other explanation
        other = self.named.effect.type_name() not in self.rival.effect.traits.stands_for
        return mostly and other and abs(self.behind) <= APART

    @property
    def rival_wins(self) -> bool:
        """Whether the rival explains more than chance allows, now that all else is in the model.

        One with more parameters has to explain more than a trifle: the named effect was preferred for having less.
        """
        trifle = self.rival.size > self.named.size and self.named.gain >= JUST_AS_GOOD * self.rival.gain
        return self.behind < -APART and not trifle


def compare(beside: _Beside, rival: Effect) -> Comparison | None:
    """Put a rival in the place of a named effect and compare the errors on held-out blocks; None where it would not be accepted."""
    first, second = beside.trial_of_named, beside.trial(rival)
    if not second.accepted:
        return None
    difference = first.block_gains - second.block_gains
    blocks = float(difference.std(ddof=1) * np.sqrt(len(difference)))
    apart = (beside.left(second.effect) - beside.left(first.effect)).T[:, :, None]
    model = beside.search.model
    weight = model.solution.sigma**-2.0
    coloured = float(scatter(apart, weight, model.spectra, model.regression.spans)[0, 0])
    white = float((weight[:, None] * apart[:, :, 0].T ** 2).sum())
    error = max(2.0 * np.sqrt(coloured), blocks, 1e-300)
    return Comparison(first, second, float(difference.sum() / error), coloured / white if white > 0 else 1.0)


def compared(search: Search, named: Effect, winner: TorqueTrial, rivals: Sequence[TorqueTrial]) -> list[Comparison]:
    """The named effect of the final model against each rival of its round that is worth it."""
    beside = _Beside(search, named)
    every = (compare(beside, r) for r in worth_comparing(search, named, winner, rivals))
    return [c for c in every if c is not None]


def alternatives(search: Search, named: Effect, comparisons: Sequence[Comparison]) -> tuple[Alternative, ...]:
    """The rivals that this data cannot tell from a named effect, the best first."""
    out = []
    for c in sorted((c for c in comparisons if c.undecided), key=lambda c: c.behind):
        text, apart = separating_experiment(search, named, c)
        out.append(Alternative(c.rival.effect, c.rival.gain / c.named.gain, c.rival.size, c.behind, text, apart))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class _Beside:
    """The final model without a named effect, but with what that one replaced."""

    search: Search
    named: Effect

    @property
    def restored(self) -> tuple[Effect, ...]:
        """Declared effects that the named one took the place of."""
        declared = self.search.regression.robot.effects
        return tuple(
            e for e in declared if e.place == self.named.place and e.type_name() in self.named.traits.stands_for
        )

    @property
    def kept(self) -> list[Effect]:
        """The model's other effects, in the order of its columns."""
        return [e for e in self.search.model.effects if e is not self.named]

    def base(self, candidate: Effect | None) -> Base:
        """What the candidate comes to: all of this, less what it replaces itself."""
        out = tuple(e for e in self.restored if candidate is None or e.type_name() not in candidate.traits.stands_for)
        return self.search.base(self.named, out)

    def trial(self, effect: Effect) -> TorqueTrial:
        """Of an effect in the named one's place."""
        return self.search.trial(effect, self.base(effect), self.base(None), 1)

    @cached_property
    def trial_of_named(self) -> TorqueTrial:
        """The named effect's own, which all rivals are compared with."""
        return self.trial(self.named)

    def left(self, effect: Effect) -> Array:
        """Residual with an effect in the named one's place, shape (joints, N)."""
        return self.search.left_with(effect, self.base(effect))


# ---- the experiment that would decide -----------------------------------------------------------------------


def separating_experiment(search: Search, present: Effect, compared: Comparison) -> tuple[str, float]:
    """The motion after which a named effect and its rival stand farthest apart, and by how many standard errors.

    Torque of the named effect is made on the data and on each experiment; the rival, its shape and all coefficients of
    the model are fitted to both together. What cannot be fitted is what tells them apart (T-optimality, Atkinson and
    Fedorov, 1975). An experiment is one of a few motions of one joint concerned, within the ranges of the data.
    """
    named, rival = compared.named.effect, compared.rival.effect
    joints = list(dict.fromkeys((*named.joints, *rival.joints))) or list(search.regression.joints)
    beside = _Beside(search, present)
    data = _Fitted.on_data(search, beside, named, rival)
    best = ("", data.distance())
    for joint in joints:
        for text, motion in experiments(search, joint):
            apart = data.plus(_Fitted.on_motion(search, beside, named, rival, motion)).distance()
            if apart > best[1]:
                best = (text, apart)
    return best[0], float(np.sqrt(best[1] / compared.noise_over_white) / 2.0)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Normal equations of a rival's fit to the torque of a named effect."""

    gram: Array
    cross: Array
    power: float

    @staticmethod
    def of(columns: Array, torque: Array, weight: Array) -> _Fitted:
        """From columns (N, joints, p) and the named effect's torque (N, joints)."""
        x = (columns * np.sqrt(weight)[:, None]).reshape(-1, columns.shape[2])
        y = (torque * np.sqrt(weight)).reshape(-1)
        return _Fitted(x.T @ x, x.T @ y, float(y @ y))

    @staticmethod
    def on_data(search: Search, beside: _Beside, named: Effect, rival: Effect) -> _Fitted:
        model, regression = search.model, search.regression
        links = [regression.link_columns] if model.links_fitted else []
        others = [regression.columns(e) for e in (*beside.kept, *beside.restored)]
        columns = [*links, *others, *(regression.columns(e) for e in _with_slopes(rival))]
        torque = regression.columns(named) @ named.known_coefficients()
        return _Fitted.of(_joined(columns, rival), torque, model.solution.sigma**-2.0)

    @staticmethod
    def on_motion(search: Search, beside: _Beside, named: Effect, rival: Effect, motion: Motion) -> _Fitted:
        model, rows = search.model, search.regression.rows

        def of(effect: Effect) -> Array:
            return search.regression.seen(effect, effect.columns(motion))

        links = [motion.on_tree.link_regressor()[:, rows]] if model.links_fitted else []
        columns = [*links, *(of(e) for e in (*beside.kept, *beside.restored, *_with_slopes(rival)))]
        # as many samples as the data's rate would give
        weight = model.solution.sigma**-2.0 * search.regression.segments[0].rate_hz / RATE_HZ
        return _Fitted.of(_joined(columns, rival), of(named) @ named.known_coefficients(), weight)

    def plus(self, other: _Fitted) -> _Fitted:
        return _Fitted(self.gram + other.gram, self.cross + other.cross, self.power + other.power)

    def distance(self) -> float:
        """What of the named effect's torque the rival cannot imitate: weighted square."""
        theta, _, _, _ = solve_weighted(self.gram, self.cross, np.zeros(len(self.cross)))
        return max(self.power - 2 * float(self.cross @ theta) + float(theta @ self.gram @ theta), 0.0)


def _with_slopes(effect: Effect) -> list[Effect]:
    """The effect, and a neighbour in each of its shape parameters: the rival may change its shape too."""
    steps = np.diag(1e-3 * np.maximum(np.abs(effect.shape), 1e-3))
    return [effect, *(effect.with_shape(effect.shape + step) for step in steps)]


def _joined(columns: Sequence[Array], rival: Effect) -> Array:
    """Columns side by side; the last ones, of the rival's neighbours, become derivatives of its torque by the shape."""
    s = len(rival.shape)
    steps = 1e-3 * np.maximum(np.abs(rival.shape), 1e-3)
    own = columns[len(columns) - 1 - s]
    slopes = [(columns[len(columns) - s + i] - own) @ rival.known_coefficients() / steps[i] for i in range(s)]
    return np.concatenate([*columns[: len(columns) - s], *(x[:, :, None] for x in slopes)], axis=2)


def swapped(effects: Sequence[Effect], named: Effect, comparison: Comparison, search: Search) -> list[Effect]:
    """The model's effects with the rival in the named one's place."""
    rival = comparison.rival.effect
    beside = _Beside(search, named)
    restored = [e for e in beside.restored if e.type_name() not in rival.traits.stands_for]
    kept = [
        e
        for e in effects
        if e is not named and not (e.place == rival.place and e.type_name() in rival.traits.stands_for)
    ]
    return [*kept, *restored, rival]
