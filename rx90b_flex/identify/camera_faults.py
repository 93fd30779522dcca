"""Mistakes in a table of markers that the markers themselves tell: units, signs, exchanged links, outliers.

Distances between markers of one link, and how the links turn since the first row, depend on no frame of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.camera import RigidBodyFit, link_poses, links_beside
from rx90b_flex.identify.linear_fit import LinearFit
from rx90b_flex.robot import Robot

SIDES = ("before", "behind")
FAR, NEAR = 20.0, 1e-3  # m; no markers of one row lie so far apart, or so near,
TOO_LARGE, TOO_SMALL = 30.0, 3e-3  # if that is also out of proportion to the robot
SAME_TURN = 0.05  # rad; links turn as the model's to within their deformation and the noise
WORSE = 3.0  # times what the best explanation leaves: another one is none
SAME_SCALE = 0.2  # links go as far as the model's to within this share
ONE_AXIS = 0.1  # rad; turns about a second axis below which the first leaves the camera's frame open
ROWS = 100  # that are looked at
BY_CHANCE = 1e-3  # how often sound noise may give an outlier, in a whole table
FEWEST = 5  # rows from which on one that stands out can be told
EXCHANGED = 10.0  # standard deviations that sides of a triangle differ by where their order tells something
MOST = 0.5  # of all squares: less than that in single rows, and the fault is in all of them
NAMED = 5  # outliers that are named one by one


# ---- units --------------------------------------------------------------------------------------------------------


def check_size(robot: Robot, markers: Array, millimetres: bool) -> None:
    """Whether markers (2, N, m, 3), m, lie no farther apart than a robot can hold them.

    Raises
    ------
    ValueError
        They are in another unit.
    """
    tip = robot.tree.frames[robot.tree.getFrameId(robot.tip_frame)]
    reach = sum(float(np.linalg.norm(place.translation)) for place in (*robot.tree.jointPlacements, tip.placement))
    # of a row, whose markers are those of two neighbouring links
    seen = np.concatenate(list(markers), axis=1)
    size = float(np.median(np.linalg.norm(seen - seen[:, :1], axis=2).max(axis=1)))
    if size > max(FAR, TOO_LARGE * reach):
        raise ValueError(
            f"one row's markers lie {size:.3g} m apart, on a robot with a reach of {reach:.2g} m: columns without a unit are in m; "
            f"name those in mm {SIDES[0]}_1_x_mm and so on"
        )
    if millimetres and size < min(NEAR, TOO_SMALL * reach):
        raise ValueError(
            f"one row's markers lie {1e3 * size:.3g} mm apart, on a robot with a reach of {reach:.2g} m: columns ..._mm are in mm; "
            f"name those in m {SIDES[0]}_1_x and so on"
        )


# ---- turns --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Seen:
    """Angles (N, joints), rad, and how the links beside a joint turned since the first row and where they are.

    Attributes
    ----------
    turns : array, shape (2, N, 3, 3)
    centres : array, shape (2, N, 3), m
        Of the markers, in the camera's frame.
    """

    angles: Array
    turns: Array
    centres: Array


@dataclass(frozen=True)
class Left:
    """How the links' motion differs from that of the model, in the best frame of the camera.

    Attributes
    ----------
    turn : float, rad
        Median over rows and links.
    scale, scale_std : float
        How far the links go over how far they should, -1 in mirrored coordinates, in which they turn as the robot does;
        as if every number had the same errors in all rows. Infinite: not told.
    """

    turn: float
    scale: float
    scale_std: float

    def near(self, scale: float) -> bool:
        """Whether the links go about so far."""
        return abs(self.scale - scale) < SAME_SCALE


def check_turns(robot: Robot, joint: str, angles: Array, markers: Array, bodies: Sequence[RigidBodyFit]) -> None:
    """Whether both links turn and go as the drives' angles say, whatever the camera's frame is.

    Where they do not, each of the usual mistakes is taken back by itself; what then fits is named. Nothing is said
    where none fits, or where the links turn about one axis only.

    Raises
    ------
    ValueError
        A mistake that the markers tell.
    """
    rows = np.unique(np.linspace(0, len(angles) - 1, ROWS).astype(int))
    turns = np.stack([body.rotation[rows] @ body.rotation[rows[0]].T for body in bodies])
    seen = Seen(angles[rows], turns, markers[:, rows].mean(axis=2))
    found = _left(robot, joint, seen)
    if found is None or (found.turn < SAME_TURN and not (found.near(-1.0) and found.scale_std < SAME_SCALE)):
        return
    fitting = {}
    for said, tried in _mistakes(robot, joint, seen):
        after = _left(robot, joint, tried)
        if after is not None and after.turn < SAME_TURN and (np.isinf(after.scale_std) or after.near(1.0)):
            fitting[said] = after.turn
    if fitting:
        best = [said for said, turn in fitting.items() if turn < WORSE * min(fitting.values())]
        raise ValueError(
            f"the links beside {joint} do not move as the angles say; what explains it: " + ", or ".join(best)
        )


def _mistakes(robot: Robot, joint: str, seen: Seen) -> list[tuple[str, Seen]]:
    """What may be the case, and what would be seen otherwise."""
    tree, angles = robot.tree, seen.angles
    mirror = np.diag([-1.0, 1.0, 1.0])
    mirrored = Seen(angles, mirror @ seen.turns @ mirror, seen.centres @ mirror)
    out = [
        ("the angles q_... are in degrees (rad is expected)", replace(seen, angles=np.deg2rad(angles))),
        ("the columns before_... and behind_... are exchanged", Seen(angles, seen.turns[::-1], seen.centres[::-1])),
        ("the camera's frame is left-handed (change the sign of one axis in all its columns)", mirrored),
        ("the angles of all joints have the other sign", replace(seen, angles=-angles)),
    ]
    chain = [tree.names[i] for i in tree.supports[tree.getJointId(joint)]]
    for i, name in enumerate(robot.joints):
        if name in chain and angles[:, i].any():
            for said, factor in (("has the other sign", -1.0), ("is in degrees (rad is expected)", np.deg2rad(1.0))):
                other = np.where(np.arange(len(robot.joints)) == i, factor * angles, angles)
                out.append((f"column q_{name} {said}", replace(seen, angles=other)))
    return out


def _left(robot: Robot, joint: str, seen: Seen) -> Left | None:
    """What the best turn C of the base leaves of the turns of both links, and the scale of their places.

    ``seen C = C model`` is linear in C. None: turns about one axis, which leave it open.
    """
    links = links_beside(robot, joint)
    poses = link_poses(robot, seen.angles @ robot.input_matrix.T, links)
    model = np.concatenate([poses[link][0] @ poses[link][0][0].T for link in links])
    turns = np.concatenate(list(seen.turns))
    for one in (turns, model):
        about = np.linalg.svd(Rotation.from_matrix(one).as_rotvec(), compute_uv=False)
        if about[1] < ONE_AXIS * np.sqrt(len(one)):
            return None
    eye = np.eye(3)
    columns = np.einsum("nik,jl->nijkl", turns, eye) - np.einsum("ik,nlj->nijkl", eye, model)
    base = np.linalg.svd(columns.reshape(-1, 9), full_matrices=False)[2][-1].reshape(3, 3)
    u, _, vt = np.linalg.svd(base * np.sign(np.linalg.det(base)))
    base = u @ vt
    apart = Rotation.from_matrix(np.swapaxes(turns, 1, 2) @ base @ model @ base.T).magnitude()
    return Left(float(np.median(apart)), *_scale([poses[link] for link in links], seen.centres, base))


def _scale(poses: Sequence[tuple[Array, Array]], centres: Array, base: Array) -> tuple[float, float]:
    """Scale of the links' places and its standard deviation.

    ``centre = base (rotation marker + scale position) + translation`` is linear in what is left.
    """
    columns = np.zeros((2, len(centres[0]), 3, 10))
    for side, (rotation, position) in enumerate(poses):
        columns[side, ..., 3 * side : 3 * side + 3] = base @ rotation
        columns[side, ..., 6] = position @ base.T
    columns[..., 7:] = np.eye(3)
    slope = columns.reshape(-1, 10)
    size = np.linalg.norm(slope, axis=0)
    if not size.all() or np.linalg.matrix_rank(slope / size, tol=1e-3 * np.sqrt(len(size))) < len(size):
        return 0.0, np.inf
    fit = LinearFit.of(slope, centres.reshape(-1))
    # deformations make errors that more rows do not lessen
    return float(fit.theta[6]), float(fit.std[6] * np.sqrt(len(slope) / len(size)))


# ---- outliers -----------------------------------------------------------------------------------------------------


def outliers(markers: Array, std: Array) -> list[str]:
    """Rows in which the distances of a link's markers stand out, a line each: which row, which marker, how far.

    From the middle of all rows, in standard deviations of the stated noise, or of what all rows show where that is more.

    Parameters
    ----------
    markers : array, shape (2, N, m, 3), m
    std : array, shape (3,), m
    """
    _, rows, count, _ = markers.shape
    if rows < FEWEST:
        return []
    pairs = list(combinations(range(count), 2))
    first, second = np.array(pairs).T
    apart = markers[:, :, first] - markers[:, :, second]
    distance = np.linalg.norm(apart, axis=3)
    along = apart / np.maximum(distance, np.finfo(float).tiny)[..., None]
    noise = np.sqrt(2.0) * np.maximum(np.linalg.norm(along * std, axis=3), std.min())
    noise *= np.sqrt(1.0 + 0.5 * np.pi / rows)  # of the middle, too
    usual = np.median(distance, axis=1, keepdims=True)
    off = np.abs(distance - usual)
    pull = off / noise
    # the middle of a normal variable's sizes is 0.674 of its standard deviation
    pull /= np.maximum(1.0, np.median(pull, axis=1, keepdims=True) / special.ndtri(0.75))
    limit = float(-special.ndtri(0.5 * BY_CHANCE / pull.size))
    reordered = np.abs(np.sort(distance, axis=2) - np.sort(usual, axis=2)).max(axis=2) < limit * noise.max(axis=2)
    said = []
    for side, row in np.argwhere((pull > limit).any(axis=2)):
        names = " or ".join(f"{SIDES[side]}_{k + 1}" for k in _moved(pull[side, row], pairs, count, limit))
        what = f"{names} stands {1e3 * off[side, row].max():.2g} mm off its link"
        if reordered[side, row] and off[side, row].max() > EXCHANGED * noise[side, row].max():
            what = f"the markers {SIDES[side]}_... are in another order than in the other rows"
        said.append((int(row), f"row {row + 1}: {what}"))
    said.sort()
    more = [f"and {len(said) - NAMED} more such places"] if len(said) > NAMED else []
    return [line for _, line in said[:NAMED]] + more


def _moved(pull: Array, pairs: Sequence[tuple[int, int]], count: int, limit: float) -> list[int]:
    """Markers that alone explain the distances that stand out; all that take part, where none does."""
    loud = [pair for pair, size in zip(pairs, pull, strict=True) if size > limit]
    alone = [k for k in range(count) if all(k in pair for pair in loud)]
    if len(alone) > 1:
        # one distance stands out: the marker whose other distances moved along, too, where one of them clearly does
        others = [
            max((s for p, s in zip(pairs, pull, strict=True) if k in p and p not in loud), default=0.0) for k in alone
        ]
        if max(others) > 3.0 > min(others):
            alone = [alone[int(np.argmax(others))]]
    return alone or sorted({k for pair in loud for k in pair})


def loud_rows(row_chi2: Array, freedom: int) -> list[int]:
    """Rows whose squares of what is left stand out, as `outliers`, and hold the most of all rows' squares."""
    if len(row_chi2) < FEWEST:
        return []
    scale = max(1.0, float(np.median(row_chi2)) / float(special.chdtri(freedom, 0.5)))
    limit = float(special.chdtri(freedom, BY_CHANCE / len(row_chi2)))
    loud = row_chi2 > scale * limit
    return [int(row) for row in np.flatnonzero(loud)] if row_chi2[loud].sum() > MOST * row_chi2.sum() else []
