"""Claims about accelerometers in a campaign: read as stated, fitted together with the motors' signals, and refused where unfit."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from linear_campaign import BENT, recordings_at, viscous_robot, write
from test_grey_box import truth, wrong

from rx90b_flex import cli
from rx90b_flex.identify.accelerometers import sensor_rows
from rx90b_flex.identify.frf_command import FrfOptions, MotorIdentification, frf_json, identify_from_motors
from rx90b_flex.signals import load_campaign
from rx90b_flex.signals.stated import Accelerometer
from rx90b_flex.view import frf_report
from rx90b_flex.view.page import Image

ROBOT = viscous_robot()
SENSORS = tuple(Accelerometer(link, p) for link in ("link_2", "link_3") for p in ((0.0, 0.12, 0.3), (0.1, -0.1, 0.05)))
QUICK = FrfOptions(starts=0, modes=(5,), bending_alike_std=0.0, replay=False)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight realisations at one pose, 1 % of noise on every signal; the robot file's hinges are declared wrong."""
    runs = recordings_at(
        ROBOT, BENT[0], np.random.default_rng(2), realisations=8, noise=0.01, sensors=SENSORS, sensor_noise=0.01
    )
    return write(tmp_path_factory.mktemp("accelerometers"), wrong(ROBOT, 0.2, 1), runs, SENSORS)


@pytest.fixture(scope="module")
def both(campaign: Path) -> tuple[MotorIdentification, MotorIdentification]:
    """By motors alone, and together with the accelerometers."""
    text = campaign.read_text()
    alone = campaign.with_name("motors.toml")
    head, _, rest = text.partition("[[accelerometer]]")
    alone.write_text(head + rest[rest.index("[[recording]]") :])
    return identify_from_motors(alone, QUICK), identify_from_motors(campaign, QUICK)


def test_rows_of_a_sensor_are_its_acceleration_and_what_gravity_does_as_it_turns() -> None:
    q = ROBOT.input_matrix @ BENT[0] + 0.01 * np.arange(ROBOT.model.nv)
    linear, gravity = sensor_rows(ROBOT, q, SENSORS)
    model, data = ROBOT.model, ROBOT.model.createData()
    rest = np.zeros(model.nv)
    a = np.random.default_rng(0).standard_normal(model.nv)

    def shown(q: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Proper accelerations: without gravity a sensor at rest shows nothing, with it -g in its own frame."""
        pin.forwardKinematics(model, data, q, rest, a)
        out = []
        for sensor in SENSORS:
            joint = dict(ROBOT.bodies)[sensor.link]
            spatial = pin.getAcceleration(model, data, joint, pin.LOCAL)
            own = spatial.linear + np.cross(spatial.angular, sensor.position)
            out.append(own - data.oMi[joint].rotation.T @ model.gravity.linear)
        return np.concatenate(out)

    np.testing.assert_allclose(linear @ a, shown(q, a) - shown(q, rest), atol=1e-12)
    step = 1e-6  # central differences: second order, 1e-12 g
    turned = np.stack([(shown(q + d, rest) - shown(q - d, rest)) / (2 * step) for d in step * np.eye(model.nv)], axis=1)
    np.testing.assert_allclose(gravity, turned, atol=1e-8)


def test_sensors_and_their_columns_are_read_as_they_were_written(campaign: Path) -> None:
    loaded = load_campaign(campaign)
    assert loaded.accelerometers == SENSORS
    again = recordings_at(
        ROBOT, BENT[0], np.random.default_rng(2), realisations=8, noise=0.01, sensors=SENSORS, sensor_noise=0.01
    )
    assert loaded.recordings[3].acceleration is not None
    np.testing.assert_array_equal(loaded.recordings[3].acceleration, again[3].acceleration)


@pytest.mark.slow
def test_fitted_together_the_joints_stiffness_is_known_far_better(
    both: tuple[MotorIdentification, MotorIdentification],
) -> None:
    alone, together = both
    assert alone.grey is not None and together.grey is not None and not together.left_out
    true = truth(ROBOT)
    gain = []
    for e in together.grey.estimates:
        name = re.sub(r"(friction_slope)_\d", r"\1", e.name)  # one an experiment
        # 24 parameters: one in 660 trials has one beyond four deviations
        assert abs(np.log(e.value / true[name])) < 4.0 * e.std / e.value, e.name
        if "joint_stiffness" in e.name:
            gain.append(alone.grey[e.name].std / alone.grey[e.name].value / (e.std / e.value))
    assert np.median(gain) > 1.5, gain
    assert not together.grey.bias_detected


@pytest.mark.slow
def test_the_result_names_its_sensors(both: tuple[MotorIdentification, MotorIdentification]) -> None:
    alone, together = (frf_json(result) for result in both)
    assert alone["accelerometers"] == []
    assert together["accelerometers"] == [{"link": s.link, "position": list(s.position)} for s in SENSORS]
    json.dumps(together, allow_nan=False)


@pytest.mark.slow
def test_the_report_says_that_they_were_used_and_shows_their_residuals(
    both: tuple[MotorIdentification, MotorIdentification], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone, together = both
    monkeypatch.setattr(
        frf_report, "image", lambda figure, alt, caption="", zoom=False: Image("", alt, 1, 1, caption)
    )  # drawing is slow
    for result, count in ((alone, 0), (together, 1)):
        frf_report.write_frf_report(result, tmp_path / "report.html")
        text = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert text.count("4 accelerometers on link 2, link 3 were fitted together") == count
        assert text.count("residuals of the accelerometers") == count


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('link = "link_3"', 'link = "link_9"', "link_9"),
        ('"acc_1_x", "acc_1_y", "acc_1_z"', '"acc_1_x", "acc_1_y"', "three are expected"),
        ('"acc_1_x", "acc_1_y", "acc_1_z"', '"acc_1_x", "acc_1_y", "acc_1_x"', "listed twice"),
        ('"acc_1_x", "acc_1_y", "acc_1_z"', '"acc_1_x", "acc_1_y", "acc_9_z"', "acc_9_z"),
        ('"acc_1_x", "acc_1_y", "acc_1_z"', '"acc_1_x", "acc_1_y", "q_joint_1"', "already used"),
    ],
)
def test_a_wrong_sensor_is_refused_in_one_line(
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    old: str,
    new: str,
    message: str,
) -> None:
    changed = campaign.with_name("changed.toml")
    changed.write_text(campaign.read_text().replace(old, new, 1))
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "frf", str(changed), "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2 and message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
