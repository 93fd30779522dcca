"""Weighted least squares over base parameters, with shape parameters by variable projection."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.effects.stand_in import as_in_files
from rx90b_flex.identify import near_tree
from rx90b_flex.identify.coloured import Spectrum
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.first_shapes import begun, with_starts, without_value
from rx90b_flex.identify.normal_equations import (
    NormalEquations,
    Solution,
    coefficients,
    fit_weighted,
    squares_held_out,
    squares_left,
)
from rx90b_flex.identify.penalty import prior_precision, smoothed
from rx90b_flex.identify.reach import widened
from rx90b_flex.identify.regression import Pair, Regression
from rx90b_flex.identify.shapes import Shapes
from rx90b_flex.identify.uncertainty import Uncertainty, absorbed_each
from rx90b_flex.levenberg import ROUNDING, Iterate, lowest
from rx90b_flex.robot import LINK_PARAMETERS, LINK_UNITS

MOST_CIRCLES = 12  # of such fits where shapes are fitted with them
SAME_MISFIT = 1.0e-4  # change of the sum of the residuals' logarithms below which a fit has settled
TWISTS = 2.0e-3  # of the torque: drives that take so much are fitted together with the links behind them
# Of what the data say of a coefficient, were all torque noise, that holds a combination which is left to others at zero: about as
# much as they say with a hundredth of it left.
HELD = 1e4
LARGEST = 10.0  # of a joint's torque, root mean square: a curve's standard deviation before the data
BENT = 0.05  # of the torque: with so much left over, links that were fitted to it are far off
CIRCULAR_ROUNDS = 4  # fits of effects whose columns depend on the model that they are part of
MULTIPLIED_ROUNDS = 12  # with gains among them, which the links must follow
SMALLEST_FACTOR = 0.02  # of a torque gain during a fit
DIFFERENCE = 1.0e-3  # step of difference quotients by a shape parameter, part of its value
SETTLED = 1.0e-5  # part of the squares below which another step is not worth while
BEYOND = 2.0  # standard deviations beyond its bound that put a coefficient where it cannot be
CORRELATION_S = 1.0  # longest correlation of a residual that covariances allow for


@dataclass(frozen=True)
class Estimate:
    """One identified parameter; value and std are None where the data does not determine it."""

    name: str
    value: float | None
    std: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Identification:
    """An identified model.

    Attributes
    ----------
    effects : tuple of Effect
        With their identified values.
    link_parameters : array, shape (10 * bodies,)
        Identified, or the known ones.
    theta : array, shape (p,)
        Coefficients in the order of the columns: links (if fitted), then effects.
    uncertainty : Uncertainty
        Of theta and the shape parameters.
    solution : Solution
    residual : array, shape (N, rows)
        Torque left over on the data of the fit, N m.
    regression : Regression
        The data of the fit, seen by the identified links.
    derivatives : ColumnsByJoint
        Of the torque by theta and by the shape parameters, in p + s places.
    links_fitted : bool
    shapes : Shapes
        Where the effects' shape parameters stand among the s.
    links_near : float
        Strength with which links were kept near the tree's values (`near_tree`).
    fit : _Fit or None
        What it ended with, to be asked how far shapes may be off; None where no effect's would tell more than the covariance.
    """

    effects: tuple[Effect, ...]
    link_parameters: Array
    theta: Array
    uncertainty: Uncertainty
    solution: Solution
    residual: Array
    regression: Regression
    derivatives: ColumnsByJoint
    links_fitted: bool
    shapes: Shapes
    links_near: float = 0.0
    fit: _Fit | None = field(default=None, repr=False)

    @property
    def columns(self) -> Array:
        """Columns of theta, shape (N, joints, p)."""
        size = len(self.theta)
        return self.derivatives.kept(np.arange(size), size + len(self.shapes)).dense(size)

    @property
    def covariance(self) -> Array:
        """Of theta and the shape parameters, allowing for coloured residuals, shape (p + s, p + s)."""
        return self.uncertainty.covariance

    @property
    def spectra(self) -> tuple[Spectrum, ...]:
        """Of the residual, one a row: motors, then torque sensors."""
        return self.uncertainty.spectra

    @cached_property
    def absorbed(self) -> list[Array]:
        """What the fit took out of each joint's noise (`absorbed_by_fit`)."""
        if len(self.uncertainty.free) == self.uncertainty.size:
            return self.uncertainty.absorbed
        regression, weight = self.regression, self.solution.sigma**-2.0
        longest = int(CORRELATION_S * regression.segments[0].rate_hz)
        return absorbed_each(self.derivatives, self.precision, weight, regression.spans, longest)

    @property
    def relative_error(self) -> float:
        """Norm of the residual over the norm of the torque, all joints and samples."""
        return float(np.linalg.norm(self.residual) / np.linalg.norm(self.regression.torque))

    def residual_on(self, regression: Regression) -> Array:
        """Torque left over on other data, shape (N, joints), N m."""
        seen = regression.with_model(self.link_parameters, self.effects)
        torque = seen.torque - seen.link_torque(self.link_parameters)
        for effect in self.effects:
            torque = torque - seen.columns(effect) @ effect.known_coefficients()
        return torque

    @property
    def in_tree(self) -> tuple[Effect, ...]:
        """The effects as a robot file has them."""
        return as_in_files(self.effects, self.regression.segments[0].motion)

    @property
    def precision(self) -> Array:
        """Inverse covariance of theta and the shape parameters before the data, (p + s, p + s): penalties, else zero."""
        out = np.zeros((len(self.theta) + len(self.shapes),) * 2)
        out[: len(self.theta), : len(self.theta)] = _with_links(self.effects, self._own_links, self.links_near)
        held = self.shapes.precision(self.shapes.values(self.effects))
        return out + np.diag(np.concatenate([np.zeros(len(self.theta)), held]))

    @property
    def _own_links(self) -> Array:
        """The tree's values of the links that are fitted, (links,)."""
        return self.regression.robot.link_parameters if self.links_fitted else np.zeros(0)

    @property
    def centre(self) -> Array:
        """What `precision` pulls to, (p + s,)."""
        return near_tree.pulled_to(self._own_links, self.links_near, len(self.theta) + len(self.shapes))

    @property
    def information(self) -> Array:
        """Weighted Gram matrix of all coefficients with the effects' penalties, shape (p, p).

        Without what keeps links near the tree: bodies that are made possible go where the data are harmed least.
        """
        size = len(self.theta)
        whole = self.derivatives.gram(self.solution.sigma**-2.0, size + len(self.shapes))
        return whole[:size, :size] + _with_links(self.effects, self._own_links, 0.0)

    def with_rest(self, change: Array) -> tuple[Effect, ...]:
        """The effects with their coefficients changed; shape (p - links,)."""
        out = []
        for i, effect in enumerate(self.effects):
            first = self.first_column(i)
            k = len(effect.coefficients)
            at = first - self.first_column(0)
            out.append(effect.with_coefficients(self.theta[first : first + k] + change[at : at + k]))
        return tuple(out)

    def impossible(self) -> tuple[Effect, ...]:
        """Effects of one coefficient which the data puts beyond what it can be, by more than chance explains."""
        out = []
        for i, effect in enumerate(self.effects):
            if len(effect.coefficient_parameters) == 1:
                (parameter,) = effect.coefficient_parameters.values()
                at = self.first_column(i)
                if not (self.solution.determined[at] and self.theta[at] < parameter.lower):
                    continue  # before its covariance is asked for, which takes long to work out
                if self.theta[at] < parameter.lower - BEYOND * np.sqrt(max(self.covariance[at, at], 0.0)):
                    out.append(effect)
        return tuple(out)

    @property
    def coefficient_names(self) -> list[str]:
        """Names of theta."""
        bodies = self.regression.robot.bodies if self.links_fitted else ()
        links = [f"{link}.{name}" for link, _ in bodies for name in LINK_PARAMETERS]
        return links + [f"{e.label}.{name}" for e in self.effects for name in e.coefficient_parameters]

    def first_column(self, index: int) -> int:
        """Place in theta of the first coefficient of an effect."""
        links = len(self.link_parameters) if self.links_fitted else 0
        return links + sum(len(e.coefficients) for e in self.effects[:index])

    def estimates(self, index: int) -> tuple[Estimate, ...]:
        """Public parameters of one effect with standard deviations (delta method)."""
        effect = self.effects[index]
        first = self.first_column(index)
        k = len(effect.coefficients)
        of_shapes = self.shapes.places[index]
        places = np.r_[first : first + k, len(self.theta) + of_shapes]
        at = np.concatenate([self.theta[first : first + k], effect.shape])
        determined = np.concatenate([self.solution.determined[first : first + k], np.ones(len(effect.shape), bool)])
        if (
            k and not determined[:k].any() and not effect.traits.coefficients_follow
        ):  # of a joint that never moves, say: its shape is not told either
            return tuple(Estimate(name, None, None, unit) for name, unit, _ in self.regression.robot.values_of(effect))

        def public(x: Array) -> Array:
            shown = effect.with_coefficients(np.where(determined, x, np.nan)[:k]).with_shape(x[k:])
            return np.array([value for _, _, value in shown.public_values()])

        values = public(at)
        covariance = self.covariance[np.ix_(places, places)].copy()
        if effect.traits.coefficients_follow and len(of_shapes) and self.fit is not None:
            wide = np.ones(len(at))
            wide[k:] = self.fit.widened(index, np.sqrt(np.maximum(np.diag(covariance)[k:], 0.0)))
            covariance *= np.outer(wide, wide)
        ends = np.flatnonzero(self.shapes.at_bound(self.shapes.values(self.effects))[of_shapes])
        for i in k + ends:  # beyond the end the log tells nothing: anything up to there, or from there on
            covariance[i, :] = covariance[:, i] = 0.0
            covariance[i, i] = at[i] ** 2
        step = 1e-6 * np.maximum(np.abs(at), np.sqrt(np.maximum(np.diag(covariance), 1e-24)) * 1e-2)
        jacobian = np.stack(
            [(public(at + h * e) - public(at - h * e)) / (2 * h) for h, e in zip(step, np.eye(len(at)), strict=True)],
            axis=1,
        )
        free = np.concatenate([determined[:k], np.ones(len(effect.shape), bool)])
        usable = jacobian[:, free]
        std = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", usable, covariance[np.ix_(free, free)], usable), 0.0))
        shown = self.regression.robot.values_of(effect)
        told = std > ROUNDING * np.abs(values)
        return tuple(
            Estimate(name, float(value), float(s), unit) if known else Estimate(name, None, None, unit)
            for (name, unit, _), value, s, known in zip(shown, values, std, told, strict=True)
        )

    def link_estimates(self) -> tuple[Estimate, ...]:
        """Link parameters with standard deviations; None where the data does not determine one by itself."""
        robot = self.regression.robot
        before = np.full(len(self.link_parameters), np.inf)
        if self.links_near:  # what the data tell next to nothing of is the tree's
            before = near_tree.SHOWN * near_tree.deviations(self._own_links) / np.sqrt(self.links_near)
        out = []
        for b, (link, _) in enumerate(robot.bodies):
            for c, (name, unit) in enumerate(zip(LINK_PARAMETERS, LINK_UNITS, strict=True)):
                i = 10 * b + c
                known = self.links_fitted and self.solution.determined[i]
                std = float(np.sqrt(max(self.covariance[i, i], 0.0))) if known else np.inf
                if known and std < before[i]:
                    out.append(Estimate(f"{link}.{name}", float(self.link_parameters[i]), std, unit))
                else:
                    out.append(Estimate(f"{link}.{name}", None, None, unit))
        return tuple(out)


