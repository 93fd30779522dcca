"""Text: columns between commas, semicolons, tabs, bars or blanks; decimal points or commas; comments; compressed or not."""

from __future__ import annotations

import codecs
import csv
import dataclasses
import datetime
import gzip
import itertools
import re
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.signals.readers.reader import Log, Reader, log_of
from rx90b_flex.signals.tables import number_of
from rx90b_flex.signals.units import are_units

COMMENTS = ("#", "%", "//")
SEPARATORS = (",", ";", "\t", "|", " ")
# with decimal commas, semicolons or tabs divide as often
_RANK = {separator: rank for rank, separator in enumerate((";", "\t", "|", ",", " "))}
SEARCHED = 400  # lines among which the names of the columns are looked for
_CURE = "; the line of column names was not found: put # before lines that stand above it"
_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
# ISO 8601, as pandas and most loggers write dates with times; 31.12.2025 for the date; a time of day alone
_STAMP = re.compile(
    r"(?:(\d{4}-\d\d-\d\d)[T ]|(\d\d)\.(\d\d)\.(\d{4})[T ]+)?"
    r"(\d\d:\d\d:\d\d)(?:[.,](\d{1,9})\d*)?\s*(?:Z|UTC|([+-])(\d\d):?(\d\d))?",
    re.ASCII,
)
_EXCEL = re.compile(r"\ufeff?\"?sep=.\"?\s*")  # a first line that tells Excel the separator


class TextReader(Reader):
    """CSV of any kind."""

    endings = (".csv", ".csv.gz", ".tsv", ".txt")

    def read(self, path: Path) -> Log:
        raw = path.read_bytes()
        text, assumed = _decoded(path, gzip.decompress(raw) if path.name.lower().endswith(".gz") else raw)
        lines = [line.lstrip("\ufeff") for line in text.splitlines() if line.strip()]
        lines = _without_comments(lines[1:] if lines and _EXCEL.fullmatch(lines[0]) else lines)
        if len(lines) < 2:
            raise ValueError(f"{path}: {len(lines)} lines; expected a line of column names and rows of numbers")
        separator, lines, above = _from_the_header(lines)
        if separator is None:
            raise ValueError(
                f"{path}: one column only; expected columns between commas, semicolons, tabs, bars or blanks"
            )
        header = [cell.strip().strip('"') for cell in _cells(lines[0], separator)]
        if all(_number(cell, False) is not None for cell in header):
            raise ValueError(f"{path}: the first line holds numbers; a line of column names is expected")
        units = _units(header, lines, separator)
        cure = "" if _is_header(lines, separator) else _CURE
        log = _read_rows(path, header, lines[2 if units else 1 :], separator, cure)
        if units:
            log = dataclasses.replace(log, notes=(*log.notes, "a row of units below the names"))
        # what a column is read in, as of dates with times, overrules what stands below its name
        return dataclasses.replace(log, units={**units, **log.units}, assumed=(*assumed, *above, *log.assumed))


def _decoded(path: Path, raw: bytes) -> tuple[str, list[str]]:
    """The text of a file, and what was assumed of its characters."""
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16"), []
    try:
        return raw.decode("utf-8-sig"), []
    except UnicodeDecodeError as error:
        byte, line = raw[error.start], raw[: error.start].count(b"\n") + 1
    try:
        text = raw.decode("cp1252")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise ValueError(
            f"{path}: cannot be read: no text; line {line} holds byte 0x{byte:02x}; expected text as UTF-8 or CP1252"
        )
    return text, ["its characters are no UTF-8: read as CP1252 (Latin-1)"]


def _without_comments(lines: list[str]) -> list[str]:
    """Lines without comments; the names come first, which may be one, as NumPy's savetxt and `rostopic echo -p` write them."""
    above = itertools.takewhile(lambda line: line.lstrip().startswith(COMMENTS), lines)
    comments = [line.lstrip("#%/ \t") for line in above]
    rows = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    if not comments or not rows:
        return [*comments, *rows]
    separator = _separator(rows[:20])
    cells = _cells(rows[0], separator) if separator else rows[:1]
    numbers = any(cell.strip() and _number(cell, separator != ",") is not None for cell in cells)
    if not numbers:
        return rows
    names = comments[-1]
    if separator and len(_cells(names, separator)) != len(cells):
        return rows
    if len(comments) > 1 and separator and are_units(_cells(names, separator)):
        return [comments[-2], names, *rows]
    return [names, *rows]


