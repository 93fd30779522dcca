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
LEVEL = 1.5  # steps of a coarse torque: below its largest value comes one other
OVER_NEXT = 3.0


def clipped(recordings: Sequence[Recording], coarse: Coarse | None = None) -> Iterator[DataFault]:
    """Joints whose largest or smallest torque comes again and again, while values just below it are rare; of torques in coarse steps,
    where the motion also asks for more.
    """
    for k, joint in enumerate(recordings[0].joints):
        torque = [r.torque[:, k] for r in recordings]
        ends = [(sign, _share(torque, sign)) for sign in (1.0, -1.0)]
        step = 0.0 if coarse is None else float(coarse.steps[k])
        if coarse is not None and step > NEXT * max(float(np.ptp(t)) for t in torque):
            # within a hundredth of the range there is no other value, cut off or not
            ends = [(sign, _share(torque, sign, step)) for sign, share in ends if share > SHARE]
            ends = [(sign, share) for sign, share in ends if not coarse.may_end(k, sign)]
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


def _share(torque: Sequence[Array], sign: float, step: float = 0.0) -> float:
    """Part of the samples that lies at the upper end (of the negative, with -1), where it is cut off; else 0. Of a torque in steps,
    where it may be.
    """
    x = np.concatenate([sign * t for t in torque])
    top, spread = float(x.max()), float(np.ptp(x))
    if spread <= 0.0 or top == 0.0 or len(x) < RUN:
        return 0.0
    at = x >= top - 1e-6 * spread
    below = (x >= top - max(NEXT * spread, LEVEL * step)) & ~at
    runs = np.lib.stride_tricks.sliding_window_view(at, RUN).all(axis=1)
    return float(at.mean()) if at.sum() > OVER_NEXT * below.sum() and runs.any() else 0.0
