"""Recordings made without the package: effects in plain NumPy on pinocchio's rnea, logs and campaign as plain text.

Whatever the package finds in them, it cannot owe to an error that the generator shares with it. Dry friction is
`numpy.sign` here; the package smooths it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import example_robot_data
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]
Torque = Callable[["Motion", Array], Array]  # motion and the links' torque, (N, n) -> (N, n)


@dataclass(frozen=True, eq=False)
class Motion:
    """N samples; time (N,), the others (N, n); SI units."""

    time: Array
    q: Array
    v: Array
    a: Array


@dataclass(frozen=True, eq=False)
class Arm:
    """A rigid arm and what its robot file calls its tree."""

    urdf: str
    model: pin.Model

    @cached_property
    def joints(self) -> tuple[str, ...]:
        return tuple(self.model.names)[1:]

    def torque(self, motion: Motion) -> Array:
        """Torque that the links ask for, (N, n)."""
        data = self.model.createData()
        samples = zip(motion.q, motion.v, motion.a, strict=True)
        return np.array([pin.rnea(self.model, data, q, v, a) for q, v, a in samples])


@cache
def example(name: str) -> pin.Model:
    """A model of example-robot-data, which loads its meshes too."""
    return example_robot_data.load(name).model


def ur10(heavier: float = 1.0) -> Arm:
    """The UR10, its links `heavier` times as heavy as its URDF says."""
    model = example("ur10").copy()
    for i, inertia in enumerate(model.inertias):
        model.inertias[i] = pin.Inertia(heavier * inertia.mass, inertia.lever, heavier * inertia.inertia)
    return Arm("example-robot-data:ur10", model)


def ur5() -> Arm:
    """The UR5."""
    return Arm("example-robot-data:ur5", example("ur5"))


def panda() -> Arm:
    """The Panda's seven joints, its fingers held closed."""
    model = example("panda").copy()
    fingers = [i for i, name in enumerate(model.names) if "finger" in name]
    return Arm("example-robot-data:panda", pin.buildReducedModel(model, fingers, pin.neutral(model)))


def rx90b() -> Arm:
    """The rigid tree of the RX90B."""
    path = Path(__file__).parents[1] / "urdf" / "rx90b.urdf"
    return Arm(str(path), pin.buildModelFromUrdf(str(path)))


TWO_JOINTS = """<robot name="two_joints">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.21 0.03 0.01"/><mass value="4"/>
    <inertia ixx="0.02" iyy="0.07" izz="0.08" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.17 -0.02 0.02"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.03" izz="0.035" ixy="-0.001" ixz="0.001" iyz="0.002"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="5" effort="100"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 0.6 0.8"/><limit lower="-3" upper="3" velocity="5" effort="50"/></joint>
</robot>
"""


def two_joints(folder: Path) -> Arm:
    """An arm of two joints, its URDF written into a folder."""
    (folder / "two_joints.urdf").write_text(TWO_JOINTS)
    return Arm("two_joints.urdf", pin.buildModelFromXML(TWO_JOINTS))


def harmonics(
    rng: np.random.Generator,
    joints: int,
    *,
    period_s: float,
    periods: int = 1,
    rate_hz: float = 100.0,
    speed: float = 1.2,
    lines: int = 6,
) -> Motion:
    """A motion that repeats: random harmonics, every joint's fastest velocity `speed` rad/s, exact derivatives."""
    time = np.arange(round(period_s * periods * rate_hz)) / rate_hz
    omega = 2 * np.pi / period_s * np.arange(1, lines + 1)
    size = rng.uniform(0.5, 1.0, (lines, joints)) / np.sqrt(omega)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (lines, joints))
    angle = omega[:, None] * time[:, None, None] + phase
    v = (size * np.cos(angle)).sum(axis=1)
    q = (size / omega[:, None] * np.sin(angle)).sum(axis=1)
    a = (-size * omega[:, None] * np.sin(angle)).sum(axis=1)
    scale = speed / np.abs(v).max(axis=0)
    centre = rng.uniform(-0.8, 0.8, joints)
    return Motion(time, q * scale + centre, v * scale, a * scale)


