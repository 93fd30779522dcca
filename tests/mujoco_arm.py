"""An arm of three flexible joints in MuJoCo, under its own controller, with its own logger: nothing here is the package's.

Each joint is a body with four hinges in a row: the motor (rotor and gear as armature), the gear's twist about the same axis and
two bendings across it, a spring and a damper each. Dry and viscous friction act on the motor or, by a tendon over motor and twist,
on the joint. A cascade at 2 kHz (position P, velocity PI, torque limit) drives the motors; the log has motor angles as an encoder
counts them and motor torques with noise, both filtered alike and at 500 Hz.

`Arm.drawn` draws all parameters, `write_robot` writes the URDF and the robot file that somebody would have who knows the links and
guesses the rest, `play` runs a reference file.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]

JOINTS = ("waist", "shoulder", "elbow")
AXES = {"waist": (0, 0, 1), "shoulder": (0, 1, 0), "elbow": (0, 1, 0)}
BENDS = {"waist": ((1, 0, 0), (0, 1, 0)), "shoulder": ((0, 0, 1), (1, 0, 0)), "elbow": ((0, 0, 1), (1, 0, 0))}
PLACES = {"waist": (0.0, 0.0, 0.2), "shoulder": (0.1, 0.0, 0.25), "elbow": (0.0, 0.0, 0.5)}  # in the link before, m
LINKS = {  # mass, centre, principal moments about it: kg, m, kg m^2
    "column": (22.0, (0.03, 0.01, 0.15), (0.5, 0.45, 0.4)),
    "upper": (16.0, (0.02, 0.04, 0.24), (0.45, 0.42, 0.12)),
    "lower": (11.0, (0.03, -0.02, 0.26), (0.35, 0.33, 0.09)),
}
TIP = (0.0, 0.0, 0.55)  # in the last link, m
GEARS = (120.0, 140.0, 100.0)
LIMITS = (400.0, 500.0, 200.0)  # N m
CONTROL_HZ, LOG_HZ = 2000.0, 500.0
CUTOFF_HZ = 180.0
COUNTS = 2**17  # of the motor's encoder, a turn
FLOOR_LAG_S = 3e-4  # damping over stiffness
NOTCH = 0.5, 0.2  # damping, and what is left at its frequency
TORQUE_NOISE = 0.001  # of the limit, at the controller's rate


@dataclass(frozen=True)
class Drive:
    """One joint: SI, joint side. The cascade's gains belong to it."""

    inertia: float
    stiffness: float
    damping: float
    bending: tuple[float, float]
    bending_damping: tuple[float, float]
    dry: float
    viscous: float
    position_loop: float
    velocity_loop: float
    integral_time_s: float


TYPICAL = (
    Drive(2.6, 9.0e4, 30.0, (4.0e5, 3.0e5), (130.0, 100.0), 14.0, 35.0, 18.0, 420.0, 0.06),
    Drive(2.2, 1.1e5, 35.0, (3.2e5, 2.6e5), (110.0, 90.0), 16.0, 38.0, 18.0, 480.0, 0.06),
    Drive(0.7, 3.2e4, 10.0, (9.0e4, 6.0e4), (30.0, 20.0), 6.0, 12.0, 18.0, 130.0, 0.06),
)


