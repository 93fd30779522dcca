"""Closing the loop, whatever was measured: add what explains most, fit again, take out what that made needless, and go round.

A `Residual` is one kind of data: it fits models to them, tries what may be missing, and says what each trial is worth. The loop
before it decides what is added, alone or in pairs, what goes again, and what takes another's place; no model is visited twice.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import groupby, pairwise
from typing import Any, Generic, TypeVar

from rx90b_flex.diagnose.trial import Trial
from rx90b_flex.effects import Effect

TRIES = 12  # candidates of a round that are added for a trial at the most: what falls says little of those behind it

Progress = Callable[[str, float], None]
ModelT = TypeVar("ModelT")
TrialT = TypeVar("TrialT", bound=Trial)


@dataclass(frozen=True)
class Candidates:
    """Candidates of a round that are tried together; those of the next only where none of them is added.

    Attributes
    ----------
    kinds : callable
        Which types of effect are tried.
    in_pairs : bool
        Whether two of which none is sure alone are tried together.
    told : bool
        Whether what it refused is kept.
    """

    kinds: Callable[[type[Effect]], bool] = lambda kind: True
    in_pairs: bool = True
    told: bool = True


@dataclass(frozen=True, eq=False)
class Addition(Generic[TrialT]):
    """One addition: the trial that won, what it beat, and the errors before and after it (`Residual.errors_of`)."""

    trial: TrialT
    rivals: tuple[TrialT, ...]
    before: Any
    after: Any


@dataclass(frozen=True, eq=False)
class Standing(Generic[ModelT, TrialT]):
    """Where the loop stands: a model, what was added to it, what a round that added nothing refused, and what was taken out in
    the end, for it does not carry over.
    """

    model: ModelT
    steps: tuple[Addition[TrialT], ...] = ()
    refused: tuple[TrialT, ...] = ()
    taken_out: tuple[TrialT, ...] = ()


class Residual(ABC, Generic[ModelT, TrialT]):
    """One kind of data that models are held against.

    A model is whatever its `declared` and `joined` return; the loop does not look into it.
    """

    @abstractmethod
    def declared(self) -> ModelT:
        """The model with nothing added, fitted."""

    @abstractmethod
    def signature(self, model: ModelT, trial: TrialT | None = None) -> Hashable:
        """What tells a model, or one with a trial's candidate beside it, from others."""

    @abstractmethod
    def candidates(self, standing: Standing[ModelT, TrialT]) -> Sequence[Candidates]:
        """What a round tries, one after the other; none where nothing is left to look for."""

    @abstractmethod
    def trials(
        self, model: ModelT, some: Candidates, told: Callable[[float], None], company_of: TrialT | None = None
    ) -> list[TrialT]:
        """Every one of some candidates, tried beside a model; best first.

        Of the company of a trial that is in the model and not sure, single ones are enough, and those that can have to do with it.
        """

    def choose(self, trials: Sequence[TrialT]) -> TrialT | None:
        """Which one to add; None where none is accepted."""
        return next((t for t in trials if t.accepted), None)

    @abstractmethod
    def joined(self, model: ModelT, trial: TrialT) -> ModelT:
        """The model with a trial's candidate, all fitted again."""

    def settled(self, model: ModelT) -> ModelT:
        """A model that is kept, where its fit is then brought further than that of one which is only tried."""
        return model

    def refit(self, model: ModelT, trial: TrialT) -> tuple[ModelT | None, TrialT]:
        """The settled model with a trial's candidate, None where that does not help; and the trial, which may fall with it."""
        return self.settled(self.joined(model, trial)), trial

    def unsure(self, model: ModelT, trial: TrialT) -> str:
        """Why what a trial added is not certain in a model that holds it, in words; empty where it is."""
        return ""

    def fallen(self, trial: TrialT, why: str) -> TrialT:
        """A trial that was accepted by itself and is not added all the same, with the reason."""
        return trial

    def errors_of(self, model: ModelT) -> Any:
        """A model's errors, which are kept with every addition; the models themselves are too large for that."""
        return None

    def findings(self, trial: TrialT) -> list[TrialT]:
        """What an added trial counts as: one addition, those of a family, or none."""
        return [trial]

    @abstractmethod
    def holds(self, model: ModelT, trial: TrialT) -> bool:
        """Whether what a trial added is still in a model."""

    def spoils(self, new: ModelT, old: ModelT) -> bool:
        """Whether a model does worse than the one that the round began with."""
        return False

    @abstractmethod
    def hopeful(self, trials: Sequence[TrialT]) -> list[TrialT]:
        """Trials that are not sure alone and worth company."""

    @abstractmethod
    def companion(self, half: ModelT, first: TrialT, beside: Sequence[TrialT]) -> TrialT | None:
        """Of what was tried beside the first of two, the one with which both are sure."""

    @abstractmethod
    def worth(self, model: ModelT, trial: TrialT) -> TrialT:
        """The trial of adding what a model holds to the same model without it."""

    def apart(self, trials: Sequence[TrialT], new: ModelT, old: ModelT, beside: Sequence[TrialT] = ()) -> list[TrialT]:
        """Trials beside an old model that have nothing to do with what a new one has more, nor with the trials `beside` it."""
        return []

    def together(self, model: ModelT, trials: Sequence[TrialT]) -> ModelT | None:
        """The settled model with several trials that have nothing to do with each other; None where any does not help in it."""
        return None

    def errors_along(self, old: ModelT, new: ModelT, trials: Sequence[TrialT]) -> list[Any]:
        """Errors before and after each of the trials that are in the new model together, one more than there are."""
        return [self.errors_of(old)] * len(trials) + [self.errors_of(new)]

    def once_more(self, model: ModelT, trial: TrialT) -> TrialT:
        """A trial beside another model, its candidate as it was."""
        return trial

    def once_fitted(self, half: ModelT, first: TrialT) -> TrialT:
        """A trial that was not sure alone, in the model that was fitted with it."""
        return self.worth(half, first)

    @abstractmethod
    def needless(
        self, standing: Standing[ModelT, TrialT], latest: int, everywhere: bool = True
    ) -> Addition[TrialT] | None:
        """An addition that the model can do without, after the latest so many; None where there is none.

        Unless asked for `everywhere`, one that has nothing to do with these need not be looked at.
        """

    @abstractmethod
    def without(self, standing: Standing[ModelT, TrialT], step: Addition[TrialT]) -> tuple[ModelT, list[TrialT]]:
        """The model without an addition, and the trials of what that stood in for, where it is a finding by itself."""

    def burden(self, standing: Standing[ModelT, TrialT]) -> tuple[Addition[TrialT], TrialT] | None:
        """The addition that does most harm to data that were not fitted, and its trial, which says so; None where none does."""
        return None

    @abstractmethod
    def instead(self, model: ModelT, step: Addition[TrialT]) -> tuple[TrialT, ModelT] | None:
        """What explains more in an addition's place, now that everything else is in the model, and the model with it."""


