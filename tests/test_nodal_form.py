"""Claims that the source's own lumped-mass form gives the same dynamics: nodes and Euler parameters, no recursion.

Hardeman (2008), section 3.3.1. The text that we have lost accents and exponents; the formulas are restored here, and
were derived again. With skew(a) b = a x b, lam the Euler parameters (scalar first), a dot for each time derivative:

====================  ===========================================================================================
(3.8), (3.11)         nodal coordinates x = F(q): the place x_p and the Euler parameters lam of every link's node p
(3.16), (3.40)        R = Lambda Lambda'^T; the text has a factor 2 here, with which R would be no rotation
(3.18), (3.19)        omega = 2 Lambda lam., the velocity in global axes; omega' = 2 Lambda' lam. in the body's (3.41)
(3.45), (3.46)        M x.. + f_in - f_c = f_p of one body; s = R s' its centre of mass from the node, s' fixed in it,
                      J' its inertia about the node, in its own axes, g the acceleration of gravity:
                      M_xx = m I,  M_xlam = 2 m skew(s)^T Lambda = M_lamx^T,  M_lamlam = 4 Lambda'^T J' Lambda',
                      f_in = (4 m skew(Lambda lam.) skew(Lambda lam.) s,  8 Lambda'.^T J' Lambda' lam.),
                      f_c = (m g,  2 Lambda^T skew(s) m g)
(3.47) to (3.52)      the same, linear in p = (m, m s', l): Phi p = f_p, l the six entries of J' and hat(a) l = J' a:
                      Phi_xm = x_p.. - g,  Phi_xs = 2 (skew(Lambda lam..) + 2 skew(Lambda lam.) skew(Lambda lam.)) R,
                      Phi_lams = 2 Lambda^T skew(g - x_p..) R,
                      Phi_laml = 4 Lambda'^T hat(Lambda' lam..) + 8 Lambda'.^T hat(Lambda' lam.)
(3.62) to (3.65)      virtual power: M(q) = DF^T M DF and inverse dynamics DF^T (M x.. + f_in - f_c) = DF^T Phi p
====================  ===========================================================================================

The multiplier of lam^T lam = 1 in (3.45) drops out of the last line, for lam^T Dlam = 0. As the hinges' angles are
given, lam is a product of Euler parameters (A.8) and x.. follows from it by the product rule: nothing here is a finite
difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from test_rx90b import LINKS

from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot, load_robot

AGREE = 1e-10  # of the norm
GRAVITY = np.array([0.0, 0.0, -9.81])
X, Y, Z = np.eye(3)
# From node to node when the arm points up (PHYSICS.md), and the axes of drive and torsion, bend_1, bend_2.
HINGES = [
    (np.array([0.0, 0.0, 0.14]), (Z, Z, X, Y)),
    (np.array([0.0, 0.1, 0.28]), (Y, Y, Z, X)),
    (np.array([0.0, 0.0, 0.45]), (Y, Y, Z, X)),
    (np.array([0.0, -0.1, 0.07]), (Z, Z, X, Y)),
]


# ---- Euler parameters -------------------------------------------------------------------------------------------


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def big_lambda(lam: Array) -> Array:
    """Lambda of (3.19), shape (3, 4)."""
    return np.column_stack([-lam[1:], lam[0] * np.eye(3) + skew(lam[1:])])


def big_lambda_body(lam: Array) -> Array:
    """Lambda' of (3.41), shape (3, 4)."""
    return np.column_stack([-lam[1:], lam[0] * np.eye(3) - skew(lam[1:])])


def rotation(lam: Array) -> Array:
    """R of (3.40)."""
    return big_lambda(lam) @ big_lambda_body(lam).T


def product(p: Array, r: Array) -> Array:
    """Product of Euler parameters, (A.9)."""
    return np.r_[p[0] * r[0] - p[1:] @ r[1:], p[0] * r[1:] + r[0] * p[1:] + np.cross(p[1:], r[1:])]


def hat(a: Array) -> Array:
    """hat(a) l = J a of (3.52), with l = (xx, yy, zz, xy, xz, yz)."""
    x, y, z = a
    return np.array([[x, 0, 0, y, z, 0], [0, y, 0, x, 0, z], [0, 0, z, 0, x, y]])


# ---- nodes as functions of time: value, first and second derivative -----------------------------------------------


