"""Claims about what is worth a name: however certain, an effect has to matter to a joint, and a delay to the log's clock."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.kinds import laws
from rx90b_flex.diagnose.loop import Addition, Standing
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.torque import TorqueData, TorqueModel, TorqueResidual, find, find_each
from rx90b_flex.diagnose.trial import TorqueTrial
from rx90b_flex.effects import Effect, Sites, catalogue
from rx90b_flex.effects.stand_in import form_stated
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign

RATE_HZ, SECONDS = 100.0, 10.0
COULOMB, VISCOUS = (0.0, 0.0), (3.0, 1.5)  # no step: between samples a step of dry friction has its own instant
DECLARED = [{"type": "viscous_friction", "joint": j} for j in ("shoulder", "elbow")]


def logs(folder: Path, noise: Sequence[float], late_s: float = 0.0, more: Sequence[ind.Torque] = ()) -> Path:
    """Three runs whose torques are logged `late_s` after the positions."""
    rng, arm = np.random.default_rng(0), ind.two_joints(folder)
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=SECONDS, rate_hz=RATE_HZ, lines=10)
        whole = ind.run(arm, role, m, [ind.friction(COULOMB, VISCOUS), *more], np.zeros_like(m.q))
        # the motion repeats, so that a shift in time is a turn of each of its harmonics
        turn = np.exp(-2j * np.pi * np.fft.rfftfreq(len(m.time), 1 / RATE_HZ) * late_s)
        torque = np.fft.irfft(np.fft.rfft(whole.torque, axis=0) * turn[:, None], len(m.time), axis=0)
        runs.append(dataclasses.replace(whole, torque=torque + ind.white(rng, len(m.time), noise)))
    return ind.write_files(folder, arm, DECLARED, runs)


def search_beside_declared(campaign: Path, kind: Callable[[type[Effect]], bool]) -> Search:
    """Of some types, beside the declared model."""
    read = load_campaign(campaign)
    robot = rf.load_robot(read.robot_source)
    regression = Regression.of(robot, read.identification, read.cutoff_hz)
    model = identify(regression, regression.robot.effects, fit_links=True)
    return Search(model, Sites(regression.robot.joints, robot.tip_frame), kind)


def best(campaign: Path, kind: str) -> TorqueTrial:
    """The largest gain of one type, in all its places, beside the declared model."""
    return max(search_beside_declared(campaign, lambda e: e.type_name() == kind).run(), key=lambda t: t.gain)


def test_the_company_of_an_effect_is_looked_for_on_its_joints_and_on_the_whole_robot(tmp_path: Path) -> None:
    springs = [ind.hidden("joint_spring", j, {"stiffness": 30.0, "rest_angle": 0.4}) for j in (0, 1)]
    search = search_beside_declared(logs(tmp_path, (0.05, 0.02), more=springs), laws)
    every = {(type(t.effect), t.label): t for t in search.run() if not t.members}
    company = search.run(company_of=catalogue()["gear_ripple"](joint="elbow"))
    assert any(t.effect.joints == ("shoulder",) for t in every.values())
    assert all("elbow" in t.effect.joints or not t.effect.joints for t in company)
    both = [(t, every[type(t.effect), t.label]) for t in company if (type(t.effect), t.label) in every]
    assert both
    assert all(t.gain == other.gain and t.p_value == other.p_value for t, other in both)


def test_the_shapes_that_a_search_tries_are_counted_alike_with_and_without_its_starts(tmp_path: Path) -> None:
    search = search_beside_declared(logs(tmp_path, (0.05, 0.02)), lambda e: True)
    for effect, _ in search.candidates:
        assert effect.independent_shapes(search.longest) == effect.shape_search(search.longest).independent, effect


def test_a_drift_that_hardly_begins_while_a_log_lasts_is_none(tmp_path: Path) -> None:
    search = search_beside_declared(logs(tmp_path, (0.05, 0.02)), laws)
    (low,), (high,) = catalogue()["friction_drift"](joint="elbow").shape_range(search.longest)
    # from its first tenth to a slope that loses 3 % in all of it
    assert low == pytest.approx(0.1 * SECONDS, rel=0.01)
    assert np.exp(-SECONDS / high) == pytest.approx(0.967, abs=0.001)


@pytest.mark.parametrize(
    ("samples", "noise", "named"), [(0.003, 20.0, False), (0.1, 40.0, False), (0.1, 20.0, True), (0.5, 20.0, True)]
)
def test_a_delay_far_below_a_sample_is_named_only_where_it_explains_much(
    tmp_path: Path, samples: float, noise: float, named: bool
) -> None:
    delay = samples / RATE_HZ
    # a torque of some 10 N m that goes through its range in a quarter of a second changes by 1e-3 N m in 30 us
    found = best(logs(tmp_path, (noise * delay, 0.5 * noise * delay), delay), "torque_delay")
    assert found.p_value < 1e-6
    assert found.effect.coefficients[0] == pytest.approx(delay, rel=0.2)
    assert found.accepted is named
    assert ("of a sample" in found.refusal) is not named


@pytest.mark.parametrize(("part", "named"), [(0.015, False), (0.05, True)])
def test_what_takes_less_than_a_fiftieth_off_a_joints_error_is_not_named(
    tmp_path: Path, part: float, named: bool
) -> None:
    noise = (0.5, 0.2)
    # (1 - part)^2 = noise^2 / (noise^2 + amplitude^2 / 2)
    amplitude = noise[0] * np.sqrt(2.0 * ((1.0 - part) ** -2 - 1.0))
    ripple = ind.hidden("gear_ripple", 0, {"order": 24.0, "amplitude": amplitude, "phase": 0.4})
    found = best(logs(tmp_path, noise, more=[ripple]), "gear_ripple")
    assert found.effect.joints == ("shoulder",)
    assert found.p_value < 1e-3
    assert found.accepted is named, found.refusal


@pytest.mark.parametrize(("size", "named"), [(5e-4, False), (2e-3, True)])
def test_less_than_a_thousandth_of_a_joints_torque_is_not_named(tmp_path: Path, size: float, named: bool) -> None:
    torques = np.concatenate([r.torque for r in load_campaign(logs(tmp_path, (0.0, 0.0))).identification])
    amplitude = size * np.sqrt(2.0 * (torques[:, 0] ** 2).mean())
    ripple = ind.hidden("gear_ripple", 0, {"order": 24.0, "amplitude": amplitude, "phase": 0.4})
    found = best(logs(tmp_path, (0.2 * amplitude, 0.1 * amplitude), more=[ripple]), "gear_ripple")
    assert found.effect.joints == ("shoulder",) and found.p_value < 1e-6
    assert found.accepted is named, found.refusal
    assert named or found.refusal == "its torque is 0.0005 of a joint's, too little for a name"


@pytest.mark.parametrize("friction", [2.0, -2.0])
def test_what_later_additions_turn_into_a_value_that_it_cannot_have_is_taken_out_whatever_stands_on_it(
    tmp_path: Path, friction: float
) -> None:
    """Dry friction that pushes, beside a Stribeck effect that needs one in its place."""

    def elbow(m: ind.Motion, load: np.ndarray) -> np.ndarray:
        v = m.v[:, 1]
        dropped = 6.0 * np.exp(-((np.abs(v) / 0.3) ** 2)) * np.sign(v)
        return np.column_stack([np.zeros(len(v)), friction * np.sign(v) + dropped])

    read = load_campaign(logs(tmp_path, (0.05, 0.02), more=[elbow]))
    robot = rf.load_robot(read.robot_source)
    data, sites = TorqueData.of(robot, read), Sites(("shoulder", "elbow"), robot.tip_frame)
    residual = TorqueResidual(data, read, sites, fit_links=True)
    dry = catalogue()["presliding_friction"](joint="elbow", deflection=1e-4)
    along_angle = form_stated(catalogue()["stribeck_friction"], ["deflection"])
    fallen = along_angle(joint="elbow", velocity=0.3, power=2.0, deflection=1e-4)
    model = TorqueModel(identify(data.regression, (*data.regression.robot.effects, dry, fallen), fit_links=True), data)
    fitted = next(e for e in model.effects if e.type_name() == "presliding_friction")
    assert fitted.coefficients[0] * friction > 0.0
    trials = [
        residual.search(model).without(e)
        for e in model.effects
        if e.type_name() in ("presliding_friction", "stribeck_friction")
    ]
    steps = tuple(Addition(t, (), None, None) for t in trials)
    assert residual.needless(Standing(model, steps), latest=1) is (steps[0] if friction < 0.0 else None)


def test_of_two_ripples_of_one_joint_each_is_found_again_as_itself(tmp_path: Path) -> None:
    """Where a fit has moved both, so that one of them is the nearest to what either began as."""
    kind = catalogue()["gear_ripple"]
    begun = [kind(joint="elbow", order=order, amplitude=1.0, phase=0.0) for order in (11.0, 12.0)]
    moved = [dataclasses.replace(e, order=order) for e, order in zip(begun, (11.6, 15.0), strict=True)]
    model = type("Model", (), {"effects": (moved[1], moved[0])})()
    assert find(model, begun[0]) is find(model, begun[1]) is moved[0]
    assert find_each(model, begun) == moved
    assert find_each(model, begun[::-1]) == moved[::-1]


@pytest.mark.parametrize("stiffness", [0.0, 20.0])
def test_what_has_no_certain_value_beside_a_curve_is_taken_out(tmp_path: Path, stiffness: float) -> None:
    """A spring beside a curve of friction, which otherwise makes nothing needless that has a name."""

    def elbow(m: ind.Motion, load: np.ndarray) -> np.ndarray:
        v = m.v[:, 1]
        bump = 4.0 * np.exp(-(((v - 0.3) / 0.2) ** 2)) + stiffness * (m.q[:, 1] - 0.2)
        return np.column_stack([np.zeros(len(v)), bump])

    read = load_campaign(logs(tmp_path, (0.05, 0.02), more=[elbow]))
    robot = rf.load_robot(read.robot_source)
    data, sites = TorqueData.of(robot, read), Sites(("shoulder", "elbow"), robot.tip_frame)
    residual = TorqueResidual(data, read, sites, fit_links=True)
    spring = catalogue()["joint_spring"](joint="elbow")
    curve = catalogue()["friction_curve"](joint="elbow", velocities=tuple(np.linspace(-1.0, 1.0, 15)))
    model = TorqueModel(
        identify(data.regression, (*data.regression.robot.effects, spring, curve), fit_links=True), data
    )
    trials = [
        residual.search(model).without(e) for e in model.effects if e.type_name() in ("joint_spring", "friction_curve")
    ]
    steps = tuple(Addition(t, (), None, None) for t in trials)
    assert residual.needless(Standing(model, steps), latest=1) is (None if stiffness else steps[0])
