"""Torque that repeats with the angle of a joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.effect import JointEffect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch
from rx90b_flex.effects.law_effect import LawEffect
from rx90b_flex.effects.motion import Array, Indices, JointMotion, Motion
from rx90b_flex.effects.parameters import Parameter, derived, shape

MOST_ORDERS = 2400  # that are looked at
HEARD = 0.25  # of the sample rate, up to which a period has samples enough
STANDS = 0.02  # of a joint's largest speed, below which it hardly moves
MOSTLY = 0.6  # of the time in motion in which an order is to be heard
GROUP = 16  # orders of a spectrum over the angle that are worked out together
TURNS_BYTES = 4e6  # of turns that are kept
AT_ONCE = 20_000  # samples whose turns are worked out at a time


def highest_peaks(power: Array, most: int) -> Indices:
    """Places of the highest local maxima, highest first."""
    beside = np.concatenate([[-np.inf], power, [-np.inf]])
    peaks = np.flatnonzero((power >= beside[:-2]) & (power > beside[2:]))
    return peaks[np.argsort(-power[peaks], kind="stable")][:most]


def _turned_back(one: Array, other: Array) -> NDArray[np.complex64]:
    """``exp(-i one other)`` of all pairs, to the digits that a peak takes to be found."""
    phase = np.outer(one, other).astype(np.float32)
    out = np.empty(phase.shape, dtype=np.complex64)
    out.real, out.imag = np.cos(phase), -np.sin(phase)
    return out


class SineEffect(JointEffect):
    """A sine of something with an amplitude and a phase, linear in ``amplitude * cos(phase)`` and ``amplitude * sin(phase)``."""

    amplitude: float | None
    phase: float | None

    @property
    def coefficient_parameters(self) -> dict[str, Parameter]:
        either = Parameter(self.parameters()["amplitude"].unit, "linear")
        return {"sine": either, "cosine": either}

    @property
    def coefficients(self) -> Array:
        amplitude, phase = (np.nan if x is None else x for x in (self.amplitude, self.phase))
        return np.array([amplitude * np.cos(phase), amplitude * np.sin(phase)])

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        sine, cosine = (float(x) for x in values)
        known = not np.isnan([sine, cosine]).any()
        amplitude, phase = (float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))) if known else (None, None)
        change: dict[str, Any] = {"amplitude": amplitude, "phase": phase}
        return dataclasses.replace(self, **change)


@dataclass(frozen=True, kw_only=True)
class PeriodicEffect(SineEffect, repeats=True, of_make=False):
    """Something periodic in the joint angle, ``amplitude * sin(order * q + phase)``, order cycles a joint turn."""

    PEAKS: ClassVar[int] = 10  # of the residual's spectrum over the angle, from which a search begins
    SHOWN: ClassVar[float] = 1.0  # periods that a joint's travel shows at the least
    HIGHEST_ORDER: ClassVar[float] = 1500.0  # of a motor's poles behind a large gear, or of a screw with a lead of 4 mm
    TEETH: ClassVar[float] = 240.0  # of a gear, which are looked for however slowly a log hears

    order: float | None = shape("1/turn", start=1.0, lower=0.5, upper=HIGHEST_ORDER)
    amplitude: float | None = derived("N m", lower=0.0)
    phase: float | None = derived("rad")

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """From the highest peaks of the residual's spectrum over the joint's angle, for each weight of the samples."""
        # two starts a lobe of the periodogram over the range that the joint covers
        low, high = self.parameters()["order"].lower, self._highest(motion)
        step = np.pi / max(self._range(motion), 1e-2)
        every = np.arange(max(low, 2 * step * self.SHOWN), high, max(step, (high - low) / MOST_ORDERS))
        orders, tried = every, max(1, len(every) // 2)
        if left is not None:
            every = every[every < self._highest(motion, left.cutoff_hz)]
            best = [highest_peaks(power, self.PEAKS) for power in self._spectra(every, left)]
            # a joint that never moves shows none
            orders = every[np.unique(np.concatenate(best))] if best else every[:0]
        return ShapeSearch(orders[:, None], tried, spread=np.array([0.5 * step]))

    def _highest(self, motion: Motion, cutoff_hz: float | None = None) -> float:
        """Highest order that is looked for: heard, through the low-pass and by samples, most of the time in which the joint moves."""
        at = motion.joint(self.joint)

        def make() -> tuple[Array, ...]:
            speed = np.abs(at.v)
            moving = speed[speed > STANDS * speed.max(initial=0.0)]
            usual = np.quantile(moving, MOSTLY) if len(moving) > 1 else np.inf
            return (np.array([usual, HEARD / np.median(np.diff(at.time)) if len(speed) > 1 else 0.0]),)

        ((speed, hz),) = motion.once(("usual speed", self.joint), make)
        hz = hz if cutoff_hz is None else min(cutoff_hz, hz)
        return float(np.clip(2.0 * np.pi * hz / speed, self.TEETH, self.HIGHEST_ORDER))

    def too_small(self, part: float, sample_s: float, motion: Motion) -> str:
        """A sine of which a joint shows less than a period may be any curve over its angle."""
        shown = self.shape[0] * self._range(motion) / (2.0 * np.pi)
        curve = f"the joint's range shows {shown:.2g} of a period, which any curve may have"
        return super().too_small(part, sample_s, motion) or (curve if shown < self.SHOWN else "")

    def weights(self, at: JointMotion) -> tuple[Array, ...]:
        """How its torque may grow and shrink along a motion, each (N,): the weights of the spectra that a search looks at."""
        return (np.ones_like(at.q),)

    def _spectra(self, orders: Array, left: LeftOver) -> list[Array]:
        """For each weight w: |sum w r exp(-i order q)|^2 over the sum of w^2, where the low-pass lets the order through."""
        if len(orders) == 0:
            return []
        fastest = np.inf if left.cutoff_hz is None else 2.0 * np.pi * left.cutoff_hz
        # orders are evenly spaced: those of a group turn on from its first by the same few steps, and are heard alike
        groups, steps = orders[::GROUP], orders[:GROUP] - orders[0]
        sums: list[Array] = []
        own: list[Array] = []
        for m, torque in left.residual:
            at = m.joint(self.joint, "drive")
            weights = self.weights(at)
            for some in (slice(i, i + AT_ONCE) for i in range(0, len(torque), AT_ONCE)):
                turned, onward, heard = self._turned(at, some, groups, steps, fastest)
                for i, w in enumerate(weights):
                    if i == len(sums):
                        sums.append(np.zeros((len(groups), len(steps)), dtype=complex))
                        own.append(np.full((len(groups), 1), 1e-300))
                    sums[i] = sums[i] + turned @ ((w * torque)[some, None].astype(np.float32) * onward)
                    own[i] = own[i] + (heard @ w[some] ** 2)[:, None]
        return [(np.abs(s) ** 2 / o).ravel()[: len(orders)] for s, o in zip(sums, own, strict=True)]

    def _turned(
        self, at: JointMotion, some: slice, groups: Array, steps: Array, fastest: float
    ) -> tuple[NDArray[Any], ...]:
        """``exp(-i order q)`` at some samples for the first order of each group, where it is heard, and onward by steps; and where.

        Of a short log it is worked out once: several types ask for the same.
        """

        def make() -> tuple[NDArray[Any], ...]:
            q, v = at.q[some], at.v[some]
            heard = np.outer(groups + 0.5 * steps[-1], np.abs(v)) < fastest
            return _turned_back(groups, q) * heard, _turned_back(q, steps), heard

        if 16 * len(at.q) * (len(groups) + len(steps)) > TURNS_BYTES or len(at.q) > AT_ONCE:
            return make()
        asked = (groups[0], groups[-1], steps[-1], fastest)
        return at.motion.once(("turns", self.joint, *(repr(float(x)) for x in asked)), make)

    def _range(self, motion: Motion) -> float:
        return float(np.ptp(motion.joint(self.joint).q))


@dataclass(frozen=True, kw_only=True)
class GearRipple(PeriodicEffect, LawEffect, part="spring"):
    """Torque periodic in the joint angle, ``amplitude * sin(order * q + phase)``, order cycles a joint turn.

    Signature
    ---------
    A sine of the joint's angle, of the same height at every speed; in time its frequency follows the speed.

    Neighbours
    ----------
    `line_interference` keeps its frequency in time. `transmission_error` and `resolver_error` grow with the square
    of the speed, since they bend the acceleration.

    Source
    ------
    Not in Hardeman 2008; meshing of teeth and cogging of motors.
    """

    law_stores: ClassVar[bool] = True

    def basis(self, at: JointMotion) -> Array:
        # as the law has it, without the slopes: a search over orders asks for it most
        (order,) = self.known_shape()
        return np.stack([np.sin(order * at.q), np.cos(order * at.q)], axis=1)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        sine, cosine, order = parameters[0], parameters[1], parameters[2]
        s, c = np.sin(order * x), np.cos(order * x)
        out[0] = sine * s + cosine * c
        out[1] = order * (sine * c - cosine * s)
        out[2] = 0.0

    def potential(self, motion: Motion) -> Array:
        (order,) = self.known_shape()
        angle = order * motion.joint(self.joint).q
        return np.stack([-np.cos(angle), np.sin(angle)], axis=1) @ self.known_coefficients() / order
