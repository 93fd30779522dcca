"""Lines of a clock among those of a motion that repeats."""

from __future__ import annotations

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.regression import Regression

BESIDE = 6  # harmonics of a repeating motion on either side of a line that it is compared with
STANDS_OUT = 20.0  # over their median: that of noise, or of what a model lacks, exceeds it once in a million


def follows_motion(regression: Regression, residual: Array, hz: float) -> bool:
    """Whether a line sits among the harmonics of a motion that repeats, and does not stand out of those beside it.

    What the model lacks repeats with the motion, so it has all of these harmonics; a clock of its own has one line.
    Near the motion's own frequencies no data of that motion can tell one from the other.

    Parameters
    ----------
    regression : Regression
    residual : array, (joints, N)
        Of some of its joints, N m.
    hz : float
        Of the line.
    """
    for segment, span in zip(regression.segments, regression.spans, strict=True):
        period = segment.recording.period_s
        if period is None:
            continue
        harmonics = round(hz * period) + np.arange(-BESIDE, BESIDE + 1)
        harmonics = harmonics[(harmonics > 0) & (harmonics != round(hz * period))]
        lines = np.append(harmonics / period, hz)
        tapered = residual[:, span] * np.hanning(len(segment.time))
        power = np.array([(np.abs(tapered @ np.exp(-2j * np.pi * f * segment.time)) ** 2).sum() for f in lines])
        if power[-1] < STANDS_OUT * np.median(power[:-1]):
            return True
    return False
