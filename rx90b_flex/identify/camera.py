"""Deformations of a joint from markers on the links beside it (section 4.2.3, equations 4.9 and A.8-A.13).

Three or more markers show how a link has turned since a reference pose. The turn of the link behind a joint against the
link before it, in the joint's own frame, is the large joint angle and two small bendings. An error of that frame leaks
the one into the others: ``bending + after - R(-angle) before`` is what is seen, with the frame's small constant errors
before and behind the joint. That pattern is known but for a few numbers, which `fit_joint` estimates
together with the stiffnesses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.flexify import bending_axes
from rx90b_flex.robot import Robot

# ---- a rigid body from its markers ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RigidBodyFit:
    """How a set of markers moved: ``measured = rotation @ reference + translation`` (equation 4.9).

    Attributes
    ----------
    rotation : array, shape (N, 3, 3)
    translation : array, shape (N, 3), m
    covariance : array, shape (N, 6, 6)
        Of a small turn about the camera's axes (rad) and of the centre of the markers (m).
    chi2 : array, shape (N,)
        Weighted squares left; with right standard deviations chi-squared with 3 m - 6 degrees of freedom.
    shared : array, shape (N, 3, k), rad, or None
        Errors of the turns that all rows have in common, those of the markers' places on the body: ``shared @ z`` with
        k independent standard normal z, on top of `covariance`. None: the places are known.
    """

    rotation: Array
    translation: Array
    covariance: Array
    chi2: Array
    shared: Array | None = None


def fit_rigid_body(reference: Array, measured: Array, std: Array | float) -> RigidBodyFit:
    """Rotation and translation of three or more markers, weighted by each coordinate's noise.

    The thesis solves for four constrained Euler parameters with equal weights. Here the singular value
    decomposition (Kabsch) starts, and Gauss-Newton steps in small turns weight x, y and the five times noisier z.

    Parameters
    ----------
    reference : array, shape (m, 3), m
        Markers in the reference pose; taken as exact. Where they were measured like the rest: `fit_rigid_shape`.
    measured : array, shape (N, m, 3), m
    std : float or array that broadcasts to (N, m, 3), m

    Raises
    ------
    ValueError
        Fewer than three markers, or markers on one line.
    """
    reference, measured = np.asarray(reference, dtype=float), np.asarray(measured, dtype=float)
    markers = len(reference)
    if reference.shape != (markers, 3) or markers < 3 or measured.shape[1:] != (markers, 3):
        raise ValueError(
            f"markers have shapes {reference.shape} and {measured.shape}; expected (m, 3) and (N, m, 3), m at least 3"
        )
    weight = 1.0 / np.broadcast_to(np.asarray(std, dtype=float), measured.shape)
    if not np.isfinite(weight).all():
        raise ValueError("std must be above 0")
    middle = reference.mean(axis=0)
    spread = reference - middle
    size = np.linalg.svd(spread, compute_uv=False)
    if size[1] < 1e-6 * size[0]:
        raise ValueError("the markers lie on one line; their turn about it cannot be seen")

    centre = measured.mean(axis=1)
    u, _, vt = np.linalg.svd(np.einsum("nmi,mj->nij", measured - centre[:, None], spread))
    u[..., -1] *= np.linalg.det(u @ vt)[:, None]  # no reflections
    rotation = u @ vt
    for _ in range(3):  # quadratic convergence from errors of a few noise standard deviations
        arms = np.einsum("nij,mj->nmi", rotation, spread)
        slope = np.concatenate([-_cross_matrix(arms), np.broadcast_to(np.eye(3), (*arms.shape, 3))], axis=-1)
        slope = (weight[..., None] * slope).reshape(len(measured), 3 * markers, 6)
        missing = (weight * (measured - arms - centre[:, None])).reshape(len(measured), 3 * markers)
        information = np.swapaxes(slope, 1, 2) @ slope
        step = np.linalg.solve(information, np.einsum("nki,nk->ni", slope, missing)[..., None])[..., 0]
        rotation = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rotation
        centre = centre + step[:, 3:]
    arms = np.einsum("nij,mj->nmi", rotation, spread)
    chi2 = ((weight * (measured - arms - centre[:, None])) ** 2).sum(axis=(1, 2))
    return RigidBodyFit(rotation, centre - rotation @ middle, np.linalg.inv(information), chi2)


def fit_rigid_shape(measured: Array, std: Array | float) -> RigidBodyFit:
    """Turns of a body together with the markers' places on it, by maximum likelihood over all rows.

    No row is exact: which is the reference pose is open, near the first row. The turns are those of `fit_rigid_body` at
    the best places; Gauss-Newton steps on the places with the turns eliminated (variable projection). A rigid motion of
    the places does not show, which leaves 3 m - 6 numbers of the shape; how their errors turn the rows is `shared`.

    Parameters
    ----------
    measured : array, shape (N, m, 3), m
    std : float or array that broadcasts to (N, m, 3), m

    Raises
    ------
    ValueError
        As `fit_rigid_body`, or no convergence.
    """
    measured = np.asarray(measured, dtype=float)
    places = measured[0]
    weight = 1.0 / np.broadcast_to(np.asarray(std, dtype=float), measured.shape) ** 2
    markers = len(places)
    for _ in range(STEPS):
        fit = fit_rigid_body(places, measured, std)
        rotation = fit.rotation
        arms = np.einsum("nij,mj->nmi", rotation, places - places.mean(axis=0))
        slope = np.concatenate([-_cross_matrix(arms), np.broadcast_to(np.eye(3), (*arms.shape, 3))], axis=-1)
        # how places (k, of the body) and poses (p) go together in the squares
        both = np.einsum("nik,nmi,nmip->nmkp", rotation, weight, slope).reshape(len(measured), 3 * markers, 6)
        across = both @ np.linalg.cholesky(fit.covariance)
        across = np.swapaxes(across, 0, 1).reshape(3 * markers, -1)
        information = -across @ across.T
        for m in range(markers):
            at = slice(3 * m, 3 * m + 3)
            information[at, at] += np.einsum("nik,ni,nil->kl", rotation, weight[:, m], rotation)
        missing = measured - arms - (fit.translation + rotation @ places.mean(axis=0))[:, None]
        values, vectors = np.linalg.eigh(information)
        root = vectors[:, 6:] / np.sqrt(values[6:])
        step = root @ (root.T @ np.einsum("nik,nmi,nmi->mk", rotation, weight, missing).ravel())
        if np.abs(step).max() < 1e-9 * np.abs(arms).max():
            # places that are too far out by d turn a row by -covariance both^T d
            return replace(fit, shared=-(fit.covariance @ np.swapaxes(both, 1, 2) @ root)[:, :3])
        places = places + step.reshape(markers, 3)
    raise ValueError(f"the places of the markers did not settle in {STEPS} steps; are they on one rigid link?")


def _cross_matrix(x: Array) -> Array:
    """S(x) with ``S(x) y = x cross y``, (..., 3) to (..., 3, 3)."""
    out = np.zeros((*x.shape, 3))
    out[..., [2, 0, 1], [1, 2, 0]] = x
    return out - np.swapaxes(out, -1, -2)


# ---- the hinges of a joint ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class JointTurn:
    """Turn of the link behind a joint against the link before it, along a motion.

    Attributes
    ----------
    rotation : array, shape (N, 3, 3)
        In the joint's frame; its axes are the joint's own and the two bending axes across, in this order.
    covariance : array, shape (N, 3, 3), rad^2
        Of a small turn about the axes behind the joint.
    shared : array, shape (N, 3, k), rad
        Errors that all rows have in common, as in `RigidBodyFit`, about the same axes.
    """

    rotation: Array
    covariance: Array
    shared: Array | None = None


def joint_turn(before: RigidBodyFit, behind: RigidBodyFit, before_frame: Array, behind_frame: Array) -> JointTurn:
    """Relative rotation of two links in the joint's frame (A.8-A.12), `hinge_angles` of which are the deformations.

    Parameters
    ----------
    before, behind : RigidBodyFit
        Of the two links, since one reference pose.
    before_frame, behind_frame : array, shape (3, 3)
        Axes of the joint (its own, then the two bending axes) as columns in the camera's frame at the reference
        pose: as the link before it carries them, and as the link behind it does. They come from `calibrate_base` and
        the kinematic model, and their errors are the frame mismatch.
    """
    ends = np.asarray(behind.rotation) @ behind_frame
    starts = np.asarray(before.rotation) @ before_frame
    noise = before.covariance[:, :3, :3] + behind.covariance[:, :3, :3]
    turned = np.swapaxes(ends, 1, 2)
    parts = [sign * fit.shared for sign, fit in ((-1.0, before), (1.0, behind)) if fit.shared is not None]
    shared = turned @ np.concatenate(parts, axis=2) if parts else None
    return JointTurn(np.swapaxes(starts, 1, 2) @ ends, turned @ noise @ ends, shared)


def links_beside(robot: Robot, joint: str) -> tuple[str, str]:
    """Names of the links before and behind a joint."""
    if joint not in robot.joints:
        raise ValueError(f"unknown joint {joint!r} for robot {robot.name}; {close_match(joint, robot.joints)}")
    tree = robot.tree
    bodies: dict[int, str] = {}
    for frame in tree.frames:
        if frame.type == pin.FrameType.BODY:
            bodies.setdefault(frame.parentJoint, frame.name)
    behind = tree.getJointId(joint)
    return bodies[tree.parents[behind]], bodies[behind]


def joint_axes(robot: Robot, joint: str) -> Array:
    """Axes of a joint as columns in its own frame: its own, then the two about which it bends; shape (3, 3)."""
    tree = robot.tree
    axis = np.array(np.ravel(tree.joints[tree.getJointId(joint)].createData().S)[3:])
    return np.stack([axis, *bending_axes(axis)], axis=1)


def joint_frames(robot: Robot, joint: str, base_rotation: Array, angles: Array) -> Array:
    """Where the joint's axes are in the camera's frame at the reference pose, by the rigid robot's kinematics.

    For `joint_turn`. They miss what the reference pose's own deformation turns, about 1e-3 rad under weight.

    Parameters
    ----------
    base_rotation : array, shape (3, 3)
        From `calibrate_base`.
    angles : array, shape (joints,), rad
        Drive angles at the reference pose.

    Returns
    -------
    array, shape (2, 3, 3)
        As the link before the joint carries them, and as the link behind it does.
    """
    tree, data = robot.tree, robot.tree.createData()
    pin.forwardKinematics(tree, data, np.asarray(angles, dtype=float))
    at = tree.getJointId(joint)
    before = data.oMi[tree.parents[at]].rotation @ tree.jointPlacements[at].rotation
    turns = np.stack([before, data.oMi[at].rotation])
    return np.asarray(np.asarray(base_rotation) @ turns @ joint_axes(robot, joint))


def mean_frames(
    robot: Robot, joint: str, base_rotation: Array, angles: Array, bodies: Sequence[RigidBodyFit]
) -> tuple[Array, Array]:
    """`joint_frames` at the bodies' reference, as the mean over all rows: no row's noise or sag counts more than another's.

    Parameters
    ----------
    base_rotation : array, shape (3, 3)
    angles : array, shape (N, joints), rad
    bodies : two RigidBodyFit
        Of the links before and behind, one row for each of the angles.

    Returns
    -------
    tuple of two arrays, shapes (2, 3, 3) and (2, 3), rad
        The frames, and what the markers' noise makes of them about their axes, standard deviations.
    """
    by_row = np.stack([joint_frames(robot, joint, base_rotation, row) for row in angles], axis=1)
    frames, std = np.empty((2, 3, 3)), np.empty((2, 3))
    for side, body in enumerate(bodies):
        frames[side] = Rotation.from_matrix(np.swapaxes(body.rotation, 1, 2) @ by_row[side]).mean().as_matrix()
        axes = body.rotation @ frames[side]
        variance = np.einsum("nij,nik,nkj->j", axes, body.covariance[:, :3, :3], axes) / len(angles) ** 2
        if body.shared is not None:
            variance += ((np.swapaxes(axes, 1, 2) @ body.shared).mean(axis=0) ** 2).sum(axis=1)
        std[side] = np.sqrt(variance)
    return frames, std


def link_poses(robot: Robot, q: Array, links: Sequence[str]) -> dict[str, tuple[Array, Array]]:
    """Rotations (N, 3, 3) and positions (N, 3) of links of the flexible robot in the world."""
    model, data = robot.model, robot.model.createData()
    frames = [model.getFrameId(link) for link in links]
    poses = {link: (np.empty((len(q), 3, 3)), np.empty((len(q), 3))) for link in links}
    for k, state in enumerate(np.asarray(q, dtype=float)):
        pin.framesForwardKinematics(model, data, state)
        for link, frame in zip(links, frames, strict=True):
            poses[link][0][k] = data.oMf[frame].rotation
            poses[link][1][k] = data.oMf[frame].translation
    return poses


def hinge_angles(rotation: Array) -> Array:
    """Joint angle and the two bendings behind it, shape (..., 3), rad.

    Exact for the virtual joints in series: ``rotation = R_1(angle) R_2(bending_1) R_3(bending_2)``. Equation A.13 has the
    same angle, and the bendings about axes that do not turn with the joint; both agree to second order
    of the bendings once A.13's are turned by the joint angle.

    Parameters
    ----------
    rotation : array, shape (..., 3, 3)
        In axes (joint, bend_1, bend_2).
    """
    r = np.asarray(rotation)
    angle = np.arctan2(-r[..., 1, 2], r[..., 2, 2])
    first = np.arctan2(r[..., 0, 2], np.hypot(r[..., 0, 0], r[..., 0, 1]))
    return np.stack([angle, first, np.arctan2(-r[..., 0, 1], r[..., 0, 0])], axis=-1)


def mismatched(rotation: Array, before: Array, behind: Array) -> Array:
    """What frames with small errors make of a joint's rotation: ``exp(-before) rotation exp(behind)``.

    Parameters
    ----------
    rotation : array, shape (..., 3, 3)
    before, behind : array, shape (3,), rad
        Turn from the true to the assumed joint frame, as the link before and the link behind carries it.
    """
    left, right = (Rotation.from_rotvec(x).as_matrix() for x in (-np.asarray(before), np.asarray(behind)))
    return np.asarray(left @ rotation @ right)


# ---- stiffness ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class JointFit:
    """Stiffness of a joint's hinges from its turn along a motion.

    Attributes
    ----------
    stiffness, stiffness_std : array, shape (3,)
        Torsion and the two bendings, N m/rad; standard deviations, as those of the frame, widened by the root of `loudness`.
    before, behind : array, shape (3,), rad
        The estimated errors of the joint's frame, as in `mismatched`.
    before_std, behind_std : array, shape (3,), rad
    deformation : array, shape (N, 3), rad
        Torsion and bendings in the corrected frame.
    chi2 : float
    degrees_of_freedom : int
    row_chi2 : array, shape (N,)
        Of each row by itself, without the errors that rows have in common.
    """

    stiffness: Array
    stiffness_std: Array
    before: Array
    behind: Array
    before_std: Array
    behind_std: Array
    deformation: Array
    chi2: float
    degrees_of_freedom: int
    row_chi2: Array

    @property
    def loudness(self) -> float:
        """Chi-squared a degree of freedom where that is more than chance makes of the stated noise, otherwise 1."""
        return _loudness(self.chi2, self.degrees_of_freedom)


FRAME_PRIOR = 1e-3  # rad; about what a base calibration reaches with a rigid model of a robot that sags
LOUD = 1.5  # chi-squared a degree of freedom above which the noise is not what was stated
BY_CHANCE = 1e-3  # how often stated noise may be said to be loud
STEPS = 20  # in which Gauss and Newton's settle
SAME_SQUARES = 1e-4  # change of the weighted squares of a fit that has settled
_COARSE = 2  # steps of the fit that leave its faint directions alone
_FRAME = 6  # numbers of the frame in the fit: three before the joint, three behind


def fit_joint(
    turn: JointTurn,
    drive_angle: Array,
    moment: Array,
    *,
    same_bending: bool = False,
    frame_prior: float | Array = FRAME_PRIOR,
) -> JointFit:
    """Stiffnesses of a joint's three hinges together with the errors of its frame.

    ``turn = exp(-before) R_1(drive_angle + m_1 / k_1) R_2(m_2 / k_2) R_3(m_3 / k_3) exp(behind)``, by Gauss-Newton with
    the covariance of each turn and of the errors that turns share. Linear in the compliances 1 / k and nearly so in the
    frame. The frame's leak into the bendings (a constant, and sine and cosine of the joint angle) differs from the moments
    unless the joint hardly turns.
    About the joint's own axis the difference of the two errors shows as a zero error of the angle; each by itself
    only in how it turns the bendings into each other, so faintly that it would cost the smaller bending's stiffness its
    accuracy. So the frame's six errors are held near zero by what is known of them beforehand, `frame_prior`.

    Parameters
    ----------
    turn : JointTurn
    drive_angle : array, shape (N,), rad
        From the resolver.
    moment : array, shape (N, 3), N m
        About the joint's axis and the two bending axes; independent of the noise of the turn.
    same_bending : bool
        One stiffness for both bendings, as table 4.1 has it for bearings that are symmetric about their axis.
    frame_prior : float or array, shape (6,), rad
        Standard deviation of each component of the frame's errors (before, behind) before the measurement. The data
        overrule it but for the errors about the joint's own axis.

    Raises
    ------
    ValueError
        A moment that is zero throughout, or no convergence.
    """
    angle, moment = np.asarray(drive_angle, dtype=float), np.asarray(moment, dtype=float)
    largest = np.abs(moment).max(axis=0)
    if (largest == 0.0).any():
        raise ValueError("one of the three moments is zero throughout: its hinge's stiffness cannot show")
    whiten = _whitening(turn)
    size = _sizes_of_unknowns(largest, same_bending)
    found, root = _settled_joint(turn.rotation, angle, moment, whiten, size, frame_prior)
    before, behind, compliance = np.split(found, [3, _FRAME])
    residual, _ = _misfit(found, turn.rotation, angle, moment)
    chi2, freedom = float((whiten(residual[..., None]) ** 2).sum()), residual.size - size.shape[1]
    # what is left above the stated noise is an error of the model, too; the frame is known beforehand, whatever is left
    std = np.sqrt(_loudness(chi2, freedom) * (root**2).sum(axis=1))
    std[:_FRAME] = np.minimum(std[:_FRAME], frame_prior)
    deformation = hinge_angles(mismatched(turn.rotation, -before, -behind))
    deformation[:, 0] = np.angle(np.exp(1j * (deformation[:, 0] - angle)))
    return JointFit(
        stiffness=1.0 / compliance,
        stiffness_std=std[_FRAME:] / compliance**2,
        before=before,
        behind=behind,
        before_std=std[:3],
        behind_std=std[3:_FRAME],
        deformation=deformation,
        chi2=chi2,
        degrees_of_freedom=freedom,
        row_chi2=np.einsum("ni,nij,nj->n", residual, np.linalg.inv(turn.covariance), residual),
    )


def _loudness(chi2: float, degrees_of_freedom: int) -> float:
    freedom = max(degrees_of_freedom, 1)
    ratio = chi2 / freedom
    return ratio if ratio > max(LOUD, float(chdtri(freedom, BY_CHANCE)) / freedom) else 1.0


def _whitening(turn: JointTurn) -> Callable[[Array], Array]:
    """What makes turns' errors independent with variance 1: (N, 3, k) to (rows, k).

    Errors that rows have in common are unknowns beside the model's, each held near zero by a row of its own, and are
    eliminated: what an orthonormal basis of their columns spans is taken out.
    """
    weight = np.linalg.inv(np.linalg.cholesky(turn.covariance))
    size = 3 * len(weight)
    shared = np.zeros((len(weight), 3, 0)) if turn.shared is None else turn.shared
    count = shared.shape[2]
    basis = np.linalg.qr(np.concatenate([(weight @ shared).reshape(size, count), np.eye(count)]))[0]

    def whiten(x: Array) -> Array:
        rows = np.concatenate([(weight @ x).reshape(size, x.shape[2]), np.zeros((count, x.shape[2]))])
        return np.asarray(rows - basis @ (basis.T @ rows))

    return whiten


def _sizes_of_unknowns(largest: Array, same_bending: bool) -> Array:
    """How the model's nine numbers follow from unknowns of about 1, in 1e-3 rad; shape (9, 9), or (9, 8)."""
    size = np.diag(np.concatenate([np.full(_FRAME, 1e-3), 1e-3 / largest]))
    if same_bending:
        size = np.column_stack([size[:, :-2], np.r_[np.zeros(_FRAME + 1), 1.0, 1.0] * 1e-3 / largest[1:].max()])
    return size


