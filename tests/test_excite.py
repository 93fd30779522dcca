"""Claims about ``rx90b-flex excite``: the references of a campaign as files, and the options that the source recommends."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import Recording, load_campaign, save_recording
from rx90b_flex.simulate import load_cs8, square_wave
from rx90b_flex.simulate.command import read_trajectory
from rx90b_flex.simulate.excite import ExciteRequest, excitation_plans, white_amplitudes

RATE = 250.0


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


def lines_of(wave: np.ndarray) -> np.ndarray:
    """Numbers of cycles that a periodic signal holds."""
    size = np.abs(np.fft.rfft(wave))
    return np.flatnonzero(size > 1e-6 * size.max())


def test_references_repeat_keep_to_odd_lines_and_come_in_pairs_of_signs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    arguments = ["--realisations", "2", "--periods", "3", "--pose", "0,90,0", "--pose", "0,60,60"]
    assert run(monkeypatch, "excite", "rx90b_3dof", "--out", str(out), *arguments) == 0
    assert "24 runs of 3 periods of 4.096 s" in capsys.readouterr().out
    files = sorted((out / "references").rglob("*.csv"))
    assert len(files) == 2 * 2 * 3 * 2
    tables = {f"{f.parent.name}/{f.stem}": pd.read_csv(f) for f in files}
    for pose, angles in (("pose_1", (0, 90, 0)), ("pose_2", (0, 60, 60))):
        plus, minus = (tables[f"{pose}/run_001_2_{sign}"] for sign in ("plus", "minus"))
        for j, angle in enumerate(angles):
            name = f"joint_{j + 1}"
            assert plus[name].mean() == pytest.approx(np.deg2rad(angle), abs=1e-9)
            assert (plus[name] == minus[name]).all()
            # text of ten digits: the largest of 45 N m to 5e-9
            np.testing.assert_allclose(minus[f"ff_{name}"], -plus[f"ff_{name}"], atol=1e-8)
            assert np.all(lines_of(plus[f"ff_{name}"].to_numpy()) % 2 == 1)
            assert np.all(lines_of(plus[f"v_{name}"].to_numpy()) % 2 == 1)
            # position and velocity belong together
            spectrum = np.fft.rfft(plus[name] - plus[name].mean())
            slope = np.fft.irfft(2j * np.pi * np.fft.rfftfreq(len(plus), 1.0 / RATE) * spectrum, len(plus))
            np.testing.assert_allclose(slope, plus[f"v_{name}"], atol=1e-6)
        joint_2 = [np.sign(tables[f"{pose}/run_001_{k}_plus"]["ff_joint_2"] @ plus["ff_joint_1"]) for k in (1, 2, 3)]
        assert joint_2 == [1.0, -1.0, 1.0]  # (6.50)


def test_a_reference_file_is_a_trajectory_that_can_be_simulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    assert run(monkeypatch, "excite", "rx90b_3dof", "--out", str(out), "--realisations", "1", "--periods", "2") == 0
    (plan,) = excitation_plans(ExciteRequest("rx90b_3dof", realisations=1, periods=1))
    read = read_trajectory(out / "references" / "runs" / "run_000_3_minus.csv", plan.robot, RATE)
    meant = plan.trajectory(plan.runs[5])
    for field in ("position", "velocity", "torque"):
        np.testing.assert_allclose(getattr(read, field), getattr(meant, field), atol=1e-8)


def test_logs_put_where_the_campaign_file_names_them_are_all_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(monkeypatch, "excite", "rx90b_3dof", "--out", str(out), "--realisations", "1", "--periods", "2") == 0
    with pytest.raises(ValueError, match="run_000_1_plus"):
        load_campaign(out / "campaign.toml")
    entries = tomllib.loads((out / "campaign.toml").read_text())["recording"]
    joints = load_robot("rx90b_3dof").joints
    for entry in entries:
        reference = pd.read_csv(out / entry["file"].replace("logs/", "references/"))
        fed = np.tile(reference[[f"ff_{j}" for j in joints]].to_numpy(), (2, 1))
        log = Recording(
            "log", "identification", np.arange(len(fed)) / RATE, RATE, joints, fed, fed, feedforward_torque=fed
        )
        (out / entry["file"]).parent.mkdir(exist_ok=True)
        save_recording(log, out / entry["file"])
    campaign = load_campaign(out / "campaign.toml")
    assert [r.name for r in campaign.identification][:2] == ["run_000_1_plus", "run_000_1_minus"]
    assert all(r.period_s == 4.096 and r.duration_s == pytest.approx(4.096) for r in campaign.identification)
    capsys.readouterr()
    assert run(monkeypatch, "excite", "rx90b_3dof", "--out", str(out)) == 2
    assert "has references already" in capsys.readouterr().err


def test_torques_follow_each_joints_limit_unless_a_peak_is_given() -> None:
    (plan,) = excitation_plans(ExciteRequest("rx90b_3dof", realisations=1))
    peaks = np.abs(plan.trajectory(plan.runs[0]).torque).max(axis=0)
    np.testing.assert_allclose(peaks, 0.1 * load_robot("rx90b_3dof").tree.effortLimit)
    (plan,) = excitation_plans(ExciteRequest("rx90b_3dof", realisations=1, peak=(30.0,), joints=("joint_1", "joint_3")))
    np.testing.assert_allclose(np.abs(plan.trajectory(plan.runs[0]).torque).max(axis=0), [30.0, 0.0, 30.0])


@pytest.mark.parametrize("matrix", ["ones", "hadamard", "identity"])
def test_experiments_are_independent_for_each_input_matrix(matrix: str) -> None:
    (plan,) = excitation_plans(ExciteRequest("rx90b_3dof", realisations=1, matrix=matrix))  # type: ignore[arg-type]
    waves = np.stack([plan.trajectory(k).torque[:1024] for k in plan.runs if k.sign > 0], axis=-1)
    spectra = np.fft.rfft(waves, axis=0)[list(plan.lines)]
    spectra /= np.linalg.norm(spectra, axis=-1, keepdims=True)
    condition = np.linalg.cond(spectra)
    # orthogonal rows have condition 1, (6.50) of three joints 2
    np.testing.assert_allclose(condition, 2.0 if matrix == "ones" else 1.0, rtol=1e-6)


def test_white_torques_reach_the_drives_through_the_loop() -> None:
    (plan,) = excitation_plans(ExciteRequest("rx90b_3dof", realisations=1, white=True))
    robot, lines = plan.robot, np.array(plan.lines)
    speed = np.abs(plan.reference.velocity).max(axis=0)
    at = robot.linearize(robot.input_matrix @ [0.0, 0.5 * np.pi, 0.0], v=robot.input_matrix @ speed)
    sensitivity = load_cs8().for_joints(robot.joints).sensitivity(at, lines / 4.096)
    fed = np.abs(np.fft.rfft(plan.trajectory(plan.runs[0]).torque[:1024], axis=0))[lines]
    for j in range(3):
        drive = fed[:, j] * np.abs(sensitivity[:, j, j])
        assert np.ptp(drive) < 1e-6 * drive.mean() < np.ptp(fed[:, j])
    assert len(white_amplitudes(plan)) == 3


def test_a_long_period_has_finer_lines_and_more_swings_keep_the_joints_near() -> None:
    coarse, fine = (
        excitation_plans(ExciteRequest("rx90b_3dof", realisations=1, period_s=4.096 * k, swings=k))[0] for k in (1, 3)
    )
    assert np.diff(fine.lines).min() / (3 * 4.096) == pytest.approx(np.diff(coarse.lines).min() / 4.096 / 3)
    assert np.ptp(fine.reference.position, axis=0).max() == pytest.approx(
        np.ptp(coarse.reference.position, axis=0).max(), rel=1e-3
    )
    assert np.all(lines_of(fine.reference.velocity[:, 0]) % 2 == 1)
    with pytest.raises(ValueError, match="swings is 2; expected an odd number"):
        square_wave(load_robot("rx90b_3dof"), np.zeros(3), swings=2)


CASCADE = """
reference_rate_hz = 500.0
controller_rate_hz = 2000.0
log_rate_hz = 500.0
log_cutoff_hz = 180.0
"""


def cascades(folder: Path) -> Path:
    """A controller file of somebody's own."""
    loops = "position_loop = 20.0\nvelocity_loop = 400.0\nintegral_time_s = 0.05\ntorque_limit = 500.0\n"
    file = folder / "own.toml"
    file.write_text(CASCADE + "".join(f'[[cascade]]\nname = "joint_{k}"\n{loops}' for k in (1, 2, 3)))
    return file


