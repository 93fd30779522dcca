"""What a grey box is fitted to, pose by pose, and what the user may choose of the fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.accelerometers import AccelerationResponse
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse
from rx90b_flex.identify.grey_model import DELAY_STD, poses_along

SMOOTHED = 8  # degrees of freedom that a line's covariance is given by its neighbours, per entry of the response
OWN = 3.0  # a line whose variance exceeds its neighbours' mean by this keeps its own: an interfering line
# Of |P|, what separates the response of a moving robot from the model after all that is averaged: with viscous friction, 0.3 % at the
# drive points and up to 1.2 % elsewhere (RMS over the lines of section 6.6.2's campaign).
MODEL_ERROR = 0.005
# Of a friction slope, what separates friction with reversals from a viscous one: it locks a joint for a part of the time.
FRICTION_ERROR = 0.5
REACH_HZ = 5.0  # over which these errors stay alike
Feedback = Callable[[Array], ComplexArray]


@dataclass(frozen=True)
class GreyBoxOptions:
    """What the user may choose of a grey box.

    Attributes
    ----------
    band_hz : (low, high)
        Lines used.
    starts, seed : int
        Starts beside the declared values, drawn about these.
    link_mass_std : float
        Relative standard deviation to which the links' masses are known; then one factor a link is fitted too. 0: known exactly.
    bending_alike_std : float
        Relative standard deviation to which a joint is known to be equally stiff (and damped) about both its bending axes, up to
        their declared ratio: bearings are round. One pose may not tell joints apart that bend about the same axis. 0: not known.
    delay_std : float
        Standard deviation, s, to which torques are known to be logged at the instants of angles: by that much they may be late, or
        early, and how much is estimated (`GreyBox.torque_delay`). 0: logged together.
    hinge_std : float, or mapping of joint to float
        Standard deviation, m, to which it is known along each axis where a joint's hinges lie on their links; of all joints that
        bend, or of those named. The places are estimated (`GreyBox.hinges`); what is not known of them is part of all intervals.
        0: known.
    fixed : names of parameters that keep their declared values
    model_error, friction_error : float or None
        Bias that is left, as random functions of frequency that stay alike over `REACH_HZ`: of each entry, over its magnitude, and of
        each friction slope in each column, over the slope. It weighs the lines and widens the intervals. 0: the model is exact. None:
        estimated from what the fit cannot explain, by restricted maximum likelihood. That sees no bias which parameters can take
        up: with dry friction its intervals are too short, and those of the stated default are not.
    """

    band_hz: tuple[float, float] = (8.0, 80.0)
    starts: int = 16
    seed: int = 0
    link_mass_std: float = 0.0
    bending_alike_std: float = 0.0
    delay_std: float = DELAY_STD
    hinge_std: float | Mapping[str, float] = 0.0
    fixed: tuple[str, ...] = ()
    model_error: float | None = MODEL_ERROR
    friction_error: float | None = FRICTION_ERROR


@dataclass(frozen=True, eq=False)
class PoseResponse:
    """A frequency response at a pose, and how it was measured. F lines, n joints.

    Attributes
    ----------
    response : FrequencyResponse
        It knows its pose.
    along : array, shape (S, joints of the robot), rad, optional
        Poses that the motion passes (`poses_along`), alike in time: the model is averaged over them. Otherwise the pose alone.
    torques : complex array, shape (F, n, experiments), optional
        Of the experiments at one phase realisation. Friction with reversals is steeper where a joint vibrates less, and so differs
        between experiments; with their torques each has its own slopes (``joint_3.friction_slope_2``), if all poses have as many.
    feedback : callable, optional
        Feedback torque against drive acceleration, (F, n, n), as a function of frequencies in Hz. With it the average over the
        poses is that of a closed loop.
    accelerations : AccelerationResponse, optional
        What accelerometers on links showed at the same lines; fitted together with the response, their errors independent of those
        of the drives and of each other.
    """

    response: FrequencyResponse
    along: Array | None = None
    torques: ComplexArray | None = None
    feedback: Feedback | None = None
    accelerations: AccelerationResponse | None = None

    def __post_init__(self) -> None:
        lines, n = self.response.value.shape[:2]
        if self.torques is not None:
            shape = np.shape(self.torques)
            if len(shape) != 3 or shape[:2] != (lines, n) or shape[2] < n:
                raise ValueError(
                    f"torques has shape {shape}; expected {(lines, n)} and at least as many experiments as joints"
                )
        other = self.accelerations
        if other is not None and (
            other.joints != self.response.joints or not np.array_equal(other.hz, self.response.hz)
        ):
            raise ValueError("accelerations are of other joints or lines than the drives' response")

    @classmethod
    def of(
        cls,
        measured: MeasuredResponse,
        motion: Array,
        feedback: Feedback | None = None,
        accelerations: AccelerationResponse | None = None,
    ) -> PoseResponse:
        """As it was measured along one period of a motion, (N, joints of the robot), rad."""
        response = dataclasses.replace(measured, pose=motion.mean(axis=0))
        return cls(response, poses_along(motion), measured.torque, feedback, accelerations)

    @property
    def experiments(self) -> int:
        """Those whose friction slopes can be told apart."""
        return 1 if self.torques is None else int(self.torques.shape[2])

    def band(self, low_hz: float, high_hz: float) -> PoseResponse:
        """The lines between two frequencies, both included."""
        hz, other = self.response.hz, self.accelerations
        return dataclasses.replace(
            self,
            response=self.response.band(low_hz, high_hz),
            torques=None if self.torques is None else self.torques[(hz >= low_hz) & (hz <= high_hz)],
            accelerations=None if other is None else other.band(low_hz, high_hz),
        )


def smoothed_covariance(response: FrequencyResponse) -> tuple[ComplexArray, float]:
    """Covariance of a response, averaged over neighbouring lines as far as its few degrees of freedom ask for.

    A covariance of n^2 entries from a dozen realisations is nearly singular, and its inverse far too large. The distortion changes
    slowly along the lines, so that neighbours may be put together; a line whose variance sticks out keeps its own.

    Returns
    -------
    covariance : complex array, shape (F, n*n, n*n)
    degrees_of_freedom : float
        Of each, about.
    """
    covariance, own = response.covariance, response.degrees_of_freedom
    size = covariance.shape[1]
    if not np.isfinite(own) or own >= SMOOTHED * size:
        return covariance, own
    half = math.ceil((SMOOTHED * size / max(own, 1.0) - 1) / 2)
    lines = len(response.hz)
    sums = np.concatenate([np.zeros((1, size, size)), np.cumsum(covariance, axis=0)])
    low, high = np.maximum(np.arange(lines) - half, 0), np.minimum(np.arange(lines) + half + 1, lines)
    mean = (sums[high] - sums[low]) / (high - low)[:, None, None]
    excess = np.einsum("faa->fa", covariance).real / np.einsum("faa->fa", mean).real
    grow = np.sqrt(np.where(excess > OWN, excess, 1.0))
    return grow[:, :, None] * mean * grow[:, None, :], float(own * np.mean(high - low))
