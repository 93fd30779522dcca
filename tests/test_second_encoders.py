"""Second encoders: a gear's stiffness is the slope of its deflection over the torque that passes it.

The recordings come from two inertias in plain NumPy (`two_inertias`) with friction of LuGre's kind; the second encoder is read 2 ms
late, sits off its axis, ripples with the angle and counts in steps.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from data_folder import data_folder
from two_inertias import Drive, simulate, write_campaign

import rx90b_flex as rf
from rx90b_flex.diagnose.deflection import GearDeflection, gear_deflections
from rx90b_flex.diagnose.output import closed_loop_robot, write_result
from rx90b_flex.identify.deflection import agreement, play
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import Campaign, load_campaign
from rx90b_flex.view.report import write_report

DECLARED = "".join(
    f'[[effects]]\ntype = "{kind}"\njoint = "swing"\n'
    for kind in ("drive_inertia", "coulomb_friction", "viscous_friction")
)
ROLES = ("identification", "identification", "validation")


def looked_at(campaign: Campaign) -> tuple[GearDeflection, ...]:
    """What second encoders show beside the declared model, identified."""
    robot = rf.load_robot(campaign.robot_source)
    regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz)
    model = identify(regression, regression.robot.effects, fit_links=True)
    return gear_deflections(robot, campaign, model)


def campaign_of(folder: Path, drive: Drive, seed: int = 1) -> Path:
    return write_campaign(folder, simulate(drive, np.random.default_rng(seed), len(ROLES)), ROLES, DECLARED)


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return campaign_of(tmp_path_factory.mktemp("soft"), Drive())


def test_the_stiffness_of_a_gear_lies_in_its_interval_and_is_known_to_a_fifth(soft: Path) -> None:
    (gear,) = looked_at(load_campaign(soft))
    assert gear.effect is not None and gear.trial is not None and gear.trial.p_value < 1e-6
    stiffness = gear.parameters[0]
    assert stiffness.value is not None and stiffness.std is not None
    assert abs(stiffness.value - Drive().stiffness) < 3.0 * stiffness.std
    assert stiffness.std < 0.2 * Drive().stiffness


def test_recordings_agree_and_the_lag_of_the_second_encoder_is_told(soft: Path) -> None:
    (gear,) = looked_at(load_campaign(soft))
    assert gear.fit is not None and gear.agreement > 0.01
    assert gear.fit.data.lag_s == pytest.approx(Drive().lag_s, abs=3e-4)


def test_the_load_carries_over_to_a_recording_that_was_not_fitted(soft: Path) -> None:
    (gear,) = looked_at(load_campaign(soft))
    assert gear.errors is not None
    held_out = gear.errors["validation"]
    assert held_out.after < 0.5 * held_out.before < held_out.measured


@pytest.mark.parametrize(
    "change",
    [
        {"hysteresis": 8.0},
        *(pytest.param(x, marks=pytest.mark.slow) for x in ({"step": 3.0e-5}, {"dry": 40.0}, {"gap": 3.0e-4})),
    ],
)
def test_another_gear_or_encoder_leaves_the_truth_in_the_interval(tmp_path: Path, change: dict[str, float]) -> None:
    (gear,) = looked_at(load_campaign(campaign_of(tmp_path, dataclasses.replace(Drive(), **change), seed=2)))
    assert gear.fit is not None and gear.effect is not None
    off = gear.fit.compliance - 1.0 / Drive().stiffness
    assert abs(off) < 3.0 * gear.fit.std("torque")


def test_a_gear_that_does_not_give_way_is_not_named(tmp_path: Path) -> None:
    (gear,) = looked_at(load_campaign(campaign_of(tmp_path, Drive(stiff=True))))
    assert gear.effect is None and "shows no deflection" in gear.message


def test_a_second_encoder_that_repeats_the_motors_is_said(soft: Path) -> None:
    campaign = load_campaign(soft)
    runs = tuple(dataclasses.replace(r, link_position=r.position) for r in campaign.recordings)
    (gear,) = looked_at(dataclasses.replace(campaign, recordings=runs))
    assert gear.effect is None and "repeats the motor's" in gear.message


def test_a_second_encoder_that_counts_the_other_way_is_said_and_not_used(soft: Path) -> None:
    campaign = load_campaign(soft)
    runs = tuple(dataclasses.replace(r, link_position=-1.0 * r.link_position) for r in campaign.recordings)  # type: ignore[operator]
    (gear,) = looked_at(dataclasses.replace(campaign, recordings=runs))
    assert gear.effect is None and "times as far as the motor" in gear.message


def test_a_flexibility_that_is_declared_is_measured_but_not_added(soft: Path, tmp_path: Path) -> None:
    declared = (
        DECLARED + '[[effects]]\ntype = "drive_flexibility"\njoint = "swing"\nstiffness = 2.0e4\ndamping = 40.0\n'
    )
    lanes = simulate(Drive(), np.random.default_rng(1), len(ROLES))
    (gear,) = looked_at(load_campaign(write_campaign(tmp_path, lanes, ROLES, declared)))
    assert gear.effect is None and gear.parameters and "declares this flexibility" in gear.message


@pytest.mark.slow
def test_a_declared_flexibility_without_a_stiffness_gets_one(soft: Path, tmp_path: Path) -> None:
    lanes = simulate(Drive(), np.random.default_rng(1), len(ROLES))
    declared = DECLARED + '[[effects]]\ntype = "drive_flexibility"\njoint = "swing"\n'
    result = rf.close_loop(write_campaign(tmp_path, lanes, ROLES, declared))
    assert isinstance(result, rf.ClosedLoop)
    (own,) = (e for e in closed_loop_robot(result).effects if e.type_name() == "drive_flexibility")
    assert own.coefficients[0] == pytest.approx(Drive().stiffness, rel=0.2)
    assert result.after.validation.relative_error <= result.before.validation.relative_error
    assert any("declared without a stiffness" in said for said in result.cautions)


@pytest.mark.slow
def test_the_loop_names_the_gear_and_writes_it_into_the_robot(soft: Path, tmp_path: Path) -> None:
    result = rf.close_loop(soft)
    assert "drive_flexibility" in [e.effect.type_name() for e in result.effects]
    write_result(result, tmp_path, extra=[lambda r, at: write_report(r, at / "report.html")])
    content = json.loads((tmp_path / "closed_loop.json").read_text())
    named = [e for e in content["effects"] if e["type"] == "drive_flexibility"]
    assert [e["joint"] for e in named] == ["swing"] and named[0]["p_value"] < 1e-6
    assert (
        content["deflection"][0]["rms"]["validation"]["after"] < content["deflection"][0]["rms"]["validation"]["before"]
    )
    robot = rf.load_robot(tmp_path / "robot.toml")
    assert robot.coordinates == ("swing:drive", "swing:torsion")
    assert "what second encoders show" in (tmp_path / "report.html").read_text()


def test_play_follows_only_beyond_its_width() -> None:
    np.testing.assert_allclose(play(np.array([0.0, 1.0, 3.0, 2.0, -2.0]), 1.0), [0.0, 0.0, 2.0, 2.0, -1.0])


def test_agreement_is_the_chance_of_so_large_a_spread() -> None:
    """Of two estimates the difference over its own standard deviation is one normal number."""
    from scipy import stats

    assert agreement([(1.0, 0.3), (2.0, 0.4)]) == pytest.approx(2.0 * stats.norm.sf(1.0 / 0.5))


@pytest.mark.slow
def test_intervals_of_the_compliance_hold_what_they_promise(tmp_path: Path) -> None:
    """Of 40 campaigns at least 33 within 1.96 standard deviations: fewer of a true 95 % happen once in 3000."""
    lanes = simulate(Drive(), np.random.default_rng(7), 120)
    inside = 0
    for i in range(0, 120, 3):
        at = slice(i, i + 3)
        part = dataclasses.replace(lanes, motor=lanes.motor[:, at], link=lanes.link[:, at], torque=lanes.torque[:, at])
        (gear,) = looked_at(load_campaign(write_campaign(tmp_path, part, ROLES, DECLARED)))
        assert gear.fit is not None
        inside += abs(gear.fit.compliance - 1.0 / Drive().stiffness) < 1.96 * gear.fit.std("torque")
    assert inside >= 33


def test_the_encoders_of_a_large_arm_show_three_gears_on_which_recordings_agree() -> None:
    """Axes 1-3 have their own second encoders, read 3 ms late; those of 4-6 repeat the motor's."""
    found = looked_at(load_campaign(data_folder("kr300_encoders") / "campaign.toml"))
    named = [gear.joint for gear in found if gear.effect is not None]
    assert named == ["A1", "A2", "A3"]
    for gear in found[:3]:
        assert gear.agreement > 0.05 and gear.errors is not None and gear.fit is not None
        assert gear.errors["validation"].after < gear.errors["validation"].before
        assert gear.fit.data.lag_s == pytest.approx(3.0e-3, abs=0.2e-3)
    assert all("repeats the motor's" in gear.message for gear in found[3:])


@pytest.mark.slow
def test_a_gear_with_which_the_torques_fit_worse_than_as_declared_is_told_and_left_out() -> None:
    campaign = load_campaign(data_folder("kr300_encoders") / "campaign.toml")
    roles = ("identification", "validation", "validation")
    recordings = [dataclasses.replace(r, role=x) for r, x in zip(campaign.recordings, roles, strict=True)]
    result = rf.close_loop(dataclasses.replace(campaign, recordings=tuple(recordings)))
    assert isinstance(result, rf.ClosedLoop)
    assert result.after.validation.relative_error <= result.before.validation.relative_error
    shown = [gear for gear in result.deflection if gear.parameters]
    added = [e.effect.joints for e in result.effects if e.effect.type_name() == "drive_flexibility"]
    assert shown and all("not in the robot file" in g.message or (g.joint,) in added for g in shown)
