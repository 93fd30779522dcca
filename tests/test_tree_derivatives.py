"""Derivatives of a tree whose fitted links weigh nothing or less together, by differences of what its regressor says."""

import dataclasses

import numpy as np
import pytest

import rx90b_flex as rf

STEP = 1e-6
GRAVITY_ALONG_X = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module", params=["rx90b", "example-robot-data:ur10"])
def robot(request):
    return rf.load_robot(request.param).rigid()


def motion_of(robot, seed):
    rng = np.random.default_rng(seed)
    return robot.motion(*rng.uniform(-1.5, 1.5, (3, 4, robot.model.nv)))


def links_that_weigh(robot, part, seed):
    """Link parameters (10 * bodies,) of which those of the outer half weigh so much of what their inner neighbours weigh."""
    rng = np.random.default_rng(seed)
    bodies = robot.link_parameters.reshape(-1, 10) * rng.uniform(0.5, 1.5, (len(robot.bodies), 10))
    outer = len(bodies) // 2
    bodies[outer:, 0] *= part * bodies[:outer, 0].sum() / bodies[outer:, 0].sum()
    return bodies.ravel()


def by_differences(torque, at):
    """Derivatives (N, n, n) of torques (N, n) by each coordinate."""
    up, down = (np.stack([torque(at + s * STEP * e) for e in np.eye(at.shape[1])], axis=2) for s in (1.0, -1.0))
    return (up - down) / (2.0 * STEP)


@pytest.mark.parametrize("part", [1.0, 1e-9, 0.0, -0.5, -1.0, -1.0 - 1e-9, -3.0])
def test_links_of_any_mass_have_the_derivatives_of_their_regressor(robot, part):
    motion, links = motion_of(robot, 1), links_that_weigh(robot, part, 2)
    found = robot.on_links(motion, links).on_tree.derivatives()
    for derivative, name in zip(found, ("q", "v", "a"), strict=True):

        def torque(x, name=name):
            return robot.link_regressor(dataclasses.replace(motion, **{name: x})) @ links

        expected = by_differences(torque, getattr(motion, name))
        assert derivative == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("part", [1.0, -1.0, -3.0])
def test_so_has_their_gravity(robot, part):
    motion, links = motion_of(robot, 3), links_that_weigh(robot, part, 4)

    def torque(q):
        there = dataclasses.replace(motion, q=q)
        return robot.on_links(there, links).on_tree.gravity_torque(GRAVITY_ALONG_X)

    expected = by_differences(torque, motion.q)
    found = robot.on_links(motion, links).on_tree.gravity_derivative(GRAVITY_ALONG_X)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_a_body_that_weighs_less_than_nothing_has_the_derivatives_of_one_that_weighs_more_turned_round(robot):
    motion, body = motion_of(robot, 5), np.r_[2.0, 0.1, -0.2, 0.3, 0.5, 0.4, 0.3, 0.01, 0.02, 0.03]
    tree = robot.motion(motion.q, motion.v, motion.a).on_tree
    for more, less in zip(
        tree.body_derivatives(robot.tip_frame, body), tree.body_derivatives(robot.tip_frame, -body), strict=True
    ):
        assert less == pytest.approx(-more, rel=1e-9, abs=1e-9)
