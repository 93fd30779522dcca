"""Claims about real recordings: what a free-form model explains of them, and that written robots are the reported ones."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest
from data_folder import data_folder, kr300_without
from real_loops import closed_loop, kr300_closed

import rx90b_flex as rf
from rx90b_flex.diagnose.identified import identified_robot, with_possible_values
from rx90b_flex.diagnose.output import write_result
from rx90b_flex.diagnose.residual import Errors, ReplayedTorques
from rx90b_flex.diagnose.torque import predict
from rx90b_flex.diagnose.yardstick import Explainable, HeldOut, yardstick
from rx90b_flex.effects.reversal import SHARP
from rx90b_flex.export import save_robot
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import prepare
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Campaign, load_campaign

# Relative error on the validation recordings of the best of cross-validated bases and boosted trees, found apart from this package.
FREE_FORM = {"tx40": 0.132, "emps": 0.0259, "ur10e": 0.0202, "dualarm_v2": 0.163}
NEAR = 1.1  # that search is called slightly optimistic: it chose among forms with a look at the same recordings
NAMES = (*FREE_FORM, "kr300_encoders")


@dataclass(frozen=True, eq=False)
class Declared:
    """A campaign with its declared model identified, and what that says on the validation recordings."""

    name: str
    campaign: Campaign
    robot: Robot
    model: Identification
    held_out: tuple[HeldOut, ...]
    errors: Errors


@pytest.fixture(scope="module", params=NAMES)
def declared(request: pytest.FixtureRequest) -> Declared:
    campaign = load_campaign(data_folder(request.param) / "campaign.toml")
    robot = load_robot(campaign.robot_source)
    # the independent search stood beside one whose dry friction is as the speed shows it
    regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz).with_sticking(())
    with pytest.MonkeyPatch.context() as patch:
        # the independent search stood beside a declared model whose dry friction is a step
        patch.setattr("rx90b_flex.effects.reversal.turnover_range", lambda at: (SHARP, 1.01 * SHARP))
        model = with_possible_values(identify(regression, regression.robot.effects, fit_links=True))
    rigid = regression.robot
    replays = [
        ReplayedTorques(rigid, prepare(rigid, r, campaign.cutoff_hz, False, regression.sticking))
        for r in campaign.validation
    ]
    held_out = tuple(HeldOut(r.torque, predict(r, model), r.waiting) for r in replays)
    errors = Errors.of([h.torque for h in held_out], [h.declared for h in held_out], [h.waiting for h in held_out])
    return Declared(request.param, campaign, robot, model, held_out, errors)


@pytest.fixture(scope="module")
def explainable(declared: Declared) -> Explainable:
    campaign, sticking = declared.campaign, declared.model.regression.sticking
    validation, _ = Regression.and_whole(declared.robot, campaign.validation, campaign.cutoff_hz, sticking=sticking)
    found = yardstick(declared.model, validation, declared.held_out, declared.errors)
    assert isinstance(found, Explainable)
    return found


def test_a_free_form_reaches_what_an_independent_search_did(declared, explainable):
    if declared.name in FREE_FORM:
        assert explainable.validation.relative_error < NEAR * FREE_FORM[declared.name]
    assert explainable.validation.relative_error < declared.errors.relative_error


def test_the_declared_model_itself_has_no_share(declared, explainable):
    if declared.name not in FREE_FORM:
        pytest.skip("20 s hold too little for a free form: there is nothing to have a share of")
    assert explainable.share == pytest.approx(0.0, abs=1e-9)


def test_the_written_declared_robot_replayed_has_its_error(declared, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "rx90b_flex.identify.regression.drives_that_stick", lambda regression: ()
    )  # as it was declared here
    robot = identified_robot(declared.robot, declared.model, declared.campaign.joints)
    path = save_robot(robot, tmp_path)
    errors = rf.replay_errors(path, declared.campaign)
    assert errors.relative_error == pytest.approx(declared.errors.relative_error, rel=1e-6)


# the dual arm with its wrong torque constants takes minutes: its loop is closed by hand, the others' by CI, too
BY_HAND = {"dualarm_v2": [pytest.mark.long]}


@pytest.fixture(
    params=[pytest.param(name, marks=[pytest.mark.xdist_group(name), *BY_HAND.get(name, [])]) for name in NAMES]
)
def closed(request: pytest.FixtureRequest) -> rf.ClosedLoop:
    return closed_loop(request.param)


@pytest.mark.slow
def test_the_written_robot_replayed_has_the_error_that_is_reported(closed, tmp_path):
    write_result(closed, tmp_path)
    errors = rf.replay_errors(tmp_path / "robot.toml", closed.campaign)
    assert errors.relative_error == pytest.approx(closed.after.validation.relative_error, rel=1e-6)


@pytest.mark.slow
def test_no_verdict_is_explained_below_four_fifths_of_the_free_form(closed):
    assert closed.verdict != "explained" or (closed.explainable is not None and closed.explainable.share >= 0.8)


@pytest.mark.slow
def test_no_held_out_error_grows(closed):
    assert closed.after.validation.relative_error <= closed.before.validation.relative_error


@pytest.mark.slow
def test_gains_of_wrong_torque_constants_are_those_that_torque_sensors_say(closed):
    """Stated and by sensors (the data's README), N m/A: on axes 1 and 2 far too small, on 3 and 4 too large. Links whose scale the
    first two set give the others a gain between that beside either.
    """
    gains = {e.effect.joints[0]: e.effect.gain for e in closed.effects if e.effect.traits.multiplies}
    if closed.campaign.path.parent.name != "dualarm_v2":
        assert not gains
        return
    stated, sensed = np.array([1.35, 1.35, 6.1, 6.1]), np.array([6.5, 8.2, 3.3, 2.9])
    first, second, *others = stated / sensed
    for joint, wrong in zip(("joint_3", "joint_4"), others, strict=True):
        assert wrong / first < gains[joint] < wrong / second


@pytest.mark.slow
@pytest.mark.xdist_group("kr300_encoders")
@pytest.mark.long
@pytest.mark.parametrize("held_out", ("A", "B"))
def test_no_held_out_error_grows_with_another_recording_held_out_nor_closing_again(held_out, tmp_path):
    """Closed again on the robot that was written the error is what it was, and next to nothing is found that changes it."""
    campaign, closed = kr300_without(held_out), kr300_closed(held_out)
    assert closed.after.validation.relative_error <= closed.before.validation.relative_error
    write_result(closed, tmp_path)
    written = {"robot": str(tmp_path / "robot.toml"), "robot_source": tmp_path / "robot.toml"}
    again = rf.close_loop(dataclasses.replace(campaign, **written))
    first, second = closed.after.validation.relative_error, again.before.validation.relative_error
    assert second == pytest.approx(first, rel=0.02)
    # what friction holds before a first move decides nothing: held at random, it may rise
    known = again.before.told.validation.relative_error
    assert again.after.told.validation.relative_error == pytest.approx(known, rel=0.02)
