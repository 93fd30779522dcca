"""What a scene is made of: the shapes of a robot's links, where they are, tubes along paths, labels and colour bars.

Nothing here knows of a browser: `rx90b_flex.view.meshcat` puts these together.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import meshcat.geometry as geometry
import numpy as np
import pinocchio as pin
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from rx90b_flex import flexify as virtual
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot

PLAIN = (0.70, 0.72, 0.75, 1.0)  # of a link whose URDF says no colour
STICK_RADIUS = 0.035  # m, where a robot has no shapes
COLOURS = "plasma"  # rises in lightness, so that it reads on paper and by colour-blind eyes; its yellow end is left out
BRIGHTEST = 0.92
_CYLINDER_TO_Z = pin.utils.rpyToMatrix(0.5 * np.pi, 0.0, 0.0)  # meshcat's cylinders lie along y, URDF's along z


class Plane(geometry.Geometry):  # type: ignore[misc, unused-ignore]
    """A rectangle in its x and y, which meshcat's page knows and its Python side does not."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__()
        self.width, self.height = width, height

    def lower(self, object_data: Any) -> dict[str, Any]:
        """As three.js reads it."""
        return {"uuid": self.uuid, "type": "PlaneGeometry", "width": self.width, "height": self.height}


@dataclass(frozen=True, eq=False)
class Shape:
    """One piece of a link.

    Attributes
    ----------
    link : str
    geometry : of meshcat.
    placement : array, shape (4, 4)
        In the link's frame, m.
    colour : red, green, blue, opacity, each 0 to 1.
    """

    link: str
    geometry: Any
    placement: Array
    colour: tuple[float, float, float, float]


def shapes(robot: Robot) -> tuple[Shape, ...]:
    """The visual shapes of the robot's URDF; sticks between its joints where it has none or its meshes are not found."""
    urdf = virtual.read_xml(robot.urdf)
    named = {m.name: m for m in getattr(urdf.robot, "materials", ()) if m.color is not None}
    found = []
    for link in urdf.robot.links:
        for visual in link.visuals:
            made = _geometry(visual.geometry)
            if made is None:
                return _sticks(robot)  # half a robot would mislead
            placement = np.eye(4) if visual.origin is None else np.array(visual.origin, dtype=float)
            if isinstance(made, geometry.Cylinder):
                placement[:3, :3] = placement[:3, :3] @ _CYLINDER_TO_Z
            material = visual.material
            if material is not None and material.color is None:
                material = named.get(material.name, material)
            plain = material is None or material.color is None
            red, green, blue, opacity = PLAIN if plain else map(float, material.color.rgba)
            found.append(Shape(link.name, made, placement, (red, green, blue, opacity)))
    return tuple(found) if found else _sticks(robot)


def _geometry(given: Any) -> Any:
    if given.box is not None:
        return geometry.Box(list(map(float, given.box.size)))
    if given.cylinder is not None:
        return geometry.Cylinder(float(given.cylinder.length), float(given.cylinder.radius))
    if given.sphere is not None:
        return geometry.Sphere(float(given.sphere.radius))
    return _mesh(given.mesh)


def _mesh(given: Any) -> Any:
    """Triangles of a mesh file, or None where it cannot be found or read."""
    import trimesh

    path = _mesh_path(given.filename)
    if path is None:
        return None
    try:
        mesh: Any = trimesh.load(path, force="mesh")
    except (ValueError, OSError, ImportError):
        return None
    scale = 1.0 if given.scale is None else np.asarray(given.scale, dtype=float)
    return geometry.TriangularMeshGeometry(np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces))


def _mesh_path(name: str) -> Path | None:
    """Where a mesh lies: as the name says, or among the robots of example-robot-data."""
    if name.startswith("package://example-robot-data/"):
        from example_robot_data.robots_loader import getModelPath

        inside = name.removeprefix("package://example-robot-data/robots/")
        try:
            return Path(getModelPath(inside), inside)
        except OSError:
            return None
    path = Path(name.removeprefix("file://"))
    return path if path.is_file() else None


def _sticks(robot: Robot) -> tuple[Shape, ...]:
    """A ball at every joint and a stick to each joint behind it, and to the tip."""
    tree = robot.tree
    # the first of each
    bodies = {f.parentJoint: f.name for f in reversed(list(tree.frames)) if f.type == pin.FrameType.BODY}
    names = {j: bodies.get(j, "universe") for j in range(tree.njoints)}
    ends = [(int(tree.parents[j]), tree.jointPlacements[j].translation) for j in range(1, tree.njoints)]
    tip = tree.frames[tree.getFrameId(robot.tip_frame)]
    ends.append((int(tip.parentJoint), tip.placement.translation))
    found = [
        Shape(names[j], geometry.Sphere(1.4 * STICK_RADIUS), np.eye(4), (0.25, 0.26, 0.28, 1.0))
        for j in range(1, tree.njoints)
    ]
    for joint, end in ends:
        length = float(np.linalg.norm(end))
        if length > 1e-6:
            stick = geometry.Cylinder(length, STICK_RADIUS)
            found.append(Shape(names[joint], stick, _along(end), (0.95, 0.78, 0.2, 1)))
    # body frames may lie apart from their joint: sticks are told in the joint's frame
    frames = {name: tree.frames[tree.getFrameId(name)].placement.inverse().homogeneous for name in names.values()}
    return tuple(Shape(s.link, s.geometry, frames[s.link] @ s.placement, s.colour) for s in found)


