"""Claims about reading rigid URDFs and writing flexible ones."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rx90b_flex import flexify as fx

EPS = np.finfo(float).eps
INERTIAL = '<inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="4"/>'


def link(name: str, content: str = INERTIAL) -> str:
    return f'<link name="{name}">{content}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", content: str = LIMIT) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{content}</joint>'


def robot(*parts: str) -> str:
    return f'<robot name="toy">{"".join(parts)}</robot>'


TOY = robot(link("base"), link("arm"), joint("shoulder", "base", "arm"))


@pytest.fixture
def read(tmp_path: Path):
    """A function that writes a text to a file and reads it with `read_urdf`."""

    def read_text(text: str) -> yourdfpy.URDF:
        path = tmp_path / "toy.urdf"
        path.write_text(text)
        return fx.read_urdf(path)

    return read_text


def example_robot(name: str) -> yourdfpy.URDF:
    return fx.normalise(fx.read_urdf(f"example-robot-data:{name}"))


def model(urdf: yourdfpy.URDF) -> pin.Model:
    return pin.buildModelFromXML(fx.to_xml(urdf))


def parsed(xml: str) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(io.BytesIO(xml.encode()), build_scene_graph=False, load_meshes=False)


def joint_of(urdf: yourdfpy.URDF, name: str):
    return urdf.joint_map[name]


# ---------------------------------------------------------------------------------- zero deflection is the rigid robot


@pytest.mark.parametrize("name", ["ur10", "panda", "kinova", "tiago"])
def test_at_zero_deflection_frames_and_mass_matrix_are_those_of_the_rigid_robot(name):
    urdf = example_robot(name)
    joints = fx.moving_joints(urdf)
    rigid, flexible = model(urdf), model(fx.flexify(urdf, joints, joints))
    rigid_data, flexible_data = rigid.createData(), flexible.createData()
    drives = [flexible.joints[flexible.getJointId(name)].idx_v for name in rigid.names[1:]]
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(-3, 3, rigid.nq)
        q_flexible = np.zeros(flexible.nq)
        q_flexible[drives] = q
        pin.framesForwardKinematics(rigid, rigid_data, q)
        pin.framesForwardKinematics(flexible, flexible_data, q_flexible)
        for body in urdf.link_map:
            here = rigid_data.oMf[rigid.getFrameId(body)].homogeneous
            there = flexible_data.oMf[flexible.getFrameId(body)].homogeneous
            np.testing.assert_allclose(there, here, rtol=0, atol=100 * EPS)
        mass, mass_flexible = pin.crba(rigid, rigid_data, q), pin.crba(flexible, flexible_data, q_flexible)
        np.testing.assert_allclose(
            mass_flexible[np.ix_(drives, drives)], mass, rtol=0, atol=1000 * EPS * np.abs(mass).max()
        )


def test_torsion_adds_to_the_drive_so_their_mass_matrix_rows_are_equal():
    urdf = example_robot("ur10")
    joints = fx.moving_joints(urdf)
    flexible = model(fx.flexify(urdf, joints, joints))
    q = np.zeros(flexible.nq)
    mass = pin.crba(flexible, flexible.createData(), q)
    for name in joints:
        row = mass[flexible.joints[flexible.getJointId(name)].idx_v]
        twist = mass[flexible.joints[flexible.getJointId(f"{name}_torsion")].idx_v]
        np.testing.assert_allclose(twist, row, rtol=0, atol=1000 * EPS * np.abs(mass).max())


def test_a_bent_joint_moves_its_link_but_not_the_joint_itself(read):
    content = '<origin xyz="0 0 1" rpy="0.3 0 0"/><axis xyz="0 0 1"/>' + LIMIT
    urdf = read(robot(link("base"), link("arm"), joint("j", "base", "arm", content=content)))
    flexible = model(fx.flexify(urdf, [], ["j"]))
    data = flexible.createData()
    pin.framesForwardKinematics(flexible, data, np.array([0.0, 0.05, 0.0]))
    arm = data.oMf[flexible.getFrameId("arm")]
    np.testing.assert_allclose(arm.translation, [0, 0, 1], atol=4 * EPS)
    np.testing.assert_allclose(arm.rotation, pin.rpy.rpyToMatrix(0.35, 0, 0), atol=4 * EPS)


# ------------------------------------------------------------------------------------------- the tree of virtual joints


def test_virtual_joints_follow_their_drive_in_the_order_drive_torsion_bendings(read):
    urdf = read(robot(link("a"), link("b"), link("c"), joint("j1", "a", "b"), joint("j2", "b", "c")))
    names = list(model(fx.flexify(urdf, ["j1"], ["j1", "j2"])).names)[1:]
    assert names == ["j1", "j1_torsion", "j1_bend_1", "j1_bend_2", "j2", "j2_bend_1", "j2_bend_2"]
    assert fx.virtual_joint_names("j1") == ("j1_torsion", "j1_bend_1", "j1_bend_2")


def test_the_drive_keeps_origin_axis_and_limits():
    urdf = example_robot("ur10")
    before, after = joint_of(urdf, "elbow_joint"), joint_of(fx.flexify(urdf, ["elbow_joint"], []), "elbow_joint")
    assert np.array_equal(after.origin, before.origin) and np.array_equal(after.axis, before.axis)
    assert after.limit == before.limit and after.type == before.type and after.parent == before.parent


def test_virtual_links_have_no_mass_and_no_shape():
    urdf = example_robot("ur10")
    flexible = fx.flexify(urdf, fx.moving_joints(urdf), fx.moving_joints(urdf), base=True)
    virtual = [body for body in flexible.robot.links if body.name not in urdf.link_map]
    assert len(virtual) == 3 * 6 + 2
    assert all(body.inertial is None and not body.visuals and not body.collisions for body in virtual)


def test_virtual_joints_do_not_change_the_mass():
    urdf = example_robot("ur10")
    flexible = model(fx.flexify(urdf, fx.moving_joints(urdf), fx.moving_joints(urdf)))
    assert pin.computeTotalMass(flexible) == pytest.approx(pin.computeTotalMass(model(urdf)), rel=10 * EPS)


def test_flexifying_leaves_the_argument_as_it_was():
    urdf = example_robot("ur10")
    before = fx.to_xml(urdf)
    fx.flexify(urdf, ["elbow_joint"], ["elbow_joint"], base=True)
    fx.lock(urdf, ["elbow_joint"])
    assert fx.to_xml(urdf) == before


def test_flexifying_nothing_changes_nothing():
    urdf = example_robot("panda")
    assert fx.to_xml(fx.flexify(urdf, [], [])) == fx.to_xml(urdf)


def test_branches_keep_pinocchios_order_of_joints():
    urdf = example_robot("tiago")
    flexible = model(fx.flexify(urdf, fx.moving_joints(urdf), ["torso_lift_joint"], base=True))
    rigid = model(urdf)
    assert [name for name in flexible.names if name in set(rigid.names)] == list(rigid.names)
    assert flexible.nv == 2 * rigid.nv + 2 + 2


def test_the_drive_of_a_prismatic_joint_deforms_along_its_axis_and_its_bendings_turn(read):
    content = '<axis xyz="0 1 0"/>' + LIMIT
    urdf = read(robot(link("a"), link("b"), joint("slide", "a", "b", "prismatic", content)))
    flexible = model(fx.flexify(urdf, ["slide"], ["slide"]))
    assert [j.shortname() for j in flexible.joints[1:]] == [
        "JointModelPY",
        "JointModelPY",
        "JointModelRZ",
        "JointModelRX",
    ]


def test_a_flexible_base_tilts_the_whole_robot_about_x_then_y(read):
    urdf = read(TOY)
    flexible = model(fx.flexify(urdf, [], [], base=True))
    assert list(flexible.names)[1:] == ["base_bend_1", "base_bend_2", "shoulder"]
    assert [j.shortname() for j in flexible.joints[1:3]] == ["JointModelRX", "JointModelRY"]
    assert flexible.inertias[2].mass == 2.0  # the root link, which in the rigid robot stands still, moves
    data = flexible.createData()
    pin.framesForwardKinematics(flexible, data, np.array([0.1, 0.2, 0.0]))
    expected = pin.rpy.rpyToMatrix(0.1, 0, 0) @ pin.rpy.rpyToMatrix(0, 0.2, 0)
    np.testing.assert_allclose(data.oMf[flexible.getFrameId("base")].rotation, expected, atol=4 * EPS)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3))
@example((0.0, 0.0, -1.0))
@example((1.0, 1.0, 1.0))
def test_bending_axes_are_right_handed_and_orthonormal_for_any_axis(axis):
    a = np.array(axis) / np.linalg.norm(axis)
    basis = np.column_stack([a, *fx.bending_axes(axis)])
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=20 * EPS)
    assert np.linalg.det(basis) > 0.99


def test_the_bendings_of_joints_about_coordinate_axes_are_about_the_next_two():
    for i in range(3):
        first, second = fx.bending_axes(np.eye(3)[i])
        assert np.array_equal(first, np.eye(3)[(i + 1) % 3]) and np.array_equal(second, np.eye(3)[(i + 2) % 3])


# --------------------------------------------------------------------------------------------------- coordinate names


@pytest.mark.parametrize(
    ("joint_name", "expected"),
    [
        ("joint_1", "joint_1:drive"),
        ("joint_1_torsion", "joint_1:torsion"),
        ("joint_1_bend_1", "joint_1:bend_1"),
        ("joint_1_bend_2", "joint_1:bend_2"),
        ("base_bend_1", "base:bend_1"),
        ("base_bend_2", "base:bend_2"),
        ("spring_torsion", "spring_torsion:drive"),
        ("spring_torsion_torsion", "spring_torsion:torsion"),
    ],
)
def test_coordinates_are_named_after_the_driving_joint(joint_name, expected):
    assert fx.coordinate_name(joint_name, ["joint_1", "spring_torsion"]) == expected


@pytest.mark.parametrize("joint_name", ["joint_2", "joint_2_torsion", "base_torsion", "_torsion"])
def test_a_joint_that_is_no_coordinate_has_no_name(joint_name):
    with pytest.raises(ValueError, match=f"'{joint_name}' is no driving joint"):
        fx.coordinate_name(joint_name, ["joint_1"])


def test_every_joint_of_a_flexible_robot_has_its_own_coordinate_name():
    urdf = example_robot("tiago")
    joints = fx.moving_joints(urdf)
    flexible = model(fx.flexify(urdf, joints, joints, base=True))
    names = {fx.coordinate_name(name, joints) for name in flexible.names[1:]}
    assert len(names) == flexible.nv


# ------------------------------------------------------------------------------------------ numbers survive the writing


@pytest.mark.parametrize("name", ["ur10", "panda", "kinova", "xarm7", "tiago", "romeo", "anymal", "icub"])
def test_pinocchio_builds_the_identical_model_from_the_original_and_from_the_written_file(name):
    original = pin.buildModelFromUrdf(str(fx.urdf_path(f"example-robot-data:{name}")))
    assert model(fx.read_urdf(f"example-robot-data:{name}")) == original


@pytest.mark.parametrize("name", ["ur10", "panda", "tiago", "romeo"])
def test_inertias_origins_axes_and_limits_read_back_bit_for_bit(name):
    urdf = fx.read_urdf(f"example-robot-data:{name}")
    again = parsed(fx.to_xml(urdf))
    for one, other in zip(urdf.robot.links, again.robot.links, strict=True):
        parts = [(one.inertial, other.inertial)] if one.inertial else []
        for inertial, back in parts:
            assert inertial.mass == back.mass and np.array_equal(inertial.inertia, back.inertia)
        parts += zip(one.visuals + one.collisions, other.visuals + other.collisions, strict=True)
        for part, back in parts:
            assert (part.origin is None and back.origin is None) or np.array_equal(part.origin, back.origin)
    for one, other in zip(urdf.robot.joints, again.robot.joints, strict=True):
        assert np.array_equal(one.axis, other.axis) and one.limit == other.limit and one.mimic == other.mimic
        assert (one.origin is None and other.origin is None) or np.array_equal(one.origin, other.origin)


def written_rotation(rotation: np.ndarray) -> np.ndarray:
    """Rotation of a joint's origin after writing and reading it."""
    origin = np.eye(4)
    origin[:3, :3] = rotation
    urdf = yourdfpy.URDF(
        robot=yourdfpy.urdf.Robot(
            name="r",
            links=[yourdfpy.urdf.Link("a"), yourdfpy.urdf.Link("b")],
            joints=[yourdfpy.urdf.Joint("j", "fixed", "a", "b", origin=origin)],
        ),
        build_scene_graph=False,
    )
    return parsed(fx.to_xml(urdf)).robot.joints[0].origin[:3, :3]


