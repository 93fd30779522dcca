"""The torsions of flexible drives along a motion, sample by sample: what `effects.deflection` repeats most."""

from __future__ import annotations

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, entry


@entry
def swing_free(c: Array, step: float, stiffness: float, cubic: float, damping: float, inertia: float) -> Array:
    """The first two torsions (2, k) of the swing-free answers to cubics of time with coefficients (4, k)."""
    out = np.empty((2, c.shape[1]))
    for i in range(c.shape[1]):
        rest = c[0, i] / stiffness
        for _ in range(60):  # Newton's method; convex on the side of zero where the linear part alone would end
            rest -= (stiffness * rest + cubic * rest**3 - c[0, i]) / (stiffness + 3.0 * cubic * rest**2)
        stiff = stiffness + 3.0 * cubic * rest**2
        x3 = c[3, i] / stiff
        x2 = (c[2, i] - 3.0 * damping * x3) / stiff
        x1 = (c[1, i] - 2.0 * damping * x2 - 6.0 * inertia * x3) / stiff
        out[0, i] = rest - (damping * x1 + 2.0 * inertia * x2) / stiff
        out[1, i] = out[0, i] + step * (x1 + step * (x2 + step * x3))
    return out


@entry
def oscillators(
    at_angle: Array, at_rate: Array, by_a: Array, fast: Array, swings: Array, step: float
) -> tuple[Array, Integers, Array, Array, Array]:
    """The oscillators' equations: factors of x[n], as LU with its pivots, of x[n - 1] and x[n - 2] in row n, and the weights.

    Parameters
    ----------
    at_angle, at_rate, by_a : array, shape (N, m, m)
        Stiffness, damping and inertia along the motion.
    fast : array, shape (N, m)
        Squared frequency, (rad a sample)^2, as far as it counts; above zero.
    swings : array, shape (m,)
        1 where a joint swings, 0 where it follows at once.
    step : float
        Time between samples, s.
    """
    samples, m, _ = at_angle.shape
    now, pivots = at_angle.copy(), np.zeros((samples, m), dtype=np.int64)
    last, before, weight = np.zeros((samples, m, m)), np.zeros((samples, m, m)), np.zeros((samples, m))
    for n in range(samples):
        for i in range(m):
            if swings[i] > 0.0 and 0 < n < samples - 1:
                angle = np.sqrt(fast[n, i])
                turn = 2.0 - 2.0 * np.cos(angle)
                w = (1.0 - turn / angle**2) / turn
                weight[n, i] = w
                for j in range(m):
                    mass, rate, k = by_a[n, i, j] / step**2, at_rate[n, i, j] / (2.0 * step), at_angle[n, i, j]
                    now[n + 1, i, j] = mass + rate + w * k
                    last[n + 1, i, j] = -2.0 * mass + (1.0 - 2.0 * w) * k
                    before[n + 1, i, j] = mass - rate + w * k
    for n in range(samples):
        for k in range(m):
            best = k
            for i in range(k + 1, m):
                if abs(now[n, i, k]) > abs(now[n, best, k]):
                    best = i
            pivots[n, k] = best
            for j in range(m if best != k else 0):
                now[n, k, j], now[n, best, j] = now[n, best, j], now[n, k, j]
            for i in range(k + 1, m):
                now[n, i, k] /= now[n, k, k]
                for j in range(k + 1, m):
                    now[n, i, j] -= now[n, i, k] * now[n, k, j]
    return now, pivots, last, before, weight


