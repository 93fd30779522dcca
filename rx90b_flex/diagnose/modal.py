"""Modal tables: resonances and antiresonances held against a flexible robot, and what it lacks to have them.

A modal table is a TOML file::

    robot = "rx90b"                              # a robot's name, or a robot file beside this one
    joints = ["joint_1", "joint_2", "joint_3"]   # whose drives move; the other drives are held
    band_hz = [8.0, 75.0]                        # what was looked at: a mode of the model in it should have been seen
    [[pose]]                                     # one or more
    angles_deg = { joint_2 = 90.0 }              # of the drives; the others stand at zero
    resonance = { hz = [28.4, 30.3], std_hz = [0.02, 0.10] }
    antiresonance.joint_1 = { hz = [15.1], std_hz = [0.03] }
    role = "identification"                      # or "validation": predicted, not fitted

Frequencies are undamped (the distance of a pole or zero from the origin), rigid-body modes left out. An antiresonance of a joint is a
zero of its own transfer function: a frequency with its drive locked (section 5.4). A list that is not there was not measured.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import linalg

from rx90b_flex.diagnose.flexible import NEW_STD, FlexibleLoop, FlexibleResidual, Structure
from rx90b_flex.diagnose.likelihood import (
    MOST_CHANGES,
    Change,
    FoundChange,
    LikelihoodFit,
    LikelihoodTrial,
    State,
    close_residual,
)
from rx90b_flex.diagnose.loop import Progress
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.files.keys import close_match
from rx90b_flex.files.results import finite
from rx90b_flex.files.table import TomlTable
from rx90b_flex.files.toml import named_in, read_toml
from rx90b_flex.robot import Robot, load_robot

MODEL_ERROR = 0.005  # of a frequency: what separates a robot that moves from its model at rest
SEPARATING_DEG = (-60.0, 0.0, 60.0, 120.0)  # angles of the second and third moving joint that are looked at
SPURIOUS = 0.05  # of measured modes: chance of one that is none of the robot's (mains, a double pole of a fit)
MISSED = 0.1  # chance that a mode inside the band is not seen
ROLES = ("identification", "validation")


# ---- the table -------------------------------------------------------------------------------------------------------


def list_name(locked: str | None) -> str:
    """Of a list of modes: ``resonances``, ``antiresonances of joint_1``."""
    return "resonances" if locked is None else f"antiresonances of {locked}"


@dataclass(frozen=True, eq=False)
class ModeList:
    """Frequencies of one kind at one pose.

    Attributes
    ----------
    locked : str or None
        Joint whose antiresonances they are; None: resonances.
    hz, std_hz : array, shape (m,)
        Ascending.
    """

    locked: str | None
    hz: Array
    std_hz: Array

    @property
    def name(self) -> str:
        """As a heading."""
        return list_name(self.locked)

    @cached_property
    def log(self) -> Array:
        return np.log(self.hz)

    @cached_property
    def variance(self) -> Array:
        """Of the logarithm."""
        return (self.std_hz / self.hz) ** 2


@dataclass(frozen=True, eq=False)
class ModalPose:
    """What was measured at one pose.

    Attributes
    ----------
    angles : mapping of joint to angle, rad
        Joints that are not named stand at zero.
    lists : tuple of ModeList
    role : str
        ``identification`` or ``validation``.
    """

    angles: Mapping[str, float]
    lists: tuple[ModeList, ...]
    role: str = "identification"

    def drive_angles(self, robot: Robot) -> Array:
        """Angles in the order of a robot's joints, rad."""
        for joint in self.angles:
            if joint not in robot.joints:
                raise ValueError(f"pose: unknown joint {joint!r} of {robot.name}; {close_match(joint, robot.joints)}")
        return np.array([self.angles.get(j, 0.0) for j in robot.joints])


@dataclass(frozen=True, eq=False)
class ModalTable:
    """Measured modes of a robot.

    Attributes
    ----------
    joints : tuple of str
        Whose drives moved.
    band_hz : (low, high)
    poses : tuple of ModalPose
    robot : str or None
        Name or file of the robot, where the table says it.
    name : str
    """

    joints: tuple[str, ...]
    band_hz: tuple[float, float]
    poses: tuple[ModalPose, ...]
    robot: str | None = None
    name: str = "modes"

    def role(self, role: str) -> tuple[ModalPose, ...]:
        """The poses of a role."""
        return tuple(p for p in self.poses if p.role == role)


