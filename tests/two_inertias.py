"""A drive and its link with a gear that gives way between them, in plain NumPy; many runs side by side.

Nothing of the package is used: friction is of LuGre's kind, the gear's hysteresis of Dahl's, encoders count in steps and the second
one is read late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

URDF = """<robot name="pendulum"><link name="base"/><link name="arm"><inertial><origin xyz="0.6 0 0"/><mass value="20"/>
<inertia ixx="0.1" iyy="1.3" izz="1.3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="5" effort="500"/></joint></robot>
"""
WEIGHT = 20.0 * 9.81 * 0.6  # N m
LINK = 1.3 + 20.0 * 0.36  # kg m^2


@dataclass(frozen=True)
class Drive:
    """What is behind the recordings; SI units, joint side."""

    rotor: float = 6.0
    stiffness: float = 2.0e4
    damping: float = 40.0
    dry: float = 14.0
    viscous: float = 9.0
    bristle: float = 1.0e4  # stiffness of presliding
    hysteresis: float = 0.0  # torque of a Dahl element beside the spring
    gap: float = 0.0
    cubic: float = 0.0
    lag_s: float = 0.002
    step: float = 2.0e-6  # of both encoders
    torque_noise: float = 0.5
    eccentricity: float = 2.0e-5
    ripple: float = 1.0e-5
    order: float = 90.0
    stiff: bool = False  # the second encoder shows the motor's angle, with its own lag and errors


@dataclass(frozen=True, eq=False)
class Lanes:
    """Signals of L runs, each (N, L), at `rate_hz`."""

    time: Array
    motor: Array
    link: Array
    torque: Array
    rate_hz: float


def simulate(
    drive: Drive, rng: np.random.Generator, lanes: int, seconds: float = 12.0, rate_hz: float = 250.0
) -> Lanes:
    """Random harmonics under feed-forward and PD control; every lane another motion."""
    inner = 12
    dt = 1.0 / (rate_hz * inner)
    omega = 2 * np.pi / seconds * np.arange(1, 7)[:, None]
    size = rng.uniform(0.3, 1.0, (6, lanes)) / omega
    size *= 2.0 / (size * omega).sum(axis=0)
    phase, centre = rng.uniform(0, 2 * np.pi, (6, lanes)), rng.uniform(-0.5, 0.5, lanes)

    count = round(seconds * rate_hz)
    t = (np.arange(count)[:, None] / rate_hz + np.arange(inner) * dt).reshape(-1, 1)
    r, dr, ddr = (np.zeros((len(t), lanes)) for _ in range(3))
    for w, a, p in zip(omega[:, 0], size, phase, strict=True):
        r += a * np.sin(w * t + p)
        dr += a * w * np.cos(w * t + p)
        ddr -= a * w**2 * np.sin(w * t + p)
    r += centre
    forward = (LINK + drive.rotor) * ddr - WEIGHT * np.cos(r) + drive.dry * np.tanh(dr / 0.02) + drive.viscous * dr

    q, v = r[0], dr[0]
    state = np.stack([q, v, q + WEIGHT * np.cos(q) / drive.stiffness, v, np.zeros(lanes), np.zeros(lanes)])
    motor, link, torque = (np.empty((count, lanes)) for _ in range(3))

    def slope(x: Array, tau: Array) -> Array:
        qm, vm, ql, vl, z, h = x
        twist, rate = ql - qm, vl - vm
        out = np.empty_like(x)
        if drive.gap:
            twist = twist - np.clip(twist, -0.5 * drive.gap, 0.5 * drive.gap)
        gear = -(drive.stiffness * twist + drive.damping * rate)
        if drive.cubic:
            gear -= drive.cubic * twist**3
        if drive.hysteresis:
            gear -= h
            out[5] = rate * drive.stiffness * 0.5 * (1.0 - np.sign(rate) * h / drive.hysteresis)
        else:
            out[5] = 0.0
        friction = drive.bristle * z + drive.viscous * vm
        out[0], out[1] = vm, (tau - friction - gear) / drive.rotor
        out[2], out[3] = vl, (gear + WEIGHT * np.cos(ql)) / LINK
        out[4] = vm - drive.bristle / drive.dry * np.abs(vm) * z
        return out

    for k in range(count * inner):
        tau = forward[k] + 4.0e3 * (r[k] - state[0]) + 300.0 * (dr[k] - state[1])
        if k % inner == 0:
            motor[k // inner], link[k // inner], torque[k // inner] = state[0], state[2], tau
        half = state + 0.5 * dt * slope(state, tau)
        state = state + dt * slope(half, tau)
    time = np.arange(count) / rate_hz
    if drive.stiff:
        link = motor.copy()
    late = np.array([np.interp(time - drive.lag_s, time, x) for x in link.T]).T
    late = late + drive.eccentricity * np.sin(late + 0.4) + drive.ripple * np.sin(drive.order * late + 1.0)
    counted = [np.round(x / drive.step) * drive.step for x in (motor, late + 1.0e-3)]
    noisy = torque + drive.torque_noise * rng.standard_normal(torque.shape)
    return Lanes(time, counted[0], counted[1], noisy, rate_hz)


def write_campaign(folder: Path, runs: Lanes, roles: Sequence[str], declared: str) -> Path:
    """Logs, robot file and campaign file of the first lanes, one a role."""
    (folder / "pendulum.urdf").write_text(URDF)
    (folder / "robot.toml").write_text(f'urdf = "pendulum.urdf"\ninertial_parameters = "fitted"\n{declared}')
    lines = [
        'robot = "robot.toml"',
        f"sample_rate_hz = {runs.rate_hz}",
        'joints = ["swing"]',
        '[signals]\nmotor_position = ["q"]\ntorque = ["tau"]\nlink_position = ["s"]',
        "[preprocessing]\ncutoff_hz = 15.0",
    ]
    for i, role in enumerate(roles):
        table = np.column_stack([runs.time, runs.motor[:, i], runs.torque[:, i], runs.link[:, i]])
        np.savetxt(folder / f"log_{i}.csv", table, fmt="%.12g", delimiter=",", header="time,q,tau,s", comments="")
        lines.append(f'[[recording]]\nfile = "log_{i}.csv"\nrole = "{role}"')
    path = folder / "campaign.toml"
    path.write_text("\n".join(lines) + "\n")
    return path
