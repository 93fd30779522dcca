"""Base parameters of the TX40 recording: as before, and the same whatever other robot's tool solves for them."""

from __future__ import annotations

import numpy as np
import pytest
from data_folder import tx40_folder

import rx90b_flex as rf
from rx90b_flex.effects.coupling import JointCoupling
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign


def fitted() -> tuple[Identification, Regression]:
    """The declared model on the identification part, and the held-out part."""
    campaign = load_campaign(tx40_folder() / "campaign.toml")
    robot = rf.load_robot(campaign.robot_source)
    data, held_out = (
        Regression.of(robot, r, campaign.cutoff_hz) for r in (campaign.identification, campaign.validation)
    )
    return identify(data, data.robot.effects, fit_links=True), held_out


@pytest.fixture(scope="module")
def result() -> tuple[Identification, Regression]:
    return fitted()


def columns_of(regression: Regression, fit: Identification) -> np.ndarray:
    """Of all linear parameters, at the velocities within which the fit found that dry friction turns over."""
    parts = [regression.link_columns, *(regression.columns(e) for e in fit.effects)]
    return np.concatenate(parts, axis=2)


def scale_of(columns: np.ndarray) -> np.ndarray:
    """One over each column's length; zero for columns of nothing but rounding."""
    length = np.linalg.norm(columns.reshape(-1, columns.shape[2]), axis=0)
    return np.where(length > 1e-12 * length.max(), 1.0 / np.maximum(length, 1e-300), 0.0)


def test_the_estimate_is_reproducible(result: tuple[Identification, Regression]) -> None:
    again, _ = fitted()
    assert np.array_equal(again.theta, result[0].theta)


def test_the_held_out_error_of_the_declared_model_is_a_fifth(result: tuple[Identification, Regression]) -> None:
    """0.2136 with friction as a sign of the velocity; its turn-over, fitted on the other recordings, takes some of that away."""
    fit, held_out = result
    error = np.linalg.norm(fit.residual_on(held_out)) / np.linalg.norm(held_out.torque)
    assert 0.95 * 0.2136 < error < 0.2136


def test_the_coupling_of_the_wrist_declared_takes_a_quarter_off_the_held_out_error(
    result: tuple[Identification, Regression],
) -> None:
    """What the loop finds by itself in `test_tx40.py`: an inertia and frictions above zero."""
    fit, held_out = result
    coupling = JointCoupling(joint_pair=("joint_5", "joint_6"))
    coupled = identify(fit.regression, [*fit.effects, coupling], fit_links=True)
    before, after = (np.linalg.norm(f.residual_on(held_out)) for f in (fit, coupled))
    assert after < 0.75 * before
    (found,) = (e for e in coupled.effects if isinstance(e, JointCoupling))
    assert (found.coefficients > 0.0).all()


def test_the_fit_is_that_of_plain_weighted_least_squares(result: tuple[Identification, Regression]) -> None:
    """NumPy's solution of the same weighted rows predicts the same torque: rounding, through a condition number of 1e6 at most."""
    fit, held_out = result
    columns, sigma = columns_of(fit.regression, fit), fit.solution.sigma
    scale = scale_of(columns)
    rows = (columns * scale / sigma[:, None]).reshape(-1, len(scale))
    target = (fit.regression.torque / sigma).ravel()
    plain = np.linalg.lstsq(rows, target, rcond=1e-6)[0] * scale
    for regression in (fit.regression, held_out):
        own, other = columns_of(regression, fit) @ fit.theta, columns_of(regression, fit) @ plain
        assert np.linalg.norm(own - other) < 1e-3 * np.linalg.norm(regression.torque)


def test_held_out_prediction_is_no_worse_than_that_of_ordinary_least_squares(
    result: tuple[Identification, Regression],
) -> None:
    """Ordinary least squares on the same columns is what figaroh's QR and `lstsq` come to."""
    fit, held_out = result
    columns = columns_of(fit.regression, fit)
    scale = scale_of(columns)
    rows = (columns * scale).reshape(-1, len(scale))
    ordinary = np.linalg.lstsq(rows, fit.regression.torque.ravel(), rcond=1e-6)[0] * scale
    theirs = np.linalg.norm(held_out.torque - columns_of(held_out, fit) @ ordinary)
    assert np.linalg.norm(fit.residual_on(held_out)) <= theirs
