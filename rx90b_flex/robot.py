"""A robot: a rigid tree plus a list of effects, and the dynamics that follow from it."""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from rx90b_flex import flexify as virtual
from rx90b_flex import tree_derivatives
from rx90b_flex.default_tip import default_tip
from rx90b_flex.effects import Coordinates, Effect, Motion, close_match, effect_from_table
from rx90b_flex.effects.effect import shared_shapes
from rx90b_flex.effects.elements import PointMass
from rx90b_flex.effects.motion import Array
from rx90b_flex.files.keys import check_keys
from rx90b_flex.files.toml import named_in, read_toml
from rx90b_flex.joint_units import SLIDES, TURNS, JointUnits, any_of
from rx90b_flex.linearize import Linearization, check_one, joint_angle_transform, linearize

if TYPE_CHECKING:
    from rx90b_flex.plant import Plant

LINK_PARAMETERS = ("mass", "s_x", "s_y", "s_z", "J_xx", "J_yy", "J_zz", "J_xy", "J_xz", "J_yz")
LINK_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)
# pinocchio's order is m, s, then J as xx xy yy xz yz zz
_TO_TABLE_ORDER = np.array([0, 1, 2, 3, 4, 6, 9, 5, 7, 8])

LARGEST_INERTIA = 1e9  # kg, kg m or kg m^2 of a link: none is larger
ROBOT_KEYS = ("name", "urdf", "tip_frame", "inertial_parameters", "controller", "effects")


