"""Files that people log robots in, as named columns: CSV of any kind, Parquet, MATLAB, ROS 2 bags and MCAP.

What the columns mean is not decided here: see `rx90b_flex.signals.importers`.
"""

from __future__ import annotations

import csv
import gzip
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.signals import lerobot
from rx90b_flex.signals.matlab import read_arrays
from rx90b_flex.signals.tables import number_of, one_line

Array = NDArray[np.float64]

TEXT = (".csv", ".csv.gz", ".tsv", ".txt")
BAGS = (".mcap", ".db3", ".bag")
KINDS = (*TEXT, ".parquet", ".mat", *BAGS)
JOINT_STATE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
SEPARATORS = (",", ";", "\t", "|", " ")
TIME = "time"


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
    """

    path: Path
    names: tuple[str, ...]
    values: Array
    notes: tuple[str, ...] = ()
    time: Array | None = None
    roles: Mapping[str, tuple[str, str]] | None = None

    def column(self, name: str) -> Array:
        """(N,) values of a column."""
        return self.values[:, self.names.index(name)]


def kind_of(path: Path) -> str:
    """Which of `KINDS` a file is; a folder with a metadata.yaml is a bag.

    Raises
    ------
    ValueError
        One line that names the file.
    """
    if not path.exists():
        raise ValueError(f"{path}: no such file")
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return ".db3"
        raise ValueError(f"{path}: a folder without metadata.yaml; expected a file or the folder of a ROS 2 bag")
    for kind in sorted(KINDS, key=len, reverse=True):
        if path.name.lower().endswith(kind):
            if path.stat().st_size == 0:
                raise ValueError(f"{path}: the file is empty")
            return kind
    raise ValueError(f"{path}: unknown kind of file; expected {', '.join(KINDS)}, or the folder of a ROS 2 bag")


def stem_of(path: Path) -> str:
    """The file's name without its extension."""
    ending = "" if path.is_dir() else kind_of(path)
    return path.name[: len(path.name) - len(ending)] or path.name


def read_log(path: Path, topic: str | None = None) -> Log:
    """Read a file.

    Parameters
    ----------
    path : of one of `KINDS`, or the folder of a bag.
    topic : of a bag; the one with most messages of type JointState where not given.

    Raises
    ------
    ValueError
        One line that names the file and, where it applies, column and row: unreadable, no table in it, a cell that is no
        number, no such topic; a format whose reader is not installed, with what to install.
    """
    kind = kind_of(path)
    if topic is not None and kind not in BAGS:
        raise ValueError(f"{path}: --topic {topic}: only bags have topics")
    try:
        if kind in BAGS:
            return _read_bag(path, topic)
        if kind in TEXT:
            return _read_text(path, kind)
        return _read_parquet(path) if kind == ".parquet" else _read_mat(path)
    except Exception as error:  # a damaged file takes readers to places that their authors never thought of
        if isinstance(error, ValueError) and str(error).startswith(str(path)):
            raise
        raise ValueError(f"{path}: cannot be read: {one_line(error)}") from error


# ---- tables ---------------------------------------------------------------------------------------------------


def _read_text(path: Path, kind: str) -> Log:
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if kind == ".csv.gz" else raw).decode("utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("%", "//"))]
    # a header may itself be a comment, as NumPy's savetxt writes it
    lines = [line.lstrip("# ") if k == 0 else line for k, line in enumerate(lines)]
    lines = [line for line in lines if not line.startswith("#")]
    if len(lines) < 2:
        raise ValueError(f"{path}: {len(lines)} lines; expected a line of column names and rows of numbers")
    separator = _separator(lines)
    if separator is None:
        raise ValueError(f"{path}: one column only; expected columns between commas, semicolons, tabs, bars or blanks")
    header = [cell.strip().strip('"') for cell in _cells(lines[0], separator)]
    if all(_number(cell, False) is not None for cell in header):
        raise ValueError(f"{path}: the first line holds numbers; a line of column names is expected")
    first = _cells(lines[1], separator)
    decimal_comma = separator != "," and any("," in cell for cell in first) and "." not in "".join(first)
    word = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}[separator]
    notes = [f"columns between {word}" + (", decimal commas" if decimal_comma else "")]
    try:  # quickly, where every cell is a number
        values = np.loadtxt(lines[1:], delimiter=None if separator == " " else separator, ndmin=2, comments=None)
    except ValueError:
        return _read_cells(path, header, [_cells(line, separator) for line in lines[1:]], decimal_comma, notes)
    if values.shape[1] != len(header):
        raise ValueError(f"{path}: row 1 has {values.shape[1]} cells, the header has {len(header)}")
    kept = [c for c in range(len(header)) if header[c]]
    return _log(path, [header[c] for c in kept], values[:, kept], notes)


