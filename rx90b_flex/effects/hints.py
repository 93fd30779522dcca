"""What only fits and searches ask of an effect: where and at which shapes to try it, and whether it is worth a name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from rx90b_flex.effects.motion import Array, Coordinates, Motion
from rx90b_flex.effects.parameters import Parametrized

SMALLEST_PART = 0.02  # of a joint's root mean square error: what takes less off it is not worth a name


@dataclass(frozen=True)
class Sites:
    """Places of a robot where a search may try an effect: its joints in tree order and its tip frame."""

    joints: tuple[str, ...]
    tip_frame: str


@dataclass(frozen=True)
class RestSites(Sites):
    """Places of a robot at rest in a pose, where data over frequency may show an effect.

    Attributes
    ----------
    moving : tuple of str
        Joints whose drives move; the others are held.
    angles : mapping of joint to angle, rad
        The pose.
    declared : frozenset of (type name, place)
        Effects that the robot has.
    """

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


class Hints(Parametrized, ABC):
    """What fits and searches ask of an effect; all but `everywhere` has an answer that serves most types."""

    def shape_range(self, motion: Motion) -> Array:
        """Lower and upper ends, (2, s), between which this motion can tell the shape parameters, within their bounds."""
        return self.shape_bounds()

    @property
    def shape_keys(self) -> tuple[tuple[str, ...] | None, ...]:
        """What names the one value that several effects share, for each shape parameter; None: it is this effect's own."""
        return (None,) * len(self.shape_names())

    def shape_starts(self, motion: Motion) -> Array:
        """Shapes from which a search begins, shape (M, s). Dense enough for one to lie in the best valley."""
        return np.array([[p.start for _, p in self._flat("shape")]])

    @classmethod
    def usual_shapes(cls) -> dict[str, float]:
        """Shape parameters that mostly have one value, and that value."""
        return {name: p.start for name, p in cls._flat("shape") if p.usual}

    def starts_beside(self, motion: Motion, residual: Sequence[tuple[Motion, Array]], cutoff_hz: float | None) -> Array:
        """Shapes to begin from where the residual helps to find them, shape (M, s).

        Parameters
        ----------
        motion : Motion
            Of the longest recording.
        residual : one (motion, torque left over) a recording, N samples each
            Of the first joint that it sits on; uniform in time.
        cutoff_hz : float or None
            Of the low-pass that the residual went through.
        """
        return self.shape_starts(motion)

    def starts_in_place_of(self, other: Parametrized) -> Array:
        """Shapes to begin from where it is tried in the place of another effect that is known, shape (M, s)."""
        return np.zeros((0, len(self.shape)))

    def shape_spread(self, motion: Motion) -> Array:
        """How far the best shape may lie from the best start, shape (s,)."""
        return 0.3 * self.shape

    def independent_shapes(self, motion: Motion) -> int:
        """How many independent shapes a search tries, for the correction of its significance."""
        return 1

    def possible(self) -> bool:
        """Whether its values go together, and with what its force assumes; bounds of single values are no part of it."""
        return True

    def too_small(self, part: float, sample_s: float, motion: Motion) -> str:
        """Why it is not worth a name, however certain it is, in words; empty where it is.

        Parameters
        ----------
        part : float
            Of the root mean square error of the joint for which it does most, that it takes off on held-out data.
        sample_s : float
            Time between two samples of the log, s.
        motion : Motion
            The longest of the fitted recordings.
        """
        return (
            "" if part >= SMALLEST_PART else f"it takes {max(part, 0.0):.1%} off a joint's error, too little for a name"
        )

    @property
    def roughness(self) -> Array | None:
        """What a fit keeps small beside the squared error: a quadratic form of the coefficients, (k, k); None: nothing.

        The penalty is its `strength` times this, as if the coefficients had that inverse covariance before the data.
        """
        return None

    @property
    def strength(self) -> float | None:
        """Of the penalty; None: not chosen yet, which a fit or a trial does by its data."""
        return None

    def penalised(self, strength: float) -> Self:
        """With that strength of its penalty."""
        return self

    def placed(self, motion: Motion) -> Self:
        """Prepared for a search on a motion: with what of its geometry this motion suggests."""
        return self

    @classmethod
    @abstractmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        """This effect, without values, in every place where a search may try it."""

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        """This effect, with values to be multiplied, wherever frequency responses and modes may show it; empty: nowhere."""
        return []

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        """Values of the first coefficient of each group of `scaled` from which a search over frequency begins, (S, groups)."""
        raise TypeError(f"{self.type_name()} is not tried against data over frequency")

    def rescaled_to(self, values: Mapping[int, float]) -> Self:
        """With other values of some coefficients, by their numbers."""
        own = self.coefficients
        for number, value in values.items():
            own[number] = value
        return self.with_coefficients(own)
