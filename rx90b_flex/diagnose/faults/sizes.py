"""Signals of a size that the URDF's limits and links rule out, whatever a fit makes of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rx90b_flex.diagnose.faults.compare import CREDIBLE
from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.diagnose.faults.units import outside
from rx90b_flex.signals.data_fault import DataFault

TOO_SMALL = 0.04  # of the torque that the URDF's links alone ask for: no links are so much lighter than their CAD model
TOO_SMALL_ALONE = 0.25  # the same for one joint, where the URDF's links fit every other joint
TOO_LARGE = 3.0  # times the URDF's effort limit
DEGREES = 180.0 / np.pi


def impossible_sizes(look: Look, named: Sequence[DataFault]) -> Iterator[DataFault]:
    """Positions beyond their limits and torques beyond reason, of joints whose unit is not yet in doubt."""
    joints = look.sample.joints
    known = {(f.signal, j) for f in named if f.kind in ("unit", "torque_gain") for j in f.joints}
    beyond = np.flatnonzero(outside(look, 1.0)).tolist()
    degrees = [k for k in beyond if not look.prismatic[k] and not outside(look, 1.0 / DEGREES)[k]]
    other = [k for k in beyond if k not in degrees]
    large, small = torque_sizes(look)
    scale = "another unit, amperes, or the motor's side of the gear?"
    in_degrees = "leaves the URDF's limits and fits into them in degrees: bring it to rad."
    wide = "moves through more than the URDF's range: the motor's side of the gear? State `gear_matrix`."
    found: tuple[tuple[str, Sequence[int], float | None, str], ...] = (
        ("motor_position", degrees, DEGREES, in_degrees),
        ("motor_position", other, None, wide),
        ("torque", large, None, f"is far above the URDF's effort limit: {scale}"),
        ("torque", small, None, f"is far below what the URDF's links ask for: {scale}"),
    )
    for signal, chosen, factor, what in found:
        names = tuple(joints[k] for k in chosen if (signal, joints[k]) not in known)
        if names:
            text = f"The {signal.removeprefix('motor_')} of {', '.join(names)} {what}"
            yield DataFault("unit", signal, names, text, factor=factor)


def torque_sizes(look: Look) -> tuple[list[int], list[int]]:
    """Numbers of the joints whose torque is too large for the URDF's limits, and too small for its links."""
    reading, robot = look.reading, look.reading.robot
    at = np.array([robot.layout.index(j) for j in look.sample.joints])
    expected = robot.link_torque(look.sample.motion(reading))[:, at] @ reading.torques_to_motors.T
    torque = look.sample.torque_seen(reading)
    effort = robot.tree.effortLimit[at]
    largest = np.abs(torque).max(axis=0)
    # a limit below what the links ask for is a placeholder
    stated = np.isfinite(effort) & (effort > np.abs(expected).max(axis=0))
    size = np.sqrt((expected**2).mean(axis=0))
    heavy = size > 1e-3 * size.max()
    part = np.sqrt((torque**2).mean(axis=0)) / np.maximum(size, 1e-300)
    # one joint's links cannot be far lighter than the file says while those that carry them are not
    unfit = np.minimum(look.fit_of_known_links().error, look.beside.fit_of_known_links().error) >= CREDIBLE
    alone = (part < TOO_SMALL_ALONE) & unfit & (unfit.sum() == 1) & (len(part) > 1)
    small = heavy & ((part < TOO_SMALL) | alone)
    large = stated & (largest > TOO_LARGE * effort)
    return [int(k) for k in np.flatnonzero(large)], [int(k) for k in np.flatnonzero(small)]
