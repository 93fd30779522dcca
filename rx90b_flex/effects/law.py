"""Scalar laws: effects in the form that a compiled simulation reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from rx90b_flex.effects.motion import Array

LawFunction = Callable[[Any, Any, Any, Any], None]
Where = Literal["force", "links", "measured", "motor"]

# What a function finds behind its own parameters where its law asks for it, and what it writes behind torque and slopes.
TIME, LOAD, BEFORE, REMEMBERED = range(4)
BY_LOAD, ONWARD = 3, 4


@dataclass(frozen=True, eq=False)
class Law:
    """A torque that depends on one combination of the coordinates, ``x = port @ q``, and acts on it alike.

    ``torque = inertia * x'' + damping * x' + stiffness * x + function``, and ``port * torque`` is the generalised
    force.

    Attributes
    ----------
    port : array, shape (n,)
    inertia, damping, stiffness : float
        The linear part.
    function : callable or None
        ``function(x, rate, parameters, out)`` writes torque, slope by x and slope by rate to ``out[0:3]``. Plain
        arithmetic and functions of NumPy that take numbers and arrays alike, without branches and without calls to other
        functions: the simulation compiles it for numbers, `LawEffect` asks it for columns.
    parameters : array
        What the function reads.
    stores : bool
        Whether the function's torque is the gradient of the effect's `potential`; otherwise it dissipates.
    reads : array, shape (n,), or None
        Combination of the coordinates that the function depends on, where it is not the one that it acts on.
    timed, loaded : bool
        Whether it depends on time (s), and on the torque that the links ask of its port's last coordinate (N m). The function
        finds them behind its own parameters: ``parameters[k + TIME]``, ``parameters[k + LOAD]`` with k parameters of its own, and
        writes its slope by the load to ``out[BY_LOAD]``.
    remembers : int
        How many numbers it keeps from one step to the next, zero at first. It finds them at ``parameters[k + REMEMBERED:]``, behind x
        of the step before (``parameters[k + BEFORE]``), and writes what they are at x to ``out[ONWARD:]``; at the same x once more it
        must leave them.
    at : str
        What the function is: ``force``, a torque; ``links``, the angle by which the links are ahead of the port's coordinate, with
        its first two derivatives by it; ``measured``, what a resolver shows beyond its drive's angle, with its slope; ``motor``, what
        the motor at the port gives beyond the torque x that it is asked for.
    """

    port: Array
    inertia: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    function: LawFunction | None = None
    parameters: Array = field(default_factory=lambda: np.zeros(0))
    stores: bool = False
    reads: Array | None = None
    timed: bool = False
    loaded: bool = False
    remembers: int = 0
    at: Where = "force"

    def __post_init__(self) -> None:
        if self.wide and (self.function is None or self.inertia or self.damping or self.stiffness):
            raise ValueError(
                "a law that is more than a torque by one angle has a function and no linear part: state two laws"
            )
        if self.at != "force" and (self.timed or self.loaded or self.remembers or np.count_nonzero(self.port) != 1):
            raise ValueError(
                f"a law at {self.at!r} depends on one coordinate alone: not on time, load or what it remembers"
            )

    @property
    def combination(self) -> Array:
        """What its function depends on, shape (n,)."""
        return self.port if self.reads is None else self.reads

    def times(self, value: float) -> Law:
        """So many times the law, whose function is in proportion to its first parameter."""
        return replace(
            self,
            inertia=value * self.inertia,
            damping=value * self.damping,
            stiffness=value * self.stiffness,
            parameters=np.concatenate([value * self.parameters[:1], self.parameters[1:]]),
        )

    @property
    def wide(self) -> bool:
        """Whether it is more than a torque by one combination of the coordinates, on which it acts."""
        return self.reads is not None or self.timed or self.loaded or self.remembers > 0 or self.at != "force"


def links_ahead(laws: Iterable[Law], q: Array) -> Array:
    """Coordinates (N, n) that put the links where they are, for coordinates q (N, n) and the laws at ``links`` among these."""
    for law in laws:
        if law.at == "links" and law.function is not None:
            out = np.zeros((3, len(q)))
            law.function(q @ law.port, 0.0, law.parameters, out)
            q = q + np.outer(out[0], law.port)
    return q


def constant(x: float, rate: float, parameters: Any, out: Any) -> None:
    """The law of a constant torque, ``parameters[0]``."""
    out[0] = parameters[0]
    out[1] = 0.0
    out[2] = 0.0