def _read_cells(path: Path, header: list[str], rows: list[list[str]], decimal_comma: bool, notes: list[str]) -> Log:
    """Cell by cell: empty ones, words, decimal commas."""
    values = np.empty((len(rows), len(header)))
    text_columns: set[int] = set()
    for r, row in enumerate(rows):
        if len(row) != len(header):
            raise ValueError(f"{path}: row {r + 1} has {len(row)} cells, the header has {len(header)}")
        for c, cell in enumerate(row):
            number = _number(cell, decimal_comma)
            if number is None:
                if r > 0 and c not in text_columns:
                    raise ValueError(
                        f"{path}: column {header[c]!r}, row {r + 1}: {cell.strip()[:40]!r} is not a number"
                    )
                text_columns.add(c)  # words from the first row on: a label, not a signal
                number = np.nan
            values[r, c] = number
    kept = [c for c in range(len(header)) if c not in text_columns and header[c]]
    return _log(path, [header[c] for c in kept], values[:, kept], notes)


def _separator(lines: list[str]) -> str | None:
    """What divides header and first rows into equally many cells, most cells first."""
    found: list[tuple[int, str]] = []
    for separator in SEPARATORS:
        counts = {len(_cells(line, separator)) for line in lines[:20]}
        if len(counts) == 1 and counts != {1}:
            found.append((counts.pop(), separator))
    if not found:  # a row is wrong: go by the header, and let the row be told
        found = [(len(_cells(lines[0], s)), s) for s in SEPARATORS if len(_cells(lines[0], s)) > 1]
    # with decimal commas, semicolons or tabs divide as often
    order = {separator: -rank for rank, separator in enumerate((";", "\t", "|", ",", " "))}
    return max(found, key=lambda pair: (order[pair[1]] if pair[1] != " " else -9, pair[0]))[1] if found else None


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return next(csv.reader([line], delimiter=separator), [])


def _number(cell: str, decimal_comma: bool) -> float | None:
    cell = cell.strip().strip('"')
    if cell == "" or cell.lower() in ("nan", "na", "null", "none"):
        return float("nan")
    return number_of(cell.replace(",", ".") if decimal_comma else cell)


def _read_parquet(path: Path) -> Log:
    import pyarrow as pa
    import pyarrow.parquet as pa_parquet

    table = pa_parquet.read_table(path)
    if lerobot.is_episode(table):
        return _log(path, *lerobot.columns_of(path, table))
    names, columns = [], []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_timestamp(column.type):
            ticks = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy(zero_copy_only=False)
            names.append(f"{name}_s")
            columns.append((ticks - ticks[0]) * 1e-9)
        elif pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
            names.append(name)
            columns.append(column.to_numpy(zero_copy_only=False).astype(float))
    if not columns:
        raise ValueError(f"{path}: no columns of numbers")
    return _log(path, names, np.stack(columns, axis=1), [])


def _log(path: Path, names: Sequence[str], values: Array, notes: Sequence[str]) -> Log:
    for name in names:
        if list(names).count(name) > 1:
            raise ValueError(f"{path}: column {name!r} is there {list(names).count(name)} times")
    if len(values) < 2:
        raise ValueError(f"{path}: {len(values)} rows of numbers; expected more")
    return Log(path, tuple(names), values, tuple(notes))


# ---- MATLAB ---------------------------------------------------------------------------------------------------


