"""Times of a log's samples, as exact as they are printed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rx90b_flex.pieces import Array
from rx90b_flex.signals.data_fault import DataFault, DataFaultError
from rx90b_flex.signals.units import words_of

JITTERING = 0.1  # of the steps off the usual one: more than lost samples make
_SECONDS, _NANOSECONDS = {"sec", "secs"}, {"nsec", "nsecs", "nanosec", "nanosecs"}


def seconds_and_nanoseconds(names: Sequence[str]) -> tuple[str, str] | None:
    """Columns that hold one time in two parts, as ROS writes stamps; None where there are none."""
    seen = {name: words_of(name) for name in names}
    for name, words in seen.items():
        if words and words[-1] in _SECONDS:
            for other, others in seen.items():
                if others[:-1] == words[:-1] and others[-1:] and others[-1] in _NANOSECONDS:
                    return name, other
    return None


def printed_resolution(time: Array, single_precision: bool) -> Array:
    """(N,) s: by how much each time may differ from the true one because of the digits it was logged with.

    The step of the last decimal, or of the last significant digit, that the column as a whole uses, whichever is
    coarser: logs print with a fixed number of either.
    """
    representation = 4.0 * np.spacing(np.abs(time))
    # zero shows no digits: as small as the smallest other time
    sizes = np.abs(time)
    smallest = float(np.min(sizes[sizes > 0.0], initial=1.0))
    magnitude = np.floor(np.log10(np.maximum(sizes, smallest) * (1.0 + 1e-15)))

    def fits(step: Array) -> bool:
        return bool(np.all(np.abs(np.round(time / step) * step - time) <= representation))

    decimals = next((10.0**-d for d in range(16) if fits(np.full_like(time, 10.0**-d))), 0.0)
    digits = next((d for d in range(1, 17) if fits(10.0 ** (magnitude + 1.0 - d))), 17)
    resolution = np.maximum(np.maximum(10.0 ** (magnitude + 1.0 - digits), decimals), representation)
    single = sizes.astype(np.float32)
    if single_precision or digits <= 9 or np.array_equal(single, sizes):
        # nine digits or fewer hold what 32-bit floats hold, so the clock may have been one
        resolution = np.maximum(resolution, np.spacing(single).astype(np.float64))
    return np.asarray(resolution)


def check_increasing(file: Path, time: Array, rate: float, resolution: Array) -> None:
    """Refuse times that do not grow, as far as their print tells."""
    steps = np.diff(time)
    # equal times are only a matter of print where the print is coarser than the sample period
    coarse = np.maximum(resolution[1:], resolution[:-1]) > 1.01 / rate
    bad = (steps < 0.0) | ((steps == 0.0) & ~coarse)
    if np.any(bad):
        row = int(np.argmax(bad)) + 1
        raise ValueError(
            f"{file}: column 'time', row {row + 1}: {time[row]:.10g} s after {time[row - 1]:.10g} s;"
            f" increasing times are expected"
        )


def check_uniform(file: Path, time: Array, rate: float, resolution: Array, first: int) -> None:
    """Times must step by 1/rate to 1 %, apart from the rounding of their print."""
    period = 1.0 / rate
    steps = np.diff(time)
    rounding = np.maximum(resolution[1:], resolution[:-1])
    fine = bool(np.max(rounding) <= 0.6 * period)
    typical = float(np.median(steps)) if fine else float(np.mean(steps))
    # lost samples leave the median as it is, stamps that come early and late the mean
    jitter = fine and float((np.abs(steps - typical) > 0.01 * period + rounding).mean()) > JITTERING
    typical = float(np.mean(steps)) if jitter else typical
    if fine:
        contradicts = abs(typical - period) > 0.01 * period + float(np.median(rounding))
    else:
        contradicts = abs(typical - period) > 0.05 * period + float(np.max(rounding)) / len(steps)
    if contradicts:
        found = f"steps of {typical:.6g} s ({1.0 / typical:.6g} Hz)" if typical > 0.0 else "times that never change"
        message = f"{file}: column 'time': {found} contradict sample_rate_hz = {rate:g} ({period:.6g} s)"
        raise DataFaultError(
            DataFault("sample_rate", None, (), message, factor=float(f"{rate * typical:.12g}") or None)
        )
    if jitter:
        message = (
            f"{file}: column 'time': steps of {steps.min():.3g} to {steps.max():.3g} s at {1.0 / typical:.4g} Hz on average, the "
            "time stamps jitter: leave the column out if sampling was even; else bring samples to even times (`rx90b-flex import`)"
        )
        raise DataFaultError(DataFault("sample_rate", None, (), message))
    if fine:
        bad = np.abs(steps - period) > 0.01 * period + rounding
    else:
        # Steps of such a print say nothing singly. All deviations from the grid must fit in one rounding interval;
        # a lost sample shifts them by a period, which is more.
        deviation = time - time[0] - np.arange(len(time)) * period
        spread = np.maximum.accumulate(deviation) - np.minimum.accumulate(deviation)
        widest = np.maximum.accumulate(resolution)
        bad = (spread > np.minimum(0.01 * period + widest, 0.999 * np.maximum(widest, period)))[1:]
    if np.any(bad):
        row = int(np.argmax(bad)) + 1
        raise ValueError(
            f"{file}: column 'time', row {first + row + 1}: a step of {steps[row - 1]:.6g} s, {period:.6g} s is"
            f" expected: samples must be uniform in time; cut the log there, or bring it to one rate with import"
        )
    mean = float(time[-1] - time[0]) / len(steps)
    if abs(mean - period) > 1e-3 * period + float(np.max(rounding)) / len(steps):
        raise ValueError(
            f"{file}: column 'time': {len(steps)} steps of {mean:.8g} s on average ({1.0 / mean:.8g} Hz) contradict"
            f" sample_rate_hz = {rate:g}"
        )
