"""Claims about ``rx90b-flex close-loop`` on modal tables and frequency responses."""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pytest
from modal_generator import MEASURED, PLAIN, STRETCHED, measured, measured_response, truth_of

from rx90b_flex import cli
from rx90b_flex.diagnose.modal import close_modal
from rx90b_flex.export import save_robot
from rx90b_flex.robot import load_robot
from rx90b_flex.view import modal_plots


def table_text(table, robot):
    """A modal table's file."""
    (pose,) = table.poses
    angles = ", ".join(f"{j} = {np.rad2deg(a)}" for j, a in pose.angles.items())
    lines = [
        f'robot = "{robot}"',
        f"joints = {json.dumps(table.joints)}",
        f"band_hz = {list(table.band_hz)}",
        "[[pose]]",
    ]
    lines.append(f"angles_deg = {{ {angles} }}")
    for m in pose.lists:
        key = "resonance" if m.locked is None else f"antiresonance.{m.locked}"
        lines.append(f"{key} = {{ hz = {m.hz.tolist()}, std_hz = {m.std_hz.tolist()} }}")
    return "\n".join(lines) + "\n"


@pytest.fixture
def folder(tmp_path):
    """A robot's file with a table and a response of its own beside it."""
    save_robot(PLAIN, tmp_path, "plain.toml", allow_inconsistent=True)
    rng = np.random.default_rng(7)
    (tmp_path / "modes.toml").write_text(table_text(measured(truth_of(PLAIN), rng, 0.003), "plain.toml"))
    response = measured_response(truth_of(PLAIN), rng, 0.03, STRETCHED, PLAIN.joints)
    (tmp_path / "frf").mkdir()
    content = {
        "robot": "rx90b", "joints": list(MEASURED), "pose_rad": response.pose.tolist(),
        "frequency_response": {
            "hz": response.hz.tolist(), "real": response.value.real.tolist(), "imag": response.value.imag.tolist(),
            "std": response.std().tolist(), "degrees_of_freedom": None,
        },
    }  # fmt: skip
    (tmp_path / "frf" / "frf.json").write_text(json.dumps(content))
    return tmp_path


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["rx90b-flex", "close-loop", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code


def test_a_modal_table_is_closed(folder, monkeypatch, capsys):
    assert not run(monkeypatch, folder / "modes.toml", "--out", folder / "out")
    out = folder / "out"
    assert sorted(p.name for p in out.iterdir()) == ["closed_loop.json", "report.html", "robot.toml", "robot.urdf"]
    found = json.loads((out / "closed_loop.json").read_text())
    assert found["verdict"] == "nothing_missing" and found["effects"] == []
    assert [m["list"] for m in found["modes"]] == ["resonances", *(f"antiresonances of {j}" for j in MEASURED)]
    assert load_robot(out / "robot.toml").effects == PLAIN.effects
    page = (out / "report.html").read_text()
    assert "How sure" in page and page.count("data:image/svg") == 2
    assert not any(f'{key}="http' in page for key in ("src", "href"))
    assert "nothing missing" in capsys.readouterr().out


def test_a_folder_of_frequency_responses_is_closed(folder, monkeypatch, capsys):
    arguments = (folder / "frf", "--robot", folder / "plain.toml", "--out", folder / "out")
    assert not run(monkeypatch, *arguments)
    found = json.loads((folder / "out" / "closed_loop.json").read_text())
    assert found["verdict"] == "nothing_missing" and found["residual"] == "frequency_response"
    assert (folder / "out" / "report.html").read_text().count("data:image/svg") == 1


def test_a_folder_of_which_not_all_joints_were_excited_is_closed(folder, monkeypatch):
    """Drives that were not excited are held, in the data (by MuJoCo) and in the model."""
    excited, rng = MEASURED[:2], np.random.default_rng(8)
    response = measured_response(truth_of(PLAIN), rng, 0.03, STRETCHED, PLAIN.joints, measured=excited)
    content = json.loads((folder / "frf" / "frf.json").read_text())
    content["frequency_response"] |= {
        "joints": excited, "hz": response.hz.tolist(), "std": response.std().tolist(),
        "real": response.value.real.tolist(), "imag": response.value.imag.tolist(),
    }  # fmt: skip
    (folder / "frf" / "frf.json").write_text(json.dumps(content))
    assert not run(monkeypatch, folder / "frf", "--robot", folder / "plain.toml", "--out", folder / "out")
    found = json.loads((folder / "out" / "closed_loop.json").read_text())
    assert found["joints"] == list(excited) and found["verdict"] == "nothing_missing"
    assert found["after"]["identification"][0]["weighted_error"] < 1.2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("list", "frf.json: not a result of `rx90b-flex frf`: holds a list; expected a JSON object"),
        ("other joints", "poses: joint_1, joint_2, joint_3 at one pose and joint_1, joint_2 at another were excited"),
    ],
)
def test_a_folder_that_cannot_be_closed_is_refused_in_a_line(folder, monkeypatch, capsys, content, message):
    table = json.loads((folder / "frf" / "frf.json").read_text())
    pose = {"pose_rad": table["pose_rad"], "frequency_response": table["frequency_response"]}
    fewer = {key: np.array(pose["frequency_response"][key])[:, :2, :2].tolist() for key in ("real", "imag", "std")}
    other = {**pose["frequency_response"], **fewer, "joints": MEASURED[:2]}
    poses = [pose, {**pose, "frequency_response": other}]
    (folder / "frf" / "frf.json").write_text(json.dumps([] if content == "list" else {**table, "poses": poses}))
    assert run(monkeypatch, folder / "frf", "--robot", folder / "plain.toml", "--out", folder / "out") == 2
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error and not (folder / "out").exists()


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        ("modes.toml", ["--robot", "nobody"], "unknown robot 'nobody'"),
        ("modes.toml", ["--model-error", "-1"], "--model-error is -1"),
        ("broken.toml", [], "broken.toml: [[pose]] 1 'resonances': unknown key (did you mean 'resonance'"),
        ("frf", ["--robot", "rx90b_3dof"], "a pose of the data has 6 angles, rx90b_3dof has 3 joints"),
        ("campaign.toml", ["--robot", "rx90b"], "--robot goes with a modal table"),
        ("missing.toml", ["--robot", "rx90b"], "missing.toml: no such file"),
        ("no_pose.toml", [], "no_pose.toml: [[pose]]: missing; one or more are expected"),
        ("rad.toml", [], "outside band_hz, 8 to 75 Hz; are they in rad/s? else widen band_hz"),
        ("narrow.toml", [], "outside band_hz, 74 to 75 Hz; widen band_hz"),
        ("exact.toml", [], "exact.toml: [[pose]] 1 resonance std_hz: found 0, expected standard deviations above 0 Hz"),
    ],
)
def test_bad_input_is_one_line_status_2_and_nothing_written(folder, monkeypatch, capsys, source, options, message):
    (folder / "campaign.toml").write_text('robot = "rx90b"\nsample_rate_hz = 500.0\n')
    (folder / "broken.toml").write_text((folder / "modes.toml").read_text().replace("resonance =", "resonances =", 1))
    modes = (folder / "modes.toml").read_text()
    (folder / "no_pose.toml").write_text(modes.partition("[[pose]]")[0])
    in_rad = re.sub(r"\bhz = \[([^\]]*)\]", lambda m: f"hz = {[6.2832 * float(x) for x in m[1].split(',')]}", modes)
    (folder / "rad.toml").write_text(in_rad)
    (folder / "narrow.toml").write_text(modes.replace("band_hz = [8.0", "band_hz = [74.0"))
    (folder / "exact.toml").write_text(re.sub(r"std_hz = \[[^,\]]*", "std_hz = [0.0", modes, count=1))
    assert run(monkeypatch, folder / source, "--out", folder / "out", *options) == 2
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error
    assert not (folder / "out").exists()


def test_the_ladder_shows_every_measured_mode_and_joins_partners():
    loop = close_modal(measured(truth_of(PLAIN), np.random.default_rng(7), 0.003), PLAIN)
    figure = modal_plots.ladder(loop.before, loop.after)
    assert len(figure.axes) == 4
    for ax, b, a in zip(figure.axes, loop.before, loop.after, strict=True):
        shown = [line for line in ax.lines if line.get_marker() == "o" and line.get_markersize() == 4]
        np.testing.assert_array_equal(shown[0].get_xdata(), b.measured.hz)
        joins = [
            line
            for line in ax.lines
            if len(line.get_xdata()) == 2 and set(line.get_ydata()) in ({0.0, 1.0}, {1.0, 2.0})
        ]
        assert len(joins) >= len(b.errors) + len(a.errors)
    assert figure.axes[-1].get_xlabel() == "undamped frequency, Hz"
