"""What an identified model predicts, sample by sample, and what it leaves over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90b_flex.diagnose.moving import waiting
from rx90b_flex.effects import Effect
from rx90b_flex.effects.log_effect import between
from rx90b_flex.effects.motion import Array, Mask, with_forces
from rx90b_flex.identify.segment import Segment
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording, lowpass, periods

NOISE_ALONE = 1.005  # error over another's that is none where the joints' own errors fall on average
UNLIKE = 3.0  # times what is left of the next worst: a recording that was made otherwise
UNLIKE_LEAST = 0.005  # of its torques: below it no recording is unlike


@dataclass(frozen=True)
class Errors:
    """Error of a model on the recordings of one role.

    Attributes
    ----------
    relative_error : float
        2-norm of the torque error over the 2-norm of the torque, all joints and samples.
    torque_rms : tuple of float
        Root mean square error a joint, N m.
    since_moved : Errors or None
        The same but for rows in which a joint has stood since its recording began; None where there are no such rows.
    """

    relative_error: float
    torque_rms: tuple[float, ...]
    since_moved: Errors | None = None

    @staticmethod
    def of(measured: Sequence[Array], predicted: Sequence[Array], waiting: Sequence[Mask] = ()) -> Errors:
        """Errors over several recordings, each (N, joints), and rows that are not told."""
        each = [tau - p for tau, p in zip(measured, predicted, strict=True)]
        error = each[0] if len(each) == 1 else np.concatenate(each)
        size = float(np.linalg.norm([np.linalg.norm(tau) for tau in measured]))
        relative = float(np.linalg.norm(error) / size)
        error *= error
        since = None
        if any(still.any() for still in waiting):
            told, said = ([x * ~still for x, still in zip(xs, waiting, strict=True)] for xs in (measured, predicted))
            since = Errors.of(told, said)
        return Errors(relative, tuple(float(x) for x in np.sqrt(error.mean(axis=0))), since)

    @property
    def told(self) -> Errors:
        """What says something of a model: what friction holds before a joint first moves nobody knows."""
        return self.since_moved or self

    def worse_than(self, other: Errors) -> bool:
        """Whether more is left over; a small joint's name is no matter of a large one's noise."""
        own, before = (float(np.log(np.maximum(e.torque_rms, 1e-300)).sum()) for e in (self, other))
        return self.relative_error > (NOISE_ALONE if own < before else 1.0) * other.relative_error

    def partly(self, other: Errors, joints: Sequence[bool]) -> Errors:
        """With another model's errors on some joints, of the same recordings."""
        rms = tuple(b if here else a for a, b, here in zip(self.torque_rms, other.torque_rms, joints, strict=True))
        size = float(np.linalg.norm(self.torque_rms))
        since = self.since_moved and self.since_moved.partly(other.told, joints)
        return Errors(self.relative_error * float(np.linalg.norm(rms)) / size if size > 0.0 else 0.0, rms, since)


@dataclass(frozen=True)
class RoleErrors:
    """Errors of one model on both roles."""

    validation: Errors
    identification: Errors

    @property
    def told(self) -> RoleErrors:
        """But for rows before joints first move."""
        return RoleErrors(self.validation.told, self.identification.told)

    def partly(self, other: RoleErrors, joints: Sequence[bool]) -> RoleErrors:
        """With another model's errors on some joints."""
        return RoleErrors(
            self.validation.partly(other.validation, joints), self.identification.partly(other.identification, joints)
        )


