"""What a flexible robot lacks, from data over frequency: one search for modal tables and frequency responses.

A robot at rest in a pose is ``M, D, K``; each is a constant and a sum of coefficients times fixed matrices. One tree with every
hinge that could be there is linearised once a pose, and a hinge that a model does not have is a coordinate held at zero. A `Change`
multiplies coefficients, ``c = declared * exp(x)``, or brings an effect in with them; so trying one costs no new tree.

Two kinds of data compare models by one number, the deviance ``-2 log likelihood`` with a *model error*: a scatter of unknown size
beside the measured standard deviations, estimated with each model. What is tried is charged for its parameters and for the number of
other changes that might have been tried instead (extended BIC: J. Chen, Z. Chen, Biometrika 95, 2008).
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats
from scipy.special import gammaln

from rx90b_flex.effects import Effect, RestSites, RestSizes, catalogue, close_match
from rx90b_flex.effects.friction import friction_port
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.robot import Robot

SIGNIFICANCE = 1.0e-3  # of a change, after correction for all that was tried
PAIRS = 2  # changes that are tried with company where none is sure alone
MISFIT = 1.0e-3  # probability below which scatter beyond the stated errors is not called chance
RIVAL = 2.0 * np.log(20.0)  # criterion: a change whose odds against the best are better than 1 to 20 is an alternative
MOST_CHANGES = 6  # more than this describe the table rather than explain it
FIRST_ERROR = 0.25  # model error that a fit begins with: wide valleys
FACTOR_STD = 1.0  # of the logarithm: what a declared value may be wrong by
NEW_STD = 2.0  # of the logarithm of a new value, about those declared of its kind, else about what the band can show
SCOUTED = 8  # steps from each start, at the least, before the best are followed
STEPS = 60  # at the most
CLOSE = 20.0  # deviance: scouted starts and changes this near the best are followed to their end

Progress = Callable[[str, float], None]


# ---- what may be missing ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of an effect: which, and its value before any change."""

    effect: int
    column: int
    value: float


@dataclass(frozen=True, eq=False)
class Change:
    """One thing that a model may lack: an effect in a place, or other values of declared ones.

    Attributes
    ----------
    type : str
        Effect type.
    place : str
        Joint, frame, ``base``, or ``all``.
    adds : bool
        Whether it adds the effect; otherwise it multiplies declared values.
    names, units : tuple of str
        Of its parameters.
    moves : tuple of tuple of int
        Coefficients that each parameter multiplies.
    frees : tuple of str
        Coordinates that it adds.
    starts : array, shape (S, k)
        Logarithms of the parameters from which a fit begins, over the coefficients' values.
    usual : array, shape (k,)
        Centre of the prior of the logarithms.
    std : float
        Its standard deviation.
    """

    type: str
    place: str
    adds: bool
    names: tuple[str, ...]
    units: tuple[str, ...]
    moves: tuple[tuple[int, ...], ...]
    frees: tuple[str, ...]
    starts: Array
    usual: Array
    std: float

    @property
    def label(self) -> str:
        """As in ``joint_4.drive_flexibility`` for what is added, ``joint_2.drive_stiffness`` for what is changed."""
        return f"{self.place}.{self.type if self.adds else self.names[0]}"

    @property
    def words(self) -> str:
        """In a sentence."""
        kind = (self.type if self.adds else self.names[0]).replace("_", " ")
        where = "" if self.place == "base" else f" of {self.place.replace('_', ' ')}"
        return f"{kind}{where}" if self.adds else f"another {kind}{where}"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.moves)