def from_text(rpy: str) -> np.ndarray:
    text = robot(link("a"), link("b"), joint("j", "a", "b", "fixed", f'<origin rpy="{rpy}"/>'))
    return parsed(text).robot.joints[0].origin[:3, :3]


@pytest.mark.parametrize(
    "rpy",
    [
        "0 1.5707963267948966 0",
        "0.3 1.5707963267948966 -1.2",
        "1.57079632679 -1.57079632679 3.14159265359",
        "3.1416 3.1416 0",
        "0 0 -4.71238898038",
        "-3.141592653589793 0 3.141592653589793",
        "0.1 2.5 -0.7",
        "1e-9 1.570796327 2e-12",
    ],
)
def test_angles_of_a_file_read_back_bit_for_bit_also_at_the_singular_pitch(rpy):
    rotation = from_text(rpy)
    assert np.array_equal(written_rotation(rotation), rotation)


@given(st.tuples(*[st.floats(-4, 4)] * 3))
@settings(max_examples=200, deadline=None)
def test_any_angles_read_back_to_rounding(rpy):
    rotation = from_text(" ".join(map(repr, rpy)))
    np.testing.assert_allclose(written_rotation(rotation), rotation, rtol=0, atol=4 * EPS)


@given(st.floats(-math.pi, math.pi), st.sampled_from([-1.0, 1.0]), st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_rotations_that_are_products_read_back_to_rounding_at_the_singular_pitch(roll, sign, seed):
    noise = np.random.default_rng(seed).normal(scale=EPS, size=(3, 3))
    rotation = from_text(f"{roll!r} {sign * math.pi / 2!r} 0.4") + noise
    np.testing.assert_allclose(written_rotation(rotation), rotation, rtol=0, atol=20 * EPS)


def test_numbers_keep_all_their_digits(read):
    inertia = {"ixx": 0.1234567890123456, "iyy": 1e-17, "izz": 3.0000000000000004, "ixy": -1e-300, "ixz": 0, "iyz": 1}
    attributes = " ".join(f'{key}="{value!r}"' for key, value in inertia.items())
    content = f'<inertial><mass value="{1 / 3!r}"/><inertia {attributes}/></inertial>'
    back = parsed(fx.to_xml(read(robot(link("a", content), link("b"), joint("j", "a", "b"))))).robot.links[0].inertial
    assert back.mass == 1 / 3
    assert [back.inertia[0, 0], back.inertia[1, 1], back.inertia[2, 2]] == [
        0.1234567890123456,
        1e-17,
        3.0000000000000004,
    ]
    assert [back.inertia[0, 1], back.inertia[0, 2], back.inertia[1, 2]] == [-1e-300, 0, 1]


def test_shapes_materials_and_package_names_stay_as_in_the_source(read):
    shapes = (
        '<visual name="v"><geometry><mesh filename="package://robot/arm.stl" scale="0.001 0.002 0.003"/></geometry>'
        '<material name="red"><color rgba="1 0 0 0.5"/></material></visual>'
        '<visual><geometry><cylinder radius="0.1" length="0.2"/></geometry><material name="blue"/></visual>'
        '<collision><origin xyz="1 2 3"/><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'
        '<collision><geometry><sphere radius="0.4"/></geometry></collision>'
    )
    named = '<material name="blue"><color rgba="0 0 1 1"/></material>'
    urdf = read(robot(link("a", shapes), link("b"), joint("j", "a", "b"), named))
    xml = fx.to_xml(fx.flexify(urdf, ["j"], ["j"], base=True))
    assert parsed(xml).link_map["a"] == urdf.link_map["a"]
    assert parsed(xml).robot.materials == urdf.robot.materials
    assert 'filename="package://robot/arm.stl"' in xml


def test_safety_and_mimic_tags_stay_as_in_the_source(read):
    safety = LIMIT + '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="1.5" k_position="2" k_velocity="3"/>'
    mimic = LIMIT + '<mimic joint="j" multiplier="-0.5" offset="0.25"/>'
    bodies = [link(name) for name in "abc"]
    urdf = read(robot(*bodies, joint("j", "a", "b", content=safety), joint("k", "b", "c", content=mimic)))
    again = parsed(fx.to_xml(urdf))
    assert again.robot.joints == urdf.robot.joints


def test_names_may_hold_any_characters(read):
    urdf = read(robot(link("a &amp; b"), link("ü <1>".replace("<", "&lt;")), joint("j: 1", "a &amp; b", "ü &lt;1>")))
    flexible = model(fx.flexify(urdf, ["j: 1"], []))
    assert list(flexible.names)[1:] == ["j: 1", "j: 1_torsion"]
    assert fx.coordinate_name("j: 1_torsion", ["j: 1"]) == "j: 1:torsion"


def test_a_written_file_loads_in_yourdfpy_with_its_kinematics(tmp_path):
    urdf = example_robot("ur10")
    path = tmp_path / "ur10_flex.urdf"
    fx.write_urdf(fx.flexify(urdf, ["elbow_joint"], ["elbow_joint"], base=True), path)
    loaded = yourdfpy.URDF.load(str(path), load_meshes=False)
    assert loaded.num_actuated_joints == 6 + 3 + 2 and loaded.validate()
    assert loaded.base_link == fx.GROUND_LINK
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]  # no temporary file is left


