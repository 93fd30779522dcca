"""The second fit of a robot: with what was found on its make, so that robots can be compared parameter by parameter.

A loop that is closed on one robot may miss an effect, or give it the name of a look-alike, where others see it well. So every robot
is fitted again, to all its recordings, with the effects that most robots of the make have. What its own loop found beside these
stays where it still passes the loop's tests (see `rx90b_flex.diagnose.trial`). For any other effect that was found somewhere the
robot's data say how much of it they hold: the coefficients of its columns beside the robot's model, which are zero where there is
none, with the standard deviation that coloured residuals leave them.

A robot that changed between two days is two robots: one model of both would give the change to whatever differs between their
motions. So where recordings carry dates every coefficient of the model's effects is estimated date by date, beside all else. If one
changed, the days before and the days after are fitted by themselves, and the robot is compared as it is after its last change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.base import DETERMINED, Base
from rx90b_flex.diagnose.kinds import sites_of
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.torque import reweighted
from rx90b_flex.diagnose.trial import added
from rx90b_flex.effects import Effect, Sites
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.fleet.statistics import change
from rx90b_flex.identify.coloured import scatter, widening
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.torque_scale import resolved
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording

# Of its logarithm, by which the shape of an effect that may stand twice in one place differs between robots.
ALIKE = 0.05
LINK = "link"  # stands for the type where a parameter is a link's


@dataclass(frozen=True)
class ByDate:
    """One coefficient date by date: dates (ISO 8601), values, and their covariance."""

    dates: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Told:
    """What one robot's data say of one parameter.

    Attributes
    ----------
    name : str
    value, std : float
        In the unit of the parameter.
    unit : str
    by_date : ByDate or None
        None where its recordings carry fewer than two dates.
    """

    name: str
    value: float
    std: float
    unit: str
    by_date: ByDate | None = None


@dataclass(frozen=True)
class ToldEffect:
    """What one robot's data say of one effect.

    Attributes
    ----------
    effect : Effect
        As the robot has it, or as it was looked for.
    present : bool
        Whether the robot's second fit has it.
    parameters : tuple of Told
        Of an effect that it has, as a report gives them.
    coefficients : tuple of Told
        Of the columns of the effect that was looked for.
    """

    effect: Effect
    present: bool
    parameters: tuple[Told, ...]
    coefficients: tuple[Told, ...]


@dataclass(frozen=True)
class SecondFit:
    """A robot beside its make: effects that it declares, then those that were found anywhere; and its links' parameters.

    Attributes
    ----------
    effects : tuple of ToldEffect
    links : tuple of Told
    earlier : SecondFit or None
        The same robot before its last change, where there was one.
    until, since : str or None
        Last day before that change, and first day after it (ISO 8601).
    """

    effects: tuple[ToldEffect, ...]
    links: tuple[Told, ...]
    earlier: SecondFit | None = None
    until: str | None = None
    since: str | None = None


def same(one: Effect, other: Effect) -> bool:
    """Whether effects of two robots are one: type, place and, of those that may stand twice there, nearly the same shape."""
    if type(one) is not type(other) or one.place != other.place:
        return False
    if not one.traits.repeats:
        return True
    a, b = (np.log(np.maximum(np.abs(e.shape), 1e-9)) for e in (one, other))
    return bool((np.abs(a - b) < ALIKE).all())


def found_effects(declared: Robot, closed: Robot, joints: Sequence[str]) -> tuple[Effect, ...]:
    """What the loop added to a robot, of what shows in torques over time.

    Parameters
    ----------
    declared, closed : Robot
        As its campaign names it, and as the loop wrote it.
    joints : sequence of str
        Of the campaign.
    """
    known, now = (r.over_time().restricted(joints).effects for r in (declared, closed))
    labels = [e.label for e in known]
    return tuple(e for e in now if e.label not in labels)


def second_fit(
    campaign: Campaign,
    declared: Robot,
    found: Sequence[Effect],
    common: Sequence[Effect],
    others: Sequence[Effect],
    robots: int = 1,
) -> SecondFit:
    """Fit a robot again with the effects that its make has in common, and ask it for the others.

    Parameters
    ----------
    campaign : Campaign
    declared : Robot
    found : sequence of Effect
        On this robot, with their values.
    common, others : sequence of Effect
        On most robots, and on some; with the shapes in which they are looked for. Those on joints that it lacks are left out.
    robots : int
        How many are asked whether they changed, for whose number p-values of changes are corrected.
    """
    campaign, _ = resolved(campaign, declared)
    sites = sites_of(declared, campaign.joints)
    common, others = ([e for e in effects if set(e.joints) <= set(sites.joints)] for effects in (common, others))

    def fit(recordings: Sequence[Recording]) -> SecondFit:
        return _one_state(recordings, campaign.cutoff_hz, declared, sites, found, common, others)

    recordings, now = campaign.recordings, fit(campaign.recordings)
    while (since := _changed(now, robots)) is not None:
        dated = [(r, r.date) for r in recordings if r.date is not None]
        before = [(r, d) for r, d in dated if d < since]
        recordings = tuple(r for r, d in dated if d >= since)
        now = dataclasses.replace(
            fit(recordings), earlier=fit([r for r, _ in before]), until=max(d for _, d in before), since=since
        )
    return now


def _changed(fit: SecondFit, robots: int) -> str | None:
    """First day after the surest change of a coefficient of the model's effects."""
    dated = [c.by_date for e in fit.effects if e.present for c in e.coefficients if c.by_date is not None]
    tests = robots * len(dated)
    changes = [(change(np.array(d.values), np.array(d.covariance), tests), d.dates) for d in dated]
    found = [(c.p_value, dates[c.at]) for c, dates in changes if c is not None]
    return min(found)[1] if found else None


