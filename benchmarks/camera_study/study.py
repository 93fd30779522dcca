"""Why a camera fails to give the joint stiffness, and what would be enough (section 4.2.3).

A robot runs through the motion of section 4.2.2; a camera reads three markers on each of the two links beside a joint.
Moments, drive angles and the markers' places are known without error, and each instant's noise is its own: all that
stands in the way of the stiffness is the camera's noise and the frame mismatch, so the requirements found here are the
least that can be asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from camera_study.camera import Camera, CameraNoise, carried_motion
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.camera import (
    FRAME_PRIOR,
    JointTurn,
    RigidBodyFit,
    fit_joint,
    fit_rigid_body,
    hinge_angles,
    joint_axes,
    joint_turn,
    link_poses,
    links_beside,
)
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.trajectories import PERIOD_S, RATE_HZ, SINE_AMPLITUDE, SINE_HARMONICS

# Choices: the source prints neither the camera's place nor the markers'. Zones II and III of table C.2 all along the
# motion, in the quadrant that the arm sweeps; a triangle with sides of 0.4 m, between the source's marker distances of
# 0.44 to 0.74 m for lines and what fits a link all round. Whether markers hide behind links is left out.
CAMERA_AT = (2.9, 2.6, 1.2)
LOOKING_AT = (0.3, 0.3, 0.7)
TRIANGLE = 0.4 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0]])
TRIANGLE_TURN = (0.4, 0.7, 0.2)  # rotation vector: no side along an axis of the robot

# The thesis' regression, the same the other way round, and fits of the joint's frame along with the stiffnesses.
ESTIMATORS = ("moment on deformation", "deformation on moment", "frame fitted", "frame fitted, bendings alike")
REQUIRED = 0.05


@dataclass(frozen=True, eq=False)
class Scene:
    """A joint in motion before a camera, without noise.

    Attributes
    ----------
    joint : str
    stiffness : array, shape (3,), N m/rad
        True ones: torsion and the two bendings.
    drive_angle : array, shape (N,), rad
    deformation, moment : array, shape (N, 3)
        True torsion and bendings, rad; moments by the rigid robot, N m.
    camera : Camera
    markers : array, shape (N, 2, 3, 3), m
        Three markers before and behind the joint, in the camera's frame; sample 0 is the reference pose.
    frames : array, shape (2, 3, 3)
        True axes of the joint in the camera's frame at the reference pose, carried by the link before and behind.
    """

    joint: str
    stiffness: Array
    drive_angle: Array
    deformation: Array
    moment: Array
    camera: Camera
    markers: Array
    frames: Array


def sine_motion(joints: int, rate_hz: float = RATE_HZ, amplitude: float = SINE_AMPLITUDE) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the motion of section 4.2.2, one period, each (N, joints)."""
    count = round(PERIOD_S * rate_hz)
    moving = np.arange(joints) < len(SINE_HARMONICS)
    omega = 2.0 * np.pi * np.resize(SINE_HARMONICS, joints) * moving / PERIOD_S
    phase = np.arange(count)[:, None] / rate_hz * omega
    position = amplitude * (np.sin(phase) + moving)
    return position, amplitude * omega * np.cos(phase), -amplitude * omega**2 * np.sin(phase)