def test_a_written_file_reads_back_and_writes_the_same_text(tmp_path):
    flexible = fx.flexify(example_robot("panda"), ["panda_joint1"], ["panda_joint2"])
    fx.write_urdf(flexible, tmp_path / "panda.urdf")
    assert fx.to_xml(fx.read_urdf(tmp_path / "panda.urdf")) == fx.to_xml(flexible)


def test_a_text_reads_like_a_file():
    urdf = example_robot("ur10")
    assert fx.to_xml(fx.read_xml(fx.to_xml(urdf))) == fx.to_xml(urdf)
    with pytest.raises(ValueError, match=r"^is not a URDF"):
        fx.read_xml("<sdf/>")


def test_writing_where_it_cannot_be_written_names_the_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"file/x\.urdf: cannot be written"):
        fx.write_urdf(example_robot("ur10"), tmp_path / "file" / "x.urdf")


def test_folders_on_the_way_to_a_file_are_made(tmp_path):
    fx.write_urdf(example_robot("ur10"), tmp_path / "new" / "folder" / "x.urdf")
    assert (tmp_path / "new" / "folder" / "x.urdf").exists()


def test_a_flexible_robot_shows_in_meshcat(read):
    meshcat_visualizer = pytest.importorskip("pinocchio.visualize").MeshcatVisualizer
    shape = '<visual><geometry><box size="1 2 3"/></geometry></visual>'
    urdf = read(robot(link("a", shape), link("b", INERTIAL + shape), joint("j", "a", "b")))
    flexible = fx.flexify(urdf, ["j"], ["j"], base=True)
    tree = model(flexible)
    shapes = pin.buildGeomFromUrdfString(tree, fx.to_xml(flexible), pin.GeometryType.VISUAL)
    viewer = meshcat_visualizer(tree, shapes, shapes)
    viewer.initViewer(open=False)
    try:
        viewer.loadViewerModel()
        viewer.display(np.full(tree.nq, 0.05))
        names = [viewer.getViewerNodeName(shape, pin.GeometryType.VISUAL) for shape in shapes.geometryObjects]
        assert names == ["pinocchio/visuals/a_0", "pinocchio/visuals/b_0"]
    finally:
        viewer.viewer.window.server_proc.kill()