@dataclass(frozen=True, eq=False)
class Pose:
    """Matrices of the tree with every hinge at one pose: ``X = constant + sum_i c_i pattern_i``."""

    angles: Array
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
                    f"a pose has shape {np.shape(pose)}; expected {len(robot.joints)} angles of {robot.name}"
                )
        full = robot.with_effects([*robot.effects, *_additions(robot, joints, poses[0])])
        coefficients = _coefficients(full, len(robot.effects))
        first = len(coefficients)
        coefficients += [Coefficient(-1, k, 30.0) for k in range(len(joints))]
        linear = [_pose(full, joints, np.asarray(q, dtype=float), coefficients) for q in poses]
        structure = Structure(robot, full, tuple(joints), tuple(coefficients), tuple(linear), ())
        return dataclasses.replace(structure, changes=tuple(_changes(structure, first, band_hz, new_std)))

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
            effects.append(effect.rescaled_to(values) if values else effect)
        return self.robot.with_effects(effects)


def _additions(robot: Robot, joints: Sequence[str], pose: Array) -> list[Effect]:
    """What could be there and is not declared, with values to be scaled."""
    declared = frozenset((e.type_name(), e.place) for e in robot.effects)
    angles = dict(zip(robot.joints, (float(q) for q in pose), strict=True))
    sites = RestSites(robot.joints, robot.tip_frame, tuple(j for j in robot.joints if j in joints), angles, declared)
    possible = (effect for cls in catalogue().values() for effect in cls.at_rest(sites))
    return [e for e in possible if (e.type_name(), e.place) not in declared]


def _coefficients(full: Robot, declared: int) -> list[Coefficient]:
    out = []
    for i, effect in enumerate(full.effects):
        if effect.scaled and (i >= declared or effect.rescaled):
            values = effect.known_coefficients()
            out += [Coefficient(i, k, float(values[k])) for k in sorted(itertools.chain(*effect.scaled))]
    return out


def _pose(full: Robot, joints: Sequence[str], angles: Array, coefficients: Sequence[Coefficient]) -> Pose:
    n, rest = full.model.nv, np.zeros(full.model.nv)
    motion = full.motion(full.input_matrix @ angles, rest, rest)
    patterns = np.zeros((3, len(coefficients), n, n))
    varied = {c.effect for c in coefficients}

    def of(derivatives: tuple[Array, Array, Array]) -> Array:
        by_q, by_v, by_a = derivatives
        return np.stack([by_a[0], by_v[0], by_q[0]])

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
        if i not in varied and effect.in_dynamics and effect.part != "friction":
            constant = constant + of(effect.derivatives(motion))
    return Pose(angles, constant, patterns)


def _changes(structure: Structure, first_slope: int, band_hz: tuple[float, float], new_std: float) -> list[Change]:
    """Every change that data over frequency can speak of."""
    full, declared = structure.full, len(structure.robot.effects)
    numbers = {(c.effect, c.column): i for i, c in enumerate(structure.coefficients[:first_slope])}
    total = float(structure.robot.link_parameters[::10].sum())
    sizes = RestSizes(full.layout, structure.poses[0].constant[0], total, band_hz)
    out: list[Change] = []
    shared: dict[str, list[int]] = {}
    for e in sorted({e for e, _ in numbers}):
        effect = full.effects[e]
        groups = tuple(tuple(numbers[e, k] for k in group) for group in effect.scaled)
        at = tuple(sorted(itertools.chain(*groups)))
        if e >= declared:
            out.append(_addition(structure.robot, effect, groups, sizes, new_std))
        elif effect.virtual or set(effect.joints) <= set(structure.joints):
            out.append(_factor(effect, _place(effect), tuple(i for i in at if _stiffens(structure, i))))
            if effect.virtual:
                shared.setdefault(effect.type_name(), []).append(e)
    for several in (s for s in shared.values() if len(s) > 1):
        at = tuple(i for (e, _), i in numbers.items() if e in several and _stiffens(structure, i))
        out.append(_factor(full.effects[several[0]], "all", at))
    return out


def _stiffens(structure: Structure, number: int) -> bool:
    """Whether a coefficient is not a damping: a softer hinge need not lose less."""
    c = structure.coefficients[number]
    virtual = structure.full.effects[c.effect].virtual
    return not virtual or c.column < len(virtual)


