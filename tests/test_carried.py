"""Claims about what does not carry over: an effect of the fitted recordings that the held-out one does not have is no finding."""

from __future__ import annotations

import json
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.carried import rise
from rx90b_flex.diagnose.output import closed_loop_json

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
