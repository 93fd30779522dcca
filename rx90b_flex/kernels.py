"""Compiled code: dynamics of a tree, scalar laws, the integrator's step, and the sampling loop around it.

Newton-Euler in world axes about the joints' own origins. The virtual hinges of a flexible joint share their origin and
carry no mass, so that most of a flexible tree costs one plane rotation a hinge. Everything here is for one lane (one
run); the callers loop over lanes. Nothing here knows of robots or effects: only of arrays.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numba
import numpy as np
import pinocchio as pin
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.law import Law, LawFunction
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.vectors import WIDTH, Vector, as_vectors, lane_of, larger_size, with_lane

# L-stable, and the smaller of the two error constants that (1 - 1/sqrt 2, 1 + 1/sqrt 2) give
GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
SMALL_ANGLE = 0.03  # rad; below it four terms of the Taylor series are exact in double precision

Integers = np.ndarray[Any, np.dtype[np.int64]]


class Tree(NamedTuple):
    """A tree of one-coordinate joints, in the order of the coordinates."""

    parent: Integers  # (n,) -1 for the base
    prismatic: Integers  # (n,)
    turned: Integers  # (n,) whether `rotation` is not 1
    shifted: Integers  # (n,) whether the joint's origin is not its parent's
    heavy: Integers  # (n,) whether the body has mass
    rotation: Array  # (n, 3, 3) of the joint's frame at zero, in the parent's
    offset: Array  # (n, 3) m
    axis: Array  # (n, 3) in the joint's own frame
    mass: Array  # (n,) kg
    moment: Array  # (n, 3) mass times centre of mass, kg m
    inertia: Array  # (n, 3, 3) about the joint's origin, kg m^2
    gravity: Array  # (3,) m/s^2


class Laws(NamedTuple):
    """Torques that depend on one combination of the coordinates, x = sum of weight * q: linear part and compiled
    law.
    """

    place: Integers  # (m, w) coordinates of the combination
    weight: Array  # (m, w) zero where there are fewer
    inertia: Array  # (m,) per d2x/dt2
    damping: Array  # (m,) per dx/dt
    stiffness: Array  # (m,) per x
    address: Integers  # (m,) of the compiled law, 0 where there is none
    stores: Integers  # (m,) whether the law stores energy instead of dissipating it
    parameters: Array  # (m, p) of the law
    out: Array  # (3,) what a law writes
    wanted: Integers  # (1,) lanes of a vector whose laws are asked


class Scratch(NamedTuple):
    """Working memory of one lane."""

    rotation: Array  # (n, 3, 3)
    axis: Array  # (n, 3) world
    arm: Array  # (n, 3) from the parent's origin to the joint's, world
    spin: Array  # (n, 3) angular velocity
    turn: Array  # (n, 3) angular acceleration
    lift: Array  # (n, 3) acceleration of the origin less gravity
    force: Array  # (n, 3)
    torque: Array  # (n, 3)
    mass: Array  # (n,) of everything that hangs on the joint
    moment: Array  # (n, 3)
    inertia: Array  # (n, 3, 3)
    torques: Array  # (m,) of the laws
    late_torques: Array  # (m,)
    by_x: Array  # (m,) slopes of the laws
    by_rate: Array  # (m,)
    late_by_x: Array  # (m,)
    late_by_rate: Array  # (m,)
    system: Array  # (n, n)
    generalised: Array  # (n,)
    right: Array  # (n,)
    k_q: Array  # (n,)
    k_v: Array  # (n,)
    q: Array  # (n,)
    v: Array  # (n,)
    a: Array  # (n,)


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


# Forced inline: a call would copy the hundreds of words that describe these arrays. No reordering of sums: runs repeat
# to the bit. The cache on disk knows a function's own file alone, so all functions that call each other stand in this
# one.
compiled = numba.njit(cache=True, error_model="numpy", forceinline=True)

# The large ones are called, which keeps the time that the compiler takes in bounds.
called = numba.njit(cache=True, error_model="numpy")
# for what Python never calls, and what it could not take: vectors
_options: dict[str, Any] = {"no_cpython_wrapper": True}
_inner = numba.njit(cache=True, error_model="numpy", forceinline=True, **_options)

_NUMBERS = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
LAW_SIGNATURE = types.void(types.float64, types.float64, _NUMBERS, _NUMBERS)


@functools.cache
def compiled_law(function: LawFunction) -> Any:
    """A law of an effect as a C function; its `address` is good as long as the process lives."""
    return numba.cfunc(LAW_SIGNATURE, cache=True, error_model="numpy")(function)


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
    address = [0 if law.function is None else int(compiled_law(law.function).address) for law in laws]
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


@intrinsic
def _call_address(typing_context: Any, address: Any, x: Any, rate: Any, parameters: Any, out: Any) -> Any:
    """Call a compiled law ``void(double, double, double *, double *)`` by its address."""
    signature = types.void(types.int64, types.float64, types.float64, types.int64, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.DoubleType()
        pointer = double.as_pointer()
        function = ir.FunctionType(ir.VoidType(), [double, double, pointer, pointer])
        where = builder.inttoptr(args[0], function.as_pointer())
        builder.call(where, [args[1], args[2], builder.inttoptr(args[3], pointer), builder.inttoptr(args[4], pointer)])
        return context.get_dummy_value()

    return signature, generate


_call: Any = _call_address


@compiled
def _series(x):  # type: ignore[no-untyped-def]
    """Sine and cosine of a small angle by their series."""
    s = x * x
    sine = x - x * s * (1.0 / 6.0 - s * (1.0 / 120.0 - s * (1.0 / 5040.0 - s * (1.0 / 362880.0))))
    cosine = 1.0 - s * (0.5 - s * (1.0 / 24.0 - s * (1.0 / 720.0 - s * (1.0 / 40320.0))))
    return sine, cosine


def sine_cosine(x: Any) -> Any:
    """Sine and cosine; compiled code only."""
    raise NotImplementedError


@overload(sine_cosine)
def _sine_cosine(x):  # type: ignore[no-untyped-def]
    if isinstance(x, Vector):

        def lanes(x):  # type: ignore[no-untyped-def]
            sine, cosine = _series(x)
            for lane in range(WIDTH):
                angle = lane_of(x, lane)
                if abs(angle) >= SMALL_ANGLE:
                    sine, cosine = with_lane(sine, lane, math.sin(angle)), with_lane(cosine, lane, math.cos(angle))
            return sine, cosine

        return lanes

    def number(x):  # type: ignore[no-untyped-def]
        if abs(x) >= SMALL_ANGLE:
            return math.sin(x), math.cos(x)
        return _series(x)

    return number


@compiled
def _turn(rotation, i, axis, sine, cosine, x, y, z):  # type: ignore[no-untyped-def]
    """Turn frame i about its own axis (x, y, z), which is `axis` in the world."""
    if x == 1.0 or y == 1.0 or z == 1.0:
        # a turn about a frame axis mixes the two columns across it
        first = 1 if x == 1.0 else (2 if y == 1.0 else 0)
        second = 2 if x == 1.0 else (0 if y == 1.0 else 1)
        for r in range(3):
            f, g = rotation[i, r, first], rotation[i, r, second]
            rotation[i, r, first] = f * cosine + g * sine
            rotation[i, r, second] = g * cosine - f * sine
    else:
        for r in range(3):
            f, g, h = rotation[i, r, 0], rotation[i, r, 1], rotation[i, r, 2]
            along = (1.0 - cosine) * axis[i, r]
            rotation[i, r, 0] = f * cosine + along * x + sine * (g * z - h * y)
            rotation[i, r, 1] = g * cosine + along * y + sine * (h * x - f * z)
            rotation[i, r, 2] = h * cosine + along * z + sine * (f * y - g * x)


@compiled
def place(tree, s, q):  # type: ignore[no-untyped-def]
    """Rotations, axes and arms of all joints at q, in world axes."""
    # no views of rows: counting their references would cost more than the arithmetic
    rotation, axis, arm = s.rotation, s.axis, s.arm
    fixed, offset = tree.rotation, tree.offset
    for i in range(len(q)):
        parent = tree.parent[i]
        if parent < 0:
            for r in range(3):
                arm[i, r] = offset[i, r]
                for c in range(3):
                    rotation[i, r, c] = fixed[i, r, c]
        else:
            for r in range(3):
                f, g, h = rotation[parent, r, 0], rotation[parent, r, 1], rotation[parent, r, 2]
                if tree.shifted[i]:
                    arm[i, r] = f * offset[i, 0] + g * offset[i, 1] + h * offset[i, 2]
                if tree.turned[i]:
                    for c in range(3):
                        rotation[i, r, c] = f * fixed[i, 0, c] + g * fixed[i, 1, c] + h * fixed[i, 2, c]
                else:
                    rotation[i, r, 0], rotation[i, r, 1], rotation[i, r, 2] = f, g, h
        x, y, z = tree.axis[i, 0], tree.axis[i, 1], tree.axis[i, 2]
        for r in range(3):
            axis[i, r] = rotation[i, r, 0] * x + rotation[i, r, 1] * y + rotation[i, r, 2] * z
        if tree.prismatic[i]:
            for r in range(3):
                arm[i, r] += axis[i, r] * q[i]
        else:
            sine, cosine = sine_cosine(q[i])
            _turn(rotation, i, axis, sine, cosine, x, y, z)


@compiled
def _move(tree, s, v, a):  # type: ignore[no-untyped-def]
    """Angular velocities, angular accelerations and accelerations of the origins, gravity as an upward acceleration."""
    for i in range(len(v)):
        parent = tree.parent[i]
        if parent < 0:
            px = py = pz = tx = ty = tz = 0.0
            lx, ly, lz = -tree.gravity[0], -tree.gravity[1], -tree.gravity[2]
        else:
            px, py, pz = s.spin[parent, 0], s.spin[parent, 1], s.spin[parent, 2]
            tx, ty, tz = s.turn[parent, 0], s.turn[parent, 1], s.turn[parent, 2]
            lx, ly, lz = s.lift[parent, 0], s.lift[parent, 1], s.lift[parent, 2]
        wx, wy, wz = s.axis[i, 0], s.axis[i, 1], s.axis[i, 2]
        if tree.shifted[i]:
            dx, dy, dz = s.arm[i, 0], s.arm[i, 1], s.arm[i, 2]
            ux, uy, uz = py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx
            lx += ty * dz - tz * dy + py * uz - pz * uy
            ly += tz * dx - tx * dz + pz * ux - px * uz
            lz += tx * dy - ty * dx + px * uy - py * ux
        if tree.prismatic[i]:
            rate = 2.0 * v[i]
            lx += wx * a[i] + rate * (py * wz - pz * wy)
            ly += wy * a[i] + rate * (pz * wx - px * wz)
            lz += wz * a[i] + rate * (px * wy - py * wx)
        else:
            tx += wx * a[i] + v[i] * (py * wz - pz * wy)
            ty += wy * a[i] + v[i] * (pz * wx - px * wz)
            tz += wz * a[i] + v[i] * (px * wy - py * wx)
            px += wx * v[i]
            py += wy * v[i]
            pz += wz * v[i]
        s.spin[i, 0], s.spin[i, 1], s.spin[i, 2] = px, py, pz
        s.turn[i, 0], s.turn[i, 1], s.turn[i, 2] = tx, ty, tz
        s.lift[i, 0], s.lift[i, 1], s.lift[i, 2] = lx, ly, lz


@compiled
def _weigh(tree, s):  # type: ignore[no-untyped-def]
    """Mass, first moment and inertia of each body about its joint's origin, world axes."""
    rotation, local = s.rotation, tree.inertia
    for i in range(len(tree.parent)):
        s.mass[i] = tree.mass[i]
        if not tree.heavy[i]:
            for r in range(3):
                s.moment[i, r] = 0.0
                for c in range(3):
                    s.inertia[i, r, c] = 0.0
            continue
        for r in range(3):
            f, g, h = rotation[i, r, 0], rotation[i, r, 1], rotation[i, r, 2]
            s.moment[i, r] = f * tree.moment[i, 0] + g * tree.moment[i, 1] + h * tree.moment[i, 2]
            x = f * local[i, 0, 0] + g * local[i, 1, 0] + h * local[i, 2, 0]
            y = f * local[i, 0, 1] + g * local[i, 1, 1] + h * local[i, 2, 1]
            z = f * local[i, 0, 2] + g * local[i, 1, 2] + h * local[i, 2, 2]
            for c in range(3):
                s.inertia[i, r, c] = x * rotation[i, c, 0] + y * rotation[i, c, 1] + z * rotation[i, c, 2]


