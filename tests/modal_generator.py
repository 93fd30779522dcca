"""Modes of robots with hidden flexibilities, worked out without the package: MuJoCo's dynamics, SciPy's eigenvalues."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from xml.etree import ElementTree

import numpy as np
from mujoco_engine import Engine
from scipy.linalg import eigh

from rx90b_flex.diagnose.flexible import FlexibleLoop
from rx90b_flex.diagnose.modal import ModalPose, ModalTable, ModeList
from rx90b_flex.effects.coupling import JointCoupling
from rx90b_flex.effects.flexibility import BaseFlexibility
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.robot import Robot, load_robot

Array = np.ndarray
BAND = (8.0, 75.0)
MEASURED = ("joint_1", "joint_2", "joint_3")
STRETCHED = {"joint_2": np.pi / 2}
BENT = {"joint_2": 0.6, "joint_3": 1.2}


@dataclasses.dataclass(frozen=True)
class Truth:
    """A robot as it really is: hinges with stiffness, drives with inertia; all by coordinate."""

    urdf: str
    torsion: tuple[str, ...]
    bending: tuple[str, ...]
    base: bool
    armature: dict[str, float]
    stiffness: dict[str, float]
    coupling: tuple[dict[str, float], float] | None = None  # an inertia, and how often it turns with coordinates
    springs: dict[str, float] = dataclasses.field(
        default_factory=dict
    )  # across a joint, drive and its torsion together

    def matrices(self, angles: dict[str, float]) -> tuple[tuple[str, ...], Array, Array]:
        """Coordinates, mass, and stiffness with gravity's."""
        engine = Engine(self.urdf, self.torsion, self.bending, self.base, self.armature, self.stiffness)
        names = engine.coordinates
        q = np.array([angles.get(n.split(":")[0], 0.0) if n.endswith(":drive") else 0.0 for n in names])
        mass, zero, steps = engine.mass_matrix(q), np.zeros(len(q)), 1e-4 * np.eye(len(q))
        if self.coupling is not None:
            turns, inertia = self.coupling
            row = np.array([turns.get(n, 0.0) for n in names])
            mass += inertia * np.outer(row, row)
        force = np.array(
            [engine.inverse_dynamics(q + d, zero, zero) - engine.inverse_dynamics(q - d, zero, zero) for d in steps]
        )
        stiff = (force + force.T) / 4e-4
        for joint, spring in self.springs.items():
            stiff += spring * np.outer(*2 * [_turning(joint, names)])
        return names, mass, stiff

    def response(
        self,
        angles: dict[str, float],
        measured: tuple[str, ...],
        hz: Array,
        slope: float | Sequence[float] = 30.0,
        lag: float | dict[str, float] = 1e-3,
    ) -> Array:
        """Acceleration of the measured drives over their torque; dampings are `lag` times the stiffness, friction is viscous."""
        names, mass, stiff = self.matrices(angles)
        lags = lag if isinstance(lag, dict) else dict.fromkeys(names, lag)
        damping = np.diag([lags.get(n, 0.0) * self.stiffness.get(n, 0.0) for n in names])
        for joint, viscous in zip(measured, np.broadcast_to(slope, len(measured)), strict=True):
            damping += viscous * np.outer(*2 * [_turning(joint, names)])
        free = [i for i, n in enumerate(names) if not n.endswith(":drive") or n.split(":")[0] in measured]
        drives = np.array([[float(names[i] == f"{j}:drive") for j in measured] for i in free])
        at = np.ix_(free, free)
        s = 2j * np.pi * hz[:, None, None]
        return s**2 * (drives.T @ np.linalg.inv(s**2 * mass[at] + s * damping[at] + stiff[at]) @ drives)

    def modes(self, angles: dict[str, float], measured: tuple[str, ...], locked: str | None) -> Array:
        """Undamped elastic frequencies, Hz."""
        names, mass, stiff = self.matrices(angles)
        free = [i for i, n in enumerate(names) if not n.endswith(":drive") or n.split(":")[0] in measured]
        free = [i for i in free if names[i] != f"{locked}:drive"]
        at = np.ix_(free, free)
        squares = eigh(stiff[at], mass[at], eigvals_only=True)
        return np.sqrt(squares[len(measured) - (locked is not None) :]) / (2 * np.pi)


