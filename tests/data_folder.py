"""Where measured data lies that the package does not carry."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import pytest

from rx90b_flex.signals import Campaign, load_campaign

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


def kr300_without(held_out: str) -> Campaign:
    """The KR300's campaign with that recording (A, B or C) held out and the others fitted."""
    campaign = load_campaign(data_folder("kr300_encoders") / "campaign.toml")
    roles = {True: "validation", False: "identification"}
    recordings = tuple(dataclasses.replace(r, role=roles[r.name == held_out]) for r in campaign.recordings)
    return dataclasses.replace(campaign, recordings=recordings)