def _place(effect: Effect) -> str:
    return "_".join(effect.place) or "base"


def _addition(
    robot: Robot, effect: Effect, groups: tuple[tuple[int, ...], ...], sizes: RestSizes, std: float
) -> Change:
    single = len(groups) == 1
    names = tuple(effect.parameters())[:1] if single else effect.coefficient_names[: len(groups)]
    coordinates = tuple(f"{_place(effect)}:{v}" for v in effect.virtual)
    starts = np.log(effect.starts_at_rest(sizes))
    return Change(
        effect.type_name(), _place(effect), True, names, effect.coefficient_units[: len(groups)], groups, coordinates,
        starts, _usual(robot, effect.type_name(), starts), std,
    )  # fmt: skip


def _factor(effect: Effect, place: str, moved: tuple[int, ...]) -> Change:
    starts = np.log(np.array([[0.6], [1.6]]))
    return Change(
        effect.type_name(), place, False, (effect.rescaled,), effect.coefficient_units[:1], (moved,), (),
        starts, np.zeros(1), FACTOR_STD,
    )  # fmt: skip


def _usual(robot: Robot, kind: str, starts: Array) -> Array:
    """Logarithm of the values that a robot declares of an effect type; the middle of the starts where it declares none."""
    known = [e.coefficients[0] for e in robot.effects if e.type_name() == kind and e.virtual and e.coefficients[0] > 0]
    return np.full(starts.shape[1], np.log(known).mean()) if known else np.asarray(starts.mean(axis=0))


# ---- one model fitted to data ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class State:
    """What a residual says of one model at one x.

    Attributes
    ----------
    deviance : float
        -2 log likelihood, without a prior.
    gradient, information : array, (p,) and (p, p)
        Half its gradient by x, and the Gauss-Newton form of half its second derivative.
    model_error : float
        Most likely size of the model error for these residuals.
    """

    deviance: float
    gradient: Array
    information: Array
    model_error: float


@dataclass(frozen=True, eq=False)
class FlexibleFit:
    """A robot with some changes, fitted.

    Attributes
    ----------
    changes : tuple of Change
    x : array, shape (p,)
        Logarithms of the parameters of nuisances, then of changes, over the coefficients' values.
    covariance : array, shape (p, p)
    deviance : float
        With the prior's part.
    model_error : float
        What scatter is needed beside the stated errors; relative.
    """

    changes: tuple[Change, ...]
    x: Array
    covariance: Array
    deviance: float
    model_error: float


