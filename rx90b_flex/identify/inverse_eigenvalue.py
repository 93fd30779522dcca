"""Drive inertia and stiffness from the resonances and antiresonances of a drive point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rx90b_flex.effects.motion import Array


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
        Different numbers of frequencies, frequencies that are not positive, none or both inertias given, or
        antiresonances that lie so high that the stiffness would be negative.
    """
    w, mu = _frequencies("resonances_hz", resonances_hz), _frequencies("antiresonances_hz", antiresonances_hz)
    if len(w) != len(mu):
        raise ValueError(f"{len(w)} resonances and {len(mu)} antiresonances; expected as many of one as of the other")
    if (drive_inertia is None) == (rigid_inertia is None):
        raise ValueError("give drive_inertia or rigid_inertia, one of them")
    given = drive_inertia if drive_inertia is not None else rigid_inertia
    if given is None or not np.isfinite(given) or given <= 0:
        raise ValueError(f"the inertia is {given!r}; expected a positive number in kg m^2")
    w_std, mu_std = (
        _deviations("resonances_std_hz", resonances_std_hz, w),
        _deviations("antiresonances_std_hz", antiresonances_std_hz, mu),
    )
    difference = float((w**2).sum() - (mu**2).sum())
    if difference <= 0:
        raise ValueError("the antiresonances lie above the resonances: their squares leave no positive stiffness")
    factor = 1.0 if drive_inertia is not None else float(np.prod((mu / w) ** 2))
    inertia = float(given * factor)
    # relative derivatives of the inertia, then of the stiffness J * difference, by each frequency
    free = 0.0 if drive_inertia is not None else 1.0
    by_w, by_mu = -2 * free / w, 2 * free / mu
    relative = (inertia_std / given) ** 2 + ((by_w * w_std) ** 2).sum() + ((by_mu * mu_std) ** 2).sum()
    stiff = (
        (inertia_std / given) ** 2
        + (((by_w + 2 * w / difference) * w_std) ** 2).sum()
        + (((by_mu - 2 * mu / difference) * mu_std) ** 2).sum()
    )
    stiffness = inertia * difference
    return DriveParameters(inertia, stiffness, float(inertia * np.sqrt(relative)), float(stiffness * np.sqrt(stiff)))


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
