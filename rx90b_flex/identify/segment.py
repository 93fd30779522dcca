"""One recording on the way to a regression: differentiated, low-passed and thinned out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from rx90b_flex.effects import Motion
from rx90b_flex.effects.motion import Array, Held, Indices, Mask
from rx90b_flex.identify.carried import carried_parameters
from rx90b_flex.pieces import AT_ONCE
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Recording, decimation_factor, filters, lowpass, motion, noise_cutoff_hz
from rx90b_flex.signals.sticking import held_part

# Positions are differentiated with a cutoff this much above the one that errors are counted after, so that the
# columns are low-passed once, as the torque is, and not twice.
POSITION_CUTOFF_RATIO = 2.0
ABOVE_NOISE = 1.5  # times the low-pass that is best for a noisy position's acceleration: velocities bear more
# Columns are worked out at this many times the cutoff at least: products of filtered signals stay free of aliasing.
WORKING_RATE_RATIO = 20.0
# Later times are dates, s.
LATEST_S = 1.0e6
# Left out of a fit at both ends, in periods of the cutoff: where the filter and the differences lack neighbours.
EDGE_PERIODS = 1.0
STANDING_S = 0.2  # within which the angle of a joint that stands still
STANDING_NOISE = 8.0  # stays in a range of so many standard deviations of the log's noise
MAD_TO_STD = 1.4826  # of a normal distribution
WIDER = 2.0  # times the cutoff of positions: another guess at the velocity
COARSEST = 10.0  # times the cutoff: working rate that is enough for a first look
PIECES = 4  # of a recording in an excerpt
RUN_IN_S = 0.25  # before and after each, for what remembers the motion


@dataclass(frozen=True, eq=False)
class Segment:
    """One recording, ready to be fitted.

    Attributes
    ----------
    recording : Recording
        In the order of the campaign's joints.
    motion : Motion
        Of the rigid robot, in tree order, at the working rate.
    time : array, shape (N,)
        Seconds, at the fit's rate.
    torque : array, shape (N, joints)
        Joint side, after the low-pass, at the fit's rate; N m.
    rate_hz : float
        The fit's sample rate.
    cutoff_hz : float or None
        The low-pass that the torque went through.
    factor, working_factor : int
        The fit keeps every `factor`-th sample of the working rate, which keeps every `working_factor`-th of the log.
    kept : slice
        Part of the fit's samples that is away from the ends.
    carried : array, shape (10 * bodies,), or None
        What a known payload adds to the links' inertial parameters in this recording.
    sensed : array, shape (N, joints), or None
        Torque of the sensors behind the gears, as `torque`; N m.
    first : int
        Working sample of the recording with which the motion begins.
    """

    recording: Recording
    motion: Motion
    time: Array
    torque: Array
    rate_hz: float
    cutoff_hz: float | None
    factor: int
    working_factor: int
    kept: slice
    carried: Array | None = None
    sensed: Array | None = None
    first: int = 0

    def brought(self, columns: Array) -> Array:
        """Low-pass columns at the working rate and take the fit's samples; shape (N_working, ...) -> (N, ...)."""
        # a view would keep all that it is part of
        return np.ascontiguousarray(self.low_passed(columns)[:: self.factor][self.kept])

    def low_passed(self, columns: Array) -> Array:
        """Columns (N_working, ...) behind the low-pass."""
        return columns if self.cutoff_hz is None else lowpass(columns, self.cutoff_hz, self.rate_hz * self.factor)

    @cached_property
    def wider(self) -> tuple[Array, Array]:
        """Angle and velocity from positions that keep another octave, at the working rate, each (N_working, joints); rad, rad/s."""
        if self.cutoff_hz is None:
            return self.motion.q, self.motion.v
        rate, low_pass = self.recording.sample_rate_hz, self.motion.low_pass
        cutoff = WIDER * (rate if low_pass is None else low_pass.cutoff_hz)
        logged = self.recording.position[self.first * self.working_factor :][: len(self.motion) * self.working_factor]
        wide = motion(logged, rate, cutoff if cutoff < 0.4 * rate else None)
        order = [self.recording.joints.index(j) for j in self.motion.coordinates.joints]
        q, v = (np.asarray(x[:: self.working_factor][:, order]) for x in (wide.position, wide.velocity))
        return q, v

    @cached_property
    def half_a_sample_off(self) -> tuple[Array, Array]:
        """The velocity of `wider` half a working sample before and after, each (N_working, joints); rad/s."""
        return filters.half_a_sample_off(self.wider[1])

    @property
    def beside_rests(self) -> Mask:
        """Where a joint is about to stand still or has just stood, at the fit's samples, (N, joints) in tree order."""
        still = self.motion.v == 0.0
        window = 1 + 2 * round(STANDING_S * self.rate_hz * self.factor)
        near = maximum_filter1d(still.astype(np.uint8), window, axis=0, mode="nearest") > 0
        return np.asarray((near & ~still)[:: self.factor][self.kept])

    @property
    def velocity(self) -> Array:
        """Of the recording's joints at the fit's samples, rad/s (m/s), shape (N, joints)."""
        order = [self.motion.coordinates.joints.index(joint) for joint in self.recording.joints]
        return np.asarray(self.motion.v[:: self.factor][self.kept][:, order])

    def sticking(self, held: Sequence[Held]) -> Segment:
        """The same, with friction held in no other sticks (`Motion.sticking`)."""
        return dataclasses.replace(self, motion=self.motion.sticking(held))

    def thinned(self) -> Segment:
        """Of one that has all its samples those that a fit needs, away from the ends."""
        rate, cutoff = self.rate_hz, self.cutoff_hz
        working, factor, edge = 1, 1, 4
        if cutoff is not None:
            working = decimation_factor(cutoff, rate, WORKING_RATE_RATIO / 2)
            factor = decimation_factor(cutoff, rate / working, 2.0)
            edge = int(np.ceil(EDGE_PERIODS / cutoff * rate / working / factor))
        keep_every = working * factor
        samples = _enough(self.recording, cutoff, len(self.time[::keep_every]), edge)
        kept = slice(edge, samples - edge)
        return dataclasses.replace(
            self,
            motion=self.motion if working == 1 else self.motion.part(slice(None, None, working)),
            time=self.time[::keep_every][kept],
            torque=self.torque[::keep_every][kept],
            sensed=None if self.sensed is None else self.sensed[::keep_every][kept],
            rate_hz=rate / keep_every,
            factor=factor,
            working_factor=working,
            kept=kept,
        )

    def loaded(self, link_parameters: Array) -> Array:
        """Inertial parameters of the links with what this recording carries, shape (10 * bodies,)."""
        return link_parameters if self.carried is None else link_parameters + self.carried

    @cached_property
    def sampled(self) -> Motion:
        """The motion at the fit's samples."""
        return self.motion.part(np.arange(len(self.motion))[:: self.factor][self.kept])

    def beginning(self, part: float) -> Segment:
        """A part of this one from its first sample on."""
        return self._piece(slice(0, max(1, int(part * len(self)))), self._run_in)

    def pieces(self, part: float, of_whole: bool = False) -> list[tuple[Segment, int]]:
        """A part of this one in pieces, each with its first sample; where the motion repeats, at different phases of it.

        With `of_whole` the tree is asked once at all samples (`Motion.piece`).
        """
        length = int(part * len(self) / PIECES)
        period = self.recording.period_s or np.inf
        repeats = max(1, int(len(self) / (period * self.rate_hz)))
        whole = min(period * self.rate_hz, len(self))
        starts = (min(int((k % repeats + k / PIECES) * whole), len(self) - length) for k in range(PIECES))
        return [(self._piece(slice(at, at + length), self._run_in, of_whole), at) for at in starts]

    def halved(self) -> tuple[Segment, Indices] | None:
        """Every other working sample, and which of the fit's samples are among these; None where the low-pass bears no fewer.

        The tree is asked once at all samples (`Motion.piece`).
        """
        if self.cutoff_hz is not None and self.rate_hz * self.factor < 2.0 * COARSEST * self.cutoff_hz:
            return None
        every = 1 if self.factor % 2 == 0 else 2
        samples = np.arange(-self.kept.start % every, len(self), every)
        begin = -(-self.kept.start // every)
        new = dataclasses.replace(
            self,
            motion=self.motion.piece(slice(None, None, 2)),
            time=self.time[samples],
            torque=self.torque[samples],
            sensed=None if self.sensed is None else self.sensed[samples],
            rate_hz=self.rate_hz / every,
            factor=self.factor * every // 2,
            working_factor=2 * self.working_factor,
            kept=slice(begin, begin + len(samples)),
            first=self.first // 2,
        )
        return new, samples

    def split(self) -> Iterator[Segment]:
        """Pieces of `AT_ONCE` working samples or fewer, behind whose low-pass columns of one instant are those of the whole."""
        if len(self.motion) <= AT_ONCE:
            yield self
            return
        rate = self.rate_hz * self.factor
        rings = 0 if self.cutoff_hz is None else filters.RINGS * filters.minimum_samples(self.cutoff_hz, rate)
        ends = np.append(np.arange(0, len(self), max(1, AT_ONCE // self.factor)), len(self))
        yield from (self._piece(slice(int(a), int(b)), -(-rings // self.factor)) for a, b in pairwise(ends))

    @property
    def _run_in(self) -> int:
        return max(self.kept.start, int(np.ceil(RUN_IN_S * self.rate_hz)))

    def _piece(self, samples: slice, beside: int, of_whole: bool = False) -> Segment:
        """Some of its samples, with the motion of so many more on either side that their columns need."""
        first, last = self.kept.start + samples.start, self.kept.start + samples.stop
        begin, end = max(0, first - beside), last + beside
        moved = slice(begin * self.factor, end * self.factor)
        return dataclasses.replace(
            self,
            motion=self.motion.piece(moved) if of_whole else self.motion.part(moved),
            time=self.time[samples],
            torque=self.torque[samples],
            sensed=None if self.sensed is None else self.sensed[samples],
            kept=slice(first - begin, last - begin),
            first=self.first + moved.start,
        )

    def __len__(self) -> int:
        return len(self.torque)


def prepare(
    robot: Robot, recording: Recording, cutoff_hz: float | None, thin: bool = True, sticking: Sequence[Held] = ()
) -> Segment:
    """Differentiate, low-pass and thin out one recording.

    Parameters
    ----------
    robot : Robot
        Rigid, with the recording's joints.
    recording : Recording
    cutoff_hz : float or None
        Zero-phase low-pass of every signal; None fits the torque as it was logged.
    thin : bool
        Keep only the samples that a fit needs (`Segment.thinned`); otherwise all of them.
    sticking : sequence of (str, str)
        Joints whose dry friction is held where their drives stand still between two moves (`Motion.stuck`), each with ``turn`` or
        ``pause``.

    Raises
    ------
    ValueError
        The recording is shorter than the filter.
    """
    rate = recording.sample_rate_hz
    try:
        # the narrower filter first: where a recording is too short for it, that is the cutoff that the user knows
        torque, sensed = (
            x if x is None or cutoff_hz is None else lowpass(x, cutoff_hz, rate)
            for x in (recording.torque, recording.joint_torque)
        )
        assert torque is not None
        position_cutoff = _position_cutoff(recording.position, rate, cutoff_hz)
        moved = motion(recording.position, rate, position_cutoff)
        off = _noise(recording.position - moved.position)
        moved = _standing(moved, off, rate)
    except ValueError as error:
        raise ValueError(f"{recording.source or recording.name}: {error}") from None
    order = [recording.joints.index(j) for j in robot.joints]
    q, v, a = (x[:, order] for x in moved)
    motion_of_tree = robot.motion(q, v, a, _since(recording.time))
    if position_cutoff is not None:
        below = position_cutoff / (0.5 * rate)
        motion_of_tree = dataclasses.replace(
            motion_of_tree,
            angle_noise=off[order] * np.sqrt(below / (1.0 - below)),
            low_pass=_LowPassOfAngles(position_cutoff),
        )
    stuck = held_part(recording.position, rate) if sticking else None
    motion_of_tree = dataclasses.replace(motion_of_tree, stuck=None if stuck is None else stuck[:, order]).sticking(
        sticking
    )
    carried = None if recording.payload is None else carried_parameters(robot, recording.payload)
    samples = slice(0, _enough(recording, cutoff_hz, len(torque), 0))
    whole = Segment(recording, motion_of_tree, recording.time, torque, rate, cutoff_hz, 1, 1, samples, carried, sensed)
    return whole.thinned() if thin else whole


def _enough(recording: Recording, cutoff_hz: float | None, samples: int, edge: int) -> int:
    """So many samples, if they are enough for a fit that leaves out an edge on either side."""
    if samples > 2 * edge + 8:
        return samples
    behind = "" if cutoff_hz is None else f" after a low-pass of {cutoff_hz:g} Hz"
    raise ValueError(f"{recording.source or recording.name}: {recording.samples} samples are too few to fit{behind}")


def _noise(off: Array) -> Array:
    """Standard deviation of each column but for outliers."""
    return np.asarray(MAD_TO_STD * np.median(np.abs(off - np.median(off, axis=0)), axis=0))


def _standing(moved: filters.FilteredMotion, noise: Array, rate: float) -> filters.FilteredMotion:
    """A motion without velocity and acceleration where a joint stands still.

    There the angle stays within the log's `noise`, (joints,), rad, and the velocity's sign would be that of the noise.
    """
    window = max(3, round(STANDING_S * rate))
    reach = [
        filter_(moved.position, window, axis=0, mode="nearest") for filter_ in (maximum_filter1d, minimum_filter1d)
    ]
    still = reach[0] - reach[1] <= STANDING_NOISE * noise + 1e-12
    return moved._replace(
        velocity=np.where(still, 0.0, moved.velocity), acceleration=np.where(still, 0.0, moved.acceleration)
    )


def _since(time: Array) -> Array:
    """Times (N,) since a log's clock began, s; since the log began if it gives dates."""
    return time - time[0] if abs(time[0]) > LATEST_S else time


def _position_cutoff(position: Array, rate: float, cutoff_hz: float | None) -> float | None:
    """Low-pass of positions, Hz: well above the torque's, but not so far above where their noise begins to rule the acceleration."""
    if cutoff_hz is None:
        return noise_cutoff_hz(position, rate)
    noise = noise_cutoff_hz(position, rate) if len(position) >= filters.FEWEST_SAMPLES else None
    wide = min(POSITION_CUTOFF_RATIO * cutoff_hz, np.inf if noise is None else ABOVE_NOISE * noise)
    return wide if wide < 0.4 * rate else None


@dataclass(frozen=True)
class _LowPassOfAngles:
    """The low-pass of a log's positions; samples that are too few or too sparse for it stay as they are."""

    cutoff_hz: float

    def __call__(self, x: Array, rate_hz: float) -> Array:
        possible = self.cutoff_hz < 0.5 * rate_hz and len(x) >= filters.minimum_samples(self.cutoff_hz, rate_hz)
        return lowpass(x, self.cutoff_hz, rate_hz) if possible else x
