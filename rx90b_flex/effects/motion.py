"""What an effect is shown: the coordinates of a robot and a segment of its motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.traits import Traits

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Found = TypeVar("Found")
STICKS = ("turn", "pause")  # where a drive sticks: as it turns, or on its way
Held = tuple[str, str]  # a joint, and one of these
# numbers for which a joint's motion keeps what follows from them, of a long one fewer
MOST_LATEST, LATEST_BYTES = 4, 2e6


@dataclass(frozen=True)
class Coordinates:
    """Names and places of a robot's generalised coordinates.

    Attributes
    ----------
    names : tuple of str
        One name a degree of freedom, in tree order: ``joint_1:drive``, ``joint_1:torsion``,
        ``joint_1:bend_1``, ``joint_1:bend_2``, ``base:bend_1``.
    """

    names: tuple[str, ...]

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joints with a drive, in tree order."""
        return tuple(name[: -len(":drive")] for name in self.names if name.endswith(":drive"))

    def __len__(self) -> int:
        return len(self.names)

    def index(self, joint: str, kind: str = "drive") -> int | None:
        """Place of a joint's ``drive``, ``torsion``, ``bend_1`` or ``bend_2``; None where it has none."""
        return self._index.get(f"{joint}:{kind}")

    def port(self, joint: str, kind: str = "joint") -> Array:
        """Row that picks a joint's motion out of the coordinates, and puts its force into them; shape (n,).

        ``drive`` is e, ``joint`` is the joint angle theta = e + eps1 (equation 3.4), any other
        kind is a virtual joint of that name.
        """
        if (joint, kind) not in self._ports:
            self._ports[joint, kind] = self._port(joint, kind)
        return self._ports[joint, kind].copy()

    @cached_property
    def _ports(self) -> dict[tuple[str, str], Array]:
        return {}

    def _port(self, joint: str, kind: str) -> Array:
        row = np.zeros(len(self.names))
        kinds = ("drive", "torsion") if kind == "joint" else (kind,)
        for k in kinds:
            i = self.index(joint, k)
            if i is not None:
                row[i] = 1.0
        if not row.any():
            raise ValueError(f"joint {joint!r} has no coordinate {kind!r} in this robot")
        return row


class TreeMotion(Protocol):
    """What the rigid-body tree can tell an effect about a segment of motion."""

    def link_regressor(self) -> Array:
        """Regressor of the links; shape (N, n, 10 * bodies)."""
        ...

    def load(self) -> Array:
        """Torque that the links ask of each coordinate; shape (N, n), N m."""
        ...

    def gravity_torque(self, direction: Array, *, laden: bool = False) -> Array:
        """Generalised force that gravity along ``direction`` (unit, base frame) needs; shape (N, n), N m.

        Of the links, or ``laden`` with the point masses among the model's effects.
        """
        ...

    def gravity_derivative(self, direction: Array, *, laden: bool = False) -> Array:
        """Derivative of `gravity_torque` by q; shape (N, n, n)."""
        ...

    def gravity_potential(self, direction: Array, *, laden: bool = False) -> Array:
        """Potential energy of the links under gravity along ``direction``; shape (N,), J."""
        ...

    def body_columns(self, frame: str) -> Array:
        """Regressor of a body fixed to ``frame``; shape (N, n, 10), columns m, s (3), J (xx yy zz xy xz yz)."""
        ...

    def body_derivatives(self, frame: str, body: Array) -> tuple[Array, Array, Array]:
        """Derivatives by q, v and a, each (N, n, n), of ``body_columns(frame) @ body``; body (10,), its mass > 0."""
        ...

    def body_potential(self, frame: str, body: Array) -> Array:
        """Potential energy of that body under the tree's gravity; shape (N,), J."""
        ...

    def joint_axis(self, joint: str) -> Array:
        """Unit axis of a revolute joint in its own frame, shape (3,); other joints are refused."""
        ...

    def derivatives(self) -> tuple[Array, Array, Array]:
        """Derivatives of the links' generalised force by q, v and a; each (N, n, n)."""
        ...

    def with_hinges(self, hinges: tuple[Any, ...]) -> Motion:
        """The same motion on the tree with the coordinates of these effects, which stay at zero."""
        ...


class LowPass(Protocol):
    """A low-pass without phase shift."""

    @property
    def cutoff_hz(self) -> float: ...

    def __call__(self, x: Array, rate_hz: float) -> Array:
        """Samples (N, ...) behind it."""
        ...