# ---- effects ------------------------------------------------------------------------------------------------


def friction(coulomb: Sequence[float], viscous: Sequence[float]) -> Torque:
    """Dry and viscous friction of every joint."""
    return lambda m, load: np.sign(m.v) * coulomb + m.v * viscous


def hidden(kind: str, place: int | tuple[int, int], p: Mapping[str, float]) -> Torque:
    """The torque of one effect of INTERFACE.md's table, on one joint or two, by number."""

    def on_one(m: Motion, load: Array, j: int) -> Array:
        q, v, a, through = m.q[:, j], m.v[:, j], m.a[:, j], load[:, j]
        laws: dict[str, Callable[[], Array]] = {
            "drive_inertia": lambda: p["inertia"] * a,
            "torque_offset": lambda: p["torque"] * np.ones(len(q)),
            "coulomb_friction": lambda: p["torque"] * np.sign(v),
            "viscous_friction": lambda: p["coefficient"] * v,
            "viscous_power_friction": lambda: p["coefficient"] * np.sign(v) * np.abs(v) ** p["power"],
            "stribeck_friction": lambda: (
                p["torque"] * np.exp(-((np.abs(v) / p["velocity"]) ** p["power"])) * np.sign(v)
            ),
            "asymmetric_friction": lambda: p["coefficient"] * np.abs(v),
            "load_friction": lambda: p["coefficient"] * np.abs(through) * np.sign(v),
            "joint_spring": lambda: p["stiffness"] * (q - p["rest_angle"]),
            "gear_ripple": lambda: p["amplitude"] * np.sin(p["order"] * q + p["phase"]),
        }
        return laws[kind]()

    def torque(m: Motion, load: Array) -> Array:
        out = np.zeros_like(load)
        if isinstance(place, tuple):
            assert kind == "joint_coupling"
            a, b = place
            v = m.v[:, a] + m.v[:, b]
            motor = p["inertia"] * (m.a[:, a] + m.a[:, b]) + p["viscous"] * v + p["coulomb"] * np.sign(v)
            out[:, a] = out[:, b] = motor
        else:
            out[:, place] = on_one(m, load, place)
        return out

    return torque


def tilted(arm: Arm, angle_x: float, angle_y: float) -> Torque:
    """What gravity asks for beyond its share along the base's z, the base turned about its own x and y."""
    model = arm.model.copy()
    turned = pin.exp3(np.array([angle_x, angle_y, 0.0]))
    model.gravity.linear = turned.T @ model.gravity.linear
    return lambda m, load: Arm(arm.urdf, model).torque(m) - load


def carrying(arm: Arm, frame: str, mass: float, centre: Sequence[float]) -> Torque:
    """What a point mass fixed to a frame asks for."""
    model = arm.model.copy()
    tip = model.frames[model.getFrameId(frame)]
    point = pin.Inertia(mass, tip.placement.act(np.asarray(centre, dtype=float)), np.zeros((3, 3)))
    model.inertias[tip.parentJoint] += point
    return lambda m, load: Arm(arm.urdf, model).torque(m) - load


def pressing(arm: Arm, frame: str, stiffness: float, wall: float) -> Torque:
    """A soft wall across the base's x at `wall` that the frame's origin presses into; not of the catalogue."""

    def torque(m: Motion, load: Array) -> Array:
        data, place = arm.model.createData(), arm.model.getFrameId(frame)
        out = np.zeros_like(load)
        for row, q in zip(out, m.q, strict=True):
            pin.computeJointJacobians(arm.model, data, q)
            depth = pin.updateFramePlacement(arm.model, data, place).translation[0] - wall
            if depth > 0.0:
                towards = pin.getFrameJacobian(arm.model, data, place, pin.LOCAL_WORLD_ALIGNED)[0]
                row[:] = stiffness * depth * towards
        return out

    return torque


def angle_dependent_friction(joint: int, other: int, coefficient: float) -> Torque:
    """Dry friction that grows with the angle of another joint; not of the catalogue."""

    def torque(m: Motion, load: Array) -> Array:
        out = np.zeros_like(load)
        angle = m.q[:, other]
        out[:, joint] = coefficient * (angle - angle.mean()) * np.sign(m.v[:, joint])
        return out

    return torque


