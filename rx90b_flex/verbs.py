"""What one does with a robot and its recordings, as functions: the commands of the command line, in Python.

A robot is given as `load_robot` takes it or as a `Robot`, a campaign as its file or as a `Campaign`; results are objects with
numbers, uncertainty and a way to show themselves. What a function needs is loaded when it is called.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rx90b_flex.identify.command import Identified
    from rx90b_flex.identify.frf_command import MotorIdentification
    from rx90b_flex.path.check import PathCheck
    from rx90b_flex.path.seam import Seam
    from rx90b_flex.robot import Robot
    from rx90b_flex.signals import Campaign
    from rx90b_flex.simulate import CampaignPlan, Noise, Simulation, Trajectory
    from rx90b_flex.simulate.campaign import By
    from rx90b_flex.simulate.excite import Matrix
    from rx90b_flex.view import Run, View

    RobotSource = Robot | str | os.PathLike[str]
    CampaignSource = Campaign | str | os.PathLike[str]
    Progress = Callable[[str, float], None]

__all__ = ["check_path", "excite", "frf", "identify", "simulate", "view"]


def identify(
    campaign: CampaignSource,
    *,
    robot: RobotSource | None = None,
    basics: bool = False,
    estimator: str = "least_squares",
    progress: Progress | None = None,
) -> Identified:
    """Fit a robot's declared parameters to the identification recordings of a campaign; the command ``identify``.

    The data are taken as they are: `rx90b_flex.check` looks for what is wrong with them.

    Parameters
    ----------
    campaign : path or Campaign
    robot : optional
        In place of the one that the campaign names.
    basics : bool
        Whether drive inertia, dry and viscous friction and an offset are declared on every joint of the campaign that lacks them.
    estimator : str
        ``least_squares``; ``huber``, which bumps and lost samples hardly move; or another package's.
    progress : callable, optional
        Called with a message and a fraction.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> found = rf.identify("campaign.toml")
    >>> found.validation.relative_error < 0.5
    True
    >>> list(found.to_pandas().columns)
    ['parameter', 'value', 'std', 'unit']
    """
    from rx90b_flex.diagnose.basics import declared_robot
    from rx90b_flex.identify.command import identify_campaign
    from rx90b_flex.signals import Campaign, load_campaign

    read = campaign if isinstance(campaign, Campaign) else load_campaign(Path(campaign))
    declared = declared_robot(read, basics, robot)
    return identify_campaign(read, robot=declared, estimator=estimator, progress=progress)


def simulate(
    robot: RobotSource,
    motion: Trajectory | str | os.PathLike[str] = "line",
    *,
    controller: str | os.PathLike[str] | None = None,
    periods: int = 1,
    seed: int = 0,
    noise: Noise | None = None,
    perturbation: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Simulate a robot under its controller along a motion; the command ``simulate``.

    Parameters
    ----------
    robot : Robot, or what `load_robot` takes
    motion : Trajectory, path or str
        ``line``, ``excitation``, ``square-wave`` or ``harmonics``; or a table of a trajectory (CSV).
    controller : path, optional
        Controller file; the one that the robot's file states, else gains designed for the robot, where not given.
    periods : int
        Of an excitation that repeats.
    seed : int
        Of excitation and noise.
    noise : Noise, optional
    perturbation : bool
        Whether to use the perturbation method.
    progress : callable, optional
        Called with the part that is done.

    Raises
    ------
    ValueError
        One line that names file and key or column, or what a motion may be.
    TypeError
        A noise that is no `Noise`.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> run = rf.simulate("rx90b_3dof", "harmonics")
    >>> run.ended is None
    True
    >>> run.q.shape == (len(run.time), len(run.robot.coordinates))
    True
    """
    from rx90b_flex.robot import load_robot
    from rx90b_flex.simulate import Noise, Trajectory
    from rx90b_flex.simulate.command import RunRequest, check_motion, prepare, run

    if not isinstance(noise, Noise | None):
        raise TypeError(f"noise is {noise!r}; expected a rx90b_flex.simulate.Noise, as Noise(torque=0.1)")
    loaded = load_robot(robot)
    given = motion if isinstance(motion, Trajectory) else None
    if given is None:
        check_motion(str(motion))
    named = given.name if given is not None else str(motion)
    file = None if controller is None else Path(controller)
    request = RunRequest(loaded.name, named, file, periods, seed, noise or Noise(), perturbation)
    return run(prepare(request, loaded, given), progress)


