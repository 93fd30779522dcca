"""Simulated campaigns: many experiments as one job, saved run by run, resumed where they were interrupted.

A plan lists its runs in order: realisations, columns of the input matrix, both signs. Each run's excitation and noise come from
seeds that depend on the plan's seed and the run's place alone, so that neither batches nor workers change them. Batches of runs go
through `joblib.Parallel`: its Dask or Ray backend carries them over several machines, which must see the same folder.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import joblib
import numpy as np

from rx90b_flex.compiled.compile import told_of_compiling
from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation import minus_below_first, multisine
from rx90b_flex.excitation.multisine import Crest
from rx90b_flex.export import save_robot
from rx90b_flex.files.toml import toml_text
from rx90b_flex.robot import Robot
from rx90b_flex.signals import save_recording
from rx90b_flex.signals.folders import claim, claimed
from rx90b_flex.signals.recording import SIGNALS, Recording, Role
from rx90b_flex.signals.tables import write_whole
from rx90b_flex.simulate.closed_loop import CHUNK_S, Noise, Simulation, simulate_lanes
from rx90b_flex.simulate.cs8 import CS8, ComplexArray, save_cs8
from rx90b_flex.simulate.perturbation import Manipulator, perturb_lanes, steps_bytes
from rx90b_flex.simulate.trajectories import (
    FEEDFORWARD_LINES,
    FEEDFORWARD_PEAK,
    PERIOD_S,
    Trajectory,
    horizontal,
    square_wave,
)

Method = Literal["nonlinear", "perturbation"]
By = Literal["torque", "reference", "both"]
Progress = Callable[[str, float], None]

BATCH_RUNS, BATCH_BYTES = 48, 1e9  # of a worker, at most, unless the caller says otherwise
PLAN_FILE = "plan.json"
RUNS = "runs"
LOGGED = tuple(s.key for s in SIGNALS if not s.always_joint_side)  # by a simulated controller


@dataclass(frozen=True)
class RunKey:
    """Place of a run in its plan: realisation, experiment (column of the input matrix), sign."""

    realisation: int
    experiment: int
    sign: int

    @property
    def name(self) -> str:
        """Of the run, its recording and its file."""
        return f"run_{self.realisation:03d}_{self.experiment + 1}_{'plus' if self.sign > 0 else 'minus'}"


@dataclass(frozen=True, eq=False)
class CampaignPlan:
    """Experiments on one robot about one motion (section 6.6.2).

    The torque fed forward in realisation m, experiment k, sign s is ``s * input_matrix[j, k] * multisine_m(t)`` on moving joint j.
    A controller without an input for it (`by`) is asked for a vibration of the references that makes it order the same torque.

    Attributes
    ----------
    robot : Robot
    controller : CS8
    reference : Trajectory
        One period of the references; what it feeds forward is not used.
    moving : tuple of str
        Joints that the input matrix's rows belong to.
    input_matrix : tuple of tuples of float
        Rows are joints, columns experiments.
    by : str
        What carries the excitation: ``torque``, ``reference``, or ``both``, each half of it.
    speeds : tuple of float, rad/s
        Largest speed that is added to each moving joint's reference, its multisine one of speed; for controllers that nobody knows.
        Empty: the references make `controller` order the torques.
    lines : tuple of int
        Of the multisine: whole cycles in the period.
    peak : float
        Of the multisine, N m.
    crest : str
        How its peak is lowered, see `rx90b_flex.excitation.multisine`; the source clips, ``lp`` lowers it further.
    amplitudes : tuple of float, or one such tuple a moving joint, or None
        Its spectrum, up to a factor, one number a line; None is flat. With one a joint, each joint has its own phases too.
    signs : tuple of int
        1, -1 or both.
    realisations, validation : int
        Phase realisations of the multisine; the last `validation` of them have that role in the campaign file.
    periods : int
        Of each run, the first one in which the transient dies included.
    noise : Noise
    seed : int
    method : str
        ``nonlinear`` or ``perturbation``.
    manipulator : str
        ``moving``, or for the perturbation method ``frozen``: see `rx90b_flex.simulate.perturbation.perturb_lanes`.
    """

    robot: Robot
    controller: CS8
    reference: Trajectory
    moving: tuple[str, ...]
    input_matrix: tuple[tuple[float, ...], ...]
    lines: tuple[int, ...] = FEEDFORWARD_LINES
    peak: float = FEEDFORWARD_PEAK
    crest: Crest = "lp"
    amplitudes: tuple[float, ...] | tuple[tuple[float, ...], ...] | None = None
    by: By = "torque"
    speeds: tuple[float, ...] = ()
    signs: tuple[int, ...] = (1, -1)
    realisations: int = 16
    validation: int = 0
    periods: int = 9
    noise: Noise = dataclasses.field(default_factory=Noise)
    seed: int = 0
    method: Method = "nonlinear"
    manipulator: Manipulator = "moving"

    def __post_init__(self) -> None:
        if self.by not in get_args(By):
            raise ValueError(f"by is {self.by!r}; expected {', '.join(get_args(By))}")
        if self.by != "torque" and set(self.signs) != {1, -1}:
            raise ValueError(f"excitation by {self.by} needs both signs: only they tell it from the motion")
        shape = np.shape(self.input_matrix)
        if len(shape) != 2 or shape[0] != len(self.moving) or shape[1] < 1:
            raise ValueError(f"input_matrix has shape {shape}; expected {len(self.moving)} rows, one a moving joint")
        for joint in self.moving:
            if joint not in self.robot.joints:
                raise ValueError(f"moving joint {joint!r} is none of {', '.join(self.robot.joints)}")
        if not self.signs or not set(self.signs) <= {1, -1}:
            raise ValueError(f"signs are {self.signs}; expected 1, -1 or both")
        if self.periods < 1 or not 0 <= self.validation < self.realisations:
            raise ValueError(
                f"{self.realisations} realisations, {self.validation} of validation, {self.periods} periods; "
                "expected one or more of identification, and one or more periods"
            )
        if self.method not in ("nonlinear", "perturbation"):
            raise ValueError(f"method is {self.method!r}; expected 'nonlinear' or 'perturbation'")
        if self.manipulator != "moving" and (self.manipulator, self.method) != ("frozen", "perturbation"):
            raise ValueError(
                f"manipulator is {self.manipulator!r}; expected 'moving', or 'frozen' with the perturbation method"
            )

    def __getstate__(self) -> dict[str, object]:
        # to another process without what the robot has worked out: addresses of compiled laws mean nothing there
        return {**self.__dict__, "robot": dataclasses.replace(self.robot)}

    @property
    def runs(self) -> tuple[RunKey, ...]:
        """All runs, in order."""
        experiments = range(len(self.input_matrix[0]))
        return tuple(RunKey(m, k, s) for m in range(self.realisations) for k in experiments for s in self.signs)

    @property
    def digest(self) -> str:
        """Of everything that decides the results, hexadecimal."""
        text = [self.robot.urdf, self.robot.tip_frame, repr(self.robot.effects), repr(self.controller)]
        # a folder that was begun before there was this choice goes on
        usual = {"manipulator"} if self.manipulator == "moving" else set()
        usual |= {"by", "speeds"} if self.by == "torque" else set()
        text += [repr((f.name, getattr(self, f.name))) for f in dataclasses.fields(self)[3:] if f.name not in usual]
        text += [repr((self.reference.joints, self.reference.rate_hz, self.reference.period_s))]
        state = hashlib.sha256("\n".join(text).encode())
        for array in (self.reference.position, self.reference.velocity):
            state.update(np.ascontiguousarray(array).tobytes())
        return state.hexdigest()

    def role(self, key: RunKey) -> Role:
        """Of a run in the campaign file."""
        return "validation" if key.realisation >= self.realisations - self.validation else "identification"

    def trajectory(self, key: RunKey) -> Trajectory:
        """References and feed-forward torques of a run."""
        return self.period(key).repeated(self.periods)

    def period(self, key: RunKey) -> Trajectory:
        """One period of them."""
        return self._carried(self.torque(key), key.name)

    def torque(self, key: RunKey) -> Array:
        """One period of the torque that a run is to bring about, whatever carries it, (N, joints), N m."""
        samples = len(self.reference.position)
        waves = _waves(self.lines, samples, self.peak, self.crest, self.amplitudes, self.seed, key.realisation)
        feedforward = np.zeros((samples, len(self.robot.joints)))
        for place, (joint, row) in enumerate(zip(self.moving, self.input_matrix, strict=True)):
            wave = waves[:, place % waves.shape[1]]
            feedforward[:, self.robot.joints.index(joint)] = key.sign * row[key.experiment] * wave
        return feedforward

    def _carried(self, torque: Array, name: str) -> Trajectory:
        """One period of references and torques that bring about a torque (N, joints)."""
        if self.by == "torque":
            return self.reference.with_feedforward(torque, name)
        share = 1.0 if self.by == "reference" else 0.5
        samples = len(torque)
        hz = np.arange(1.0, samples // 2 + 1) * (self.reference.rate_hz / samples)
        added = self._references_over_torque(hz) * np.asarray(np.fft.rfft(share * torque, axis=0)[1:])
        rest = np.zeros((1, torque.shape[1]))
        position, velocity = (
            np.fft.irfft(np.vstack([rest, x]), samples, axis=0) for x in (added, 2j * np.pi * hz[:, None] * added)
        )
        return dataclasses.replace(
            self.reference,
            name=name,
            position=self.reference.position + position,
            velocity=self.reference.velocity + velocity,
            feedforward=(1.0 - share) * torque,
        )

    def _references_over_torque(self, hz: Array) -> ComplexArray:
        """What takes the place of a torque in the references, (F, joints), rad per N m."""
        if not self.speeds:
            return np.asarray(1.0 / self.controller.for_joints(self.robot.joints).by_references(hz))
        largest = self.peak * np.abs(np.asarray(self.input_matrix)).max(axis=1)
        over = np.zeros(len(self.robot.joints))
        over[[self.robot.joints.index(j) for j in self.moving]] = np.asarray(self.speeds) / largest
        return np.asarray(over / (2j * np.pi * hz[:, None]))

    def generator(self, key: RunKey) -> np.random.Generator:
        """For the noise of a run, whatever runs beside it."""
        place = self.runs.index(key)
        # millions of numbers a run: the fastest of numpy's bit generators
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence(self.seed, spawn_key=(1, place))))


def section_662(robot: Robot, controller: CS8, **changes: object) -> CampaignPlan:
    """The 96 runs of section 6.6.2: three joints, orthogonal inputs (6.50), both signs, 16 realisations, 9 periods.

    Parameters
    ----------
    changes : fields of `Plan` to replace.
    """
    moving = robot.joints[:3]
    matrix = tuple(tuple(float(x) for x in row) for row in minus_below_first(len(moving)))
    plan = CampaignPlan(robot, controller, square_wave(robot, horizontal(robot), moving=moving), moving, matrix)
    return dataclasses.replace(plan, **changes)  # type: ignore[arg-type]


@functools.lru_cache(maxsize=64)
def _waves(
    lines: tuple[int, ...],
    samples: int,
    peak: float,
    crest: Crest,
    amplitudes: tuple[float, ...] | tuple[tuple[float, ...], ...] | None,
    seed: int,
    realisation: int,
) -> Array:
    """One multisine for all joints, or one a joint, shape (samples, 1 or joints); the same for all runs of a realisation."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, realisation)))
    spectra = [None] if amplitudes is None else np.atleast_2d(np.asarray(amplitudes))
    waves = [multisine(lines, samples, peak, rng, amplitudes=spectrum, crest=crest) for spectrum in spectra]
    return np.hstack(waves)


