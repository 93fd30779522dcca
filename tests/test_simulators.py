"""Claims about robots written for simulators: loaded back they are the same robot, less what was said to be lost.

MJCF is loaded by MuJoCo, URDF by Pinocchio's own reader, SDF by the reader below, which knows the format's rules for poses and builds
its tree without the package.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from drawn_effects import ALL_TYPES, draw_effect, tree
from numpy.typing import NDArray
from test_cli import Command

import rx90b_flex as rf
from rx90b_flex.effects import effect_from_table
from rx90b_flex.robot import Robot
from rx90b_flex.simulators import Exported, export_robot

mujoco = pytest.importorskip("mujoco", reason="the simulator")

Array = NDArray[np.float64]
UR10, PANDA = "example-robot-data:ur10", "example-robot-data:panda"
AGREE = 1e-9
A, B, C = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"

LINEAR = [
    {"type": "drive_inertia", "joint": A, "inertia": 2.0},
    {"type": "drive_inertia", "joint": B, "inertia": 1.5},
    {"type": "drive_inertia", "joint": C, "inertia": 0.7},
    {"type": "viscous_friction", "joint": A, "coefficient": 20.0},
    {"type": "viscous_friction", "joint": "wrist_1_joint", "coefficient": 3.0},
    {"type": "joint_spring", "joint": C, "stiffness": 15.0, "rest_angle": 0.4},
    {"type": "joint_spring", "joint": B, "stiffness": 25.0, "rest_angle": -1.0},
    {"type": "payload", "frame": "tool0", "mass": 3.0, "centre": [0.02, -0.03, 0.08]},
    {"type": "payload", "frame": "forearm_link", "mass": 1.0, "centre": [0.1, 0.05, 0.2]},
]
COUPLED = [
    {
        "type": "joint_coupling",
        "joints": ["wrist_2_joint", "wrist_3_joint"],
        "inertia": 0.3,
        "viscous": 1.2,
        "coulomb": 0.0,
    }
]
TILTED = [{"type": "base_tilt", "angle_x": 0.01, "angle_y": -0.02}]
TWISTING = [
    {"type": "drive_flexibility", "joint": j, "stiffness": k, "damping": 1e-3 * k} for j, k in ((A, 2e4), (B, 3e4))
]
BENDING = [
    {"type": "joint_flexibility", "joint": B, "stiffness": [4e4, 5e4], "damping": [40.0, 50.0]},
    {"type": "joint_flexibility", "joint": "wrist_3_joint", "stiffness": [4e3, 5e3], "damping": [4.0, 5.0]},
    {"type": "base_flexibility", "stiffness": [1e5, 2e5], "damping": [100.0, 200.0]},
]


def ur10(*lists: Sequence[dict[str, object]]) -> Robot:
    robot = tree(UR10)
    frames = [f.name for f in robot.tree.frames]
    return robot.with_effects([effect_from_table(t, "test", robot.joints, frames) for ts in lists for t in ts])


def states(robot: Robot, count: int = 5, deformation: float = 0.05) -> Array:
    """Random q, v, a, shape (count, 3, n)."""
    size = np.where([name.endswith(":drive") for name in robot.coordinates], 2.0, deformation)
    return np.stack([size, 1.0 + 0 * size, 3.0 + 0 * size]) * np.random.default_rng(3).uniform(
        -1, 1, (count, 3, len(size))
    )


def said(done: Exported) -> str:
    return "\n".join(str(x) for x in done.lost)


def assert_agree(found: Array, wanted: Array) -> None:
    assert np.abs(found - wanted).max() <= AGREE * np.abs(wanted).max()


# ---- MJCF ----------------------------------------------------------------------------------------------------


class InMujoco:
    """A robot exported and loaded back, its coordinates in our order."""

    def __init__(self, robot: Robot, path: Path) -> None:
        self.done = export_robot(robot, path, "mjcf")
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        names = tuple(robot.model.names)[1:]
        self.order = [self.model.joint(name).dofadr[0] for name in names]

    def _set(self, q: Array, v: Array, a: Array) -> None:
        for where, x in ((self.data.qpos, q), (self.data.qvel, v), (self.data.qacc, a)):
            where[self.order] = x

    def mass_matrix(self, q: Array) -> Array:
        self._set(q, 0 * q, 0 * q)
        mujoco.mj_forward(self.model, self.data)
        mass = np.empty((self.model.nv, self.model.nv))
        for row, unit in zip(mass, np.eye(self.model.nv), strict=True):
            mujoco.mj_mulM(self.model, self.data, row, unit)
        return mass[np.ix_(self.order, self.order)]

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Generalised forces that the motion asks of the motors, whose own constant torques help."""
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        self._set(q, v, a)
        self.data.ctrl[:] = 0.0
        mujoco.mj_inverse(self.model, self.data)
        needed = self.data.qfrc_inverse.copy()
        mujoco.mj_forward(self.model, self.data)
        return np.asarray((needed - self.data.qfrc_actuator)[self.order])


