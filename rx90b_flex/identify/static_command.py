"""What ``rx90b-flex static`` does: dead-weight tests of a robot become stiffnesses of its hinges.

A file of tests (TOML)::

    robot = "rx90b_4dof"              # optional: its robot file is written with what was found
    skip = 1                          # optional, of every test: readings before friction slides
    confidence = 0.95                 # optional, of every interval
    [[test]]
    coordinate = "joint_2:bend_1"
    file = "joint_2_bend_1.csv"       # moment_nm or load_n, deformation_rad, direction (up or down)
    lever_arm_m = 0.985               # where the table has load_n
    moment_std_nm = 0.2               # optional, of one reading
    deformation_std_rad = 2.9e-5      # optional, of one reading
    [[test]]                          # the lever by the robot's kinematics instead
    coordinate = "joint_3:torsion"
    file = "joint_3.csv"
    frame = "tool0"                   # where the load pulls
    direction = [0.0, 0.0, -1.0]      # optional, in the base frame: a hanging weight
    angles_deg = [0.0, 90.0, 0.0]     # of the drives; what is left out is zero
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy import special

from rx90b_flex.effects import close_match
from rx90b_flex.export import save_robot
from rx90b_flex.files.keys import check_keys
from rx90b_flex.files.toml import named_beside, named_in, read_toml
from rx90b_flex.identify.measured_stiffness import HingeStiffness, with_stiffnesses
from rx90b_flex.identify.static_stiffness import StaticStiffness, fit_static_stiffness
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals.static_test import StaticTest, read_static_table

KEYS = ("robot", "skip", "confidence", "test")
TEST_KEYS = (
    "coordinate", "file", "lever_arm_m", "moment_std_nm", "deformation_std_rad", "frame", "direction", "angles_deg",
)  # fmt: skip
SHORTEST_LEVER = 1e-3  # m; below it a load does not turn the hinge


@dataclass(frozen=True, eq=False)
class StaticTests:
    """A file of dead-weight tests.

    Attributes
    ----------
    path : Path
    robot : Robot or None
    tests : tuple of StaticTest
    skip : int
    confidence : float
    """

    path: Path
    robot: Robot | None
    tests: tuple[StaticTest, ...]
    skip: int
    confidence: float


@dataclass(frozen=True, eq=False, repr=False)
class StaticResult(Showing):
    """Stiffnesses from dead-weight tests.

    Attributes
    ----------
    source : StaticTests
    found : tuple of StaticStiffness, one a test
    hinges : tuple of HingeStiffness
        Tests of one hinge together, weighted by their variances.
    robot : Robot or None
        With those stiffnesses that are determined.
    """

    source: StaticTests
    found: tuple[StaticStiffness, ...]
    hinges: tuple[HingeStiffness, ...]
    robot: Robot | None


def read_static_tests(path: Path) -> StaticTests:
    """Read a file of tests and their tables.

    Raises
    ------
    ValueError
        One line that names the file and the test, key, column or row.
    """
    keys = read_toml(path, "file of tests")
    check_keys(keys, KEYS, path)
    robot = None
    if "robot" in keys:
        with named_in(path, "robot"):
            robot = load_robot(_robot_source(path, keys["robot"]))
    skip, confidence = keys.get("skip", 0), keys.get("confidence", 0.95)
    if isinstance(skip, bool) or not isinstance(skip, int) or skip < 0:
        raise ValueError(f"{path}: skip is {skip!r}; expected a number of readings, 0 or more")
    if isinstance(confidence, bool) or not isinstance(confidence, float) or not 0.0 < confidence < 1.0:
        raise ValueError(f"{path}: confidence is {confidence!r}; expected a number between 0 and 1")
    tables = keys.get("test")
    if not isinstance(tables, list) or not tables:
        raise ValueError(f"{path}: has no [[test]]; expected one or more")
    tests = tuple(_read_test(path, f"{path}: test {k}", t, robot) for k, t in enumerate(tables, start=1))
    return StaticTests(path, robot, tests, skip, confidence)


def _robot_source(path: Path, robot: Any) -> str:
    if not isinstance(robot, str):
        raise ValueError(f"{path}: robot is {robot!r}; expected a text")
    return str(named_beside(path, robot))


def _read_test(path: Path, where: str, table: Any, robot: Robot | None) -> StaticTest:
    if not isinstance(table, dict):
        raise ValueError(f"{where} is {table!r}; expected a table")
    check_keys(table, TEST_KEYS, where)
    for key in ("coordinate", "file"):
        if not isinstance(table.get(key), str):
            raise ValueError(f"{where}: {key} is {table.get(key)!r}; expected a text")
    numbers = {key: _number(where, table, key) for key in ("lever_arm_m", "moment_std_nm", "deformation_std_rad")}
    lever = numbers["lever_arm_m"]
    if "frame" in table:
        if lever is not None:
            raise ValueError(f"{where}: has lever_arm_m and frame; expected one of them")
        lever = _lever(where, table, robot)
    elif "direction" in table or "angles_deg" in table:
        raise ValueError(f"{where}: direction and angles_deg go with frame, where the load pulls")
    coordinate = table["coordinate"]
    if robot is not None:
        _hinge(where, robot, coordinate)
    file = path.parent / table["file"]
    with named_in(path, where.removeprefix(f"{path}: ") + " file"):
        return read_static_table(file, coordinate, lever, numbers["moment_std_nm"], numbers["deformation_std_rad"])


def _number(where: str, table: Mapping[str, Any], key: str) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < np.inf:
        raise ValueError(f"{where}: {key} is {value!r}; expected a number above 0")
    return float(value)


def _hinge(where: str, robot: Robot, coordinate: str) -> int:
    hinges = [c for c in robot.coordinates if not c.endswith(":drive")]
    if coordinate not in hinges:
        hint = close_match(coordinate, hinges) if hinges else "none of its joints is flexible"
        raise ValueError(f"{where}: {robot.name} has no hinge {coordinate!r}; {hint}")
    return robot.coordinates.index(coordinate)


def _lever(where: str, table: Mapping[str, Any], robot: Robot | None) -> float:
    """Moment about the hinge's axis per newton at the frame: its row of the Jacobian, along the pull; m."""
    if robot is None:
        raise ValueError(f"{where}: frame needs the file's robot")
    place = _hinge(where, robot, table["coordinate"])
    frames = [f.name for f in robot.model.frames]
    if table["frame"] not in frames:
        raise ValueError(f"{where}: unknown frame {table['frame']!r}; {close_match(str(table['frame']), frames)}")
    pull = _vector(where, "direction", table.get("direction", [0.0, 0.0, -1.0]))
    angles = _vector(where, "angles_deg", table.get("angles_deg", []))
    if len(pull) != 3 or not np.linalg.norm(pull) > 0.0:
        raise ValueError(f"{where}: direction is {table['direction']!r}; expected three numbers, not all 0")
    if len(angles) > len(robot.joints):
        raise ValueError(f"{where}: angles_deg has {len(angles)} numbers; expected at most {len(robot.joints)}")
    q = robot.input_matrix @ np.deg2rad(np.pad(angles, (0, len(robot.joints) - len(angles))))
    data, frame = robot.model.createData(), robot.model.getFrameId(table["frame"])
    jacobian = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    lever = float(jacobian[:3, place] @ pull / np.linalg.norm(pull))
    if abs(lever) < SHORTEST_LEVER:
        raise ValueError(
            f"{where}: the load does not turn {table['coordinate']}: its lever is {lever:.2g} m in that pose"
        )
    return lever


