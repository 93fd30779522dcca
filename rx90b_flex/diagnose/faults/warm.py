"""A recording in which the robot was warmer or colder than in the others: its friction is another, and nothing is wrong with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.diagnose.faults.rigid_fit import FRICTION, PER_JOINT
from rx90b_flex.effects.motion import Array, Mask

AS_WELL, WITH_OTHERS = 1.1, 2.5  # of the squared error with a torque scaled, up to which its friction explains as much
# times the others' friction, or over it, up to which another one is believed where it takes most of the error: friction often
# changes so, and another unit of one joint's torque in one recording hardly ever
WARMER = 1.6
MOSTLY = 0.5  # of a recording's squared error that another friction of its joints leaves: it is no other load


class OfFriction(NamedTuple):
    """Squared error of each recording and joint, (recordings, joints), N^2 m^2."""

    left_now: Array
    left_of_all: Array  # with the joint's torque times what fits that recording best
    left: Array  # with its friction alone so
    times: Array  # that factor of its friction
    spread: Array  # variance of each joint's torque, (joints,), N^2 m^2

    @property
    def warm(self) -> Mask:
        """Recordings of whose error another friction of the joints takes most, (recordings,)."""
        return np.asarray((self.left / self.spread).sum(axis=1) < MOSTLY * (self.left_now / self.spread).sum(axis=1))

    def explains(self, recording: int, joint: int) -> bool:
        """Whether friction does as well as the whole torque; less well where that of most joints is another, too."""
        mostly = self.left[recording] < MOSTLY * self.left_now[recording]
        if mostly[joint] and 1 / WARMER < self.times[recording, joint] < WARMER:
            return True
        room = AS_WELL if mostly.mean() <= 0.5 else WITH_OTHERS
        return bool(self.left[recording, joint] < room * self.left_of_all[recording, joint])


def of_friction(look: Look) -> OfFriction:
    """Whether a recording that stands apart has another friction: a robot is warmer in one than in another."""
    sample = look.sample
    measured, predicted = look.measured(), look.predicted_by_others
    friction = rubs(look, look.theta_by_others)

    def left(part: Array) -> tuple[Array, Array]:
        out, times = [], []
        for span in sample.spans:
            rest, some = (measured - predicted + part)[span], part[span]
            times.append((some * rest).sum(axis=0) / np.maximum((some**2).sum(axis=0), 1e-300))
            out.append(((rest - times[-1] * some) ** 2).mean(axis=0))
        return np.array(out), np.array(times)

    now = np.array([((measured - predicted)[span] ** 2).mean(axis=0) for span in sample.spans])
    return OfFriction(now, left(predicted)[0], *left(friction), measured.var(axis=0) + 1e-300)


def rubs(look: Look, theta: Array) -> Array:
    """Basic friction of a fit's parameters at each row (R, p), or at all of them (1, p); (R, joints), N m."""
    columns, links = look.columns(look.reading), look.reading.links
    own = [[links + PER_JOINT * j + i for i in FRICTION] for j in range(len(look.sample.joints))]
    return np.stack([(columns[:, j, at] * theta[:, at]).sum(axis=1) for j, at in enumerate(own)], axis=1)