@dataclass(frozen=True)
class Node:
    """Place and Euler parameters of a node; row i is the i-th time derivative."""

    place: Array  # (3, 3)
    lam: Array  # (3, 4)

    @property
    def x(self) -> Array:
        """The seven nodal coordinates, and their derivatives, (3, 7)."""
        return np.hstack([self.place, self.lam])


def turned_by(lam: Array, axis: Array, q: float, v: float, a: float) -> Array:
    """Euler parameters lam, (3, 4), times a hinge's (A.4), with the product rule."""
    half, across = (np.r_[np.cos(q / 2), np.sin(q / 2) * axis], np.r_[-np.sin(q / 2), np.cos(q / 2) * axis] / 2)
    first = across * v
    second = across * a - half * v**2 / 4
    return np.array(
        [
            product(lam[0], half),
            product(lam[1], half) + product(lam[0], first),
            product(lam[2], half) + 2 * product(lam[1], first) + product(lam[0], second),
        ]
    )


def carried(lam: Array, arm: Array) -> Array:
    """R arm and its derivatives, (3, 3): R is a product of two factors linear in lam."""
    body = [big_lambda_body(x).T @ arm for x in lam]
    left = [big_lambda(x) for x in lam]
    second = left[2] @ body[0] + 2 * left[1] @ body[1] + left[0] @ body[2]
    return np.array([left[0] @ body[0], left[1] @ body[0] + left[0] @ body[1], second])


def nodes(q: Array, v: Array, a: Array) -> list[Node]:
    """F(q) of (3.8), its velocity (3.10) and its acceleration, for the coordinates of `rx90b_4dof`."""
    place = np.zeros((3, 3))
    lam = np.zeros((3, 4))
    lam[0, 0] = 1.0
    found = []
    for joint, (arm, axes) in enumerate(HINGES):
        place = place + carried(lam, arm)
        for hinge, axis in enumerate(axes, start=4 * joint):
            lam = turned_by(lam, axis, q[hinge], v[hinge], a[hinge])
        found.append(Node(place, lam))
    return found


def node_jacobians(q: Array) -> Array:
    """DF of (3.11) for each node, shape (4, 7, 16): column j is the nodal velocity for a unit velocity of q_j."""
    still = np.zeros(16)
    return np.array([[node.x[1] for node in nodes(q, unit, still)] for unit in np.eye(16)]).transpose(1, 2, 0)


# ---- one body (3.45-3.52) -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Body:
    """A lumped body: mass, m s' and J' about its node, as table D.1 prints them."""

    parameters: Array

    @property
    def mass(self) -> float:
        return float(self.parameters[0])

    @property
    def lever(self) -> Array:
        """s'."""
        return self.parameters[1:4] / self.mass

    @property
    def inertia(self) -> Array:
        """J'."""
        return np.stack([hat(unit) @ self.parameters[4:] for unit in np.eye(3)])

    def mass_matrix(self, node: Node) -> Array:
        """M of (3.46a-d), shape (7, 7)."""
        lam = node.lam[0]
        coupling = 2 * self.mass * skew(rotation(lam) @ self.lever).T @ big_lambda(lam)
        turning = 4 * big_lambda_body(lam).T @ self.inertia @ big_lambda_body(lam)
        return np.block([[self.mass * np.eye(3), coupling], [coupling.T, turning]])

    def inertia_force(self, node: Node) -> Array:
        """f_in of (3.46e), shape (7,)."""
        lam, rate, _ = node.lam
        spin = skew(big_lambda(lam) @ rate)
        force = 4 * self.mass * spin @ spin @ rotation(lam) @ self.lever
        return np.r_[force, 8 * big_lambda_body(rate).T @ self.inertia @ big_lambda_body(lam) @ rate]

    def gravity_force(self, node: Node) -> Array:
        """f_c of (3.46f), shape (7,)."""
        lam = node.lam[0]
        weight = self.mass * GRAVITY
        return np.r_[weight, 2 * big_lambda(lam).T @ skew(rotation(lam) @ self.lever) @ weight]


BODIES = [Body(np.array(link)) for link in LINKS]