@compiled
def _body_wrench(s, i):  # type: ignore[no-untyped-def]
    """Force on a body and torque about its joint's origin that its motion needs."""
    m, j = s.mass[i], s.inertia
    cx, cy, cz = s.moment[i, 0], s.moment[i, 1], s.moment[i, 2]
    wx, wy, wz = s.spin[i, 0], s.spin[i, 1], s.spin[i, 2]
    tx, ty, tz = s.turn[i, 0], s.turn[i, 1], s.turn[i, 2]
    lx, ly, lz = s.lift[i, 0], s.lift[i, 1], s.lift[i, 2]
    ux, uy, uz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
    hx = j[i, 0, 0] * wx + j[i, 0, 1] * wy + j[i, 0, 2] * wz
    hy = j[i, 1, 0] * wx + j[i, 1, 1] * wy + j[i, 1, 2] * wz
    hz = j[i, 2, 0] * wx + j[i, 2, 1] * wy + j[i, 2, 2] * wz
    s.force[i, 0] = m * lx + ty * cz - tz * cy + wy * uz - wz * uy
    s.force[i, 1] = m * ly + tz * cx - tx * cz + wz * ux - wx * uz
    s.force[i, 2] = m * lz + tx * cy - ty * cx + wx * uy - wy * ux
    s.torque[i, 0] = cy * lz - cz * ly + j[i, 0, 0] * tx + j[i, 0, 1] * ty + j[i, 0, 2] * tz + wy * hz - wz * hy
    s.torque[i, 1] = cz * lx - cx * lz + j[i, 1, 0] * tx + j[i, 1, 1] * ty + j[i, 1, 2] * tz + wz * hx - wx * hz
    s.torque[i, 2] = cx * ly - cy * lx + j[i, 2, 0] * tx + j[i, 2, 1] * ty + j[i, 2, 2] * tz + wx * hy - wy * hx


