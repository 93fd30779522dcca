"""Readings of a campaign compared with each other, each worked out once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import optimize

from rx90b_flex.diagnose.faults.rigid_fit import (
    FLOOR,
    KNOWN,
    RIDGE,
    Products,
    RigidFit,
    columns_of,
    effects_of,
    solution,
)
from rx90b_flex.diagnose.faults.sample import Reading, Sample
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.robot import Robot
from rx90b_flex.signals.stated import FlangeLoad

KEPT = 3  # motions whose columns are kept: the present one, and those that a refinement goes back to
ENOUGH = 10.0  # times as many independent values of torques as columns
STEPS = 14  # of a refinement


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Something that may be wrong with the data, and how the log would then have to be read.

    Attributes
    ----------
    kind : str
        As in ``check.json``.
    signal : str or None
        Key of a campaign file, or ``all``.
    joints : tuple of str
    text : str
        A sentence with the cure; ``<factor>`` stands for the factor times `shown`.
    family : callable
        What would be right, by factor.
    factor : float or None
        What is stated over what is true; seconds for a shift.
    bounds : (low, high) or None
        Of the factor, where it is a number on a scale that can be refined.
    usable : bool
        Whether the data can be used all the same.
    shown : float
        Of the factor's unit in the text, such as degrees a radian.
    smallest : float
        Distance of the factor from `neutral` below which it is no fault.
    far : float
        Squared error of most of its joints with it, above which it is none either.
    neutral : float
        The factor at which nothing is wrong.
    grain : float
        Step of the factor below which nothing changes.
    by_links : bool
        Whether the factor goes by the URDF's links, too.
    evident : float
        What shows of it without a fit, as a gain.
    """

    kind: str
    signal: str | None
    joints: tuple[str, ...]
    text: str
    family: Callable[[float], Reading]
    factor: float | None = None
    bounds: tuple[float, float] | None = None
    usable: bool = False
    shown: float = 1.0
    smallest: float = 0.0
    far: float = np.inf
    neutral: float = 0.0
    grain: float = 0.0
    by_links: bool = True
    evident: float = 0.0

    @staticmethod
    def of(
        kind: str, signal: str | None, joints: tuple[str, ...], text: str, reading: Reading, factor: float | None = None
    ) -> Hypothesis:
        """With one reading that would be right."""
        return Hypothesis(kind, signal, joints, text, lambda _factor: reading, factor)

    @cached_property
    def reading(self) -> Reading:
        """What would be right."""
        return self.family(1.0 if self.factor is None else self.factor)

    @property
    def message(self) -> str:
        """The sentence with the factor in it."""
        return self.text if self.factor is None else self.text.replace("<factor>", f"{self.factor * self.shown:.3g}")


@dataclass(frozen=True, eq=False)
class Motors:
    """What brought a log's columns from the motors' side to the joints'.

    Attributes
    ----------
    gear : array, shape (joints, joints)
        Motor angles over joint angles.
    offset : array, shape (joints,)
    torques : bool
        Whether the torques' columns are the motors', too.
    """

    gear: Array
    offset: Array
    torques: bool


