"""What a residual still depends on: a nonparametric measure with a permutation test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse, stats

from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import Segment

BINS = 12
SHUFFLES = 200
MOST_SAMPLES = 3000  # more do not change a score, and cost
SIGNIFICANCE = 0.01
STANDSTILL = "standstill"  # name of the signal "no joint moves"
REST = 1.0e-3  # of a joint's largest speed, below which it rests
SMALLEST_PART = 0.02  # of the samples, at rest or moving, for the other to be told apart
SMALLEST_SCORE = 0.05  # share of a residual's power; less is not worth a line in a report

FEWEST_CYCLES = 4.0  # over a joint's range, from which a curve of `BINS` bins no longer follows an order
HIGHEST_ORDER = 240.0  # as effects that are periodic in an angle have it
ORDER_SHUFFLES = 40
TOGETHER = 100  # orders that are worked out at once
BANDS = 10  # of equal width up to the low-pass
FREE_LINES = 0.5  # part of a spectrum's lines that are independent under Hann's window


@dataclass(frozen=True)
class Dependence:
    """A joint's residual depends on a signal.

    Attributes
    ----------
    joint : str
        Whose residual.
    signal : str
        What it depends on, as in ``joint_3 position`` or ``joint_3 order 18.2``.
    score : float
        Share of the residual's power that a free curve over the signal explains, 0 to 1, less what chance explains.
    p_value : float
        Of the score under shifts of the residual in time, corrected for the number of signals.
    """

    joint: str
    signal: str
    score: float
    p_value: float

    @property
    def order(self) -> float | None:
        """Cycles a turn of the joint itself, where that is what the residual repeats with."""
        _, _, order = self.signal.partition(f"{self.joint} order ")
        return float(order) if order else None


def dependences(data: Sequence[tuple[Regression, Array]], seed: int = 0) -> tuple[Dependence, ...]:
    """Signals that a residual depends on, strongest first.

    The score is the correlation ratio over bins of equal count, apart for each direction in which the joint moves (what
    friction does forward it undoes backward); its distribution under "no dependence" comes from shifting the
    residual in time, which keeps both signals' own correlation in time.

    Parameters
    ----------
    data : sequence of (Regression, array of shape (N, joints))
        Recordings with what a model leaves over on them.
    seed : int
        Of the shifts.
    """
    joints = data[0][0].joints
    residual = np.concatenate([r for _, r in data])
    rng = np.random.default_rng(seed)
    resting = np.concatenate([at_rest(regression) for regression, _ in data])
    moving = ~resting
    names = [name for name, _ in signals(data[0][0])]
    values = [np.concatenate(parts) for parts in zip(*([v for _, v in signals(r)] for r, _ in data), strict=True)]
    tests = len(joints) * len(names)
    found: list[Dependence] = []
    if SMALLEST_PART < resting.mean() < 1 - SMALLEST_PART:
        excess, chance = _excess(residual**2, resting, rng)
        # one question a joint, asked before and apart from the search through all signals
        found += _dependences(joints, STANDSTILL, excess, chance, (residual**2).sum(axis=0), len(joints))
    # at rest every signal has one value and friction any: what else depends on what shows in motion only
    if moving.sum() > 20 * BINS:
        every = max(1, int(moving.sum()) // MOST_SAMPLES)
        at = np.flatnonzero(moving)[::every]
        rest = residual[at]
        forward = [values[names.index(f"{joint} velocity")][at] > 0 for joint in joints]
        # a shift by s is the residual read at (i - s) modulo N
        back = (np.arange(len(rest))[:, None] - _shifts(len(rest), rng)) % len(rest)
        bins = [_bins(value[at]) for value in values]
        real, chance = np.empty((len(names), len(joints))), np.zeros((len(names), len(joints), SHUFFLES))
        for j in range(len(joints)):
            shifted, power = rest[back, j], float((rest[:, j] ** 2).sum())
            for i in range(len(names)):
                cells = _cells(2 * bins[i] + forward[j])
                real[i, j] = _explained(rest[:, j : j + 1], cells)[0]
                if real[i, j] > SMALLEST_SCORE * power:  # else it is not worth a line, whatever chance does
                    chance[i, j] = _explained(shifted, cells)
        for name, explained, by_chance in zip(names, real, chance, strict=True):
            found += _dependences(joints, name, explained, by_chance, (rest**2).sum(axis=0), tests)
        angles = [values[names.index(f"{joint} position")][at] for joint in joints]
        for j, joint in enumerate(joints):
            repeats = order_dependence(joint, rest[:, j], angles[j], len(joints), rng)
            found += [repeats] if repeats else []
    return tuple(sorted(found, key=lambda d: -d.score))


def order_dependence(joint: str, rest: Array, angle: Array, tests: int, rng: np.random.Generator) -> Dependence | None:
    """The order, cycles a turn of the joint itself, whose sine explains most of its residual (N,); None where chance does.

    The largest of many orders under shifts follows Gumbel's law, fitted by its moments.
    """
    span, power = float(np.ptp(angle)), float((rest**2).sum())
    orders = np.arange(2 * np.pi * FEWEST_CYCLES / max(span, 1e-9), HIGHEST_ORDER, np.pi / max(span, 1e-9))
    if len(orders) < 2 or power == 0.0:
        return None
    shifts = _shifts(len(rest), rng)[:ORDER_SHUFFLES]
    (highest,), (at,) = _most_explained(rest[:, None], angle, orders)
    if highest <= SMALLEST_SCORE * power:
        return None  # beyond chance it is less still
    chance = _most_explained(np.stack([np.roll(rest, s) for s in shifts], axis=1), angle, orders)[0] / power
    highest /= power
    scale = max(float(chance.std(ddof=1)) * np.sqrt(6.0) / np.pi, 1e-12)
    p_value = min(1.0, tests * float(stats.gumbel_r.sf(highest, chance.mean() - np.euler_gamma * scale, scale)))
    score = float(highest - chance.mean())
    found = p_value < SIGNIFICANCE and score > SMALLEST_SCORE
    return Dependence(joint, f"{joint} order {at:.1f}", score, p_value) if found else None


def _most_explained(residuals: Array, angle: Array, orders: Array) -> tuple[Array, Array]:
    """Power that the best of some orders, of equal distance, explains of each of residuals (N, k), and that order; each (k,)."""
    highest, at = np.zeros(residuals.shape[1]), np.zeros(residuals.shape[1])
    turn, onward = np.exp(1j * orders[0] * angle), np.exp(1j * (orders[1] - orders[0]) * angle)
    for part in np.array_split(orders, len(orders) // TOGETHER + 1):
        cosine, sine = np.empty((2, len(part), len(angle)))
        for k in range(len(part)):
            cosine[k], sine[k] = turn.real, turn.imag
            turn = turn * onward  # exact to 1e-13 after a thousand orders, in a tenth of the time of sine and cosine
        explained = 2.0 * ((cosine @ residuals) ** 2 + (sine @ residuals) ** 2) / len(angle)
        best = explained.argmax(axis=0)
        more = explained.max(axis=0)
        at = np.where(more > highest, part[best], at)
        highest = np.maximum(highest, more)
    return highest, at


@dataclass(frozen=True)
class Band:
    """A band of frequencies in which a joint's residual repeats with the motion: there the model lacks something.

    Attributes
    ----------
    joint : str
    low_hz, high_hz : float
    score : float
        Share of the residual's power that repeats in this band, less what noise adds.
    p_value : float
        That only noise is there, corrected for the number of bands and joints.
    """

    joint: str
    low_hz: float
    high_hz: float
    score: float
    p_value: float


def bands(data: Sequence[tuple[Regression, Array]]) -> tuple[Band, ...]:
    """Bands in which residuals repeat from period to period beyond what differs between periods (an F-test each).

    Only recordings of two or more whole periods tell; neighbouring bands are put together. Strongest first.

    Parameters
    ----------
    data : sequence of (Regression, array of shape (N, joints))
    """
    joints = data[0][0].joints
    segments = [s for regression, _ in data for s in regression.segments]
    residuals = [left[span] for regression, left in data for span in regression.spans]
    top = min(s.cutoff_hz or s.rate_hz / 2 for s in segments)
    edges = np.linspace(0.0, top, BANDS + 1)
    repeated, noise, whole = (np.zeros((BANDS, len(joints))) for _ in range(3))
    above, below = np.zeros(BANDS), np.zeros(BANDS)  # degrees of freedom
    for segment, left in zip(segments, residuals, strict=True):
        samples = _period_samples(segment)
        if samples is None:
            continue
        # a fit leaves out both ends, so the last period is seldom whole
        count = max(2, len(left) // samples)
        long = min(samples, len(left) - (count - 1) * samples)
        if long < samples / 2:
            continue
        parts = np.stack([left[k * samples : k * samples + long] for k in range(count)])
        spectra = np.fft.rfft(parts * np.hanning(long)[:, None], axis=1)
        mean = spectra.mean(axis=0)
        band = np.digitize(np.fft.rfftfreq(long, 1 / segment.rate_hz), edges) - 1
        for b in range(BANDS):
            at = (band == b) & (np.arange(len(band)) > 0)
            repeated[b] += count * (np.abs(mean[at]) ** 2).sum(axis=0)
            noise[b] += (np.abs(spectra[:, at] - mean[at]) ** 2).sum(axis=(0, 1)) / (count - 1)
            whole[b] += (np.abs(spectra[:, at]) ** 2).sum(axis=(0, 1))
            above[b] += FREE_LINES * 2 * at.sum()
            below[b] += FREE_LINES * 2 * at.sum() * (count - 1)
    out: list[Band] = []
    for j, joint in enumerate(joints):
        p = stats.f.sf(repeated[:, j] / np.maximum(noise[:, j], 1e-300), np.maximum(above, 1), np.maximum(below, 1))
        p = np.where(above > 0, np.minimum(1.0, p * BANDS * len(joints)), 1.0)
        score = np.maximum(repeated[:, j] - noise[:, j], 0.0) / max(whole[:, j].sum(), 1e-300)
        loud = np.flatnonzero((p < SIGNIFICANCE) & (score > SMALLEST_SCORE / 2))
        for run in np.split(loud, np.flatnonzero(np.diff(loud) > 1) + 1):
            if len(run) and score[run].sum() > SMALLEST_SCORE:
                low, high = float(edges[run[0]]), float(edges[run[-1] + 1])
                out.append(Band(joint, low, high, float(score[run].sum()), float(p[run].min())))
    return tuple(sorted(out, key=lambda b: -b.score))


def _period_samples(segment: Segment) -> int | None:
    """Samples of the fit in a period; None where it does not repeat, or not on a whole number of them."""
    if segment.recording.period_s is None:
        return None
    samples = segment.recording.period_s * segment.rate_hz
    return round(samples) if abs(samples - round(samples)) < 1e-6 * samples else None


def _bins(value: Array) -> Indices:
    """Which of the bins of equal count each sample falls into, shape (N,)."""
    rank = np.empty(len(value), dtype=np.intp)
    rank[np.argsort(value, kind="stable")] = np.arange(len(value))
    return rank * BINS // len(value)


def _cells(cell: Indices) -> sparse.csr_array:
    """Ones where a sample is in a cell, (cells, N), for the cells that hold any."""
    counts = np.bincount(cell)
    order = np.argsort(cell.astype(np.int16), kind="stable")
    ends = np.cumsum(counts[counts > 0])
    return sparse.csr_array((np.ones(len(cell)), order, np.r_[0, ends]), shape=(len(ends), len(cell)))


def _shifts(samples: int, rng: np.random.Generator) -> Indices:
    return rng.integers(samples // 20 + 1, samples - samples // 20, SHUFFLES)


def _excess(power: Array, mask: Mask, rng: np.random.Generator) -> tuple[Array, Array]:
    """Power in part of the samples beyond the mean elsewhere: (joints,), and (joints, shuffles) for shifted masks."""

    def beyond(at: Mask) -> Array:
        return np.asarray(power[at].sum(axis=0) - at.sum() * power[~at].mean(axis=0))

    return beyond(mask), np.stack([beyond(np.roll(mask, s)) for s in _shifts(len(mask), rng)], axis=1)


def _dependences(
    joints: Sequence[str], signal: str, real: Array, chance: Array, power: Array, tests: int
) -> list[Dependence]:
    """Scores of one signal for each joint, where they are significant and worth a line."""
    out = []
    mean, std = chance.mean(axis=1), chance.std(axis=1)
    for j, joint in enumerate(joints):
        if power[j] == 0:
            continue
        # with a mask, chance draws the rest of the recording: its mean is no level that the score starts from
        score = (real[j] - (mean[j] if signal != STANDSTILL else 0.0)) / power[j]
        beyond = int((chance[j] >= real[j]).sum())
        p_value = (beyond + 1) / (SHUFFLES + 1)
        # shuffles are too few for a corrected p-value: beyond them a normal tail stands in
        if beyond == 0 and std[j] > 0:
            p_value = min(p_value, float(np.exp(-0.5 * ((real[j] - mean[j]) / std[j]) ** 2)))
        p_value = min(1.0, p_value * tests)
        if p_value < SIGNIFICANCE and score > SMALLEST_SCORE:
            out.append(Dependence(joint, signal, float(score), p_value))
    return out


def at_rest(regression: Regression) -> Mask:
    """Samples of the fit at which no joint moves, shape (N,), bool."""
    speed = [np.abs(s.motion.v[:: s.factor][s.kept]) for s in regression.segments]
    fastest = np.max([v.max(axis=0) for v in speed], axis=0)
    return np.concatenate([(v <= REST * np.maximum(fastest, 1e-12)).all(axis=1) for v in speed])


def _explained(residual: Array, cells: sparse.csr_array) -> Array:
    """Power of the means of residuals (N, k) over the samples of each cell, shape (k,)."""
    sums = cells @ residual
    power: Array = (sums**2 / np.diff(cells.indptr)[:, None]).sum(axis=0)
    return power


def signals(regression: Regression) -> Sequence[tuple[str, Array]]:
    """Signals that a residual may depend on: motion of every joint and time in the recording, at the fit's samples."""
    out: list[tuple[str, Array]] = []
    for joint in regression.joints:
        column = regression.robot.layout.index(joint)
        for name in ("position", "velocity", "acceleration"):
            values = [getattr(s.motion, name[0] if name[0] != "p" else "q") for s in regression.segments]
            thinned = [v[:: s.factor][s.kept][:, column] for v, s in zip(values, regression.segments, strict=True)]
            out.append((f"{joint} {name}", np.concatenate(thinned)))
    time = [s.motion.time[:: s.factor][s.kept] for s in regression.segments]
    out.append(("time", np.concatenate(time)))
    return out
