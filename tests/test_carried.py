"""Claims about what does not carry over: an effect of the fitted recordings that the held-out one does not have is no finding."""

from __future__ import annotations

import json
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.beyond_fitted import beyond_fitted
from rx90b_flex.diagnose.carried import grossly_risen, rise
from rx90b_flex.diagnose.output import closed_loop_json
from rx90b_flex.diagnose.residual import Errors

RATE_HZ, CUTOFF_HZ, PERIOD_S = 100.0, 15.0, 8.0
JOINTS = tuple(ind.ur10().joints)
LIFT, WRIST_2 = 1, 4
COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
NOISE = (0.8, 1.0, 0.6, 0.12, 0.1, 0.06)  # N m
DECLARED = [{"type": kind, "joint": j} for j in JOINTS for kind in ("coulomb_friction", "viscous_friction")]
ALWAYS = ind.hidden("gear_ripple", LIFT, {"order": 18.0, "amplitude": 4.0, "phase": 0.7})
ONCE = ind.hidden("joint_spring", WRIST_2, {"stiffness": 2.0, "rest_angle": 0.3})


def campaign(folder: Path, *, spring_held_out: bool) -> Path:
    """Two recordings to fit, with a hose on a wrist joint; one to judge by, with or without it."""
    arm, rng = ind.ur10(1.1), np.random.default_rng(3)
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 6, period_s=PERIOD_S, periods=1, rate_hz=RATE_HZ)
        hose = [ONCE] if spring_held_out or role == "identification" else []
        noise = ind.white(rng, len(m.time), NOISE)
        runs.append(ind.run(arm, role, m, [ind.friction(COULOMB, VISCOUS), ALWAYS, *hose], noise))
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ)


@pytest.mark.slow
def test_a_hose_that_was_taken_off_before_the_held_out_recording_is_no_finding_and_that_is_said(tmp_path):
    result = rf.close_loop(campaign(tmp_path, spring_held_out=False))
    assert [e.effect.type_name() for e in result.effects] == ["gear_ripple"]
    gone = [t.effect for t in result.last_round.taken_out]
    assert ("joint_spring", (JOINTS[WRIST_2],)) in [(e.type_name(), e.joints) for e in gone]
    refused = json.loads(json.dumps(closed_loop_json(result)))["unexplained"]["refused"]
    told = [r for r in refused if r["type"] == "joint_spring" and r["joint"] == JOINTS[WRIST_2]]
    assert "which was not fitted" in told[0]["reason"]
    assert result.after.validation.relative_error < result.before.validation.relative_error
    assert result.verdict != "explained"  # the fitted recordings hold what the result does not


@pytest.mark.slow
def test_a_hose_that_stays_is_found(tmp_path):
    result = rf.close_loop(campaign(tmp_path, spring_held_out=True))
    assert {e.effect.type_name() for e in result.effects} == {"gear_ripple", "joint_spring"}
    assert result.last_round.taken_out == ()


def progressive_spring(motion: ind.Motion, load: np.ndarray) -> np.ndarray:
    """A spring between two anchors on the elbow whose rate grows with its length; not of the catalogue."""
    far, near, angle = 0.42, 0.16, -0.9
    turned = motion.q[:, 1] - angle
    length = np.sqrt(far**2 + near**2 - 2.0 * far * near * np.cos(turned))
    force = 40.0 * (length - 0.35) + 900.0 * (length - 0.35) ** 3
    return np.stack([np.zeros(len(turned)), force * far * near * np.sin(turned) / length], axis=1)


def spring_campaign(folder: Path, seed: int) -> Path:
    """Held out goes to angles that no fitted recording has: what fits there says little here."""
    arm = ind.two_joints(folder)
    declared = [{"type": kind, "joint": j} for j in arm.joints for kind in ("coulomb_friction", "viscous_friction")]
    runs = []
    for i, role in enumerate(("identification", "identification", "validation")):
        rng = np.random.default_rng([seed, i])
        m = ind.harmonics(rng, 2, period_s=10.0)
        noise = ind.white(rng, len(m.time), (0.05, 0.05))
        runs.append(ind.run(arm, role, m, [ind.friction([1.0, 0.6], [2.0, 1.1]), progressive_spring], noise))
    return ind.write_files(folder, arm, declared, runs, cutoff_hz=15.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [32, 36, 37])