def load_modal_table(path: str | os.PathLike[str]) -> ModalTable:
    """Read a modal table; the module's first lines say what it looks like.

    Raises
    ------
    ValueError
        One line that names file and key.
    """
    path = Path(path)
    table = TomlTable(str(path), "", read_toml(path, "modal table"))
    if not table.has("pose"):
        raise table.problem("[[pose]]", "missing; one or more are expected, each with resonance or antiresonance")
    table.allow("robot", "joints", "band_hz", "pose")
    joints = table.texts("joints")
    read = tuple(_read_pose(pose, joints) for pose in table.sections("pose"))
    if not any(p.role == "identification" for p in read):
        raise table.problem("pose", "every one has the role 'validation'; expected one to identify with")
    robot = table.optional("robot", table.text)
    if robot is not None and Path(robot).suffix and not robot.startswith("example-robot-data:"):
        robot = str(path.parent / robot)
    everything = np.concatenate([m.hz for p in read for m in p.lists])
    band = table.numbers("band_hz", 2, "a band has") if table.has("band_hz") else (everything.min(), everything.max())
    low, high = map(float, band)
    if not 0 < low < high:
        raise table.problem("band_hz", f"found {[low, high]}, a low and a higher frequency above 0 are expected")
    _check_inside(table, read, (low, high))
    return ModalTable(joints, (low, high), read, robot, path.stem)


def _check_inside(table: TomlTable, poses: Sequence[ModalPose], band_hz: tuple[float, float]) -> None:
    low, high = band_hz
    for number, pose in enumerate(poses, start=1):
        for modes in pose.lists:
            outside = modes.hz[(modes.hz < low) | (modes.hz > high)]
            if len(outside):
                key = "resonance" if modes.locked is None else f"antiresonance.{modes.locked}"
                hint = (
                    "are they in rad/s? else widen band_hz"
                    if outside.max() > high
                    else "widen band_hz if it was looked at as well"
                )
                raise table.problem(
                    f"[[pose]] {number} {key} hz", f"{outside[0]:g} is outside band_hz, {low:g} to {high:g} Hz; {hint}"
                )


def _read_pose(table: TomlTable, joints: tuple[str, ...]) -> ModalPose:
    table.allow("angles_deg", "resonance", "antiresonance", "role")
    angles, locked = (table.section_or_empty(key) for key in ("angles_deg", "antiresonance"))
    turned = {joint: float(np.deg2rad(angles.number(joint))) for joint in angles.values}
    lists = [_read_list(locked.section(j), j) for j in joints if locked.has(j)]
    for joint in locked.values:
        if joint not in joints:
            raise table.problem("antiresonance", f"the drive of {joint!r} did not move; {close_match(joint, joints)}")
    if table.has("resonance"):
        lists.insert(0, _read_list(table.section("resonance"), None))
    if not lists:
        raise table.problem("resonance", "missing, and antiresonance too; one or more lists of modes are expected")
    return ModalPose(turned, tuple(lists), table.one_of("role", ROLES))


def _read_list(table: TomlTable, locked: str | None) -> ModeList:
    table.allow("hz", "std_hz")
    hz = table.numbers("hz")
    std = table.numbers("std_hz", len(hz), "hz lists")
    for key, values, what in (("hz", hz, "frequencies"), ("std_hz", std, "standard deviations")):
        if not (values > 0.0).all():
            raise table.problem(key, f"found {values[values <= 0.0][0]:g}, expected {what} above 0 Hz")
    order = np.argsort(hz, kind="stable")
    return ModeList(locked, hz[order], std[order])


# ---- the model's modes -----------------------------------------------------------------------------------------------