def _from_the_header(lines: list[str]) -> tuple[str | None, list[str], list[str]]:
    """What divides the columns, the lines from that of the names on, and what was assumed of those above it."""
    usual = _separator(lines)
    if usual is not None and _is_header(lines, usual):
        return usual, lines, []
    for separator in sorted(SEPARATORS, key=_RANK.__getitem__):
        cells = [_cells(line, separator) for line in lines[:SEARCHED]]
        width = Counter(map(len, cells)).most_common(1)[0][0]
        # what is as wide and full above it may be the names, or numbers that are not to be lost
        full = [len(row) == width and 2 * sum(bool(cell.strip()) for cell in row) > width for row in cells]
        first = full.index(True) if True in full else 0
        if width > 1 and first > 0 and _is_header(lines[first:], separator):
            return separator, lines[first:], [f"{first} lines before the header left out"]
    return usual, lines, []


def _is_header(lines: list[str], separator: str) -> bool:
    """Whether the first line holds words for the most part, and the one below it, or below a row of units, numbers."""
    names, *rows = ([cell.strip().strip('"') for cell in _cells(line, separator)] for line in lines[:3])
    if len(rows) > 1 and are_units(rows[0]):
        rows = rows[1:]
    if not rows or len(rows[0]) != len(names):
        return False
    words = [name for name in names if name and _number(name, separator != ",") is None]
    cells = [cell for cell in rows[0] if cell]
    numbers = [cell for cell in cells if _STAMP.fullmatch(cell) or _number(cell, separator != ",") is not None]
    return 2 * len(words) > len(names) and 2 * len(numbers) >= len(cells) > 0


def _units(header: list[str], lines: list[str], separator: str) -> dict[str, str]:
    """Column -> unit, where a row of them stands below the names; else empty."""
    cells = [cell.strip().strip('"') for cell in _cells(lines[1], separator)]
    if len(cells) != len(header) or len(lines) < 3 or not are_units(cells):
        return {}
    if any(cell and cell != "1" and _number(cell, True) is not None for cell in cells):
        return {}
    return dict(zip(header, cells, strict=True))


def _read_rows(path: Path, header: list[str], lines: list[str], separator: str, cure: str) -> Log:
    first = [cell for cell in _cells(lines[0], separator) if not _STAMP.fullmatch(cell.strip())]
    decimal_comma = separator != "," and any("," in cell for cell in first) and "." not in "".join(first)
    notes = [f"columns between {_WORDS[separator]}" + (", decimal commas" if decimal_comma else "")]
    try:  # quickly, where every cell is a number
        values = np.loadtxt(lines, delimiter=None if separator == " " else separator, ndmin=2, comments=None)
    except ValueError:
        return _read_cells(path, header, [_cells(line, separator) for line in lines], decimal_comma, notes, cure)
    if not any(header[values.shape[1] :]):  # separators behind the last name
        header = header[: values.shape[1]]
    if values.shape[1] != len(header):
        raise ValueError(f"{path}: row 1 has {values.shape[1]} cells, the header has {len(header)}{cure}")
    kept = [c for c in range(len(header)) if header[c]]
    return log_of(path, [header[c] for c in kept], values[:, kept], notes)


def _read_cells(
    path: Path, header: list[str], rows: list[list[str]], decimal_comma: bool, notes: list[str], cure: str
) -> Log:
    """Cell by cell: empty ones, words, decimal commas, dates with times."""
    header, (rows, told) = list(header), _without_empty_ends(rows, header)
    if not rows:
        raise ValueError(f"{path}: no row of numbers")
    values, notes = np.empty((len(rows), len(header))), [*notes, *told]
    stamps = {c for c, cell in enumerate(rows[0]) if _STAMP.fullmatch(cell.strip().strip('"'))}
    text_columns: set[int] = set()
    clocks: dict[str, float] = {}
    for r, row in enumerate(rows):
        if len(row) != len(header):
            raise ValueError(f"{path}: row {r + 1} has {len(row)} cells, the header has {len(header)}{cure}")
        for c, cell in enumerate(row):
            if c in stamps:
                continue
            number = _number(cell, decimal_comma)
            if number is None:
                if r > 0 and c not in text_columns:
                    raise ValueError(
                        f"{path}: column {header[c]!r}, row {r + 1}: {cell.strip()[:40]!r} is not a number"
                    )
                text_columns.add(c)  # words from the first row on: a label, not a signal
                number = np.nan
            values[r, c] = number
    for c in sorted(stamps):
        if not header[c] and "time" not in header:
            header[c] = "time"  # pandas gives an index no name
        values[:, c] = _seconds(path, header[c], [row[c] for row in rows])
        clocks[header[c]] = _nanoseconds(_STAMP.fullmatch(rows[0][c].strip().strip('"')), zoned=False) * 1e-9
    units = {header[c]: "s" for c in sorted(stamps) if header[c]}
    notes = [*notes, *(f"column {name!r}: dates with times, as seconds from the first" for name in units)]
    kept = [c for c in range(len(header)) if c not in text_columns and header[c]]
    words = {header[c]: rows[0][c].strip()[:40] for c in sorted(text_columns) if header[c]}
    log = log_of(path, [header[c] for c in kept], values[:, kept], notes)
    return dataclasses.replace(log, words=words, units=units, clocks=clocks)


