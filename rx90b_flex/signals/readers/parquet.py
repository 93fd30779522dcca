"""Parquet: tables with a column a signal, and episodes of LeRobot data sets."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from rx90b_flex.signals import lerobot
from rx90b_flex.signals.readers.reader import Log, Reader, log_of
from rx90b_flex.signals.tables import read_parquet


class ParquetReader(Reader):
    """Columns of numbers and of time stamps."""

    endings = (".parquet",)

    def read(self, path: Path) -> Log:
        import pyarrow as pa

        table = read_parquet(path)
        if lerobot.is_episode(table):
            return log_of(path, *lerobot.columns_of(path, table))
        names, columns = [], []
        words: dict[str, str] = {}
        clocks: dict[str, float] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if pa.types.is_timestamp(column.type):
                ticks = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy(zero_copy_only=False)
                names.append(f"{name}_s")
                columns.append((ticks - ticks[0]) * 1e-9)
                clocks[names[-1]] = float(ticks[0]) * 1e-9
            elif pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
                names.append(name)
                columns.append(column.to_numpy(zero_copy_only=False).astype(float))
            elif len(column):
                words[name] = str(column[0].as_py())[:40]
        if not columns:
            raise ValueError(f"{path}: no columns of numbers")
        return dataclasses.replace(log_of(path, names, np.stack(columns, axis=1), []), words=words, clocks=clocks)