class Residual(ABC):
    """Data over frequency that models are held against."""

    structure: Structure
    nuisance: tuple[Change, ...] = ()  # in every model
    smallest_error: float  # of the model: stated, not estimated

    @property
    @abstractmethod
    def size(self) -> float:
        """Independent numbers in the data."""

    @abstractmethod
    def evaluate(self, changes: tuple[Change, ...], x: Array, model_error: float) -> State:
        """The deviance at x, nuisances first."""

    @abstractmethod
    def chance(self, fit: FlexibleFit) -> float:
        """Probability of a misfit as large as this one, if the model were right to within the stated errors."""

    def fit(
        self, changes: tuple[Change, ...], begin: dict[Change, Array] | None = None, error: float = FIRST_ERROR
    ) -> FlexibleFit:
        """Most likely values, from all starts of what has none in `begin`; the model error shrinks from `error`."""
        scouted = self.scouted(changes, begin, error)
        found = [self.followed(f) for f in scouted[:2] if f.deviance < scouted[0].deviance + CLOSE]
        return min(found, key=lambda f: f.deviance)

    def scouted(
        self, changes: tuple[Change, ...], begin: dict[Change, Array] | None, error: float
    ) -> list[FlexibleFit]:
        """From each start until a step gains little, best first."""
        known = begin or {}
        choices = [np.atleast_2d(known[c]) if c in known else c.starts for c in (*self.nuisance, *changes)]
        starts = [np.concatenate([*start, np.zeros(0)]) for start in itertools.product(*choices)]
        return sorted((self._descend(changes, x, error, SCOUTED) for x in starts), key=lambda f: f.deviance)

    def followed(self, fit: FlexibleFit) -> FlexibleFit:
        """A fit brought to its end."""
        return self._descend(fit.changes, fit.x, fit.model_error, STEPS)

    def _descend(self, changes: tuple[Change, ...], x: Array, error: float, least: int) -> FlexibleFit:
        """Levenberg-Marquardt on the deviance; the model error shrinks as the fit gets better.

        After `least` steps one that gains less than `CLOSE` is the last.
        """
        everything = (*self.nuisance, *changes)
        weight = np.concatenate([*(np.full(c.size, c.std**-2.0) for c in everything), np.zeros(0)])
        centre = np.concatenate([*(c.usual for c in everything), np.zeros(0)])

        def at(x: Array, error: float) -> tuple[State, float]:
            state = self.evaluate(everything, x, error)
            return state, state.deviance + float(weight @ (x - centre) ** 2)

        state, value = at(x, error)
        damping, gain = 1e-2, 0.0
        for count in range(1, STEPS + 1):
            # no faster than by halves: a small error too early fixes a wrong pairing of modes
            next_error = max(state.model_error, 0.5 * error)
            if abs(next_error - error) > 1e-3 * error:
                error = next_error
                state, value = at(x, error)
            gradient = state.gradient + weight * (x - centre)
            curvature = state.information + np.diag(weight)
            moved = False
            for _ in range(6):
                step = -np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
                step *= min(1.0, 1.0 / max(float(np.abs(step).max(initial=0.0)), 1e-12))
                other, other_value = at(x + step, error)
                if other_value < value:
                    gain = value - other_value
                    x, state, value, damping, moved = x + step, other, other_value, max(0.2 * damping, 1e-9), True
                    break
                damping *= 8.0
            else:
                damping = 1e-2
            settled = abs(max(state.model_error, 0.5 * error) - error) <= 1e-3 * error
            if settled and (not moved or gain < (1e-4 if count < least else CLOSE)):
                break
        curvature = state.information + np.diag(weight)
        covariance: Array = np.asarray(np.linalg.inv(curvature)) if len(x) else np.zeros((0, 0))
        return FlexibleFit(changes, x, covariance, value, error)

    def begin(self, fit: FlexibleFit) -> dict[Change, Array]:
        """A fit's values by change, to begin another from."""
        out, at = {}, 0
        for change in (*self.nuisance, *fit.changes):
            out[change] = fit.x[at : at + change.size]
            at += change.size
        return out


# ---- the search --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FlexibleTrial:
    """A change that was tried beside others.

    Attributes
    ----------
    change : Change
    fit : Fit
        With it.
    gain : float
        Drop of the deviance by it.
    p_value : float
        That it explains nothing, corrected for the number tried.
    criterion : float
        Extended BIC of the fit; lower is better.
    """

    change: Change
    fit: FlexibleFit
    gain: float
    p_value: float
    criterion: float


