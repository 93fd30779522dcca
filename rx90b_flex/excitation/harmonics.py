"""Motion that any arm can make: random harmonics, each joint within its limits of position and speed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from rx90b_flex.effects.motion import Array

TURNS = 4.0 * np.pi  # rad; a joint with more room than this turns without end: it is kept within one turn about zero


def harmonic_motion(
    tree: pin.Model, time: Array, rng: np.random.Generator, *, period_s: float, lines: int = 8, speed: float = 0.75
) -> tuple[Array, Array, Array]:
    """Angles, velocities and accelerations of a motion that repeats after `period_s`, each (N, joints).

    Parameters
    ----------
    tree : pinocchio.Model
        The rigid arm; its limits of position and speed are kept.
    time : array, shape (N,), s
    lines : int
        Harmonics of 1 / period_s.
    speed : float
        Largest velocity over the joint's limit, where its range has room for it.
    """
    omega = 2.0 * np.pi / period_s * np.arange(1, lines + 1)
    angle = np.outer(time, omega)
    # velocities fall off slowly with frequency, so that slow and fast passages alternate
    weights = rng.normal(size=(2, lines, tree.nv)) / np.sqrt(omega)[:, None]
    v = np.cos(angle) @ weights[0] + np.sin(angle) @ weights[1]
    q = np.sin(angle) @ (weights[0] / omega[:, None]) - np.cos(angle) @ (weights[1] / omega[:, None])
    a = -np.sin(angle) @ (weights[0] * omega[:, None]) + np.cos(angle) @ (weights[1] * omega[:, None])
    low, high = np.array(tree.lowerPositionLimit), np.array(tree.upperPositionLimit)
    endless = high - low > TURNS * (1.0 + 1e-6)
    low[endless], high[endless] = -np.pi, np.pi
    by_speed = speed * tree.velocityLimit / np.abs(v).max(axis=0)
    by_range = 0.9 * (high - low) / np.ptp(q, axis=0)
    scale = np.minimum(by_speed, by_range)
    q, v, a = q * scale, v * scale, a * scale
    middle = (q.max(axis=0) + q.min(axis=0)) / 2
    room = np.maximum((high - low) - np.ptp(q, axis=0), 0.0)
    centre = (high + low) / 2 + rng.uniform(-0.4, 0.4, tree.nv) * room
    return q - middle + centre, v, a