@dataclass(frozen=True)
class ParameterEntry:
    """One entry of a robot's parameter vector: its name, its unit, and where it comes from."""

    name: str
    unit: str
    source: int  # index of the effect, or -1 for a link
    column: int  # coefficient of that effect, or column of the links' regressor


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A rigid tree and its effects.

    Attributes
    ----------
    name : str
    urdf : str
        XML of the rigid tree; every moving joint has one coordinate.
    tip_frame : str
    inertial_parameters : str
        ``fitted`` or ``known``: whether identification may change the links.
    effects : tuple of Effect
    controller : str
        Its controller file, or the name of one in `robots_folder()`; empty where none is stated.
    followers : tuple of (joint, leader)
        Joints that mimic another in the URDF that was read; in `urdf` they are fixed.
    """

    name: str
    urdf: str
    tip_frame: str
    inertial_parameters: str
    effects: tuple[Effect, ...]
    controller: str = ""
    followers: tuple[tuple[str, str], ...] = ()

    def __repr__(self) -> str:
        count = len(self.effects)
        return f"<Robot {self.name!r}: {len(self.joints)} joints, {len(self.coordinates)} coordinates, {count} effects>"

    # ---- structure --------------------------------------------------------------------------------------

    @cached_property
    def tree(self) -> pin.Model:
        """The rigid tree."""
        return pin.buildModelFromXML(self.urdf)

    @cached_property
    def flexible_urdf(self) -> str:
        """XML of the tree with a virtual joint for every flexibility; the same as `urdf` where there is none."""
        torsion, bending, base = self.flexible_places()
        if not (torsion or bending or base):
            return self.urdf
        rigid = virtual.read_xml(self.urdf)
        return virtual.to_xml(virtual.flexify(rigid, torsion, bending, base))

    def flexible_places(self) -> tuple[list[str], list[str], bool]:
        """Joints whose drive twists, joints that bend, and whether the base tilts."""
        torsion = [e.joints[0] for e in self.effects if "torsion" in e.traits.virtual]
        bending = [e.joints[0] for e in self.effects if "bend_1" in e.traits.virtual and e.joints]
        base = any("bend_1" in e.traits.virtual and not e.joints for e in self.effects)
        return torsion, bending, base

    @cached_property
    def model(self) -> pin.Model:
        """Pinocchio model of the flexible tree (of the rigid one where nothing is flexible)."""
        return pin.buildModelFromXML(self.flexible_urdf)

    @cached_property
    def _data(self) -> pin.Data:
        return self.model.createData()

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Driven joints in tree order."""
        return tuple(self.tree.names)[1:]

    @cached_property
    def units(self) -> tuple[JointUnits, ...]:
        """Of each driven joint: rad and N m where it turns, m and N where it slides."""
        kinds = [joint.shortname() for joint in self.tree.joints][1:]
        return tuple(SLIDES if kind.startswith("JointModelP") else TURNS for kind in kinds)

    def units_of(self, joints: Sequence[str]) -> tuple[JointUnits, ...]:
        """Of some driven joints."""
        return tuple(self.units[self.joints.index(joint)] for joint in joints)

    def force_unit(self, joints: Sequence[str]) -> str:
        """Of all torques and forces of some driven joints."""
        return any_of(u.force for u in self.units_of(joints))

    def unit_of(self, effect: Effect, unit: str) -> str:
        """The unit of an effect's parameter on this robot, from the one that it has on a joint that turns."""
        if len(effect.joints) != 1 or "bend_1" in effect.traits.virtual:
            return unit
        return self.units[self.joints.index(effect.joints[0])].of(unit)

    def values_of(self, effect: Effect) -> list[tuple[str, str, float]]:
        """`Effect.public_values` with their units on this robot; a phase is one of a cycle, whatever moves."""
        shown = effect.public_values()
        return [(name, unit if name == "phase" else self.unit_of(effect, unit), value) for name, unit, value in shown]

    def pose_of(self, given: Sequence[float], name: str = "pose") -> list[float]:
        """A pose as people give it, degrees and for sliding joints m, in rad and m."""
        if len(given) != len(self.joints) or not np.isfinite(given).all():
            each = ", ".join(f"{joint} ({unit.given})" for joint, unit in zip(self.joints, self.units, strict=True))
            said = ",".join(f"{x:g}" for x in given)
            raise ValueError(f"{name}: found {said}; expected {len(self.joints)} finite numbers, one a joint: {each}")
        return [float(x) / unit.scale for x, unit in zip(given, self.units, strict=True)]

    @cached_property
    def layout(self) -> Coordinates:
        """Names and places of the generalised coordinates."""
        names = tuple(virtual.coordinate_name(name, self.joints) for name in tuple(self.model.names)[1:])
        return Coordinates(names)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the generalised coordinates, one a degree of freedom, in tree order."""
        return self.layout.names

    @cached_property
    def input_matrix(self) -> Array:
        """B of equation 3.65: puts the drive torques into the drives' rows; shape (n, joints)."""
        return np.stack([self.layout.port(j, "drive") for j in self.joints], axis=1)

    @cached_property
    def bodies(self) -> tuple[tuple[str, int], ...]:
        """Moving bodies with mass: name of the link and index of the joint that carries it, in tree order."""
        found: dict[int, str] = {}
        for frame in self.model.frames:
            if frame.type == pin.FrameType.BODY and frame.parentJoint not in found and frame.parentJoint > 0:
                found[frame.parentJoint] = frame.name
        carrying = (j for j in range(1, self.model.njoints) if not _is_intermediate(self.layout.names, j - 1))
        return tuple((found[j], j) for j in carrying)

    @cached_property
    def forces(self) -> tuple[Effect, ...]:
        """The effects that are forces of the robot; the others stand between it and the log."""
        return tuple(e for e in self.effects if e.traits.in_dynamics)

    @cached_property
    def plant(self) -> Plant:
        """Tree and effects as arrays for compiled code, made once."""
        from rx90b_flex.plant import plant_of  # here, since loading the compiler takes half a second

        rest = np.zeros(self.model.nv)
        drives = np.argmax(self.input_matrix, axis=0).astype(np.int64)
        return plant_of(self.model, self.forces, self.motion(rest, rest, rest), drives)

    # ---- parameters -------------------------------------------------------------------------------------

    @cached_property
    def parameter_entries(self) -> tuple[ParameterEntry, ...]:
        """Entries of the parameter vector: links first, then effects in the order of table D.1."""
        keyed: list[tuple[tuple[int, int, int, int], ParameterEntry]] = []
        for b, (link, _) in enumerate(self.bodies):
            for c, (name, unit) in enumerate(zip(LINK_PARAMETERS, LINK_UNITS, strict=True)):
                keyed.append(((0, b, 0, c), ParameterEntry(f"{link}.{name}", unit, -1, 10 * b + c)))
        order = {joint: i for i, joint in enumerate(self.joints)}
        labels: dict[str, int] = {}
        for e, effect in enumerate(self.forces):
            seen = labels[effect.label] = labels.get(effect.label, 0) + 1
            label = effect.label if seen == 1 else f"{effect.label}_{seen}"
            at = order.get(effect.joints[-1], -1) if effect.joints else -1
            for c, (name, p) in enumerate(effect.coefficient_parameters.items()):
                keyed.append(
                    ((p.rank, at, e, c), ParameterEntry(f"{label}.{name}", self.unit_of(effect, p.unit), e, c))
                )
        return tuple(entry for _, entry in sorted(keyed, key=lambda pair: pair[0]))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the linear parameters, in the order of the regressor's columns."""
        return tuple(entry.name for entry in self.parameter_entries)

    @cached_property
    def link_parameters(self) -> Array:
        """Inertial parameters of the moving bodies about their joints, ten a body in table D.1's order."""
        return np.concatenate(
            [self.model.inertias[joint].toDynamicParameters()[_TO_TABLE_ORDER] for _, joint in self.bodies]
        )

    @cached_property
    def _effect_places(self) -> list[list[int]]:
        """Columns of each effect's coefficients in the regressor."""
        places: list[list[int]] = [[0] * len(effect.coefficient_parameters) for effect in self.forces]
        for i, entry in enumerate(self.parameter_entries):
            if entry.source >= 0:
                places[entry.source][entry.column] = i
        return places

    @cached_property
    def link_parameter_places(self) -> Array:
        """Where each link parameter stands in pinocchio's vector of ten a joint, shape (10 * bodies,)."""
        return np.concatenate([10 * (joint - 1) + _TO_TABLE_ORDER for _, joint in self.bodies])

    @cached_property
    def parameters(self) -> Array:
        """Values of the linear parameters, shape (p,); NaN where a robot file leaves one out."""
        per_effect = [effect.coefficients for effect in self.forces]
        per_effect.append(self.link_parameters)  # the last, as -1 says
        return np.array([per_effect[entry.source][entry.column] for entry in self.parameter_entries])

    # ---- dynamics ---------------------------------------------------------------------------------------

    def motion(self, q: Array, v: Array, a: Array, time: Array | None = None) -> Motion:
        """Put samples of motion, each (n,) or (N, n), into the form that effects read."""
        n = self.model.nv
        arrays = [np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, v, a)]
        samples = max(x.shape[0] for x in arrays)
        for name, x in zip(("q", "v", "a"), arrays, strict=True):
            if x.ndim != 2 or x.shape[1] != n or x.shape[0] not in (1, samples):
                raise ValueError(f"{name} has shape {np.shape(x)}; expected ({n},) or (N, {n}) for {self.name}")
        q, v, a = (np.ascontiguousarray(np.broadcast_to(x, (samples, n))) for x in arrays)
        t = np.zeros(samples) if time is None else np.asarray(time, dtype=float)
        return Motion(self.layout, q, v, a, t, partial(_RobotTreeMotion, self))

    def on_links(self, motion: Motion, link_parameters: Array, effects: Sequence[Effect] = ()) -> Motion:
        """The same motion of the same tree with other link parameters and effects, as an identification finds them."""
        known = tuple(e for e in effects if e.traits.in_dynamics and e.known)
        tree = partial(_on_links, self, motion, link_parameters, known)
        return motion.seen_by(tree, known)

    def link_regressor(self, motion: Motion, columns: int = 0) -> Array:
        """Regressor of the links alone, shape (N, n, 10 * bodies), or of so many `columns`, those behind them zero."""
        from rx90b_flex.plant import columns_of_links

        return columns_of_links(self.model, [joint for _, joint in self.bodies], motion, columns)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Inverse dynamics per unit of each parameter (equations 3.85-3.87).

        Parameters
        ----------
        q, v, a : array, shape (n,) or (N, n)

        Returns
        -------
        array, shape (n, p) or (N, n, p)
            ``regressor @ parameters == inverse_dynamics``; columns are `parameter_names`.
        """
        motion = self.motion(q, v, a)
        out = self.link_regressor(motion, len(self.parameter_entries))  # links come first in their order
        for effect, at in zip(self.forces, self._effect_places, strict=True):
            factors = effect.factors(motion)
            if factors is None:
                out[:, :, at] = effect.columns(motion)
                continue
            port, basis = factors
            for row in np.flatnonzero(port):
                out[:, row, at] = port[row] * basis
        return out if 2 in (np.ndim(q), np.ndim(v), np.ndim(a)) else out[0]

    def inverse_dynamics(self, q: Array, v: Array, a: Array, time: Array | None = None) -> Array:
        """Generalised forces for a motion, every declared effect included (left side of equation 3.65).

        Parameters
        ----------
        q, v, a : array, shape (n,) or (N, n)
            Coordinates in the order of `coordinates`; rad, rad/s, rad/s^2.
        time : array, shape (N,), optional
            Seconds, where the samples are one motion: effects that remember it, such as friction at rest, need to know.

        Returns
        -------
        array, shape (n,) or (N, n)
            N m; for a consistent motion the rows of flexible coordinates are zero.

        Raises
        ------
        ValueError
            Shapes that do not fit the robot or each other; times that do not increase.
        """
        motion = self.motion(q, v, a, time)
        if motion.time.shape != (len(motion.q),) or (time is not None and not (np.diff(motion.time) > 0.0).all()):
            raise ValueError(f"time has shape {motion.time.shape}; expected ({len(motion.q)},), increasing")
        force = self.link_torque(motion)
        for effect in self.forces:
            force = force + effect.force(motion)
        return force if 2 in (np.ndim(q), np.ndim(v), np.ndim(a)) else force[0]

    def link_torque(self, motion: Motion) -> Array:
        """Inverse dynamics of the links alone, shape (N, n), N m."""
        out = np.empty_like(motion.q)
        model, data, rnea = self.model, self._data, pin.rnea
        for k, (q, v, a) in enumerate(zip(motion.q, motion.v, motion.a, strict=True)):
            out[k] = rnea(model, data, q, v, a)
        return out

    def linearize(self, q: Array, v: Array | None = None, a: Array | None = None) -> Linearization:
        """Small motions about a point of a trajectory (equations 3.88-3.94), analytically.

        Parameters
        ----------
        q, v, a : array, shape (n,)
            Coordinates, rates and accelerations; at rest where v and a are not given. Friction at rest has its steep
            slope at reversal, which holds the drives: linearise with a velocity to see them move. A ValueError names a
            wrong shape, or an effect without a value.
        """
        q = np.asarray(q, dtype=float)
        rest = np.zeros_like(q)
        v, a = (rest if x is None else x for x in (v, a))
        check_one(self.model.nv, q=q, v=v, a=a)
        moving = self.motion(q, v, a)
        return linearize(self.forces, moving, self.motion(q, rest, rest), self.joints, self.input_matrix)

    def energy(self, q: Array, v: Array) -> float:
        """Kinetic and potential energy of links and effects, J; zero potential where pinocchio and the effects have it.

        Without friction, damping and drive torque it stays the same along a motion.
        """
        q, v = (np.asarray(x, dtype=float) for x in (q, v))
        motion = self.motion(q, v, np.zeros_like(q))
        energy = 0.5 * v @ self.mass_matrix(q) @ v + pin.computePotentialEnergy(self.model, self._data, q)
        return float(energy + sum(effect.potential(motion)[0] for effect in self.forces))

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrix of links and drives at q, shape (n,): shape (n, n), kg m^2. A ValueError names a wrong shape."""
        check_one(self.model.nv, q=q)
        motion = self.motion(q, *np.zeros((2, self.model.nv)))
        mass = pin.crba(self.model, self._data, motion.q[0])
        mass = np.triu(mass) + np.triu(mass, 1).T
        for effect in self.forces:
            if effect.traits.adds_inertia:
                mass = mass + effect.derivatives(motion)[2][0]
        return mass

    def forward_dynamics(self, q: Array, v: Array, drive_torque: Array) -> Array:
        """Accelerations under given drive torques (equation 3.65 solved for the accelerations).

        Parameters
        ----------
        q, v : array, shape (n,)
        drive_torque : array, shape (joints,)
            N m, joint side, in the order of `joints`.

        Returns
        -------
        array, shape (n,), rad/s^2

        Raises
        ------
        ValueError
            A wrong shape; a flexible drive without inertia; load friction that no acceleration agrees with.
        """
        self.check_drives()
        torque = np.asarray(drive_torque, dtype=float)
        if torque.shape != (len(self.joints),):
            raise ValueError(f"drive_torque has shape {torque.shape}; expected ({len(self.joints)},) for {self.name}")
        if not self.plant.others:
            return self._compiled_forward_dynamics(q, v, torque)
        force = self.input_matrix @ torque
        a = np.zeros(self.model.nv)
        mass = self.mass_matrix(q)
        loaded = [effect for effect in self.forces if effect.traits.needs_load]
        for _ in range(50):
            short = force - self.inverse_dynamics(q, v, a)
            if not loaded:
                return a + np.linalg.solve(mass, short)
            # friction that grows with the load holds the acceleration too: Newton steps, exact between sign changes
            motion = self.motion(q, v, a)
            slope = mass + sum(effect.derivatives(motion)[2][0] for effect in loaded)
            step = np.linalg.solve(slope, short)
            a = a + step
            if np.abs(step).max() <= 1e-9 * (1.0 + np.abs(a).max()):
                return a
        raise ValueError(f"{self.name}: forward dynamics found no acceleration consistent with the load friction")

    @cached_property
    def weightless_drives(self) -> tuple[str, ...]:
        """Joints whose drive turns apart from its link but has no inertia of its own."""
        transform, _ = joint_angle_transform(self.coordinates)
        mass = np.diag(transform.T @ self.mass_matrix(np.zeros(self.model.nv)) @ transform)
        twisting = [j for j in self.joints if self.layout.index(j, "torsion") is not None]
        return tuple(j for j in twisting if mass[self.layout.names.index(f"{j}:drive")] <= 1e-12 * mass.max())

    def check_drives(self) -> None:
        """Raise a ValueError where a drive that turns apart from its link has no inertia to be moved."""
        if self.weightless_drives:
            names = ", ".join(self.weightless_drives)
            raise ValueError(f"{self.name}: a flexible drive needs a drive_inertia to move; none at {names}")

    def _compiled_forward_dynamics(self, q: Array, v: Array, torque: Array) -> Array:
        q, v = np.ascontiguousarray(q, dtype=float), np.ascontiguousarray(v, dtype=float)
        n = self.plant.tree.parent.shape  # asking the model would take longer
        if q.shape != n or v.shape != n:
            raise ValueError(f"q and v have shapes {q.shape} and {v.shape}; expected {n} for {self.name}")
        a = self.plant.accelerations(q, v, np.ascontiguousarray(torque))
        if not math.isfinite(a[0]):  # the substitution ends there and carries along what is not finite
            raise ValueError(f"{self.name}: no accelerations: singular mass matrix, or q, v or drive_torque not finite")
        return a

    # ---- other robots from this one ---------------------------------------------------------------------

    def with_effects(self, effects: Iterable[Effect]) -> Robot:
        """The same tree with other effects.

        Raises
        ------
        ValueError
            One on a joint or a frame that the robot does not have.
        """
        effects = tuple(effects)
        for effect in effects:
            for joint in effect.joints:
                if joint not in self.joints:
                    raise ValueError(f"{effect.label}: unknown joint {joint!r}; {close_match(joint, self.joints)}")
            for frame in effect.place if effect.traits.on == "frame" else ():
                if not self.tree.existFrame(frame):
                    frames = [f.name for f in self.tree.frames]
                    raise ValueError(f"{effect.label}: unknown frame {frame!r}; {close_match(frame, frames)}")
        return dataclasses.replace(self, effects=effects)

    def rigid(self) -> Robot:
        """The robot without the effects that add coordinates."""
        return self.with_effects([e for e in self.effects if not e.traits.virtual])

    def over_time(self) -> Robot:
        """The robot as measured motors show it over time: a rigid tree, with what stands there for coordinates that it lacks."""
        standing = [e for e in (x.on_rigid_tree() for x in self.effects) if e is not None]
        there = {(e.type_name(), e.place) for e in standing}
        supported = (e for e in standing if not e.traits.needs or there & {(n, e.place) for n in e.traits.needs})
        return self.with_effects(supported)

    def restricted(self, joints: Sequence[str]) -> Robot:
        """The robot with all joints but these held at their neutral position; effects on held joints go with them."""
        for joint in joints:
            if joint not in self.joints:
                raise ValueError(f"unknown joint {joint!r} for robot {self.name}; {close_match(joint, self.joints)}")
        if set(joints) == set(self.joints):
            return self
        urdf = virtual.to_xml(virtual.lock(virtual.read_xml(self.urdf), joints))
        kept = [e for e in self.effects if set(e.joints) <= set(joints)]
        return dataclasses.replace(self, urdf=urdf, effects=tuple(kept))