def _settled_joint(
    rotation: Array,
    angle: Array,
    moment: Array,
    whiten: Callable[[Array], Array],
    size: Array,
    frame_prior: float | Array,
) -> tuple[Array, Array]:
    """The model's nine numbers by Gauss-Newton, and a root R of their covariance, R R^T."""
    x = np.zeros(size.shape[1])
    prior = np.hstack([np.eye(_FRAME) * 1e-3 / frame_prior, np.zeros((_FRAME, len(x) - _FRAME))])
    squares = np.inf
    for iteration in range(STEPS):
        residual, slope = _misfit(size @ x, rotation, angle, moment)
        r = np.concatenate([whiten(residual[..., None]).ravel(), -prior @ x])
        squares, before = float(r @ r), squares
        columns = np.concatenate([whiten(slope @ size), prior])
        u, s, vt = np.linalg.svd(columns, full_matrices=False)
        # at first only what shows clearly: along the faint direction a far start would throw the fit off
        clear = s > (1e-2 if iteration < _COARSE else 0.0) * s[0]
        step = vt.T[:, clear] @ ((u.T @ r)[clear] / s[clear])
        x = x + step
        # of a direction that the poses hardly tell a hundredth of a standard deviation is no reason to go on
        idle = 0.0 <= before - squares < SAME_SQUARES or np.abs(step).max() < 1e-5 * (1.0 + np.abs(x).max())
        if iteration > _COARSE and idle:
            return size @ x, size @ vt.T / s
    raise ValueError(f"the fit of joint and frame did not settle in {STEPS} steps")


