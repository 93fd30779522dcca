"""Logs of an arm with something between robot and log, or friction that remembers: made without the package.

Motions are functions of time, so that a delay is the motion of another time and not an interpolation. Each effect is worked out
from its definition (INTERFACE.md): the true motion goes through `pinocchio.rnea`, no linearisation anywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from independent import Arm, Array, Motion, Torque
from scipy import optimize

BETWEEN = (  # what `log` makes of an effect that is no torque of `independent.hidden`
    "resolver_error",
    "transmission_error",
    "backlash",
    "torque_delay",
    "motor_saturation",
    "line_interference",
    "friction_drift",
    "presliding_friction",
)
SLIP_S = 0.1  # a slip of the encoder takes so long
REVERSAL = 0.001  # rad/s, of tanh: another smoothing of dry friction than the package's


@dataclass(frozen=True, eq=False)
class Experiment:
    """Random harmonics of every joint as a function of time, the friction of the joints, and what else loads them."""

    size: Array
    phase: Array
    centre: Array
    omega: Array
    coulomb: Array
    viscous: Array
    more: tuple[Torque, ...] = ()

    @staticmethod
    def draw(
        rng: np.random.Generator,
        period_s: float,
        speed: float,
        coulomb: Sequence[float],
        viscous: Sequence[float],
        lines: int = 8,
    ) -> Experiment:
        """Every joint's fastest velocity is `speed`, rad/s."""
        n = len(coulomb)
        omega = 2 * np.pi / period_s * np.arange(1, lines + 1)
        size = rng.uniform(0.5, 1.0, (lines, n)) / np.sqrt(omega)[:, None]
        made = Experiment(
            size,
            rng.uniform(0, 2 * np.pi, (lines, n)),
            rng.uniform(-0.8, 0.8, n),
            omega,
            np.asarray(coulomb),
            np.asarray(viscous),
        )
        fastest = np.abs(made.motion(np.arange(0.0, period_s, 0.005)).v).max(axis=0)
        return dataclasses.replace(made, size=size * speed / fastest)

    def motion(self, time: Array) -> Motion:
        """At the given times, (N,)."""
        w = self.omega[:, None]
        angle = w * time[:, None, None] + self.phase
        q = (self.size / w * np.sin(angle)).sum(axis=1)
        v = (self.size * np.cos(angle)).sum(axis=1)
        a = (-self.size * w * np.sin(angle)).sum(axis=1)
        return Motion(time, q + self.centre, v, a)

    def friction(self, m: Motion) -> Array:
        return np.tanh(m.v / REVERSAL) * self.coulomb + m.v * self.viscous

    def torque(self, arm: Arm, time: Array) -> Array:
        """What the motors give."""
        m = self.motion(time)
        return self.on_links(m, arm.torque(m)) + self.friction(m)

    def on_links(self, m: Motion, load: Array) -> Array:
        """Torque that the links ask for and what else loads them."""
        return load + sum((torque(m, load) for torque in self.more), np.zeros_like(load))


def _in_error(m: Motion, j: int, p: Mapping[str, float], sign: float) -> Motion:
    """The motion in which joint j turns by the periodic error more or less."""
    q, v, a = m.q.copy(), m.v.copy(), m.a.copy()
    x = p["order"] * q[:, j] + p["phase"]
    slope, bend = p["amplitude"] * p["order"] * np.cos(x), -p["amplitude"] * p["order"] ** 2 * np.sin(x)
    q[:, j] += sign * p["amplitude"] * np.sin(x)
    v[:, j] += sign * slope * m.v[:, j]
    a[:, j] += sign * (slope * m.a[:, j] + bend * m.v[:, j] ** 2)
    return Motion(m.time, q, v, a)


def log(
    kind: str, arm: Arm, run: Experiment, time: Array, j: int | None, p: Mapping[str, float]
) -> tuple[Array, Array]:
    """Logged positions and torques of an arm with one effect on joint j (None: on the robot); each (N, n)."""
    m = run.motion(time)
    torque = run.torque(arm, time)

    def resolver_error() -> tuple[Array, Array]:
        measured = m.q.copy()
        measured[:, j] += p["amplitude"] * np.sin(p["order"] * m.q[:, j] + p["phase"])
        return measured, torque

    def transmission_error() -> tuple[Array, Array]:
        load = arm.torque(_in_error(m, j, p, 1.0))
        load[:, j] *= 1 + p["amplitude"] * p["order"] * np.cos(p["order"] * m.q[:, j] + p["phase"])
        return m.q, run.on_links(m, load) + run.friction(m)

    def backlash() -> tuple[Array, Array]:
        side = -0.5 * p["gap"] * np.tanh(arm.torque(m)[:, j])
        rate = np.gradient(side, time)
        q, v, a = m.q.copy(), m.v.copy(), m.a.copy()
        for x, change in ((q, side), (v, rate), (a, np.gradient(rate, time))):
            x[:, j] += change
        return m.q, run.on_links(m, arm.torque(Motion(time, q, v, a))) + run.friction(m)

    def torque_delay() -> tuple[Array, Array]:
        late = run.torque(arm, time - p["delay"])
        return m.q, late if j is None else np.where(np.arange(late.shape[1]) == j, late, torque)

    def motor_saturation() -> tuple[Array, Array]:
        c = p["coefficient"]
        top = 1 / np.sqrt(3 * c)
        asked = [optimize.brentq(lambda x, g=g: x - c * x**3 - g, -top, top) for g in torque[:, j]]
        return m.q, np.where(np.arange(torque.shape[1]) == j, np.array(asked)[:, None], torque)

    def slipping_encoder() -> tuple[Array, Array]:
        """Not of the catalogue: at three instants the encoder slips on its shaft."""
        measured = m.q.copy()
        for part in (0.2, 0.5, 0.8):
            since = (time - time[0] - part * (time[-1] - time[0])) / SLIP_S
            measured[:, j] += p["slip"] * 0.5 * (1 + np.tanh(2 * since))
        return measured, torque

    def added(extra: Array) -> tuple[Array, Array]:
        out = torque.copy()
        out[:, j] += extra
        return m.q, out

    def presliding_friction() -> tuple[Array, Array]:
        """Dahl's equation, explicit Euler on a grid of 40 steps a sample."""
        fine = np.linspace(time[0], time[-1], 40 * (len(time) - 1) + 1)
        step = np.diff(run.motion(fine).q[:, j])
        f = np.empty(len(fine))
        f[0] = p["torque"] * np.sign(step[0])
        for k, d in enumerate(step):
            f[k + 1] = f[k] + p["stiffness"] * (1 - f[k] / p["torque"] * np.sign(d)) * d
        return added(f[::40])

    made: dict[str, Callable[[], tuple[Array, Array]]] = {
        "resolver_error": resolver_error,
        "transmission_error": transmission_error,
        "backlash": backlash,
        "torque_delay": torque_delay,
        "slipping_encoder": slipping_encoder,
        "motor_saturation": motor_saturation,
        "line_interference": lambda: added(p["amplitude"] * np.sin(2 * np.pi * p["frequency_hz"] * time + p["phase"])),
        "friction_drift": lambda: added(p["coefficient"] * np.exp(-time / p["time_constant"]) * m.v[:, j]),
        "presliding_friction": presliding_friction,
    }
    return made[kind]()
