"""Dynamics of a tree of one-coordinate joints.

Newton-Euler in world axes about the joints' own origins. The virtual hinges of a flexible joint share their origin and
carry no mass, so that most of a flexible tree costs one plane rotation a hinge.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba.extending import overload

from rx90b_flex.compiled.compile import Array, Integers, inlined
from rx90b_flex.compiled.scratch import Scratch
from rx90b_flex.compiled.vectors import WIDTH, Vector, lane_of, with_lane

SMALL_ANGLE = 0.03  # rad; below it four terms of the Taylor series are exact in double precision


class Tree(NamedTuple):
    """A tree of t one-coordinate joints, in the order of the last t coordinates.

    The k coordinates before them are drives whose torsion's joint turns by the link's own angle: no link feels them, and they are
    joined to that angle alone (equations 3.73-3.83).
    """

    parent: Integers  # (t,) -1 for the base
    prismatic: Integers  # (t,)
    turned: Integers  # (t,) whether `rotation` is not 1
    shifted: Integers  # (t,) whether the joint's origin is not its parent's
    heavy: Integers  # (t,) whether the body has mass
    partner: Integers  # (k,) coordinate of the angle behind each drive's torsion
    rotation: Array  # (t, 3, 3) of the joint's frame at zero, in the parent's
    offset: Array  # (t, 3) m
    axis: Array  # (t, 3) in the joint's own frame
    mass: Array  # (t,) kg
    moment: Array  # (t, 3) mass times centre of mass, kg m
    inertia: Array  # (t, 3, 3) about the joint's origin, kg m^2
    gravity: Array  # (3,) m/s^2


@inlined
def _series(x: Any) -> tuple[Any, Any]:
    """Sine and cosine of a small angle by their series."""
    s = x * x
    sine = x - x * s * (1.0 / 6.0 - s * (1.0 / 120.0 - s * (1.0 / 5040.0 - s * (1.0 / 362880.0))))
    cosine = 1.0 - s * (0.5 - s * (1.0 / 24.0 - s * (1.0 / 720.0 - s * (1.0 / 40320.0))))
    return sine, cosine


def sine_cosine(x: Any) -> Any:
    """Sine and cosine; compiled code only."""
    raise NotImplementedError


@overload(sine_cosine)
def _sine_cosine(x: Any) -> Any:
    if isinstance(x, Vector):

        def lanes(x: Any) -> Any:
            sine, cosine = _series(x)
            for lane in range(WIDTH):
                angle = lane_of(x, lane)
                if abs(angle) >= SMALL_ANGLE:
                    sine, cosine = with_lane(sine, lane, math.sin(angle)), with_lane(cosine, lane, math.cos(angle))
            return sine, cosine

        return lanes

    def number(x: Any) -> Any:
        if abs(x) >= SMALL_ANGLE:
            return math.sin(x), math.cos(x)
        return _series(x)

    return number


@inlined
def _turn(rotation: Array, i: int, axis: Array, sine: Any, cosine: Any, x: float, y: float, z: float) -> None:
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


@inlined
def place(tree: Tree, s: Scratch, q: Array) -> None:
    """Rotations, axes and arms of all joints at q, in world axes."""
    # no views of rows: counting their references would cost more than the arithmetic
    rotation, axis, arm = s.rotation, s.axis, s.arm
    fixed, offset, first = tree.rotation, tree.offset, len(tree.partner)
    for i in range(len(tree.parent)):
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
                arm[i, r] += axis[i, r] * q[first + i]
        else:
            sine, cosine = sine_cosine(q[first + i])
            _turn(rotation, i, axis, sine, cosine, x, y, z)


@inlined
def move(tree: Tree, s: Scratch, v: Array, a: Array) -> None:
    """Angular velocities, angular accelerations and accelerations of the origins, gravity as an upward acceleration."""
    first = len(tree.partner)
    for i in range(len(tree.parent)):
        parent, rate, more = tree.parent[i], v[first + i], a[first + i]
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
            twice = 2.0 * rate
            lx += wx * more + twice * (py * wz - pz * wy)
            ly += wy * more + twice * (pz * wx - px * wz)
            lz += wz * more + twice * (px * wy - py * wx)
        else:
            tx += wx * more + rate * (py * wz - pz * wy)
            ty += wy * more + rate * (pz * wx - px * wz)
            tz += wz * more + rate * (px * wy - py * wx)
            px += wx * rate
            py += wy * rate
            pz += wz * rate
        s.spin[i, 0], s.spin[i, 1], s.spin[i, 2] = px, py, pz
        s.turn[i, 0], s.turn[i, 1], s.turn[i, 2] = tx, ty, tz
        s.lift[i, 0], s.lift[i, 1], s.lift[i, 2] = lx, ly, lz


@inlined
def _weigh(tree: Tree, s: Scratch) -> None:
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


@inlined
def _body_wrench(s: Scratch, i: int) -> None:
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


@inlined
def inverse_dynamics(tree: Tree, s: Scratch, q: Array, v: Array, a: Array, out: Array) -> None:
    """Generalised forces that the links need; leaves the places and own inertias of all bodies in the scratch."""
    n, first = len(tree.parent), len(tree.partner)
    place(tree, s, q)
    move(tree, s, v, a)
    _weigh(tree, s)
    for i in range(first):
        out[i] = 0.0
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
            out[first + i] = wx * fx + wy * fy + wz * fz
        else:
            out[first + i] = wx * nx + wy * ny + wz * nz
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


@inlined
def _in_body(s: Scratch, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the world in body i's own axes."""
    r = s.rotation
    return (
        r[i, 0, 0] * x + r[i, 1, 0] * y + r[i, 2, 0] * z,
        r[i, 0, 1] * x + r[i, 1, 1] * y + r[i, 2, 1] * z,
        r[i, 0, 2] * x + r[i, 1, 2] * y + r[i, 2, 2] * z,
    )