# ---- running --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Failure:
    """A run that is not in the campaign, and why."""

    run: str
    reason: str


@dataclass(frozen=True)
class CampaignResult:
    """What a campaign came to.

    Attributes
    ----------
    file : Path or None
        The campaign file; None where no run succeeded.
    done : names of all runs that are on disk.
    resumed : names of those that were there before.
    failed : runs that ended early or raised, with their reasons. They are tried again when the campaign is run again.
    """

    file: Path | None
    done: tuple[str, ...]
    resumed: tuple[str, ...]
    failed: tuple[Failure, ...]


def run_campaign(
    plan: CampaignPlan,
    folder: str | os.PathLike[str],
    *,
    jobs: int = 1,
    batch: int | None = None,
    progress: Progress | None = None,
) -> CampaignResult:
    """Simulate all runs of a plan into a folder; runs that are there already are kept.

    Parameters
    ----------
    plan : Plan
    folder : path
        Receives ``runs/*.parquet``, the robot, the controller, ``plan.json`` and, at the end, ``campaign.toml``.
    jobs : int
        Workers, as `joblib.Parallel` counts them; inside ``joblib.parallel_config(backend="dask")`` those of the cluster.
    batch : int, optional
        Runs that one worker advances together; by default all, shared evenly among the workers, 48 at most, and no more than take
        1 GB by `batch_bytes`, which bounds a worker's arrays; the interpreter and its libraries come on top.
    progress : callable, optional
        Called with a text and the part that is done.

    Raises
    ------
    ValueError
        The folder holds another plan's runs.
    """
    folder = Path(folder)
    _claim(plan, folder)
    (folder / RUNS).mkdir(exist_ok=True)
    # files appear whole or not at all, and the plan's digest says that they are this plan's
    resumed = tuple(key for key in plan.runs if _file(folder, key).is_file())
    missing = [key for key in plan.runs if key not in set(resumed)]
    tell = progress or (lambda text, part: None)
    count = len(plan.runs)
    done, failed = list(resumed), []
    tell(f"{len(done)} of {count} runs", len(done) / count)
    share = -(-len(missing) // max(joblib.effective_n_jobs(jobs), 1))
    size = batch or max(1, min(share, BATCH_RUNS, _runs_in(plan, BATCH_BYTES)))
    batches = [tuple(missing[i : i + size]) for i in range(0, len(missing), size)]
    work = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(simulate_batch)(plan, keys, folder) for keys in batches
    )
    # workers of their own do not tell
    with told_of_compiling(lambda: tell("compiling, once on this machine", len(done) / count)):
        for finished in work:
            for key, reason in finished:
                if reason is None:
                    done.append(key)
                else:
                    failed.append(Failure(key.name, reason))
            tell(f"{len(done)} of {count} runs", (len(done) + len(failed)) / count)
    present = set(done)
    kept = [key for key in plan.runs if key in present]
    names = tuple(key.name for key in kept)
    file = _write_campaign_file(plan, kept, folder) if any(plan.role(k) == "identification" for k in kept) else None
    return CampaignResult(file, names, tuple(k.name for k in resumed), tuple(failed))