def _is_intermediate(names: Sequence[str], place: int) -> bool:
    """Whether the body behind this coordinate is massless: the next coordinate belongs to the same joint."""
    joint, kind = names[place].rsplit(":", 1)
    last = place + 1 >= len(names) or names[place + 1].rsplit(":", 1)[0] != joint
    return not last and kind in ("drive", "torsion", "bend_1")


@dataclass(frozen=True)
class _RobotTreeMotion:
    """The tree's view of a motion, for effects (`rx90b_flex.effects.TreeMotion`).

    With `link_parameters` the links are those, whether or not a body could have them; with `carried` the masses on them
    are those of these effects, and not of the robot's own.
    """

    robot: Robot
    motion: Motion
    link_parameters: Array | None = None
    bodies: dict[str, Array] = field(default_factory=dict, repr=False)
    hinged: dict[tuple[Effect, ...], Motion] = field(default_factory=dict, repr=False)
    carried: tuple[Effect, ...] | None = None

    def link_regressor(self) -> Array:
        return self.robot.link_regressor(self.motion)

    def load(self) -> Array:
        return self._load

    @cached_property
    def _load(self) -> Array:
        if self.link_parameters is None:
            return self.robot.link_torque(self.motion)
        from rx90b_flex.plant import torque_of_links

        bodies = [joint for _, joint in self.robot.bodies]
        return torque_of_links(self.robot.model, bodies, self.link_parameters, self.motion)

    def gravity_torque(self, direction: Array, *, laden: bool = False) -> Array:
        return self._in_each_pose(pin.computeGeneralizedGravity, *self._under_gravity(direction, laden))

    def gravity_derivative(self, direction: Array, *, laden: bool = False) -> Array:
        return tree_derivatives.of_gravity(self._under_gravity(direction, laden)[0], self.motion.q)

    def gravity_potential(self, direction: Array, *, laden: bool = False) -> Array:
        return self._in_each_pose(pin.computePotentialEnergy, *self._under_gravity(direction, laden))

    def _in_each_pose(self, asked: Callable[..., Any], model: pin.Model, data: pin.Data) -> Array:
        return np.array([asked(model, data, q) for q in self.motion.q])

    def _under_gravity(self, direction: Array, laden: bool) -> tuple[pin.Model, pin.Data]:
        model = self._own_links()
        effects = self.robot.forces if self.carried is None else self.carried
        for load in (e.element() for e in effects if e.known) if laden else ():
            if isinstance(load, PointMass):  # at rest its place and mass are all that counts
                place = model.frames[model.getFrameId(load.frame)]
                body = model.inertias[place.parentJoint].toDynamicParameters()[_TO_TABLE_ORDER]
                body[:4] += load.mass * np.r_[1.0, place.placement.act(load.centre)]
                model.inertias[place.parentJoint] = _inertia(body)
        model.gravity.linear = np.linalg.norm(model.gravity.linear) * np.asarray(direction, dtype=float)
        return model, model.createData()

    def body_columns(self, frame: str) -> Array:
        if frame not in self.bodies:  # a search asks for the same body with many shapes
            self.bodies[frame] = self._body_columns(frame)
        return self.bodies[frame]

    def _body_columns(self, frame: str) -> Array:
        robot, motion = self.robot, self.motion
        model, data = robot.model, robot._data
        frame_id = model.getFrameId(frame)
        out = np.empty((len(motion), model.nv, 10))
        for k, (q, v, a) in enumerate(zip(motion.q, motion.v, motion.a, strict=True)):
            jacobian = pin.computeFrameJacobian(model, data, q, frame_id, pin.LOCAL)
            pin.rnea(model, data, q, v, a)  # the regressor reads the velocities and accelerations that it leaves
            out[k] = jacobian.T @ pin.frameBodyRegressor(model, data, frame_id)
        return out[:, :, _TO_TABLE_ORDER]

    def body_derivatives(self, frame: str, body: Array) -> tuple[Array, Array, Array]:
        return tree_derivatives.of_torques(self._only_body(frame, body)[0], self.motion)

    def body_potential(self, frame: str, body: Array) -> Array:
        return self._in_each_pose(pin.computePotentialEnergy, *self._only_body(frame, body))

    def _only_body(self, frame: str, body: Array) -> tuple[pin.Model, pin.Data]:
        """The tree without mass but for one body in a frame."""
        model = self.robot.model.copy()
        place = model.frames[model.getFrameId(frame)]
        for joint in range(model.njoints):
            model.inertias[joint] = pin.Inertia.Zero()
        model.inertias[place.parentJoint] = place.placement.act(_inertia(body))
        return model, model.createData()

    def joint_axis(self, joint: str) -> Array:
        model = self.robot.model
        subspace = np.ravel(model.joints[model.getJointId(joint)].createData().S)
        if not subspace[3:].any():
            raise ValueError(f"joint {joint!r} of {self.robot.name} is prismatic; expected a revolute joint")
        return np.array(subspace[3:])

    def derivatives(self) -> tuple[Array, Array, Array]:
        return self._derivatives

    @cached_property
    def _derivatives(self) -> tuple[Array, Array, Array]:
        return tree_derivatives.of_torques(self._own_links(), self.motion)

    def with_hinges(self, hinges: tuple[Any, ...]) -> Motion:
        if hinges not in self.hinged:
            robot, motion = self.robot.with_effects(hinges), self.motion
            q, v, a = (np.zeros((len(motion), robot.model.nv)) for _ in range(3))
            drives = [robot.layout.names.index(f"{j}:drive") for j in self.robot.joints]
            for x, own in ((q, motion.q), (v, motion.v), (a, motion.a)):
                x[:, drives] = own
            links = robot.link_parameters.reshape(-1, 10).copy()
            if self.link_parameters is not None:  # a base that tilts is a body more
                names = [name for name, _ in robot.bodies]
                links[[names.index(name) for name, _ in self.robot.bodies]] = self.link_parameters.reshape(-1, 10)
            carried = self.robot.forces if self.carried is None else self.carried
            noise = None if motion.angle_noise is None else np.zeros(robot.model.nv)
            if noise is not None:
                noise[drives] = motion.angle_noise
            moved = dataclasses.replace(
                robot.motion(q, v, a, motion.time),
                effects=motion.effects,
                stuck=motion.stuck,
                angle_noise=noise,
                low_pass=motion.low_pass,
            )
            tree = partial(_RobotTreeMotion, robot, link_parameters=links.ravel(), carried=carried)
            self.hinged[hinges] = dataclasses.replace(moved, tree=tree)
        return self.hinged[hinges]

    def _own_links(self) -> pin.Model:
        """The tree with these link parameters."""
        model = self.robot.model.copy()
        if self.link_parameters is not None:
            for (_, joint), body in zip(self.robot.bodies, self.link_parameters.reshape(-1, 10), strict=True):
                model.inertias[joint] = _inertia(body)
        return model


