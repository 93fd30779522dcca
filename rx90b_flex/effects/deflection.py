"""How far the drives of a rigid tree twist under the torque that passes them, and what motors feel of that.

Motor angles are measured, links lag behind by the torsion eps, which obeys

    tau(q + E eps, v + E eps', a + E eps'')_j + k_j (eps_j + T_j eps_j') = 0

for each twisting joint j (Hardeman 2008, equation 3.58, with the motor's motion given): tau is the torque that links and
springs ask for, E puts a torsion into its joint's coordinate, k is the stiffness, T the damping over it. What the motors feel
beyond the rigid tree is ``tau(q + E eps, ...) - tau(q, ...)``, to first order in 1/k ``-(K tau/k + D (tau/k)' + M (tau/k)'')``.

The torsions are stepped on in time as an oscillator, so that nothing is lost near and above the frequency at which a link swings
on its held drive; steps are then corrected with derivatives of eighth order. What the tree does beyond its
derivatives at the measured motion is asked of the tree itself, once a model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import linalg
from scipy.interpolate import CubicSpline

from rx90b_flex.compiled.compile import Integers
from rx90b_flex.compiled.torsion import (
    add_torques,
    asked,
    hinges_together,
    oscillators,
    rates,
    stepped,
    swing_free,
    torques,
)
from rx90b_flex.effects.calm import Calm
from rx90b_flex.effects.motion import Array, Indices, Motion

# central differences, as `convolve` reads them
FIRST = np.array([-1 / 280, 4 / 105, -1 / 5, 4 / 5, 0.0, -4 / 5, 1 / 5, -4 / 105, 1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
CUBIC = 4  # coefficients
CORRECTIONS = 3  # of the steps, each with the eighth-order derivatives of the one before
LARGE_SWEEPS = 4  # in which the tree itself is asked what its derivatives leave out
SAME = 1e-6  # of the torque: a sweep that changes less is the last
LEAST_INERTIA = 0.1  # of its median along a motion, that a link is stepped on with
LARGEST = 1.0  # rad, that a drive twists
FASTEST = 2.5  # rad a sample: a link that swings faster on its drive follows the torque at once
SWINGS_BEFORE, DAMPED_SWINGS, DAMPED_BEFORE = 4.0, 2.0, 0.5  # before a log and into it; damping ratio
STEP_OF_A_SWING = 0.1  # rad, of the slowest swing of several hinges: 0.1 % of its period by the trapezoidal rule
ALONE_BYTES = 1.5e5  # of a matrix along the motion: so many springs of a drive are stepped on side by side
SOFTEST = 3.0  # times the stiffness of gravity and of the motion itself, that a drive has at the least


@dataclass(frozen=True)
class Spring:
    """A twisting drive: its joint, stiffness (N m/rad), damping over stiffness (s) and cubic part (N m/rad^3).

    On a tree that has hinges as coordinates `kind` names one of them; on the rigid one it is the drive. Through so many `swings` goes
    the cubic that says how it twists as a log begins (`begun_slowly`).
    """

    joint: str
    stiffness: float
    lag: float
    cubic: float = 0.0
    kind: str = "drive"
    swings: float = 1.0

    @property
    def key(self) -> str:
        """Its values as a name."""
        return repr((self.joint, self.stiffness, self.lag, self.cubic, self.kind, self.swings))


@dataclass(frozen=True, eq=False)
class Deflection:
    """Torsions of a set of drives and the torque that each adds to the rigid tree's.

    Attributes
    ----------
    torsion : array, shape (N, m)
        rad.
    torque : array, shape (m, N, n)
        By the tree's derivatives at the measured motion; N m.
    beyond : array, shape (N, n)
        What the tree asks for beyond that, all drives together; N m.
    """

    torsion: Array
    torque: Array
    beyond: Array

    def on(self, motion: Motion, springs: Sequence[Spring]) -> Motion:
        """The links' motion behind the springs that gave way."""
        return _moved(motion, _places(motion, springs), self.torsion)


