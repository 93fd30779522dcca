"""What ``rx90b-flex camera`` does: markers on the links beside a joint become stiffnesses of its three hinges.

A file (TOML)::

    robot = "rx90b_4dof"             # its links give the moments; the joint's hinges are declared
    joint = "joint_2"
    file = "markers.csv"
    std_mm = [0.02, 0.02, 0.1]       # of a marker's x, y and z in the camera's frame
    markers = 3                      # optional, on each link
    base_rpy_deg = [0.0, 0.0, 90.0]  # optional: the base in the camera's frame; otherwise it is calibrated from the markers
    same_bending = true              # optional: a bearing that is round
    frame_std_rad = 1e-3             # optional: how wrong the joint's frame may be

The table has the drives' angles ``q_<joint>`` (rad; what is left out is zero) and the markers on the links before and behind the
joint in the camera's frame, ``before_1_x`` to ``before_3_z`` and ``behind_1_x`` to ``behind_3_z`` (m; or ``..._x_mm``). Every row is
as noisy as ``std_mm`` says, the first too: the markers' places on their links are fitted along. With a column ``time`` (s, uniform)
the rows are a motion, whose accelerations count; without it every row is a pose at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.export import save_robot
from rx90b_flex.files.results import finite, write_json
from rx90b_flex.files.table import TomlTable
from rx90b_flex.files.toml import named_beside, named_in, read_toml
from rx90b_flex.identify.camera import (
    FRAME_PRIOR,
    BaseCalibration,
    JointFit,
    calibrate_base,
    fit_joint,
    fit_rigid_shape,
    joint_turn,
    link_poses,
    links_beside,
    mean_frames,
)
from rx90b_flex.identify.camera_faults import NAMED, SIDES, check_size, check_turns, loud_rows, outliers
from rx90b_flex.identify.measured_stiffness import HingeStiffness, with_stiffnesses
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals.filters import differentiate
from rx90b_flex.signals.tables import read_table

KEYS = ("robot", "joint", "file", "std_mm", "markers", "base_rpy_deg", "same_bending", "frame_std_rad")
MOST_MARKERS = 100  # on a link
KINDS = ("torsion", "bend_1", "bend_2")
JITTER = 0.01  # of a sample's time


@dataclass(frozen=True, eq=False)
class MarkerRecording:
    """Markers beside a joint, along a motion or in poses at rest.

    Attributes
    ----------
    path : Path
    robot : Robot
    joint : str
    angles : array, shape (N, joints), rad
    markers : array, shape (2, N, m, 3), m
        On the links before and behind, in the camera's frame.
    std : array, shape (3,), m
    rate_hz : float or None
        None: poses at rest.
    base_rotation : array, shape (3, 3), or None
    same_bending : bool
    frame_std : float, rad
    """

    path: Path
    robot: Robot
    joint: str
    angles: Array
    markers: Array
    std: Array
    rate_hz: float | None
    base_rotation: Array | None
    same_bending: bool
    frame_std: float


@dataclass(frozen=True, eq=False, repr=False)
class CameraResult(Showing):
    """Stiffnesses of a joint from markers.

    Attributes
    ----------
    source : MarkerRecording
    fit : JointFit
    moment : array, shape (N, 3), N m
    base : BaseCalibration or None
        Where the base had to be calibrated.
    hinges : tuple of HingeStiffness
    robot : Robot
        With those stiffnesses that are determined.
    cautions : tuple of str
        Rows that stand out.
    """

    source: MarkerRecording
    fit: JointFit
    moment: Array
    base: BaseCalibration | None
    hinges: tuple[HingeStiffness, ...]
    robot: Robot
    cautions: tuple[str, ...]


def read_markers(path: Path) -> MarkerRecording:
    """Read a file of markers and its table.

    Raises
    ------
    ValueError
        One line that names the file and key, column or row.
    """
    table = TomlTable(str(path), "", read_toml(path, "file of markers"))
    table.allow(*KEYS)
    with named_in(path, "robot"):
        robot = load_robot(named_beside(path, table.text("robot")))
    joint = table.text("joint")
    if joint not in robot.joints:
        raise table.problem(
            "joint", f"unknown joint {joint!r} for robot {robot.name}; {close_match(joint, robot.joints)}"
        )
    if any(robot.layout.index(joint, kind) is None for kind in KINDS):
        raise table.problem(
            "joint",
            f"{joint} of {robot.name} has no torsion and bendings; declare drive_flexibility and joint_flexibility there",
        )
    std = 1e-3 * table.numbers("std_mm", 3, "a marker has")
    if not (std > 0.0).all():
        raise table.problem("std_mm", f"found {(1e3 * std).tolist()}, three numbers above 0 are expected")
    count = table.whole("markers", 3, MOST_MARKERS) if table.has("markers") else 3
    frame_std = table.share("frame_std_rad") if table.has("frame_std_rad") else FRAME_PRIOR
    base = None
    if table.has("base_rpy_deg"):
        base = Rotation.from_euler("xyz", table.numbers("base_rpy_deg", 3, "a turn has"), degrees=True).as_matrix()
    same = table.flag("same_bending")
    with named_in(path, "file"):
        angles, markers, rate = _read_table(path.parent / table.text("file"), robot, count)
    return MarkerRecording(path, robot, joint, angles, markers, std, rate, base, same, frame_std)


def _read_table(file: Path, robot: Robot, count: int) -> tuple[Array, Array, float | None]:
    names = [f"{side}_{m}_{axis}" for side in SIDES for m in range(1, count + 1) for axis in "xyz"]
    millimetres = [f"{name}_mm" for name in names]
    angles = [f"q_{joint}" for joint in robot.joints]
    table = read_table(file, [], optional=[*names, *millimetres, *angles, "time"])
    used, scale = (millimetres, 1e-3) if millimetres[0] in table.names else (names, 1.0)
    for name in used:
        if name not in table.names:
            raise ValueError(f"{file}: no column {name!r}; expected {used[0]} to {used[-1]}")
    table.finite(table.names)
    rows = len(table.values)
    drives = np.zeros((rows, len(angles)))
    for i, name in enumerate(angles):
        if name in table.names:
            drives[:, i] = table.columns([name])[:, 0]
    places = scale * table.columns(used).reshape(rows, 2, count, 3).swapaxes(0, 1)
    with named_in(file):
        check_size(robot, places, used is millimetres)
    rate = None
    if "time" in table.names:
        steps = np.diff(table.columns(["time"])[:, 0])
        step = float(np.median(steps))
        if not step > 0.0 or np.abs(steps - step).max() > JITTER * step:
            raise ValueError(
                f"{file}: column 'time': steps of {steps.min():.4g} to {steps.max():.4g} s; expected equal ones"
            )
        rate = 1.0 / step
    return drives, places, rate


def fit_markers(source: MarkerRecording) -> CameraResult:
    """Stiffnesses of the joint's hinges, together with the errors of its frame.

    Raises
    ------
    ValueError
        One line that names the file and why the markers do not tell them.
    """
    loose = outliers(source.markers, source.std)
    with named_in(source.path):
        try:
            return _fitted(source, loose)
        except ValueError as error:
            if not loose:
                raise
            raise ValueError(f"{error}; {loose[0]}") from None


def _fitted(source: MarkerRecording, loose: list[str]) -> CameraResult:
    robot, joint = source.robot, source.joint
    bodies = [fit_rigid_shape(seen, source.std) for seen in source.markers]
    check_turns(robot, joint, source.angles, source.markers, bodies)
    base, rotation, base_std = None, source.base_rotation, 0.0
    if rotation is None:
        _, behind = links_beside(robot, joint)
        poses = link_poses(robot, source.angles @ robot.input_matrix.T, [behind])[behind]
        base = calibrate_base(*poses, source.markers[1], source.std)
        rotation, base_std = base.rotation, float(base.rotation_std.max())
    frames, noise = mean_frames(robot, joint, rotation, source.angles, bodies)
    prior = np.sqrt(source.frame_std**2 + base_std**2 + noise.ravel() ** 2)
    turn = joint_turn(bodies[0], bodies[1], frames[0], frames[1])
    moment = hinge_moments(robot, joint, source.angles, source.rate_hz)
    drive = source.angles[:, robot.joints.index(joint)]
    # the turn is since the reference pose, the drive's angle since its own zero: the frames carry the pose between them
    fit = fit_joint(turn, drive, moment, same_bending=source.same_bending, frame_prior=prior)
    hinges = tuple(
        HingeStiffness(f"{joint}:{kind}", float(k), float(s))
        for kind, k, s in zip(KINDS, fit.stiffness, fit.stiffness_std, strict=True)
    )
    found = with_stiffnesses(robot, {h.coordinate: h.value for h in hinges if h.determined})
    return CameraResult(source, fit, moment, base, hinges, found, _cautions(source, fit, loose))


def _cautions(source: MarkerRecording, fit: JointFit, loose: list[str]) -> tuple[str, ...]:
    """Rows whose markers, or else whose turn, stand out from the others."""
    if loose:
        return tuple(f"{line}; correct the row or take it out" for line in loose)
    return tuple(
        f"row {row + 1}: the turn of {source.joint} stands {np.sqrt(fit.row_chi2[row] / 3.0):.2g} standard deviations off the fit; "
        "look at its angles and markers, or take it out"
        for row in loud_rows(fit.row_chi2, 3)[:NAMED]
    )


def hinge_moments(robot: Robot, joint: str, angles: Array, rate_hz: float | None) -> Array:
    """What weight and motion of the rigid robot load a joint's three hinges with, shape (N, 3), N m.

    Parameters
    ----------
    robot : Robot
    joint : str
    angles : array, shape (N, joints), rad
    rate_hz : float or None
        Of the rows; None: poses at rest, without the friction that holds them.
    """
    drives = angles @ robot.input_matrix.T
    if rate_hz is None:
        v = a = np.zeros_like(drives)
    else:
        v, a = (differentiate(drives, rate_hz, derivative=k) for k in (1, 2))
    hinges = np.stack([robot.layout.port(joint, kind) for kind in KINDS], axis=1)
    return np.asarray(-robot.inverse_dynamics(drives, v, a) @ hinges)


def as_json(result: CameraResult) -> dict[str, Any]:
    """Everything but the samples."""
    fit = result.fit
    return {
        "schema": 1,
        "robot": result.robot.name,
        "joint": result.source.joint,
        "rows": len(result.source.angles),
        "stiffness": [
            {
                "coordinate": h.coordinate,
                "value": h.value if h.determined else None,
                "std": h.even_std if h.determined else None,
                "unit": "N m/rad",
                "interval": [finite(x) for x in h.interval],
                "confidence": 0.95,
            }
            for h in result.hinges
        ],
        "frame_error_rad": {
            side: {"value": list(value), "std": list(std)}
            for side, value, std in zip(SIDES, (fit.before, fit.behind), (fit.before_std, fit.behind_std), strict=True)
        },
        "base_calibrated": result.base is not None,
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "cautions": list(result.cautions),
    }


def write_camera(result: CameraResult, folder: Path) -> None:
    """Write `camera.json` and the robot with the stiffnesses."""
    write_json(folder / "camera.json", as_json(result), indent=1, allow_nan=True)
    save_robot(result.robot, folder, allow_inconsistent=True)
