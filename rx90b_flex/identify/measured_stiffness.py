"""Stiffnesses that were measured at hinges, put into a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.robot import Robot

# Relative standard deviation from which on a stiffness is no number. Of many hinges, however soft, whose compliance is at least five
# standard deviations, value ± 1.96 std holds the truth for 94 %; where two were enough it would for 89 %, for those pass that
# noise makes look soft.
DETERMINED = 0.2
REACH = 1.96  # standard deviations of a compliance on either side of it: 95 %


@dataclass(frozen=True)
class HingeStiffness:
    """Stiffness of a hinge.

    Attributes
    ----------
    coordinate : str
        ``joint_2:bend_1``.
    value, std : float, N m/rad
        The standard deviation to first order of the compliance's, whose errors are normal.
    measurements : int
        How many it is the weighted mean of.
    p_value : float
        That these differ by their standard deviations alone; one measurement: 1.
    """

    coordinate: str
    value: float
    std: float
    measurements: int = 1
    p_value: float = 1.0

    @property
    def determined(self) -> bool:
        """Whether the data tell it: its standard deviation is less than a fifth of it. Otherwise see `interval`."""
        return bool(self.value > 0.0 and self.std < DETERMINED * self.value)

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of 95 %, that of the compliance inverted; its upper end is infinite where the compliance may be zero.

        Both ends are infinite where even the upper end of the compliance is below zero, which no hinge is.
        """
        compliance, std = 1.0 / self.value, self.std / self.value**2
        ends = compliance + REACH * std, compliance - REACH * std
        low, high = (1.0 / end if end > 0.0 else np.inf for end in ends)
        return low, high

    @property
    def even_std(self) -> float:
        """Standard deviation of which 1.96 on either side are as wide as `interval`; above `std`, infinite without upper end."""
        low, high = self.interval
        return (high - low) / (2.0 * REACH) if np.isfinite(high) else np.inf


def declared_stiffnesses(robot: Robot) -> dict[str, float]:
    """Stiffness of each hinge that a robot declares, N m/rad, by its coordinate."""
    return {
        f"{'_'.join(effect.joints) or 'base'}:{kind}": float(stiffness)
        for effect in robot.effects
        for kind, stiffness in zip(effect.traits.virtual, effect.coefficients, strict=False)
    }


def with_stiffnesses(robot: Robot, found: Mapping[str, float]) -> Robot:
    """The robot with other stiffnesses at some hinges; a hinge's damping keeps its ratio to them.

    Parameters
    ----------
    robot : Robot
    found : mapping of coordinate (``joint_2:torsion``) to stiffness, N m/rad

    Raises
    ------
    ValueError
        A coordinate that no declared flexibility has.
    """
    effects: list[Effect] = []
    placed: set[str] = set()
    for effect in robot.effects:
        names = [f"{'_'.join(effect.joints) or 'base'}:{kind}" for kind in effect.traits.virtual]
        stiffness, damping = np.split(effect.coefficients, 2) if names else (np.zeros(0), np.zeros(0))
        for i, name in enumerate(names):
            if name in found:
                placed.add(name)
                damping[i] *= found[name] / stiffness[i]
                stiffness[i] = found[name]
        effects.append(effect.with_coefficients(np.r_[stiffness, damping]) if placed & set(names) else effect)
    if missing := sorted(set(found) - placed):
        known = ", ".join(c for c in robot.coordinates if not c.endswith(":drive")) or "none"
        raise ValueError(f"{robot.name}: no declared flexibility has {', '.join(missing)}; its hinges: {known}")
    return robot.with_effects(effects)