@dataclass(frozen=True)
class Arm:
    """Drives, the mass of a tool at the tip, and by how much the logger's torques are late against its angles.

    Attributes
    ----------
    friction : ``motor`` or ``joint``
    floor : (about x, about y) or None
        Stiffnesses of what the arm stands on, N m/rad.
    speed_hz, notch_hz : float
        Of a low-pass of the measured speeds, and of a notch (`NOTCH`) of the torques that are asked for; 0: none.
    """

    drives: tuple[Drive, ...] = TYPICAL
    friction: str = "motor"
    tool_kg: float = 0.0
    torque_late_s: float = 0.0
    floor: tuple[float, float] | None = None
    speed_hz: float = 0.0
    notch_hz: float = 0.0
    seed: int = 0

    @classmethod
    def drawn(cls, seed: int, **changes: object) -> Arm:
        """Parameters within a quarter of `TYPICAL`, each for itself."""
        rng = np.random.default_rng([seed, 1])
        drives = []
        for typical in TYPICAL:
            by = rng.uniform(0.75, 1.25, 9)
            drives.append(dataclasses.replace(
                typical, inertia=typical.inertia * by[0], stiffness=typical.stiffness * by[1], damping=typical.damping * by[2],
                bending=(typical.bending[0] * by[3], typical.bending[1] * by[4]),
                bending_damping=(typical.bending_damping[0] * by[5], typical.bending_damping[1] * by[6]),
                dry=typical.dry * by[7], viscous=typical.viscous * by[8],
            ))  # fmt: skip
        return cls(tuple(drives), seed=seed, **changes)  # type: ignore[arg-type]

    @property
    def truth(self) -> dict[str, float]:
        """Inertias and stiffnesses by the names that a grey box gives them."""
        out = {}
        for joint, d in zip(JOINTS, self.drives, strict=True):
            out |= {f"{joint}.drive_inertia": d.inertia, f"{joint}.drive_stiffness": d.stiffness}
            out |= {f"{joint}.joint_stiffness_{i + 1}": k for i, k in enumerate(d.bending)}
        return out

    @property
    def skew_s(self) -> float:
        """By which logged torques are late against what acts: a command acts half a period of the controller later, on average."""
        return self.torque_late_s - 0.5 / CONTROL_HZ

    def mjcf(self) -> str:
        """Of the arm."""
        body, tendons = "", ""
        for joint, d, (link, (mass, centre, moments)) in zip(
            reversed(JOINTS), reversed(self.drives), reversed(LINKS.items()), strict=True
        ):
            ball = f'<inertial mass="{self.tool_kg}" pos="0 0 0" diaginertia="0.002 0.002 0.002"/>'
            tool = f'<body pos="{_text(TIP)}">{ball}</body>' if link == "lower" and self.tool_kg else ""
            at_motor = (d.dry, d.viscous) if self.friction == "motor" else (0.0, 0.0)
            first, second = BENDS[joint]
            below = self._floor() if joint == JOINTS[0] else ""
            body = f"""<body name="{link}" pos="{_text(PLACES[joint])}">{below}
              <joint name="{joint}" axis="{_text(AXES[joint])}" armature="{d.inertia}"
                     frictionloss="{at_motor[0]}" damping="{at_motor[1]}" solreffriction="0.001 1" solimpfriction="0.99 0.99 1"/>
              <joint name="{joint}_twist" axis="{_text(AXES[joint])}" stiffness="{d.stiffness}" damping="{d.damping}"/>
              <joint name="{joint}_bend_1" axis="{_text(first)}" stiffness="{d.bending[0]}" damping="{d.bending_damping[0]}"/>
              <joint name="{joint}_bend_2" axis="{_text(second)}" stiffness="{d.bending[1]}" damping="{d.bending_damping[1]}"/>
              <inertial mass="{mass}" pos="{_text(centre)}" diaginertia="{_text(moments)}"/>{tool}{body}</body>"""
            if self.friction == "joint":
                tendons += f"""<fixed name="{joint}" frictionloss="{d.dry}" damping="{d.viscous}" solreffriction="0.001 1"
                  solimpfriction="0.99 0.99 1"><joint joint="{joint}" coef="1"/><joint joint="{joint}_twist" coef="1"/></fixed>"""
        return f"""<mujoco><compiler angle="radian" autolimits="false"/>
          <option timestep="{1.0 / CONTROL_HZ}" integrator="RK4" jacobian="dense"><flag contact="disable" limit="disable"/></option>
          <worldbody>{body}</worldbody><tendon>{tendons}</tendon></mujoco>"""

    def _floor(self) -> str:
        """Hinges at the base's origin, before the first joint."""
        x, y, z = PLACES[JOINTS[0]]
        stiffness = zip(("1 0 0", "0 1 0"), self.floor or (), strict=False)
        return "".join(
            f'<joint axis="{axis}" pos="{-x} {-y} {-z}" stiffness="{k}" damping="{FLOOR_LAG_S * k}"/>'
            for axis, k in stiffness
        )


