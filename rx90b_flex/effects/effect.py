"""The base classes of effects: what a robot needs of one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rx90b_flex.effects.elements import Element
from rx90b_flex.effects.hints import Hints, Sites
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array, JointMotion, Motion


@dataclass(frozen=True, kw_only=True)
class Effect(Hints):
    """Something a robot has beyond its rigid tree.

    A subclass is one effect type: its name in files is the class name in snake case, its fields are its
    parameters. None as a value means: not known, to be identified.

    The force is linear in the *coefficients*: ``force = columns @ coefficients``. They are the linear
    parameters unless a subclass says otherwise (an amplitude and a phase are a sine and a cosine).
    """

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints it sits on; empty for an effect on the robot or a frame."""
        return ()

    @property
    def label(self) -> str:
        """Place and type, as in ``joint_2.viscous_friction``."""
        return ".".join(("_".join(self.joints) or "robot", self.type_name()))

    @property
    def place(self) -> tuple[str, ...]:
        """What tells two effects of one type apart."""
        return self.joints

    @abstractmethod
    def columns(self, motion: Motion) -> Array:
        """Generalised force per unit of each coefficient; shape (N, n, k)."""

    def factors(self, motion: Motion, leading: bool = False) -> tuple[Array, Array] | None:
        """Columns as the outer product of a constant port (n,) and a basis (N, k), where they are one.

        With `leading` also where their larger part is one, which is enough for a first look: then that.
        """
        return None

    def force(self, motion: Motion) -> Array:
        """Generalised force on the inverse-dynamics side, shape (N, n), N m."""
        factors, coefficients = self.factors(motion), self.known_coefficients()
        if factors is None:
            return self.columns(motion) @ coefficients
        port, basis = factors
        return np.outer(basis @ coefficients, port)

    def side_by_side(
        self, effects: Sequence[Effect], motion: Motion, leading: bool = False
    ) -> tuple[Array | None, Array]:
        """Columns of several effects in its place, one behind the other, of which it may be the first.

        A type whose effects differ in their shapes alone may work them out together.

        Parameters
        ----------
        effects : sequence of Effect
        motion : Motion
        leading : bool
            Whether the larger part is enough (`factors`).

        Returns
        -------
        port : array, shape (n,), or None
            The one port on which all of them act.
        columns : array, shape (N, sum of k)
            What goes to the port; without one the columns as they are, (N, n, sum of k).
        """
        factors = [e.factors(motion, leading) for e in effects]
        known = [f for f in factors if f is not None]
        if len(known) == len(effects) and all(np.array_equal(port, known[0][0]) for port, _ in known):
            return known[0][0], np.concatenate([basis for _, basis in known], axis=1)
        return None, np.concatenate([e.columns(motion) for e in effects], axis=2)

    def by_links(self, motion: Motion) -> Array | None:
        """Change of its force per change of the links' parameters, (N, n, 10 * bodies), where it is large; None: not worth it."""
        return None

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        """Derivatives of the force by q, v and a; each (N, n, n)."""
        raise TypeError(f"{self.type_name()} has no derivatives")

    def potential(self, motion: Motion) -> Array:
        """Potential energy whose gradient is the force at rest, shape (N,), J; zero for what only dissipates."""
        return np.zeros(len(motion))

    def laws(self, motion: Motion) -> tuple[Law, ...] | None:
        """The force as scalar laws, for a compiled simulation; None: that asks for `force` and `derivatives` at each step.

        Optional, and only for speed. ``motion`` is any sample: the laws need its coordinates and its tree.
        """
        return None

    def element(self) -> Element | None:
        """The mechanical element that is the whole effect, for simulations and simulators; optional, like `laws`."""
        return None

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        """What a search over time tries, without values, in every place; of what adds coordinates, what acts on the rigid tree."""
        return ()

    def on_rigid_tree(self) -> Effect | None:
        """What stands for it where the tree is rigid and motors alone are measured; None: nothing, it is left out."""
        return None if self.traits.virtual else self


@dataclass(frozen=True, kw_only=True)
class JointEffect(Effect):
    """An effect on one joint: a torque that depends on that joint's own motion."""

    joint: str
    acts_at: ClassVar[str] = "joint"  # the joint angle theta, or the "drive" angle alone

    @property
    def joints(self) -> tuple[str, ...]:
        return (self.joint,)

    @property
    def port_kind(self) -> str:
        """Which of the joint's angles it acts on, as `Coordinates.port` has it."""
        return self.acts_at

    @abstractmethod
    def basis(self, at: JointMotion) -> Array:
        """Torque per unit of each coefficient, shape (N, k)."""

    def at(self, motion: Motion) -> JointMotion:
        """The motion that it depends on."""
        return motion.joint(self.joint, self.port_kind)

    def factors(self, motion: Motion, leading: bool = False) -> tuple[Array, Array] | None:
        at = self.at(motion)
        return at.port, self.basis(at)

    def columns(self, motion: Motion) -> Array:
        at = self.at(motion)
        return at.port[None, :, None] * self.basis(at)[:, None, :]

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(joint=j) for j in sites.joints]


class JointForce(JointEffect):
    """An effect on one joint that is a force of the robot."""

    @abstractmethod
    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        """Derivatives of the basis by position, velocity and acceleration; each (N, k)."""

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        at = motion.joint(self.joint, self.port_kind)
        outer = np.outer(at.port, at.port)[None]
        by_q, by_v, by_a = (outer * (slope @ self.known_coefficients())[:, None, None] for slope in self.slopes(at))
        return by_q, by_v, by_a


@dataclass(frozen=True, kw_only=True)
class PairEffect(Effect, on="joints"):
    """An effect on two joints [a, b]."""

    joint_pair: tuple[str, str]

    @property
    def joints(self) -> tuple[str, ...]:
        return self.joint_pair

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(joint_pair=(a, b)) for i, a in enumerate(sites.joints) for b in sites.joints[i + 1 :]]


@dataclass(frozen=True, kw_only=True)
class FrameEffect(Effect, on="frame"):
    """An effect on a frame of the robot."""

    frame: str

    @property
    def place(self) -> tuple[str, ...]:
        return (self.frame,)

    @property
    def label(self) -> str:
        return f"{self.frame}.{self.type_name()}"

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(frame=sites.tip_frame)]


def shared_shapes(effect: Effect) -> tuple[tuple[str, ...] | None, ...]:
    """What names the one value that effects of a joint share, for each shape parameter; None: it is this effect's own.

    Of two joints it is the second one, whose motor both turn.
    """
    named = effect.shape_parameters.items()
    return tuple((effect.joints[-1], name) if p.shared else None for name, p in named)


def of_motion_alone(effect: Effect) -> bool:
    """Whether an effect's columns are the same for every model: those of one angle that no load enters."""
    return isinstance(effect, JointEffect | PairEffect) and not (effect.traits.needs_load or effect.traits.needs_model)
