"""Path files, and the curve that a path's points make.

A path file (TOML) has

    points = [[x, y, z], ...]      in the robot's base frame; or points_file = "points.csv", relative to this file
    unit = "m"                     or "mm", of points
    speed_mm_s = 50.0              along the path
    acceleration = 1.0             m/s^2, the largest along the path, and across it on a blend
    corner = "stop"                or "blend": an arc that leaves each corner's sides blend_mm before it
    blend_mm = 5.0
    orientation = "free"           only the tip's place matters, three joints carry it; "keep": that of the start;
                                   or rpy_deg = [[r, p, y], ...] or quaternion_xyzw = [[x, y, z, w], ...], one a point or one for all
    start_deg = [0, 40, 80, 0]     joint angles near the start, where the robot can reach it in several ways
    robot = "rx90b_4dof"           whose path it is, where the command does not say; a file is relative to this file

Only points and speed_mm_s are needed. A table of points (CSV) has columns x, y, z (m) or x_mm, y_mm, z_mm, and may have roll_deg,
pitch_deg, yaw_deg or qx, qy, qz, qw. It is a path file of its own where the speed is given with the command.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.files.table import TomlTable
from rx90b_flex.files.toml import named_beside, named_in, read_toml
from rx90b_flex.signals.tables import read_table
from rx90b_flex.simulate.trajectories import LINE_DISTANCE, LINE_HEIGHT, LINE_LENGTH

Corner = Literal["stop", "blend"]
Orientation = Literal["free", "keep", "given"]

KEYS = (
    "points", "points_file", "unit", "speed_mm_s", "acceleration", "corner", "blend_mm", "orientation", "rpy_deg", "quaternion_xyzw",
    "start_deg", "robot",
)  # fmt: skip
ACCELERATION = 1.0  # m/s^2; choice: 50 mm/s is reached in 94 ms and 2.3 mm
FARTHEST = 100.0  # m, of a point
LONGEST_S = 3600.0  # of a path
ROBOT = "rx90b"  # whose path it is where neither the path file nor the caller says
STRAIGHT = 1e-6  # rad; a corner that turns less is none
RAMP_PEAK = 1.875  # of a ramp's acceleration, over its mean

EXAMPLES = {
    "line": f"""\
# The horizontal line of figure 4.6 of the source: {LINE_LENGTH} m across the robot's front, {LINE_DISTANCE} m from its axis.
unit = "m"
points = [[{LINE_DISTANCE}, {-0.5 * LINE_LENGTH}, {LINE_HEIGHT}], [{LINE_DISTANCE}, {0.5 * LINE_LENGTH}, {LINE_HEIGHT}]]
speed_mm_s = 50.0
acceleration = {ACCELERATION}   # m/s^2
orientation = "free"   # the tip's place alone matters
start_deg = [-67.6, 34.4, 68.8]
""",
    "square": f"""\
