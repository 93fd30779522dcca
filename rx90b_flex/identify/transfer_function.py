"""Symmetric transfer functions with common poles, fitted to a frequency response by maximum likelihood.

Chapter 6 fits numerators and a common denominator. Their coefficients are ill-conditioned, and a matrix of free numerators
gives every pole a residue of rank n, where a mode of a structure has one of rank one. Here each mode is its pole and its
shape at the drives, so that symmetry, the common denominator and the rank hold by construction:

    P(s) = (D + s E + s^2 F - R / (s + a) + Q / s^2 + sum_r [u_r u_r^T / (s - p_r) + conj.]) diag(exp(-s T))

D, E and F (symmetric) stand for the modes above the band: far below its resonance a mode's acceleration over torque grows with
s^2, so that F is a residual flexibility. R / (s + a) (symmetric) stands for friction on the rigid-body motion below the band, Q / s^2
(symmetric) for gravity on it and for friction that is not in proportion to inertia. E, F and Q are kept where they pay. T are delays
of the logged torques. Antiresonances are the zeros of the drive points ``P_jj``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, product

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.stability import Values, model_weights, nearest, refusals, spread, zero_refusals
from rx90b_flex.identify.starting_values import (
    PoleSet,
    real_rows,
    residue_fit,
    starting_poles,
    symmetric_basis,
    symmetric_data,
    whitening,
)
from rx90b_flex.identify.transfer_model import (
    POWERS_OF_S,
    TERMS,
    TURN,
    FittedModel,
    TermLayout,
    TransferFunctions,
    delayed_jacobian,
    zero_derivatives,
)
from rx90b_flex.levenberg import Damping, Iterate, lowest

WORTH_A_STEP = 1e-2  # of the cost, in units of the noise: what a tenth of a parameter's standard deviation is worth
CLIMB = Damping(1e-2, rise=4.0, fall=9.0)
EVALUATIONS = 500  # of the cost, in one climb
DAMPING = (1e-4, 0.95)  # bounds of a damping ratio
DELAY_S = (-0.01, 0.01)  # bounds of a delay
BOUND_PRICE = 2.0  # times the criterion of a candidate with a mode on a bound: what lies beside the band may need one
FEWER = ((-2, 0, 2), (-2, 0), (0, 1, 2), (0, 2), (0,))  # powers of s that may do instead of all
ADDED = ("one mode more", "a mode above the band")  # where starts come from that add to a fit with a mode less
WEAK = 0.1  # times the shape of such a mode: a hundredth of its residue
SURELY = 10.0  # times its price: a mode worth as much by its covariance is worth it
START_DAMPING = 0.05  # ratio, of modes to start from of which the frequency alone is given
EDGE_HZ = 0.01  # by which an antiresonance may leave its bounds at a cost of 1


# ---- fit ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bounds:
    """Limits of the modes and of what stands beside them; a user's own replace these.

    Attributes
    ----------
    frequency_hz : (low, high) of every mode; by default from the lowest line to twice the highest.
    damping_ratio : (low, high).
    antiresonances : tuple of (joint, low, high)
        The antiresonance of that joint's drive point which is nearest to the interval, Hz, stays in it. Zeros are functions of
        modes and what stands beside them: a steep price keeps them.
    """

    frequency_hz: tuple[float, float] | None = None
    damping_ratio: tuple[float, float] = DAMPING
    antiresonances: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class CandidateModel(FittedModel):
    """A model that was tried, of some number of modes and terms beside the band.

    Attributes
    ----------
    modes : int
    criterion : float
        What decides; the lowest is chosen.
    started : str
        Where its poles came from.
    bound : bool
        Whether a mode not above the lines ended on a bound: then it is no mode of the band, and the criterion counts
        `BOUND_PRICE` times.
    """

    modes: int
    criterion: float
    started: str
    bound: bool


@dataclass(frozen=True, eq=False)
class TransferFit(FittedModel):
    """Transfer functions with their uncertainty, and how they were found.

    Attributes
    ----------
    response : FrequencyResponse
        The lines that were fitted.
    candidates : tuple of CandidateModel
        The best of each number of modes tried, ascending.
    alternatives : tuple of CandidateModel
        All that were tried: each number of modes with every choice of terms. Standard deviations of resonances, damping ratios and
        antiresonances hold what these differ by (`stability.spread`).
    worth : array, shape (m,)
        By how much the cost rises without each mode, over what a mode has to save by the criterion that decides: below 1 the
        fit is as good without it.
    """

    response: FrequencyResponse
    candidates: tuple[CandidateModel, ...]
    alternatives: tuple[CandidateModel, ...]
    worth: Array

    def resonances_std_hz(self) -> Array:
        """Standard deviations of `resonances_hz`, the choice of the model included, shape (m,)."""
        return self._resonance_spread[0]

    def damping_std(self) -> Array:
        """Standard deviations of the damping ratios, the choice of the model included, shape (m,)."""
        return self._resonance_spread[1]

    def antiresonances(self, drive: int) -> tuple[Array, Array]:
        """Antiresonances of a drive point (5.41) and standard deviations, the choice of the model included, ascending, Hz."""
        own = super().antiresonances(drive)
        return own[0], self._widened(own, lambda one: one.antiresonances(drive))

    def torque_delays(self) -> tuple[Array, Array]:
        """As of one model, the standard deviations with the choice of the model included."""
        own = super().torque_delays()
        places = np.tile(np.arange(len(own[0])), (len(self._weighted), 1))
        return own[0], self._widened(own, CandidateModel.torque_delays, places)

    @cached_property
    def _weighted(self) -> list[tuple[CandidateModel, float]]:
        """Alternatives that the data leave open, with their weights."""
        weights = model_weights(self.alternatives, efficiency(self.response)[0], self.inflation)
        return [pair for pair in zip(self.alternatives, weights, strict=True) if pair[1] > 0.0]

    @cached_property
    def _resonance_spread(self) -> tuple[Array, Array]:
        hz, ratio = (self.resonances_hz, super().resonances_std_hz()), (self.model.damping_ratio, super().damping_std())
        places = nearest(*hz, [one.modes_told()[:2] for one, _ in self._weighted])
        by_hz = self._widened(hz, lambda one: one.modes_told()[:2], places)
        return by_hz, self._widened(ratio, lambda one: one.modes_told()[2:], places)

    def _widened(
        self, own: Values, told: Callable[[CandidateModel], Values], places: NDArray[np.intp] | None = None
    ) -> Array:
        """Standard deviations of values, with what the alternatives say of them (`spread`)."""
        others = [told(one) for one, _ in self._weighted]
        return spread(*own, others, [weight for _, weight in self._weighted], places)

    @cached_property
    def refused(self) -> tuple[str, ...]:
        """Why a mode does not count, one text each, empty where it does: too uncertain, needless, or not found at other orders."""
        return refusals(self.modes_told(), self.worth, self.candidates)

    def mode_rows(self) -> Iterator[tuple[float, float, float, float, str]]:
        """Of each mode: resonance and standard deviation, Hz; damping ratio and its; why it does not count, empty where it does."""
        return zip(*self.modes_told(), self.refused, strict=True)

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Which modes count, shape (m,)."""
        return np.array([not why for why in self.refused], bool)

    def refused_antiresonances(self, drive: int) -> tuple[str, ...]:
        """Why an antiresonance of a drive point does not count: too uncertain, or that beside a mode that does not."""
        zeros = self.antiresonance_zeros(drive)
        return zero_refusals(zeros, self.antiresonances(drive)[1], self.model.poles, self.refused)

    def in_band(self, hz: Array) -> NDArray[np.bool_]:
        """Which frequencies lie between the lines: those outside only stand for what is beyond."""
        return (np.asarray(hz) >= self.response.hz[0]) & (np.asarray(hz) <= self.response.hz[-1])


