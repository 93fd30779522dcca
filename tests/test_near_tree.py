"""Claims about links that a log tells little of: they stay near the URDF's values as far as what is left out likes it."""

from __future__ import annotations

from pathlib import Path

import independent as ind
import numpy as np
import pytest
from scipy import linalg

import rx90b_flex as rf
from rx90b_flex.diagnose.torque import TorqueData, TorqueResidual
from rx90b_flex.effects import Sites
from rx90b_flex.identify import near_tree
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.view.report import write_report

JOINTS = tuple(ind.ur10().joints)
COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
DECLARED = [{"type": kind, "joint": j} for j in JOINTS for kind in ("coulomb_friction", "viscous_friction")]
NOISE = (6.0, 7.0, 4.0, 0.9, 0.7, 0.5)  # N m
MEMORY = 0.95


def campaign(folder: Path, seed: int, heavier: float, seconds: float) -> Path:
    """Two short logs to fit, with noise of long memory and a friction that nobody declares, and a longer one to judge by."""
    arm, rng = ind.ur10(heavier), np.random.default_rng(seed)
    runs = []
    for role, length in (("identification", seconds), ("identification", seconds), ("validation", 20.0)):
        m = ind.harmonics(rng, 6, period_s=length, periods=1, rate_hz=100.0)
        noise = ind.coloured(rng, len(m.time), NOISE, MEMORY)
        turning = ind.angle_dependent_friction(1, 2, 3.0)
        runs.append(ind.run(arm, role, m, [ind.friction(COULOMB, VISCOUS), turning], noise))
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=10.0)


def residual_of(path: Path) -> TorqueResidual:
    found = load_campaign(path)
    robot = load_robot(found.robot_source)
    sites = Sites(robot.rigid().restricted(found.joints).joints, robot.tip_frame)
    return TorqueResidual(TorqueData.of(robot, found), found, sites, fit_links=True)


def errors(folder: Path, seed: int, heavier: float, seconds: float) -> list[float]:
    """Held-out error of the fitted values as the loop fits the declared model, and without a pull."""
    folder.mkdir()
    residual = residual_of(campaign(folder, seed, heavier, seconds))
    near = residual.declared()
    data, known = residual.data, near.identified
    free = identify(known.regression, known.effects, fit_links=True, links_near=0.0)
    return [data.fitted_errors(m).validation.relative_error for m in (known, free)]


def model_of(folder: Path, strength: float) -> Identification:
    regression = residual_of(campaign(folder, 0, 1.0, 4.0)).data.regression
    return identify(regression, regression.robot.effects, fit_links=True, links_near=strength)


@pytest.mark.parametrize("strength", [0.1, 30.0])
def test_links_are_those_of_least_squares_with_the_tree_as_one_more_measurement_of_each(tmp_path, strength):
    model = model_of(tmp_path, strength)
    links = model.regression.robot.link_parameters
    deviation = near_tree.deviations(links) / np.sqrt(strength)
    rows = [
        (x / s, y / s)
        for x, y, s in zip(
            model.columns.transpose(1, 0, 2),
            (model.residual + model.columns @ model.theta).T,
            model.solution.sigma,
            strict=True,
        )
    ]
    tree = np.diag(1.0 / deviation)
    a = np.vstack([*(x for x, _ in rows), np.pad(tree, ((0, 0), (0, len(model.theta) - len(links))))])
    b = np.concatenate([*(y for _, y in rows), links / deviation])
    expected = linalg.lstsq(a, b)[0]
    scale = np.r_[deviation, np.full(len(expected) - len(links), np.abs(expected).max())]
    # the weights are those of one round before the last
    assert np.abs((model.theta - expected) / scale).max() < 1e-3


def test_a_value_that_is_the_trees_and_not_the_logs_is_not_told_as_identified(tmp_path):
    near, free = model_of(tmp_path, 30.0), model_of(tmp_path, 0.0)
    told = [{e.name for e in m.link_estimates() if e.value is not None} for m in (near, free)]
    deviation = dict(
        zip(
            [e.name for e in near.link_estimates()],
            near_tree.deviations(near.regression.robot.link_parameters),
            strict=True,
        )
    )
    for e in near.link_estimates():
        if e.value is not None:
            assert e.std < 0.5 * deviation[e.name] / np.sqrt(30.0)
    assert len(told[0]) < len(near.link_parameters)
    assert len(told[1]) < len(near.link_parameters)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heavier", "seconds", "better"), [(1.0, 4.0, 0.97), (1.15, 8.0, 0.99), (1.6, 4.0, 1.0), (1.6, 20.0, 1.01)]
)
def test_logs_near_a_urdf_predict_others_better_the_shorter_they_are_and_the_better_it_is(
    tmp_path, heavier, seconds, better
):
    pairs = [errors(tmp_path / str(seed), seed, heavier, seconds) for seed in range(10, 14)]
    ratios = [near / free for near, free in pairs]
    assert np.mean(ratios) < better
    assert max(ratios) < 1.03


@pytest.mark.slow
def test_the_report_says_that_links_were_kept_near(tmp_path):
    result = rf.close_loop(campaign(tmp_path, 0, 1.0, 4.0))
    assert result.model.links_near > 0.0
    write_report(result, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "near the URDF&#39;s values, masses to" in page or "near the URDF's values, masses to" in page
