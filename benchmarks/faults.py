"""Faults put into sound data, and which of them `check` names:

    python benchmarks/faults.py [--seeds 5] [--first-seed 0] [--faults NAME ...] [--out FILE] [--table FILE]
    python benchmarks/faults.py --robots ur10e tx40 dualarm_v2 kr300_encoders    # the same faults in real recordings

Five robots: UR10, Panda, Kinova (example-robot-data), the RX90B, and an arm of five joints written here. Links are up to 15 % off
what the file says; dry friction is `numpy.tanh`, with some that grows with the load and some that differs by direction, none of it
declared; noise on torque and position. Dynamics are pinocchio's own. Each fault is put into such a campaign, one at a time; a
campaign without any is the sound one beside it.

Real recordings are looked for where the tests look (`RX90B_FLEX_DATA`). What is known to be wrong with them is not counted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
import time as clock
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
import pinocchio as pin
from data_folder import data_folder
from numpy.typing import NDArray

import rx90b_flex as rf
from rx90b_flex.signals import Campaign, Recording, load_campaign

Array = NDArray[np.float64]

RATE_HZ, SECONDS, CUTOFF_HZ = 100.0, 12.0, 12.0
ROLES = ("identification", "identification", "validation")
TORQUE_NOISE, POSITION_NOISE = 0.01, 1e-5  # of the torque's root mean square; rad
LINKS_OFF = 0.15
ROBOTS = ("ur10", "panda", "kinova", "rx90b", "five_axis")
REAL = ("ur10e", "tx40", "dualarm_v2", "kr300_encoders")
KNOWN_WRONG = {"dualarm_v2": ("torque_gain",)}  # kinds that are found in the recordings as they are

FIVE_AXIS = """<robot name="five_axis"><link name="base"/>{links}</robot>"""
_AXES = (  # origin, axis, mass, centre of mass, moments of inertia
    ("0 0 0.3", "0 0 1", 14.0, "0.05 0.01 0.1", (0.20, 0.18, 0.15)),
    ("0.1 0 0.2", "0 1 0", 11.0, "0.25 0.02 0.03", (0.06, 0.55, 0.54)),
    ("0.5 0 0", "0 1 0", 7.0, "0.2 -0.03 0.02", (0.03, 0.25, 0.26)),
    ("0.45 0 0", "0 1 0", 2.5, "0.06 0.01 0.02", (0.006, 0.012, 0.011)),
    ("0.12 0 0", "1 0 0", 1.4, "0.04 0.02 0.015", (0.003, 0.004, 0.005)),
)


def five_axis() -> str:
    """URDF of an arm of five joints: turn, three pitches, roll."""
    links, parent = "", "base"
    for k, (origin, axis, mass, centre, (xx, yy, zz)) in enumerate(_AXES, start=1):
        links += (
            f'<link name="link_{k}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}" '
            f'izz="{zz}" ixy="0.001" ixz="-0.002" iyz="0.001"/></inertial></link><joint name="axis_{k}" type="revolute">'
            f'<parent link="{parent}"/><child link="link_{k}"/><origin xyz="{origin}" rpy="0 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="4" effort="300"/></joint>'
        )
        parent = f"link_{k}"
    return FIVE_AXIS.format(links=links)


def urdf_of(name: str, folder: Path) -> str:
    """The URDF's text of one of `ROBOTS`, joints of one coordinate each."""
    if name == "five_axis":
        path = folder / "five_axis.urdf"
        path.write_text(five_axis())
        return rf.load_robot(path).urdf
    robot = rf.load_robot("rx90b_rigid" if name == "rx90b" else f"example-robot-data:{name}")
    arm = [j for j in robot.joints if "finger" not in j]
    return robot.restricted(arm).urdf


@dataclass(frozen=True, eq=False)
class Logs:
    """What a campaign's files hold: one array a recording, (N, n) each; and the robot's file."""

    joints: tuple[str, ...]
    urdf: str
    position: tuple[Array, ...]
    torque: tuple[Array, ...]
    rate_hz: float = RATE_HZ