def _turning(joint: str, names: tuple[str, ...]) -> Array:
    """What turns a joint behind its gear."""
    return np.array([float(n in (f"{joint}:drive", f"{joint}:torsion")) for n in names])


def measured_response(
    truth: Truth,
    rng: np.random.Generator,
    noise: float,
    angles: dict[str, float],
    joints: tuple[str, ...],
    measured: tuple[str, ...] = MEASURED,
    slope: float | Sequence[float] = 30.0,
    lag: float | dict[str, float] = 1e-3,
) -> FrequencyResponse:
    """On the lines of section 6.6.2 from 8 to 78 Hz; each entry's error of that part of its magnitude."""
    hz = np.arange(33, 322, 2) / 4.096
    clean = truth.response(angles, measured, hz, slope, lag)
    size = noise * np.abs(clean)
    drawn = rng.standard_normal((2, *clean.shape)) / np.sqrt(2.0)
    covariance = (size.reshape(len(hz), -1) ** 2)[:, :, None] * np.eye(len(measured) ** 2).astype(complex)
    pose = np.array([angles.get(j, 0.0) for j in joints])
    return FrequencyResponse(hz, clean + size * (drawn[0] + 1j * drawn[1]), covariance, measured, pose)


def truth_of(robot: Robot) -> Truth:
    """What a robot declares, as plain numbers; springs and friction are not taken over."""
    armature, stiffness, torsion, bending, base, coupling = {}, {}, [], [], False, None
    for effect in robot.effects:
        kind, values = effect.type_name(), effect.coefficients
        place = effect.place[0] if effect.place else "base"
        if kind == "drive_inertia":
            armature[f"{place}:drive"] = float(values[0])
        elif kind == "joint_coupling":
            coupling = ({f"{j}:drive": 1.0 for j in effect.joints}, float(values[0]))
        elif kind == "drive_flexibility":
            torsion.append(place)
            stiffness[f"{place}:torsion"] = float(values[0])
        elif kind in ("joint_flexibility", "base_flexibility"):
            stiffness |= {f"{place}:bend_1": float(values[0]), f"{place}:bend_2": float(values[1])}
            bending += [place] if effect.joints else []
            base = base or not effect.joints
    return Truth(robot.urdf, tuple(torsion), tuple(bending), base, armature, stiffness, coupling)


def measured(
    truth: Truth, rng: np.random.Generator, noise: float, poses: tuple[dict[str, float], ...] = (STRETCHED,)
) -> ModalTable:
    """Every mode inside the band, with normal errors of the stated relative standard deviation."""
    out = []
    for angles in poses:
        lists = []
        for locked in (None, *MEASURED):
            hz = truth.modes(angles, MEASURED, locked)
            hz = hz[(hz > BAND[0]) & (hz < BAND[1])]
            seen = np.sort(hz * (1.0 + noise * rng.standard_normal(len(hz))))
            lists.append(ModeList(locked, seen, noise * seen))
        out.append(ModalPose(angles, tuple(lists)))
    return ModalTable(MEASURED, BAND, tuple(out))


# ---- causes to hide -------------------------------------------------------------------------------------------------


def without_springs(name: str = "rx90b") -> Robot:
    """What both the package and the generator have: links, drives and hinges."""
    robot = load_robot(name)
    return robot.with_effects([e for e in robot.effects if e.traits.in_drivetrain])


PLAIN = without_springs()


def scaled(robot: Robot, kind: str, joint: str, factor: float) -> Robot:
    """The robot with the values of one effect multiplied."""
    here = (kind, (joint,))
    return robot.with_effects(
        [
            e.with_coefficients(factor * e.coefficients) if (e.type_name(), e.joints) == here else e
            for e in robot.effects
        ]
    )


