"""Low-pass, differentiate and resample sampled signals, along axis 0 and without phase shift."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal
from scipy.interpolate import CubicSpline

from rx90b_flex.compiled.signals import forward_and_backward
from rx90b_flex.pieces import AT_ONCE, Array, in_pieces

ORDER = 4  # of one pass of the low-pass
# The filter's response to an impulse counts as over when its slowest part has fallen to this.
_IMPULSE_END = 1e-3
RINGS = 5  # times the length of that response, after which nothing is left of an end
# FIR of `resample`: attenuation in dB and the band, as fractions of the lower Nyquist frequency.
_RESAMPLE_ATTENUATION_DB = 100.0
_RESAMPLE_PASS = 0.8
# `noise_cutoff_hz`: a spectrum this many times the noise floor is signal; noise that adds less than this part
# to the acceleration does not matter.
ACCURACY = 8  # order of the differences of a motion
FEWEST_OF_QUARTIC = 8  # samples that a continuation goes through
# samples and degree of continuations where there is no low-pass, the last as off-centre differences have it
PLAIN = ((34, 4), (24, 4), (16, 4), (11, 4), (8, 4), (ACCURACY + 2, ACCURACY + 1))
FORETOLD = 8  # times that a continuation is tried on samples that are known
FEWEST_SAMPLES = 64  # that noise can be told from motion in
_SIGNAL_OVER_FLOOR = 4.0
_NEGLIGIBLE_NOISE = 1e-3


class FilteredMotion(NamedTuple):
    """Position, velocity and acceleration, each (N, ...) in rad, rad/s and rad/s²."""

    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, eq=False)
class _Butterworth:
    sections: Array
    padding: int
    steady: Array  # the sections' state after an endless row of ones, (sections, 2)


def lowpass(x: ArrayLike, cutoff_hz: float, sample_rate_hz: float) -> Array:
    """Zero-phase Butterworth low-pass of fourth order: second-order sections, run forward and backward.

    Each pass has 1/√2 at the cutoff, so the result has 1/2 there: the gain is 1 / (1 + (f/cutoff)^8) far
    below Nyquist. The ends are continued by odd reflection (value and slope go on) over the length in which the
    filter's impulse response falls to 1/1000, each section starting in its steady state.

    Parameters
    ----------
    x : (N, ...) samples.
    cutoff_hz : 0 < cutoff_hz < sample_rate_hz / 2.

    Returns
    -------
    (N, ...) float64.

    Raises
    ------
    ValueError
        Cutoff out of range, samples that are not finite, or fewer than `minimum_samples`.
    """
    samples = _samples(x)
    filter_ = _butterworth(float(cutoff_hz), float(sample_rate_hz))
    if len(samples) <= filter_.padding:
        raise ValueError(
            f"{len(samples)} samples are too few for a low-pass of {cutoff_hz:g} Hz at {sample_rate_hz:g} Hz: "
            f"{filter_.padding + 1} or more are needed"
        )
    # as `scipy.signal.sosfiltfilt` does it, but that works the steady state out anew for every call
    columns, beside = np.ascontiguousarray(samples.reshape(len(samples), -1)), RINGS * filter_.padding

    def filtered(x: Array) -> Array:
        return forward_and_backward(x, filter_.sections, filter_.steady, filter_.padding)

    return in_pieces(filtered, columns, beside, max(AT_ONCE, beside)).reshape(samples.shape)


def minimum_samples(cutoff_hz: float, sample_rate_hz: float) -> int:
    """Shortest signal that `lowpass` takes: one sample more than the filter's impulse response is long."""
    return _butterworth(float(cutoff_hz), float(sample_rate_hz)).padding + 1


def difference_weights(offsets: ArrayLike, derivative: int) -> Array:
    """Weights w with sum(w_i f(offset_i)) = the derivative of f at 0, for unit steps.

    Exact for polynomials of degree up to len(offsets) - 1. B. Fornberg, *Generation of finite difference formulas on
    arbitrarily spaced grids*, Math. Comp. 51 (1988).

    Parameters
    ----------
    offsets : (k,) distinct points, in steps.
    derivative : 0 ... k - 1.
    """
    points = np.asarray(offsets, dtype=np.float64)
    if points.ndim != 1 or len(np.unique(points)) != len(points) or not 0 <= derivative < len(points):
        raise ValueError(f"{derivative}th derivative from offsets {points.tolist()}: need more, and distinct, points")
    weights = np.zeros((len(points), derivative + 1))
    weights[0, 0] = 1.0
    product = 1.0
    for i in range(1, len(points)):
        new_product = 1.0
        for j in range(i):
            gap = points[i] - points[j]
            new_product *= gap
            if j == i - 1:
                for m in range(derivative, -1, -1):
                    lower = m * weights[i - 1, m - 1] if m else 0.0
                    weights[i, m] = product * (lower - points[i - 1] * weights[i - 1, m]) / new_product
            for m in range(derivative, -1, -1):
                lower = m * weights[j, m - 1] if m else 0.0
                weights[j, m] = (points[i] * weights[j, m] - lower) / gap
        product = new_product
    return weights[:, derivative]


