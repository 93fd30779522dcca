"""A flexible robot at rest with all that it might lack: what modal tables and frequency responses are held against.

A robot at rest in a pose is ``M, D, K``; each is a constant and a sum of coefficients times fixed matrices. One tree with every
hinge that could be there is linearised once a pose, and a hinge that a model does not have is a coordinate held at zero. A `Change`
multiplies coefficients, ``c = declared * exp(x)``, or brings an effect in with them; so trying one costs no new tree.
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.diagnose.likelihood import RIVAL, Change, FoundChange, LikelihoodResidual, LikelihoodTrial, SearchResult
from rx90b_flex.effects import Effect, RestSites, RestSizes, catalogue, close_match
from rx90b_flex.effects.at_rest import ShownAtRest, undeclared_at_rest
from rx90b_flex.effects.friction import friction_port
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.robot import Robot

SCHEMA = 1
UNUSUAL = 10.0  # factor from declared stiffnesses of its kind beyond which a new hinge's is called unusual
FEW_MODES = 6.0  # data for each fitted parameter below which a fit says little
FACTOR_STD = 1.0  # of the logarithm: what a declared value may be wrong by
NEW_STD = 2.0  # of the logarithm of a new value, about those declared of its kind, else about what the band can show


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of an effect: which, and its value before any change."""

    effect: int
    column: int
    value: float


@dataclass(frozen=True, eq=False)
class Pose:
    """Matrices of the tree with every hinge at one pose: ``X = constant + sum_i c_i pattern_i``."""

    constant: Array  # (3, n, n): M, D, K
    patterns: Array  # (3, coefficients, n, n)