@pytest.mark.parametrize(("by", "share"), [("reference", 1.0), ("both", 0.5)])
def test_references_vibrate_so_that_the_controller_orders_the_torques(by: str, share: float, tmp_path: Path) -> None:
    own = cascades(tmp_path)
    plans = {
        kind: excitation_plans(ExciteRequest("rx90b_3dof", realisations=1, periods=1, controller=own, by=kind))[0]  # type: ignore[arg-type]
        for kind in ("torque", by)
    }
    for key in plans[by].runs:
        meant, sent = (plans[kind].trajectory(key) for kind in ("torque", by))
        np.testing.assert_allclose(sent.torque, (1.0 - share) * meant.torque, atol=1e-9)
        vibration, speed = sent.position - meant.position, sent.velocity - meant.velocity
        # Kv (Kp (1 + 1/(Ti s)) r) with no speed fed forward: its integral by sums over the period, which has no mean
        asked = 20.0 * vibration
        integral = np.cumsum(asked, axis=0) / 500.0
        integral -= integral.mean(axis=0) + 0.5 * asked / 500.0  # trapezoids
        ordered = 400.0 * (asked + integral / 0.05)
        missing = np.linalg.norm(ordered - share * meant.torque) / np.linalg.norm(share * meant.torque)
        assert missing < 0.01  # trapezoids of 80 Hz at 500 Hz
        assert np.abs(np.gradient(vibration, 1.0 / 500.0, axis=0) - speed).max() < 0.2 * np.abs(speed).max()