@compiled
def inverse_dynamics(tree, s, q, v, a, out):  # type: ignore[no-untyped-def]
    """Generalised forces that the links need; leaves the places and own inertias of all bodies in the scratch."""
    n = len(q)
    place(tree, s, q)
    _move(tree, s, v, a)
    _weigh(tree, s)
    for i in range(n):
        if tree.heavy[i]:
            _body_wrench(s, i)
        else:
            for r in range(3):
                s.force[i, r] = 0.0
                s.torque[i, r] = 0.0
    for i in range(n - 1, -1, -1):
        fx, fy, fz = s.force[i, 0], s.force[i, 1], s.force[i, 2]
        nx, ny, nz = s.torque[i, 0], s.torque[i, 1], s.torque[i, 2]
        wx, wy, wz = s.axis[i, 0], s.axis[i, 1], s.axis[i, 2]
        if tree.prismatic[i]:
            out[i] = wx * fx + wy * fy + wz * fz
        else:
            out[i] = wx * nx + wy * ny + wz * nz
        parent = tree.parent[i]
        if parent >= 0:
            if tree.shifted[i]:
                dx, dy, dz = s.arm[i, 0], s.arm[i, 1], s.arm[i, 2]
                nx += dy * fz - dz * fy
                ny += dz * fx - dx * fz
                nz += dx * fy - dy * fx
            s.force[parent, 0] += fx
            s.force[parent, 1] += fy
            s.force[parent, 2] += fz
            s.torque[parent, 0] += nx
            s.torque[parent, 1] += ny
            s.torque[parent, 2] += nz


@compiled
def _hang(s, i, parent, shifted):  # type: ignore[no-untyped-def]
    """Add what hangs on joint i to what hangs on its parent, about the parent's origin."""
    m = s.mass[i]
    if shifted:
        d, c = s.arm, s.moment
        square = 0.0
        for r in range(3):
            square += d[i, r] * (m * d[i, r] + 2.0 * c[i, r])
        for r in range(3):
            s.inertia[parent, r, r] += square
            for k in range(3):
                crossed = m * d[i, r] * d[i, k] + d[i, r] * c[i, k] + c[i, r] * d[i, k]
                s.inertia[parent, r, k] += s.inertia[i, r, k] - crossed
        for r in range(3):
            c[parent, r] += c[i, r] + m * d[i, r]
    else:
        for r in range(3):
            s.moment[parent, r] += s.moment[i, r]
            for k in range(3):
                s.inertia[parent, r, k] += s.inertia[i, r, k]
    s.mass[parent] += m


@compiled
def mass_matrix(tree, s, out):  # type: ignore[no-untyped-def]
    """Mass matrix of the links, upper triangle, from the places and inertias that `inverse_dynamics` left behind."""
    n = len(tree.parent)
    for i in range(n):
        for k in range(i, n):
            out[i, k] = 0.0
    for i in range(n - 1, -1, -1):
        parent = tree.parent[i]
        wx, wy, wz = s.axis[i, 0], s.axis[i, 1], s.axis[i, 2]
        j = s.inertia
        cx, cy, cz = s.moment[i, 0], s.moment[i, 1], s.moment[i, 2]
        if tree.prismatic[i]:
            m = s.mass[i]
            fx, fy, fz = m * wx, m * wy, m * wz
            nx, ny, nz = cy * wz - cz * wy, cz * wx - cx * wz, cx * wy - cy * wx
        else:
            fx, fy, fz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
            nx = j[i, 0, 0] * wx + j[i, 0, 1] * wy + j[i, 0, 2] * wz
            ny = j[i, 1, 0] * wx + j[i, 1, 1] * wy + j[i, 1, 2] * wz
            nz = j[i, 2, 0] * wx + j[i, 2, 1] * wy + j[i, 2, 2] * wz
        k = i
        while k >= 0:
            if tree.prismatic[k]:
                out[k, i] = s.axis[k, 0] * fx + s.axis[k, 1] * fy + s.axis[k, 2] * fz
            else:
                out[k, i] = s.axis[k, 0] * nx + s.axis[k, 1] * ny + s.axis[k, 2] * nz
            if tree.shifted[k]:
                dx, dy, dz = s.arm[k, 0], s.arm[k, 1], s.arm[k, 2]
                nx += dy * fz - dz * fy
                ny += dz * fx - dx * fz
                nz += dx * fy - dy * fx
            k = tree.parent[k]
        if parent >= 0:
            _hang(s, i, parent, tree.shifted[i])


_SCRATCH_MATRICES = 2 * 9 + 8 * 3 + 8  # numbers a coordinate, without the square matrix


def scratch_size(n: int, laws: int) -> int:
    """Numbers that `scratch_in` needs for n coordinates and that many laws."""
    return _SCRATCH_MATRICES * n + n * n + 6 * laws


@compiled
def scratch_in(memory, n, m):  # type: ignore[no-untyped-def]
    """Working memory for n coordinates and m laws, laid out in a flat array."""
    return _scratch_in(memory, n, m)


