"""Transfer functions as sums of modes and of what stands for modes beside the band; their parameters, derivatives and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray
from rx90b_flex.identify.starting_values import symmetric_basis

TURN = 2 * np.pi
NEARLY_STILL = 1e-6  # rad/s
TERMS = {-2: "restoring", 0: "direct", 1: "slope", 2: "flexibility"}  # beside the modes, by powers of s
POWERS_OF_S = (-2, 0, 1, 2)  # of Q, D, E and F


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
    direct, slope, flexibility : array, shape (n, n)
        D, rad/s^2 per N m; E, the same times s; F, the residual flexibility of the modes above the band, rad per N m.
    restoring : array, shape (n, n)
        Q, rad/s^4 per N m.
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
    flexibility: Array
    restoring: Array
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
        smooth = self.direct + s * self.slope + s**2 * self.flexibility + self.restoring / s**2
        return smooth - self.drag / (s + TURN * self.decay_hz) + modes

    def zeros(self, drive: int) -> ComplexArray:
        """Finite zeros of a drive point, rad/s, by distance from the origin.

        They are the eigenvalues of the pencil of its realisation, found without forming polynomials.
        """
        m = len(self.frequency_hz)
        own = 2 * m  # states: of modes, of friction; torque integrated once and twice; s times torque; torque
        decay, once, twice, rate, torque = range(own, own + 5)
        a, e = np.zeros((own + 5, own + 5)), np.eye(own + 5)
        p, q = self.poles, self.shape[:, drive] ** 2
        for r in range(m):
            a[2 * r : 2 * r + 2, 2 * r : 2 * r + 2] = [[p[r].real, p[r].imag], [-p[r].imag, p[r].real]]
        a[:own:2, torque] = 2.0
        a[decay, decay], a[decay, torque] = -TURN * self.decay_hz, 1.0
        a[once, torque] = a[twice, once] = 1.0
        a[torque, twice] = self.restoring[drive, drive]
        a[rate, rate], e[rate, rate], e[rate, torque] = 1.0, 0.0, 1.0
        a[torque, :own:2], a[torque, 1:own:2] = q.real, q.imag
        a[torque, decay], a[torque, torque] = -self.drag[drive, drive], self.direct[drive, drive]
        a[torque, rate] = self.slope[drive, drive]
        e[torque, rate], e[torque, torque] = -self.flexibility[drive, drive], 0.0
        found = linalg.eigvals(a, e)
        found = found[np.isfinite(found)]
        return found[np.argsort(np.abs(found))]

    def complex_zeros(self, drive: int) -> ComplexArray:
        """Zeros of a drive point above the real axis, rad/s, by distance from the origin."""
        z = self.zeros(drive)
        return z[z.imag > 1e-6 * np.abs(z)]

    def rigid_inverse(self) -> Array:
        """Inverse of the rigid mass matrix (5.52): the gain below the first resonance without friction, shape (n, n)."""
        return self.direct - 2 * np.einsum("mj,mk,m->jk", self.shape, self.shape, 1 / self.poles).real


# ---- parameters -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TermLayout:
    """Where each parameter stands in the vector: modes (frequency, damping, Re u, Im u), of Q, D, E and F what it has, a, R, T."""

    modes: int
    size: int
    high_hz: float  # unit of s
    delays: int  # 0, 1 for all torques alike, or one each
    powers: tuple[int, ...] = POWERS_OF_S
    low_hz: float = 0.0  # antiresonances below it are none

    @property
    def entries(self) -> int:
        """Independent entries of a symmetric matrix."""
        return self.size * (self.size + 1) // 2

    @property
    def width(self) -> int:
        """Parameters of a mode."""
        return 2 + 2 * self.size

    @property
    def decay(self) -> int:
        """Place of a."""
        return self.modes * self.width + len(self.powers) * self.entries

    @property
    def count(self) -> int:
        """All parameters."""
        return self.decay + 1 + self.entries + self.delays

    def units(self) -> Array:
        """Of Q, D, E and F as far as there are any, 1 / s to their powers."""
        return (TURN * self.high_hz) ** -np.array(self.powers, float)

    def pack(self, model: TransferFunctions) -> Array:
        """The vector of a model's parameters."""
        upper = np.triu_indices(self.size)
        own = [model.frequency_hz[:, None], model.damping_ratio[:, None], model.shape.real, model.shape.imag]
        smooth = [getattr(model, TERMS[power])[upper] for power in self.powers]
        return np.concatenate(
            [
                np.hstack(own).ravel(),
                *(x / unit for x, unit in zip(smooth, self.units(), strict=True)),
                [model.decay_hz],
                model.drag[upper],
                model.delay[: self.delays],
            ]
        )

    def unpack(self, x: Array) -> TransferFunctions:
        """The model of a vector of parameters."""
        n, k = self.size, self.entries
        own, rest, decay, drag, delay = np.split(x, np.cumsum([self.modes * self.width, len(self.powers) * k, 1, k]))
        own = own.reshape(self.modes, -1)
        full = symmetric_basis(n)
        each = np.tensordot(rest.reshape(-1, k) * self.units()[:, None], full, 1)
        smooth = {power: np.zeros((n, n)) for power in POWERS_OF_S} | dict(zip(self.powers, each, strict=True))
        return TransferFunctions(
            own[:, 0],
            own[:, 1],
            own[:, 2 : 2 + n] + 1j * own[:, 2 + n :],
            smooth[0],
            smooth[1],
            smooth[2],
            smooth[-2],
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
        own = out[:, :, : self.modes * self.width].reshape(len(s), k, self.modes, self.width)
        squares = np.einsum("fm,mk->fkm", one**2, q), np.einsum("fm,mk->fkm", other**2, q.conj())
        by_frequency, by_damping = p / model.frequency_hz, TURN * model.frequency_hz * (-1 - 1j * z / np.sqrt(1 - z**2))
        for place, step in enumerate((by_frequency, by_damping)):
            own[..., place] = squares[0] * step + squares[1] * step.conj()
        pick = np.eye(n)
        by_shape = pick[rows][None] * u[:, columns, None] + pick[columns][None] * u[:, rows, None]  # (m, k, n)
        left, right = np.einsum("fm,mkn->fkmn", one, by_shape), np.einsum("fm,mkn->fkmn", other, by_shape.conj())
        own[..., 2 : 2 + n], own[..., 2 + n :] = left + right, 1j * (left - right)
        out[:, :, : self.modes * self.width] = own.reshape(len(s), k, -1)
        at = self.modes * self.width
        decay = 1 / (s + TURN * model.decay_hz)
        for power, unit in zip(self.powers, self.units(), strict=True):
            out[:, np.arange(k), at + np.arange(k)] = (unit * s**power)[:, None]
            at += k
        out[:, :, at] = TURN * (decay**2)[:, None] * model.drag[rows, columns]
        out[:, np.arange(k), at + 1 + np.arange(k)] = -decay[:, None]
        return out


def zero_derivatives(layout: TermLayout, model: TransferFunctions, drive: int, z: ComplexArray) -> ComplexArray:
    """Derivatives of zeros z of a drive point by the parameters, shape (z, p)."""
    free = layout.count - layout.delays
    rows, columns = np.triu_indices(layout.size)
    entry = int(np.flatnonzero((rows == drive) & (columns == drive))[0])
    out = np.zeros((len(z), layout.count), complex)
    out[:, :free] = layout.jacobian(model, z)[:, entry]
    q, p = model.shape[:, drive] ** 2, model.poles
    by_s = (
        model.slope[drive, drive]
        + 2 * z * model.flexibility[drive, drive]
        + model.drag[drive, drive] / (z + TURN * model.decay_hz) ** 2
    )
    by_s = by_s - 2 * model.restoring[drive, drive] / z**3
    by_s = by_s - (q / (z[:, None] - p) ** 2 + q.conj() / (z[:, None] - p.conj()) ** 2).sum(axis=1)
    return -out / by_s[:, None]


def delayed_jacobian(layout: TermLayout, model: TransferFunctions, s: ComplexArray) -> ComplexArray:
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


@dataclass(frozen=True, eq=False)
class FittedModel:
    """Transfer functions with the covariance of their parameters.

    Attributes
    ----------
    model : TransferFunctions
    covariance : array, shape (p, p)
        Of the parameters (6.46), for weights estimated with the response's degrees of freedom, times `inflation`.
    cost : float
        V of (6.35), over n*n entries a line.
    inflation : float
        Covariances were multiplied by it, at least 1: the cost over its expected value. Errors of the model and
        nonlinear bias raise it above 1; (6.46) alone would keep silent about them.
    parameters : int
    """

    model: TransferFunctions
    covariance: Array
    cost: float
    inflation: float
    parameters: int
    _layout: TermLayout

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
        return self.spread(self.resonance_derivatives()[1])

    def damping_std(self) -> Array:
        """Standard deviations of the damping ratios, shape (m,)."""
        return self.spread(self._of_modes(1))

    def modes_told(self) -> tuple[Array, Array, Array, Array]:
        """Resonances and standard deviations, Hz, damping ratios and theirs, each (m,)."""
        return self.resonances_hz, self.resonances_std_hz(), self.model.damping_ratio, self.damping_std()

    def spread(self, derivatives: Array) -> Array:
        """Standard deviations of what has these derivatives by the parameters, (..., p) to (...)."""
        return np.sqrt(np.einsum("...p,pq,...q->...", derivatives, self.covariance, derivatives))

    def _of_modes(self, place: int) -> Array:
        width = self._layout.width
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
        start = layout.modes * layout.width
        upper = layout.jacobian(self.model, np.full(1, NEARLY_STILL, complex))[0].real
        upper[:, start:] = 0.0  # without friction and what the rigid-body motion is held by
        direct = start + layout.powers.index(0) * layout.entries
        upper[:, direct : direct + layout.entries] = np.eye(layout.entries)
        out = np.zeros((layout.size, layout.size, layout.count))
        out[..., : upper.shape[1]] = np.tensordot(symmetric_basis(layout.size), upper, ((0,), (0,)))
        return out

    def antiresonances(self, drive: int) -> tuple[Array, Array]:
        """Undamped antiresonances of a drive point (5.41) and their standard deviations, ascending, Hz."""
        hz, by = self.antiresonance_derivatives(drive)
        return hz, self.spread(by)

    def antiresonance_zeros(self, drive: int) -> ComplexArray:
        """Zeros of a drive point above the real axis and not below the lines, rad/s, by distance from the origin."""
        z = self.model.complex_zeros(drive)
        return z[np.abs(z) >= TURN * self._layout.low_hz]

    def antiresonance_derivatives(self, drive: int) -> tuple[Array, Array]:
        """Antiresonances of a drive point, Hz, and their derivatives by the parameters, shapes (z,) and (z, p).

        A zero moves with the parameters by ``dz = -(dP/dtheta) / (dP/ds)``.
        """
        z = self.antiresonance_zeros(drive)
        along = (z.conj() / np.abs(z))[:, None] * zero_derivatives(self._layout, self.model, drive, z)
        return np.abs(z) / TURN, along.real / TURN

    def residual_flexibility(self) -> tuple[Array, Array]:
        """F and its standard deviations, rad per N m, shape (n, n); zero where the term does not pay."""
        layout, n = self._layout, self._layout.size
        std = np.zeros((n, n))
        if 2 in layout.powers:
            place = layout.powers.index(2)
            at = layout.modes * layout.width + place * layout.entries
            own = np.sqrt(np.diag(self.covariance)[at : at + layout.entries]) * layout.units()[place]
            std = np.tensordot(own, symmetric_basis(n), 1)
        return self.model.flexibility, std

    def frf_std(self, hz: Array) -> Array:
        """Standard deviation of the fitted FRF (6.48), ``sqrt(E |d|^2)``, shape (F, n, n), rad/s^2 per N m."""
        s = 2j * np.pi * np.asarray(hz, float)
        by = delayed_jacobian(self._layout, self.model, s)
        return np.sqrt(np.einsum("fap,pq,faq->fa", by, self.covariance, by.conj()).real).reshape(
            len(s), self._layout.size, -1
        )

    @property
    def residual_terms(self) -> tuple[str, ...]:
        """Which terms it has for what lies beside the band: of ``restoring``, ``direct``, ``slope`` and ``flexibility``."""
        return tuple(TERMS[power] for power in self._layout.powers)