@inlined
def body_columns(tree: Tree, s: Scratch, i: int, out: Array, first: int) -> None:
    """What body i's mass, first moment and inertia (xx, yy, zz, xy, xz, yz) ask of all joints below it, per unit of each.

    Into ten columns of `out` (n, ...) from `first` on; `place` and `move` come before. The wrench that one unit needs is worked out
    in the body's own axes, and taken along the axis of each joint, there too.
    """
    px, py, pz = _in_body(s, i, s.spin[i, 0], s.spin[i, 1], s.spin[i, 2])
    tx, ty, tz = _in_body(s, i, s.turn[i, 0], s.turn[i, 1], s.turn[i, 2])
    lx, ly, lz = _in_body(s, i, s.lift[i, 0], s.lift[i, 1], s.lift[i, 2])
    xx, yy, zz, xy, xz, yz = px * px, py * py, pz * pz, px * py, px * pz, py * pz
    dx = dy = dz = 0.0  # of the body's origin from the joint's
    joint = i
    while joint >= 0:
        wx, wy, wz = s.axis[joint, 0], s.axis[joint, 1], s.axis[joint, 2]
        if tree.prismatic[joint]:
            fx, fy, fz = _in_body(s, i, wx, wy, wz)
            nx = ny = nz = 0.0
        else:
            nx, ny, nz = _in_body(s, i, wx, wy, wz)
            fx, fy, fz = _in_body(s, i, wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx)
        row = out[joint]
        row[first] = fx * lx + fy * ly + fz * lz
        row[first + 1] = fy * (tz + xy) + fz * (xz - ty) - fx * (yy + zz) + ny * -lz + nz * ly
        row[first + 2] = fx * (xy - tz) + fz * (yz + tx) - fy * (xx + zz) + nx * lz - nz * lx
        row[first + 3] = fx * (xz + ty) + fy * (yz - tx) - fz * (xx + yy) - nx * ly + ny * lx
        row[first + 4] = nx * tx + ny * xz - nz * xy
        row[first + 5] = ny * ty - nx * yz + nz * xy
        row[first + 6] = nz * tz + nx * yz - ny * xz
        row[first + 7] = nx * (ty - xz) + ny * (tx + yz) + nz * (xx - yy)
        row[first + 8] = nx * (tz + xy) + ny * (zz - xx) + nz * (tx - yz)
        row[first + 9] = nx * (yy - zz) + ny * (tz - xy) + nz * (ty + xz)
        if tree.shifted[joint]:
            dx += s.arm[joint, 0]
            dy += s.arm[joint, 1]
            dz += s.arm[joint, 2]
        joint = tree.parent[joint]


@inlined
def _hang(mass: Array, c: Array, inertia: Array, d: Array, i: int, parent: int, shifted: int) -> None:
    """Add what hangs on joint i to what hangs on its parent, about the parent's origin; first moments c, arms d."""
    m = mass[i]
    if shifted:
        square = 0.0
        for r in range(3):
            square += d[i, r] * (m * d[i, r] + 2.0 * c[i, r])
        for r in range(3):
            inertia[parent, r, r] += square
            for k in range(3):
                crossed = m * d[i, r] * d[i, k] + d[i, r] * c[i, k] + c[i, r] * d[i, k]
                inertia[parent, r, k] += inertia[i, r, k] - crossed
        for r in range(3):
            c[parent, r] += c[i, r] + m * d[i, r]
    else:
        for r in range(3):
            c[parent, r] += c[i, r]
            for k in range(3):
                inertia[parent, r, k] += inertia[i, r, k]
    mass[parent] += m


@inlined
def mass_matrix(tree: Tree, s: Scratch, out: Array) -> None:
    """Mass matrix of the links, upper triangle, from the places and inertias that `inverse_dynamics` left behind."""
    n, first = len(tree.parent), len(tree.partner)
    for i in range(first + n):
        for k in range(i, first + n):
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
                out[first + k, first + i] = s.axis[k, 0] * fx + s.axis[k, 1] * fy + s.axis[k, 2] * fz
            else:
                out[first + k, first + i] = s.axis[k, 0] * nx + s.axis[k, 1] * ny + s.axis[k, 2] * nz
            if tree.shifted[k]:
                dx, dy, dz = s.arm[k, 0], s.arm[k, 1], s.arm[k, 2]
                nx += dy * fz - dz * fy
                ny += dz * fx - dx * fz
                nz += dx * fy - dy * fx
            k = tree.parent[k]
        if parent >= 0:
            _hang(s.mass, s.moment, s.inertia, s.arm, i, parent, tree.shifted[i])
