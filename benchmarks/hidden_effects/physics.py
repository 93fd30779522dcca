"""What an arm with effects logs over one period: its links by `pinocchio.rnea`, every effect from its definition in plain NumPy.

A motion is that of the links. Where a drive gives way, the motor turns further than its link by what the load bends it; friction acts
on the motor. Behind the motor stand what falsifies its torque and its angle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from independent import Arm, Array, Motion, angle_dependent_friction, carrying, tilted

from hidden_effects.friction import dahl, dry, hysteresis, last_direction, maxwell
from hidden_effects.motions import Experiment, spectral

CONTACT = 0.1  # of a joint's dry friction, over which a drive with lost motion changes sides
SLIP_S = 0.1  # a slip of the encoder takes so long

Values = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Hidden:
    """One effect to hide: its type, place (joint numbers) and values, sizes apart from shapes; a law where this file has none."""

    kind: str
    place: tuple[int, ...]
    sizes: dict[str, Any]
    shapes: dict[str, Any]
    finish: Callable[[dict[str, Any]], dict[str, Any]] = dict
    law: Callable[[Motion, int, Values], Array] | None = None

    def values(self, size: float) -> dict[str, Any]:
        scaled = {name: (size * np.asarray(x)).tolist() for name, x in self.sizes.items()}
        return self.finish(scaled | self.shapes)


@dataclass(frozen=True, eq=False)
class State:
    """One period: the motors' motion, the torque that the links ask for, dry friction over its torque, last directions."""

    motor: Motion
    load: Array
    dry: Array
    last: Array


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm, the friction of its joints, and what hides in it."""

    arm: Arm
    tip: str
    form: str
    coulomb: Array
    viscous: Array
    deflections: tuple[float, ...]
    hidden: tuple[tuple[Hidden, float], ...] = ()

    def with_hidden(self, hidden: Sequence[tuple[Hidden, float]]) -> Plant:
        return replace(self, hidden=tuple(hidden))

    def state(self, run: Experiment, time: Array) -> State:
        """At the times of one period, (N,)."""
        m = run.motion(time)
        turned = self._each(IN_TRANSMISSION)
        load = self.arm.torque(m)
        motor = m
        for j, kind, p in turned:
            if kind == "transmission_error":
                inside = in_error(m, j, p)
                load = self.arm.torque(inside)
                load[:, j] *= 1 + p["amplitude"] * p["order"] * np.cos(p["order"] * m.q[:, j] + p["phase"])
                continue
            further = IN_TRANSMISSION[kind](load[:, j], run.period_s, p | {"contact": CONTACT * self.coulomb[j]})
            motor = _shifted(motor, j, further, run.period_s)
        unit = dry(self.form, motor.q, motor.v, self.deflections)
        return State(motor, load, unit, last_direction(motor.v))

    def torque(self, run: Experiment, time: Array) -> tuple[State, Array]:
        """State and the motors' torque, all that repeats with the motion."""
        s = self.state(run, time)
        tau = s.load + s.dry * self.coulomb + s.motor.v * self.viscous
        for h, size in self.hidden:
            p = h.values(size)
            if h.kind in ON_JOINT:
                tau[:, h.place[0]] += ON_JOINT[h.kind](s, h.place[0], p)
            elif h.kind in ON_PAIR:
                tau += ON_PAIR[h.kind](s, h.place, p)
            elif h.kind in ON_ARM:
                tau += ON_ARM[h.kind](self, h.place, p, s)
            elif h.law is not None:
                tau[:, h.place[0]] += h.law(s.motor, h.place[0], p)
        return s, tau

    def logged(self, run: Experiment, rate_hz: float, periods: int) -> tuple[Array, Array]:
        """Positions and torques of whole periods, (N, n), before noise."""
        count = round(run.period_s * rate_hz)
        one, whole = np.arange(count) / rate_hz, np.arange(count * periods) / rate_hz
        s, tau = self.torque(run, one)
        for h, size in self.hidden:
            if h.kind == "torque_delay":
                late = self.torque(run, one - h.values(size)["delay"])[1]
                mine = np.ones(tau.shape[1], bool) if not h.place else np.arange(tau.shape[1]) == h.place[0]
                tau = np.where(mine, late, tau)
        q, tau = np.tile(s.motor.q, (periods, 1)), np.tile(tau, (periods, 1))
        v = np.tile(s.motor.v, (periods, 1))
        for h, size in self.hidden:
            if h.kind in ON_LOG:
                q[:, h.place[0]], tau[:, h.place[0]] = ON_LOG[h.kind](
                    whole, q[:, h.place[0]], v[:, h.place[0]], tau[:, h.place[0]], h.values(size)
                )
        return q, tau

    def _each(self, kinds: Mapping[str, object]) -> list[tuple[int, str, Values]]:
        return [(h.place[0], h.kind, h.values(size)) for h, size in self.hidden if h.kind in kinds]


