"""Claims about commands on URDFs of other robots: joints that slide, limits and masses that nobody meant, odd names."""

from __future__ import annotations

import re
from pathlib import Path

import independent as ind
import numpy as np
import pytest

from rx90b_flex import cli
from rx90b_flex.commands.shared import show_table
from rx90b_flex.diagnose.kinds import sites_of
from rx90b_flex.effects import effect_from_table
from rx90b_flex.effects.gravity_spring import GravitySpring
from rx90b_flex.files.keys import whole_names
from rx90b_flex.files.warned import InputWarning
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign

RAIL = ind.TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="prismatic"')


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


def urdf(folder: Path, text: str, name: str = "foreign.urdf") -> Path:
    (folder / name).write_text(text)
    return folder / name


# ---- joints that slide ------------------------------------------------------------------------------------------


def test_what_slides_has_kilograms_newtons_and_metres(tmp_path: Path) -> None:
    robot = load_robot(urdf(tmp_path, RAIL))
    assert [(u.position, u.force) for u in robot.units] == [("rad", "N m"), ("m", "N")]
    np.testing.assert_allclose(robot.pose_of([90.0, 0.25]), [0.5 * np.pi, 0.25])
    _, sliding = robot.units
    ripple = effect_from_table(
        {"type": "gear_ripple", "joint": "elbow", "order": 1.0, "amplitude": 2.0}, "", robot.joints
    )
    assert [(name, unit) for name, unit, _ in robot.values_of(ripple)][1:] == [("amplitude", "N"), ("phase", "rad")]
    per_turning = ("kg m^2", "N m/rad", "N m s/rad", "1/(N m)^2", "rad/s", "Hz")
    assert [unit for name, unit, _ in robot.values_of(ripple) if name == "order"] == ["rad/m"]  # no turns along a slide
    assert [sliding.of(unit) for unit in per_turning] == ["kg", "N/m", "N s/m", "1/N^2", "m/s", "Hz"]


def test_a_spring_between_two_levers_is_looked_for_where_joints_turn(tmp_path: Path) -> None:
    robot = load_robot(urdf(tmp_path, RAIL))
    tried = GravitySpring.everywhere(sites_of(robot, robot.joints))
    assert {e.joints for e in tried} == {("shoulder",)}


def test_a_view_of_what_slides_is_given_and_says_metres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, out = urdf(tmp_path, RAIL), tmp_path / "view.html"
    assert run(monkeypatch, "view", robot, "--flexible", "--pose", "90,0.25", "--out", out) == 0
    said = capsys.readouterr().out
    (line,) = (line for line in said.splitlines() if line.startswith("elbow: "))
    inertia, drive, hinge = line.split("; ")
    assert inertia.endswith(" kg") and drive.endswith(" N/m") and hinge.endswith(" N m/rad")  # its bearings bend
    assert "Drives at 90°, 0.25 m, without friction" in said
    assert run(monkeypatch, "view", robot, "--flexible", "--pose", "90", "--out", out) == 2
    assert (
        "--pose: found 90; expected 2 finite numbers, one a joint: shoulder (degrees), elbow (m)"
        in capsys.readouterr().err
    )


def test_an_excitation_of_what_slides_is_told_in_newtons_and_metres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = urdf(tmp_path, RAIL)
    options = ["--realisations", "1", "--pose", "0,0.25"]
    assert run(monkeypatch, "excite", robot, "--out", tmp_path / "out", *options) == 0
    said = capsys.readouterr().out
    assert "Feed-forward torque at most: shoulder 10 N m, elbow 5 N" in said
    assert "Joints swing by 12.21° or 0.213 m" in said  # speed 0.11 rad/s or m/s, a period of 4.096 s
    assert "(rad or m), v_shoulder" in (tmp_path / "out" / "campaign.toml").read_text()
    assert run(monkeypatch, "excite", robot, "--out", tmp_path / "other", *options[:3], "0,3.1") == 2
    assert "elbow moves from 2.993 m to 3.207 m; its limits are -3 m and 3 m" in capsys.readouterr().err