# --------------------------------------------------------------------------------- one coordinate and velocity a joint


@pytest.mark.parametrize(
    "name", ["ur10", "panda", "kinova", "tiago", "tiago_pro", "romeo", "pr2", "double_pendulum_continuous"]
)
def test_after_normalising_every_moving_joint_has_one_coordinate_and_one_velocity(name):
    urdf = example_robot(name)
    tree = model(urdf)
    assert tree.nq == tree.nv == tree.njoints - 1 == len(fx.moving_joints(urdf))


def test_a_continuous_joint_becomes_revolute_with_wide_limits(read):
    urdf = read(robot(link("a"), link("b"), joint("spin", "a", "b", "continuous", "")))
    limits = joint_of(fx.normalise(urdf), "spin").limit
    assert (limits.lower, limits.upper) == (-fx.CONTINUOUS_LIMIT, fx.CONTINUOUS_LIMIT)
    assert (limits.effort, limits.velocity) == (fx.UNLIMITED, fx.UNLIMITED)


def test_a_mimic_joint_is_held_where_its_leaders_neutral_position_puts_it(read):
    bodies = [link(name) for name in "abcd"]
    leader = '<limit lower="0.5" upper="2" effort="1" velocity="1"/>'
    first = LIMIT + '<axis xyz="0 0 1"/><mimic joint="leader" multiplier="2" offset="0.1"/>'
    second = LIMIT + '<axis xyz="0 0 1"/><mimic joint="first" multiplier="-1"/>'
    urdf = read(
        robot(
            *bodies,
            joint("leader", "a", "b", content=leader),
            joint("first", "b", "c", content=first),
            joint("second", "c", "d", content=second),
        )
    )
    normal = fx.normalise(urdf)
    assert fx.moving_joints(normal) == ("leader",)
    np.testing.assert_allclose(joint_of(normal, "first").origin[:3, :3], pin.rpy.rpyToMatrix(0, 0, 0.1), atol=4 * EPS)
    assert fx.neutral_position(urdf, "second") == -0.1