def test_without_a_controller_file_references_have_a_speed_and_a_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    more = ("--by", "reference", "--rate-hz", "500", "--speed-peak", "0.05,0.06,0.07", "--realisations", "1")
    assert (
        run(monkeypatch, "excite", "example-robot-data:ur5", "--out", str(out), *more, "--pose", "0,-90,60,0,0,0") == 0
    )
    assert (
        "Its speed at most: shoulder_pan_joint 0.05 rad/s, shoulder_lift_joint 0.06 rad/s, elbow_joint 0.07 rad/s"
        in " ".join(capsys.readouterr().out.split())
    )
    plus, minus = (pd.read_csv(out / "references" / "runs" / f"run_000_1_{sign}.csv") for sign in ("plus", "minus"))
    assert plus["time"][1] == pytest.approx(1.0 / 500.0)
    assert np.abs(plus["v_elbow_joint"] - minus["v_elbow_joint"]).max() == pytest.approx(0.14, abs=1e-6)
    assert not plus["ff_elbow_joint"].any()
    assert not (out / "controller.toml").exists()  # nobody knows it: a replay goes by the logged torques
    listed = tomllib.loads((out / "campaign.toml").read_text())
    assert listed["sample_rate_hz"] == 500.0
    assert list(listed["signals"]) == ["motor_position", "torque", "reference_position"]
    head = (out / "campaign.toml").read_text()
    assert "Between rows references go along the cubic" in head and "early or late is identified" in head


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--by", "force"], "--by is 'force'; expected torque, reference, both"),
        (
            ["--by", "both", "--one-sign"],
            "--by is 'both' with one sign alone: only both signs tell the excitation from the motion",
        ),
        (["--by", "reference", "--speed-peak", "0.1,0.2"], "2 peak speeds for 3 joints; expected one, or one a joint"),
        (["--by", "reference", "--speed-peak", "-1"], "--speed-peak is -1; expected more than 0"),
        (["--by", "reference", "--speed-peak", "9"], "joint_1 moves at 9"),
        (["--rate-hz", "0"], "--rate-hz is 0; expected 1 to 100000"),
        (["--pose", "0,90"], "pose 1: found 0,90; expected 3"),
        (["--pose", "0,ninety,0"], "pose is '0,ninety,0'; expected numbers"),
        (["--pose", "0,136,0"], "pose 1: joint_2 moves from 129.9° to 142.1°; its limits are -137.5° and 137.5°"),
        (["--peak", "45,45,500"], "peak torque of joint_3 is 500 N m"),
        (["--peak", "45,45"], "2 peak torques for 3 joints"),
        (["--high-hz", "130"], "the band is 2.5 to 130 Hz"),
        (["--period-s", "4.0011"], "--period-s is 4.0011: expected a whole number of samples at 250 Hz"),
        (["--speed", "9"], "pose 1: joint_1 moves from"),
        (["--matrix", "unit"], "matrix is 'unit'; expected ones, hadamard, identity"),
        (["--joints", "joint_9"], "joint_9"),
    ],
)
def test_what_cannot_be_is_one_line_and_nothing_is_written(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert run(monkeypatch, "excite", "rx90b_3dof", "--out", str(out), "--realisations", "1", *arguments) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not out.exists()


def test_a_campaign_is_replaced_if_told_so_and_never_measured_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    few = ["excite", "rx90b_3dof", "--out", str(out), "--realisations", "1", "--periods", "2", "--joints", "joint_1"]
    short = [*few, "--period-s", "0.512", "--low-hz", "3", "--high-hz", "30", "--simulate", "--one-sign"]
    assert run(monkeypatch, *short) == 0
    campaign = load_campaign(out / "campaign.toml")
    assert [r.name for r in campaign.identification] == ["run_000_1_plus"]
    assert sorted(p.name for p in (out / "logs" / "runs").iterdir()) == ["plan.json", "run_000_1_plus.parquet"]
    capsys.readouterr()
    assert run(monkeypatch, *few) == 2
    said = capsys.readouterr().err
    assert "has references already, and a campaign is replaced only if told so; give another folder, or --over" in said
    assert run(monkeypatch, *few, "--overwrite") == 0 and list((out / "logs").iterdir()) == []
    for log in ("runs/run_000_1_plus.csv", "other/mine.csv"):
        assert run(monkeypatch, *short, "--overwrite") == 0
        (out / "logs" / log).parent.mkdir(exist_ok=True)
        (out / "logs" / log).write_text("measured")
        assert run(monkeypatch, *few, "--overwrite") == 2
        assert f"has logs/{log}; give another folder, so that no logs are lost" in capsys.readouterr().err
        (out / "logs" / log).unlink()


@pytest.mark.slow
@pytest.mark.long  # of one pose the table of the README does it
def test_simulated_logs_of_two_poses_go_the_whole_road(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    poses = ["--pose", "0,90,0", "--pose", "0,60,60", "--realisations", "2", "--periods", "3", "--simulate"]
    assert run(monkeypatch, "excite", "rx90b_3dof", "--out", str(out), *poses) == 0
    campaign = load_campaign(out / "campaign.toml")
    assert len(campaign.identification) == 24
    results = tmp_path / "results"
    assert run(monkeypatch, "frf", str(out / "campaign.toml"), "--out", str(results), "--high-hz", "50") == 0
    replay = json.loads((results / "frf.json").read_text())["replay"]
    assert replay["poses"] == ["pose 1", "pose 2"]
    for before, after in zip(*replay["realisations_deviate"].values(), strict=True):
        # the robot is declared as it was simulated: what is left at the drive points is noise
        assert (np.diagonal(after) < 0.1 * np.diagonal(before)).all()
    page = (results / "report.html").read_text()
    assert "Pose 1: Frequency response" in page and "Pose 2: Frequency response" in page


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"by": "x"}, "by is 'x'; expected torque, reference, both"),
        ({"periods": 0}, "periods is 0; expected 1 or more"),
        ({"period_s": 0.0}, "period_s is 0; expected more than 0"),
        ({"rate_hz": 0.0}, "rate_hz is 0; expected 1 to"),
        ({"by": "both", "both_signs": False}, "by is 'both' with one sign alone"),
        ({"joints": ["joint_1", "joint_1"]}, "joints: 'joint_1' is listed 2 times"),
    ],
)
def test_arguments_in_python_are_named_as_they_are_there(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        rf.excite("rx90b_3dof", **options)  # type: ignore[arg-type]