@dataclass(frozen=True, eq=False)
class ReplayedTorques:
    """One recording at its own sample rate, ready to be predicted by any model of the same tree.

    Attributes
    ----------
    robot : Robot
        Rigid, with the recording's joints.
    segment : Segment
        The recording, differentiated at its own rate.
    """

    robot: Robot
    segment: Segment

    @property
    def recording(self) -> Recording:
        """The recording that is replayed."""
        return self.segment.recording

    @property
    def torque(self) -> Array:
        """Measured torque after the low-pass, shape (N, joints), N m."""
        return self.segment.torque

    @property
    def velocity(self) -> Array:
        """Velocity of the recording's joints, shape (N, joints), rad/s."""
        return self._of_joints(self.segment.motion.v)

    @cached_property
    def waiting(self) -> Mask:
        """Rows up to a joint's first move (`moving.waiting`), shape (N, joints)."""
        return waiting(self.velocity, self.recording.sample_rate_hz)

    @property
    def position(self) -> Array:
        """Position of the recording's joints, shape (N, joints), rad or m."""
        return self._of_joints(self.segment.motion.q)

    def _of_joints(self, x: Array) -> Array:
        """Of coordinates (N, n) those of the recording's joints; no copy where these are all of them in order."""
        rows = np.array([self.robot.layout.index(j) for j in self.recording.joints])
        return x if np.array_equal(rows, np.arange(x.shape[1])) else x[:, rows]

    def _filtered(self, torque: Array) -> Array:
        cutoff = self.segment.cutoff_hz
        return torque if cutoff is None else lowpass(torque, cutoff, self.recording.sample_rate_hz)

    def predict(self, effects: Sequence[Effect], link_parameters: Array) -> Array:
        """Torque of a model on this recording's motion, its known payload carried, after the low-pass; (N, joints), N m."""
        return self._filtered(self._torque(effects, link_parameters))

    def _torque(self, effects: Sequence[Effect], link_parameters: Array) -> Array:
        """The same before it."""
        loaded = self.segment.loaded(link_parameters)
        seen = self.robot.on_links(self.segment.motion, loaded, effects)
        force = np.array(seen.on_tree.load())
        if not any(e.traits.needs_load or e.traits.needs_model for e in effects):
            seen.forget()  # nobody asks for the load again
        force = with_forces(force, (e for e in effects if e.traits.in_dynamics), seen)
        for effect in between(effects):
            force = effect.logged(seen, force)
        return self._of_joints(force)


def replayed_errors(replays: Sequence[ReplayedTorques], predicted: Sequence[Array]) -> Errors:
    """Errors of torques predicted on some recordings, each (N, joints), N m."""
    return Errors.of([r.torque for r in replays], predicted, [r.waiting for r in replays])


def noise_floor(replays: Sequence[ReplayedTorques], residuals: Sequence[Array], campaign: Campaign) -> Array | None:
    """Noise of the torque after the low-pass, a joint; from repeated periods, else from a stated noise, else None."""
    return noise_between_periods([replay.recording for replay in replays], residuals, campaign)


def noise_between_periods(
    recordings: Sequence[Recording], residuals: Sequence[Array], campaign: Campaign
) -> Array | None:
    """The same from recordings, and what repeats in them with the motion or is left of it, each (N, joints), N m."""
    found = [period_noise(r, recording) for recording, r in zip(recordings, residuals, strict=True)]
    known = [(f, len(r)) for f, r in zip(found, residuals, strict=True) if f is not None]
    if known:
        total = sum(n for _, n in known)
        return np.sqrt(np.sum([n * f**2 for f, n in known], axis=0) / total)
    if campaign.noise_torque is not None:
        return np.asarray(campaign.noise_torque) * _white_noise_gain(campaign.cutoff_hz, campaign.sample_rate_hz)
    return None


def unlike_words(names: Sequence[str], measured: Sequence[Array], predicted: Sequence[Array]) -> tuple[str, ...]:
    """That a model leaves far more of one recording than of the others, where it does; torques (N, joints) of each."""
    pairs = zip(measured, predicted, strict=True)
    left = np.array([np.linalg.norm(tau - p) / max(float(np.linalg.norm(tau)), 1e-300) for tau, p in pairs])
    worst = int(np.argmax(left))
    others = np.delete(left, worst)
    if len(others) < 2 or left[worst] < UNLIKE * max(float(others.max()), UNLIKE_LEAST):
        return ()
    return (
        f"Of {names[worst]} {left[worst]:.2g} of the torques are left, of the other recordings {others.max():.2g} at the most: that "
        "one was made otherwise. Look at its columns, its load and its times, or leave it out.",
    )


def _white_noise_gain(cutoff_hz: float | None, sample_rate_hz: float) -> float:
    """Root of the part of white noise's power that the low-pass leaves."""
    if cutoff_hz is None:
        return 1.0
    impulse = np.zeros((int(40 * sample_rate_hz / cutoff_hz) // 2 * 2 + 1, 1))
    impulse[len(impulse) // 2] = 1.0
    return float(np.linalg.norm(lowpass(impulse, cutoff_hz, sample_rate_hz)))


def period_noise(residual: Array, recording: Recording) -> Array | None:
    """Noise of a repeating experiment, from what differs between its periods.

    Parameters
    ----------
    residual : array, shape (N, joints)
        One row a sample of the recording.
    recording : Recording

    Returns
    -------
    array, shape (joints,), or None where the recording does not hold two whole periods
        Root mean square, N m.
    """
    if recording.period_s is None:
        return None
    samples = round(recording.period_s * recording.sample_rate_hz)
    if samples < 1 or len(residual) < 2 * samples:
        return None
    # one joint after the other: all take as much room as a long recording once more
    return np.sqrt([periods(x, samples).var(axis=0, ddof=1).mean() for x in residual.T])