@pytest.mark.parametrize(
    "lists",
    [(LINEAR,), (LINEAR, COUPLED), (LINEAR, TILTED), (LINEAR, TWISTING), (LINEAR, TILTED, TWISTING, BENDING, COUPLED)],
    ids=["rigid", "coupled", "tilted", "twisting", "everything"],
)
def test_mujoco_finds_the_same_mass_matrix_and_the_same_forces(lists, tmp_path: Path) -> None:
    robot = ur10(*lists)
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    assert not [x for x in loaded.done.lost if x.what != "shapes"]
    for q, v, a in states(robot):
        assert_agree(loaded.mass_matrix(q), robot.mass_matrix(q))
        assert_agree(loaded.inverse_dynamics(q, 0 * v, 0 * a), robot.inverse_dynamics(q, 0 * v, 0 * a))
        assert_agree(loaded.inverse_dynamics(q, v, a), robot.inverse_dynamics(q, v, a))


@pytest.mark.parametrize("source", [PANDA, "example-robot-data:kinova", "example-robot-data:xarm7"])
def test_mujoco_finds_the_same_dynamics_of_bare_robots(source: str, tmp_path: Path) -> None:
    robot = rf.load_robot(source)
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    for q, v, a in states(robot, 3):
        assert_agree(loaded.mass_matrix(q), robot.mass_matrix(q))
        assert_agree(loaded.inverse_dynamics(q, v, a), robot.inverse_dynamics(q, v, a))


def test_the_spring_that_carries_the_rx90bs_arm_pulls_alike_in_mujoco(tmp_path: Path) -> None:
    robot = rf.load_robot("rx90b_rigid")
    robot = robot.with_effects([e for e in robot.effects if e.type_name() == "gravity_spring"])
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    for q, _, _ in states(robot):
        assert_agree(loaded.inverse_dynamics(q, 0 * q, 0 * q), robot.inverse_dynamics(q, 0 * q, 0 * q))


def test_links_that_no_body_has_keep_their_weight_and_are_named(tmp_path: Path) -> None:
    """Table D.1's first two links break the triangle inequality; MuJoCo would refuse them."""
    robot = rf.load_robot("rx90b").with_effects([])
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    assert {x.what for x in loaded.done.lost} == {"link_1", "link_2"}
    off = 0.0
    for q, _, _ in states(robot):
        zero = 0 * q
        assert_agree(loaded.inverse_dynamics(q, zero, zero), robot.inverse_dynamics(q, zero, zero))
        off = max(off, float(np.abs(loaded.mass_matrix(q) - robot.mass_matrix(q)).max()))
    assert 1e-4 < off < 0.05  # kg m^2: the first link's 0.015 and the second's 0.002


def test_a_motor_a_drive_and_what_it_is_told_is_its_torque(tmp_path: Path) -> None:
    robot = ur10(LINEAR, TWISTING)
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    assert [loaded.model.actuator(i).name for i in range(loaded.model.nu)] == list(robot.joints)
    q, v, _ = states(robot)[0]
    torque = np.arange(1.0, 7.0)
    loaded._set(q, v, 0 * q)
    loaded.data.ctrl[:] = torque
    mujoco.mj_forward(loaded.model, loaded.data)
    assert_agree(loaded.data.qacc[loaded.order], robot.forward_dynamics(q, v, torque))