def modes_of(
    structure: Structure, changes: Sequence[Change], matrices: tuple[Array, Array], locked: str | None = None
) -> tuple[Array, Array]:
    """Undamped elastic frequencies of a changed model and their slopes: logarithms of Hz, (m,), and by x, (m, p).

    The rigid-body modes, one a drive that moves, are left out; gravity and springs are in the stiffness. ``matrices`` are those of
    `Structure.matrices`.
    """
    (M, _, K), by_x = matrices
    free = structure.free(changes, locked)
    rigid = len(structure.joints) - (locked is not None)
    if len(free) <= rigid:
        return np.zeros(0), np.zeros((0, len(by_x)))
    at = np.ix_(free, free)
    squares, within = linalg.eigh(0.5 * (K[at] + K[at].T), M[at], check_finite=False)
    squares = np.maximum(squares[rigid:], 1.0)
    shapes = np.zeros((len(M), len(squares)))
    shapes[free] = within[:, rigid:]
    slopes = np.empty((len(squares), len(by_x)))
    for k, (dM, _, dK) in enumerate(by_x):
        slopes[:, k] = 0.5 * ((shapes * (dK @ shapes)).sum(axis=0) / squares - (shapes * (dM @ shapes)).sum(axis=0))
    return 0.5 * np.log(squares) - np.log(2.0 * np.pi), slopes


@dataclass(frozen=True, eq=False)
class Pairing:
    """Which mode of the model each measured one is.

    Attributes
    ----------
    measured, model : array of int, shape (k,)
        Places in both lists; both ascend.
    cost : float
        -2 log of the joint probability of pairs, measured modes without one, and modes of the model that were not seen.
    unseen : int
        Modes of the model inside the band without a partner.
    """

    measured: Indices
    model: Indices
    cost: float
    unseen: int


def pair(measured: ModeList, model: Array, model_error: float, band_hz: tuple[float, float]) -> Pairing:
    """The most probable pairing that keeps both orders; model: logarithms of Hz, ascending.

    A measured mode is a mode of the model with a normal error of its logarithm, or spurious (`SPURIOUS`), then anywhere in the band.
    A mode of the model inside the band is missed with the chance `MISSED`, so that a model with many modes does not fit anything.
    """
    low, high = np.log(band_hz)
    variance = measured.variance + model_error**2
    difference = measured.log[:, None] - model
    normal = np.log(2.0 * np.pi * variance)[:, None] + difference**2 / variance[:, None]
    inside = (model >= low) & (model <= high)
    match = (normal - 2.0 * np.log(1.0 - SPURIOUS) - np.where(inside, 2.0 * np.log(1.0 - MISSED), 0.0)).tolist()
    alone = -2.0 * np.log(SPURIOUS / (high - low))
    missed = np.where(inside, -2.0 * np.log(MISSED), 0.0).tolist()
    rows, columns = difference.shape
    best = [[0.0] * (columns + 1) for _ in range(rows + 1)]
    for j in range(columns):
        best[0][j + 1] = best[0][j] + missed[j]
    for i in range(rows):
        row, above, costs = best[i + 1], best[i], match[i]
        row[0] = above[0] + alone
        for j in range(columns):
            row[j + 1] = min(above[j] + costs[j], above[j + 1] + alone, row[j] + missed[j])
    pairs, i, j, unseen = [], rows, columns, 0
    while i and j:
        here = best[i][j]
        if here == best[i - 1][j - 1] + match[i - 1][j - 1]:
            i, j = i - 1, j - 1
            pairs.append((i, j))
        elif here == best[i - 1][j] + alone:
            i -= 1
        else:
            j -= 1
            unseen += bool(inside[j])
    unseen += int(inside[:j].sum())
    both = np.array(pairs[::-1], dtype=np.intp).reshape(-1, 2)
    return Pairing(both[:, 0], both[:, 1], best[rows][columns], unseen)


# ---- the residual ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Compared:
    """One list of measured modes beside the model's.

    Attributes
    ----------
    pose : int
        Number of the pose in the table.
    measured : ModeList
    model : array, shape (m,)
        Logarithms of Hz of all elastic modes of the model, ascending.
    slopes : array, shape (m, p)
        Theirs by the model's parameters.
    pairing : Pairing
    """

    pose: int
    measured: ModeList
    model: Array
    slopes: Array
    pairing: Pairing

    @cached_property
    def model_hz(self) -> Array:
        """All elastic modes of the model, ascending."""
        return np.exp(self.model)

    @property
    def residual(self) -> Array:
        """Difference of the logarithms of each pair, as a fit has it."""
        return self.measured.log[self.pairing.measured] - self.model[self.pairing.model]

    @property
    def variance(self) -> Array:
        """Of each pair's measured logarithm."""
        return self.measured.variance[self.pairing.measured]

    @property
    def errors(self) -> Array:
        """Logarithm of measured over model of each pair."""
        return np.log(self.measured.hz[self.pairing.measured] / self.model_hz[self.pairing.model])

    @property
    def in_order(self) -> Array:
        """The same with the n-th measured mode as the model's n-th, as far as both go."""
        count = min(len(self.measured.hz), len(self.model_hz))
        return np.log(self.measured.hz[:count] / self.model_hz[:count])


