"""Logs of arms whose drives twist, made without the package: link and motor are two inertias with a spring between.

Motors follow their references exactly; the links behind them are integrated by Runge and Kutta's method on pinocchio's rigid tree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import independent as ind
import numpy as np
import pinocchio as pin

Array = ind.Array
Motors = Callable[[float], tuple[Array, Array, Array]]  # angles, rates and accelerations, (n,), at a time
SUBSTEPS = 4  # of integration a sample


@dataclass(frozen=True)
class Drive:
    """Torque of a transmission, ``spring(twist)``, with a damper beside it."""

    stiffness: float
    damping: float = 0.0
    cubic: float = 0.0
    gap: float = 0.0

    def torque(self, twist: float, rate: float) -> float:
        """What the transmission takes up at a twist; nothing within its gap."""
        free = 0.5 * self.gap
        beyond = np.sign(twist) * max(abs(twist) - free, 0.0)
        touching = 1.0 if abs(twist) >= free else 0.0
        return float(self.stiffness * beyond + self.cubic * beyond**3 + touching * self.damping * rate)

    def at_rest(self, load: float) -> float:
        """Twist under a load that stays."""
        roots = np.roots([self.cubic, 0.0, self.stiffness, -abs(load)])
        beyond = roots.real[np.argmin(np.abs(roots.imag))]
        return float(-np.sign(load) * (beyond + 0.5 * self.gap))


def motor_torque(arm: ind.Arm, motors: Motors, time: Array, drives: Mapping[int, Drive]) -> Array:
    """Torque (N, n) that motors feel of the links behind twisting drives, which begin at rest under their load."""
    model, data = arm.model, arm.model.createData()
    motors = lru_cache(maxsize=2)(motors)
    places = list(drives)
    own = np.ix_(places, places)

    def tree(q: Array, v: Array, a: Array, x: Array, dx: Array, ddx: Array) -> Array:
        q, v, a = q.copy(), v.copy(), a.copy()
        q[places] += x
        v[places] += dx
        a[places] += ddx
        return np.asarray(pin.rnea(model, data, q, v, a))

    def second(t: float, x: Array, dx: Array) -> Array:
        q, v, a = motors(t)
        zero = np.zeros(len(places))
        load = tree(q, v, a, x, dx, zero)[places]
        load = load + [d.torque(float(e), float(r)) for d, e, r in zip(drives.values(), x, dx, strict=True)]
        moved = q.copy()
        moved[places] += x
        mass = pin.crba(model, data, moved)
        mass = np.triu(mass) + np.triu(mass, 1).T
        return np.asarray(np.linalg.solve(mass[own], -load))

    step = float(time[1] - time[0]) / SUBSTEPS
    q, v, a = motors(float(time[0]))
    x = np.zeros(len(places))
    for _ in range(30):  # at rest under the load
        load = tree(q, v, a, x, 0 * x, 0 * x)[places]
        pairs = zip(load, drives.values(), strict=True)
        x = np.array([d.at_rest(float(tau)) for tau, d in pairs])
    dx = np.zeros_like(x)
    out = np.empty((len(time), model.nv))
    for n, start in enumerate(time):
        q, v, a = motors(float(start))
        out[n] = tree(q, v, a, x, dx, second(float(start), x, dx))
        t = float(start)
        for _ in range(SUBSTEPS if places else 0):
            k1 = second(t, x, dx)
            k2 = second(t + step / 2, x + step / 2 * dx, dx + step / 2 * k1)
            k3 = second(t + step / 2, x + step / 2 * dx + step**2 / 4 * k1, dx + step / 2 * k2)
            k4 = second(t + step, x + step * dx + step**2 / 2 * k2, dx + step * k3)
            x, dx = x + step * dx + step**2 / 6 * (k1 + k2 + k3), dx + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            t += step
    return out


def harmonics(rng: np.random.Generator, joints: int, period_s: float, lines: int, speed: float) -> Motors:
    """Random harmonics of every joint, its fastest velocity about `speed` rad/s, as a function of time."""
    omega = 2 * np.pi / period_s * np.arange(1, lines + 1)
    size = rng.uniform(0.5, 1.0, (lines, joints)) / np.sqrt(omega)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (lines, joints))
    time = np.linspace(0.0, period_s, 2000)
    fastest = np.abs((size * np.cos(omega[:, None] * time[:, None, None] + phase)).sum(axis=1)).max(axis=0)
    size = size * speed / fastest
    centre = rng.uniform(-0.8, 0.8, joints)

    def motors(t: float) -> tuple[Array, Array, Array]:
        angle = (omega * t)[:, None] + phase
        w = omega[:, None]
        q = (size / w * np.sin(angle)).sum(axis=0) + centre
        return q, (size * np.cos(angle)).sum(axis=0), (-size * w * np.sin(angle)).sum(axis=0)

    return motors


def from_rest(motors: Motors, ramp_s: float) -> Motors:
    """The same about its first angles, grown from rest over so many seconds."""
    start = motors(0.0)[0]

    def grown(t: float) -> tuple[Array, Array, Array]:
        u = min(t / ramp_s, 1.0)
        size = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
        rate = 140 * u**3 * (1 - u) ** 3 / ramp_s
        bend = 420 * u**2 * (1 - u) ** 2 * (1 - 2 * u) / ramp_s**2
        q, v, a = motors(t)
        way = q - start
        return start + size * way, size * v + rate * way, size * a + 2 * rate * v + bend * way

    return grown