def frf(
    campaign: CampaignSource,
    *,
    band_hz: tuple[float, float] = (8.0, 80.0),
    controller: str | os.PathLike[str] | None = None,
    link_mass_std: float = 0.0,
    bending_alike_std: float = 0.1,
    hinge_std: float | Mapping[str, float] = 0.0,
    references: str | os.PathLike[str] | None = None,
    mains_hz: float | None = None,
    replay: bool = True,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> MotorIdentification:
    """Identify stiffness, damping and inertia from motor signals; the command ``frf``.

    Parameters
    ----------
    campaign : path or Campaign
        What `rx90b_flex.excite` writes, with the logs of its motions.
    band_hz : (low, high)
        Lines used.
    controller : path, optional
        Controller file; else ``controller.toml`` beside the campaign, if there is one.
    link_mass_std : float
        Relative standard deviation of the links' masses; 0: known.
    bending_alike_std : float
        To which a joint is equally stiff about both its bending axes; 0: not assumed.
    hinge_std : float, or mapping of joint to float
        Standard deviation, m, along each axis, to which it is known where hinges that bend lie on their links; 0: known. The places
        are estimated, and what is not known of them is part of all intervals.
    references : path, optional
        Folder ``references`` of `rx90b_flex.excite`, where the logs lack the feed-forward torque.
    mains_hz : float, optional
        50 or 60, or any other frequency: what is within 0.2 Hz of it is taken out.
    replay : bool
        Whether the experiments are simulated to take out the distortion that friction makes.
    seed, jobs : int
        Of the grey box's starts; processes for the simulations.
    progress : callable, optional
        Called with a message and a fraction.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it. What fails later is in ``left_out`` of the result.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> found = rf.frf("runs/campaign.toml", replay=False)
    >>> found.robot.name
    'rx90b_3dof'
    >>> found.poses[0].measured.value.shape[1:]
    (3, 3)
    """
    from rx90b_flex.identify.frf_command import FrfOptions, identify_from_motors

    options = FrfOptions(
        band_hz, controller=None if controller is None else Path(controller), link_mass_std=link_mass_std,
        bending_alike_std=bending_alike_std, hinge_std=hinge_std, seed=seed,
        references=None if references is None else Path(references), mains_hz=mains_hz, replay=replay, jobs=jobs,
    )  # fmt: skip
    return identify_from_motors(campaign, options, progress)


def excite(
    robot: RobotSource,
    out: str | os.PathLike[str] | None = None,
    *,
    poses_deg: Sequence[Sequence[float]] = (),
    joints: Sequence[str] = (),
    matrix: Matrix = "ones",
    peak: Sequence[float] = (),
    band_hz: tuple[float, float] = (2.5, 80.0),
    period_s: float | None = None,
    realisations: int = 16,
    periods: int = 9,
    both_signs: bool = True,
    white: bool = False,
    controller: str | os.PathLike[str] | None = None,
    by: By = "torque",
    speed_peak: Sequence[float] = (),
    rate_hz: float | None = None,
    simulate: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[CampaignPlan, ...]:
    """Design the motions that `rx90b_flex.frf` needs; the command ``excite``.

    Parameters
    ----------
    robot : Robot, or what `load_robot` takes
    out : path, optional
        Folder for references, robot and campaign file; nothing is written where it is not given.
    poses_deg : sequence of poses, degrees
        One angle a joint, m where it slides; the horizontal arm where not given.
    joints : sequence of str
        Those that are excited; the first three where not given.
    matrix : ``ones``, ``hadamard`` or ``identity``
        Input matrix.
    peak : sequence of float, N m
        Largest feed-forward torque, one for all or one a joint; 10 % of the limits where not given.
    band_hz : (low, high)
        Odd lines between these are excited.
    period_s : float, optional
        The source's 4.096 s where not given.
    realisations, periods : int
        Multisines with other phases; periods of a run, of which the first is for the transient.
    both_signs : bool
        Whether each run is made again with the sign changed.
    white : bool
        Whether the drive torques are white.
    controller : path, optional
        For `white`, `simulate` and references that order torques.
    by : ``torque``, ``reference`` or ``both``
        What carries the excitation: torques that are fed forward, references that vibrate, or each half.
    speed_peak : sequence of float, rad/s
        Largest speed that is added to references, one for all or one a joint, where no controller file is given.
    rate_hz : float, optional
        Of the references; the controller file's where not given.
    simulate : bool
        Whether the logs are simulated and written, too.
    seed : int
    overwrite : bool
        Whether what is in the way in `out` is replaced.
    progress : callable, optional

    Returns
    -------
    tuple of Plan, one a pose

    Raises
    ------
    ValueError
        One line that names what does not fit.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> (plan,) = rf.excite("rx90b_3dof", "runs", realisations=2, periods=2, simulate=True)
    >>> plan.moving
    ('joint_1', 'joint_2', 'joint_3')
    """
    from rx90b_flex.robot import load_robot
    from rx90b_flex.simulate.excite import ExciteRequest, excitation_plans, excite_into
    from rx90b_flex.simulate.trajectories import PERIOD_S

    loaded = load_robot(robot)
    request = ExciteRequest(
        loaded.name, tuple(tuple(loaded.pose_of(pose)) for pose in poses_deg), tuple(joints), matrix, tuple(peak), band_hz,
        PERIOD_S if period_s is None else period_s, realisations=realisations, periods=periods, both_signs=both_signs, white=white,
        controller=None if controller is None else Path(controller), seed=seed, by=by, speed_peak=tuple(speed_peak), rate_hz=rate_hz,
    )  # fmt: skip
    if out is not None:
        excite_into(request, Path(out), simulate, progress or (lambda _text, _part: None), overwrite, loaded)
    return excitation_plans(request, loaded)


def check_path(
    path: Seam | str | os.PathLike[str],
    *,
    robot: RobotSource | None = None,
    tolerance_mm: float = 0.1,
    speed_mm_s: float | None = None,
    controller: str | os.PathLike[str] | None = None,
    correct: bool = True,
    contributions: bool = True,
    iterations: int = 10,
    jobs: int = 1,
    progress: Progress | None = None,
) -> PathCheck:
    """Check whether a robot's tip keeps to a path within a tolerance, why not, and correct it; the command ``check-path``.

    Parameters
    ----------
    path : Seam, path or str
        A path file, a table of points (with `speed_mm_s`), or an example: ``line``, ``square``.
    robot : optional
        The path file's, or the RX90B, where not given.
    tolerance_mm : float
        Largest deviation across the path.
    speed_mm_s : float, optional
        Instead of the path file's.
    controller : path, optional
    correct, contributions : bool
        Whether a corrected path is looked for; whether each effect is switched off in turn.
    iterations, jobs : int
        Of the correction, at most; processes for the effects' runs.
    progress : callable, optional

    Raises
    ------
    ValueError
        One line that names the file and key, or the place along the path and what is wrong there.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> checked = rf.check_path("square", robot="rx90b_3dof", speed_mm_s=250, correct=False, contributions=False)
    >>> checked.verdict
    'outside_tolerance'
    >>> checked.before.max_across > checked.options.tolerance_mm
    True
    """
    from rx90b_flex.path.check import PathOptions
    from rx90b_flex.path.check import check_path as checked
    from rx90b_flex.path.seam import ROBOT, Seam, load_seam
    from rx90b_flex.robot import load_robot
    from rx90b_flex.simulate.command import controller_of

    options = PathOptions(tolerance_mm, correct, contributions, iterations, jobs)
    seam = path if isinstance(path, Seam) else load_seam(str(path), speed_mm_s)
    loaded = load_robot(robot if robot is not None else seam.robot or ROBOT)
    for effect in loaded.effects:
        effect.known_coefficients()
    gains = controller_of(loaded, None if controller is None else Path(controller))
    return checked(seam, loaded, gains, options, progress)


def view(
    source: Robot | Simulation | Run | str | os.PathLike[str],
    beside: Simulation | Run | str | os.PathLike[str] | None = None,
    *,
    recording: str | None = None,
    magnify: float = 100.0,
    pose_deg: Sequence[float] | None = None,
    count: int = 6,
    flexible: bool = False,
    tip: str | None = None,
) -> View:
    """Show a robot bend: a run's motion, two runs beside each other, or a robot's mode shapes; the command ``view``.

    A notebook's cell shows what this returns; ``.open()`` shows it in the browser, ``.save_html(path)`` writes one file that opens
    offline.

    Parameters
    ----------
    source : Simulation, Run, Robot, path or str
        A folder of `rx90b-flex simulate` and a campaign file are runs; anything else is a robot.
    beside : optional
        A second run, shown as what came after.
    recording : str, optional
        Of a campaign; the first where not given.
    magnify : float
        Factor of the deformations.
    pose_deg : sequence of float, optional
        Drive angles of the mode shapes, degrees; m where a joint slides.
    count : int
        Mode shapes at most.
    flexible : bool
        Whether a robot that declares nothing flexible bends by stated default stiffnesses.
    tip : str, optional
        Frame that counts as the tip.

    Raises
    ------
    ValueError
        One line that names the file, robot or option; an option that what is shown has no use for.
    TypeError
        A source that is none of these.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> shown = rf.view("rx90b_3dof", pose_deg=[0, 90, 0], count=2)
    >>> shown.title
    'Modes of rx90b_3dof'
    """
    from rx90b_flex.robot import Robot
    from rx90b_flex.view.command import check_options, modes_of, run_of, view_of
    from rx90b_flex.view.meshcat import compare, show

    check_options(source, beside, recording=recording, pose_deg=pose_deg, flexible=flexible)
    if isinstance(source, Robot):
        return modes_of(source, pose_deg, count, flexible, tip)
    if isinstance(source, str | os.PathLike) and (beside is None or isinstance(beside, str | os.PathLike)):
        second = None if beside is None else str(beside)
        return view_of(
            str(source),
            second,
            recording=recording,
            magnify=magnify,
            pose=pose_deg,
            count=count,
            flexible=flexible,
            tip=tip,
        )
    run = run_of(source, recording, tip)
    return (
        show(run, magnify=magnify) if beside is None else compare(run, run_of(beside, recording, tip), magnify=magnify)
    )
