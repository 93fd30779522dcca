"""What a reader of logs is, and the list of all readers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.files.extensions import READERS, Brought, brought, import_all, own, subclasses, wrong_class
from rx90b_flex.pieces import Array


@dataclass(frozen=True, eq=False)
class Log:
    """Columns of one file.

    Attributes
    ----------
    path : the file, or the folder of a bag.
    names : of the columns, each once.
    values : (N, columns) float64; empty cells are NaN.
    notes : what was worked out while reading, a line each.
    time : (N,) s, where the format itself says which column that is; else None.
    roles : column -> (signal, joint), where the format itself says so.
    words : columns that hold no numbers -> what stands in their first row.
    units : column -> unit, where a row below the names says so.
    assumed : what was taken for likely while reading, a line each.
    twice : names of several columns -> how many; these are left out of `names`, and refused where they can be used.
    clocks : columns of dates with times, whose values count from the first row -> s since 1970 in that row, by the log's own clock;
        "time" for `time`.
    """

    path: Path
    names: tuple[str, ...]
    values: Array
    notes: tuple[str, ...] = ()
    time: Array | None = None
    roles: Mapping[str, tuple[str, str]] | None = None
    words: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    twice: Mapping[str, int] = field(default_factory=dict)
    clocks: Mapping[str, float] = field(default_factory=dict)

    def column(self, name: str) -> Array:
        """(N,) values of a column."""
        return self.values[:, self.names.index(name)]


class Reader(ABC):
    """Reads one format into named columns. What they mean is worked out later, from names and units.

    A subclass in a module of this folder, or of another package that names it in the entry point group ``rx90b_flex.readers``,
    is used by ``rx90b-flex import`` for files of its endings.
    """

    endings: ClassVar[tuple[str, ...]]  # of file names, in lower case, with their dot

    @classmethod
    def takes_folder(cls, folder: Path) -> bool:
        """Whether a folder is a log of this format."""
        return False

    @abstractmethod
    def read(self, path: Path) -> Log:
        """Read a file of one of `endings`, not empty, or a folder that `takes_folder`.

        Raises
        ------
        ValueError
            One line that begins with the path. Any other error is shown as one, too.
        """

    def read_topic(self, path: Path, topic: str | None) -> Log:
        """Read one topic of a format that has several; None: that with most messages."""
        raise ValueError(f"{path}: --topic {topic}: only bags have topics")


def log_of(path: Path, names: Sequence[str], values: Array, notes: Sequence[str]) -> Log:
    """Columns of a table as a log, without those whose name is there twice; ValueError for less than two rows."""
    if len(values) < 2:
        raise ValueError(f"{path}: {len(values)} rows of numbers; expected more")
    counts = Counter(names)
    once = [k for k, name in enumerate(names) if counts[name] == 1]
    twice = {name: count for name, count in counts.items() if count > 1}
    return Log(path, tuple(names[k] for k in once), values[:, once], tuple(notes), twice=twice)


def why_no_log(found: Any) -> str:
    """What a reader returned, and what is expected instead; empty: a log."""
    if not isinstance(found, Log):
        return f"{'None' if found is None else type(found).__name__}; expected a Log, as log_of makes it"
    shape, count = np.shape(found.values), len(found.names)
    if len(shape) != 2 or shape[1] != count:
        return f"values of shape {shape} for {count} names; expected (rows, {count})"
    if found.time is not None and np.shape(found.time) != shape[:1]:
        return f"a time of shape {np.shape(found.time)} for {shape[0]} rows; expected ({shape[0]},)"
    return ""


def readers() -> dict[str, type[Reader]]:
    """All readers by the endings that they read."""
    import_all("rx90b_flex.signals.readers")
    found = [*from_others().things, *filter(own, subclasses(Reader))]
    return {ending: cls for cls in found for ending in cls.endings}


def from_others() -> Brought:
    """Readers of other packages."""
    return brought(READERS, _why_no_reader)


def _why_no_reader(found: Any) -> str:
    """What is wrong with a reader that another package brings; empty: nothing."""
    wrong = wrong_class(found, Reader)
    if wrong or not hasattr(found, "endings"):
        return wrong or f"{found.__name__} lacks endings"
    if isinstance(found.endings, str) or not all(isinstance(e, str) and e[:1] == "." for e in found.endings):
        return f'endings of {found.__name__} is {found.endings!r}; expected texts with their dot, as in (".jsonl",)'
    taken = {ending for cls in filter(own, subclasses(Reader)) for ending in cls.endings}
    return next((f"files {ending} have a reader already" for ending in found.endings if ending in taken), "")