def fit_transfer_functions(
    response: FrequencyResponse,
    modes: int | Sequence[int] = range(2, 9),
    *,
    delays: str = "none",
    leave_out_hz: Sequence[tuple[float, float]] = (),
    start: TransferFunctions | None = None,
    start_hz: Sequence[float] = (),
    bounds: Bounds | None = None,
) -> TransferFit:
    """Symmetric transfer functions by maximum likelihood, with their order, without a hand in it.

    For each number of modes, poles come from linear fits of several orders and weights (`starting_poles`) and from
    the fit with one mode less and a new pole where it helps most; the likelihood is climbed from each by
    Levenberg-Marquardt with the analytic Jacobian, and the lowest cost stays. The number of modes is that of the lowest
    criterion (minimum description length), where two more did not lower it.

    Parameters
    ----------
    response : FrequencyResponse
        Cut to the band that is to be fitted (`FrequencyResponse.band`).
    modes : int or several
        Numbers to try.
    delays : str
        ``none``, ``common`` (one for all torques) or ``each`` (one a torque): a delay that the model lacks turns into zeros in
        the right half plane.
    leave_out_hz : pairs (centre, half width)
        Lines not to use, such as those at the mains frequency.
    start : TransferFunctions, optional
        Initial model; then its number of modes and its terms beside the band count, and no other start is tried.
    start_hz : sequence of float
        Resonances, Hz, from which the fit of as many modes sets out as well.
    bounds : Bounds, optional

    Raises
    ------
    ValueError
        Too few lines; a covariance that is not positive definite; unknown words; an initial model outside its bounds; resonances to
        start from that are outside them, or of which there are as many as no number of modes.
    """
    if delays not in ("none", "common", "each"):
        raise ValueError(f"delays is {delays!r}; expected 'none', 'common' or 'each'")
    for centre, half in leave_out_hz:
        response = response.lines(np.abs(response.hz - centre) > half)
    tried = (len(start.frequency_hz),) if start is not None else (modes,) if isinstance(modes, int) else tuple(modes)
    layouts = _layouts(response, tried, {"none": 0, "common": 1, "each": len(response.joints)}[delays], start)
    problem = _Likelihood(response, bounds or Bounds())
    _check_start_hz(start_hz, tried, problem.frequency_hz)
    wholes = _whole_fits(problem, layouts, start, start_hz)
    every = _with_fewer_terms(problem, wholes) if start is None else [[one] for one in wholes]
    found = sorted((min(order, key=lambda one: one.score) for order in every), key=lambda one: one.layout.modes)
    best = min(found, key=lambda one: one.score)
    return TransferFit(
        *best.fitted,
        response,
        tuple(one.candidate for one in found),
        tuple(one.candidate for one in chain(*every)),
        _worth(best)[np.argsort(best.model.frequency_hz)],
    )