def deflected(motion: Motion, springs: Sequence[Spring], springs_of_model: Sequence[Spring], load: Array) -> Deflection:
    """Torsions of drives on a motion of the rigid tree.

    Parameters
    ----------
    motion : Motion
        Of the motors.
    springs : sequence of Spring
    springs_of_model : sequence of Spring
        Those of the present model: what the tree asks for beyond its derivatives is worked out at their torsions.
    load : array, shape (N, n)
        Torque that links and springs ask for at the motors' angles, N m.
    """
    known = tuple(s.key for s in springs_of_model)
    (beyond,) = motion.once(("torque beyond first order", *known), lambda: (_beyond(motion, springs_of_model, load),))
    if tuple(s.key for s in springs) == known:  # asked for by each of them
        found = motion.once(("deflection", *known), lambda: _first_order(motion, springs, load + beyond))
    else:
        found = _first_order(motion, springs, load + beyond)
    torsion, torque = found
    return Deflection(torsion, torque, beyond)


def each_alone(motion: Motion, springs: Sequence[Spring], load: Array) -> Array:
    """Torque that each of several springs adds to the rigid tree's, no other drive twisting; (m, N, n), N m.

    Parameters
    ----------
    motion : Motion
        Of the motors.
    springs : sequence of Spring
        Of drives on the rigid tree.
    load : array, shape (N, n)
        Torque that links and springs ask for at the motors' angles, N m.
    """
    together = max(1, int(np.sqrt(ALONE_BYTES / (8 * len(motion)))))
    parts = [_alone(motion, springs[i : i + together], load) for i in range(0, len(springs), together)]
    return np.concatenate(parts)


def _alone(motion: Motion, springs: Sequence[Spring], load: Array) -> Array:
    """As `each_alone`, of so many that their equations fit side by side."""
    places, by = _places(motion, springs), motion.on_tree.derivatives()
    apart = np.eye(len(springs))
    at_angle, at_rate, by_a = (x * apart for x in _among(by, places))
    torsion = _torsion(springs, load[:, places], at_angle, at_rate, by_a, motion.time)
    if len(springs) > 1 and not torsion.any(axis=0).all():  # one that swings beyond numbers must not stop the others
        return np.concatenate([_first_order(motion, [s], load)[1] for s in springs])
    return np.asarray(torques(*by, places, torsion, *rates_in_time(torsion, motion.time)))


def _beyond(motion: Motion, springs: Sequence[Spring], load: Array) -> Array:
    """Torque of the deflected tree less that by its derivatives, (N, n)."""
    out = np.zeros_like(motion.q)
    if not springs:
        return out
    places = _places(motion, springs)
    rigid = np.array(motion.on_tree.load())
    for _ in range(LARGE_SWEEPS):
        torsion, torque = _first_order(motion, springs, load + out)
        there = _moved(motion, places, torsion).on_tree.load()
        new = there - rigid - np.sum(torque, axis=0)
        if not np.isfinite(new).all() or np.abs(torsion).max() > LARGEST:
            return np.zeros_like(motion.q)  # no drive twists like that: values from which a fit turns back
        done = np.abs(new - out).max() <= SAME * max(float(np.abs(load).max()), 1e-300)
        out = new
        if done:
            break
    return out


def by_links(motion: Motion, springs: Sequence[Spring], load: Array, calm: Calm | None) -> Array:
    """Change of the torque that all drives of the model add, per change of the links' parameters, (N, n, 10 * bodies).

    The tree asks for its torque at the deflected motion, and drives twist further under what more it asks for, which goes through the
    filter that the load (N, n) went through.
    """
    places = _places(motion, springs)
    found = deflected(motion, springs, springs, load)
    there = _moved(motion, places, found.torsion).on_tree.link_regressor()
    by = motion.on_tree.derivatives()
    more = there[:, places] if calm is None else calm(there[:, places], places)
    further = _Steps.of(*_with_springs(springs, *_among(by, places)), time_step(motion.time)).solve(-more)
    if _runs_away(further):
        return np.zeros_like(there)
    out = there - motion.on_tree.link_regressor()
    for slope, x in zip(by, (further, *rates_in_time(further, motion.time)), strict=True):
        add_torques(out, slope, places, x)
    return np.asarray(out)