def _on_links(robot: Robot, motion: Motion, links: Array, known: tuple[Effect, ...], moved: Motion) -> _RobotTreeMotion:
    before = motion.on_tree
    same = isinstance(before, _RobotTreeMotion) and all(getattr(moved, x) is getattr(motion, x) for x in "qva")
    bodies = before.bodies if same else {}  # type: ignore[attr-defined]  # they know nothing of the links
    return _RobotTreeMotion(robot, moved, links, bodies, carried=known)


def _inertia(body: Array) -> pin.Inertia:
    """Of ten parameters in table D.1's order."""
    dynamic = np.empty(10)
    # pinocchio divides by the mass to find the centre
    dynamic[_TO_TABLE_ORDER] = body if abs(body[0]) >= 1e-6 else np.r_[1e-6, body[1:]]
    return pin.Inertia.FromDynamicParameters(dynamic)


# ---- robot files --------------------------------------------------------------------------------------------


def robots_folder() -> Path:
    """Folder of the robots that come with the package."""
    here = Path(__file__).resolve().parent
    installed = here / "urdf"
    return installed if installed.is_dir() else here.parent / "urdf"


@cache
def robot_names() -> tuple[str, ...]:
    """Names that `load_robot` knows."""
    # a robot file names a URDF; the controller's file beside it does not
    return tuple(sorted(p.stem for p in robots_folder().glob("*.toml") if "urdf" in read_toml(p, "robot file")))