def test_the_mass_of_a_mimic_joints_link_is_kept():
    original = pin.buildModelFromUrdf(str(fx.urdf_path("example-robot-data:panda")))
    assert pin.computeTotalMass(model(example_robot("panda"))) == pytest.approx(
        pin.computeTotalMass(original), rel=10 * EPS
    )


def test_mimic_joints_in_a_circle_are_refused(read):
    first, second = (LIMIT + f'<mimic joint="{name}"/>' for name in ("k", "j"))
    bodies = [link(name) for name in "abc"]
    urdf = read(robot(*bodies, joint("j", "a", "b", content=first), joint("k", "b", "c", content=second)))
    with pytest.raises(ValueError, match="mimic each other in a circle"):
        fx.normalise(urdf)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joints_of_several_coordinates_are_refused_with_the_reason(read, kind):
    urdf = read(robot(link("a"), link("b"), joint("free", "a", "b", kind, "")))
    with pytest.raises(ValueError, match=rf"'free' is {kind}: it has (six|three) coordinates and no drive"):
        fx.normalise(urdf)


def test_axes_become_unit_vectors(read):
    urdf = read(robot(link("a"), link("b"), joint("j", "a", "b", "prismatic", '<axis xyz="3 0 -4"/>' + LIMIT)))
    np.testing.assert_allclose(joint_of(fx.normalise(urdf), "j").axis, [0.6, 0, -0.8], rtol=EPS)