def batch_bytes(plan: CampaignPlan, runs: int) -> float:
    """Bound of the memory of a batch's arrays, bytes.

    A run has, at the log's rate, 2 n states, their work and dissipation, three signals a joint and the time; at the references'
    rate three signals a joint; and at the controller's rate, for 0.256 s, its signals, noise and the filter's memory, 13 numbers a
    joint. The perturbation method adds the steps of the nominal motion, which all runs share.
    """
    n, joints, controller = plan.robot.model.nv, len(plan.robot.joints), plan.controller
    seconds = plan.reference.duration_s * plan.periods
    states = seconds * controller.log_rate_hz * (2 * n + 3 * joints + 3)
    references = seconds * controller.reference_rate_hz * 3 * joints
    chunk = (min(CHUNK_S, seconds) * controller.controller_rate_hz) * 13 * joints
    shared = steps_bytes(plan.robot, controller, plan.reference) if plan.method == "perturbation" else 0.0
    return 8.0 * runs * (states + references + chunk) + shared


def _runs_in(plan: CampaignPlan, limit: float) -> int:
    """How many runs a batch may have to stay below a memory, bytes."""
    shared = batch_bytes(plan, 0)
    return int(max(limit - shared, 0.0) // (batch_bytes(plan, 1) - shared))


def simulate_batch(plan: CampaignPlan, keys: Sequence[RunKey], folder: Path) -> list[tuple[RunKey, str | None]]:
    """Simulate some runs together and save each; what a worker does. Returns each run with None or why it failed."""
    try:
        runs = _simulate(plan, keys)
    except Exception as error:
        if len(keys) == 1:
            return [(keys[0], _one_line(error))]
        # one of them cannot be simulated: find out which
        return [result for key in keys for result in simulate_batch(plan, [key], folder)]
    out: list[tuple[RunKey, str | None]] = []
    for key, run in zip(keys, runs, strict=True):
        reason = run.ended
        if reason is None:
            try:
                save_recording(run.recording, _file(folder, key))
            except (OSError, ValueError) as error:
                reason = _one_line(error)
        out.append((key, reason))
    return out


def _simulate(plan: CampaignPlan, keys: Sequence[RunKey]) -> list[Simulation]:
    trajectories = [plan.trajectory(key).with_tail() for key in keys]
    noisy = any(np.any(getattr(plan.noise, f.name)) for f in dataclasses.fields(plan.noise))
    noise = plan.noise if noisy else None
    rng = _Spawned([plan.generator(key) for key in keys])
    if plan.method == "perturbation":
        runs = perturb_lanes(
            plan.robot, plan.controller, trajectories, noise=noise, rng=rng, manipulator=plan.manipulator
        )
    else:
        runs = simulate_lanes(plan.robot, plan.controller, trajectories, noise=noise, rng=rng)
    return [dataclasses.replace(run, recording=_without_tail(plan, run.recording)) for run in runs]


def _without_tail(plan: CampaignPlan, recording: Recording) -> Recording:
    if plan.reference.period_s is None:
        return recording
    count = round(plan.periods * plan.reference.period_s * recording.sample_rate_hz)
    logged = {s.field: x[:count] for s in SIGNALS if (x := getattr(recording, s.field)) is not None}
    return dataclasses.replace(recording, time=recording.time[:count], **logged)


class _Spawned(np.random.Generator):
    """A generator whose children are given: each lane gets its own run's."""

    def __init__(self, children: list[np.random.Generator]) -> None:
        super().__init__(np.random.PCG64(0))
        self.children = children

    def spawn(self, n_children: int) -> list[np.random.Generator]:
        """The given generators."""
        if n_children != len(self.children):
            raise ValueError(f"{n_children} generators asked for, there are {len(self.children)}")
        return self.children


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


# ---- files ----------------------------------------------------------------------------------------------------


def _file(folder: Path, key: RunKey) -> Path:
    return folder / RUNS / f"{key.name}.parquet"


def _claim(plan: CampaignPlan, folder: Path) -> None:
    """Make the folder this plan's, or refuse it."""
    found = claimed(folder, PLAN_FILE, RUNS)
    if found is not None:
        if found != plan.digest:
            raise ValueError(
                f"{folder}: holds runs of another plan ({PLAN_FILE}); give another folder or empty this one"
            )
        return
    if (folder / RUNS).exists():
        raise ValueError(f"{folder}: has a folder {RUNS!r} but no {PLAN_FILE}; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(plan.robot, folder, allow_inconsistent=True)
    save_cs8(plan.controller, folder / "controller.toml")
    summary = {
        "robot": plan.robot.name,
        "method": plan.method,
        "runs": [key.name for key in plan.runs],
        "periods": plan.periods,
        "seed": plan.seed,
    }
    claim(folder, PLAN_FILE, plan.digest, summary)


def _write_campaign_file(plan: CampaignPlan, keys: Sequence[RunKey], folder: Path) -> Path:
    """`campaign.toml` for the runs on disk; of each the first period, in which the transient dies, is left out."""
    runs = [RunFile(f"{RUNS}/{key.name}.parquet", plan.role(key)) for key in keys]
    file = folder / "campaign.toml"
    write_whole(file, lambda part: part.write_text(campaign_text(plan, runs), encoding="utf-8"))
    return file


@dataclass(frozen=True)
class RunFile:
    """A recording of a campaign file: its file, relative to it, and its role."""

    file: str
    role: Role


def campaign_text(plan: CampaignPlan, runs: Sequence[RunFile], signals: Sequence[str] = LOGGED) -> str:
    """Text of a campaign file of a plan's recordings; the first period of each, in which the transient dies, is left out.

    Parameters
    ----------
    signals : those that the recordings have, by their keys in a campaign file.
    """
    joints, controller = plan.robot.joints, plan.controller
    period = plan.reference.period_s or PERIOD_S
    torque_noise = np.broadcast_to(plan.noise.torque, len(joints))
    # the anti-alias filter keeps the part below its cutoff
    kept = np.sqrt(2.0 * controller.log_cutoff_hz / controller.controller_rate_hz)
    start = period if plan.periods > 1 else None
    return toml_text(
        {
            "robot": "robot.toml",
            "sample_rate_hz": controller.log_rate_hz,
            "joints": joints,
            "signals": {s.key: [f"{s.prefix}_{j}" for j in joints] for s in SIGNALS if s.key in signals},
            "noise": {"torque_rms": kept * torque_noise} if np.any(torque_noise) else None,
            "recording": [{"file": r.file, "role": r.role, "start_s": start, "period_s": period} for r in runs],
        }
    )