def _without_empty_ends(rows: list[list[str]], header: list[str]) -> tuple[list[list[str]], list[str]]:
    """Rows without empty ones at the end, and each as wide as the header where only empty cells differ; what was left out."""

    def empty(cells: list[str]) -> bool:
        return not any(cell.strip() for cell in cells)

    count, width = len(rows), len(header)
    while count and empty(rows[count - 1]):
        count -= 1
    told = [f"{len(rows) - count} empty rows at the end left out"] if count < len(rows) else []
    out, beyond = [], 0
    for row in rows[:count]:
        if len(row) > width and empty(row[width:]):
            row, beyond = row[:width], beyond + 1
        elif len(row) < width and not any(header[len(row) :]):
            row = row + [""] * (width - len(row))
        out.append(row)
    if beyond:
        told.append(f"empty cells beyond the last column left out, in {beyond} rows")
    return out, told


def _seconds(path: Path, name: str, cells: list[str]) -> NDArray[np.float64]:
    """Dates with times as seconds from the first; NaN where a cell is empty."""
    out: list[int | None] = []
    for r, cell in enumerate(cells):
        found = _STAMP.fullmatch(cell.strip().strip('"'))
        try:
            out.append(_nanoseconds(found) if found or cell.strip() else None)
        except (ValueError, TypeError):
            shown = cell.strip()[:40]
            raise ValueError(
                f"{path}: column {name!r}, row {r + 1}: {shown!r} is no date with time as {cells[0].strip()[:40]!r} is"
            ) from None
    start = next(t for t in out if t is not None)
    return np.array([np.nan if t is None else (t - start) / 1e9 for t in out])


def _nanoseconds(found: re.Match[str] | None, zoned: bool = True) -> int:
    """Since 1970, UTC or (not `zoned`) as the clock shows it.

    TypeError without a match, ValueError for a day or hour that does not exist.
    """
    if found is None:
        raise TypeError
    iso, day_of_month, month, year, clock, fraction, sign, hours, minutes = found.groups()
    day = iso or (f"{year}-{month}-{day_of_month}" if year else "1970-01-01")
    whole = datetime.datetime.fromisoformat(f"{day}T{clock}") - datetime.datetime(1970, 1, 1)
    zone = int(f"{sign}1") * (60 * int(hours) + int(minutes)) * 60 if sign and zoned else 0
    return (whole.days * 86400 + whole.seconds - zone) * 10**9 + int((fraction or "0").ljust(9, "0"))


def _separator(lines: list[str]) -> str | None:
    """What divides header and first rows into equally many cells, most cells first."""
    found: list[tuple[int, str]] = []
    for separator in SEPARATORS:
        counts = {len(_cells(line, separator)) for line in lines[:20]}
        if len(counts) == 1 and counts != {1}:
            found.append((counts.pop(), separator))
    if not found:  # a row is wrong: go by the header, and let the row be told
        found = [(len(_cells(lines[0], s)), s) for s in SEPARATORS if len(_cells(lines[0], s)) > 1]
    return min(found, key=lambda pair: (_RANK[pair[1]], -pair[0]))[1] if found else None


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return next(csv.reader([line], delimiter=separator), [])


def _number(cell: str, decimal_comma: bool) -> float | None:
    cell = cell.strip().strip('"')
    if cell == "" or cell.lower() in ("nan", "na", "null", "none"):
        return float("nan")
    return number_of(cell.replace(",", ".") if decimal_comma else cell)