def test_absent_limits_are_zero_or_unlimited_as_the_urdf_specification_says(read):
    urdf = read(robot(link("a"), link("b"), joint("j", "a", "b", content='<limit upper="1"/>')))
    limits = joint_of(fx.normalise(urdf), "j").limit
    assert (limits.lower, limits.upper, limits.effort, limits.velocity) == (0.0, 1.0, fx.UNLIMITED, fx.UNLIMITED)
    assert model(fx.normalise(urdf)).nv == 1


# ------------------------------------------------------------------------------------------------------------- locking


def test_locked_joints_give_pinocchios_reduced_model():
    urdf = example_robot("ur10")
    keep = ["shoulder_lift_joint", "elbow_joint"]
    locked, full = model(fx.lock(urdf, keep)), model(urdf)
    others = [full.getJointId(name) for name in full.names[1:] if name not in keep]
    reduced = pin.buildReducedModel(full, others, np.zeros(full.nq))
    assert list(locked.names) == list(reduced.names)
    rng = np.random.default_rng(2)
    q, v, a = rng.normal(size=(3, 2))
    np.testing.assert_allclose(
        pin.rnea(locked, locked.createData(), q, v, a), pin.rnea(reduced, reduced.createData(), q, v, a), rtol=1e-12
    )


def test_joints_are_held_where_pinocchios_neutral_configuration_has_them_whatever_their_limits():
    urdf = example_robot("panda")
    assert joint_of(urdf, "panda_joint4").limit.upper < 0  # its range leaves zero out
    full, locked = model(urdf), model(fx.lock(urdf, ["panda_joint1"]))
    q = pin.neutral(full)
    data, locked_data = full.createData(), locked.createData()
    pin.framesForwardKinematics(full, data, q)
    pin.framesForwardKinematics(locked, locked_data, np.zeros(1))
    np.testing.assert_allclose(
        locked_data.oMf[locked.getFrameId("panda_hand")].homogeneous,
        data.oMf[full.getFrameId("panda_hand")].homogeneous,
        atol=20 * EPS,
    )


