"""The sampled closed loop of a controller and a robot about a point as one state space: what responses are held against."""

from __future__ import annotations

import control
import numpy as np
from scipy import linalg

from rx90b_flex.linearize import Linearization
from rx90b_flex.simulate import CS8


def sampled_loop(controller: CS8, linearization: Linearization) -> control.StateSpace:
    """From torques fed forward to drive angles, then drive torques; states: coordinates, rates, filters, integrators, currents."""
    own = controller.for_joints(linearization.joints)
    n, m = len(linearization.coordinates), len(own.joints)
    b = linearization.input_matrix
    solved = np.linalg.solve(linearization.M, np.hstack([-linearization.K, -linearization.D, b]))
    rates = np.block([[np.zeros((n, n)), np.eye(n), np.zeros((n, m))], [solved], [np.zeros((m, 2 * n + m))]])
    step = linalg.expm(rates * own.period)
    f, g = step[: 2 * n, : 2 * n], step[: 2 * n, 2 * n :]
    pick, law = linalg.block_diag(b.T, b.T), _law(own)
    angle, nothing = np.hstack([b.T, np.zeros((m, n + len(law.A)))]), np.zeros((m, m))
    seen, fed = slice(0, 2 * m), slice(2 * m, None)
    torque = np.hstack([law.D[:, seen] @ pick, law.C])
    a = np.block([[f, np.zeros((2 * n, len(law.A)))], [law.B[:, seen] @ pick, law.A]])
    a[: 2 * n] += g @ torque
    inputs, outputs = np.vstack([g @ law.D[:, fed], law.B[:, fed]]), np.vstack([angle, torque])
    return control.ss(a, inputs, outputs, np.vstack([nothing, law.D[:, fed]]), own.period)


def _law(controller: CS8) -> control.StateSpace:
    """From angles, speeds and torques fed forward, (3 joints,), to the torques that act until the next sample, (joints,)."""
    one, t, (mean, decay) = np.eye(len(controller.joints)), controller.period, controller.current_loop
    speed, torque = (control.append(*(_chain(own, t) for own in each)) for each in controller.sections)
    kp, kv, ki, kf = (
        np.diag(controller.column(f"{x}_gain")) for x in ("position", "velocity", "integral", "filtered_speed")
    )

    def plain(gain: np.ndarray) -> control.StateSpace:
        return control.ss([], [], [], gain, t)

    # of angle, speed, filtered speed and torque fed forward: what is asked for at once, and what is summed
    asked = np.block([[-kp, 0.0 * one, -kv, one], [-ki, kf, -kf, 0.0 * one]])
    copied = np.vstack([np.eye(3 * len(one))[: 2 * len(one)], np.eye(3 * len(one))[len(one) :]])
    law = plain(asked) * control.append(plain(np.eye(2 * len(one))), speed, plain(one)) * plain(copied)
    summed = control.append(plain(one), control.ss(one, t * one, one, t * one, t))
    current = control.ss(decay * one, (1.0 - decay) * one, mean * one, (1.0 - mean) * one, t)
    return current * torque * plain(np.hstack([one, one])) * summed * law


def _chain(sections: np.ndarray, period: float) -> control.StateSpace:
    """Second-order sections (n, 5), one after another."""
    out = control.ss([], [], [], [[1.0]], period)
    for b0, b1, b2, a1, a2 in sections.tolist():
        out = control.ss([[-a1, 1.0], [-a2, 0.0]], [[b1 - a1 * b0], [b2 - a2 * b0]], [[1.0, 0.0]], [[b0]], period) * out
    return out
