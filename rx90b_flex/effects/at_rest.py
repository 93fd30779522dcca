"""Effects that data over frequency may show: frequency responses and modes of a robot at rest."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Self

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.motion import Array, Coordinates


@dataclass(frozen=True)
class RestSites:
    """Places of a robot at rest in a pose, where data over frequency may show an effect.

    Attributes
    ----------
    joints : tuple of str
        In tree order.
    tip_frame : str
    moving : tuple of str
        Joints whose drives move; the others are held.
    angles : mapping of joint to angle, rad
        The pose.
    declared : frozenset of (type name, place)
        Effects that the robot has.
    """

    joints: tuple[str, ...]
    tip_frame: str
    moving: tuple[str, ...]
    angles: Mapping[str, float]
    declared: frozenset[tuple[str, tuple[str, ...]]]


@dataclass(frozen=True, eq=False)
class RestSizes:
    """How heavy a robot is at rest, and where data over frequency look: what a new value can be sized by.

    Attributes
    ----------
    coordinates : Coordinates
    mass_matrix : array, shape (n, n)
    total_mass : float, of the links, kg
    band_hz : (low, high)
    """

    coordinates: Coordinates
    mass_matrix: Array
    total_mass: float
    band_hz: tuple[float, float]

    def inertia(self, port: Array) -> float:
        """Along a port (n,), kg m^2."""
        return float(port @ self.mass_matrix @ port)


class ShownAtRest(Effect):
    """An effect that frequency responses and modes may show. Its trait `scaled` says which coefficients a search multiplies."""

    @classmethod
    @abstractmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        """This effect, with values to be multiplied, wherever such data may show it."""

    @abstractmethod
    def starts_at_rest(self, sizes: RestSizes) -> Array:
        """Values of the first coefficient of each group of `scaled` from which a search begins, (S, groups)."""


def undeclared_at_rest(types: Iterable[type[Effect]], sites: RestSites) -> list[ShownAtRest]:
    """Effects of some types that a robot does not have and that such data may show."""
    possible = (e for kind in types if issubclass(kind, ShownAtRest) for e in kind.at_rest(sites))
    return [e for e in possible if (e.type_name(), e.place) not in sites.declared]
