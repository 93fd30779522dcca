"""The verdict on a closed loop: what remains, beside noise and beside what can be explained at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.events import Events
from rx90b_flex.diagnose.evidence import Dependence
from rx90b_flex.diagnose.free_form import NO_FORM
from rx90b_flex.diagnose.loop import verdict
from rx90b_flex.diagnose.residual import Errors, RoleErrors
from rx90b_flex.diagnose.yardstick import Explainable
from rx90b_flex.effects.motion import Array, Mask

NEAR_FLOOR = 1.2  # residual over noise floor above which something is called unexplained, if it depends on a signal
FAR_FROM_FLOOR = 1.5  # and above which it is, even if no signal is found that it depends on
STRONG = 0.2  # part of a joint's squared residual that depends on one signal: too much for noise
ENOUGH = 0.8  # share of what a free form explains from which a residual counts as explained
NEAR_FREE = 1.1  # a joint's error over that of its free form that is no sign of anything missing
MOST_LEFT = 0.5  # of a joint's torque: what no free form predicts and no noise is known to be is not explained either
NOTHING = 1e-4  # of the torque: less than any torque is measured to, as of recordings that somebody computed
DEPENDS_FREE = 1.05  # and that is none either where the joint's residual still depends on a signal
RAISED = 1.15  # times a joint's error held out, by all that was added: said, whatever the others gain


def raised(joints: Sequence[str], before: Errors, after: Errors) -> Iterator[str]:
    """That what was added raises a joint's error on recordings that were not fitted, one caution a joint."""
    for joint, less, more in zip(joints, before.told.torque_rms, after.told.torque_rms, strict=True):
        if more > RAISED * less > 0.0:
            yield (
                f"What was added raises the error of {joint}, held out, to {more / less:.3g} times what it was: it is no law of that "
                "joint, whatever others gain by it."
            )


@dataclass(frozen=True, eq=False)
class Remains:
    """What a loop ended with.

    Attributes
    ----------
    joints : tuple of str
    found : bool
        Whether effects were added.
    before, after : RoleErrors
    floor : array, shape (joints,), or None
        Noise of the torque, N m; None where it is not known.
    explainable : Explainable or None
        None where a free-form model says nothing.
    where : sequence of Dependence
        Signals that the residual still depends on.
    doubtful : bool
        Whether the data holds what a rigid tree cannot have, or mostly noise whose size is not known.
    spread : array, shape (joints,), or None
        Standard deviation of the measured torque on validation, N m; None where errors have no size to go by.
    events : sequence of Events
        Where most of a joint's error on validation lies in a few short times.
    slow : bool
        Whether much of a joint's torque is left that is too slow for noise, or what shows too seldom for a name.
    curved : sequence of str
        Joints to which a curve of no known law was added.
    """

    joints: tuple[str, ...]
    found: bool
    before: RoleErrors
    after: RoleErrors
    floor: Array | None
    explainable: Explainable | None
    where: Sequence[Dependence]
    doubtful: bool = False
    spread: Array | None = None
    events: Sequence[Events] = ()
    slow: bool = False
    curved: Sequence[str] = ()

    @property
    def verdict(self) -> str:
        """``nothing_missing``, ``explained``, ``partly_explained`` or ``unexplained``."""
        # what helps on the fitted recordings alone explains nothing for certain
        pairs = (self.before, self.after), (self.before.told, self.after.told)
        carried = all(a.validation.relative_error < b.validation.relative_error for b, a in pairs)
        return verdict(self.found, self.left, carried and not self.doubtful)

    @property
    def nothing(self) -> bool:
        """Whether next to nothing is left, whatever it looks like."""
        return self.after.told.validation.relative_error < NOTHING

    @property
    def left(self) -> bool:
        """Whether something remains that is neither noise nor beyond what a free form explains."""
        if self.nothing:
            return False
        if self.floor is not None:
            # what happens at a few instants makes repeats differ, too: a floor that holds it hides it
            happened = self._among([e.joint for e in self.events])
            return bool((self._above_floor(self.floor) | self._not_carried_over(self.floor) | happened).any())
        if self.events or self.slow or any(d.score > STRONG for d in self.where) or self._mostly_left:
            return True  # whatever a free form makes of it
        if self.explainable is not None:
            return self._short_of(self.explainable) or bool(self._above_free_form(self.explainable).any())
        return True  # neither measure is known, so nobody can say that nothing is left

    def _short_of(self, explainable: Explainable) -> bool:
        """Whether too small a part of what can be explained is, of all rows that are reported, too, where effects are said to do so;
        where none are and a free form leaves hardly less, there is no part to be had: closed again, what was explained is.
        """
        before, after = (e.told.validation for e in (self.before, self.after))
        share = explainable.told.of(before, after).share
        if self.found:
            return min(share, explainable.share) < ENOUGH
        return share < ENOUGH and after.relative_error > NEAR_FREE * explainable.validation.told.relative_error

    @property
    def _mostly_left(self) -> bool:
        """Whether a joint is left with so much that torques of other motions, or of another clock, would look the same."""
        if self.spread is None:
            return False
        return bool((np.array(self.after.told.validation.torque_rms) > MOST_LEFT * self.spread).any())

    def _above_free_form(self, explainable: Explainable) -> Mask:
        """Joints left with more than their free form leaves, part of its drop allowed for, shape (joints,)."""
        before, after, free = (
            np.array(e.torque_rms)
            for e in (self.before.told.validation, self.after.told.validation, explainable.validation.told)
        )
        room = (1.0 - ENOUGH) * np.maximum(before - free, 0.0)
        # where the free form found nothing, a signal that the residual depends on has found more
        silent = np.array([form == NO_FORM for form in explainable.forms])
        over = after > np.where(self._named, DEPENDS_FREE, NEAR_FREE) * free + room
        return np.asarray(over | (silent & self._named))

    def _above_floor(self, floor: Array) -> Mask:
        # friction that changes sign within one sample leaves spikes of up to a third of the noise that depend on nothing
        ratio = np.array(self.after.told.identification.torque_rms) / np.maximum(floor, 1e-300)
        return np.asarray((ratio > FAR_FROM_FLOOR) | ((ratio > NEAR_FLOOR) & self._named))

    def _not_carried_over(self, floor: Array) -> Mask:
        """Joints whose error on validation is far above the noise, shape (joints,).

        Where a free form leaves as much it counts if it is none of motion, which nothing that was fitted knows of, or if the model
        has a curve of no known law there, which is a free form itself.
        """
        far = np.array(self.after.told.validation.torque_rms) > FAR_FROM_FLOOR * floor
        if self.explainable is None:
            return np.asarray(far)
        others = self._among([*(e.joint for e in self.events), *self.curved])
        return np.asarray(far & (self._above_free_form(self.explainable) | others))

    @property
    def _named(self) -> Mask:
        return self._among([d.joint for d in self.where])

    def _among(self, joints: Sequence[str]) -> Mask:
        return np.isin(self.joints, joints)
