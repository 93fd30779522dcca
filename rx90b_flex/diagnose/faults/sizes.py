"""Signals of a size that the URDF's limits and links rule out, whatever a fit makes of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from rx90b_flex.diagnose.faults.compare import CREDIBLE, GAIN_KNOWN
from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.diagnose.faults.units import outside
from rx90b_flex.effects.motion import Array
from rx90b_flex.signals.data_fault import DataFault

TOO_SMALL = 0.04  # of the torque that the URDF's links alone ask for: no links are so much lighter than their CAD model
TOO_SMALL_ALONE = 0.25  # the same for one joint, where the URDF's links fit every other joint
TOO_LARGE = 3.0  # times the URDF's effort limit
BEARS_MUCH = 0.1  # of the largest torque that links ask of a joint, from which a joint's own is held against it
DEGREES = 180.0 / np.pi


def impossible_sizes(look: Look, named: Sequence[DataFault]) -> Iterator[DataFault]:
    """Positions beyond their limits and torques beyond reason, of joints whose signal is not yet in doubt."""
    joints = look.sample.joints
    known = {(f.signal, j) for f in named if f.kind in ("unit", "torque_gain", "unrelated") for j in f.joints}
    beyond = np.flatnonzero(outside(look, 1.0)).tolist()
    fitting = [k for k in beyond if not look.prismatic[k] and not outside(look, 1.0 / DEGREES)[k]]
    narrow = _borne_out(look, fitting)
    degrees = [k for k in fitting if k not in narrow]
    slides = [k for k in beyond if look.prismatic[k]]
    other = [k for k in beyond if k not in (*fitting, *slides)]
    # what a position in another unit makes links ask for says nothing of a torque
    large, small = ([k for k in chosen if k not in beyond] for chosen in torque_sizes(look))
    scale = "another unit, amperes, or the motor's side of the gear?"
    in_degrees = "leaves the URDF's limits and fits into them in degrees: bring it to rad."
    wide = "moves through more than the URDF's range: the motor's side of the gear? State `gear_matrix`."
    found: tuple[tuple[str, Sequence[int], float | None, str], ...] = (
        ("motor_position", degrees, DEGREES, in_degrees),
        ("motor_position", other, None, wide),
        (
            "motor_position",
            slides,
            None,
            "moves through more than the URDF's range: mm, or the motor's side of the gear?",
        ),
        ("torque", large, None, f"is far above the URDF's effort limit: {scale}"),
        ("torque", small, None, f"is far below what the URDF's links ask for: {scale}"),
    )
    for signal, chosen, factor, what in found:
        names = tuple(joints[k] for k in chosen if (signal, joints[k]) not in known)
        if names:
            text = f"The {signal.removeprefix('motor_')} of {', '.join(names)} {what}"
            yield DataFault("unit", signal, names, text, factor=factor)
    if narrow:
        names = tuple(joints[k] for k in narrow)
        text = (
            f"The position of {', '.join(names)} moves through more than the URDF's range, and the torques bear it out: the URDF's "
            "limits are narrower than the robot's; widen them."
        )
        yield DataFault("kinematics", None, names, text, usable=True)


def _borne_out(look: Look, beyond: Sequence[int]) -> list[int]:
    """Joints of whose angles the URDF's links explain the torques far worse in degrees, with those that are not told, if there are
    such: then its limits are not the robot's.
    """
    in_rad = look.fit_of_known_links()
    if not beyond or np.median(in_rad.error) >= CREDIBLE:
        return []
    readings = [look.reading.changed("scale", [k], lambda x: x / DEGREES) for k in beyond]
    lost = np.array([look.fit_of_known_links(r).score - in_rad.score for r in readings])
    return [k for k, x in zip(beyond, lost, strict=True) if x > 0.0] if (lost > GAIN_KNOWN).any() else []


def torque_sizes(look: Look) -> tuple[list[int], list[int]]:
    """Numbers of the joints whose torque is too large for the URDF's limits, and too small for its links."""
    expected, torque, size, part = _held_against_links(look)
    at = np.array([look.reading.robot.layout.index(j) for j in look.sample.joints])
    effort = look.reading.robot.tree.effortLimit[at]
    largest = np.abs(torque).max(axis=0)
    # a limit below what the links ask for is a placeholder
    stated = np.isfinite(effort) & (effort > np.abs(expected).max(axis=0))
    heavy = size > 1e-3 * size.max()
    # one joint's links cannot be far lighter than the file says while those that carry them are not
    unfit = np.minimum(look.fit_of_known_links().error, look.beside.fit_of_known_links().error) >= CREDIBLE
    alone = (part < TOO_SMALL_ALONE) & unfit & (unfit.sum() == 1) & (len(part) > 1)
    small = heavy & ((part < TOO_SMALL) | alone)
    large = stated & (largest > TOO_LARGE * effort)
    return [int(k) for k in np.flatnonzero(large)], [int(k) for k in np.flatnonzero(small)]


def far_below(look: Look, but: Collection[str] = ()) -> str:
    """Which joints' torques are a small part of what the URDF's links alone ask for, in words; empty where none is.

    That may be so on a sound robot: links may be lighter than the file says, or a spring may carry them.
    """
    joints, (_, _, size, part) = look.sample.joints, _held_against_links(look)
    few = np.flatnonzero((size > BEARS_MUCH * size.max()) & (part < TOO_SMALL_ALONE)).tolist()
    found = {joints[k]: f"{1 / part[k]:.2g}" for k in few if joints[k] not in but}
    if not found:
        return ""
    names, times = ", ".join(found), ", ".join(found.values())
    return (
        f"What the URDF's links alone ask of {names} is {times} times the measured torque: amperes, another torque constant, a "
        "spring that carries them, or links that are lighter than the file says?"
    )


def _held_against_links(look: Look) -> tuple[Array, Array, Array, Array]:
    """Torque that the URDF's links ask for and the measured one, each (R, joints), N m; the root mean square of the first, and which
    part of it the second's is, each (joints,).
    """
    reading = look.reading
    at = np.array([reading.robot.layout.index(j) for j in look.sample.joints])
    expected = reading.robot.link_torque(look.sample.motion(reading))[:, at] @ reading.torques_to_motors.T
    torque = look.sample.torque_seen(reading)
    size, measured = (np.sqrt((x**2).mean(axis=0)) for x in (expected, torque))
    return expected, torque, size, measured / np.maximum(size, 1e-300)