def _shifted(m: Motion, j: int, by: Array, period_s: float) -> Motion:
    q, v, a = m.q.copy(), m.v.copy(), m.a.copy()
    for x, change in ((q, by), (v, spectral(by, period_s)), (a, spectral(by, period_s, 2))):
        x[:, j] += change
    return Motion(m.time, q, v, a)


def in_error(m: Motion, j: int, p: Values) -> Motion:
    """The motion in which joint j turns by the periodic error more."""
    q, v, a = m.q.copy(), m.v.copy(), m.a.copy()
    x = p["order"] * q[:, j] + p["phase"]
    slope, bend = p["amplitude"] * p["order"] * np.cos(x), -p["amplitude"] * p["order"] ** 2 * np.sin(x)
    q[:, j] += p["amplitude"] * np.sin(x)
    v[:, j] += slope * m.v[:, j]
    a[:, j] += slope * m.a[:, j] + bend * m.v[:, j] ** 2
    return Motion(m.time, q, v, a)


# ---- between motor and link: how much further the motor turns, from the load of one joint over a period --------------


def drive_flexibility(load: Array, period_s: float, p: Values) -> Array:
    """Of ``k x + d dx/dt = load``, line by line."""
    omega = 2 * np.pi * np.fft.rfftfreq(len(load), period_s / len(load))
    return np.asarray(np.fft.irfft(np.fft.rfft(load) / (p["stiffness"] + 1j * omega * p["damping"]), len(load)))


def backlash(load: Array, period_s: float, p: Values) -> Array:
    return np.asarray(0.5 * p["gap"] * np.tanh(load / p["contact"]))


IN_TRANSMISSION: Mapping[str, Any] = {
    "drive_flexibility": drive_flexibility,
    "backlash": backlash,
    "transmission_error": None,  # turns the link in `Plant.state`
}


# ---- torques of one joint, from the state, the joint and the values --------------------------------------------------


def _efficiency(s: State, j: int, p: Values) -> Array:
    driving = s.load[:, j] * s.motor.v[:, j] > 0.0
    return np.where(driving, p["motoring"], p["backdriving"]) * np.abs(s.load[:, j]) * s.dry[:, j]


def _gravity_spring(s: State, j: int, p: Values) -> Array:
    """Between a point at the distance `far` from the axis and one at `near` on the link that turns; `angle` apart at zero."""

    def length(q: Array) -> Array:
        return np.asarray(np.sqrt(p["far"] ** 2 + p["near"] ** 2 - 2 * p["far"] * p["near"] * np.cos(q + p["angle"])))

    q = s.motor.q[:, j]
    slope = p["far"] * p["near"] * np.sin(q + p["angle"]) / length(q)
    return np.asarray((p["stiffness"] * (length(q) - length(np.zeros(1))) + p["prestress"]) * slope)


def _dahl(s: State, j: int, p: Values) -> Array:
    return np.asarray(p["torque"] * hysteresis(s.motor.q[:, [j]], dahl(p["torque"] / p["stiffness"]))[:, 0])


def _maxwell(s: State, j: int, p: Values) -> Array:
    pairs = zip(p["torques"], p["stiffnesses"], strict=True)
    return np.asarray(sum(t * hysteresis(s.motor.q[:, [j]], maxwell(t / k))[:, 0] for t, k in pairs))


ON_JOINT: Mapping[str, Callable[[State, int, Values], Array]] = {
    "drive_inertia": lambda s, j, p: p["inertia"] * s.motor.a[:, j],
    "torque_offset": lambda s, j, p: np.full(len(s.load), p["torque"]),
    "coulomb_friction": lambda s, j, p: p["torque"] * s.dry[:, j],
    "viscous_friction": lambda s, j, p: p["coefficient"] * s.motor.v[:, j],
    "viscous_power_friction": lambda s, j, p: (
        p["coefficient"] * np.sign(s.motor.v[:, j]) * np.abs(s.motor.v[:, j]) ** p["power"]
    ),
    "stribeck_friction": lambda s, j, p: (
        p["torque"] * np.exp(-((np.abs(s.motor.v[:, j]) / p["velocity"]) ** p["power"])) * s.dry[:, j]
    ),
    "asymmetric_friction": lambda s, j, p: p["coefficient"] * np.abs(s.motor.v[:, j]),
    "load_friction": lambda s, j, p: p["coefficient"] * np.abs(s.load[:, j]) * s.dry[:, j],
    "load_viscous_friction": lambda s, j, p: p["coefficient"] * np.abs(s.load[:, j]) * s.motor.v[:, j],
    "drive_efficiency": _efficiency,
    "held_friction": lambda s, j, p: p["torque"] * (s.last[:, j] - s.dry[:, j]),
    "position_friction": lambda s, j, p: (
        p["amplitude"] * np.sin(p["order"] * s.motor.q[:, j] + p["phase"]) * s.dry[:, j]
    ),
    "presliding_friction": _dahl,
    "maxwell_slip_friction": _maxwell,
    "joint_spring": lambda s, j, p: p["stiffness"] * (s.motor.q[:, j] - p["rest_angle"]),
    "gravity_spring": _gravity_spring,
    "gear_ripple": lambda s, j, p: p["amplitude"] * np.sin(p["order"] * s.motor.q[:, j] + p["phase"]),
}


