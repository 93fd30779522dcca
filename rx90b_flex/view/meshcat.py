"""The moving robot in a browser, a notebook cell or one HTML file that needs no network.

A `View` is a finished scene: `show` makes it of a run, `compare` of two runs side by side, `show_modes` of a robot's mode
shapes. It is then saved, opened or put in a cell.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import markupsafe
import meshcat
import meshcat.geometry as geometry
import numpy as np
import pinocchio as pin
import umsgpack  # type: ignore[import-untyped, unused-ignore]
from meshcat.animation import Animation, AnimationClip, AnimationTrack
from meshcat.servers.zmqserver import VIEWER_ROOT
from scipy.spatial.transform import Rotation

from rx90b_flex.effects.motion import Array
from rx90b_flex.linearize import ComplexArray, Modes
from rx90b_flex.robot import Robot
from rx90b_flex.signals.recording import Recording
from rx90b_flex.signals.single import write_file
from rx90b_flex.simulate.closed_loop import Simulation, tip_poses
from rx90b_flex.tip import jacobian_at
from rx90b_flex.view import scene
from rx90b_flex.view.page import template
from rx90b_flex.view.server import start_server

MAGNIFY = 100.0
LARGEST_FRAMES = 800  # of an animation; longer runs take fewer a second
FASTEST_FPS = 100.0
TRAIL_POINTS = 1500
TRAIL_RADIUS = 0.007  # m
GHOST_OPACITY = 0.28
GHOST_COLOUR = (0.35, 0.45, 0.60)
MODE_TIP = 0.10  # m, how far a mode shape moves the tip at most
MODE_ANGLE = 0.30  # rad, and how far it turns a coordinate
SLOWEST_MODE_HZ = 0.5  # on the screen; the others keep their ratio to it
MODE_SECONDS, MODE_FPS = 10.0, 40.0
FOREVER = 1_000_000
THICKNESS = 0.15  # m, of links about their frames, for the scene to fit
FIELD_OF_VIEW = 35.0  # degrees, of the camera, upright
ASPECT = 1.5  # of a page, for which the scene is made to fit


@dataclass(frozen=True, eq=False)
class Run:
    """A motion of a robot to be seen.

    Attributes
    ----------
    name : str
    robot : Robot
    time : array, shape (N,), s
        Uniform.
    q : array, shape (N, n)
        Coordinates of the robot.
    reference : array, shape (N, joints), or None
        Reference positions, rad.
    """

    name: str
    robot: Robot
    time: Array
    q: Array
    reference: Array | None = None

    @classmethod
    def of(cls, source: Simulation | Run) -> Run:
        """The motion of a simulation; a run is returned as it is."""
        if isinstance(source, Run):
            return source
        recording = source.recording
        return cls(recording.name, source.robot, source.time, source.q, recording.reference_position)

    @classmethod
    def of_recording(cls, recording: Recording, robot: Robot) -> Run:
        """A measured motion: the drives as measured; the torsion too, where the link's angle was.

        Raises
        ------
        ValueError
            A recording of other joints than the robot's.
        """
        if set(recording.joints) != set(robot.joints):
            raise ValueError(
                f"recording {recording.name!r} is of joints {', '.join(recording.joints)}; expected {', '.join(robot.joints)}"
            )
        order = [recording.joints.index(joint) for joint in robot.joints]
        drives = recording.position[:, order]
        q = drives @ robot.input_matrix.T
        if recording.link_position is not None:
            for place, joint in enumerate(robot.joints):
                torsion = robot.layout.index(joint, "torsion")
                if torsion is not None:
                    q[:, torsion] = recording.link_position[:, order[place]] - drives[:, place]
        reference = recording.reference_position
        return cls(recording.name, robot, recording.time, q, None if reference is None else reference[:, order])

    @property
    def deforms(self) -> bool:
        """Whether anything but the drives moves."""
        return bool(self.q[:, ~self.robot.input_matrix.any(axis=1)].any())

    @cached_property
    def reference_path(self) -> Array | None:
        """Positions of the rigid robot's tip at the references, shape (N, 3), m; None without references."""
        if self.reference is None:
            return None
        return tip_poses(self.robot.tree, self.robot.tip_frame, self.reference)[:, :3, 3]

    @cached_property
    def tip_path(self) -> Array:
        """Positions of the tip, not magnified, shape (N, 3), m."""
        return tip_poses(self.robot.model, self.robot.tip_frame, self.q)[:, :3, 3]

    @cached_property
    def deviation_mm(self) -> Array | None:
        """Distance of the tip from its reference, not magnified, shape (N,), mm."""
        if self.reference_path is None:
            return None
        return 1e3 * np.linalg.norm(self.tip_path - self.reference_path, axis=1)


