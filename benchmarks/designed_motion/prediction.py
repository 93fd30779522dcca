"""Motion that an excitation will cause, without simulating it, and how that motion changes with the excitation.

The drives follow their references; the hinges' deformation is the one which inverse dynamics asks for along them (their
own inertia left out); the vibration is the linear response to the multisine, in closed loop, about points along the
motion. Of each of these a search needs the gradient: `Prediction.slope` takes the change of some number per change of
the motion back to its change per change of the references' harmonics and of the multisine's lines. Whatever their count, this
costs as much as a regressor for each coordinate, rate and acceleration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from designed_motion.limits import Limits
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.cs8 import CS8, drive_places
from rx90b_flex.simulate.trajectories import RATE_HZ

ComplexArray = NDArray[np.complex128]
Motion = tuple[Array, Array, Array]  # coordinates, rates and accelerations, or the change of a number by each

STEADY_SPEED = 0.15  # rad/s; friction's slope in the linear response is at this speed or more, not at reversal
STEPS = (1e-6, 1e-6, 1.0)  # of finite differences by q, v and a, in which everything is linear
GRID_A_HARMONIC = 16  # instants of the slow deformation, of which a quarter are lines that it is made of
CHECKS = 128  # instants of a period at which torques without vibration, and distances, are checked


@dataclass(frozen=True, eq=False)
class CandidateMotion:
    """An excitation as numbers.

    Attributes
    ----------
    motion : array, shape (1 + 2 H, joints)
        Mean of the references, rad; amplitudes of the cosines, then of the sines, of their speed's harmonics, rad/s.
    torque : complex array, shape (L, joints), N m
        Amplitude of each line of the multisine.
    """

    motion: Array
    torque: ComplexArray

    @property
    def centre(self) -> Array:
        """Mean of the references, shape (joints,), rad."""
        return self.motion[0]

    def scaled(self, motion: float, torque: float) -> CandidateMotion:
        """Smaller or larger motion about the same centre, smaller or larger multisine."""
        return CandidateMotion(np.concatenate([self.motion[:1], motion * self.motion[1:]]), torque * self.torque)

    def references(self, time: Array, period_s: float) -> Motion:
        """Position, velocity and acceleration of the references, each (N, joints)."""
        position, velocity, acceleration = harmonics(time, period_s, len(self.motion) // 2)
        return position @ self.motion, velocity @ self.motion, acceleration @ self.motion

    def feedforward(self, time: Array, hz: Array) -> Array:
        """Feed-forward torque, shape (N, joints), N m."""
        return np.real(np.exp(2j * np.pi * np.outer(time, hz)) @ self.torque)


def harmonics(time: Array, period_s: float, count: int) -> Motion:
    """Position, velocity and acceleration per unit of each row of `Candidate.motion`, each (N, 1 + 2 count)."""
    w = 2.0 * np.pi / period_s * np.arange(1, count + 1)
    c, s = np.cos(np.outer(time, w)), np.sin(np.outer(time, w))
    one, none = np.ones((len(time), 1)), np.zeros((len(time), 1))
    return np.hstack([one, s / w, -c / w]), np.hstack([none, c, s]), np.hstack([none, -s * w, c * w])


@dataclass(frozen=True, eq=False)
class Frame:
    """What all candidates of a design share.

    Attributes
    ----------
    harmonics : int
        Of the references.
    hz : array, shape (L,)
        Lines of the multisine.
    times : array, shape (N,), s
        Instants of the predicted motion.
    points : int
        Of the linear response, in a period.
    missed : coordinates, rates and accelerations, each (D, n), or None
        At every instant: what the simulation of a motion nearby has and its prediction does not.
    """

    robot: Robot
    controller: CS8
    limits: Limits
    period_s: float
    harmonics: int
    hz: Array
    times: Array
    points: int
    missed: Motion | None = None

    @cached_property
    def drives(self) -> NDArray[np.intp]:
        return drive_places(self.robot)

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Places of the hinges' coordinates."""
        return np.setdiff1d(np.arange(self.robot.model.nv), self.drives)

    @cached_property
    def rigid(self) -> Robot:
        return self.robot.rigid()

    @cached_property
    def compliance(self) -> Array:
        """Of the hinges, shape (free, free), rad per N m."""
        stiffness = self.robot.linearize(np.zeros(self.robot.model.nv)).flexibility.K
        return np.asarray(np.linalg.inv(stiffness[np.ix_(self.free, self.free)]))

    @cached_property
    def every_instant(self) -> Array:
        """The references' instants, shape (D,), s."""
        return np.arange(round(self.period_s * RATE_HZ)) / RATE_HZ

    @cached_property
    def checks(self) -> Array:
        """Some of these, `CHECKS` a period or more."""
        return self.every_instant[:: max(1, len(self.every_instant) // CHECKS)]

    @cached_property
    def nearest_check(self) -> NDArray[np.intp]:
        """Of every instant."""
        nearest = np.round(self.every_instant / (self.checks[1] - self.checks[0])).astype(int)
        return nearest % len(self.checks)

    @cached_property
    def grid(self) -> Array:
        count = GRID_A_HARMONIC * self.harmonics
        return np.arange(count) / count * self.period_s

    @cached_property
    def smoothing(self) -> Motion:
        """From the deformation on the grid to it and its derivatives at `times`, each (N, grid), by Fourier series."""
        count = len(self.grid)
        lines = np.fft.rfft(np.eye(count), axis=0)[: count // 4] / count  # friction's jumps have no derivative
        lines[1:] *= 2.0
        jw = 2j * np.pi / self.period_s * np.arange(len(lines))
        wave = np.exp(np.outer(self.times, jw))
        position, velocity, acceleration = (np.real((wave * jw**power) @ lines) for power in range(3))
        return position, velocity, acceleration

    @cached_property
    def missed_now(self) -> Motion | None:
        """`missed` at `times`, by Fourier series."""
        if self.missed is None:
            return None
        count = len(self.every_instant)
        wave = np.exp(2j * np.pi / self.period_s * np.outer(self.times, np.arange((count + 1) // 2))) / count
        wave[:, 1:] *= 2.0
        q, v, a = (np.real(wave @ np.fft.rfft(x, axis=0)[: wave.shape[1]]) for x in self.missed)
        return q, v, a

    @cached_property
    def poses(self) -> Array:
        """Instants of the points of the linear response, shape (points,), s."""
        return np.arange(self.points) / self.points * self.period_s

    def waves(self, time: Array) -> ComplexArray:
        """From a line's amplitude at each point to the vibration at any time: straight lines between points.

        Shape (N, points * L).
        """
        place = time / self.period_s * self.points
        before = place.astype(int)
        share = np.zeros((len(time), self.points))
        share[np.arange(len(time)), before % self.points] = 1.0 - (place - before)
        share[np.arange(len(time)), (before + 1) % self.points] += place - before
        wave = np.exp(2j * np.pi * np.outer(time, self.hz))
        return np.asarray((share[:, :, None] * wave[:, None]).reshape(len(time), -1))

    @cached_property
    def fast(self) -> ComplexArray:
        return self.waves(self.times)

    @cached_property
    def fast_everywhere(self) -> ComplexArray:
        return self.waves(self.every_instant)

    @cached_property
    def s(self) -> ComplexArray:
        """Laplace variable of the lines, shape (L, 1)."""
        return np.asarray(2j * np.pi * self.hz[:, None])

    @cached_property
    def control(self) -> ComplexArray:
        """Torque that the controller gives for a drive's angle, shape (L, joints), N m/rad."""
        return self.controller.frequency_response(self.hz)

    def derivatives(self, r: Array, v: Array) -> Motion:
        """Of inverse dynamics by q, v and a, friction as at a steady speed; each (N, n, n)."""
        q, rate, rest = (np.zeros((len(r), self.robot.model.nv)) for _ in range(3))
        q[:, self.drives] = r
        rate[:, self.drives] = np.where(v < 0.0, -1.0, 1.0) * np.maximum(np.abs(v), STEADY_SPEED)
        motion = self.robot.motion(q, rate, rest)
        parts = [motion.on_tree.derivatives(), *(effect.derivatives(motion) for effect in self.robot.effects)]
        by_q, by_v, by_a = (np.sum([part[i] for part in parts], axis=0) for i in range(3))
        return by_q, by_v, by_a


@dataclass(frozen=True, eq=False)
class PrecisionPrediction:
    """What one candidate will do."""

    frame: Frame
    candidate: CandidateMotion

    # ---- motion -----------------------------------------------------------------------------------------

    @cached_property
    def motion(self) -> Motion:
        """Coordinates, rates and accelerations at the frame's `times`, each (N, n)."""
        frame = self.frame
        whole = tuple(np.zeros((len(frame.times), frame.robot.model.nv)) for _ in range(3))
        for out, of_drives in zip(whole, self.candidate.references(frame.times, frame.period_s), strict=True):
            out[:, frame.drives] = of_drives
        if len(frame.free):
            for out, smooth in zip(whole, frame.smoothing, strict=True):
                out[:, frame.free] += smooth @ self._deformation
        if len(frame.hz):
            for power, out in enumerate(whole):
                out += np.real(frame.fast @ _flat(frame.s**power * self._vibration))
        for out, missed in zip(whole, frame.missed_now or (), strict=bool(frame.missed)):
            out += missed
        return whole[0], whole[1], whole[2]

    def _on_drives(self, r: Array, v: Array, a: Array) -> Array:
        """Torque that the hinges must carry, shape (N, free), N m."""
        q, rate, acceleration = (np.zeros((len(r), self.frame.robot.model.nv)) for _ in range(3))
        for out, of_drives in ((q, r), (rate, v), (acceleration, a)):
            out[:, self.frame.drives] = of_drives
        return self.frame.robot.inverse_dynamics(q, rate, acceleration)[:, self.frame.free]

    @cached_property
    def _deformation(self) -> Array:
        """Of the hinges, slow, on the grid; shape (grid, free), rad."""
        slow = self.candidate.references(self.frame.grid, self.frame.period_s)
        return -self._on_drives(*slow) @ self.frame.compliance

    @cached_property
    def _dynamic_stiffness(self) -> ComplexArray:
        """In closed loop, shape (points, L, n, n), N m/rad."""
        frame, b = self.frame, self.frame.robot.input_matrix
        s = frame.s[:, :, None]
        r, v, _ = self.candidate.references(frame.poses, frame.period_s)
        by_q, by_v, by_a = (x[:, None] for x in frame.derivatives(r, v))
        return np.asarray(by_a * s**2 + by_v * s + by_q + b @ (frame.control[:, :, None] * b.T))

    @cached_property
    def _vibration(self) -> ComplexArray:
        """Amplitude of each line, shape (points, L, n), rad."""
        given = self.candidate.torque @ self.frame.robot.input_matrix.T
        stiffness = self._dynamic_stiffness
        column = np.broadcast_to(given[:, :, None], (*stiffness.shape[:3], 1))
        return np.asarray(np.linalg.solve(stiffness, column)[..., 0])

    # ---- limits -----------------------------------------------------------------------------------------

    @cached_property
    def _watched(self) -> tuple[Array, Array, Array, Array, Array]:
        """Angles, speeds, torques, distances and feed-forward at every instant."""
        frame, c = self.frame, self.candidate
        r, v, a = c.references(frame.checks, frame.period_s)
        torque = frame.rigid.inverse_dynamics(r, v, a)
        distance = frame.limits.distances(frame.rigid.tree, r)
        r, v, torque, distance = (x[frame.nearest_check] for x in (r, v, torque, distance))
        given = np.zeros_like(v)
        if len(frame.hz):
            angle = self._vibration[:, :, frame.drives]
            v = v + np.real(frame.fast_everywhere @ _flat(frame.s * angle))
            given = np.real(frame.fast_everywhere @ _flat(np.broadcast_to(c.torque, angle.shape)))
            torque = torque + given - np.real(frame.fast_everywhere @ _flat(frame.control * angle))
        return r, v, torque, distance, given

    @cached_property
    def excess(self) -> Array:
        """How far the motion is outside each limit at every instant, shape (D, limits); see `Limits.excess`."""
        return self.frame.limits.excess(*self._watched)

    # ---- gradient ---------------------------------------------------------------------------------------

    def slope(self, by_motion: Motion, by_excess: Array) -> CandidateMotion:
        """Change of a number by the candidate's, from its change by `motion`, each (N, n), and by `excess`.

        Real and imaginary parts of a line are its ``torque.real`` and ``torque.imag``.
        """
        frame = self.frame
        bases = harmonics(frame.times, frame.period_s, frame.harmonics)
        of_motion = _sum(basis.T @ by[:, frame.drives] for basis, by in zip(bases, by_motion, strict=True))
        by_vibration = np.zeros((frame.points, len(frame.hz), frame.robot.model.nv), complex)
        if len(frame.free):
            by_deformation = _sum(m.T @ by[:, frame.free] for m, by in zip(frame.smoothing, by_motion, strict=True))
            of_motion += self._through(self._on_drives, frame.grid, -by_deformation @ frame.compliance)
        if len(frame.hz):
            for power, by in enumerate(by_motion):
                by_vibration += frame.s**power * (frame.fast.T @ by).reshape(by_vibration.shape)
        by_r, by_v, by_torque, by_distance, by_given = frame.limits.slope(*self._watched, by_excess)
        of_torque = np.zeros_like(self.candidate.torque)
        if len(frame.hz):
            fast = frame.fast_everywhere.T
            shape = (frame.points, len(frame.hz), len(frame.drives))
            by_angle = frame.s * (fast @ by_v).reshape(shape) - frame.control * (fast @ by_torque).reshape(shape)
            by_vibration[:, :, frame.drives] += by_angle
            of_torque += (fast @ (by_given + by_torque)).reshape(shape).sum(axis=0)
        checked = [np.zeros((len(frame.checks), x.shape[1])) for x in (by_r, by_v, by_torque, by_distance)]
        for out, by in zip(checked, (by_r, by_v, by_torque, by_distance), strict=True):
            np.add.at(out, frame.nearest_check, by)
        bases = harmonics(frame.checks, frame.period_s, frame.harmonics)
        of_motion += bases[0].T @ checked[0] + bases[1].T @ checked[1]
        of_motion += self._through(frame.rigid.inverse_dynamics, frame.checks, checked[2])
        of_motion += self._through(
            lambda r, v, a: frame.limits.distances(frame.rigid.tree, r), frame.checks, checked[3], orders=1
        )
        if len(frame.hz):
            more_motion, more_torque = self._through_response(by_vibration)
            of_motion, of_torque = of_motion + more_motion, of_torque + more_torque
        return CandidateMotion(of_motion, np.asarray(np.conj(of_torque)))

    def _through(self, function: Callable[..., Array], time: Array, weight: Array, orders: int = 3) -> Array:
        """Change of ``sum(weight * function(references at time))`` by the references' harmonics, (1 + 2 H, joints)."""
        at = np.flatnonzero(weight.any(axis=1))  # few instants are outside a limit
        bases = harmonics(time[at], self.frame.period_s, self.frame.harmonics)
        out = np.zeros_like(self.candidate.motion)
        if not len(at):
            return out
        here = [basis @ self.candidate.motion for basis in bases]
        slopes = differences(function, (here[0], here[1], here[2]), weight[at], orders)
        return out + _sum(basis.T @ slope for basis, slope in zip(bases, slopes, strict=True))

    def _through_response(self, by_vibration: ComplexArray) -> tuple[Array, ComplexArray]:
        """Change by the references, which move the points of the linear response, and by the lines' amplitudes."""
        frame = self.frame
        turned = np.swapaxes(self._dynamic_stiffness, 2, 3)
        back = np.linalg.solve(turned, by_vibration[..., None])[..., 0]
        of_torque = back.sum(axis=0) @ frame.robot.input_matrix
        weights = [
            -np.real(np.einsum("plm,pln->pmn", back * frame.s**power, self._vibration, optimize=True))
            for power in range(3)
        ]
        bases = harmonics(frame.poses, frame.period_s, frame.harmonics)
        r, v, _ = (basis @ self.candidate.motion for basis in bases)

        def stiffnesses(r: Array, v: Array, a: Array) -> Array:
            return np.concatenate([x.reshape(len(r), -1) for x in frame.derivatives(r, v)], axis=1)

        weight = np.concatenate([x.reshape(frame.points, -1) for x in weights], axis=1)
        slopes = differences(stiffnesses, (r, v, np.zeros_like(r)), weight, orders=2)
        return _sum(basis.T @ slope for basis, slope in zip(bases, slopes, strict=True)), of_torque


def differences(function: Callable[..., Array], at: Motion, weight: Array, orders: int = 3) -> Motion:
    """Change of ``sum(weight * function(q, v, a))`` by each number of the first of q, v and a; each (N, n).

    By forward differences: a sample of the function depends on that sample of motion alone.
    """
    count, n = at[0].shape
    weight = weight.reshape(count, -1)
    here = (function(*at).reshape(count, -1) * weight).sum(axis=1)
    out = tuple(np.zeros((count, n)) for _ in range(3))
    for order in range(orders):
        moved = [np.broadcast_to(x, (n, count, n)) for x in at]
        moved[order] = moved[order] + STEPS[order] * np.eye(n)[:, None]
        values = function(*(x.reshape(-1, n) for x in moved)).reshape(n, count, -1)
        out[order][:] = ((np.einsum("dnk,nk->dn", values, weight) - here) / STEPS[order]).T
    return out[0], out[1], out[2]


def _flat(amplitude: ComplexArray) -> ComplexArray:
    """Points and lines on one axis, as `Frame.waves` has them."""
    return np.asarray(amplitude.reshape(-1, amplitude.shape[-1]))


def _sum(parts: Iterable[Array]) -> Array:
    return np.asarray(np.sum(list(parts), axis=0))