def _misfit(x: Array, rotation: Array, angle: Array, moment: Array) -> tuple[Array, Array]:
    """What the model lacks of the measured turn, (N, 3), rad, and how the model's turn follows x, (N, 3, 9).

    Both in the axes behind the joint.
    """
    before, behind, compliance = np.split(x, [3, _FRAME])
    hinges = moment * compliance
    hinges[:, 0] += angle
    after = Rotation.from_rotvec(behind).as_matrix()
    one, two, three = (Rotation.from_rotvec(np.eye(3)[i] * hinges[:, i : i + 1]).as_matrix() for i in range(3))
    behind_two = three @ after
    behind_one = two @ behind_two
    whole = one @ behind_one
    model = Rotation.from_rotvec(-before).as_matrix() @ whole
    short = Rotation.from_matrix(np.swapaxes(model, 1, 2) @ rotation).as_rotvec()
    slope = np.empty((len(angle), 3, len(x)))
    slope[:, :, :3] = -np.swapaxes(whole, 1, 2) @ _turn_by(-before)
    slope[:, :, 3:_FRAME] = _turn_by(behind)
    # an axis e of a hinge, seen from behind all that follows it: row e of what follows
    seen = np.stack([behind_one[:, 0], behind_two[:, 1], np.broadcast_to(after[2], (len(angle), 3))], axis=2)
    slope[:, :, _FRAME:] = seen * moment[:, None]
    return np.asarray(short), slope


