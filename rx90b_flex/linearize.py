"""The equations of motion about a point of a trajectory, and what follows from them in frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects import Effect, Motion, close_match
from rx90b_flex.effects.motion import Array, Coordinates
from rx90b_flex.effects.traits import PARTS
from rx90b_flex.showing import Showing

if TYPE_CHECKING:
    import control

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Terms:
    """One group's part of equation 3.90: derivatives of its generalised force by a, v and q.

    Attributes
    ----------
    M, D, K : array, shape (n, n)
        kg m^2, N m s/rad, N m/rad.
    """

    M: Array
    D: Array
    K: Array

    def __add__(self, other: Terms) -> Terms:
        return Terms(self.M + other.M, self.D + other.D, self.K + other.K)


@dataclass(frozen=True, eq=False, repr=False)
class Modes(Showing):
    """Damped modes of a linearisation: eigenvalues of the state matrix, one of each complex pair, slowest first.

    Attributes
    ----------
    poles : complex array, shape (m,)
        rad/s. A real pole (a rigid-body mode under friction) stands alone.
    shapes : complex array, shape (n, m)
        Coordinates, largest entry 1.
    """

    poles: ComplexArray
    shapes: ComplexArray

    @property
    def frequencies_hz(self) -> Array:
        """Distance of each pole from the origin (equation 5.41), shape (m,)."""
        return np.abs(self.poles) / (2.0 * np.pi)

    @property
    def damping_ratios(self) -> Array:
        """-Re(p) / |p|, shape (m,): 1 for a decaying real pole, -1 for a growing one, 0 at the origin."""
        size = np.abs(self.poles)
        return -self.poles.real / np.where(size > 0, size, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Linearization:
    """Small motions about (q, v, a): ``M d(a) + D d(v) + K d(q) = B d(drive torque)`` (equation 3.90).

    Every effect stands in one group (its class says which: `Effect.part`).

    Attributes
    ----------
    coordinates : tuple of str
        Names, one a degree of freedom.
    joints : tuple of str
    input_matrix : array, shape (n, joints)
        B; its columns also pick the drive angles.
    links : Terms
        M of the links, ``C0`` and ``G0 + N0``; with payload and base tilt.
    drives : Terms
        Drive inertia.
    flexibility : Terms
        ``D0`` and the structural stiffness of the hinges (3.68, 3.70).
    spring : Terms
        Gravity springs, hoses and torque that repeats with the angle. What a spring's prestress adds is in it too.
    friction : Terms
        ``F0``, and what else friction and couplings depend on. Friction acts on ``e + eps1``, so its block on these is
        full, [[f', f'], [f', f']], and not diagonal as printed in (3.92).
    G0 : array, shape (n, n)
        Stiffness of gravity: ``links.K`` in the same pose at rest.

    Notes
    -----
    (3.91) divides ``G0 + N0`` in a way that depends on its nodal coordinates (Euler parameters). Here G0 is what is
    there at rest, where both agree, and N0 what the motion adds.
    """

    coordinates: tuple[str, ...]
    joints: tuple[str, ...]
    input_matrix: Array
    links: Terms
    drives: Terms
    flexibility: Terms
    spring: Terms
    friction: Terms
    G0: Array

    def __repr__(self) -> str:
        return f"<Linearization: {len(self.coordinates)} coordinates, {len(self.joints)} joints>"

    @cached_property
    def total(self) -> Terms:
        """All groups together."""
        return self.links + self.drives + self.flexibility + self.spring + self.friction

    @property
    def M(self) -> Array:
        """Derivative of the inverse dynamics by the accelerations, shape (n, n), kg m^2."""
        return self.total.M

    @property
    def D(self) -> Array:
        """Derivative of the inverse dynamics by the velocities, shape (n, n), N m s/rad: ``D0 + C0 + F0``."""
        return self.total.D

    @property
    def K(self) -> Array:
        """Derivative of the inverse dynamics by the positions, shape (n, n), N m/rad: ``K0 + G0 + N0``."""
        return self.total.K

    @property
    def C0(self) -> Array:
        """Velocity sensitivity of Coriolis and centrifugal forces, shape (n, n), N m s/rad."""
        return self.links.D

    @property
    def D0(self) -> Array:
        """Structural damping, shape (n, n), N m s/rad."""
        return self.flexibility.D

    @property
    def F0(self) -> Array:
        """Slope of the friction, shape (n, n), N m s/rad."""
        return self.friction.D

    @property
    def K0(self) -> Array:
        """Structural stiffness with the springs, shape (n, n), N m/rad."""
        return self.flexibility.K + self.spring.K

    @property
    def N0(self) -> Array:
        """Dynamic stiffness: what velocities and accelerations add to G0, shape (n, n), N m/rad."""
        return self.links.K - self.G0

    # ---- undamped ---------------------------------------------------------------------------------------

    def frequencies_hz(self, *, elastic_only: bool = False) -> Array:
        """Undamped natural frequencies, Hz, ascending, rigid-body modes first; shape (n,).

        Parameters
        ----------
        elastic_only : bool
            Use the stiffness of the hinges alone, so that the rigid-body modes are zero, as in (5.48). Otherwise K as
            it is: gravity and springs give a rigid-body mode a low frequency, or zero where the pose would fall.
        """
        return self._undamped_hz(np.arange(len(self.coordinates)), elastic_only)

    def antiresonances_hz(self, joint: str, *, elastic_only: bool = False) -> Array:
        """Undamped frequencies with one drive locked, Hz, ascending; shape (n - 1,).

        They are the zeros of that drive's own transfer function (section 5.4).
        """
        if joint not in self.joints:
            raise ValueError(f"unknown joint {joint!r}; {close_match(joint, self.joints)}")
        locked = self.input_matrix[:, self.joints.index(joint)]
        return self._undamped_hz(np.flatnonzero(locked == 0), elastic_only)

    def with_drives_locked_hz(self) -> Array:
        """Undamped frequencies of the hinges with every drive locked, Hz, ascending; shape (n - joints,)."""
        return self._undamped_hz(np.flatnonzero(~self.input_matrix.any(axis=1)), True)

    def _undamped_hz(self, free: NDArray[np.intp], elastic_only: bool) -> Array:
        from scipy import linalg  # here, for most uses of a robot do without

        at = np.ix_(free, free)
        if elastic_only:
            squares = linalg.eigh(self.flexibility.K[at], self.M[at], eigvals_only=True)
            # a zero stiffness comes back as rounding of the largest one
            squares[np.abs(squares) < 1e-12 * np.abs(squares).max()] = 0.0
        else:
            squares = linalg.eigvals(self.K[at], self.M[at])
        return np.sort(np.sqrt(squares.astype(complex)).real) / (2.0 * np.pi)

    # ---- damped -----------------------------------------------------------------------------------------

    def frf(self, hz: Array) -> ComplexArray:
        """Frequency response from drive torques to drive accelerations.

        Parameters
        ----------
        hz : float or array, shape (F,)

        Returns
        -------
        complex array, shape (F, joints, joints), or (joints, joints) of one frequency; rad/s^2 per N m
            ``(jw)^2 B^T (K + jw D - w^2 M)^-1 B`` (equations 5.36, 5.47), rows are drives that move.

        Raises
        ------
        ValueError
            A frequency that is not finite, or a pole: a drive that nothing holds at rest has one at 0 Hz.
        """
        if not np.isfinite(np.asarray(hz, dtype=float)).all():
            raise ValueError("hz: a frequency is not finite; expected finite ones")
        s = 2j * np.pi * np.asarray(hz, dtype=float)[..., None, None]
        drives = self.input_matrix
        try:
            response = np.linalg.solve(self.K + s * self.D + s**2 * self.M, drives.astype(complex))
        except np.linalg.LinAlgError:
            raise ValueError(
                "hz: a pole is among the frequencies, where there is no response (drives that nothing holds at rest have "
                "theirs at 0 Hz); expected frequencies above 0"
            ) from None
        return s**2 * (drives.T @ response)

    def to_statespace(self) -> control.StateSpace:
        """State space with state (coordinates, their rates), input drive torque, N m, and output drive angle, rad."""
        import control  # here, not at the top: it takes as long to import as everything else together

        a, b = self._state_matrices()
        rates = [f"{name}:rate" for name in self.coordinates]
        drives = np.hstack([self.input_matrix.T, np.zeros_like(self.input_matrix.T)])
        return control.ss(
            a,
            b,
            drives,
            np.zeros((len(self.joints), len(self.joints))),
            states=[*self.coordinates, *rates],
            inputs=[f"{joint}:torque" for joint in self.joints],
            outputs=[f"{joint}:angle" for joint in self.joints],
        )

    def _state_matrices(self) -> tuple[Array, Array]:
        n = len(self.coordinates)
        solved = np.linalg.solve(self.M, np.hstack([-self.K, -self.D, self.input_matrix]))
        a = np.block([[np.zeros((n, n)), np.eye(n)], [solved[:, : 2 * n]]])
        return a, np.vstack([np.zeros_like(self.input_matrix), solved[:, 2 * n :]])

    def modes(self) -> Modes:
        """Poles with their frequencies, damping ratios and shapes (section 5.6)."""
        n = len(self.coordinates)
        poles, vectors = np.linalg.eig(self._state_matrices()[0])
        kept = np.flatnonzero(poles.imag >= 0)
        kept = kept[np.argsort(np.abs(poles[kept]), kind="stable")]
        shapes = vectors[:n, kept].astype(complex)
        largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(len(kept))]
        return Modes(poles[kept].astype(complex), shapes / largest)

    # ---- other coordinates ------------------------------------------------------------------------------

    def in_joint_angles(self) -> Linearization:
        """The same linearisation in (e, theta, eps2, eps3), each matrix X as T^T X T (equations 3.75-3.83)."""
        transform, names = joint_angle_transform(self.coordinates)

        def changed(x: Array) -> Array:
            return transform.T @ x @ transform

        parts: dict[str, Terms] = {name: getattr(self, name) for name in PARTS}
        groups = {name: Terms(changed(t.M), changed(t.D), changed(t.K)) for name, t in parts.items()}
        drives = transform.T @ self.input_matrix
        return Linearization(names, self.joints, drives, **groups, G0=changed(self.G0))


def linearize(
    effects: Sequence[Effect], moving: Motion, still: Motion, joints: tuple[str, ...], input_matrix: Array
) -> Linearization:
    """Linearise equations of motion about a point of a trajectory (equations 3.88-3.94), analytically.

    Parameters
    ----------
    effects : sequence of Effect
    moving, still : Motion
        One sample: the point, and the same position at rest.
    joints : tuple of str
    input_matrix : array, shape (n, joints)

    Raises
    ------
    ValueError
        An effect without a value.
    """
    nothing = np.zeros((len(moving.coordinates),) * 2)
    groups = {name: Terms(nothing, nothing, nothing) for name in PARTS}
    groups["links"] = _terms(moving.on_tree.derivatives())
    gravity = still.on_tree.derivatives()[0][0]
    for effect in effects:
        groups[effect.traits.part] += _terms(effect.derivatives(moving))
        if effect.traits.part == "links":
            gravity = gravity + effect.derivatives(still)[0][0]
    return Linearization(moving.coordinates.names, joints, input_matrix, **groups, G0=gravity)


def check_one(size: int, **arrays: Any) -> None:
    """Refuse coordinates, rates or accelerations that are not of one sample, shape (size,)."""
    for name, x in arrays.items():
        if np.shape(x) not in ((size,), (1, size)):
            raise ValueError(f"{name} has shape {np.shape(x)}; expected one sample, ({size},)")


def joint_angle_transform(coordinates: tuple[str, ...]) -> tuple[Array, tuple[str, ...]]:
    """Matrix T of ``q = T q'``, with theta = e + eps1 in the place of eps1 (equations 3.73, 3.74).

    Parameters
    ----------
    coordinates : tuple of str
        Names of q, in any order; that order is kept.

    Returns
    -------
    transform : array, shape (n, n)
        Then ``force' = T.T @ force`` and a matrix X of forces per coordinate becomes ``T.T @ X @ T`` (3.75).
    names : tuple of str
        Names of q': ``joint_1:torsion`` becomes ``joint_1:angle``. Joints without torsion stay as they are.
    """
    layout = Coordinates(coordinates)
    transform = np.eye(len(coordinates))
    names = list(coordinates)
    for joint in layout.joints:
        drive, torsion = layout.index(joint), layout.index(joint, "torsion")
        if torsion is not None:
            transform[torsion, drive] = -1.0
            names[torsion] = f"{joint}:angle"
    return transform, tuple(names)


def _terms(derivatives: tuple[Array, Array, Array]) -> Terms:
    return Terms(*(by[0] for by in reversed(derivatives)))