def recorded(name: str, urdf: str, rng: np.random.Generator) -> Logs:
    """Recordings of the robot, its true links off those of its file."""
    model = pin.buildModelFromXML(urdf)
    for i in range(1, model.njoints):
        f = 1.0 + LINKS_OFF * rng.uniform(-1, 1)
        body = model.inertias[i]
        model.inertias[i] = pin.Inertia(f * body.mass, body.lever * (1 + 0.1 * rng.uniform(-1, 1)), f * body.inertia)
    data, n = model.createData(), model.nv
    inertia = None
    positions, torques = [], []
    for _ in ROLES:
        q, v, a = harmonic(model, rng)
        load = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
        if inertia is None:
            size = np.maximum(np.sqrt((load**2).mean(axis=0)), 0.02 * np.abs(load).max())
            speed = np.abs(v).max(axis=0)
            dry, viscous = size * rng.uniform(0.1, 0.3, n), size / speed * rng.uniform(0.1, 0.4, n)
            loaded, skew = rng.uniform(0.0, 0.06, n), rng.uniform(-0.1, 0.1, n)
            inertia = rng.uniform(0.05, 0.3, n) * size / np.abs(a).max(axis=0)
            offset = 0.05 * size * rng.normal(size=n)
        turned = np.tanh(v / 2e-3)
        torque = (
            load + inertia * a + (dry + loaded * np.abs(load)) * turned + viscous * v * (1 + skew * turned) + offset
        )
        positions.append(q + POSITION_NOISE * rng.normal(size=q.shape))
        torques.append(torque + TORQUE_NOISE * torque.std(axis=0) * rng.normal(size=q.shape))
    return Logs(tuple(model.names)[1:], urdf, tuple(positions), tuple(torques))