def _moved(motion: Motion, places: Indices, torsion: Array) -> Motion:
    """The links' motion behind twisted drives."""
    q, v, a = motion.q.copy(), motion.v.copy(), motion.a.copy()
    for x, change in zip((q, v, a), (torsion, *rates_in_time(torsion, motion.time)), strict=True):
        x[:, places] += change
    return dataclasses.replace(motion, q=q, v=v, a=a)


def _first_order(motion: Motion, springs: Sequence[Spring], load: Array) -> tuple[Array, Array]:
    """Torsions (N, m), and the torque that the tree's derivatives make of each, (m, N, n)."""
    if not springs:
        return np.zeros((len(motion), 0)), np.zeros((0, *motion.q.shape))
    places, by = _places(motion, springs), motion.on_tree.derivatives()
    torsion = _torsion(springs, load[:, places], *_among(by, places), motion.time)
    return torsion, torques(*by, places, torsion, *rates_in_time(torsion, motion.time))


def _among(by: tuple[Array, Array, Array], places: Indices) -> tuple[Array, Array, Array]:
    """Derivatives of torques at some places by what is at these, (N, m, m)."""
    by_q, by_v, by_a = (x[:, places[:, None], places] for x in by)
    return by_q, by_v, by_a


def _places(motion: Motion, springs: Sequence[Spring]) -> Indices:
    return np.array([motion.coordinates.index(s.joint, s.kind) for s in springs], dtype=np.intp)


def _torsion(springs: Sequence[Spring], load: Array, by_q: Array, by_v: Array, by_a: Array, time: Array) -> Array:
    """Torsions (N, m) under a load (N, m), for derivatives (N, m, m) of the load by angle, velocity and acceleration."""
    cubic = np.array([s.cubic for s in springs])
    at_angle, at_rate, by_a = _with_springs(springs, by_q, by_v, by_a)
    if any(s.kind != "drive" for s in springs):
        try:
            return _together(load, at_angle, at_rate, by_a, time_step(time))
        except np.linalg.LinAlgError:  # a swing that grows beyond numbers: values from which a fit turns back
            return np.zeros_like(load)
    swings = tuple(s.swings for s in springs)
    steps = _Steps.of(at_angle, at_rate, by_a, time_step(time), swings)
    torsion = steps.solve(-load)
    wide = -load[:, :, None]
    begun = np.zeros((2, *wide.shape[1:]))
    if cubic.any():
        begun = steps.begun(wide, cubic) - steps.begun(wide, 0.0 * cubic)
    for _ in range(CORRECTIONS):
        if _runs_away(torsion):
            break
        left = asked(load, at_angle, at_rate, by_a, cubic, torsion, *rates_in_time(torsion, time))
        if cubic.any():  # Newton's steps
            stiffer = at_angle + 3.0 * (cubic * torsion**2)[:, :, None] * np.eye(len(springs))
            steps = _Steps.of(stiffer, at_rate, by_a, time_step(time), swings)
        torsion = torsion + steps.solve(-left, begun)
        begun = np.zeros_like(begun)
    return np.zeros_like(load) if _runs_away(torsion) else torsion


def _runs_away(torsion: Array) -> bool:
    """Whether a swing grows as no drive's does: values from which a fit turns back."""
    return not np.isfinite(torsion).all() or bool(np.abs(torsion).max() > 1e3 * LARGEST)


