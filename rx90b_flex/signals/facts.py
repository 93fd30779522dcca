"""What a recording tells of its own motion: whether it repeats, and up to which frequency it goes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90b_flex.pieces import Array
from rx90b_flex.signals.filters import FEWEST_SAMPLES, noise_cutoff_hz
from rx90b_flex.signals.recording import Recording

MOTION_POWER = 0.999  # of the velocity's power that a cutoff found in the data keeps
ENOUGH = 200_000  # samples that tell a recording's noise: spectra of an hour take memory
WANDERS = 4.0  # standard deviations of the sum of noise within which nothing is motion
OVER_MOTION = 4.0  # that cutoff over the frequency below which so much of the power lies
LOWEST_HZ = 1.0
PRINTED = 1e3  # steps of a grid that a joint usually moves by from sample to sample: finer is no sensor's
SHORTEST_PERIOD_S = 0.5
MUCH_THE_SAME = 0.02  # the same, up to which a stated period is one: a robot's drives and its wear are no other motion
REPEATS = 2e-5  # squared difference of a motion to itself a period later, over twice its variance


def sensible_cutoff_hz(recordings: Sequence[Recording]) -> float:
    """A low-pass that keeps the motion and leaves out what lies far above it, Hz.

    Four times the frequency below which 99.9 % of the velocity's power lies, over all moving joints, or `quiet_cutoff_hz` where
    that is lower; between 1 Hz and a fifth of the sample rate.
    """
    found = [_highest_hz(np.diff(position), r.sample_rate_hz) for r in recordings for position in r.position.T]
    rate = min(r.sample_rate_hz for r in recordings)
    kept = min(OVER_MOTION * max(LOWEST_HZ, *found), quiet_cutoff_hz(recordings))
    return float(np.clip(kept, LOWEST_HZ, 0.2 * rate))


def quiet_cutoff_hz(recordings: Sequence[Recording]) -> float:
    """The low-pass above which noise of the positions, counters' or of uneven sampling, outweighs the acceleration, Hz; or inf.

    Of the recording that moves fastest: one that hardly moves has little else than noise.
    """
    long = [r for r in recordings if r.samples >= FEWEST_SAMPLES]
    found = [noise_cutoff_hz(r.position[:ENOUGH], r.sample_rate_hz) or np.inf for r in long]
    return max(LOWEST_HZ, *found) if found else np.inf


def _highest_hz(speed: Array, rate: float) -> float:
    """Frequency below which nearly all of a velocity's power lies, (N,)."""
    power = np.abs(np.fft.rfft((speed - speed.mean()) * np.hanning(len(speed)))) ** 2
    hz = np.fft.rfftfreq(len(speed), 1.0 / rate)
    # white noise of the position counter has this shape in its differences; sums of what is left of it wander
    shape = np.sin(np.pi * hz / rate) ** 2
    noise = shape * np.median(power[len(hz) // 2 :] / shape[len(hz) // 2 :]) / np.log(2.0)
    below = np.cumsum(power - noise)
    wander = WANDERS * np.sqrt(np.sum(noise**2))
    reached = int(np.argmax(below >= min(MOTION_POWER * below[-1], below[-1] - wander)))
    return float(hz[reached])


def found_period_s(recording: Recording) -> float | None:
    """Period of a motion that repeats at least twice, a whole number of samples, s; None where it does not."""
    q = recording.position - recording.position.mean(axis=0)
    n, rate = len(q), recording.sample_rate_hz
    power = (q**2).sum(axis=1)
    if not power.any():
        return None
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    spectrum = np.sum([np.abs(np.fft.rfft(x, size)) ** 2 for x in q.T], axis=0)
    product = np.fft.irfft(spectrum, size)[: n // 2 + 1]
    square = np.concatenate([[0.0], np.cumsum(power)])
    lags = np.arange(n // 2 + 1)
    squares = (square[n] - square[lags]) + square[n - lags]
    unlike = np.maximum(squares - 2 * product, 0.0) / np.maximum(squares, 1e-300)
    first = max(2, round(SHORTEST_PERIOD_S * rate))
    # the start of every curve is alike: a period comes after a time at which the motion was somewhere else
    elsewhere = np.flatnonzero(unlike > 0.1)
    first = max(first, int(elsewhere[0]) if len(elsewhere) else len(unlike))
    edges = first + np.flatnonzero(np.diff(unlike[first:] < REPEATS, prepend=False, append=False))
    if len(edges) == 0:
        return None
    begin, end = edges[:2]
    return float((begin + np.argmin(unlike[begin:end])) / rate)


def repeats(recording: Recording, period_s: float) -> bool:
    """Whether the motion is much the same a period later; also where the recording holds no two of them."""
    lag = round(period_s * recording.sample_rate_hz)
    if lag < 1 or recording.samples < 2 * lag:
        return True
    q = recording.position - recording.position.mean(axis=0)
    change = ((q[lag:] - q[:-lag]) ** 2).sum()
    return bool(change <= 2.0 * MUCH_THE_SAME * ((q[lag:] ** 2).sum() + (q[:-lag] ** 2).sum()))


def counter_steps(position: Array) -> Array:
    """Grid that each joint's positions (N, joints) lie on, rad; zero where there is none, shape (joints,)."""
    return np.array([_step(column) for column in position.T])


def _step(column: Array) -> float:
    steps = np.abs(np.diff(column))
    steps = steps[steps > 1e-12]
    if len(steps) == 0:
        return 0.0
    step = float(steps.min())
    multiples = steps / step
    if np.median(multiples) > PRINTED:
        return 0.0  # the last digit of the print, no counter
    near = np.abs(multiples - np.round(multiples)) < 0.02 * np.maximum(multiples, 1.0) ** 0.5
    return step if np.mean(near) > 0.98 else 0.0
