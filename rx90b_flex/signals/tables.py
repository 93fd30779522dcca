"""Read and write the numeric tables that recordings are kept in: .csv, .csv.gz and .parquet."""

from __future__ import annotations

import csv
import gzip
import io
import os
import re
import secrets
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import NDArray

from rx90b_flex.files.keys import suggestion

EXTENSIONS = (".csv", ".csv.gz", ".parquet")
PIECE = 4 << 20  # bytes of text that are parsed at once
ROOM = 64 * PIECE  # what the parser and its thread reserve for that, with some to spare
# BLAS takes its working memory at its first product, and ends the process where there is none: now, before a log fills what there is
np.eye(64) @ np.eye(64)

LARGEST_TIME = 1e20  # nanoseconds since 1970 are 2e18
LARGEST = 1e9  # of any number that is read: no signal of a robot has so many SI units
_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf|infinity)", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Table:
    """Numeric columns of one file.

    Attributes
    ----------
    path : the file.
    names : names of the columns that were read.
    values : (rows, columns) float64, in the order of `names`; empty cells are NaN.
    single_precision : one flag a column, true where the file stores 32-bit floats.
    """

    path: Path
    names: tuple[str, ...]
    values: NDArray[np.float64]
    single_precision: tuple[bool, ...]

    def columns(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(rows, len(names)) values of the named columns."""
        return self.values[:, [self.names.index(name) for name in names]]

    def finite(self, names: Sequence[str]) -> NDArray[np.float64]:
        """As `columns`; ValueError, naming column and row, where one is no finite number or beyond `LARGEST` (`LARGEST_TIME`)."""
        values = self.columns(names)
        for name, column in zip(names, values.T, strict=True):
            limit = LARGEST_TIME if name == "time" else LARGEST
            bad = ~(np.abs(column) < limit)
            if bad.any():
                row = int(np.argmax(bad))
                why = f"{column[row]:g}; expected a number below {limit:g}"
                raise ValueError(
                    f"{self.path}: column {name!r}, row {row + 1}: {why if np.isfinite(column[row]) else 'no finite number'}"
                )
        return values


def extension_of(path: Path) -> str:
    """The table extension of `path`, in lower case; ValueError where it is none of `EXTENSIONS`."""
    for extension in sorted(EXTENSIONS, key=len, reverse=True):
        if path.name.lower().endswith(extension):
            return extension
    raise ValueError(f"{path}: unknown kind of file; expected {', '.join(EXTENSIONS)}")


def stem_of(path: Path) -> str:
    """File name without its table extension: `run_1.csv.gz` gives `run_1`."""
    return path.name[: -len(extension_of(path))]


def one_line(error: Exception) -> str:
    """The message of an error without line breaks; its kind where it has no message."""
    return " ".join(str(error).split()) or type(error).__name__


def read_table(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> Table:
    """Read only the named columns of a table, as float64.

    Parameters
    ----------
    path : .csv, .csv.gz (one header line, commas, UTF-8) or .parquet.
    columns : columns that must be there.
    optional : columns read where they are there.

    Raises
    ------
    ValueError
        One line naming the file and, where it applies, column and data row (counted from 1): file missing,
        unreadable or empty, no data rows, a column missing or there twice, none of the optional columns
        where none must be there, a cell that is not a number.
    """
    extension = extension_of(path)
    try:
        size = path.stat().st_size if path.is_file() else None
    except OSError as error:  # a name that no folder can hold
        raise ValueError(f"{path}: {error.strerror}") from None
    if size is None:
        raise ValueError(f"{path}: no such file")
    if size == 0:
        raise ValueError(f"{path}: the file is empty")
    try:
        header = list(pa_parquet.read_schema(path).names) if extension == ".parquet" else _csv_header(path)
        refuse_separators(path, header)
        wanted = _choose(path, header, columns, optional)
        if not wanted:
            raise ValueError(f"{path}: has none of the columns {', '.join(optional)}")
        positions = [header.index(name) for name in wanted]
        read = _read_parquet if extension == ".parquet" else _read_csv
        values, single = read(path, header, positions)
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error, pa.ArrowException) as error:
        raise ValueError(f"{path}: cannot be read: {one_line(error)}") from error
    except MemoryError as error:
        raise ValueError(f"{path}: cannot be read: not enough memory") from error
    if not len(values):
        raise ValueError(f"{path}: a header but no data rows")
    return Table(path, tuple(wanted), values, single)


def write_table(path: Path, names: Sequence[str], values: NDArray[np.float64]) -> None:
    """Write (rows, columns) float64 `values` under `names`; the file appears whole or not at all.

    CSV is written with the shortest digits that read back as the same number, so that every format is exact.
    """
    extension = extension_of(path)
    table = pa.table([pa.array(np.ascontiguousarray(column)) for column in values.T], names=list(names))

    def write(temporary: Path) -> None:
        as_csv = pa_csv.WriteOptions(quoting_style="needed")
        if extension == ".parquet":
            pa_parquet.write_table(table, temporary)
        elif extension == ".csv":
            pa_csv.write_csv(table, temporary, as_csv)
        else:
            # mtime=0 keeps the bytes the same for the same data
            with open(temporary, "wb") as raw, gzip.GzipFile("", "wb", mtime=0, fileobj=raw) as stream:
                pa_csv.write_csv(table, stream, as_csv)

    write_whole(path, write)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with a temporary name beside `path`, then rename: readers never see half a file."""
    temporary = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _choose(path: Path, header: Sequence[str], columns: Sequence[str], optional: Sequence[str]) -> list[str]:
    wanted = list(dict.fromkeys([*[name for name in optional if name in header], *columns]))
    for name in wanted:
        count = header.count(name)
        if count > 1:
            raise ValueError(f"{path}: column {name!r} is there {count} times")
        if count == 0:
            raise ValueError(f"{path}: no column {name!r}{_why_missing(name, header)}")
    return wanted


def refuse_separators(path: Path, header: Sequence[str]) -> None:
    """Refuse a table whose names are divided by something else than commas, which looks like one column.

    Raises
    ------
    ValueError
        One line that names the file.
    """
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) - header.count("") <= 1 and any(separator in name for name in header):
            raise ValueError(
                f"{path}: columns seem separated by {word}, commas are expected; "
                "save it with commas between columns and points in numbers"
            )


