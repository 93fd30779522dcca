"""Filters in a joint's controller: chains of low-passes and notches, each a second-order section at the controller's rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from rx90b_flex.effects.motion import Array
from rx90b_flex.files.table import TomlTable

NOTCH = "notch"
KINDS = ("low_pass", NOTCH)
NOTHING = (1.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Filter:
    """One filter; its gain at rest is 1.

    A low-pass without damping is of first order, ``y_k = y_(k-1) + (1 - exp(-w T)) (x_k - y_(k-1))``, with w = 2 pi frequency_hz and
    the controller's period T. The others are, by the bilinear transform prewarped at their frequency, ::

        low-pass  w^2 / (s^2 + 2 damping w s + w^2)
        notch     (s^2 + 2 depth damping w s + w^2) / (s^2 + 2 damping w s + w^2)

    Attributes
    ----------
    type : ``low_pass`` or ``notch``
    frequency_hz : float
    damping : float
        Of the denominator; a notch is ``2 damping frequency_hz`` wide.
    depth : float
        Gain of a notch at its frequency, 0 to 1; 0: nothing passes.
    """

    type: str
    frequency_hz: float
    damping: float = 0.0
    depth: float = 0.0

    def section(self, period: float) -> tuple[float, ...]:
        """``b0, b1, b2, a1, a2`` of ``(b0 + b1/z + b2/z^2) / (1 + a1/z + a2/z^2)``."""
        w = 2.0 * math.pi * self.frequency_hz
        if self.damping == 0.0:
            left = math.exp(-w * period)
            return 1.0 - left, 0.0, 0.0, -left, 0.0
        through = (1.0, 2.0 * self.depth * self.damping, 1.0) if self.type == NOTCH else (0.0, 0.0, 1.0)
        # in s / w: prewarped, that is s = w / tan(w T / 2) (z - 1) / (z + 1)
        b, a = signal.bilinear(through, (1.0, 2.0 * self.damping, 1.0), 0.5 / math.tan(0.5 * w * period))
        return tuple(float(x) for x in (*b, *a[1:]))


def read_filters(table: TomlTable, key: str, rate_hz: float) -> tuple[Filter, ...]:
    """The chain that a controller's table states under a key; empty where it states none.

    Raises
    ------
    ValueError
        One line that names file, table and key.
    """
    if not table.has(key):
        return ()
    out = []
    for entry in table.sections(key):
        where = TomlTable(table.file, f"{table.name} {entry.name}", entry.values)
        where.allow("type", "frequency_hz", "damping", "depth")
        if not where.has("type"):
            raise where.problem("type", f"missing; {' or '.join(map(repr, KINDS))} is expected")
        kind, hz = where.one_of("type", KINDS), where.positive("frequency_hz")
        if not hz < 0.5 * rate_hz:
            raise where.problem(
                "frequency_hz", f"found {hz:g}, expected less than half of controller_rate_hz = {rate_hz:g}"
            )
        damping = where.positive("damping") if kind == NOTCH else where.optional("damping", where.not_negative) or 0.0
        depth = where.optional("depth", where.not_negative) or 0.0
        if depth > (1.0 if kind == NOTCH else 0.0):
            raise where.problem(
                "depth", f"found {depth:g}, expected {'0 to 1' if kind == NOTCH else 'none: only a notch has it'}"
            )
        out.append(Filter(kind, hz, damping, depth))
    return tuple(out)


def sections_of(chains: Sequence[Sequence[Filter]], period: float) -> Array:
    """Second-order sections of a chain a joint, (joints, longest chain, 5); chains that are shorter end in ones that do nothing."""
    longest = max((len(chain) for chain in chains), default=0)
    rows = [[f.section(period) for f in chain] + [NOTHING] * (longest - len(chain)) for chain in chains]
    return np.array(rows, dtype=float).reshape(len(chains), longest, 5)


def response_of(sections: Array, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Of such chains at z, shape (N, 1): (N, joints)."""
    b0, b1, b2, a1, a2 = np.moveaxis(sections, -1, 0)
    each = (b0 + b1 / z[..., None] + b2 / z[..., None] ** 2) / (1.0 + a1 / z[..., None] + a2 / z[..., None] ** 2)
    return np.asarray(each.prod(axis=-1), dtype=np.complex128)


def at_rest(sections: Array, x: Array) -> Array:
    """What such chains, written as in `rx90b_flex.compiled.controller`, remember of inputs (joints, lanes) that stay as they are.

    Shape (joints, sections, 2, lanes).
    """
    b0, _, b2, _, a2 = np.moveaxis(sections, -1, 0)
    return np.stack([1.0 - b0, b2 - a2], axis=-1)[..., None] * x[:, None, None, :]
