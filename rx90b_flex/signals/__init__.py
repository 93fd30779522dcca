"""From files to sampled signals: campaign files and recordings, and filters on uniform samples."""

from typing import TYPE_CHECKING

from rx90b_flex.on_demand import names_of
from rx90b_flex.signals.recording import Campaign, Recording, load_campaign, save_recording, write_campaign

if TYPE_CHECKING:
    from rx90b_flex.signals.filters import (
        FilteredMotion,
        decimation_factor,
        difference_weights,
        differentiate,
        lowpass,
        minimum_samples,
        motion,
        noise_cutoff_hz,
        periods,
        resample,
    )

__all__ = [
    "Campaign",
    "FilteredMotion",
    "Recording",
    "decimation_factor",
    "difference_weights",
    "differentiate",
    "load_campaign",
    "lowpass",
    "minimum_samples",
    "motion",
    "noise_cutoff_hz",
    "periods",
    "resample",
    "save_recording",
    "write_campaign",
]

# on demand: who reads a file waits for no filters
__getattr__ = names_of(__name__)
