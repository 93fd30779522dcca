"""Modes of robots with hidden flexibilities, worked out without the package: MuJoCo's dynamics, SciPy's eigenvalues."""

from __future__ import annotations

import dataclasses

import numpy as np
from mujoco_engine import Engine
from scipy.linalg import eigh

from rx90b_flex.diagnose.modal import ModalPose, ModalTable, ModeList
from rx90b_flex.robot import Robot

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
    coupling: tuple[str, str, float] | None = None  # two coordinates and an inertia that turns with their sum

    def modes(self, angles: dict[str, float], measured: tuple[str, ...], locked: str | None) -> Array:
        """Undamped elastic frequencies, Hz."""
        engine = Engine(self.urdf, self.torsion, self.bending, self.base, self.armature, self.stiffness)
        names = engine.coordinates
        q = np.array([angles.get(n.split(":")[0], 0.0) if n.endswith(":drive") else 0.0 for n in names])
        free = [i for i, n in enumerate(names) if not n.endswith(":drive") or n.split(":")[0] in measured]
        free = [i for i in free if names[i] != f"{locked}:drive"]
        mass, zero, steps = engine.mass_matrix(q), np.zeros(len(q)), 1e-4 * np.eye(len(q))
        if self.coupling is not None:
            a, b, inertia = self.coupling
            row = np.array([float(n in (a, b)) for n in names])
            mass += inertia * np.outer(row, row)
        force = [
            (engine.inverse_dynamics(q + d, zero, zero) - engine.inverse_dynamics(q - d, zero, zero)) / 2e-4
            for d in steps
        ]
        stiff = 0.5 * (np.array(force) + np.array(force).T)
        at = np.ix_(free, free)
        squares = eigh(stiff[at], mass[at], eigvals_only=True)
        return np.sqrt(squares[len(measured) - (locked is not None) :]) / (2 * np.pi)


def truth_of(robot: Robot) -> Truth:
    """What a robot declares, as plain numbers; springs and friction are not taken over."""
    armature, stiffness, torsion, bending, base = {}, {}, [], [], False
    for effect in robot.effects:
        kind, values = effect.type_name(), effect.coefficients
        place = effect.place[0] if effect.place else "base"
        if kind == "drive_inertia":
            armature[f"{place}:drive"] = float(values[0])
        elif kind == "drive_flexibility":
            torsion.append(place)
            stiffness[f"{place}:torsion"] = float(values[0])
        elif kind in ("joint_flexibility", "base_flexibility"):
            stiffness |= {f"{place}:bend_1": float(values[0]), f"{place}:bend_2": float(values[1])}
            bending += [place] if effect.joints else []
            base = base or not effect.joints
    return Truth(robot.urdf, tuple(torsion), tuple(bending), base, armature, stiffness)


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
