"""One step of the integrator.

Verwer's two-stage Rosenbrock-W method ROS2 on y = (q, v), y' = F(y):

    (1 - g h J) k_1 = h F(y),   (1 - g h J) k_2 = h F(y + k_1) - 2 k_1,   y <- y + 3/2 k_1 + 1/2 k_2

Second order for any J, L-stable for the true J. J here holds what is stiff (mass matrix, slopes of the effects) and
leaves out the slow rest (how gravity and Coriolis forces change along a step). With M a = u - f(q, v), D = df/dv and
K = df/dq, eliminating the positions leaves one system of n equations a step, A = M + g h D + (g h)^2 K.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from rx90b_flex.compiled.compile import Array, Integers, counted, inlined
from rx90b_flex.compiled.laws import Laws, add_laws_to_system, combine, law_forces, scatter
from rx90b_flex.compiled.linear import add_dense, factor, factor_general, solve, solve_general
from rx90b_flex.compiled.scratch import Scratch
from rx90b_flex.compiled.tree import Tree, inverse_dynamics, mass_matrix
from rx90b_flex.compiled.vectors import larger_size
from rx90b_flex.compiled.wide import (
    Wide,
    first_forces,
    first_system,
    links_torques,
    second_forces,
    second_system,
    solve_leaning,
    view,
)

# L-stable, and the smaller of the two error constants that (1 - 1/sqrt 2, 1 + 1/sqrt 2) give
GAMMA = 1.0 - 1.0 / math.sqrt(2.0)


class Extra(NamedTuple):
    """What effects without a compiled law add at one stage, for each lane."""

    lost: Array  # (lanes,) W, dissipated
    force: Array  # (lanes, n)
    inertia: Array  # (lanes, n, n)
    damping: Array  # (lanes, n, n)
    stiffness: Array  # (lanes, n, n)


@inlined
def _add_extra_to_system(extra: Extra, lane: int, gh: float, system: Array) -> None:
    n = len(system)
    for i in range(n):
        for j in range(i):
            system[i, j] = system[j, i]
    for i in range(n):
        for j in range(n):
            more = extra.inertia[lane, i, j] + gh * extra.damping[lane, i, j]
            system[i, j] += more + gh * gh * extra.stiffness[lane, i, j]


@inlined
def begin(s: Scratch, q: Array, v: Array) -> None:
    """Put the point of the first stage where `evaluate` looks."""
    for i in range(len(q)):
        s.q[i], s.v[i], s.a[i] = q[i], v[i], 0.0


@counted
def evaluate(tree: Tree, laws: Laws, s: Scratch, wide: Wide | None, room: Array) -> Any:
    """Forces of links and laws at the scratch's point; each law's torque and slopes to the `late` arrays.

    Returns the power that laws dissipate, W.
    """
    if wide is not None:
        links_torques(tree, s, wide, room, view(wide, room, s.a), laws.wanted[0], s.q, s.v, s.a)
    else:
        inverse_dynamics(tree, s, s.q, s.v, s.a, s.generalised)
    return law_forces(laws, s, s.q, s.v, s.a, s.late_torques, s.late_by_x, s.late_by_rate, s.generalised)


@counted
def first_stage(
    tree: Tree,
    laws: Laws,
    s: Scratch,
    wide: Wide | None,
    room: Array,
    extra: Extra | None,
    lane: int,
    q: Array,
    v: Array,
    torque: Array,
    h: float,
    lost: Any,
) -> Any:
    """k_1, and the point y + k_1 with its acceleration k_1 / h, in the scratch, after `begin` and `evaluate`.

    Returns the power dissipated at y, W, where laws dissipate `lost`. `room` is the working memory of the wide laws.
    `extra.force` is the effects' force less `extra.inertia` times the acceleration that it was taken at.
    """
    n, gh = len(q), GAMMA * h
    for m in range(len(laws.inertia)):
        s.torques[m], s.by_x[m], s.by_rate[m] = s.late_torques[m], s.late_by_x[m], s.late_by_rate[m]
    mass_matrix(tree, s, s.system)
    if wide is not None:
        w = view(wide, room, s.a)
        lost += first_forces(s, wide, room, w, laws.wanted[0], q, v)
    add_laws_to_system(laws, s, gh, gh * gh, s.system)
    for i in range(n):
        s.right[i] = h * (torque[i] - s.generalised[i])
    for m in range(len(laws.inertia)):
        scatter(laws, m, -gh * h * s.by_x[m] * combine(laws, m, v), s.right)
    if extra is not None:
        for i in range(n):
            s.right[i] -= h * extra.force[lane, i]
        lost += extra.lost[lane]
        add_dense(extra.stiffness, lane, -gh * h, v, s.right)
        _add_extra_to_system(extra, lane, gh, s.system)
        factor_general(s.system)
    elif wide is not None:
        first_system(s, tree.partner, w, gh, h, v)
    else:
        factor(s.system, tree.partner)
    for i in range(n):
        s.k_v[i] = s.right[i]
    if extra is not None:
        solve_general(s.system, s.k_v)
    elif wide is not None:
        solve_leaning(s, tree.partner, w, s.k_v, w.whole.shape[1])
    else:
        solve(s.system, tree.partner, s.k_v)
    for i in range(n):
        s.k_q[i] = h * v[i] + gh * s.k_v[i]
        s.q[i] = q[i] + s.k_q[i]
        s.v[i] = v[i] + s.k_v[i]
        s.a[i] = s.k_v[i] / h
    return lost


@inlined
def _inverse_pivot(system: Array, partner: Integers, c: int) -> Any:
    """Of coordinate c of a factored system, as elimination among the robot's own coordinates would leave it.

    The robot has a torsion's angle in place of the angle behind it, for which the larger one of drive and torsion is given.
    """
    for k in range(len(partner)):
        p = partner[k]
        if c in (k, p):
            own, behind, joined = 1.0 / system[k, k], 1.0 / system[p, p], system[k, p]
            both = own + behind + joined * joined * system[k, k] + 2.0 * joined
            drive, torsion = 1.0 / both, both * system[k, k] * system[p, p]
            return drive if c == k else larger_size(drive, torsion)
    return system[c, c]


@inlined
def _bend(laws: Laws, partner: Integers, s: Scratch, h: float) -> Any:
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
        for w in range(laws.width[m]):  # inverse pivots: of the inertia that this coordinate turns, or more
            lightest = larger_size(lightest, _inverse_pivot(s.system, partner, laws.place[m, w]))
        most = larger_size(most, missed * lightest)
    return h * h * most


@counted
def second_stage(
    tree: Tree,
    laws: Laws,
    s: Scratch,
    wide: Wide | None,
    room: Array,
    extra: Extra | None,
    late_force: Array | None,
    lane: int,
    q: Array,
    v: Array,
    torque: Array,
    h: float,
) -> Any:
    """k_2, then q and v moved on by a step, after `evaluate` at y + k_1. Returns how much the laws bend along it, rad.

    `late_force` (lanes, n) is the extra effects' force at y + k_1.

    The accelerations at y + k_1 are asked for about k_1 / h: what remains of the mass matrix's change along the step is
    then of second order.
    """
    n, gh = len(q), GAMMA * h
    bend = _bend(laws, tree.partner, s, h)
    if wide is not None:
        w = view(wide, room, s.a)
        second_forces(s, wide, room, w, laws.wanted[0], h)
    # right = h (u - f) - M k_1 - g h K r, with M k_1 from the first stage's equation and r = h v - 2 k_q
    for i in range(n):
        s.right[i] = h * (torque[i] - s.generalised[i]) - s.right[i]
        s.q[i] = h * s.v[i] - 2.0 * s.k_q[i]
    for m in range(len(laws.inertia)):
        rate, x = combine(laws, m, s.k_v), combine(laws, m, s.q)
        scatter(laws, m, gh * (s.by_rate[m] * rate + s.by_x[m] * (gh * rate - x)), s.right)
    if extra is not None and late_force is not None:
        for i in range(n):
            s.right[i] -= h * late_force[lane, i]
        add_dense(extra.damping, lane, gh, s.k_v, s.right)
        add_dense(extra.stiffness, lane, gh * gh, s.k_v, s.right)
        add_dense(extra.stiffness, lane, -gh, s.q, s.right)
        solve_general(s.system, s.right)
    elif wide is not None:
        second_system(s, tree.partner, w, gh)
    else:
        solve(s.system, tree.partner, s.right)
    for i in range(n):
        q[i] += 1.5 * s.k_q[i] + 0.5 * (s.q[i] + gh * s.right[i])
        v[i] += 1.5 * s.k_v[i] + 0.5 * s.right[i]
    return bend
