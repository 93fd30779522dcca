"""Filters and hysteresis along a signal, sample by sample."""

from __future__ import annotations

import numpy as np

from rx90b_flex.compiled.compile import Array, entry, inlined
from rx90b_flex.compiled.vectors import WIDTH, aligned, as_vectors


@entry
def forward_and_backward(x: Array, sections: Array, steady: Array, pad: int) -> Array:
    """Second-order sections run forward and backward along x (N, k), ends continued by odd reflection over `pad` samples.

    `sections` (s, 6) as SciPy has them, `steady` (s, 2) their state after an endless row of ones. Returns (N, k).
    """
    samples, columns = x.shape
    out = np.empty((samples, columns))
    numbers = aligned(samples + 2 * pad)
    work = as_vectors(numbers)  # a column a lane
    for begin in range(0, columns, WIDTH):
        here = min(WIDTH, columns - begin)
        for i in range(samples):
            for c in range(here):
                numbers[WIDTH * (pad + i) + c] = x[i, begin + c]
        first, last = work[pad], work[pad + samples - 1]
        for i in range(pad):
            work[i] = 2.0 * first - work[2 * pad - i]
            work[pad + samples + i] = 2.0 * last - work[pad + samples - 2 - i]
        _run(work, sections, steady, 0, 1)
        _run(work, sections, steady, len(work) - 1, -1)
        for i in range(samples):
            for c in range(here):
                out[i, begin + c] = numbers[WIDTH * (pad + i) + c]
    return out


@inlined
def _run(work: Array, sections: Array, steady: Array, begin: int, step: int) -> None:
    """Sections along signals, in their place, from `begin` on: two in one pass, for each waits for its own last result."""
    start = work[begin]
    for s in range(0, len(sections), 2):
        b0, b1, b2, a1, a2 = sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 4], sections[s, 5]
        z1, z2 = steady[s, 0] * start, steady[s, 1] * start
        if s + 1 == len(sections):
            for k in range(len(work)):
                u = work[begin + step * k]
                y = b0 * u + z1
                z1 = (b1 * u + z2) - a1 * y
                z2 = b2 * u - a2 * y
                work[begin + step * k] = y
            return
        c0, c1, c2, d1, d2 = (
            sections[s + 1, 0],
            sections[s + 1, 1],
            sections[s + 1, 2],
            sections[s + 1, 4],
            sections[s + 1, 5],
        )
        w1, w2 = steady[s + 1, 0] * start, steady[s + 1, 1] * start
        for k in range(len(work)):
            u = work[begin + step * k]
            y = b0 * u + z1
            z1 = (b1 * u + z2) - a1 * y
            z2 = b2 * u - a2 * y
            v = c0 * y + w1
            w1 = (c1 * y + w2) - d1 * v
            w2 = c2 * y - d2 * v
            work[begin + step * k] = v


@entry
def hysteresis(q: Array, deflection: float, slips: bool) -> Array:
    """Hysteresis over its torque along angles q (N,), rad: from each turn towards 1 or -1, at once at its end if it slips, ever
    more slowly if not.

    How it stands at first nobody knows: at the end towards which the angle first goes further than the deflection, or goes furthest.
    """
    out = np.zeros(len(q))
    direction, farthest = 0.0, 0.0
    for i in range(1, len(q)):
        off = abs(q[i] - q[0])
        if off > farthest:
            farthest = off
            direction = 1.0 if q[i] > q[0] else -1.0
        if off > deflection:
            break
    at, turned = direction, q[0]
    out[:1] = direction
    for i in range(1, len(q)):
        step = q[i] - q[i - 1]
        s = 1.0 if step > 0.0 else (-1.0 if step < 0.0 else direction)
        if s != direction:
            at, turned, direction = out[i - 1], q[i - 1], s
        if slips:
            out[i] = min(max(at + (q[i] - turned) / deflection, -1.0), 1.0)
        else:
            out[i] = s - (s - at) * np.exp(-abs(q[i] - turned) / deflection)
    return out


def dahl(q: Array, deflection: float) -> Array:
    """Dahl's friction over its torque along angles q (N,), rad, exact between samples of monotone motion; shape (N,)."""
    return hysteresis(np.array(q), float(deflection), False)


def maxwell(q: Array, deflection: float) -> Array:
    """Torque over its limit of a spring in series with dry friction, along angles q (N,), rad; shape (N,)."""
    return hysteresis(np.array(q), float(deflection), True)


@entry
def prediction_error_filter(autocovariance: Array, samples: int) -> Array:
    """Autoregression of the order that Akaike's criterion chooses, by Levinson's recursion; coefficients from lag zero on."""
    orders = len(autocovariance)
    found, before, chosen = np.zeros(orders), np.zeros(orders), np.zeros(orders)
    found[0] = chosen[0] = 1.0
    length, best, error = 1, np.inf, autocovariance[0]
    for order in range(orders):
        if error <= 1e-12 * autocovariance[0]:
            break
        criterion = samples * np.log(error) + 2 * order
        if criterion < best:
            best, length = criterion, order + 1
            for i in range(length):
                chosen[i] = found[i]
        if order + 1 < orders:
            along = 0.0
            for i in range(order + 1):
                along += found[i] * autocovariance[order + 1 - i]
            reflection = -along / error
            for i in range(order + 2):
                before[i] = found[i]
            for i in range(order + 2):
                found[i] = before[i] + reflection * before[order + 1 - i]
            error *= 1.0 - reflection**2
    return chosen[:length].copy()


@entry
def decimate(buffer: Array, weights: Array, stride: int, out: Array) -> None:
    """Every `stride`-th sample of a filtered signal.

    Parameters
    ----------
    buffer : (samples, channels)
    weights : (2 half + 1,), symmetric
    out : (outputs, channels)
    """
    half, channels = len(weights) // 2, buffer.shape[1]
    for k in range(out.shape[0]):
        low, high = k * stride, k * stride + 2 * half
        middle = weights[half]
        for c in range(channels):
            out[k, c] = middle * buffer[low + half, c]
        t = 0
        while t + 2 <= half:  # two pairs at a time, which halves the looks at `out`
            w0, w1 = weights[t], weights[t + 1]
            for c in range(channels):
                outer = w0 * (buffer[low + t, c] + buffer[high - t, c])
                out[k, c] += outer + w1 * (buffer[low + t + 1, c] + buffer[high - t - 1, c])
            t += 2
        if t < half:
            w0 = weights[t]
            for c in range(channels):
                out[k, c] += w0 * (buffer[low + t, c] + buffer[high - t, c])
