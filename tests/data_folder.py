"""Where measured data lies that the package does not carry."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

VARIABLE = "RX90B_FLEX_DATA"


def data_folder(name: str) -> Path:
    """Folder of a robot's recordings: in `$RX90B_FLEX_DATA`, else in `shared/data` beside the repository; or skip."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get(VARIABLE, beside)) / name
    if not (folder / "campaign.toml").is_file():
        pytest.skip(f"no recordings in {folder}; set {VARIABLE} to the folder that holds {name}/")
    return folder


def tx40_folder() -> Path:
    """Folder of the TX40 recording, or skip."""
    return data_folder("tx40")