def _one_state(
    recordings: Sequence[Recording], cutoff_hz: float | None, declared: Robot, sites: Sites, found: Sequence[Effect],
    common: Sequence[Effect], others: Sequence[Effect],
) -> SecondFit:  # fmt: skip
    """The second fit to recordings over which nothing changes."""
    regression = Regression.of(declared, recordings, cutoff_hz)
    search = Search(_fitted(regression, sites, declared, found, common), sites)
    looked_for = [*common, *others]
    declared_ones = [e for e in search.model.effects if not any(same(e, other) for other in looked_for)]
    wanted = [*declared_ones, *looked_for]
    dates = tuple(r.date for r in recordings)
    effects = tuple(_told(search, e, dates) for e in wanted)
    links = search.model.link_estimates()
    told = [Told(e.name, e.value, e.std, e.unit) for e in links if e.value is not None and e.std is not None]
    return SecondFit(effects, tuple(told))


def _fitted(
    regression: Regression, sites: Sites, declared: Robot, found: Sequence[Effect], common: Sequence[Effect]
) -> Identification:
    """The declared model with the make's effects, and with what of the robot's own still shows beside them."""
    fit_links = declared.inertial_parameters == "fitted"
    effects: tuple[Effect, ...] = regression.robot.effects
    for effect in common:
        effects = added(effects, next((f for f in found if same(f, effect)), effect))
    model = reweighted(regression, identify(regression, effects, fit_links=fit_links))
    for effect in common:  # what the make has, this robot may lack
        here = _in(model, effect)
        search = Search(model, sites)
        if here is not None and not any(same(f, effect) for f in found) and not search.without(here).accepted:
            kept = search.present_without(here)
            model = reweighted(regression, identify(regression, kept, fit_links=fit_links, start=model))
    for effect in found:
        if _in(model, effect) is not None:
            continue
        search = Search(model, sites)
        replaced = next(
            (e for e in model.effects if e.place == effect.place and e.type_name() in effect.traits.replaces), None
        )
        trial = search.trial(effect, search.base(replaced), search.present, search.tests)
        if trial.accepted:
            effects = added(model.effects, trial.effect)
            model = reweighted(regression, identify(regression, effects, fit_links=fit_links, start=model))
    return model