def _layouts(
    response: FrequencyResponse, tried: tuple[int, ...], delays: int, start: TransferFunctions | None
) -> dict[int, TermLayout]:
    """The parameters of each number of modes, for which there must be enough numbers."""
    rows = 2 * response.value.size
    low, high = (float(response.hz[0]), float(response.hz[-1])) if len(response.hz) else (0.0, 1.0)
    terms = POWERS_OF_S if start is None else tuple(p for p in POWERS_OF_S if p == 0 or getattr(start, TERMS[p]).any())
    layouts = {m: TermLayout(m, len(response.joints), high, delays, terms, low) for m in tried}
    needed = max((layout.count for layout in layouts.values()), default=0)
    if not tried or min(tried) < 1 or rows < 2 * needed:
        raise ValueError(
            f"{len(response.hz)} lines give {rows} numbers for the {needed} parameters of {max(tried, default=0)} modes; "
            "expected modes from 1 on and twice as many numbers as parameters"
        )
    return layouts


def _whole_fits(
    problem: _Likelihood, layouts: dict[int, TermLayout], start: TransferFunctions | None, start_hz: Sequence[float]
) -> list[_Climb]:
    """Fits with all terms by number of modes, until two more do not lower the criterion."""
    sets: tuple[PoleSet, ...] = ()
    if start is None:
        sets = starting_poles(problem.data, range(2 * min(layouts), 2 * max(layouts) + 4, 2))
    wholes: list[_Climb] = []
    for m, layout in layouts.items():
        before = next((one for one in wholes if one.layout.modes == m - 1), None)
        if start is not None:
            starts = [("given", _checked_start(problem, layout, start))]
        else:
            starts = _starts(problem, layout, sets, None if before is None else before.model)
        if m == len(start_hz):
            damping = float(np.clip(START_DAMPING, *problem.bounds.damping_ratio))
            poles = TURN * np.sort(np.array(start_hz, float)) * (-damping + 1j * np.sqrt(1 - damping**2))
            starts.append(("given resonances", problem.model_over(poles, layout)))
        wholes.append(_of_order(problem, layout, starts, before))
        if m - min(wholes, key=lambda one: one.score).layout.modes >= 2:
            break
    return wholes


