"""Effects whose physics is stated once, as a law or one a coefficient: columns, their slopes and the compiled form come from it."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from rx90b_flex.effects.effect import Effect, JointForce
from rx90b_flex.effects.law import BY_LOAD, ONWARD, Law
from rx90b_flex.effects.motion import Array, JointMotion, Motion


class SumOfLaws(Effect):
    """An effect on one combination of the coordinates that states a law for each coefficient: inertia, damping, spring, any other."""

    @abstractmethod
    def unit_laws(self, motion: Motion) -> tuple[Law, ...]:
        """The law of one unit of each coefficient, all on one port; a function is in proportion to its first parameter.

        Functions may read another joint's angle and time, not the load or what they remember.
        """

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        values = zip(self.known_coefficients(), self.unit_laws(motion), strict=True)
        scaled = [law.times(float(value)) for value, law in values]
        total = {name: sum(getattr(law, name) for law in scaled) for name in ("inertia", "damping", "stiffness")}
        found = [law for law in scaled if law.function is not None]
        if found and not found[0].wide:  # one law holds a linear part and a function
            found[0] = dataclasses.replace(found[0], **total)
        elif not found or any(total.values()):
            found.append(Law(scaled[0].port, **total))
        return tuple(found)

    def factors(self, motion: Motion, leading: bool = False) -> tuple[Array, Array]:
        units = self.unit_laws(motion)
        basis = np.empty((len(motion), len(units)))
        for column, law in zip(basis.T, units, strict=True):
            column[:] = _written(law, motion)[0]
        return units[0].port, basis

    def columns(self, motion: Motion) -> Array:
        port, basis = self.factors(motion)
        return port[None, :, None] * basis[:, None, :]

    def basis(self, at: JointMotion) -> Array:
        """Of one on a joint."""
        return self.factors(at.motion)[1]

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        units = self.unit_laws(motion)
        outer = np.outer(units[0].port, units[0].combination)
        each = zip(self.known_coefficients(), units, strict=True)
        total = sum(
            value * np.array(np.broadcast_arrays(np.zeros(len(motion)), *_written(law, motion))) for value, law in each
        )
        by_q, by_v, by_a = (slope[:, None, None] * outer for slope in total[2:])
        return by_q, by_v, by_a


def _written(law: Law, motion: Motion) -> list[Array]:
    """Torque of a law and its slopes by what it reads, its rate and second rate, at samples of a motion; each (N,), or a number."""
    own: list[Any] = [0.0, 0.0, 0.0, 0.0]
    if law.function is not None:
        out = np.empty((3, len(motion)))
        law.function(_read(law, motion.q), _read(law, motion.v), [*law.parameters, motion.time], out)
        own[:3] = out
    linear = ((law.stiffness, motion.q), (law.damping, motion.v), (law.inertia, motion.a))
    for slope, (value, of) in enumerate(linear, start=1):
        if value:
            own[0], own[slope] = own[0] + value * _read(law, of), own[slope] + value
    return own


def _read(law: Law, of: Array) -> Array:
    """What a law reads of coordinates or their rates (N, n), shape (N,)."""
    at = np.flatnonzero(law.combination)
    alone = len(at) == 1 and law.combination[at[0]] == 1.0
    return of[:, at[0]] if alone else np.asarray(of @ law.combination)


class LawEffect(JointForce):
    """An effect on one joint that states a law. The law may read the load too (`needs_load`) and time (`law_timed`)."""

    law_stores: ClassVar[bool] = False  # whether the law is the gradient of `potential`
    law_timed: ClassVar[bool] = False
    law_remembers: ClassVar[int] = 0

    @staticmethod
    @abstractmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        """Torque at angle x and rate, and its slopes by them, to ``out[0]``, ``out[1]``, ``out[2]``; a `LawFunction`.

        Parameters: the coefficients, which the torque is linear in, then the shape; behind them what a `Law` may read.
        """

    def law_shape(self, motion: Motion) -> Array:
        """What the law reads behind the coefficients, shape (s,)."""
        return self.known_shape()

    def law_parameters(self, motion: Motion) -> Array:
        """Parameters of each of the laws side by side, one here; shape (laws, coefficients + s)."""
        return np.concatenate([self.known_coefficients(), self.law_shape(motion)])[None]

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        port = motion.coordinates.port(self.joint, self.port_kind)
        return tuple(
            Law(
                port,
                function=self.law,
                parameters=values,
                stores=self.law_stores,
                timed=self.law_timed,
                loaded=self.traits.needs_load,
                remembers=self.law_remembers,
            )
            for values in self.law_parameters(motion)
        )

    def basis(self, at: JointMotion) -> Array:
        return np.ascontiguousarray(self._by_law(at)[0].T)

    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        by_q, by_v = (np.ascontiguousarray(x.T) for x in self._by_law(at)[1:3])
        return by_q, by_v, np.zeros_like(by_q)

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        own = super().derivatives(motion)
        if not self.traits.needs_load:
            return own
        at = motion.joint(self.joint, self.port_kind)
        place = int(np.flatnonzero(at.port)[-1])
        factor = (self.known_coefficients() @ self._by_law(at)[BY_LOAD])[:, None, None] * at.port[None, :, None]
        by_q, by_v, by_a = (
            x + factor * by[:, place, None, :] for x, by in zip(own, motion.on_tree.derivatives(), strict=True)
        )
        return by_q, by_v, by_a

    def _by_law(self, at: JointMotion) -> Array:
        """Torque and its slopes by angle, rate and load, per unit of each coefficient, (4, k, N): the law of all units at once."""
        units = np.eye(len(self.coefficients))
        out = np.zeros((4, len(units), len(at.q)))
        load = at.load if self.traits.needs_load else 0.0
        self.law(at.q, at.v, [*units[:, :, None], *self.law_shape(at.motion), at.time, load], out)
        return out


class RememberingLaw(LawEffect, remembers=True):
    """One whose law remembers; what it comes to where samples do not follow each other is its columns' to say."""

    law_remembers: ClassVar[int] = 1

    @property
    def turns_along(self) -> float | None:
        """Of hysteresis the angle, rad, along which the sign of a friction beside it turns over; None: of no such use."""
        return None

    def memory(self, motion: Motion) -> Array:
        """What it knows at rest before a motion, shape (N, m)."""
        rest = np.zeros((len(motion), 1 + self.law_remembers))
        rest[:, 0] = motion.joint(self.joint, self.port_kind).q
        return np.tile(rest, len(self.law_parameters(motion)))

    def onward(self, memory: Array, motion: Motion) -> Array:
        """What it knows a step later, at the samples of a motion, shape (N, m)."""
        q = motion.joint(self.joint, self.port_kind).q
        return np.concatenate([np.stack([q, *out[ONWARD:]], axis=1) for out in self._steps(memory, motion)], axis=1)

    def remembered(self, memory: Array, motion: Motion) -> tuple[Array, Array, Array]:
        """Force (N, n), and its derivatives by q and v (N, n, n)."""
        port = motion.coordinates.port(self.joint, self.port_kind)
        torque, by_x, by_rate = sum(self._steps(memory, motion))[:3]  # type: ignore[index]
        by_q, by_v = (slope[:, None, None] * np.outer(port, port) for slope in (by_x, by_rate))
        return np.outer(torque, port), by_q, by_v

    def _steps(self, memory: Array, motion: Motion) -> list[Array]:
        """What each law writes at samples of a motion, (ONWARD + remembered, N), with its memory (N, m) of a step before."""
        at, rows = motion.joint(self.joint, self.port_kind), self.law_parameters(motion)
        written = []
        for values, before in zip(rows, np.split(memory, len(rows), axis=1), strict=True):
            out = np.zeros((ONWARD + self.law_remembers, len(at.q)))
            load = at.load if self.traits.needs_load else 0.0
            self.law(at.q, at.v, [*values, at.time, load, *before.T], out)
            written.append(out)
        return written


def remembering(effects: Sequence[Effect]) -> tuple[RememberingLaw, ...]:
    """Those whose laws remember."""
    return tuple(e for e in effects if isinstance(e, RememberingLaw))