def _along(end: Array) -> Array:
    """Placement of a cylinder from the origin to `end`."""
    placement = np.eye(4)
    y = end / np.linalg.norm(end)
    x = np.cross(y, np.eye(3)[np.argmin(np.abs(y))])
    x /= np.linalg.norm(x)
    placement[:3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
    placement[:3, 3] = 0.5 * end
    return placement


# ---- where the links are --------------------------------------------------------------------------------------


def frame_poses(model: pin.Model, q: Array, frames: Sequence[str]) -> Array:
    """Poses of named frames, shape (N, frames, 4, 4), in the base frame.

    Parameters
    ----------
    q : array, shape (N, n)
    """
    data, places = model.createData(), [model.getFrameId(name) for name in frames]
    out = np.empty((len(q), len(frames), 4, 4))
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        out[k] = [data.oMf[place].homogeneous for place in places]
    return out


def magnified(robot: Robot, q: Array, factor: float) -> Array:
    """Coordinates with torsion and bending multiplied by a factor, drives as they are; shape as q."""
    drives = robot.input_matrix.any(axis=1)
    return np.where(drives, q, factor * q)


# ---- paths, colours, words ------------------------------------------------------------------------------------


def tube(path: Array, radius: float, colours: Array, sides: int = 8) -> Any:
    """A tube along a path with a colour a point.

    Parameters
    ----------
    path : array, shape (N, 3), m
        Two points or more; points that repeat are left out.
    colours : array, shape (N, 3)
    """
    moved = np.r_[True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-5]
    if moved.sum() < 2:  # it stands still: a short piece, so that there is something to see
        path = np.stack([path[0] - [0, 0, 0.5 * radius], path[0] + [0, 0, 0.5 * radius]])
        colours = np.repeat(colours[:1], 2, axis=0)
    else:
        path, colours = path[moved], colours[moved]
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    across = np.empty_like(path)
    last = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for k, t in enumerate(tangent):  # carried along, so that the tube does not twist
        last = last - (last @ t) * t
        last /= max(float(np.linalg.norm(last)), 1e-12)
        across[k] = last
    other = np.cross(tangent, across)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = across[:, None] * np.cos(angle)[:, None] + other[:, None] * np.sin(angle)[:, None]
    vertices = (path[:, None] + radius * ring).reshape(-1, 3)
    rows, columns = np.arange(len(path) - 1)[:, None] * sides, np.arange(sides)
    beside = (columns + 1) % sides
    a, b = rows + columns, rows + beside
    faces = np.stack([a, b, a + sides, b, b + sides, a + sides], axis=-1).reshape(-1, 3)
    return geometry.TriangularMeshGeometry(vertices, faces, np.repeat(colours, sides, axis=0))


def colours_of(values: Array, largest: float) -> Array:
    """Red, green, blue of values between 0 and `largest`, shape (N, 3)."""
    return np.asarray(matplotlib.colormaps[COLOURS](BRIGHTEST * Normalize(0.0, largest, clip=True)(values))[:, :3])


def colour_bar(largest: float, title: str) -> bytes:
    """A colour bar from 0 to `largest`, as PNG."""
    from matplotlib.colorbar import ColorbarBase
    from matplotlib.colors import ListedColormap

    figure = Figure(figsize=(3.2, 0.72), facecolor="white")
    ax = figure.add_axes((0.06, 0.42, 0.88, 0.22))
    shades = ListedColormap(matplotlib.colormaps[COLOURS](np.linspace(0.0, BRIGHTEST, 256)))
    bar = ColorbarBase(ax, cmap=shades, norm=Normalize(0.0, largest), orientation="horizontal")
    bar.ax.tick_params(labelsize=8)
    ax.set_title(title, fontsize=9, pad=4)
    return _png(figure, 160)


def label(text: str, size: float = 15.0) -> tuple[bytes, float]:
    """Words as PNG with a clear ground, and their width over their height."""
    lines = text.splitlines()
    width, height = 0.011 * size * max(map(len, lines)) + 0.1, 0.019 * size * len(lines) + 0.1
    figure = Figure(figsize=(width, height))
    figure.patch.set_alpha(0.0)
    figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=size, linespacing=1.15, color="#222222")
    return _png(figure, 150), width / height


def _png(figure: Figure, dpi: int) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
