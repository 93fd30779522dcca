"""Cheap fits of the rigid model with basic friction: what hypotheses about the data are compared by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from rx90b_flex.diagnose.faults.sample import FOLDS, Reading, Sample, other_effects
from rx90b_flex.effects import Effect, Motion
from rx90b_flex.effects.motion import Array, Indices
from rx90b_flex.identify.carried import LINK, carried_parameters, link_of_tip

RIDGE = 1e-6  # of a column's square: holds what the data do not tell near the URDF's values
NEAR = 1.0  # the same where they may be a little off
KNOWN = 1e2  # the same where the links are known
OUT = 1e9  # the same of what is left out
ROUNDS = 3  # fits with weights from the last one's errors
FLOOR = 1e-4  # squared relative error below which a difference is no matter of the data's columns
CHANGES = 1e-12  # of a torque's square, which rounding leaves of the variance of a constant
POSES = 24  # at which the mass matrix's diagonal is looked at
IMPOSSIBLE = 3.0  # added to the score of a joint whose friction drives it, or whose inertia is negative
DRIVES = 0.03, 0.06  # of the torque's size: from where a negative inertia or driving friction counts, and where in full
ILL = 0.3**2  # squared relative error from which a fit tells nothing of a joint's inertia
# of a joint's relative error: driving friction that counts, and counts in full, however large that is
BEYOND_ERROR = 0.5, 1.0
# correlation of a joint's torque with its velocity, negative, from which it drives it, and drives it surely
AGAINST = 0.1, 0.3
PER_JOINT = 5  # drive inertia, viscous, dry, offset, viscous by direction
FRICTION = (1, 2, 4)  # of these


@dataclass(frozen=True, eq=False)
class Products:
    """Normal equations of one reading's motion with every torque column, a fold and a joint each.

    Attributes
    ----------
    gram : array, shape (folds, joints, p, p)
    cross : array, shape (folds, joints, columns, p)
        Of joint j's rows with torque column k.
    power, mean_sum, work : array, shape (folds, joints, columns)
        Sums of squares and of values of each torque column over joint j's rows, and of its product with that joint's velocity.
    travel : array, shape (folds, joints)
        Sums of velocity.
    rows : array, shape (folds, joints)
    friction : array, shape (folds, joints, p)
        Mean of velocity times the friction columns.
    inertia : array, shape (joints, p)
        What gives the mass matrix's mean diagonal.
    speed, push : array, shape (joints,)
        Root mean squares of velocity and acceleration.
    prior, ridge : array, shape (p,)
    """

    gram: Array
    cross: Array
    power: Array
    mean_sum: Array
    work: Array
    travel: Array
    rows: Array
    friction: Array
    inertia: Array
    speed: Array
    push: Array
    prior: Array
    ridge: Array

    @staticmethod
    def of(sample: Sample, reading: Reading, columns: Array) -> Products:
        """From columns (R, joints, p) and the torques that the reading has."""
        torque, inside = sample.torque_of(reading)
        _, v, a, _ = sample.seen(reading)
        links, (_, n, p) = reading.links, columns.shape
        rows, there = _by_fold(np.where(inside, sample.fold, -1))
        y, counts = torque[rows], sample.left_seen(reading)[rows] * there[..., None]
        along, across = counts * v[rows], y.swapaxes(1, 2)
        in_all = np.maximum(there.sum(axis=1), 1)
        # in memory as sums over the joints need it
        gram = np.zeros((n, FOLDS, p, p)).swapaxes(0, 1)
        cross, friction = np.zeros((FOLDS, n, n, p)), np.zeros((FOLDS, n, p))
        for j in range(n):
            own = np.flatnonzero(columns[:, j].any(axis=0))
            rubs = [links + PER_JOINT * j + i for i in FRICTION]
            x = columns[:, j, own][rows] * there[..., None]
            gram[:, j][:, own[:, None], own] = x.swapaxes(1, 2) @ x
            cross[:, j][:, :, own] = across @ x
            friction[:, j, rubs] = (along[:, None, :, j] @ columns[:, j, rubs][rows])[:, 0] / in_all[:, None]
        c, m = counts.swapaxes(1, 2), along.swapaxes(1, 2)
        power, mean_sum, work, travel = c @ y**2, c @ y, m @ y, along.sum(axis=1)
        prior = np.zeros(p)
        prior[:links] = reading.robot.link_parameters
        ridge = np.full(len(prior), RIDGE)
        if reading.robot.inertial_parameters == "known":
            ridge[:links] = KNOWN
        if sample.loaded:
            load = links + PER_JOINT * n + sum(len(e.coefficients) for e in other_effects(reading.robot))
            prior[load], ridge[load] = 1.0, KNOWN
        return Products(
            gram, cross, power, mean_sum, work, travel, counts.sum(axis=1), friction, _inertia(sample, reading, p, links),
            np.sqrt((v**2).mean(axis=0)), np.sqrt((a**2).mean(axis=0)), prior, ridge,
        )  # fmt: skip

    def held(self, columns: Sequence[int], ridge: float) -> Products:
        """With another ridge on some columns."""
        changed = self.ridge.copy()
        changed[list(columns)] = ridge
        return replace(self, ridge=changed)

    def read(self, reading: Reading) -> tuple[Array, Array, Array]:
        """Of the torques that a reading gives each joint: products with its columns (folds, joints, p), squares (folds, joints),
        and squares about the mean of all rows (joints,).
        """
        order, scale = list(reading.torque_order), np.array(reading.torque_scale)
        cross = self.cross[:, np.arange(len(order)), order] * scale[:, None]
        joints = np.arange(len(order))
        power = self.power[:, joints, order] * scale**2
        sums = self.mean_sum[:, joints, order].sum(axis=0) * scale
        total = power.sum(axis=0) - sums**2 / np.maximum(self.rows.sum(axis=0), 1.0)
        return cross, power, np.maximum(total, 1e-300)

    def against(self, reading: Reading) -> Array:
        """How surely each joint's torque drives it, 0 to 1, by the correlation of torque and velocity, shape (joints,)."""
        order, scale = list(reading.torque_order), np.array(reading.torque_scale)
        joints, rows = np.arange(len(order)), np.maximum(self.rows.sum(axis=0), 1.0)
        _, _, total = self.read(reading)
        mean = self.mean_sum[:, joints, order].sum(axis=0) * scale / rows
        work = self.work[:, joints, order].sum(axis=0) * scale - mean * self.travel.sum(axis=0)
        along = work / (np.sqrt(total * rows) * self.speed + 1e-300)
        return np.asarray(np.interp(-along, AGAINST, (0.0, 1.0)))


