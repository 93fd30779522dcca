"""A rigid URDF and a list of flexible joints become a URDF with virtual joints.

The one place where URDFs are read, checked, changed and written. A flexible joint of the source (Hardeman 2008,
chapter 3) is a driving hinge and a flexible hinge in series at the same point; as a tree of one-coordinate joints it is

``parent -> J (drive) -> J_torsion -> J_bend_1 -> J_bend_2 -> child``

with massless links between. The drive keeps the name, origin, axis and limits of the rigid joint ``J``, so that limits,
branch order and everything else that refers to ``J`` stay valid.

Files are parsed and written by yourdfpy; what it loses (exact angles, mimic and safety tags, `package://` names) is put
right here. Units are the URDF's: m, rad, kg, N, N m.
"""

from __future__ import annotations

import copy
import difflib
import io
import math
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from lxml import etree  # type: ignore[import-untyped, unused-ignore]

from rx90b_flex.files.warned import InputWarning
from rx90b_flex.written_angles import roll_pitch_yaw

if TYPE_CHECKING:  # at run time where it is needed, for it takes a second: it loads what can draw meshes
    import yourdfpy  # type: ignore[import-untyped, unused-ignore]

Vector = npt.NDArray[np.float64]

EXAMPLE_ROBOT_PREFIX = "example-robot-data:"
"""A source that starts with this names a robot of the package example-robot-data instead of a file."""

CONTINUOUS_LIMIT = 2000.0 * math.pi
"""Position limit (rad) of what was a continuous joint: a thousand turns. urdfdom, and so Pinocchio, reads no `inf`."""

UNLIMITED = 1e9
"""Effort (N m, N) and velocity (rad/s, m/s) limit written where the URDF states none; finite for the same reason."""

VIRTUAL_LIMIT = 0.1
"""Position limit (rad, m) of a virtual joint, for display and sampling: Pinocchio's dynamics does not know it."""

GROUND_LINK = "base_ground"
"""Root link of a robot on a flexible base."""

BASE_JOINTS = ("base_bend_1", "base_bend_2")
"""The two hinges of a flexible base, about the x and then the y axis of the original root link."""

_MOVING_TYPES = ("revolute", "continuous", "prismatic")
_JOINT_TYPES = (*_MOVING_TYPES, "fixed", "floating", "planar")
_KINDS = _TORSION, _BEND_1, _BEND_2 = "torsion", "bend_1", "bend_2"

