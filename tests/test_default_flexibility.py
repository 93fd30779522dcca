"""Claims about a bending robot from a URDF alone: what is stated is what it does, and what flexify wrote is read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_cli import Command

import rx90b_flex as rf
from rx90b_flex import flexify as virtual
from rx90b_flex.default_flexibility import DRIVE_HZ, with_default_flexibility, without_written_hinges
from rx90b_flex.tip import is_finger, tip_words, with_tip
from rx90b_flex.written_hinges import unflexify

UR10, PANDA = "example-robot-data:ur10", "example-robot-data:panda"


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


@pytest.mark.parametrize("source", ["rx90b_rigid", UR10, PANDA])
def test_links_swing_on_each_drive_at_the_stated_frequency_or_faster(source: str) -> None:
    """One torsion free, everything else held: sqrt(k / m) of the mass matrix, in poses other than those it was drawn from."""
    robot = with_default_flexibility(rf.load_robot(source).with_effects([]))
    rng = np.random.default_rng(9)
    lower, upper = (np.clip(x, -np.pi, np.pi) for x in (robot.tree.lowerPositionLimit, robot.tree.upperPositionLimit))
    slowest = np.full(len(robot.joints), np.inf)
    for _ in range(30):
        mass = robot.mass_matrix(robot.input_matrix @ rng.uniform(lower, upper))
        for k, joint in enumerate(robot.joints):
            i = robot.layout.index(joint, "torsion")
            stiffness = next(e for e in robot.effects if e.label == f"{joint}.drive_flexibility").coefficients[0]
            slowest[k] = min(slowest[k], np.sqrt(stiffness / mass[i, i]) / (2 * np.pi))
    assert (slowest > 0.9 * DRIVE_HZ).all() and (slowest[:3] < 1.3 * DRIVE_HZ).all()


def test_what_a_robot_declares_stays(tmp_path: Path) -> None:
    robot = rf.load_robot("rx90b")
    flexible = with_default_flexibility(robot)
    assert flexible.effects[: len(robot.effects)] == robot.effects
    new = {(e.type_name(), *e.joints) for e in flexible.effects[len(robot.effects) :]}
    assert new == {(t, j) for j in ("joint_5", "joint_6") for t in ("drive_flexibility", "joint_flexibility")}


@pytest.mark.parametrize("source", ["rx90b_rigid", UR10, PANDA])
@pytest.mark.parametrize("base", [False, True])
def test_what_flexify_wrote_is_taken_out_again(source: str, base: bool) -> None:
    rigid = virtual.read_xml(rf.load_robot(source).urdf)
    joints = virtual.moving_joints(rigid)
    written = virtual.flexify(rigid, joints[::2], joints[1:3], base)
    back, torsion, bending, had_base = unflexify(written)
    assert (torsion, sorted(bending), had_base) == (tuple(joints[::2]), sorted(joints[1:3]), base)
    assert virtual.to_xml(back) == virtual.to_xml(rigid)


def test_a_urdf_without_written_hinges_is_left_alone() -> None:
    robot = rf.load_robot(PANDA)
    assert without_written_hinges(robot) == (robot, (), (), False)


def test_a_link_whose_name_only_looks_like_a_written_one_is_left_alone(tmp_path: Path) -> None:
    text = rf.load_robot("rx90b_rigid").urdf.replace('"link_6"', '"joint_6_drive_link"')
    (tmp_path / "robot.urdf").write_text(text)
    robot = rf.load_robot(tmp_path / "robot.urdf")
    assert without_written_hinges(robot)[0] is robot


# ---- command ----------------------------------------------------------------------------------------------------


def test_view_shows_a_urdf_bend_and_says_by_which_stiffnesses(tmp_path: Path, command: Command) -> None:
    (tmp_path / "my.urdf").write_text(rf.load_robot("rx90b_rigid").urdf)
    out = tmp_path / "view.html"
    refused = command("view", tmp_path / "my.urdf", "--out", out)
    assert refused.status == 2 and "--flexible" in refused.err and not out.exists()
    found = command("view", tmp_path / "my.urdf", "--flexible", "--out", out)
    assert (found.status, found.err) == (0, "") and out.stat().st_size > 10000
    assert "not identified" in found.out and "joint_2: drive inertia" in found.out and "N m/rad" in found.out


def test_view_shows_what_flexify_wrote(tmp_path: Path, command: Command) -> None:
    urdf, out = tmp_path / "flexible.urdf", tmp_path / "view.html"
    assert command("flexify", "rx90b_rigid", "--out", urdf, "--torsion", "joint_2", "--bending", "joint_3").status == 0
    found = command("view", urdf, "--out", out)
    assert (found.status, found.err) == (0, "") and out.is_file()
    assert "joint_2: drive inertia" in found.out and "joint_3: joint flexibility" in found.out
    assert "joint_1: " not in found.out


def test_a_continuous_joint_is_continuous_in_what_is_written(tmp_path: Path, command: Command) -> None:
    source = "example-robot-data:kinova"  # three joints of six turn without end
    robot = rf.load_robot(source)
    for name, arguments in (("f.urdf", ["flexify", source]), ("e.urdf", ["export", source, "--format", "urdf"])):
        assert command(*arguments, "--out", tmp_path / name).status == 0
        text = (tmp_path / name).read_text()
        assert text.count('type="continuous"') == 3 and '"6283' not in text
        again = rf.load_robot(tmp_path / name)
        assert set(robot.joints) <= set(again.joints) and again.tree.nq == again.tree.nv == len(again.joints)
    np.testing.assert_array_equal(again.tree.lowerPositionLimit, robot.tree.lowerPositionLimit)


def test_flexify_puts_a_declared_payload_into_its_link(tmp_path: Path, command: Command) -> None:
    rigid = rf.load_robot("rx90b_rigid")
    tip = rigid.tip_frame
    robot, urdf = tmp_path / "robot.toml", tmp_path / "flexible.urdf"
    (tmp_path / "my.urdf").write_text(rigid.urdf)
    head = f'urdf = "my.urdf"\n[[effects]]\ntype = "payload"\nframe = "{tip}"\n'
    robot.write_text(head + "mass = 1.5\ncentre = [0.01, -0.02, 0.05]\n")
    said = command("flexify", robot, "--out", urdf, "--torsion", "joint_2")
    assert said.status == 0 and f"In the links: {tip}.payload" in said.out
    loaded = rf.load_robot(robot)
    flexible = rf.load_robot(urdf)
    q = np.linspace(0.3, 0.8, len(rigid.joints))
    at = dict(zip(rigid.joints, q, strict=True))
    wide = np.array([at.get(joint, 0.0) for joint in flexible.joints])
    pull = dict(zip(flexible.joints, flexible.inverse_dynamics(wide, 0 * wide, 0 * wide), strict=True))
    wanted = loaded.inverse_dynamics(q, 0 * q, 0 * q)
    np.testing.assert_allclose([pull[joint] for joint in rigid.joints], wanted, rtol=1e-9, atol=1e-9)
    robot.write_text(head)
    said = command("flexify", robot, "--out", urdf, "--torsion", "joint_2")
    assert said.status == 0 and f"Not held: {tip}.payload: has no value" in said.out


def test_the_tip_is_named_and_what_else_could_be_where_it_is_a_finger(tmp_path: Path, command: Command) -> None:
    panda = with_tip(rf.load_robot(PANDA), "panda_leftfinger")
    assert is_finger(panda) and not is_finger(rf.load_robot("rx90b")) and not is_finger(rf.load_robot(UR10))
    assert "panda_hand" in tip_words(panda)
    assert tip_words(with_tip(panda, "panda_hand")) == "Tip frame: panda_hand"
    assert "a finger" in tip_words(panda) and "--tip" in tip_words(panda)
    found = command("view", "rx90b_3dof", "--tip", "link_2", "--out", tmp_path / "b.html")
    assert found.status == 0 and "Tip frame: link_2\n" in found.out
    found = command("view", PANDA, "--flexible", "--tip", "panda_hend", "--out", tmp_path / "c.html")
    told, last = found.err.splitlines()  # of its finger that follows the other one, then of the frame
    assert found.status == 2 and "here it is fixed" in told and "'panda_hand'" in last


def hand(tip: str, finger: str = "left", mimics: bool = True) -> str:
    """An arm of two joints with a fixed link `tip` on its second link, and two fingers that slide, the second of which mimics."""
    inertial = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    links = "".join(f'<link name="{n}">{inertial}</link>' for n in ("base", "upper", "lower", "pad_1", "pad_2"))
    limit = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>'

    def joint(name: str, kind: str, parent: str, child: str, inside: str) -> str:
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}<origin xyz="0 0 0.3"/>{inside}</joint>'

    joints = [
        joint("swing", "revolute", "base", "upper", limit),
        joint("lift", "revolute", "upper", "lower", limit),
        joint(finger, "prismatic", "lower", "pad_1", limit),
        joint("right", "prismatic", "lower", "pad_2", limit + f'<mimic joint="{finger}"/>' * mimics),
        joint("mount", "fixed", "lower", tip, ""),
    ]
    return f'<robot name="hand">{links}<link name="{tip}"/>{"".join(joints)}</robot>'


@pytest.mark.filterwarnings("ignore:.*here it is fixed")
@pytest.mark.parametrize("mimics", [True, False])
@pytest.mark.parametrize("tool", ["tcp", "arm_tool0", "ee_link", "Flange", "EndEffector"])
def test_a_tool_s_frame_is_the_tip_before_a_finger(tmp_path: Path, tool: str, mimics: bool) -> None:
    (tmp_path / "hand.urdf").write_text(hand(tool, mimics=mimics))
    robot = rf.load_robot(tmp_path / "hand.urdf")
    assert robot.tip_frame == tool and tip_words(robot) == f"Tip frame: {tool}"
    assert rf.load_robot(PANDA).tip_frame == "panda_hand_tcp"


@pytest.mark.filterwarnings("ignore:.*here it is fixed")
@pytest.mark.parametrize(("finger", "mimics"), [("left", True), ("left", False), ("finger", True)])
def test_a_finger_that_is_all_there_is_is_said(tmp_path: Path, command: Command, finger: str, mimics: bool) -> None:
    urdf = tmp_path / "hand.urdf"
    urdf.write_text(hand("steel", finger, mimics))
    found = command("view", urdf, "--flexible", "--out", tmp_path / "view.html")
    (line,) = [line for line in found.out.splitlines() if line.startswith("Tip frame")]
    pad = "pad_1" if mimics else "pad_2"
    assert found.status == 0 and f"Tip frame: {pad}, a finger" in line and "--tip" in line and "steel" in line
    t = np.arange(600) / 250.0
    q, tau = np.column_stack([np.sin(2.0 * t), np.cos(3.0 * t)]), np.column_stack([np.cos(t), np.sin(t)])
    names = "time,q_swing,q_lift,tau_swing,tau_lift"
    np.savetxt(tmp_path / "run.csv", np.column_stack([t, q, tau]), delimiter=",", header=names, comments="")
    found = command("import", tmp_path / "run.csv", "--robot", urdf, "--out", tmp_path / "data")
    assert (
        found.status == 0 and f"Tip frame: {pad}, a finger; if another is meant, a robot file's tip_frame" in found.out
    )
    urdf.write_text(hand("tcp", finger, mimics))
    found = command("import", tmp_path / "run.csv", "--robot", urdf, "--out", tmp_path / "data", "--overwrite")
    assert found.status == 0 and "a finger" not in found.out


def test_a_tool_behind_a_slide_stays_the_tip_whatever_is_named_before_it(tmp_path: Path) -> None:
    """As of a SCARA: the quill slides, and is no finger."""
    body = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="9"/>'
    chain = [("a", "revolute", "base", "arm"), ("b", "fixed", "arm", "flange"), ("z", "prismatic", "arm", "quill")]
    chain += [("c", "fixed", "quill", "tool0")]
    joints = "".join(
        f'<joint name="{n}" type="{kind}"><parent link="{p}"/><child link="{c}"/>{limit * (kind != "fixed")}</joint>'
        for n, kind, p, c in chain
    )
    links = "".join(f'<link name="{n}">{body}</link>' for n in ("base", "arm", "flange", "quill", "tool0"))
    (tmp_path / "scara.urdf").write_text(f'<robot name="scara">{links}{joints}</robot>')
    assert rf.load_robot(tmp_path / "scara.urdf").tip_frame == "tool0"


def test_the_last_link_is_the_tip_where_it_is_no_finger() -> None:
    assert rf.load_robot(UR10).tip_frame == rf.load_robot("rx90b").tip_frame == "tool0"
    assert rf.load_robot("example-robot-data:xarm7").tip_frame == "link_eef"
