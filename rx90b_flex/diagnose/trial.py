"""What was tried, what it gained, and why it was or was not accepted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array

SIGNIFICANCE = 1.0e-3  # of the best trial, after correction for everything that was tried
SMALLEST_GAIN = 0.02  # of the squared error of all joints that an effect touches; less is not worth a name
GAIN_T = 2.0  # held-out gain over its standard error, as `Trial.gain_t` has it
REPLICAS = 3  # held-out blocks that show an effect by themselves, where it is absent from others and gains spread;
FEWEST_REPLICAS = 2  # these are enough where it acts in no more than them
AS_GOOD = 0.95  # a simpler effect with this part of the best gain is preferred, if blocks cannot tell them apart
JUST_AS_GOOD = 0.99  # and with this part of it, even if they can: the rest is no reason for more parameters,
LEAVES_AS_LITTLE = 1.2  # unless it leaves so many times the squared error: that may be all that a strong effect leaves
CARRIED = 0.2  # of its gain an effect keeps where whole recordings are left out, or it is no name for what is missing
FAINTEST = 1.0e-3  # of a joint's torque: no motor's or sensor's torque signal is linear beyond that
# Of a line by the clock: phases that differ by more than twenty degrees from recording to recording keep less.
PHASE_CARRIED = 0.7


class Trial(ABC):
    """A candidate that was tried beside a model; a residual's own kind says by what it is judged."""

    members: tuple[Trial, ...] = ()  # of candidates that are one hypothesis together

    @property
    @abstractmethod
    def label(self) -> str:
        """The candidate's name."""

    @property
    @abstractmethod
    def refusal(self) -> str:
        """Why it is not accepted, in words; empty where it is."""

    @property
    def accepted(self) -> bool:
        """Whether it may be added."""
        return not self.refusal


@dataclass(frozen=True, eq=False)
class TorqueTrial(Trial):
    """One effect, tried in one place on torques over time, judged by what was held out.

    Attributes
    ----------
    effect : Effect
        With the values that fit best beside the present model.
    gain : float
        Drop of the weighted squared error on held-out blocks, in units of residual variance.
    block_gains : array, shape (blocks,)
    p_value : float
        That nothing is there, corrected for the number of trials.
    size : int
        Parameters that it adds to the model.
    share : float
        Gain over the squared error of the joints that it touches.
    lawful : bool
        Whether its values are such as it can have, and this data can tell them.
    colour : float
        Variance of its torque's product with the residual, over what white noise would give.
    objection : str
        Why its values are not lawful, or why it fell once everything was fitted with it; empty where neither is so.
    small : str
        Why it is not worth a name by its own rule (`Effect.too_small`); empty where it is.
    lost, by_chance : array, shape (recordings,)
        Rise of the squared error of each recording that was left out as a whole, and what chance explains of one; empty where
        the log is too short for that.
    members : tuple of TorqueTrial
        Of a family: one law on several joints, one hypothesis. `effect` is then the first member's.
    acting : int
        Blocks in which its torque is large enough to show by itself.
    left : float
        Weighted squared error of the joints that it touches with it in the model.
    alone : float
        The p-value of a hypothesis that nobody had to search for: corrected for the shapes of this one effect alone.
    of_family : bool
        Whether it was added as one of several joints' that have one law.
    """

    effect: Effect
    gain: float
    block_gains: Array
    p_value: float
    size: int
    share: float
    lawful: bool
    colour: float = 1.0
    objection: str = ""
    lost: Array = field(default_factory=lambda: np.zeros(0))
    by_chance: Array = field(default_factory=lambda: np.zeros(0))
    members: tuple[TorqueTrial, ...] = ()
    small: str = ""
    acting: int = REPLICAS
    left: float = np.inf
    alone: float = 1.0
    of_family: bool = False

    @property
    def label(self) -> str:
        return self.effect.label

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What it adds: one effect, or a family's."""
        return tuple(m.effect for m in self.members) or (self.effect,)

    @property
    def gain_t(self) -> float:
        """Mean over standard error of the blocks' gains, as signed roots: an effect that acts much in one block and
        little in others, such as a saturation, differs between them without being less sure.
        """
        roots = np.sign(self.block_gains) * np.sqrt(np.abs(self.block_gains))
        error = roots.std(ddof=1) / np.sqrt(len(roots))
        return float(roots.mean() / error) if error > 0 else np.inf

    @property
    def worst(self) -> float:
        """Largest loss on a recording that was left out as a whole, over what chance explains; below one: none."""
        return float((self.lost / np.maximum(self.by_chance, 1e-300)).max()) if len(self.lost) else 0.0

    @property
    def carried(self) -> float:
        """Part of the gain on held-out blocks that is left where whole recordings are held out."""
        return -float(self.lost.sum()) / self.gain if len(self.lost) else 1.0

    @property
    def replicated(self) -> bool:
        """Whether several held-out blocks show it, or all recordings that were left out, each beyond its own noise, and what
        other blocks lose is within theirs.

        A gain g of an effect that is there has the variance 4 g `colour`. An effect that acts in bursts leaves some blocks
        without a gain; their spread says little of it, but every block that has one is an experiment of its own. One that acts
        at rest alone may have a single such block in a recording: then each recording is. No block is asked for an effect that does
        not act in it.
        """
        if self.effect.traits.last_resort:
            return False  # a curve of no known law has nothing but carrying over everywhere to speak for it
        shown = self.block_gains > shows_by_itself(self.colour)
        lost = -float(np.minimum(self.block_gains, 0.0).sum())
        often = shown.sum() >= min(REPLICAS, max(FEWEST_REPLICAS, self.acting)) or self.worst < -1.0
        return bool(often and lost <= GAIN_T * 2.0 * np.sqrt(max(self.gain, 0.0) * self.colour))

    @property
    def sure_gain(self) -> float:
        """Gain less twice its standard error: what it explains beyond the luck of a few blocks.

        Zero for one that is only `replicated`: it gives way to all that every block shows.
        """
        if self.gain <= 0:
            return self.gain
        sure = self.gain * (1.0 - GAIN_T / max(self.gain_t, 1e-9))
        return max(sure, 0.0) if self.replicated else sure

    @property
    def refusal(self) -> str:
        """Why it is not significant, does not hold on data it was not fitted to, is not lawful or not worth a name."""
        if not self.lawful:
            return self.objection or "its values are not such as it can have"
        if self.p_value >= SIGNIFICANCE:
            return f"chance would do as well (p = {self.p_value:.2g})"
        if self.share <= SMALLEST_GAIN:
            return f"it explains {max(self.share, 0.0):.1%} of the squared error, too little for a name"
        if self.small:
            return self.small
        if not (self.gain_t > GAIN_T or self.replicated):
            return "parts of the data that were held out disagree on it"
        if self.worst > 1.0:
            return "it raises the error of a recording that was left out"
        if self.carried < (PHASE_CARRIED if self.effect.traits.by_clock else CARRIED):
            return f"of its gain {max(self.carried, 0.0):.0%} carries over to recordings that were left out as a whole"
        return self.objection

    @property
    def belongs(self) -> bool:
        """Whether it may be one of a family: what others are sure of it need only help where it was held out."""
        return self.lawful and self.gain > 0 and self.share > SMALLEST_GAIN and not self.small and self.worst <= 1.0

    def no_better_than(self, other: TorqueTrial) -> bool:
        """Whether held-out blocks cannot tell that this one explains more than the other."""
        alike = other.effect.joints == self.effect.joints and not (self.members or other.members)
        if alike and other.left > LEAVES_AS_LITTLE * self.left:
            return False
        if other.gain >= JUST_AS_GOOD * self.gain:
            return True
        difference = self.block_gains - other.block_gains
        spread = difference.std(ddof=1) * np.sqrt(len(difference))
        return bool(other.gain >= AS_GOOD * self.gain and difference.sum() <= GAIN_T * spread)


