"""Claims about the loop itself, on a residual whose candidates are names and whose fits are written here."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import pytest

from rx90b_flex.diagnose.loop import TRIES, Addition, Candidates, ClosingLoop, Residual, Standing

Model = frozenset[str]


@dataclass(frozen=True)
class Tried:
    """A candidate that looks sure, and how much it seems to gain."""

    label: str
    gain: float
    accepted: bool = True
    members: tuple[Tried, ...] = ()


class Names(Residual[Model, Tried]):
    """Only some of the names that look sure still help once everything is fitted again."""

    def __init__(self, *names: str, helps: frozenset[str]) -> None:
        self.names, self.helps, self.refits = names, helps, list[str]()

    def declared(self) -> Model:
        return frozenset()

    def signature(self, model: Model, trial: Tried | None = None) -> Hashable:
        return model | ({trial.label} if trial else set())

    def candidates(self, standing: Standing[Model, Tried]) -> Sequence[Candidates]:
        return (Candidates(in_pairs=False),)

    def trials(
        self, model: Model, some: Candidates, told: Callable[[float], None], company_of: Tried | None = None
    ) -> list[Tried]:
        return [Tried(n, float(len(self.names) - i)) for i, n in enumerate(self.names) if n not in model]

    def joined(self, model: Model, trial: Tried) -> Model:
        return model | {trial.label}

    def refit(self, model: Model, trial: Tried) -> tuple[Model | None, Tried]:
        self.refits.append(trial.label)
        return (
            (self.joined(model, trial), trial) if trial.label in self.helps else (None, Tried(trial.label, 0.0, False))
        )

    def holds(self, model: Model, trial: Tried) -> bool:
        return trial.label in model

    def hopeful(self, trials: Sequence[Tried]) -> list[Tried]:
        return []

    def companion(self, half: Model, first: Tried, beside: Sequence[Tried]) -> Tried | None:
        return None

    def worth(self, model: Model, trial: Tried) -> Tried:
        return trial

    def needless(
        self, standing: Standing[Model, Tried], latest: int, everywhere: bool = True
    ) -> Addition[Tried] | None:
        return None

    def without(self, standing: Standing[Model, Tried], step: Addition[Tried]) -> tuple[Model, list[Tried]]:
        return standing.model - {step.trial.label}, []

    def instead(self, model: Model, step: Addition[Tried]) -> tuple[Tried, Model] | None:
        return None


def closed(residual: Names, most: int = 24) -> Standing[Model, Tried]:
    return ClosingLoop(residual, lambda message, fraction: None, most).run()


@pytest.mark.parametrize("fallen", [0, 3, TRIES - 1])
def test_what_falls_does_not_keep_what_stands_behind_it_from_being_tried(fallen):
    residual = Names(*(f"falls {i}" for i in range(fallen)), "helps", helps=frozenset({"helps"}))
    assert closed(residual).model == {"helps"}


def test_a_round_ends_after_so_many():
    residual = Names(*(f"falls {i}" for i in range(3 * TRIES)), helps=frozenset())
    assert closed(residual).model == frozenset()
    assert len(residual.refits) == TRIES


def test_no_more_than_so_many_are_added():
    names = [f"helps {i}" for i in range(9)]
    assert len(closed(Names(*names, helps=frozenset(names)), most=5).steps) == 5


class Apart(Names):
    """Names that have nothing to do with each other where their first letters differ; some fall beside what was added."""

    def __init__(self, *names: str, helps: frozenset[str], falls_beside: frozenset[str] = frozenset()) -> None:
        super().__init__(*names, helps=helps)
        self.falls_beside, self.rounds = falls_beside, 0

    def trials(
        self, model: Model, some: Candidates, told: Callable[[float], None], company_of: Tried | None = None
    ) -> list[Tried]:
        self.rounds += 1
        return super().trials(model, some, told)

    def apart(self, trials: Sequence[Tried], new: Model, old: Model, beside: Sequence[Tried] = ()) -> list[Tried]:
        more = {name[0] for name in new - old} | {t.label[0] for t in beside}
        return [t for t in trials if t.label[0] not in more]

    def once_more(self, model: Model, trial: Tried) -> Tried:
        return Tried(trial.label, trial.gain, trial.label not in self.falls_beside)


def test_what_has_nothing_to_do_with_an_addition_is_added_in_its_round():
    residual = Apart("a1", "b1", "a2", "c1", helps=frozenset({"a1", "b1", "a2", "c1"}))
    standing = closed(residual)
    assert [s.trial.label for s in standing.steps] == ["a1", "b1", "c1", "a2"]
    assert residual.rounds == 3  # a2 has to do with a1: it waits for the next; the third adds nothing
    first = standing.steps[1]
    assert [t.label for t in first.rivals] == ["a1", "a2", "c1"], "what it won against in its round"


def test_what_no_longer_passes_beside_an_addition_is_not_added_with_it():
    residual = Apart("a1", "b1", "c1", helps=frozenset({"a1", "c1"}), falls_beside=frozenset({"b1"}))
    assert [s.trial.label for s in closed(residual).steps] == ["a1", "c1"]
    assert residual.refits[:2] == ["a1", "c1"]


def test_a_round_adds_no_more_than_may_be_added():
    names = tuple("abcdefgh")
    assert len(closed(Apart(*names, helps=frozenset(names)), most=5).steps) == 5


class AtOnce(Apart):
    """The same, with one fit for all additions of a round; its errors are how many names a model holds."""

    def __init__(self, *names: str, helps: frozenset[str]) -> None:
        super().__init__(*names, helps=helps)
        self.fits = list[tuple[str, ...]]()

    def together(self, model: Model, trials: Sequence[Tried]) -> Model | None:
        labels = tuple(t.label for t in trials)
        self.fits.append(labels)
        return model | set(labels) if self.helps.issuperset(labels) else None

    def errors_of(self, model: Model) -> int:
        return len(model)

    def errors_along(self, old: Model, new: Model, trials: Sequence[Tried]) -> list[int]:
        return list(range(len(old), len(new) + 1))


def test_additions_of_a_round_that_have_nothing_to_do_with_each_other_are_fitted_at_once():
    residual = AtOnce("a1", "b1", "a2", "c1", helps=frozenset({"a1", "b1", "a2", "c1"}))
    standing = closed(residual)
    assert [s.trial.label for s in standing.steps] == ["a1", "b1", "c1", "a2"]
    assert residual.fits == [("a1", "b1", "c1")] and residual.refits == ["a2"]
    assert [(s.before, s.after) for s in standing.steps] == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert [t.label for t in standing.steps[1].rivals] == ["a1", "a2", "c1"]


def test_where_one_falls_with_the_others_they_are_added_one_by_one():
    residual = AtOnce("a1", "b1", "c1", helps=frozenset({"a1", "c1"}))
    assert [s.trial.label for s in closed(residual).steps] == ["a1", "c1"]
    assert residual.fits[0] == ("a1", "b1", "c1") and residual.refits[:3] == ["a1", "b1", "c1"]


def test_no_more_are_added_at_once_than_may_be_added():
    names = tuple("abcdefgh")
    residual = AtOnce(*names, helps=frozenset(names))
    assert len(closed(residual, most=5).steps) == 5 and residual.fits == [tuple("abcde")]


class Leaning(Names):
    """With c in the model a is needless, and b goes where a goes."""

    def needless(
        self, standing: Standing[Model, Tried], latest: int, everywhere: bool = True
    ) -> Addition[Tried] | None:
        return next((s for s in standing.steps if s.trial.label == "a" and "c" in standing.model), None)

    def without(self, standing: Standing[Model, Tried], step: Addition[Tried]) -> tuple[Model, list[Tried]]:
        return standing.model - {step.trial.label, "b"}, []


def test_what_goes_with_something_needless_is_no_addition_any_more():
    standing = closed(Leaning("a", "b", "c", "d", helps=frozenset("abcd")), most=12)
    assert {s.trial.label for s in standing.steps} == standing.model
    assert "c" in standing.model
    assert "a" not in standing.model


@pytest.mark.parametrize(("most", "said"), [(2, "2 effects are as many"), (4, "")])
def test_a_loop_that_a_limit_ends_says_so(most, said):
    names = ("a", "b", "c")
    loop = ClosingLoop(Names(*names, helps=frozenset(names)), lambda message, fraction: None, most)
    text = " ".join(loop.stopped(loop.run()))
    assert text.startswith(said) and bool(text) == bool(said)
    loop.visited.update(frozenset({str(i)}) for i in range(2 * most))
    assert "as many as are looked at" in loop.stopped(Standing(frozenset()))[0]


class LookAlike(Names):
    """In the end a look-alike would take a name's place, and seems needless there; a model with neither is worse, if it `leans`."""

    def __init__(self, leans: bool) -> None:
        super().__init__("name", "other", helps=frozenset({"name", "other"}))
        self.leans = leans

    def instead(self, model: Model, step: Addition[Tried]) -> tuple[Tried, Model] | None:
        alike = Tried("alike", 1.0)
        return (alike, model - {"name"} | {"alike"}) if step.trial.label == "name" else None

    def needless(
        self, standing: Standing[Model, Tried], latest: int, everywhere: bool = True
    ) -> Addition[Tried] | None:
        return next((s for s in standing.steps if s.trial.label == "alike"), None)

    def spoils(self, new: Model, old: Model) -> bool:
        return self.leans and "alike" in old and "alike" not in new


@pytest.mark.parametrize(("leans", "left"), [(True, {"name", "other"}), (False, {"other"})])
def test_a_look_alike_that_is_needless_and_without_which_all_is_worse_does_not_take_a_place(leans, left):
    assert closed(LookAlike(leans)).model == left
