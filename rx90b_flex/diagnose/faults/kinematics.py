"""A URDF whose zero, axis, length or mounting is not the robot's."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator

import numpy as np

from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.sample import Reading

ZEROS = tuple(np.radians([-90.0, -40.0, 40.0, 90.0, 180.0]).tolist())
LENGTHS = (0.1, 0.5, 0.75, 1.33, 2.0, 10.0)  # the URDF's over the true one
LITTLE = 0.2, 1.2  # rad of a zero, and times a length, that a URDF may be off by
DIRECTIONS = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))


def zeros(look: Look) -> Iterator[Hypothesis]:
    """The joint angle at which the log counts zero is another one in the URDF."""
    for k in _turning(look):
        for angle in ZEROS:
            yield _zero(look, k, angle, (angle - 0.8, angle + 0.8))


def a_little_off(look: Look) -> Iterator[Hypothesis]:
    """Every zero, every length and the base's level by as much as it takes, as small errors are: what a small fault competes with."""
    angle, factor = LITTLE
    down = np.array(look.reading.gravity)
    across = np.eye(3)[np.argmin(np.abs(down))]
    one_way, _ = look.refined(_tilt(look, look.reading, across, angle))
    yield _tilt(look, one_way.reading, np.cross(down, across), angle)
    for k in _turning(look):
        yield _zero(look, k, 0.0, (-angle, angle))
    for joint in look.sample.joints:
        if _place(look, joint).any():
            yield _length(look, joint, 1.0, (1.0 / factor, factor))


def _tilt(look: Look, before: Reading, towards: np.ndarray, largest: float) -> Hypothesis:
    """Gravity of a reading leans in a direction across it."""

    def reading(angle: float) -> Reading:
        x, y, z = np.array(before.gravity) + np.tan(angle) * towards
        length = float(np.sqrt(x**2 + y**2 + z**2))
        return dataclasses.replace(before, gravity=(x / length, y / length, z / length))

    text = "The base is not level: mount the URDF as the robot is."
    return Hypothesis("kinematics", None, (), text, reading, 0.0, (-largest, largest))


def _turning(look: Look) -> list[int]:
    return [k for k in range(len(look.sample.joints)) if not look.prismatic[k]]


def _zero(look: Look, k: int, angle: float, bounds: tuple[float, float]) -> Hypothesis:
    joint = look.sample.joints[k]
    text = (
        f"The zero of {joint} is <factor>° off: the URDF's angle is the log's plus that; correct the joint's origin, or state "
        "`offset`."
    )

    def reading(angle: float) -> Reading:
        return look.reading.changed("offset", (k,), lambda x: x + angle)

    return Hypothesis("kinematics", None, (joint,), text, reading, angle, bounds, shown=float(np.degrees(1.0)))


def axes(look: Look) -> Iterator[Hypothesis]:
    """The joint turns about another axis of its frame than the URDF says."""
    for joint in look.sample.joints:
        element = _joint(_tree(look), joint).find("axis")
        present = _numbers(element, "xyz", (1.0, 0.0, 0.0))
        for axis in np.eye(3):
            if abs(axis @ present) > 0.7:
                continue

            def turned(root: ElementTree.Element, axis: np.ndarray = axis, joint: str = joint) -> None:
                at = _joint(root, joint)
                found = at.find("axis")
                (ElementTree.SubElement(at, "axis") if found is None else found).set("xyz", _text(axis))

            name = "xyz"[int(np.argmax(axis))]
            text = (
                f"The axis of {joint} does not fit: about its frame's {name} the torques go together. Correct the URDF."
            )
            yield Hypothesis.of("kinematics", None, (joint,), text, _with(look, ("axis", joint, name), turned))


def lengths(look: Look) -> Iterator[Hypothesis]:
    """A link is longer or shorter than the URDF says."""
    for joint in look.sample.joints:
        if _place(look, joint).any():
            for factor in LENGTHS:
                yield _length(look, joint, factor, (factor / 1.5, factor * 1.5))


def _place(look: Look, joint: str) -> np.ndarray:
    """Of a joint in the frame of the one before."""
    return _numbers(_joint(_tree(look), joint).find("origin"), "xyz", (0.0, 0.0, 0.0))


def _length(look: Look, joint: str, factor: float, bounds: tuple[float, float]) -> Hypothesis:
    place = _place(look, joint)

    def reading(factor: float) -> Reading:
        def moved(root: ElementTree.Element) -> None:
            origin = _joint(root, joint).find("origin")
            assert origin is not None
            origin.set("xyz", _text(place / factor))

        return _with(look, ("length", joint, factor), moved)

    text = f"The link before {joint} is <factor> times too long in the URDF: correct the joint's origin."
    return Hypothesis("kinematics", None, (joint,), text, reading, factor, bounds)


def mountings(look: Look) -> Iterator[Hypothesis]:
    """The robot hangs from a ceiling or a wall."""
    for direction in DIRECTIONS:
        if direction != look.reading.gravity:
            text = f"Gravity points along {direction} of the URDF's base: mount the URDF as the robot is."
            reading = dataclasses.replace(look.reading, gravity=direction)
            yield Hypothesis.of("kinematics", None, (), text, reading)


def _with(look: Look, key: tuple[object, ...], edit: Callable[[ElementTree.Element], None]) -> Reading:
    """The reading with an edited URDF; the same edit gives the same robot."""
    robot, known = look.reading.robot, look.robots
    key = (id(robot), *key)
    if key not in known:
        root = _tree(look)
        edit(root)
        known[key] = dataclasses.replace(robot, urdf=ElementTree.tostring(root, encoding="unicode"))
    return dataclasses.replace(look.reading, robot=known[key])


def _tree(look: Look) -> ElementTree.Element:
    return ElementTree.fromstring(look.reading.robot.urdf)


def _joint(root: ElementTree.Element, name: str) -> ElementTree.Element:
    return next(j for j in root.iter("joint") if j.get("name") == name)


def _numbers(element: ElementTree.Element | None, key: str, default: tuple[float, ...]) -> np.ndarray:
    text = None if element is None else element.get(key)
    return np.array(default if text is None else [float(x) for x in text.split()])


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values)
