"""A robot in arrays, for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from rx90b_flex.compiled.compile import Integers
from rx90b_flex.compiled.laws import Laws, compiled_law
from rx90b_flex.compiled.packed import Order, Packed, accelerations, link_columns, link_torques, pack
from rx90b_flex.compiled.scratch import scratch_size
from rx90b_flex.compiled.tree import Tree
from rx90b_flex.compiled.vectors import WIDTH
from rx90b_flex.compiled.wide import FORCE, LINKS, MEASURED, MOTOR, ROWS, Wide, pack_wide
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.elements import GravityChange, PointMass
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
        partner=np.zeros(0, dtype=np.int64),
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
    packed = pack(tree, laws_of((), model.nv), order_of(model.nv))
    return np.asarray(link_torques(packed.integers, packed.numbers, scratch_size(model.nv, 0), *_samples(motion)))


def columns_of_links(model: pin.Model, bodies: Sequence[int], motion: Motion, columns: int = 0) -> Array:
    """The same per unit of each parameter, shape (N, n, 10 * bodies), or of so many `columns`, those behind them zero."""
    packed = pack(tree_of(model), laws_of((), model.nv), order_of(model.nv))
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


def _sparse(ports: Array) -> tuple[Integers, Array]:
    """Places and weights (m, w) of combinations of coordinates (m, n); where one has fewer, its weights end in zeros."""
    found = [np.flatnonzero(port) for port in ports]
    width = max((len(at) for at in found), default=1)
    place, weight = np.zeros((len(ports), width), dtype=np.int64), np.zeros((len(ports), width))
    for m, at in enumerate(found):
        place[m, : len(at)], weight[m, : len(at)] = at, ports[m, at]
    return place, weight


def laws_of(laws: Sequence[Law], n: int) -> Laws:
    """The arrays of scalar laws on n coordinates."""
    ports = np.array([law.port for law in laws]).reshape(len(laws), n)
    place, weight = _sparse(ports)
    width = np.count_nonzero(ports, axis=1)
    length = max([len(law.parameters) for law in laws], default=1)
    parameters = np.zeros((len(laws), max(length, 1)))
    for m, law in enumerate(laws):
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
        width,
        np.array(address, dtype=np.int64),
        np.array(stores, dtype=np.int64),
        parameters,
        np.zeros(3),
        np.array([WIDTH, 0]),
    )


def order_of(n: int) -> Order:
    """Of a plant in the robot's own n coordinates."""
    return Order(np.arange(n), np.full(n, -1), np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Stepped:
    """A plant in the coordinates in which it is stepped.

    Where the joint of a torsion epsilon does nothing but turn on about its drive's axis, the drive's angle e and the link's,
    theta = e + epsilon, stand for e and epsilon: q' of equations 3.73-3.83, e first. In it no link feels a drive, so that tree and
    mass matrix are smaller by that joint.

    Attributes
    ----------
    tree, laws, order
    links : array, shape (n,)
        Coordinate by which the links feel each of the robot's.
    """

    tree: Tree
    laws: Laws
    order: Order
    links: Integers

    @cached_property
    def packed(self) -> Packed:
        """Tree and laws in flat arrays."""
        return pack(self.tree, self.laws, self.order)

    def of(self, q: Array) -> Array:
        """Coordinates (or rates) of the robot, (..., n), in these."""
        out = np.ascontiguousarray(q[..., self.order.source])
        twisted = np.flatnonzero(self.order.added >= 0)
        out[..., twisted] += q[..., self.order.added[twisted]]
        return out

    def robots(self, own: Array) -> Array:
        """These coordinates in the robot's."""
        out = np.empty_like(own)
        out[..., self.order.source] = own
        twisted = np.flatnonzero(self.order.added >= 0)
        out[..., self.order.source[twisted]] -= out[..., self.order.added[twisted]]
        return out

    def ports(self, ports: Array) -> Array:
        """Combinations of the robot's coordinates, (m, n), as ones of these."""
        return _ports_behind(ports, self.order)


def _ports_behind(ports: Array, order: Order) -> Array:
    out = ports[:, order.source]
    for i in np.flatnonzero(order.added >= 0):
        out[:, np.flatnonzero(order.source == order.added[i])[0]] -= ports[:, order.source[i]]
    return out


def _twisting(tree: Tree, drives: Integers, ports: Array) -> Integers:
    """Joints that turn on about a drive's axis where nothing lies between them, and no law joins the drive to more.

    `ports` (m, n) are combinations of the coordinates whose torques act where they are read.
    """
    found = []
    for i, p in enumerate(tree.parent):
        plain = (
            p in drives
            and i not in drives
            and not (tree.heavy[p] or tree.shifted[i] or tree.turned[i] or tree.prismatic[p])
        )
        if plain and (tree.axis[p] == tree.axis[i]).all() and np.count_nonzero(tree.parent == p) == 1:
            joined = ports[ports[:, p] != ports[:, i]]
            joined[:, [p, i]] = 0.0
            if not joined.any():
                found.append(i)
    return np.array(found, dtype=np.int64)


def _leans(law: Law) -> bool:
    """Whether a law's part of a step's system is not symmetric."""
    return law.loaded or not np.array_equal(law.port, law.combination)


def stepped(tree: Tree, laws: Laws, drives: Integers, wide: Sequence[Law]) -> Stepped:
    """A plant in the coordinates in which it is stepped; its own where a gear's error stands between drives and links."""
    n = len(tree.parent)
    ports = np.zeros((len(laws.inertia), n))
    for m, (place, weight) in enumerate(zip(laws.place, laws.weight, strict=True)):
        np.add.at(ports[m], place, weight)
    beside = [law.port for law in wide if not _leans(law)]
    twisting = _twisting(tree, drives, np.concatenate([ports, np.array(beside).reshape(-1, n)]))
    if any(law.at == "links" for law in wide):
        twisting = twisting[:0]
    turned_by = tree.parent[twisting]  # drives
    kept = np.setdiff1d(np.arange(n), turned_by)
    first = len(turned_by)
    number = np.full(n + 1, -1)  # among the joints that are left; the base's stays -1
    number[kept] = np.arange(len(kept))
    number[turned_by] = number[twisting]
    whose = np.arange(n)  # joint whose place each one takes
    whose[twisting] = turned_by
    at = whose[kept]
    source, added = np.concatenate([turned_by, kept]), np.full(n, -1)
    added[first + number[twisting]] = turned_by
    where = np.argsort(source)
    order = Order(source, added, where[drives])
    small = Tree(
        parent=number[tree.parent[at]],
        prismatic=tree.prismatic[kept],
        turned=tree.turned[at],
        shifted=tree.shifted[at],
        heavy=tree.heavy[kept],
        partner=first + number[twisting],
        rotation=tree.rotation[at],
        offset=tree.offset[at],
        axis=tree.axis[kept],
        mass=tree.mass[kept],
        moment=tree.moment[kept],
        inertia=tree.inertia[kept],
        gravity=tree.gravity,
    )
    ports = _ports_behind(ports, order)
    place, weight = _sparse(ports)
    width = np.count_nonzero(ports, axis=1)
    return Stepped(small, laws._replace(place=place, weight=weight, width=width), order, first + number[:n])


def wide_of(laws: Sequence[Law], plant: Plant, q: Array) -> Wide:
    """The arrays of laws that are more than a torque by one angle, for lanes that start at q (lanes, n), in `plant.stepped`'s
    coordinates.
    """
    n, behind = q.shape[1], plant.stepped
    whole = np.zeros((ROWS, len(laws)), dtype=np.int64)
    acting, reading = (
        behind.ports(np.array(ports).reshape(len(laws), n))
        for ports in ([law.port for law in laws], [law.combination for law in laws])
    )
    place, weight = _sparse(np.concatenate([acting, reading]))
    width = place.shape[1]
    most = max((law.remembers for law in laws), default=0)
    slots = max((len(law.parameters) for law in laws), default=0)
    parameters, memory = np.zeros((len(laws), slots + REMEMBERED + most)), np.zeros((len(q), len(laws), 1 + most))
    for m, law in enumerate(laws):
        acts = int(np.flatnonzero(law.port)[-1])
        drive = int(np.flatnonzero(plant.drives == acts)[0]) if law.at in ("measured", "motor") else -1
        loaded = behind.links[acts] if law.loaded else -1
        whole[:, m] = (
            KINDS[law.at],
            _address(law),
            law.stores,
            len(law.parameters),
            loaded,
            law.remembers,
            drive,
            _leans(law),
        )
        parameters[m, : len(law.parameters)] = law.parameters
        memory[:, m, 0] = q @ reading[m]
    both = 2, len(laws), width
    return pack_wide(whole, place.reshape(both), weight.reshape(both), parameters, memory, n)


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
        """Tree and laws in flat arrays, in the robot's own coordinates."""
        return pack(self.tree, self.laws, order_of(len(self.tree.parent)))

    @cached_property
    def stepped(self) -> Stepped:
        """The same in the coordinates in which it is stepped."""
        return stepped(self.tree, self.laws, self.drives, self.wide or ())

    @cached_property
    def _memory(self) -> Array:
        return self.scratch(1)[0]

    def accelerations(self, q: Array, v: Array, drive_torque: Array) -> Array:
        """Accelerations of the tree and the effects with compiled laws, shape (n,)."""
        packed = self.stepped.packed
        return accelerations(packed.integers, packed.numbers, self._memory, q, v, drive_torque)

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
    for effect in effects:
        own, element = effect.laws(motion), effect.element()
        if own is not None and not any(law.wide for law in own):
            laws += own
        elif isinstance(element, PointMass):
            place = model.frames[model.getFrameId(element.frame)]
            body = pin.Inertia(element.mass, element.centre, np.zeros((3, 3)))
            loaded.appendBodyToJoint(place.parentJoint, body, place.placement)
            in_tree.append(effect)
        elif isinstance(element, GravityChange):
            loaded.gravity.linear += np.linalg.norm(model.gravity.linear) * element.direction
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