# ---- torques of two joints -------------------------------------------------------------------------------------------


def _coupling(s: State, place: tuple[int, ...], p: Values) -> Array:
    a, b = place
    v = s.motor.v[:, a] + s.motor.v[:, b]
    acceleration = s.motor.a[:, a] + s.motor.a[:, b]
    out = np.zeros_like(s.load)
    out[:, a] = out[:, b] = p["inertia"] * acceleration + p["viscous"] * v + p["coulomb"] * np.sign(v)
    return out


def _cable(s: State, place: tuple[int, ...], p: Values) -> Array:
    """On the first joint, a polynomial of the second's angle without its constant."""
    out = np.zeros_like(s.load)
    powers = s.motor.q[:, [place[1]]] ** np.arange(1, 1 + len(p["coefficients"]))
    out[:, place[0]] = powers @ np.asarray(p["coefficients"])
    return out


ON_PAIR: Mapping[str, Callable[[State, tuple[int, ...], Values], Array]] = {
    "joint_coupling": _coupling,
    "cable_torque": _cable,
    "angle_dependent_friction": lambda s, place, p: angle_dependent_friction(*place, p["coefficient"])(s.motor, s.load),
}


# ---- torques of the whole arm ----------------------------------------------------------------------------------------


def _contact(plant: Plant, place: tuple[int, ...], p: Values, s: State) -> Array:
    """A soft wall across the base's x that the tip presses into, where it is further than in a part of the motion."""
    model = plant.arm.model
    data, frame = model.createData(), model.getFrameId(plant.tip)
    x, towards = np.empty(len(s.load)), np.empty_like(s.load)
    for i, q in enumerate(s.motor.q):
        pin.computeJointJacobians(model, data, q)
        x[i] = pin.updateFramePlacement(model, data, frame).translation[0]
        towards[i] = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[0]
    return p["stiffness"] * np.maximum(x - np.quantile(x, p["quantile"]), 0.0)[:, None] * towards


ON_ARM: Mapping[str, Callable[[Plant, tuple[int, ...], Values, State], Array]] = {
    "base_tilt": lambda plant, place, p, s: tilted(plant.arm, p["angle_x"], p["angle_y"])(s.motor, s.load),
    "payload": lambda plant, place, p, s: carrying(plant.arm, plant.tip, p["mass"], p["centre"])(s.motor, s.load),
    "contact": _contact,
}


# ---- between motor and log: one joint's angle and torque, from time, angle, velocity, torque and the values ----------

Logged = tuple[Array, Array]


def _saturated(time: Array, q: Array, v: Array, torque: Array, p: Values) -> Logged:
    """The torque that is logged where the motor gives ``asked - c asked^3``: Newton's method."""
    asked = torque.copy()
    for _ in range(30):
        asked -= (asked - p["coefficient"] * asked**3 - torque) / (1.0 - 3.0 * p["coefficient"] * asked**2)
    return q, asked


def _slipping(time: Array, q: Array, v: Array, torque: Array, p: Values) -> Logged:
    """At three instants the encoder slips on its shaft."""
    since = [(time - part * time[-1]) / SLIP_S for part in (0.2, 0.5, 0.8)]
    return q + p["slip"] * 0.5 * sum(1 + np.tanh(2 * x) for x in since), torque


ON_LOG: Mapping[str, Callable[[Array, Array, Array, Array, Values], Logged]] = {
    "resolver_error": lambda time, q, v, torque, p: (q + p["amplitude"] * np.sin(p["order"] * q + p["phase"]), torque),
    "motor_saturation": _saturated,
    "torque_gain": lambda time, q, v, torque, p: (q, p["gain"] * torque),
    "line_interference": lambda time, q, v, torque, p: (
        q,
        torque + p["amplitude"] * np.sin(2 * np.pi * p["frequency_hz"] * time + p["phase"]),
    ),
    "friction_drift": lambda time, q, v, torque, p: (
        q,
        torque + p["coefficient"] * np.exp(-time / p["time_constant"]) * v,
    ),
    "slipping_encoder": _slipping,
}
ELSEWHERE = ("torque_delay",)  # worked out in `Plant.logged`