def _by_fold(fold: Indices) -> tuple[Indices, Array]:
    """Numbers of the rows of each fold, (folds, L), and one where there is such a row: folds differ in length."""
    order = np.argsort(fold, kind="stable")
    ends = np.searchsorted(fold[order], np.arange(FOLDS + 1))
    count = np.diff(ends)
    places = np.arange(count.max(initial=1))
    return order[np.minimum(ends[:-1, None] + places, len(order) - 1)], (places < count[:, None]).astype(float)


def columns_of(sample: Sample, reading: Reading) -> Array:
    """Columns (R, joints, p), zero where a row does not count: links, then five a joint, then what else is declared, then the torque
    of stated loads, then a link of the tip of some recordings' own.
    """
    robot, joints = reading.robot, sample.joints
    seen = sample.motion(reading)
    rows = np.array([robot.layout.index(j) for j in joints])
    links = _under(reading, seen)[:, rows]
    _, v, a, dry = sample.seen(reading)
    own = np.zeros((len(v), len(joints), PER_JOINT * len(joints)))
    for j in range(len(joints)):
        at = PER_JOINT * j
        own[:, j, at : at + PER_JOINT] = np.stack(
            [a[:, j], v[:, j], dry[:, j], np.ones(len(v)), np.abs(v[:, j])], axis=1
        )
    more = [_started(e, seen).columns(seen)[:, rows] for e in other_effects(robot)]
    if sample.loaded:
        stated = [
            np.zeros(links.shape[2]) if t.load is None else carried_parameters(robot, t.load) for t in sample.tracks
        ]
        more.append(np.einsum("rjp,rp->rj", links, sample.by_rows(stated))[:, :, None])
    if any(log.other_load for log in reading.logs):
        at = LINK * (len(robot.bodies) - 1 if (link := link_of_tip(robot)) is None else link)
        more.append(links[:, :, at : at + LINK] * sample.in_logs(reading, "other_load")[:, None, None])
    if reading.carried:
        links, *more = (np.einsum("kj,rjp->rkp", reading.torques_to_motors, x) for x in (links, *more))
    return np.concatenate([links, own, *more], axis=2) * sample.left_seen(reading)[:, :, None]