def _turn_by(x: Array) -> Array:
    """J with ``exp(x + d) = exp(x) exp(J d)`` for small d, to second order in x."""
    cross = _cross_matrix(x)
    return np.eye(3) - cross / 2.0 + cross @ cross / 6.0


# ---- base -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BaseCalibration:
    """Where the robot's base stands in the camera's frame: ``camera point = rotation @ base point + translation``.

    Attributes
    ----------
    rotation : array, shape (3, 3)
    translation : array, shape (3,), m
    markers : array, shape (m, 3), m
        In the frame of the link that carries them.
    rotation_std : array, shape (3,), rad
        About the camera's axes, for the noise alone: errors of the kinematic model come on top.
    chi2, degrees_of_freedom : float, int
    """

    rotation: Array
    translation: Array
    markers: Array
    rotation_std: Array
    chi2: float
    degrees_of_freedom: int


def _placed_with_markers(
    turns: Array, places: Array, measured: Array, std: float | Array
) -> tuple[Array, Array, Array]:
    """Where a fit of base and markers begins: the base's rotation (3, 3), the markers (m, 3) and its translation (3,), m."""
    count = measured.shape[1]
    seen = fit_rigid_body(measured[0], measured, std).rotation
    in_base = Rotation.from_matrix(turns @ turns[0].T).as_rotvec()
    in_camera = Rotation.from_matrix(seen).as_rotvec()
    if np.linalg.matrix_rank(in_base, tol=1e-3) < 2:
        raise ValueError(
            "the link turns about one axis only, which leaves the base's turn about it open; move a second joint"
        )
    rotation = Rotation.align_vectors(in_camera, in_base)[0].as_matrix()
    # measured = rotation link_rotation marker + (rotation link_position + translation): linear in the rest
    inner = rotation @ turns
    columns = np.zeros((len(turns), count, 3, 3 * count + 3))
    for m in range(count):
        columns[:, m, :, 3 * m : 3 * m + 3] = inner
    columns[..., -3:] = np.eye(3)
    moved = measured - (places @ rotation.T)[:, None]
    first = np.linalg.lstsq(columns.reshape(-1, columns.shape[-1]), moved.ravel(), rcond=None)[0]
    return rotation, first[:-3].reshape(count, 3), first[-3:]