def differentiate(x: ArrayLike, sample_rate_hz: float, accuracy: int = 8, derivative: int = 1) -> Array:
    """Central differences along axis 0 (thesis section 4.2.2: eighth order), of the same order up to the ends.

    Inside, 2·((derivative + 1)//2) - 1 + accuracy points about each sample; at either end as many or one more,
    off-centre, so that the order is kept. Exact for polynomials of degree up to accuracy + derivative - 1.
    The off-centre weights are large: noise in the first and last accuracy/2 samples is amplified more than inside.

    Parameters
    ----------
    x : (N, ...) samples.
    accuracy : even order of accuracy in the sample period.
    derivative : 1 or 2.

    Returns
    -------
    (N, ...) in units of x per s, or per s².

    Raises
    ------
    ValueError
        Fewer than accuracy + derivative samples, odd accuracy, samples that are not finite.
    """
    samples = _samples(x)
    rate = _rate(sample_rate_hz)
    if accuracy < 2 or accuracy % 2:
        raise ValueError(f"accuracy = {accuracy}: an even number of 2 or more is expected")
    if derivative not in (1, 2):
        raise ValueError(f"derivative = {derivative}: 1 or 2 is expected")
    half = accuracy // 2
    skewed = accuracy + derivative
    count = len(samples)
    if count < skewed:
        raise ValueError(f"{count} samples are too few for a difference of order {accuracy}: {skewed} are needed")
    central = difference_weights(np.arange(-half, half + 1), derivative)
    result = np.zeros_like(samples)
    inside = result[half : count - half]
    for shift, weight in enumerate(central):
        inside += weight * samples[shift : count - 2 * half + shift]
    for row in range(half):
        weights = difference_weights(np.arange(skewed) - row, derivative)
        result[row] = np.tensordot(weights, samples[:skewed], axes=1)
        mirrored = weights[::-1] if derivative == 2 else -weights[::-1]
        result[count - 1 - row] = np.tensordot(mirrored, samples[count - skewed :], axes=1)
    result *= rate**derivative
    return result


def motion(position: ArrayLike, sample_rate_hz: float, cutoff_hz: float | None = None) -> FilteredMotion:
    """Position, velocity and acceleration from logged positions.

    Low-pass (if a cutoff is given), then eighth-order differences. The acceleration is one second difference of the
    position, not the velocity differentiated again: its relative error is ω⁸/3150 against 2·ω⁸/630 (ω in rad a sample),
    ten times flatter, and its end effects reach half as far. In exchange it does not suppress noise
    near Nyquist, which is the low-pass's task.

    Parameters
    ----------
    position : (N, n) rad.
    cutoff_hz : cutoff of `lowpass`, or None for no filter.

    Raises
    ------
    ValueError
        As `lowpass` and `differentiate`.
    """
    position = _samples(position)
    if cutoff_hz is None:
        margin = ACCURACY // 2
        q = _continued(position, margin, margin, PLAIN) if len(position) > 2 * ACCURACY else position.copy()
        margin = (len(q) - len(position)) // 2
    else:
        margin = minimum_samples(cutoff_hz, sample_rate_hz)
        if len(position) < margin:
            lowpass(position, cutoff_hz, sample_rate_hz)  # refuses, and says why
        ahead = math.ceil(sample_rate_hz / (2.0 * cutoff_hz))
        q = lowpass(_continued(position, margin, ahead, _spans(margin)), cutoff_hz, sample_rate_hz)
    inside = slice(margin, len(q) - margin)
    return FilteredMotion(
        q[inside],
        differentiate(q, sample_rate_hz, ACCURACY)[inside],
        differentiate(q, sample_rate_hz, ACCURACY, derivative=2)[inside],
    )


