"""A flexible robot in MuJoCo, built from its rigid URDF without the package: XML, placing and inertias are read here.

The virtual hinges are placed here too, so that an engine of this kind checks the flexible tree as well as its dynamics.
All hinges of a joint are joints of one MuJoCo body, which applies them in their order; there are no massless bodies.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Where MuJoCo puts a body's mass at first. Off centre and turned: it has short cuts for bodies whose mass is neither,
# and chooses them once, before the true inertias are written.
_STAND_IN = {"mass": "1", "pos": "0.1 0.2 0.3", "quat": "0.5 0.1 -0.7 0.3", "diaginertia": "1 1.1 1.2"}


class Engine:
    """Dynamics of a URDF with flexible joints.

    Parameters
    ----------
    urdf : str
        XML of the rigid robot. Joints that mimic others stand still at zero.
    torsion, bending : names of joints
        Whose drive twists and who bends.
    base : bool
        Whether the root link tilts about its x and its y.
    armature, stiffness, damping : by coordinate (``joint_1:torsion``), zero where absent
        A drive that twists needs armature, its inertia: without it, drive and torsion are one motion of the links, and
        MuJoCo, which factorises the mass matrix in any case, warns that it is singular.
    """

    def __init__(
        self,
        urdf: str,
        torsion: Collection[str] = (),
        bending: Collection[str] = (),
        base: bool = False,
        armature: Mapping[str, float] | None = None,
        stiffness: Mapping[str, float] | None = None,
        damping: Mapping[str, float] | None = None,
    ) -> None:
        root = ElementTree.fromstring(urdf)
        links = {link.get("name", ""): link for link in root.findall("link")}
        joints = root.findall("joint")
        mjcf = ElementTree.Element("mujoco")
        ElementTree.SubElement(mjcf, "compiler", angle="radian", autolimits="false")
        ElementTree.SubElement(mjcf, "option", gravity="0 0 -9.81")
        bodies = {name: ElementTree.Element("body", name=f"link:{name}") for name in links}  # MuJoCo has a "world"
        (first,) = set(links) - {_end(joint, "child") for joint in joints}
        ElementTree.SubElement(mjcf, "worldbody").append(bodies[first])
        if base:
            _add_joint(bodies[first], "base:bend_1", "hinge", np.array([1.0, 0.0, 0.0]))
            _add_joint(bodies[first], "base:bend_2", "hinge", np.array([0.0, 1.0, 0.0]))
        for joint in joints:
            body = bodies[_end(joint, "child")]
            bodies[_end(joint, "parent")].append(body)
            place, rpy = _origin(joint)
            body.set("pos", _text(place))
            body.set("quat", _text(_quaternion(rpy)))
            if joint.get("type") == "fixed" or joint.find("mimic") is not None:
                continue
            name = joint.get("name", "")
            along = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}[joint.get("type", "")]
            tag = joint.find("axis")
            axis = _numbers("1 0 0" if tag is None else tag.get("xyz", ""))
            axis /= np.linalg.norm(axis)
            _add_joint(body, f"{name}:drive", along, axis)
            if name in torsion:
                _add_joint(body, f"{name}:torsion", along, axis)
            if name in bending:
                across = np.roll(np.eye(3)[np.argmax(np.abs(axis))], 1)
                across = across - (across @ axis) * axis
                across /= np.linalg.norm(across)
                _add_joint(body, f"{name}:bend_1", "hinge", across)
                _add_joint(body, f"{name}:bend_2", "hinge", np.cross(axis, across))
        for joint in mjcf.iter("joint"):
            for key, values in (("armature", armature), ("stiffness", stiffness), ("damping", damping)):
                joint.set(key, repr((values or {}).get(joint.get("name", ""), 0.0)))
        for body in bodies.values():
            ElementTree.SubElement(body, "inertial", _STAND_IN)

        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(mjcf, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        for name, link in links.items():
            self._set_inertia(self.model.body(f"link:{name}").id, link.find("inertial"))
        self.coordinates = tuple(self.model.joint(i).name for i in range(self.model.njnt))
        mujoco.mj_setConst(self.model, self.data)

    def _set_inertia(self, body: int, inertial: ElementTree.Element | None) -> None:
        """Write a link's inertia as it is: MuJoCo's compiler would refuse, or change, those of table D.1."""
        model = self.model
        model.body_mass[body], model.body_inertia[body] = 0.0, 0.0
        if inertial is None:
            return
        mass, tensor = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None and tensor is not None
        xx, yy, zz, xy, xz, yz = (float(tensor.get(key, "")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
        principal, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        place, rpy = _origin(inertial)
        within, turned, frame = np.empty(4), np.empty(4), _quaternion(rpy)
        mujoco.mju_mat2Quat(within, axes.ravel())
        mujoco.mju_mulQuat(turned, frame, within)
        model.body_mass[body] = float(mass.get("value", ""))
        model.body_inertia[body] = principal
        model.body_ipos[body] = place
        model.body_iquat[body] = turned / np.linalg.norm(turned)

    def principal_inertia(self, link: str) -> Array:
        """Principal moments of inertia of a link, ascending, kg m^2."""
        return np.sort(self.model.body(f"link:{link}").inertia)

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrix with drive inertias, in the order of `coordinates`."""
        self.data.qpos[:] = q
        mujoco.mj_fwdPosition(self.model, self.data)
        mass = np.empty((self.model.nv, self.model.nv))
        for row, unit in zip(mass, np.eye(self.model.nv), strict=True):
            mujoco.mj_mulM(self.model, self.data, row, unit)
        return mass

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Generalised forces, in the order of `coordinates`."""
        self.data.qpos[:], self.data.qvel[:], self.data.qacc[:] = q, v, a
        mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse.copy()


def _add_joint(body: ElementTree.Element, name: str, kind: str, axis: Array) -> None:
    ElementTree.SubElement(body, "joint", name=name, type=kind, axis=_text(axis))


def _end(joint: ElementTree.Element, which: str) -> str:
    tag = joint.find(which)
    assert tag is not None
    return tag.get("link", "")


def _origin(element: ElementTree.Element) -> tuple[Array, Array]:
    """Position and roll, pitch, yaw."""
    tag = element.find("origin")
    if tag is None:
        return np.zeros(3), np.zeros(3)
    return _numbers(tag.get("xyz", "0 0 0")), _numbers(tag.get("rpy", "0 0 0"))


def _quaternion(rpy: Array) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), scalar first."""
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in zip(np.eye(3), rpy, strict=True):
        turned = np.empty(4)
        mujoco.mju_mulQuat(turned, np.r_[math.cos(angle / 2), math.sin(angle / 2) * axis], turn)
        turn = turned
    return turn


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _text(numbers: Array) -> str:
    return " ".join(repr(float(x)) for x in numbers)