def identify(
    regression: Regression,
    effects: Sequence[Effect],
    *,
    fit_links: bool,
    start: Identification | None = None,
    with_covariance: bool = True,
    links_near: float | None = None,
) -> Identification:
    """Identify a model: weighted least squares over base parameters, shapes by variable projection.

    Parameters
    ----------
    regression : Regression
        The data, with the rigid robot.
    effects : sequence of Effect
        The model beyond the tree. Values that they have are where shape parameters start, and what undetermined
        coefficients keep.
    fit_links : bool
        Whether the links' inertial parameters are fitted or kept.
    start : Identification, optional
        Earlier fit of nearly the same model, whose links give the transmission's load.
    links_near : float, optional
        Strength with which links are kept near the tree's values (`near_tree`); as at the start where not given.

    Returns
    -------
    Identification
    """
    given, effects = effects, with_starts(effects, regression)
    links = regression.robot.link_parameters if start is None else start.link_parameters
    circular = any(e.traits.needs_load or e.traits.needs_model for e in effects)
    known = effects if start is None else start.effects
    if links_near is None:
        links_near = 0.0 if start is None else start.links_near
    seen = regression.with_model(links, known) if circular else regression
    fit = begun(_Fit.of(seen, effects, fit_links, links_near).smoothed(), without_value(given))
    # shapes that an earlier fit of all these effects settled need no order among them
    together = start is not None and {e.label for e in effects} <= {e.label for e in start.effects}
    if any(e.traits.coefficients_follow and len(e.shape) for e in effects):
        fit = _settled(fit, links, regression, start, together)
        return fit.finished(regression.with_model(fit.link_parameters, fit.valued), with_covariance)
    multiplied = any(e.traits.multiplies for e in effects)
    for i in range((MULTIPLIED_ROUNDS if multiplied else CIRCULAR_ROUNDS) if circular else 1):
        fit = fit.refined(together=together or i > 0)
        if circular:
            before, fit = fit, fit.seen_by(regression.with_model(fit.link_parameters, fit.valued))
            if abs(fit.misfit - before.misfit) < SAME_MISFIT:
                break
    return fit.finished(regression.with_model(fit.link_parameters, fit.valued), with_covariance)