# A horizontal square of 200 mm in front of the robot; the tip stops at each corner.
unit = "mm"
points = [[500, -100, 350], [700, -100, 350], [700, 100, 350], [500, 100, 350], [500, -100, 350]]
speed_mm_s = 50.0
acceleration = {ACCELERATION}   # m/s^2
corner = "stop"        # or "blend", with blend_mm = 5
orientation = "free"   # or "keep", or rpy_deg = [[180, 0, 0]]
start_deg = [-11.3, 34.4, 68.8]
""",
}


@dataclass(frozen=True, eq=False)
class Pieces:
    """Straight lines and circular arcs, end to end.

    Attributes
    ----------
    start : array, shape (K,), m
        Distance along the path at which each begins.
    length : array, shape (K,), m
    place, direction, inward : array, shape (K, 3)
        Where each begins, its direction there, and the direction to an arc's centre.
    curvature : array, shape (K,), 1/m
    run : array, shape (K,)
        Pieces of one run follow each other without a stop.
    """

    start: Array
    length: Array
    place: Array
    direction: Array
    inward: Array
    curvature: Array
    run: NDArray[np.int64]

    @property
    def total(self) -> float:
        """Length of the path, m."""
        return float(self.start[-1] + self.length[-1])

    def at(self, distance: Array) -> tuple[Array, Array]:
        """Points (m) and unit tangents at distances along the path, each (N, 3)."""
        s = np.asarray(distance, dtype=float)
        k = np.clip(np.searchsorted(self.start, s, side="right") - 1, 0, len(self.start) - 1)
        on, turn = (s - self.start[k])[:, None], self.curvature[k, None] * (s - self.start[k])[:, None]
        # sin(c s)/c and (1 - cos(c s))/c, which are s and 0 on a line
        ahead, aside = on * np.sinc(turn / np.pi), 0.5 * on * turn * np.sinc(0.5 * turn / np.pi) ** 2
        point = self.place[k] + ahead * self.direction[k] + aside * self.inward[k]
        return point, np.cos(turn) * self.direction[k] + np.sin(turn) * self.inward[k]


@dataclass(frozen=True, eq=False)
class Seam:
    """A path and how it is to be followed.

    Attributes
    ----------
    name : str
    points : array, shape (K, 3), m
        In the robot's base frame.
    speed : float, m/s
    acceleration : float, m/s^2
        Largest along the path, and towards an arc's centre.
    corner : str
        ``stop`` or ``blend``.
    blend : float, m
        From a corner to where the arc leaves its sides.
    orientation : str
        ``free``, ``keep`` or ``given``.
    rotations : array, shape (K, 3, 3), or None
        Tip frame at the points, where given; between them it turns evenly about one axis.
    start : array, shape (joints or fewer,), or None
        Angles near the start, rad.
    robot : str or None
    """

    name: str
    points: Array
    speed: float
    acceleration: float = ACCELERATION
    corner: Corner = "stop"
    blend: float = 0.0
    orientation: Orientation = "free"
    rotations: Array | None = None
    start: Array | None = None
    robot: str | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
            raise ValueError(f"{self.name}: points have shape {points.shape}; expected two or more of x, y, z")
        object.__setattr__(self, "points", points)
        for name, value in (("speed", self.speed), ("acceleration", self.acceleration)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{self.name}: {name} is {value:g}; expected more than 0")
        sides = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if np.abs(points).max() > FARTHEST:
            raise ValueError(
                f"{self.name}: a point is {np.abs(points).max():.3g} m away; expected metres, {FARTHEST:g} at most"
            )
        if sides.sum() > LONGEST_S * self.speed or self.speed > LONGEST_S * self.acceleration:
            raise ValueError(
                f"{self.name}: at {1e3 * self.speed:.3g} mm/s and {self.acceleration:.3g} m/s^2 it takes more than {LONGEST_S:g} s; "
                "expected a faster motion"
            )
        if (sides < 1e-6).any():
            k = int(np.argmin(sides))
            raise ValueError(f"{self.name}: points {k + 1} and {k + 2} are the same; expected a path between them")
        shape = None if self.rotations is None else np.shape(self.rotations)
        if shape != ((len(points), 3, 3) if self.orientation == "given" else None):
            raise ValueError(
                f"{self.name}: orientation is {self.orientation!r} and rotations have shape {shape}; expected one matrix a point "
                "where orientation is 'given', else none"
            )
        if self.corner == "blend" and not self.blend > 0.0:
            raise ValueError(
                f"{self.name}: corner is 'blend' and blend_mm is {1e3 * self.blend:g}; expected more than 0"
            )

    @cached_property
    def pieces(self) -> Pieces:
        """The curve.

        Raises
        ------
        ValueError
            A blend that does not fit between two corners, or a corner that turns back.
        """
        length, along, turn, cut = self._sides()
        self._refuse_blends(turn, cut, length)
        before, after = np.append(0.0, cut), np.append(cut, 0.0)
        rows: list[tuple[float, Array, Array, Array, float, int]] = []
        run = 0
        for k, straight in enumerate(length - before - after):
            begin = self.points[k] + before[k] * along[k]
            rows.append((float(straight), begin, along[k], np.zeros(3), 0.0, run))
            if k == len(turn):
                break
            if cut[k] > 0.0:
                radius = cut[k] / math.tan(0.5 * turn[k])
                inward = along[k + 1] - (along[k + 1] @ along[k]) * along[k]
                inward = inward / np.linalg.norm(inward)
                rows.append((radius * turn[k], begin + straight * along[k], along[k], inward, 1.0 / radius, run))
            elif turn[k] > STRAIGHT:
                run += 1
        kept = [row for row in rows if row[0] > 1e-12]
        lengths, places, directions, inwards, curvatures, runs = (np.array(x) for x in zip(*kept, strict=True))
        starts = np.append(0.0, np.cumsum(lengths)[:-1])
        return Pieces(starts, lengths, places, directions, inwards, curvatures, runs)

    def _sides(self) -> tuple[Array, Array, Array, Array]:
        """Lengths and directions of the sides; turn (rad) and cut (m, from corner to arc) of the corners between them."""
        sides = np.diff(self.points, axis=0)
        length = np.linalg.norm(sides, axis=1)
        along = sides / length[:, None]
        turn = np.array([_angle(a, b) for a, b in itertools.pairwise(along)])
        return length, along, turn, np.where(turn > STRAIGHT, self.blend if self.corner == "blend" else 0.0, 0.0)

    def _refuse_blends(self, turn: Array, cut: Array, length: Array) -> None:
        if self.corner != "blend":
            return
        for k, angle in enumerate(turn):
            where = f"{self.name}: the corner at point {k + 2} ({self._corner_mm(k):.0f} mm along)"
            if angle > np.pi - 0.02:
                raise ValueError(
                    f"{where} turns back; a blend needs less than 180 degrees, corner = 'stop' can turn back"
                )
            room = min(length[k] - (cut[k - 1] if k else 0.0), length[k + 1])
            if cut[k] > room + 1e-12:
                raise ValueError(
                    f"{where}: blend_mm is {1e3 * cut[k]:g}, but {1e3 * room:.4g} mm are left on its sides"
                )
            if cut[k] > 0.0:
                pull = self.speed**2 * math.tan(0.5 * angle) / cut[k]
                if pull > self.acceleration * (1.0 + 1e-9):
                    raise ValueError(
                        f"{where} is taken too fast: {1e3 * self.speed:g} mm/s on its arc is {pull:.3g} m/s^2 to the centre, over "
                        f"{self.acceleration:g}; expected blend_mm of {1e3 * cut[k] * pull / self.acceleration:.3g} or more"
                    )

    def _corner_mm(self, k: int) -> float:
        return 1e3 * float(np.linalg.norm(np.diff(self.points[: k + 2], axis=0), axis=1).sum())

    def corner_distances(self) -> Array:
        """Distance along the curve at each point (on a blend: the middle of its arc), shape (K,), m."""
        length, _, turn, cut = self._sides()
        arc = cut * turn / np.tan(0.5 * np.where(turn > STRAIGHT, turn, 1.0))
        ends = np.cumsum(length - np.append(0.0, cut) - np.append(cut, 0.0)) + np.append(0.0, np.cumsum(arc))
        return np.concatenate([[0.0], ends[:-1] + 0.5 * arc, ends[-1:]])

    def frames(self, distance: Array) -> Array | None:
        """Tip frame at distances along the path, shape (N, 3, 3), where the path gives it."""
        if self.rotations is None:
            return None
        from scipy.spatial.transform import Rotation, Slerp

        at = Slerp(self.corner_distances(), Rotation.from_matrix(self.rotations))
        return np.asarray(at(np.clip(distance, 0.0, self.pieces.total)).as_matrix())

    def motion(self, time: Array) -> Array:
        """Distance along the path (m), shape (N,), from rest at time 0 to rest at `duration_s`.

        Each run speeds up and slows down by a fifth-order polynomial of time in its speed, whose peak is `acceleration`; one
        too short for that reaches less than the speed.
        """
        t = np.asarray(time, dtype=float)
        out = np.zeros_like(t)
        for begin, length in self.runs:
            speed, ramp, whole = self._law(length)
            on = np.clip(t, 0.0, whole)
            early, late = (speed * ramp * _ramp(np.minimum(x / ramp, 1.0)) for x in (on, whole - on))
            middle = speed * (on - 0.5 * ramp)
            s = np.where(on < ramp, early, np.where(on > whole - ramp, length - late, middle))
            out = np.where(t > 0.0, begin + s, out)
            t = t - whole
        return out

    @cached_property
    def runs(self) -> tuple[tuple[float, float], ...]:
        """Where each run between two stops begins, and its length, m."""
        pieces = self.pieces
        return tuple(
            (float(pieces.start[pieces.run == r][0]), float(pieces.length[pieces.run == r].sum()))
            for r in range(int(pieces.run[-1]) + 1)
        )

    def _law(self, length: float) -> tuple[float, float, float]:
        """Speed that a run reaches, duration of either ramp, and of the run."""
        speed = min(self.speed, math.sqrt(self.acceleration * length / RAMP_PEAK))
        ramp = RAMP_PEAK * speed / self.acceleration
        return speed, ramp, length / speed + ramp

    @property
    def duration_s(self) -> float:
        """Of the whole path."""
        return sum(self._law(length)[2] for _, length in self.runs)

    def notes(self) -> list[str]:
        """What the planned path does that its points and speed do not say."""
        out = []
        slow = [self._law(length)[0] for _, length in self.runs if self._law(length)[0] < self.speed * (1.0 - 1e-9)]
        if slow:
            out.append(
                f"{len(slow)} of {len(self.runs)} runs between stops are too short for {1e3 * self.speed:g} mm/s at "
                f"{self.acceleration:g} m/s^2; the shortest reaches {1e3 * min(slow):.3g} mm/s."
            )
        arcs = self.pieces.curvature > 0.0
        if arcs.any():
            curvature, angle = self.pieces.curvature[arcs], (self.pieces.curvature * self.pieces.length)[arcs]
            leaves = (1.0 / np.cos(0.5 * angle) - 1.0) / curvature
            out.append(
                f"Blends pass their corners at up to {1e3 * leaves.max():.3g} mm; deviations are counted from the blended path."
            )
        return out


def _angle(a: Array, b: Array) -> float:
    return float(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


def _ramp(x: Array) -> Array:
    """Integral of 10 x^3 - 15 x^4 + 6 x^5, the speed of a ramp."""
    return x**4 * (2.5 - 3.0 * x + x * x)


# ---- files ------------------------------------------------------------------------------------------------------


def load_seam(source: str | Path, speed_mm_s: float | None = None) -> Seam:
    """Read a path file, or one of the `EXAMPLES` by name.

    Parameters
    ----------
    source : str or Path
    speed_mm_s : float, optional
        Instead of the file's.

    Raises
    ------
    ValueError
        One line that names the file and the key or column.
    """
    path = Path(source)
    if speed_mm_s is not None and not speed_mm_s > 0.0:
        raise ValueError(f"speed_mm_s is {speed_mm_s:g}; expected more than 0")
    if str(source) in EXAMPLES and not path.exists():
        return _seam(TomlTable(str(path), "", tomllib.loads(EXAMPLES[str(source)])), path, speed_mm_s)
    if path.suffix == ".toml":
        return _seam(TomlTable(str(path), "", read_toml(path, "path file")), path, speed_mm_s)
    if path.suffix == ".csv":
        if speed_mm_s is None:
            raise ValueError(f"{path}: a table of points has no speed; give it with the command")
        return _seam(TomlTable(str(path), "", {"points_file": path.name}), path, speed_mm_s)
    raise ValueError(f"{path}: expected a path file (.toml), a table of points (.csv), or one of {', '.join(EXAMPLES)}")


def _seam(table: TomlTable, path: Path, speed_mm_s: float | None) -> Seam:
    table.allow(*KEYS)
    points, rotations = _points(table, path)
    speed = table.positive("speed_mm_s") if speed_mm_s is None else speed_mm_s
    orientation = table.one_of("orientation", ("free", "keep"))
    given = [key for key in ("orientation", "rpy_deg", "quaternion_xyzw") if table.has(key)]
    if len(given) + (rotations is not None and bool(given) and given[-1] == "orientation") > 1:
        raise table.problem(" and ".join(given), "choose one way to give the orientation")
    try:
        return Seam(
            name=path.stem,
            points=points,
            speed=1e-3 * speed,
            acceleration=table.positive("acceleration") if table.has("acceleration") else ACCELERATION,
            corner=table.one_of("corner", ("stop", "blend")),  # type: ignore[arg-type]
            blend=1e-3 * table.not_negative("blend_mm") if table.has("blend_mm") else 0.0,
            orientation=orientation if rotations is None else "given",  # type: ignore[arg-type]
            rotations=rotations,
            start=np.deg2rad(table.numbers("start_deg")) if table.has("start_deg") else None,
            robot=str(named_beside(path, table.text("robot"))) if table.has("robot") else None,
        )
    except ValueError as error:
        text = str(error)
        raise ValueError(
            text if text.startswith(str(path)) else f"{path}: {text.removeprefix(f'{path.stem}: ')}"
        ) from None


def _points(table: TomlTable, path: Path) -> tuple[Array, Array | None]:
    """Points, m, and tip frames at them."""
    if table.has("points") == table.has("points_file"):
        raise table.problem("points", "one of the keys 'points' and 'points_file' is expected")
    if table.has("points_file"):
        with named_in(path, "points_file"):
            points, rotations = _read_points(path.parent / table.text("points_file"))
    else:
        points, rotations = table.rows("points", 3) * {"m": 1.0, "mm": 1e-3}[table.one_of("unit", ("m", "mm"))], None
    for key, width in (("rpy_deg", 3), ("quaternion_xyzw", 4)):
        if not table.has(key):
            continue
        rows = table.rows(key, width, one=True)
        if len(rows) not in (1, len(points)):
            raise table.problem(key, f"has {len(rows)} rows; expected 1 or {len(points)}, one a point")
        rotations = _rotations(np.broadcast_to(rows, (len(points), width)), f"{path}: {key}")
    return points, rotations


def _read_points(file: Path) -> tuple[Array, Array | None]:
    sets = {name: (*(f"{c}{name}" for c in "xyz"),) for name in ("", "_mm")}
    angles = ("roll_deg", "pitch_deg", "yaw_deg"), ("qx", "qy", "qz", "qw")
    table = read_table(file, [], [*sets[""], *sets["_mm"], *angles[0], *angles[1]])
    found = [name for name, columns in sets.items() if set(columns) <= set(table.names)]
    if len(found) != 1:
        raise ValueError(f"{file}: expected columns x, y, z (m) or x_mm, y_mm, z_mm")
    turned = [columns for columns in angles if set(columns) <= set(table.names)]
    values = table.finite([*sets[found[0]], *(turned[0] if turned else ())])
    rotations = _rotations(values[:, 3:], str(file)) if turned else None
    return values[:, :3] * (1e-3 if found[0] else 1.0), rotations


def _rotations(rows: Array, where: str) -> Array:
    from scipy.spatial.transform import Rotation

    if rows.shape[1] == 3:
        return np.asarray(Rotation.from_euler("xyz", rows, degrees=True).as_matrix())
    if (np.abs(np.linalg.norm(rows, axis=1) - 1.0) > 1e-3).any():
        raise ValueError(f"{where}: a quaternion has length other than 1")
    return np.asarray(Rotation.from_quat(rows).as_matrix())