def _in(model: Identification, effect: Effect) -> Effect | None:
    return next((e for e in model.effects if same(e, effect)), None)


def _told(search: Search, wanted: Effect, dates: Sequence[str | None]) -> ToldEffect:
    model, present = search.model, _in(search.model, wanted)
    if present is None:
        return ToldEffect(wanted, False, (), _coefficients(search, wanted, None, dates))
    own = _coefficients(search, present, present, dates)
    by_date = {c.name: c.by_date for c in own}
    parameters = tuple(
        Told(e.name, e.value, e.std, e.unit, by_date.get(e.name))
        for e in model.estimates(model.effects.index(present))
        if e.value is not None and e.std is not None
    )
    return ToldEffect(present, True, parameters, _coefficients(search, wanted, present, dates))


def _coefficients(
    search: Search, wanted: Effect, present: Effect | None, dates: Sequence[str | None]
) -> tuple[Told, ...]:
    """Coefficients of an effect in the shape that it has here, beside the robot's model without `present`."""
    base = search.base(present)
    rows, columns = search.regression.compact([wanted])
    if len(rows) == 0 or np.isnan(wanted.shape).any():
        return ()
    values, covariance = _beside(search, base, rows, columns)
    of_dates = sorted({d for d in dates if d is not None})
    apart = _by_date(search, base, rows, columns, of_dates, dates) if len(of_dates) > 1 else None
    out = []
    for i, (name, p) in enumerate(wanted.coefficient_parameters.items()):
        if np.isfinite(covariance[i, i]):
            by_date = None if apart is None else _one_of(apart, i, len(values), of_dates)
            out.append(Told(name, float(values[i]), float(np.sqrt(covariance[i, i])), p.unit, by_date))
    return tuple(out)


def _by_date(
    search: Search, base: Base, rows: Indices, columns: Array, of_dates: Sequence[str], dates: Sequence[str | None]
) -> tuple[Array, Array]:
    """Coefficients of each date beside each other, (d * k,), and their covariance; what carries no date counts with none."""
    parts = []
    for date in of_dates:
        part = np.zeros_like(columns)
        for span, here in zip(search.regression.spans, dates, strict=True):
            if here == date:
                part[span] = columns[span]
        parts.append(part)
    return _beside(search, base, rows, np.concatenate(parts, axis=2))


def _one_of(apart: tuple[Array, Array], i: int, k: int, of_dates: Sequence[str]) -> ByDate | None:
    """One coefficient of k, at the dates that tell it; None where fewer than two do."""
    values, covariance = apart
    places = np.arange(len(of_dates)) * k + i
    told = np.isfinite(covariance[places, places])
    if told.sum() < 2:
        return None
    at = places[told]
    shown = tuple(d for d, t in zip(of_dates, told, strict=True) if t)
    return ByDate(shown, tuple(values[at].tolist()), tuple(tuple(row) for row in covariance[np.ix_(at, at)].tolist()))


def _beside(search: Search, base: Base, rows: Indices, columns: Array) -> tuple[Array, Array]:
    """Least-squares coefficients of columns (N, rows, k) beside a base, everything fitted, and their covariance (k, k).

    The covariance allows for coloured residuals; it is infinite for a coefficient that the data do not tell by itself.
    """
    left, own, score = base.projected(rows, columns)
    scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
    values, vectors = np.linalg.eigh(left / np.outer(scale, scale))
    kept = values > DETERMINED
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    apart = base.apart(rows, columns).transpose(1, 0, 2)
    spectra = search.model.spectra
    covariance = widening(spectra) * inverse @ scatter(apart, base.weight, spectra, search.regression.spans) @ inverse
    unknown = np.linalg.norm(vectors[:, ~kept], axis=1) > np.sqrt(DETERMINED)
    covariance[unknown, unknown] = np.inf
    return inverse @ score, covariance