def linear_form(node: Node) -> Array:
    """Phi of (3.48), (3.49), shape (7, 10)."""
    lam, rate, rate2 = node.lam
    turn, left, body = rotation(lam), big_lambda(lam), big_lambda_body(lam)
    spin = skew(left @ rate)
    out = np.zeros((7, 10))
    out[:3, 0] = node.place[2] - GRAVITY
    out[:3, 1:4] = 2 * (skew(left @ rate2) + 2 * spin @ spin) @ turn
    out[3:, 1:4] = 2 * left.T @ skew(GRAVITY - node.place[2]) @ turn
    out[3:, 4:] = 4 * body.T @ hat(body @ rate2) + 8 * big_lambda_body(rate).T @ hat(body @ rate)
    return out


# ---- the claims ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot() -> Robot:
    """The flexible four-axis arm with nothing but its links: every stiffness and damping zero."""
    flexible = [e for e in load_robot("rx90b_4dof").effects if e.traits.virtual]
    return load_robot("rx90b_4dof").with_effects([e.with_coefficients(0 * e.coefficients) for e in flexible])


STATES = np.random.default_rng(1).uniform(-1, 1, (20, 3, 16)) * np.array([2.0, 3.0, 10.0])[:, None]


@pytest.fixture(scope="module")
def transfer() -> list[Array]:
    """DF at every state."""
    return [node_jacobians(q) for q in STATES[:, 0]]


def assert_agree(found: Array, expected: Array) -> None:
    assert np.linalg.norm(found - expected) <= AGREE * np.linalg.norm(expected)


def test_the_coordinates_of_the_nodes_are_those_of_the_robot(robot: Robot):
    kinds = ("drive", "torsion", "bend_1", "bend_2")
    assert robot.coordinates == tuple(f"joint_{j}:{kind}" for j in range(1, 5) for kind in kinds)


def test_mass_matrix_is_the_nodal_one_seen_through_the_transfer_function(robot: Robot, transfer: list[Array]):
    """(3.64): DF^T M DF."""
    for (q, v, a), moves in zip(STATES, transfer, strict=True):
        mass = np.zeros((16, 16))
        for body, node, move in zip(BODIES, nodes(q, v, a), moves, strict=True):
            mass += move.T @ body.mass_matrix(node) @ move
        assert_agree(robot.mass_matrix(q), mass)


def test_inverse_dynamics_is_the_virtual_power_of_the_nodal_forces(robot: Robot, transfer: list[Array]):
    """(3.63): DF^T (M x.. + f_in - f_c), gravity included."""
    for (q, v, a), moves in zip(STATES, transfer, strict=True):
        force = np.zeros(16)
        for body, node, move in zip(BODIES, nodes(q, v, a), moves, strict=True):
            nodal = body.mass_matrix(node) @ node.x[2] + body.inertia_force(node) - body.gravity_force(node)
            force += move.T @ nodal
        assert_agree(robot.inverse_dynamics(q, v, a), force)


def test_gravity_alone_is_the_virtual_power_of_the_weights(robot: Robot, transfer: list[Array]):
    still = np.zeros(16)
    for (q, _, _), moves in zip(STATES, transfer, strict=True):
        weight = np.zeros(16)
        for body, node, move in zip(BODIES, nodes(q, still, still), moves, strict=True):
            weight += move.T @ body.gravity_force(node)
        assert_agree(robot.inverse_dynamics(q, still, still), -weight)


def test_each_links_columns_of_the_regressor_are_the_parameter_linear_form(robot: Robot, transfer: list[Array]):
    """(3.85): DF^T Phi, ten columns a link in table D.1's order."""
    for (q, v, a), moves in zip(STATES, transfer, strict=True):
        regressor = robot.regressor(q, v, a)
        for link, (node, move) in enumerate(zip(nodes(q, v, a), moves, strict=True)):
            assert_agree(regressor[:, 10 * link : 10 * link + 10], move.T @ linear_form(node))


def test_hinge_coordinates_are_the_sources_deformations_to_second_order():
    """(A.12), (A.13), written for a hinge about x; the source's own angles of bending are nonlinear in lam."""
    small = 1e-4 * np.array([0.7, -1.0, 0.4])
    lam = np.eye(4)[:3] * np.array([[1.0], [0.0], [0.0]])
    for axis, angle in zip((X, Y, Z), small, strict=True):
        lam = turned_by(lam, axis, angle, 0.0, 0.0)
    l0, l1, l2, l3 = lam[0]
    source = [2 * np.arctan(l1 / l0), 2 * (l0 * l2 - l1 * l3), 2 * (l1 * l2 + l0 * l3)]
    assert np.abs(source - small).max() <= 1e-4**2