def _settled_base(
    turns: Array, places: Array, measured: Array, weight: Array, start: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array, Array]:
    """Rotation, markers and translation by Gauss-Newton, and a root R of the covariance, R R^T, of turn, translation and markers."""
    rotation, at, translation = start
    count = measured.shape[1]
    for _ in range(STEPS):
        points = np.einsum("nij,mj->nmi", turns, at) + places[:, None]
        arms = points @ rotation.T
        missing = measured - arms - translation
        slope = np.zeros((*measured.shape, 6 + 3 * count))
        slope[..., :3], slope[..., 3:6] = -_cross_matrix(arms), np.eye(3)
        for m in range(count):
            slope[:, m, :, 6 + 3 * m : 9 + 3 * m] = rotation @ turns
        u, s, vt = np.linalg.svd((weight[..., None] * slope).reshape(measured.size, -1), full_matrices=False)
        if s[-1] < 1e-9 * s[0]:
            raise ValueError("the poses do not determine the base: markers or poses lie on one line")
        step = vt.T @ ((u.T @ (weight * missing).ravel()) / s)
        rotation = Rotation.from_rotvec(step[:3]).as_matrix() @ rotation
        translation = translation + step[3:6]
        at = at + step[6:].reshape(count, 3)
        if np.abs(step).max() < 1e-12:
            return rotation, at, translation, vt.T / s
    raise ValueError(
        f"the calibration of the base did not settle in {STEPS} steps; look for markers in another unit, angles in degrees or of the "
        "other sign, exchanged links or markers, a left-handed camera, another robot"
    )