def _vector(where: str, key: str, value: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    numbers = isinstance(value, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    if not numbers or not np.isfinite(value).all():
        raise ValueError(f"{where}: {key} is {value!r}; expected a list of numbers")
    return np.asarray(value, dtype=float)


def fit_tests(source: StaticTests) -> StaticResult:
    """Fit every test, put those of one hinge together and into the robot.

    Raises
    ------
    ValueError
        One line that names the file, and the test that tells no stiffness.
    """
    try:
        found = tuple(fit_static_stiffness(t, skip=source.skip, confidence=source.confidence) for t in source.tests)
        hinges = tuple(_together(name, found) for name in dict.fromkeys(f.coordinate for f in found))
        robot = source.robot
        if robot is not None:
            robot = with_stiffnesses(robot, {h.coordinate: h.value for h in hinges if h.determined})
    except ValueError as error:
        raise ValueError(f"{source.path}: {error}") from None
    return StaticResult(source, found, hinges, robot)


def _together(coordinate: str, found: tuple[StaticStiffness, ...]) -> HingeStiffness:
    """Mean of the compliances (their errors are normal, those of stiffnesses are not), weighted by their variances."""
    own = [f for f in found if f.coordinate == coordinate]
    compliance = np.array([1.0 / f.stiffness for f in own])
    std = np.array([f.stiffness_std / f.stiffness**2 for f in own])
    if len(own) == 1 or not (std > 0.0).all():
        mean, mean_std, p = float(compliance.mean()), float(std.mean() / np.sqrt(len(own))), 1.0
    else:
        weight = 1.0 / std**2
        mean, mean_std = float(weight @ compliance / weight.sum()), float(1.0 / np.sqrt(weight.sum()))
        p = float(special.chdtrc(len(own) - 1, np.sum((compliance - mean) ** 2 * weight)))
    return HingeStiffness(coordinate, 1.0 / mean, mean_std / mean**2, len(own), p)


def as_json(result: StaticResult) -> dict[str, Any]:
    """Everything but the readings."""
    return {
        "schema": 1,
        "robot": None if result.robot is None else result.robot.name,
        "stiffness": [
            {"coordinate": h.coordinate, "value": h.value, "std": h.std, "unit": "N m/rad", "tests": h.measurements,
             "p_value": h.p_value}
            for h in result.hinges
        ],
        "tests": [
            {
                "coordinate": f.coordinate,
                "stiffness": f.stiffness,
                "std": f.stiffness_std,
                "interval": [x if np.isfinite(x) else None for x in f.interval],
                "confidence": f.confidence,
                "readings": len(t),
                "loading_against_unloading_p_value": f.p_value,
                "hysteresis_area": f.hysteresis_area,
                "hysteresis_std": f.hysteresis_std,
            }
            for f, t in zip(result.found, result.source.tests, strict=True)
        ],
    }  # fmt: skip


def write_static(result: StaticResult, folder: Path) -> None:
    """Write `static.json`, and the robot with the stiffnesses where the file names one."""
    (folder / "static.json").write_text(json.dumps(as_json(result), indent=1) + "\n", encoding="utf-8")
    if result.robot is not None:
        save_robot(result.robot, folder, allow_inconsistent=True)