def _of_order(
    problem: _Likelihood, layout: TermLayout, starts: Sequence[tuple[str, TransferFunctions]], before: _Climb | None
) -> _Climb:
    """Best model of one number of modes with all terms beside the band, from each start."""
    whole = min((problem.climbed(layout, model, told) for told, model in starts), key=lambda one: one.goal)
    if before is None or whole.goal <= before.goal:
        return whole
    # a mode more cannot fit worse: all starts ended beside the best
    more = [(told, _with_weak_mode(before.model, model)) for told, model in starts if told in ADDED]
    return min([whole, *(problem.climbed(layout, model, told) for told, model in more)], key=lambda one: one.goal)


def _with_fewer_terms(problem: _Likelihood, wholes: Sequence[_Climb]) -> list[list[_Climb]]:
    """Models of each order: the whole one, and where its order may be the best one's, those with fewer terms."""
    lowest = min(one.criterion for one in wholes)
    out = []
    for whole in wholes:
        saved = problem.price * (len(POWERS_OF_S) - 1) * whole.layout.entries
        fewer = [replace(whole.layout, powers=powers) for powers in FEWER] if whole.criterion - saved < lowest else []
        found = [problem.climbed(layout, whole.model, whole.started) for layout in fewer]
        better = min([whole, *found], key=lambda one: one.goal)
        if better is not whole:  # all terms cannot fit worse than some: that climb ended beside the best
            whole = problem.climbed(whole.layout, better.model, better.started)
        out.append([whole, *found])
    return out


def _with_weak_mode(before: TransferFunctions, start: TransferFunctions) -> TransferFunctions:
    """A fitted model with a start's last mode, too weak to spoil the fit."""
    return replace(
        before,
        frequency_hz=np.append(before.frequency_hz, start.frequency_hz[-1]),
        damping_ratio=np.append(before.damping_ratio, start.damping_ratio[-1]),
        shape=np.vstack([before.shape, WEAK * start.shape[-1:]]),
    )


def efficiency(response: FrequencyResponse) -> tuple[float, float, float]:
    """What estimated weights do to the cost a line and entry: its mean, its variance, and the parameters' covariance.

    Each line's cost is then Hotelling's T^2 of n*n complex numbers; for a single output the first two are the factors of
    (6.42) and (6.43), the last that of (6.46). Degrees of freedom too few for the mean or variance to exist give infinity.
    """
    v, entries = response.degrees_of_freedom, len(response.joints) ** 2
    if not np.isfinite(v):
        return 1.0, 1.0, 1.0
    d1, d2 = 2 * entries, 2 * (v - entries + 1)
    mean = v / (v - entries) if d2 > 2 else np.inf
    scale = v * entries / (v - entries + 1)
    variance = scale**2 * 2 * d2**2 * (d1 + d2 - 2) / (d1 * (d2 - 2) ** 2 * (d2 - 4)) if d2 > 4 else np.inf
    return mean, variance / entries, v / (v - entries - 1) if v > entries + 1 else np.inf


