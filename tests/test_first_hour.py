"""A first campaign as a new user has it: a bare URDF, three CSV files in degrees with odd headers, the commands of the README."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import independent as ind
import mujoco
import numpy as np
import pytest
from test_cli import Command, Outcome

Run = Callable[[Sequence[str]], Outcome]
README = Path(__file__).parents[1] / "README.md"
RATE_HZ = 100.0
COULOMB, VISCOUS, INERTIA, NOISE = (2.0, 1.0), (3.0, 1.5), (0.4, 0.2), (0.05, 0.02)


def drives(m: ind.Motion, load: np.ndarray) -> np.ndarray:
    return np.sign(m.v) * COULOMB + m.v * VISCOUS + m.a * INERTIA


def write_logs(folder: Path, change: Callable[[np.ndarray], np.ndarray] = lambda x: x) -> list[Path]:
    """Three logs of an arm of two joints, `robot.urdf` beside them; `change` is made to the torques."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(4)
    (folder / "two_joints.urdf").rename(folder / "robot.urdf")
    files = []
    for number in (1, 2, 3):
        m = ind.harmonics(rng, 2, period_s=12.0, rate_hz=RATE_HZ)
        torque = change(arm.torque(m) + drives(m, m.q) + ind.white(rng, len(m.time), NOISE))
        rows = ["time [ms];Axis 1 act pos;Axis 2 act pos;Axis 1 act trq;Axis 2 act trq;Mode"]
        for t, q, tau in zip(1e3 * m.time, np.degrees(m.q), torque, strict=True):
            cells = [f"{t:.1f}", *(f"{x:.6f}" for x in q), *(f"{x:.5f}" for x in tau)]
            rows.append(";".join([*(c.replace(".", ",") for c in cells), "AUTO"]))
        path = folder / f"run_{number}.csv"
        path.write_text("\n".join(rows) + "\n", encoding="latin-1")
        files.append(path)
    return files


def commands() -> list[list[str]]:
    """The commands of the README's section on a first campaign."""
    section = README.read_text(encoding="utf-8").split("## A first campaign", 1)[1].split("\n## ", 1)[0]
    block = re.search(r"```sh\n(.*?)```", section, re.S)
    assert block is not None
    return [shlex.split(line, comments=True) for line in block[1].splitlines() if line.strip()]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """A line of the shell in the test's folder."""
    monkeypatch.chdir(tmp_path)
    command = Command(monkeypatch, capfd)

    def line(words: Sequence[str]) -> Outcome:
        assert words[0] == "rx90b-flex"
        return command(*words[1:])

    return line


def test_the_commands_of_the_readme_take_a_bare_urdf_and_logs_in_degrees_to_a_result_and_to_mujoco(
    tmp_path: Path, run: Run
) -> None:
    write_logs(tmp_path)
    printed = commands()
    assert [words[1] for words in printed] == ["import", "check", "identify", "close-loop", "export"]
    for words in printed:
        done = run(words)
        assert done.status == 0, f"{words}: {done.out}{done.err}"
    campaign = tomllib.loads((tmp_path / "data" / "campaign.toml").read_text())
    assert 2.0 < campaign["preprocessing"]["cutoff_hz"] < 40.0
    assert json.loads((tmp_path / "look" / "check.json").read_text())["usable"] is True
    found = json.loads((tmp_path / "fitted" / "identification.json").read_text())
    values = {p["name"]: p["value"] for p in found["parameters"]}
    for joint, dry, viscous in zip(("shoulder", "elbow"), COULOMB, VISCOUS, strict=True):
        assert values[f"{joint}.coulomb_friction.torque"] == pytest.approx(dry, rel=0.1)
        assert values[f"{joint}.viscous_friction.coefficient"] == pytest.approx(viscous, rel=0.1)
    closed = json.loads((tmp_path / "results" / "closed_loop.json").read_text())
    # what every drive has is declared, and there is nothing else in these logs
    assert closed["effects"] == [] and closed["data_faults"] == []
    assert closed["before"]["validation"]["relative_error"] < 0.05
    simulated = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert [simulated.joint(i).name for i in range(simulated.njnt)] == ["shoulder", "elbow"]
    np.testing.assert_allclose(simulated.dof_frictionloss, COULOMB, rtol=0.1)
    np.testing.assert_allclose(simulated.dof_damping.ravel(), VISCOUS, rtol=0.1)


def test_import_offers_what_every_drive_has_where_the_robot_declares_none_of_it(tmp_path: Path, run: Run) -> None:
    write_logs(tmp_path)
    (imported, *_) = commands()
    bare = run([word for word in imported if word != "--basics"])
    assert bare.status == 0 and "--basics" in bare.out
    declared = run([*(word for word in imported if word not in ("data", "--out")), "--out", "with"])
    assert declared.status == 0 and "--basics" not in declared.out
    again = ["rx90b-flex", "import", "run_1.csv", "run_2.csv", "--robot", "with/robot.toml", "--out", "third"]
    named = run(again)
    assert named.status == 0 and "--basics" not in named.out


def test_a_wrong_sign_in_the_first_campaign_is_named_before_anything_is_fitted(tmp_path: Path, run: Run) -> None:
    write_logs(tmp_path, lambda torque: -torque)
    (imported, checked, *_) = commands()
    assert run(imported).status == 0
    done = run(checked)
    assert done.status == 1
    (fault,) = json.loads((tmp_path / "look" / "check.json").read_text())["data_faults"]
    assert (fault["kind"], fault["signal"]) == ("reversed_sign", "torque")
    assert set(fault["joints"]) == {"shoulder", "elbow"}