def make_scene(robot: Robot, joint: str, *, rate_hz: float = RATE_HZ, camera: Camera | None = None) -> Scene:
    """The joint along one period of the motion, before the camera.

    Raises
    ------
    ValueError
        A joint that does not exist, or has no torsion and bendings.
    """
    before, behind = links_beside(robot, joint)
    places = [robot.layout.index(joint, kind) for kind in ("drive", "torsion", "bend_1", "bend_2")]
    if None in places:
        raise ValueError(f"{robot.name}: {joint} has no torsion and bendings to be seen")
    drive, torsion, bend_1, bend_2 = (int(p) for p in places if p is not None)
    hinges = [torsion, bend_1, bend_2]
    camera = camera or Camera.looking(CAMERA_AT, LOOKING_AT)
    motion = carried_motion(robot, *sine_motion(len(robot.joints), rate_hz))
    poses = link_poses(robot, motion.q, [before, behind])
    triangle = TRIANGLE @ Rotation.from_rotvec(TRIANGLE_TURN).as_matrix().T
    markers = np.stack(
        [np.einsum("nij,mj->nmi", turn, triangle) + place[:, None] for turn, place in poses.values()], axis=1
    )
    # the joint's axes as the two links carry them; behind all its hinges they are those of the link
    axes = joint_axes(robot, joint)
    tree = robot.tree
    placement = tree.jointPlacements[tree.getJointId(joint)].rotation
    into_camera = camera.rotation.T
    frames = np.stack([into_camera @ poses[before][0][0] @ placement @ axes, into_camera @ poses[behind][0][0] @ axes])
    stiffness = {
        kind: value
        for effect in robot.effects
        if effect.traits.virtual and effect.joints == (joint,)
        for kind, value in zip(effect.traits.virtual, np.split(effect.coefficients, 2)[0], strict=True)
    }
    return Scene(
        joint,
        np.array([stiffness[kind] for kind in ("torsion", "bend_1", "bend_2")]),
        motion.q[:, drive],
        motion.q[:, hinges],
        motion.moment[:, hinges],
        camera,
        camera.see(markers),
        frames,
    )


def rigid_bodies(
    scene: Scene, markers: Array, noise: CameraNoise, reference: Array | None = None
) -> list[RigidBodyFit]:
    """Rigid bodies before and behind the joint, fitted to markers (N, 2, 3, 3) of the camera's frame.

    Parameters
    ----------
    reference : array, shape (2, 3, 3), m, optional
        Markers in the reference pose; the true ones by default, as if averaged at rest for long.
    """
    at = scene.markers[0] if reference is None else reference
    std = noise.std(scene.markers)
    return [fit_rigid_body(at[side], markers[:, side], std[:, side]) for side in (0, 1)]


def mismatched_turn(scene: Scene, bodies: Sequence[RigidBodyFit], mismatch: Array) -> JointTurn:
    """The joint's turn in frames that are wrong by two rotation vectors, (2, 3), rad: before and behind."""
    wrong = scene.frames @ Rotation.from_rotvec(mismatch).as_matrix()
    return joint_turn(bodies[0], bodies[1], wrong[0], wrong[1])


def regress_bending(turn: JointTurn, moment: Array, *, response: str = "moment") -> Array:
    """Stiffness of the two bendings by least squares, the joint's frame taken as right, shape (2,), N m/rad.

    Parameters
    ----------
    turn : JointTurn
    moment : array, shape (N, 2), N m
        About the two bending axes.
    response : ``moment`` or ``deformation``
        ``moment`` is the thesis' regression (4.2.1): the deformation is a column of the regressor, and its noise
        lowers the stiffness by ``1 + noise variance / its variance``. ``deformation`` is free of that.
    """
    if response not in ("moment", "deformation"):
        raise ValueError(f"response is {response!r}; expected 'moment' or 'deformation'")
    bending, moment = hinge_angles(turn.rotation)[:, 1:], np.asarray(moment, dtype=float)
    common = (bending * moment).sum(axis=0)
    return np.asarray(common / (bending**2).sum(axis=0) if response == "moment" else (moment**2).sum(axis=0) / common)


def estimate(scene: Scene, turn: JointTurn, estimator: str, frame_prior: float = FRAME_PRIOR) -> Array:
    """Relative errors of the two bending stiffnesses, shape (2,)."""
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator is {estimator!r}; expected one of {', '.join(map(repr, ESTIMATORS))}")
    if estimator in ESTIMATORS[:2]:
        found = regress_bending(turn, scene.moment[:, 1:], response=estimator.split()[0])
    else:
        alike = estimator == ESTIMATORS[3]
        fit = fit_joint(turn, scene.drive_angle, scene.moment, same_bending=alike, frame_prior=frame_prior)
        found = fit.stiffness[1:]
    return np.asarray(found / scene.stiffness[1:] - 1.0)


