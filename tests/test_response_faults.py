"""Claims about frequency responses that no robot has: columns of the other sign or in degrees are refused, late torques are not."""

from __future__ import annotations

import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.identify.response_faults import check_response

POSE, SLOPE = np.array([0.0, 0.5 * np.pi, 1.0]), 30.0  # rad; N m s/rad of each drive's friction
ROBOT = rf.load_robot("rx90b_3dof")


def measured(late_s: float = 0.0, **factors: float) -> FrequencyResponse:
    """The robot's response with 1 % of noise, torques so much late, and a joint's own rows so many times what they are."""
    hz, rng = np.arange(1.0, 60.0, 0.5), np.random.default_rng(3)
    robot = ROBOT.with_effects([e for e in ROBOT.effects if not e.traits.is_friction])
    value = robot.linearize(robot.input_matrix @ POSE).frf(hz)
    value = np.linalg.inv(np.linalg.inv(value) + SLOPE * np.eye(3) / (2j * np.pi * hz)[:, None, None])
    value = value * np.exp(2j * np.pi * late_s * hz)[:, None, None]
    for joint, factor in factors.items():
        value[:, robot.joints.index(joint)] *= factor
    std = 0.01 * np.abs(value)
    value = value + std * (rng.normal(size=value.shape) + 1j * rng.normal(size=value.shape)) / np.sqrt(2.0)
    covariance = np.stack([np.diag(x.ravel() ** 2) for x in std]).astype(complex)
    return FrequencyResponse(hz, value, covariance, robot.joints, POSE)


@pytest.mark.parametrize("late_s", [0.0, 2e-3, -2e-3, 8e-3])
def test_a_sound_response_is_taken_though_torques_are_late(late_s):
    check_response(measured(late_s), ROBOT)


@pytest.mark.parametrize("joint", ROBOT.joints)
@pytest.mark.parametrize("late_s", [0.0, 1e-3])
def test_a_reversed_column_is_refused_with_its_joint(joint, late_s):
    with pytest.raises(ValueError, match=rf"^{joint}: the drive moves against its torque"):
        check_response(measured(late_s, **{joint: -1.0}), ROBOT)


def test_angles_in_degrees_are_refused():
    with pytest.raises(ValueError, match=r"joint_2: .* look like degrees"):
        check_response(measured(joint_2=np.rad2deg(1.0)), ROBOT)