@dataclass(frozen=True, eq=False)
class FoundChange:
    """A change that the data support.

    Attributes
    ----------
    change : Change
    values, stds : array, shape (k,)
        Of its parameters: values of an added effect, factors on declared values.
    gain, p_value : float
        Against the final model without it.
    before, after : Fit
        Of the round in which it was added.
    criterion : float
        Extended BIC of the final model.
    alternatives : tuple of Trial
        Changes that in its stead do nearly as well: the data cannot tell them apart.
    """

    change: Change
    values: Array
    stds: Array
    gain: float
    p_value: float
    before: FlexibleFit
    after: FlexibleFit
    criterion: float
    alternatives: tuple[FlexibleTrial, ...]


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search over changes found.

    Attributes
    ----------
    before, after : Fit
        Of the declared robot, and of the robot with what was found.
    found : tuple of Found
        In the order in which they were added.
    refused : tuple of Trial
        Of the last round, best first.
    verdict : str
        ``nothing_missing``, ``explained``, ``partly_explained``, ``unexplained``.
    chance_before, chance_after : float
        Probability of such a misfit if the model were right to within the stated errors.
    tried : int
        Changes that a round may try.
    """

    before: FlexibleFit
    after: FlexibleFit
    found: tuple[FoundChange, ...]
    refused: tuple[FlexibleTrial, ...]
    verdict: str
    chance_before: float
    chance_after: float
    tried: int


def search(residual: Residual, progress: Progress | None = None, most: int = MOST_CHANGES) -> SearchResult:
    """Add the change that explains most, again and again; take out what a later one made needless.

    Parameters
    ----------
    residual : Residual
    progress : callable, optional
    most : int
        Changes at the most.
    """
    return _FlexibleSearch(residual, progress or (lambda text, part: None), most).run()


@dataclass(eq=False)
class _FlexibleSearch:
    residual: Residual
    tell: Progress
    most: int

    @property
    def _changes(self) -> tuple[Change, ...]:
        return self.residual.structure.changes

    def run(self) -> SearchResult:
        declared = self.residual.fit(())
        present: FlexibleFit = declared
        refused: tuple[FlexibleTrial, ...] = ()
        rounds: dict[Change, tuple[FlexibleFit, FlexibleFit]] = {}
        while len(present.changes) < self.most and self.residual.chance(present) < MISFIT:
            refused = tuple(self._round(present.changes, present))
            best = refused[0]
            if best.p_value <= SIGNIFICANCE and best.criterion <= self._criterion(present):
                rounds[best.change] = (present, best.fit)
                present, refused = self._pruned(best.fit), ()
                continue
            two = self._two_together(present, refused)
            if two is None:
                break
            first, second = two
            rounds |= {first.change: (present, first.fit), second.change: (first.fit, second.fit)}
            present, refused = second.fit, ()
        present = self._pruned(self._swapped(present, rounds))
        found = tuple(self._found(present, change, rounds) for change in present.changes)
        chance = self.residual.chance(present)
        return SearchResult(
            declared, present, found, refused, _verdict(bool(found), chance),
            self.residual.chance(declared), chance, len(self._changes),
        )  # fmt: skip

    def _two_together(
        self, present: FlexibleFit, trials: Sequence[FlexibleTrial]
    ) -> tuple[FlexibleTrial, FlexibleTrial] | None:
        """Two changes of which none is sure alone, each needed beside the other; None where no two are sure together."""
        many = len(self._changes)
        for first in [t for t in trials[:PAIRS] if t.criterion < self._criterion(present)]:
            second = self._round(first.fit.changes, first.fit)[0]
            size = first.change.size + second.change.size
            p_value = 0.5 * many * (many - 1) * self._by_chance(first.gain + second.gain, size, second.fit)
            worth = p_value <= SIGNIFICANCE and second.criterion < first.criterion
            if worth and self._pruned(second.fit) is second.fit:
                return first, second
        return None

    def _round(self, kept: tuple[Change, ...], beside: FlexibleFit) -> list[FlexibleTrial]:
        """Try every change beside `kept`, whose values begin near those of a fit."""
        key = frozenset(kept)
        if key not in self._rounds:
            base = self._refit(kept, beside)
            begin, error = self.residual.begin(base), min(FIRST_ERROR, 3.0 * base.model_error)
            candidates, fits = [c for c in self._changes if c not in kept], []
            for i, change in enumerate(candidates):
                self.tell(f"{len(kept) + 1}: {change.label}", min(0.9, (len(kept) + i / len(candidates)) / self.most))
                fits += self.residual.scouted((*kept, change), begin, error)[:2]
            near = min(f.deviance for f in fits) + CLOSE
            fits = [self.residual.followed(f) if f.deviance < near else f for f in fits]
            best = {f.changes[-1]: f for f in sorted(fits, key=lambda f: -f.deviance)}
            trials = [self._trial(change, base, best[change]) for change in candidates]
            self._rounds[key] = sorted(trials, key=lambda t: t.criterion)
        return self._rounds[key]

    def _trial(self, change: Change, without: FlexibleFit, fit: FlexibleFit) -> FlexibleTrial:
        gain = without.deviance - fit.deviance
        p_value = min(1.0, len(self._changes) * self._by_chance(gain, change.size, fit))
        return FlexibleTrial(change, fit, gain, p_value, self._criterion(fit))

    def _by_chance(self, gain: float, size: int, fit: FlexibleFit) -> float:
        """Probability of such a gain by parameters that mean nothing."""
        # a likelihood ratio of few data is too large: charge it for the parameters already fitted
        fair = max(1.0 - (len(fit.x) + 1) / self.residual.size, 0.1)
        return float(stats.chi2.sf(max(fair * gain, 0.0), size))

    def _criterion(self, fit: FlexibleFit) -> float:
        chosen, many = len(fit.changes), len(self._changes)
        ways = gammaln(many + 1) - gammaln(chosen + 1) - gammaln(many - chosen + 1)
        return fit.deviance + len(fit.x) * np.log(self.residual.size) + 2.0 * float(ways)

    def _refit(self, changes: tuple[Change, ...], near: FlexibleFit) -> FlexibleFit:
        if changes == near.changes:
            return near
        return self.residual.fit(changes, self.residual.begin(near))

    def _pruned(self, present: FlexibleFit) -> FlexibleFit:
        """Without what the rest can do without."""
        while len(present.changes) > 1:
            trials = []
            for change in present.changes:
                less = self._refit(tuple(c for c in present.changes if c is not change), present)
                trials.append((self._trial(change, less, present), less))
            trial, less = max(trials, key=lambda pair: pair[0].p_value)
            if trial.p_value < SIGNIFICANCE and trial.criterion < self._criterion(less):
                break
            present = less
        return present

    def _swapped(self, present: FlexibleFit, rounds: dict[Change, tuple[FlexibleFit, FlexibleFit]]) -> FlexibleFit:
        """Each change against every other in its stead; the better one stays."""
        for old in present.changes:
            kept = tuple(c for c in present.changes if c is not old)
            trials = self._beside[old] = [t for t in self._round(kept, present) if t.change is not old]
            if trials[0].criterion < self._criterion(present):
                rounds[trials[0].change] = (rounds[old][0], trials[0].fit)
                return self._swapped(trials[0].fit, rounds)
        return present

    @cached_property
    def _rounds(self) -> dict[frozenset[Change], list[FlexibleTrial]]:
        return {}

    @cached_property
    def _beside(self) -> dict[Change, list[FlexibleTrial]]:
        return {}

    def _found(
        self, present: FlexibleFit, change: Change, rounds: dict[Change, tuple[FlexibleFit, FlexibleFit]]
    ) -> FoundChange:
        kept = tuple(c for c in present.changes if c is not change)
        trial = self._trial(change, self._refit(kept, present), present)
        near = [t for t in self._beside[change] if t.criterion < trial.criterion + RIVAL]
        at = sum(c.size for c in (*self.residual.nuisance, *present.changes[: present.changes.index(change)]))
        own = slice(at, at + change.size)
        value = np.exp(present.x[own])
        std = value * np.sqrt(np.diag(present.covariance)[own])
        return FoundChange(change, value, std, trial.gain, trial.p_value, *rounds[change], trial.criterion, tuple(near))


def _verdict(found: bool, chance: float) -> str:
    if chance >= MISFIT:
        return "explained" if found else "nothing_missing"
    return "partly_explained" if found else "unexplained"