def _pooled(lists: Sequence[Compared]) -> tuple[Array, Array, Array]:
    """Residuals of all pairs, their variances, and slopes of the model's, (k,), (k,), (k, p)."""
    slopes = np.concatenate([c.slopes[c.pairing.model] for c in lists])
    return np.concatenate([c.residual for c in lists]), np.concatenate([c.variance for c in lists]), slopes


class ModalResidual(FlexibleResidual):
    """Logarithms of measured over model frequencies.

    Parameters
    ----------
    structure : Structure
        At the poses of `poses`, in their order.
    poses : sequence of ModalPose
    band_hz : (low, high)
    model_error : float
        Relative error of a frequency that is always allowed for.
    """

    largest_error = 1.0

    def __init__(
        self, structure: Structure, poses: Sequence[ModalPose], band_hz: tuple[float, float], model_error: float
    ) -> None:
        self.structure = structure
        self.poses = tuple(poses)
        self.band_hz = band_hz
        self.smallest_error = model_error

    @staticmethod
    def of(
        robot: Robot, table: ModalTable, poses: Sequence[ModalPose], model_error: float, new_std: float = NEW_STD
    ) -> ModalResidual:
        """Of some poses of a table."""
        angles = [p.drive_angles(robot) for p in poses]
        structure = Structure.of(robot, table.joints, angles, table.band_hz, new_std)
        return ModalResidual(structure, poses, table.band_hz, model_error)

    @property
    def size(self) -> float:
        return float(sum(len(m.hz) for pose in self.poses for m in pose.lists))

    def _paired(self, changes: tuple[Change, ...], x: Array, error: float) -> list[Compared]:
        out = []
        for k, pose in enumerate(self.poses):
            matrices = self.structure.matrices(k, changes, x)
            for measured in pose.lists:
                model, slopes = modes_of(self.structure, changes, matrices, measured.locked)
                out.append(Compared(k, measured, model, slopes, pair(measured, model, error, self.band_hz)))
        return out

    def evaluate(self, changes: tuple[Change, ...], x: Array, model_error: float) -> State:
        paired = self._paired(changes, x, max(model_error, self.smallest_error))
        residual, variance, slopes = _pooled(paired)
        return self.of_independent(residual, slopes, variance, 1.0, model_error, sum(c.pairing.cost for c in paired))

    def chance(self, fit: LikelihoodFit) -> float:
        """By chi-squared of all pairs at the stated errors; a measured mode without a partner counts as four standard deviations."""
        squares = ((c.residual**2 / (c.variance + self.smallest_error**2), alone([c])) for c in self.compare(fit))
        return self.by_chi_squared(sum(float(x.sum()) + 16.0 * without for x, without in squares), self.size, fit)

    def compare(self, fit: LikelihoodFit) -> tuple[Compared, ...]:
        """Every list of the table beside a fitted model's modes."""
        return tuple(self._paired(fit.changes, fit.x, max(fit.model_error, self.smallest_error)))

    def left_out(self, fit: LikelihoodFit) -> float:
        """Root mean square of the errors with which each measured mode is predicted by a fit to the others.

        To first order: an error over ``1 - h``, h its leverage in the fit.
        """
        residual, variance, slopes = _pooled(self.compare(fit))
        weight = 1.0 / (variance + max(fit.model_error, self.smallest_error) ** 2)
        leverage = np.einsum("ij,jk,ik->i", slopes, fit.covariance, slopes) * weight
        return rms(residual / np.maximum(1.0 - leverage, 1e-3))


def rms(values: Array) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.asarray(values) ** 2))) if len(values) else float("nan")