def test_what_was_added_never_leaves_more_held_out_than_the_declared_model(tmp_path, seed):
    result = rf.close_loop(spring_campaign(tmp_path, seed))
    before, after = (e.validation.relative_error for e in (result.before, result.after))
    assert after <= 1.005 * before
    if seed == 32:
        assert any("elbow reaches positions that no fitted recording has" in c for c in result.cautions)
    for gone in result.last_round.taken_out:
        assert gone.objection


def test_error_where_no_fitted_recording_was_is_said_to_be_there():
    rng = np.random.default_rng(5)
    fitted = {"positions": rng.uniform(-1.0, 1.0, (500, 2)), "speeds": rng.uniform(-2.0, 2.0, (500, 2))}
    held_out = {"positions": rng.uniform(-1.5, 1.5, (600, 2)), "speeds": rng.uniform(-1.9, 1.9, (600, 2))}
    far = np.maximum(np.abs(held_out["positions"]) - 1.0, 0.0)
    noise = 0.05 * rng.normal(size=far.shape)
    (said,) = beyond_fitted(("waist", "elbow"), fitted, held_out, noise + far * [0.0, 10.0])
    assert said.startswith("Held out, elbow reaches positions")
    part = (np.abs(held_out["positions"][:, 1]) > np.abs(fitted["positions"][:, 1]).max()).mean()
    assert f"{part:.0%} of the samples" in said
    assert beyond_fitted(("waist", "elbow"), fitted, held_out, noise) == ()
    everywhere = (
        np.sign(held_out["positions"]) + noise
    )  # a model that is wrong everywhere is no matter of where it was fitted
    assert beyond_fitted(("waist", "elbow"), fitted, held_out, everywhere) == ()


@pytest.mark.parametrize("seed", range(3))
def test_what_chance_alone_raises_seldom_counts_as_raised(seed):
    rng, raised = np.random.default_rng(seed), 0
    for _ in range(200):
        torque = rng.normal(size=(2000, 3))
        predicted = [1e-2 * rng.normal(size=(2000, 3)) for _ in range(2)]  # two models that are off alike
        found = rise([torque], [rng.normal(size=(2000, 3))], [100.0], [predicted[0]], [predicted[1]])
        raised += found is not None
    assert raised <= 20  # of 200; 5 % of them are 10 on average, and more than 20 have a probability of 0.001
    assert rise([torque], [torque], [100.0], [predicted[0]], [torque]) is None  # a perfect prediction raises nothing
    worst = rise([torque], [torque], [100.0], [torque], [predicted[0]])
    assert worst is not None and worst[0] == 0 and worst[1] < 1e-6


@pytest.mark.parametrize(
    ("shoulder", "wrist", "worse"), [(1.003, 0.75, False), (1.003, 1.01, True), (1.01, 0.75, True), (0.99, 1.2, False)]
)
def test_a_wrist_that_is_explained_is_no_matter_of_a_shoulders_noise(shoulder, wrist, worse):
    rng = np.random.default_rng(0)
    torque, noise = 50.0 * rng.normal(size=(2000, 2)), rng.normal(size=(2000, 2)) * [1.0, 0.05]
    before, after = (Errors.of([torque], [torque - noise * grown]) for grown in ([1.0, 1.0], [shoulder, wrist]))
    assert after.worse_than(before) == worse


@pytest.mark.parametrize(("at_s", "gross"), [(0.5, False), (3.0, True)])
def test_a_gross_rise_counts_in_however_few_parts_but_for_the_first_second(at_s: float, gross: bool) -> None:
    rng, time = np.random.default_rng(5), np.arange(1000) / RATE_HZ
    velocity, torque = np.sin(time + 0.5)[:, None], 10.0 * np.cos(time)[:, None]
    less = torque + 0.1 * rng.normal(size=torque.shape)
    more = less + 2.0 * np.exp(-(((time - at_s) / 0.1) ** 2))[:, None]
    data = [torque], [velocity], [RATE_HZ], [less]
    assert rise(*data, [more]) is None
    assert grossly_risen(*data, [more]) is gross