def _continued(position: Array, margin: int, ahead: int, ways: Sequence[tuple[int, int]]) -> Array:
    """Positions continued by `margin` samples at both ends, each by the polynomial through its last samples that foretells best.

    A reflection has no acceleration at the end, and off-centre differences amplify noise; a fitted polynomial keeps the
    acceleration that the motion has there and how it changes. Through many samples it amplifies noise no more than the inside
    does, but cannot follow a motion that turns within them: which of the `ways` (samples, degree) serves is told by the samples
    before the end, which are foretold `ahead` samples at a time from those before them.
    """
    before = _beyond(position[::-1], margin, ahead, ways)[::-1]
    return np.concatenate([before, position, _beyond(position, margin, ahead, ways)])


def _beyond(position: Array, margin: int, ahead: int, ways: Sequence[tuple[int, int]]) -> Array:
    """What comes after the last sample, (margin, ...)."""
    samples = position.reshape(len(position), -1)
    ways = [way for way in ways if way[0] + 2 * ahead <= len(samples)] or [ways[-1]]
    scores = [_foretold(samples, way, ahead) for way in ways] if len(ways) > 1 else [np.zeros(samples.shape[1])]
    out = np.empty((margin, samples.shape[1]))
    for column, best in enumerate(np.argmin(scores, axis=0)):
        span, degree = ways[best]
        further = min(span, margin)
        longer = np.r_[samples[:, column], _polynomial(span, degree, further) @ samples[-span:, column]]
        # as far ahead as it was fitted; then by odd reflection
        rest = np.arange(margin - further)
        out[:further, column] = longer[len(samples) :]
        out[further:, column] = 2.0 * longer[-1] - longer[len(longer) - 2 - rest]
    return out.reshape(margin, *position.shape[1:])


def _spans(margin: int) -> list[tuple[int, int]]:
    """Numbers of samples through which a quartic may go, the largest first, each with its degree."""
    out = [margin]
    while 0.7 * out[-1] >= FEWEST_OF_QUARTIC:
        out.append(int(0.7 * out[-1]))
    return [(span, 4) for span in out]


def _foretold(samples: Array, way: tuple[int, int], ahead: int) -> Array:
    """Squared error of each column, where samples near the end are foretold from those before them."""
    span, degree = way
    weights = _polynomial(span, degree, ahead)
    earlier = np.unique(np.linspace(0, min(2 * ahead, len(samples) - ahead - span), FORETOLD).astype(int))
    ends = len(samples) - ahead - earlier
    error = [weights @ samples[end - span : end] - samples[end : end + ahead] for end in ends]
    return np.asarray(np.square(error).sum(axis=(0, 1)) / len(ends))


@functools.cache
def _polynomial(span: int, degree: int, ahead: int) -> Array:
    """Weights (ahead, span) of samples in the values of the polynomial that fits them best, at the samples after them."""
    t = np.linspace(-1.0, 1.0, span)
    later = 1.0 + (1 + np.arange(ahead)) * (t[1] - t[0])
    fitted, after = (np.polynomial.chebyshev.chebvander(x, degree) for x in (t, later))
    return np.asarray(after @ np.linalg.pinv(fitted))


def decimation_factor(cutoff_hz: float, sample_rate_hz: float, margin: float = 4.0) -> int:
    """Largest whole factor that leaves the new Nyquist frequency at `margin` times the cutoff or above; at least 1.

    With the default margin, what `lowpass` leaves beyond the new Nyquist frequency is below 2e-5 of what was
    there, so that `x[::factor]` of a filtered signal needs no further filter.
    """
    if not cutoff_hz > 0.0 or not margin >= 1.0:
        raise ValueError(f"cutoff_hz = {cutoff_hz:g}, margin = {margin:g}: expected above 0, and 1 or more")
    # the small term keeps an exact ratio from falling below its whole number by rounding
    return max(1, math.floor(_rate(sample_rate_hz) / (2.0 * margin * cutoff_hz) * (1.0 + 1e-12)))


