"""`rx90b-flex simulate`: its files, its summary, and one line for bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.signals import load_campaign


def run(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "simulate", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0)  # type: ignore[arg-type]


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    """A trajectory file of joint 1, at another rate than the controller's."""
    time = np.arange(51) / 100.0
    table = pd.DataFrame({"time": time, "joint_1": 0.1 * (1 - np.cos(2 * np.pi * time)), "ff_joint_2": 5.0 * time})
    table.to_csv(tmp_path / "swing.csv", index=False)
    return tmp_path / "swing.csv"


def test_a_trajectory_file_becomes_recording_campaign_tip_and_figure(
    tmp_path: Path, swing: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run("rx90b_3dof", "--out", out, "--trajectory", swing, monkeypatch=monkeypatch) == 0
    recording = load_campaign(out / "campaign.toml").recordings[0]
    assert recording.samples == 126 and recording.sample_rate_hz == 250.0
    assert recording.reference_position is not None and recording.feedforward_torque is not None
    np.testing.assert_allclose(recording.reference_position[::5][:, 0], pd.read_csv(swing).joint_1[::2], atol=1e-5)
    assert recording.feedforward_torque[-1, 1] == pytest.approx(2.5)
    tip = pd.read_csv(out / "tip.csv")
    assert list(tip)[:4] == ["time", "x", "y", "z"] and len(tip) == 126
    assert {p.name for p in out.iterdir()} == {
        "campaign.toml", "robot.toml", "robot.urdf", "state.parquet", "swing.parquet", "tip.csv", "tip.png", "tip.svg",
    }  # fmt: skip
    text = capsys.readouterr().out
    for part in ("Tip deviation:", "Power above 125 Hz", "went to its end"):
        assert part in text


def test_a_run_that_ends_early_says_why_and_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "far.csv"
    time = np.arange(101) / 100.0
    pd.DataFrame({"time": time, "joint_1": np.where(time < 0.2, 0.0, 1.0)}).to_csv(file, index=False)
    assert run("rx90b_3dof", "--out", tmp_path / "o", "--trajectory", file, monkeypatch=monkeypatch) == 0
    assert "The run ended early: at t = 0.1" in capsys.readouterr().out
    assert (tmp_path / "o" / "far.parquet").exists()


def test_the_same_seed_gives_the_same_noise(tmp_path: Path, swing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        given = ("--trajectory", swing, "--torque-noise", 0.2, "--seed", seed)
        assert run("rx90b_3dof", "--out", tmp_path / name, *given, monkeypatch=monkeypatch) == 0
    a, b, c = (load_campaign(tmp_path / name / "campaign.toml").recordings[0].torque for name in "abc")
    assert np.array_equal(a, b) and not np.array_equal(a, c)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("time,joint_9\n0,1\n", (), "column 'joint_9'"),
        ("time\n0\n", (), "no column of a joint"),
        ("time,joint_1\n0,0\n", (), "column 'time'"),
        (None, (), "no such trajectory file"),
        ("time,joint_1\n" + "".join(f"{k / 100},0\n" for k in range(20)), ("--line",), "choose one"),
        ("time,joint_1\n" + "".join(f"{k / 100},0\n" for k in range(20)), ("--periods", 2), "does not repeat"),
        ("time,joint_1\n" + "".join(f"{k / 100},0\n" for k in range(20)), ("--torque-noise", -1), "torque noise"),
        ("time,joint_1\n" + "".join(f"{k / 100},0\n" for k in range(20)), ("--controller", "no.toml"), "no.toml"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    text: str | None,
    options: tuple[object, ...],
    message: str,
) -> None:
    file = tmp_path / "t.csv"
    if text is not None:
        file.write_text(text)
    out = tmp_path / "out"
    assert run("rx90b_3dof", "--out", out, "--trajectory", file, *options, monkeypatch=monkeypatch) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and message in lines[0]
    assert not out.exists()


def test_another_robot_follows_harmonics_under_a_controller_designed_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # at zero this arm points up, and its first joint turns a hundredth of what it turns stretched out
    assert run("example-robot-data:kinova", "--out", tmp_path / "o", "--harmonics", monkeypatch=monkeypatch) == 0
    assert "went to its end" in capsys.readouterr().out
    (recording,) = load_campaign(tmp_path / "o" / "campaign.toml").recordings
    assert recording.reference_position is not None
    assert np.abs(recording.position - recording.reference_position).max() < 0.02  # rad; 0.3 with that pose's inertia


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["--line", "--excitation", "--square-wave", "--harmonics"])
def test_the_built_in_motions_run_to_their_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], motion: str
) -> None:
    assert run("rx90b_4dof", "--out", tmp_path / "o", motion, monkeypatch=monkeypatch) == 0
    assert "went to its end" in capsys.readouterr().out


def test_arguments_in_python_that_cannot_be_are_named() -> None:
    with pytest.raises(
        ValueError, match=r"^motion is 'lines'; expected line, excitation, square-wave, harmonics or a table"
    ):
        rf.simulate("rx90b_3dof", "lines")
    with pytest.raises(ValueError, match=r"^seed is -1; expected 0 or more$"):
        rf.simulate("rx90b_3dof", seed=-1)
    with pytest.raises(
        TypeError, match=r"^noise is 0.1; expected a rx90b_flex.simulate.Noise, as Noise\(torque=0.1\)$"
    ):
        rf.simulate("rx90b_3dof", noise=0.1)  # type: ignore[arg-type]


def test_a_folder_in_the_place_of_the_campaign_is_named(tmp_path: Path) -> None:
    (tmp_path / "out" / "campaign.toml").mkdir(parents=True)
    with pytest.raises(ValueError, match=r"out: has campaign.toml, a folder, already"):
        rf.excite("rx90b_3dof", tmp_path / "out", realisations=1)
