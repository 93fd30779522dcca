"""From files to sampled signals: campaign files and recordings, and filters on uniform samples."""

from rx90b_flex.signals.filters import (
    Motion,
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
from rx90b_flex.signals.recording import Campaign, Recording, load_campaign, save_recording, write_campaign

__all__ = [
    "Campaign",
    "Motion",
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