@_inner
def _scratch_in(memory, n, m):  # type: ignore[no-untyped-def]
    three, at = 3 * n, 27 * n + 15 * n
    rows = at + 6 * m + n * n
    return Scratch(
        memory[: 9 * n].reshape((n, 3, 3)),
        memory[9 * n : 12 * n].reshape((n, 3)),
        memory[12 * n : 15 * n].reshape((n, 3)),
        memory[15 * n : 18 * n].reshape((n, 3)),
        memory[18 * n : 21 * n].reshape((n, 3)),
        memory[21 * n : 24 * n].reshape((n, 3)),
        memory[24 * n : 27 * n].reshape((n, 3)),
        memory[27 * n : 30 * n].reshape((n, 3)),
        memory[rows : rows + n],
        memory[30 * n : 30 * n + three].reshape((n, 3)),
        memory[33 * n : at].reshape((n, 3, 3)),
        memory[at : at + m],
        memory[at + m : at + 2 * m],
        memory[at + 2 * m : at + 3 * m],
        memory[at + 3 * m : at + 4 * m],
        memory[at + 4 * m : at + 5 * m],
        memory[at + 5 * m : at + 6 * m],
        memory[at + 6 * m : rows].reshape((n, n)),
        memory[rows + n : rows + 2 * n],
        memory[rows + 2 * n : rows + 3 * n],
        memory[rows + 3 * n : rows + 4 * n],
        memory[rows + 4 * n : rows + 5 * n],
        memory[rows + 5 * n : rows + 6 * n],
        memory[rows + 6 * n : rows + 7 * n],
        memory[rows + 7 * n : rows + 8 * n],
    )


# ---- scalar laws --------------------------------------------------------------------------------------------


@compiled
def combine(laws, m, x):  # type: ignore[no-untyped-def]
    """The combination of x that law m depends on."""
    total = 0.0
    for w in range(laws.place.shape[1]):
        total += laws.weight[m, w] * x[laws.place[m, w]]
    return total


@compiled
def scatter(laws, m, torque, out):  # type: ignore[no-untyped-def]
    """Add the torque of law m to the coordinates that it depends on."""
    for w in range(laws.place.shape[1]):
        out[laws.place[m, w]] += laws.weight[m, w] * torque


@compiled
def _ask(laws, m, x, rate):  # type: ignore[no-untyped-def]
    _call(laws.address[m], x, rate, laws.parameters[m].ctypes.data, laws.out.ctypes.data)
    return laws.out[0], laws.out[1], laws.out[2]


def ask_law(laws: Any, m: Any, x: Any, rate: Any) -> Any:
    """Torque of the compiled law m and its slopes by x and rate; compiled code only."""
    raise NotImplementedError


@overload(ask_law)
def _ask_law(laws, m, x, rate):  # type: ignore[no-untyped-def]
    if isinstance(x, Vector):

        def lanes(laws, m, x, rate):  # type: ignore[no-untyped-def]
            force, slope, rate_slope = 0.0 * x, 0.0 * x, 0.0 * x
            for lane in range(laws.wanted[0]):
                a, b, c = _ask(laws, m, lane_of(x, lane), lane_of(rate, lane))
                force = with_lane(force, lane, a)
                slope, rate_slope = with_lane(slope, lane, b), with_lane(rate_slope, lane, c)
            return force, slope, rate_slope

        return lanes

    def number(laws, m, x, rate):  # type: ignore[no-untyped-def]
        return _ask(laws, m, x, rate)

    return number


@compiled
def law_forces(laws, s, q, v, a, torques, by_x, by_rate, out):  # type: ignore[no-untyped-def]
    """Add the laws' generalised forces to `out`; each law's torque and slopes to the other arrays.

    Returns the power that they dissipate, W.
    """
    lost = 0.0
    for m in range(len(laws.inertia)):
        x, rate = combine(laws, m, q), combine(laws, m, v)
        torque = laws.stiffness[m] * x + laws.damping[m] * rate + laws.inertia[m] * combine(laws, m, a)
        by_x[m], by_rate[m] = laws.stiffness[m], laws.damping[m]
        lost += laws.damping[m] * rate * rate
        if laws.address[m] != 0:
            force, slope, rate_slope = ask_law(laws, m, x, rate)
            torque += force
            by_x[m] += slope
            by_rate[m] += rate_slope
            if not laws.stores[m]:
                lost += force * rate
        torques[m] = torque
        scatter(laws, m, torque, out)
    return lost


@compiled
def _add_laws_to_system(laws, s, by_rate, by_x, system):  # type: ignore[no-untyped-def]
    """Add inertia + by_rate * D + by_x * K of the laws to the upper triangle of `system`."""
    for m in range(len(laws.inertia)):
        value = laws.inertia[m] + by_rate * s.by_rate[m] + by_x * s.by_x[m]
        for w in range(laws.place.shape[1]):
            for u in range(laws.place.shape[1]):
                r, c = laws.place[m, w], laws.place[m, u]
                weight = laws.weight[m, w] * laws.weight[m, u]
                if r <= c and weight != 0.0:
                    system[r, c] += weight * value


# ---- linear algebra -----------------------------------------------------------------------------------------


@compiled
def factor(system):  # type: ignore[no-untyped-def]
    """U of ``U.T diag(1 / d) U = system`` in place, from the upper triangle of a symmetric matrix; 1 / d on its
    diagonal.
    """
    n = len(system)
    for k in range(n):
        inverse = 1.0 / system[k, k]
        system[k, k] = inverse
        for i in range(k + 1, n):
            scale = system[k, i] * inverse
            for j in range(i, n):
                system[i, j] -= scale * system[k, j]


@compiled
def solve(system, x):  # type: ignore[no-untyped-def]
    """Solve with what `factor` left, in place."""
    n = len(x)
    for k in range(n):
        x[k] *= system[k, k]
        for j in range(k + 1, n):
            x[j] -= x[k] * system[k, j]
    for k in range(n - 1, -1, -1):
        total = 0.0
        for j in range(k + 1, n):
            total += system[k, j] * x[j]
        x[k] -= total * system[k, k]


def packed(tree: Tree, laws: Laws) -> tuple[Integers, Array]:
    """All integers and all numbers of a plant in two flat arrays, which cross from Python faster than twenty."""
    integers = [
        tree.parent,
        tree.prismatic,
        tree.turned,
        tree.shifted,
        tree.heavy,
        laws.place,
        laws.address,
        laws.stores,
    ]
    numbers = [tree.rotation, tree.offset, tree.axis, tree.mass, tree.moment, tree.inertia, tree.gravity]
    numbers += [laws.weight, laws.inertia, laws.damping, laws.stiffness, laws.parameters, laws.out]
    sizes = np.array([len(tree.parent), *laws.place.shape, laws.parameters.shape[1]], dtype=np.int64)
    return np.concatenate([sizes, *(np.ravel(x) for x in integers)]), np.concatenate([np.ravel(x) for x in numbers])