def load_robot(source: str | os.PathLike[str] | Robot) -> Robot:
    """Load a robot.

    Parameters
    ----------
    source : str, path or Robot
        A robot is returned as it is. A name in `robots_folder()` (``rx90b``), a robot file (``.toml``), a URDF (no effects), or
        ``example-robot-data:NAME``. Joints that mimic others are fixed, with an `InputWarning`: `Robot.followers`.

    Raises
    ------
    ValueError
        One line that names the file and the key, joint or effect type that is wrong.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> rf.load_robot("rx90b_3dof")
    <Robot 'rx90b_3dof': 3 joints, 12 coordinates, 16 effects>
    """
    if isinstance(source, Robot):
        return source
    text = str(source)
    if text.startswith(virtual.EXAMPLE_ROBOT_PREFIX):
        return _from_urdf(text, text.removeprefix(virtual.EXAMPLE_ROBOT_PREFIX))
    if text in robot_names():  # before the files: a folder or file of that name must not hide the robot
        return _from_file(robots_folder() / f"{text}.toml")
    path = Path(source)
    if path.suffix == ".toml":
        return _from_file(path)
    if os.path.isdir(path):  # unlike the path's own method, no error where the name is too long for any file
        raise ValueError(f"{path} is a folder; expected a robot file or a URDF")
    if path.suffix or os.path.exists(path):
        return _from_urdf(path, path.stem)
    raise ValueError(f"unknown robot {text!r}: no such file, and {_near_robots(text)}")


