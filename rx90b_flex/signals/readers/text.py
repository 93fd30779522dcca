"""Text: columns between commas, semicolons, tabs, bars or blanks; decimal points or commas; comments; compressed or not."""

from __future__ import annotations

import csv
import dataclasses
import gzip
from pathlib import Path

import numpy as np

from rx90b_flex.signals.readers.reader import Log, Reader, log_of
from rx90b_flex.signals.tables import number_of

SEPARATORS = (",", ";", "\t", "|", " ")


class TextReader(Reader):
    """CSV of any kind."""

    endings = (".csv", ".csv.gz", ".tsv", ".txt")

    def read(self, path: Path) -> Log:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if path.name.lower().endswith(".gz") else raw).decode("utf-8-sig")
        lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("%", "//"))]
        # a header may itself be a comment, as NumPy's savetxt writes it
        lines = [line.lstrip("# ") if k == 0 else line for k, line in enumerate(lines)]
        lines = [line for line in lines if not line.startswith("#")]
        if len(lines) < 2:
            raise ValueError(f"{path}: {len(lines)} lines; expected a line of column names and rows of numbers")
        separator = _separator(lines)
        if separator is None:
            raise ValueError(
                f"{path}: one column only; expected columns between commas, semicolons, tabs, bars or blanks"
            )
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
        return log_of(path, [header[c] for c in kept], values[:, kept], notes)


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
    words = {header[c]: rows[0][c].strip()[:40] for c in sorted(text_columns) if header[c]}
    return dataclasses.replace(log_of(path, [header[c] for c in kept], values[:, kept], notes), words=words)


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