@_inner
def _unpacked(integers, numbers):  # type: ignore[no-untyped-def]
    """Tree and laws as views of what `packed` made."""
    n, m, width, length = integers[0], integers[1], integers[2], integers[3]
    i, k = 4 + 5 * n, 28 * n + 3
    w = k + m * width
    tree = Tree(
        integers[4 : 4 + n],
        integers[4 + n : 4 + 2 * n],
        integers[4 + 2 * n : 4 + 3 * n],
        integers[4 + 3 * n : 4 + 4 * n],
        integers[4 + 4 * n : i],
        numbers[: 9 * n].reshape((n, 3, 3)),
        numbers[9 * n : 12 * n].reshape((n, 3)),
        numbers[12 * n : 15 * n].reshape((n, 3)),
        numbers[15 * n : 16 * n],
        numbers[16 * n : 19 * n].reshape((n, 3)),
        numbers[19 * n : 28 * n].reshape((n, 3, 3)),
        numbers[28 * n : 28 * n + 3],
    )
    laws = Laws(
        integers[i : i + m * width].reshape((m, width)),
        numbers[k:w].reshape((m, width)),
        numbers[w : w + m],
        numbers[w + m : w + 2 * m],
        numbers[w + 2 * m : w + 3 * m],
        integers[i + m * width : i + m * width + m],
        integers[i + m * width + m : i + m * width + 2 * m],
        numbers[w + 3 * m : w + 3 * m + m * length].reshape((m, length)),
        numbers[w + 3 * m + m * length :],
        integers[:1],
    )
    return tree, laws


@called
def accelerations(integers, plant_numbers, memory, drive, q, v, drive_torque):  # type: ignore[no-untyped-def]
    """Accelerations under drive torques; not finite where the mass matrix is singular."""
    tree, laws = _unpacked(integers, plant_numbers)
    n = len(q)
    out = np.zeros(n)
    s = _scratch_in(memory, n, len(laws.inertia))
    for i in range(n):
        s.a[i] = 0.0
    inverse_dynamics(tree, s, q, v, s.a, s.generalised)
    law_forces(laws, s, q, v, s.a, s.torques, s.by_x, s.by_rate, s.generalised)
    mass_matrix(tree, s, s.system)
    _add_laws_to_system(laws, s, 0.0, 0.0, s.system)
    for j in range(len(drive)):
        out[drive[j]] = drive_torque[j]
    for i in range(n):
        out[i] -= s.generalised[i]
    factor(s.system)
    solve(s.system, out)
    return out


# ---- one step of the integrator -----------------------------------------------------------------------------
#
# Verwer's two-stage Rosenbrock-W method ROS2 on y = (q, v), y' = F(y):
#
#   (1 - g h J) k_1 = h F(y),   (1 - g h J) k_2 = h F(y + k_1) - 2 k_1,   y <- y + 3/2 k_1 + 1/2 k_2
#
# Second order for any J, L-stable for the true J. J here holds what is stiff (mass matrix, slopes of the effects) and
# leaves out the slow rest (how gravity and Coriolis forces change along a step). With M a = u - f(q, v), D = df/dv and
# K = df/dq, eliminating the positions leaves one system of n equations a step, A = M + g h D + (g h)^2 K.


class Extra(NamedTuple):
    """What effects without a compiled law add at one stage, for each lane."""

    used: bool
    lost: Array  # (lanes,) W, dissipated
    force: Array  # (lanes, n)
    inertia: Array  # (lanes, n, n)
    damping: Array  # (lanes, n, n)
    stiffness: Array  # (lanes, n, n)


def no_extra() -> Extra:
    """All effects have compiled laws."""
    return Extra(False, np.zeros(1), np.zeros((1, 1)), *(np.zeros((1, 1, 1)) for _ in range(3)))


@compiled
def _add_dense(matrix, lane, scale, x, out):  # type: ignore[no-untyped-def]
    n = len(x)
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += matrix[lane, i, j] * x[j]
        out[i] += scale * total


@compiled
def _add_extra_to_system(extra, lane, gh, system):  # type: ignore[no-untyped-def]
    n = len(system)
    for i in range(n):
        for j in range(i):
            system[i, j] = system[j, i]
    for i in range(n):
        for j in range(n):
            more = extra.inertia[lane, i, j] + gh * extra.damping[lane, i, j]
            system[i, j] += more + gh * gh * extra.stiffness[lane, i, j]


@compiled
def _factor_general(system):  # type: ignore[no-untyped-def]
    """L and U in place, 1 / U_kk on the diagonal; no pivots: inertia outweighs what makes the matrix unsymmetric."""
    n = len(system)
    for k in range(n):
        inverse = 1.0 / system[k, k]
        system[k, k] = inverse
        for i in range(k + 1, n):
            scale = system[i, k] * inverse
            system[i, k] = scale
            for j in range(k + 1, n):
                system[i, j] -= scale * system[k, j]


@compiled
def _solve_general(system, x):  # type: ignore[no-untyped-def]
    n = len(x)
    for i in range(n):
        for j in range(i):
            x[i] -= system[i, j] * x[j]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= system[i, j] * x[j]
        x[i] *= system[i, i]


@called
def first_stage(tree, laws, s, extra, lane, q, v, torque, h):  # type: ignore[no-untyped-def]
    """k_1, and the point y + k_1 with its acceleration k_1 / h, in the scratch. Returns the power dissipated at y, W.

    `extra.force` is the effects' force less `extra.inertia` times the acceleration that it was taken at.
    """
    n, gh = len(q), GAMMA * h
    for i in range(n):
        s.a[i] = 0.0
    inverse_dynamics(tree, s, q, v, s.a, s.generalised)
    lost = law_forces(laws, s, q, v, s.a, s.torques, s.by_x, s.by_rate, s.generalised)
    mass_matrix(tree, s, s.system)
    _add_laws_to_system(laws, s, gh, gh * gh, s.system)
    for i in range(n):
        s.right[i] = h * (torque[i] - s.generalised[i])
    for m in range(len(laws.inertia)):
        scatter(laws, m, -gh * h * s.by_x[m] * combine(laws, m, v), s.right)
    if extra.used:
        for i in range(n):
            s.right[i] -= h * extra.force[lane, i]
        lost += extra.lost[lane]
        _add_dense(extra.stiffness, lane, -gh * h, v, s.right)
        _add_extra_to_system(extra, lane, gh, s.system)
        _factor_general(s.system)
    else:
        factor(s.system)
    for i in range(n):
        s.k_v[i] = s.right[i]
    if extra.used:
        _solve_general(s.system, s.k_v)
    else:
        solve(s.system, s.k_v)
    for i in range(n):
        s.k_q[i] = h * v[i] + gh * s.k_v[i]
        s.q[i] = q[i] + s.k_q[i]
        s.v[i] = v[i] + s.k_v[i]
        s.a[i] = s.k_v[i] / h
    return lost


