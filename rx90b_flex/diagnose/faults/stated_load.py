"""What recordings state to be on the flange, against what their torques ask for there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.faults.columns_in_one import name_of
from rx90b_flex.diagnose.faults.compare import CREDIBLE, GAIN, MODEST, TIE
from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.diagnose.faults.rigid_fit import RigidFit
from rx90b_flex.diagnose.faults.sample import FOLDS, Reading
from rx90b_flex.diagnose.faults.warm import of_friction
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.carried import LINK
from rx90b_flex.signals.data_fault import DataFault
from rx90b_flex.signals.stated import FlangeLoad

SURE = 8.0  # standard deviations that a mass or a place is off
LEAST = 0.03  # of the stated mass: so much it is off by at the least, and with so little there is none
ELSEWHERE = 0.02  # m from where it is stated, at the least


def stated_load(look: Look) -> tuple[DataFault | None, Look]:
    """Whether one payload other than a stated one explains what nothing else does.

    Links that are known tell any payload, fitted ones what that of some recordings differs by from that of the others. More mass than
    is stated beside known links can be used all the same: a search adds it.

    Returns
    -------
    DataFault or None
    Look
        At the same data, with that payload stated.
    """
    found = [x for load in dict.fromkeys(t.load for t in look.sample.tracks) if load and (x := _other(look, load))]
    if not found:
        return None, look
    other = max(found, key=lambda x: x.before.score - x.after.score)
    return other.fault(look), look.stating(other.true, other.recordings)


@dataclass(frozen=True, eq=False)
class _Other:
    """Another payload than is stated in some recordings, with fits without and with it, and its mass's standard deviation."""

    stated: FlangeLoad
    recordings: tuple[int, ...]
    before: RigidFit
    after: RigidFit
    mass: float
    std: float
    centre: tuple[float, float, float]

    @property
    def true(self) -> FlangeLoad | None:
        return FlangeLoad(self.mass, self.centre) if self.mass > LEAST * self.stated.mass else None

    @property
    def off(self) -> bool:
        """Whether its mass differs."""
        return abs(self.stated.mass - self.mass) > max(SURE * self.std, LEAST * self.stated.mass)

    def fault(self, look: Look) -> DataFault:
        known = look.reading.robot.inertial_parameters == "known"
        of_all = len(self.recordings) == len(look.sample.tracks)
        names = ", ".join(name_of(look, r) for r in self.recordings)
        whose = "The recordings state" if of_all else f"{names}: stated is"
        part = f"; or bring the torques to N m: all being {self.mass / self.stated.mass:.3g} times the true ones looks the same."
        alike = part if self.off else "."
        true, beside = self.true, " with the links that the robot file calls known" if known else ""
        text = (
            f"{whose} a payload of {self.stated.mass:g} kg {_at(self.stated.centre)};{beside} the torques go with "
            f"{f'{self.mass:.3g} kg' if true else 'none'} (std {self.std:.2g} kg){f' {_at(self.centre)}' if true else ''}"
            f"{'' if of_all else ', beside what the others state'}: correct `payload`"
            + (', or the links, or let these be fitted with inertial_parameters = "fitted".' if known else alike)
        )
        factor = self.stated.mass / self.mass if self.off and true else None
        before, after = (float(np.sqrt(np.minimum(f.error, 1.0).mean())) for f in (self.before, self.after))
        usable = known and of_all and self.off and self.mass > self.stated.mass
        return DataFault("kinematics", None, (), text, usable, before, after, factor=factor)


def _other(look: Look, stated: FlangeLoad) -> _Other | None:
    recordings = tuple(r for r, track in enumerate(look.sample.tracks) if track.load == stated)
    known, of_all = look.reading.robot.inertial_parameters == "known", len(recordings) == len(look.sample.tracks)
    if (of_all and not known) or (not of_all and of_friction(look).warm[list(recordings)].all()):
        return None
    reading = look.reading
    for r in recordings:
        reading = reading.changed_in(r, {"other_load": True})
    before, after, beside = look.fit(), look.fit(reading), look.beside
    gains = before.score - after.score, beside.fit().score - beside.fit(reading).score
    as_good = not known or after.score < look.fit_of_free_links().score + TIE
    if gains[0] < GAIN or gains[1] < MODEST or not as_good or not (after.error < CREDIBLE).all():
        return None
    values, stds = _load(look, reading, after, stated)
    other = _Other(
        stated, recordings, before, after, float(values[0]), float(stds[0]), (values[1], values[2], values[3])
    )
    moved = np.abs(values[1:] - stated.centre) > np.maximum(SURE * stds[1:], ELSEWHERE)
    return other if other.off or moved.any() else None


def _load(look: Look, reading: Reading, fit: RigidFit, stated: FlangeLoad) -> tuple[Array, Array]:
    """Mass and centre in the tip frame (4,), of the stated point mass with what the fit has beyond it, and standard deviations."""
    robot = reading.robot
    placement = robot.model.frames[robot.model.getFrameId(robot.tip_frame)].placement
    factor = fit.theta[:, -LINK - 1 : -LINK]  # by which the stated one was taken
    own = stated.mass * np.array([1.0, *placement.act(np.array(stated.centre))])
    each = fit.theta[:, -LINK:][:, :4] + factor * own
    places = [placement.actInv(x) for x in each[:, 1:] / np.maximum(each[:, :1], 1e-9)]
    values = np.hstack([each[:, :1], places])
    # each fold's parameters come of all other folds: the jackknife's standard deviation
    spread = np.sqrt((FOLDS - 1) / FOLDS * ((values - values.mean(axis=0)) ** 2).sum(axis=0))
    return values.mean(axis=0), spread


def _at(centre: Sequence[float]) -> str:
    return f"at ({', '.join(f'{round(x, 3) + 0.0:.3f}' for x in centre)}) m in the tip frame"