def _settled(fit: _Fit, links: Array, regression: Regression, start: Identification | None, together: bool) -> _Fit:
    """A fit whose effects see the model that it ends with, links (10 * bodies,) as they see them at first.

    Where much was left over, links that were fitted to it are far off: then one that begins with the declared links comes first.
    """
    own = regression.robot.link_parameters
    bent = start is not None and fit.fit_links and start.relative_error > BENT
    new = [e for e in fit.effects if e.traits.coefficients_follow and len(e.shape)]
    new = [e for e in new if start is not None and not any(e.label == known.label for known in start.effects)]
    if not (bent and new):
        return _circled(fit, links, regression, together)
    other = dataclasses.replace(fit, regression=regression.with_model(own, ()))
    for effect in new:
        starts = effect.shape_search(other.regression.longest).starts
        shaped = [other.with_effect(effect.with_shape(x)) for x in starts]
        other = min(shaped, key=lambda f: f.misfit, default=other)
    other = _circled(other, own, regression)
    if other.relative_error < BENT:
        return other
    return min(other, _circled(fit, links, regression), key=lambda f: f.misfit)


def _circled(fit: _Fit, links: Array, regression: Regression, together: bool = False) -> _Fit:
    """Fits that see one another's links in turn, as far on the way from one to the next as does not spoil them.

    Where effects are large, links are fitted together with what these do as the links change (Gauss and Newton's method).
    """
    fit = fit.refined(together=together)
    large = fit.fit_links and fit.followed > TWISTS * float(np.linalg.norm(regression.torque))

    def seeing(links: Array) -> _Fit:
        seen = fit.seen_by(regression.with_model(links, fit.valued))
        return seen.changing_with(links) if large else seen

    if large:
        fit = seeing(links).refined(together=together)
    for _ in range(MOST_CIRCLES):
        for part in (1.0, 0.5, 0.25, 0.1):
            on_the_way = links + part * (fit.link_parameters - links)
            further = seeing(on_the_way).refined(together=True)
            if further.misfit < fit.misfit + SAME_MISFIT:
                break
        else:
            return fit if large else seeing(fit.link_parameters)
        done = fit.misfit - further.misfit < SAME_MISFIT
        fit, links = further, on_the_way
        if done:
            break
    return fit


