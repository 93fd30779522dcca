"""Dead-weight tests: how far a hinge yields to a moment, step by step up and down (section 4.1)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from rx90b_flex.files.keys import suggestion
from rx90b_flex.pieces import Array
from rx90b_flex.signals.tables import read_parquet, read_table

Mask = NDArray[np.bool_]

DIRECTIONS = ("up", "down")


@dataclass(frozen=True, eq=False)
class StaticTest:
    """Readings of one hinge under dead weights, in the order in which they were taken.

    Attributes
    ----------
    coordinate : str
        What was loaded, for example ``joint_2:bend_1``.
    moment : array, shape (N,)
        Of the load about the hinge's axis, N m.
    deformation : array, shape (N,)
        Turn of the link behind the joint against the link before it, rad; its zero is free.
    rising : bool array, shape (N,)
        Whether the load had come from below; the largest load counts as rising.
    moment_std, deformation_std : float, optional
        Standard deviations of one reading, where they are known; N m and rad.
    """

    coordinate: str
    moment: Array
    deformation: Array
    rising: Mask
    moment_std: float | None = None
    deformation_std: float | None = None

    def __post_init__(self) -> None:
        for name, kind in (("moment", float), ("deformation", float), ("rising", bool)):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=kind))
        shapes = {self.moment.shape, self.deformation.shape, self.rising.shape}
        if len(shapes) != 1 or self.moment.ndim != 1:
            raise ValueError(f"static test {self.coordinate!r}: moment, deformation and rising have different shapes")
        if not (np.isfinite(self.moment).all() and np.isfinite(self.deformation).all()):
            raise ValueError(f"static test {self.coordinate!r}: moment and deformation must be finite")
        for name in ("moment_std", "deformation_std"):
            std = getattr(self, name)
            if std is not None and not (np.isfinite(std) and std >= 0.0):
                raise ValueError(f"static test {self.coordinate!r}: {name} is {std!r}; expected 0 or more")

    def __len__(self) -> int:
        return len(self.moment)


def read_static_table(
    path: str | os.PathLike[str],
    coordinate: str,
    lever: float | None = None,
    moment_std: float | None = None,
    deformation_std: float | None = None,
) -> StaticTest:
    """Readings of one test: a table (.csv, .csv.gz, .parquet) with a row a reading.

    Its columns are ``moment_nm`` or ``load_n``, ``deformation_rad`` and ``direction`` (``up`` or ``down``).

    Parameters
    ----------
    path : path
    coordinate : str
    lever : float, optional
        Moment over load, m, where the table has loads; its sign is that of the hinge's axis.
    moment_std, deformation_std : float, optional
        Of one reading, N m and rad.

    Raises
    ------
    ValueError
        One line that names the file and the column or row.
    """
    path = Path(path)
    table = read_table(path, ["deformation_rad"], optional=["moment_nm", "load_n"])
    loads = [name for name in ("moment_nm", "load_n") if name in table.names]
    if len(loads) != 1:
        found = "both moment_nm and load_n" if loads else "neither moment_nm nor load_n"
        raise ValueError(f"{path}: has {found}; expected one of these columns")
    if loads == ["load_n"] and lever is None:
        raise ValueError(f"{path}: column 'load_n' needs lever_arm_m; describe the test in a TOML file that gives it")
    load, deformation = table.finite([*loads, "deformation_rad"]).T
    moment = load * lever if loads == ["load_n"] and lever is not None else load
    return StaticTest(coordinate, moment, deformation, _read_direction(path), moment_std, deformation_std)


def gives_moment(path: str | os.PathLike[str]) -> bool:
    """Whether a table of a dead-weight test has moments, which need no lever."""
    return "moment_nm" in read_table(Path(path), ["deformation_rad"], optional=["moment_nm"]).names


def _read_direction(path: Path) -> Mask:
    frame = read_parquet(path).to_pandas() if path.suffix.lower() == ".parquet" else pd.read_csv(path, dtype=str)
    names = [str(name).strip() for name in frame.columns]
    if "direction" not in names:
        raise ValueError(f"{path}: no column 'direction'{suggestion('direction', names)}")
    words = frame.iloc[:, names.index("direction")].fillna("").astype(str).str.strip().str.lower()
    bad = np.flatnonzero(~words.isin(DIRECTIONS))
    if len(bad):
        found = words.iloc[int(bad[0])]
        raise ValueError(f"{path}: column 'direction', row {bad[0] + 1}: {found!r}; expected 'up' or 'down'")
    return np.asarray(words == "up")
