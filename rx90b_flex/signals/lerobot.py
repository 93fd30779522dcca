"""Episodes of LeRobot data sets: Parquet with a list a sample, whose names stand in ``meta/info.json``.

``observation.state`` is taken for positions, ``action`` for their references; ``observation.velocity``, ``observation.effort``
and the like for what their names say. A file may hold several episodes: the longest is read. Versions 2 and 3.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from rx90b_flex.pieces import Array

STATE, EPISODE, TIME = "observation.state", "episode_index", "timestamp"
MEANT = {STATE: "position", "action": "reference_position"}  # what their own names do not say
LEVELS = 4  # folders above the file in which meta/ may lie


def is_episode(table: Any) -> bool:
    """Whether a Parquet table is of a LeRobot data set."""
    return STATE in table.column_names and TIME in table.column_names


def columns_of(path: Path, table: Any) -> tuple[list[str], Array, list[str]]:
    """Names of the columns, their values (N, columns), and what was worked out.

    Raises
    ------
    ValueError
        One line that names the file and the column: lists of other lengths, or no numbers.
    """
    notes = ["an episode of a LeRobot data set"]
    rows = np.arange(len(table))
    if EPISODE in table.column_names:
        episode = table.column(EPISODE).to_numpy(zero_copy_only=False)
        which, counts = np.unique(episode, return_counts=True)
        longest = which[np.argmax(counts)]
        rows = np.flatnonzero(episode == longest)
        if len(which) > 1:
            notes = [f"a LeRobot data set of {len(which)} episodes: the longest is read, number {longest}"]
    joints_of = _joints(path)
    names, columns = [TIME], [table.column(TIME).to_numpy(zero_copy_only=False)[rows].astype(float)[:, None]]
    for key in table.column_names:
        if key != "action" and not key.startswith("observation."):
            continue
        values = table.column(key).to_pylist()
        if not isinstance(values[0], list | tuple):
            continue  # a frame of a video
        lengths = {len(value) for value in values}
        if len(lengths) != 1:
            raise ValueError(f"{path}: column {key!r}: lists of {min(lengths)} to {max(lengths)} numbers")
        (width,) = lengths
        joints = joints_of.get(key, [])
        ends = joints if len(joints) == width else [str(k) for k in range(1, width + 1)]
        names += [f"{MEANT.get(key, key.removeprefix('observation.'))}/{end}" for end in ends]
        columns.append(np.array(values, dtype=float)[rows])
    said = ", ".join(f"{key} as {meant}" for key, meant in MEANT.items() if key in table.column_names)
    return names, np.concatenate(columns, axis=1), [*notes, f"read {said}"]


def _joints(path: Path) -> dict[str, list[str]]:
    """Names of a feature's numbers, as the data set's ``meta/info.json`` has them; none where there is no such file."""
    for folder in list(path.resolve().parents)[:LEVELS]:
        info = folder / "meta" / "info.json"
        if not info.is_file():
            continue
        try:
            features = json.loads(info.read_text(encoding="utf-8"))["features"]
            return {key: _listed(feature.get("names")) for key, feature in features.items()}
        except (ValueError, KeyError, AttributeError) as error:
            raise ValueError(f"{info}: cannot be read: {error!r}") from None
    return {}


def _listed(names: Any) -> list[str]:
    if isinstance(names, dict):  # {"motors": [...]}
        names = next((value for value in names.values() if isinstance(value, list)), None)
    # shoulder_pan.pos is the position of shoulder_pan: the feature says so already
    return [str(name).rsplit(".", 1)[0] for name in names] if isinstance(names, list) else []
