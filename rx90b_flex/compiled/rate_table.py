"""Friction in a table over the rate.

Cells are 1/16 of an octave: a cell's number is the leading bits of the floating-point number, and a cubic in each leaves
relative errors of 1e-8. Below 2^-30 rad/s the torque is linear, from 2^8 rad/s on the law itself is asked.
"""

from __future__ import annotations

import numpy as np

from rx90b_flex.compiled.compile import Array, Integers, entry, inlined
from rx90b_flex.compiled.laws import Laws, ask

LOWEST, OCTAVES, FINE = -30, 38, 16
CELLS = OCTAVES * FINE
SMALLEST, LARGEST = 2.0**LOWEST, 2.0 ** (LOWEST + OCTAVES)


@inlined
def from_table(table: Array, rate: float) -> tuple[float, float]:
    """Torque and slope by the rate; the rate within the table."""
    size = abs(rate)
    sign, base = (1.0, 0) if rate >= 0.0 else (-1.0, CELLS)
    if size < SMALLEST:
        # from here through the torque of either side's first point
        middle, span = 0.5 * (table[0, 0] + table[CELLS, 0]), 0.5 * (table[0, 0] - table[CELLS, 0])
        return middle + span * rate / SMALLEST, span / SMALLEST
    # exponent and first bits of the mantissa number the cell, the other bits are the place in it
    leading = np.float64(size).view(np.int64) >> 48
    s = size - np.int64(leading << 48).view(np.float64)
    cell = base + leading - ((1023 + LOWEST) << 4)
    c0, c1, c2, c3 = table[cell, 0], table[cell, 1], table[cell, 2], table[cell, 3]
    return c0 + s * (c1 + s * (c2 + s * c3)), sign * (c1 + s * (2.0 * c2 + s * 3.0 * c3))


@entry
def fill_tables(laws: Laws, start: Integers, law: Integers, probes: Array, tabulated: Integers, table: Array) -> None:
    """Cubics with the torque and slope of each cell's ends, for ports whose laws depend on the rate alone."""
    for p in range(len(tabulated)):
        depends = False
        for cell in range(2 * CELLS):
            sign, at = (1.0, cell) if cell < CELLS else (-1.0, cell - CELLS)
            low = 2.0 ** (LOWEST + at // FINE) * (1.0 + (at % FINE) / FINE)
            width = 2.0 ** (LOWEST + at // FINE) / FINE
            ends = np.zeros((2, 2))
            for place in range(start[p], start[p + 1]):
                for end in range(2):
                    rate = sign * (low + end * width)
                    torque, by_x, by_rate = ask(laws, law[place], 0.0, rate)
                    ends[end, 0] += torque
                    ends[end, 1] += by_rate * sign * width
                    depends = depends or by_x != 0.0
                    for x in probes:
                        depends = depends or ask(laws, law[place], x, rate)[0] != torque
            more = ends[1, 0] - ends[0, 0]
            table[p, cell, 0], table[p, cell, 1] = ends[0, 0], ends[0, 1] / width
            table[p, cell, 2] = (3.0 * more - 2.0 * ends[0, 1] - ends[1, 1]) / width**2
            table[p, cell, 3] = (ends[0, 1] + ends[1, 1] - 2.0 * more) / width**3
        tabulated[p] = not depends
