"""What robots have in common and what is one robot's own: parameters over the robots of a make."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.fleet.robots import Outcome
from rx90b_flex.fleet.second_fit import LINK, ByDate, SecondFit, Told, ToldEffect, same
from rx90b_flex.fleet.statistics import FEWEST_OTHERS, Summary, change, p_values, summary

COMMON = 0.5  # of the robots: what more of them have belongs to the make


@dataclass(frozen=True)
class RobotValue:
    """One parameter of one robot.

    Attributes
    ----------
    robot : str
    value, std : float
    present : bool
        Whether the robot's model has the effect; otherwise this is what its data hold of it, zero within `std` where there is none.
    p_value : float or None
        Of a value so far from what the others predict, corrected for all tests; None where it is not tested.
    stands_out : bool
    since, until : str or None
        Day from which on it does, or to which it did, where dated recordings tell (ISO 8601).
    before, after : float or None
        With either of these days the value until it changed, and the value from then on; `value` is over all recordings.
    """

    robot: str
    value: float
    std: float
    present: bool
    p_value: float | None = None
    stands_out: bool = False
    since: str | None = None
    until: str | None = None
    before: float | None = None
    after: float | None = None


@dataclass(frozen=True)
class MakeParameter:
    """One parameter over the robots of a make.

    Attributes
    ----------
    effect : Effect or None
        In the shape in which it was looked for; None for a link's parameter.
    name, unit : str
    tested : bool
        Whether robots are held against each other by it.
    values : tuple of RobotValue
    summary : Summary
        Over the robots that do not stand out.
    """

    effect: Effect | None
    name: str
    unit: str
    tested: bool
    values: tuple[RobotValue, ...]
    summary: Summary

    @property
    def type(self) -> str:
        """Type of the effect, or ``link``."""
        return LINK if self.effect is None else self.effect.type_name()

    @property
    def place(self) -> str:
        """Joints or frame; of a link's parameter the link."""
        if self.effect is None:
            return self.name.rpartition(".")[0]
        return " + ".join(self.effect.place) or "robot"

    @property
    def parameter(self) -> str:
        """The name without the place."""
        return self.name.rpartition(".")[2]

    @property
    def present(self) -> int:
        """How many robots have it."""
        return sum(v.present for v in self.values)


@dataclass(frozen=True)
class Sought:
    """Effects that were found on the robots of a make: on most, and on some; each in the shape of the surest find."""

    common: tuple[Effect, ...]
    others: tuple[Effect, ...]


def sought(outcomes: Sequence[Outcome]) -> Sought:
    """What to look for on every robot."""
    compared = [o for o in outcomes if o.compared]
    groups: list[list[tuple[float, Effect]]] = []
    for outcome in compared:
        for effect, p in zip(outcome.found, outcome.p_values, strict=True):
            group = next((g for g in groups if same(g[0][1], effect)), None)
            if group is None:
                groups.append(group := [])
            group.append((p, effect))
    most = COMMON * len(compared)
    common = tuple(_surest(g) for g in groups if len(g) > most)
    return Sought(common, tuple(_surest(g) for g in groups if len(g) <= most))


def _surest(group: Sequence[tuple[float, Effect]]) -> Effect:
    return min(group, key=lambda pair: pair[0])[1]


@dataclass(frozen=True, eq=False)
class _Row:
    """One parameter before it is summarised: whether it is tested, and what each robot tells."""

    effect: Effect | None
    tested: bool
    told: dict[str, tuple[Told, bool]]


def parameters(fits: Mapping[str, SecondFit]) -> tuple[MakeParameter, ...]:
    """Every parameter over the robots, robots in the order of `fits`."""
    rows = [row for row in _rows(fits) if row.told]
    tests = sum(len(row.told) for row in rows if row.tested and len(row.told) > FEWEST_OTHERS)
    return tuple(_summarised(row, tests) for row in rows)


def _rows(fits: Mapping[str, SecondFit]) -> list[_Row]:
    wanted: list[Effect] = []
    for fit in fits.values():
        wanted += [t.effect for t in fit.effects if not any(same(t.effect, w) for w in wanted)]
    out: list[_Row] = []
    for effect in wanted:
        told = {name: next((t for t in fit.effects if same(t.effect, effect)), None) for name, fit in fits.items()}
        known = {name: t for name, t in told.items() if t is not None}
        out += _of_effect(known)
    names = dict.fromkeys(t.name for fit in fits.values() for t in fit.links)
    for link in names:
        values = {name: (t, True) for name, fit in fits.items() for t in fit.links if t.name == link}
        out.append(_Row(None, True, values))
    return out


def _of_effect(told: Mapping[str, ToldEffect]) -> list[_Row]:
    """Public parameters of what most robots have, coefficients of what few have."""
    having = [t for t in told.values() if t.present]
    shown = (having or list(told.values()))[0].effect
    if len(having) <= COMMON * len(told):
        looked_for = next((t.effect for t in told.values() if not t.present), shown)
        names = dict.fromkeys(c.name for t in told.values() for c in t.coefficients)
        return [
            _Row(
                looked_for, True, {r: (c, t.present) for r, t in told.items() for c in t.coefficients if c.name == name}
            )
            for name in names
        ]
    kinds = {e: p.kind for e, p in type(shown).parameters().items()}
    out = []
    for name in dict.fromkeys(p.name for t in having for p in t.parameters if p.name != "phase"):
        values: dict[str, tuple[Told, bool]] = {}
        for robot, t in told.items():
            # what a robot lacks is told by the coefficient of that name, if there is one
            here = t.parameters if t.present else t.coefficients
            values.update((robot, (p, t.present)) for p in here if p.name == name)
        out.append(_Row(shown, kinds.get(name, "linear") != "shape" and name not in shown.shape_names(), values))
    return out


def _summarised(row: _Row, tests: int) -> MakeParameter:
    robots = list(row.told)
    told = [t for t, _ in row.told.values()]
    values, stds = (np.array([getattr(t, field) for t in told]) for field in ("value", "std"))
    tested = row.tested and len(told) > FEWEST_OTHERS
    p, out = p_values(values, stds, tests) if tested else (np.ones(len(told)), np.zeros(len(told), dtype=bool))
    over = summary(values[~out], stds[~out])
    shown = tuple(
        RobotValue(
            robot, float(values[i]), float(stds[i]), row.told[robot][1], float(p[i]) if tested else None, bool(out[i])
        )
        for i, robot in enumerate(robots)
    )
    dated = tuple(_dated(v, t.by_date, over.mean) if v.stands_out else v for v, t in zip(shown, told, strict=True))
    return MakeParameter(row.effect, told[0].name, told[0].unit, tested, dated, over)


def _dated(value: RobotValue, by_date: ByDate | None, mean: float) -> RobotValue:
    """With the day on which it left the make's mean, or came back to it."""
    changed = None if by_date is None else change(np.array(by_date.values), np.array(by_date.covariance))
    if changed is None or by_date is None:
        return value
    value = dataclasses.replace(value, before=changed.before, after=changed.after)
    if abs(changed.after - mean) > abs(changed.before - mean):
        return dataclasses.replace(value, since=by_date.dates[changed.at])
    return dataclasses.replace(value, until=by_date.dates[changed.at - 1])
