"""What makes long logs bearable: loads without regressors, memory given back, a first look at an excerpt, a shorter yardstick."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose import yardstick as measure
from rx90b_flex.diagnose.residual import Errors
from rx90b_flex.diagnose.torque import TorqueData, predict
from rx90b_flex.effects.friction import CoulombFriction, StribeckFriction
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign

RATE_HZ, SECONDS = 500.0, 150.0
FRICTION = ("coulomb_friction", "viscous_friction")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two joints with Stribeck friction that is not declared, two and a half minutes in each role."""
    folder = tmp_path_factory.mktemp("long")
    arm, rng = ind.two_joints(folder), np.random.default_rng(3)
    hidden = ind.hidden("stribeck_friction", 0, {"torque": 1.2, "velocity": 0.15, "power": 1.2})
    runs = []
    for role in ("identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=15.0, periods=round(SECONDS / 15.0), rate_hz=RATE_HZ, lines=10)
        torques = [ind.friction((1.0, 0.6), (1.5, 0.8)), hidden]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), (0.1, 0.05)), 15.0))
    return ind.write_files(
        folder, arm, [{"type": k, "joint": j} for j in arm.joints for k in FRICTION], runs, cutoff_hz=20.0
    )


@pytest.mark.parametrize("name", ["rx90b_3dof", "example-robot-data:ur10"])
def test_links_ask_for_the_regressors_torque_whether_or_not_a_body_could_have_their_parameters(name: str) -> None:
    robot, rng = rf.load_robot(name).rigid(), np.random.default_rng(0)
    motion = robot.motion(*(rng.standard_normal((50, robot.model.nv)) for _ in range(3)))
    links = robot.link_parameters + rng.standard_normal(len(robot.link_parameters))
    links[:10] = 0.0
    load = robot.on_links(motion, links).on_tree.load()
    np.testing.assert_allclose(load, robot.link_regressor(motion) @ links, rtol=0.0, atol=1e-12 * np.abs(load).max())


def test_a_motion_goes_with_its_last_user() -> None:
    robot = rf.load_robot("rx90b_3dof").rigid()
    motion = robot.on_links(robot.motion(*np.zeros((3, 50, 3))), robot.link_parameters)
    assert motion.on_tree.load().any()
    gone = weakref.ref(motion)
    gc.disable()  # nobody else collects what holds itself
    try:
        del motion
        assert gone() is None
    finally:
        gc.enable()


def test_an_excerpt_of_a_long_log_has_the_columns_of_the_whole(campaign: Path) -> None:
    data = load_campaign(campaign)
    whole = Regression.of(rf.load_robot(data.robot_source), data.identification, data.cutoff_hz)
    assert whole.excerpt is not None
    part, samples = whole.excerpt
    assert len(samples) < 0.5 * len(whole)
    np.testing.assert_array_equal(part.torque, whole.torque[samples])
    phases = np.unique(np.round(samples / whole.segments[0].rate_hz % 15.0))
    assert len(phases) > 14  # of the 15 s after which all repeats
    for effect in (CoulombFriction(joint="shoulder"), StribeckFriction(joint="elbow", velocity=0.1, power=1.0)):
        known = whole.columns(effect)[samples]
        np.testing.assert_allclose(part.columns(effect), known, rtol=0.0, atol=1e-3 * np.abs(known).max())


def test_links_of_a_long_log_have_the_columns_of_the_whole_though_made_in_pieces(campaign: Path) -> None:
    data = load_campaign(campaign)
    made = Regression.of(rf.load_robot(data.robot_source), data.identification, data.cutoff_hz)
    (segment,) = made.segments
    assert len(segment.motion) > 50_000
    whole = segment.brought(segment.motion.on_tree.link_regressor())
    np.testing.assert_allclose(made.link_columns, whole[:, made.rows], rtol=0.0, atol=1e-10 * np.abs(whole).max())


def test_a_short_log_is_looked_at_as_a_whole(tmp_path: Path) -> None:
    arm, rng = ind.two_joints(tmp_path), np.random.default_rng(3)
    m = ind.harmonics(rng, 2, period_s=10.0, periods=2)
    runs = [
        ind.run(arm, role, m, [], ind.white(rng, len(m.time), (0.1, 0.1))) for role in ("identification", "validation")
    ]
    data = load_campaign(ind.write_files(tmp_path, arm, [], runs, cutoff_hz=10.0))
    assert Regression.of(rf.load_robot(data.robot_source), data.identification, data.cutoff_hz).excerpt is None


def test_the_beginning_of_a_long_log_tells_what_can_be_explained(
    campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = load_campaign(campaign)
    torques = TorqueData.of(rf.load_robot(data.robot_source), data)
    here = torques.regression
    there = Regression.of(here.robot, data.validation, data.cutoff_hz)
    declared = identify(here, here.robot.effects, fit_links=True)
    held_out = [measure.HeldOut(r.torque, predict(r, declared), r.waiting) for r in torques.validation]
    before = Errors.of([h.torque for h in held_out], [h.declared for h in held_out], [h.waiting for h in held_out])
    found = []
    for samples in (20_000, 40_000):
        monkeypatch.setattr(measure, "LONGEST", samples)
        explainable = measure.yardstick(declared, there, held_out, before)
        assert isinstance(explainable, measure.Explainable)
        found.append(explainable.validation.relative_error)
    assert max(found) < 0.8 * before.relative_error
    assert found[0] == pytest.approx(found[1], rel=0.15)
