"""Claims about the motion before and after: an RX90B under its controller, with a spring that its file does not declare."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose import motion
from rx90b_flex.diagnose.close import _cautions
from rx90b_flex.diagnose.motion import LONGEST_SLOW_S, MotionErrors, motion_errors
from rx90b_flex.diagnose.output import motion_json
from rx90b_flex.effects import Effect, effect_from_table
from rx90b_flex.effects.friction import ViscousFriction
from rx90b_flex.effects.presliding import PreslidingFriction
from rx90b_flex.effects.torque_signal import TorqueDelay
from rx90b_flex.export import save_robot
from rx90b_flex.signals import write_campaign
from rx90b_flex.simulate import Noise, harmonics, load_cs8, simulate
from rx90b_flex.view.report import report_html

# small beside the drive: a rigid fit without it takes k / w^2 off the drive's inertia
SPRING = {"type": "joint_spring", "joint": "joint_3", "stiffness": 15.0, "rest_angle": 0.0}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> rf.ClosedLoop:
    folder: Path = tmp_path_factory.mktemp("motion")
    declared = rf.load_robot("rx90b_3dof")
    true = declared.with_effects([*declared.effects, effect_from_table(SPRING, "test", declared.joints)])
    rng = np.random.default_rng(0)
    recordings = []
    for number, role in enumerate(("identification", "identification", "validation")):
        excited = harmonics(declared, rng, period_s=4.096)
        run = simulate(true, load_cs8(), excited, noise=Noise(torque=0.5, position=1e-6), rng=rng, role=role)  # type: ignore[arg-type]
        recordings.append(dataclasses.replace(run.recording, name=f"run_{number}"))
    save_robot(declared, folder, "declared.toml", allow_inconsistent=True)
    # rigid rows hardly tell a rotor from the link behind it, and with half a rotor no flexible robot can be controlled
    file = folder / "declared.toml"
    file.write_text(file.read_text().replace('inertial_parameters = "fitted"', 'inertial_parameters = "known"'))
    return rf.close_loop(write_campaign(folder, "declared.toml", recordings, cutoff_hz=20.0))


@pytest.mark.slow
def test_the_simulated_motion_comes_nearer_to_the_log_when_the_spring_is_added(result):
    assert "joint_3.joint_spring" in [e.effect.label for e in result.effects]
    errors = motion_errors(result)
    assert isinstance(errors, MotionErrors), errors
    assert errors.motor_rms_mrad.after[2] < errors.motor_rms_mrad.before[2]
    assert errors.link_rms_mrad is None and errors.tip_rms_mm is None
    assert errors.tip_apart_rms_mm > 0
    told = motion_json(errors)
    assert told["motor_rms_mrad"]["after"] == errors.motor_rms_mrad.after.tolist() and told["tip_rms_mm"] is None
    page = report_html(result, errors)
    assert "Motion in closed loop" in page and "No link side was measured" in page


@pytest.mark.slow
def test_where_the_band_reaches_what_hinges_swing_at_it_is_said(result):
    # its links swing at 17 Hz with the drives held, and the campaign keeps 20
    caution, *others = result.cautions
    assert "first swing at 1" in caution and result.verdict == "partly_explained"
    assert all(
        "stribeck_friction" in text and "held at" in text for text in others
    )  # a few seconds do not tell its power
    low = dataclasses.replace(result.campaign, cutoff_hz=0.5)
    assert _cautions(result.source, low) == ()
    assert _cautions(result.source.rigid(), result.campaign) == ()

    def cautions_without_value(label: str) -> tuple[str, ...]:
        """Where a file leaves an effect to be identified."""
        effects = [
            e.with_coefficients(np.nan * e.coefficients) if e.label == label else e for e in result.source.effects
        ]
        return _cautions(result.source.with_effects(effects), result.campaign)

    assert cautions_without_value("joint_1.drive_inertia") == (caution,)  # does not move with the drives held
    (other,) = cautions_without_value("joint_1.joint_flexibility")
    assert "not known from which frequency" in other


@pytest.mark.slow
def test_without_references_it_is_said_that_no_motion_can_be_compared(result):
    runs = [dataclasses.replace(r, reference_position=None) for r in result.campaign.recordings]
    blind = dataclasses.replace(result, campaign=dataclasses.replace(result.campaign, recordings=tuple(runs)))
    why = motion_errors(blind)
    assert isinstance(why, str) and "no references" in why
    assert motion_json(why) == {"schema": 1, "not_simulated": why}


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Uncompiled(ViscousFriction):
    def laws(self, motion: object) -> None:
        return None


@pytest.mark.slow
def test_effects_before_the_log_and_with_a_memory_take_part_and_without_a_law_in_a_shorter_simulation(
    result, monkeypatch
):
    declared = result.source

    def identified(*to: Effect) -> MotionErrors:
        found = {id(result.declared): declared, id(result.model): declared.with_effects([*declared.effects, *to])}
        monkeypatch.setattr(motion, "identified_robot", lambda source, model, joints: found[id(model)])
        errors = motion_errors(result)
        assert isinstance(errors, MotionErrors), errors
        return errors

    more = (TorqueDelay(delay=0.004), PreslidingFriction(joint="joint_1", torque=15.0, deflection=1e-3))
    plain, both, slow = (
        identified(),
        identified(*more),
        identified(*more, _Uncompiled(joint="joint_3", coefficient=1.0)),
    )
    np.testing.assert_array_equal(*plain.motor_rms_mrad)
    # presliding friction holds joint 1 back, which changes its motion and no other's as much
    change = np.abs(both.motor_rms_mrad.after - both.motor_rms_mrad.before)
    assert change[0] > change[1:].max()
    assert plain.seconds == both.seconds <= both.of_s
    assert slow.seconds == pytest.approx(LONGEST_SLOW_S, abs=0.01) and slow.seconds < both.seconds
    assert "the first 3 s of" in report_html(result, slow)