class Force(Protocol):
    """What a motion knows of an effect of the present model."""

    traits: ClassVar[Traits]

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints whose motion it depends on; empty: all."""
        ...

    def force(self, motion: Motion) -> Array:
        """Generalised force, shape (N, n)."""
        ...

    def factors(self, motion: Motion) -> tuple[Array, Array] | None:
        """Its columns as a constant port (n,) and a basis (N, k), where they are the outer product of the two."""
        ...

    def known_coefficients(self) -> Array:
        """Coefficients, shape (k,)."""
        ...


@dataclass(frozen=True)
class Motion:
    """N samples of a robot's motion.

    Attributes
    ----------
    coordinates : Coordinates
    q, v, a : array, shape (N, n)
        Positions, velocities, accelerations; rad, rad/s, rad/s^2 (m for prismatic joints).
    time : array, shape (N,)
        Seconds.
    tree : callable
        Gives the tree's view of this motion when an effect asks for it.
    effects : tuple
        The present model's forces beyond the tree, for effects that depend on the model as a whole.
    angle_noise : array, shape (n,), or None
        Standard deviation of what the angles are off, rad, where a log tells it.
    stuck : array, shape (N, joints), or None
        Where a drive sticks at a reversal: the part of its dry friction, -1 to 1, that it is taken to hold
        (`signals.sticking.held_part`); elsewhere NaN.
    low_pass : LowPass or None
        What a log's angles went through, and their noise.
    logged : Motion or None
        The motion as it was logged, which tells what the log resolves, where this one is worked out from it.
    """

    coordinates: Coordinates
    q: Array
    v: Array
    a: Array
    time: Array
    tree: Callable[[Motion], TreeMotion] = field(repr=False)
    effects: tuple[Force, ...] = field(default=(), repr=False)
    angle_noise: Array | None = field(default=None, repr=False)
    stuck: Array | None = field(default=None, repr=False)
    low_pass: LowPass | None = field(default=None, repr=False)
    logged: Motion | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return self.q.shape[0]

    def as_angles(self, x: Array) -> Array:
        """Changes of an angle, (N, ...) rad, as this motion shows it: behind the low-pass of the log's angles."""
        step = float(self.time[1] - self.time[0]) if len(self) > 1 else 0.0
        return x if self.low_pass is None or step <= 0 else self.low_pass(x, 1.0 / step)

    @cached_property
    def on_tree(self) -> TreeMotion:
        """The tree's view of this motion, made once."""
        # of a copy: two that hold each other would keep all that they have worked out until the next collection of cycles
        return self.tree(replace(self))

    def part(self, samples: slice | Indices) -> Motion:
        """Some of the samples."""
        q, v, a, time = (np.ascontiguousarray(x[samples]) for x in (self.q, self.v, self.a, self.time))
        stuck = None if self.stuck is None else np.ascontiguousarray(self.stuck[samples])
        return replace(self, q=q, v=v, a=a, time=time, stuck=stuck)

    def piece(self, samples: slice) -> Motion:
        """Some of the samples, for which the tree is asked at all of them, once for many pieces."""
        out = self.part(samples)
        return replace(out, tree=partial(_tree_of_piece, self, samples, out))

    def sticking(self, held: Sequence[Held]) -> Motion:
        """The same, with friction held in no other sticks than these joints' at their turns or in their pauses."""
        if self.stuck is None:
            return self
        there = [[(j, kind) in held for j in self.coordinates.joints] for kind in STICKS]
        stuck = np.where(np.where(self.pauses, there[1], there[0]), self.stuck, np.nan)
        return replace(self, stuck=stuck if np.any(there) else None)

    @property
    def pauses(self) -> Mask:
        """Where a drive sticks on its way, (N, joints): it then holds at the end what it held at first."""
        stuck = np.full((len(self), len(self.coordinates.joints)), np.nan) if self.stuck is None else self.stuck
        out = np.zeros(stuck.shape, dtype=bool)
        for part, pauses in zip(stuck.T, out.T, strict=True):
            edges = np.flatnonzero(np.diff(~np.isnan(part), prepend=False, append=False))
            for begin, end in zip(edges[::2], edges[1::2], strict=True):
                pauses[begin:end] = part[begin] == part[end - 1]
        return out

    @cached_property
    def model_torque(self) -> Array:
        """Generalised force of the present model, tree and effects; shape (N, n), N m."""
        return with_forces(np.array(self.on_tree.load()), self.effects, self)

    @cached_property
    def _kept(self) -> dict[tuple[str, ...], tuple[NDArray[Any], ...]]:
        return {}

    def once(self, key: tuple[str, ...], make: Callable[[], tuple[NDArray[Any], ...]]) -> tuple[NDArray[Any], ...]:
        """Arrays of this motion that are worked out once: many shapes of an effect ask for them."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    @cached_property
    def _alone(self) -> dict[tuple[str, ...], tuple[NDArray[Any], ...]]:
        return {}

    def once_for_all(
        self, key: tuple[str, ...], make: Callable[[], tuple[NDArray[Any], ...]]
    ) -> tuple[NDArray[Any], ...]:
        """As `once`, of what every model sees alike."""
        if key not in self._alone:
            self._alone[key] = make()
        return self._alone[key]

    def seen_by(self, tree: Callable[[Motion], TreeMotion], effects: tuple[Force, ...]) -> Motion:
        """The same motion with another model."""
        other = replace(self, tree=tree, effects=effects)
        other.__dict__["_alone"] = self._alone
        return other

    @cached_property
    def _joints(self) -> dict[tuple[str, str], tuple[Any, ...]]:
        return {}

    def forget(self) -> None:
        """Give back what was worked out once."""
        for name in ("on_tree", "model_torque", "_kept", "_joints"):
            self.__dict__.pop(name, None)
        self._alone.clear()

    def model_sensitivity(self, joint: str) -> tuple[Array, ...]:
        """Change of `model_torque` per change of a joint's position, velocity and acceleration; each (N, n).

        By velocity it is the secant over a fiftieth of the velocity: what a small relative error does to it, also where a
        friction's slope at reversal would say something about that instant only.
        """

        def make() -> tuple[Array, ...]:
            i = self.coordinates.index(joint)
            assert i is not None
            at = np.arange(len(self.coordinates)) == i
            links = tuple(np.array(by[:, :, i]) for by in self.on_tree.derivatives())
            v = np.abs(self.v[:, i])
            slowest = 1e-3 * max(float(v.max()), 1e-9)
            steps = (np.full(len(self), 1e-5), 0.02 * np.maximum(v, slowest), np.ones(len(self)))
            for out, name, step in zip(links, ("q", "v", "a"), steps, strict=True):
                change = np.outer(step, at)
                up, down = (replace(self, **{name: getattr(self, name) + sign * change}) for sign in (1.0, -1.0))
                for effect in self.effects:
                    elsewhere = effect.joints and joint not in effect.joints
                    if not effect.traits.needs_load and not elsewhere:
                        out += (effect.force(up) - effect.force(down)) / (2.0 * step[:, None])
            return links

        return self.once(("model_sensitivity", joint), make)

    def joint(self, name: str, kind: str = "joint") -> JointMotion:
        """Motion of one joint (its angle theta) or of one of its coordinates."""
        if (name, kind) not in self._joints:
            port = self.coordinates.port(name, kind)
            alone = slice(None), *np.flatnonzero(port)
            own = (x[alone] if len(alone) == 2 else x @ port for x in (self.q, self.v, self.a))
            self._joints[name, kind] = *own, self.time, port, {}
        q, v, a, time, port, kept = self._joints[name, kind]
        return JointMotion(q, v, a, time, self, port, kept)


def with_forces(torque: Array, effects: Iterable[Force], motion: Motion) -> Array:
    """A torque (N, n) with the forces of effects added, in its place."""
    for effect in effects:
        factors = effect.factors(motion)
        if factors is None:
            torque += effect.force(motion)
            continue
        port, basis = factors
        along = basis @ effect.known_coefficients()
        for i in np.flatnonzero(port):
            torque[:, i] += port[i] * along
    return torque


def _tree_of_piece(whole: Motion, samples: slice, piece: Motion, moved: Motion) -> TreeMotion:
    own = whole.tree(moved)
    same = all(getattr(moved, x) is getattr(piece, x) for x in "qva")
    return _PieceOfTree(whole, samples, own) if same else own


@dataclass(frozen=True, eq=False)
class _PieceOfTree:
    """The tree's view of a piece of a motion: what takes long is taken from that of the whole."""

    whole: Motion
    samples: slice
    own: TreeMotion

    def load(self) -> Array:
        return self.whole.on_tree.load()[self.samples]

    def derivatives(self) -> tuple[Array, Array, Array]:
        by_q, by_v, by_a = self._derivatives
        return by_q, by_v, by_a

    @cached_property
    def _derivatives(self) -> tuple[Array, ...]:
        return tuple(np.ascontiguousarray(by[self.samples]) for by in self.whole.on_tree.derivatives())

    def body_columns(self, frame: str) -> Array:
        return self.whole.on_tree.body_columns(frame)[self.samples]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.own, name)


