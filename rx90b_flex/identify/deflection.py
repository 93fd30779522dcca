"""Torsion of gears from second encoders: the angle behind a gear less the motor's, over the torque that passes the gear."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import stats
from scipy.interpolate import CubicSpline

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.identify.coloured import absorbed_by_fit, residual_spectrum, widening
from rx90b_flex.identify.least_squares import CORRELATION_S
from rx90b_flex.identify.linear_fit import LinearFit, weighted_mean
from rx90b_flex.signals import Recording, decimation_factor, lowpass, motion

# Of the fastest velocity; below, dry friction may have any value and the torque through the gear is not known.
SLOWEST = 0.03
ALIKE_S = 0.5  # over which errors of a model are alike
SLOW_FRICTION = 0.1  # of the fastest velocity, below which friction near rest is one of its own
REVERSAL_PERIODS = 0.5  # of the low-pass, around a reversal, in which the sign of the velocity is smeared
EDGE_PERIODS = 1.0  # of the low-pass, left out at both ends
FEWEST_CYCLES = 3.0  # of a periodic position error over the range of angles; slower ones look like the load
MOST_ORDERS = 6  # periodic position errors of one encoder pair in one recording
ORDER_SIGNIFICANCE = 1.0e-3  # of a periodic position error, corrected for all orders
RING_ERROR = 2.0e-4  # rad, of a ring's errors once and twice a turn: one of 0.1 m radius that sits 0.02 mm off its axis
# Standard deviations by which the model's torque must stand out beside friction, inertia and position errors.
WEAKEST = 4.0
LAWFUL = 3.0  # standard deviations above zero at which an inertia needs no help to be positive
ROUNDS = 5  # of reading the second encoder earlier by what the fit before found
BLOCKS = 8  # to hold out in turn, at the least
FEWEST_PER_BLOCK = 8  # samples
LOAD = ("torque", "acceleration")
BASE = ("remainder", "velocity", "direction", "slow_direction")


@dataclass(frozen=True, eq=False)
class GearRun:
    """One gear in one recording: low-passed, thinned, its second encoder read `lag_s` earlier. Arrays are (N,).

    Attributes
    ----------
    name, role : of the recording.
    time : s.
    rate_hz : of the thinned samples.
    cutoff_hz : of the low-pass.
    angle, velocity, acceleration : of the motor, joint side; rad, rad/s, rad/s^2.
    measured : torque of the motor, joint side, N m.
    torque : what a model of the whole robot asks of the drive, without friction, N m; the measured one where there is no model.
    remainder : measured torque less all that the model holds, N m: friction of its own accord, or load that the model lacks.
    deflection : link less motor, rad.
    used : rows where the joint surely moves, away from reversals and ends.
    """

    name: str
    role: str
    time: Array
    rate_hz: float
    cutoff_hz: float
    angle: Array
    velocity: Array
    acceleration: Array
    measured: Array
    torque: Array
    remainder: Array
    deflection: Array
    used: Mask

    @cached_property
    def direction(self) -> Array:
        """Sign of the velocity."""
        return np.sign(self.velocity)

    @cached_property
    def slow_direction(self) -> Array:
        """The same where the joint is slow: friction near rest is another than in motion (Stribeck, presliding)."""
        slow = SLOW_FRICTION * max(float(np.abs(self.velocity).max()), 1e-12)
        return np.asarray(self.direction * np.exp(-np.abs(self.velocity) / slow))

    def columns(self, names: Sequence[str]) -> Array:
        """Signals by their names, (N, k): the columns that all recordings share."""
        return np.column_stack([getattr(self, name) for name in names])


def gear_run(
    recording: Recording, joint: str, cutoff_hz: float, lag_s: float = 0.0, model: Array | None = None
) -> GearRun:
    """The rows of one gear in a recording with second encoders.

    Parameters
    ----------
    recording : Recording
    joint : str
    cutoff_hz, lag_s : float
        Of the low-pass, and by which the second encoder is read earlier.
    model : array, shape (N, 2), optional
        The joint's torque without friction, and whole, as a model has it; N m.

    Raises
    ------
    ValueError
        The recording has no second encoders, or is shorter than the filter.
    """
    place, rate = recording.joints.index(joint), recording.sample_rate_hz
    if recording.link_position is None:
        raise ValueError(f"{recording.source or recording.name}: no link_position; second encoders are expected")
    moved = motion(recording.position[:, place], rate, cutoff_hz)
    torque = recording.torque[:, place]
    known = np.column_stack([torque, torque]) if model is None else model
    slow = lowpass(np.column_stack([recording.link_position[:, place], torque, known]), cutoff_hz, rate)
    clock = np.arange(recording.samples) / rate
    link = CubicSpline(clock, slow[:, 0])(np.clip(clock + lag_s, 0.0, clock[-1]))
    used = np.abs(moved.velocity) > SLOWEST * max(float(np.abs(moved.velocity).max()), 1e-12)
    around = round(REVERSAL_PERIODS / cutoff_hz * rate)
    for k in np.flatnonzero(np.diff(np.sign(moved.velocity)) != 0.0):
        used[max(0, k + 1 - around) : k + 1 + around] = False
    edge = max(1, round(EDGE_PERIODS / cutoff_hz * rate))
    used[:edge] = used[-edge:] = False
    every = slice(None, None, decimation_factor(cutoff_hz, rate, 2.0))
    return GearRun(
        recording.name,
        recording.role,
        recording.time[every],
        rate / (every.step or 1),
        cutoff_hz,
        moved.position[every],
        moved.velocity[every],
        moved.acceleration[every],
        slow[every, 1],
        slow[every, 2],
        (slow[:, 1] - slow[:, 3])[every],
        (link - moved.position)[every],
        used[every],
    )


def encoder_ratio(recordings: Sequence[Recording], joint: str) -> tuple[float, float]:
    """Slope of the second encoder over the motor's angle, and the largest difference between them beyond a constant, rad.

    A difference of exactly zero says that the second column repeats the first.
    """
    above = below = widest = 0.0
    for recording in recordings:
        place = recording.joints.index(joint)
        assert recording.link_position is not None
        angle, link = (x[:, place] - x[:, place].mean() for x in (recording.position, recording.link_position))
        above, below = above + float(angle @ link), below + float(angle @ angle)
        widest = max(widest, float(np.ptp(link - angle)))
    return (above / below if below > 0.0 else np.nan), widest


# ---- what the encoders themselves do wrong --------------------------------------------------------------------------


def position_orders(runs: Sequence[GearRun], columns: Sequence[Array]) -> tuple[float, ...]:
    """Orders (cycles a joint turn) of periodic errors between the two encoders, strongest first.

    Encoders and gears repeat their errors with the angle, at the same orders in every recording. Beside `columns`, (N, p) a run, and
    whatever changes slowly with the angle, apart for each direction, the orders are found one by one as long as the largest line of
    what is left over the angle is more than the largest of as many lines of noise would be.
    """
    angles = [r.angle[r.used] for r in runs]
    span = max(max(float(np.ptp(x)) for x in angles), 1e-9)
    speed = np.median(np.abs(np.concatenate([r.velocity[r.used] for r in runs])))
    highest = 2 * np.pi * runs[0].cutoff_hz / max(float(speed), 1e-9)
    lowest = 2 * np.pi * FEWEST_CYCLES / span
    orders = np.arange(lowest, highest, np.pi / (4.0 * span))
    # neighbouring samples of a low-passed signal are one
    alike = max(1.0, runs[0].rate_hz / (2.0 * runs[0].cutoff_hz))
    if len(orders) < 2:
        return ()
    slow = [k * lowest / FEWEST_CYCLES for k in range(1, int(FEWEST_CYCLES))]
    beside = [
        np.column_stack([c, *_waves(r.angle, slow), *(w * r.direction for w in _waves(r.angle, slow))])[r.used]
        for r, c in zip(runs, columns, strict=True)
    ]
    waves = [np.exp(-1j * np.outer(orders, angle)) for angle in angles]
    found: list[float] = []
    for _ in range(MOST_ORDERS):
        power, whole, taken = np.zeros(len(orders)), 0.0, 0
        for run, angle, rows, wave in zip(runs, angles, beside, waves, strict=True):
            basis = np.linalg.qr(np.column_stack([rows, *_waves(angle, found)]))[0]
            rest = run.deflection[run.used] - basis @ (basis.T @ run.deflection[run.used])
            power += 2.0 * np.abs(wave @ rest) ** 2 / len(rest)
            whole, taken = whole + float(rest @ rest), taken + basis.shape[1]
        freedom = sum(map(len, angles)) / alike - taken
        share = min(float(power.max()) / max(whole, 1e-300), 1.0 - 1e-12)
        tests = span * (orders[-1] - orders[0]) / np.pi
        chance = stats.chi2.sf(-freedom * np.log1p(-share), 2 * len(runs))
        if freedom < 2 * len(runs) or tests * chance > ORDER_SIGNIFICANCE:
            break
        found.append(float(orders[power.argmax()]))
    return tuple(found)


def _waves(angle: Array, orders: Sequence[float]) -> list[Array]:
    return [f(order * angle) for order in orders for f in (np.cos, np.sin)]


def nuisance(run: GearRun, orders: Sequence[float], turning: bool) -> Array:
    """What a pair of encoders shows without any load, (N, p): its zero, slow errors and ripple.

    A ring that is off its axis errs once a turn, one that is oval or tilted twice; a rod has a scale and sags.
    """
    slow = _waves(run.angle, (1.0, 2.0)) if turning else [run.angle, run.angle**2]
    return np.column_stack([np.ones(len(run.angle)), *slow, *_waves(run.angle, orders)])


# ---- the fit --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class GearData:
    """One gear in several recordings, with what its encoders do wrong in each.

    Attributes
    ----------
    joint : str
    runs : tuple of GearRun
    errors : tuple of array, shape (N, p)
        Columns of position errors of each run, its own.
    orders : tuple of float
        Of the periodic ones, cycles a joint turn.
    lag_s : float
        By which the second encoder was read earlier.
    noise : float
        rad, of independent samples; what the usual size of slow position errors is weighed against.
    slow : int
        Number of columns of slow position errors, after the first, which is the zero.
    """

    joint: str
    runs: tuple[GearRun, ...]
    errors: tuple[Array, ...]
    orders: tuple[float, ...]
    lag_s: float
    noise: float
    slow: int

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """Used rows of each run among those of all."""
        ends = np.cumsum([0, *(int(r.used.sum()) for r in self.runs)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    @property
    def rows(self) -> int:
        """Used rows of all runs; below them stand rows that say how large slow position errors usually are."""
        return self.spans[-1].stop

    @cached_property
    def _bases(self) -> tuple[Array, ...]:
        """Orthonormal bases of the position errors' columns, with rows below that say how large they usually are."""
        usual = np.zeros((self.slow, self.errors[0].shape[1]))
        usual[np.arange(self.slow), 1 + np.arange(self.slow)] = self.noise / RING_ERROR
        both = zip(self.runs, self.errors, strict=True)
        return tuple(np.linalg.qr(np.vstack([e[r.used], usual]))[0] for r, e in both)

    def apart(self, columns: Sequence[Array]) -> Array:
        """Used rows of one column (N,) or columns (N, k) a run, less what position errors explain of them, stacked."""
        above, below = [], []
        for run, basis, column in zip(self.runs, self._bases, columns, strict=True):
            rows = np.concatenate([column[run.used], np.zeros((self.slow, *column.shape[1:]))])
            rows = rows - basis @ (basis.T @ rows)
            above.append(rows[: len(rows) - self.slow])
            below.append(rows[len(rows) - self.slow :])
        return np.concatenate([*above, *below])

    @cached_property
    def target(self) -> Array:
        """The deflection, less what position errors explain of it, stacked over runs."""
        return self.apart([r.deflection for r in self.runs])

    def stacked(self, names: Sequence[str]) -> Array:
        """Shared columns, less what position errors explain of them, (rows, k)."""
        return self.apart([r.columns(names) for r in self.runs])

    def only(self, role: str) -> GearData:
        """The recordings of one role."""
        return self.of_runs([i for i, r in enumerate(self.runs) if r.role == role])

    def of_runs(self, places: Sequence[int]) -> GearData:
        """Some of the recordings."""
        runs, errors = tuple(self.runs[i] for i in places), tuple(self.errors[i] for i in places)
        return dataclasses.replace(self, runs=runs, errors=errors)

    def blocks(self) -> tuple[slice, ...]:
        """Consecutive parts of the runs to hold out in turn."""
        each = max(2, -(-BLOCKS // max(len(self.runs), 1)))
        out: list[slice] = []
        for span in self.spans:
            parts = max(1, min(each, (span.stop - span.start) // FEWEST_PER_BLOCK))
            edges = np.linspace(span.start, span.stop, parts + 1).astype(int)
            out += [slice(int(a), int(b)) for a, b in pairwise(edges)]
        return tuple(out)

    def scatter(self, columns: Array, rest: Array) -> Array:
        """Covariance of ``columns.T @ noise`` for noise of the colour that the residual (rows,) has, (k, k)."""
        longest = int(CORRELATION_S * self.runs[0].rate_hz)
        own = np.zeros((self.rows, sum(b.shape[1] for b in self._bases)))
        at = 0
        for span, basis in zip(self.spans, self._bases, strict=True):
            own[span, at : at + basis.shape[1]] = basis[: len(basis) - self.slow]
            at += basis.shape[1]
        taken = absorbed_by_fit(np.hstack([own, np.linalg.qr(columns[: self.rows])[0]]), self.spans, longest)
        spectrum = residual_spectrum(rest[: self.rows], self.spans, taken, longest)
        below = columns[self.rows :]
        above = sum(spectrum.product(columns[s]) for s in self.spans)
        return np.asarray(widening([spectrum]) * above + self.noise**2 * below.T @ below)


@dataclass(frozen=True, eq=False)
class GearFit:
    """Least squares of a gear's deflection on shared columns, position errors of each recording projected out.

    Attributes
    ----------
    names : tuple of str
        Of the shared columns.
    theta, covariance : array, shapes (k,) and (k, k)
        The covariance allows for coloured residuals.
    residual : array, shape (rows,)
    strength : float
        Standard deviations by which the model's torque stands out in the measured one, beside friction and inertia.
    """

    data: GearData
    names: tuple[str, ...]
    theta: Array
    covariance: Array
    residual: Array
    strength: float = np.inf

    @property
    def rms(self) -> float:
        """Of the residual, rad."""
        return float(np.sqrt((self.residual[: self.data.rows] ** 2).mean()))

    def value(self, name: str) -> float:
        """A coefficient."""
        return float(self.theta[self.names.index(name)])

    def std(self, name: str) -> float:
        """Standard deviation of a coefficient."""
        i = self.names.index(name)
        return float(np.sqrt(max(self.covariance[i, i], 0.0)))

    @property
    def compliance(self) -> float:
        """rad per N m through the gear; positive for a gear that gives way."""
        return -self.value("torque")

    @property
    def inertia(self) -> float:
        """Of what turns before the gear, kg m^2, joint side: its torque does not pass the gear."""
        return self.value("acceleration") / self.compliance if self.compliance else np.nan

    def lawful(self) -> GearFit:
        """Given that the rotor's inertia is not negative: mean and covariance of the normal distribution cut off there."""
        i = self.names.index("acceleration")
        mean, spread = float(self.theta[i]), float(self.covariance[i, i])
        cut = -mean / max(np.sqrt(spread), 1e-300)
        if cut < -LAWFUL:
            return self
        ratio = float(np.exp(stats.norm.logpdf(cut) - stats.norm.logsf(cut)))
        narrower = max(1.0 + cut * ratio - ratio**2, 0.0)
        along = self.covariance[i] / spread
        theta = self.theta + along * ratio * np.sqrt(spread)
        covariance = self.covariance - (1.0 - narrower) * spread * np.outer(along, along)
        rest = self.data.target - self.data.stacked(self.names) @ theta
        return dataclasses.replace(self, theta=theta, covariance=covariance, residual=rest)


def fit_columns(data: GearData, names: Sequence[str], columns: Array) -> GearFit:
    """Least squares on columns (rows, k) that have position errors projected out; a column of nothing gets zero."""
    fit = LinearFit.of(columns, data.target)
    covariance = fit.inverse @ data.scatter(columns, fit.residual) @ fit.inverse
    return GearFit(data, tuple(names), fit.theta, covariance, fit.residual)


def fit_gear(data: GearData) -> GearFit:
    """Fit the deflection of a gear.

    A gear of compliance c (1 / stiffness) turns by ``-c`` times the torque that passes it, link less motor: the drive's torque
    without friction, less what its rotor takes,

        deflection = -c (tau - J a) - c' remainder - f sign(v) - T v + errors of position,

    linear in c, c J, c', f and T. Friction before the gear does not pass it, friction behind it and the gear's own hysteresis do:
    f. What the model of the torques leaves may be either, so that it has a coefficient c' of its own. T is by how much the
    second encoder is read later than the motor's, viscous friction behind the gear included. How well the model's torque is told
    from friction, inertia and the zero limits how well c can be known, and counts in its uncertainty.
    """
    names = (*LOAD, *BASE)
    fit, strength = fit_columns(data, names, data.stacked(names)), _strength(data)
    covariance, i = fit.covariance.copy(), names.index("torque")
    covariance[i, i] += (fit.compliance / max(strength, 1e-3)) ** 2
    return dataclasses.replace(fit, covariance=covariance, strength=strength)


def _strength(data: GearData) -> float:
    """The model's torque in the measured one, beside friction and inertia: its coefficient over its standard deviation."""
    rows = np.concatenate([r.measured[r.used] - r.measured[r.used].mean() for r in data.runs])
    kept = [n for n in (*LOAD, *BASE) if n != "remainder"]
    columns = np.concatenate([r.columns(kept)[r.used] for r in data.runs])
    fit = LinearFit.of(columns - columns.mean(axis=0), rows)
    if not fit.residual.any():
        return np.inf
    i = kept.index("torque")
    spread = float(fit.coloured_covariance(data.spans, int(CORRELATION_S * data.runs[0].rate_hz))[i, i])
    return float(abs(fit.theta[i]) / np.sqrt(max(spread, 1e-300)))


def each_recording(data: GearData) -> list[GearFit]:
    """The fit of each recording by itself: its own inertia, friction and position errors."""
    return [fit_gear(data.of_runs([i])).lawful() for i in range(len(data.runs))]


def agreement(estimates: Sequence[tuple[float, float]]) -> float:
    """Probability that independent estimates (value, standard deviation) of one number differ as much as these or more."""
    return weighted_mean(*np.array(estimates).T)[2]


def gear_data(
    recordings: Sequence[Recording],
    joint: str,
    cutoff_hz: float,
    models: Sequence[Array] | None = None,
    turning: bool = True,
) -> GearData | None:
    """Rows of one gear in all recordings, the second encoder's lag taken out; None where too little moves.

    Parameters
    ----------
    recordings : sequence of Recording
    joint : str
    cutoff_hz : float
        Of the low-pass.
    models : sequence of array (N, 2), optional
        The joint's torque as a model has it, one a recording; see `gear_run`.
    turning : bool
        Whether the encoders are rings, not rods.
    """
    torques: Sequence[Array | None] = [None] * len(recordings) if models is None else models
    lag, noise, orders = 0.0, RING_ERROR, None
    data: GearData | None = None
    for number in range(ROUNDS):
        runs = tuple(gear_run(r, joint, cutoff_hz, lag, t) for r, t in zip(recordings, torques, strict=True))
        runs = tuple(r for r in runs if r.used.sum() > 2 * FEWEST_PER_BLOCK)
        if not runs:
            return None
        if orders is None and number > 0:  # the lag, which all orders would mix with, is out
            orders = position_orders(
                runs, [np.column_stack([nuisance(r, (), turning), r.columns((*LOAD, *BASE))]) for r in runs]
            )
        errors = tuple(nuisance(r, orders or (), turning) for r in runs)
        slow = nuisance(runs[0], (), turning).shape[1] - 1
        data = GearData(joint, runs, errors, orders or (), lag, noise, slow)
        # of a sample if all were independent and told no more together than samples `ALIKE_S` apart do
        alone = fit_gear(data).rms * float(np.sqrt(max(1.0, ALIKE_S * runs[0].rate_hz)))
        data = dataclasses.replace(data, noise=alone)
        noise, step = data.noise, -fit_gear(data).value("velocity")
        if orders is not None and abs(step) < 1e-6 / cutoff_hz:
            break
        lag += step
    return data


@dataclass(frozen=True, eq=False)
class GearLoop:
    """One recording's loop, arrays over its used rows.

    Attributes
    ----------
    recording, role : str
    motor : N m, torque of the motor, joint side.
    measured : rad, link less motor, less its mean.
    through : N m, torque that passes the gear.
    deflection : rad, less lag and position errors.
    """

    recording: str
    role: str
    motor: Array
    measured: Array
    through: Array
    deflection: Array


def loops(fit: GearFit) -> list[GearLoop]:
    """Deflection over torque of each recording, before and after everything but the load is taken out."""
    out = []
    for run, error in zip(fit.data.runs, fit.data.errors, strict=True):
        through = through_gear(run, fit)[run.used]
        rest = (run.deflection - run.columns(fit.names) @ fit.theta)[run.used]
        own = np.linalg.lstsq(error[run.used], rest, rcond=1e-10)[0]
        clean = rest - error[run.used] @ own - fit.compliance * (through - through.mean())
        raw = (run.deflection - fit.data.lag_s * run.velocity)[run.used]  # as it was before the lag was taken out
        out.append(
            GearLoop(run.name, run.role, run.measured[run.used], raw - raw.mean(), through - through.mean(), clean)
        )
    return out


# ---- more than a straight line --------------------------------------------------------------------------------------

More = Callable[[GearRun, GearFit], Array]


def through_gear(run: GearRun, fit: GearFit) -> Array:
    """Torque that passes the gear, (N,), N m, but for friction behind it."""
    return run.torque - fit.inertia * run.acceleration


def play(signal: Array, width: float) -> Array:
    """What follows a signal with a play of half width `width`, (N,): the hysteresis operator of Prandtl and Ishlinskii."""
    out = np.empty_like(signal)
    at = float(signal[0])
    for i, x in enumerate(signal):
        at = min(max(at, x - width), x + width)
        out[i] = at
    return out


def hysteresis(part: float) -> More:
    """A Dahl-like element beside the spring: what saturates after the torque has turned back by `part` of its range."""

    def column(run: GearRun, fit: GearFit) -> Array:
        torque = through_gear(run, fit)
        return torque - play(torque, 0.5 * part * float(np.ptp(torque[run.used])))

    return column


def hardening(run: GearRun, fit: GearFit) -> Array:
    """Third power of the torque: ``k eps + k3 eps^3 = tau`` is ``eps = c tau - k3 c^4 tau^3`` to first order in k3."""
    return through_gear(run, fit) ** 3


def lost_motion(run: GearRun, fit: GearFit) -> Array:
    """Side of the teeth that carries: which way the torque acts, smoothed over a twentieth of its range."""
    torque = through_gear(run, fit)
    return np.tanh(torque / (0.05 * max(float(np.ptp(torque[run.used])), 1e-12)))


def loaded_friction(run: GearRun, fit: GearFit) -> Array:
    """Friction behind the gear that grows with the torque through it."""
    return np.abs(through_gear(run, fit)) * run.direction


def rate_of_torque(run: GearRun, fit: GearFit) -> Array:
    """Time derivative of the torque through the gear: damping beside the spring delays its deflection."""
    return np.gradient(through_gear(run, fit)) * run.rate_hz


def with_more(fit: GearFit, name: str, more: More) -> GearFit:
    """The fit with one column more."""
    columns = fit.data.apart([more(r, fit) for r in fit.data.runs])
    return fit_columns(fit.data, (*fit.names, name), np.column_stack([fit.data.stacked(fit.names), columns]))


def held_out_gains(data: GearData, less: Array, more: Array) -> tuple[Array, Array]:
    """Drop of the squared error on each held-out block by columns (rows, k + m) over columns (rows, k), and the error before.

    Position errors are fitted on all rows of a recording: they are no physics of the gear that could carry over.
    """
    gains, before = [], []
    for block in data.blocks():
        kept = np.arange(len(data.target)) < data.rows
        kept[block] = False
        errors = []
        for columns in (less, more):
            theta = np.linalg.lstsq(columns[kept], data.target[kept], rcond=1e-10)[0]
            errors.append(float(((data.target[block] - columns[block] @ theta) ** 2).sum()))
        gains.append(errors[0] - errors[1])
        before.append(errors[0])
    return np.array(gains), np.array(before)