def resample(x: ArrayLike, rate_from: float, rate_to: float) -> Array:
    """Change the sample rate without phase shift and without aliasing.

    A linear-phase FIR low-pass (Kaiser, 100 dB) run as polyphase; it passes 0.8 and stops 1.0 of the lower of
    the two Nyquist frequencies. Sample 0 stays at its time: for a whole factor, a signal inside the pass band gives
    `x[::factor]` to 1e-5. The ends are continued by odd reflection over half the filter's length.

    Parameters
    ----------
    x : (N, ...) samples at `rate_from`.
    rate_from, rate_to : Hz; their ratio must be a fraction with terms up to 1000.

    Returns
    -------
    (ceil(N · rate_to / rate_from), ...).

    Raises
    ------
    ValueError
        A ratio that is no such fraction, or a signal shorter than half the filter.
    """
    samples = _samples(x)
    ratio = _rate(rate_to) / _rate(rate_from)
    fraction = Fraction(ratio).limit_denominator(1000)
    up, down = fraction.numerator, fraction.denominator
    if not 0 < up <= 1000 or abs(up / down / ratio - 1.0) > 1e-9:
        raise ValueError(
            f"resampling from {rate_from:g} to {rate_to:g} Hz: the ratio is no fraction of whole numbers up to 1000"
        )
    if up == down:
        return samples.copy()
    widest = max(up, down)
    taps, beta = signal.kaiserord(_RESAMPLE_ATTENUATION_DB, (1.0 - _RESAMPLE_PASS) / widest)
    half = math.ceil(taps / 2 / down) * down  # in upsampled samples; a whole number of output samples
    fir = signal.firwin(2 * half + 1, 0.5 * (1.0 + _RESAMPLE_PASS) / widest, window=("kaiser", beta))
    # a whole number of outputs, and of filter halves, is added before the first sample
    padding = math.ceil(half / up / down) * down
    count = len(samples)
    if count <= padding:
        raise ValueError(
            f"{count} samples are too few to resample from {rate_from:g} to {rate_to:g} Hz: {padding + 1} are needed"
        )
    before = 2.0 * samples[0] - samples[padding:0:-1]
    after = 2.0 * samples[-1] - samples[-2 : -2 - padding : -1]
    padded = np.concatenate([before, samples, after])
    resampled = signal.resample_poly(padded, up, down, axis=0, window=fir)
    first = padding * up // down
    return np.asarray(resampled[first : first + math.ceil(count * up / down)])


def noise_cutoff_hz(position: ArrayLike, sample_rate_hz: float) -> float | None:
    """Cutoff of `lowpass` that best serves the acceleration, from the measured positions alone.

    The noise is taken as white, its floor the median of the position spectrum between 0.5 and 0.9 of Nyquist. Where
    the smoothed spectrum exceeds the floor four times, the excess S is signal. With G the gain of `lowpass` and N the
    floor, the cutoff minimises the acceleration's expected error

        ∫ ω⁴ [ (1 - G)² S + G² N ] dω,

    summed over the moving joints, each over its own signal ∫ ω⁴ S dω. Above the highest frequency at which the signal
    stands out there is only noise to remove; how far above the cutoff lies depends on how strong the signal is there.
    The spectra are taken from second differences, which keep slow motion from leaking over the noise.

    Parameters
    ----------
    position : (N,) or (N, n).

    Returns
    -------
    Hz, or None where no noise is visible: the spectrum still falls near Nyquist, or the noise would add less than
    1/1000 to the acceleration unfiltered (simulation without noise).

    Raises
    ------
    ValueError
        Fewer than 64 samples: no spectrum worth the name. Below 256 it is a rough one.
    """
    samples = _samples(position)
    rate = _rate(sample_rate_hz)
    samples = samples.reshape(len(samples), -1)
    if len(samples) < FEWEST_SAMPLES:
        raise ValueError(f"{len(samples)} samples are too few to tell noise from motion: {FEWEST_SAMPLES} are needed")
    hz, spectrum = _position_spectrum(samples, rate)
    top = spectrum[(hz > 0.25 * rate) & (hz < 0.45 * rate)]
    lower, upper = np.array_split(top, 2)
    floor = np.median(top, axis=0)
    white = np.median(lower, axis=0) < 2.0 * np.median(upper, axis=0)

    # five bins are averaged before the comparison with the floor; the integral takes the excess bin by bin
    smooth = signal.convolve(np.pad(spectrum, ((2, 2), (0, 0)), mode="edge"), np.full((5, 1), 0.2), mode="valid")
    excess = np.where(smooth > _SIGNAL_OVER_FLOOR * floor, np.maximum(spectrum - floor, 0.0), 0.0)
    weight = hz[:, None] ** 4
    signal_power = np.sum(weight * excess, axis=0)
    noise_power = np.sum(weight * floor, axis=0)
    matters = white & (floor > 0.0) & (noise_power > _NEGLIGIBLE_NOISE**2 * signal_power)
    if not np.any(matters):
        return None
    moving = matters & (signal_power > 0.0)
    if not np.any(moving):
        return float(hz[0])  # noise alone: nothing to keep
    excess, floor, signal_power = excess[:, moving], floor[moving], signal_power[moving]

    candidates = np.geomspace(hz[0], 0.45 * rate, 400)
    # bilinear transform: the digital Butterworth's gain goes by tan(π f / rate)
    warped = np.tan(np.pi * hz / rate) / np.tan(np.pi * candidates[:, None] / rate)
    gain = 1.0 / (1.0 + warped ** (2 * ORDER))
    lost = ((1.0 - gain) ** 2 * weight.T) @ (excess / signal_power)
    passed = (gain**2 * weight.T) @ np.tile(floor / signal_power, (len(hz), 1))
    return float(candidates[np.argmin(np.sum(lost + passed, axis=1))])