def white(rng: np.random.Generator, samples: int, rms: Sequence[float]) -> Array:
    """White noise, (N, n)."""
    return rng.normal(size=(samples, len(rms))) * rms


def coloured(rng: np.random.Generator, samples: int, rms: Sequence[float], memory: float) -> Array:
    """First-order autoregressive noise, x_k = memory * x_(k-1) + white, in its steady state; (N, n)."""
    start_up = int(20 / (1 - memory))
    driven = rng.normal(size=(samples + start_up, len(rms))) * np.sqrt(1 - memory**2)
    return signal.lfilter([1.0], [1.0, -memory], driven, axis=0)[start_up:] * rms


# ---- files --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Run:
    """One recording of an arm: motion and logged torque."""

    role: str
    motion: Motion
    torque: Array
    period_s: float | None = None


def run(
    arm: Arm,
    role: str,
    motion: Motion,
    torques: Sequence[Torque],
    noise: Array,
    period_s: float | None = None,
) -> Run:
    """The log of an arm with effects."""
    load = arm.torque(motion)
    return Run(role, motion, load + sum(t(motion, load) for t in torques) + noise, period_s)


def effect_tables(declared: Sequence[Mapping[str, object]]) -> str:
    """Effects of a robot file."""
    return "".join(
        "[[effects]]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in table.items()) for table in declared
    )


def write_robot(folder: Path, arm: Arm, declared: Sequence[Mapping[str, object]], known: bool = False) -> Path:
    """A robot file."""
    path = folder / "robot_declared.toml"
    kind = "known" if known else "fitted"
    head = f'name = "declared"\nurdf = "{arm.urdf}"\ninertial_parameters = "{kind}"\n'
    path.write_text(head + effect_tables(declared))
    return path


def write_files(
    folder: Path,
    arm: Arm,
    declared: Sequence[Mapping[str, object]],
    runs: Sequence[Run],
    *,
    cutoff_hz: float | None = None,
    joints: Sequence[str] | None = None,
    gear_matrix: Array | None = None,
    offset: Array | None = None,
    known: bool = False,
) -> Path:
    """Robot file, logs and campaign file; returns the last.

    `joints` are those that are logged, in the order of the columns. With a gear matrix the logs are motor side.
    """
    write_robot(folder, arm, declared, known)
    names = list(arm.joints if joints is None else joints)
    places = [arm.joints.index(name) for name in names]
    angle, torque = ([f"{kind}_{i}" for i in range(len(names))] for kind in ("angle", "moment"))
    rate = 1.0 / (runs[0].motion.time[1] - runs[0].motion.time[0])
    lines = [
        'robot = "robot_declared.toml"',
        f"sample_rate_hz = {rate:.6g}",
        f"joints = {json.dumps(names)}",
        "[signals]",
        f"motor_position = {json.dumps(angle)}",
        f"torque = {json.dumps(torque)}",
    ]
    if gear_matrix is not None:
        lines += ["[motor]", f"gear_matrix = {gear_matrix.tolist()}"]
        lines += [] if offset is None else [f"offset = {offset.tolist()}"]
    if cutoff_hz is not None:
        lines += ["[preprocessing]", f"cutoff_hz = {cutoff_hz}"]
    for number, item in enumerate(runs, start=1):
        q, tau = item.motion.q[:, places], item.torque[:, places]
        if gear_matrix is not None:
            q = (q - (0.0 if offset is None else offset)) @ gear_matrix.T
            tau = tau @ np.linalg.inv(gear_matrix)
        table = np.column_stack([item.motion.time, q, tau])
        header = ",".join(["time", *angle, *torque])
        np.savetxt(folder / f"log_{number}.csv", table, fmt="%.17g", delimiter=",", header=header, comments="")
        lines += ["[[recording]]", f'file = "log_{number}.csv"', f'role = "{item.role}"']
        lines += [] if item.period_s is None else [f"period_s = {item.period_s}"]
    path = folder / "campaign.toml"
    path.write_text("\n".join(lines) + "\n")
    return path