def test_a_run_that_ends_early_says_how_fast_a_joint_slides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = urdf(tmp_path, RAIL)
    place = np.where(np.arange(100) < 50, 0.0, 1.0)  # a metre in 4 ms
    rows = "".join(f"{k / 250},0,{x}\n" for k, x in enumerate(place))
    (tmp_path / "jump.csv").write_text(f"time,shoulder,elbow\n{rows}")
    assert run(monkeypatch, "simulate", robot, "--trajectory", tmp_path / "jump.csv", "--out", tmp_path / "out") == 0
    assert re.search(r"the reference of elbow jumps: [\d.]+ m/s, over 7.5", capsys.readouterr().out)


# ---- limits and masses ------------------------------------------------------------------------------------------


def test_a_limit_of_zero_is_one_that_nobody_stated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    zeros = ind.TWO_JOINTS.replace('velocity="5"', 'velocity="0"').replace('effort="50"', 'effort="0.0"')
    absent = ind.TWO_JOINTS.replace(' velocity="5"', "").replace(' effort="50"', "")
    one, other = (load_robot(urdf(tmp_path, text)) for text in (zeros, absent))
    assert one.urdf == other.urdf
    robot = urdf(tmp_path, zeros)
    time = np.arange(250) / 250.0
    rows = "".join(f"{t},{0.2 * (1.0 - np.cos(np.pi * t))},0\n" for t in time)
    (tmp_path / "slow.csv").write_text(f"time,shoulder,elbow\n{rows}")
    assert run(monkeypatch, "simulate", robot, "--trajectory", tmp_path / "slow.csv", "--out", tmp_path / "out") == 0
    assert "The run went to its end" in capsys.readouterr().out
    assert run(monkeypatch, "excite", robot, "--out", tmp_path / "runs") == 2
    assert "joint 'elbow' has no torque limit in its URDF; give the peak torque" in capsys.readouterr().err


def test_a_negative_mass_is_told_with_its_link(tmp_path: Path) -> None:
    file = urdf(tmp_path, ind.TWO_JOINTS.replace('<mass value="2"/>', '<mass value="-2"/>'))
    with pytest.raises(
        ValueError, match=r"foreign.urdf: link 'lower': value of <mass> is '-2', expected 0 or more \(kg\)"
    ):
        load_robot(file)


# ---- limits, drives and frictions -------------------------------------------------------------------------------


def test_a_joint_that_rests_at_its_limit_is_simulated_and_one_that_leaves_it_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # the upper link hangs on the lower one's axis: its drive gives way at rest
    robot, out = (
        urdf(
            tmp_path,
            ind.TWO_JOINTS.replace(
                'lower="-3" upper="3" velocity="5" effort="50"', 'lower="0" upper="3" velocity="5" effort="50"'
            ),
        ),
        tmp_path / "out",
    )
    turn = 0.005 * (1.0 - np.cos(2.0 * np.pi * np.arange(250) / 250.0))
    for least, ends in ((0.0, False), (-0.02, True)):
        rows = "".join(f"{k / 250},{x},{least}\n" for k, x in enumerate(turn))
        (tmp_path / "path.csv").write_text(f"time,shoulder,elbow\n{rows}")
        status = run(monkeypatch, "simulate", robot, "--trajectory", tmp_path / "path.csv", "--out", out, "--overwrite")
        said = capsys.readouterr()
        assert ("outside its limits 0 to 3 rad" in said.out + said.err) == ends
        assert status == (2 if ends else 0)


def test_a_drive_that_twists_needs_an_inertia_wherever_it_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf(tmp_path, ind.TWO_JOINTS)
    table = '[[effects]]\ntype = "drive_flexibility"\njoint = "elbow"\nstiffness = 1e4\ndamping = 1.0\n'
    (tmp_path / "robot.toml").write_text(f'urdf = "foreign.urdf"\ntip_frame = "lower"\n{table}')
    assert run(monkeypatch, "simulate", tmp_path / "robot.toml", "--harmonics", "--out", tmp_path / "out") == 2
    assert "a flexible drive needs a drive_inertia to move; none at elbow" in capsys.readouterr().err


