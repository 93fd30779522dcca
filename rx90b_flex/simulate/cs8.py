"""The CS8 motion controller: six independent digital controllers (PHYSICS.md, "Closed loop"; sections 3.1 and
6.6.1).
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.files.keys import close_match
from rx90b_flex.files.table import TomlTable
from rx90b_flex.files.toml import named_in, read_toml, toml_text
from rx90b_flex.linearize import Linearization
from rx90b_flex.robot import Robot, robots_folder
from rx90b_flex.simulate.filters import Filter, read_filters, response_of, sections_of

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class JointController:
    """One joint's controller, joint side.

    ``torque = G(position_gain (r - e) + velocity_gain (r' - F e') + integral_gain * integral(r - e) + feed-forward
    - filtered_speed_gain * integral(F e' - e'))``, with e and e' as the resolver shows them, F the filters of the speed and G those
    of the torque.

    Attributes
    ----------
    name : str
    position_gain, velocity_gain, integral_gain : float
        N m/rad, N m s/rad, N m/(rad s).
    position_step, velocity_step, torque_step : float
        Quantisation of resolver and current, rad, rad/s, N m; 0: none.
    torque_limit : float
        N m. The command is held there; `CS8.overload_time_s` at the limit ends a run.
    by_reference, by_reference_speed, by_reference_acceleration : float
        What the reference alone adds to the torque fed forward, over ``r - r_0``, r' and r'': N m/rad, N m s/rad, kg m^2. A cascade
        has them (`rx90b_flex.simulate.cascade`).
    filtered_speed_gain : float
        N m/rad. Of a velocity loop's integral, which sees the filtered speed.
    velocity_filters, torque_filters : tuple of Filter
        Of the measured speed, and of the torque that is asked for, feed-forward among it, before its limit.
    """

    name: str
    position_gain: float
    velocity_gain: float
    integral_gain: float
    position_step: float
    velocity_step: float
    torque_step: float
    torque_limit: float
    by_reference: float = 0.0
    by_reference_speed: float = 0.0
    by_reference_acceleration: float = 0.0
    filtered_speed_gain: float = 0.0
    velocity_filters: tuple[Filter, ...] = ()
    torque_filters: tuple[Filter, ...] = ()


CHAINS = ("velocity_filters", "torque_filters")
SIGNED = ("by_reference", "by_reference_speed", "by_reference_acceleration")


@dataclass(frozen=True)
class CS8:
    """Motion controller of all joints.

    Attributes
    ----------
    joints : tuple of JointController
    reference_rate_hz, controller_rate_hz, log_rate_hz : float
        References and feed-forward arrive at the first rate; a cubic (references) and a straight line (feed-forward)
        take them to the second, where the controller runs. The log is decimated to the third. Both ratios are whole.
    log_cutoff_hz : float
        Cutoff of the anti-alias filter before the log (90 Hz in section 6.6.1). Linear phase, its delay taken out.
    current_bandwidth_hz : float
        Of the first-order current loop behind the zero-order hold; 0: ideal. What acts on the robot during a sample is
        the mean of that exponential over the sample.
    overload_time_s : float
        How long a torque may stay at its limit before the amplifier switches off.
    """

    joints: tuple[JointController, ...]
    reference_rate_hz: float = 250.0
    controller_rate_hz: float = 4000.0
    log_rate_hz: float = 250.0
    log_cutoff_hz: float = 90.0
    current_bandwidth_hz: float = 0.0
    overload_time_s: float = 0.05

    def __post_init__(self) -> None:
        for name in ("controller_rate_hz", "reference_rate_hz", "log_rate_hz", "log_cutoff_hz"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name):g}; expected a frequency above 0")
        for name in ("reference_rate_hz", "log_rate_hz"):
            ratio = self.controller_rate_hz / getattr(self, name)
            if not (ratio >= 1.0 and abs(ratio - round(ratio)) < 1e-9):
                raise ValueError(
                    f"{name} is {getattr(self, name):g}; expected a whole fraction of {self.controller_rate_hz:g}"
                )
        if not 0.0 < self.log_cutoff_hz < 0.5 * self.log_rate_hz:
            raise ValueError(f"log_cutoff_hz is {self.log_cutoff_hz:g}; expected 0 to {0.5 * self.log_rate_hz:g}")

    @property
    def period(self) -> float:
        """Of the controller, s."""
        return 1.0 / self.controller_rate_hz

    def for_joints(self, names: Sequence[str]) -> CS8:
        """The controller of these joints, in this order."""
        known = {joint.name: joint for joint in self.joints}
        for name in names:
            if name not in known:
                raise ValueError(f"the controller has no joint {name!r}; {close_match(name, list(known))}")
        return dataclasses.replace(self, joints=tuple(known[name] for name in names))

    def column(self, name: str) -> Array:
        """One number of every joint, shape (joints,)."""
        return np.array([getattr(joint, name) for joint in self.joints])

    @property
    def sections(self) -> tuple[Array, Array]:
        """Of the filters of speed and of torque, each (joints, longest chain, 5); see `rx90b_flex.simulate.filters.sections_of`."""
        speed, torque = (sections_of([getattr(joint, x) for joint in self.joints], self.period) for x in CHAINS)
        return speed, torque

    def fed_forward(self, position: Array, velocity: Array, torque: Array | None) -> Array | None:
        """Torque that is fed forward with what the reference adds to it, all (N, joints); None where there is none."""
        own = [self.column(name) for name in SIGNED]
        if not np.any(own):
            return torque
        acceleration = np.gradient(velocity, 1.0 / self.reference_rate_hz, axis=0)
        added = own[0] * (position - position[0]) + own[1] * velocity + own[2] * acceleration
        return np.asarray(added if torque is None else torque + added)

    def by_references(self, hz: Array) -> ComplexArray:
        """Torque that a reference orders over that reference, the drives held, shape (N, joints); N m/rad."""
        s = 2j * np.pi * np.asarray(hz, dtype=float)[:, None]
        angle = self.column("position_gain") + self.column("integral_gain") / s + self.column("by_reference")
        speed = self.column("velocity_gain") + self.column("by_reference_speed")
        asked = angle + speed * s + self.column("by_reference_acceleration") * s**2
        return np.asarray(asked * response_of(self.sections[1], np.exp(s * self.period)))

    def ideal(self) -> CS8:
        """The same controller without quantisation."""
        exact = (
            dataclasses.replace(joint, position_step=0.0, velocity_step=0.0, torque_step=0.0) for joint in self.joints
        )
        return dataclasses.replace(self, joints=tuple(exact))

    # ---- linear model -----------------------------------------------------------------------------------

    def frequency_response(self, hz: Array) -> ComplexArray:
        """Torque over drive angle error, shape (N, joints): the PID with its hold, filters and current loop included; N m/rad."""
        s = 2j * np.pi * np.asarray(hz, dtype=float)[:, None]
        z = np.exp(s * self.period)
        slow = response_of(self.sections[0], z)
        pid = self.column("position_gain") + self.column("velocity_gain") * s * slow
        summed = self.column("integral_gain") + self.column("filtered_speed_gain") * s * (slow - 1.0)
        return (pid + summed * self.period * z / (z - 1.0)) * self._acting(s, z)

    def _acting(self, s: ComplexArray, z: ComplexArray) -> ComplexArray:
        """From the torque that is asked for to the torque that acts, by filters, hold and current loop."""
        hold = (1.0 - 1.0 / z) / (s * self.period) * response_of(self.sections[1], z)
        if self.current_bandwidth_hz == 0.0:
            return hold
        mean, decay = self.current_loop
        return hold * ((1.0 - mean) + mean * (1.0 - decay) / (z - decay))

    @property
    def current_loop(self) -> tuple[float, float]:
        """Share of the old current in a sample's mean, and what is left of it at the sample's end."""
        if self.current_bandwidth_hz == 0.0:
            return 0.0, 0.0
        x = 2.0 * np.pi * self.current_bandwidth_hz * self.period
        return -math.expm1(-x) / x, math.exp(-x)

    def sensitivity(self, linearization: Linearization, hz: Array) -> ComplexArray:
        """Drive torque over feed-forward torque, ``S = (1 + C P)^-1``, shape (N, joints, joints).

        With it the torque spectrum that an excitation will have is known before the run.

        Parameters
        ----------
        linearization : Linearization
            Of the robot about the point, with a velocity: at rest friction's slope would hold the drives.
        hz : array, shape (N,), above 0
        """
        hz = np.asarray(hz, dtype=float)
        own = self.for_joints(linearization.joints)
        loop = own.frequency_response(hz)[:, :, None] * drive_compliance(linearization, hz)
        s = np.asarray(2j * np.pi * hz[:, None])
        hold = own._acting(s, np.exp(s * self.period))
        # what is fed forward passes the same hold as what is fed back
        return np.asarray(np.linalg.inv(np.eye(len(own.joints)) + loop) * hold[:, None, :])


def drive_compliance(linearization: Linearization, hz: Array) -> ComplexArray:
    """Drive angle over drive torque, shape (N, joints, joints), rad per N m."""
    s = 2j * np.pi * np.asarray(hz, dtype=float)[:, None, None]
    dynamic = linearization.M * s**2 + linearization.D * s + linearization.K
    b = linearization.input_matrix
    return np.asarray(b.T @ np.linalg.solve(dynamic, np.broadcast_to(b.astype(complex), (len(s), *b.shape))))


# ---- gains ----------------------------------------------------------------------------------------------------


def rigid_inertia(robot: Robot, pose: Array) -> Array:
    """Inertia that each drive turns with the other drives and all hinges stiff, shape (joints,), kg m^2.

    Parameters
    ----------
    pose : array, shape (joints,), rad
    """
    q = np.zeros(robot.model.nv)
    q[drive_places(robot)] = pose
    return np.diag(robot.input_matrix.T @ robot.mass_matrix(q) @ robot.input_matrix).copy()


def drive_places(robot: Robot) -> NDArray[np.int64]:
    """Where the drive angles stand among the coordinates, shape (joints,)."""
    return np.argmax(robot.input_matrix, axis=0).astype(np.int64)


def design_gains(inertia: Array, bandwidth_hz: float, damping: float, integral_hz: float) -> tuple[Array, Array, Array]:
    """Gains that give each joint, as one rigid inertia J, the poles of ``(s^2 + 2 damping w s + w^2)(s + w_i)``.

    Then ``velocity_gain = J (2 damping w + w_i)``, ``position_gain = J (w^2 + 2 damping w w_i)``, ``integral_gain = J
    w^2 w_i``.

    Returns
    -------
    position, velocity and integral gain, each of inertia's shape.
    """
    w, slow = 2.0 * np.pi * bandwidth_hz, 2.0 * np.pi * integral_hz
    velocity = 2.0 * damping * w
    return inertia * (w * w + velocity * slow), inertia * (velocity + slow), inertia * w * w * slow


def mean_rigid_inertia(robot: Robot) -> Array:
    """`rigid_inertia` averaged over 32 poses spread evenly at random within the limits of position, shape (joints,), kg m^2.

    One pose would not do: stretched straight up, an arm's first joint turns next to nothing.
    """
    low, high = (np.clip(x, -np.pi, np.pi) for x in (robot.tree.lowerPositionLimit, robot.tree.upperPositionLimit))
    drawn = np.random.default_rng(0).uniform(low, np.maximum(low, high), (32, len(robot.joints)))
    return np.mean([rigid_inertia(robot, pose) for pose in drawn], axis=0)


def design_cs8(
    robot: Robot, pose: Array | None = None, bandwidth_hz: float = 5.0, damping: float = 0.8, integral_hz: float = 0.5
) -> CS8:
    """A controller for any robot: gains from `design_gains` on its rigid inertia, limits from its URDF.

    The inertia is that at `pose`, (joints,), rad; without one `mean_rigid_inertia`.

    Quantisation: a 16-bit resolver behind a gear of 100 (1e-6 rad), speed from its difference over about 1/100 s, and
    12 bits of current.
    """
    inertia = mean_rigid_inertia(robot) if pose is None else rigid_inertia(robot, pose)
    gains = design_gains(inertia, bandwidth_hz, damping, integral_hz)
    limits = np.asarray(robot.tree.upperEffortLimit, dtype=float)
    joints = []
    for j, name in enumerate(robot.joints):
        limit = float(limits[j])
        position, velocity, integral = (float(gain[j]) for gain in gains)
        current_step = 2.0 * limit / 4096 if limit < 1e6 else 0.0  # a URDF without limits has a huge one
        joints.append(JointController(name, position, velocity, integral, 1.0e-6, 1.0e-4, current_step, limit))
    return CS8(tuple(joints))


def load_cs8(source: str | os.PathLike[str] | None = None) -> CS8:
    """Read a controller file; without one, the RX90B's (``urdf/cs8.toml``).

    Raises
    ------
    ValueError
        One line that names the file and the key.
    """
    from rx90b_flex.simulate.cascade import NEEDED, NUMBERS, cascade

    path = robots_folder() / "cs8.toml" if source is None else Path(source)
    table = TomlTable(str(path), "", read_toml(path, "controller file"))
    kind = "cascade" if table.has("cascade") else "joint"
    if kind == "cascade" and table.has("joint"):
        raise table.problem("cascade", "stands beside [[joint]]; one kind is expected, for all joints")
    settings = [f.name for f in dataclasses.fields(CS8) if f.name != "joints"]
    numbers = _numbers(table, settings, [], [kind])
    fields = [f.name for f in dataclasses.fields(JointController) if f.name not in ("name", *CHAINS)]
    optional = [f.name for f in dataclasses.fields(JointController) if f.default is not dataclasses.MISSING]
    joints: list[JointController] = []
    for entry in table.sections(kind):
        name = entry.text("name")
        if any(joint.name == name for joint in joints):
            raise entry.problem("name", f"{name!r} stands in a table before; one [[{kind}]] a joint is expected")
        if kind == "cascade":
            given = _numbers(entry, NUMBERS, NEEDED, ["name", *CHAINS])
            with named_in(path, entry.name):
                joint = cascade(name, **given)
        else:
            given = _numbers(entry, fields, [f for f in fields if f not in optional], ["name", *CHAINS])
            joint = JointController(name, **given)
        rate = numbers.get("controller_rate_hz", CS8.controller_rate_hz)
        speed, torque = (read_filters(entry, key, rate) for key in CHAINS)
        joints.append(dataclasses.replace(joint, velocity_filters=speed, torque_filters=torque))
    with named_in(path):
        return CS8(tuple(joints), **numbers)


def own_controller(robot: Robot) -> CS8 | None:
    """The controller that the robot's file states, of its joints; None where it states none.

    Raises
    ------
    ValueError
        A file that cannot be read, or is of other joints.
    """
    if not robot.controller:
        return None
    named = not robot.controller.endswith(".toml")
    path = robots_folder() / f"{robot.controller}.toml" if named else Path(robot.controller)
    return controller_of_joints(load_cs8(path), robot, str(path))


def controller_of_joints(controller: CS8, robot: Robot, where: str) -> CS8:
    """Of the robot's joints; an error says where it is from."""
    with named_in(where):
        return controller.for_joints(robot.joints)


def _numbers(table: TomlTable, allowed: Sequence[str], needed: Sequence[str], others: Sequence[str]) -> dict[str, Any]:
    """The numbers of a table that may hold other keys."""
    table.allow(*others, *allowed)
    asked = [key for key in allowed if table.has(key) or key in needed]
    return {key: table.number(key) if key in SIGNED else table.not_negative(key) for key in asked}


def save_cs8(controller: CS8, path: str | os.PathLike[str]) -> None:
    """Write a controller file that `load_cs8` reads back as the same controller."""
    content = dataclasses.asdict(controller)
    joints = [{key: value for key, value in joint.items() if value != ()} for joint in content.pop("joints")]
    Path(path).write_text(toml_text({**content, "joint": joints}), encoding="utf-8")