def _near_robots(name: str) -> str:
    """What somebody may have meant: robots of the package, and those of example-robot-data that have the name in theirs."""
    own, prefix, others = robot_names(), virtual.EXAMPLE_ROBOT_PREFIX, virtual.example_robots()
    if not others or difflib.get_close_matches(name, own, n=1):
        return close_match(name, own)
    near = [x for x in others if name.lower() in x.lower()] or difflib.get_close_matches(name.lower(), others, n=3)
    if near:
        return f"did you mean {' or '.join(prefix + x for x in near[:5])}?"
    return f"{close_match(name, own)}; or the path of a URDF, or {prefix}NAME with a name of that package: {', '.join(others)}"


def _from_urdf(
    source: str | Path, name: str, tip_frame: str | None = None, inertial_parameters: str = "fitted"
) -> Robot:
    read = virtual.read_urdf(source)
    followers = virtual.followers(read, str(source))
    urdf = virtual.to_xml(virtual.normalise(read))
    robot = Robot(name, urdf, "", inertial_parameters, (), followers=followers)
    for frame, inertia in zip(robot.tree.names, robot.tree.inertias, strict=True):
        largest = float(np.abs(inertia.toDynamicParameters()).max())
        if not largest <= LARGEST_INERTIA:
            raise ValueError(
                f"{source}: the link behind joint {frame!r} has an inertial parameter of {largest:.3g}; expected SI units"
            )
    if robot.tree.nv == 0:
        raise ValueError(f"{source}: the URDF has no moving joint")
    leaders = {leader for _, leader in followers}
    tip = default_tip(robot.tree, leaders) if tip_frame is None else tip_frame
    return dataclasses.replace(robot, tip_frame=tip)


