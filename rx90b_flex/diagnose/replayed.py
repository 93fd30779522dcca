"""A robot as its file gives it, replayed on a campaign's recordings: the check of what a written robot is said to predict."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from rx90b_flex.diagnose.residual import Errors, ReplayedTorques, replayed_errors
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import prepare
from rx90b_flex.identify.torque_scale import scaled
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Campaign, load_campaign
from rx90b_flex.signals.recording import Role

ROLES: tuple[Role, Role] = ("validation", "identification")


def replay_errors(
    robot: str | os.PathLike[str] | Robot, campaign: str | os.PathLike[str] | Campaign, role: Role = "validation"
) -> Errors:
    """Torque errors of a robot with the values that it has, nothing identified, on the recordings of one role.

    The same motion, differences and low-pass as in closing the loop: a robot that this has written gives the error ``after``
    that it stated. Torque constants that the campaign leaves out are those with which the robot fits the recordings for
    identification.

    Parameters
    ----------
    robot : path or Robot
        As `load_robot` takes it.
    campaign : path or Campaign
    role : "identification" or "validation"

    Raises
    ------
    ValueError
        No recording of that role, joints that the robot lacks, or an effect without a value.
    """
    loaded = robot if isinstance(robot, Robot) else load_robot(os.fspath(robot))
    known = campaign if isinstance(campaign, Campaign) else load_campaign(Path(campaign))
    if not any(r.role == role for r in known.recordings):
        raise ValueError(f"{known.path}: no recording has role {role!r}")
    both = replayed(loaded, _with_constants(loaded, known), role)
    return replayed_errors(*zip(*both, strict=True))


def _with_constants(robot: Robot, campaign: Campaign) -> Campaign:
    """With the torques of currents whose constants are left out, by what the robot says of them."""
    stated = campaign.torque_constants or ()
    missing = [j for j, constant in zip(campaign.joints, stated, strict=False) if constant is None]
    if not missing:
        return campaign
    pairs = replayed(robot, campaign, "identification")
    current, said = (np.concatenate(x) for x in zip(*((r.torque, torque) for r, torque in pairs), strict=True))
    factors = (current * said).sum(axis=0) / np.maximum((current**2).sum(axis=0), 1e-300)
    told = dict(zip(campaign.joints, factors.tolist(), strict=True))
    return scaled(campaign, {j: told[j] for j in missing})


def replayed(robot: Robot, campaign: Campaign, role: Role) -> list[tuple[ReplayedTorques, Array]]:
    """Recordings of one role, each with the torque of a robot as it stands, (N, joints), N m, after the low-pass."""
    rigid = robot.over_time().restricted(campaign.joints)
    recordings = [r for r in campaign.recordings if r.role == role]
    sticking = Regression.of(robot, campaign.identification, campaign.cutoff_hz).sticking
    replays = [
        ReplayedTorques(rigid, prepare(rigid, r, campaign.cutoff_hz, thin=False, sticking=sticking)) for r in recordings
    ]
    return [(r, r.predict(rigid.effects, rigid.link_parameters)) for r in replays]