@entry
def stepped(
    now: Array, pivots: Integers, last: Array, before: Array, weight: Array, swings: Array, begun: Array, force: Array
) -> Array:
    """Torsions (N, m, k) under forces (N, m, k), by the equations of `oscillators`.

    Where a joint swings, the right sides of its first two are `begun`, (2, m, k).
    """
    samples, m, width = force.shape
    out = np.empty((samples, m, width))
    for n in range(samples):
        for i in range(m):
            for c in range(width):
                if swings[i] == 0.0:
                    out[n, i, c] = force[n, i, c]
                elif n < 2:
                    out[n, i, c] = begun[n, i, c]
                else:
                    w = weight[n - 1, i]
                    right = w * (force[n, i, c] + force[n - 2, i, c]) + (1.0 - 2.0 * w) * force[n - 1, i, c]
                    for j in range(m):
                        right -= last[n, i, j] * out[n - 1, j, c] + before[n, i, j] * out[n - 2, j, c]
                    out[n, i, c] = right
        for i in range(m):  # pivots, then forward and back
            best = pivots[n, i]
            for c in range(width if best != i else 0):
                out[n, i, c], out[n, best, c] = out[n, best, c], out[n, i, c]
        for i in range(m):
            for j in range(i):
                for c in range(width):
                    out[n, i, c] -= now[n, i, j] * out[n, j, c]
        for i in range(m - 1, -1, -1):
            for j in range(i + 1, m):
                for c in range(width):
                    out[n, i, c] -= now[n, i, j] * out[n, j, c]
            for c in range(width):
                out[n, i, c] /= now[n, i, i]
    return out


@entry
def rates(x: Array, step: float, first: Array, second: Array) -> tuple[Array, Array]:
    """First and second derivatives by time of uniform samples (N, k), central with the given weights, ends continued oddly."""
    samples, width = x.shape
    beside = len(first) // 2
    v, a = np.zeros((samples, width)), np.zeros((samples, width))
    flat, of_first, of_second = x.ravel(), v.ravel(), a.ravel()
    for k in range(len(first)):
        begin, count = (2 * beside - k) * width, max(samples - 2 * beside, 0) * width
        there, by_first, by_second = (
            flat[begin : begin + count],
            of_first[beside * width :],
            of_second[beside * width :],
        )
        for at in range(count):
            by_first[at] += first[k] * there[at]
            by_second[at] += second[k] * there[at]
    for i in range(samples):
        for k in range(len(first) if i < beside or i >= samples - beside else 0):
            at = i + beside - k
            for c in range(width):
                if at < 0:
                    value = 2.0 * x[0, c] - x[-at, c]
                elif at >= samples:
                    value = 2.0 * x[samples - 1, c] - x[2 * samples - 2 - at, c]
                else:
                    value = x[at, c]
                v[i, c] += first[k] * value
                a[i, c] += second[k] * value
    for at in range(samples * width):
        of_first[at] /= step
        of_second[at] /= step**2
    return v, a


@entry
def asked(
    load: Array, at_angle: Array, at_rate: Array, by_a: Array, cubic: Array, x: Array, v: Array, a: Array
) -> Array:
    """What torsions and their rates, (N, m) each, leave of a load (N, m) by derivatives (N, m, m); N m."""
    out = np.empty_like(load)
    for n in range(len(load)):
        for i in range(load.shape[1]):
            left = load[n, i] + cubic[i] * x[n, i] ** 3
            for j in range(load.shape[1]):
                left += at_angle[n, i, j] * x[n, j] + at_rate[n, i, j] * v[n, j] + by_a[n, i, j] * a[n, j]
            out[n, i] = left
    return out


@entry
def torques(by_q: Array, by_v: Array, by_a: Array, places: Integers, x: Array, v: Array, a: Array) -> Array:
    """What the tree's derivatives (N, n, n) make of torsions at some places and of their rates, (N, m) each; (m, N, n)."""
    samples, n, _ = by_q.shape
    out = np.empty((len(places), samples, n))
    for i in range(len(places)):
        p = places[i]
        for t in range(samples):
            for j in range(n):
                out[i, t, j] = by_q[t, j, p] * x[t, i] + by_v[t, j, p] * v[t, i] + by_a[t, j, p] * a[t, i]
    return out


@entry
def add_torques(out: Array, by: Array, places: Integers, x: Array) -> None:
    """Put on what derivatives (N, n, n) make of changes (N, m, k) at some places; onto (N, n, k)."""
    samples, n, width = out.shape
    for t in range(samples):
        for j in range(n):
            for i in range(len(places)):
                slope = by[t, j, places[i]]
                for c in range(width):
                    out[t, j, c] += slope * x[t, i, c]


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
