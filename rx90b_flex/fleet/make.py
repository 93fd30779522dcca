"""What robots have in common and what is one robot's own: parameters over the robots of a make."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from rx90b_flex.effects import Effect
from rx90b_flex.fleet.robots import Outcome
from rx90b_flex.fleet.second_fit import LINK, SecondFit, Told, ToldEffect, same
from rx90b_flex.fleet.statistics import CHANGED, FEWEST_OTHERS, STANDS_OUT, Summary, p_value_beside, p_values, summary

COMMON = 0.5  # of the robots: what more of them have belongs to the make


@dataclass(frozen=True)
class RobotValue:
    """One parameter of one robot.

    Attributes
    ----------
    robot : str
    value, std : float
        After its last change, where it changed between the dates of its recordings.
    present : bool
        Whether the robot's model has the effect; otherwise this is what its data hold of it, zero within `std` where there is none.
    p_value : float or None
        Of a value so far from what the others predict, corrected for all tests; None where it is not tested.
    stands_out : bool
    since, until : str or None
        First day on which it does, or last one on which it did, where dated recordings tell (ISO 8601).
    before, before_std : float or None
        With either of these days, the value before that change.
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
    before_std: float | None = None


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


def sought(outcomes: Sequence[Outcome]) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Effects to look for on every robot: found on most, and found on some; each in the shape of the surest find."""
    compared = [o for o in outcomes if o.compared]
    groups: list[list[tuple[float, Effect]]] = []
    for outcome in compared:
        for effect, p in zip(outcome.found, outcome.p_values, strict=True):
            group = next((g for g in groups if same(g[0][1], effect)), None)
            if group is None:
                groups.append(group := [])
            group.append((p, effect))
    surest = [(len(group), min(group, key=lambda pair: pair[0])[1]) for group in groups]
    most = COMMON * len(compared)
    return tuple(e for count, e in surest if count > most), tuple(e for count, e in surest if count <= most)


@dataclass(frozen=True, eq=False)
class _Row:
    """One parameter before it is summarised: whether it is tested, what each robot tells, and what it told before its last change."""

    effect: Effect | None
    tested: bool
    told: dict[str, tuple[Told, bool]]
    earlier: dict[str, Told] = dataclasses.field(default_factory=dict)


def parameters(fits: Mapping[str, SecondFit]) -> tuple[MakeParameter, ...]:
    """Every parameter over the robots, robots in the order of `fits`."""
    rows = [row for row in _rows(fits) if row.told]
    tests = sum(len(row.told) + len(row.earlier) for row in rows if row.tested and len(row.told) > FEWEST_OTHERS)
    return tuple(_summarised(row, tests, fits) for row in rows)


def _rows(fits: Mapping[str, SecondFit]) -> list[_Row]:
    wanted: list[Effect] = []
    for fit in fits.values():
        wanted += [t.effect for t in fit.effects if not any(same(t.effect, w) for w in wanted)]
    earlier = {name: fit.earlier for name, fit in fits.items() if fit.earlier is not None}
    out: list[_Row] = []
    for effect in wanted:
        out += _of_effect(_those(fits, effect), _those(earlier, effect))
    names = dict.fromkeys(t.name for fit in fits.values() for t in fit.links)
    for link in names:
        values = {name: (t, True) for name, fit in fits.items() for t in fit.links if t.name == link}
        before = {name: t for name, fit in earlier.items() for t in fit.links if t.name == link and name in values}
        out.append(_Row(None, True, values, before))
    return out


def _those(fits: Mapping[str, SecondFit], effect: Effect) -> dict[str, ToldEffect]:
    """What each robot tells of one effect."""
    found = {name: next((t for t in fit.effects if same(t.effect, effect)), None) for name, fit in fits.items()}
    return {name: t for name, t in found.items() if t is not None}


def _of_effect(told: Mapping[str, ToldEffect], earlier: Mapping[str, ToldEffect]) -> list[_Row]:
    """Public parameters of what most robots have, coefficients of what few have."""
    having = [t for t in told.values() if t.present]
    shown = (having or list(told.values()))[0].effect
    if len(having) <= COMMON * len(told):
        looked_for = next((t.effect for t in told.values() if not t.present), shown)
        names = dict.fromkeys(c.name for t in told.values() for c in t.coefficients)
        return [_row(looked_for, True, name, told, earlier, lambda t: t.coefficients) for name in names]
    kinds = {e: p.kind for e, p in type(shown).parameters().items()}
    return [
        _row(
            shown, kinds.get(name, "linear") != "shape" and name not in shown.shape_parameters, name, told, earlier,
            # what a robot lacks is told by the coefficient of that name, if there is one
            lambda t: t.parameters if t.present else t.coefficients,
        )
        for name in dict.fromkeys(p.name for t in having for p in t.parameters if p.name != "phase")
    ]  # fmt: skip


def _row(
    effect: Effect, tested: bool, name: str, told: Mapping[str, ToldEffect], earlier: Mapping[str, ToldEffect],
    those: Callable[[ToldEffect], tuple[Told, ...]],
) -> _Row:  # fmt: skip
    now = {robot: (p, t.present) for robot, t in told.items() for p in those(t) if p.name == name}
    before = {robot: p for robot, t in earlier.items() for p in those(t) if p.name == name and robot in now}
    return _Row(effect, tested, now, before)


def _summarised(row: _Row, tests: int, fits: Mapping[str, SecondFit]) -> MakeParameter:
    robots = list(row.told)
    told = [t for t, _ in row.told.values()]
    values, stds = (np.array([getattr(t, field) for t in told]) for field in ("value", "std"))
    tested = row.tested and len(told) > FEWEST_OTHERS
    p, out = p_values(values, stds, tests) if tested else (np.ones(len(told)), np.zeros(len(told), dtype=bool))
    shown = []
    for i, robot in enumerate(robots):
        chance = float(p[i]) if tested else None
        value = RobotValue(robot, float(values[i]), float(stds[i]), row.told[robot][1], chance, bool(out[i]))
        if tested and robot in row.earlier:
            others = ~out & (np.arange(len(told)) != i)
            before = row.earlier[robot]
            then = min(1.0, tests * p_value_beside(before.value, before.std, values[others], stds[others]))
            value = _dated(value, before, then, fits[robot])
        shown.append(value)
    return MakeParameter(
        row.effect, told[0].name, told[0].unit, tested, tuple(shown), summary(values[~out], stds[~out])
    )


def _dated(now: RobotValue, before: Told, p_before: float, fit: SecondFit) -> RobotValue:
    """With the day of its robot's last change, if this parameter stands out on one side of it and is another on the other."""
    size = abs(now.value - before.value) / np.hypot(now.std, before.std)
    if 2.0 * stats.norm.sf(size) >= CHANGED:
        return now
    if now.stands_out:
        return dataclasses.replace(now, since=fit.since, before=before.value, before_std=before.std)
    if p_before < STANDS_OUT:
        return dataclasses.replace(
            now, p_value=p_before, stands_out=True, until=fit.until, before=before.value, before_std=before.std
        )
    return now