@dataclass(frozen=True, eq=False)
class _Fit:
    """A model on its data during identification."""

    regression: Regression
    effects: tuple[Effect, ...]
    fit_links: bool
    shapes: Shapes
    links_near: float = 0.0
    # links (10 * bodies,) about which effects change with the links; None: they see them as they are
    about: Array | None = None
    by_links: Array | None = None  # by so much, (N, rows, 10 * bodies)

    @staticmethod
    def of(regression: Regression, effects: Sequence[Effect], fit_links: bool, links_near: float = 0.0) -> _Fit:
        shapes = Shapes.of(effects, regression.longest)
        return _Fit(regression, shapes.put(effects, shapes.values(effects)), fit_links, shapes, links_near)

    @cached_property
    def factors(self) -> Array:
        """Gain of each row's log so far, shape (rows,): the rows of all columns are multiplied by it."""
        out = np.ones(len(self.regression.rows))
        for e in self.effects:
            if e.traits.multiplies and e.known:
                at = self.regression.joints.index(e.joints[0])
                out[at] = max(out[at] * (1.0 + e.coefficients[0]), SMALLEST_FACTOR)
        return out

    def _scaled(self, effect: Effect) -> Array:
        columns = self.regression.columns(effect)
        return columns if effect.traits.multiplies or (self.factors == 1.0).all() else columns * self.factors[:, None]

    @cached_property
    def target(self) -> Array:
        """Torque that the columns are to explain. Gains are linear about their values so far, whose part is added."""
        torque, carried = self.regression.torque, self.regression.carried_torque
        if carried is not None:  # of which the log has the gain, too
            torque = torque + (1.0 - self.factors) * carried
        if self.by_links is not None and self.about is not None:
            torque = torque + self.factors * (self.by_links @ self.about)
        links = self.regression.robot.link_parameters
        fitted = self.regression.links_shown if self.fit_links else np.zeros(len(links), dtype=bool)
        if not fitted.all():
            torque = torque - self.factors * self.regression.link_torque(np.where(fitted, 0.0, links))
        gains = [e for e in self.effects if e.traits.multiplies and e.known]
        if gains:
            torque = np.array(torque)
            for e, (rows, columns) in zip(gains, self.regression.each(gains, once=True), strict=True):
                torque[:, rows] += columns @ e.coefficients
        return torque

    @property
    def _link_columns(self) -> Iterator[Array]:
        """Of the links, with what effects change by them; of each row (N, 10 * bodies)."""
        return map(self._link_columns_in, range(len(self.factors)))

    def _link_columns_in(self, row: int) -> Array:
        columns = self.regression.links_in(row)
        seen = columns if self.by_links is None else columns + self.by_links[:, row]
        return seen if (self.factors == 1.0).all() else seen * self.factors[row]

    @cached_property
    def _places(self) -> tuple[Indices, ...]:
        """Where each effect's coefficients stand among all."""
        ends = self._offset + np.cumsum([0, *(len(e.coefficients) for e in self.effects)])
        return tuple(np.arange(a, b) for a, b in pairwise(ends))

    def _by_joint(self, shaped: bool) -> ColumnsByJoint:
        """Columns of the effects that have shape parameters, or of those without, as far as their coefficients are estimated."""
        asked = [
            (e, at)
            for e, at, own in zip(self.effects, self._places, self.shapes.places, strict=True)
            if bool(len(own)) == shaped and not e.traits.coefficients_follow
        ]
        parts = []
        for (e, at), (rows, columns) in zip(asked, self.regression.each([e for e, _ in asked]), strict=True):
            plain = e.traits.multiplies or (self.factors == 1.0).all()
            parts.append((at, rows, columns if plain else columns * self.factors[rows, None]))
        return ColumnsByJoint.of(parts, len(self.regression.rows), len(self.regression))

    @cached_property
    def fixed(self) -> ColumnsByJoint:
        """Columns that no shape parameter changes; shared by all steps of a fit."""
        rest = self._by_joint(shaped=False)
        if not self.fit_links:
            return rest
        return ColumnsByJoint.of_dense(np.arange(self._offset), self._link_columns).beside(rest)

    @cached_property
    def varied(self) -> ColumnsByJoint:
        """Columns that change with the shapes."""
        return self._by_joint(shaped=True)

    @property
    def follows(self) -> Mask:
        """Which coefficients follow from their effect's shape, shape (p,)."""
        return self._of_effects([e.traits.coefficients_follow for e in self.effects])

    def _of_effects(self, which: Sequence[bool]) -> Mask:
        """Which coefficients are of those effects, (p,)."""
        return np.repeat([False, *which], [self._offset, *map(len, self._places)])

    @cached_property
    def goal(self) -> Array:
        """Torque less that of the coefficients which follow from their effect's shape, shape (joints, N)."""
        torque = self.target
        for e in self.effects:
            if e.traits.coefficients_follow:
                torque = torque - self._scaled(e) @ e.coefficients
        return np.ascontiguousarray(torque.T)

    def columns(self, *others: ColumnsByJoint) -> ColumnsByJoint:
        """All columns, and others beside them."""
        following = [
            (at, np.arange(len(self.regression.rows)), self._scaled(e))
            for e, at in zip(self.effects, self._places, strict=True)
            if e.traits.coefficients_follow
        ]
        if following:
            others = ColumnsByJoint.of(following, len(self.regression.rows), len(self.regression)), *others
        return self.fixed.beside(self.varied, *others)

    @cached_property
    def normal(self) -> NormalEquations:
        """Products of the columns of what is estimated, on all samples."""
        goal, size = self.goal, len(self.prior)
        gram, cross = np.zeros((len(goal), size, size)), np.zeros((len(goal), size))
        for j, y in enumerate(goal):
            f, v = self.fixed.places[j], self.varied.places[j]
            a, x = self.fixed.columns[j], self.varied.columns[j]
            across = a.T @ x
            gram[j][np.ix_(f, f)], gram[j][np.ix_(f, v)] = self.fixed.grams[j], across
            gram[j][np.ix_(v, f)], gram[j][np.ix_(v, v)] = across.T, self.varied.grams[j]
            cross[j, f], cross[j, v] = a.T @ y, x.T @ y
        return NormalEquations(gram[None], cross[None], (goal**2).sum(axis=1)[None], np.array([goal.shape[1]]))

    @cached_property
    def prior(self) -> Array:
        links = self.regression.robot.link_parameters if self.fit_links else np.zeros(0)
        values = np.concatenate([links, *(e.coefficients for e in self.effects)])
        return np.where(np.isnan(values), 0.0, values)

    @cached_property
    def solution(self) -> Solution:
        return fit_weighted(self.normal, self.prior, precision=self.precision, centre=self.centre)

    @cached_property
    def precision(self) -> Array:
        """Inverse covariance of the coefficients before the data, shape (p, p): penalties, what is left to others, else zero.

        A curve is within `LARGEST` times its joint's torque: what others of much the same shape have would not end else.
        """
        out = _with_links(self.effects, self._own_links, self.links_near)
        motions = [s.motion for s in self.regression.segments]
        for effect, at in zip(self.effects, self._places, strict=True):
            if effect.penalty is not None:
                held = effect.held_beside(self.effects, motions)
                (gram,), power = self.normal.gram, self.normal.power[0] / self.normal.counts.sum()
                joint = int(np.argmax(gram[:, at, at].sum(axis=1)))
                told = gram[joint, at, at].mean() / max(power[joint], 1e-300)
                own = np.eye(len(at)) / max(LARGEST**2 * power[joint], 1e-300)
                out[np.ix_(at, at)] += HELD * told * held @ held.T + own
        return out

    @cached_property
    def _own_links(self) -> Array:
        """The tree's values of the links that are fitted, (links,)."""
        return self.regression.robot.link_parameters if self.fit_links else np.zeros(0)

    @property
    def centre(self) -> Array:
        """What `precision` pulls to, (p,)."""
        return near_tree.pulled_to(self._own_links, self.links_near, len(self.prior))

    def smoothed(self) -> _Fit:
        """With strengths of penalties that were not chosen yet, each by what is predicted of blocks that are held out."""
        fit = self
        for i, effect in enumerate(self.effects):
            if effect.penalty is not None and effect.penalty.strength is None:
                fit = fit._with_strength(i)
        return fit

    def _with_strength(self, index: int) -> _Fit:
        def of(effect: Effect) -> _Fit:
            effects = (*self.effects[:index], effect, *self.effects[index + 1 :])
            return dataclasses.replace(self, effects=effects)

        normal = NormalEquations.by_joint(self.columns(), self.goal, self.regression.blocks(), len(self.prior))
        sigma, at = self.solution.sigma, self._places[index]
        own = np.einsum("j,jpq->pq", sigma**-2.0, normal.total[0])[np.ix_(at, at)]

        def held_out(effect: Effect) -> float:
            return squares_held_out(normal, self.prior, sigma, of(effect).precision, self.centre)

        return of(smoothed(self.effects[index], own, held_out))

    @property
    def link_parameters(self) -> Array:
        if not self.fit_links:
            return self.regression.robot.link_parameters
        return self.solution.theta[: len(self.regression.robot.link_parameters)]

    @cached_property
    def valued(self) -> tuple[Effect, ...]:
        """The effects with the coefficients that fit best."""
        out, at = [], self._offset
        for e in self.effects:
            k = len(e.coefficients)
            out.append(e.with_coefficients(self.solution.theta[at : at + k]))
            at += k
        return tuple(out)

    @property
    def misfit(self) -> float:
        """Sum of the logarithms of the joints' residual standard deviations."""
        return float(np.log(self.solution.sigma).sum())

    @property
    def relative_error(self) -> float:
        """Norm of what is left over the norm of the torque."""
        left = self.target - self.columns().times(self.solution.theta).T
        return float(np.linalg.norm(left) / np.linalg.norm(self.regression.torque))

    def with_effect(self, effect: Effect) -> _Fit:
        """With an effect in the place of the one of its label."""
        return _Fit.of(
            self.regression,
            [effect if e.label == effect.label else e for e in self.effects],
            self.fit_links,
            self.links_near,
        )

    def seen_by(self, regression: Regression) -> _Fit:
        return _Fit(regression, self.valued, self.fit_links, self.shapes, self.links_near)

    def changing_with(self, links: Array) -> _Fit:
        """With effects that change with the links, about those (10 * bodies,) that they see."""
        return dataclasses.replace(self, about=links, by_links=self.regression.by_links(self.effects))

    @property
    def followed(self) -> float:
        """Norm of the torque of the effects whose coefficients follow from their shapes."""
        return float(np.linalg.norm(self.columns().times(np.where(self.follows, self.prior, 0.0))))

    @property
    def _offset(self) -> int:
        return len(self.regression.robot.link_parameters) if self.fit_links else 0

    @cached_property
    def shape(self) -> Array:
        return self.shapes.values(self.effects)

    def with_shape(self, shape: Array) -> _Fit:
        """With other shapes, and the columns that these do not touch."""
        other = dataclasses.replace(self, effects=self.shapes.put(self.effects, shape))
        other.__dict__.update(target=self.target, factors=self.factors, fixed=self.fixed, _places=self._places)
        if not any(e.traits.coefficients_follow for e in self.effects):
            other.__dict__.update(goal=self.goal, prior=self.prior)
        if not any(len(own) and e.penalty is not None for e, own in zip(self.effects, self.shapes.places, strict=True)):
            other.__dict__["precision"] = self.precision
        return other

    @cached_property
    def _by_shape(self) -> ColumnsByJoint:
        """Derivative of the predicted torque by each shape parameter."""
        asked: list[tuple[int, float]] = []
        pairs: list[Pair] = []
        for e, places, own in zip(self.effects, self.shapes.places, self._places, strict=True):
            theta, at = self.solution.theta[own], e.shape
            for i, place in enumerate(places):
                step = DIFFERENCE * max(abs(at[i]), 0.0 if self.shapes.low[place] > 0 else 1e-4)
                both = (e.with_shape(at + change) for change in (step * np.outer((1.0, -1.0), np.arange(len(at)) == i)))
                above, below = ((x, x.coefficients if e.traits.coefficients_follow else theta) for x in both)
                pairs.append((above, below))
                asked.append((place, 2.0 * step))
        each = zip(asked, self.regression.apart(pairs), strict=True)
        parts = [(np.array([p]), at, x / width * self.factors[at, None]) for (p, width), (at, x) in each]
        return ColumnsByJoint.of(parts, len(self.regression.rows), len(self.regression))

    def cost(self, sigma: Array) -> float:
        """Sum of squares over given variances, at the best coefficients."""
        return squares_left(self.normal, self.prior, sigma, self.precision, self.centre)

    def refined(self, rounds: int = 100, together: bool = False) -> _Fit:
        """Levenberg-Marquardt steps in the shape parameters, coefficients projected out (variable projection).

        Those that effects share wait until the others have settled, unless all go `together`: a turn-over must not grow in place of
        what stands beside it.
        """
        shared = np.array([key is not None for key in self.shapes.keys], dtype=bool)
        if together or shared.all() or not shared.any():
            return self._stepped(rounds, np.ones(len(self.shapes), dtype=bool)) if len(shared) else self
        return self._stepped(rounds, ~shared)._stepped(rounds, np.ones(len(shared), dtype=bool))

    def _stepped(self, rounds: int, moving: Mask) -> _Fit:
        """Steps in some of the shape parameters (s,)."""
        # what a robot file states, as it does when a loop is closed again, goes on to be possible
        stated = {e.label for e in self.regression.robot.effects if e.known}
        within = self._of_effects([e.label in stated for e in self.effects])
        within = within & ~self.beyond if within.any() else within
        return lowest(_Shaped(self, moving & ~self.shapes.held, self.solution.sigma, within), rounds).fit

    @property
    def beyond(self) -> Mask:
        """Which coefficients lie below what they can be, (p,)."""
        low = [p.lower for e in self.effects for p in e.coefficient_parameters.values()]
        return self.solution.determined & (self.solution.theta < np.append(np.full(self._offset, -np.inf), low))

    def shape_equations(self, sigma: Array) -> tuple[Array, Array]:
        """Normal equations of a step in the shapes' fitted coordinates, (s, s) and (s,)."""
        shapes, size = len(self.shapes), len(self.prior)
        own, score, with_columns = np.zeros((shapes, shapes)), np.zeros(shapes), np.zeros((shapes, size))
        for j, weight in enumerate(sigma**-2.0):
            d, s = self._by_shape.columns[j], self._by_shape.places[j]
            left = d.T @ self.goal[j]
            for part in (self.fixed, self.varied):
                at = part.places[j]
                products = d.T @ part.columns[j]
                left -= products @ self.solution.theta[at]
                np.add.at(with_columns, np.ix_(s, at), weight * products)
            np.add.at(own, np.ix_(s, s), weight * d.T @ d)
            np.add.at(score, s, weight * left)
        gram = np.tensordot(sigma**-2.0, self.normal.total[0], axes=1) + self.precision
        taken = with_columns @ coefficients(gram, with_columns.T, np.zeros((size, shapes)))
        step = self.shapes.per_step(self.shape)
        return (own - taken) * np.outer(step, step), score * step

    def widened(self, index: int, std: Array) -> Array:
        """Factors of standard deviations (k,) of an effect's shapes (`reach.widened`), worked out once."""
        if index not in self._widened:
            self._widened[index] = widened(self, index, std)
        return self._widened[index]

    @cached_property
    def _widened(self) -> dict[int, Array]:
        return {}

    def finished(self, regression: Regression, with_covariance: bool) -> Identification:
        solution, spans = self.solution, regression.spans
        derivatives = self.columns(self._by_shape.merged().shifted(len(solution.theta)))
        size = len(solution.theta) + len(self.shape)
        residual = self.target - derivatives.times(np.concatenate([solution.theta, np.zeros(len(self.shape))])).T
        # what follows from a shape has neither a part in the noise nor a covariance of its own
        free = np.flatnonzero(~np.concatenate([self.follows, self.shapes.held]))
        estimated = derivatives if len(free) == size else derivatives.kept(free, size)
        held = self.shapes.precision(self.shape)
        longest = int(CORRELATION_S * regression.segments[0].rate_hz)
        precision = np.zeros((size, size))
        precision[: len(self.precision), : len(self.precision)] = self.precision
        counted = np.ascontiguousarray((residual / np.sqrt(regression.share)).T)
        uncertainty = Uncertainty(
            estimated,
            free,
            size,
            precision[np.ix_(free, free)],
            solution.sigma,
            counted,
            spans,
            partial(getattr, regression, "alike"),
            longest,
            with_covariance,
            derivatives,
            np.concatenate([np.zeros(len(solution.theta)), np.divide(1.0, held, out=0.0 * held, where=held > 0.0)]),
        )
        return Identification(
            self.valued,
            self.link_parameters,
            solution.theta,
            uncertainty,
            solution,
            residual,
            regression,
            derivatives,
            self.fit_links,
            self.shapes,
            self.links_near,
            self if any(e.traits.coefficients_follow for e in self.effects) else None,
        )


