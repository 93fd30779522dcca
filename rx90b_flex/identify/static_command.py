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

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rx90b_flex.effects import close_match
from rx90b_flex.export import save_robot
from rx90b_flex.files.results import finite, write_json
from rx90b_flex.files.table import TomlTable
from rx90b_flex.files.toml import named_beside, named_in, read_toml
from rx90b_flex.identify.linear_fit import weighted_mean
from rx90b_flex.identify.measured_stiffness import HingeStiffness, declared_stiffnesses, with_stiffnesses
from rx90b_flex.identify.static_stiffness import ROUNDING, StaticStiffness, fit_static_stiffness
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals.static_test import StaticTest, gives_moment, read_static_table
from rx90b_flex.tip import jacobian_at

KEYS = ("robot", "skip", "confidence", "test")
TEST_KEYS = (
    "coordinate", "file", "lever_arm_m", "moment_std_nm", "deformation_std_rad", "frame", "direction", "angles_deg",
)  # fmt: skip
SHORTEST_LEVER = 1e-3  # m; below it a load does not turn the hinge
LONGEST_LEVER = 20.0  # m; nobody's lever is longer
LARGEST_TURN = 0.05  # rad; more than a drive or bearing yields under a load that it bears
NEWTONS, LIKE_WEIGHTS = (
    9.81,
    0.05,
)  # a kg weighs, and how near to one over that a ratio of stiffnesses looks like loads in kg
OFF_DECLARED = 20.0  # times a stiffness may be off the declared one without a word


@dataclass(frozen=True, eq=False)
class StaticTests:
    """A file of dead-weight tests.

    Attributes
    ----------
    path : Path
    robot : Robot or None
    tests : tuple of StaticTest
    files : tuple of str
        Of the tests.
    skip : int
    confidence : float
    cautions : tuple of str
        Levers that can hardly be, or that are not used.
    """

    path: Path
    robot: Robot | None
    tests: tuple[StaticTest, ...]
    files: tuple[str, ...]
    skip: int
    confidence: float
    cautions: tuple[str, ...]


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
    cautions : tuple of str
        Readings, levers and units to look at.
    """

    source: StaticTests
    found: tuple[StaticStiffness, ...]
    hinges: tuple[HingeStiffness, ...]
    robot: Robot | None
    cautions: tuple[str, ...]


def read_static_tests(path: Path) -> StaticTests:
    """Read a file of tests and their tables.

    Raises
    ------
    ValueError
        One line that names the file and the test, key, column or row.
    """
    table = TomlTable(str(path), "", read_toml(path, "file of tests"))
    table.allow(*KEYS)
    robot = None
    if table.has("robot"):
        with named_in(path, "robot"):
            robot = load_robot(named_beside(path, table.text("robot")))
    skip = table.whole("skip", 0) if table.has("skip") else 0
    confidence = table.share("confidence") if table.has("confidence") else 0.95
    sections = table.sections("test")
    tests = tuple(_read_test(path, test, robot) for test in sections)
    files = tuple(test.text("file") for test in sections)
    levers = [(test, test.positive("lever_arm_m")) for test in sections if test.has("lever_arm_m")]
    cautions = tuple(
        f"{path.name}: {test.name} lever_arm_m: {lever:.4g} is taken as m; a lever of {lever:.4g} mm is {1e-3 * lever:.4g} there"
        for test, lever in levers
        if lever > LONGEST_LEVER
    )
    return StaticTests(path, robot, tests, files, skip, confidence, (*cautions, *_unused_levers(path, sections)))


def _unused_levers(path: Path, sections: list[TomlTable]) -> list[str]:
    said = []
    for test in sections:
        key = next((key for key in ("lever_arm_m", "frame") if test.has(key)), None)
        if key is not None and gives_moment(path.parent / test.text("file")):
            said.append(f"{path.name}: {test.name} {key}: is not used, for {test.text('file')} gives moment_nm")
    return said


def _read_test(path: Path, table: TomlTable, robot: Robot | None) -> StaticTest:
    table.allow(*TEST_KEYS)
    coordinate, file = table.text("coordinate"), table.text("file")
    lever, moment_std, deformation_std = (
        table.optional(key, table.positive) for key in ("lever_arm_m", "moment_std_nm", "deformation_std_rad")
    )
    if table.has("frame"):
        if lever is not None:
            raise table.problem("frame", "stands beside lever_arm_m; one of them is expected")
        lever = _lever(table, robot)
    for key in ("direction", "angles_deg"):
        if table.has(key) and not table.has("frame"):
            raise table.problem(key, "direction and angles_deg go with frame, where the load pulls")
    if robot is not None:
        _hinge(table, robot)
    with named_in(path, f"{table.name} file"):
        return read_static_table(path.parent / file, coordinate, lever, moment_std, deformation_std)


def _hinge(table: TomlTable, robot: Robot) -> int:
    coordinate = table.text("coordinate")
    hinges = [c for c in robot.coordinates if not c.endswith(":drive")]
    if coordinate not in hinges:
        hint = close_match(coordinate, hinges) if hinges else "none of its joints is flexible"
        raise table.problem("coordinate", f"{robot.name} has no hinge {coordinate!r}; {hint}")
    return robot.coordinates.index(coordinate)


def _lever(table: TomlTable, robot: Robot | None) -> float:
    """Moment about the hinge's axis per newton at the frame: its row of the Jacobian, along the pull; m."""
    if robot is None:
        raise table.problem("frame", "needs the file's robot")
    place = _hinge(table, robot)
    name, frames = table.text("frame"), [f.name for f in robot.model.frames]
    if name not in frames:
        raise table.problem("frame", f"unknown frame {name!r}; {close_match(name, frames)}")
    pull = table.numbers("direction", 3, "a direction has") if table.has("direction") else np.array([0.0, 0.0, -1.0])
    angles = table.numbers("angles_deg") if table.has("angles_deg") else np.zeros(0)
    if not np.linalg.norm(pull) > 0.0:
        raise table.problem("direction", "found three zeros, a direction is expected")
    if len(angles) > len(robot.joints):
        raise table.problem("angles_deg", f"lists {len(angles)} values, at most {len(robot.joints)} are expected")
    q = robot.input_matrix @ np.deg2rad(np.pad(angles, (0, len(robot.joints) - len(angles))))
    data, frame = robot.model.createData(), robot.model.getFrameId(name)
    jacobian = jacobian_at(robot.model, data, q, frame)
    lever = float(jacobian[:3, place] @ pull / np.linalg.norm(pull))
    if abs(lever) < SHORTEST_LEVER:
        coordinate = robot.coordinates[place]
        raise table.problem("frame", f"the load does not turn {coordinate}: its lever is {lever:.2g} m in that pose")
    return lever