def _text(numbers: tuple[float, ...]) -> str:
    return " ".join(repr(x) for x in numbers)


# ---- what its owner knows -----------------------------------------------------------------------------------------


def write_urdf(path: Path) -> None:
    """The rigid links, which are known."""
    before, parts = "base", ['<robot name="arm"><link name="base"/>']
    limits = zip(JOINTS, LINKS.items(), LIMITS, strict=True)
    for joint, (link, (mass, centre, (x, y, z))), limit in limits:
        parts.append(f"""<link name="{link}"><inertial><origin xyz="{_text(centre)}"/><mass value="{mass}"/>
          <inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial></link>
          <joint name="{joint}" type="revolute"><parent link="{before}"/><child link="{link}"/><origin xyz="{_text(PLACES[joint])}"/>
          <axis xyz="{_text(AXES[joint])}"/><limit lower="-2.5" upper="2.5" effort="{limit}" velocity="3"/></joint>""")
        before = link
    parts.append(f"""<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="lower"/><child link="tip"/>
      <origin xyz="{_text(TIP)}"/></joint></robot>""")
    path.write_text("\n".join(parts))


def write_robot(arm: Arm, folder: Path, without: tuple[str, ...] = (), guess: float = 0.2) -> Path:
    """URDF and robot file: values wrong by up to a part `guess`; `without` leaves out effects (``elbow.drive_flexibility``)."""
    rng = np.random.default_rng([arm.seed, 2])
    write_urdf(folder / "arm.urdf")
    lines = ['name = "arm"', 'urdf = "arm.urdf"', 'tip_frame = "tip"', 'inertial_parameters = "known"']

    def off(value: float) -> float:
        return float(value * rng.uniform(1.0 - guess, 1.0 + guess))

    for joint, d in zip(JOINTS, arm.drives, strict=True):
        side = {"side": f'"{arm.friction}"'}
        bending = [off(k) for k in d.bending]
        effects: dict[str, dict[str, object]] = {
            "drive_inertia": {"inertia": off(d.inertia)},
            "drive_flexibility": {"stiffness": off(d.stiffness), "damping": off(d.damping)},
            "joint_flexibility": {"stiffness": bending, "damping": [off(x) for x in d.bending_damping]},
            "coulomb_friction": {"torque": off(d.dry), **side},
            "viscous_friction": {"coefficient": off(d.viscous), **side},
        }
        for kind, values in effects.items():
            if f"{joint}.{kind}" not in without:
                lines += ["", "[[effects]]", f'type = "{kind}"', f'joint = "{joint}"']
                lines += [f"{key} = {value}" for key, value in values.items()]
    path = folder / "arm.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_controller(arm: Arm, path: Path) -> Path:
    """The cascades as the arm's maker states them."""
    lines = [f"reference_rate_hz = {LOG_HZ}", f"controller_rate_hz = {CONTROL_HZ}", f"log_rate_hz = {LOG_HZ}"]
    lines += [f"log_cutoff_hz = {CUTOFF_HZ}"]
    for joint, d, gear, limit in zip(JOINTS, arm.drives, GEARS, LIMITS, strict=True):
        lines += ["", "[[cascade]]", f'name = "{joint}"', f"position_loop = {d.position_loop}"]
        lines += [
            f"velocity_loop = {d.velocity_loop}",
            f"integral_time_s = {d.integral_time_s}",
            "velocity_feedforward = 1.0",
        ]
        lines += [f"position_step = {2.0 * np.pi / COUNTS / gear}", f"torque_limit = {limit}"]
        if arm.speed_hz:
            lines.append(f'velocity_filters = [{{ type = "low_pass", frequency_hz = {arm.speed_hz} }}]')
        if arm.notch_hz:
            form = f"frequency_hz = {arm.notch_hz}, damping = {NOTCH[0]}, depth = {NOTCH[1]}"
            lines.append(f'torque_filters = [{{ type = "notch", {form} }}]')
    path.write_text("\n".join(lines) + "\n")
    return path


