"""What other packages bring through entry points: effects, readers of logs, estimators.

A package that cannot be used is left out with a warning of one line; what needs it says why it is not there.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import FunctionType
from typing import Any

from rx90b_flex.files.warned import InputWarning

EFFECTS, READERS, ESTIMATORS = "rx90b_flex.effects", "rx90b_flex.readers", "rx90b_flex.estimators"


class BrokenPackageWarning(InputWarning):
    """Another package brings something that cannot be used."""


@dataclass(frozen=True)
class Broken:
    """An entry point that cannot be used: its name and module, and a line that names the package and says why."""

    name: str
    module: str
    line: str


@dataclass(frozen=True)
class Brought:
    """What the entry points of a group hold."""

    things: tuple[Any, ...]
    broken: tuple[Broken, ...]

    def left_out(self, cls: type) -> bool:
        """Whether a class comes from a module of which something cannot be used, and is nothing else that it brings."""
        return cls not in self.things and cls.__module__ in {b.module for b in self.broken}

    def why_missing(self, name: str) -> str:
        """Why what an entry point of this name should bring is not there, after a semicolon; empty where there is none."""
        return next((f"; {b.line}" for b in self.broken if b.name == name), "")


def import_all(package: str) -> None:
    """Import every module of a folder of the package."""
    _import_all(package, tuple(importlib.import_module(package).__path__))


@cache
def _import_all(package: str, folders: tuple[str, ...]) -> None:
    for module in pkgutil.iter_modules(folders):
        importlib.import_module(f"{package}.{module.name}")


def subclasses(cls: Any) -> Iterator[Any]:
    """All classes below a class that is loaded, those below them first."""
    for sub in cls.__subclasses__():
        yield from subclasses(sub)
        yield sub


def concrete(cls: type) -> bool:
    """Whether a class lacks nothing and is not for its own file only."""
    return not getattr(cls, "__abstractmethods__", None) and not cls.__name__.startswith("_")


def own(cls: type) -> bool:
    """Whether a class is of this package."""
    return cls.__module__.startswith("rx90b_flex.")


def wrong_class(found: Any, base: type) -> str:
    """Why something that another package brings is no class of a kind that can be used; empty where it is one."""
    if not (isinstance(found, type) and issubclass(found, base)):
        return f"{found!r} is no subclass of {base.__module__}.{base.__name__}"
    lacking = sorted(getattr(found, "__abstractmethods__", ()))
    return f"{found.__name__} lacks {', '.join(lacking)}" if lacking else _wrong_signature(found)


def _wrong_signature(found: type) -> str:
    """Which method of another package's class cannot be called as that of this package which it stands for; empty: none."""
    theirs = [cls for cls in found.__mro__ if not own(cls) and cls.__module__ not in ("abc", "builtins")]
    for name, made in {
        n: m for cls in reversed(theirs) for n, m in vars(cls).items() if not n.startswith("__")
    }.items():
        stated: Any = next((vars(cls)[name] for cls in found.__mro__ if own(cls) and name in vars(cls)), None)
        kind = next((k for k in (staticmethod, classmethod, FunctionType) if isinstance(stated, k)), None)
        if kind is None:
            continue
        if not isinstance(made, kind):
            expected = "a method" if kind is FunctionType else f"a @{kind.__name__}"
            return f"{found.__name__}.{name} is a {type(made).__name__}; expected {expected}"
        both: tuple[Any, Any] = (stated, made)
        ours, its = (inspect.signature(getattr(x, "__func__", x)) for x in both)
        named = {n: None for n, p in ours.parameters.items() if p.kind is inspect.Parameter.KEYWORD_ONLY}
        try:
            its.bind(*[None] * (len(ours.parameters) - len(named)), **named)
        except TypeError:
            words = [", ".join(x.parameters) for x in (its, ours)]
            return f"{found.__name__}.{name} takes ({words[0]}); expected ({words[1]})"
    return ""


@cache
def brought(group: str, wrong: Callable[[Any], str]) -> Brought:
    """Load what other packages bring.

    Parameters
    ----------
    group : str
        Of entry points.
    wrong : callable
        What is wrong with a thing that was loaded, in words; empty where it can be used.
    """
    things, broken = [], []
    for point in sorted(entry_points(group=group), key=lambda p: (p.name, p.value)):
        try:
            thing = point.load()
            why = wrong(thing)
        except (Exception, SystemExit) as error:  # somebody else's code: anything may be wrong with it
            thing, why = None, f"{type(error).__name__}: {' '.join(str(error).split())}"
        if why:
            broken.append(Broken(point.name, point.module, f"{_words(point)}: {why}"))
            warnings.warn(broken[-1].line, BrokenPackageWarning, stacklevel=2)
        else:
            things.append(thing)
    return Brought(tuple(things), tuple(broken))


def package_of(point: EntryPoint) -> str:
    """Name and version of the package that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else point.module


def _words(point: EntryPoint) -> str:
    return f"package {package_of(point)}: {point.group} {point.name!r}"


def whose(cls: type) -> str:
    """Package and entry point that a class comes from; where it comes from none, its name."""
    every = (p for group in (EFFECTS, READERS, ESTIMATORS) for p in entry_points(group=group))
    return next((_words(p) for p in every if p.module == cls.__module__), cls.__name__)


def blamed(error: BaseException) -> str:
    """The package with entry points in whose code an error arose; empty: in none."""
    every = entry_points()
    points = {p.module.split(".")[0]: p for group in (EFFECTS, READERS, ESTIMATORS) for p in every.select(group=group)}
    while error.__cause__ is not None:
        error = error.__cause__
    frames = [str(frame.f_globals.get("__name__")) for frame, _ in traceback.walk_tb(error.__traceback__)]
    found = [points[name.split(".")[0]] for name in frames if name.split(".")[0] in points]
    return package_of(found[-1]) if found else ""
