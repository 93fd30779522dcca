"""Whether a file or folder speaks of frequency or of time, found out without what either search needs."""

from __future__ import annotations

import os
from pathlib import Path

from rx90b_flex.files.toml import read_toml

KEYS = frozenset({"pose", "band_hz", "resonance", "antiresonance"})  # no campaign has any of them


def speaks_of_frequency(source: str | os.PathLike[str]) -> bool:
    """Whether a file or folder is a modal table or a result of ``rx90b-flex frf``, not a campaign of recordings."""
    path = Path(source)
    if path.is_dir():
        return (path / "frf.json").is_file()
    try:
        return path.suffix == ".toml" and not KEYS.isdisjoint(read_toml(path, "modal table"))
    except ValueError:
        return False  # the campaign's reader says what is wrong with it