def effects_of(sample: Sample, reading: Reading) -> Array:
    """Columns of what may be missing in a joint's own drive, (R, joints, k): what a fault has to do better than.

    Springs and gravity compensators (q, sin q, cos q), friction quadratic in velocity, friction that winds up before it slides and
    so comes late, and the neighbours' motion, with which a coupled motor or a cable goes.
    """
    q, v, a, dry = sample.seen(reading)
    wound = sample.wound_seen(reading)
    n = q.shape[1]
    blocks = []
    for j in range(n):
        own = [q[:, j], np.sin(q[:, j]), np.cos(q[:, j]), v[:, j] * np.abs(v[:, j]), *wound[:, j].T]
        for k in (j - 1, j + 1):
            if 0 <= k < n:
                own += [q[:, k], v[:, k], a[:, k], dry[:, k]]
        block = np.zeros((len(q), n, len(own)))
        block[:, j] = np.stack(own, axis=1)
        blocks.append(block)
    return np.concatenate(blocks, axis=2) * sample.left_seen(reading)[:, :, None]


def _under(reading: Reading, seen: Motion) -> Array:
    """The links' regressor under the reading's gravity."""
    model = reading.robot.model
    before = np.array(model.gravity.linear)
    try:
        model.gravity.linear = np.linalg.norm(before) * np.array(reading.gravity)
        return reading.robot.link_regressor(seen)
    finally:
        model.gravity.linear = before