def harmonic(model: pin.Model, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Six harmonics a joint within its range, 1.2 rad/s at the most; exact derivatives."""
    n = model.nv
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    omega = 2 * np.pi / SECONDS * np.arange(1, 7)[:, None, None] * (1 + 0.02 * rng.uniform(-1, 1, n))
    size, phase = rng.uniform(0.3, 1.0, (6, 1, n)) / np.sqrt(omega), rng.uniform(0, 2 * np.pi, (6, 1, n))
    angle = omega * time[:, None] + phase
    v = (size * np.cos(angle)).sum(axis=0)
    q = (size / omega * np.sin(angle)).sum(axis=0)
    a = (-size * omega * np.sin(angle)).sum(axis=0)
    low, high = np.maximum(model.lowerPositionLimit, -2.5), np.minimum(model.upperPositionLimit, 2.5)
    scale = np.minimum(1.2 / np.abs(v).max(axis=0), 0.4 * (high - low) / np.abs(q).max(axis=0))
    room = 0.5 * (high - low) - scale * np.abs(q).max(axis=0)
    centre = 0.5 * (low + high) + rng.uniform(-0.5, 0.5, n) * room
    return scale * q + centre, scale * v, scale * a


# ---- faults ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Expected:
    """What `check` should say: a kind, and the joints (none: whichever it names)."""

    kind: str
    joints: tuple[str, ...] = ()


Fault = Callable[[Logs, np.random.Generator], tuple[Logs, Expected]]
FAULTS: dict[str, Fault] = {}


def fault(function: Fault) -> Fault:
    FAULTS[function.__name__] = function
    return function


def each(arrays: tuple[Array, ...], change: Callable[[Array], Array]) -> tuple[Array, ...]:
    return tuple(change(x.copy()) for x in arrays)


def one(arrays: tuple[Array, ...], rng: np.random.Generator, change: Callable[[Array], Array]) -> tuple[Array, ...]:
    """One recording's changed."""
    chosen = int(rng.integers(len(arrays)))
    return tuple(change(x.copy()) if k == chosen else x for k, x in enumerate(arrays))


def some_joint(logs: Logs, rng: np.random.Generator, first: int = 0, last: int = 0) -> int:
    return int(rng.integers(first, len(logs.joints) - last))


def carrying_joint(logs: Logs, rng: np.random.Generator) -> int:
    """The second, third or fourth: what they carry stands out of their friction, and other joints' torques depend on it."""
    return int(rng.integers(1, 4))


def exchanged(logs: Logs, signal: str, i: int, j: int) -> tuple[Logs, Expected]:
    order = np.arange(len(logs.joints))
    order[[i, j]] = j, i
    changed = replace(logs, **{signal: each(getattr(logs, signal), lambda x: x[:, order])})
    return changed, Expected("swapped_columns", (logs.joints[i], logs.joints[j]))


def exchanged_in_one(logs: Logs, signal: str, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng, last=1)
    order = np.arange(len(logs.joints))
    order[[k, k + 1]] = k + 1, k
    changed = replace(logs, **{signal: one(getattr(logs, signal), rng, lambda x: x[:, order])})
    return changed, Expected("swapped_columns", (logs.joints[k], logs.joints[k + 1]))


def plus(k: int, angle: float) -> Callable[[Array], Array]:
    def change(x: Array) -> Array:
        x[:, k] += angle
        return x

    return change


def times(k: int | slice, factor: float) -> Callable[[Array], Array]:
    def change(x: Array) -> Array:
        x[:, k] *= factor
        return x

    return change


@fault
def torques_exchanged(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng, last=1)
    return exchanged(logs, "torque", k, k + 1)


@fault
def far_torques_exchanged(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return exchanged(logs, "torque", 0, some_joint(logs, rng, first=2))


@fault
def positions_exchanged(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng, last=1)
    return exchanged(logs, "position", k, k + 1)


@fault
def torque_reversed(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    return replace(logs, torque=each(logs.torque, times(k, -1.0))), Expected("reversed_sign", (logs.joints[k],))


@fault
def every_torque_reversed(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return replace(logs, torque=each(logs.torque, np.negative)), Expected("reversed_sign", logs.joints)


@fault
def position_reversed(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    return replace(logs, position=each(logs.position, times(k, -1.0))), Expected("reversed_sign", (logs.joints[k],))


@fault
def torque_reversed_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    return replace(logs, torque=one(logs.torque, rng, times(k, -1.0))), Expected("reversed_sign", (logs.joints[k],))


@fault
def position_reversed_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    return replace(logs, position=one(logs.position, rng, times(k, -1.0))), Expected("reversed_sign", (logs.joints[k],))


@fault
def torque_halved_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    return replace(logs, torque=one(logs.torque, rng, times(k, 0.5))), Expected("torque_gain", (logs.joints[k],))


@fault
def torques_exchanged_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return exchanged_in_one(logs, "torque", rng)


@fault
def positions_exchanged_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return exchanged_in_one(logs, "position", rng)


@fault
def zero_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    angle = rng.uniform(0.15, 0.6) * rng.choice([-1.0, 1.0])
    return replace(logs, position=one(logs.position, rng, plus(k, angle))), Expected("kinematics", (logs.joints[k],))


@fault
def degrees_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return replace(logs, position=one(logs.position, rng, np.degrees)), Expected("unit", logs.joints)


@fault
def a_little_late_in_one(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    late = round(float(rng.choice([-1.0, 1.0])) * rng.uniform(0.02, 0.05) * logs.rate_hz)

    def shifted(x: Array) -> Array:
        return x[np.clip(np.arange(len(x)) - late, 0, len(x) - 1)]

    return replace(logs, torque=one(logs.torque, rng, shifted)), Expected("time_shift", logs.joints)


@fault
def degrees(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return replace(logs, position=each(logs.position, np.degrees)), Expected("unit", logs.joints)


@fault
def one_in_degrees(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    return replace(logs, position=each(logs.position, times(k, 180 / np.pi))), Expected("unit", (logs.joints[k],))


@fault
def torque_in_n_mm(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng, last=1)
    return replace(logs, torque=each(logs.torque, times(k, 1000.0))), Expected("unit", (logs.joints[k],))


@fault
def motor_side_torque(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    gear = rng.uniform(50, 160)
    return replace(logs, torque=each(logs.torque, times(k, 1 / gear))), Expected("unit", (logs.joints[k],))


@fault
def wrong_motor_constant(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    gain = float(rng.choice([0.3, 3.0]))
    return replace(logs, torque=each(logs.torque, times(k, gain))), Expected("torque_gain", (logs.joints[k],))


@fault
def wrong_gear_ratio(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    ratio = float(rng.choice([0.8, 0.9, 1.1, 1.25]))
    position, torque = each(logs.position, times(k, ratio)), each(logs.torque, times(k, 1 / ratio))
    return replace(logs, position=position, torque=torque), Expected("unit", (logs.joints[k],))


@fault
def wrong_scale_of_an_angle(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    ratio = float(rng.choice([0.8, 0.9, 1.1, 1.25]))
    return replace(logs, position=each(logs.position, times(k, ratio))), Expected("unit", (logs.joints[k],))


@fault
def torques_late(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    late = round(float(rng.choice([-1.0, 1.0])) * rng.uniform(0.3, 1.0) * logs.rate_hz)
    return _later(logs, late, slice(None)), Expected("time_shift", logs.joints)


@fault
def one_torque_late(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    return _later(logs, round(0.3 * logs.rate_hz), k), Expected("time_shift", (logs.joints[k],))


def _later(logs: Logs, samples: int, k: int | slice) -> Logs:
    """Torques so many samples later, the ends of both cut off, as two logs started apart have them."""
    keep = slice(abs(samples), None) if samples > 0 else slice(None, -abs(samples))

    def shifted(x: Array) -> Array:
        x[:, k] = np.roll(x, samples, axis=0)[:, k]
        return x[keep]

    return replace(logs, position=tuple(q[keep] for q in logs.position), torque=each(logs.torque, shifted))


@fault
def stated_rate_wrong(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    return replace(logs, rate_hz=logs.rate_hz * float(rng.choice([0.5, 2.0]))), Expected("sample_rate")


@fault
def torque_clipped(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    centre = np.median(logs.torque[0][:, k])
    top = 0.6 * max(np.abs(t[:, k] - centre).max() for t in logs.torque)

    def cut(x: Array) -> Array:
        x[:, k] = np.clip(x[:, k], centre - top, centre + top)
        return x

    return replace(logs, torque=each(logs.torque, cut)), Expected("clipped", (logs.joints[k],))


@fault
def encoder_stands(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = some_joint(logs, rng)
    own, still = np.arange(len(logs.joints)) == k, logs.position[0][0, k]
    stood = each(logs.position, lambda x: np.where(own, still, x))
    return replace(logs, position=stood), Expected("stuck", (logs.joints[k],))


@fault
def wild_cell(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k, row = some_joint(logs, rng), int(rng.integers(20, 1000))
    torque = tuple(t.copy() for t in logs.torque)
    torque[0][row, k] = 1e6
    return replace(logs, torque=torque), Expected("glitch", (logs.joints[k],))


@fault
def validation_is_a_copy(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    q, tau = list(logs.position), list(logs.torque)
    q[-1], tau[-1] = q[0].copy(), tau[0] + TORQUE_NOISE * tau[0].std(axis=0) * rng.normal(size=tau[0].shape)
    return replace(logs, position=tuple(q), torque=tuple(tau)), Expected("repeated_recording")


@fault
def random_torques(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    def noise(x: Array) -> Array:
        smooth = np.apply_along_axis(lambda c: np.convolve(c, np.hanning(25), "same"), 0, rng.normal(size=x.shape))
        return x.mean(axis=0) + x.std(axis=0) * smooth / smooth.std(axis=0)

    return replace(logs, torque=each(logs.torque, noise)), Expected("unrelated", logs.joints)


@fault
def zero_off(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    off = float(rng.choice([-np.pi / 2, np.pi / 2])) * (np.arange(len(logs.joints)) == k)
    return replace(logs, position=each(logs.position, lambda x: x + off)), Expected("kinematics", (logs.joints[k],))


@fault
def link_too_long(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    root = ElementTree.fromstring(logs.urdf)
    joints = {j.get("name"): j for j in root.iter("joint")}
    longest = max(logs.joints[1:-1], key=lambda j: _length(joints[j]))
    origin = joints[longest].find("origin")
    assert origin is not None
    origin.set("xyz", " ".join(repr(1.5 * float(x)) for x in (origin.get("xyz") or "").split()))
    return replace(logs, urdf=ElementTree.tostring(root, encoding="unicode")), Expected("kinematics", (longest,))


def _length(joint: ElementTree.Element) -> float:
    origin = joint.find("origin")
    return 0.0 if origin is None else float(np.linalg.norm([float(x) for x in origin.get("xyz", "0 0 0").split()]))


@fault
def axis_wrong(logs: Logs, rng: np.random.Generator) -> tuple[Logs, Expected]:
    k = carrying_joint(logs, rng)
    root = ElementTree.fromstring(logs.urdf)
    axis = next(j for j in root.iter("joint") if j.get("name") == logs.joints[k]).find("axis")
    assert axis is not None
    x, y, z = (axis.get("xyz") or "").split()
    axis.set("xyz", f"{y} {z} {x}")
    return replace(logs, urdf=ElementTree.tostring(root, encoding="unicode")), Expected("kinematics", (logs.joints[k],))


# ---- running ----------------------------------------------------------------------------------------------------------


BASICS = ("drive_inertia", "coulomb_friction", "viscous_friction", "torque_offset")


def measured(name: str) -> tuple[Logs, Campaign]:
    """Real recordings: what their files hold, and the campaign that they are of, without signals that the robots above lack."""
    found = load_campaign(data_folder(name) / "campaign.toml")
    robot = rf.load_robot(found.robot_source).restricted(found.joints)
    q, tau = tuple(r.position for r in found.recordings), tuple(r.torque for r in found.recordings)
    return Logs(found.joints, robot.urdf, q, tau, found.sample_rate_hz), found


def as_in(logs: Logs, found: Campaign, folder: Path) -> Campaign:
    """A campaign of real recordings with these logs in their place, the robot's file in the folder."""
    (folder / "robot.urdf").write_text(logs.urdf)
    robot = Path(found.robot_source).read_text()
    (folder / "robot.toml").write_text(re.sub(r'(?m)^urdf = ".*"$', 'urdf = "robot.urdf"', robot))
    recordings = tuple(
        Recording(r.name, r.role, np.arange(len(q)) / logs.rate_hz, logs.rate_hz, logs.joints, q, tau)
        for r, q, tau in zip(found.recordings, logs.position, logs.torque, strict=True)
    )
    return Campaign(
        folder / "campaign.toml",
        "robot.toml",
        folder / "robot.toml",
        logs.rate_hz,
        logs.joints,
        recordings,
        found.cutoff_hz,
    )


def campaign(logs: Logs, folder: Path) -> Campaign:
    """The logs as a campaign, the robot's file with basic friction in the folder."""
    (folder / "robot.urdf").write_text(logs.urdf)
    tables = "".join(f'[[effects]]\ntype = "{kind}"\njoint = "{j}"\n' for j in logs.joints for kind in BASICS)
    (folder / "robot.toml").write_text(f'name = "robot"\nurdf = "robot.urdf"\n{tables}')
    recordings = tuple(
        Recording(f"run_{k}", role, np.arange(len(q)) / logs.rate_hz, logs.rate_hz, logs.joints, q, tau)  # type: ignore[arg-type]
        for k, (role, q, tau) in enumerate(zip(ROLES, logs.position, logs.torque, strict=True), start=1)
    )
    return Campaign(
        folder / "campaign.toml", "robot.toml", folder / "robot.toml", logs.rate_hz, logs.joints, recordings, CUTOFF_HZ
    )


@dataclass(frozen=True)
class Outcome:
    """One campaign: what was put in, what was said, and whether that is the same thing on the same joints."""

    robot: str
    fault: str
    seed: int
    named: bool
    usable: bool
    said: list[list[object]] = field(default_factory=list)
    seconds: float = 0.0


def run(robot: str, name: str, seed: int) -> Outcome:
    """One campaign checked; `name` is a fault's, or ``sound``."""
    number = (*ROBOTS, *REAL).index(robot)
    rng = np.random.default_rng([seed, number])
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        logs, found = measured(robot) if robot in REAL else (recorded(robot, urdf_of(robot, folder), rng), None)
        expected = None
        if name != "sound":
            logs, expected = FAULTS[name](logs, np.random.default_rng([seed, number, 1]))
        start = clock.process_time()
        checked = rf.check(campaign(logs, folder) if found is None else as_in(logs, found, folder))
        seconds = clock.process_time() - start
    said = [[f.kind, f.signal, list(f.joints), f.factor, round(f.error_after or 0.0, 3)] for f in checked.data_faults]
    if expected is None:
        named = all(f.kind in KNOWN_WRONG.get(robot, ()) for f in checked.data_faults)
    else:
        named = any(
            f.kind == expected.kind and (not expected.joints or set(f.joints) == set(expected.joints))
            for f in checked.data_faults
        )
    return Outcome(robot, name, seed, named, checked.usable, said, round(seconds, 2))


def table(outcomes: list[Outcome]) -> str:
    """Faults down, robots across: how many of the seeds were named on the right joints."""
    robots = [r for r in (*ROBOTS, *REAL) if any(o.robot == r for o in outcomes)]
    lines = ["| put in | " + " | ".join(robots) + " | named |", "|---|" + "---|" * (len(robots) + 1)]
    for name in ("sound", *FAULTS):
        here = [o for o in outcomes if o.fault == name]
        if here:
            cells = [[o.named for o in here if o.robot == r] for r in robots]
            lines.append(
                f"| {name.replace('_', ' ')} | "
                + " | ".join(f"{sum(c)}/{len(c)}" for c in cells)
                + f" | {sum(o.named for o in here)}/{len(here)} |"
            )
    faulty = [o for o in outcomes if o.fault != "sound"]
    if faulty:
        lines.append(f"\nFaults named on the right joints: {sum(o.named for o in faulty)} of {len(faulty)}.")
        missed = [o for o in faulty if o.usable and o.fault != "wrong_motor_constant"]
        lines.append(f"Faulty data called usable: {len(missed)} of {len(faulty)}.")
    return "\n".join(lines) + "\n"


def wanted(robots: list[str], faults: list[str], seeds: range) -> Iterator[tuple[str, str, int]]:
    yield from ((r, f, s) for s in seeds for f in faults for r in robots)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS), choices=[*ROBOTS, *REAL])
    parser.add_argument("--faults", nargs="*", default=["sound", *FAULTS])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    done: list[Outcome] = []
    if options.out and options.out.exists():
        done = [Outcome(**json.loads(line)) for line in options.out.read_text().splitlines()]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    have = {(o.robot, o.fault, o.seed) for o in done}
    for robot, name, seed in wanted(options.robots, options.faults, seeds):
        if (robot, name, seed) in have:
            continue
        outcome = run(robot, name, seed)
        done.append(outcome)
        if not outcome.named:
            print(outcome, file=sys.stderr)
        if options.out:
            with options.out.open("a") as file:
                file.write(json.dumps(outcome.__dict__) + "\n")
    print(table(done))
    if options.table:
        options.table.write_text(table(done))


if __name__ == "__main__":
    main()
