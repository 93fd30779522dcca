"""What excites a robot: multisines, input matrices, the reference that keeps joints from reversing."""

from rx90b_flex.excitation.harmonics import harmonic_motion
from rx90b_flex.excitation.input_matrix import hadamard, identity, minus_below_first, scaled
from rx90b_flex.excitation.multisine import (
    crest_factor,
    lines_in_band,
    lower_crest,
    multisine,
    odd_lines,
    smoothed_square,
    whitening,
)

__all__ = [
    "crest_factor",
    "hadamard",
    "harmonic_motion",
    "identity",
    "lines_in_band",
    "lower_crest",
    "minus_below_first",
    "multisine",
    "odd_lines",
    "scaled",
    "smoothed_square",
    "whitening",
]