@compiled
def _bend(laws, s, h):  # type: ignore[no-untyped-def]
    """How far the laws' torques at y + k_1 are from where their slopes at y put them, as an angle that a step errs by,
    rad.
    """
    most = 0.0
    for m in range(len(laws.inertia)):
        if laws.address[m] == 0:
            continue
        rate, x = combine(laws, m, s.k_v), combine(laws, m, s.k_q)
        missed = s.late_torques[m] - laws.inertia[m] * combine(laws, m, s.a)
        missed -= s.torques[m] + s.by_rate[m] * rate + s.by_x[m] * x
        lightest = 0.0
        for w in range(laws.place.shape[1]):
            if laws.weight[m, w] != 0.0:  # inverse pivots: of the inertia that this coordinate turns, or more
                lightest = larger_size(lightest, s.system[laws.place[m, w], laws.place[m, w]])
        most = larger_size(most, missed * lightest)
    return h * h * most


@called
def second_stage(tree, laws, s, extra, late_force, lane, q, v, torque, h):  # type: ignore[no-untyped-def]
    """k_2, then q and v moved on by a step. Returns how much the laws bend along it, rad.

    `late_force` (lanes, n) is the extra effects' force at y + k_1.

    The accelerations at y + k_1 are asked for about k_1 / h: what remains of the mass matrix's change along the step is
    then of second order.
    """
    n, gh = len(q), GAMMA * h
    inverse_dynamics(tree, s, s.q, s.v, s.a, s.generalised)
    law_forces(laws, s, s.q, s.v, s.a, s.late_torques, s.late_by_x, s.late_by_rate, s.generalised)
    bend = _bend(laws, s, h)
    # right = h (u - f) - M k_1 - g h K r, with M k_1 from the first stage's equation and r = h v - 2 k_q
    for i in range(n):
        s.right[i] = h * (torque[i] - s.generalised[i]) - s.right[i]
        s.q[i] = h * s.v[i] - 2.0 * s.k_q[i]
    for m in range(len(laws.inertia)):
        rate, x = combine(laws, m, s.k_v), combine(laws, m, s.q)
        scatter(laws, m, gh * (s.by_rate[m] * rate + s.by_x[m] * (gh * rate - x)), s.right)
    if extra.used:
        for i in range(n):
            s.right[i] -= h * late_force[lane, i]
        _add_dense(extra.damping, lane, gh, s.k_v, s.right)
        _add_dense(extra.stiffness, lane, gh * gh, s.k_v, s.right)
        _add_dense(extra.stiffness, lane, -gh, s.q, s.right)
        _solve_general(s.system, s.right)
    else:
        solve(s.system, s.right)
    for i in range(n):
        q[i] += 1.5 * s.k_q[i] + 0.5 * (s.q[i] + gh * s.right[i])
        v[i] += 1.5 * s.k_v[i] + 0.5 * s.right[i]
    return bend


# ---- the sampling loop ----------------------------------------------------------------------------------------
#
# Controller, current loop, checks and log around the integrator. It stands in this file because the compiler's cache of
# a function knows only the function's own file.

DIVISION = 8
RUNNING, OVERLOAD, ANGLE_LIMIT, OVERSPEED, DIVERGED, JUMP = range(6)


class Loop(NamedTuple):
    """The controller in numbers, one a joint unless said otherwise."""

    drive: Integers  # (joints,) coordinate of each drive
    period: float  # s
    substeps: int  # steps of the integrator a period
    tolerance: float  # rad; a step along which the laws bend more is divided
    position_gain: Array  # N m/rad
    velocity_gain: Array  # N m s/rad
    integral_gain: Array  # N m/(rad s)
    position_step: Array  # rad, 0 for no quantisation
    velocity_step: Array  # rad/s
    torque_step: Array  # N m
    torque_limit: Array  # N m
    current_mean: float  # share of the old current in the mean of a sample; 0 for an ideal current loop
    current_left: float  # what is left of the old current at the sample's end
    overload_samples: int
    lower: Array  # rad
    upper: Array  # rad
    speed: Array  # rad/s


class Lanes(NamedTuple):
    """State of all lanes between two samples."""

    q: Array  # (lanes, n)
    v: Array  # (lanes, n)
    a: Array  # (lanes, n) of the last stage, where effects ask for it
    integral: Array  # (lanes, joints) N m
    current: Array  # (lanes, joints) N m, behind the current loop, now
    held: Array  # (lanes, joints) N m, mean over the sample
    overloaded: Integers  # (lanes, joints) samples at the limit without a break
    open: Array  # (lanes,) s, half the last step: what its end still adds to the dissipation, per W
    work: Array  # (lanes,) J
    dissipated: Array  # (lanes,) J
    status: Integers  # (lanes,)
    joint: Integers  # (lanes,) where a lane ended
    sample: Integers  # (lanes,) when
    closed: Array  # (lanes,) J, dissipated up to the last step's start
    divided: Integers  # (lanes,) steps that were taken in `DIVISION` parts
    stop: Integers  # (lanes, 2) sample at which a lane's reference jumps, and the joint


class Inputs(NamedTuple):
    """A chunk of inputs at the controller's rate."""

    first: int  # number of the chunk's first sample
    position: Array  # (lanes, samples, joints) rad, reference
    velocity: Array  # (lanes, samples, joints) rad/s, reference
    feedforward: Array  # (lanes, samples, joints) N m
    position_noise: Array  # (lanes, samples, joints) rad; no samples where there is none
    velocity_noise: Array  # (lanes, samples, joints) rad/s


class Logs(NamedTuple):
    """A chunk of logs: measured signals at the controller's rate, states every `stride` samples."""

    stride: int
    position: Array  # (lanes, samples, joints) rad
    velocity: Array  # (lanes, samples, joints) rad/s
    torque: Array  # (lanes, samples, joints) N m, mean over one period centred on the sample
    q: Array  # (lanes, states, n)
    v: Array  # (lanes, states, n)
    work: Array  # (lanes, states) J
    dissipated: Array  # (lanes, states) J