def _why_missing(name: str, header: Sequence[str]) -> str:
    if header and all(number_of(cell) is not None for cell in header):
        return "; the first line holds numbers, a line of column names is expected"
    hint = suggestion(name, header)
    if hint:
        return hint
    shown = ", ".join(repr(found) for found in header[:12])
    return f"; the file has {shown}{' and others' if len(header) > 12 else ''}"


def _csv_header(path: Path) -> list[str]:
    with _opened(path) as stream:
        header = next(csv.reader(io.TextIOWrapper(stream, encoding="utf-8-sig", newline="")), [])
    if not header:
        raise ValueError(f"{path}: the file is empty or its first line is blank; a line of column names is expected")
    return [name.strip() for name in header]


def _opened(path: Path) -> IO[bytes]:
    return cast(IO[bytes], gzip.open(path, "rb")) if extension_of(path) == ".csv.gz" else path.open("rb")


def _read_csv(
    path: Path, header: Sequence[str], positions: Sequence[int]
) -> tuple[NDArray[np.float64], tuple[bool, ...]]:
    """Values of some columns, read in pieces: neither the text as a whole is kept nor all of what the parser makes of it."""
    pieces = [np.empty((0, len(positions)))]
    rows, names = 0, [header[position] for position in positions]
    with _opened(path) as stream:
        line = stream.readline()
        if b"\r" in line.rstrip(b"\r\n"):  # lines end with it alone, as old programs write them
            stream = io.BytesIO((line + stream.read()).replace(b"\r", b"\n"))
            stream.readline()
        for text in _pieces(stream):
            table = _parsed(path, text, len(header), positions, rows)
            pieces.append(
                np.stack([_numbers(path, name, table.column(i), rows) for i, name in enumerate(names)], axis=1)
            )
            rows += table.num_rows
    return np.concatenate(pieces), (False,) * len(positions)


