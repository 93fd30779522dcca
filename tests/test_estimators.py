"""Claims about Huber's M-estimator: it is what others compute, bumps hardly move it, and its standard deviations hold with them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from scipy import optimize
from sklearn.linear_model import HuberRegressor

import rx90b_flex as rf
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.identify.estimators.estimator import estimator_named, estimators
from rx90b_flex.identify.estimators.huber import CUT, Huber
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Recording, load_campaign

RATE_HZ = 100.0
VISCOUS, INERTIA, NOISE = (3.0, 1.5), (0.4, 0.2), (0.2, 0.08)
JOINTS = ("shoulder", "elbow")
EFFECTS = [
    *(ViscousFriction(joint=j) for j in JOINTS),
    *(DriveInertia(joint=j) for j in JOINTS),
]
TRUE = (*VISCOUS, *INERTIA)


def regression(folder: Path, seed: int, bumps: float = 0.0, cutoff_hz: float | None = None) -> Regression:
    """Of an arm of two joints with known links; a part of the samples of each torque is off by fifty times the noise, upwards."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(seed)
    m = ind.harmonics(rng, 2, period_s=8.0, rate_hz=RATE_HZ)
    noise = ind.white(rng, len(m.time), NOISE)
    noise[rng.random(noise.shape) < bumps] += 50.0 * np.mean(NOISE)
    effects = [lambda m, load: m.v * VISCOUS + m.a * INERTIA]
    run = ind.run(arm, "identification", m, effects, noise)
    path = ind.write_files(folder, arm, [], [run], cutoff_hz=cutoff_hz, known=True)
    campaign = load_campaign(path)
    robot: Robot = rf.load_robot(campaign.robot_source)
    recordings: tuple[Recording, ...] = campaign.identification
    return Regression.of(robot.with_effects(EFFECTS), recordings, cutoff_hz)


def rows(data: Regression, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (N, 2) and torque (N,) of one joint."""
    torque = data.torque - data.link_columns @ data.robot.link_parameters
    columns = np.concatenate([data.columns(e) for e in EFFECTS if e.joint == JOINTS[joint]], axis=2)
    return columns[:, joint], torque[:, joint]


@pytest.mark.parametrize("joint", [0, 1])
def test_huber_is_the_minimum_that_scipy_finds(joint, tmp_path):
    data = regression(tmp_path, 3, bumps=0.05)
    model = Huber().identify(data, EFFECTS, fit_links=False)
    x, y = rows(data, joint)
    scale = 1.4826 * np.median(np.abs(model.residual[:, joint]))
    found = optimize.least_squares(
        lambda theta: x @ theta - y, np.zeros(2), loss="huber", f_scale=CUT * scale, xtol=1e-12, ftol=1e-12, gtol=1e-12
    )
    np.testing.assert_allclose(model.theta[joint::2], found.x, rtol=1e-4)


@pytest.mark.parametrize("joint", [0, 1])
def test_huber_is_close_to_what_scikit_learn_finds_with_a_scale_of_its_own(joint, tmp_path):
    data = regression(tmp_path, 4, bumps=0.05)
    model = Huber().identify(data, EFFECTS, fit_links=False)
    x, y = rows(data, joint)
    found = HuberRegressor(epsilon=CUT, alpha=0.0, fit_intercept=False, max_iter=1000, tol=1e-8).fit(x, y)
    std = np.sqrt(np.diag(model.covariance))[joint::2]
    assert (np.abs(model.theta[joint::2] - found.coef_) < 0.3 * std).all()


def test_bumps_move_least_squares_and_hardly_huber(tmp_path):
    errors = {"huber": [], "least_squares": []}
    for seed in range(6):
        data = regression(tmp_path, seed, bumps=0.03)
        for name, found in errors.items():
            model = estimator_named(name).identify(data, EFFECTS, fit_links=False)
            found.append((model.theta - TRUE) / TRUE)
    huber, usual = (np.sqrt(np.mean(np.square(errors[name]))) for name in ("huber", "least_squares"))
    assert huber < 0.3 * usual


def test_without_bumps_huber_is_as_certain_as_theory_says(tmp_path):
    data = regression(tmp_path, 5)
    usual = identify(data, EFFECTS, fit_links=False)
    model = Huber().identify(data, EFFECTS, fit_links=False)
    stds = [np.sqrt(np.diag(m.covariance)) for m in (model, usual)]
    # 95 % as certain for normal errors, give or take that 800 samples tell a variance to 5 %
    np.testing.assert_allclose(stds[0] / stds[1], 1.0 / np.sqrt(0.95), rtol=0.1)
    assert (np.abs(model.theta - usual.theta) < stds[1]).all()
    np.testing.assert_allclose(model.residual, model.residual_on(data), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("cutoff_hz", [None, 10.0])
def test_standard_deviations_hold_beside_bumps(cutoff_hz, tmp_path):
    """Of 160 values 95 % lie within 1.96 standard deviations: no fewer than 89 % but for one time in a thousand."""
    z = []
    for seed in range(40):
        data = regression(tmp_path, 100 + seed, bumps=0.01, cutoff_hz=cutoff_hz)
        model = Huber().identify(data, EFFECTS, fit_links=False)
        z.append((model.theta - TRUE) / np.sqrt(np.diag(model.covariance)))
    assert np.mean(np.abs(z) < 1.96) > 0.89


def test_an_estimator_is_chosen_by_name():
    assert {"huber", "least_squares"} <= set(estimators())
    with pytest.raises(ValueError, match=r"estimator is 'hubr'; did you mean 'huber'\?"):
        estimator_named("hubr")


def test_least_squares_by_name_is_least_squares(tmp_path):
    data = regression(tmp_path, 6)
    named, direct = (
        estimator_named("least_squares").identify(data, EFFECTS, fit_links=False),
        identify(data, EFFECTS, fit_links=False),
    )
    for field in dataclasses.fields(named):
        if field.name in ("theta", "covariance", "residual"):
            np.testing.assert_array_equal(getattr(named, field.name), getattr(direct, field.name))
