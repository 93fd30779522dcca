"""Claims about look-alikes: friction of a loaded joint, whose load a small motion hardly changes (`independent.py`)."""

from __future__ import annotations

from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.alternatives import APART
from rx90b_flex.diagnose.output import closed_loop_json
from rx90b_flex.view.advice import next_measurements

TRUTH = {"coefficient": 0.1}
NOISE = (0.2, 0.08)
DECLARED = [
    {"type": kind, "joint": joint}
    for kind, joint in (
        ("coulomb_friction", "shoulder"),
        ("viscous_friction", "shoulder"),
        ("viscous_friction", "elbow"),
    )
]
POSE = np.array([0.4, 0.3])


def closed(folder: Path, speed: float) -> rf.ClosedLoop:
    """A hidden friction of the elbow that grows with its load; every motion about one pose."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(0)
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=12.0, speed=speed)
        m = ind.Motion(m.time, m.q - m.q.mean(axis=0) + POSE, m.v, m.a)
        torques = [ind.friction((2.0, 0.0), (3.0, 1.5)), ind.hidden("load_friction", 1, TRUTH)]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE)))
    return rf.close_loop(ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=15.0))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> rf.ClosedLoop:
    """At 0.03 rad/s the arm moves by 0.07 rad, which changes the load of 1.7 N m by some 2 %: 4 mN m of friction, where
    the noise of about 700 free samples hides sqrt(2 / 700) * 40 mN m = 2 mN m.
    """
    return closed(tmp_path_factory.mktemp("small"), 0.03)


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> rf.ClosedLoop:
    return closed(tmp_path_factory.mktemp("wide"), 1.2)


def test_what_data_cannot_tell_apart_is_named_with_its_alternative(small):
    found = small.effects[0]
    both = {found.effect.label, *(a.effect.label for a in found.alternatives)}
    assert {"elbow.load_friction", "elbow.coulomb_friction"} <= both


def test_an_alternative_explains_as_much_with_values_of_its_own(small):
    for other in small.effects[0].alternatives:
        assert abs(other.behind) <= APART
        assert other.share == pytest.approx(1.0, abs=0.05)
        assert np.isfinite([v for _, _, v in other.effect.public_values()]).all()


def test_the_experiment_that_would_tell_them_apart_changes_the_load(small):
    """Over the whole range of the elbow its load changes sign; constant speeds or reversals would not change it."""
    pair = {"load_friction", "coulomb_friction"}
    (other,) = (a for a in small.effects[0].alternatives if a.effect.type_name() in pair)
    assert "more of its range" in other.experiment or "load changes" in other.experiment
    assert other.apart > APART
    assert any(other.experiment in a.what for a in next_measurements(small))


def test_after_that_experiment_the_data_decides(wide):
    assert [e.effect.label for e in wide.effects] == ["elbow.load_friction"]
    assert wide.effects[0].alternatives == ()


def test_alternatives_stand_in_the_json(small):
    (entry, *_) = closed_loop_json(small)["effects"]
    for other, found in zip(entry["alternatives"], small.effects[0].alternatives, strict=True):
        assert (other["type"], other["joint"]) == (found.effect.type_name(), "elbow")
        assert other["standard_errors_behind"] == found.behind
        assert other["experiment"] == found.advice
        assert set(other["parameters"]) == {name for name, _, _ in found.effect.public_values()}
