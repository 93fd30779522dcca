"""Robots as SDF, the format of Gazebo.

Links that are fixed to each other are one link, the others frames of it; bendings and a base that tilts are joints with springs,
between links that weigh next to nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from lxml import etree  # type: ignore[import-untyped, unused-ignore]

from rx90b_flex.effects.motion import Array
from rx90b_flex.simulators.bodies import SMALLEST_MASS, Body, possible_body
from rx90b_flex.simulators.held import Format, Held, Lost, Port
from rx90b_flex.simulators.tree import Hinge, Node, numbers, tree_of
from rx90b_flex.written_angles import roll_pitch_yaw

SDF = Format("sdf", "SDF", rotors=False, springs=True, constants=False, pairs=False, gravity=False, lines=False)

VERSION = "1.8"  # poses relative to frames, and links relative to joints
_NOTHING = Body(SMALLEST_MASS, np.zeros(3), SMALLEST_MASS * np.eye(3))


def sdf_text(held: Held) -> tuple[str, tuple[Lost, ...]]:
    """A robot as SDF, and what beyond its effects the text does not hold.

    Raises
    ------
    ValueError
        A link that no body is.
    """
    root = etree.Element("sdf", version=VERSION)
    model = etree.SubElement(root, "model", name=held.robot.name)
    writer = _Writer(held, model)
    tree = tree_of(held.robot)
    fixed = etree.SubElement(model, "joint", name="fixed_to_the_world", type="fixed")
    if tree.hinges:
        raise ValueError(f"{held.robot.name}: the root link moves; expected one that stands")
    root_link = writer.link(tree.link, _NOTHING, None)
    _text(fixed, "parent", "world")
    _text(fixed, "child", root_link.get("name"))
    writer.fill(tree, root_link, np.eye(4))
    return etree.tostring(root, pretty_print=True, encoding="unicode"), tuple(writer.lost)


class _Writer:
    """Links, joints and frames of one model; their names must differ among each other."""

    def __init__(self, held: Held, model: Any) -> None:
        self.held, self.model = held, model
        self.lost: list[Lost] = []
        # joints keep their names, for controllers call them by these
        self.names = {"world", "fixed_to_the_world", *tuple(held.robot.model.names)[1:]}

    def name(self, wanted: str, kind: str) -> str:
        """A name that nothing else has."""
        found = wanted
        while found in self.names:
            found = f"{found}_{kind}"
        self.names.add(found)
        if found != wanted:
            why = f"this {kind} is called {found}: names of links, joints and frames differ in SDF"
            self.lost.append(Lost(wanted, why))
        return found

    def link(self, name: str, body: Body, joint: str | None) -> Any:
        """A link with its inertia, placed at the joint that carries it."""
        link = etree.SubElement(self.model, "link", name=self.name(name, "link"))
        if joint is not None:
            etree.SubElement(link, "pose", relative_to=joint).text = "0 0 0 0 0 0"
        inertial = etree.SubElement(link, "inertial")
        _text(inertial, "pose", numbers(np.r_[body.centre, 0.0, 0.0, 0.0]))
        _text(inertial, "mass", numbers(body.mass))
        inertia = etree.SubElement(inertial, "inertia")
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            _text(inertia, f"i{'xyz'[i]}{'xyz'[j]}", numbers(body.moments[i, j]))
        return link

    def fill(self, node: Node, link: Any, at: Array) -> None:
        """Shapes of a node that is (fixed to) a link, and what hangs on it."""
        for what, shapes in (("visual", node.visuals), ("collision", node.collisions)):
            for i, shape in enumerate(shapes):
                self._add_shape(link, f"{node.link}_{what}_{i}", what, shape, at)
        for child in node.children:
            placement = at @ child.placement
            if child.hinges:
                self._add_moving(child, link.get("name"), placement)
                continue
            frame = etree.SubElement(self.model, "frame", name=self.name(child.link, "frame"))
            frame.set("attached_to", link.get("name"))
            etree.SubElement(frame, "pose", relative_to=link.get("name")).text = _pose(placement)
            self.fill(child, link, placement)

    def _add_moving(self, node: Node, parent: str, placement: Array) -> None:
        body = _NOTHING
        if node.link in self.held.bodies:
            body, changed = possible_body(self.held.robot.name, node.link, self.held.bodies[node.link])
            self.lost += [] if changed is None else [changed]
        link = None
        for i, hinge in enumerate(node.hinges):
            last = i == len(node.hinges) - 1
            joint = self._add_joint(hinge, parent, placement)
            link = self.link(node.link if last else f"{hinge.name}_link", body if last else _NOTHING, joint.get("name"))
            _child_of(joint, link.get("name"))
            parent, placement = link.get("name"), np.eye(4)
        self.fill(node, link, np.eye(4))

    def _add_joint(self, hinge: Hinge, parent: str, placement: Array) -> Any:
        kind = "prismatic" if hinge.slides else "revolute"
        joint = etree.SubElement(self.model, "joint", name=hinge.name, type=kind)
        etree.SubElement(joint, "pose", relative_to=parent).text = _pose(placement)
        _text(joint, "parent", parent)
        axis = etree.SubElement(joint, "axis")
        _text(axis, "xyz", numbers(hinge.axis))
        limit = etree.SubElement(axis, "limit")
        lower, upper = hinge.limits or (-1e16, 1e16)  # SDF's own numbers for no limit
        for tag, value in (("lower", lower), ("upper", upper), ("effort", hinge.effort), ("velocity", hinge.speed)):
            if value is not None:
                _text(limit, tag, numbers(value))
        _add_dynamics(axis, self.held.on(hinge.coordinate))
        return joint

    def _add_shape(self, link: Any, name: str, what: str, shape: Any, at: Array) -> None:
        found = shape.geometry
        element = etree.SubElement(link, what, name=name)
        _text(element, "pose", _pose(at @ (np.eye(4) if shape.origin is None else shape.origin)))
        geometry = etree.SubElement(element, "geometry")
        for kind, sizes in (("box", ["size"]), ("cylinder", ["radius", "length"]), ("sphere", ["radius"])):
            plain = getattr(found, kind)
            if plain is not None:
                made = etree.SubElement(geometry, kind)
                for name_of_size in sizes:
                    _text(made, name_of_size, numbers(getattr(plain, name_of_size)))
        if found.mesh is not None:
            mesh = etree.SubElement(geometry, "mesh")
            _text(mesh, "uri", found.mesh.filename)
            if found.mesh.scale is not None:
                _text(mesh, "scale", numbers(np.broadcast_to(found.mesh.scale, 3)))


def _child_of(joint: Any, link: str) -> None:
    child = etree.Element("child")
    child.text = link
    joint.insert(2, child)


def _add_dynamics(axis: Any, port: Port) -> None:
    dynamics = etree.SubElement(axis, "dynamics")
    _text(dynamics, "damping", numbers(port.damping))
    _text(dynamics, "friction", numbers(port.friction))
    _text(dynamics, "spring_reference", numbers(port.rest if port.stiffness else 0.0))
    _text(dynamics, "spring_stiffness", numbers(port.stiffness))


def _pose(placement: Array) -> str:
    return numbers(np.r_[placement[:3, 3], roll_pitch_yaw(placement[:3, :3])])


def _text(parent: Any, tag: str, text: str) -> None:
    etree.SubElement(parent, tag).text = text