def _position_spectrum(samples: Array, rate: float) -> tuple[Array, Array]:
    """Frequencies (bins,) between 0 and Nyquist and the density of each column (bins, n), by second differences."""
    shortest = min(128, 2 ** int(math.log2(len(samples) / 2)))
    length = min(max(shortest, 2 ** int(math.log2(len(samples) / 8))), 8192)
    hz, spectrum = signal.welch(np.diff(samples, 2, axis=0), rate, nperseg=length, detrend=False, axis=0)
    # bin 0 carries no shape, the last (Nyquist) only half the power
    hz, spectrum = hz[1:-1], spectrum[1:-1]
    difference_gain = (2.0 * np.sin(np.pi * hz / rate)) ** 4
    return hz, spectrum / difference_gain[:, None]


def half_a_sample_off(x: Array) -> tuple[Array, Array]:
    """A signal (N, n) half a sample before and after, by cubic splines."""
    at = np.arange(len(x))
    splines = [CubicSpline(at, column) for column in x.T]
    before, after = (np.stack([s(at + off) for s in splines], axis=1) for off in (-0.5, 0.5))
    return before, after


def periods(x: ArrayLike, period_samples: int) -> Array:
    """Whole periods from the start of `x`: (N, ...) becomes (N // period_samples, period_samples, ...).

    Samples after the last whole period are left out. ValueError where there is not one whole period.
    """
    samples = np.asarray(x, dtype=np.float64)
    if period_samples < 1 or samples.ndim < 1 or len(samples) < period_samples:
        count = len(samples) if samples.ndim else 0
        raise ValueError(f"{count} samples hold no whole period of {period_samples} samples")
    count = len(samples) // period_samples
    return samples[: count * period_samples].reshape(count, period_samples, *samples.shape[1:])


@functools.lru_cache(maxsize=64)
def _butterworth(cutoff_hz: float, sample_rate_hz: float) -> _Butterworth:
    _rate(sample_rate_hz)
    if not 0.0 < cutoff_hz < 0.5 * sample_rate_hz:
        raise ValueError(
            f"cutoff {cutoff_hz:g} Hz: must lie between 0 and half the sample rate, {0.5 * sample_rate_hz:g} Hz"
        )
    sections = signal.butter(ORDER, cutoff_hz, fs=sample_rate_hz, output="sos")
    _, poles, _ = signal.butter(ORDER, cutoff_hz, fs=sample_rate_hz, output="zpk")
    slowest = float(np.max(np.abs(poles)))
    # a pole at zero dies in one sample; never fewer than the samples the sections hold
    length = math.ceil(math.log(_IMPULSE_END) / math.log(slowest)) if slowest > 0.0 else 1
    steady = signal.sosfilt_zi(sections)
    return _Butterworth(np.asarray(sections), max(length, 3 * (ORDER + 1)), steady)


def _rate(sample_rate_hz: float) -> float:
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0):
        raise ValueError(f"sample rate {sample_rate_hz!r} Hz: a number above 0 is expected")
    return float(sample_rate_hz)


def _samples(x: ArrayLike) -> Array:
    samples = np.asarray(x, dtype=np.float64)
    if samples.ndim < 1 or len(samples) == 0:
        raise ValueError(f"array of shape {samples.shape}: samples along axis 0 are expected")
    if not np.all(np.isfinite(samples)):
        raise ValueError(f"sample {int(np.argwhere(~np.isfinite(samples))[0][0])} is not finite")
    return samples
