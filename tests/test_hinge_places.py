"""Claims about hinges that lie elsewhere than declared: what moves, and what is said of stiffnesses where the place is not known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from scipy import stats
from test_grey_box import BENT, EXACT, STRETCHED, response, robot, scores, truth

from rx90b_flex.hinge_places import with_hinges_moved
from rx90b_flex.identify.grey_box import GreyBox, grey_box
from rx90b_flex.robot import Robot

MOVED = np.array([0.02, 0.0, 0.0])


def tip(whole: Robot, q: np.ndarray) -> np.ndarray:
    data = whole.model.createData()
    pin.framesForwardKinematics(whole.model, data, q)
    return np.asarray(data.oMf[whole.model.getFrameId(whole.tip_frame)].translation)


def test_along_its_axis_a_moved_hinge_bends_elsewhere_and_turns_as_before() -> None:
    whole = robot()
    rest = np.zeros(whole.model.nv)
    turning, frame = axis_and_frame(whole, "joint_2")
    axis = frame.T @ turning
    moved, aside = (with_hinges_moved(whole, {"joint_2": 0.02 * x}) for x in (axis, np.roll(axis, 1)))
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (4, 3)):
        rigid = whole.rigid().mass_matrix(q)
        np.testing.assert_allclose(moved.rigid().mass_matrix(q), rigid, rtol=1e-9, atol=1e-12)
        assert not np.allclose(aside.rigid().mass_matrix(q), rigid, rtol=1e-4)
    assert not np.allclose(moved.mass_matrix(rest), whole.mass_matrix(rest), rtol=1e-4)


def test_links_stay_and_a_bending_turns_about_the_moved_hinge() -> None:
    whole = robot()
    offset, rest, small = np.array([0.02, -0.03, 0.01]), np.zeros(whole.model.nv), 1e-6
    moved = with_hinges_moved(whole, {"joint_2": offset})
    np.testing.assert_allclose(tip(moved, rest), tip(whole, rest), atol=1e-12)
    for hinge in ("joint_2_bend_1", "joint_2_bend_2"):
        q = rest.copy()
        q[whole.model.joints[whole.model.getJointId(hinge)].idx_v] = small
        before, after = ((tip(r, q) - tip(r, rest)) / small for r in (whole, moved))
        axis, frame = axis_and_frame(whole, hinge)
        np.testing.assert_allclose(after - before, -np.cross(axis, frame @ offset), atol=1e-5)


def axis_and_frame(whole: Robot, joint: str) -> tuple[np.ndarray, np.ndarray]:
    """A joint's axis in the base frame at zero angles, and its frame there."""
    model, rest = whole.model, np.zeros(whole.model.nv)
    place, data = model.getJointId(joint), whole.model.createData()
    jacobian = pin.computeJointJacobians(model, data, rest)
    return jacobian[3:, model.joints[place].idx_v], data.oMi[place].rotation


@pytest.fixture(scope="module")
def fits() -> dict[str, list[GreyBox]]:
    """Of a robot whose second hinge lies 2 cm aside, from two poses, with three draws of noise."""
    declared = robot()
    true = with_hinges_moved(declared, {"joint_2": MOVED})
    out: dict[str, list[GreyBox]] = {"known": [], "not known": []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        data = [response(true, pose, 0.01, rng) for pose in (STRETCHED, BENT)]
        for name, std in (("known", 0.0), ("not known", 0.02)):
            out[name].append(grey_box(declared, data, dataclasses.replace(EXACT, hinge_std=std)))
    return out


def stiffness_scores(grey: GreyBox) -> np.ndarray:
    stiff = ["stiffness" in e.name for e in grey.estimates]
    return np.abs(scores(grey, truth(robot())))[stiff]


@pytest.mark.slow
def test_a_hinge_two_centimetres_aside_is_in_the_intervals_where_it_is_allowed_for(
    fits: dict[str, list[GreyBox]],
) -> None:
    known, not_known = (np.array([stiffness_scores(g) for g in fits[name]]) for name in ("known", "not known"))
    assert (known.max(axis=1) > 10.0).all()
    assert np.mean(known < 1.96) < 0.7
    # no fewer than chance leaves of 95 % in 999 of 1000 such tests, a run's nine taken as one
    assert (not_known < 1.96).mean() >= stats.binom.ppf(0.001, len(not_known), 0.95) / len(not_known)
    assert not_known.max() < 4.0


@pytest.mark.slow
def test_the_hinge_is_found(fits: dict[str, list[GreyBox]]) -> None:
    for grey in fits["not known"]:
        places = {h.joint: h for h in grey.hinges}
        for joint, place in places.items():
            off = np.array(place.offset) - (MOVED if joint == "joint_2" else 0.0)
            assert (np.abs(off) < 4.0 * np.array(place.std)).all(), (joint, place)
            assert (np.array(place.std) <= 1.001 * place.declared_std).all()
        if min(places["joint_2"].std) < 0.005:
            moved = grey.robot.mass_matrix(np.zeros(grey.robot.model.nv))
            assert not np.allclose(moved, robot().mass_matrix(np.zeros(len(moved))), rtol=1e-4)


def test_a_hinge_of_no_joint_is_one_line() -> None:
    data = response(robot(), BENT, 0.03)
    for std, words in (
        ({"joint_9": 0.01}, "hinge_std: .* has no joint 'joint_9'"),
        ({"joint_2": -1.0}, "joint_2 has -1 m; expected 0"),
    ):
        with pytest.raises(ValueError, match=words):
            grey_box(robot(), data, dataclasses.replace(EXACT, hinge_std=std))
