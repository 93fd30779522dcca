"""Parameters of effects: what a type says about each, and the values of one effect."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar, NoReturn, Self

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.effects.traits import Traits
from rx90b_flex.files.keys import check_keys

# Rank of a parameter in a robot's parameter vector: the order of table D.1.
INERTIA, SPRING, FRICTION, STIFFNESS, DAMPING, OTHER = range(1, 7)

_in_snake_case = cache(lambda name: re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower())


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect type.

    Attributes
    ----------
    unit : str
    kind : str
        ``linear``: the force is proportional to it. ``shape``: the force depends on it in another way.
        ``derived``: made from the coefficients by the effect's own class (amplitude, phase, rest angle).
        ``given``: geometry that is stated and never estimated.
    lower, upper : float
        Physical bounds. A linear parameter estimated beyond them says that another effect is at work.
    start : float
        Where a search for a shape parameter begins.
    size : int
        Number of values; zero: as many as are given.
    rank : int
        Place in the parameter vector.
    attribute : str
        Where its value stands in the effect.
    usual : bool
        Whether `start` is what a shape parameter mostly is: where the data lead it astray a search holds it there.
    held : bool
        Whether a fit leaves it at its value, of which no more is known than what is usual.
    shared : bool
        Whether all effects of a joint have one value of that name; `start` where it is not known.
    telling : bool
        Whether the name means nothing where no more than its size's order is known.
    least_will_do : bool
        Whether the least value of a shape that a log can tell stands for all below it.
    """

    unit: str
    kind: str
    lower: float = -np.inf
    upper: float = np.inf
    start: float = np.nan
    size: int = 1
    rank: int = OTHER
    attribute: str = ""
    usual: bool = False
    held: bool = False
    shared: bool = False
    telling: bool = False
    least_will_do: bool = False


def linear(unit: str, *, lower: float = -np.inf, size: int = 1, rank: int = OTHER, public: str = "") -> Any:
    """Field of an effect: a parameter that the force is proportional to; `public`: its name in files, if not the attribute's."""
    parameter = Parameter(unit, "linear", lower, size=size, rank=rank)
    return dataclasses.field(default=None, metadata={"parameter": parameter, "public": public})


def shape(
    unit: str,
    *,
    start: float,
    lower: float,
    upper: float,
    size: int = 1,
    usual: bool = False,
    shared: bool = False,
    telling: bool = False,
    least_will_do: bool = False,
) -> Any:
    """Field of an effect: a parameter that gives the force its shape."""
    parameter = Parameter(
        unit, "shape", lower, upper, start, size,
        usual=usual, shared=shared, telling=telling, least_will_do=least_will_do,
    )  # fmt: skip
    return dataclasses.field(default=None, metadata={"parameter": parameter})


def derived(unit: str, *, lower: float = -np.inf, size: int = 1) -> Any:
    """Field of an effect: a parameter that its class makes from the coefficients, such as an amplitude."""
    return dataclasses.field(default=None, metadata={"parameter": Parameter(unit, "derived", lower, size=size)})


def choice(*values: str) -> Any:
    """Field of an effect: one of a few words, the first where a robot file says nothing."""
    return dataclasses.field(default=values[0], metadata={"choice": values})


def given(unit: str, *, lower: float = -np.inf, size: int = 1) -> Any:
    """Field of an effect: stated geometry."""
    return dataclasses.field(default=None, metadata={"parameter": Parameter(unit, "given", lower, size=size)})


