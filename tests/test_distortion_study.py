"""The source's study of nonlinear distortion (section 6.6.6), on the robot of section 6.6.1: `benchmarks/distortion.py`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import distortion
from distortion import Case, measure, relative, six_joints, truth


def test_the_robot_of_section_661_has_three_flexible_joints_and_three_rigid_ones():
    robot = six_joints()
    assert len(robot.joints) == 6 and robot.model.nv == 6 + 9
    assert {name.split(":")[0] for name in robot.coordinates if ":bend" in name} == {"joint_1", "joint_2", "joint_3"}


@pytest.mark.slow
def test_friction_distorts_most_and_the_links_motion_more_above_40_hz(tmp_path: Path):
    robot = six_joints()
    found = {
        (dry, moving): measure(Case(dry=dry, moving=moving), robot, tmp_path)
        for dry in (False, True)
        for moving in (False, True)
    }
    hz = found[True, True].hz
    below = hz < distortion.SPLIT_HZ
    true = truth(robot, hz)
    error = {key: relative(response.value, true) for key, response in found.items()}
    low = {key: np.median(e[below], axis=0) for key, e in error.items()}
    high = {key: np.median(e[~below], axis=0) for key, e in error.items()}
    # all linear: noise, quantisation and sampling are left
    assert (low[False, False] < 0.005).all() and (high[False, False] < 0.02).all()
    # either nonlinearity adds to it, friction ten times as much below 40 Hz
    assert (low[True, False] > 10 * low[False, False]).all()
    assert (low[True, True] > 5 * low[False, True]).all()
    assert (high[False, True] > high[False, False]).all()
    assert (high[False, True] > 5 * low[False, True])[1:].all()
