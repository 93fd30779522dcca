"""Claims about added effects that mostly cancel: a caution says that their own values tell little."""

from __future__ import annotations

import re

import numpy as np
import pytest
from independent import harmonics, run, two_joints, white, write_files

import rx90b_flex as rf
from rx90b_flex.diagnose.cancelling import cancelling
from rx90b_flex.effects.springs import JointSpring
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign


@pytest.fixture(scope="module")
def regression(tmp_path_factory: pytest.TempPathFactory) -> Regression:
    """A recording of two joints, whose torques are those of the links."""
    folder = tmp_path_factory.mktemp("two")
    arm, rng = two_joints(folder), np.random.default_rng(4)
    m = harmonics(rng, 2, period_s=10.0, rate_hz=200.0, lines=8)
    runs = [run(arm, role, m, [], white(rng, len(m.time), (0.01, 0.01))) for role in ("identification", "validation")]
    campaign = load_campaign(write_files(folder, arm, [], runs, cutoff_hz=20.0, known=True))
    return Regression.of(rf.load_robot(campaign.robot_source), campaign.identification, campaign.cutoff_hz)


def said(regression: Regression, *stiffness: float) -> list[str]:
    """Of springs of the elbow, N m/rad, one behind the other."""
    springs = [JointSpring(joint="elbow", stiffness=k, rest_angle=0.3) for k in stiffness]
    return list(cancelling(identify(regression, [], fit_links=False), springs, regression))


def test_two_that_take_each_other_back_are_said(regression: Regression) -> None:
    (text,) = said(regression, 30.0, -24.0)
    angle = regression.longest.q[:, 1]
    assert "mostly cancel" in text and text.startswith("On elbow, elbow.joint_spring")
    numbers = [float(x) for x in re.findall(r"([\d.]+) N m rms", text)]
    assert numbers == pytest.approx([k * angle.std() for k in (30.0, 24.0, 6.0)], rel=0.02)


@pytest.mark.parametrize("stiffness", [(3.0,), (3.0, 2.0), (3.0, -0.5)])
def test_springs_of_which_none_takes_much_of_another_back_are_not(
    regression: Regression, stiffness: tuple[float, ...]
) -> None:
    assert said(regression, *stiffness) == []
