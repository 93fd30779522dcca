"""What other packages bring through entry points: effects, readers of logs, estimators.

A package that cannot be used is left out with a warning of one line; what needs it says why it is not there.
"""

from __future__ import annotations

import importlib
import pkgutil
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

EFFECTS, READERS, ESTIMATORS = "rx90b_flex.effects", "rx90b_flex.readers", "rx90b_flex.estimators"


class BrokenPackageWarning(UserWarning):
    """Another package brings something that cannot be used."""


@dataclass(frozen=True)
class Broken:
    """An entry point that cannot be used: its name, and a line that names the package and says why."""

    name: str
    line: str


@dataclass(frozen=True)
class Brought:
    """What the entry points of a group hold."""

    things: tuple[Any, ...]
    broken: tuple[Broken, ...]

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
    return f"{found.__name__} lacks {', '.join(lacking)}" if lacking else ""


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
        except Exception as error:  # somebody else's code: anything may be wrong with it
            thing, why = None, f"{type(error).__name__}: {' '.join(str(error).split())}"
        if why:
            broken.append(Broken(point.name, f"package {package_of(point)}: {group} {point.name!r}: {why}"))
            warnings.warn(broken[-1].line, BrokenPackageWarning, stacklevel=2)
        else:
            things.append(thing)
    return Brought(tuple(things), tuple(broken))


def package_of(point: EntryPoint) -> str:
    """Name and version of the package that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else point.module


def blamed(error: BaseException) -> str:
    """The package with entry points in whose code an error arose; empty: in none."""
    every = entry_points()
    points = {p.module.split(".")[0]: p for group in (EFFECTS, READERS, ESTIMATORS) for p in every.select(group=group)}
    while error.__cause__ is not None:
        error = error.__cause__
    frames = [str(frame.f_globals.get("__name__")) for frame, _ in traceback.walk_tb(error.__traceback__)]
    found = [points[name.split(".")[0]] for name in frames if name.split(".")[0] in points]
    return package_of(found[-1]) if found else ""
