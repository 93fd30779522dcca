"""Claims about a real robot: ten seconds of a Staubli TX40, whose declared model lacks the coupling of its wrist."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from data_folder import tx40_folder
from real_loops import closed_loop
from scipy import signal

import rx90b_flex as rf
from rx90b_flex.diagnose.close import FoundEffect
from rx90b_flex.diagnose.evidence import STANDSTILL
from rx90b_flex.diagnose.output import write_result
from rx90b_flex.effects.log_effect import between

BYTES = 2e9
# the coupling where it is declared: test_tx40_identification.py
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("tx40")]


@pytest.fixture(scope="module")
def result() -> rf.ClosedLoop:
    return closed_loop("tx40")


def of_type(result: rf.ClosedLoop, kind: str) -> list[FoundEffect]:
    return [e for e in result.effects if e.effect.type_name() == kind]


def value(found: FoundEffect, name: str) -> tuple[float, float]:
    (estimate,) = (p for p in found.parameters if p.name == name)
    assert estimate.value is not None and estimate.std is not None
    return estimate.value, estimate.std


def fall(found: FoundEffect) -> float:
    """Of the relative error on held-out data, with an effect, or with those of one law that were added together."""
    return found.before.relative_error - found.after.relative_error


def test_the_coupling_of_joints_5_and_6_is_found_first(result):
    first = result.effects[0].effect
    assert (first.type_name(), first.joints) == ("joint_coupling", ("joint_5", "joint_6"))


def test_the_validation_error_falls_from_a_fifth_to_less_than_a_tenth(result):
    assert 0.20 < result.before.validation.relative_error < 0.22
    assert result.after.validation.relative_error <= 0.09


def test_the_identification_error_falls_by_half(result):
    assert result.before.identification.relative_error == pytest.approx(0.10, abs=0.005)
    assert result.after.identification.relative_error <= 0.055


def test_half_of_the_fall_on_held_out_data_is_the_coupling_and_nearly_all_of_the_rest_what_friction_holds_at_rest(
    result,
):
    assert result.effects[0].before == result.before.validation
    whole = result.before.validation.relative_error - result.after.validation.relative_error
    coupling = fall(result.effects[0])
    held = fall(of_type(result, "held_friction")[0])  # one law of several joints, which were added together
    assert coupling > 0.5 * whole and coupling > held > 0.3 * whole
    assert coupling + held > 0.9 * whole


def test_the_coupling_is_that_of_a_motor(result):
    """An inertia and frictions above zero: the motor of joint 6 also turns with joint 5."""
    for name in ("inertia", "viscous", "coulomb"):
        estimate, std = value(result.effects[0], name)
        assert estimate > 3 * std > 0  # which allows for how little 6 s tell of the residual's own spectrum


def test_viscous_friction_grows_less_than_linearly_on_several_joints(result):
    """Power-law viscous friction, as the source has it for the RX90B, takes the place of the declared linear one."""
    found = of_type(result, "viscous_power_friction")
    assert len({e.effect.joints for e in found}) >= 3
    for e in found:
        power, std = value(e, "power")
        assert power + 2 * std < 1


def test_joint_4_has_a_ripple_of_about_30_cycles_a_turn(result):
    ripples = [e for e in of_type(result, "gear_ripple") if e.effect.joints == ("joint_4",)]
    assert ripples
    order, std = value(ripples[0], "order")
    assert order == pytest.approx(30.6, abs=0.3) and std < 0.1
    amplitude, std = value(ripples[0], "amplitude")
    assert amplitude > 5 * std


def test_joint_5_s_friction_repeats_with_its_motor_which_the_search_did_not_know(result):
    (text,) = result.motor_turns
    assert text.startswith("joint_5.position_friction repeats once a turn of joint_5's motor (order 44.9 ")


def test_every_effect_is_significant_after_correction_for_all_that_was_tried(result):
    assert all(e.p_value < 1e-3 for e in result.effects)
    # one law on several joints is one hypothesis, which blocks are asked about as a whole
    alone = [e for e in result.effects if len(of_type(result, e.effect.type_name())) < 3]
    assert all(e.gain_t > 2 for e in alone)


def test_joint_2_holds_friction_at_rest_which_no_function_of_its_motion_tells(result):
    """While the robot rests, dry friction holds any torque within its bounds; smooth curves leave it as it was."""
    (held,) = (e for e in of_type(result, "held_friction") if e.effect.joints == ("joint_2",))
    torque, std = value(held, "torque")
    assert torque > 5 * std > 0
    joint = result.joints.index("joint_2")
    before, after, free = (e.validation.torque_rms[joint] for e in (result.before, result.after, result.explainable))
    assert free > 0.9 * before and after < 0.5 * before


def test_what_no_effect_explains_is_standstill(result):
    """Of joint 3, which creeps back by 2e-5 rad after it has settled: whether that turns its friction no motion tells."""
    assert result.verdict == "partly_explained"
    where = result.unexplained.where
    assert (where[0].joint, where[0].signal) == ("joint_3", STANDSTILL)
    assert where[0].score > 0.5


def lowpass(x: np.ndarray, cutoff_hz: float, rate_hz: float) -> np.ndarray:
    return np.asarray(signal.sosfiltfilt(signal.butter(4, cutoff_hz, fs=rate_hz, output="sos"), x, axis=0))


def test_the_saved_model_predicts_the_validation_part_as_well_as_reported(result, tmp_path):
    """`robot.toml`, whose links a body can have, on the held-out motion, differentiated by NumPy alone."""
    write_result(result, tmp_path)
    robot = rf.load_robot(tmp_path / "robot.toml").over_time()
    (prediction,) = result.predictions
    recording = prediction.recording
    rate, cutoff = recording.sample_rate_hz, 40.0
    assert recording.joints == robot.joints
    q = lowpass(recording.position, 2 * cutoff, rate)
    v = np.gradient(q, 1 / rate, axis=0)
    a = np.gradient(v, 1 / rate, axis=0)
    torque = robot.inverse_dynamics(q, v, a, recording.time)
    seen = robot.on_links(robot.motion(q, v, a, recording.time), robot.link_parameters, robot.effects)
    for effect in between(robot.effects):  # which stand between the robot and its log
        torque = effect.logged(seen, torque)
    error = lowpass(recording.torque - torque, cutoff, rate)
    # away from the ends by four periods of the cutoff: how signals go on beyond them is each filter's own affair
    inside = slice(round(4 / cutoff * rate), -round(4 / cutoff * rate))
    reported = np.linalg.norm((prediction.torque - prediction.after)[inside])
    assert np.linalg.norm(error[inside]) == pytest.approx(reported, rel=0.02)


@pytest.mark.long
def test_the_command_takes_less_than_two_gigabytes_where_it_compiles_as_well(tmp_path: Path) -> None:
    campaign = tx40_folder() / "campaign.toml"
    script = Path(sys.executable).with_name("rx90b-flex")
    if not script.is_file():
        pytest.skip(f"the package is not installed beside {sys.executable}")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with subprocess.Popen([script, "close-loop", campaign, "--out", tmp_path / "out"], env=environment) as run:
        _, run.returncode, used = os.wait4(run.pid, 0)
    assert run.returncode == 0
    assert used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) < BYTES  # kB on Linux, bytes on macOS
    assert json.loads((tmp_path / "out" / "closed_loop.json").read_text())["schema"] == 1
