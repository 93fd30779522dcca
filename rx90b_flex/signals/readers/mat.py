"""MATLAB files."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from rx90b_flex.signals.matlab import read_arrays
from rx90b_flex.signals.readers.reader import Log, Reader, log_of


class MatlabReader(Reader):
    """Arrays of one length."""

    endings = (".mat",)

    def read(self, path: Path) -> Log:
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
        return log_of(path, names, np.concatenate(columns, axis=1), notes)