@dataclass(frozen=True, eq=False)
class Structure:
    """A robot with every hinge and spring that it might have, at the poses of some data.

    Attributes
    ----------
    robot : Robot
        As declared.
    full : Robot
        With every effect that a change may add.
    joints : tuple of str
        Whose drives move; the others are held by their brakes, controllers or friction.
    coefficients : tuple of Coefficient
        Friction slopes of `joints` last, with effect -1.
    poses : tuple of Pose
    changes : tuple of Change
        All that may be tried.
    """

    robot: Robot
    full: Robot
    joints: tuple[str, ...]
    coefficients: tuple[Coefficient, ...]
    poses: tuple[Pose, ...]
    changes: tuple[Change, ...]

    @staticmethod
    def of(
        robot: Robot,
        joints: Sequence[str],
        poses: Sequence[Array],
        band_hz: tuple[float, float],
        new_std: float = NEW_STD,
    ) -> Structure:
        """Linearise a robot, with all that it might lack, at poses of its drives (rad, in the order of its joints).

        ``new_std`` is the prior standard deviation of the logarithm of a new value.

        Raises
        ------
        ValueError
            An unknown joint, a pose of another number of joints, an effect without a value.
        """
        for joint in joints:
            if joint not in robot.joints:
                raise ValueError(f"unknown joint {joint!r} of {robot.name}; {close_match(joint, robot.joints)}")
        for pose in poses:
            if np.shape(pose) != (len(robot.joints),):
                raise ValueError(
                    f"a pose of the data has {np.size(pose)} angles, {robot.name} has {len(robot.joints)} joints: is it their robot?"
                )
        additions = _additions(robot, joints, poses[0])
        full = robot.with_effects([*robot.effects, *additions])
        coefficients = _coefficients(full, len(robot.effects))
        first = len(coefficients)
        coefficients += [Coefficient(-1, k, 30.0) for k in range(len(joints))]
        linear = [_pose(full, joints, np.asarray(q, dtype=float), coefficients) for q in poses]
        structure = Structure(robot, full, tuple(joints), tuple(coefficients), tuple(linear), ())
        return dataclasses.replace(structure, changes=tuple(_changes(structure, additions, first, band_hz, new_std)))

    def restricted(self, only: Sequence[str]) -> Structure:
        """With some of the changes, by their labels."""
        labels = [c.label for c in self.changes]
        for label in only:
            if label not in labels:
                raise ValueError(f"only: no change {label!r} of {self.robot.name}; {close_match(label, labels)}")
        return dataclasses.replace(self, changes=tuple(c for c in self.changes if c.label in only))

    @cached_property
    def declared(self) -> Array:
        """Values of the coefficients, shape (c,)."""
        return np.array([c.value for c in self.coefficients])

    @cached_property
    def _always(self) -> Array:
        return np.array([c.effect < len(self.robot.effects) for c in self.coefficients])

    def free(self, changes: Sequence[Change], locked: str | None = None) -> Indices:
        """Coordinates that move: declared hinges, those that changes add, and drives but a locked one."""
        moving = [j for j in self.joints if j != locked]
        names = {*self.robot.coordinates, *(c for change in changes for c in change.frees)}
        names -= {f"{j}:drive" for j in self.robot.joints if j not in moving}
        return np.flatnonzero([c in names for c in self.full.coordinates])

    def stiffens(self, number: int) -> bool:
        """Whether a coefficient is not a damping: a softer hinge need not lose less."""
        c = self.coefficients[number]
        virtual = self.full.effects[c.effect].traits.virtual
        return not virtual or c.column < len(virtual)

    def drives(self, free: Indices) -> Array:
        """B of the measured joints on the free coordinates, shape (free, joints)."""
        return self.full.input_matrix[free][:, [self.robot.joints.index(j) for j in self.joints]]

    def values(self, changes: Sequence[Change], x: Array) -> tuple[Array, Array]:
        """Coefficients (c,), zero where not in the model, and their derivatives by x, (c, p)."""
        present, power = self._always.copy(), np.zeros((len(self.coefficients), len(x)))
        at = 0
        for change in changes:
            for moved in change.moves:
                power[list(moved), at] = 1.0
                at += 1
                if change.adds:
                    present[list(moved)] = True
        c = np.where(present, self.declared * np.exp(power @ x), 0.0)
        return c, c[:, None] * power

    def matrices(self, pose: int, changes: Sequence[Change], x: Array) -> tuple[Array, Array]:
        """M, D, K of all coordinates at one pose, (3, n, n), and their derivatives by x, (p, 3, n, n)."""
        c, by_x = self.values(changes, x)
        here = self.poses[pose]
        derivatives = np.zeros((len(x), *here.constant.shape))
        for out, column in zip(derivatives, by_x.T, strict=True):
            for i in np.flatnonzero(column):
                out += column[i] * here.patterns[:, i]
        used = np.flatnonzero(c)
        return here.constant + np.tensordot(here.patterns[:, used], c[used], axes=(1, 0)), derivatives

    def changed(self, changes: Sequence[Change], x: Array) -> Robot:
        """The robot with changes made, as it can be saved."""
        c, _ = self.values(changes, x)
        by_effect: dict[int, dict[int, float]] = {}
        for coefficient, value in zip(self.coefficients, c, strict=True):
            by_effect.setdefault(coefficient.effect, {})[coefficient.column] = float(value)
        effects: list[Effect] = []
        for i, effect in enumerate(self.full.effects):
            values = by_effect.get(i, {})
            if i >= len(self.robot.effects) and not any(values.values()):
                continue
            if values:
                own = effect.coefficients
                own[list(values)] = list(values.values())
                effect = effect.with_coefficients(own)
            effects.append(effect)
        return self.robot.with_effects(effects)


def _additions(robot: Robot, joints: Sequence[str], pose: Array) -> list[ShownAtRest]:
    """What could be there and is not declared, with values to be scaled."""
    declared = frozenset((e.type_name(), e.place) for e in robot.effects)
    angles = dict(zip(robot.joints, (float(q) for q in pose), strict=True))
    moving = tuple(j for j in robot.joints if j in joints)
    return undeclared_at_rest(catalogue().values(), RestSites(robot.joints, robot.tip_frame, moving, angles, declared))


def _coefficients(full: Robot, declared: int) -> list[Coefficient]:
    out = []
    for i, effect in enumerate(full.effects):
        if effect.traits.scaled and (i >= declared or effect.traits.rescaled):
            values = effect.known_coefficients()
            out += [Coefficient(i, k, float(values[k])) for k in sorted(itertools.chain(*effect.traits.scaled))]
    return out