def test_friction_that_the_urdf_states_and_the_robot_has_not_is_told_of_on_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    limit = '<limit lower="-3" upper="3" velocity="5" effort="50"/>'
    urdf(tmp_path, ind.TWO_JOINTS.replace(limit, f'{limit}<dynamics damping="12" friction="5"/>'))
    table = '[[effects]]\ntype = "coulomb_friction"\njoint = "elbow"\ntorque = 1.0\n'
    for name, effects, told in (("bare", "", True), ("own", table, False)):
        (tmp_path / f"{name}.toml").write_text(f'urdf = "foreign.urdf"\ntip_frame = "lower"\n{effects}')
        file = tmp_path / f"{name}.urdf"
        assert run(monkeypatch, "export", tmp_path / f"{name}.toml", "--format", "urdf", "--out", file) == 0
        text = "Not held: elbow: its URDF's damping of 12 and friction of 5 are no effects of this robot"
        assert (text in " ".join(capsys.readouterr().out.split())) == told


# ---- motions ----------------------------------------------------------------------------------------------------


def test_a_run_without_a_motion_says_whose_line_it_took_and_what_suits_any_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, out = urdf(tmp_path, ind.TWO_JOINTS), tmp_path / "out"
    assert run(monkeypatch, "simulate", robot, "--out", out) == 2
    line = "--line (taken where no motion is chosen) is made for the RX90B; --harmonics suits any robot"
    assert f"cannot reach the point (0.350, -0.850, 0.350) m with 'lower': {line}" in capsys.readouterr().err
    assert not out.exists()


def test_a_robot_of_one_joint_is_told_so_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = ind.TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="fixed"')
    assert run(monkeypatch, "simulate", urdf(tmp_path, text), "--line", "--out", tmp_path / "out") == 2
    assert "cannot reach the point (0.350, -0.850, 0.350) m" in capsys.readouterr().err


@pytest.mark.parametrize(("jump", "told"), [(0.1, "jumps"), (0.0, "is too fast")])
def test_what_is_too_fast_is_no_jump_and_neither_is_in_degrees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], jump: float, told: str
) -> None:
    robot, time = urdf(tmp_path, ind.TWO_JOINTS), np.arange(500) / 250.0
    turn = np.where(time > 1.0, jump, 0.0) if jump else 1.0 - np.cos(3.0 * np.pi * time)
    rows = "".join(f"{t},0,{x}\n" for t, x in zip(time, turn, strict=True))
    (tmp_path / "path.csv").write_text(f"time,shoulder,elbow\n{rows}")
    assert run(monkeypatch, "simulate", robot, "--trajectory", tmp_path / "path.csv", "--out", tmp_path / "out") == 0
    said = capsys.readouterr().out
    assert f"the reference of elbow {told}: " in said and "degrees" not in said


@pytest.mark.parametrize("amplitude", [30.0, 4.0])  # degrees: beyond its limits of 3 rad; within, and too fast
def test_a_trajectory_in_degrees_is_said_to_look_like_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], amplitude: float
) -> None:
    robot, out = urdf(tmp_path, ind.TWO_JOINTS), tmp_path / "out"
    for name, size in (("degrees", amplitude), ("radians", np.deg2rad(amplitude))):
        place = 0.5 * size * (1.0 - np.cos(2.0 * np.pi * np.arange(250) / 250.0))
        rows = "".join(f"{k / 250},0,{x}\n" for k, x in enumerate(place))
        (tmp_path / f"{name}.csv").write_text(f"time,shoulder,elbow\n{rows}")
        assert run(monkeypatch, "simulate", robot, "--trajectory", tmp_path / f"{name}.csv", "--out", out) == 0
        said = capsys.readouterr().out
        assert (f"; its angles look like degrees (elbow goes to {amplitude:g}); expected rad" in said) == (
            name == "degrees"
        )
    monkeypatch.setenv("COLUMNS", "200")
    assert run(monkeypatch, "simulate", "--help") == 0
    assert "Exit status: 0 the run is written, also one that ended early" in capsys.readouterr().out