def fit_tests(source: StaticTests) -> StaticResult:
    """Fit every test, put those of one hinge together and into the robot.

    Raises
    ------
    ValueError
        One line that names the file, and the test that tells no stiffness.
    """
    with named_in(source.path):
        found = tuple(fit_static_stiffness(t, skip=source.skip, confidence=source.confidence) for t in source.tests)
        hinges = tuple(_together(name, found) for name in dict.fromkeys(f.coordinate for f in found))
        robot = source.robot
        if robot is not None:
            robot = with_stiffnesses(robot, {h.coordinate: h.value for h in hinges if h.determined})
    return StaticResult(source, found, hinges, robot, _cautions(source, found, hinges))


def _cautions(
    source: StaticTests, found: tuple[StaticStiffness, ...], hinges: tuple[HingeStiffness, ...]
) -> tuple[str, ...]:
    said = list(source.cautions)
    declared = {} if source.robot is None else declared_stiffnesses(source.robot)
    for hinge in hinges:
        ratio = hinge.value / declared.get(hinge.coordinate, hinge.value)
        if hinge.determined and max(ratio, 1.0 / ratio) > OFF_DECLARED:
            times = f"{max(ratio, 1.0 / ratio):.3g} times {'above' if ratio > 1.0 else 'below'}"
            said.append(
                f"{hinge.coordinate}: {hinge.value:.4g} N m/rad is {times} the declared {declared[hinge.coordinate]:.4g}; unless "
                "that is meant, look at the units: deformation_rad in rad (degrees are 57 times, mrad 1000 times larger), "
                "load_n in N, lever_arm_m in m"
            )
        elif hinge.determined and abs(ratio * NEWTONS - 1.0) < LIKE_WEIGHTS:
            said.append(
                f"{hinge.coordinate}: {hinge.value:.4g} N m/rad is {1.0 / ratio:.3g} times below the declared "
                f"{declared[hinge.coordinate]:.4g}: look whether load_n is in kg; N are expected"
            )
    for file, test, fit in zip(source.files, source.tests, found, strict=True):
        span = float(np.ptp(test.deformation))
        if span > LARGEST_TURN:
            said.append(
                f"{file}: column 'deformation_rad' spans {span:.2g} rad ({np.degrees(span):.2g} degrees), more than a hinge bears; "
                "look whether it is in degrees or mrad"
            )
        if fit.backwards:
            said.append(
                f"{file}: the loop of loading and unloading runs the wrong way round ({fit.hysteresis_area:.2g} ± "
                f"{fit.hysteresis_std:.1g} J): that is no friction but a drift, of the camera say, or rows in another order than read"
            )
        if fit.outlier is not None:
            said.append(_stands_out(file, test, fit.outlier))
    return tuple(said)


def _stands_out(file: str, test: StaticTest, place: int) -> str:
    first = place in {int(np.flatnonzero(rows)[0]) for rows in (test.rising, ~test.rising)}
    friction = (
        "; of a direction's first readings it may be friction that does not slide yet, see `skip`" if first else ""
    )
    return f"{file}, row {place + 1}: the reading stands out from the line; correct it or take it out{friction}"


def _together(coordinate: str, found: tuple[StaticStiffness, ...]) -> HingeStiffness:
    """Mean of the compliances (their errors are normal, those of stiffnesses are not), weighted by their variances."""
    own = [f for f in found if f.coordinate == coordinate]
    compliance = np.array([1.0 / f.stiffness for f in own])
    std = np.array([f.stiffness_std / f.stiffness**2 for f in own])
    if len(own) == 1 or not (std > ROUNDING * np.abs(compliance)).all():
        mean, mean_std, p = float(compliance.mean()), float(std.mean() / np.sqrt(len(own))), 1.0
    else:
        mean, mean_std, p = weighted_mean(compliance, std)
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
                "interval": [finite(x) for x in f.interval],
                "confidence": f.confidence,
                "readings": len(t),
                "loading_against_unloading_p_value": f.p_value,
                "hysteresis_area": f.hysteresis_area,
                "hysteresis_std": f.hysteresis_std,
                "outlier_row": None if f.outlier is None else f.outlier + 1,
            }
            for f, t in zip(result.found, result.source.tests, strict=True)
        ],
        "cautions": list(result.cautions),
    }  # fmt: skip


def write_static(result: StaticResult, folder: Path) -> None:
    """Write `static.json`, and the robot with the stiffnesses where the file names one."""
    write_json(folder / "static.json", as_json(result), indent=1, allow_nan=True)
    if result.robot is not None:
        save_robot(result.robot, folder, allow_inconsistent=True)