def _pose(full: Robot, joints: Sequence[str], angles: Array, coefficients: Sequence[Coefficient]) -> Pose:
    n, rest = full.model.nv, np.zeros(full.model.nv)
    motion = full.motion(full.input_matrix @ angles, rest, rest)
    patterns = np.zeros((3, len(coefficients), n, n))
    varied = {c.effect for c in coefficients}

    def of(derivatives: tuple[Array, Array, Array]) -> Array:
        return np.stack([by[0] for by in reversed(derivatives)])

    for i, c in enumerate(coefficients):
        if c.effect < 0:
            port = friction_port(full.effects, full.layout, joints[c.column])
            patterns[1, i] = np.outer(port, port)
        else:
            effect = full.effects[c.effect]
            patterns[:, i] = of(
                effect.with_coefficients(np.eye(len(effect.coefficients))[c.column]).derivatives(motion)
            )
    constant = of(motion.on_tree.derivatives())
    for i, effect in enumerate(full.effects):
        if i not in varied and effect.traits.in_dynamics and not effect.traits.is_friction:
            constant = constant + of(effect.derivatives(motion))
    return Pose(constant, patterns)


def _changes(
    structure: Structure,
    additions: Sequence[ShownAtRest],
    first_slope: int,
    band_hz: tuple[float, float],
    new_std: float,
) -> list[Change]:
    """Every change that data over frequency can speak of."""
    full, declared = structure.full, len(structure.robot.effects)
    numbers = {(c.effect, c.column): i for i, c in enumerate(structure.coefficients[:first_slope])}
    total = float(structure.robot.link_parameters[::10].sum())
    sizes = RestSizes(full.layout, structure.poses[0].constant[0], total, band_hz)
    out: list[Change] = []
    shared: dict[str, list[int]] = {}
    for e in sorted({e for e, _ in numbers}):
        effect = full.effects[e]
        groups = tuple(tuple(numbers[e, k] for k in group) for group in effect.traits.scaled)
        at = tuple(sorted(itertools.chain(*groups)))
        if e >= declared:
            out.append(_addition(structure.robot, additions[e - declared], groups, sizes, new_std))
        elif effect.traits.virtual or set(effect.joints) <= set(structure.joints):
            out.append(_factor(structure.robot, effect, _place(effect), tuple(i for i in at if structure.stiffens(i))))
            if effect.traits.virtual:
                shared.setdefault(effect.type_name(), []).append(e)
    for several in (s for s in shared.values() if len(s) > 1):
        at = tuple(i for (e, _), i in numbers.items() if e in several and structure.stiffens(i))
        out.append(_factor(structure.robot, full.effects[several[0]], "all", at))
    return out


def _place(effect: Effect) -> str:
    return "_".join(effect.place) or "base"


def _addition(
    robot: Robot, effect: ShownAtRest, groups: tuple[tuple[int, ...], ...], sizes: RestSizes, std: float
) -> Change:
    single = len(groups) == 1
    coefficients, units = tuple(effect.coefficient_parameters), _units(robot, effect)
    names = tuple(effect.parameters())[:1] if single else coefficients[: len(groups)]
    coordinates = tuple(f"{_place(effect)}:{v}" for v in effect.traits.virtual)
    starts = np.log(effect.starts_at_rest(sizes))
    alike = Change(
        effect.type_name(), _place(effect), True, names, units[: len(groups)],
        starts, _usual(robot, effect.type_name(), starts), std, groups, coordinates,
    )  # fmt: skip
    if not single or len(effect.traits.virtual) != 2:
        return alike
    first = min(groups[0])
    return _unlike(alike, coefficients[:2], ((first, first + 2), (first + 1, first + 3)))


def _units(robot: Robot, effect: Effect) -> tuple[str, ...]:
    return tuple(robot.unit_of(effect, p.unit) for p in effect.coefficient_parameters.values())


def _factor(robot: Robot, effect: Effect, place: str, moved: tuple[int, ...]) -> Change:
    starts = np.log(np.array([[0.6], [1.6]]))
    alike = Change(
        effect.type_name(), place, False, (effect.traits.rescaled,), _units(robot, effect)[:1],
        starts, np.zeros(1), FACTOR_STD, (moved,),
    )  # fmt: skip
    if len(effect.traits.virtual) != 2 or len(moved) != 2:
        return alike
    return _unlike(alike, (f"{effect.traits.rescaled}_1", f"{effect.traits.rescaled}_2"), ((moved[0],), (moved[1],)))


def _unlike(alike: Change, names: tuple[str, ...], moves: tuple[tuple[int, ...], ...]) -> Change:
    """A change of two hinges, with the same of each for itself, where that is more than an alternative."""
    apart = dataclasses.replace(
        alike, names=names, units=alike.units * 2, moves=moves,
        starts=np.repeat(alike.starts, 2, axis=1), usual=np.repeat(alike.usual, 2), charge=RIVAL,
    )  # fmt: skip
    return dataclasses.replace(alike, unlike=apart)