# ---- the loop --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Separation:
    """An experiment that tells two explanations apart.

    Attributes
    ----------
    angles : mapping of joint to angle, rad
    measured : str
        Which list of modes.
    with_found, with_alternative : float
        Frequency of the mode that differs most, Hz.
    """

    angles: Mapping[str, float]
    measured: str
    with_found: float
    with_alternative: float

    @property
    def words(self) -> str:
        """In a sentence."""
        pose = ", ".join(f"{j.replace('_', ' ')} at {np.rad2deg(a):.0f}°" for j, a in self.angles.items())
        both = f"{self.with_found:.1f} Hz against {self.with_alternative:.1f} Hz"
        return f"{pose}: one of the {self.measured.replace('_', ' ')} is at {both}"


@dataclass(frozen=True, eq=False)
class ModalLoop(FlexibleLoop):
    """The loop closed on a modal table.

    Attributes
    ----------
    table : ModalTable
    before, after : tuple of Compared
        Every list of the identification poses.
    validation_before, validation_after : tuple of Compared
        Of the validation poses, which were not fitted.
    left_out_before, left_out_after : float
        Root mean square error of the logarithms with each mode predicted from the others.
    separations : mapping of (found, alternative) labels to Separation
    """

    kind: ClassVar[str] = "modes"

    table: ModalTable
    before: tuple[Compared, ...]
    after: tuple[Compared, ...]
    validation_before: tuple[Compared, ...]
    validation_after: tuple[Compared, ...]
    left_out_before: float
    left_out_after: float
    separations: Mapping[tuple[str, str], Separation]

    def _distinct(self) -> int | None:
        poses = ([c.measured.log for c in self.after if c.pose == k] for k in {c.pose for c in self.after})
        gaps = (np.diff(np.sort(np.concatenate(logs))) for logs in poses)
        return sum(1 + int((gap > self.result.after.model_error).sum()) for gap in gaps)

    def separation(self, found: FoundChange, other: LikelihoodTrial) -> str:
        known = self.separations.get((found.change.label, other.change.label))
        return known.words if known else ""

    def as_json(self) -> dict[str, Any]:
        return {
            **self.json_of_all("modes"),
            "before": _errors_json(self.before, self.left_out_before, self.result.before, self.result.chance_before),
            "after": _errors_json(self.after, self.left_out_after, self.result.after, self.result.chance_after),
            "validation": {
                "before": {"log_frequency_rms": finite(error_rms(self.validation_before))},
                "after": {"log_frequency_rms": finite(error_rms(self.validation_after))},
            }
            if self.validation_before
            else None,
            "modes": [
                {
                    "pose": b.pose,
                    "list": b.measured.name,
                    "measured_hz": b.measured.hz.tolist(),
                    "std_hz": b.measured.std_hz.tolist(),
                    "before_hz": _partners(b),
                    "after_hz": _partners(a),
                }
                for b, a in zip(self.before, self.after, strict=True)
            ],
            "separate_by": [
                {"found": found, "alternative": other, "angles_deg": {j: float(np.rad2deg(a)) for j, a in s.angles.items()},
                 "list": s.measured, "hz_with_found": s.with_found, "hz_with_alternative": s.with_alternative}
                for (found, other), s in self.separations.items()
            ],
        }  # fmt: skip