def _pieces(stream: IO[bytes]) -> Iterator[bytes]:
    """The lines of a file, some at a time, where there is room for what the parser takes: without it the parser ends the process."""
    while text := stream.read(PIECE) + stream.readline():
        if text.strip():
            np.empty(ROOM, np.uint8)
            yield text


def _parsed(path: Path, text: bytes, width: int, positions: Sequence[int], rows: int) -> pa.Table:
    invalid: list[str] = []

    def on_invalid_row(row: pa_csv.InvalidRow) -> str:
        at = "a row" if row.number is None else f"data row {rows + row.number}"
        invalid.append(f"{at} has {row.actual_columns} cells, the header has {row.expected_columns}")
        return "error"

    # Columns go by position here, so that names may hold blanks and unused columns may share a name.
    keys = [str(index) for index in range(width)]
    try:
        return pa_csv.read_csv(
            pa.BufferReader(text),
            pa_csv.ReadOptions(column_names=keys, use_threads=False),
            pa_csv.ParseOptions(invalid_row_handler=on_invalid_row),
            pa_csv.ConvertOptions(include_columns=[keys[position] for position in positions]),
        )
    except pa.ArrowException as error:
        if invalid:
            raise ValueError(f"{path}: {invalid[0]}") from error
        raise


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The columns of a Parquet file, all unless named, read by this thread: another without memory would end the process, or wait."""
    with pa_parquet.ParquetFile(path, pre_buffer=False) as file:
        return file.read(columns=None if columns is None else list(columns), use_threads=False)


def _read_parquet(
    path: Path, header: Sequence[str], positions: Sequence[int]
) -> tuple[NDArray[np.float64], tuple[bool, ...]]:
    names = [header[position] for position in positions]
    table = read_parquet(path, names)
    values = np.empty((table.num_rows, len(names)))
    for index, name in enumerate(names):
        values[:, index] = _numbers(path, name, table.column(name))
    return values, tuple(table.column(name).type == pa.float32() for name in names)


def _numbers(path: Path, name: str, column: pa.ChunkedArray, before: int = 0) -> NDArray[np.float64]:
    """A column's numbers; `before`: rows of the file before its first."""
    kind = column.type
    if pa.types.is_floating(kind) or pa.types.is_integer(kind):
        return np.concatenate([np.zeros(0), *(_floats(chunk) for chunk in column.chunks)])
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    numbers = np.empty(len(column))
    for row, cell in enumerate(column.to_pylist()):
        number = np.nan if cell is None or cell == "" else number_of(cell)
        if number is None:
            found = " ".join(str(cell).split())
            raise ValueError(f"{path}: column {name!r}, row {before + row + 1}: {found[:40]!r} is not a number")
        numbers[row] = number
    return numbers


def _floats(chunk: pa.Array) -> NDArray[np.float64]:
    """Numbers of one chunk of a column, NaN where a cell is empty."""
    if chunk.null_count:
        return np.asarray(chunk.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    # pyarrow's own way to NumPy first loads pandas, which takes longer than most logs
    return np.from_dlpack(chunk).astype(np.float64)


def number_of(cell: object) -> float | None:
    """The number that a cell of a table holds, or None: decimal notation in ASCII, nan and inf, as every other program reads it.

    Python's own reading takes more: ``1_000``, and digits of every script.
    """
    if isinstance(cell, bool):
        return None
    if isinstance(cell, str) and not _NUMBER.fullmatch(cell.strip()):
        return None
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