class _Likelihood:
    """Residuals and Jacobian over one response, the bounds of the parameters, and what decides between models."""

    def __init__(self, response: FrequencyResponse, bounds: Bounds) -> None:
        low, high = float(response.hz[0]), float(response.hz[-1])
        self.response, self.bounds = response, bounds
        self.frequency_hz = bounds.frequency_hz or (low, 2 * high)
        self.decay_hz = 1e-3 * low, low / 2  # of the friction's real pole
        self.zeros = []  # drive, lowest and highest frequency of an antiresonance, Hz
        for joint, low, high in bounds.antiresonances:
            if joint not in response.joints or not 0.0 <= low < high:
                raise ValueError(
                    f"antiresonance of {joint!r} between {low:g} and {high:g} Hz; expected a joint of {', '.join(response.joints)} "
                    "and an ascending pair"
                )
            self.zeros.append((response.joints.index(joint), low, high))
        self.data = symmetric_data(response)
        self.white = whitening(response)
        self.n = len(response.joints)
        self.upper = np.triu_indices(self.n)
        self.noise, _, self.loss = efficiency(response)
        self.price = np.log(2 * response.value.size) / 2  # of a parameter, in units of the cost: its description length

    def climbed(self, layout: TermLayout, model: TransferFunctions, started: str) -> _Climb:
        """Where the likelihood's climb from a model ends."""
        limits = self.limits(layout)
        begin = _Climb(self, layout, limits, np.clip(layout.pack(model), *limits), started)
        return lowest(begin, EVALUATIONS, CLIMB, patience=2)

    def model_over(self, poles: ComplexArray, layout: TermLayout) -> TransferFunctions:
        """Model over given poles: the best residues, each replaced by its nearest of rank one."""
        n, m = layout.size, len(poles)
        decay_hz = float(np.sqrt(np.prod(self.decay_hz)))
        found, _ = residue_fit(self.data, np.append(poles, -TURN * decay_hz))
        full = symmetric_basis(n)
        restoring, direct, slope, flexibility, drag = (np.tensordot(c, full, 1) for c in found.T[:5])
        residues = np.einsum("km,kab->mab", found[:, 5 : 5 + m] + 1j * found[:, 5 + m :], full)
        left = np.linalg.svd(residues)[0][:, :, 0]
        size = np.einsum("ma,mab,mb->m", left.conj(), residues, left.conj())
        shape = left * np.sqrt(size)[:, None]
        f, z = np.abs(poles) / TURN, -poles.real / np.abs(poles)
        return TransferFunctions(f, z, shape, direct, slope, flexibility, restoring, decay_hz, -drag, np.zeros(n))

    def limits(self, layout: TermLayout) -> tuple[Array, Array]:
        """Lowest and highest values of the parameters, each (p,)."""
        low, high = np.full(layout.count, -np.inf), np.full(layout.count, np.inf)
        end, width = layout.modes * layout.width, layout.width
        places: list[tuple[slice, tuple[float, float]]] = [
            (slice(0, end, width), self.frequency_hz),
            (slice(1, end, width), self.bounds.damping_ratio),
            (slice(layout.decay, layout.decay + 1), self.decay_hz),
            (slice(layout.count - layout.delays, layout.count), DELAY_S),
        ]
        for place, (least, most) in places:
            low[place], high[place] = least, most
        return low, high

    def cost(self, layout: TermLayout, x: Array) -> float:
        model = layout.unpack(x)
        r, beyond = self.residual(layout, model), self.beyond(layout, model)[0]
        return float((np.abs(r) ** 2).sum() + beyond @ beyond) + (0.0 if layout.delays else self.data.rest)

    def beyond(self, layout: TermLayout, model: TransferFunctions) -> tuple[Array, Array]:
        """How far each bounded antiresonance is out of its bounds, over `EDGE_HZ`, and its derivatives, (z,) and (z, p)."""
        values, slopes = [], []
        for drive, low, high in self.zeros:
            z = model.complex_zeros(drive)
            hz = np.abs(z) / TURN
            out = hz - np.clip(hz, low, high)
            nearest = int(np.argmin(np.abs(out))) if len(out) else -1
            if nearest >= 0 and out[nearest] != 0.0:
                one = z[nearest : nearest + 1]
                by = (one.conj() / np.abs(one) @ zero_derivatives(layout, model, drive, one)).real / TURN
                values.append(out[nearest] / EDGE_HZ)
                slopes.append(by / EDGE_HZ)
        return np.array(values), np.array(slopes).reshape(len(values), layout.count)

    def residual(self, layout: TermLayout, model: TransferFunctions) -> ComplexArray:
        """Whitened model minus data: of the n*n entries with delays, of what a symmetric model reaches without."""
        s = self.data.s
        if layout.delays:
            error = model.frf(self.response.hz) - self.response.value
            return np.einsum("fab,fb->fa", self.white, error.reshape(len(s), -1))
        upper = model._undelayed(s)[:, self.upper[0], self.upper[1]]
        return np.einsum("fak,fk->fa", self.data.weight, upper) - self.data.target

    def jacobian(self, layout: TermLayout, model: TransferFunctions) -> ComplexArray:
        if layout.delays:
            return self.white @ delayed_jacobian(layout, model, self.data.s)
        return self.data.weight @ layout.jacobian(model, self.data.s)

    def normal_equations(self, layout: TermLayout, x: Array) -> tuple[Array, Array]:
        """Gauss-Newton Hessian and gradient of half the cost."""
        model = layout.unpack(x)
        j, r = self.jacobian(layout, model), self.residual(layout, model)
        beyond, by = self.beyond(layout, model)
        rows, target = np.vstack([real_rows(j), by]), np.append(real_rows(r[:, :, None])[:, 0], beyond)
        return rows.T @ rows, rows.T @ target