@dataclass(frozen=True, eq=False)
class ClosingLoop(Generic[ModelT, TrialT]):
    """The loop before a residual.

    Attributes
    ----------
    residual : Residual
    tell : callable
        Called with a message and a fraction.
    most : int
        Candidates that are added at the most.
    """

    residual: Residual[ModelT, TrialT]
    tell: Progress
    most: int
    visited: set[Hashable] = dataclasses.field(default_factory=set)

    @cached_property
    def declared(self) -> ModelT:
        """The model with nothing added."""
        return self.residual.declared()

    def run(self) -> Standing[ModelT, TrialT]:
        """Add until nothing more passes, give what was added its look-alikes' places where these explain more, and take out what
        does not carry over.
        """
        standing: Standing[ModelT, TrialT] = Standing(self.declared)
        self.visited.add(self.residual.signature(standing.model))
        while not self.stopped(standing):
            before, standing = standing, self._round(standing)
            if standing.model is before.model:
                less = self._pruned(standing, 1, everywhere=True)
                if less is standing or not self._new(less.model):
                    break
                standing = less
            self.visited.add(self.residual.signature(standing.model))
        return self._chained(self._carried(self._renamed(standing)))

    def _chained(self, standing: Standing[ModelT, TrialT]) -> Standing[ModelT, TrialT]:
        """With errors that go on from step to step, from the declared model's to what is left, whatever was taken out between."""
        # what was added together begins at the same errors
        together = [list(steps) for _, steps in groupby(standing.steps, key=lambda s: id(s.before))]
        ends = [steps[-1].after for steps in together[:-1]] + [self.residual.errors_of(standing.model)]
        begins = [self.residual.errors_of(self.declared), *ends]
        steps = [
            dataclasses.replace(step, before=before, after=after)
            for some, before, after in zip(together, begins, ends, strict=False)
            for step in some
        ]
        return dataclasses.replace(standing, steps=tuple(steps))

    def _renamed(self, standing: Standing[ModelT, TrialT]) -> Standing[ModelT, TrialT]:
        """With look-alikes in place of additions, less what these make needless; as it was where it does worse without that."""
        swapped = self._swapped(standing)
        if swapped is standing:
            return standing
        less = self._pruned(swapped, 0, everywhere=True)
        return standing if self.residual.spoils(less.model, swapped.model) else less

    def stopped(self, standing: Standing[ModelT, TrialT]) -> tuple[str, ...]:
        """Sentence that a limit ends it and no want of candidates; none where it goes on, or ended by itself before."""
        if len(standing.steps) >= self.most:
            return (f"{len(standing.steps)} effects are as many as are added; more may be missing.",)
        if len(self.visited) >= 2 * self.most:
            return (f"{len(self.visited)} models are as many as are looked at; more may be missing.",)
        return ()

    def _new(self, model: ModelT) -> bool:
        return self.residual.signature(model) not in self.visited

    def _round(self, standing: Standing[ModelT, TrialT]) -> Standing[ModelT, TrialT]:
        """With one addition, or two that are sure together; else with what was refused."""
        refused: list[TrialT] = []
        done, number = _done(standing), len(standing.steps) + 1
        for some in self.residual.candidates(standing):
            trials = self.residual.trials(standing.model, some, partial(self._tell_part, number, done))
            more = self._at_once(standing, trials) or self._several(standing, trials)
            if more is None and some.in_pairs:
                more = self._once_fitted(standing, trials, some)
            if more is not None:
                return more
            refused += trials if some.told else []
        return dataclasses.replace(standing, refused=tuple(refused))

    def _tell_part(self, number: int, done: float, fraction: float) -> None:
        self.tell(f"trying what may be missing, round {number}", done + 0.15 * (0.9 - done) * fraction)

    def _at_once(self, standing: Standing[ModelT, TrialT], trials: list[TrialT]) -> Standing[ModelT, TrialT] | None:
        """With all additions of a round that have nothing to do with each other; None where there is but one, or any falls in the
        model with all.
        """
        residual, model, left = self.residual, standing.model, trials
        best = residual.choose(left)
        some: list[TrialT] = []
        while best is not None and len(standing.steps) + len(some) < self.most:
            some.append(best)
            left = residual.apart([t for t in left if t is not best], model, model, some)
            best = residual.choose(left)
        if len(some) < 2:
            return None
        self.tell(f"adding {', '.join(t.label for t in some)}", _done(standing))
        new = residual.together(model, some)
        if new is None:
            return None
        errors = residual.errors_along(model, new, some)
        steps = [
            Addition(found, _others(trials, t), *between)
            for t, between in zip(some, pairwise(errors), strict=True)
            for found in residual.findings(t)
        ]
        return self._added(standing, new, (*standing.steps, *steps), len(steps))

    def _several(self, standing: Standing[ModelT, TrialT], trials: list[TrialT]) -> Standing[ModelT, TrialT] | None:
        """With the best addition, and those of its round that have nothing to do with it and pass beside it; None: there is none."""
        first = more = self._one_more(standing, trials)
        left, followers = trials, 0
        while more is not None and len(more.steps) < self.most:
            left = self.residual.apart(left, more.model, standing.model)
            best = self.residual.choose(left)
            if best is None:
                break
            left.remove(best)
            self.visited.add(self.residual.signature(more.model))
            again = self.residual.once_more(more.model, best)
            beside = self._one_more(more, [again], _others(trials, best), pruned=False)
            more, followers = (more, followers) if beside is None else (beside, followers + 1)
        if more is None or not followers:
            return more
        less = self._pruned(more, followers)
        kept = less is more or (self._new(less.model) and not self.residual.spoils(less.model, standing.model))
        return less if kept else first

    def _one_more(
        self,
        standing: Standing[ModelT, TrialT],
        trials: list[TrialT],
        rivals: tuple[TrialT, ...] = (),
        pruned: bool = True,
    ) -> Standing[ModelT, TrialT] | None:
        """With the best addition that still helps once everything is fitted again; None where none does.

        One that falls with the fit stays among the `trials`, with that as its objection. `rivals` lost to it elsewhere. What it makes
        needless is taken out unless others follow first.
        """
        left = list(trials)
        for _ in range(TRIES):
            best = self.residual.choose(left)
            if best is None:
                return None
            left.remove(best)
            place = trials.index(best)
            if self.residual.signature(standing.model, best) in self.visited:
                trials[place] = self.residual.fallen(
                    best, "with it the model would be one that was left for a better one"
                )
                continue
            alike = f" and {len(best.members) - 1} alike" if best.members else ""
            self.tell(f"adding {best.label}{alike}", _done(standing))
            lost = (*_others(trials, best), *rivals)
            model, found = self.residual.refit(standing.model, best)
            trials[place] = found
            if model is None:
                continue
            errors = [self.residual.errors_of(m) for m in (standing.model, model)]
            steps = [Addition(t, lost, *errors) for t in self.residual.findings(found)]
            more = self._added(standing, model, (*standing.steps, *steps), len(steps) if pruned else None)
            if more is not None:
                return more
            trials[place] = self.residual.fallen(found, "without what it makes needless the model is no better")
        return None

    def _once_fitted(
        self, standing: Standing[ModelT, TrialT], trials: Sequence[TrialT], some: Candidates
    ) -> Standing[ModelT, TrialT] | None:
        """An addition that blocks agree on once everything is fitted with it, or two of which none is sure alone, each in the
        other's residual; None where there is none.
        """
        residual = self.residual
        for first in residual.hopeful(trials):
            self.tell(f"trying what goes with {first.label}", _done(standing))
            half = residual.joined(standing.model, first)
            fitted = residual.once_fitted(half, first)
            more = self._one_more(standing, [fitted]) if fitted.accepted else None
            if more is not None:
                return more
            beside = residual.trials(half, some, lambda part: None, company_of=first)
            second = residual.companion(half, first, beside)
            if second is None:
                continue
            whole = residual.settled(residual.joined(half, second))
            again = residual.worth(whole, first)
            if not again.accepted or any(residual.unsure(whole, t) for t in (first, second)):
                continue
            before, between, after = (residual.errors_of(m) for m in (standing.model, half, whole))
            new = [
                Addition(again, _others(trials, first), before, between),
                Addition(second, _others(beside, second), between, after),
            ]
            more = self._added(standing, whole, (*standing.steps, *new), latest=1)
            if more is not None and all(residual.holds(more.model, s.trial) for s in new):
                return more
        return None

    def _added(
        self, standing: Standing[ModelT, TrialT], model: ModelT, steps: Sequence[Addition[TrialT]], latest: int | None
    ) -> Standing[ModelT, TrialT] | None:
        """With these steps, less what the model has no more and what the latest so many made needless; None where that is no new
        model, or a worse one.
        """
        more = Standing(model, tuple(s for s in steps if self.residual.holds(model, s.trial)))
        more = more if latest is None else self._pruned(more, latest)
        return more if self._new(more.model) and not self.residual.spoils(more.model, standing.model) else None

    def _pruned(
        self, standing: Standing[ModelT, TrialT], latest: int, everywhere: bool = False
    ) -> Standing[ModelT, TrialT]:
        """Take out what the latest additions made needless, and those of a family that turn out not to belong to it."""
        step = self.residual.needless(standing, latest, everywhere)
        if step is None:
            return standing
        less = self._less(standing, step)
        if not less.steps:
            return standing
        newest = standing.steps.index(step) >= len(standing.steps) - latest
        return self._pruned(dataclasses.replace(less, refused=()), max(1, latest - newest), everywhere)

    def _less(self, standing: Standing[ModelT, TrialT], step: Addition[TrialT]) -> Standing[ModelT, TrialT]:
        """Without an addition, what that stood in for back in its place."""
        self.tell(f"taking out {step.trial.label}", _done(standing))
        model, back = self.residual.without(standing, step)
        at = standing.steps.index(step)
        restored = [dataclasses.replace(step, trial=t) for t in back]
        others = [*standing.steps[:at], *restored, *standing.steps[at + 1 :]]
        kept = [s for s in others if self.residual.holds(model, s.trial)]
        if not kept:
            return dataclasses.replace(standing, model=self.declared, steps=())
        kept[-1] = dataclasses.replace(kept[-1], after=self.residual.errors_of(model))
        return dataclasses.replace(standing, model=model, steps=tuple(kept))

    def _carried(self, standing: Standing[ModelT, TrialT]) -> Standing[ModelT, TrialT]:
        """Without what does worse than nothing on data that were not fitted."""
        burden = self.residual.burden(standing)
        if burden is None:
            return standing
        step, told = burden
        less = self._less(standing, step)
        return self._carried(dataclasses.replace(less, taken_out=(*standing.taken_out, told)))

    def _swapped(self, standing: Standing[ModelT, TrialT]) -> Standing[ModelT, TrialT]:
        """Give an addition its look-alike's name where that explains more, now that everything else is in the model."""
        for at, step in enumerate(standing.steps):
            better = self.residual.instead(standing.model, step)
            if better is None:
                continue
            rival, model = better
            self.tell(f"{rival.label} in place of {step.trial.label}", 0.92)
            # the loser is a rival from now on
            rivals = (step.trial, *(t for t in step.rivals if t.label != rival.label))
            steps = list(standing.steps)
            steps[at] = dataclasses.replace(step, trial=rival, rivals=rivals)
            steps[-1] = dataclasses.replace(steps[-1], after=self.residual.errors_of(model))
            return self._swapped(Standing(model, tuple(steps), standing.refused))
        return standing


def _done(standing: Standing[ModelT, TrialT]) -> float:
    """Part of the way: how many rounds there will be is not known before."""
    return 0.1 + 0.8 * (1.0 - 0.8 ** len(standing.steps))


def _others(trials: Sequence[TrialT], won: TrialT) -> tuple[TrialT, ...]:
    """Single trials that lost to one, or to those of a family."""
    parts = won.members or (won,)
    return tuple(t for t in trials if not t.members and t not in parts)


def verdict(found: bool, left: bool, carries: bool = True) -> str:
    """``nothing_missing``, ``explained``, ``partly_explained`` or ``unexplained``.

    Parameters
    ----------
    found : bool
        Whether anything was added.
    left : bool
        Whether more is left than errors that are known of.
    carries : bool
        Whether what was added helps on data that were not fitted.
    """
    if not found:
        return "unexplained" if left else "nothing_missing"
    return "explained" if carries and not left else "partly_explained"