@dataclass(frozen=True)
class JointMotion:
    """Motion of one angle: position, velocity, acceleration and time, each (N,)."""

    q: Array
    v: Array
    a: Array
    time: Array
    motion: Motion = field(repr=False)
    port: Array = field(repr=False)
    kept: dict[str, dict[float, Any]] = field(default_factory=dict, repr=False, compare=False)

    def of_number(self, name: str, number: float, make: Callable[[], Found]) -> Found:
        """What follows from this motion and one number: of the numbers asked for last it is kept.

        Friction laws of one joint share their turn-over, and each asks what the others have asked.
        """
        most = min(MOST_LATEST, int(LATEST_BYTES / (8 * max(len(self.time), 1))))
        known = self.kept.setdefault(name, {})
        found = known.pop(number, None)
        if found is None:
            found = make()
            if isinstance(found, np.ndarray):
                found.flags.writeable = False
            if most and len(known) >= most:
                del known[next(iter(known))]
        if most:
            known[number] = found  # what was asked for last stands last
        return cast(Found, found)

    def creeping(self, number: float, velocity: Callable[[], Array]) -> JointMotion:
        """With another velocity (N,), which follows from one number, and what is kept of that motion."""
        v, kept = self.of_number("creeping", number, lambda: (velocity(), dict[str, dict[float, Any]]()))
        return replace(self, v=v, kept=kept)

    @property
    def follows(self) -> bool:
        """Whether samples follow each other in time."""
        return len(self.time) > 1 and bool((np.diff(self.time) > 0).all())

    @property
    def load(self) -> Array:
        """Torque through this joint's transmission, shape (N,), N m."""
        place = int(np.flatnonzero(self.port)[-1])
        return self.motion.on_tree.load()[:, place]
