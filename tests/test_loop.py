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

    def trials(self, model: Model, some: Candidates, told: Callable[[float], None]) -> list[Tried]:
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

    def needless(self, standing: Standing[Model, Tried], latest: int) -> Addition[Tried] | None:
        return None

    def without(self, model: Model, trial: Tried) -> tuple[Model, list[Tried]]:
        return model - {trial.label}, []

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
