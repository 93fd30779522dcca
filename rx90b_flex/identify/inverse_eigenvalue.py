"""Drive inertia and stiffness from the resonances and antiresonances of a drive point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from rx90b_flex.effects.motion import Array

if TYPE_CHECKING:
    from rx90b_flex.identify.transfer_function import TransferFit

OUT_OF_TURN = 0.05  # part of a frequency by which measured ones may be out of their order (table 6.4: 0.025)


@dataclass(frozen=True)
class DriveParameters:
    """Inertia and stiffness of one drive, joint side, with standard deviations.

    Attributes
    ----------
    inertia, inertia_std : float
        kg m^2; the standard deviation is zero where no uncertainty was given.
    stiffness, stiffness_std : float
        N m/rad.
    """

    inertia: float
    stiffness: float
    inertia_std: float
    stiffness_std: float


def drive_parameters(
    resonances_hz: ArrayLike,
    antiresonances_hz: ArrayLike,
    drive_inertia: float | None = None,
    rigid_inertia: float | None = None,
    *,
    resonances_std_hz: ArrayLike | None = None,
    antiresonances_std_hz: ArrayLike | None = None,
    inertia_std: float = 0.0,
) -> DriveParameters:
    """Parameters of one drive from its undamped resonances and antiresonances.

    The drive-point response is ``P = (1/J) prod(mu_r^2 - w^2) / prod(w_r^2 - w^2)`` (chapter 5, without damping,
    rigid-body modes left out). The traces of the free and of the drive-locked system give
    ``stiffness = J (sum w_r^2 - sum mu_r^2)``, which sums (5.53) over all modes in closed form. With the first n modes
    and the low-frequency gain ``1 / rigid_inertia`` kept, ``J = rigid_inertia * prod((mu_r / w_r)^2)``.

    Parameters
    ----------
    resonances_hz, antiresonances_hz : array, shape (n,)
        Without the rigid-body modes; as many of one as of the other, Hz.
    drive_inertia : float, optional
        J, where it is known; kg m^2.
    rigid_inertia : float, optional
        ``1 / (M_ee^-1)_jj``, the inertia at low frequency; kg m^2. Give this or `drive_inertia`.
    resonances_std_hz, antiresonances_std_hz : array, shape (n,), optional
        Standard deviations, taken as independent.
    inertia_std : float
        Of whichever inertia is given.

    Raises
    ------
    ValueError
        Different numbers of frequencies, frequencies that are not positive, none or both inertias given,
        antiresonances that lie so high that the stiffness would be negative, or frequencies that do not alternate: each
        antiresonance lies below its resonance and above the resonance before (5 % and three standard deviations are allowed).
    """
    w, mu = _frequencies("resonances_hz", resonances_hz), _frequencies("antiresonances_hz", antiresonances_hz)
    if len(w) != len(mu):
        raise ValueError(f"{len(w)} resonances and {len(mu)} antiresonances; expected as many of one as of the other")
    given = _given_inertia(drive_inertia, rigid_inertia)
    w_std = _deviations("resonances_std_hz", resonances_std_hz, w)
    mu_std = _deviations("antiresonances_std_hz", antiresonances_std_hz, mu)
    if not (w**2).sum() > (mu**2).sum():
        raise ValueError("the antiresonances lie above the resonances: their squares leave no positive stiffness")
    _refuse_out_of_turn(w, mu, w_std, mu_std)
    values, slopes = _drive(given, w, mu, rigid=drive_inertia is None)
    relative = np.concatenate([[inertia_std / given], w_std / w, mu_std / mu])
    return DriveParameters(*values.tolist(), *(values * np.linalg.norm(slopes * relative, axis=1)).tolist())


def _refuse_out_of_turn(w: Array, mu: Array, w_std: Array, mu_std: Array) -> None:
    by_w, by_mu = np.argsort(w), np.argsort(mu)
    # antiresonance, resonance, antiresonance, ..., and their numbers
    turn, std = (np.stack([a[by_mu], b[by_w]], axis=1).ravel() / (2 * np.pi) for a, b in ((mu, w), (mu_std, w_std)))
    allowed = np.maximum(OUT_OF_TURN * turn[1:], 3.0 * np.hypot(std[1:], std[:-1]))
    bad = np.flatnonzero(turn[:-1] - turn[1:] > allowed)
    if len(bad):
        k = int(bad[0])
        names = [f"{'resonance' if i % 2 else 'antiresonance'} {i // 2 + 1} ({turn[i]:.4g} Hz)" for i in (k, k + 1)]
        raise ValueError(
            f"{names[0]} lies above {names[1]}; those of one drive alternate, an antiresonance first: one is missing or too many"
        )


def _drive(given: float, w: Array, mu: Array, rigid: bool) -> tuple[Array, Array]:
    """Inertia and stiffness, (2,), of an inertia (of the drive or rigid) and frequencies, rad/s; slopes of their logarithms.

    The slopes (2, 1 + 2 n) are by the logarithms of the inertia and of each frequency.
    """
    difference = float((w**2).sum() - (mu**2).sum())
    inertia = given * float(np.prod((mu / w) ** 2)) if rigid else given
    of_inertia = np.concatenate([[1.0], np.full(len(w), -2.0 * rigid), np.full(len(mu), 2.0 * rigid)])
    of_stiffness = of_inertia + np.concatenate([[0.0], 2 * w**2, -2 * mu**2]) / difference
    return np.array([inertia, inertia * difference]), np.stack([of_inertia, of_stiffness])


@dataclass(frozen=True, eq=False)
class DriveIdentification:
    """What the motor signals say of the drives (section 5.8), from one fit.

    Attributes
    ----------
    joints : tuple of str
    drives : tuple of DriveParameters
        One a joint. With the modes above the band missing they are truncated: inertia too high, stiffness mostly too low.
    modes : tuple of int
        Pairs of resonance and antiresonance that each drive used.
    rigid_mass : array, shape (n, n)
        M_ee, kg m^2 (5.52).
    rigid_mass_std : array, shape (n, n)
    decay_rate, decay_rate_std : array, shape (m,)
        ``-Re(p)`` of each mode that counts: its damping, rad/s.
    """

    joints: tuple[str, ...]
    drives: tuple[DriveParameters, ...]
    modes: tuple[int, ...]
    rigid_mass: Array
    rigid_mass_std: Array
    decay_rate: Array
    decay_rate_std: Array


def identify_drives(fit: TransferFit) -> DriveIdentification:
    """Drive inertias and stiffnesses, the rigid mass matrix and the modes' damping, with the fit's covariance carried through.

    Each drive's inertia comes from its gain at low frequency, without friction, and its resonances and antiresonances above the
    lowest line, ``J = prod(mu_r / w_r)^2 / (M_ee^-1)_jj``; its stiffness from the traces. What the fit refuses does not count
    (`TransferFit.refused`, `TransferFit.refused_antiresonances`).

    Raises
    ------
    ValueError
        A drive without a resonance and an antiresonance above the lowest line that count.
    """
    n, at = len(fit.response.joints), fit.response.hz[0]
    by_inverse = fit.rigid_inverse_derivatives()
    inverse, mass = fit.model.rigid_inverse(), np.linalg.inv(fit.model.rigid_inverse()).astype(float)
    resonances, by_resonance = fit.resonance_derivatives()
    kept = fit.counted & (resonances > at * 1.001)  # not on the bound
    drives, counts = [], []
    for j in range(n):
        zeros, by_zero = fit.antiresonance_derivatives(j)
        above = np.array([not why for why in fit.refused_antiresonances(j)], bool) & (zeros > at)
        count = min(int(kept.sum()), int(above.sum()))
        if count == 0:
            raise ValueError(
                f"{fit.response.joints[j]} has no resonance and antiresonance above {at:.4g} Hz that count"
            )
        w, mu = (2 * np.pi * x[:count] for x in (resonances[kept], zeros[above]))
        by_w, by_mu = (2 * np.pi * x[:count] for x in (by_resonance[kept], by_zero[above]))
        values, slopes = _drive(1.0 / inverse[j, j], w, mu, rigid=True)
        relative = np.vstack([-by_inverse[j, j] / inverse[j, j], by_w / w[:, None], by_mu / mu[:, None]])
        stds = fit.spread(values[:, None] * (slopes @ relative))
        drives.append(DriveParameters(*values.tolist(), *stds.tolist()))
        counts.append(count)
    by_mass = -np.einsum("ij,jkp,kl->ilp", mass, by_inverse, mass)
    rate, by_rate = fit.decay_derivatives()
    return DriveIdentification(
        fit.response.joints,
        tuple(drives),
        tuple(counts),
        mass,
        fit.spread(by_mass),
        rate[fit.counted],
        fit.spread(by_rate[fit.counted]),
    )


def _given_inertia(drive: float | None, rigid: float | None) -> float:
    """The one of the two that is given."""
    if (drive is None) == (rigid is None):
        raise ValueError("give drive_inertia or rigid_inertia, one of them")
    given = drive if drive is not None else rigid
    if given is None or not np.isfinite(given) or given <= 0:
        raise ValueError(f"the inertia is {given!r}; expected a positive number in kg m^2")
    return given


def _frequencies(name: str, values: ArrayLike) -> Array:
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or len(array) == 0 or not np.isfinite(array).all() or (array <= 0).any():
        raise ValueError(f"{name} is {values!r}; expected positive frequencies in Hz, one-dimensional")
    return 2 * np.pi * array


def _deviations(name: str, values: ArrayLike | None, like: Array) -> Array:
    if values is None:
        return np.zeros_like(like)
    array = np.asarray(values, dtype=float)
    if array.shape != like.shape or not np.isfinite(array).all() or (array < 0).any():
        raise ValueError(f"{name} is {values!r}; expected {len(like)} standard deviations in Hz")
    return 2 * np.pi * array
