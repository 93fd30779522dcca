"""A spring beside the weight of the links: shown where its curve is more than the links' weight, said where it is not."""

from __future__ import annotations

from pathlib import Path

import independent as plain
import numpy as np

import rx90b_flex as rf
from rx90b_flex.diagnose.spring_look import spring_words
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign


def identified(folder: Path, spring: float) -> Identification:
    """An arm of two joints, on its shoulder a spring whose torque turns three times as fast as the weight's."""
    rng = np.random.default_rng(4)
    arm = plain.two_joints(folder)

    def pull(m: plain.Motion, load: np.ndarray) -> np.ndarray:
        out = np.zeros_like(load)
        out[:, 0] = spring * np.sin(3.0 * m.q[:, 0])
        return out

    torques = [plain.friction([1.0, 0.6], [2.0, 1.1]), pull]
    motion = plain.harmonics(rng, 2, period_s=12.0)
    run = plain.run(arm, "identification", motion, torques, plain.white(rng, len(motion.time), [0.1, 0.1]))
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    campaign = load_campaign(plain.write_files(folder, arm, declared, [run], cutoff_hz=15.0))
    regression = Regression.of(rf.load_robot(campaign.robot_source), campaign.identification, campaign.cutoff_hz)
    return identify(regression, regression.robot.effects, fit_links=True)


def test_a_spring_that_the_weight_cannot_be_is_shown(tmp_path: Path) -> None:
    assert "stand out" in spring_words(identified(tmp_path, 3.0), "shoulder")


def test_where_there_is_none_it_is_said_that_none_is_shown(tmp_path: Path) -> None:
    assert "is not shown" in spring_words(identified(tmp_path, 0.0), "shoulder")