def begun_slowly(
    force: Array, samples: int, step: float, stiffness: float, cubic: float, damping: float, inertia: float
) -> Array:
    """The first two torsions (2, k) of the swing-free answers to cubics through the first samples of forces (N, k).

    ``inertia x'' + damping x' + stiffness x + cubic x^3`` of a polynomial x is that cubic, to first order beyond rest. What the first
    samples are off by themselves, a log's noise at its end, would else set the link swinging.
    """
    many = max(min(samples, len(force)), min(CUBIC, len(force)))
    return np.asarray(swing_free(_cubic(many, step) @ force[:many], step, stiffness, cubic, damping, inertia))


@lru_cache(maxsize=64)
def _cubic(samples: int, step: float) -> Array:
    """What makes the coefficients of a cubic of time of so many samples, (4, N)."""
    powers = np.vander(step * np.arange(samples), CUBIC, increasing=True)
    scale = np.maximum(np.linalg.norm(powers, axis=0), 1e-300)
    return np.asarray(np.linalg.pinv(powers / scale) / scale[:, None])


def _together(load: Array, at_angle: Array, at_rate: Array, by_a: Array, step: float) -> Array:
    """Deflections (N, m) of hinges that swing together, their fastest modes far above what the log samples.

    Steps as short as the slowest of them asks for. How they swing as a log begins is not known: its first swings turned round are
    put before it, and hinges are damped well until two swings into it.
    """
    stiffness, mass = (0.5 * (x + x.T) for x in (at_angle.mean(axis=0), by_a.mean(axis=0)))
    # fitted links need not
    stands, swings = (np.isfinite(x).all() and np.linalg.eigvalsh(x)[0] > 0 for x in (stiffness, mass))
    if not stands:
        return np.zeros_like(load)  # values from which a fit turns back
    if step == 0.0 or len(load) < 2 * CUBIC or not swings:
        return np.asarray(np.linalg.solve(at_angle, -load[:, :, None])[:, :, 0])
    slowest = np.sqrt(linalg.eigvalsh(stiffness, mass)[0])
    swing = 2 * np.pi / (slowest * step)  # samples
    before = min(len(load) - 1, int(SWINGS_BEFORE * swing))
    first = np.arange(min(len(load), max(2 * CUBIC, round(swing))))
    start = np.polynomial.polynomial.polyfit(first, load[first], CUBIC - 1)[0]
    load = np.concatenate([2.0 * start - load[before:0:-1], load])
    at_angle, at_rate, by_a = (np.concatenate([x[before:0:-1], x]) for x in (at_angle, at_rate, by_a))
    damped = before + int(DAMPED_SWINGS * swing)
    at_rate[:damped] += 2.0 * DAMPED_BEFORE / slowest * at_angle[:damped]
    parts = max(1, int(np.ceil(step * slowest / STEP_OF_A_SWING)))
    fine = CubicSpline(np.arange(len(load)), load)(np.arange(parts * (len(load) - 1) + 1) / parts)
    swinging: Any = hinges_together  # typed by numba, not by mypy
    return np.asarray(swinging(fine, at_angle, at_rate, by_a, step / parts, parts))[before:]


def _with_springs(springs: Sequence[Spring], by_q: Array, by_v: Array, by_a: Array) -> tuple[Array, Array, Array]:
    """Derivatives of the torque on the torsions by them and their rates, springs and dampers included, (N, m, m)."""
    stiffness = np.array([s.stiffness for s in springs])
    return by_q + np.diag(stiffness), by_v + np.diag(stiffness * np.array([s.lag for s in springs])), by_a


