"""A robot in arrays, for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from rx90b_flex.compiled.compile import Integers
from rx90b_flex.compiled.laws import Laws, compiled_law
from rx90b_flex.compiled.packed import Packed, accelerations, link_columns, link_torques, pack
from rx90b_flex.compiled.scratch import scratch_size
from rx90b_flex.compiled.tree import Tree
from rx90b_flex.compiled.vectors import WIDTH
from rx90b_flex.compiled.wide import FORCE, LINKS, MEASURED, MOTOR, ROWS, Wide, pack_wide
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.law import BY_LOAD, LOAD, ONWARD, REMEMBERED, Law
from rx90b_flex.effects.motion import Array, Motion

KINDS = {"force": FORCE, "links": LINKS, "measured": MEASURED, "motor": MOTOR}


def tree_of(model: pin.Model) -> Tree:
    """The arrays of a pinocchio model whose joints have one coordinate each."""
    n = model.nv
    if model.nq != n or model.njoints != n + 1:
        raise ValueError(f"{model.name}: {model.njoints - 1} joints with {model.nq} positions; one each is expected")
    axes = np.array([np.ravel(model.joints[i].createData().S) for i in range(1, n + 1)])
    prismatic = np.logical_not(axes[:, 3:].any(axis=1))
    placements = [model.jointPlacements[i] for i in range(1, n + 1)]
    rotation = np.array([p.rotation for p in placements])
    offset = np.array([p.translation for p in placements])
    bodies = [model.inertias[i] for i in range(1, n + 1)]
    dynamic = np.array([b.toDynamicParameters() for b in bodies])
    packed = dynamic[:, [4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(n, 3, 3)
    return Tree(
        parent=np.array([int(model.parents[i]) - 1 for i in range(1, n + 1)], dtype=np.int64),
        prismatic=np.array(prismatic, dtype=np.int64),
        turned=np.array((rotation != np.eye(3)).any(axis=(1, 2)), dtype=np.int64),
        shifted=np.array(offset.any(axis=1) | prismatic, dtype=np.int64),
        heavy=np.array(dynamic.any(axis=1), dtype=np.int64),
        rotation=np.ascontiguousarray(rotation),
        offset=np.ascontiguousarray(offset),
        axis=np.where(prismatic[:, None], axes[:, :3], axes[:, 3:]),
        mass=np.ascontiguousarray(dynamic[:, 0]),
        moment=np.ascontiguousarray(dynamic[:, 1:4]),
        inertia=np.ascontiguousarray(packed),
        gravity=np.array(model.gravity.linear, dtype=float),
    )


def torque_of_links(model: pin.Model, bodies: Sequence[int], link_parameters: Array, motion: Motion) -> Array:
    """Generalised forces that links need, whether or not a body could have their parameters; shape (N, n), N m.

    Parameters
    ----------
    bodies : sequence of int
        Joints that carry them.
    link_parameters : array, shape (10 * bodies,)
        Mass, its first moment and xx, yy, zz, xy, xz, yz of the inertia about the joint's origin.
    """
    tree, at = tree_of(model), np.array(bodies, dtype=np.intp) - 1
    values = link_parameters.reshape(-1, 10)
    tree.mass[at], tree.moment[at] = values[:, 0], values[:, 1:4]
    tree.inertia[at] = values[:, [4, 7, 8, 7, 5, 9, 8, 9, 6]].reshape(-1, 3, 3)
    tree.heavy[at] = values.any(axis=1)
    packed = pack(tree, laws_of((), model.nv))
    return np.asarray(link_torques(packed.integers, packed.numbers, scratch_size(model.nv, 0), *_samples(motion)))


def columns_of_links(model: pin.Model, bodies: Sequence[int], motion: Motion, columns: int = 0) -> Array:
    """The same per unit of each parameter, shape (N, n, 10 * bodies), or of so many `columns`, those behind them zero."""
    packed = pack(tree_of(model), laws_of((), model.nv))
    out = np.zeros((len(motion), model.nv, max(columns, 10 * len(bodies))))
    at = np.array(bodies) - 1
    link_columns(packed.integers, packed.numbers, scratch_size(model.nv, 0), at, out, *_samples(motion))
    return out


def _samples(motion: Motion) -> tuple[Array, ...]:
    """Angles, velocities and accelerations, (N, n), as compiled code takes them: arrays that are read only would be a type more."""
    return tuple(np.require(x, dtype=float, requirements=["C", "W"]) for x in (motion.q, motion.v, motion.a))


def _address(law: Law) -> int:
    """Of a law's compiled function; 0: it has none. Refuses one that goes beyond its arrays, of which compiled code says nothing."""
    if law.function is None:
        return 0
    read = REMEMBERED + law.remembers if law.remembers else LOAD + 1 if law.loaded else int(law.timed)
    written = ONWARD + law.remembers if law.remembers else BY_LOAD + law.loaded
    try:
        with np.errstate(all="ignore"):
            law.function(np.float64(0.1), np.float64(0.1), np.append(law.parameters, np.ones(read)), np.zeros(written))
    except IndexError as error:
        why = "reads or writes more than its law states (timed, loaded, remembers)"
        raise ValueError(f"{law.function.__qualname__} {why}: {error}") from None
    return int(compiled_law(law.function).address)