def _started(effect: Effect, seen: Motion) -> Effect:
    if not np.isnan(effect.shape).any():
        return effect
    starts = effect.shape_search(seen).starts
    return effect.with_shape(np.where(np.isnan(effect.shape), starts[len(starts) // 2], effect.shape))


def _inertia(sample: Sample, reading: Reading, count: int, links: int) -> Array:
    """Rows whose product with the parameters is the mean diagonal of the mass matrix, (joints, p)."""
    robot = reading.robot
    n = len(sample.joints)
    q = sample.motion(reading).q[:: max(1, len(sample.q) // POSES)]
    rows = np.array([robot.layout.index(joint) for joint in sample.joints])
    rest = np.zeros((n + 1, *q.shape))
    push = rest.copy()  # none, then of each joint in turn
    to_joints, to_motors = reading.to_joints, reading.torques_to_motors
    for k in range(n):
        push[k + 1][:, rows] = to_joints[:, k]
    poses = [x.reshape(-1, q.shape[1]) for x in (np.broadcast_to(q, rest.shape), rest, push)]
    gravity, *pushed = robot.link_regressor(robot.motion(*poses)).reshape(n + 1, *q.shape, links)
    out = np.zeros((n, count))
    for k, columns in enumerate(pushed):
        out[k, :links] = to_motors[k] @ (columns - gravity)[:, rows].mean(axis=0)
        out[k, links + PER_JOINT * k] = 1.0
    return out


@dataclass(frozen=True, eq=False)
class RigidFit:
    """A fit of one reading, judged on rows that it did not see.

    Attributes
    ----------
    error : array, shape (joints,)
        Squared held-out error over the torque's variance, a joint; 1 is what a constant leaves.
    theta : array, shape (folds, p)
        Of each fold's training rows.
    impossible : array, shape (joints,)
        How surely friction would drive a joint, or its inertia be negative, 0 to 1; zero where its torque is fitted badly, for
        then what is missing in the model decides such signs: but of friction that drives it with more than what is missing.
    driven : array, shape (joints,)
        How surely friction would drive a joint, whatever is missing, for all of its torque does.
    by_fold : array, shape (folds, joints)
        The error of each fold's rows.
    """

    error: Array
    theta: Array
    impossible: Array
    driven: Array
    by_fold: Array

    @cached_property
    def score(self) -> float:
        """Sum over joints of the log error (a constant does no worse than 1), and of what is impossible; lower is better."""
        return float(_log(self.error).sum() + IMPOSSIBLE * self.impossible.sum())

    @property
    def scores(self) -> Array:
        """The score of each fold's rows, of their errors alone, shape (folds,)."""
        return np.asarray(_log(self.by_fold).sum(axis=1))

    @staticmethod
    def of(products: Products, reading: Reading, held_out: bool = True, near: RigidFit | None = None) -> RigidFit:
        """Weighted least squares, one weight a joint, each fold predicted from the others, or from all of them.

        A first look takes the weights from the errors of a fit that is `near`.
        """
        cross, power, total = products.read(reading)
        error = np.ones(len(total)) if near is None else near.error
        # a torque of one value asks nothing of links that others tell
        changes = total > CHANGES * power.sum(axis=0) + 1e-250
        for _ in range(ROUNDS if near is None else 1):
            theta = _solved(products, cross, changes / (total * (error + FLOOR)), held_out)
            aside = theta[:, None, :]
            seen = (products.gram @ aside[..., None])[..., 0]
            left = power + ((seen - 2 * cross) * aside).sum(axis=2)
            error = np.divide(np.maximum(left.sum(axis=0), 0.0), total, out=np.ones(len(total)), where=changes)
        rows = np.maximum(products.rows.sum(axis=0), 1.0)
        rms = np.sqrt(total / rows)
        told = np.clip(1.0 - error / ILL, 0.0, 1.0)
        drives, falls = _impossible(products, theta, rms)
        driven = (
            np.interp(drives / np.sqrt(error + FLOOR), BEYOND_ERROR, (0.0, 1.0))
            * _counted(drives)
            * products.against(reading)
        )
        size = total * np.maximum(products.rows / rows, 1e-9)
        by_fold = np.divide(
            np.maximum(left, 0.0), size, out=np.ones(left.shape), where=np.broadcast_to(changes, left.shape)
        )
        return RigidFit(error, theta, np.maximum(told * _counted(np.maximum(drives, falls)), driven), driven, by_fold)


def _log(error: Array) -> Array:
    return np.asarray(np.log(np.minimum(error, 1.0) + FLOOR))


def _solved(products: Products, cross: Array, weight: Array, held_out: bool) -> Array:
    """Parameters from all folds but one, for each, or from all of them; shape (folds, p)."""
    gram = np.tensordot(weight, products.gram, axes=(0, 1))
    right = np.tensordot(weight, cross, axes=(0, 1))
    whole = gram.sum(axis=0), right.sum(axis=0)
    if not held_out:
        return np.tile(solution(*whole, products), (len(gram), 1))
    others = zip(whole[0] - gram, whole[1] - right, strict=True)
    return np.array([solution(*of_others, products) for of_others in others])


def solution(gram: Array, right: Array, products: Products) -> Array:
    """Parameters (p,) of normal equations, held by the products' ridge where these tell nothing."""
    size = np.diag(gram)
    size = np.sqrt(np.where(size > 1e-12 * size.max(), size, size.max() + 1e-300))
    scaled = gram / np.outer(size, size)
    scaled.flat[:: len(size) + 1] += products.ridge
    _, solved, _ = linalg.lapack.dposv(scaled, right / size + products.ridge * size * products.prior)
    return np.asarray(solved / size)


def _impossible(products: Products, theta: Array, rms: Array) -> tuple[Array, Array]:
    """How much friction drives each joint, and how negative its inertia is, over its torque's size; zero where any fold has it
    otherwise.
    """
    driving = (products.friction * theta[:, None, :]).sum(axis=2) / (rms * products.speed + 1e-300)
    inertia = theta @ products.inertia.T * products.push / (rms + 1e-300)
    drives, falls = (np.where((x < 0).all(axis=0), -x.mean(axis=0), 0.0) for x in (driving, inertia))
    return drives, falls


def _counted(below: Array) -> Array:
    # no step: whether a joint lies just below it or just above would decide between hypotheses that do not touch it
    return np.asarray(np.interp(below, DRIVES, (0.0, 1.0)))