# the camera starts before the robot, to its right and above: three unit vectors in the base frame
TO_CAMERA = np.array([1.0, -0.5, 0.45]) / np.linalg.norm([1.0, -0.5, 0.45])
RIGHT = np.array([0.5, 1.0, 0.0]) / np.linalg.norm([0.5, 1.0])
UP = np.cross(TO_CAMERA, RIGHT)


# ---- what is shown --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class View:
    """A scene, ready to be seen.

    Attributes
    ----------
    title : str
    notes : tuple of str
        What the scene shows, a line each.
    commands : tuple
        Commands of meshcat, packed, in order, the animation last.
    legend : bytes or None
        Colour bar in millimetres, PNG.
    """

    title: str
    notes: tuple[str, ...]
    commands: tuple[_ViewerCommand, ...] = field(repr=False)  # megabytes
    legend: bytes | None = field(default=None, repr=False)

    def html(self) -> str:
        """The scene as one HTML page that asks for nothing from outside: robot, controls, legend."""
        library = Path(VIEWER_ROOT, "main.min.js").read_text(encoding="utf-8")
        kept = [base64.b64encode(c.packed).decode("ascii") for c in self.commands if not c.live_only]
        bar = None if self.legend is None else "data:image/png;base64," + base64.b64encode(self.legend).decode("ascii")
        return template("view.html").render(
            title=self.title,
            notes=self.notes,
            legend=bar,
            # a closing tag inside a string of the script would end the script
            library=markupsafe.Markup(library.replace("</script", "<\\/script")),
            commands=markupsafe.Markup(json.dumps(kept)),
        )

    def save_html(self, path: str | os.PathLike[str]) -> Path:
        """Write `html` to a file; it appears whole or not at all."""
        path = Path(path)
        text = self.html()
        write_file(path, text)
        return path

    def serve(self) -> meshcat.Visualizer:
        """Start meshcat's server with this scene, for this machine alone; it ends with this process.

        `.url()` of what is returned is its page.
        """
        process, address = start_server()
        with contextlib.redirect_stdout(io.StringIO()):  # it prints its address; whoever calls decides on that
            visualizer = meshcat.Visualizer(zmq_url=address)
        visualizer.window.server_proc = process
        for command in self.commands:
            window = visualizer.window
            window.zmq_socket.send_multipart([command.kind.encode(), command.path.encode(), command.packed])
            window.zmq_socket.recv()
        return visualizer

    def open(self) -> meshcat.Visualizer:
        """Serve the scene and open it in the browser; the scene can still be changed through what is returned."""
        visualizer = self.serve()
        webbrowser.open(visualizer.url(), new=2)
        return visualizer

    def cell(self, height: int = 500) -> Any:
        """The served scene in a notebook cell whose kernel runs on the same machine."""
        return self.serve().jupyter_cell(height=height)

    def _repr_html_(self) -> str:
        """In a notebook, without a server: the cell holds the whole page, and so does the notebook's file."""
        page = markupsafe.escape(self.html())
        return f'<iframe srcdoc="{page}" style="width: 100%; height: 500px; border: none"></iframe>'


def show(source: Simulation | Run, *, magnify: float = MAGNIFY) -> View:
    """The moving robot with its deformations magnified, the undeformed robot as a ghost, tip and reference path.

    The trail along the tip's path is coloured by the tip's true distance from its reference, in millimetres. The robot, and so
    the place of the trail, is drawn with torsion and bending times `magnify`; the ghost has the same drive angles
    and no deformation.

    Parameters
    ----------
    source : Simulation or Run
    magnify : float
        0 or more.
    """
    run = Run.of(source)
    builder = _Builder()
    largest = _largest_mm([run])
    builder.look_at(_reach(run, magnify))
    duration = _duration([run])
    builder.add_run("run", run, magnify, largest, np.zeros(3), duration)
    builder.legend(largest)
    notes = [*_peak_note(f"{duration:.3g} s", run), *_magnify_note([run], magnify)]
    factor = f", deformations × {magnify:g}" if run.deforms else ""
    return builder.view(f"{run.name}{factor}", notes, largest)


