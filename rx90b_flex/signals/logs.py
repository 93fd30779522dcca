"""Files that people log robots in, as named columns: of every format that `rx90b_flex.signals.readers` has a reader of.

What the columns mean is not decided here: see `rx90b_flex.signals.importers`.
"""

from __future__ import annotations

from pathlib import Path

from rx90b_flex.files.extensions import whose
from rx90b_flex.signals.readers.reader import Log, Reader, from_others, readers, why_no_log
from rx90b_flex.signals.tables import one_line

TIME = "time"


def _reader_of(path: Path) -> tuple[str, type[Reader]]:
    """The ending of a file that has a reader, and that; no ending for a folder.

    Raises
    ------
    ValueError
        One line that names the file.
    """
    known = readers()
    if not path.exists():
        raise ValueError(f"{path}: no such file")
    if path.is_dir():
        for cls in known.values():
            if cls.takes_folder(path):
                return "", cls
        raise ValueError(f"{path}: a folder without metadata.yaml; expected a file or the folder of a ROS 2 bag")
    for ending in sorted(known, key=len, reverse=True):
        if path.name.lower().endswith(ending):
            if path.stat().st_size == 0:
                raise ValueError(f"{path}: the file is empty")
            return ending, known[ending]
    why = from_others().why_missing(path.suffix.lstrip(".").lower())
    why = why or f"; expected {', '.join(sorted(known))}, or the folder of a ROS 2 bag"
    raise ValueError(f"{path}: unknown kind of file{why}")


def stem_of(path: Path) -> str:
    """The file's name without its extension."""
    return path.name[: len(path.name) - len(_reader_of(path)[0])] or path.name


def read_log(path: Path, topic: str | None = None) -> Log:
    """Read a file.

    Parameters
    ----------
    path : of a format that has a reader, or the folder of a bag.
    topic : of a bag; the one with most messages of type JointState where not given.

    Raises
    ------
    ValueError
        One line that names the file and, where it applies, column and row: unreadable, no table in it, a cell that is no
        number, no such topic; a format whose reader is not installed, with what to install.
    """
    _, reader = _reader_of(path)
    try:
        log = reader().read(path) if topic is None else reader().read_topic(path, topic)
        why = why_no_log(log)
        if why:
            raise ValueError(f"{path}: cannot be read: {whose(reader)}: read returned {why}")
        return log
    except Exception as error:  # a damaged file takes readers to places that their authors never thought of
        if isinstance(error, ValueError) and str(error).startswith(str(path)):
            raise
        raise ValueError(f"{path}: cannot be read: {one_line(error)}") from error
