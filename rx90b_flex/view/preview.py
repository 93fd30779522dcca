"""Each joint's measured torque against the declared model's, before anything is fitted."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rx90b_flex.identify.segment import prepare
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import Campaign, load_campaign
from rx90b_flex.signals.facts import sensible_cutoff_hz
from rx90b_flex.view.identify_plots import torque_fit
from rx90b_flex.view.page import Image, image

MOST_SAMPLES = 4000  # of a figure


def preview(source: str | os.PathLike[str] | Campaign) -> dict[str, Figure]:
    """One figure a joint of the first recording; effects without a value are left out."""
    campaign = source if isinstance(source, Campaign) else load_campaign(source)
    robot = load_robot(campaign.robot_source).rigid().restricted(campaign.joints)
    recording = campaign.recordings[0]
    cutoff = campaign.cutoff_hz or min(sensible_cutoff_hz([recording]), 0.2 * recording.sample_rate_hz)
    segment = prepare(robot, recording, cutoff, thin=False)
    force = robot.link_torque(segment.motion)
    for effect in robot.effects:
        if not np.isnan(np.concatenate([effect.coefficients, effect.shape])).any():
            force = force + effect.force(segment.motion)
    rows = np.array([robot.layout.index(j) for j in campaign.joints])
    modelled = segment.brought(force[:, rows])
    part = slice(None, None, max(1, len(modelled) // MOST_SAMPLES))
    units = [u.force for u in robot.units_of(campaign.joints)]
    return {
        joint: torque_fit(
            segment.time[part], segment.torque[part, k], modelled[part, k], joint, "declared model", units[k]
        )
        for k, joint in enumerate(campaign.joints)
    }


def preview_images(source: Path | Campaign) -> list[Image]:
    """The same as parts of a report."""
    alt, caption = "Torque of {}, measured and of the declared model", "{}: first recording, nothing fitted"
    return [image(figure, alt.format(j), caption.format(j), zoom=True) for j, figure in preview(source).items()]
