"""Whether a log without a low-pass is better fitted behind one: how far in frequency torques follow a model at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from rx90b_flex.effects.motion import Array

SPAN_S = 1.0  # of the parts whose spectra are averaged: bands from 1 Hz on
FEWEST_PARTS = 8  # of a recording, where it is shorter than so many spans
BAND = 1.3  # upper over lower edge of a band
FOLLOWS = 0.9  # of a band's power that a model may leave where a torque follows it
LARGE = 0.3  # of the squared error: so much beyond the last band that follows is worth a word


@dataclass(frozen=True)
class BeyondModel:
    """Above so many Hz no joint's torque follows the model, and this part of its squared error lies there."""

    hz: float
    part: float

    @property
    def words(self) -> str:
        """As a caution."""
        hz = f"{float(f'{self.hz:.2g}'):g}"
        return (
            f"No low-pass is stated, and {self.part:.0%} of the squared error on the fitted recordings lies above {hz} Hz, "
            "where no joint's torque follows the model: what is noise there hides what is missing below, and noise of the angles "
            "bends the fit. "
            f"[preprocessing] cutoff_hz = {hz}, or less, may tell more."
        )


def beyond_model(torque: Sequence[Array], predicted: Sequence[Array], rates: Sequence[float]) -> BeyondModel | None:
    """Where the band ends in which a model of logs without a low-pass says anything; None if little is left beyond.

    Parameters
    ----------
    torque, predicted : sequences of arrays (N, joints)
        One a recording, N m.
    rates : sequence of float
        Hz.
    """
    last, squares = 0.0, []
    for tau, model, rate in zip(torque, predicted, rates, strict=True):
        length = int(min(SPAN_S * rate, len(tau) / FEWEST_PARTS))
        if length < 2 * FEWEST_PARTS:
            return None
        hz, whole = signal.welch(tau, rate, nperseg=length, axis=0)
        _, left = signal.welch(tau - model, rate, nperseg=length, axis=0)
        edges = np.geomspace(hz[1], hz[-1], 2 + int(np.log(hz[-1] / hz[1]) / np.log(BAND)))
        bands = [b for b in np.split(np.arange(len(hz)), np.searchsorted(hz, edges)) if len(b)]
        following = [b for b in bands if (left[b].sum(axis=0) < FOLLOWS * whole[b].sum(axis=0)).any()]
        last = max(last, float(hz[following[-1][-1]]) if following else 0.0)
        squares.append((hz, left.sum(axis=1) * (hz[1] - hz[0]) * len(tau)))
    beyond = sum(float(power[hz > last].sum()) for hz, power in squares)
    every = sum(float(power.sum()) for _, power in squares)
    found = BeyondModel(last, beyond / every if every > 0.0 else 0.0)
    return found if last > 0.0 and found.part > LARGE else None
