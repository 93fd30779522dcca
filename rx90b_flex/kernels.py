"""Compiled code: dynamics of a tree, scalar laws, the integrator's step, and the sampling loop around it.

Newton-Euler in world axes about the joints' own origins. The virtual hinges of a flexible joint share their origin and
carry no mass, so that most of a flexible tree costs one plane rotation a hinge. Everything is for one lane (one
run), and the callers loop over lanes; only the perturbation method, at the end, advances all of them at once.
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
    integral: Array  # (joints, lanes) N m
    current: Array  # (joints, lanes) N m, behind the current loop, now
    held: Array  # (joints, lanes) N m, mean over the sample
    overloaded: Integers  # (joints, lanes) samples at the limit without a break
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
    """A chunk of inputs. Lanes come last, so that what acts on all of them lies side by side."""

    first: int  # number of the chunk's first sample
    up: int  # samples of the controller between two of the feed-forward torque
    position: Array  # (samples, joints, lanes or 1) rad, reference; 1: the lanes share it
    velocity: Array  # (samples, joints, lanes or 1) rad/s, reference
    feedforward: Array  # (samples / up + 1, joints, lanes) N m, straight lines between
    noise: Array  # (samples or 1, 2, joints, lanes) of angle and speed, rad and rad/s; or one sample for all


class Logs(NamedTuple):
    """Signals of a chunk as the controller sees them, and the states of the whole run, every `stride` samples."""

    stride: int
    row: int  # of the chunk's first state
    measured: Array  # (samples, 3, joints, lanes) rad, rad/s, and the torque's mean over a period centred on the sample
    q: Array  # (lanes, all states, n)
    v: Array  # (lanes, all states, n)
    work: Array  # (lanes, all states) J
    dissipated: Array  # (lanes, all states) J


@compiled
def _rounded(x, step):  # type: ignore[no-untyped-def]
    return x if step == 0.0 else step * np.floor(x / step + 0.5)


@compiled
def _joint_in_loop(loop, j):  # type: ignore[no-untyped-def]
    """The numbers of one joint that `_command` reads; numbers, since looking into arrays costs more than arithmetic."""
    gains = loop.position_gain[j], loop.velocity_gain[j], loop.integral_gain[j] * loop.period
    steps = loop.position_step[j], loop.velocity_step[j], loop.torque_step[j]
    return gains, steps, loop.torque_limit[j], loop.current_mean, loop.current_left


@compiled
def _command(joint, angle, speed, reference, rate, feedforward, integral, current):  # type: ignore[no-untyped-def]
    """One sample of one joint's controller and current loop.

    Returns angle and speed as the resolver shows them, the new integral and current, the torque that acts until the next
    sample (its mean), and whether the command was at its limit.
    """
    (position_gain, velocity_gain, integral_gain), (position_step, velocity_step, torque_step), limit, mean, left = (
        joint
    )
    angle, speed = _rounded(angle, position_step), _rounded(speed, velocity_step)
    error = reference - angle
    more = integral_gain * error
    command = position_gain * error + velocity_gain * (rate - speed) + (integral + more + feedforward)
    limited = abs(command) > limit
    # at the limit the integrator waits, unless it would help out of it
    integral += 0.0 if limited & (command * more >= 0.0) else more
    command = limit if command > limit else (-limit if command < -limit else command)
    command = _rounded(command, torque_step)
    missing = current - command
    return angle, speed, integral, command + left * missing, command + mean * missing, limited


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
        elif lanes.overloaded[j, lane] >= loop.overload_samples:
            _end(lanes, lane, OVERLOAD, j, sample)
    if sample >= lanes.stop[lane, 0]:
        _end(lanes, lane, JUMP, lanes.stop[lane, 1], sample)


@called
def control(loop, lanes, inputs, logs, lane, k, torque):  # type: ignore[no-untyped-def]
    """One sample of the controller for one lane: measure, command, log, check.

    `torque` (n,) receives the drive torques that act until the next sample.
    """
    row, part = k // inputs.up, (k % inputs.up) / inputs.up
    own, noise = lane if inputs.position.shape[2] > 1 else 0, k if inputs.noise.shape[0] > 1 else 0
    for j in range(len(loop.drive)):
        i = loop.drive[j]
        angle, speed = lanes.q[lane, i], lanes.v[lane, i]
        angle += inputs.noise[noise, 0, j, lane]
        speed += inputs.noise[noise, 1, j, lane]
        start, end = inputs.feedforward[row, j, lane], inputs.feedforward[row + 1, j, lane]
        angle, speed, integral, current, held, limited = _command(
            _joint_in_loop(loop, j),
            angle,
            speed,
            inputs.position[k, j, own],
            inputs.velocity[k, j, own],
            start + part * (end - start),
            lanes.integral[j, lane],
            lanes.current[j, lane],
        )
        lanes.overloaded[j, lane] = lanes.overloaded[j, lane] + 1 if limited else 0
        logs.measured[k, 0, j, lane], logs.measured[k, 1, j, lane] = angle, speed
        logs.measured[k, 2, j, lane] = 0.5 * (lanes.held[j, lane] + held)
        lanes.integral[j, lane], lanes.current[j, lane], lanes.held[j, lane] = integral, current, held
        torque[i] = held
    if k % logs.stride == 0:
        at = logs.row + k // logs.stride
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
                    at = logs.row + k // logs.stride
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


# ---- the perturbation method ------------------------------------------------------------------------------------
#
# Lanes stand in the columns: a step of all of them is one product of matrices.

NEWTON = 30  # iterations for one rate; one is usual, more where a joint sticks
# Friction is read from a table over the rate, whose cells are 1/16 of an octave: a cell's number is the leading bits of
# the floating-point number, and a cubic in each leaves relative errors of 1e-8. Below 2^-30 rad/s the torque is linear,
# from 2^8 rad/s on the law itself is asked.
LOWEST, OCTAVES, FINE = -30, 38, 16
CELLS = OCTAVES * FINE
SMALLEST, LARGEST = 2.0**LOWEST, 2.0 ** (LOWEST + OCTAVES)


class Along(NamedTuple):
    """The nominal motion of a chunk and the system about it."""

    nodes: Array  # (rows + 1, 3, n, n) M, D and K at the references' rate, without the compiled laws' functions
    q: Array  # (samples + 1, n) at the controller's rate
    v: Array  # (samples + 1, n)
    middle: Array  # (samples, 3, n) coordinates, rates, accelerations in the middle of a sample
    other: Array  # (samples, n) forces of the effects without a compiled law


class Steps(NamedTuple):
    """The linear system of a chunk, a step a sample, the same for all lanes.

    With y = (dq', dq, drive torque) the rate in the middle of a step is ``move @ y + shift - push @ port torques``.
    """

    q: Array  # (samples, n) nominal coordinates at the step's start
    v: Array  # (samples, n)
    move: Array  # (samples, n, 2 n + joints)
    shift: Array  # (samples, n) rad/s
    push: Array  # (samples, n, ports) rad/s per N m, of the exact laws
    port_x: Array  # (samples, ports) combination of the nominal coordinates in the middle of the step
    port_rate: Array  # (samples, ports)
    gain: Array  # (samples, ports, ports) ports.T @ push


class Ports(NamedTuple):
    """Combinations of the coordinates that exact laws depend on."""

    vector: Array  # (n, ports)
    start: Integers  # (ports + 1,) first law of each port in `law`
    law: Integers
    tabulated: Integers  # (ports,) whether the torque depends on the rate alone and is read from the table
    table: Array  # (ports, 2 * CELLS, 4) cubics of the torque by |rate| less the cell's start; negative rates second


class Perturbed(NamedTuple):
    """State of all lanes about the nominal motion."""

    y: Array  # (2 n + joints, lanes) dq', dq, drive torque
    middle: Array  # (n, lanes) dq' in the middle of a step
    torques: Array  # (ports, lanes) N m, of the step before
    angle: Array  # (joints, lanes) rad, of the drives at the sample before


@compiled
def _invert(matrix, out):  # type: ignore[no-untyped-def]
    """Inverse by Gauss and Jordan without pivots: the mass matrix dominates."""
    n = len(matrix)
    for i in range(n):
        for j in range(n):
            out[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        scale = 1.0 / matrix[k, k]
        for j in range(k, n):
            matrix[k, j] *= scale
        for j in range(k + 1):
            out[k, j] *= scale
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                if factor != 0.0:
                    for j in range(k, n):
                        matrix[i, j] -= factor * matrix[k, j]
                    for j in range(k + 1):
                        out[i, j] -= factor * out[k, j]


@compiled
def _add_linear_laws(laws, x, v, before, after, damping, stiffness, force):  # type: ignore[no-untyped-def]
    """Add the laws' functions along the nominal motion: torque, slope by the angle, chord over the step by the rate."""
    for m in range(len(laws.inertia)):
        if laws.address[m] == 0:
            continue
        angle, rate = combine(laws, m, x), combine(laws, m, v)
        torque, by_x, by_rate = _ask(laws, m, angle, rate)
        low, high = combine(laws, m, before), combine(laws, m, after)
        if abs(high - low) > 1e-9:
            by_rate = (_ask(laws, m, angle, high)[0] - _ask(laws, m, angle, low)[0]) / (high - low)
        scatter(laws, m, torque, force)
        for w in range(laws.place.shape[1]):
            for u in range(laws.place.shape[1]):
                weight = laws.weight[m, w] * laws.weight[m, u]
                damping[laws.place[m, w], laws.place[m, u]] += weight * by_rate
                stiffness[laws.place[m, w], laws.place[m, u]] += weight * by_x


@compiled
def _make_step(tree, laws, ports, scratch, drive, h, up, along, at, work, steps, exact):  # type: ignore[no-untyped-def]
    """Matrices of the step at a chunk's sample `at`."""
    row = at // up
    part = (at - row * up + 0.5) / up
    middle, low, high = along.middle[at], along.nodes[row], along.nodes[row + 1]
    n = middle.shape[1]
    mass, damping, stiffness, system, inverse = work[0], work[1], work[2], work[3], work[4]
    for i in range(n):
        for j in range(n):
            mass[i, j] = low[0, i, j] + part * (high[0, i, j] - low[0, i, j])
            damping[i, j] = low[1, i, j] + part * (high[1, i, j] - low[1, i, j])
            stiffness[i, j] = low[2, i, j] + part * (high[2, i, j] - low[2, i, j])
    force = scratch.generalised
    inverse_dynamics(tree, scratch, middle[0], middle[1], middle[2], force)
    for m in range(len(laws.inertia)):
        torque = laws.stiffness[m] * combine(laws, m, middle[0]) + laws.damping[m] * combine(laws, m, middle[1])
        scatter(laws, m, torque + laws.inertia[m] * combine(laws, m, middle[2]), force)
    if not exact:
        _add_linear_laws(laws, middle[0], middle[1], along.v[at], along.v[at + 1], damping, stiffness, force)
    for i in range(n):
        force[i] += along.other[at, i]
        for j in range(n):
            system[i, j] = mass[i, j] + 0.5 * h * damping[i, j] + 0.25 * h * h * stiffness[i, j]
    _invert(system, inverse)
    move, push, gain = steps.move[at], steps.push[at], steps.gain[at]
    port_x, port_rate = steps.port_x[at], steps.port_rate[at]
    for i in range(n):
        for j in range(2 * n):
            move[i, j] = 0.0
        shift = 0.0
        for m in range(n):
            x = inverse[i, m]
            y = -0.5 * h * x
            shift += y * force[m]
            for j in range(n):
                move[i, j] += x * mass[m, j]
            for j in range(n):
                move[i, n + j] += y * stiffness[m, j]
        steps.shift[at, i] = shift
        for j in range(len(drive)):
            move[i, 2 * n + j] = 0.5 * h * inverse[i, drive[j]]
        for p in range(push.shape[1]):
            total = 0.0
            for m in range(n):
                total += inverse[i, m] * ports.vector[m, p]
            push[i, p] = 0.5 * h * total
    for p in range(push.shape[1]):
        port_x[p], port_rate[p] = 0.0, 0.0
        for i in range(n):
            port_x[p] += ports.vector[i, p] * middle[0, i]
            port_rate[p] += ports.vector[i, p] * middle[1, i]
        for u in range(push.shape[1]):
            total = 0.0
            for i in range(n):
                total += ports.vector[i, u] * push[i, p]
            gain[u, p] = total


@called
def make_steps(tree, laws, ports, memory, drive, h, up, along, steps, exact):  # type: ignore[no-untyped-def]
    """Fill `steps` for all samples of a chunk, `up` of them between two nodes."""
    n = along.q.shape[1]
    scratch, work = scratch_in(memory, n, len(laws.inertia)), np.zeros((5, n, n))
    for at in range(len(along.middle)):
        for i in range(n):
            steps.q[at, i], steps.v[at, i] = along.q[at, i], along.v[at, i]
        _make_step(tree, laws, ports, scratch, drive, h, up, along, at, work, steps, exact)


@compiled
def _product(matrix, y, shift, out):  # type: ignore[no-untyped-def]
    """out = matrix @ y + shift, lanes in the columns."""
    rows, inner = matrix.shape
    lanes = y.shape[1]
    for i in range(rows):
        for c in range(lanes):
            out[i, c] = shift[i]
        j = 0
        while j + 6 <= inner:  # several at a time, since looks at `out` cost as much as the arithmetic
            a0, a1, a2, a3, a4, a5 = (
                matrix[i, j],
                matrix[i, j + 1],
                matrix[i, j + 2],
                matrix[i, j + 3],
                matrix[i, j + 4],
                matrix[i, j + 5],
            )
            for c in range(lanes):
                half = a0 * y[j, c] + a1 * y[j + 1, c] + a2 * y[j + 2, c]
                out[i, c] += half + (a3 * y[j + 3, c] + a4 * y[j + 4, c] + a5 * y[j + 5, c])
            j += 6
        while j < inner:
            a0 = matrix[i, j]
            for c in range(lanes):
                out[i, c] += a0 * y[j, c]
            j += 1


@called
def fill_tables(laws, start, law, probes, tabulated, table):  # type: ignore[no-untyped-def]
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
                    torque, by_x, by_rate = _ask(laws, law[place], 0.0, rate)
                    ends[end, 0] += torque
                    ends[end, 1] += by_rate * sign * width
                    depends = depends or by_x != 0.0
                    for x in probes:
                        depends = depends or _ask(laws, law[place], x, rate)[0] != torque
            more = ends[1, 0] - ends[0, 0]
            table[p, cell, 0], table[p, cell, 1] = ends[0, 0], ends[0, 1] / width
            table[p, cell, 2] = (3.0 * more - 2.0 * ends[0, 1] - ends[1, 1]) / width**2
            table[p, cell, 3] = (ends[0, 1] + ends[1, 1] - 2.0 * more) / width**3
        tabulated[p] = not depends


@compiled
def _from_table(table, rate):  # type: ignore[no-untyped-def]
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


@compiled
def _port_torque(laws, ports, p, x, rate, half):  # type: ignore[no-untyped-def]
    """Torque of the laws at port p, and its slope by the rate in the middle of a step, with which the angle moves by half a step."""
    torque, slope = 0.0, 0.0
    for place in range(ports.start[p], ports.start[p + 1]):
        own, by_x, by_rate = _ask(laws, ports.law[place], x + half * rate, rate)
        torque += own
        slope += by_rate + half * by_x
    return torque, slope


@compiled
def _newton(rate, torque, slope, target, gain, bracket):  # type: ignore[no-untyped-def]
    """Next guess of the rate with ``rate + gain * torque(rate) = target``, and whether it is near enough to be the last.

    Newton's method; where friction's steep reversal throws it out of the interval known to hold the root (`bracket`, (low, high)),
    halving.
    """
    low, high = bracket
    miss = rate + gain * torque - target
    if miss > 0.0:
        high = rate
    else:
        low = rate
    new = rate - miss / max(1.0 + gain * slope, 0.1)
    near = abs(new - rate) <= 0.01 * abs(rate) + 1e-6
    if new <= low or new >= high:
        near = not (np.isfinite(low) and np.isfinite(high))
        new = rate if near else 0.5 * (low + high)
    return new, near, (low, high)


@compiled
def _solve_by_table(table, guess, target, gain):  # type: ignore[no-untyped-def]
    """The torque at the rate with ``rate + gain * torque(rate) = target``; not a number where a rate is beyond the table."""
    rate, bracket = guess, (-np.inf, np.inf)
    torque = np.nan
    for _ in range(NEWTON):
        if not abs(rate) < LARGEST:
            return np.nan
        torque, slope = _from_table(table, rate)
        new, near, bracket = _newton(rate, torque, slope, target, gain, bracket)
        if near:
            return torque + slope * (new - rate)
        rate = new
    return torque


@compiled
def _solve_by_laws(laws, ports, p, x, guess, target, gain, half):  # type: ignore[no-untyped-def]
    """The same with ``torque(x + half * rate, rate)`` from the laws themselves."""
    rate, bracket = guess, (-np.inf, np.inf)
    torque = 0.0
    for _ in range(NEWTON):
        torque, slope = _port_torque(laws, ports, p, x, rate, half)
        new, near, bracket = _newton(rate, torque, slope, target, gain, bracket)
        if near:
            return torque + slope * (new - rate)
        rate = new
    return torque


@compiled
def _rub(laws, ports, steps, at, h, y, middle, torques, memory, running):  # type: ignore[no-untyped-def]
    """Correct the rates in the middle of a step for the exact laws of each lane.

    `torques` (ports, lanes) of the step before are a first guess that couples the ports; then each port in turn.
    `memory` is three arrays of a number a lane.
    """
    n, count = middle.shape
    number = torques.shape[0]
    target, angle, change = memory
    vector, push, gains = ports.vector, steps.push[at], steps.gain[at]
    port_x, port_rate = steps.port_x[at], steps.port_rate[at]
    for p in range(number):
        for i in range(n):
            each = push[i, p]
            for c in range(count):
                middle[i, c] -= each * torques[p, c]
    for p in range(number):
        tabulated, table, gain, nominal = ports.tabulated[p], ports.table[p], gains[p, p], port_rate[p]
        # the angle at the step's start; half a step of the rate is added to it
        x = port_x[p] - 0.5 * h * nominal
        for c in range(count):
            target[c], angle[c] = nominal, x
        for i in range(n):
            weight = vector[i, p]
            if weight != 0.0:
                for c in range(count):
                    target[c] += weight * middle[i, c]
                if not tabulated:
                    for c in range(count):
                        angle[c] += weight * y[n + i, c]
        if tabulated:
            for c in range(count):
                torque = _solve_by_table(table, target[c], target[c] + gain * torques[p, c], gain)
                change[c] = torque - torques[p, c]
        for c in range(count):
            if running[c] != RUNNING:
                change[c] = 0.0
            elif not tabulated or not np.isfinite(change[c]):
                right = target[c] + gain * torques[p, c]
                change[c] = _solve_by_laws(laws, ports, p, angle[c], target[c], right, gain, 0.5 * h) - torques[p, c]
        for c in range(count):
            torques[p, c] += change[c]
        for i in range(n):
            each = push[i, p]
            for c in range(count):
                middle[i, c] -= each * change[c]


@compiled
def _control_lanes(loop, lanes, inputs, logs, j, k, angle, speed, torque, wrong):  # type: ignore[no-untyped-def]
    """`control` of joint j for all lanes, whose drive angles and speeds are (lanes,); its torques go to `torque`.

    `wrong` (lanes,) is set where something must be looked at.
    """
    joint = _joint_in_loop(loop, j)
    lower, upper, fastest, longest = loop.lower[j], loop.upper[j], loop.speed[j], loop.overload_samples
    row, part = k // inputs.up, (k % inputs.up) / inputs.up
    start, end = inputs.feedforward[row, j], inputs.feedforward[row + 1, j]
    reference, rate = inputs.position[k, j, 0], inputs.velocity[k, j, 0]
    noise = inputs.noise[k if inputs.noise.shape[0] > 1 else 0]
    seen_angle, seen_speed, seen_torque = logs.measured[k, 0, j], logs.measured[k, 1, j], logs.measured[k, 2, j]
    integral, current, held, counts = lanes.integral[j], lanes.current[j], lanes.held[j], lanes.overloaded[j]
    for c in range(len(angle)):
        a, v = angle[c] + noise[0, j, c], speed[c] + noise[1, j, c]
        forward = start[c] + part * (end[c] - start[c])
        a, v, whole, now, mean, limited = _command(joint, a, v, reference, rate, forward, integral[c], current[c])
        seen_angle[c], seen_speed[c], seen_torque[c] = a, v, 0.5 * (held[c] + mean)
        integral[c], current[c], held[c], torque[c] = whole, now, mean, mean
        counts[c] = counts[c] + 1 if limited else 0
        # not a number is not inside either
        inside = (abs(speed[c]) <= fastest) & (angle[c] >= lower) & (angle[c] <= upper) & (counts[c] < longest)
        wrong[c] += 0 if inside else 1


@compiled
def _stop(loop, lanes, steps, y, at, sample, wrong):  # type: ignore[no-untyped-def]
    """Look at the lanes where something is wrong, or whose reference jumps here."""
    n = steps.q.shape[1]
    for c in range(len(wrong)):
        if lanes.status[c] == RUNNING and (wrong[c] != 0 or sample >= lanes.stop[c, 0]):
            for i in range(n):
                lanes.v[c, i], lanes.q[c, i] = steps.v[at, i] + y[i, c], steps.q[at, i] + y[n + i, c]
            _check(loop, lanes, c, sample)
        wrong[c] = 0


@compiled
def _log_states(lanes, logs, steps, y, at):  # type: ignore[no-untyped-def]
    q, v, work, log_q, log_v, log_work, status = lanes.q, lanes.v, lanes.work, logs.q, logs.v, logs.work, lanes.status
    n, row = steps.q.shape[1], logs.row + at // logs.stride
    for c in range(len(work)):
        if status[c] == RUNNING:
            for i in range(n):
                q[c, i], v[c, i] = steps.q[at, i] + y[n + i, c], steps.v[at, i] + y[i, c]
                log_q[c, row, i], log_v[c, row, i] = q[c, i], v[c, i]
            log_work[c, row] = work[c]


@called
def advance(laws, ports, loop, lanes, inputs, logs, steps, state, samples):  # type: ignore[no-untyped-def]
    """Controller and robot for that many samples, all lanes."""
    y, middle, torques, last = state.y, state.middle, state.torques, state.angle
    n, number = middle.shape
    h, joints = loop.period, len(loop.drive)
    target, angle, speed = np.zeros(number), np.zeros(number), np.zeros(number)
    wrong = np.zeros(number, dtype=np.int64)
    work, status, first_stop = lanes.work, lanes.status, lanes.stop[:, 0].min()
    for at in range(samples):
        for j in range(joints):
            i = loop.drive[j]
            nominal_angle, nominal_speed, pull = steps.q[at, i], steps.v[at, i], y[2 * n + j]
            for c in range(number):
                angle[c], speed[c] = nominal_angle + y[n + i, c], nominal_speed + y[i, c]
                work[c] += pull[c] * (angle[c] - last[j, c]) if status[c] == RUNNING else 0.0
                last[j, c] = angle[c]
            _control_lanes(loop, lanes, inputs, logs, j, at, angle, speed, pull, wrong)
        if at % logs.stride == 0:
            _log_states(lanes, logs, steps, y, at)
        if wrong.any() or inputs.first + at >= first_stop:
            _stop(loop, lanes, steps, y, at, inputs.first + at, wrong)
            if status.all():
                return
        _product(steps.move[at], y, steps.shift[at], middle)
        _rub(laws, ports, steps, at, h, y, middle, torques, (target, angle, speed), status)
        for i in range(n):
            for c in range(number):
                y[i, c] = 2.0 * middle[i, c] - y[i, c]
                y[n + i, c] += h * middle[i, c]


# ---- a robot --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot in arrays: its tree, the effects that have compiled laws, and those that have none.

    Attributes
    ----------
    tree, laws, drives : arrays
    others : tuple of Effect
        Asked for `force` and `derivatives` at each step.
    in_tree : tuple of Effect
        Part of `tree`: masses that they fix to it, gravity that they turn.
    """

    tree: Tree
    laws: Laws
    others: tuple[Effect, ...]
    drives: Integers  # (joints,) where the drive angles stand among the coordinates
    in_tree: tuple[Effect, ...] = ()

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
    others: list[Effect] = []
    in_tree: list[Effect] = []
    loaded = model.copy()
    # masses first: where there are some, gravity stays as it is, since tilts turn that of the links alone
    for effect in sorted(effects, key=lambda effect: effect.gravity_change() is not None):
        own, mass, tilt = effect.laws(motion), effect.point_mass(), effect.gravity_change()
        if own is not None:
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
    return Plant(tree_of(loaded), laws_of(laws, model.nv), tuple(others), drives, tuple(in_tree))