# ---- running ------------------------------------------------------------------------------------------------------


def play(arm: Arm, reference: Path, log: Path, periods: int, run: int) -> None:
    """Play a reference file over and over, and write what the logger has: motor angles and torques on the motor's side."""
    names = reference.read_text().split("\n", 1)[0].split(",")
    table = dict(zip(names, np.loadtxt(reference, delimiter=",", skiprows=1).T, strict=True))
    rate = 1.0 / (table["time"][1] - table["time"][0])
    position, speed, fed = (
        _at_controller(np.stack([table.get(f"{kind}{j}", 0.0 * table["time"]) for j in JOINTS], axis=1), rate)
        for kind in ("", "v_", "ff_")
    )
    angle, torque = _simulate(arm, position, speed, fed, periods)
    rng = np.random.default_rng([arm.seed, 3, run])
    torque = torque + TORQUE_NOISE * np.array(LIMITS) * rng.standard_normal(torque.shape)
    late = round(arm.torque_late_s * CONTROL_HZ)
    assert abs(late - arm.torque_late_s * CONTROL_HZ) < 1e-9
    torque = np.roll(torque, late, axis=0)
    up = round(CONTROL_HZ / LOG_HZ)
    gears = np.array(GEARS)
    filtered = [_filtered(x)[::up] for x in (angle * gears, torque / gears)]
    columns = np.column_stack([np.arange(len(filtered[0])) / LOG_HZ, *filtered])
    head = ",".join(["time", *(f"angle_{j}" for j in JOINTS), *(f"torque_{j}" for j in JOINTS)])
    log.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(log, columns, delimiter=",", header=head, comments="", fmt="%.9g")


def _at_controller(wave: Array, rate: float) -> Array:
    """A period of references at the controller's rate, straight lines between rows."""
    up = round(CONTROL_HZ / rate)
    time = np.arange(len(wave) * up) / up
    closed = np.vstack([wave, wave[:1]])
    return np.stack([np.interp(time, np.arange(len(closed)), x) for x in closed.T], axis=1)


def _filtered(x: Array) -> Array:
    taps = signal.firwin(129, CUTOFF_HZ, fs=CONTROL_HZ)
    padded = np.vstack([2 * x[0] - x[64:0:-1], x, 2 * x[-1] - x[-2:-66:-1]])
    return np.asarray(signal.oaconvolve(padded, taps[:, None], mode="valid", axes=0))


def _notch(hz: float) -> tuple[Array, Array]:
    """Numerator and denominator at the controller's rate; those of a filter that does nothing for 0 Hz."""
    (damping, depth), k = NOTCH, np.tan(np.pi * hz / CONTROL_HZ)
    b, a = (
        np.array([1.0 + c + k * k, 2.0 * (k * k - 1.0), 1.0 - c + k * k])
        for c in 2.0 * damping * k * np.array([depth, 1.0])
    )
    return b / a[0], a / a[0]


