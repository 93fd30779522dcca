"""Claims about the study `benchmarks/closing_the_loop_over_frequency.py`: what it hides, how strong, what it counts."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from rx90b_flex.diagnose.flexible import Structure
from rx90b_flex.diagnose.response import response_of
from rx90b_flex.effects import catalogue

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import closing_the_loop as counted
import closing_the_loop_over_frequency as study


def test_every_type_that_frequency_responses_can_show_is_in_the_study():
    assert sorted(study.KINDS) == sorted(name for name, kind in catalogue().items() if kind.traits.scaled)


@pytest.mark.parametrize("name", study.SUBJECTS)
def test_with_nothing_hidden_package_and_generator_are_one_robot(name):
    scene = study.Scene.draw(np.random.default_rng(0), name)
    hz = np.linspace(*study.BAND_HZ, 10)
    angles = np.array([scene.poses[0].get(j, 0.0) for j in scene.robot.joints])
    structure = Structure.of(scene.robot, scene.subject.measured, [angles], study.BAND_HZ)
    expected = scene.plain.response(scene.poses[0], scene.subject.measured, hz)
    found = response_of(structure, 0, (), np.zeros(0), hz)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    first = scene.plain.modes(scene.poses[0], scene.subject.measured, None)[0]
    assert study.BAND_HZ[0] < first < study.BAND_HZ[1]


@pytest.fixture(scope="module")
def row():
    return study.run_case(study.Case("hidden", "joint_spring", 3.0, 0))


@pytest.mark.slow
def test_a_hidden_effect_of_a_given_strength_is_found(row):
    assert row["reached"] == pytest.approx(3.0, rel=0.15)  # met to 10 %, the fit of nuisances begins elsewhere
    assert row["verdict"] == "explained"
    assert counted.right(row) and len(counted.deviations(row)) == 1
    assert abs(counted.deviations(row)[0]) < counted.DEVIATIONS
    assert row["held_out"] < counted.NEAR_FLOOR


@pytest.mark.slow
def test_the_table_counts_it(row):
    text = study.table(
        [row, {"study": "hidden", "name": "payload", "strength": 3.0, "seed": 0, "skipped": "too light"}]
    )
    assert "| joint_spring | 3 | 1/1" in text and "Left out 1 times: too light." in text


@pytest.mark.parametrize("name", [name for name, kind in study.KINDS.items() if kind.changed])
def test_a_size_of_nothing_leaves_what_is_declared(name):
    rng = np.random.default_rng(1)
    scene = study.Scene.draw(rng, "panda")
    kind = study.KINDS[name]
    hidden = kind.changed(scene, study.places(kind.on, scene.subject.measured, rng)[0], rng)
    assert list(hidden.values(0.0).values()) == [1.0]
    assert hidden.truth(hidden.values(0.0)) == study.truth_of(hidden.declared)
    assert hidden.truth(hidden.values(0.5)) != study.truth_of(hidden.declared)


def test_a_run_can_be_sent_to_other_processes():
    """As a program the study is `__main__`, which workers do not import: what a run needs is sent to them whole."""
    cloudpickle = pytest.importorskip("cloudpickle")  # joblib's; older ones keep it to themselves
    cloudpickle.register_pickle_by_value(study)
    try:
        assert cloudpickle.dumps(study.run_case)
    finally:
        cloudpickle.unregister_pickle_by_value(study)