@dataclass(frozen=True, eq=False)
class Study:
    """Trials with one set of noise and directions of mismatch, so that only their sizes change.

    Attributes
    ----------
    scene : Scene
    true : two RigidBodyFit
        The links' turns without noise, with the covariance that table C.2's noise gives them.
    noise : array, shape (trials, 2, N, 3), rad
        Errors of those turns at table C.2's noise.
    directions : array, shape (trials, 2, 3)
        Unit vectors of the mismatch before and behind the joint.
    """

    scene: Scene
    true: tuple[RigidBodyFit, RigidBodyFit]
    noise: Array
    directions: Array

    def turn(self, trial: int, factor: float, mismatch: float) -> JointTurn:
        """What the camera makes of the joint in one trial; errors of turns are linear in the markers' noise.

        Parameters
        ----------
        factor : float
            Of table C.2's noise.
        mismatch : float, rad
            Size of the error of the joint's frame, before and behind it alike.
        """
        noisy = [
            replace(
                fit,
                rotation=Rotation.from_rotvec(factor * error).as_matrix() @ fit.rotation,
                covariance=max(factor, 1e-6) ** 2 * fit.covariance,  # never quite zero: it is a weight
            )
            for fit, error in zip(self.true, self.noise[trial], strict=True)
        ]
        return mismatched_turn(self.scene, noisy, mismatch * self.directions[trial])

    def errors(self, factor: float, mismatch: float, estimator: str) -> Array:
        """Relative errors of both bending stiffnesses in each trial, shape (trials, 2).

        Who fits the frame knows how wrong it may be: `mismatch`, or `FRAME_PRIOR` where that is larger.
        """
        prior = max(mismatch, FRAME_PRIOR)
        turns = (self.turn(trial, factor, mismatch) for trial in range(len(self.noise)))
        return np.array([estimate(self.scene, turn, estimator, prior) for turn in turns])

    def error(self, factor: float, mismatch: float, estimator: str) -> float:
        """What 95 % of the trials stay under: the larger relative error of the two bendings."""
        worst = np.abs(self.errors(factor, mismatch, estimator)).max(axis=1)
        return float(np.quantile(worst, 0.95))

    def enough(self, estimator: str, *, factor: float | None = None, mismatch: float | None = None) -> float:
        """The largest noise (with `mismatch` given) or mismatch (with `factor` given) within `REQUIRED`.

        Returns
        -------
        float
            A factor on table C.2, or rad; infinite where 100 times table C.2 or 0.1 rad are still within.
        """
        if (factor is None) == (mismatch is None):
            raise ValueError("give factor or mismatch, one of them")
        if factor is None:
            at = 0.0 if mismatch is None else mismatch
            return _crossing(lambda x: self.error(x, at, estimator), 1e-4, 100.0)
        return _crossing(lambda x: self.error(factor, x, estimator), 1e-7, 0.1)


def make_study(scene: Scene, trials: int, rng: np.random.Generator, noise: CameraNoise | None = None) -> Study:
    """Draw noise and directions of mismatch.

    Parameters
    ----------
    noise : CameraNoise, optional
        Table C.2 by default; without rounding, so that its size alone decides.
    """
    noise = replace(CameraNoise() if noise is None else noise, resolution=0.0)
    true = rigid_bodies(scene, scene.markers, noise)
    errors = np.empty((trials, 2, len(scene.markers), 3))
    for trial in range(trials):
        seen = noise.read(scene.markers, rng)
        # an error that goes with the position is in the reference pose too; others average out there
        bodies = rigid_bodies(scene, seen, noise, seen[0] if noise.correlation_length else None)
        for side, (fit, body) in enumerate(zip(true, bodies, strict=True)):
            errors[trial, side] = Rotation.from_matrix(body.rotation @ np.swapaxes(fit.rotation, 1, 2)).as_rotvec()
    directions = rng.standard_normal((trials, 2, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return Study(scene, (true[0], true[1]), errors / noise.factor, directions)


def _crossing(error: Callable[[float], float], low: float, high: float) -> float:
    """Where the error reaches `REQUIRED`, to 1 %, by Brent's method in logarithms; 0 or infinite outside the bracket."""

    def excess(log_x: float) -> float:
        return float(np.log(error(float(np.exp(log_x))) / REQUIRED))

    ends = np.log([low, high])
    if excess(ends[0]) > 0.0:
        return 0.0
    if excess(ends[1]) <= 0.0:
        return np.inf
    return float(np.exp(brentq(excess, *ends, xtol=0.01)))
