"""Robots as MJCF, the format of MuJoCo.

All hinges of a joint are joints of one body, which MuJoCo applies in their order, so that no massless body stands between them.
A drive's inertia is the armature of its own hinge (Spong's assumption is MuJoCo's). What acts on two coordinates at once (friction
on drive and torsion, a motor that turns with two joints) is a fixed tendon with damper, spring, dry friction and armature of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from lxml import etree  # type: ignore[import-untyped, unused-ignore]
from scipy import linalg

from rx90b_flex.effects.motion import Array
from rx90b_flex.simulators.bodies import possible_body
from rx90b_flex.simulators.held import Format, Held, Lost, Port
from rx90b_flex.simulators.tree import Hinge, Node, numbers, rotation_quaternion, tree_of

MJCF = Format("mjcf", "MJCF", rotors=True, springs=True, constants=True, pairs=True, gravity=True, lines=True)

LONGEST_STEP = 2e-3  # s, MuJoCo's own
STEPS = 0.2  # step times the fastest mode's angular frequency: its frequency is right to 0.2 %
_SHAPES = ("box", "cylinder", "sphere")  # in both formats


def mjcf_text(held: Held) -> tuple[str, tuple[Lost, ...]]:
    """A robot as MJCF, and what beyond its effects the text does not hold.

    Raises
    ------
    ValueError
        A flexible drive without inertia; a link that no body is.
    """
    robot = held.robot
    robot.check_drives()
    root = etree.Element("mujoco", model=robot.name)
    etree.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    step = f"{_time_step(held):.3g}"
    etree.SubElement(root, "option", timestep=step, integrator="implicitfast", gravity=numbers(held.gravity))
    world = etree.SubElement(root, "worldbody")
    lost: list[Lost] = []
    tree = tree_of(robot)
    _add_body(world, tree, held, lost)
    meshes = sum(shape.geometry.mesh is not None for node in tree.walk() for shape in node.visuals)
    if meshes:
        lost.append(Lost("shapes", f"meshes are left out ({meshes}), for MuJoCo reads other files than URDFs name"))
    _add_tip(root, robot.tip_frame)
    _add_lines(root, held, tree)
    tendons = _add_tendons(root, held)
    _add_motors(root, held, tree, tendons)
    return etree.tostring(root, pretty_print=True, encoding="unicode"), tuple(lost)


def _body_name(link: str) -> str:
    return "world_link" if link == "world" else link  # MuJoCo's own body of that name is the world itself


def _add_body(parent: Any, node: Node, held: Held, lost: list[Lost]) -> None:
    body = etree.SubElement(parent, "body", name=_body_name(node.link), pos=numbers(node.placement[:3, 3]))
    if not np.array_equal(node.placement[:3, :3], np.eye(3)):
        body.set("quat", numbers(rotation_quaternion(node.placement[:3, :3])))
    for hinge in node.hinges:
        _add_joint(body, hinge, held.on(hinge.coordinate))
    if node.link in held.bodies:
        made, changed = possible_body(held.robot.name, node.link, held.bodies[node.link])
        moments, axes = made.principal()
        etree.SubElement(
            body, "inertial", pos=numbers(made.centre), quat=numbers(rotation_quaternion(axes)),
            mass=numbers(made.mass), diaginertia=numbers(moments),
        )  # fmt: skip
        lost += [] if changed is None else [changed]
    for shape in node.visuals:
        _add_shape(body, shape)
    for child in node.children:
        _add_body(body, child, held, lost)


def _add_joint(body: Any, hinge: Hinge, port: Port) -> None:
    joint = etree.SubElement(
        body, "joint", name=hinge.name, type="slide" if hinge.slides else "hinge", axis=numbers(hinge.axis)
    )
    if hinge.limits is not None:
        joint.set("range", numbers(hinge.limits))
    _set_passive(joint, port)
    if port.stiffness:
        joint.set("springref", numbers(port.rest))


def _set_passive(element: Any, port: Port) -> None:
    """What a joint and a tendon have alike."""
    for key, value in (
        ("armature", port.inertia), ("damping", port.damping), ("frictionloss", port.friction), ("stiffness", port.stiffness),
    ):  # fmt: skip
        if value:
            element.set(key, numbers(value))


def _add_shape(body: Any, shape: Any) -> None:
    """A visual as a geom that touches nothing and weighs nothing; a mesh is left out, for MuJoCo reads other files."""
    kind = next((k for k in _SHAPES if getattr(shape.geometry, k) is not None), None)
    if kind is None:
        return
    found = getattr(shape.geometry, kind)
    if kind == "box":
        size = 0.5 * np.asarray(found.size, dtype=float)
    else:
        size = np.array([found.radius, 0.5 * found.length] if kind == "cylinder" else [found.radius])
    origin = np.eye(4) if shape.origin is None else shape.origin
    geom = etree.SubElement(body, "geom", type=kind, size=numbers(size), pos=numbers(origin[:3, 3]))
    geom.set("quat", numbers(rotation_quaternion(origin[:3, :3])))
    geom.attrib.update({"contype": "0", "conaffinity": "0", "group": "2", "mass": "0"})
    colour = shape.material.color.rgba if shape.material is not None and shape.material.color is not None else None
    if colour is not None:
        geom.set("rgba", numbers(colour))


def _add_tip(root: Any, name: str) -> None:
    """A site where the robot file says that the tip is."""
    body = root.find(f".//body[@name='{_body_name(name)}']")
    if body is not None:
        body.append(etree.Element("site", name=name, size="0.01"))


def _add_lines(root: Any, held: Held, tree: Node) -> None:
    """Springs between two points as spatial tendons between sites."""
    drives = {h.coordinate: node for node in tree.walk() for h in node.hinges}
    for i, line in enumerate(held.lines):
        node = drives[f"{line.joint}:drive"]
        behind = root.find(f".//body[@name='{_body_name(node.link)}']")
        before = node.placement[:3, :3] @ line.fixed + node.placement[:3, 3]
        ends = (f"{line.joint}_spring_{i}_fixed", f"{line.joint}_spring_{i}_moving")
        etree.SubElement(behind.getparent(), "site", name=ends[0], pos=numbers(before), size="0.01")
        etree.SubElement(behind, "site", name=ends[1], pos=numbers(line.moving), size="0.01")
        spring = etree.SubElement(_section(root, "tendon"), "spatial", name=f"{line.joint}_spring_{i}")
        spring.set("stiffness", numbers(line.stiffness))
        spring.set("springlength", numbers(line.rest_m))
        for end in ends:
            etree.SubElement(spring, "site", site=end)


def _add_tendons(root: Any, held: Held) -> dict[str, Port]:
    """Combinations of coordinates as fixed tendons; by name."""
    names = dict(zip(held.robot.coordinates, tuple(held.robot.model.names)[1:], strict=True))
    made: dict[str, Port] = {}
    for port in held.ports:
        values = (port.inertia, port.damping, port.stiffness, port.friction, port.constant)
        if port.coordinate is not None or not any(values):
            continue
        name = "_and_".join(names[c] for c, _ in port.weights)
        made[name] = port
        tendon = etree.SubElement(_section(root, "tendon"), "fixed", name=name)
        _set_passive(tendon, port)
        if port.stiffness:
            # a length of -1 alone would mean: as long as at the start
            rest = port.rest if port.rest != -1.0 else np.nextafter(-1, 0)
            tendon.set("springlength", numbers([rest, rest]))
        for coordinate, factor in port.weights:
            etree.SubElement(tendon, "joint", joint=names[coordinate], coef=numbers(factor))
    return made


def _add_motors(root: Any, held: Held, tree: Node, tendons: dict[str, Port]) -> None:
    """A motor a drive, whose control is its torque (N m); constant torques are its bias."""
    actuators = _section(root, "actuator")
    for node in tree.walk():
        for hinge in node.hinges:
            if not hinge.coordinate.endswith(":drive"):
                continue
            port = held.on(hinge.coordinate)
            constant = 0.0 if port.stiffness else port.constant
            motor = etree.SubElement(actuators, "general", name=hinge.name, joint=hinge.name, gainprm="1")
            if hinge.effort is not None:
                motor.set("ctrlrange", numbers([-hinge.effort, hinge.effort]))
            if constant:
                motor.attrib.update({"biastype": "affine", "biasprm": numbers([-constant, 0.0, 0.0])})
    for name, port in tendons.items():
        if port.constant and not port.stiffness:
            offset = etree.SubElement(actuators, "general", name=f"{name}_offset", tendon=name, gainprm="0")
            offset.attrib.update({"biastype": "affine", "biasprm": numbers([-port.constant, 0.0, 0.0])})


def _section(root: Any, name: str) -> Any:
    found = root.find(name)
    return etree.SubElement(root, name) if found is None else found


def _time_step(held: Held) -> float:
    """Short enough for the fastest mode of links on springs."""
    robot = held.robot
    places = {name: i for i, name in enumerate(robot.coordinates)}
    stiffness: Array = np.zeros((len(places), len(places)))
    for port in held.ports:
        row = np.zeros(len(places))
        for name, factor in port.weights:
            row[places[name]] = factor
        stiffness += port.stiffness * np.outer(row, row)
    if not stiffness.any():
        return LONGEST_STEP
    fastest = float(np.abs(linalg.eigvals(stiffness, robot.mass_matrix(np.zeros(robot.model.nv)))).max()) ** 0.5
    return min(LONGEST_STEP, STEPS / fastest)