def lacking(robot: Robot, kind: str, joint: str) -> Robot:
    """The robot without one effect."""
    return robot.with_effects([e for e in robot.effects if (e.type_name(), e.joints) != (kind, (joint,))])


TWO_ON_A_MOTOR = JointCoupling(joint_pair=("joint_2", "joint_3"), inertia=0.6, viscous=0.0, coulomb=0.0)

# declared, true, and what is to be found
CAUSES = {
    "nothing": (PLAIN, PLAIN, []),
    "drive that twists": (lacking(PLAIN, "drive_flexibility", "joint_3"), PLAIN, ["joint_3.drive_flexibility"]),
    "joint that bends": (lacking(PLAIN, "joint_flexibility", "joint_2"), PLAIN, ["joint_2.joint_flexibility"]),
    "softer joint": (PLAIN, scaled(PLAIN, "joint_flexibility", "joint_2", 0.8), ["joint_2.joint_stiffness"]),
    "softer drive": (PLAIN, scaled(PLAIN, "drive_flexibility", "joint_3", 0.8), ["joint_3.drive_stiffness"]),
    "heavier rotor": (PLAIN, scaled(PLAIN, "drive_inertia", "joint_2", 1.3), ["joint_2.drive_inertia"]),
    # unlike about its two axes: one that is alike is joint 1's bending, a little softer
    "floor": (
        PLAIN,
        PLAIN.with_effects([*PLAIN.effects, BaseFlexibility(stiffness=(2e6, 8e6), damping=(2e3, 8e3))]),
        ["base.base_flexibility"],
    ),
    "coupled drives": (PLAIN, PLAIN.with_effects([*PLAIN.effects, TWO_ON_A_MOTOR]), ["joint_2_joint_3.joint_coupling"]),
}


def heavier(urdf: str, link: str, factor: float) -> str:
    """A URDF in which one link has `factor` times the mass; its centre and its inertia about that stay."""
    root = ElementTree.fromstring(urdf)
    (mass,) = (m for x in root.findall("link") if x.get("name") == link for m in x.iter("mass"))
    mass.set("value", repr(factor * float(mass.get("value", ""))))
    return ElementTree.tostring(root, encoding="unicode")


def carrying(urdf: str, link: str, mass: float, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> str:
    """A URDF with a point mass on a link, at a point of the link's frame, m."""
    root = ElementTree.fromstring(urdf)
    load = ElementTree.SubElement(ElementTree.SubElement(root, "link", name="load"), "inertial")
    ElementTree.SubElement(load, "origin", xyz=" ".join(repr(x) for x in centre))
    ElementTree.SubElement(load, "mass", value=repr(mass))
    ElementTree.SubElement(load, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0"))
    joint = ElementTree.SubElement(root, "joint", name="load", type="fixed")
    ElementTree.SubElement(joint, "parent", link=link)
    ElementTree.SubElement(joint, "child", link="load")
    return ElementTree.tostring(root, encoding="unicode")


# what no change of the search can be
OUTSIDE = {
    "differential": dataclasses.replace(truth_of(PLAIN), coupling=({"joint_2:drive": 1.0, "joint_3:drive": -2.0}, 0.6)),
    "heavier forearm": dataclasses.replace(truth_of(PLAIN), urdf=heavier(PLAIN.urdf, "link_3", 1.15)),
}


def share_named_wrongly(closed: Callable[[str, int], FlexibleLoop], seeds: Iterable[int]) -> float:
    """Part of the runs of all causes that are there whose changes are not the ones hidden; prints those."""
    runs = [(cause, seed) for cause in CAUSES if cause != "nothing" for seed in seeds]
    found = [[f.change.label for f in closed(cause, seed).found] for cause, seed in runs]
    wrong = [(run, labels) for run, labels in zip(runs, found, strict=True) if labels != CAUSES[run[0]][2]]
    print(wrong)
    return len(wrong) / len(runs)


def times_called_complete(closed: Callable[[str, int], FlexibleLoop], seeds: Iterable[int]) -> int:
    """Runs with nothing hidden that say so."""
    return sum(closed("nothing", seed).verdict == "nothing_missing" for seed in seeds)