def _from_file(path: Path) -> Robot:
    table = read_toml(path, "robot file")
    check_keys(table, ROBOT_KEYS, path)
    if "urdf" not in table:
        raise ValueError(f"{path}: key 'urdf' is missing")
    for key in ("name", "urdf", "tip_frame", "inertial_parameters", "controller"):
        if key in table and not isinstance(table[key], str):
            raise ValueError(f"{path}: {key} is {table[key]!r}; expected a string")
    inertial = table.get("inertial_parameters", "fitted")
    if inertial not in ("fitted", "known"):
        raise ValueError(f"{path}: inertial_parameters is {inertial!r}; expected 'fitted' or 'known'")
    named = table["urdf"].startswith(virtual.EXAMPLE_ROBOT_PREFIX)
    urdf: str | Path = table["urdf"] if named else path.parent / table["urdf"]
    with named_in(path, "urdf"):
        robot = _from_urdf(urdf, table.get("name", path.stem), table.get("tip_frame"), inertial)
    frames = [f.name for f in robot.tree.frames]
    if robot.tip_frame not in frames:
        raise ValueError(f"{path}: unknown tip_frame {robot.tip_frame!r}; {close_match(robot.tip_frame, frames)}")
    stated = table.get("controller", "")
    controller = str((path.parent / stated).resolve()) if stated.endswith(".toml") else stated
    robot = dataclasses.replace(robot, controller=controller)
    return robot.with_effects(_read_effects(table.get("effects", []), path, robot.joints, frames))


