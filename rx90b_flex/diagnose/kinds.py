"""Which effects a search tries, and where there is room for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90b_flex.effects import Effect, Sites
from rx90b_flex.effects.stand_in import as_beside
from rx90b_flex.robot import Robot

MOST_REPEATED = 2  # of one type in one place, until a curve of no known law had its turn


def sites_of(robot: Robot, joints: Sequence[str]) -> Sites:
    """Where a search may try effects: those of a campaign's joints that the robot has, and its tip."""
    rigid = robot.rigid().restricted(tuple(joints))
    sliding = (j for j, unit in zip(rigid.joints, rigid.units, strict=True) if unit.slides)
    return Sites(rigid.joints, robot.tip_frame, sliding=tuple(sliding))


def laws(kind: type[Effect]) -> bool:
    """Effects with a law of their own."""
    return not kind.traits.last_resort


def last_resorts(kind: type[Effect]) -> bool:
    """Curves of no known law."""
    return kind.traits.last_resort


def repeated(kind: type[Effect]) -> bool:
    """Effects that follow the motion and may stand more than once in a place: once more than a few, what only a series makes up."""
    return kind.traits.repeats and kind.traits.repeats_with_motion and laws(kind)


def beside_motion(kind: type[Effect]) -> bool:
    """Effects that do not repeat where the motion does: the noise between repeats holds them."""
    return not kind.traits.repeats_with_motion


def crowded(effect: Effect, here: Sequence[Effect]) -> bool:
    """Whether as many of a type stand in a place as make a series of any curve, and no curve."""
    return not any(e.traits.last_resort for e in here) and _many(effect, here)


def rounded_off(effect: Effect, here: Sequence[Effect]) -> bool:
    """Whether as many stand in a place beside a curve over its angle: what that rounds off is no teeth's."""
    return any(e.traits.last_resort and not e.traits.is_friction for e in here) and _many(effect, here)


def _many(effect: Effect, here: Sequence[Effect]) -> bool:
    return repeated(type(effect)) and sum(type(e) is type(effect) for e in here) >= MOST_REPEATED


def shuts_out(present: Effect, new: Effect) -> bool:
    """Whether an effect of the model leaves no room for another one in its place; a freer form of its own type may replace it."""
    if type(present) is type(new) or present.type_name() == new.type_name():
        return not new.traits.repeats and (type(present) is type(new) or new.type_name() not in new.traits.replaces)
    return new.type_name() in present.traits.stands_for


def leaned_on(effect: Effect, effects: Sequence[Effect]) -> bool:
    """Whether another effect in its place is one that only stands beside it."""
    others = [e for e in effects if e.place == effect.place and e is not effect]
    return any(as_beside(e, others) is None and as_beside(e, [*others, effect]) is not None for e in others)


def rounded(effect: Effect) -> tuple[int, ...]:
    """Logarithms of the shapes in tenths, where an effect may stand twice in one place."""
    logs = np.round(10.0 * np.log(np.abs(effect.shape) + 1e-9)) if effect.traits.repeats else np.zeros(0)
    return tuple(logs.astype(int).tolist())