@dataclass(frozen=True, eq=False)
class _Steps:
    """The oscillators ``M x'' + D x' + K x = f``, stepped on sample after sample.

    ``M (x+ - 2x + x-)/h^2 + D (x+ - x-)/(2h) + K (w x+ + (1-2w) x + w x-) = w f+ + (1-2w) f + w f-``, with the weight w that gives
    an oscillator of M and K its own frequency; where that lies beyond `FASTEST`, ``K x = f``.
    """

    equations: tuple[Array, Integers, Array, Array, Array]  # of `oscillators`
    swings: Array  # (m,), 1 where a joint swings, 0 where it follows at once
    swing: tuple[int, ...]  # samples that say how it begins, (m,)
    start: tuple[tuple[float, float, float, float], ...]  # (m,), seconds a sample, first stiffness, damping and inertia

    @staticmethod
    def of(at_angle: Array, at_rate: Array, by_a: Array, step: float, begin: Sequence[float] = ()) -> _Steps:
        own = np.arange(at_angle.shape[1])
        inertia = by_a[:, own, own]
        # fitted links need not be possible ones: their inertia may fall below zero for an instant
        typical = np.median(inertia, axis=0)
        inertia = np.where(typical > 0, np.maximum(inertia, LEAST_INERTIA * typical), inertia)
        first, by_a = by_a[0].diagonal(), by_a.copy()
        by_a[:, own, own] = inertia
        fast = at_angle[:, own, own] * step**2 / np.where(inertia > 0, inertia, np.inf)
        middle = np.median(fast, axis=0)
        swings = ((middle < FASTEST**2) & (typical > 0) & (step > 0)).astype(float)
        equations = oscillators(at_angle, at_rate, by_a, np.clip(fast, 1e-6, FASTEST**2), swings, step)
        first_swings = zip(begin or (1.0,) * len(middle), middle, strict=True)
        swing = tuple(int(part * 2.0 * np.pi / np.sqrt(max(float(x), 1e-6))) for part, x in first_swings)
        diagonals = zip(at_angle[0].diagonal(), at_rate[0].diagonal(), first, strict=True)
        at_start = tuple((step, float(k), float(d), float(max(m, 0.0))) for k, d, m in diagonals)
        return _Steps(equations, swings, swing, at_start)

    def begun(self, force: Array, cubic: Array) -> Array:
        """The first two torsions (2, m, k) of each by itself, under the first forces of (N, m, k), as `begun_slowly` has them."""
        out = np.zeros((2, *force.shape[1:]))
        for j in np.flatnonzero(self.swings):
            step, stiffness, damping, inertia = self.start[j]
            own = np.ascontiguousarray(force[:, j])
            out[:, j] = begun_slowly(own, self.swing[j], step, stiffness, float(cubic[j]), damping, inertia)
        return out

    def solve(self, force: Array, begun: Array | None = None) -> Array:
        """Deflections (N, m) or (N, m, k) under forces; where a joint swings from the first two (2, m, k) on, or swing-free."""
        wide = np.ascontiguousarray(force.reshape(*force.shape[:2], -1))
        first = self.begun(wide, np.zeros(wide.shape[1])) if begun is None else begun
        stiffness = np.array([x[1] for x in self.start])[:, None]
        out = stepped(*self.equations, self.swings, stiffness * first, wide)
        return np.asarray(out if np.isfinite(out).all() else np.zeros_like(out)).reshape(force.shape)


def time_step(time: Array) -> float:
    """Time between uniform samples, s; zero where they are not a motion in time."""
    step = float(time[1] - time[0]) if len(time) > len(FIRST) else 0.0
    return max(step, 0.0)


def rates_in_time(x: Array, time: Array) -> tuple[Array, Array]:
    """First and second derivatives by time of uniform samples (N, ...); zero where they are not a motion in time."""
    step = time_step(time)
    if step == 0.0:
        return np.zeros_like(x), np.zeros_like(x)
    first, second = rates(np.ascontiguousarray(x.reshape(len(x), -1)), step, FIRST, SECOND)
    return first.reshape(x.shape), second.reshape(x.shape)


def softest(by_q: Array, inertia: float) -> float:
    """Lowest frequency, rad/s, at which a link may swing on its drive: softer drives would give way to the load altogether."""
    return float(np.sqrt(SOFTEST * np.quantile(np.abs(by_q), 0.95) / inertia))