def test_a_trajectory_in_milliseconds_is_said_to_have_samples_seconds_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = urdf(tmp_path, ind.TWO_JOINTS)
    for name, unit in (("s", 1.0), ("ms", 1e3)):
        rows = "".join(f"{unit * k / 250},0,{1e-3 * k}\n" for k in range(12))
        (tmp_path / f"{name}.csv").write_text(f"time,shoulder,elbow\n{rows}")
        given = ["--trajectory", tmp_path / f"{name}.csv", "--out", tmp_path / name]
        assert run(monkeypatch, "simulate", robot, *given) == 0
        said = "ms.csv: samples are 4 s apart; expected seconds in column 'time', not ms" in capsys.readouterr().out
        assert said == (name == "ms")


# ---- names ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["joint 1/a:b:", "[red]arm[/red]", "j[1]"])
def test_names_are_printed_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    robot = urdf(tmp_path, ind.TWO_JOINTS.replace("elbow", name))
    assert run(monkeypatch, "view", robot, "--flexible", "--out", tmp_path / "view.html") == 0
    assert f"\n{name}: drive inertia" in capsys.readouterr().out
    show_table(name, [(name, "1")], (name, "value"))
    assert capsys.readouterr().out.count(name) == 3


def test_a_joint_with_a_comma_in_its_name_is_found_among_names_with_commas_between(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = urdf(tmp_path, ind.TWO_JOINTS.replace('name="elbow"', 'name="a,b"'))
    for k, (joints, driven) in enumerate({"a,b": "a,b 5 N m", "a,b,shoulder": "shoulder 10 N m, a,b 5 N m"}.items()):
        options = ["--joints", joints, "--realisations", "1", "--pose", "0,0"]
        assert run(monkeypatch, "excite", robot, "--out", tmp_path / f"out_{k}", *options) == 0
        assert f"Feed-forward torque at most: {driven}\n" in capsys.readouterr().out
    assert whole_names(["a", "b", "c"], ["a", "b", "a,b"]) == ("a,b", "c")  # the longest; what is unknown stays
    time = np.arange(1000) / 100.0
    columns = np.column_stack([time, np.sin(time), np.cos(time), np.sin(time), np.cos(time)])
    rows = "\n".join(",".join(map(repr, row)) for row in columns.tolist())
    (tmp_path / "log.csv").write_text(f"time,q1,q2,tau1,tau2\n{rows}\n")
    options = ["--robot", robot, "--joints", "a,b,shoulder", "--out", tmp_path / "campaign"]
    assert run(monkeypatch, "import", tmp_path / "log.csv", *options) == 0, capsys.readouterr().err
    assert load_campaign(tmp_path / "campaign" / "campaign.toml").joints == ("a,b", "shoulder")


# ---- joints that follow -----------------------------------------------------------------------------------------

FINGER = """<link name="finger"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="second" type="prismatic"><parent link="lower"/><child link="finger"/>
    <limit lower="0" upper="1" velocity="5" effort="50"/><mimic joint="elbow" multiplier="2"/></joint>
</robot>"""


@pytest.mark.parametrize("command", ["flexify", "export --format urdf", "export --format mjcf", "export --format sdf"])
def test_a_joint_that_follows_another_is_said_to_be_fixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    robot = urdf(tmp_path, ind.TWO_JOINTS.replace("</robot>", FINGER))
    (tmp_path / "robot.toml").write_text(f'urdf = "{robot.name}"\n')
    name, *options = command.split()
    for source in (robot, tmp_path / "robot.toml"):
        assert run(monkeypatch, name, source, *options, "--out", tmp_path / "out.xml") == 0
        said = capsys.readouterr().out.splitlines()
        assert said[:-1] == ["Not held: second: follows elbow where it is from; here it is fixed"]


@pytest.mark.parametrize("command", ["simulate --harmonics --periods 1", "excite --realisations 1", "view --flexible"])
def test_commands_that_load_a_joint_that_follows_say_once_that_it_is_fixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    robot = urdf(tmp_path, ind.TWO_JOINTS.replace("</robot>", FINGER))
    name, *options = command.split()
    run(monkeypatch, name, robot, *options, "--out", tmp_path / "out.html")
    line = f"rx90b-flex: warning: {robot}: second follows elbow in the URDF; here it is fixed"
    assert capsys.readouterr().err.splitlines().count(line) == 1
    with pytest.warns(InputWarning, match="second follows elbow in the URDF; here it is fixed"):
        assert load_robot(robot).followers == (("second", "elbow"),)
