"""The sign of a velocity, smooth at reversal (equation 3.54)."""

from __future__ import annotations

import numpy as np

from rx90b_flex.effects.motion import Array

# 1/c_a of equation 3.54. The source asks for a c_a that is "sufficiently high" and prints none: at 1 mrad/s
# the sign is 99 % complete at 64 mrad/s, well inside the speeds of an identification experiment, and still
# smooth enough for an implicit integrator at 4 kHz.
REVERSAL_VELOCITY = 1.0e-3


def reversal(v: Array) -> Array:
    """(2/pi) atan(v/v_0): the smoothed sign of v."""
    return (2.0 / np.pi) * np.arctan(v / REVERSAL_VELOCITY)


def reversal_slope(v: Array) -> Array:
    """Derivative of `reversal` by v, s/rad."""
    return (2.0 / np.pi) * REVERSAL_VELOCITY / (REVERSAL_VELOCITY**2 + v**2)