def _simulate(arm: Arm, position: Array, speed: Array, fed: Array, periods: int) -> tuple[Array, Array]:
    """Motor angles as counted and torques as commanded, at the controller's instants, joint side."""
    model = mujoco.MjModel.from_xml_string(arm.mjcf())
    data = mujoco.MjData(model)
    places = np.array([model.joint(j).dofadr[0] for j in JOINTS])
    data.qpos[places], data.qvel[places] = position[0], speed[0]
    gains = [
        np.array([getattr(d, k) for d in arm.drives]) for k in ("position_loop", "velocity_loop", "integral_time_s")
    ]
    loop, damping, time = gains
    step, limits = 2.0 * np.pi / COUNTS / np.array(GEARS), np.array(LIMITS)
    mujoco.mj_inverse(model, data)
    held = data.qfrc_inverse[places] / damping * time  # the integral that carries the weight
    count = len(position) * periods
    angle, torque = np.empty((count, 3)), np.empty((count, 3))
    last = np.round(data.qpos[places] / step) * step - speed[0] / CONTROL_HZ
    part = 1.0 - np.exp(-2.0 * np.pi * arm.speed_hz / CONTROL_HZ) if arm.speed_hz else 1.0
    slow, (b, a) = speed[0].copy(), _notch(arm.notch_hz)
    notch = (
        signal.lfilter_zi(b, a)[:, None] * (data.qfrc_inverse[places] + fed[0]) if arm.notch_hz else np.zeros((2, 3))
    )
    for k in range(count):
        i = k % len(position)
        seen = np.round(data.qpos[places] / step) * step
        slow = slow + part * ((seen - last) * CONTROL_HZ - slow)
        asked = loop * (position[i] - seen) + speed[i] - slow
        held = held + asked / CONTROL_HZ
        wanted = damping * (asked + held / time) + fed[i]
        passed = b[0] * wanted + notch[0]
        notch = np.stack([b[1] * wanted - a[1] * passed + notch[1], b[2] * wanted - a[2] * passed])
        command = np.clip(passed, -limits, limits)
        angle[k], torque[k], last = seen, command, seen
        data.qfrc_applied[places] = command
        mujoco.mj_step(model, data)
    return angle, torque


# ---- slow motion, logged over time --------------------------------------------------------------------------------


def write_slow_reference(path: Path, seed: int, period_s: float, speed: float = 0.8) -> None:
    """Eight harmonics of a period that are drawn for each joint, its largest speed as stated, rad/s."""
    rng = np.random.default_rng([seed, 7])
    time = np.arange(round(period_s * LOG_HZ)) / LOG_HZ
    pace = 2.0 * np.pi / period_s * np.arange(1, 9)[:, None]
    size, phase = rng.uniform(0.5, 1.0, (8, 3)) / np.sqrt(pace), rng.uniform(0.0, 2.0 * np.pi, (8, 3))
    angle = pace[:, None] * time[:, None] + phase[:, None]
    velocity, position = (size[:, None] * np.cos(angle)).sum(axis=0), (size / pace)[:, None] * np.sin(angle)
    fits = speed / np.abs(velocity).max(axis=0)
    columns = [time, position.sum(axis=0) * fits + [0.0, 0.9, 0.6], velocity * fits]
    names = ["time", *JOINTS, *(f"v_{j}" for j in JOINTS)]
    np.savetxt(path, np.column_stack(columns), delimiter=",", comments="", header=",".join(names))


def write_slow_campaign(
    arm: Arm, declared: Arm, folder: Path, cutoff_hz: float, period_s: float = 16.0, without: tuple[str, ...] = ()
) -> Path:
    """Two recordings to identify the arm and one held out, and the file of what its owner declares."""
    write_robot(declared, folder, without, guess=0.0)
    lines = ['robot = "arm.toml"', f"sample_rate_hz = {LOG_HZ}", f"joints = {list(JOINTS)}", "[signals]"]
    lines += [f"motor_position = {[f'angle_{j}' for j in JOINTS]}", f"torque = {[f'torque_{j}' for j in JOINTS]}"]
    lines += ["[motor]", f"gear_matrix = {np.diag(GEARS).tolist()}", "offset = [0.0, 0.0, 0.0]"]
    lines += ["[preprocessing]", f"cutoff_hz = {cutoff_hz}"]
    for i, role in enumerate(("identification", "identification", "validation")):
        write_slow_reference(folder / f"reference_{i}.csv", arm.seed * 10 + i, period_s)
        play(arm, folder / f"reference_{i}.csv", folder / f"log_{i}.csv", 2, i)
        lines += ["[[recording]]", f'file = "log_{i}.csv"', f'role = "{role}"', f"start_s = {period_s / 2}"]
    path = folder / "campaign.toml"
    path.write_text("\n".join(lines) + "\n")
    return path
