"""Angles of rotations as files have them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[np.float64]


def roll_pitch_yaw(rotation: Vector) -> Vector:
    """Roll, pitch, yaw (rad) with R = Rz(yaw) Ry(pitch) Rx(roll), so that they give R back to the last bit if they can.

    yourdfpy keeps rotations as matrices. An angle read from a matrix by atan2 is off by a rounding error, and at
    pitch = 90 degrees only roll -+ yaw is left of the two. But the file's angles are decimals, mostly short, and five
    entries hold products of their sines and cosines alone; so the shortest decimals that give the same products are
    the file's angles again.
    """
    if np.array_equal(rotation, np.eye(3)):
        return np.zeros(3)
    sine, cosine = -rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0])
    # A pitch beyond 90 degrees has a negative cosine; roll and yaw then are half a turn further.
    for sign in (1.0, -1.0):
        for pitch in _decimals(math.atan2(sine, sign * cosine)):
            scale = math.cos(pitch)
            if math.sin(pitch) != sine or abs(scale - sign * cosine) > 4 * np.finfo(float).eps * cosine:
                continue
            roll = _decimal(scale, rotation[2, 1], rotation[2, 2])
            yaw = _decimal(scale, rotation[1, 0], rotation[0, 0])
            if roll is not None and yaw is not None:
                return np.array([roll, pitch, yaw])
    pitch = math.atan2(sine, cosine)
    roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    regular = np.array([roll, pitch, yaw])
    # At pitch = +-90 degrees the four entries used are tiny; noise in them (a product of rotations) makes roll and yaw
    # meaningless one by one. Then yaw = 0 is chosen and roll carries their sum.
    singular = np.array([math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    errors = [float(np.abs(_rotation(angles) - rotation).max()) for angles in (regular, singular)]
    return singular if errors[1] < errors[0] else regular


def _decimal(scale: float, sine: float, cosine: float) -> float | None:
    """Shortest decimal angle whose sine and cosine, times `scale`, are exactly these doubles; None if there is none."""
    for angle in _decimals(math.atan2(math.copysign(1.0, scale) * sine, math.copysign(1.0, scale) * cosine)):
        if scale * math.sin(angle) == sine and scale * math.cos(angle) == cosine:
            return angle
    return None


def _decimals(angle: float) -> Iterator[float]:
    """Round `angle` to ever more digits, then take its neighbours; then the same a turn away, for 3.1416 is past pi."""
    if angle == 0.0:
        yield 0.0
    for turned in (angle, angle - 2.0 * math.pi, angle + 2.0 * math.pi):
        yield from (float(f"{turned:.{digits}g}") for digits in range(1, 18))
        below = above = turned
        for _ in range(3):
            below, above = math.nextafter(below, -math.inf), math.nextafter(above, math.inf)
            yield from (below, above)


def _rotation(rpy: Vector) -> Vector:
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cp * cy, sp * sr * cy - cr * sy, sp * cr * cy + sr * sy],
            [cp * sy, sp * sr * sy + cr * cy, sp * cr * sy - sr * cy],
            [-sp, cp * sr, cp * cr],
        ]
    )