def compare(before: Simulation | Run, after: Simulation | Run, *, magnify: float = MAGNIFY) -> View:
    """Two runs side by side with one colour scale: before an effect was added (or a controller changed) and after.

    Parameters
    ----------
    before, after : Simulation or Run
    magnify : float
        0 or more.
    """
    runs = (Run.of(before), Run.of(after))
    builder = _Builder()
    largest = _largest_mm(runs)
    points = np.concatenate([_reach(run, magnify) for run in runs])
    patch = _Patch.of(points)
    shift = 0.5 * (patch.width + 0.1) * RIGHT
    above = patch.top + 0.25 * UP
    builder.hide("Axes")
    builder.look_at(np.concatenate([points - shift, points + shift, [above]]))
    for name, run, at in (("before", runs[0], -shift), ("after", runs[1], shift)):
        builder.add_run(name, run, magnify, largest, at, _duration(runs))
        peak = "" if run.deviation_mm is None else f"\nat most {run.deviation_mm.max():.3g} mm"
        builder.label(name, f"{name}: {run.name}{peak}", above + at, patch.width)
    builder.legend(largest)
    notes = [line for name, run in zip(("Before", "After"), runs, strict=True) for line in _peak_note(name, run)]
    return builder.view("Before and after", [*notes, *_magnify_note(runs, magnify)], largest)


