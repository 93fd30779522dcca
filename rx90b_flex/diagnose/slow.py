"""Whether what is left of held-out torques is slow: no noise of a torque is, and no law of the joint's motion need hold it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from rx90b_flex.diagnose.moving import begun, resting_each
from rx90b_flex.effects.motion import Array

SLOW_HZ = 2.0  # below which noise has little of its power
PASSED = 0.25  # of the cutoff of a low-pass: of white noise no more than that share lies below
MOSTLY = 0.85  # of a joint's squared error in motion below that frequency; of first-order noise with 0.1 s of memory it is 0.65
LARGE = 0.05  # of the torque's standard deviation: what is smaller may be a sensor's drift
CONSTANT = 0.7  # of the squared error that each recording's mean takes off
ORDER = 4  # of the low-pass that parts slow from fast


@dataclass(frozen=True)
class Slow:
    """A joint whose torque error is slow, held out.

    Attributes
    ----------
    joint : str
    hz : float
        Frequency below which it lies.
    share : float
        Part of its squared error in motion there, 0 to 1.
    constant : float
        Part of it that the means of the recordings make up, 0 to 1.
    """

    joint: str
    hz: float
    share: float
    constant: float

    @property
    def words(self) -> str:
        """One caution."""
        said = f"{self.share:.0%} of the squared error that {self.joint} keeps in motion, held out, lies below {self.hz:g} Hz"
        if self.constant > CONSTANT:
            return (
                f"{said}, most of it as a constant of each recording: noise is not so slow. An offset that differs between "
                "recordings (a sensor's zero, another load, another temperature) looks so."
            )
        return (
            f"{said}: noise is not so slow. An offset that drifts with time, a base that moves or a force that no log holds looks "
            "so."
        )


def slow_errors(
    joints: Sequence[str],
    rates_hz: Sequence[float],
    cutoff_hz: float | None,
    torque: Sequence[Array],
    left: Sequence[Array],
    velocity: Sequence[Array],
) -> tuple[Slow, ...]:
    """Joints whose error is slow and large, one entry a joint.

    Parameters
    ----------
    joints : sequence of str
        Of the columns.
    rates_hz : sequence of float
        Sample rates.
    cutoff_hz : float or None
        Of the low-pass that torques went through.
    torque, left, velocity : sequence of arrays, each (N, joints)
        Torque and its error, N m (N), and velocity, rad/s (m/s), of every held-out recording.
    """
    hz = SLOW_HZ if cutoff_hz is None else min(SLOW_HZ, PASSED * cutoff_hz)
    rest = resting_each(velocity)
    since = [begun(still, rate) for still, rate in zip(rest, rates_hz, strict=True)]
    left = [np.where(there, error, 0.0) for there, error in zip(since, left, strict=True)]
    moving = ~np.concatenate(rest) & np.concatenate(since)
    smooth, mean = [], []
    for rate, error in zip(rates_hz, left, strict=True):
        passes = signal.butter(ORDER, min(hz, 0.45 * rate), fs=rate, output="sos")
        padding = min(len(error) - 1, int(rate / hz))
        smooth.append(signal.sosfiltfilt(passes, error, axis=0, padtype="even", padlen=padding))
        mean.append(np.broadcast_to(error.mean(axis=0), error.shape))

    def squares(some: Sequence[Array]) -> Array:
        return np.asarray((np.concatenate(some) ** 2 * moving).sum(axis=0))

    whole, spread = squares(left), np.concatenate(torque).std(axis=0)
    large = np.sqrt(whole / np.maximum(moving.sum(axis=0), 1)) > LARGE * spread
    share, constant = (squares(x) / np.maximum(whole, 1e-300) for x in (smooth, mean))
    return tuple(
        Slow(joint, hz, min(float(share[j]), 1.0), float(constant[j]))
        for j, joint in enumerate(joints)
        if large[j] and share[j] > MOSTLY
    )