def gain_of_chance(tests: int) -> float:
    """Gain in white noise, in units of residual variance, that chance reaches too where so many trials are made."""
    return float(stats.chi2.isf(SIGNIFICANCE / max(1, tests), 1))


def shows_by_itself(colour: float) -> float:
    """Gain of a held-out block, in units of residual variance, beyond its own noise."""
    return (2.0 * GAIN_T) ** 2 * colour


def choose(trials: Sequence[TorqueTrial]) -> TorqueTrial | None:
    """The trial to add: the largest sure held-out gain, or a simpler one that the data cannot tell from it."""
    accepted = [t for t in trials if t.accepted]
    if not accepted:
        return None
    best = max(accepted, key=lambda t: (t.sure_gain, t.gain))
    as_good = [t for t in accepted if t is best or (t.size <= best.size and best.no_better_than(t))]
    # where one block outweighs the others no gain is sure: of those that explain it alike, the one that they show too
    return min(as_good, key=lambda t: (t.size, -t.sure_gain, -t.gain_t))


def too_faint(torque: Array, measured: Array) -> str:
    """That an effect's torque (N, joints) is less than a torque signal's own errors, in words; empty where it is not."""
    part = float(np.sqrt((torque**2).mean(axis=0) / np.maximum((measured**2).mean(axis=0), 1e-300)).max())
    return "" if part >= FAINTEST else f"its torque is {part:.1g} of a joint's, too little for a name"


def meet(one: Effect, other: Effect) -> bool:
    """Whether two effects act on a joint in common; one without joints acts on all."""
    return not (one.joints and other.joints) or not set(one.joints).isdisjoint(other.joints)


def off_a_joint(before: Array, after: Array, gain: float) -> float:
    """Part of the root mean square error that an effect takes off the joint for which it does most.

    Parameters
    ----------
    before, after : array, shape (joints,)
        Weighted squared errors on all rows, of the joints that it touches.
    gain : float
        On held-out blocks, over all of them: joints share in it as they do in the drop on all rows.
    """
    drop = before - after
    whole = float(drop.sum())
    shares = gain * drop / (whole * np.maximum(before, 1e-300)) if whole > 0 else np.zeros(1)
    return float(1.0 - np.sqrt(np.clip(1.0 - shares.max(), 0.0, 1.0)))


def added(effects: Sequence[Effect], new: Effect) -> tuple[Effect, ...]:
    """The list of effects with a new one, which takes the place of what it replaces."""
    kept = [e for e in effects if not (e.place == new.place and e.type_name() in new.traits.stands_for)]
    return (*kept, new)