@dataclass(frozen=True, eq=False)
class _Shaped(Iterate):
    """A fit on its way in some of its shapes; squares count over the variances that the step began with."""

    fit: _Fit
    moving: Mask
    sigma: Array
    within: Mask  # stated coefficients that were within their bounds where it began, (p,): they stay there

    @cached_property
    def goal(self) -> float:
        left = self.within.any() and (self.within & self.fit.beyond).any()
        return np.inf if left else self.fit.cost(self.sigma)

    @property
    def enough(self) -> float:
        return SETTLED * self.goal

    def equations(self) -> tuple[Array, Array]:
        gram, score = self.fit.shape_equations(self.sigma)
        return gram * np.outer(self.moving, self.moving), score * self.moving

    def moved(self, step: Array) -> _Shaped:
        shape = self.fit.shapes.moved(self.fit.shape, step)
        return dataclasses.replace(self, fit=self.fit.with_shape(shape))

    def renewed(self) -> _Shaped:
        return dataclasses.replace(self, sigma=self.fit.solution.sigma)


def _with_links(effects: Sequence[Effect], links: Array, strength: float) -> Array:
    """Precision of coefficients before the data, links (l,) first, which are the tree's values."""
    out = np.pad(prior_precision(effects), ((len(links), 0), (len(links), 0)))
    if strength:
        out[np.diag_indices(len(links))] = near_tree.precision(links, strength)
    return out
