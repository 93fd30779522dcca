"""What only fits and searches ask of an effect: where and at which shapes to try it, and whether it is worth a name."""

from __future__ import annotations

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.effects.parameters import Parametrized

if TYPE_CHECKING:
    from rx90b_flex.effects.effect import Effect

SMALLEST_PART = 0.02  # of a joint's root mean square error: what takes less off it is not worth a name


@dataclass(frozen=True)
class Sites:
    """Places of a robot where a search may try an effect.

    Attributes
    ----------
    joints : tuple of str
        In tree order.
    tip_frame : str
    motions : tuple of Motion
        On which it is tried, a recording each, where they are known: they suggest the geometry that a curve needs.
    sliding : tuple of str
        Those joints that slide and do not turn.
    open_scale : frozenset of str
        Those whose torques are currents times constants that a model told: another gain of such a torque is that constant.
    """

    joints: tuple[str, ...]
    tip_frame: str
    motions: tuple[Motion, ...] = ()
    sliding: tuple[str, ...] = ()
    open_scale: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class LeftOver:
    """What a model leaves over, beside which an effect is tried.

    Attributes
    ----------
    residual : one (motion, torque left over) a recording, N samples each
        Of the first joint that the effect sits on; uniform in time.
    cutoff_hz : float or None
        Of the low-pass that the residual went through.
    instead_of : effect or None
        One of the model, with values, in whose place the new one is tried.
    """

    residual: Sequence[tuple[Motion, Array]]
    cutoff_hz: float | None = None
    instead_of: Parametrized | None = None


@dataclass(frozen=True, eq=False)
class ShapeSearch:
    """Where a search for the shape of an effect begins, and how far it goes from there.

    Attributes
    ----------
    starts : array, shape (M, s)
        Dense enough for one to lie in the best valley.
    independent : int
        How many independent shapes it tries, for the correction of its significance.
    part : float or array, shape (s,)
        Of the best start, how far the best shape may lie from it.
    spread : array, shape (s,), or None
        The same as it is, where it does not grow with the start.
    mixes : bool
        Whether several at all starts together come near one at the mean of these, weighted with their single coefficients: that
        is one more start, wherever it lies.
    """

    starts: Array
    independent: int = 1
    part: float | Array = 0.3
    spread: Array | None = None
    mixes: bool = False

    def reach(self, start: Array) -> Array:
        """How far the best shape may lie from a start (s,), shape (s,)."""
        return np.asarray(self.part * start if self.spread is None else self.spread)


@dataclass(frozen=True, eq=False)
class Penalty:
    """What a fit keeps small beside the squared error, ``strength * c @ roughness @ c`` of coefficients c.

    Attributes
    ----------
    roughness : array, shape (k, k)
    strength : float or None
        None: not chosen yet, which a fit or a trial does by its data.
    """

    roughness: Array
    strength: float | None

    @property
    def precision(self) -> Array:
        """Inverse covariance that the coefficients have before the data, (k, k); zero while the strength is not chosen."""
        return (0.0 if self.strength is None else self.strength) * self.roughness


class Hints(Parametrized, ABC):
    """What fits and searches ask of an effect; all of it has an answer that serves most types."""

    def shape_range(self, motion: Motion) -> Array:
        """Lower and upper ends, (2, s), between which this motion can tell the shape parameters, within their bounds."""
        return np.array([[p.lower, p.upper] for p in self.shape_parameters.values()]).reshape(-1, 2).T

    def shape_range_beside(self, motion: Motion, others: Sequence[Effect]) -> Array:
        """The same in a model with other effects: narrower where it would else play the part of one that is missing there."""
        return self.shape_range(motion)

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """How its shape is searched for on a motion, by what a model leaves over there if that helps to find it."""
        return ShapeSearch(np.array([[p.start for p in self.shape_parameters.values()]]))

    def independent_shapes(self, motion: Motion) -> int:
        """How many independent shapes that search tries, without where it begins."""
        return self.shape_search(motion).independent

    @classmethod
    def too_seldom(cls, sites: Sites) -> Sequence[Effect]:
        """What of one joint and coefficient is not tried, for these motions show it too seldom to be judged by them alone."""
        return ()

    def begun_otherwise(self) -> Sequence[Effect]:
        """The same with other guesses at what it held as a log begins, which no log tells."""
        return ()

    def possible(self) -> bool:
        """Whether its values go together, and with what its force assumes; bounds of single values are no part of it."""
        return True

    def caution(self) -> str:
        """What has to be said where it is found: why it is doubted, or what its values are taken for; empty where nothing."""
        return ""

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

    def held_beside(self, others: Sequence[Effect], motions: Sequence[Motion]) -> Array:
        """Combinations of its coefficients, (k, n), that a fit leaves at zero: on these motions others have all of their torque."""
        return np.zeros((len(self.coefficients), 0))

    @property
    def penalty(self) -> Penalty | None:
        """What a fit keeps small of its coefficients; None: nothing."""
        return None

    def penalised(self, strength: float | None) -> Self:
        """With that strength of its penalty."""
        return self