@compiled
def _rounded(x, step):  # type: ignore[no-untyped-def]
    return x if step == 0.0 else step * math.floor(x / step + 0.5)


@compiled
def _end(lanes, lane, status, joint, sample):  # type: ignore[no-untyped-def]
    lanes.status[lane] = status
    lanes.joint[lane] = joint
    lanes.sample[lane] = sample


@compiled
def _check(loop, lanes, lane, sample):  # type: ignore[no-untyped-def]
    for i in range(lanes.q.shape[1]):
        if not (math.isfinite(lanes.q[lane, i]) and math.isfinite(lanes.v[lane, i])):
            _end(lanes, lane, DIVERGED, -1, sample)
            return
    for j in range(len(loop.drive)):
        angle, speed = lanes.q[lane, loop.drive[j]], lanes.v[lane, loop.drive[j]]
        if abs(speed) > loop.speed[j]:
            _end(lanes, lane, OVERSPEED, j, sample)
        elif angle < loop.lower[j] or angle > loop.upper[j]:
            _end(lanes, lane, ANGLE_LIMIT, j, sample)
        elif lanes.overloaded[lane, j] >= loop.overload_samples:
            _end(lanes, lane, OVERLOAD, j, sample)
    if sample >= lanes.stop[lane, 0]:
        _end(lanes, lane, JUMP, lanes.stop[lane, 1], sample)


@called
def control(loop, lanes, inputs, logs, lane, k, torque):  # type: ignore[no-untyped-def]
    """One sample of the controller for one lane: measure, command, current loop, log, check.

    `torque` (n,) receives the drive torques that act until the next sample.
    """
    for j in range(len(loop.drive)):
        i = loop.drive[j]
        angle, speed = lanes.q[lane, i], lanes.v[lane, i]
        if inputs.position_noise.shape[1] > 0:
            angle += inputs.position_noise[lane, k, j]
            speed += inputs.velocity_noise[lane, k, j]
        angle, speed = _rounded(angle, loop.position_step[j]), _rounded(speed, loop.velocity_step[j])
        error = inputs.position[lane, k, j] - angle
        more = loop.integral_gain[j] * loop.period * error
        command = loop.position_gain[j] * error + loop.velocity_gain[j] * (inputs.velocity[lane, k, j] - speed)
        command += lanes.integral[lane, j] + more + inputs.feedforward[lane, k, j]
        limit = loop.torque_limit[j]
        if abs(command) > limit:
            # the integrator waits, unless it would help out of the limit
            if command * more < 0.0:
                lanes.integral[lane, j] += more
            command = math.copysign(limit, command)
            lanes.overloaded[lane, j] += 1
        else:
            lanes.integral[lane, j] += more
            lanes.overloaded[lane, j] = 0
        command = _rounded(command, loop.torque_step[j])
        before = lanes.held[lane, j]
        missing = lanes.current[lane, j] - command
        lanes.held[lane, j] = command + loop.current_mean * missing
        lanes.current[lane, j] = command + loop.current_left * missing
        torque[i] = lanes.held[lane, j]
        logs.position[lane, k, j], logs.velocity[lane, k, j] = angle, speed
        logs.torque[lane, k, j] = 0.5 * (before + lanes.held[lane, j])
    if k % logs.stride == 0:
        at = k // logs.stride
        for i in range(lanes.q.shape[1]):
            logs.q[lane, at, i], logs.v[lane, at, i] = lanes.q[lane, i], lanes.v[lane, i]
        # what the last step's end adds to the dissipation is known in the next `begin`, which logs it again
        logs.work[lane, at], logs.dissipated[lane, at] = lanes.work[lane], lanes.dissipated[lane]
    _check(loop, lanes, lane, inputs.first + k)


@compiled
def _dissipate(lanes, lane, lost, h):  # type: ignore[no-untyped-def]
    """Count the power that is lost at a step's start: by the trapezoidal rule it closes the step before as well."""
    lanes.closed[lane] = lanes.dissipated[lane] + lanes.open[lane] * lost
    lanes.dissipated[lane] = lanes.closed[lane] + 0.5 * h * lost
    lanes.open[lane] = 0.5 * h


@called
def begin(tree, laws, scratch, loop, extra, lanes, lane, torque, h):  # type: ignore[no-untyped-def]
    """First stage of a step of one lane, with its share of work and dissipation."""
    lost = first_stage(tree, laws, scratch, extra, lane, lanes.q[lane], lanes.v[lane], torque, h)
    _dissipate(lanes, lane, lost, h)
    for j in range(len(loop.drive)):
        lanes.work[lane] -= torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]


@called
def finish(tree, laws, scratch, loop, extra, late, lanes, lane, torque, h):  # type: ignore[no-untyped-def]
    """Second stage of a step of one lane."""
    bend = second_stage(tree, laws, scratch, extra, late, lane, lanes.q[lane], lanes.v[lane], torque, h)
    for j in range(len(loop.drive)):
        lanes.work[lane] += torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]
    return bend


@compiled
def _load(lanes, first, count, torque, packed):  # type: ignore[no-untyped-def]
    """States and torques of a pack of lanes side by side, (3, n, WIDTH); places without a running lane repeat
    another.
    """
    n = lanes.q.shape[1]
    spare = first
    for place in range(count):
        if lanes.status[first + place] == RUNNING:
            spare = first + place
    for place in range(WIDTH):
        lane = first + place if place < count and lanes.status[first + place] == RUNNING else spare
        for i in range(n):
            packed[0, i, place] = lanes.q[lane, i]
            packed[1, i, place] = lanes.v[lane, i]
            packed[2, i, place] = torque[lane - first, i]


@compiled
def _store(loop, lanes, lane, place, torque, packed, lost, h):  # type: ignore[no-untyped-def]
    """A lane's new state, with its share of work and dissipation."""
    _dissipate(lanes, lane, lost, h)
    for j in range(len(loop.drive)):
        lanes.work[lane] -= torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]
    for i in range(lanes.q.shape[1]):
        lanes.q[lane, i] = packed[0, i, place]
        lanes.v[lane, i] = packed[1, i, place]
    for j in range(len(loop.drive)):
        lanes.work[lane] += torque[loop.drive[j]] * lanes.q[lane, loop.drive[j]]