def _read_effects(tables: Any, path: Path, joints: Sequence[str], frames: Sequence[str]) -> list[Effect]:
    if not isinstance(tables, list):
        raise ValueError(f"{path}: effects is {type(tables).__name__}; expected [[effects]] tables")
    effects: list[Effect] = []
    for i, table in enumerate(tables, start=1):
        where = f"{path}: effect {i}"
        if not isinstance(table, dict):
            raise ValueError(f"{where} is {table!r}; expected a table")
        effect = effect_from_table(table, where, joints, frames)
        for other in effects:
            if other.place != effect.place:
                continue
            if other.type_name() == effect.type_name() and not effect.traits.repeats:
                raise ValueError(f"{where}: {effect.label} is declared twice")
            if effect.type_name() in other.traits.replaces or other.type_name() in effect.traits.replaces:
                both = f"{effect.type_name()} and {other.type_name()}"
                raise ValueError(f"{where}: {both} exclude each other on one joint")
        effects.append(effect)
    for i, effect in enumerate(effects, start=1):
        for needed in effect.traits.needs:
            if not any(e.type_name() == needed and e.place == effect.place for e in effects):
                raise ValueError(f"{path}: effect {i}: {effect.label} needs a {needed} in the same place")
    return _with_shared(effects, path)


def _with_shared(effects: Sequence[Effect], path: Path) -> list[Effect]:
    """Effects with what a joint has one value of (a turn-over), stated in any of them."""
    values: dict[tuple[str, ...], float] = {}
    for i, effect in enumerate(effects, start=1):
        for key, x in zip(shared_shapes(effect), effect.shape, strict=True):
            if (
                key is not None
                and not np.isnan(x)
                and not np.isclose(x, values.setdefault(key, float(x)), rtol=1e-9, atol=0.0)
            ):
                raise ValueError(
                    f"{path}: effect {i}: {effect.label} has {key[1]} = {x:g}, another effect there {values[key]:g}; one value "
                    f"for all of {key[0]} is expected"
                )
    out = []
    for effect in effects:
        named = zip(shared_shapes(effect), effect.shape_parameters.values(), strict=True)
        stated = {
            p.attribute: values[key] for key, p in named if key in values and getattr(effect, p.attribute) is None
        }
        out.append(dataclasses.replace(effect, **stated))
    return out
