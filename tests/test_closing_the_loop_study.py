"""Claims about the study `benchmarks/closing_the_loop.py`: what it hides, how strong, what it counts."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from rx90b_flex.effects import catalogue

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import closing_the_loop as study


def test_every_effect_type_is_in_the_study_or_said_to_be_elsewhere():
    assert sorted([*study.KINDS, *study.ELSEWHERE]) == sorted(catalogue())


@pytest.mark.parametrize("name", study.KINDS)
def test_drawn_values_are_those_of_the_effect_type(name):
    kind = study.KINDS[name]
    rng = np.random.default_rng(0)
    hidden = study.Hidden(name, (0,), kind.sizes(rng), kind.shapes(rng))
    assert sorted(hidden.values(2.0)) == sorted(catalogue()[name].parameters())


@pytest.fixture(scope="module")
def drawn() -> study.Drawn:
    made = study.draw(study.Case("hidden", "gear_ripple", 3.0, 4))
    assert isinstance(made, study.Drawn)
    return made


def test_the_strength_is_what_the_declared_model_leaves_over_the_noise_floor(drawn):
    measure = study.Measured(drawn.robot)
    floor = measure.residual_power(drawn.scene.logs([]))
    assert study.excess(measure.residual_power(drawn.campaign.recordings), floor) == pytest.approx(3.0, rel=0.05)
    # with nothing hidden that floor is the sensors' noise, which as few parameters as a model has take little of
    noise = [drawn.scene.sensor_noise * torque for _, torque in drawn.scene.noise[:2]]
    np.testing.assert_allclose(np.sqrt(floor), study.lowpassed_rms(np.concatenate(noise)), rtol=0.2)


def test_one_seed_is_one_run(drawn):
    again = study.draw(study.Case("hidden", "gear_ripple", 3.0, 4))
    assert isinstance(again, study.Drawn)
    assert again.hidden[0][1] == drawn.hidden[0][1]
    for one, other in zip(again.campaign.recordings, drawn.campaign.recordings, strict=True):
        np.testing.assert_array_equal(one.torque, other.torque)


def test_motions_keep_to_the_limits_of_the_joints(drawn):
    model = drawn.scene.arm.model
    for run in drawn.scene.experiments:
        m = run.motion(drawn.scene.time)
        assert (np.abs(m.v) <= model.velocityLimit).all()
        assert (m.q >= model.lowerPositionLimit).all() and (m.q <= model.upperPositionLimit).all()


def row(found: list[str], **change: object) -> dict[str, object]:
    def effect(kind: str) -> dict[str, object]:
        return {"type": kind, "joints": ["a"], "parameters": {"torque": [1.2, 0.1]}, "p_value": 0.0}

    hidden = [{"type": "torque_offset", "joints": ["a"], "values": {"torque": 1.0}}]
    one = {"study": "hidden", "name": "torque_offset", "strength": 3.0, "seed": 0, "robot": "ur10", "hidden": hidden}
    return one | {"found": [effect(k) for k in found], "verdict": "explained", "held_out": 1.0} | change


def test_only_what_was_hidden_and_nothing_else_counts_as_right():
    exact, more, wrong = row(["torque_offset"]), row(["torque_offset", "joint_spring"]), row(["joint_spring"])
    assert [study.right(r) for r in (exact, more, wrong)] == [True, False, False]
    assert [study.among(r) for r in (exact, more, wrong)] == [True, True, False]
    assert study.deviations(exact) == pytest.approx([2.0])
    assert study.mistakes([exact, more, wrong]) == "joint_spring (2)"
    assert "| torque_offset | 3 | 1/3" in study.table([exact, more, wrong])


def test_a_phase_is_an_angle():
    made = row(["torque_offset"])
    ripple = {"type": "gear_ripple", "joints": ["a"]}
    made["hidden"] = [ripple | {"values": {"phase": 3.1}}]
    made["found"] = [ripple | {"parameters": {"phase": [-3.1, 0.1]}}]
    assert study.deviations(made) == pytest.approx([(2 * np.pi - 6.2) / 0.1])


def test_finished_runs_are_read_back_and_a_cut_line_is_not(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps(row([])) + "\n" + json.dumps(row([], seed=1))[:40])
    assert [r["seed"] for r in study.finished(path)] == [0]


def test_what_no_joint_shows_is_left_out_and_named():
    """The first joint's rotor cannot be told from its link's inertia about its axis."""
    rng = np.random.default_rng(0)
    scene = study.Scene.draw(rng, "ur10", False)
    hidden = study.Hidden("drive_inertia", (0,), {"inertia": 1.0}, {})
    start, most = study.raw_start(scene, hidden, 3.0)
    assert study.sized(scene, hidden, study.declared_robot("ur10", (), False), 3.0, most, start) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["transmission_error", "backlash", "motor_saturation", "torque_delay"])
def test_an_effect_that_acts_in_bursts_is_found(name):
    """What acts much in one block and little in others differs between held-out blocks without being less sure."""
    found = study.run_case(study.Case("hidden", name, 10.0, 0))
    assert study.right(found), found["found"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "seed"),
    [("joint_spring+drive_inertia", 0), ("asymmetric_friction+viscous_power_friction", 4), ("asymmetric_friction+joint_spring", 4)],
)  # fmt: skip
def test_two_causes_that_hide_each_other_on_one_joint_are_found_together(pair, seed):
    """Runs of the study that were missed as long as effects were added one at a time."""
    row = study.run_case(study.Case("pair", pair, 10.0, seed))
    first, second = row["hidden"]
    assert first["joints"] == second["joints"]
    assert study.right(row)
    assert row["held_out"] < study.NEAR_FLOOR