def test_mujocos_own_steps_have_the_modes_of_the_linearisation(tmp_path: Path) -> None:
    """Eigenvalues of one step about the balance under the motors' torques, against poles that were never stepped."""
    robot = ur10([t for t in LINEAR if "friction" not in str(t["type"])], TWISTING, BENDING)
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    model, data = loaded.model, loaded.data
    q, zero = robot.input_matrix @ np.array([0.3, -1.0, 1.2, 0.4, 0.5, 0.0]), np.zeros(robot.model.nv)
    hinges = np.flatnonzero(~robot.input_matrix.any(axis=1))
    for _ in range(20):
        stiffness = robot.linearize(q).K[np.ix_(hinges, hinges)]
        q[hinges] -= np.linalg.solve(stiffness, robot.inverse_dynamics(q, zero, zero)[hinges])
    loaded._set(q, zero, zero)
    data.ctrl[:] = robot.inverse_dynamics(q, zero, zero) @ robot.input_matrix
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-6  # it stands
    step = np.empty((2 * model.nv, 2 * model.nv))
    mujoco.mjd_transitionFD(model, data, 1e-7, True, step, None, None, None)
    theirs = np.log(np.linalg.eigvals(step).astype(complex)) / model.opt.timestep
    ours = robot.linearize(q).modes().poles
    swinging = [np.sort(poles.imag[poles.imag > 2 * np.pi * 2.0]) for poles in (theirs, ours)]
    assert len(swinging[1]) >= 5 and len(swinging[0]) == len(swinging[1])
    # a step of first order in the damping: a pole is off by about half of its own angle a step
    off = np.abs(swinging[0] / swinging[1] - 1.0)
    assert (off < swinging[1] * model.opt.timestep).all() and off[0] < 2e-3


def test_the_time_step_resolves_the_fastest_mode(tmp_path: Path) -> None:
    robot = ur10(LINEAR, TWISTING, BENDING)
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    # at rest, less friction: the model's own modes, computed by another route
    still = robot.with_effects([e for e in robot.effects if "friction" not in e.type_name()])
    fastest_hz = still.linearize(np.zeros(robot.model.nv)).frequencies_hz().max()
    assert loaded.model.opt.timestep < 0.1 / fastest_hz
    assert InMujoco(tree(UR10), tmp_path / "rigid.xml").model.opt.timestep == 2e-3


