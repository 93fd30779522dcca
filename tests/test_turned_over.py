"""Claims about how dry friction turns over where a much larger effect hid it: it is asked again once that is in the model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from test_rests import from_point_to_point

import rx90b_flex as rf
from rx90b_flex.diagnose.turned_over import turned_over_again
from rx90b_flex.effects import Effect
from rx90b_flex.effects.drive import TorqueOffset
from rx90b_flex.effects.friction import CoulombFriction, ViscousFriction
from rx90b_flex.effects.springs import JointSpring
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign

TURNOVER = 0.01  # rad/s
COULOMB, VISCOUS, NOISE = (1.0, 0.6), (1.5, 0.8), (0.02, 0.01)
STIFFNESS = 40.0  # N m/rad, of a spring on the first joint


def made(folder: Path, seed: int) -> Regression:
    arm, rng, runs = ind.two_joints(folder), np.random.default_rng(seed), []
    sprung = ind.hidden("joint_spring", 0, {"stiffness": STIFFNESS, "rest_angle": 0.2})

    def rubbing(m: ind.Motion, load: ind.Array) -> ind.Array:
        return COULOMB * np.tanh(m.v / TURNOVER) + VISCOUS * m.v

    for role in ("identification", "identification", "validation"):
        m, _ = from_point_to_point(rng, 2)
        runs.append(ind.run(arm, role, m, [rubbing, sprung], ind.white(rng, len(m.time), NOISE)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    campaign = load_campaign(ind.write_files(folder, arm, declared, runs, cutoff_hz=20.0, known=True))
    return Regression.of(rf.load_robot(campaign.robot_source), campaign.identification, campaign.cutoff_hz)


def fitted(
    regression: Regression,
    turnovers: Sequence[float | None],
    more: Sequence[Effect] = (),
    start: Identification | None = None,
) -> Identification:
    effects = [*more]
    for joint, turnover in zip(regression.joints, turnovers, strict=True):
        effects += [
            CoulombFriction(joint=joint, turnover=turnover),
            ViscousFriction(joint=joint),
            TorqueOffset(joint=joint),
        ]
    return identify(regression, effects, fit_links=False, start=start)


def turnovers(model: Identification) -> list[float | None]:
    return [e.turnover for e in model.effects if isinstance(e, CoulombFriction)]


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_step_beside_a_large_error_turns_over_as_friction_does_once_that_is_explained(
    tmp_path: Path, seed: int
) -> None:
    regression = made(tmp_path, seed)
    before = fitted(regression, (None, None))
    step, right = turnovers(before)
    assert step < 0.01 * TURNOVER and right == pytest.approx(TURNOVER, rel=0.02)  # the spring hides it on its own joint
    model = fitted(regression, (step, right), [JointSpring(joint=regression.joints[0])], before)
    again = turned_over_again(regression, model, before)
    assert turnovers(again) == pytest.approx([TURNOVER, TURNOVER], rel=0.02)
    # of torques through a low-pass of a fifth of their band
    assert (again.solution.sigma < 0.6 * np.array(NOISE)).all()


def test_what_turns_over_as_it_did_stays_as_it_is(tmp_path: Path) -> None:
    regression = made(tmp_path, 1)
    spring = [JointSpring(joint=regression.joints[0])]
    before = fitted(regression, (None, None))
    model = fitted(regression, (TURNOVER, TURNOVER), spring, before)
    assert turned_over_again(regression, model, before) is model  # as wide as a new start
    same = fitted(regression, (1e-6, 1e-6), spring)
    assert turned_over_again(regression, same, same) is same  # no error fell
