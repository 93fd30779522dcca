"""The torsion of one flexible drive along a motion, sample by sample: `effects.deflection` for a single joint."""

from __future__ import annotations

import numpy as np

from rx90b_flex.compiled.compile import Array, entry

CUBIC = 4  # coefficients


@entry
def samples_of_a_swing(fast: Array) -> int:
    """From its squared frequency, (rad a sample)^2, along a motion (N,)."""
    return int(2.0 * np.pi / np.sqrt(max(np.median(fast), 1e-6)))


@entry
def steps_alone(
    at_angle: Array, at_rate: Array, by_a: Array, step: float, least: float, fastest: float
) -> tuple[Array, Array, Array, Array, bool, int]:
    """The oscillator's equations: factors of x[n], x[n - 1], x[n - 2] in row n, weights, whether the joint
    swings at all, and the samples of a swing.

    Parameters
    ----------
    at_angle, at_rate, by_a : array, shape (N,)
        Stiffness, damping and inertia along the motion.
    step : float
        Time between samples, s; zero where they are not a motion in time.
    least : float
        Part of the median inertia that is stepped on with at least.
    fastest : float
        Frequency, rad a sample, above which the torsion follows the torque at once.
    """
    samples = len(at_angle)
    typical = np.median(by_a)
    inertia = by_a.copy()
    if typical > 0.0:
        inertia = np.maximum(inertia, least * typical)
    fast = np.empty(samples)
    for i in range(samples):
        fast[i] = at_angle[i] * step**2 / inertia[i] if inertia[i] > 0.0 else 0.0
    swings = bool(step > 0.0 and typical > 0.0 and np.median(fast) < fastest**2)
    now, last, before, weight = at_angle.copy(), np.zeros(samples), np.zeros(samples), np.zeros(samples)
    if not swings:
        return now, last, before, weight, swings, 0
    swing = samples_of_a_swing(fast)
    for i in range(1, samples - 1):
        angle = np.sqrt(min(max(fast[i], 1e-6), fastest**2))
        turn = 2.0 - 2.0 * np.cos(angle)
        w = (1.0 - turn / angle**2) / turn
        mass, rate = inertia[i] / step**2, at_rate[i] / (2.0 * step)
        weight[i + 1] = w
        now[i + 1] = mass + rate + w * at_angle[i]
        last[i + 1] = -2.0 * mass + (1.0 - 2.0 * w) * at_angle[i]
        before[i + 1] = mass - rate + w * at_angle[i]
    return now, last, before, weight, swings, swing


@entry
def begun_slowly(
    force: Array, samples: int, step: float, stiffness: float, cubic: float, damping: float, inertia: float
) -> Array:
    """The first two torsions (2,) of the swing-free answer to a cubic through the first samples of a force (N,).

    ``inertia x'' + damping x' + stiffness x + cubic x^3`` of a polynomial x is that cubic, to first order beyond rest. What the first
    samples are off by themselves, a log's noise at its end, would else set the link swinging.
    """
    many = max(min(samples, len(force)), min(CUBIC, len(force)))
    powers = np.ones((many, CUBIC))
    for i in range(many):
        for k in range(1, CUBIC):
            powers[i, k] = powers[i, k - 1] * i * step
    scale = np.maximum(np.sqrt((powers**2).sum(axis=0)), 1e-300)
    c = np.linalg.lstsq(powers / scale, force[:many].copy())[0] / scale
    rest = c[0] / stiffness
    for _ in range(60):  # Newton's method; convex on the side of zero where the linear part alone would end
        rest -= (stiffness * rest + cubic * rest**3 - c[0]) / (stiffness + 3.0 * cubic * rest**2)
    stiff = stiffness + 3.0 * cubic * rest**2
    x3 = c[3] / stiff
    x2 = (c[2] - 3.0 * damping * x3) / stiff
    x1 = (c[1] - 2.0 * damping * x2 - 6.0 * inertia * x3) / stiff
    x0 = rest - (damping * x1 + 2.0 * inertia * x2) / stiff
    return np.array([x0, x0 + step * (x1 + step * (x2 + step * x3))])


@entry
def stepped(now: Array, last: Array, before: Array, weight: Array, swings: bool, begun: Array, force: Array) -> Array:
    """Torsions (N,) under forces (N,), by the equations of `steps_alone`; where a joint swings, from the first two (2,) on."""
    out = np.empty(len(force))
    if swings:
        out[:2] = begun
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
def torsion_alone(
    load: Array,
    by_q: Array,
    by_v: Array,
    by_a: Array,
    spring: tuple[float, float, float],
    step: float,
    least: float,
    fastest: float,
    first: Array,
    second: Array,
    corrections: int,
    largest: float,
) -> Array:
    """Torsion (N,), rad, of one drive under a load (N,), N m; `spring` has its stiffness, lag and cubic part.

    Zero where no drive twists like that: values from which a fit turns back.
    """
    stiffness, lag, cubic = spring
    at_angle, at_rate = by_q + stiffness, by_v + stiffness * lag
    now, last, before, weight, swings, swing = steps_alone(at_angle, at_rate, by_a, step, least, fastest)
    begun = begun_slowly(-load, swing, step, at_angle[0], cubic, at_rate[0], max(by_a[0], 0.0))
    torsion = stepped(now, last, before, weight, swings, begun, -load)
    for _ in range(corrections):
        if not np.isfinite(torsion).all() or np.abs(torsion).max() > largest:
            return np.zeros_like(load)
        v, a = rates(torsion, step, first, second)
        if cubic != 0.0:  # Newton's steps
            stiffer = at_angle + 3.0 * cubic * torsion**2
            now, last, before, weight, swings, _ = steps_alone(stiffer, at_rate, by_a, step, least, fastest)
        asked = load + cubic * torsion**3 + at_angle * torsion + at_rate * v + by_a * a
        torsion = torsion + stepped(now, last, before, weight, swings, np.zeros(2), -asked)
    return torsion


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