@dataclass(frozen=True, eq=False)
class _Climb(Iterate):
    """Parameters x on their way within bounds (low, high), and where they set out from; where they end, a model to choose from."""

    problem: _Likelihood
    layout: TermLayout
    limits: tuple[Array, Array]
    x: Array
    started: str

    enough = WORTH_A_STEP

    @cached_property
    def goal(self) -> float:
        return self.problem.cost(self.layout, self.x)

    def equations(self) -> tuple[Array, Array]:
        """Of what is free: a parameter that falls beyond its bound stays."""
        hessian, gradient = self.problem.normal_equations(self.layout, self.x)
        low, high = self.limits
        free = ~(((self.x <= low) & (gradient > 0)) | ((self.x >= high) & (gradient < 0)))
        return hessian * np.outer(free, free), -gradient * free

    def moved(self, step: Array) -> _Climb:
        return replace(self, x=np.clip(self.x + step, *self.limits))

    @property
    def model(self) -> TransferFunctions:
        return self.layout.unpack(self.x)

    @property
    def criterion(self) -> float:
        return float(self.goal / self.problem.noise + self.problem.price * self.layout.count)

    @property
    def bound(self) -> bool:
        """Whether a mode not above the lines sits on a bound. Above them a broad one may stand for all that lies there."""
        low, high = self.limits
        width, end = self.layout.width, self.layout.modes * self.layout.width
        at = ((self.x <= low) | (self.x >= high))[:end].reshape(-1, width).any(axis=1)
        return bool(np.any(at & (self.x[:end:width] <= self.layout.high_hz)))

    @property
    def score(self) -> float:
        return self.criterion * (BOUND_PRICE if self.bound else 1.0)

    @cached_property
    def fitted(self) -> tuple[TransferFunctions, Array, float, float, int, TermLayout]:
        """The fields of `FittedModel`, modes by frequency."""
        problem, layout = self.problem, self.layout
        own = self.x[: layout.modes * layout.width].reshape(layout.modes, -1)
        x = np.concatenate([own[np.argsort(own[:, 0])].ravel(), self.x[own.size :]])
        hessian, _ = problem.normal_equations(layout, x)
        scale = np.sqrt(np.diag(hessian)) + 1e-300
        inverse = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        expected = problem.noise * (len(problem.response.hz) * problem.n**2 - layout.count / 2)
        inflation = max(1.0, self.goal / expected) if np.isfinite(expected) else 1.0
        covariance = inverse / 2 * (problem.loss if np.isfinite(problem.loss) else 1.0) * inflation
        return layout.unpack(x), covariance, self.goal, inflation, layout.count, layout

    @cached_property
    def candidate(self) -> CandidateModel:
        return CandidateModel(*self.fitted, self.layout.modes, self.criterion, self.started, self.bound)


def _checked_start(problem: _Likelihood, layout: TermLayout, start: TransferFunctions) -> TransferFunctions:
    low, high = problem.limits(layout)
    x = layout.pack(start)
    bad = np.flatnonzero((x < low) | (x > high))
    if len(bad):
        raise ValueError(
            f"the initial model's parameter {bad[0]} is {x[bad[0]]:.4g}; expected {low[bad[0]]:.4g} to {high[bad[0]]:.4g}"
        )
    return start