def show_modes(robot: Robot, pose: Sequence[float] | None = None, *, count: int = 6) -> View:
    """The slowest mode shapes of a robot at rest, each with its frequency, beside each other.

    Friction is left out, for its slope at standstill would hold the drives. All modes are slowed down by one factor; how far they
    swing is not to scale.

    Parameters
    ----------
    robot : Robot
        With flexibilities.
    pose : sequence of float, shape (joints,), optional
        Drive angles, rad; zero where not given.
    count : int
        How many modes at most.

    Raises
    ------
    ValueError
        A pose of the wrong size, a count below one, or a robot in which nothing oscillates.
    """
    angles = np.zeros(len(robot.joints)) if pose is None else np.asarray(pose, dtype=float)
    if angles.shape != (len(robot.joints),):
        raise ValueError(f"pose has shape {angles.shape}; expected ({len(robot.joints)},) for {robot.name}")
    if count < 1:
        raise ValueError(f"count is {count}; expected 1 or more")
    q0 = robot.input_matrix @ angles
    modes = _slowest_modes(robot, q0, count)
    slower = max(modes.frequencies_hz[0] / SLOWEST_MODE_HZ, 1.0)
    builder = _Builder()
    points = scene.frame_poses(robot.tree, angles[None], _frames_of(robot))[0, :, :3, 3]
    patch = _Patch.of(points)
    width, height = patch.width + 0.15, patch.height + 0.3  # room between them, and above for words
    shown = len(modes.poles)
    columns = shown if shown <= 3 else -(-shown // 2) if shown <= 8 else 4
    # as on shelves across the line of sight, so that none hides another
    places = [width * (k % columns - 0.5 * (columns - 1)) * RIGHT - height * (k // columns) * UP for k in range(shown)]
    above = patch.top + 0.1 * UP
    builder.hide("Grid", "Axes")
    builder.look_at(np.concatenate([*(points + at for at in places), [above]]))
    time = np.arange(round(MODE_SECONDS * MODE_FPS) + 1) / MODE_FPS
    for place, at in enumerate(places):
        shape, hz = modes.shapes[:, place], float(modes.frequencies_hz[place])
        # a whole number of swings, so that the loop closes
        swings = max(round(hz / slower * MODE_SECONDS), 1)
        swing = np.exp(2j * np.pi * swings * time / MODE_SECONDS)
        q = q0 + _amplitude(robot, q0, shape) * np.real(swing[:, None] * shape)
        builder.add_robot(f"mode_{place + 1}", robot, q, angles[None], at, MODE_FPS)
        text = f"{hz:.1f} Hz, damping {100 * modes.damping_ratios[place]:.1f} %\n{_mostly(robot, shape)}"
        builder.label(f"mode_{place + 1}", text, above + at, width)
    drives = ", ".join(unit.place(x) for unit, x in zip(robot.units, angles, strict=True))
    notes = (
        f"Drives at {drives}, without friction",
        f"Slowed down {slower:.3g} times; how far a mode swings is not to scale",
        "Pale: the robot at rest",
    )
    return builder.view(f"Modes of {robot.name}", notes, None)


def _slowest_modes(robot: Robot, q0: Array, count: int) -> Modes:
    """Modes that oscillate about a point without friction, at most so many."""
    linear = robot.with_effects([effect for effect in robot.effects if not effect.traits.is_friction]).linearize(q0)
    sizes, directions = np.linalg.eigh(robot.mass_matrix(q0))
    if sizes[0] <= 1e-12 * sizes[-1]:
        at = robot.coordinates[int(np.abs(directions[:, 0]).argmax())]
        raise ValueError(
            f"{robot.name}: nothing with mass moves with {at} alone; expected a drive_inertia or a link's inertia there"
        )
    elastic = linear.frequencies_hz(elastic_only=True)[len(robot.joints) :]  # before them, the free drives
    if len(elastic) == 0:
        raise ValueError(f"{robot.name}: nothing in it bends; expected a robot with flexible drives or joints")
    modes = linear.modes()
    swinging = np.flatnonzero((modes.frequencies_hz > 0.5 * elastic[0]) & (modes.poles.imag > 0.0))[:count]
    return Modes(modes.poles[swinging], modes.shapes[:, swinging])


# ---- the parts of these ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _ViewerCommand:
    """A command as meshcat's server and page take it; `live_only` where the saved page has another place for what it shows."""

    kind: str
    path: str
    packed: bytes
    live_only: bool


class _Recorder:
    """Stands where meshcat's visualizer has its window, and keeps the commands."""

    def __init__(self) -> None:
        self.commands: list[_ViewerCommand] = []
        self.live_only = False

    def send(self, command: Any) -> None:
        lowered = command.lower()
        packed = umsgpack.packb(lowered)
        self.commands.append(_ViewerCommand(lowered["type"], lowered["path"], packed, self.live_only))


class _Builder:
    """Puts a scene together."""

    def __init__(self) -> None:
        self.recorder = _Recorder()
        everything = meshcat.Visualizer(window=self.recorder)
        self.default, self.root = everything["/"], everything["/view"]
        self.clips: dict[Any, AnimationClip] = {}
        self.top = np.zeros(3)
        self.default["Lights/AmbientLight/<object>"].set_property("intensity", 0.75)
        background = self.default["Background"]
        background.set_property("top_color", [0.93, 0.95, 0.97])
        background.set_property("bottom_color", [0.80, 0.83, 0.87])

    def look_at(self, points: Array) -> None:
        """Put the camera where it sees points, shape (N, 3)."""
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        across, up, near = (
            float(np.ptp((points - centre) @ axis)) + 2.0 * THICKNESS for axis in (RIGHT, UP, TO_CAMERA)
        )
        half = 0.5 * max(1.3 * up, 1.1 * across / ASPECT)  # above and below there are words and controls
        distance = half / np.tan(np.deg2rad(0.5 * FIELD_OF_VIEW)) + 0.5 * near
        moved = np.eye(4)  # the camera always turns about the origin: the scene moves there
        moved[:3, 3] = -centre
        for node in (self.root, self.default["Grid"], self.default["Axes"]):
            node.set_transform(moved)
        x, y, z = (float(c) for c in distance * TO_CAMERA)
        camera = self.default["Cameras/default/rotated/<object>"]
        camera.set_property("fov", FIELD_OF_VIEW)
        camera.set_property("position", [x, z, -y])  # y is up there
        self.top = _Patch.of(points).top

    def hide(self, *names: str) -> None:
        """Take things of meshcat's own away: Grid, Axes."""
        for name in names:
            self.default[name].set_property("visible", False)

    def add_run(self, name: str, run: Run, magnify: float, largest: float | None, at: Array, duration: float) -> None:
        """A run: robot, ghost, tip path as trail, reference path."""
        if not (np.isfinite(magnify) and magnify >= 0.0):
            raise ValueError(f"magnify is {magnify}; expected 0 or more")
        fps = min(FASTEST_FPS, LARGEST_FRAMES / duration)
        wanted = run.time[0] + np.arange(round(duration * fps) + 1) / fps
        rows = np.minimum(np.searchsorted(run.time, wanted - 1e-9), len(run.time) - 1)  # a run that ended early waits
        q = scene.magnified(run.robot, run.q, magnify)
        drives = run.q @ run.robot.input_matrix
        self.add_robot(name, run.robot, q[rows], drives[rows] if run.deforms else None, at, fps)
        trail = np.unique(np.linspace(0, len(q) - 1, TRAIL_POINTS).round().astype(int))
        path = tip_poses(run.robot.model, run.robot.tip_frame, q[trail])[:, :3, 3] + at
        colours = np.full((len(trail), 3), 0.3)
        if largest is not None and run.deviation_mm is not None:
            colours = scene.colours_of(run.deviation_mm[trail], largest)
        material = geometry.MeshBasicMaterial(vertexColors=True)
        self.root[f"{name}/trail"].set_object(geometry.Mesh(scene.tube(path, TRAIL_RADIUS, colours), material))
        if run.reference_path is not None:
            path = run.reference_path[trail] + at
            line = scene.tube(path, 0.3 * TRAIL_RADIUS, np.zeros((len(path), 3)), sides=5)
            self.root[f"{name}/reference"].set_object(geometry.Mesh(line, material))

    def add_robot(self, name: str, robot: Robot, q: Array, drives: Array | None, at: Array, fps: float) -> None:
        """A robot that moves by q, and its ghost, rigid, by drive angles, or at one of them, or none."""
        pieces = scene.shapes(robot)
        links = list(dict.fromkeys(piece.link for piece in pieces))
        for part, model, rows, ghost in (("robot", robot.model, q, False), ("ghost", robot.tree, drives, True)):
            if rows is None:
                continue
            poses = scene.frame_poses(model, rows, links)
            poses[..., :3, 3] += at
            for index, link in enumerate(links):
                node = self.root[f"{name}/{part}/{link}"]
                for number, piece in enumerate(p for p in pieces if p.link == link):
                    node[str(number)].set_object(piece.geometry, _material(piece.colour, ghost))
                    node[str(number)].set_transform(piece.placement)
                node.set_transform(poses[0, index])
                if np.ptp(poses[:, index], axis=0).max() > 1e-9:
                    self.clips[node.path] = _clip(poses[:, index], fps)

    def label(self, name: str, text: str, at: Array, room: float) -> None:
        """Words that stand upright, read from where the camera starts, and no wider than there is room."""
        png, ratio = scene.label(text)
        width = min(0.95 * room, 0.2 * ratio)
        self._picture(f"labels/{name}", png, at, (width, width / ratio))

    def legend(self, largest: float | None) -> None:
        """The colour bar in the scene, for pages that have no other place for it."""
        if largest is None:
            return
        self.recorder.live_only = True
        self._picture("legend", _bar(largest), self.top, (0.9, 0.9 * 0.72 / 3.2))
        self.recorder.live_only = False

    def _picture(self, path: str, png: bytes, at: Array, size: tuple[float, float]) -> None:
        texture = geometry.ImageTexture(geometry.PngImage(png))
        material = geometry.MeshBasicMaterial(map=texture, transparent=True, side=2)
        placement = np.eye(4)
        placement[:3, :3] = np.stack([RIGHT, UP, TO_CAMERA], axis=1)
        placement[:3, 3] = at
        self.root[path].set_object(scene.Plane(*size), material)
        self.root[path].set_transform(placement)

    def view(self, title: str, notes: Sequence[str], largest: float | None) -> View:
        """The finished scene."""
        if self.clips:
            self.default.set_animation(Animation(clips=self.clips), play=True, repetitions=FOREVER)
        legend = None if largest is None else _bar(largest)
        return View(title, tuple(notes), tuple(self.recorder.commands), legend)


def _material(colour: tuple[float, float, float, float], ghost: bool) -> Any:
    red, green, blue = (round(255 * c) for c in (GHOST_COLOUR if ghost else colour[:3]))
    number = (red << 16) + (green << 8) + blue
    if ghost:  # it hides nothing behind it
        return geometry.MeshLambertMaterial(color=number, opacity=GHOST_OPACITY, transparent=True, depthWrite=False)
    return geometry.MeshPhongMaterial(color=number, opacity=colour[3], transparent=colour[3] < 1.0)


def _clip(poses: Array, fps: float) -> AnimationClip:
    frames = list(range(len(poses)))
    position = poses[:, :3, 3].astype(np.float32).astype(float).tolist()
    turning = Rotation.from_matrix(poses[:, :3, :3]).as_quat().tolist()
    tracks = {
        "position": AnimationTrack("position", "vector3", frames, position),
        "quaternion": AnimationTrack("quaternion", "quaternion", frames, turning),
    }
    return AnimationClip(tracks, fps=fps)


def _bar(largest: float) -> bytes:
    return scene.colour_bar(largest, "tip's distance from its reference, mm")


def _largest_mm(runs: Sequence[Run]) -> float | None:
    peaks = [float(run.deviation_mm.max()) for run in runs if run.deviation_mm is not None]
    return max(*peaks, 1e-6, 1e-6) if peaks else None


def _duration(runs: Sequence[Run]) -> float:
    return max(float(run.time[-1] - run.time[0]) for run in runs)


def _frames_of(robot: Robot) -> list[str]:
    bodies = [f.name for f in robot.tree.frames if f.type == pin.FrameType.BODY]
    return [*dict.fromkeys([*bodies, robot.tip_frame])]


@dataclass(frozen=True, eq=False)
class _Patch:
    """What points with a robot's thickness about them cover as the camera sees them, m."""

    width: float
    height: float
    top: Array  # the middle of its upper edge, no further from the camera than any of the points

    @classmethod
    def of(cls, points: Array) -> _Patch:
        across, up, near = (points @ axis for axis in (RIGHT, UP, TO_CAMERA))
        top = 0.5 * (across.min() + across.max()) * RIGHT + (up.max() + THICKNESS) * UP + near.max() * TO_CAMERA
        return cls(float(np.ptp(across)) + 2.0 * THICKNESS, float(np.ptp(up)) + 2.0 * THICKNESS, top)


def _reach(run: Run, magnify: float) -> Array:
    """Points that the robot's frames pass, shape (N, 3), m."""
    rows = np.unique(np.linspace(0, len(run.q) - 1, 40).round().astype(int))
    q = scene.magnified(run.robot, run.q[rows], magnify)
    return scene.frame_poses(run.robot.model, q, _frames_of(run.robot))[..., :3, 3].reshape(-1, 3)


def _amplitude(robot: Robot, q0: Array, shape: ComplexArray) -> float:
    """What to multiply a mode shape by, so that it can be seen and is not torn apart."""
    data = robot.model.createData()
    tip = robot.model.getFrameId(robot.tip_frame)
    jacobian = jacobian_at(robot.model, data, q0, tip)[:3]
    moved = float(np.linalg.norm(jacobian @ shape))
    return min(MODE_TIP / max(moved, 1e-9), MODE_ANGLE / float(np.abs(shape).max()))


def _mostly(robot: Robot, shape: ComplexArray) -> str:
    """The coordinate that moves most in a mode."""
    return "mostly " + robot.coordinates[int(np.argmax(np.abs(shape)))].replace("_", " ").replace(":", ", ")


def _magnify_note(runs: Sequence[Run], magnify: float) -> list[str]:
    notes = []
    if any(run.deforms for run in runs):
        notes.append(f"Deformations magnified {magnify:g} times; pale: the robot undeformed, drives alike")
    if any(run.reference is not None for run in runs):
        notes.append("Colour: true distance of the tip from its reference; black: the reference's path")
    return notes


def _peak_note(name: str, run: Run) -> tuple[str, ...]:
    d = run.deviation_mm
    if d is None:
        return (f"{name}: {run.robot.name}, {run.name}",)
    return (f"{name}: {run.robot.name}, {d.max():.3g} mm at most, {np.sqrt(np.mean(d**2)):.3g} mm root mean square",)
