"""What a campaign file states beside its signals: torque constants, the torques' side of the gears, what was on the flange."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass

from rx90b_flex.files.keys import suggestion
from rx90b_flex.files.table import TomlTable, shown

# A list in a TOML file holds no gaps, but it may hold this.
LEFT_OUT = "nan"
SIDES = ("motor", "joint", "behind_gear")  # of the gears, on which torques are measured
JOINT_SIDES = ("joint", "behind_gear")  # where a gear matrix does not touch them


@dataclass(frozen=True)
class Accelerometer:
    """A triaxial accelerometer fixed to a link.

    Attributes
    ----------
    link : str
        A moving link with mass, one of `robot.bodies`.
    position : three numbers, m
        In the frame of the link's joint, whose axes are those of the sensor.
    """

    link: str
    position: tuple[float, float, float]


def read_accelerometers(root: TomlTable) -> tuple[tuple[Accelerometer, ...], tuple[str, ...]]:
    """Sensors of ``[[accelerometer]]`` (link, position in m, three columns in m/s^2), and the columns of all of them."""
    sensors: list[Accelerometer] = []
    columns: list[str] = []
    for section in root.sections("accelerometer") if root.has("accelerometer") else ():
        section.allow("link", "position", "columns")
        names = section.texts("columns")
        if len(names) != 3:
            raise section.problem(
                "columns", f"lists {len(names)} columns; three are expected, along x, y and z of the link"
            )
        for name in names:
            if [*columns, *names].count(name) > 1:
                raise section.problem("columns", f"column {name!r} is listed twice")
        x, y, z = section.numbers("position", 3, "a place has").tolist()
        sensors.append(Accelerometer(section.text("link"), (x, y, z)))
        columns += names
    return tuple(sensors), tuple(columns)


@dataclass(frozen=True)
class FlangeLoad:
    """A known point mass on the flange during a recording.

    Attributes
    ----------
    mass : kg, above 0.
    centre : (x, y, z), m, in the robot's tip frame.
    """

    mass: float
    centre: tuple[float, float, float]


def read_date(section: TomlTable) -> str | None:
    """`date` of a [[recording]], ISO 8601; None where it has none.

    Raises
    ------
    ValueError
        One line that names file and key, what was found and what is expected.
    """
    value = section.values.get("date")
    if value is None:
        return None
    if isinstance(value, datetime.datetime):
        return value.date().isoformat()
    if not isinstance(value, datetime.date):
        raise section.problem("date", f"found {shown(value)}; expected a day without quotes, such as 2026-03-02")
    return value.isoformat()


def read_torque_side(root: TomlTable, has_gears: bool, from_current: bool) -> str:
    """`side` of a [torque] table: the motors' torques, those seen at the joints, or those of sensors behind the gears.

    Raises
    ------
    ValueError
        One line that names file and key, what was found and what is expected.
    """
    torque = root.section("torque")
    torque.allow("side")
    side = torque.text("side")
    if side not in SIDES:
        raise torque.problem("side", f"found {side!r}{suggestion(side, SIDES)}; expected {', '.join(SIDES)}")
    if side == "motor" and not has_gears:
        raise torque.problem(
            "side", "found 'motor', but there is no [motor] gear_matrix to bring torques to the joints"
        )
    if side != "motor" and from_current:
        raise torque.problem(
            "side", f"found {side!r}, but torques come from [signals] motor_current; leave [torque] out"
        )
    return side


def read_torque_constants(motor: TomlTable, joints: Sequence[str]) -> tuple[float | None, ...]:
    """`torque_constant` of a [motor] table, N m/A at the joint, one a joint; None for a value that is left out.

    Either a list with a value a joint, `nan` where it is left out, or a table ``{ joint = value }`` of those that are known; without
    the key none is.

    Raises
    ------
    ValueError
        One line that names file and key, what was found and what is expected.
    """
    key = "torque_constant"
    if not motor.has(key):
        return (None,) * len(joints)
    found = motor.values[key]
    if isinstance(found, dict):
        for name in found:
            if name not in joints:
                raise motor.problem(key, f"unknown joint {name!r}{suggestion(name, joints)}")
        found = [found.get(joint) for joint in joints]
    if not isinstance(found, list):
        raise motor.problem(
            key, f"found {shown(found)}, a list of {len(joints)} numbers or a table by joint is expected"
        )
    if len(found) != len(joints):
        raise motor.problem(key, f"lists {len(found)} values, joints lists {len(joints)}")
    return tuple(_constant(motor, key, value) for value in found)


def _constant(motor: TomlTable, key: str, value: object) -> float | None:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    number = motor.finite(key, value)
    if number == 0.0:
        raise motor.problem(key, f"found 0, another number, or {LEFT_OUT} for one to be identified, is expected")
    return number


def read_flange_load(entry: TomlTable) -> FlangeLoad | None:
    """`payload = { mass = 2.6, centre = [0.0, 0.0, 0.05] }` of a [[recording]], kg and m in the tip frame; None where it has none.

    Raises
    ------
    ValueError
        One line that names file, recording and key, what was found and what is expected.
    """
    if not entry.has("payload"):
        return None
    expected = "{ mass = kg, centre = [x, y, z] } is expected"
    found = entry.values["payload"]
    if not isinstance(found, dict):
        raise entry.problem("payload", f"found {shown(found)}, {expected}")
    inside = TomlTable(entry.file, f"{entry.name} payload", found)
    inside.allow("mass", "centre")
    centre = found.get("centre")
    if not isinstance(centre, list) or len(centre) != 3:
        text = "missing" if centre is None else f"found {shown(centre)}"
        raise inside.problem("centre", f"{text}; three numbers, m in the tip frame, are expected")
    x, y, z = (inside.finite("centre", value) for value in centre)
    return FlangeLoad(inside.positive("mass"), (x, y, z))
