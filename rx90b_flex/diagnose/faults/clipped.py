"""Torques that are cut off at a largest value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rx90b_flex.diagnose.faults.coarse import Coarse
from rx90b_flex.effects.motion import Array
from rx90b_flex.signals import Recording
from rx90b_flex.signals.data_fault import DataFault

SHARE = 0.003  # of the samples at one end of the range, from which on a fit is led astray
RUN = 3  # samples behind one another
NEXT = 0.01  # of the range below the largest value: where a peak that is not cut off has as many samples
OVER_NEXT = 3.0
LEVELS = (
    4.0  # values of a grid that lie so near below: with fewer, a peak that is not cut off has as many at its largest
)


def clipped(recordings: Sequence[Recording], coarse: Coarse | None = None) -> Iterator[DataFault]:
    """Joints whose largest or smallest torque comes again and again, while values just below it are rare; of torques in coarse steps,
    where the motion also asks for more.
    """
    for k, joint in enumerate(recordings[0].joints):
        torque = [r.torque[:, k] for r in recordings]
        ends = [(sign, _share(torque, sign)) for sign in (1.0, -1.0)]
        if coarse is not None and coarse.steps[k] > NEXT / LEVELS * max(float(np.ptp(t)) for t in torque):
            ends = [(sign, share) for sign, share in ends if share > SHARE and not coarse.may_end(k, sign)]
        cut = [(sign, share) for sign, share in ends if share > SHARE]
        if cut:
            at = " and ".join(f"{sign * max((sign * t).max() for t in torque):.4g}" for sign, _ in cut)
            share = sum(share for _, share in cut)
            yield DataFault(
                "clipped",
                "torque",
                (joint,),
                f"The torque of {joint} is cut off at {at} N m in {100 * share:.2g} % of the samples: log a wider range, move "
                "more slowly, or leave these parts out (start_s, end_s).",
            )


def _share(torque: Sequence[Array], sign: float) -> float:
    """Part of the samples that lies at the upper end (of the negative, with -1), where it is cut off; else 0."""
    x = np.concatenate([sign * t for t in torque])
    top, spread = float(x.max()), float(np.ptp(x))
    if spread <= 0.0 or top == 0.0 or len(x) < RUN:
        return 0.0
    at = x >= top - 1e-6 * spread
    below = (x >= top - NEXT * spread) & ~at
    runs = np.lib.stride_tricks.sliding_window_view(at, RUN).all(axis=1)
    return float(at.mean()) if at.sum() > OVER_NEXT * below.sum() and runs.any() else 0.0