def close_modal(
    table: ModalTable | str | os.PathLike[str],
    robot: Robot | str | None = None,
    *,
    model_error: float = MODEL_ERROR,
    new_std: float = NEW_STD,
    only: Sequence[str] = (),
    most: int = MOST_CHANGES,
    progress: Progress | None = None,
) -> ModalLoop:
    """Find what a robot lacks to have the modes of a table.

    Parameters
    ----------
    table : ModalTable or path
    robot : Robot or what `load_robot` takes; the table's own where not given.
    model_error : float
        Relative error of every frequency that is allowed for beside the stated standard deviations.
    new_std : float
        Prior standard deviation of the logarithm of a new stiffness about those declared of its kind.
    only : sequence of str
        Labels of changes to try (``base.base_flexibility``, ``joint_2.drive_stiffness``); all where empty.
    most : int
        Changes at the most.
    progress : callable, optional

    Raises
    ------
    ValueError
        A table that cannot be read, without a robot, or with joints that the robot does not have.
    """
    read = table if isinstance(table, ModalTable) else load_modal_table(table)
    if robot is None and read.robot is None:
        raise ValueError(f"{read.name}: robot is missing; name it in the table or give one")
    if not model_error > 0:
        raise ValueError(f"model_error is {model_error:g}; expected a relative error above 0, as {MODEL_ERROR:g}")
    if robot is None:
        with named_in(Path(read.name), "robot"):
            robot = load_robot(str(read.robot))
    source = load_robot(robot)
    fitted, held_out = read.role("identification"), read.role("validation")
    data = ModalResidual.of(source, read, fitted, model_error, new_std)
    if only:
        data.structure = data.structure.restricted(only)
    result = close_residual(data, progress, most)
    other = ModalResidual.of(source, read, held_out, model_error, new_std) if held_out else None
    separations = {
        (found.change.label, trial.change.label): separation
        for found in result.found
        for trial in found.alternatives
        if (separation := _separation(source, read, fitted[0], result.after, trial)) is not None
    }
    return ModalLoop(
        source, read.joints, data, result, read, data.compare(result.before), data.compare(result.after),
        other.compare(result.before) if other else (), other.compare(result.after) if other else (),
        data.left_out(result.before), data.left_out(result.after), separations,
    )  # fmt: skip


def _separation(
    robot: Robot, table: ModalTable, pose: ModalPose, found: LikelihoodFit, trial: LikelihoodTrial
) -> Separation | None:
    """The pose, of a few, where two explanations differ most in a mode of the band."""
    tree, turned = robot.tree, table.joints[1:3]
    reach = {}
    for joint in turned:
        i = tree.joints[tree.getJointId(joint)].idx_q
        low, high = tree.lowerPositionLimit[i], tree.upperPositionLimit[i]
        reach[joint] = [a for a in np.deg2rad(SEPARATING_DEG) if low <= a <= high]
    poses = [{**pose.angles, **dict(zip(turned, a, strict=True))} for a in itertools.product(*reach.values())]
    structure = Structure.of(robot, table.joints, [ModalPose(p, ()).drive_angles(robot) for p in poses], table.band_hz)
    found_at: list[tuple[float, Separation]] = []
    for k, angles in enumerate(poses):
        both = [structure.matrices(k, f.changes, f.x) for f in (found, trial.fit)]
        for locked in (None, *table.joints):
            a, b = (modes_of(structure, f.changes, m, locked)[0] for f, m in zip((found, trial.fit), both, strict=True))
            count = min(len(a), len(b))
            inside = a[:count] <= np.log(table.band_hz[1])
            if not inside.any():
                continue
            gap = np.where(inside, np.abs(a[:count] - b[:count]), 0.0)
            at = int(np.argmax(gap))
            name = list_name(locked)
            found_at.append((gap[at], Separation(angles, name, float(np.exp(a[at])), float(np.exp(b[at])))))
    return max(found_at, key=lambda x: x[0])[1] if found_at else None


def error_rms(compared: Iterable[Compared]) -> float:
    """Root mean square of the errors of all pairs, of the logarithm of frequency."""
    return rms(np.concatenate([*(c.errors for c in compared), np.zeros(0)]))


def in_order_rms(compared: Iterable[Compared]) -> float:
    """The same where the n-th measured mode is the model's n-th: no mode is left out, none is taken for another."""
    return rms(np.concatenate([*(c.in_order for c in compared), np.zeros(0)]))


def alone(compared: Iterable[Compared]) -> int:
    """Measured modes that the model has none for."""
    return sum(len(c.measured.hz) - len(c.pairing.measured) for c in compared)


def _errors_json(compared: tuple[Compared, ...], left_out: float, fit: LikelihoodFit, chance: float) -> dict[str, Any]:
    return {
        "log_frequency_rms": finite(error_rms(compared)),
        "log_frequency_rms_in_order": finite(in_order_rms(compared)),
        "log_frequency_rms_left_out": finite(left_out),
        "measured_without_partner": alone(compared),
        "model_modes_unseen": sum(c.pairing.unseen for c in compared),
        "model_error": fit.model_error,
        "p_value": chance,
    }


def _partners(compared: Compared) -> list[float | None]:
    out: list[float | None] = [None] * len(compared.measured.hz)
    for i, j in zip(compared.pairing.measured, compared.pairing.model, strict=True):
        out[i] = float(compared.model_hz[j])
    return out
