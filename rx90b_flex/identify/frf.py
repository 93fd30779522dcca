"""Nonparametric frequency response from motor torques and angles measured in closed loop (chapter 6, equations 6.14-6.34).

A campaign is made of realisations (the multisine's phases), each of experiments (columns of the input matrix), each run with
both signs of the excitation, each over several periods. Both signals are noisy, and the loop carries the noise of one into the other;
the robot's nonlinearity adds a distortion that repeats with the period but changes with the phases. Hence two covariances:
periods differ by noise alone, realisations by noise and distortion together.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.accelerometers import AccelerationResponse
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.mains import without_mains
from rx90b_flex.signals import Campaign, Recording
from rx90b_flex.signals.filters import periods as whole_periods
from rx90b_flex.signals.stated import Accelerometer

SHAKEN = 1e-6  # rad by which references of runs must differ to be an excitation
EXCITED = 1e-3  # a line is excited where its feed-forward exceeds this part of the largest
USED = 1e-4  # a joint is excited where its feed-forward exceeds this part of the largest joint's
SAME = 0.99  # correlation over lines from which two feed-forward spectra are the same multisine's
OPPOSITE = 1e-2  # relative: how near a feed-forward must come to the negative of another
# Of the feed-forwards or torques of a line's experiments, rows scaled, beyond which they are singular.
WORST_CONDITION = 1e3
CLEAR = 4.0  # standard deviations by which the weakest combination of torques must stand out of the noise
NEIGHBOURS = 2  # lines on either side that count for a covariance
OWN = 3.0  # an accelerometer's line whose variance exceeds its neighbours' mean by this keeps its own
PLENTY = 8  # degrees of freedom of an accelerometer's covariance, over its entries a row
ENOUGH = 2  # degrees of freedom of a covariance, over its entries a row, below which more neighbours count
POSE_SPREAD = 0.02  # rad: mean angles further apart belong to different poses
NAME = re.compile(r"^(?P<realisation>.*\d)_(?P<experiment>\d+)_(?P<sign>plus|minus)(_\d+)?$")


@dataclass(frozen=True)
class Place:
    """Where a recording stands in the design: realisation and experiment counted from 0, sign 1 or -1."""

    recording: str
    realisation: int
    experiment: int
    sign: int


@dataclass(frozen=True, eq=False)
class Spectra:
    """Root mean square amplitudes at all lines of the period below Nyquist, over all runs and periods.

    Attributes
    ----------
    hz : array, shape (L,)
    excited : bool array, shape (L,)
    torque, acceleration : array, shape (L, n), N m and rad/s^2
        Of the half differences of sign pairs: gone are the references' part and what does not change sign with the excitation.
    torque_noise, acceleration_noise : array, shape (L, n)
        Deviation of one period from the mean of the periods; NaN with one period.
    """

    hz: Array
    excited: NDArray[np.bool_]
    torque: Array
    acceleration: Array
    torque_noise: Array
    acceleration_noise: Array

    @property
    def torque_snr(self) -> Array:
        """Torque at the excited lines over its noise, one period each, (F, n); NaN with one period."""
        return _over(self.torque[self.excited], self.torque_noise[self.excited])

    @property
    def acceleration_snr(self) -> Array:
        """The same of the acceleration."""
        return _over(self.acceleration[self.excited], self.acceleration_noise[self.excited])


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MeasuredResponse(FrequencyResponse):
    """A nonparametric estimate and what it was made of. F lines, n joints, R realisations, E experiments.

    Attributes
    ----------
    realisations : complex array, shape (R, F, n, n)
        ``Y U^-1`` of each realisation, its spectra averaged over the periods.
    h1, arithmetic_mean : complex array, shape (F, n, n)
        For comparison: ``S_yu S_uu^-1`` and the mean of ``Y U^-1``, both over single periods.
    torque, acceleration : complex array, shape (F, n, E)
        U of the first realisation, and Y of all mapped to it (6.22-6.25) and averaged (6.29). The source maps to the mean magnitudes
        of U, entry by entry, (6.23): with (6.50) these are nearly alike and their matrix singular.
    equation_noise : complex array, shape (F, n, n), or None
        Covariance of ``Y - P U`` from noise, of one experiment's mean over periods: ``B C_ZV B^H / periods`` in (6.33).
    equation_total : complex array, shape (F, n, n)
        The same with the nonlinear distortion.
    acceleration_distortion : array, shape (F, n)
        Root mean square of the line over that of noise and distortion of a realisation.
    spectra : Spectra
    places : tuple of Place
        How the recordings were understood.
    periods : int
        Whole periods of each recording.
    remarks : tuple of str
        What was left out or could not be estimated, and why.
    """

    realisations: ComplexArray
    h1: ComplexArray
    arithmetic_mean: ComplexArray
    torque: ComplexArray
    acceleration: ComplexArray
    equation_noise: ComplexArray | None
    equation_total: ComplexArray
    acceleration_distortion: Array
    spectra: Spectra
    places: tuple[Place, ...]
    periods: int
    remarks: tuple[str, ...]

    @property
    def distortion_covariance(self) -> ComplexArray | None:
        """Part of the covariance that nonlinearity brings about (6.30), shape (F, n*n, n*n); None where noise is not known.

        A difference of two estimates: where noise rules, eigenvalues below zero are set to zero.
        """
        if self.noise_covariance is None:
            return None
        values, vectors = np.linalg.eigh(self.covariance - self.noise_covariance)
        return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.conj().swapaxes(1, 2))


def confidence_radius(response: FrequencyResponse, level: float = 0.95) -> Array:
    """Radius of the circle in the complex plane that holds each entry with the given probability, shape (F, n, n).

    For a circular complex error d of variance s^2, estimated with nu degrees of freedom, ``|d|^2 / s^2`` has Fisher's
    distribution with 2 and 2 nu of them.
    """
    nu = response.degrees_of_freedom
    ratio = -np.log1p(-level) if np.isinf(nu) else stats.f.ppf(level, 2, 2.0 * nu)
    return np.asarray(response.std() * np.sqrt(ratio))


# ---- which recording is what ----------------------------------------------------------------------------------


def group_poses(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], ...]:
    """Recordings about the same pose together, poses in the order in which they appear.

    A recording's pose is its mean motor angle over whole periods; it belongs to the first pose whose first recording is within
    `POSE_SPREAD` in every joint.
    """
    groups: list[tuple[Array, list[Recording]]] = []
    for r in recordings:
        mean = _periods(r.position, r).mean(axis=(0, 1))
        for head, group in groups:
            if head.shape == mean.shape and np.abs(mean - head).max() <= POSE_SPREAD:
                group.append(r)
                break
        else:
            groups.append((mean, [r]))
    return tuple(tuple(group) for _, group in groups)


def group_recordings(recordings: Sequence[Recording]) -> tuple[Place, ...]:
    """Tell realisation, experiment and sign of each recording from what excited it (`excitations`).

    Recordings share a realisation if some joint's excitation spectrum in one is a multiple of some joint's in the other;
    within one, two whose excitations are each other's negative are a pair. Where none was logged, from names such as
    ``run_000_1_plus``.

    Raises
    ------
    ValueError
        Neither tells; a run is there twice.
    """
    waves = excitations(recordings)
    places = _from_names(recordings) if waves is None else _from_excitations(recordings, waves)
    twice = [key for key, count in Counter((p.realisation, p.experiment, p.sign) for p in places).items() if count > 1]
    if twice:
        names = [p.recording for p in places if (p.realisation, p.experiment, p.sign) == twice[0]]
        raise ValueError(f"recordings {', '.join(names)} have the same excitation; give one of them, or `places`")
    return places


def excitations(recordings: Sequence[Recording]) -> list[Array] | None:
    """One period of what excited each run about a pose, (period, n); None where that was not logged.

    Feed-forward torques, N m; where there are none, or they rest, what the references differ by from their mean over all runs, rad:
    both signs of an excitation leave the motion that all share.
    """
    fed = [r.feedforward_torque for r in recordings]
    torques = [_periods(x, r).mean(axis=0) for x, r in zip(fed, recordings, strict=True) if x is not None]
    if len(torques) == len(fed) and any(np.ptp(x, axis=0).any() for x in torques):
        return torques
    asked = [_periods(r.reference_position, r).mean(axis=0) for r in recordings if r.reference_position is not None]
    if len(asked) == len(fed) and len({x.shape for x in asked}) == 1:
        apart = np.array(asked) - np.mean(asked, axis=0)
        if np.abs(apart).max() > SHAKEN:
            return list(apart)
    return torques if len(torques) == len(fed) else None


def _from_excitations(recordings: Sequence[Recording], waves: Sequence[Array]) -> tuple[Place, ...]:
    spectra = np.stack([_spectrum_of_wave(wave) for wave in waves])  # (runs, lines, joints)
    size = np.sqrt(np.sum(np.abs(spectra) ** 2, axis=1))  # (runs, joints)
    silent = [r.name for r, s in zip(recordings, size, strict=True) if not s.any()]
    if silent:
        raise ValueError(f"recording {silent[0]!r}: feedforward_torque does not change; an excitation is expected")
    used = size > USED * size.max()
    unit = np.divide(spectra, size[:, None, :], out=np.zeros_like(spectra), where=used[:, None, :])
    places: list[Place] = []
    heads: list[ComplexArray] = []  # of each realisation: its different multisines, (lines, joints) of its runs so far
    for run, recording in enumerate(recordings):
        alike = [np.abs(head.conj().T @ unit[run]).max() for head in heads]
        realisation = int(np.argmax(alike)) if max(alike, default=0.0) > SAME else len(heads)
        if realisation < len(heads):
            heads[realisation] = np.hstack([heads[realisation], unit[run]])
        else:
            heads.append(unit[run])
        known = [(other, p) for other, p in enumerate(places) if p.realisation == realisation]
        near = OPPOSITE * np.abs(spectra[run]).max()
        signs = (
            (p, s) for other, p in known for s in (-1, 1) if np.abs(spectra[run] - s * spectra[other]).max() < near
        )
        for same, sign in signs:
            places.append(Place(recording.name, realisation, same.experiment, sign * same.sign))
            break
        else:
            new = max((p.experiment for _, p in known), default=-1) + 1
            places.append(Place(recording.name, realisation, new, 1))
    return tuple(places)


def _spectrum_of_wave(wave: Array) -> ComplexArray:
    return np.asarray(np.fft.rfft(wave - wave.mean(axis=0), axis=0))


def _from_names(recordings: Sequence[Recording]) -> tuple[Place, ...]:
    found = [NAME.match(r.name) for r in recordings]
    unknown = [r.name for r, match in zip(recordings, found, strict=True) if match is None]
    if unknown:
        raise ValueError(
            f"recording {unknown[0]!r}: neither feedforward_torque nor its name tells realisation, experiment and sign; "
            "log the feed-forward torque or the references, or name recordings as run_000_1_plus (in Python also: give `places`)"
        )
    orders = list(dict.fromkeys(match["realisation"] for match in found if match))
    return tuple(
        Place(r.name, orders.index(m["realisation"]), int(m["experiment"]) - 1, 1 if m["sign"] == "plus" else -1)
        for r, m in zip(recordings, found, strict=True)
        if m
    )


# ---- estimation -----------------------------------------------------------------------------------------------


def estimate_frequency_response(
    data: Campaign | Sequence[Recording],
    *,
    joints: Sequence[str] | None = None,
    hz: Array | None = None,
    band_hz: tuple[float, float] | None = None,
    places: Sequence[Place] | None = None,
    neighbours: int | None = None,
    mains_hz: float | None = None,
) -> MeasuredResponse:
    """Drive acceleration over drive torque of a robot about one pose, with covariances of noise and of nonlinear distortion.

    Sign pairs are subtracted, so that the references' part goes. With U and Y the torques and accelerations of one
    realisation's experiments (columns), averaged over periods, the estimate is ``P = mean(Y U^-1)`` over realisations: mapping
    them to common phases by the measured input, (6.22-6.25), multiplies U and Y from the right by one matrix, so that (6.32)
    does not depend on the phases chosen. Noise covariance (6.26-6.28) is that of the equation error ``Y - P U`` between
    periods, carried on by (6.33); torque and angle noise and their correlation are all in it. The total covariance of the
    mean, (6.31), comes from the differences of realisations.

    Parameters
    ----------
    data : Campaign, or its recordings
        Of a campaign those for identification.
    joints : names, optional
        Those that were excited, by default. Torques of other joints count as part of the robot.
    hz : array, optional
        Lines to use; by default those of the feed-forward torque.
    band_hz : two frequencies, optional
        Keeps the lines between them.
    places : as from `group_recordings`, which is asked by default
    neighbours : int, optional
        Lines on either side whose departures of realisations count for a line's total covariance: R - 1 alone are fewer degrees of
        freedom than a covariance of n*n entries needs. They are compared as torques, ``P^-1 (P_m - P)``, since friction's distortion
        is a torque, smooth over the lines where P is not. 0 uses the line alone; by default 2, or as many as give ``2 n*n`` degrees
        of freedom where the realisations are few.
    mains_hz : float, optional
        About 50 or 60: a sine near it is taken out of each recording first (`without_mains`). Where it repeats with the period, the
        line that it falls on is left out instead.

    Raises
    ------
    ValueError
        Recordings that do not fit together, no complete realisation, or no line left. What costs a part only is in `remarks`.
    """
    recordings = data.identification if isinstance(data, Campaign) else tuple(data)
    _check_alike(recordings)
    design = tuple(places) if places is not None else group_recordings(recordings)
    first = recordings[0]
    waves = excitations(recordings)
    chosen = _excited_joints(first.joints, waves) if joints is None else tuple(joints)
    unknown = [j for j in chosen if j not in first.joints]
    if unknown:
        raise ValueError(f"joint {unknown[0]!r} is not recorded; there are {', '.join(first.joints)}")
    columns = [first.joints.index(j) for j in chosen]
    remarks: list[str] = []
    struck: list[float] = []
    if mains_hz is not None:
        recordings, struck = _without_mains(recordings, mains_hz, remarks)
    complete = _complete(_experiments(recordings, _long_enough(recordings, design, remarks), remarks), chosen, remarks)
    torque, angle = (_spectrum_of(recordings, complete, x, columns) for x in ("torque", "position"))  # (R, E, M, L, n)
    period = first.period_samples or 1
    all_hz = np.arange(period // 2 + 1) * first.sample_rate_hz / period
    acceleration = -((2.0 * np.pi * all_hz[:, None]) ** 2) * angle
    lines = _lines(first, None if waves is None else [x[:, columns] for x in waves], hz, band_hz, all_hz, remarks)
    lines = np.setdiff1d(lines, np.round(np.array(struck) / all_hz[1]).astype(int))
    feedforward = None
    if waves is not None:
        excited = [[_spectrum_of_wave(waves[one.first])[lines][:, columns] for one in group] for group in complete]
        feedforward = np.stack(excited)  # (R, E, F, n)
    u, y = (np.moveaxis(x, (1, 2, 3, 4), (4, 1, 2, 3)) for x in (torque[..., lines, :], acceleration[..., lines, :]))
    lines, kept = _regular(u, feedforward, lines, all_hz, remarks)
    u, y = u[:, :, kept], y[:, :, kept]  # (R, M, F, n, E)
    spectra = _line_spectra(torque, acceleration, lines, all_hz)
    pose = np.mean([_periods(r.position, r).mean(axis=(0, 1)) for r in recordings], axis=0)
    return _estimate(u, y, all_hz[lines], chosen, pose, neighbours, spectra, design, remarks)


def _estimate(
    u: ComplexArray,
    y: ComplexArray,
    hz: Array,
    joints: tuple[str, ...],
    pose: Array,
    neighbours: int | None,
    spectra: Spectra,
    places: tuple[Place, ...],
    remarks: list[str],
) -> MeasuredResponse:
    """The response from spectra of torques and accelerations, each (R, M, F, n, E)."""
    realisations, periods = u.shape[:2]
    mean_u, mean_y = u.mean(axis=1), y.mean(axis=1)  # (R, F, n, E)
    inverse = np.linalg.pinv(mean_u)  # (R, F, E, n): experiments beyond the joints are averaged by it
    single = mean_y @ inverse
    value = single.mean(axis=0)
    # row j, column k of an error D = E U^+ of independent experiments: E[D_jk D*_j'k'] = C_jj' (U^+^T U^+*)_kk'
    spread = np.mean(inverse.swapaxes(2, 3) @ inverse.conj(), axis=0)
    noise = noise_covariance = None
    if periods > 1:
        noise = _equation_noise(u, y, value)
        noise_covariance = _kron(noise, spread) / realisations
    else:
        remarks.append("one period: noise cannot be told from distortion")
    if realisations > 1:
        total = _equation_total(single, mean_u)
        covariance, freedom = _total_covariance(single, neighbours, remarks)
    elif noise is not None and noise_covariance is not None:
        remarks.append("one realisation: the nonlinear distortion is unknown, the covariance holds noise alone")
        total, covariance, freedom = noise, noise_covariance, float((periods - 1) * u.shape[-1])
    else:
        raise ValueError(
            "one realisation of one period: no covariance can be estimated; record more periods or realisations"
        )
    return MeasuredResponse(
        hz=hz,
        value=value,
        covariance=covariance,
        joints=joints,
        pose=pose,
        noise_covariance=noise_covariance,
        degrees_of_freedom=freedom,
        realisations=single,
        h1=_h1(u, y),
        arithmetic_mean=np.mean(y @ np.linalg.pinv(u), axis=(0, 1)),
        torque=mean_u[0],
        acceleration=np.mean(mean_y @ inverse @ mean_u[0], axis=0),
        equation_noise=noise,
        equation_total=total,
        acceleration_distortion=_over(spectra.acceleration[spectra.excited], np.sqrt(np.einsum("fjj->fj", total).real)),
        spectra=spectra,
        places=places,
        periods=periods,
        remarks=tuple(remarks),
    )


def _equation_noise(u: ComplexArray, y: ComplexArray, value: ComplexArray) -> ComplexArray:
    """Covariance (F, n, n) of ``Y - P U`` from noise, by what periods differ; of one experiment's mean over periods."""
    realisations, periods, _, _, experiments = u.shape
    error = y - y.mean(axis=1, keepdims=True) - value @ (u - u.mean(axis=1, keepdims=True))
    freedom = realisations * (periods - 1) * experiments
    return np.asarray(np.einsum("rmfje,rmfke->fjk", error, error.conj()) / freedom / periods)