@called
def _divide(tree, laws, wide, single, loop, extra, lanes, lane, torque, h):  # type: ignore[no-untyped-def]
    """A step of one lane in `DIVISION` parts; `torque` (1, n)."""
    n = lanes.q.shape[1]
    vectors = as_vectors(single.reshape(single.size)).reshape((3, n))
    wanted, part = laws.wanted[0], h / DIVISION
    laws.wanted[0] = 1
    lanes.divided[lane] += 1
    for _ in range(DIVISION):
        _load(lanes, lane, 1, torque, single)
        lost = first_stage(tree, laws, wide, extra, 0, vectors[0], vectors[1], vectors[2], part)
        second_stage(tree, laws, wide, extra, extra.force, 0, vectors[0], vectors[1], vectors[2], part)
        _store(loop, lanes, lane, 0, torque[0], single, lane_of(lost, 0), part)
    laws.wanted[0] = wanted


@called
def _run_pack(  # type: ignore[no-untyped-def]
    tree, laws, wide, packed, loop, extra, lanes, inputs, logs, samples, first, count
):
    """`run` of up to `WIDTH` lanes, side by side in vectors; steps that must be divided are, lane by lane."""
    n = lanes.q.shape[1]
    h = loop.period / loop.substeps
    torque, single = np.zeros((count, n)), np.zeros((3, n, WIDTH))
    vectors = as_vectors(packed.reshape(packed.size)).reshape((3, n))
    q, v, pull = vectors[0], vectors[1], vectors[2]
    for k in range(samples):
        running = 0
        for place in range(count):
            if lanes.status[first + place] == RUNNING:
                control(loop, lanes, inputs, logs, first + place, k, torque[place])
            if lanes.status[first + place] == RUNNING:
                running += 1
        if running == 0:
            return
        for part in range(loop.substeps):
            _load(lanes, first, count, torque, packed)
            lost = first_stage(tree, laws, wide, extra, 0, q, v, pull, h)
            bend = second_stage(tree, laws, wide, extra, extra.force, 0, q, v, pull, h)
            for place in range(count):
                lane = first + place
                if lanes.status[lane] != RUNNING:
                    continue
                if part == 0 and k % logs.stride == 0:
                    at = k // logs.stride
                    logs.dissipated[lane, at] = lanes.dissipated[lane] + lanes.open[lane] * lane_of(lost, place)
                if lane_of(bend, place) > loop.tolerance:
                    _divide(tree, laws, wide, single, loop, extra, lanes, lane, torque[place : place + 1], h)
                else:
                    _store(loop, lanes, lane, place, torque[place], packed, lane_of(lost, place), h)


@called
def run(tree, laws, memory, loop, extra, lanes, inputs, logs, samples):  # type: ignore[no-untyped-def]
    """Advance all running lanes by that many samples, eight at a time; every effect has a compiled law."""
    n, m = lanes.q.shape[1], len(laws.inertia)
    wide = _scratch_in(as_vectors(np.zeros(WIDTH * memory.shape[1])), n, m)
    packed = np.zeros((3, n, WIDTH))
    for first in range(0, len(lanes.status), WIDTH):
        count = min(WIDTH, len(lanes.status) - first)
        laws.wanted[0] = count
        _run_pack(tree, laws, wide, packed, loop, extra, lanes, inputs, logs, samples, first, count)


# The same, one part of a step at a time, for effects that Python works out in between.


@called
def control_all(loop, lanes, inputs, logs, k, torque):  # type: ignore[no-untyped-def]
    """`control` of all running lanes; `torque` (lanes, n)."""
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            control(loop, lanes, inputs, logs, lane, k, torque[lane])


@called
def begin_all(tree, laws, memory, loop, extra, lanes, torque, h, q, v):  # type: ignore[no-untyped-def]
    """`begin` of all running lanes; `q`, `v` and `lanes.a` receive the points where the second stage wants its
    forces.
    """
    n = lanes.q.shape[1]
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            scratch = scratch_in(memory[lane], n, len(laws.inertia))
            begin(tree, laws, scratch, loop, extra, lanes, lane, torque[lane], h)
            q[lane], v[lane], lanes.a[lane] = scratch.q, scratch.v, scratch.a


@called
def finish_all(tree, laws, memory, loop, extra, late, lanes, torque, h):  # type: ignore[no-untyped-def]
    """`finish` of all running lanes; returns the largest bend."""
    bend = 0.0
    for lane in range(len(lanes.status)):
        if lanes.status[lane] == RUNNING:
            scratch = scratch_in(memory[lane], lanes.q.shape[1], len(laws.inertia))
            bend = max(bend, finish(tree, laws, scratch, loop, extra, late, lanes, lane, torque[lane], h))
    return bend


@called
def decimate(buffer, weights, stride, out):  # type: ignore[no-untyped-def]
    """Every `stride`-th sample of a filtered signal: buffer (lanes, samples, channels), out (lanes, outputs,
    channels).
    """
    for lane in range(out.shape[0]):
        for k in range(out.shape[1]):
            for c in range(out.shape[2]):
                out[lane, k, c] = 0.0
            for t in range(len(weights)):
                for c in range(out.shape[2]):
                    out[lane, k, c] += weights[t] * buffer[lane, k * stride + t, c]


# ---- a robot --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot in arrays: its tree, the effects that have compiled laws, and those that have none.

    Attributes
    ----------
    tree, laws, drives : arrays
    others : tuple of Effect
        Asked for `force` and `derivatives` at each step.
    """

    tree: Tree
    laws: Laws
    others: tuple[Effect, ...]
    drives: Integers  # (joints,) where the drive angles stand among the coordinates

    @cached_property
    def _packed(self) -> tuple[Integers, Array, Array]:
        return *packed(self.tree, self.laws), self.scratch(1)[0]

    def accelerations(self, q: Array, v: Array, drive_torque: Array) -> Array:
        """Accelerations of the tree and the effects with compiled laws, shape (n,)."""
        a: Array = accelerations(*self._packed, self.drives, q, v, drive_torque)
        return a

    def scratch(self, lanes: int) -> Array:
        """Working memory, one row a lane."""
        return np.zeros((lanes, scratch_size(len(self.tree.parent), len(self.laws.inertia))))


def plant_of(model: pin.Model, effects: Sequence[Effect], motion: Motion, drives: Integers) -> Plant:
    """The arrays of a model and its effects; `motion` is any sample."""
    laws: list[Law] = []
    others = []
    for effect in effects:
        own = effect.laws(motion)
        if own is None:
            others.append(effect)
        else:
            laws += own
    return Plant(tree_of(model), laws_of(laws, model.nv), tuple(others), drives)