def _usual(robot: Robot, kind: str, starts: Array) -> Array:
    """Logarithm of the values that a robot declares of an effect type; the middle of the starts where it declares none."""
    known = [
        e.coefficients[0] for e in robot.effects if e.type_name() == kind and e.traits.virtual and e.coefficients[0] > 0
    ]
    return np.full(starts.shape[1], np.log(known).mean()) if known else np.asarray(starts.mean(axis=0))


class FlexibleResidual(LikelihoodResidual):
    """Data of a robot at rest in poses."""

    structure: Structure

    @property
    def changes(self) -> tuple[Change, ...]:
        return self.structure.changes


@dataclass(frozen=True, eq=False)
class FlexibleLoop(ABC):
    """The loop closed on data of a robot at rest in poses.

    Attributes
    ----------
    source : Robot
        As declared.
    joints : tuple of str
        Whose drives moved.
    residual : FlexibleResidual
    result : SearchResult
    """

    kind: ClassVar[str]  # of data, in the plural

    source: Robot
    joints: tuple[str, ...]
    residual: FlexibleResidual
    result: SearchResult

    @property
    def verdict(self) -> str:
        """``nothing_missing``, ``explained``, ``partly_explained`` or ``unexplained``."""
        return self.result.verdict

    @property
    def found(self) -> tuple[FoundChange, ...]:
        """What the data support, in the order in which it was added."""
        return self.result.found

    @property
    def structure(self) -> Structure:
        """The robot with all that it might have."""
        return self.residual.structure

    @cached_property
    def robot(self) -> Robot:
        """The robot with what was found."""
        return self.structure.changed((*self.residual.nuisance, *self.result.after.changes), self.result.after.x)

    def doubts(self) -> list[str]:
        """What limits how sure this is, in sentences."""
        out = []
        after = self.result.after
        if self.verdict in ("partly_explained", "unexplained"):
            out.append(
                f"A scatter of {100 * after.model_error:.2g} % is left, where the stated model error is "
                f"{100 * self.residual.smallest_error:.2g} %: something is still wrong or missing in the model."
            )
        if len(self.structure.poses) == 1 and self.found:
            out.append("One pose only: another cause may act alike there. A second pose would test what was found.")
        per = self.residual.size / max(len(after.x), 1)
        if len(after.x) and per < FEW_MODES:
            out.append(f"{self.residual.size:.0f} independent numbers for {len(after.x)} parameters.")
        distinct = self._distinct()
        if self.found and distinct is not None and distinct < 0.7 * self.residual.size:
            out.append(
                f"The {self.residual.size:.0f} modes lie at {distinct} frequencies, apart by more than the scatter that is left: "
                "a resonance and the antiresonances beside it share their error, and the chances given here take them as independent."
            )
        for found in self.found:
            factor = float(np.exp(np.log(found.values) - found.change.usual).mean())
            hinge = found.change.adds and any(
                e.type_name() == found.change.type and e.traits.virtual for e in self.source.effects
            )
            if hinge and not 1 / UNUSUAL < factor < UNUSUAL:
                size = f"{1 / factor:.0f} times softer" if factor < 1 else f"{factor:.0f} times stiffer"
                out.append(
                    f"The {found.change.words} comes out {size} than the declared ones of its kind. A frequency tells a "
                    "stiffness over an inertia only: it is off by as much as the inertia behind the hinge."
                )
            if found.alternatives:
                others = ", ".join(t.change.words for t in found.alternatives)
                out.append(f"Instead of {found.change.words} the data allow: {others}.")
        return out

    def _distinct(self) -> int | None:
        """How many groups of modes the data hold, apart by more than the scatter; None where it is no list of modes."""
        return None

    def separation(self, found: FoundChange, other: LikelihoodTrial) -> str:
        """What would tell a found change from an alternative, in a sentence; empty where that is not known."""
        return ""

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """The content of ``closed_loop.json``."""

    def json_of_all(self, residual: str) -> dict[str, Any]:
        """What that says whatever the data."""
        return {
            "schema": SCHEMA,
            "residual": residual,
            "robot": self.source.name,
            "joints": list(self.joints),
            **self.result.as_json(),
            "doubts": self.doubts(),
        }