def laws_of(laws: Sequence[Law], n: int) -> Laws:
    """The arrays of scalar laws on n coordinates."""
    ports = [np.flatnonzero(law.port) for law in laws]
    width = max([len(p) for p in ports], default=1)
    length = max([len(law.parameters) for law in laws], default=1)
    place = np.zeros((len(laws), width), dtype=np.int64)
    weight = np.zeros((len(laws), width))
    parameters = np.zeros((len(laws), max(length, 1)))
    for m, (law, port) in enumerate(zip(laws, ports, strict=True)):
        place[m, : len(port)] = port
        weight[m, : len(port)] = law.port[port]
        parameters[m, : len(law.parameters)] = law.parameters
    inertia, damping, stiffness = (
        np.array([getattr(law, name) for law in laws], dtype=float) for name in ("inertia", "damping", "stiffness")
    )
    address = [_address(law) for law in laws]
    stores = [law.stores for law in laws]
    return Laws(
        place,
        weight,
        inertia,
        damping,
        stiffness,
        np.array(address, dtype=np.int64),
        np.array(stores, dtype=np.int64),
        parameters,
        np.zeros(3),
        np.full(1, WIDTH),
    )


def wide_of(laws: Sequence[Law], drives: Integers, q: Array) -> Wide:
    """The arrays of laws that are more than a torque by one angle, for lanes that start at q (lanes, n)."""
    whole = np.zeros((ROWS, len(laws)), dtype=np.int64)
    combinations = [(law.port, law.port if law.reads is None else law.reads) for law in laws]
    width = max((np.count_nonzero(c) for both in combinations for c in both), default=1)
    place, weight = np.zeros((2, len(laws), width), dtype=np.int64), np.zeros((2, len(laws), width))
    most = max((law.remembers for law in laws), default=0)
    slots = max((len(law.parameters) for law in laws), default=0)
    parameters, memory = np.zeros((len(laws), slots + REMEMBERED + most)), np.zeros((len(q), len(laws), 1 + most))
    for m, (law, both) in enumerate(zip(laws, combinations, strict=True)):
        for which, combination in enumerate(both):
            at = np.flatnonzero(combination)
            place[which, m, : len(at)], weight[which, m, : len(at)] = at, combination[at]
        acts = int(np.flatnonzero(law.port)[-1])
        drive = int(np.flatnonzero(drives == acts)[0]) if law.at in ("measured", "motor") else -1
        loaded = acts if law.loaded else -1
        leans = law.loaded or not np.array_equal(*both)
        whole[:, m] = KINDS[law.at], _address(law), law.stores, len(law.parameters), loaded, law.remembers, drive, leans
        parameters[m, : len(law.parameters)] = law.parameters
        memory[:, m, 0] = q @ both[1]
    return pack_wide(whole, place, weight, parameters, memory, q.shape[1])


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot in arrays: its tree, the effects that have compiled laws, and those that have none.

    Attributes
    ----------
    tree, laws, drives : arrays
    others : tuple of Effect
        Those that are more than torques by one angle and its rate each.
    wide : tuple of Law, or None
        What a simulation has of them; None: it asks them for `force` and `derivatives` at each step, all of them alike.
    in_tree : tuple of Effect
        Part of `tree`: masses that they fix to it, gravity that they turn.
    """

    tree: Tree
    laws: Laws
    others: tuple[Effect, ...]
    drives: Integers  # (joints,) where the drive angles stand among the coordinates
    wide: tuple[Law, ...] | None = ()
    in_tree: tuple[Effect, ...] = ()

    @cached_property
    def packed(self) -> Packed:
        """Tree and laws in flat arrays."""
        return pack(self.tree, self.laws)

    @cached_property
    def _memory(self) -> Array:
        return self.scratch(1)[0]

    def accelerations(self, q: Array, v: Array, drive_torque: Array) -> Array:
        """Accelerations of the tree and the effects with compiled laws, shape (n,)."""
        return accelerations(*self.packed, self._memory, self.drives, q, v, drive_torque)

    def scratch(self, lanes: int) -> Array:
        """Working memory, one row a lane."""
        return np.zeros((lanes, scratch_size(len(self.tree.parent), len(self.laws.inertia))))


def plant_of(model: pin.Model, effects: Sequence[Effect], motion: Motion, drives: Integers) -> Plant:
    """The arrays of a model and its effects; `motion` is any sample."""
    laws: list[Law] = []
    wide: list[Law] | None = []
    others: list[Effect] = []
    in_tree: list[Effect] = []
    loaded = model.copy()
    # masses first: where there are some, gravity stays as it is, since tilts turn that of the links alone
    for effect in sorted(effects, key=lambda effect: effect.gravity_change() is not None):
        own, mass, tilt = effect.laws(motion), effect.point_mass(), effect.gravity_change()
        if own is not None and not any(law.wide for law in own):
            laws += own
        elif mass is not None:
            frame, weight, centre = mass
            place = model.frames[model.getFrameId(frame)]
            body = pin.Inertia(weight, centre, np.zeros((3, 3)))
            loaded.appendBodyToJoint(place.parentJoint, body, place.placement)
            in_tree.append(effect)
        elif tilt is not None and not any(e.point_mass() is not None for e in in_tree):
            loaded.gravity.linear += np.linalg.norm(model.gravity.linear) * tilt
            in_tree.append(effect)
        else:
            others.append(effect)
            wide = None if own is None or wide is None or not all(law.wide for law in own) else [*wide, *own]
    # what is in the tree is no link, whose torque alone is the load
    alike = wide is not None and not (in_tree and any(law.loaded for law in wide))
    return Plant(
        tree_of(loaded),
        laws_of(laws, model.nv),
        tuple(others),
        drives,
        tuple(wide or ()) if alike else None,
        tuple(in_tree),
    )