@dataclass(frozen=True, eq=False)
class Look:
    """A sample of a campaign and the reading that is taken as right so far."""

    sample: Sample
    reading: Reading
    limits: Array  # (2, joints), rad, as the URDF has them
    prismatic: tuple[bool, ...]
    motors: Motors | None = None  # where the log's columns are theirs
    with_effects: bool = False  # whether fits may have what could be missing in a joint's drive
    _columns: dict[tuple[object, ...], Array] = field(default_factory=dict, repr=False)
    _products: dict[tuple[object, ...], Products] = field(default_factory=dict, repr=False)
    robots: dict[tuple[object, ...], Robot] = field(default_factory=dict, repr=False)  # with edited URDFs
    ratios: dict[Reading, tuple[list[Hypothesis], list[Hypothesis]]] = field(default_factory=dict, repr=False)
    # what hypotheses gain at first sight beside a reading, without effects
    first_gains: dict[tuple[object, ...], float] = field(default_factory=dict, repr=False)

    def thinned(self, factor: int) -> Look:
        """The same look at every so many-th row."""
        return dataclasses.replace(self, sample=self.sample.thinned(factor), _columns={}, _products={}, ratios={})

    def stating(self, load: FlangeLoad | None, recordings: Collection[int]) -> Look:
        """The same look at recordings of which some state another payload."""
        sample = self.sample.stating(load, recordings)
        return dataclasses.replace(self, sample=sample, _columns={}, _products={}, first_gains={})

    @cached_property
    def beside(self) -> Look:
        """The same look with fits that may have what could be missing in a joint's drive."""
        return dataclasses.replace(self, with_effects=True, _columns={}, _products={}, ratios={})

    def tells(self) -> bool:
        """Whether the log has many more independent values of torques than its fits have columns."""
        values = self.sample.independent_rows * len(self.sample.joints)
        return values >= ENOUGH * self.columns(self.reading).shape[2]

    def columns(self, reading: Reading) -> Array:
        """Columns of a reading's motion, (R, joints, p)."""
        key = reading.motion_key
        if key not in self._columns:
            while len(self._columns) >= KEPT:
                del self._columns[next(iter(self._columns))]
            columns = columns_of(self.sample, reading)
            if self.with_effects:
                columns = np.concatenate([columns, effects_of(self.sample, reading)], axis=2)
            self._columns[key] = columns
        return self._columns[key]

    def products(self, reading: Reading) -> Products:
        """Normal equations of a reading."""
        key = (reading.motion_key, reading.torque_key)
        if key not in self._products:
            while len(self._products) >= KEPT:
                del self._products[next(iter(self._products))]
            self._products[key] = Products.of(self.sample, reading, self.columns(reading))
        return self._products[key]

    def fit(self, reading: Reading | None = None, near: RigidFit | None = None) -> RigidFit:
        """How well a reading does on rows it did not see, the present one where none is given; a first look where a fit is near."""
        reading = reading or self.reading
        return RigidFit.of(self.products(reading), reading, near=near)

    def measured(self) -> Array:
        """Torques as the present reading has them, zero where a row does not count, (R, joints), N m."""
        return self.sample.torque_seen(self.reading) * self.sample.left_seen(self.reading)

    def predicted(self) -> Array:
        """Torques that the fit of the present reading predicts, (R, joints), N m."""
        return np.asarray(self.columns(self.reading) @ self.fit().theta.mean(axis=0))

    @cached_property
    def theta_by_others(self) -> Array:
        """Parameters of the fit to all recordings but that of each row, with weights of the present fit's errors, (R, p)."""
        return self._theta_of(lambda own: ~own)

    @cached_property
    def predicted_by_others(self) -> Array:
        """Torques of each recording that the fit to all others predicts, (R, joints), N m."""
        return self._predicted(self.theta_by_others)

    @cached_property
    def predicted_by_own(self) -> Array:
        """The same of a fit to itself."""
        return self._predicted(self._theta_of(lambda own: own))

    def _predicted(self, theta: Array) -> Array:
        return np.asarray((self.columns(self.reading) @ theta[:, :, None])[:, :, 0])

    def _theta_of(self, chosen: Callable[[Mask], Mask]) -> Array:
        """Of fits to rows that each recording's own (R,) choose."""
        x, y, products = self.columns(self.reading), self.measured(), self.products(self.reading)
        error, out = self.fit().error + FLOOR, []
        for span in self.sample.spans:
            own = np.zeros(len(y), dtype=bool)
            own[span] = True
            rows = chosen(own)
            root = 1.0 / np.sqrt((y[rows].var(axis=0) + 1e-300) * error)
            flat = (x[rows] * root[:, None]).reshape(-1, x.shape[2])
            out.append(solution(flat.T @ flat, flat.T @ (y[rows] * root).ravel(), products))
        return self.sample.by_rows(out)

    def fit_of_known_links(self, reading: Reading | None = None, near: RigidFit | None = None) -> RigidFit:
        """The same with the links as the URDF has them: only friction, drives and offsets are fitted."""
        return self.fit_held(range((reading or self.reading).links), KNOWN, reading, near)

    def fit_of_free_links(self, reading: Reading | None = None) -> RigidFit:
        """The same with the links fitted, also where the robot file calls them known."""
        return self.fit_held(range((reading or self.reading).links), RIDGE, reading)

    def fit_held(
        self, columns: Sequence[int], ridge: float, reading: Reading | None = None, near: RigidFit | None = None
    ) -> RigidFit:
        """The same with some columns held by another ridge: `OUT` takes them out."""
        reading = reading or self.reading
        return RigidFit.of(self.products(reading).held(columns, ridge), reading, near=near)

    def errors_at_least(self) -> tuple[Array, Array]:
        """Squared errors of each joint over its torque's variance, held out and on the rows of the fit, each (joints,).

        With links that are free and what a spring or a coupling would explain: that much has to do with the motion.
        """
        free = self.products(self.reading).held(range(self.reading.links), RIDGE)
        fits = (self.fit(), RigidFit.of(free, self.reading), self.beside.fit_of_free_links())
        return np.min([f.error for f in fits], axis=0), RigidFit.of(free, self.reading, held_out=False).error

    def refined(self, hypothesis: Hypothesis, of_known: float = 0.0) -> tuple[Hypothesis, float | None]:
        """The factor at which a hypothesis does best, and its standard deviation from the score's curvature.

        `of_known` is the weight of the fit with the URDF's links beside that with free ones.
        """
        factor, bounds = hypothesis.factor, hypothesis.bounds
        if factor is None or bounds is None:
            return hypothesis, None
        scale = _Scale(bounds[0] * bounds[1] > 0, float(np.sign(bounds[0])) or 1.0)

        def score(y: float) -> float:
            reading = hypothesis.family(scale.back(y))
            known = of_known * self.fit_of_known_links(reading).score if of_known else 0.0
            return self.fit(reading).score + known

        low, high = sorted(scale.to(b) for b in bounds)
        found = optimize.minimize_scalar(
            score, bounds=(low, high), method="bounded", options={"maxiter": STEPS, "xatol": 1e-3 * (high - low)}
        )
        at = float(found.x) if found.fun < score(scale.to(factor)) else scale.to(factor)
        best = scale.back(at)
        step = max(0.02 * (high - low), hypothesis.grain)
        bend = (score(at + step) - 2 * score(at) + score(at - step)) / step**2
        std = float(1.0 / np.sqrt(max(0.5 * self.sample.independent_rows * bend, 1e-12)))
        std = min(std, 1.0) * abs(best) if scale.logarithmic else std
        return dataclasses.replace(hypothesis, factor=best), std


@dataclass(frozen=True)
class _Scale:
    """Factors of one sign on a log scale, others as they are."""

    logarithmic: bool
    sign: float

    def to(self, x: float) -> float:
        return float(np.log(self.sign * x)) if self.logarithmic else x

    def back(self, y: float) -> float:
        return float(self.sign * np.exp(y)) if self.logarithmic else y
