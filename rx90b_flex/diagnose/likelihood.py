"""Residuals that compare models by their likelihood: what modes, frequency responses and other small tables are closed with.

Models are compared by one number, the deviance ``-2 log likelihood`` with a *model error*: a scatter of unknown size beside the
measured standard deviations, estimated with each model. What is tried is charged for its parameters and for the number of other
changes that might have been tried instead (extended BIC: J. Chen, Z. Chen, Biometrika 95, 2008). Two hinges of one effect take one
parameter; one each competes by the same number, at odds of 1 to 20, before anything else is added.
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import abstractmethod
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
from scipy import stats
from scipy.special import gammaln

from rx90b_flex.diagnose.loop import Addition, Candidates, ClosingLoop, Progress, Residual, Standing, verdict
from rx90b_flex.diagnose.trial import SIGNIFICANCE, Trial
from rx90b_flex.effects.motion import Array
from rx90b_flex.levenberg import Damping, Iterate, lowest

PAIRS = 2  # changes that are tried with company where none is sure alone
MISFIT = 1.0e-3  # probability below which scatter beyond the stated errors is not called chance
RIVAL = 2.0 * np.log(20.0)  # criterion: a change whose odds against the best are better than 1 to 20 is an alternative
MOST_CHANGES = 6  # more than this describe the data rather than explain them
FIRST_ERROR = 0.25  # model error that a fit begins with: wide valleys
SCOUTED = 8  # steps from each start, at the least, before the best are followed
STEPS = 60  # before a fit ends, at the most
DAMPING = Damping(1e-2, rise=8.0, fall=5.0)
UNLIKE = np.array([[0.5, -0.5], [-0.5, 0.5]])  # logarithms by which unlike hinges begin off alike ones
CLOSE = 20.0  # deviance: scouted starts and changes this near the best are followed to their end


@dataclass(frozen=True, eq=False)
class Change:
    """One thing that a model may lack: an effect in a place, or other values of declared ones.

    Attributes
    ----------
    type : str
        Effect type.
    place : str
        Joint, frame, ``base``, or ``all``.
    adds : bool
        Whether it adds the effect; otherwise it multiplies declared values.
    names, units : tuple of str
        Of its parameters.
    starts : array, shape (S, k)
        Logarithms of the parameters from which a fit begins; of factors over declared values.
    usual : array, shape (k,)
        Centre of the prior of the logarithms.
    std : float
        Its standard deviation.
    moves : tuple of tuple of int
        Of a `rx90b_flex.diagnose.flexible.Structure`, coefficients that each parameter multiplies.
    frees : tuple of str
        Coordinates that it adds to one.
    unlike : Change, optional
        The same with a parameter for each of two hinges.
    charge : float
        On the criterion, beside that for its parameters: what is less to be expected takes more evidence.
    """

    type: str
    place: str
    adds: bool
    names: tuple[str, ...]
    units: tuple[str, ...]
    starts: Array
    usual: Array
    std: float
    moves: tuple[tuple[int, ...], ...] = ()
    frees: tuple[str, ...] = ()
    unlike: Change | None = None
    charge: float = 0.0

    @property
    def label(self) -> str:
        """As in ``joint_4.drive_flexibility`` for what is added, ``joint_2.drive_stiffness`` for what is changed."""
        return f"{self.place}.{self._kind}"

    @property
    def _kind(self) -> str:
        if self.adds:
            return self.type
        return self.names[0] if self.size == 1 else self.names[0].removesuffix("_1")

    @property
    def words(self) -> str:
        """In a sentence."""
        kind = self._kind.replace("_", " ")
        where = "" if self.place == "base" else f" of {self.place.replace('_', ' ')}"
        return f"{kind}{where}" if self.adds else f"another {kind}{where}"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.names)


@dataclass(frozen=True, eq=False)
class State:
    """What a residual says of one model at one x.

    Attributes
    ----------
    deviance : float
        -2 log likelihood, without a prior.
    gradient, information : array, (p,) and (p, p)
        Half its gradient by x, and the Gauss-Newton form of half its second derivative.
    model_error : float
        Most likely size of the model error for these residuals.
    """

    deviance: float
    gradient: Array
    information: Array
    model_error: float


@dataclass(frozen=True, eq=False)
class LikelihoodFit:
    """A robot with some changes, fitted.

    Attributes
    ----------
    changes : tuple of Change
    x : array, shape (p,)
        Logarithms of the parameters of nuisances, then of changes, over the coefficients' values.
    covariance : array, shape (p, p)
    deviance : float
        With the prior's part.
    model_error : float
        What scatter is needed beside the stated errors; relative.
    """

    changes: tuple[Change, ...]
    x: Array
    covariance: Array
    deviance: float
    model_error: float


@dataclass(frozen=True, eq=False)
class LikelihoodTrial(Trial):
    """A change that was tried beside others.

    Attributes
    ----------
    change : Change
    fit : LikelihoodFit
        With it.
    gain : float
        Drop of the deviance by it.
    p_value : float
        That it explains nothing, corrected for the number tried.
    criterion : float
        Extended BIC of the fit; lower is better.
    lowered : float
        By how much that is below the criterion without it.
    """

    change: Change
    fit: LikelihoodFit
    gain: float
    p_value: float
    criterion: float
    lowered: float

    @property
    def label(self) -> str:
        return self.change.label

    @property
    def refusal(self) -> str:
        """Why it is not significant, or not worth its parameters."""
        if self.p_value > SIGNIFICANCE:
            return f"chance would do as well (p = {self.p_value:.2g})"
        return "" if self.lowered >= 0 else "its parameters cost more than it explains"

    def as_json(self) -> dict[str, Any]:
        """As an alternative in ``closed_loop.json``."""
        c = self.change
        return {"type": c.type, "place": c.place, "label": c.label, "criterion": self.criterion}


@dataclass(frozen=True, eq=False)
class FoundChange:
    """A change that the data support.

    Attributes
    ----------
    change : Change
    values, stds : array, shape (k,)
        Of its parameters: values of what is added, factors on declared values.
    gain, p_value : float
        Against the final model without it.
    criterion : float
        Extended BIC of the final model.
    alternatives : tuple of LikelihoodTrial
        Changes that in its stead do nearly as well: the data cannot tell them apart.
    """

    change: Change
    values: Array
    stds: Array
    gain: float
    p_value: float
    criterion: float
    alternatives: tuple[LikelihoodTrial, ...]

    @property
    def words(self) -> str:
        """With its values, in a sentence."""
        c = self.change
        if not c.adds:
            factors = " and ".join(f"{v:.3g} ± {s:.2g}" for v, s in zip(self.values, self.stds, strict=True))
            return f"{c.words}: {factors} times the declared value"
        values = ", ".join(
            f"{n.replace('_', ' ')} {v:.4g} ± {s:.2g} {u}"
            for n, v, s, u in zip(c.names, self.values, self.stds, c.units, strict=True)
        )
        return f"{c.words}: {values}"

    def as_json(self) -> dict[str, Any]:
        """As an effect in ``closed_loop.json``."""
        c = self.change
        return {
            "type": c.type,
            "place": c.place,
            "change": "added" if c.adds else "multiplied",
            "parameters": {
                name: {"value": float(v), "std": float(s), "unit": unit if c.adds else "-"}
                for name, unit, v, s in zip(c.names, c.units, self.values, self.stds, strict=True)
            },
            "deviance_gain": self.gain,
            "criterion": self.criterion,
            "p_value": self.p_value,
            "alternatives": [t.as_json() for t in self.alternatives],
        }


@dataclass(frozen=True, eq=False)
class _Descending(Iterate):
    """Values x on their way to the lowest deviance, the model error on its way to its most likely size."""

    evaluate: Callable[[Array, float], State]
    weight: Array  # of the prior
    centre: Array
    x: Array
    error: float
    least: int  # steps, before one that gains less than `CLOSE` is the last
    steps: int = 0

    @cached_property
    def state(self) -> State:
        return self.evaluate(self.x, self.error)

    @property
    def goal(self) -> float:
        return self.state.deviance + float(self.weight @ (self.x - self.centre) ** 2)

    @property
    def enough(self) -> float:
        if self.renewed() is not self:
            return -1.0
        return 1e-4 if self.steps < self.least else CLOSE

    def equations(self) -> tuple[Array, Array]:
        return self.state.information + np.diag(self.weight), -self.state.gradient - self.weight * (
            self.x - self.centre
        )

    def moved(self, step: Array) -> _Descending:
        step = step * min(1.0, 1.0 / max(float(np.abs(step).max(initial=0.0)), 1e-12))
        return dataclasses.replace(self, x=self.x + step, steps=self.steps + 1)

    def renewed(self) -> _Descending:
        # no faster than by halves: a small error too early fixes a wrong pairing of modes
        error = max(self.state.model_error, 0.5 * self.error)
        return self if abs(error - self.error) <= 1e-3 * self.error else dataclasses.replace(self, error=error)


class LikelihoodResidual(Residual["LikelihoodFit", "LikelihoodTrial"]):
    """Data whose errors are normal, beside those of a model that is never quite right.

    A kind of data gives `changes`, `smallest_error`, `size`, `evaluate` and `chance`; how models are fitted, tried and judged is
    here.
    """

    nuisance: tuple[Change, ...] = ()  # in every model
    smallest_error: float  # of the model: stated, not estimated
    largest_error: ClassVar[float] = 3.0  # that is weighed

    @cached_property
    def model_errors(self) -> Array:
        """Model errors that are weighed, the smallest last, shape (E,)."""
        errors = np.geomspace(1e-5, self.largest_error, 61)
        return np.append(errors[self.smallest_error < errors], self.smallest_error)

    def of_independent(
        self,
        left: Array,
        slopes: Array,
        variance: Array,
        scale: Array | float,
        model_error: float,
        cost: float | None = None,
    ) -> State:
        """For `evaluate`: errors (m,) independent of each other, slopes (m, p) of what the model predicts by x.

        Their variances are the stated ones and that of a model error of so much of `scale`; `cost` is the deviance where that is more
        than theirs.
        """
        total = variance + (max(model_error, self.smallest_error) * scale) ** 2
        weighted = slopes / total[:, None]
        deviance = float((np.log(2.0 * np.pi * total) + left**2 / total).sum()) if cost is None else cost
        of_each = variance + (self.model_errors[:, None] * scale) ** 2
        likely = np.argmin((np.log(of_each) + left**2 / of_each).sum(axis=1))
        return State(deviance, -weighted.T @ left, weighted.T @ slopes, float(self.model_errors[likely]))

    @staticmethod
    def by_chi_squared(squares: float, count: float, fit: LikelihoodFit) -> float:
        """Probability of so large a sum of so many squares over their variances after a fit, for `chance`."""
        return float(stats.chi2.sf(squares, max(count - len(fit.x), 1.0)))

    @property
    @abstractmethod
    def changes(self) -> tuple[Change, ...]:
        """All that may be tried."""

    @property
    @abstractmethod
    def size(self) -> float:
        """Independent numbers in the data."""

    @abstractmethod
    def evaluate(self, changes: tuple[Change, ...], x: Array, model_error: float) -> State:
        """The deviance at x, nuisances first."""

    @abstractmethod
    def chance(self, fit: LikelihoodFit) -> float:
        """Probability of a misfit as large as this one, if the model were right to within the stated errors."""

    def fit(
        self, changes: tuple[Change, ...], begin: dict[Change, Array] | None = None, error: float = FIRST_ERROR
    ) -> LikelihoodFit:
        """Most likely values, from all starts of what has none in `begin`; the model error shrinks from `error`."""
        scouted = self.scouted(changes, begin, error)
        found = [self.followed(f) for f in scouted[:2] if f.deviance < scouted[0].deviance + CLOSE]
        return min(found, key=lambda f: f.deviance)

    def scouted(
        self, changes: tuple[Change, ...], begin: dict[Change, Array] | None, error: float
    ) -> list[LikelihoodFit]:
        """From each start until a step gains little, best first."""
        known = begin or {}
        choices = [np.atleast_2d(known[c]) if c in known else c.starts for c in (*self.nuisance, *changes)]
        starts = [np.concatenate([*start, np.zeros(0)]) for start in itertools.product(*choices)]
        return sorted((self._descend(changes, x, error, SCOUTED) for x in starts), key=lambda f: f.deviance)

    def followed(self, fit: LikelihoodFit) -> LikelihoodFit:
        """A fit brought to its end."""
        return self._descend(fit.changes, fit.x, fit.model_error, STEPS)

    def _descend(self, changes: tuple[Change, ...], x: Array, error: float, least: int) -> LikelihoodFit:
        """Levenberg-Marquardt on the deviance; the model error shrinks as the fit gets better.

        After `least` steps one that gains less than `CLOSE` is the last.
        """
        everything = (*self.nuisance, *changes)
        weight = np.concatenate([*(np.full(c.size, c.std**-2.0) for c in everything), np.zeros(0)])
        centre = np.concatenate([*(c.usual for c in everything), np.zeros(0)])
        begin = _Descending(partial(self.evaluate, everything), weight, centre, x, error, least)
        end = lowest(begin, 2 * STEPS, DAMPING)
        curvature = end.equations()[0]
        covariance: Array = np.asarray(np.linalg.inv(curvature)) if len(x) else np.zeros((0, 0))
        return LikelihoodFit(changes, end.x, covariance, end.goal, end.error)

    def begin(self, fit: LikelihoodFit) -> dict[Change, Array]:
        """A fit's values by change, to begin another from."""
        out, at = {}, 0
        for change in (*self.nuisance, *fit.changes):
            out[change] = fit.x[at : at + change.size]
            at += change.size
        return out

    # ---- what the loop asks

    def declared(self) -> LikelihoodFit:
        return self.fit(())

    def signature(self, model: LikelihoodFit, trial: LikelihoodTrial | None = None) -> Hashable:
        return frozenset(model.changes if trial is None else trial.fit.changes)

    def candidates(self, standing: Standing[LikelihoodFit, LikelihoodTrial]) -> Sequence[Candidates]:
        return (Candidates(),) if self.chance(standing.model) < MISFIT else ()

    def trials(
        self,
        model: LikelihoodFit,
        some: Candidates,
        told: Callable[[float], None],
        company_of: LikelihoodTrial | None = None,
    ) -> list[LikelihoodTrial]:
        return list(self._beside(model.changes, model, told))

    def choose(self, trials: Sequence[LikelihoodTrial]) -> LikelihoodTrial | None:
        return trials[0] if trials and trials[0].accepted else None

    def joined(self, model: LikelihoodFit, trial: LikelihoodTrial) -> LikelihoodFit:
        return trial.fit

    def holds(self, model: LikelihoodFit, trial: LikelihoodTrial) -> bool:
        return trial.change in model.changes

    def hopeful(self, trials: Sequence[LikelihoodTrial]) -> list[LikelihoodTrial]:
        return [t for t in trials[:PAIRS] if t.lowered > 0]

    def companion(
        self, half: LikelihoodFit, first: LikelihoodTrial, beside: Sequence[LikelihoodTrial]
    ) -> LikelihoodTrial | None:
        if not beside:
            return None
        second, many = beside[0], len(self.changes)
        size = first.change.size + second.change.size
        p_value = 0.5 * many * (many - 1) * self._by_chance(first.gain + second.gain, size, second.fit)
        return second if p_value <= SIGNIFICANCE and second.lowered > 0 else None

    def worth(self, model: LikelihoodFit, trial: LikelihoodTrial) -> LikelihoodTrial:
        return self._trial(trial.change, self._less(model, trial.change), model)

    def needless(
        self, standing: Standing[LikelihoodFit, LikelihoodTrial], latest: int, everywhere: bool = True
    ) -> Addition[LikelihoodTrial] | None:
        if len(standing.steps) < 2:
            return None
        worths = [self.worth(standing.model, s.trial) for s in standing.steps]
        least = max(range(len(worths)), key=lambda i: worths[i].p_value)
        return None if worths[least].accepted else standing.steps[least]

    def without(
        self, standing: Standing[LikelihoodFit, LikelihoodTrial], step: Addition[LikelihoodTrial]
    ) -> tuple[LikelihoodFit, list[LikelihoodTrial]]:
        return self._less(standing.model, step.trial.change), []

    def instead(
        self, model: LikelihoodFit, step: Addition[LikelihoodTrial]
    ) -> tuple[LikelihoodTrial, LikelihoodFit] | None:
        others = self._others(model, step.trial.change)
        better = bool(others) and others[0].criterion < self._criterion(model)
        return (others[0], others[0].fit) if better else None

    # ---- trials

    def _beside(
        self, kept: tuple[Change, ...], near: LikelihoodFit, told: Callable[[float], None] = lambda part: None
    ) -> list[LikelihoodTrial]:
        """Every change beside `kept`, whose values begin near those of a fit; lowest criterion first."""
        key = frozenset(kept)
        candidates = [c for c in self.changes if c.label not in {k.label for k in kept}]
        if key not in self._rounds and candidates:
            base = self._refitted(kept, near)
            begin, error, fits = self.begin(base), min(FIRST_ERROR, 3.0 * base.model_error), []
            for i, change in enumerate(candidates):
                told(i / len(candidates))
                alike = self.scouted((*kept, change), begin, error)[:2]
                fits += alike
                if change.unlike is not None:
                    apart = begin | {change.unlike: alike[0].x[-1] + UNLIKE}
                    fits += self.scouted((*kept, change.unlike), apart, error)[:2]
            close = min(f.deviance for f in fits) + CLOSE
            fits = [self.followed(f) if f.deviance < close else f for f in fits]
            best = {f.changes[-1].label: f for f in sorted(fits, key=lambda f: -self._criterion(f))}
            tried = [self._trial(f.changes[-1], base, f) for f in best.values()]
            self._rounds[key] = sorted(tried, key=lambda t: t.criterion)
        return self._rounds.get(key, [])

    def _others(self, model: LikelihoodFit, change: Change) -> list[LikelihoodTrial]:
        """Every other change in the stead of one that a model holds."""
        kept = tuple(c for c in model.changes if c is not change)
        return [t for t in self._beside(kept, model) if t.label != change.label]

    def _trial(self, change: Change, without: LikelihoodFit, fit: LikelihoodFit) -> LikelihoodTrial:
        gain, criterion = without.deviance - fit.deviance, self._criterion(fit)
        p_value = min(1.0, len(self.changes) * self._by_chance(gain, change.size, fit))
        return LikelihoodTrial(change, fit, gain, p_value, criterion, self._criterion(without) - criterion)

    def _by_chance(self, gain: float, size: int, fit: LikelihoodFit) -> float:
        """Probability of such a gain by parameters that mean nothing."""
        # a likelihood ratio of few data is too large: charge it for the parameters already fitted
        fair = max(1.0 - (len(fit.x) + 1) / self.size, 0.1)
        return float(stats.chi2.sf(max(fair * gain, 0.0), size))

    def _criterion(self, fit: LikelihoodFit) -> float:
        chosen, many = len(fit.changes), len(self.changes)
        ways = gammaln(many + 1) - gammaln(chosen + 1) - gammaln(many - chosen + 1)
        charged = sum(c.charge for c in fit.changes)
        return fit.deviance + len(fit.x) * np.log(self.size) + 2.0 * float(ways) + charged

    def _refitted(self, changes: tuple[Change, ...], near: LikelihoodFit) -> LikelihoodFit:
        return near if changes == near.changes else self.fit(changes, self.begin(near))

    def _less(self, model: LikelihoodFit, change: Change) -> LikelihoodFit:
        """A model without one of its changes."""
        if (model, change) not in self._fits:
            self._fits[model, change] = self._refitted(tuple(c for c in model.changes if c is not change), model)
        return self._fits[model, change]

    @cached_property
    def _rounds(self) -> dict[frozenset[Change], list[LikelihoodTrial]]:
        return {}

    @cached_property
    def _fits(self) -> dict[tuple[LikelihoodFit, Change], LikelihoodFit]:
        return {}

    def found(self, model: LikelihoodFit, trial: LikelihoodTrial) -> FoundChange:
        """What a trial added, with its values in the final model."""
        change, worth = trial.change, self.worth(model, trial)
        near = [t for t in self._others(model, change) if t.criterion < worth.criterion + RIVAL]
        at = sum(c.size for c in (*self.nuisance, *model.changes[: model.changes.index(change)]))
        own = slice(at, at + change.size)
        value = np.exp(model.x[own])
        std = value * np.sqrt(np.diag(model.covariance)[own])
        return FoundChange(change, value, std, worth.gain, worth.p_value, worth.criterion, tuple(near))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search over changes found.

    Attributes
    ----------
    before, after : LikelihoodFit
        Of the declared robot, and of the robot with what was found.
    found : tuple of FoundChange
        In the order in which they were added.
    refused : tuple of LikelihoodTrial
        Of the last round, best first.
    verdict : str
        ``nothing_missing``, ``explained``, ``partly_explained``, ``unexplained``.
    chance_before, chance_after : float
        Probability of such a misfit if the model were right to within the stated errors.
    tried : int
        Changes that a round may try.
    """

    before: LikelihoodFit
    after: LikelihoodFit
    found: tuple[FoundChange, ...]
    refused: tuple[LikelihoodTrial, ...]
    verdict: str
    chance_before: float
    chance_after: float
    tried: int

    def as_json(self) -> dict[str, Any]:
        """What ``closed_loop.json`` says of it, whatever the data."""
        return {"effects": [f.as_json() for f in self.found], "verdict": self.verdict, "tried": self.tried}


def close_residual(
    residual: LikelihoodResidual, progress: Progress | None = None, most: int = MOST_CHANGES
) -> SearchResult:
    """Close the loop on a residual: add the change that explains most, again and again; take out what became needless.

    Parameters
    ----------
    residual : LikelihoodResidual
    progress : callable, optional
        Called with a message and a fraction.
    most : int
        Changes at the most.
    """
    loop = ClosingLoop(residual, progress or (lambda text, part: None), most)
    standing = loop.run()
    before, after = loop.declared, standing.model
    found = tuple(residual.found(after, s.trial) for s in standing.steps)
    chances = residual.chance(before), residual.chance(after)
    said = verdict(bool(found), left=chances[1] < MISFIT)
    return SearchResult(before, after, found, standing.refused, said, *chances, len(residual.changes))
