"""Which parameters a motion can tell, from the regressor alone, and which basic effects a model lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.diagnose.faults.rigid_fit import FLOOR, OUT, PER_JOINT
from rx90b_flex.diagnose.faults.sample import BASICS, other_effects
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.robot import LINK_PARAMETERS, Robot

NULL = 1e-3  # of a scaled parameter that lies in undetermined directions, below which it is determined by itself
SINGULAR = 1e-6  # scaled singular value over the largest, below which a direction is undetermined
WEAK = 0.3  # standard deviation over a parameter's size
WORTH = 0.1  # of the summed log error: a basic effect that explains less is not missed


@dataclass(frozen=True)
class ParameterStatus:
    """Whether the data can tell a parameter by itself.

    Attributes
    ----------
    name : str
        As in ``identification.json``.
    status : str
        ``identifiable``; ``weak``: its standard deviation is a third of its size or more; ``not``: only together with others, or
        not at all; ``known``: kept as given.
    """

    name: str
    status: str


def statuses(look: Look, robot: Robot, moving: Mask) -> tuple[ParameterStatus, ...]:
    """Status of every link parameter and of every declared effect's coefficients.

    Parameters
    ----------
    robot : Robot
        Rigid, of the campaign's joints, with its declared effects.
    moving : array of bool, shape (joints,)
    """
    columns = look.columns(look.reading)
    fit = look.fit()
    joints = look.sample.joints
    links = 10 * len(robot.bodies)
    known = robot.inertial_parameters == "known"
    names = [f"{body}.{name}" for body, _ in robot.bodies for name in LINK_PARAMETERS]
    places, still = list(range(links)), [False] * links
    for effect in robot.effects:
        if effect.type_name() in BASICS and effect.joints[0] in joints:
            k = joints.index(effect.joints[0])
            names.append(f"{effect.label}.{next(iter(effect.coefficient_parameters))}")
            places.append(links + PER_JOINT * k + BASICS.index(effect.type_name()))
            still.append(effect.type_name() != "torque_offset" and not moving[k])
    at = links + PER_JOINT * len(joints)
    for effect in other_effects(robot):
        for name in effect.coefficient_parameters:
            names.append(f"{effect.label}.{name}")
            places.append(at)
            still.append(False)
            at += 1
    fitted = np.array(places[links:] if known else places, dtype=np.intp)
    variance = look.sample.torque_of(look.reading)[0][:, list(look.reading.torque_order)].var(axis=0) + 1e-300
    weight = 1.0 / (variance * (fit.error + FLOOR))
    x = columns[:, :, fitted] * np.sqrt(weight)[:, None]
    status = _status(
        x.reshape(x.shape[0] * x.shape[1], len(fitted)),
        fit.theta.mean(axis=0)[fitted],
        look.products(look.reading).prior[fitted],
    )
    if known:
        status = ["known"] * links + status
    return tuple(
        ParameterStatus(name, "not" if s else found) for name, found, s in zip(names, status, still, strict=True)
    )


def _status(x: Array, theta: Array, prior: Array) -> list[str]:
    if x.shape[1] == 0:
        return []
    size = np.linalg.norm(x, axis=0)
    largest = size.max()
    empty = size < 1e-9 * largest
    scale = np.where(empty, largest if largest > 0 else 1.0, size)
    # by LAPACK's gesvd: its quicker gesdd, which NumPy asks, does not end for some such columns
    triangle = np.linalg.qr(x / scale, mode="r")
    _, singular, vectors = linalg.svd(triangle, full_matrices=False, lapack_driver="gesvd")
    kept = singular > SINGULAR * singular[0]
    null = np.sqrt(np.maximum(1.0 - (vectors[kept] ** 2).sum(axis=0), 0.0))
    std = np.sqrt(((vectors[kept] / singular[kept][:, None]) ** 2).sum(axis=0)) / scale
    reference = np.maximum(np.abs(theta), np.abs(prior))
    out = []
    for is_empty, loose, s, r in zip(empty, null, std, reference, strict=True):
        out.append("not" if is_empty or loose > NULL else "weak" if s > WEAK * r else "identifiable")
    return out


def undeclared_basics(look: Look, robot: Robot, moving: Mask) -> tuple[str, ...]:
    """Drive inertia, dry and viscous friction and offsets that no joint declares, and that would explain something."""
    declared = {e.type_name() for e in robot.effects} | {t for e in robot.effects for t in e.traits.replaces}
    links = look.reading.links
    whole = look.fit().score
    out = []
    for name in ("coulomb_friction", "viscous_friction", "drive_inertia", "torque_offset"):
        if name in declared:
            continue
        places = [links + PER_JOINT * k + BASICS.index(name) for k in np.flatnonzero(moving).tolist()]
        if not places:
            continue
        if look.fit_held(places, OUT).score - whole > WORTH:
            out.append(name)
    return tuple(out)
