"""Effects as a fit of torques over time works with them, which robot files have as others."""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Container, Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.motion import Motion
from rx90b_flex.effects.parameters import Parameter

E = TypeVar("E", bound=Effect)


class StandIn(Effect):
    """An effect that stands for one of another type: on a rigid tree for one that bends, or in another form of its parameters."""

    in_files: ClassVar[type[Effect]]  # what it stands for

    @classmethod
    def type_name(cls) -> str:
        return cls.in_files.type_name()

    def in_tree(self, motion: Motion) -> Effect:
        """What it stands for, with its values, on the tree of any sample of motion."""
        return self.in_files(**{f.name: getattr(self, f.name) for f in dataclasses.fields(self.in_files)})


class OtherForm(Effect):
    """An effect in another form under the same name, which a robot file asks for by one parameter more."""

    form_of: ClassVar[type[Effect]]
    stated_by: ClassVar[str]  # the parameter

    @classmethod
    def type_name(cls) -> str:
        return cls.form_of.type_name()

    @abstractmethod
    def beside(self, others: Sequence[Effect]) -> Effect | None:
        """As it is beside other effects in its place, where a search tries it; None: it is not."""


def forms_of(kind: type[E]) -> list[type[E]]:
    """An effect type and its other forms."""
    found = [kind]
    known: list[Any] = [OtherForm]
    while known:
        known += (form := known.pop()).__subclasses__()
        if form.__dict__.get("form_of") is kind:
            found.append(form)
    return found


def form_stated(kind: type[Effect], names: Container[str]) -> type[Effect]:
    """The form of an effect type that a table with these keys states."""
    return next((f for f in forms_of(kind)[1:] if f.stated_by in names), kind)  # type: ignore[attr-defined]


def as_beside(effect: Effect, others: Sequence[Effect]) -> Effect | None:
    """An effect as a search tries it beside others in its place; None: it is not."""
    return effect.beside(others) if isinstance(effect, OtherForm) else effect


class OfUsualShape(StandIn):
    """An effect for logs that do not tell all of its shape: what is `Parameter.usual` of it is held at its usual value."""

    @property
    def shape_parameters(self) -> Mapping[str, Parameter]:
        return {n: dataclasses.replace(p, held=p.usual) for n, p in super().shape_parameters.items()}

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """From the same starts but for what is held, which makes fewer of them."""
        found, own = super().shape_search(motion, left), [p for p in self.shape_parameters.values() if not p.shared]
        starts = np.where([p.held for p in self.shape_parameters.values()], self.shape, found.starts)
        free = sum(not p.held for p in own)
        independent = math.ceil(found.independent ** (free / len(own)))
        return dataclasses.replace(found, starts=np.unique(starts, axis=0), independent=independent)


def of_usual_shape(effect: Effect, stated: Effect | None = None) -> Effect | None:
    """An effect with the shapes that have a usual value held there; None where its type has none, or they are held.

    Where a robot file has `stated` the effect, they are held at what it says.
    """
    for kind in OfUsualShape.__subclasses__():
        if kind.in_files is type(effect):
            own = list(effect.shape_parameters.values())
            known = np.full(len(own), np.nan) if stated is None else stated.shape
            held = np.where(np.isnan(known), [p.start for p in own], known)
            values = {f.name: getattr(effect, f.name) for f in dataclasses.fields(kind)}
            return kind(**values).with_shape(np.where([p.usual for p in own], held, effect.shape))
    return None


def as_in_files(effects: Sequence[Effect], motion: Motion) -> tuple[Effect, ...]:
    """Effects as a robot file has them, on the tree of any sample of motion."""
    return tuple(e.in_tree(motion) if isinstance(e, StandIn) else e for e in effects)
