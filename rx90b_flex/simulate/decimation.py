"""The anti-alias filter before the log, chunk by chunk."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy import signal

from rx90b_flex.compiled.signals import decimate
from rx90b_flex.effects.motion import Array
from rx90b_flex.simulate.cs8 import CS8

FILTER_ATTENUATION_DB = 80.0
FILTER_TRANSITION = 0.22  # of the anti-alias filter, over its cutoff: 80 to 100 Hz about 90


class _Band(NamedTuple):
    """A low-pass that is flat to one frequency and stops from another, before a signal of `rate_hz` is thinned out."""

    rate_hz: float
    factor: int
    passes_hz: float
    stops_hz: float

    def weights(self) -> Array:
        """Of a linear phase, by Kaiser's window, an odd number."""
        taps, beta = signal.kaiserord(FILTER_ATTENUATION_DB, (self.stops_hz - self.passes_hz) / (0.5 * self.rate_hz))
        middle = 0.5 * (self.passes_hz + self.stops_hz)
        return np.asarray(signal.firwin(2 * (taps // 2) + 1, middle, window=("kaiser", beta), fs=self.rate_hz))


def _bands(rate_hz: float, stride: int, cutoff_hz: float) -> list[list[_Band]]:
    """The ways to thin a signal out in one or two stages.

    The last one has its transition about the cutoff; one before it only keeps away what its own rate folds into that.
    """
    low, high = (1.0 - 0.5 * FILTER_TRANSITION) * cutoff_hz, (1.0 + 0.5 * FILTER_TRANSITION) * cutoff_hz
    ways = [[_Band(rate_hz, stride, low, high)]]
    for first in range(2, stride + 1):
        between = rate_hz / first
        if stride % first == 0 and between > 2.0 * high:
            ways.append([_Band(rate_hz, first, high, between - high), _Band(between, stride // first, low, high)])
    return ways


class _Stage:
    """A linear-phase filter whose output is thinned out, its delay taken out, fed chunk by chunk.

    The ends are continued by odd reflection, so that value and slope go on.
    """

    def __init__(self, weights: Array, factor: int, channels: int, longest: int) -> None:
        self.weights, self.factor, self.half = weights, factor, len(weights) // 2
        self.buffer = np.zeros((longest + len(weights) + self.half + factor, channels))
        self.filled = 0

    def inbox(self, samples: int) -> Array:
        """Where the next samples belong, (samples, channels): fill it, then `push`."""
        start = self.filled or self.half
        return self.buffer[start : start + samples]

    def push(self, samples: int, out: Array) -> int:
        """Filter what was put into the inbox; what is ready goes to `out` (N, channels). Returns the outputs' number."""
        if self.filled == 0:
            inbox = self.inbox(samples)
            ahead = np.minimum(np.arange(self.half, 0, -1), samples - 1)
            np.subtract(2.0 * inbox[0], inbox[ahead], out=self.buffer[: self.half])
            self.filled = self.half
        self.filled += samples
        ready = max(0, (self.filled - len(self.weights)) // self.factor + 1)
        decimate(self.buffer, self.weights, self.factor, out[:ready])
        used = ready * self.factor
        self.buffer[: self.filled - used] = self.buffer[used : self.filled].copy()
        self.filled -= used
        return ready

    def finish(self, out: Array) -> int:
        """What the last samples still owe."""
        behind = np.maximum(self.filled - 2 - np.arange(self.half), 0)
        np.subtract(2.0 * self.buffer[self.filled - 1], self.buffer[behind], out=self.inbox(self.half))
        return self.push(self.half, out)


class Decimator:
    """The anti-alias filter before the log, in the stages that take the fewest multiplications.

    Parameters
    ----------
    controller : CS8
    stride : int
        Samples an output.
    channels : int
    longest : int
        Most samples that are pushed at once.
    """

    def __init__(self, controller: CS8, stride: int, channels: int, longest: int) -> None:
        ways = []
        for bands in _bands(controller.controller_rate_hz, stride, controller.log_cutoff_hz):
            weights = [band.weights() for band in bands]
            rates = [band.rate_hz / band.factor for band in bands]
            ways.append((sum(len(w) * rate for w, rate in zip(weights, rates, strict=True)), bands, weights))
        _, bands, weights = min(ways, key=lambda way: way[0])
        self.stages = []
        for band, own in zip(bands, weights, strict=True):
            self.stages.append(_Stage(own, band.factor, channels, longest))
            longest = len(self.stages[-1].buffer) // band.factor + 1

    def inbox(self, samples: int) -> Array:
        """Where the next samples belong, (samples, channels): fill it, then `push`."""
        return self.stages[0].inbox(samples)

    def push(self, samples: int, out: Array) -> int:
        """Filter what was put into the inbox; what is ready goes to `out` (N, channels). Returns the outputs' number."""
        for stage, after in itertools.pairwise(self.stages):
            room = len(stage.buffer) // stage.factor + 1
            samples = stage.push(samples, after.inbox(room))
        return self.stages[-1].push(samples, out)

    def finish(self, out: Array) -> int:
        """What the last samples still owe."""
        done = 0
        for stage, after in itertools.pairwise(self.stages):
            room = len(stage.buffer) // stage.factor + 1
            done += after.push(stage.finish(after.inbox(room)), out[done:])
        return done + self.stages[-1].finish(out[done:])
