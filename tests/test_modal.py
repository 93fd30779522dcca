"""Claims about modal tables: reading them, pairing modes, and naming what a flexible robot lacks to have them.

Modes are made without the package (MuJoCo's dynamics, SciPy's eigenvalues): `modal_generator`.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import math
import re

import numpy as np
import pytest
from modal_generator import (
    BAND,
    BENT,
    CAUSES,
    MEASURED,
    OUTSIDE,
    PLAIN,
    STRETCHED,
    measured,
    share_named_wrongly,
    times_called_complete,
    truth_of,
)
from scipy import stats

from rx90b_flex.diagnose.close_flexible import write_loop
from rx90b_flex.diagnose.flexible import Structure
from rx90b_flex.diagnose.modal import (
    MISSED,
    SPURIOUS,
    ModalPose,
    ModalResidual,
    ModeList,
    close_modal,
    in_order_rms,
    load_modal_table,
    modes_of,
    pair,
)
from rx90b_flex.effects.flexibility import BaseFlexibility
from rx90b_flex.robot import load_robot, robots_folder

NOISE = 0.003  # relative, as good as table 6.4's sharper modes
EXACT = 1e-4  # model error where the data come from a robot at rest


def structure(robot=PLAIN, *poses):
    angles = [ModalPose(p, ()).drive_angles(robot) for p in poses or (STRETCHED,)]
    return Structure.of(robot, MEASURED, angles, BAND)


# ---- the model's modes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("locked", [None, "joint_2"])
def test_modes_are_those_of_another_engine(locked):
    base = BaseFlexibility(stiffness=(4e6, 9e6), damping=(1.0, 1.0))
    robot = PLAIN.with_effects([*PLAIN.effects, base])
    found, _ = modes_of(structure(robot, BENT), (), structure(robot, BENT).matrices(0, (), np.zeros(0)), locked)
    # the generator's stiffness is a difference quotient: 1e-4 rad against 1e-16 of its forces
    np.testing.assert_allclose(np.exp(found), truth_of(robot).modes(BENT, MEASURED, locked), rtol=1e-6)


def test_slopes_of_modes_are_their_derivatives():
    s = structure()
    chosen = [c for c in s.changes if c.label in ("base.base_flexibility", "joint_2.drive_inertia", "tool0.payload")]
    chosen += [c for c in s.changes if c.label in ("joint_5.joint_flexibility", "all.drive_stiffness")]
    x = np.concatenate([c.starts[-1] for c in chosen])
    _, slopes = modes_of(s, chosen, s.matrices(0, chosen, x), "joint_1")
    # the lowest of squares that span 1e7 is known to about 1e-9: 1e-5 over a step of 1e-4, far less as a rule
    for k, step in enumerate(1e-4 * np.eye(len(x))):
        high, low = (modes_of(s, chosen, s.matrices(0, chosen, x + d), "joint_1")[0] for d in (step, -step))
        np.testing.assert_allclose(slopes[:, k], (high - low) / 2e-4, atol=1e-6)


def test_a_change_makes_a_robot_with_the_same_modes():
    s = structure()
    chosen = tuple(c for c in s.changes if c.label in ("base.base_flexibility", "joint_2.drive_stiffness"))
    x = np.concatenate([c.starts[-1] for c in chosen])
    robot = s.changed(chosen, x)
    assert len(robot.effects) == len(PLAIN.effects) + 1
    expected, _ = modes_of(s, chosen, s.matrices(0, chosen, x))
    again = structure(robot)
    np.testing.assert_allclose(modes_of(again, (), again.matrices(0, (), np.zeros(0)))[0], expected, atol=1e-10)


# ---- pairing --------------------------------------------------------------------------------------------------------


def brute_force(seen, model, error, band):
    """Least cost over every pairing that keeps both orders."""
    low, high = np.log(band)
    inside = (model >= low) & (model <= high)
    best = math.inf
    for k in range(min(len(seen.hz), len(model)) + 1):
        for rows in itertools.combinations(range(len(seen.hz)), k):
            for columns in itertools.combinations(range(len(model)), k):
                cost = -2 * (len(seen.hz) - k) * math.log(SPURIOUS / (high - low))
                for i, j in zip(rows, columns, strict=True):
                    std = math.sqrt(seen.variance[i] + error**2)
                    cost -= 2 * stats.norm.logpdf(seen.log[i], model[j], std) + 2 * math.log(1 - SPURIOUS)
                cost -= 2 * sum(math.log(1 - MISSED if j in columns else MISSED) for j in np.flatnonzero(inside))
                best = min(best, cost)
    return best


@pytest.mark.parametrize("seed", range(5))
def test_the_pairing_is_the_most_probable_of_all(seed):
    rng = np.random.default_rng(seed)
    hz = np.sort(rng.uniform(8, 75, 4))
    seen = ModeList(None, hz, 0.01 * hz)
    model = np.sort(np.log(rng.uniform(6, 110, 5)))
    found = pair(seen, model, 0.1, BAND)
    assert found.cost == pytest.approx(brute_force(seen, model, 0.1, BAND), abs=1e-9)
    assert (np.diff(found.measured) > 0).all() and (np.diff(found.model) > 0).all()


def test_a_mode_that_was_not_seen_and_one_that_is_none_are_left_alone():
    hz = np.array([20.0, 30.0, 50.0, 60.0])  # 50 Hz: mains
    found = pair(ModeList(None, hz, 0.003 * hz), np.log([20.01, 29.98, 40.0, 60.1, 90.0]), 0.001, BAND)
    assert found.measured.tolist() == [0, 1, 3]
    assert found.model.tolist() == [0, 1, 3]
    assert found.unseen == 1


# ---- known causes ---------------------------------------------------------------------------------------------------


@functools.cache
def closed(cause, seed, poses=(STRETCHED,)):
    declared, true, _ = CAUSES[cause]
    table = measured(truth_of(true), np.random.default_rng(seed), NOISE, poses)
    return close_modal(table, declared, model_error=EXACT)


@pytest.mark.parametrize("cause", ["nothing", "drive that twists", "floor"])
def test_a_hidden_cause_is_named(cause):
    loop = closed(cause, 0)
    assert [f.change.label for f in loop.found] == CAUSES[cause][2]
    assert loop.verdict == ("explained" if loop.found else "nothing_missing")


def test_values_come_with_their_uncertainty():
    (found,) = closed("drive that twists", 0).found
    assert abs(found.values[0] - 1.0e5) < 3 * found.stds[0]
    assert found.stds[0] < 0.02 * found.values[0]  # modes to 0.3 %: a stiffness to about twice that over a few of them


@pytest.mark.long
@pytest.mark.slow
def test_hidden_causes_are_named_whatever_the_noise():
    assert share_named_wrongly(closed, range(100, 105)) <= 0.1


@pytest.mark.slow
def test_where_nothing_is_hidden_nothing_is_added():
    assert times_called_complete(closed, range(200, 260)) >= 57


@pytest.mark.slow
@pytest.mark.parametrize("cause", OUTSIDE)
def test_a_cause_outside_the_catalogue_is_not_called_explained(cause):
    for seed in range(3):
        table = measured(OUTSIDE[cause], np.random.default_rng(300 + seed), NOISE, (STRETCHED, BENT))
        assert close_modal(table, PLAIN, model_error=EXACT).verdict in ("partly_explained", "unexplained")


# ---- files ----------------------------------------------------------------------------------------------------------


def test_the_table_of_the_real_robot_is_read():
    table = load_modal_table(robots_folder() / "rx90b_table_6_4.toml")
    assert table.joints == MEASURED and table.band_hz == BAND
    (pose,) = table.poses
    assert pose.angles == {"joint_2": pytest.approx(math.pi / 2)}
    assert [m.name for m in pose.lists] == ["resonances", *(f"antiresonances of {j}" for j in MEASURED)]
    assert all(len(m.hz) == len(m.std_hz) == 9 for m in pose.lists)


GOOD = """joints = ["joint_1"]
[[pose]]
angles_deg = { joint_2 = 90.0 }
resonance = { hz = [20.0, 30.0], std_hz = [0.1, 0.1] }
antiresonance.joint_1 = { hz = [15.0], std_hz = [0.1] }
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('joints = ["joint_1"]', "", "joints: missing"),
        ("[0.1, 0.1]", "[0.1]", "resonance std_hz: lists 1 values, hz lists 2"),
        ("20.0", '"20"', "resonance hz: found .*, a finite number is expected"),
        ("20.0", "-20.0", "expected frequencies above 0 Hz"),
        ("antiresonance.joint_1", "antiresonance.joint_2", "antiresonance: the drive of 'joint_2' did not move"),
        ("std_hz = [0.1] }", "sd = [0.1] }", "'sd': unknown key"),
        ("[[pose]]", "[pose]", r"pose: found .*, tables \[\[pose\]\] are expected"),
        ("angles_deg = {", "angles = {", r"\[\[pose\]\] 1 'angles': unknown key \(did you mean 'angles_deg'\?\)"),
        ("[[pose]]", "band_hz = [80.0, 8.0]\n[[pose]]", "band_hz"),
        ("[[pose]]", '[[pose]]\nrole = "validation"', "expected one to identify with"),
    ],
)
def test_a_bad_table_is_refused_in_one_line_that_names_file_and_key(tmp_path, old, new, message):
    path = tmp_path / "modes.toml"
    path.write_text(GOOD)
    load_modal_table(path)
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(ValueError, match=message) as caught:
        load_modal_table(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_pose_of_a_joint_that_the_robot_does_not_have_is_refused(tmp_path):
    path = tmp_path / "modes.toml"
    path.write_text(GOOD.replace("joint_2 = 90", "elbow = 90"))
    with pytest.raises(ValueError, match="unknown joint 'elbow' of rx90b"):
        close_modal(path, "rx90b")


def test_a_change_that_cannot_be_tried_is_refused_by_name():
    table = robots_folder() / "rx90b_table_6_4.toml"
    with pytest.raises(
        ValueError, match=r"no change 'base\.flexibility' of rx90b; did you mean 'base\.base_flexibility'\?"
    ):
        close_modal(table, only=["base.flexibility"])


def test_what_is_written_loads_and_has_the_modes(tmp_path):
    table = measured(truth_of(CAUSES["softer drive"][1]), np.random.default_rng(3), NOISE, (STRETCHED, BENT))
    table = dataclasses.replace(table, poses=(table.poses[0], dataclasses.replace(table.poses[1], role="validation")))
    loop = close_modal(table, PLAIN, model_error=EXACT)
    write_loop(loop, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "closed_loop.json").read_text())
    assert found["verdict"] == "explained" and found["residual"] == "modes"
    (effect,) = found["effects"]
    assert (effect["type"], effect["place"], effect["change"]) == ("drive_flexibility", "joint_3", "multiplied")
    assert effect["parameters"]["drive_stiffness"]["value"] == pytest.approx(0.8, abs=0.02)
    chance = [math.sqrt(stats.chi2.isf(1e-3, m) / m) for m in (sum(len(x.hz) for x in p.lists) for p in table.poses)]
    assert found["after"]["log_frequency_rms"] < chance[0] * NOISE < found["before"]["log_frequency_rms"]
    # the other pose was not fitted, and is predicted to its own noise
    after, before = (found["validation"][k]["log_frequency_rms"] for k in ("after", "before"))
    assert after < chance[1] * NOISE < before
    s = structure(load_robot(tmp_path / "out" / "robot.toml"))
    again = ModalResidual(s, table.poses[:1], BAND, EXACT)
    assert in_order_rms(again.compare(again.fit(()))) == pytest.approx(
        found["after"]["log_frequency_rms_in_order"], rel=1e-6
    )
    assert re.search("One pose only", " ".join(found["doubts"]))
