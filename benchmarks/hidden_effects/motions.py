"""Motions of the study: harmonics of one period, some with rests, as functions of time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from independent import Array, Motion

SPEED, RANGE = 0.7, 0.8  # of the joint's limits, at most
LINES = 8
REST_S, RAMP_S = 0.8, 0.4  # a rest, and how long it takes to come to it


@dataclass(frozen=True, eq=False)
class Experiment:
    """Random harmonics of every joint; at `rests` (fractions of the period) the whole arm stands still for a while."""

    size: Array
    phase: Array
    centre: Array
    period_s: float
    rests: tuple[float, ...] = ()

    @staticmethod
    def draw(rng: np.random.Generator, model: pin.Model, period_s: float, rests: bool) -> Experiment:
        """Every joint moves as fast and as far as its limits allow, one of the two at the edge."""
        n = model.nv
        omega = 2 * np.pi / period_s * np.arange(1, LINES + 1)
        size = rng.uniform(0.5, 1.0, (LINES, n)) / np.sqrt(omega)[:, None]
        phase = rng.uniform(0, 2 * np.pi, (LINES, n))
        pauses = (0.15 + 0.1 * float(rng.random()), 0.6 + 0.2 * float(rng.random())) if rests else ()
        run = Experiment(size, phase, np.zeros(n), period_s, pauses)
        m = run.motion(np.arange(0.0, period_s, 0.01))
        low, high = model.lowerPositionLimit, model.upperPositionLimit
        half = 0.5 * np.minimum(high - low, 2 * np.pi)
        middle = np.clip(0.5 * (high + low), -np.pi, np.pi)
        reach = np.abs(m.q).max(axis=0)
        scale = np.minimum(SPEED * model.velocityLimit / np.abs(m.v).max(axis=0), RANGE * half / reach)
        room = RANGE * half - scale * reach
        return replace(run, size=run.size * scale, centre=middle + rng.uniform(-1.0, 1.0, n) * room)

    @cached_property
    def _clock(self) -> tuple[Array, Array, Array]:
        """Time along the harmonics and its first derivative, tabled over a period (time, along, rate)."""
        time = np.linspace(0.0, self.period_s, 20_001)
        rate = np.ones_like(time)
        for at in self.rests:
            off = np.abs(time - at * self.period_s) - 0.5 * REST_S
            rate *= np.where(off <= 0, 0.0, np.where(off >= RAMP_S, 1.0, _step(off / RAMP_S)))
        along = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * (time[1] - time[0])
        factor = self.period_s / along[-1]
        return time, along * factor, rate * factor

    def _along(self, time: Array) -> tuple[Array, Array, Array]:
        """Time along the harmonics and its first two derivatives."""
        if not self.rests:
            return time, np.ones_like(time), np.zeros_like(time)
        table, along, rate = self._clock
        turns, here = np.divmod(time, self.period_s)
        second = np.gradient(rate, table)
        s = turns * self.period_s + np.interp(here, table, along)
        return s, np.interp(here, table, rate), np.interp(here, table, second)

    def motion(self, time: Array) -> Motion:
        """At the given times, (N,)."""
        s, rate, bend = (x[:, None] for x in self._along(time))
        w = 2 * np.pi / self.period_s * np.arange(1, LINES + 1)[:, None]
        angle = w * s[:, :, None] + self.phase
        q = (self.size / w * np.sin(angle)).sum(axis=1)
        v = (self.size * np.cos(angle)).sum(axis=1)
        a = (-self.size * w * np.sin(angle)).sum(axis=1)
        return Motion(time, q + self.centre, v * rate, a * rate**2 + v * bend)


def _step(x: Array) -> Array:
    """From 0 to 1 with a slope that vanishes at either end, as robots stop."""
    return np.asarray(x**2 * (3.0 - 2.0 * x))


def spectral(x: Array, period_s: float, order: int = 1) -> Array:
    """Derivative of one period of a periodic signal, (N, ...), by its Fourier series."""
    lines = np.fft.rfftfreq(len(x), period_s / len(x))
    factor = (2j * np.pi * lines) ** order
    return np.asarray(np.fft.irfft(np.fft.rfft(x, axis=0) * factor.reshape(-1, *[1] * (x.ndim - 1)), len(x), axis=0))