def test_a_drive_that_twists_without_inertia_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"needs a drive_inertia to move; none at {A}"):
        export_robot(ur10(TWISTING[:1]), tmp_path / "robot.xml", "mjcf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ALL_TYPES)
def test_every_effect_is_held_or_said_to_be_lost(kind: str, tmp_path: Path) -> None:
    """Effects of every type, future ones too: MuJoCo's forces are the model's, or the effect is named."""
    rng = np.random.default_rng(5)
    bare = tree(UR10)
    effects = draw_effect(kind, bare, rng)
    twisting = {e.joints[0] for e in effects if "torsion" in e.traits.virtual}
    effects += tuple(
        effect_from_table({"type": "drive_inertia", "joint": j, "inertia": 1.0}, "test", bare.joints) for j in twisting
    )
    robot = bare.with_effects(effects)
    for name in ("urdf", "sdf", "mjcf"):
        lost = [x.what for x in export_robot(robot, tmp_path / name, name).lost]  # type: ignore[arg-type]
        assert len(lost) == len(set(lost)), lost
    if any(effect.label in what for what in lost for effect in effects):
        return
    loaded = InMujoco(robot, tmp_path / "robot.xml")
    for q, v, a in states(robot):
        v = np.where(np.abs(v) < 0.3, 0.3, v)  # away from reversal, where dry friction turns over
        wanted = robot.inverse_dynamics(q, v, a)
        dry = any("coulomb" in name for e in effects for name in (e.type_name(), *e.parameters()))
        # the model's sign is a hyperbolic tangent and MuJoCo's a soft constraint
        np.testing.assert_allclose(
            loaded.inverse_dynamics(q, v, a), wanted, rtol=0, atol=(1e-2 if dry else 1e-9) * np.abs(wanted).max()
        )


# ---- friction ------------------------------------------------------------------------------------------------


def friction_in(path: Path, joint: str) -> tuple[float, float]:
    found = ElementTree.parse(path).getroot().find(f".//joint[@name='{joint}']/dynamics")
    assert found is not None
    return float(found.get("friction", "0")), float(found.get("damping", "0"))


def on_elbow(*tables: dict[str, object]) -> Robot:
    return ur10([{"joint": C, **t} for t in tables])


def test_dry_and_viscous_friction_are_a_urdfs_friction_and_damping(tmp_path: Path) -> None:
    robot = on_elbow(
        {"type": "coulomb_friction", "torque": 4.0, "turnover": 1e-3}, {"type": "viscous_friction", "coefficient": 6.0}
    )
    done = export_robot(robot, tmp_path / "robot.urdf", "urdf")
    assert done.lost == ()
    assert friction_in(done.path, C) == pytest.approx((4.0, 6.0), rel=1e-9)


def near(*values: float) -> list[tuple[float, float]]:
    """Pairs of values a thousandth off."""
    x, y = values
    return [(x * (1 + i), y * (1 + j)) for i in (-1e-3, 0.0, 1e-3) for j in (-1e-3, 0.0, 1e-3) if i or j]


def test_friction_of_another_form_is_the_nearest_and_how_far_off_is_said(tmp_path: Path) -> None:
    power, c = 0.5, 10.0
    robot = on_elbow({"type": "viscous_power_friction", "coefficient": c, "power": power})
    done = export_robot(robot, tmp_path / "robot.urdf", "urdf")
    level, slope = friction_in(done.path, C)
    (lost,) = done.lost
    fastest = float(ElementTree.fromstring(robot.urdf).find(f".//joint[@name='{C}']/limit").get("velocity"))  # type: ignore[union-attr, arg-type]
    v = np.linspace(0.05 * fastest, fastest, 2000)
    off = np.abs(c * v**power - level - slope * v).max()
    assert f"off by up to {off:.3g}"[:-1] in lost.why  # the last digit is rounded on another grid
    # no other line of level and slope is nearer in the mean square
    grid = np.linspace(0.05 * fastest, fastest, 60)
    squares = [np.sum((c * grid**power - x - y * grid) ** 2) for x, y in ((level, slope), *near(level, slope))]
    assert min(squares) == squares[0]


def test_friction_that_a_urdf_states_itself_is_not_the_robots(tmp_path: Path) -> None:
    text = tree(UR10).urdf.replace('<limit effort="150', '<dynamics damping="7" friction="8"/><limit effort="150')
    assert "damping" in text
    (tmp_path / "own.urdf").write_text(text)
    done = export_robot(tmp_path / "own.urdf", tmp_path / "robot.urdf", "urdf")
    assert "<dynamics" not in done.path.read_text()


# ---- URDF ----------------------------------------------------------------------------------------------------


def rigid_links(robot: Robot, keep: Sequence[str]) -> Robot:
    """The robot with only those effects that a format holds in its links and springs."""
    return robot.with_effects([e for e in robot.effects if e.type_name() in keep])


def test_a_urdf_has_links_payloads_and_gravity_of_the_rigid_robot(tmp_path: Path) -> None:
    robot = ur10(LINEAR, COUPLED, TILTED, TWISTING, BENDING)
    done = export_robot(robot, tmp_path / "robot.urdf", "urdf")
    model = pin.buildModelFromUrdf(str(done.path))
    links = rigid_links(robot, ["payload"])
    for q, _, _ in states(links):
        mass = pin.crba(model, model.createData(), q)
        assert_agree(np.triu(mass) + np.triu(mass, 1).T, links.mass_matrix(q))
        assert_agree(
            pin.computeGeneralizedGravity(model, model.createData(), q), links.inverse_dynamics(q, 0 * q, 0 * q)
        )
    for kind in (
        "drive_inertia",
        "joint_spring",
        "joint_coupling",
        "base_tilt",
        "drive_flexibility",
        "base_flexibility",
    ):
        assert f".{kind}: " in said(done)
    assert "payload" not in said(done) and "viscous" not in said(done)


def test_gravity_of_a_tilted_base_is_said_as_a_vector(tmp_path: Path) -> None:
    robot = ur10(TILTED)
    (lost,) = export_robot(robot, tmp_path / "robot.urdf", "urdf").lost
    gravity = np.array([float(x) for x in lost.why.split("set it to ")[1].split(" m/s^2")[0].split()])
    model = robot.model.copy()
    model.gravity.linear = gravity
    for q, _, _ in states(robot):
        torque = pin.computeGeneralizedGravity(model, model.createData(), q)
        assert_agree(torque, robot.inverse_dynamics(q, 0 * q, 0 * q))


# ---- SDF -----------------------------------------------------------------------------------------------------


class InSdf:
    """A model from SDF 1.8: links placed at their joints, joints in their parents; frames weigh nothing."""

    def __init__(self, path: Path) -> None:
        model = ElementTree.parse(path).getroot().find("model")
        assert model is not None
        self.tree, self.springs = pin.Model(), {}
        joints = {j.findtext("child"): j for j in model.findall("joint")}
        links = {link.get("name"): link for link in model.findall("link")}
        names = [x.get("name") for kind in ("link", "joint", "frame") for x in model.findall(kind)]
        assert len(names) == len(set(names)), "names of one model differ"
        made = {}
        (root,) = (name for name, j in joints.items() if j.findtext("parent") == "world")
        made[root] = 0
        while len(made) < len(links):
            for name, link in links.items():
                joint = joints[name]
                if name in made or joint.findtext("parent") not in made:
                    continue
                made[name] = self._add(joint, link, made[joint.findtext("parent")])

    def _add(self, joint: ElementTree.Element, link: ElementTree.Element, parent: int) -> int:
        pose, own = joint.find("pose"), link.find("pose")
        assert pose is not None and pose.get("relative_to") == joint.findtext("parent")
        assert own is not None and own.get("relative_to") == joint.get("name") and not any(numbers(own.text))
        axis = np.array(numbers(joint.findtext("axis/xyz")))
        kind = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
        at = self.tree.addJoint(parent, kind[joint.get("type", "")](axis), placement(pose.text), joint.get("name"))
        inertial = link.find("inertial")
        assert inertial is not None
        xx, xy, xz, yy, yz, zz = (
            float(inertial.findtext(f"inertia/i{k}", "")) for k in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert np.linalg.eigvalsh(moments)[0] > 0
        body = pin.Inertia(float(inertial.findtext("mass", "")), np.zeros(3), moments)
        self.tree.appendBodyToJoint(at, body, placement(inertial.findtext("pose")))
        stiffness, rest = (float(joint.findtext(f"axis/dynamics/spring_{k}", "0")) for k in ("stiffness", "reference"))
        self.springs[joint.get("name")] = (stiffness, rest, float(joint.findtext("axis/dynamics/damping", "0")))
        return int(at)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        torque = pin.rnea(self.tree, self.tree.createData(), q, v, a)
        values = np.array([self.springs[name] for name in tuple(self.tree.names)[1:]])
        return np.asarray(torque + values[:, 0] * (q - values[:, 1]) + values[:, 2] * v)


def numbers(text: str | None) -> list[float]:
    return [float(word) for word in (text or "").split()]


def placement(text: str | None) -> pin.SE3:
    x = np.array(numbers(text))
    return pin.SE3(pin.rpy.rpyToMatrix(x[3:]), x[:3])


@pytest.mark.parametrize("flexible", [False, True])
def test_an_sdf_has_links_payloads_springs_and_hinges_that_bend(flexible: bool, tmp_path: Path) -> None:
    robot = ur10(LINEAR, COUPLED, TILTED, TWISTING, BENDING if flexible else [])
    done = export_robot(robot, tmp_path / "robot.sdf", "sdf")
    loaded = InSdf(done.path)
    held = rigid_links(robot, ["payload", "joint_spring", "viscous_friction", "joint_flexibility", "base_flexibility"])
    assert set(loaded.tree.names) == set(held.model.names)
    order = [list(loaded.tree.names).index(name) - 1 for name in tuple(held.model.names)[1:]]
    for q, v, a in states(held):
        theirs = np.empty((3, held.model.nv))
        theirs[:, order] = (q, v, a)
        mass = pin.crba(loaded.tree, loaded.tree.createData(), theirs[0])
        assert_agree((np.triu(mass) + np.triu(mass, 1).T)[np.ix_(order, order)], held.mass_matrix(q))
        assert_agree(loaded.inverse_dynamics(*theirs)[order], held.inverse_dynamics(q, v, a))
    for kind in ("drive_inertia", "joint_coupling", "base_tilt", "drive_flexibility"):
        assert f".{kind}: " in said(done)
    for kind in ("joint_spring", "joint_flexibility", "base_flexibility", "payload", "viscous"):
        assert kind not in said(done)


def test_links_that_are_fixed_to_each_other_are_one_in_sdf(tmp_path: Path) -> None:
    robot = rf.load_robot(PANDA)
    loaded = InSdf(export_robot(robot, tmp_path / "robot.sdf", "sdf").path)
    for q, v, a in states(robot):
        assert_agree(loaded.inverse_dynamics(q, v, a), robot.inverse_dynamics(q, v, a))


def test_joints_keep_their_names_in_sdf_where_links_have_the_same(tmp_path: Path) -> None:
    """SDF has one name space for links, joints and frames; SO-100's joint and link "gripper" are one example."""
    robot = rf.load_robot("rx90b_rigid").with_effects([])
    (tmp_path / "own.urdf").write_text(robot.urdf.replace('"link_3"', '"joint_4"').replace('"tool0"', '"joint_5"'))
    robot = rf.load_robot(tmp_path / "own.urdf")
    done = export_robot(robot, tmp_path / "robot.sdf", "sdf")
    assert set(robot.joints) <= set(InSdf(done.path).tree.names)
    assert "joint_4: this link is called joint_4_link" in said(done)
    assert "joint_5: this frame is called joint_5_frame" in said(done)


# ---- refusals ------------------------------------------------------------------------------------------------


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


@pytest.mark.parametrize("name", ["urdf", "mjcf", "sdf"])
def test_the_command_writes_the_file_and_says_what_it_cannot_hold(name: str, tmp_path: Path, command: Command) -> None:
    found = command("export", "rx90b", "--format", name, "--out", tmp_path / "robot")
    assert (found.status, found.err) == (0, "")
    assert [p.name for p in tmp_path.iterdir()] == ["robot"]
    assert all(line.startswith("Not held: ") for line in found.out.splitlines()[:-1])
    assert "link_1: no body has its moments of inertia" in found.out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["rx90b", "--format", "mjc", "--out", "a.xml"], "'mjcf'"),
        (["rx90c", "--format", "mjcf", "--out", "a.xml"], "'rx90b'"),
        (["rx90b", "--format", "mjcf", "--out", "own.urdf/a.xml"], "own.urdf"),
        (["rx90b", "--format", "mjcf", "--out", "."], "is a folder"),
        (["unknown.toml", "--format", "sdf", "--out", "a.sdf"], "joint_1.viscous_friction: coefficient has no value"),
        (["unknown.toml", "--format", "sdf", "--out", "unknown.toml"], "is what this run reads"),
        (["unknown.toml", "--format", "urdf", "--out", "own.urdf"], "is what this run reads"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    arguments: list[str], named: str, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.urdf").write_text(rf.load_robot("rx90b").urdf)
    table = 'urdf = "own.urdf"\n[[effects]]\ntype = "viscous_friction"\njoint = "joint_1"\n'
    (tmp_path / "unknown.toml").write_text(table)
    monkeypatch.chdir(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    found = command("export", *arguments)
    assert (found.status, found.out, found.err.count("\n")) == (2, "", 1)
    assert named in found.err
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_a_robot_without_masses_is_said_to_be_one_that_cannot_move(tmp_path):
    urdf = tmp_path / "light.urdf"
    urdf.write_text(
        '<robot name="light"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    done = rf.export_robot(urdf, tmp_path / "light.xml", "mjcf")
    assert "no moving link has a mass" in str(done.lost[0])


@pytest.mark.parametrize("format", ["urdf", "mjcf", "sdf"])
def test_a_joint_with_nothing_that_has_a_mass_behind_it_is_named(format, tmp_path):
    limit = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    urdf = tmp_path / "light.urdf"
    urdf.write_text(
        f'<robot name="light"><link name="a"/><link name="b">{body}</link><link name="c"/><link name="d"/>'
        f'<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{limit}'
        f'<joint name="k" type="revolute"><parent link="b"/><child link="c"/>{limit}'
        '<joint name="tool" type="fixed"><parent link="c"/><child link="d"/></joint></robot>'
    )
    done = rf.export_robot(urdf, tmp_path / "light.xml", format)
    assert [str(x) for x in done.lost] == ["k: no link behind it has a mass in its URDF: a simulator cannot move it"]
