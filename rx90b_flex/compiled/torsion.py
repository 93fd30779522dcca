"""The torsion of one flexible drive along a motion, sample by sample: `effects.deflection` for a single joint."""

from __future__ import annotations

import numpy as np

from rx90b_flex.compiled.compile import Array, entry


@entry
def oscillator(at_angle: Array, at_rate: Array, inertia: Array, fast: Array, step: float, fastest: float) -> Array:
    """The oscillator's equations: factors of x[n], x[n - 1], x[n - 2] in row n, and the weights; (4, N).

    Parameters
    ----------
    at_angle, at_rate, inertia : array, shape (N,)
        Stiffness, damping and inertia along the motion.
    fast : array, shape (N,)
        Squared frequency, (rad a sample)^2.
    step : float
        Time between samples, s; zero where the joint follows the torque at once.
    fastest : float
        Frequency, rad a sample, that counts at the most.
    """
    samples = len(at_angle)
    out = np.zeros((4, samples))
    for i in range(samples):
        out[0, i] = at_angle[i]
    if step == 0.0:
        return out
    for i in range(1, samples - 1):
        angle = np.sqrt(min(max(fast[i], 1e-6), fastest**2))
        turn = 2.0 - 2.0 * np.cos(angle)
        w = (1.0 - turn / angle**2) / turn
        mass, rate = inertia[i] / step**2, at_rate[i] / (2.0 * step)
        out[0, i + 1] = mass + rate + w * at_angle[i]
        out[1, i + 1] = -2.0 * mass + (1.0 - 2.0 * w) * at_angle[i]
        out[2, i + 1] = mass - rate + w * at_angle[i]
        out[3, i + 1] = w
    return out


@entry
def swing_free(c: Array, step: float, stiffness: float, cubic: float, damping: float, inertia: float) -> Array:
    """The first two torsions (2,) of the swing-free answer to the cubic of time with coefficients (4,)."""
    rest = c[0] / stiffness
    for _ in range(60):  # Newton's method; convex on the side of zero where the linear part alone would end
        rest -= (stiffness * rest + cubic * rest**3 - c[0]) / (stiffness + 3.0 * cubic * rest**2)
    stiff = stiffness + 3.0 * cubic * rest**2
    x3 = c[3] / stiff
    x2 = (c[2] - 3.0 * damping * x3) / stiff
    x1 = (c[1] - 2.0 * damping * x2 - 6.0 * inertia * x3) / stiff
    out = np.empty(2)
    out[0] = rest - (damping * x1 + 2.0 * inertia * x2) / stiff
    out[1] = out[0] + step * (x1 + step * (x2 + step * x3))
    return out


@entry
def stepped(equations: Array, swings: bool, begun: Array, force: Array) -> Array:
    """Torsions (N,) under forces (N,), by the equations of `oscillator` (4, N); where a joint swings, from the first two (2,) on."""
    now, last, before, weight = equations[0], equations[1], equations[2], equations[3]
    out = np.empty(len(force))
    if swings:
        out[0], out[1] = begun[0], begun[1]
    for i in range(2 if swings else 0, len(force)):
        if swings:
            w = weight[i]
            right = w * (force[i] + force[i - 2]) + (1.0 - 2.0 * w) * force[i - 1]
            out[i] = (right - last[i] * out[i - 1] - before[i] * out[i - 2]) / now[i]
        else:
            out[i] = force[i] / now[i]
    return out


@entry
def rates(x: Array, step: float, first: Array, second: Array) -> tuple[Array, Array]:
    """First and second derivatives by time of uniform samples (N,), central with the given weights, ends continued oddly."""
    samples, beside = len(x), len(first) // 2
    v, a = np.zeros(samples), np.zeros(samples)
    if step == 0.0:
        return v, a
    for i in range(samples):
        for k in range(len(first)):
            at = i + beside - k
            if at < 0:
                value = 2.0 * x[0] - x[-at]
            elif at >= samples:
                value = 2.0 * x[samples - 1] - x[2 * samples - 2 - at]
            else:
                value = x[at]
            v[i] += first[k] * value
            a[i] += second[k] * value
        v[i] /= step
        a[i] /= step**2
    return v, a


@entry
def hinges_together(load: Array, at_angle: Array, at_rate: Array, by_a: Array, step: float, parts: int) -> Array:
    """Deflections (N, m) of ``by_a x'' + at_rate x' + at_angle x = -load`` by the trapezoidal rule (Newmark's, beta = 1/4).

    Matrices are (N, m, m) at every `parts`-th step, the load (parts (N - 1) + 1, m). It begins at rest.
    """
    samples, m, _ = at_angle.shape
    out = np.empty((samples, m))
    x, v, a = np.linalg.solve(at_angle[0].copy(), -load[0]), np.zeros(m), np.zeros(m)
    out[0] = x
    for n in range(samples - 1):
        for k in range(1, parts + 1):
            part = k / parts
            mass, rate, stiffness = (
                (1.0 - part) * by_a[n] + part * by_a[n + 1],
                (1.0 - part) * at_rate[n] + part * at_rate[n + 1],
                (1.0 - part) * at_angle[n] + part * at_angle[n + 1],
            )
            coming_x, coming_v = x + step * v + 0.25 * step**2 * a, v + 0.5 * step * a
            asked = -load[n * parts + k] - rate @ coming_v - stiffness @ coming_x
            a = np.linalg.solve(mass + 0.5 * step * rate + 0.25 * step**2 * stiffness, asked)
            x, v = coming_x + 0.25 * step**2 * a, coming_v + 0.5 * step * a
        out[n + 1] = x
    return out