# Tag -> attribute -> how many numbers it may hold.
_NUMBERS: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    "origin": {"xyz": (3,), "rpy": (3,)},
    "axis": {"xyz": (3,)},
    "mass": {"value": (1,)},
    "inertia": {key: (1,) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")},
    "limit": {key: (1,) for key in ("lower", "upper", "effort", "velocity")},
    "mimic": {"multiplier": (1,), "offset": (1,)},
    "safety_controller": {key: (1,) for key in ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")},
    "calibration": {"rising": (1,), "falling": (1,)},
    "dynamics": {"damping": (1,), "friction": (1,)},
    "box": {"size": (3,)},
    "cylinder": {"radius": (1,), "length": (1,)},
    "sphere": {"radius": (1,)},
    "mesh": {"scale": (1, 3)},
    "color": {"rgba": (4,)},
}
# yourdfpy fills an absent inertia entry with 1 or 0 and an absent size with an unnamed error: both are refused before.
_REQUIRED: Mapping[str, tuple[str, ...]] = {
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
    "mimic": ("joint",),
}


# ----------------------------------------------------------------------------------------------- names


def virtual_joint_names(joint: str) -> tuple[str, ...]:
    """Names of the virtual joints that may follow a driving joint, in tree order: one where it twists, two where it bends."""
    return tuple(f"{joint}_{kind}" for kind in _KINDS)


def coordinate_name(joint_name: str, driving_joints: Iterable[str]) -> str:
    """Name of the coordinate that a joint of the flexible tree carries; the inverse of `virtual_joint_names`.

    Parameters
    ----------
    joint_name
        Joint of the flexible URDF, for instance ``"joint_1_bend_2"``.
    driving_joints
        The moving joints of the rigid URDF. They decide, so a driving joint may itself be called ``"arm_torsion"``.

    Returns
    -------
    str
        ``"joint_1:drive"``, ``"joint_1:torsion"``, ``"joint_1:bend_1"``, ``"joint_1:bend_2"``, ``"base:bend_1"``,
        ``"base:bend_2"``.

    Raises
    ------
    ValueError
        If the joint is neither a driving joint nor a virtual one of theirs or of the base.
    """
    drives = set(driving_joints)
    if joint_name in drives:
        return f"{joint_name}:drive"
    for kind in _KINDS:
        joint = joint_name.removesuffix(f"_{kind}")
        if joint != joint_name and (joint in drives or joint_name in BASE_JOINTS):
            return f"{joint}:{kind}"
    raise ValueError(f"joint '{joint_name}' is no driving joint and no virtual joint of one; {_list(sorted(drives))}")


# --------------------------------------------------------------------------------------------- reading


def urdf_path(source: str | Path) -> Path:
    """Path of the URDF file that `source` means; only names of example-robot-data are looked up, no file is opened.

    Parameters
    ----------
    source
        A path, or ``"example-robot-data:NAME"`` with NAME as in `example_robot_data.load`, for instance ``ur10``.

    Raises
    ------
    ValueError
        If example-robot-data has no such robot (the message lists near names), or has it only as SDF.
    """
    if not str(source).startswith(EXAMPLE_ROBOT_PREFIX):
        return Path(source)
    name = str(source).removeprefix(EXAMPLE_ROBOT_PREFIX)
    try:  # here, not at the top: it needs Pinocchio, and a robot given by its file needs neither
        from example_robot_data.robots_loader import ROBOTS, getModelPath
    except ImportError as error:
        raise ValueError(f"{source}: needs the package example-robot-data-loaders, which does not import") from error
    if name not in ROBOTS:
        near = difflib.get_close_matches(name.lower(), ROBOTS, n=5, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else f"it has {', '.join(sorted(ROBOTS))}"
        raise ValueError(f"{source}: example-robot-data has no robot '{name}'; {hint}")
    loader = ROBOTS[name]  # the class says where the file is; an instance would load meshes and build models
    if not loader.urdf_filename:
        raise ValueError(f"{source}: example-robot-data has '{name}' as SDF only; a URDF is needed")
    relative = os.path.join(loader.path, loader.urdf_subpath, loader.urdf_filename)
    try:
        return Path(loader.model_path or getModelPath(relative), relative)
    except OSError as error:
        raise ValueError(f"{source}: its file {relative} is not installed (package example-robot-data)") from error


def example_robots() -> tuple[str, ...]:
    """Names of the robots that example-robot-data has as URDF; none where it is not installed."""
    try:
        from example_robot_data.robots_loader import ROBOTS
    except ImportError:
        return ()
    return tuple(sorted(name for name, loader in ROBOTS.items() if loader.urdf_filename))


def read_urdf(source: str | Path) -> yourdfpy.URDF:
    """Read and check a URDF: one tree, every reference resolved, every number finite.

    Meshes are not loaded. Comments, transmissions and elements of other vocabularies (gazebo) are left out, as are
    shapes other than box, cylinder, sphere and mesh, for which yourdfpy has no place.

    Parameters
    ----------
    source
        Path of a URDF file, or ``"example-robot-data:NAME"``.

    Returns
    -------
    yourdfpy.URDF
        As in the file; `normalise` makes it ready for models.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong: missing, empty, not XML, not a URDF, no links or joints, a name
        used twice, an unknown link or joint, more than one root, a loop, an unusable number, missing joint limits.
    """
    path = urdf_path(source).resolve()
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ValueError(f"{path}: no such URDF file") from None
    except IsADirectoryError:
        raise ValueError(f"{path}: is a directory, expected a URDF file") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        return _read(data, str(path.parent))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_xml(text: str) -> yourdfpy.URDF:
    """Read and check a URDF given as text, as `to_xml` gives it; else as `read_urdf`.

    Raises
    ------
    ValueError
        As `read_urdf`, but without the name of a file.
    """
    return _read(text.encode(), "")


def _read(data: bytes, mesh_dir: str) -> yourdfpy.URDF:
    import yourdfpy

    root = _parse_xml(data)
    _check_document(root)
    urdf = yourdfpy.URDF.load(
        io.BytesIO(etree.tostring(root)), build_scene_graph=False, load_meshes=False, mesh_dir=mesh_dir
    )
    _check_tree(urdf)
    return urdf


def _parse_xml(data: bytes) -> Any:
    """Root element without comments and without elements of other vocabularies (`gazebo:...`)."""
    if not data.strip():
        raise ValueError("is empty, expected a URDF")
    parser = etree.XMLParser(recover=True, remove_blank_text=True, remove_comments=True, resolve_entities=False)
    try:
        root = etree.fromstring(data, parser=parser)
    except etree.XMLSyntaxError as error:  # an encoding that it is not in: there is nothing to recover
        raise ValueError(f"is not XML ({' '.join(str(error).split())})") from None
    # Undeclared name spaces are common in URDFs and harmless; every other error means that recovery guessed.
    errors = [e for e in parser.error_log if e.domain != etree.ErrorDomains.NAMESPACE]
    if root is None or errors:
        where = f"line {errors[0].line}: {errors[0].message.strip()}" if errors else "no element found"
        raise ValueError(f"is not XML ({where})")
    for element in list(root.iter(etree.Element)):
        if ":" not in element.tag and not element.tag.startswith("{"):
            continue
        if element.prefix == "xacro" or element.tag.startswith("xacro:"):
            raise ValueError(f"is a xacro file (line {element.sourceline}); expand it to a URDF first")
        if element.getparent() is not None:
            element.getparent().remove(element)
    _drop_unwritable(root)
    return root


def _drop_unwritable(root: Any) -> None:
    """Drop what yourdfpy reads and then cannot write: nameless textures and shapes it does not know (capsules)."""
    for texture in list(root.iter("texture")):
        if texture.get("filename") is None:
            texture.getparent().remove(texture)
    for shape in list(root.iter("visual", "collision")):
        if not any(shape.find(f"geometry/{kind}") is not None for kind in ("box", "cylinder", "sphere", "mesh")):
            shape.getparent().remove(shape)


def _check_document(root: Any) -> None:
    """Refuse, by name, everything on which yourdfpy would fail without a name or would fill in a guess."""
    if root.tag != "robot":
        raise ValueError(f"is not a URDF (its root element is <{root.tag}>, expected <robot>)")
    if root.get("name") is None:
        raise ValueError("<robot> has no name")
    for kind in ("link", "joint"):
        elements = root.findall(kind)
        if not elements:
            raise ValueError(f"is not a usable URDF (<robot> has no <{kind}>)")
        seen: set[str] = set()
        for element in elements:
            name = element.get("name")
            if not name:
                raise ValueError(f"line {element.sourceline}: <{kind}> has no name")
            if name in seen:
                raise ValueError(f"{kind} name '{name}' is used twice")
            seen.add(name)
            _check_element(element, f"{kind} '{name}'")
    for material in root.findall("material"):
        _check_element(material, f"material '{material.get('name')}'")
    for joint in root.findall("joint"):
        if joint.get("type") not in _JOINT_TYPES:
            expected = ", ".join(_JOINT_TYPES)
            raise ValueError(f"joint '{joint.get('name')}': type is {joint.get('type')!r}, expected one of {expected}")
        for end in ("parent", "child"):
            if (element := joint.find(end)) is None or not element.get("link"):
                raise ValueError(f"joint '{joint.get('name')}': has no {end} link")


def _check_element(parent: Any, owner: str) -> None:
    for element in parent.iter(etree.Element):
        for key in _REQUIRED.get(element.tag, ()):
            if element.get(key) is None:
                raise ValueError(f"{owner}: <{element.tag}> has no {key}")
        if element.tag == "inertial" and (element.find("mass") is None or element.find("inertia") is None):
            raise ValueError(f"{owner}: <inertial> needs both <mass> and <inertia>")
        for key, counts in _NUMBERS.get(element.tag, {}).items():
            text = element.get(key)
            if text is None:
                continue
            try:
                numbers = [float(word) for word in text.split()]
            except ValueError:
                numbers = []
            if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
                expected = " or ".join(f"{n} finite number{'s' * (n > 1)}" for n in counts)
                raise ValueError(f"{owner}: {key} of <{element.tag}> is {text!r}, expected {expected}")
            if element.tag == "mass" and numbers[0] < 0.0:
                raise ValueError(f"{owner}: {key} of <mass> is {text!r}, expected 0 or more (kg)")


def _check_tree(urdf: yourdfpy.URDF) -> None:
    links = {link.name for link in urdf.robot.links}
    names = {joint.name for joint in urdf.robot.joints}
    parent_joint: dict[str, Any] = {}
    for joint in urdf.robot.joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ValueError(f"joint '{joint.name}': link '{end}' does not exist")
        if joint.child in parent_joint:
            first = parent_joint[joint.child].name
            raise ValueError(
                f"link '{joint.child}' is the child of both joint '{first}' and joint '{joint.name}'; a URDF is a tree"
            )
        parent_joint[joint.child] = joint
        if joint.mimic is not None and joint.mimic.joint not in names:
            raise ValueError(f"joint '{joint.name}': mimics joint '{joint.mimic.joint}', which does not exist")
        _check_moving(joint)
    roots = [link.name for link in urdf.robot.links if link.name not in parent_joint]
    if len(roots) > 1:
        raise ValueError(f"has {len(roots)} root links ({_list(roots)}), expected one")
    # With one parent each, a link whose ancestors never end at the root stands in (or below) a loop.
    for link in links:
        path: list[str] = []
        while link in parent_joint and link not in path:
            path.append(link)
            link = parent_joint[link].parent
        if link in parent_joint:
            loop = [parent_joint[name].name for name in path[path.index(link) :]]
            raise ValueError(f"joints {', '.join(sorted(loop))} form a loop; a URDF is a tree")


def _check_moving(joint: Any) -> None:
    """What a moving joint needs before anything can turn about its axis."""
    if joint.type not in _MOVING_TYPES:
        return
    if not np.linalg.norm(joint.axis) > 1e-9:
        raise ValueError(f"joint '{joint.name}': axis is {_text(joint.axis)!r}, expected a direction")
    if joint.type == "continuous":
        return
    if joint.limit is None:
        advice = ', or type "continuous"' if joint.type == "revolute" else ""
        raise ValueError(f"joint '{joint.name}' ({joint.type}): has no <limit>; give it one{advice}")
    lower, upper = _range(joint)
    if lower > upper:
        raise ValueError(f"joint '{joint.name}': lower limit {lower} is above upper limit {upper}")


# ------------------------------------------------------------------------------ one coordinate a joint


def moving_joints(urdf: yourdfpy.URDF) -> tuple[str, ...]:
    """Names of the joints with one free coordinate, in the file's order: neither fixed nor mimicking."""
    return tuple(j.name for j in urdf.robot.joints if j.type in _MOVING_TYPES and j.mimic is None)


def followers(urdf: yourdfpy.URDF, source: str) -> tuple[tuple[str, str], ...]:
    """Joints that mimic another, and that one; a warning says of each that it is fixed here."""
    found = tuple((joint.name, joint.mimic.joint) for joint in urdf.robot.joints if joint.mimic is not None)
    for joint, leader in found:
        warnings.warn(f"{source}: {joint} follows {leader} in the URDF; here it is fixed", InputWarning, stacklevel=4)
    return found


def neutral_position(urdf: yourdfpy.URDF, joint_name: str) -> float:
    """Position (rad, m) at which a joint is held when it must not move: zero, as pinocchio's neutral configuration.

    Limits do not count: a joint whose range leaves zero out is held at zero all the same.

    A mimic joint follows its leader: its offset, and so on up the chain, times each multiplier.

    Raises
    ------
    ValueError
        If the joint does not exist, or if mimic joints mimic each other in a circle.
    """
    position, factor, visited = 0.0, 1.0, [joint_name]
    joint = _joint(urdf, joint_name)
    while joint.mimic is not None:
        position += factor * (joint.mimic.offset or 0.0)
        factor *= 1.0 if joint.mimic.multiplier is None else joint.mimic.multiplier
        if joint.mimic.joint in visited:
            raise ValueError(f"mimic joints {', '.join(visited)} mimic each other in a circle")
        visited.append(joint.mimic.joint)
        joint = _joint(urdf, joint.mimic.joint)
    return position


def normalise(urdf: yourdfpy.URDF) -> yourdfpy.URDF:
    """Copy in which every moving joint has exactly one coordinate and one velocity, as all models here assume.

    - continuous joints become revolute with limits +-`CONTINUOUS_LIMIT` (Pinocchio would give them two coordinates);
    - mimic joints become fixed at their `neutral_position` (they have no coordinate of their own, and no drive);
    - axes become unit vectors; effort and velocity limits that are absent or zero become `UNLIMITED`: a zero
      stands in many URDFs for what nobody stated, and a joint that may not move at all would be fixed;
    - prismatic and fixed joints stay.

    Raises
    ------
    ValueError
        If a joint is floating or planar: it has several coordinates, none of which one drive moves.
    """
    from yourdfpy.urdf import Limit

    robot = copy.deepcopy(urdf.robot)
    for joint in robot.joints:
        if joint.type in ("floating", "planar"):
            count = {"floating": "six", "planar": "three"}[joint.type]
            raise ValueError(
                f"joint '{joint.name}' is {joint.type}: it has {count} coordinates and no drive; "
                "fix it, or write it as revolute and prismatic joints"
            )
        if joint.mimic is not None:
            _fix(joint, neutral_position(urdf, joint.name))
        elif joint.type in _MOVING_TYPES:
            joint.axis = _unit(joint.axis)
            limit = joint.limit if joint.limit is not None else Limit()
            if joint.type == "continuous":
                joint.type = "revolute"
                limit.lower, limit.upper = -CONTINUOUS_LIMIT, CONTINUOUS_LIMIT
            else:
                limit.lower, limit.upper = _range(joint)
            limit.effort, limit.velocity = limit.effort or UNLIMITED, limit.velocity or UNLIMITED
            joint.limit = limit
    return with_robot(urdf, robot)


def with_continuous(urdf: yourdfpy.URDF) -> yourdfpy.URDF:
    """Copy for other programs, in which joints that turn without limits, as `normalise` leaves them, are continuous again."""
    robot = copy.deepcopy(urdf.robot)
    for joint in robot.joints:
        limit = joint.limit
        if joint.type == "revolute" and limit is not None and limit.upper - limit.lower >= 1.99 * CONTINUOUS_LIMIT:
            joint.type, limit.lower, limit.upper = "continuous", None, None
    return with_robot(urdf, robot)


def lock(urdf: yourdfpy.URDF, keep: Sequence[str]) -> yourdfpy.URDF:
    """Copy in which every moving joint outside `keep` is fixed at its `neutral_position`.

    Parameters
    ----------
    urdf
        Any URDF; mimic joints are fixed too.
    keep
        Names of joints that stay as they are. Their order does not matter.

    Raises
    ------
    ValueError
        If a name in `keep` is unknown, or the joint is fixed, mimicking, floating or planar.
    """
    _check_drivable(urdf, keep, "keep")
    robot = copy.deepcopy(urdf.robot)
    for joint in robot.joints:
        if joint.type in _MOVING_TYPES and joint.name not in keep:
            _fix(joint, neutral_position(urdf, joint.name))
    return with_robot(urdf, robot)


# -------------------------------------------------------------------------------------- virtual joints


def bending_axes(axis: npt.ArrayLike) -> tuple[Vector, Vector]:
    """The two axes across a joint axis about which the joint bends.

    With a the unit axis and k = (argmax abs(a) + 1) mod 3: b1 is e_k less its part along a, normalised; b2 = a x b1. So
    (a, b1, b2) is right-handed, and for a joint about z the bendings are about x and y.

    Parameters
    ----------
    axis
        (3,) joint axis, of any length but zero.

    Returns
    -------
    tuple
        b1 and b2, (3,) unit vectors.
    """
    a = _unit(axis)
    k = (int(np.argmax(np.abs(a))) + 1) % 3
    first = _unit(np.eye(3)[k] - a[k] * a)
    return first, _unit(np.cross(a, first))


def flexify(urdf: yourdfpy.URDF, torsion: Sequence[str], bending: Sequence[str], base: bool = False) -> yourdfpy.URDF:
    """Copy with virtual joints for flexible drives, flexible joints and a flexible base.

    Each named joint J is followed, at its own origin, by ``J_torsion`` (as J: about its axis, or along it if prismatic)
    and by ``J_bend_1``, ``J_bend_2`` (revolute, `bending_axes`). The last one carries J's child link. The links between
    (``J_drive_link``, ``J_torsion_link``, ``J_bend_1_link``) have no mass and no shape.

    Parameters
    ----------
    urdf
        Rigid tree, normally from `normalise`.
    torsion
        Driving joints with a flexible drive: one coordinate each (rad; m for a prismatic joint).
    bending
        Driving joints that bend: two coordinates each (rad).
    base
        Whether the robot stands on a flexible floor: `BASE_JOINTS`, revolute about x and y of the original root link,
        between a new root `GROUND_LINK` and that link, whose inertia then moves too.

    Raises
    ------
    ValueError
        If a joint is unknown, fixed, mimicking, floating or planar, or if a new name is already in use.
    """
    from yourdfpy.urdf import Link

    _check_drivable(urdf, torsion, "torsion")
    _check_drivable(urdf, bending, "bending")
    robot = copy.deepcopy(urdf.robot)
    joints: list[Any] = []
    links: list[Any] = []
    if base:
        children = {joint.child for joint in robot.joints}
        root = next(link.name for link in robot.links if link.name not in children)
        between = f"{BASE_JOINTS[0]}_link"
        links += [Link(name=GROUND_LINK), Link(name=between)]
        joints.append(_virtual_joint(BASE_JOINTS[0], "revolute", GROUND_LINK, between, np.array([1.0, 0.0, 0.0])))
        joints.append(_virtual_joint(BASE_JOINTS[1], "revolute", between, root, np.array([0.0, 1.0, 0.0])))
    links += robot.links
    for joint in robot.joints:
        joints.append(joint)
        if joint.name in torsion or joint.name in bending:
            chain = _virtual_chain(joint, joint.name in torsion, joint.name in bending)
            joint.child = chain[0].parent
            joints += chain
            links += [Link(name=virtual.parent) for virtual in chain]
    robot.links, robot.joints = links, joints
    for what, names in (("link", [link.name for link in links]), ("joint", [joint.name for joint in joints])):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"the flexible model needs the {what} name '{twice[0]}', but the robot already has it "
                "(is it flexible already?); rename it"
            )
    return with_robot(urdf, robot)


def _virtual_chain(joint: Any, twists: bool, bends: bool) -> list[Any]:
    """Virtual joints of a driving joint, the last one with its child; parents of all are new links."""
    kinds: list[tuple[str, str, Vector]] = []
    if twists:
        kinds.append((_TORSION, "prismatic" if joint.type == "prismatic" else "revolute", joint.axis))
    if bends:
        kinds += zip((_BEND_1, _BEND_2), ("revolute", "revolute"), bending_axes(joint.axis), strict=True)
    names = [f"{joint.name}_{kind}" for kind, _, _ in kinds]
    links = [f"{joint.name}_drive_link", *(f"{name}_link" for name in names[:-1]), joint.child]
    return [
        _virtual_joint(name, joint_type, parent, child, axis)
        for name, (_, joint_type, axis), (parent, child) in zip(names, kinds, pairwise(links), strict=True)
    ]


def _virtual_joint(name: str, joint_type: str, parent: str, child: str, axis: Vector) -> Any:
    from yourdfpy.urdf import Joint, Limit

    limit = Limit(effort=UNLIMITED, velocity=UNLIMITED, lower=-VIRTUAL_LIMIT, upper=VIRTUAL_LIMIT)
    return Joint(name=name, type=joint_type, parent=parent, child=child, axis=np.array(axis), limit=limit)


# --------------------------------------------------------------------------------------------- writing


def to_xml(urdf: yourdfpy.URDF) -> str:
    """The URDF as text, as `pinocchio.buildModelFromXML` takes it. Every number reads back as the same double.

    yourdfpy writes it, except what it would change: it resolves mesh names on this disk (here they stay as in the
    source), leaves out mimic, calibration and safety tags, and rounds the angles of origins (see `roll_pitch_yaw`).
    """
    import yourdfpy

    writer = yourdfpy.URDF(
        robot=urdf.robot, build_scene_graph=False, load_meshes=False, filename_handler=yourdfpy.filename_handler_null
    )
    root = writer.write_xml().getroot()
    for element, link in zip(root.findall("link"), urdf.robot.links, strict=True):
        if link.inertial is not None:
            _write_angles(element.find("inertial"), link.inertial.origin)
        for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for shape_element, shape in zip(element.findall(tag), shapes, strict=True):
                _write_angles(shape_element, shape.origin)
    for element, joint in zip(root.findall("joint"), urdf.robot.joints, strict=True):
        _write_angles(element, joint.origin)
        for tag in ("mimic", "calibration", "safety_controller"):
            if (part := getattr(joint, tag)) is not None:
                values = {key: _text(value) for key, value in vars(part).items() if value is not None}
                etree.SubElement(element, tag, attrib=values)
    text = etree.tostring(root, pretty_print=True, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}'


def write_urdf(urdf: yourdfpy.URDF, path: str | Path) -> None:
    """Write `to_xml` to a file (UTF-8), which is replaced as a whole or not at all.

    Raises
    ------
    ValueError
        If the path is no place for a file, or cannot be written.
    """
    from rx90b_flex.signals.single import write_file

    write_file(Path(path), to_xml(urdf))


def _write_angles(element: Any, origin: Vector | None) -> None:
    if origin is not None:
        element.find("origin").set("rpy", _text(roll_pitch_yaw(origin[:3, :3])))


# --------------------------------------------------------------------------------------------- helpers


def with_robot(urdf: yourdfpy.URDF, robot: Any) -> yourdfpy.URDF:
    """A URDF of another `yourdfpy.Robot`, its meshes where those of `urdf` are."""
    import yourdfpy

    # The handler knows the folder of the source file, by which meshes are found later; there is no public way to it.
    handler = getattr(urdf, "_filename_handler", None)
    return yourdfpy.URDF(robot=robot, build_scene_graph=False, load_meshes=False, filename_handler=handler)


def _fix(joint: Any, position: float) -> None:
    """Make a joint fixed where it stands at `position`. At zero the origin stays the same to the last bit."""
    if position != 0.0:
        origin = np.eye(4) if joint.origin is None else joint.origin
        motion = np.eye(4)
        axis = _unit(joint.axis)
        if joint.type == "prismatic":
            motion[:3, 3] = position * axis
        else:
            cross = np.cross(np.eye(3), axis)  # row i is e_i x a, that is minus the skew matrix transposed: S(a)
            motion[:3, :3] += math.sin(position) * cross + (1.0 - math.cos(position)) * cross @ cross
        joint.origin = origin @ motion
    joint.type = "fixed"
    joint.limit = joint.mimic = joint.dynamics = joint.calibration = joint.safety_controller = None


def _range(joint: Any) -> tuple[float, float]:
    """Lower and upper limit (rad, m); absent ones are zero, as the URDF specification says."""
    return joint.limit.lower or 0.0, joint.limit.upper or 0.0


def _joint(urdf: yourdfpy.URDF, name: str) -> Any:
    for joint in urdf.robot.joints:
        if joint.name == name:
            return joint
    raise ValueError(f"joint '{name}' does not exist; moving joints: {_list(moving_joints(urdf))}")


def _check_drivable(urdf: yourdfpy.URDF, names: Sequence[str], what: str) -> None:
    """Refuse names, given in the argument `what`, one of which is no joint with one coordinate of its own."""
    if isinstance(names, str):  # its letters would be taken for names
        raise ValueError(f"{what}: got the text {names!r}, expected a list of joint names")
    for name in names:
        try:
            joint = _joint(urdf, name)
        except ValueError as error:
            raise ValueError(f"{what}: {error}") from None
        if joint.mimic is not None:
            reason = f"mimics '{joint.mimic.joint}' and has no drive of its own"
        elif joint.type not in _MOVING_TYPES:
            reason = f"is {joint.type}"
        else:
            continue
        raise ValueError(f"{what}: joint '{name}' {reason}; moving joints: {_list(moving_joints(urdf))}")


def _unit(vector: npt.ArrayLike) -> Vector:
    """Scale to length one; what already has it, to rounding, stays the same to the last bit."""
    vector = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > 4 * np.finfo(float).eps:
        vector = vector / length
    return np.asarray(vector + 0.0)  # + 0.0 turns -0.0 into 0.0


def _text(value: str | float | Vector) -> str:
    """Numbers with as many digits as bring each double back; text as it is."""
    if isinstance(value, str):
        return value
    return " ".join(repr(float(number) + 0.0) for number in np.atleast_1d(value))  # + 0.0: no "-0.0"


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"