def _read_mat(path: Path) -> Log:
    """Every numeric array that has as many samples as most others; the columns of `q` become `q_1`, `q_2`, ..."""
    arrays, version = read_arrays(path)
    lengths = Counter(max(a.shape) for a in arrays.values() if max(a.shape) > 1)
    if not lengths:
        raise ValueError(f"{path}: no numeric arrays of samples")
    # most arrays, then the longest
    samples = max(lengths, key=lambda length: (lengths[length], length))
    names, columns, left = [], [], []
    for name, array in arrays.items():
        if samples not in array.shape:
            left.append(name)
            continue
        table = array.reshape(len(array), -1)
        table = table if len(table) == samples else table.T
        if array.ndim == 1 or table.shape[1] == 1:
            names.append(name)
        else:
            names += [f"{name}_{k}" for k in range(1, table.shape[1] + 1)]
        columns.append(table)
    notes = [f"{version}: {samples} samples"]
    if left:
        notes.append(f"left out, of other lengths: {', '.join(left)}")
    return _log(path, names, np.concatenate(columns, axis=1), notes)


# ---- bags -----------------------------------------------------------------------------------------------------


def _read_bag(path: Path, topic: str | None) -> Log:
    """JointState messages; the time is their header's, or the recorder's where that is zero."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ValueError(f"{path}: bags need the package rosbags: pip install 'rx90b-flex[ros]'") from None
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        states = [c for c in reader.connections if c.msgtype in JOINT_STATE]
        chosen, notes = _topic(path, {c.topic: c.msgcount for c in states}, topic)
        messages = [
            (stamp, reader.deserialize(raw, connection.msgtype))
            for connection, stamp, raw in reader.messages([c for c in states if c.topic == chosen])
        ]
    return _joint_states(path, messages, [f"topic {chosen}, {len(messages)} messages", *notes])


def _topic(path: Path, counts: Mapping[str, int], topic: str | None) -> tuple[str, list[str]]:
    if not counts:
        raise ValueError(f"{path}: no topic of type sensor_msgs/JointState")
    if topic is not None:
        if topic not in counts:
            raise ValueError(
                f"{path}: no topic {topic!r} of type sensor_msgs/JointState; it has {', '.join(sorted(counts))}"
            )
        return topic, []
    chosen = max(sorted(counts), key=lambda name: counts[name])
    others = [name for name in sorted(counts) if name != chosen]
    return chosen, [f"other topics of the same type: {', '.join(others)} (choose with --topic)"] if others else []


def _joint_states(path: Path, messages: list[tuple[int, Any]], notes: list[str]) -> Log:
    joints = list(dict.fromkeys(name for _, message in messages for name in message.name))
    fields = {"motor_position": "position", "motor_velocity": "velocity", "torque": "effort"}
    values = np.full((len(messages), len(fields), len(joints)), np.nan)
    places = {joint: k for k, joint in enumerate(joints)}
    for row, (_, message) in enumerate(messages):
        at = [places[name] for name in message.name]
        if len(set(at)) < len(at):
            twice = next(name for name in message.name if list(message.name).count(name) > 1)
            raise ValueError(
                f"{path}: message {row + 1} names {twice!r} {list(message.name).count(twice)} times; once is expected"
            )
        for f, field in enumerate(fields.values()):
            given = np.asarray(getattr(message, field), dtype=float)
            if len(given) == len(at):  # a field may be left empty
                values[row, f, at] = given
    # a message may carry some joints only: a row counts where it has all that it could have
    whole = ~np.isnan(values).all(axis=0)
    complete = ~np.isnan(values[:, whole]).any(axis=1)
    if complete.sum() < 2:
        raise ValueError(f"{path}: no two messages hold all of {', '.join(joints)}")
    if not complete.all():
        notes.append(f"{np.count_nonzero(~complete)} messages without all joints left out")
    header = np.array([int(m.header.stamp.sec) * 10**9 + int(m.header.stamp.nanosec) for _, m in messages])
    stamps = np.array([stamp for stamp, _ in messages])
    used = header if header.any() else stamps
    notes.append(
        "time: " + ("of the messages' headers" if header.any() else "of the recorder, for the headers have none")
    )
    used = used[complete]
    names, columns, roles = [], [], {}
    for f, (signal, field) in enumerate(fields.items()):
        for k, joint in enumerate(joints):
            if whole[f, k]:
                name = f"{field}/{joint}"
                names.append(name)
                columns.append(values[complete, f, k])
                roles[name] = (signal, joint)
    return Log(path, tuple(names), np.stack(columns, axis=1), tuple(notes), (used - used[0]) * 1e-9, roles)
