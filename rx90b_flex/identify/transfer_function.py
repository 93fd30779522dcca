"""Symmetric transfer functions with common poles, fitted to a frequency response by maximum likelihood.

Chapter 6 fits numerators and a common denominator. Their coefficients are ill-conditioned, and a matrix of free numerators
gives every pole a residue of rank n, where a mode of a structure has one of rank one. Here each mode is its pole and its
shape at the drives, so that symmetry, the common denominator and the rank hold by construction:

    P(s) = (D + s E - R / (s + a) + sum_r [u_r u_r^T / (s - p_r) + conj.]) diag(exp(-s T))

D and E (symmetric) stand for the modes above the band, R / (s + a) (symmetric) for friction on the rigid-body motion
below it, T for delays of the logged torques. Antiresonances are the zeros of the drive points ``P_jj``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.starting_values import (
    POWERS,
    PoleSet,
    SymmetricData,
    real_rows,
    residue_fit,
    starting_poles,
    symmetric_basis,
    symmetric_data,
    whitening,
)

TURN = 2 * np.pi
DAMPING = (1e-4, 0.95)  # bounds of a damping ratio
BOUND_PRICE = 2.0  # times the criterion of a candidate with a mode on a bound: what lies beside the band may need one
EDGE_HZ = 0.01  # by which an antiresonance may leave its bounds at a cost of 1


@dataclass(frozen=True, eq=False)
class TransferFunctions:
    """P(s), drive acceleration over drive torque, from m modes at n drives.

    Attributes
    ----------
    frequency_hz : array, shape (m,)
        Distance of each pole from the origin: the undamped resonances (5.41), ascending.
    damping_ratio : array, shape (m,)
    shape : complex array, shape (m, n)
        u: residues are ``u u^T``. rad/s^2 per N m, times rad/s.
    direct, slope : array, shape (n, n)
        D, rad/s^2 per N m; E, the same times s.
    decay_hz : float
        a / (2 pi).
    drag : array, shape (n, n)
        R.
    delay : array, shape (n,)
        T of each torque, s.
    """

    frequency_hz: Array
    damping_ratio: Array
    shape: ComplexArray
    direct: Array
    slope: Array
    decay_hz: float
    drag: Array
    delay: Array

    @property
    def poles(self) -> ComplexArray:
        """Above the real axis, shape (m,), rad/s."""
        z = self.damping_ratio
        return TURN * self.frequency_hz * (-z + 1j * np.sqrt(1 - z**2))

    def frf(self, hz: Array) -> ComplexArray:
        """Frequency response, shape (F, n, n), rad/s^2 per N m."""
        s = 2j * np.pi * np.asarray(hz, float)
        return self._undelayed(s) * np.exp(-s[:, None, None] * self.delay)

    def _undelayed(self, s: ComplexArray) -> ComplexArray:
        q, p = np.einsum("mj,mk->mjk", self.shape, self.shape), self.poles
        modes = np.einsum("fm,mjk->fjk", 1 / (s[:, None] - p), q)
        modes += np.einsum("fm,mjk->fjk", 1 / (s[:, None] - p.conj()), q.conj())
        s = s[:, None, None]
        return self.direct + s * self.slope - self.drag / (s + TURN * self.decay_hz) + modes

    def zeros(self, row: int, column: int | None = None) -> ComplexArray:
        """Finite zeros of one entry, a drive point where no column is given; rad/s, by distance from the origin.

        They are the eigenvalues of the pencil of its realisation, found without forming polynomials.
        """
        column = row if column is None else column
        m = len(self.frequency_hz)
        size = 2 * m + 1
        a = np.zeros((size + 1, size + 1))
        p, q = self.poles, self.shape[:, row] * self.shape[:, column]
        for r in range(m):
            a[2 * r : 2 * r + 2, 2 * r : 2 * r + 2] = [[p[r].real, p[r].imag], [-p[r].imag, p[r].real]]
        a[: 2 * m : 2, size] = 2.0
        a[size, : 2 * m : 2], a[size, 1 : 2 * m : 2] = q.real, q.imag
        a[size - 1, size - 1], a[size - 1, size] = -TURN * self.decay_hz, 1.0
        a[size, size - 1], a[size, size] = -self.drag[row, column], self.direct[row, column]
        e = np.eye(size + 1)
        e[size, size] = -self.slope[row, column]
        found = linalg.eigvals(a, e)
        found = found[np.isfinite(found)]
        return found[np.argsort(np.abs(found))]

    def antiresonances_hz(self, drive: int) -> Array:
        """Undamped antiresonances of a drive point (5.41), ascending, Hz: the distance of its complex zeros from the origin."""
        return np.abs(self.complex_zeros(drive)) / TURN

    def complex_zeros(self, drive: int) -> ComplexArray:
        """Zeros of a drive point above the real axis, rad/s, by distance from the origin."""
        z = self.zeros(drive)
        return z[z.imag > 1e-6 * np.abs(z)]

    def rigid_inverse(self) -> Array:
        """Inverse of the rigid mass matrix (5.52): the gain below the first resonance without friction, shape (n, n)."""
        return self.direct - 2 * np.einsum("mj,mk,m->jk", self.shape, self.shape, 1 / self.poles).real


# ---- parameters -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TermLayout:
    """Where each parameter stands in the vector: modes (frequency, damping, Re u, Im u), D, E, a, R, T."""

    modes: int
    size: int
    high_hz: float  # unit of E
    delays: int  # 0, 1 for all torques alike, or one each

    @property
    def entries(self) -> int:
        return self.size * (self.size + 1) // 2

    @property
    def count(self) -> int:
        return self.modes * (2 + 2 * self.size) + 3 * self.entries + 1 + self.delays

    def pack(self, model: TransferFunctions) -> Array:
        upper = np.triu_indices(self.size)
        own = [model.frequency_hz[:, None], model.damping_ratio[:, None], model.shape.real, model.shape.imag]
        slope = model.slope[upper] * TURN * self.high_hz
        delay = model.delay[: self.delays]
        return np.concatenate(
            [np.hstack(own).ravel(), model.direct[upper], slope, [model.decay_hz], model.drag[upper], delay]
        )

    def unpack(self, x: Array) -> TransferFunctions:
        n, k = self.size, self.entries
        own, rest = np.split(x, [self.modes * (2 + 2 * n)])
        own = own.reshape(self.modes, -1)
        direct, slope, decay, drag, delay = np.split(rest, np.cumsum([k, k, 1, k]))
        full = symmetric_basis(n)
        return TransferFunctions(
            own[:, 0],
            own[:, 1],
            own[:, 2 : 2 + n] + 1j * own[:, 2 + n :],
            np.tensordot(direct, full, 1),
            np.tensordot(slope, full, 1) / (TURN * self.high_hz),
            float(decay[0]),
            np.tensordot(drag, full, 1),
            np.broadcast_to(delay, n) if self.delays else np.zeros(n),
        )

    def jacobian(self, model: TransferFunctions, s: ComplexArray) -> ComplexArray:
        """Derivatives of the upper entries of P without delay, shape (F, entries, parameters but delays)."""
        n, k = self.size, self.entries
        rows, columns = np.triu_indices(n)
        p, u = model.poles, model.shape
        z = model.damping_ratio
        q = u[:, rows] * u[:, columns]  # (m, k)
        one, other = 1 / (s[:, None] - p), 1 / (s[:, None] - p.conj())
        out = np.zeros((len(s), k, self.count - self.delays), complex)
        own = out[:, :, : self.modes * (2 + 2 * n)].reshape(len(s), k, self.modes, 2 + 2 * n)
        squares = np.einsum("fm,mk->fkm", one**2, q), np.einsum("fm,mk->fkm", other**2, q.conj())
        by_frequency, by_damping = p / model.frequency_hz, TURN * model.frequency_hz * (-1 - 1j * z / np.sqrt(1 - z**2))
        for place, step in enumerate((by_frequency, by_damping)):
            own[..., place] = squares[0] * step + squares[1] * step.conj()
        pick = np.eye(n)
        by_shape = pick[rows][None] * u[:, columns, None] + pick[columns][None] * u[:, rows, None]  # (m, k, n)
        left, right = np.einsum("fm,mkn->fkmn", one, by_shape), np.einsum("fm,mkn->fkmn", other, by_shape.conj())
        own[..., 2 : 2 + n], own[..., 2 + n :] = left + right, 1j * (left - right)
        out[:, :, : self.modes * (2 + 2 * n)] = own.reshape(len(s), k, -1)
        at = self.modes * (2 + 2 * n)
        decay = 1 / (s + TURN * model.decay_hz)
        for fraction in (np.ones_like(s), s / (TURN * self.high_hz)):
            out[:, np.arange(k), at + np.arange(k)] = fraction[:, None]
            at += k
        out[:, :, at] = TURN * (decay**2)[:, None] * model.drag[rows, columns]
        out[:, np.arange(k), at + 1 + np.arange(k)] = -decay[:, None]
        return out


def _start(data: SymmetricData, poles: ComplexArray, layout: _TermLayout, decay_hz: float) -> TransferFunctions:
    """Model over given poles: the best residues, each replaced by its nearest of rank one."""
    n = layout.size
    found, _ = residue_fit(data, np.concatenate([poles, [-TURN * decay_hz]]))
    full = symmetric_basis(n)
    direct, slope, drag = (np.tensordot(c, full, 1) for c in found.T[:3])
    m = len(poles)
    residues = np.einsum("km,kab->mab", found[:, 3 : 3 + m] + 1j * found[:, 3 + m :], full)
    left = np.linalg.svd(residues)[0][:, :, 0]
    size = np.einsum("ma,mab,mb->m", left.conj(), residues, left.conj())
    shape = left * np.sqrt(size)[:, None]
    p = poles
    return TransferFunctions(np.abs(p) / TURN, -p.real / np.abs(p), shape, direct, slope, decay_hz, -drag, np.zeros(n))


# ---- fit ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bounds:
    """Limits of the modes and of what stands beside them; a user's own replace these.

    Attributes
    ----------
    frequency_hz : (low, high) of every mode; by default from the lowest line to twice the highest.
    damping_ratio : (low, high).
    decay_hz : (low, high) of the friction's real pole; by default up to half the lowest line.
    delay_s : (low, high).
    antiresonances : tuple of (joint, low, high)
        The antiresonance of that joint's drive point which is nearest to the interval, Hz, stays in it. Zeros are functions of
        modes and what stands beside them: a steep price keeps them.
    """

    frequency_hz: tuple[float, float] | None = None
    damping_ratio: tuple[float, float] = DAMPING
    decay_hz: tuple[float, float] | None = None
    delay_s: tuple[float, float] = (-0.01, 0.01)
    antiresonances: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True)
class CandidateModel:
    """A number of modes that was tried.

    Attributes
    ----------
    modes : int
    cost : float
        (6.35): weighted sum of squares.
    parameters : int
    criterion : float
        What decides; the lowest is chosen.
    started : str
        Where its poles came from.
    bound : bool
        Whether a mode not above the lines ended on a bound: then it is no mode of the band, and the criterion counts
        `BOUND_PRICE` times.
    """

    modes: int
    cost: float
    parameters: int
    criterion: float
    started: str
    bound: bool


@dataclass(frozen=True, eq=False)
class TransferFit:
    """Transfer functions with their uncertainty, and how they were found.

    Attributes
    ----------
    model : TransferFunctions
    response : FrequencyResponse
        The lines that were fitted.
    covariance : array, shape (p, p)
        Of the parameters (6.46), for weights estimated with the response's degrees of freedom; see `inflation`.
    cost : float
        V of (6.35), over n*n entries a line.
    inflation : float
        Covariances were multiplied by it, at least 1: the cost over its expected value. Errors of the model and
        nonlinear bias raise it above 1; (6.46) alone would keep silent about them.
    parameters : int
    candidates : tuple of Candidate
    pole_sets : tuple of PoleSet
        Of the linear fits, for a stabilisation diagram.
    """

    model: TransferFunctions
    response: FrequencyResponse
    covariance: Array
    cost: float
    inflation: float
    parameters: int
    candidates: tuple[CandidateModel, ...]
    pole_sets: tuple[PoleSet, ...]
    _layout: _TermLayout

    @property
    def resonances_hz(self) -> Array:
        """Undamped resonances, ascending, shape (m,)."""
        return self.model.frequency_hz

    def torque_delays(self) -> tuple[Array, Array]:
        """By how much torques were logged later than angles, and standard deviations, s; as many as delays were fitted."""
        count = self._layout.delays
        spread = np.diag(self.covariance)[len(self.covariance) - count :]
        return -self.model.delay[:count], np.asarray(np.sqrt(spread))

    def resonances_std_hz(self) -> Array:
        """Standard deviations of `resonances_hz`, shape (m,)."""
        return self._spread(self.resonance_derivatives()[1])

    def damping_std(self) -> Array:
        """Standard deviations of the damping ratios, shape (m,)."""
        return self._spread(self._of_modes(1))

    def _spread(self, derivatives: Array) -> Array:
        return np.sqrt(np.einsum("...p,pq,...q->...", derivatives, self.covariance, derivatives))

    def _of_modes(self, place: int) -> Array:
        width = 2 + 2 * self._layout.size
        return np.eye(self._layout.count)[place : self._layout.modes * width : width]

    def resonance_derivatives(self) -> tuple[Array, Array]:
        """Resonances, Hz, and their derivatives by the parameters, shapes (m,) and (m, p)."""
        return self.model.frequency_hz, self._of_modes(0)

    def decay_derivatives(self) -> tuple[Array, Array]:
        """Decay rates ``-Re(p)``, rad/s, and their derivatives by the parameters, shapes (m,) and (m, p)."""
        f, z = TURN * self.model.frequency_hz, self.model.damping_ratio
        return f * z, TURN * z[:, None] * self._of_modes(0) + f[:, None] * self._of_modes(1)

    def rigid_inverse_derivatives(self) -> Array:
        """Derivatives of `TransferFunctions.rigid_inverse` by the parameters, shape (n, n, p)."""
        layout = self._layout
        upper = layout.jacobian(self.model, np.zeros(1, complex))[0].real
        at = layout.modes * (2 + 2 * layout.size) + 2 * layout.entries
        upper[:, at : at + 1 + layout.entries] = 0.0  # without friction
        out = np.zeros((layout.size, layout.size, layout.count))
        out[..., : upper.shape[1]] = np.tensordot(symmetric_basis(layout.size), upper, ((0,), (0,)))
        return out

    def in_band(self, hz: Array) -> NDArray[np.bool_]:
        """Which frequencies lie between the lines: those outside only stand for what is beyond."""
        return (np.asarray(hz) >= self.response.hz[0]) & (np.asarray(hz) <= self.response.hz[-1])

    def antiresonances(self, drive: int) -> tuple[Array, Array]:
        """Undamped antiresonances of a drive point (5.41) and their standard deviations, ascending, Hz."""
        hz, by = self.antiresonance_derivatives(drive)
        return hz, self._spread(by)

    def antiresonance_derivatives(self, drive: int) -> tuple[Array, Array]:
        """Antiresonances of a drive point, Hz, and their derivatives by the parameters, shapes (z,) and (z, p).

        A zero moves with the parameters by ``dz = -(dP/dtheta) / (dP/ds)``.
        """
        z = self.model.complex_zeros(drive)
        along = (z.conj() / np.abs(z))[:, None] * _zero_derivatives(self._layout, self.model, drive, z)
        return np.abs(z) / TURN, along.real / TURN

    def frf_std(self, hz: Array) -> Array:
        """Standard deviation of the fitted FRF (6.48), ``sqrt(E |d|^2)``, shape (F, n, n), rad/s^2 per N m."""
        s = 2j * np.pi * np.asarray(hz, float)
        by = _delayed_jacobian(self._layout, self.model, s)
        return np.sqrt(np.einsum("fap,pq,faq->fa", by, self.covariance, by.conj()).real).reshape(
            len(s), self._layout.size, -1
        )


def _zero_derivatives(layout: _TermLayout, model: TransferFunctions, drive: int, z: ComplexArray) -> ComplexArray:
    """Derivatives of zeros z of a drive point by the parameters, shape (z, p)."""
    free = layout.count - layout.delays
    rows, columns = np.triu_indices(layout.size)
    entry = int(np.flatnonzero((rows == drive) & (columns == drive))[0])
    out = np.zeros((len(z), layout.count), complex)
    out[:, :free] = layout.jacobian(model, z)[:, entry]
    q, p = model.shape[:, drive] ** 2, model.poles
    by_s = model.slope[drive, drive] + model.drag[drive, drive] / (z + TURN * model.decay_hz) ** 2
    by_s = by_s - (q / (z[:, None] - p) ** 2 + q.conj() / (z[:, None] - p.conj()) ** 2).sum(axis=1)
    return -out / by_s[:, None]


def fit_transfer_functions(
    response: FrequencyResponse,
    modes: int | Sequence[int] = range(2, 9),
    *,
    delays: str = "none",
    leave_out_hz: Sequence[tuple[float, float]] = (),
    start: TransferFunctions | None = None,
    bounds: Bounds | None = None,
    criterion: str = "mdl",
    powers: Sequence[float] = POWERS,
) -> TransferFit:
    """Symmetric transfer functions by maximum likelihood, with their order, without a hand in it.

    For each number of modes, poles come from linear fits of several orders and weights (`starting_poles`) and from
    the fit with one mode less and a new pole where it helps most; the likelihood is climbed from each by
    Levenberg-Marquardt with the analytic Jacobian, and the lowest cost stays. The number of modes is that of the lowest
    criterion, where two more did not lower it.

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
        Initial model; then its number of modes counts and no other start is tried.
    bounds : Bounds, optional
    criterion : str
        ``mdl`` (minimum description length) or ``aic``.
    powers : values of w for the linear fits (6.41).

    Raises
    ------
    ValueError
        Too few lines; a covariance that is not positive definite; unknown words; an initial model outside its bounds.
    """
    if delays not in ("none", "common", "each"):
        raise ValueError(f"delays is {delays!r}; expected 'none', 'common' or 'each'")
    if criterion not in ("mdl", "aic"):
        raise ValueError(f"criterion is {criterion!r}; expected 'mdl' or 'aic'")
    response = _without(response, leave_out_hz)
    n, high = len(response.joints), float(response.hz[-1]) if len(response.hz) else 1.0
    tried = (len(start.frequency_hz),) if start is not None else (modes,) if isinstance(modes, int) else tuple(modes)
    count = {"none": 0, "common": 1, "each": n}[delays]
    layouts = {m: _TermLayout(m, n, high, count) for m in tried}
    rows = 2 * len(response.hz) * n * n
    needed = max((layout.count for layout in layouts.values()), default=0)
    if not tried or min(tried) < 1 or rows < 2 * needed:
        raise ValueError(
            f"{len(response.hz)} lines give {rows} numbers for the {needed} parameters of {max(tried, default=0)} modes; "
            "expected modes from 1 on and twice as many numbers as parameters"
        )
    bounds = _filled(bounds or Bounds(), response)
    problem = _TransferFunctionProblem(response, _zero_bounds(bounds, response))
    sets: tuple[PoleSet, ...] = ()
    if start is None:
        sets = starting_poles(problem.data, range(2 * min(tried), 2 * max(tried) + 4, 2), powers)
    price = np.log(rows) / 2 if criterion == "mdl" else 1.0  # of a parameter, in units of the cost
    spread = efficiency(response)[0]
    best: tuple[float, Array, float, _TermLayout] | None = None
    candidates: list[CandidateModel] = []
    before: TransferFunctions | None = None
    for m in tried:
        layout = layouts[m]
        fits = []
        for told, model in _starts(problem, layout, sets, before, bounds, start):
            fits.append((*_climb(problem, layout, layout.pack(model), bounds), told))
        x, cost, told = min(fits, key=lambda fit: fit[1])
        before = layout.unpack(x)
        on_bound, value = _on_bound(layout, x, bounds), float(cost / spread + price * layout.count)
        candidates.append(CandidateModel(m, cost, layout.count, value, told, on_bound))
        score = value * (BOUND_PRICE if on_bound else 1.0)
        if best is None or score < best[0]:
            best = (score, x, cost, layout)
        elif m - best[3].modes >= 2:
            break
    assert best is not None
    _, x, cost, layout = best
    return _result(problem, layout, x, cost, tuple(candidates), sets)


def _without(response: FrequencyResponse, leave_out_hz: Sequence[tuple[float, float]]) -> FrequencyResponse:
    kept = np.ones(len(response.hz), bool)
    for centre, half in leave_out_hz:
        kept &= np.abs(response.hz - centre) > half
    if kept.all():
        return response
    noise = response.noise_covariance
    return replace(
        response,
        hz=response.hz[kept],
        value=response.value[kept],
        covariance=response.covariance[kept],
        noise_covariance=None if noise is None else noise[kept],
    )


def _filled(bounds: Bounds, response: FrequencyResponse) -> Bounds:
    low, high = float(response.hz[0]), float(response.hz[-1])
    return replace(
        bounds,
        frequency_hz=bounds.frequency_hz or (low, 2 * high),
        decay_hz=bounds.decay_hz or (1e-3 * low, low / 2),
    )


def _zero_bounds(bounds: Bounds, response: FrequencyResponse) -> list[tuple[int, float, float]]:
    out = []
    for joint, low, high in bounds.antiresonances:
        if joint not in response.joints or not 0.0 <= low < high:
            raise ValueError(
                f"antiresonance of {joint!r} between {low:g} and {high:g} Hz; expected a joint of {', '.join(response.joints)} "
                "and an ascending pair"
            )
        out.append((response.joints.index(joint), low, high))
    return out


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


class _TransferFunctionProblem:
    """Residuals and Jacobian of the likelihood over one response."""

    def __init__(self, response: FrequencyResponse, zeros: Sequence[tuple[int, float, float]] = ()) -> None:
        self.response = response
        self.zeros = zeros  # drive, lowest and highest frequency of an antiresonance, Hz
        self.data = symmetric_data(response)
        self.white = whitening(response)
        self.n = len(response.joints)
        self.upper = np.triu_indices(self.n)

    def cost(self, layout: _TermLayout, x: Array) -> float:
        model = layout.unpack(x)
        r, beyond = self.residual(layout, model), self.beyond(layout, model)[0]
        return float((np.abs(r) ** 2).sum() + beyond @ beyond) + (0.0 if layout.delays else self.data.rest)

    def beyond(self, layout: _TermLayout, model: TransferFunctions) -> tuple[Array, Array]:
        """How far each bounded antiresonance is out of its bounds, over `EDGE_HZ`, and its derivatives, (z,) and (z, p)."""
        values, slopes = [], []
        for drive, low, high in self.zeros:
            z = model.complex_zeros(drive)
            hz = np.abs(z) / TURN
            out = hz - np.clip(hz, low, high)
            nearest = int(np.argmin(np.abs(out))) if len(out) else -1
            if nearest >= 0 and out[nearest] != 0.0:
                one = z[nearest : nearest + 1]
                by = (one.conj() / np.abs(one) @ _zero_derivatives(layout, model, drive, one)).real / TURN
                values.append(out[nearest] / EDGE_HZ)
                slopes.append(by / EDGE_HZ)
        return np.array(values), np.array(slopes).reshape(len(values), layout.count)

    def residual(self, layout: _TermLayout, model: TransferFunctions) -> ComplexArray:
        """Whitened model minus data: of the n*n entries with delays, of what a symmetric model reaches without."""
        s = self.data.s
        if layout.delays:
            error = model.frf(self.response.hz) - self.response.value
            return np.einsum("fab,fb->fa", self.white, error.reshape(len(s), -1))
        upper = model._undelayed(s)[:, self.upper[0], self.upper[1]]
        return np.einsum("fak,fk->fa", self.data.weight, upper) - self.data.target

    def jacobian(self, layout: _TermLayout, model: TransferFunctions) -> ComplexArray:
        if layout.delays:
            return self.white @ _delayed_jacobian(layout, model, self.data.s)
        return self.data.weight @ layout.jacobian(model, self.data.s)

    def normal_equations(self, layout: _TermLayout, x: Array) -> tuple[Array, Array]:
        """Gauss-Newton Hessian and gradient of half the cost."""
        model = layout.unpack(x)
        j, r = self.jacobian(layout, model), self.residual(layout, model)
        beyond, by = self.beyond(layout, model)
        rows, target = np.vstack([real_rows(j), by]), np.append(real_rows(r[:, :, None])[:, 0], beyond)
        return rows.T @ rows, rows.T @ target


def _delayed_jacobian(layout: _TermLayout, model: TransferFunctions, s: ComplexArray) -> ComplexArray:
    """Derivatives of all n*n entries of P, delays included, shape (F, n*n, parameters)."""
    n = layout.size
    expand = symmetric_basis(n).reshape(-1, n * n).T  # entries from upper entries
    late = np.exp(-s[:, None] * model.delay)[:, np.tile(np.arange(n), n)]
    out = np.zeros((len(s), n * n, layout.count), complex)
    free = layout.count - layout.delays
    out[:, :, :free] = late[:, :, None] * (expand @ layout.jacobian(model, s))
    if layout.delays:
        value = -s[:, None] * late * model._undelayed(s).reshape(len(s), -1)
        columns = np.tile(np.arange(n), n) if layout.delays > 1 else np.zeros(n * n, int)
        out[:, np.arange(n * n), free + columns] = value
    return out


def _limits(layout: _TermLayout, bounds: Bounds) -> tuple[Array, Array]:
    assert bounds.frequency_hz is not None and bounds.decay_hz is not None
    low, high = np.full(layout.count, -np.inf), np.full(layout.count, np.inf)
    width = 2 + 2 * layout.size
    end = layout.modes * width
    places: list[tuple[slice, tuple[float, float]]] = [
        (slice(0, end, width), bounds.frequency_hz),
        (slice(1, end, width), bounds.damping_ratio),
        (slice(end + 2 * layout.entries, end + 2 * layout.entries + 1), bounds.decay_hz),
        (slice(layout.count - layout.delays, layout.count), bounds.delay_s),
    ]
    for place, (least, most) in places:
        low[place], high[place] = least, most
    return low, high


def _on_bound(layout: _TermLayout, x: Array, bounds: Bounds) -> bool:
    """Whether a mode not above the lines sits on a bound. Above them a broad one may stand for all that lies there."""
    low, high = _limits(layout, bounds)
    width = 2 + 2 * layout.size
    at = ((x <= low) | (x >= high))[: layout.modes * width].reshape(layout.modes, width).any(axis=1)
    return bool(np.any(at & (x[: layout.modes * width : width] <= layout.high_hz)))


def _climb(
    problem: _TransferFunctionProblem, layout: _TermLayout, x: Array, bounds: Bounds, iterations: int = 150
) -> tuple[Array, float]:
    """Levenberg-Marquardt within bounds, until a step would lower the cost by less than a hundredth.

    The cost is in units of the noise: a tenth of a parameter's standard deviation is worth a hundredth of it.
    """
    low, high = _limits(layout, bounds)
    x = np.clip(x, low, high)
    cost, ease = problem.cost(layout, x), 1e-2
    quiet = 0
    for _ in range(iterations):
        hessian, gradient = problem.normal_equations(layout, x)
        free = ~(((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0)))
        inner, slope = hessian[np.ix_(free, free)], gradient[free]
        scale = np.sqrt(np.diag(inner)) + 1e-300
        normal = inner / np.outer(scale, scale)
        while ease < 1e8:
            step = np.zeros_like(x)
            step[free] = -np.linalg.solve(normal + ease * np.eye(len(slope)), slope / scale) / scale
            new = np.clip(x + step, low, high)
            lower = problem.cost(layout, new)
            if lower < cost:
                break
            ease *= 4.0
        else:
            break
        gained, x, cost, ease = cost - lower, new, lower, max(ease / 9.0, 1e-10)
        quiet = quiet + 1 if gained < 1e-2 else 0
        if quiet == 2:
            break
    return x, cost


def _starts(
    problem: _TransferFunctionProblem,
    layout: _TermLayout,
    sets: Sequence[PoleSet],
    before: TransferFunctions | None,
    bounds: Bounds,
    start: TransferFunctions | None,
) -> list[tuple[str, TransferFunctions]]:
    """Models with the layout's number of modes to climb from, with where they came from."""
    assert bounds.frequency_hz is not None and bounds.decay_hz is not None
    if start is not None:
        low, high = _limits(layout, bounds)
        x = layout.pack(start)
        bad = np.flatnonzero((x < low) | (x > high))
        if len(bad):
            raise ValueError(
                f"the initial model's parameter {bad[0]} is {x[bad[0]]:.4g}; expected {low[bad[0]]:.4g} to {high[bad[0]]:.4g}"
            )
        return [("given", start)]
    decay = float(np.sqrt(np.prod(bounds.decay_hz)))
    found: list[tuple[float, str, ComplexArray]] = []

    def add(told: str, poles: NDArray[Any]) -> None:
        cost = residue_fit(problem.data, np.append(poles, -TURN * decay))[1]
        found.append((cost, told, poles))

    spacing = float(np.median(np.diff(problem.response.hz)))
    for one in sets:
        # narrower than the lines lie apart, or outside the bounds: not a mode but the noise of a line, or the edges
        f, z = one.frequencies_hz, one.damping_ratios
        plausible = (f * z > spacing / 4) & (f > bounds.frequency_hz[0]) & (f < bounds.frequency_hz[1])
        poles = one.poles[plausible & (z < bounds.damping_ratio[1])]
        while len(poles) > layout.modes:
            poles = min((np.delete(poles, i) for i in range(len(poles))), key=lambda p: residue_fit(problem.data, p)[1])
        if len(poles) == layout.modes:
            add(f"linear fit of order {one.order}, w = {one.power:g}", poles)
    if before is not None and len(before.poles) == layout.modes - 1:
        low, high = problem.response.hz[0], problem.response.hz[-1]
        typical = float(np.median(before.damping_ratio))
        inside, above = np.geomspace(low, high, 30), np.geomspace(1.05 * high, bounds.frequency_hz[1], 6)[:-1]
        for told, places, damping in (
            ("one mode more", inside, (typical,)),
            ("a mode above the band", above, (typical, 0.2, 0.4)),
        ):
            for centre, ratio in product(places.tolist(), damping):
                pole = np.array([TURN * centre * (-ratio + 1j * np.sqrt(1 - ratio**2))], complex)
                add(told, np.concatenate([before.poles, pole]))
    if not found:
        f = np.geomspace(problem.response.hz[0], problem.response.hz[-1], layout.modes + 2)[1:-1]
        add("spread over the band", TURN * f * (-0.05 + 1j))
    found.sort(key=lambda item: item[0])
    chosen: list[tuple[float, str, ComplexArray]] = []
    for item in found:  # the best of each kind
        if item[1].split(" of ")[0] not in {c[1].split(" of ")[0] for c in chosen}:
            chosen.append(item)
    return [(told, _start(problem.data, poles, layout, decay)) for _, told, poles in chosen]


def _result(
    problem: _TransferFunctionProblem,
    layout: _TermLayout,
    x: Array,
    cost: float,
    candidates: tuple[CandidateModel, ...],
    sets: tuple[PoleSet, ...],
) -> TransferFit:
    order = np.argsort(layout.unpack(x).frequency_hz)
    own = x[: layout.modes * (2 + 2 * layout.size)].reshape(layout.modes, -1)[order]
    x = np.concatenate([own.ravel(), x[own.size :]])
    hessian, _ = problem.normal_equations(layout, x)
    scale = np.sqrt(np.diag(hessian)) + 1e-300
    inverse = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    mean, _, loss = efficiency(problem.response)
    expected = mean * (len(problem.response.hz) * problem.n**2 - layout.count / 2)
    inflation = max(1.0, cost / expected) if np.isfinite(expected) else 1.0
    return TransferFit(
        layout.unpack(x),
        problem.response,
        inverse / 2 * (loss if np.isfinite(loss) else 1.0) * inflation,
        cost,
        inflation,
        layout.count,
        candidates,
        sets,
        layout,
    )