def _equation_total(single: ComplexArray, mean_u: ComplexArray) -> ComplexArray:
    """Covariance (F, n, n) of ``Y - P U`` from noise and distortion, by what realisations (R, F, n, n) differ."""
    realisations, _, n, _ = single.shape
    on_output = (single - single.mean(axis=0)) @ mean_u  # carried by n combinations of the experiments
    return np.asarray(np.einsum("rfje,rfke->fjk", on_output, on_output.conj()) / (n * (realisations - 1)))


def _total_covariance(single: ComplexArray, neighbours: int | None, remarks: list[str]) -> tuple[ComplexArray, float]:
    """As `_over_realisations`, over the lines that are asked for or that it needs; said where these are more or do not do."""
    realisations, lines, n, _ = single.shape
    count = NEIGHBOURS if neighbours is None else neighbours
    if neighbours is None and (2 * count + 1) * (realisations - 1) < ENOUGH * n * n:
        count = -(-(-(-ENOUGH * n * n // (realisations - 1)) - 1) // 2)
        remarks.append(
            f"{realisations} realisations: {min(2 * count + 1, lines)} neighbouring lines count for each line's covariance, "
            f"with more realisations {2 * NEIGHBOURS + 1} would do"
        )
    covariance, freedom = _over_realisations(single, count)
    if freedom < n * n:
        remarks.append(
            f"{realisations} realisations: {freedom:g} degrees of freedom are fewer than the {n * n} entries, and the covariance "
            "cannot be inverted; record more realisations or let more neighbours count"
        )
    return covariance, freedom


def _over_realisations(single: ComplexArray, neighbours: int) -> tuple[ComplexArray, float]:
    """Covariance of the mean of realisations (R, F, n, n), shape (F, n*n, n*n), and its degrees of freedom."""
    realisations, lines, n, _ = single.shape
    value = single.mean(axis=0)
    as_torque = np.linalg.solve(value, single - value).reshape(realisations, lines, n * n)
    own = np.einsum("rfa,rfb->fab", as_torque, as_torque.conj()) / (realisations * (realisations - 1))
    width = min(2 * neighbours + 1, lines)
    smooth = _over_lines(own, width)
    back = np.einsum("fjk,ab->fjakb", value, np.eye(n)).reshape(lines, n * n, n * n)
    covariance = back @ smooth @ back.conj().swapaxes(1, 2)
    return np.asarray(0.5 * (covariance + covariance.conj().swapaxes(1, 2))), float(width * (realisations - 1))


def _over_lines(x: ComplexArray, width: int) -> ComplexArray:
    """Means over so many lines (F, ...): at the ends of the band the window stays as wide, and lies to one side."""
    first = np.clip(np.arange(len(x)) - width // 2, 0, len(x) - width)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(x, width, axis=0).mean(axis=-1)[first])


def _kron(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Kronecker product line by line, (F, n, n) and (F, n, n) to (F, n*n, n*n)."""
    n = left.shape[-1]
    return np.asarray(np.einsum("fjk,fab->fjakb", left, right).reshape(-1, n * n, n * n))


def _h1(u: ComplexArray, y: ComplexArray) -> ComplexArray:
    adjoint = u.conj().swapaxes(-1, -2)
    return np.asarray(np.sum(y @ adjoint, axis=(0, 1)) @ np.linalg.inv(np.sum(u @ adjoint, axis=(0, 1))))


def _over(level: Array, noise: Array) -> Array:
    return np.divide(level, noise, out=np.full_like(level, np.inf), where=~(noise <= 0.0))


# ---- from recordings to spectra -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _SignedRuns:
    """Recordings of one experiment by sign, as places in the list of recordings."""

    realisation: int
    runs: dict[int, int]

    @property
    def first(self) -> int:
        """The run of positive sign where there is one."""
        return self.runs[max(self.runs)]


def _periods(x: Array, recording: Recording) -> Array:
    return whole_periods(x, recording.period_samples or len(x))


def _check_alike(recordings: Sequence[Recording]) -> None:
    if not recordings:
        raise ValueError("no recordings; a campaign of periodic excitation is expected")
    first = recordings[0]
    for r in recordings:
        if r.period_samples is None:
            raise ValueError(f"recording {r.name!r} has no period_s; a frequency response needs a periodic excitation")
        for what in ("joints", "sample_rate_hz", "period_samples"):
            if getattr(r, what) != getattr(first, what):
                found, expected = getattr(r, what), getattr(first, what)
                raise ValueError(f"recording {r.name!r}: {what} is {found}; expected {expected}, as of {first.name!r}")
    angles = np.stack([_periods(r.position, r).mean(axis=(0, 1)) for r in recordings])
    apart = np.abs(angles - angles[0]).max(axis=1)
    worst = int(np.argmax(apart))
    if apart[worst] > POSE_SPREAD:
        raise ValueError(
            f"recordings {first.name!r} and {recordings[worst].name!r} are {apart[worst]:.3g} rad apart in mean angle; "
            "one pose is expected: estimate each pose from its own recordings"
        )


def _without_mains(
    recordings: Sequence[Recording], near_hz: float, remarks: list[str]
) -> tuple[tuple[Recording, ...], list[float]]:
    """Recordings without mains, and the frequencies at which these repeat with the period and so stay."""
    clean, found = zip(*(without_mains(r, near_hz) for r in recordings), strict=True)
    told = [m for m in found if m.told]
    if told:
        hz = [m.hz for m in told]
        size = float(np.sqrt(np.mean([m.torque_amplitude**2 for m in told])))
        remarks.append(
            f"mains: {min(hz):.3f} to {max(hz):.3f} Hz, {size:.2g} N m of torque (root mean square amplitude), taken out"
        )
    struck = [m.hz for m in found if not m.told]
    if struck:
        remarks.append(
            f"mains: a whole number of cycles in the period in {len(struck)} of {len(found)} recordings; the line at "
            f"{np.median(struck):.4g} Hz is left out"
        )
    return clean, struck


def _excited_joints(joints: tuple[str, ...], waves: Sequence[Array] | None) -> tuple[str, ...]:
    if waves is None:
        return joints
    moved = np.max([np.ptp(x, axis=0) for x in waves], axis=0)
    return tuple(j for j, size in zip(joints, moved, strict=True) if size > USED * moved.max())


def _long_enough(recordings: Sequence[Recording], places: Sequence[Place], remarks: list[str]) -> list[Place]:
    """Places of the recordings that have as many periods as most: one that was cut short would cost all others theirs."""
    counts = {r.name: r.samples // (r.period_samples or r.samples) for r in recordings}
    usual = Counter(counts.values()).most_common(1)[0][0]
    short = {name: count for name, count in counts.items() if count < usual}
    remarks += [f"recording {name} has {count} of {usual} periods and is left out" for name, count in short.items()]
    return [p for p in places if p.recording not in short]


def _experiments(recordings: Sequence[Recording], places: Sequence[Place], remarks: list[str]) -> list[_SignedRuns]:
    """Those that were run with both signs; all where none was."""
    rows = {r.name: i for i, r in enumerate(recordings)}
    found: dict[tuple[int, int], dict[int, int]] = {}
    for p in places:
        if p.recording not in rows:
            raise ValueError(f"places name recording {p.recording!r}; there are {', '.join(list(rows)[:4])}, ...")
        found.setdefault((p.realisation, p.experiment), {})[p.sign] = rows[p.recording]
    every = [_SignedRuns(m, signs) for (m, _), signs in sorted(found.items())]
    pairs = [one for one in every if len(one.runs) == 2]
    if not pairs:
        remarks.append(
            "no experiment was run with both signs: the response to the references stays in the lines they share"
        )
        return every
    remarks += [
        f"realisation {one.realisation + 1}: {recordings[one.first].name} lacks the run of opposite sign and is left out"
        for one in every
        if len(one.runs) < 2
    ]
    return pairs


def _complete(experiments: list[_SignedRuns], joints: tuple[str, ...], remarks: list[str]) -> list[list[_SignedRuns]]:
    """Experiments of each realisation that has as many as the others, in one order."""
    inputs = len(joints)
    groups = [list(group) for _, group in groupby(experiments, key=lambda one: one.realisation)]
    expected = Counter(len(group) for group in groups).most_common(1)[0][0]
    complete = [group for group in groups if len(group) == expected]
    if expected < inputs:
        complete = [group for group in groups if len(group) == max(map(len, groups))]
        expected = len(complete[0])
    if expected < inputs:
        names = ", ".join(joints)
        raise ValueError(
            f"{expected} experiments a realisation for {inputs} joints ({names}); expected {inputs} or more, each with "
            "torques in another proportion"
        )
    for group in groups:
        if len(group) != expected:
            remarks.append(
                f"realisation {group[0].realisation + 1} has {len(group)} of {expected} experiments and is left out"
            )
    return complete


def estimate_accelerations(
    recordings: Sequence[Recording], response: MeasuredResponse, sensors: Sequence[Accelerometer]
) -> AccelerationResponse:
    """Accelerometers' signals over drive torque, from the recordings of a response and at its lines.

    As of the drives, ``A U^-1`` of each realisation, and their mean. The covariance of each channel's entries is that of the
    realisations' departures over the channel's size, averaged over as many neighbouring lines as it needs; errors of different
    channels are taken as independent.

    Raises
    ------
    ValueError
        A recording without these signals, or a single realisation.
    """
    rows = 3 * len(sensors)
    for r in recordings:
        if r.acceleration is None or r.acceleration.shape[1] != rows:
            raise ValueError(f"recording {r.name!r} has no {rows} columns of accelerometers")
    columns = [recordings[0].joints.index(j) for j in response.joints]
    groups = _complete(_experiments(recordings, _long_enough(recordings, response.places, []), []), response.joints, [])
    period = recordings[0].period_samples or 1
    lines = np.round(response.hz * period / recordings[0].sample_rate_hz).astype(int)
    used, shown = (  # (R, F, n or rows, E)
        np.moveaxis(_spectrum_of(recordings, groups, name, which).mean(axis=2)[:, :, lines], 1, 3)
        for name, which in (("torque", columns), ("acceleration", list(range(rows))))
    )
    single = shown @ np.linalg.pinv(used)
    realisations, count, inputs = len(single), len(lines), len(columns)
    if realisations < 2:
        raise ValueError("one realisation: how far accelerometers' responses are off cannot be told; record more")
    value = single.mean(axis=0)
    size = np.linalg.norm(value, axis=2, keepdims=True)
    apart = (single - value) / size
    own = np.einsum("rfjk,rfjl->fjkl", apart, apart.conj()) / (realisations * (realisations - 1))
    width = min(count, -(-PLENTY * inputs // (realisations - 1)))
    smooth = _over_lines(own, width)
    excess = np.einsum("fjkk->fj", own).real / np.einsum("fjkk->fj", smooth).real
    freedom = width * (realisations - 1)
    # the inverse of an estimated covariance is too large by this, on average
    grow = np.where(excess > OWN, excess, 1.0) * size[:, :, 0] ** 2 * freedom / max(freedom - inputs, 1)
    covariance = np.zeros((count, rows, inputs, rows, inputs), dtype=complex)
    each = np.arange(rows)
    covariance[:, each, :, each] = np.moveaxis(smooth * grow[:, :, None, None], 1, 0)
    return AccelerationResponse(
        response.hz,
        value,
        covariance.reshape(count, rows * inputs, -1),
        response.joints,
        response.pose,
        sensors=tuple(sensors),
    )


def _spectrum_of(
    recordings: Sequence[Recording], groups: list[list[_SignedRuns]], field: str, columns: list[int]
) -> ComplexArray:
    """Line amplitudes of some columns of a signal in every period, signs subtracted, (R, E, M, L, columns)."""
    used = {i for group in groups for one in group for i in one.runs.values()}
    count = min(recordings[i].samples // (recordings[i].period_samples or 1) for i in used)

    def spectrum(i: int) -> ComplexArray:
        wave = _periods(getattr(recordings[i], field)[:, columns], recordings[i])[:count]
        return np.asarray(np.fft.rfft(wave, axis=1) * (2.0 / wave.shape[1]))

    def difference(one: _SignedRuns) -> ComplexArray:
        return np.asarray(sum(sign * spectrum(i) for sign, i in one.runs.items()) / len(one.runs))

    return np.stack([[difference(one) for one in group] for group in groups])


def _lines(
    first: Recording,
    waves: Sequence[Array] | None,
    hz: Array | None,
    band_hz: tuple[float, float] | None,
    all_hz: Array,
    remarks: list[str],
) -> NDArray[np.intp]:
    """Places of the lines to use among all lines of the period."""
    step = all_hz[1]
    nyquist = 0.5 * first.sample_rate_hz
    if hz is None:
        if waves is None:
            raise ValueError(
                f"recording {first.name!r} has no feedforward_torque, which tells the excited lines; log it or give the "
                "references that were sent, or from Python the excited lines as `hz`"
            )
        size = np.max([np.abs(_spectrum_of_wave(x)).max(axis=1) for x in waves], axis=0)
        lines = np.flatnonzero(size > EXCITED * size.max())
    else:
        wanted = np.asarray(hz, dtype=float)
        number = np.round(wanted / step)
        off = wanted[np.abs(wanted / step - number) > 1e-3]
        if len(off):
            raise ValueError(f"hz: {off[0]:g} Hz is no multiple of {step:g} Hz, one over the period")
        lines = np.unique(number.astype(int))
    low, high = band_hz if band_hz is not None else (0.0, np.inf)
    kept = lines[(lines * step >= low - 1e-9) & (lines * step <= high + 1e-9)]
    beyond = kept[kept * step >= nyquist - 1e-9]
    if len(beyond):
        remarks.append(
            f"{len(beyond)} lines from {beyond[0] * step:g} Hz are at or beyond Nyquist ({nyquist:g} Hz) and left out"
        )
    elif nyquist <= high < np.inf:
        remarks.append(f"the band is asked for up to {high:g} Hz, and ends below Nyquist ({nyquist:g} Hz)")
    kept = kept[(kept > 0) & (kept * step < nyquist - 1e-9)]
    if len(kept) == 0:
        found = f"from {lines[0] * step:.4g} to {lines[-1] * step:.4g} Hz" if len(lines) else "nowhere"
        raise ValueError(
            f"no line is left between {low:g} and {high:g} Hz; excited lines lie {found}, Nyquist is {nyquist:g} Hz"
        )
    return kept


def _regular(
    u: ComplexArray, feedforward: ComplexArray | None, lines: NDArray[np.intp], all_hz: Array, remarks: list[str]
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Lines at which the experiments' torques are independent in every realisation, and which of the given they are."""
    mean = u.mean(axis=1)
    independent = _condition(mean) < WORST_CONDITION
    if feedforward is not None:
        independent &= _condition(np.moveaxis(feedforward, 1, 3)) < WORST_CONDITION
    periods, experiments = u.shape[1], u.shape[-1]
    if periods > 1:
        # a combination of torques that only noise keeps from zero does not count
        noise = np.sum(np.abs(u - mean[:, None]) ** 2, axis=(1, 3, 4)) / (periods - 1) / periods / experiments
        independent &= np.linalg.svd(mean, compute_uv=False)[..., -1] > CLEAR * np.sqrt(noise)
    kept = np.asarray(independent.all(axis=0))
    if not kept.any():
        raise ValueError("the experiments' torques are linearly dependent at every line; check the input matrix")
    if not kept.all():
        lost = ", ".join(f"{x:.4g}" for x in all_hz[lines[~kept]][:8]) + (", ..." if np.sum(~kept) > 8 else "")
        many = "1 line is" if np.sum(~kept) == 1 else f"{np.sum(~kept)} lines are"
        remarks.append(f"{many} left out, the experiments' torques are dependent there: {lost} Hz")
    return lines[kept], kept


def _condition(matrix: ComplexArray) -> Array:
    """Condition number with rows of norm one, so that units and amplitudes of joints do not count, (..., n, E) to (...)."""
    norm = np.linalg.norm(matrix, axis=-1, keepdims=True)
    values = np.linalg.svd(np.divide(matrix, norm, out=np.zeros_like(matrix), where=norm > 0), compute_uv=False)
    return np.asarray(values[..., 0] / np.maximum(values[..., -1], 1e-300))


def _line_spectra(torque: ComplexArray, acceleration: ComplexArray, lines: NDArray[np.intp], all_hz: Array) -> Spectra:
    kept = np.arange(1, len(all_hz) - 1)  # without the constant and Nyquist
    excited = np.isin(kept, lines)
    levels, noises = [], []
    for x in (torque[..., kept, :], acceleration[..., kept, :]):
        mean, count = x.mean(axis=2, keepdims=True), x.shape[2]
        noise = np.sum(np.abs(x - mean) ** 2, axis=2) / (count - 1) if count > 1 else np.full(x[:, :, 0].shape, np.nan)
        levels.append(np.sqrt(np.mean(np.abs(mean) ** 2, axis=(0, 1, 2))))
        noises.append(np.sqrt(noise.mean(axis=(0, 1))))
    return Spectra(all_hz[kept], excited, *levels, *noises)
