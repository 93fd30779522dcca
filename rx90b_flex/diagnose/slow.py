"""Whether what is left of held-out torques is slow: no noise of a torque is, and no law of the joint's motion need hold it.

At rest nothing holds it but dry friction: a controller that integrates lets a torque creep while nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from rx90b_flex.diagnose.moving import TorqueErrors
from rx90b_flex.effects.motion import Array, Mask

SLOW_HZ = 2.0  # below which noise has little of its power
PASSED = 0.25  # of the cutoff of a low-pass: of white noise no more than that share lies below
MOSTLY = 0.85  # of a joint's squared error below that frequency; of first-order noise with 0.1 s of memory it is 0.65
RESTS = 0.5  # of the squared error of all joints in which slow rests have to be said
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


@dataclass(frozen=True)
class SlowAtRest:
    """Joints whose torque creeps while they stand still, held out.

    Attributes
    ----------
    joints : tuple of str
    share : float
        Part of the squared error of all joints in those rests, 0 to 1.
    elsewhere : float
        2-norm of the torque error over the 2-norm of the torque, without them.
    """

    joints: tuple[str, ...]
    share: float
    elsewhere: float

    @property
    def words(self) -> str:
        """One caution."""
        return (
            f"{self.share:.0%} of the squared error held out lies where {', '.join(self.joints)} stand still, and is slow there: "
            "friction holds what a controller builds up, and which part of it follows from no motion. Elsewhere the relative error "
            f"is {self.elsewhere:.3g}."
        )


@dataclass(frozen=True, eq=False)
class ErrorsInTime:
    """Errors (N, joints) of all held-out recordings, from when joints first moved on, what of them is slow, and rows at rest."""

    joints: tuple[str, ...]
    torque: Array
    error: Array
    all_error: Array
    smooth: Array
    mean: Array
    still: Mask
    since: Mask
    hz: float

    @staticmethod
    def of(errors: TorqueErrors, cutoff_hz: float | None) -> ErrorsInTime:
        """From every held-out recording, with the cutoff of the low-pass that torques went through."""
        hz = SLOW_HZ if cutoff_hz is None else min(SLOW_HZ, PASSED * cutoff_hz)
        told = [np.where(there, left, 0.0) for there, left in zip(errors.since, errors.left, strict=True)]
        smooth, mean = [], []
        for rate, error in zip(errors.rates_hz, told, strict=True):
            passes = signal.butter(ORDER, min(hz, 0.45 * rate), fs=rate, output="sos")
            padding = min(len(error) - 1, int(rate / hz))
            smooth.append(signal.sosfiltfilt(passes, error, axis=0, padtype="even", padlen=padding))
            mean.append(np.broadcast_to(error.mean(axis=0), error.shape))
        torque, everywhere, error, slow, constant = (
            np.concatenate(x) for x in (errors.torque, errors.left, told, smooth, mean)
        )
        still, since = (np.concatenate(x) for x in (errors.still, errors.since))
        return ErrorsInTime(tuple(errors.joints), torque, error, everywhere, slow, constant, still, since, hz)

    def slow(self) -> tuple[Slow, ...]:
        """Joints whose error in motion is slow and large, one entry a joint."""
        moving = ~self.still & self.since
        share, constant = (self._share(x, moving) for x in (self.smooth, self.mean))
        each = zip(self.joints, share.tolist(), constant.tolist(), self._is_slow(moving), strict=True)
        return tuple(Slow(joint, self.hz, part, same) for joint, part, same, slow in each if slow)

    def at_rest(self) -> SlowAtRest | None:
        """Whether most of the error lies in rests, and is slow there."""
        resting = self.still & self.since
        creeps = self._is_slow(resting)
        there = resting & creeps
        squares, size = self.all_error**2, self.torque**2
        share = float(squares[there].sum() / max(squares.sum(), 1e-300))
        if share <= RESTS:
            return None
        elsewhere = float(np.sqrt(squares[~there].sum() / max(size[~there].sum(), 1e-300)))
        return SlowAtRest(tuple(j for j, slow in zip(self.joints, creeps, strict=True) if slow), share, elsewhere)

    def _share(self, part: Array, rows: Mask) -> Array:
        """Of the squared error in some rows, which a part of it makes up, shape (joints,)."""
        whole, own = ((x**2 * rows).sum(axis=0) for x in (self.error, part))
        return np.asarray(np.minimum(own / np.maximum(whole, 1e-300), 1.0))

    def _is_slow(self, rows: Mask) -> Mask:
        """Joints whose error in some rows is slow, and large, shape (joints,)."""
        rms = np.sqrt((self.error**2 * rows).sum(axis=0) / np.maximum(rows.sum(axis=0), 1))
        large = rms > LARGE * self.torque.std(axis=0)
        return np.asarray(large & (self._share(self.smooth, rows) > MOSTLY))