def calibrate_base(link_rotation: Array, link_position: Array, measured: Array, std: Array | float) -> BaseCalibration:
    """The base in the camera's frame, from markers on one link in several poses of a known kinematic model.

    ``measured = rotation (link_rotation @ marker + link_position) + translation``. The turns of the link in the
    camera's frame are those of the model in the base's frame, carried over: that starts the rotation; the rest is
    linear, then Gauss-Newton with all weights. The markers' places on the link are estimated too, so that it has to turn about
    more than one axis: moving joint 1 alone leaves the turn about it open.

    Parameters
    ----------
    link_rotation, link_position : array, shapes (N, 3, 3) and (N, 3), m
        Of the link in the base's frame, by the kinematic model.
    measured : array, shape (N, m, 3), m
    std : float or array that broadcasts to (N, m, 3), m

    Raises
    ------
    ValueError
        Poses that do not determine the base.
    """
    turns, places = np.asarray(link_rotation, dtype=float), np.asarray(link_position, dtype=float)
    measured = np.asarray(measured, dtype=float)
    weight = 1.0 / np.broadcast_to(np.asarray(std, dtype=float), measured.shape)
    start = _placed_with_markers(turns, places, measured, std)
    rotation, at, translation, root = _settled_base(turns, places, measured, weight, start)
    points = np.einsum("nij,mj->nmi", turns, at) + places[:, None]
    left = weight * (measured - points @ rotation.T - translation)
    return BaseCalibration(
        rotation,
        translation,
        at,
        np.sqrt((root[:3] ** 2).sum(axis=1)),
        float((left**2).sum()),
        measured.size - len(root),
    )