def _starts(
    problem: _Likelihood, layout: TermLayout, sets: Sequence[PoleSet], before: TransferFunctions | None
) -> list[tuple[str, TransferFunctions]]:
    """Models with the layout's number of modes to climb from, with where they came from."""
    (least, most), data, hz = problem.frequency_hz, problem.data, problem.response.hz
    decay = -TURN * float(np.sqrt(np.prod(problem.decay_hz)))
    found: list[tuple[str, ComplexArray]] = []
    spacing = float(np.median(np.diff(hz)))
    for one in sets:
        # narrower than the lines lie apart, or outside the bounds: not a mode but the noise of a line, or the edges
        f, z = one.frequencies_hz, one.damping_ratios
        plausible = (f * z > spacing / 4) & (f > least) & (f < most)
        poles = one.poles[plausible & (z < problem.bounds.damping_ratio[1])]
        while len(poles) > layout.modes:
            poles = min((np.delete(poles, i) for i in range(len(poles))), key=lambda p: residue_fit(data, p)[1])
        if len(poles) == layout.modes:
            found.append((f"linear fit of order {one.order}, w = {one.power:g}", poles))
    if before is not None:
        typical = float(np.median(before.damping_ratio))
        inside, above = np.geomspace(hz[0], hz[-1], 30), np.geomspace(1.05 * hz[-1], most, 6)[:-1]
        for told, places, damping in zip(ADDED, (inside, above), ((typical,), (typical, 0.2, 0.4)), strict=True):
            for centre, ratio in product(places.tolist(), damping):
                pole = np.array([TURN * centre * (-ratio + 1j * np.sqrt(1 - ratio**2))], complex)
                found.append((told, np.concatenate([before.poles, pole])))
    if not found:
        f = np.geomspace(hz[0], hz[-1], layout.modes + 2)[1:-1]
        found.append(("spread over the band", np.asarray(TURN * f * (-0.05 + 1j), complex)))
    best: dict[str, tuple[str, ComplexArray]] = {}  # of each kind
    for told, poles in sorted(found, key=lambda one: residue_fit(data, np.append(one[1], decay))[1]):
        best.setdefault(told.split(" of ")[0], (told, poles))
    return [(told, problem.model_over(poles, layout)) for told, poles in best.values()]


def _check_start_hz(start_hz: Sequence[float], tried: Sequence[int], bounds_hz: tuple[float, float]) -> None:
    low, high = bounds_hz
    if start_hz and len(start_hz) not in tried:
        numbers = ", ".join(str(m) for m in tried)
        raise ValueError(f"{len(start_hz)} resonances to start from; expected as many as a number of modes: {numbers}")
    bad = [f for f in start_hz if not low <= f <= high]
    if bad:
        raise ValueError(f"resonance to start from is {bad[0]:g} Hz; expected {low:.4g} to {high:.4g} Hz")


def _worth(best: _Climb) -> Array:
    """`TransferFit.worth`: by the fit without each mode, or by the shape's covariance where that says it is worth far more.

    Of a residue ``u u^T``, half of the square of u over its deviation, ``u^T C^-1 u / 4``, is twice the cost that it saves.
    """
    problem, layout, model, m = best.problem, best.layout, best.model, best.layout.modes
    hessian, _ = problem.normal_equations(layout, best.x)
    price = problem.price * layout.width * problem.noise
    out = np.full(m, np.inf)
    for r in range(m) if m > 1 else ():
        own = np.arange(r * layout.width + 2, (r + 1) * layout.width)
        rest = np.setdiff1d(np.arange(layout.count), own)
        across = hessian[np.ix_(own, rest)]
        inverse = (
            hessian[np.ix_(own, own)] - across @ np.linalg.pinv(hessian[np.ix_(rest, rest)], hermitian=True) @ across.T
        )
        u = best.x[own]
        out[r] = float(u @ inverse @ u) / 4 / price
        if out[r] < SURELY:
            kept = np.arange(m) != r
            less = replace(
                model,
                frequency_hz=model.frequency_hz[kept],
                damping_ratio=model.damping_ratio[kept],
                shape=model.shape[kept],
            )
            out[r] = (problem.climbed(replace(layout, modes=m - 1), less, "").goal - best.goal) / price
    return out