@dataclass(frozen=True, kw_only=True)
class Parametrized:
    """Named values with units, which the fields of a subclass declare; None as a value means: not known, to be identified.

    *Coefficients* are what a force is linear in: the linear parameters unless a subclass says otherwise (an amplitude and a
    phase are a sine and a cosine). What else it depends on is its *shape*.
    """

    traits: ClassVar[Traits] = Traits()
    _own_traits: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, **traits: Any) -> None:
        super().__init_subclass__()
        cls._own_traits = traits
        every = [vars(base).get("_own_traits", {}) for base in reversed(cls.__mro__)]
        known = [f.name for f in dataclasses.fields(Traits)]
        check_keys(traits, known, f"class {cls.__name__}")
        for name in known:
            if name in vars(cls):
                raise TypeError(
                    f"class {cls.__name__}: {name} is a trait; expected the keyword class {cls.__name__}(..., {name}=...)"
                )
        cls.traits = Traits(**{name: value for own_ones in every for name, value in own_ones.items()})

    @classmethod
    def type_name(cls) -> str:
        """Name in robot files and reports: the class name in snake case."""
        return _in_snake_case(cls.__name__)

    @classmethod
    @cache
    def parameters(cls) -> Mapping[str, Parameter]:
        """Parameters by name, in the order in which they are declared."""
        fields = [f for f in dataclasses.fields(cls) if "parameter" in f.metadata]
        named = ((f.metadata.get("public") or f.name, f) for f in fields)
        return MappingProxyType({n: dataclasses.replace(f.metadata["parameter"], attribute=f.name) for n, f in named})

    @classmethod
    @cache
    def _named(cls, kind: str) -> tuple[tuple[str, Parameter], ...]:
        return tuple((n, p) for n, p in cls.parameters().items() if p.kind == kind)

    @classmethod
    @cache
    def _flat(cls, kind: str) -> Mapping[str, Parameter]:
        flat: dict[str, Parameter] = {}
        for name, p in cls._named(kind):
            flat |= {name: p} if p.size == 1 else {f"{name}_{i + 1}": p for i in range(p.size)}
        return MappingProxyType(flat)

    def _values(self, kind: str) -> Array:
        out: list[float] = []
        for _, p in self._named(kind):
            value = getattr(self, p.attribute)
            if isinstance(value, float):
                out.append(value)
            else:
                out += [np.nan] * p.size if value is None else list(np.atleast_1d(np.asarray(value, dtype=float)))
        return np.array(out, dtype=float)

    def _with_values(self, kind: str, values: Sequence[float] | Array) -> Self:
        change: dict[str, Any] = {}
        at = 0
        known = [None if x != x else x for x in np.asarray(values, dtype=float).tolist()]  # NaN differs from itself
        for _, p in self._named(kind):
            part = known[at : at + p.size]
            change[p.attribute] = part[0] if p.size == 1 else (None if None in part else tuple(part))
            at += p.size
        return dataclasses.replace(self, **change)

    @property
    def coefficient_parameters(self) -> Mapping[str, Parameter]:
        """What the force is linear in, by name, one number each: unit, smallest physical value, rank."""
        return self._flat("linear")

    @property
    def coefficients(self) -> Array:
        """Values of the coefficients, NaN where not known; shape (k,)."""
        return self._values("linear")

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        """The same effect with other coefficients; NaN becomes unknown."""
        return self._with_values("linear", values)

    @property
    def shape_parameters(self) -> Mapping[str, Parameter]:
        """Shape parameters by name, one number each."""
        return self._flat("shape")

    @property
    def shape(self) -> Array:
        """Values of the shape parameters, NaN where not known; shape (s,)."""
        return self._values("shape")

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        """The same effect with other shape parameters."""
        return self._with_values("shape", values)

    def public_values(self) -> list[tuple[str, str, float]]:
        """Name, unit and value (NaN where not known) of each parameter that can be estimated."""
        out: list[tuple[str, str, float]] = []
        for name, p in self.parameters().items():
            if p.kind == "given":
                continue
            value = getattr(self, p.attribute)
            size = p.size or (len(self.coefficients) if value is None else len(value))
            values = np.full(size, np.nan) if value is None else np.atleast_1d(np.asarray(value, dtype=float))
            names = [name] if p.size == 1 else [f"{name}_{i + 1}" for i in range(size)]
            out += [(n, p.unit, float(x)) for n, x in zip(names, values, strict=True)]
        return out

    def known_coefficients(self) -> Array:
        """Coefficients, with an error that names the first one without a value."""
        values = self.coefficients
        if np.isnan(values).any():
            self._missing(list(self.coefficient_parameters)[int(np.isnan(values).argmax())])
        return values

    def known_shape(self) -> Array:
        """Shape parameters, with an error that names the first one without a value; what effects share has its start then."""
        values = self.shape
        if np.isnan(values).any():
            for i, (name, p) in enumerate(self.shape_parameters.items()):
                if np.isnan(values[i]):
                    values[i] = p.start if p.shared else self._missing(name)
        return values

    def _missing(self, name: str) -> NoReturn:
        raise ValueError(f"{self.label}: {name} has no value; give it in the robot file or identify it")

    @property
    def known(self) -> bool:
        """Whether all that its force needs has a value."""
        try:
            self.known_coefficients(), self.known_shape()
        except ValueError:
            return False
        return True

    @property
    def label(self) -> str:
        """Place and type, as in ``joint_2.viscous_friction``."""
        return self.type_name()