def test_a_prismatic_mimic_joint_is_locked_along_its_axis(read):
    content = '<origin xyz="1 0 0"/><axis xyz="0 0 2"/><limit lower="0" upper="1" effort="1" velocity="1"/>'
    follower = content + '<mimic joint="slide" offset="0.5"/>'
    slides = [joint("slide", "a", "b", "prismatic", content), joint("follow", "b", "c", "prismatic", follower)]
    urdf = read(robot(*(link(name) for name in "abc"), *slides))
    assert np.array_equal(joint_of(fx.lock(urdf, []), "follow").origin[:3, 3], [1, 0, 0.5])


def test_locking_keeps_the_origin_of_a_joint_at_zero_bit_for_bit():
    urdf = example_robot("ur10")
    locked = fx.lock(urdf, [])
    for one, other in zip(urdf.robot.joints, locked.robot.joints, strict=True):
        assert other.type == "fixed"
        assert one.origin is other.origin is None or np.array_equal(one.origin, other.origin)


# -------------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        ("  \n", "is empty"),
        ("shoulder: 1", "is not XML"),
        ('<robot name="r"><link name="a"></robot>', r"is not XML \(line 1"),
        ("<sdf/>", "is not a URDF .*<sdf>"),
        ("<robot><link name='a'/></robot>", "<robot> has no name"),
        ('<robot name="r"/>', "has no <link>"),
        (robot(link("a")), "has no <joint>"),
        ('<robot name="r" xmlns:xacro="x"><xacro:arm/></robot>', "is a xacro file"),
        (robot(link("a"), "<link/>", joint("j", "a", "b")), "<link> has no name"),
        (robot(link("a"), link("a"), joint("j", "a", "b")), "link name 'a' is used twice"),
        (robot(link("a"), link("b"), joint("j", "a", "b"), joint("j", "a", "b")), "joint name 'j' is used twice"),
        (robot(link("a"), link("b"), joint("j", "a", "c")), "joint 'j': link 'c' does not exist"),
        (robot(link("a"), link("b"), joint("j", "c", "b")), "joint 'j': link 'c' does not exist"),
        (
            robot(link("a"), link("b"), '<joint name="j" type="fixed"><parent link="a"/></joint>'),
            "'j': has no child link",
        ),
        (
            robot(link("a"), link("b"), '<joint name="j" type="fixed"><child link="a"/></joint>'),
            "'j': has no parent link",
        ),
        (robot(link("a"), link("b"), joint("j", "a", "b", "hinge")), "'j': type is 'hinge', expected one of revolute"),
        (robot(link("a"), link("b"), link("c"), joint("j", "a", "b")), "2 root links .a, c., expected one"),
        (
            robot(*map(link, "abc"), joint("j", "a", "b"), joint("k", "c", "b")),
            "'b' is the child of both joint 'j' and joint 'k'",
        ),
        (robot(link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a")), "joints j, k form a loop"),
        (
            robot(*map(link, "abc"), joint("j", "b", "c"), joint("k", "c", "b")),
            "joints j, k form a loop",
        ),
        (robot(link("a"), link("b"), joint("j", "a", "b", content="")), r"'j' \(revolute\): has no <limit>"),
        (
            robot(link("a"), link("b"), joint("j", "a", "b", content='<limit lower="2" upper="1"/>')),
            "'j': lower limit 2.0 is above upper limit 1.0",
        ),
        (
            robot(link("a"), link("b"), joint("j", "a", "b", content=LIMIT + '<axis xyz="0 0 0"/>')),
            "'j': axis is '0.0 0.0 0.0', expected a direction",
        ),
        (
            robot(link("a"), link("b"), joint("j", "a", "b", content=LIMIT + '<origin xyz="0 zero 0"/>')),
            "joint 'j': xyz of <origin> is '0 zero 0', expected 3 finite numbers",
        ),
        (
            robot(link("a"), link("b"), joint("j", "a", "b", content=LIMIT + '<origin rpy="0 0"/>')),
            "joint 'j': rpy of <origin> is '0 0', expected 3 finite numbers",
        ),
        (
            robot(link("a", INERTIAL.replace('"2"', '"nan"')), link("b"), joint("j", "a", "b")),
            "link 'a': value of <mass> is 'nan', expected 1 finite number",
        ),
        (
            robot(link("a", INERTIAL.replace("ixx", "xx")), link("b"), joint("j", "a", "b")),
            "link 'a': <inertia> has no ixx",
        ),
        (
            robot(link("a", '<inertial><mass value="1"/></inertial>'), link("b"), joint("j", "a", "b")),
            "link 'a': <inertial> needs both",
        ),
        (
            robot(link("a"), link("b"), joint("j", "a", "b", content=LIMIT + '<mimic joint="k"/>')),
            "joint 'j': mimics joint 'k', which does not exist",
        ),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_file_and_reason(read, text, reason):
    with pytest.raises(ValueError, match=rf"toy\.urdf: .*{reason}") as info:
        read(text)
    assert "\n" not in str(info.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"nothing\.urdf: no such URDF file"):
        fx.read_urdf(tmp_path / "nothing.urdf")


def test_a_directory_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="is a directory"):
        fx.read_urdf(tmp_path)


def test_an_unknown_example_robot_is_answered_with_near_names():
    with pytest.raises(ValueError, match=r"no robot 'UR-10'; did you mean .*ur10"):
        fx.read_urdf("example-robot-data:UR-10")


def test_an_example_robot_without_a_urdf_is_refused():
    with pytest.raises(ValueError, match="'cassie' as SDF only"):
        fx.read_urdf("example-robot-data:cassie")


def test_undeclared_name_spaces_and_unknown_shapes_are_passed_over(read, capfd):
    capsule = '<collision><geometry><capsule radius="1" length="2"/></geometry></collision>'
    extras = '<gazebo:thing x="1"/><!-- note --><transmission name="t"/><gazebo/>'
    urdf = read(robot(link("a", capsule), link("b"), joint("j", "a", "b"), extras))
    assert model(urdf).nv == 1
    assert capfd.readouterr().err == ""


MIMIC = LIMIT + '<mimic joint="drive"/>'
ALL_KINDS = robot(
    *map(link, "abcde"),
    joint("drive", "a", "b"),
    joint("glue", "b", "c", "fixed", ""),
    joint("copy", "b", "d", content=MIMIC),
    joint("free", "a", "e", "floating", ""),
)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("wrist", "joint 'wrist' does not exist; moving joints: drive"),
        ("glue", "joint 'glue' is fixed; moving joints: drive"),
        ("copy", "joint 'copy' mimics 'drive' and has no drive of its own; moving joints: drive"),
        ("free", "joint 'free' is floating; moving joints: drive"),
    ],
)
def test_only_moving_joints_can_be_flexible_or_kept_and_the_error_lists_them(read, name, reason):
    urdf = read(ALL_KINDS)
    with pytest.raises(ValueError, match=f"torsion: {reason}"):
        fx.flexify(urdf, [name], [])
    with pytest.raises(ValueError, match=f"bending: {reason}"):
        fx.flexify(urdf, ["drive"], [name])
    with pytest.raises(ValueError, match=f"keep: {reason}"):
        fx.lock(urdf, [name])


def test_a_text_in_place_of_a_list_of_names_is_refused(read):
    with pytest.raises(ValueError, match="torsion: got the text 'shoulder', expected a list of joint names"):
        fx.flexify(read(TOY), "shoulder", [])


def test_a_robot_that_is_flexible_already_is_not_made_flexible_twice(read):
    once = fx.flexify(read(TOY), ["shoulder"], [])
    with pytest.raises(ValueError, match="needs the link name 'shoulder_drive_link', but the robot already has it"):
        fx.flexify(once, ["shoulder"], [])


def test_a_joint_that_bears_the_name_of_a_virtual_one_is_a_clash(read):
    urdf = read(robot(*map(link, "abc"), joint("j", "a", "b"), joint("j_torsion", "b", "c")))
    with pytest.raises(ValueError, match="needs the joint name 'j_torsion', but the robot already has it"):
        fx.flexify(urdf, ["j"], [])


def test_a_flexible_base_twice_is_a_clash(read):
    with pytest.raises(ValueError, match="name 'base_"):
        fx.flexify(fx.flexify(read(TOY), [], [], base=True), [], [], base=True)
