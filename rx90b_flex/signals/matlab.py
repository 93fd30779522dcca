"""MATLAB files, read in a process of their own: a damaged one may end in a segmentation fault of the reader.

Run as a script, this file reads one file and hands its arrays over on standard output. It needs nothing of this package.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
VERSION_73 = b"MATLAB 7.3"  # how such a file begins


def read_arrays(path: Path) -> tuple[dict[str, Array], str]:
    """Numeric arrays of a MATLAB file, with ``structure.field`` as names, and what kind of file it is.

    Raises
    ------
    ValueError
        One line that names the file: it cannot be read, or h5py is needed and not there.
    """
    with path.open("rb") as file:
        version_73 = file.read(len(VERSION_73)) == VERSION_73
    if version_73:
        try:
            import h5py  # noqa: F401  # only whether it is there
        except ImportError:
            raise ValueError(
                f"{path}: a MATLAB file of version 7.3, which needs h5py: pip install h5py, or save('-v7') in MATLAB"
            ) from None
    command = [sys.executable, "-P", __file__, str(path)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if done.returncode < 0:
        raise ValueError(f"{path}: cannot be read: its reader crashed (signal {-done.returncode}); the file is damaged")
    if done.returncode != 0:
        words = done.stderr.decode(errors="replace").strip().splitlines() or [f"status {done.returncode}"]
        raise ValueError(f"{path}: cannot be read: {words[-1]}")
    arrays: dict[str, Array] = pickle.loads(done.stdout)
    return arrays, "MATLAB file, version 7.3" if version_73 else "MATLAB file"


def _arrays(prefix: str, given: Mapping[str, Any]) -> Iterator[tuple[str, Array]]:
    for key, value in given.items():
        if key.startswith("__"):
            continue
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _arrays(f"{name}.", value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim in (1, 2) and value.size > 1:
            yield name, value.astype(float)


def _read_classic(path: str) -> dict[str, Array]:
    from scipy.io import loadmat

    return dict(_arrays("", loadmat(path, simplify_cells=True)))


def _read_hdf(path: str) -> dict[str, Array]:
    import h5py

    found: dict[str, Array] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and item.ndim in (1, 2) and item.size > 1:
            if name.startswith("#") or "char" in str(item.attrs.get("MATLAB_class", "")):
                return
            found[name.replace("/", ".")] = np.asarray(item, dtype=float).T  # MATLAB stores columns first

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return found


def _hand_over(path: str) -> int:
    with open(path, "rb") as file:
        read = _read_hdf if file.read(len(VERSION_73)) == VERSION_73 else _read_classic
    try:
        arrays = read(path)
    except Exception as error:  # of either library, in any form
        print(" ".join(str(error).split()) or type(error).__name__, file=sys.stderr)
        return 1
    pickle.dump(arrays, sys.stdout.buffer)
    return 0


if __name__ == "__main__":
    sys.exit(_hand_over(sys.argv[1]))
