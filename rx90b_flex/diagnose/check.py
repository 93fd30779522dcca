"""Look at the data before anything is explained: columns, signs, units, times, and what the motion can tell."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from rx90b_flex.diagnose.faults.at_rest import AtRest
from rx90b_flex.diagnose.faults.clipped import clipped
from rx90b_flex.diagnose.faults.coarse import Coarse
from rx90b_flex.diagnose.faults.compare import Found, faults_of
from rx90b_flex.diagnose.faults.glitch import glitches
from rx90b_flex.diagnose.faults.look import Look, Motors
from rx90b_flex.diagnose.faults.repeated import repeated
from rx90b_flex.diagnose.faults.sample import Reading, Sample
from rx90b_flex.diagnose.faults.sensors import sensor_faults
from rx90b_flex.diagnose.faults.sizes import impossible_sizes
from rx90b_flex.diagnose.faults.speeds import speeds
from rx90b_flex.diagnose.faults.stated_load import stated_load
from rx90b_flex.diagnose.faults.stuck import (
    NEVER,
    frozen,
    moves,
    moves_within,
    no_excitation,
    not_measured,
    stuck,
    stuck_in_one,
)
from rx90b_flex.diagnose.faults.unrelated import unrelated
from rx90b_flex.diagnose.parameters import ParameterStatus, statuses, undeclared_basics
from rx90b_flex.diagnose.residual import noise_between_periods
from rx90b_flex.diagnose.torque_side import NOT_LOOKED_AT, TorqueSide, torque_side
from rx90b_flex.effects.motion import Mask
from rx90b_flex.files.toml import named_in
from rx90b_flex.identify.torque_scale import of_open_size, resolved
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals import Campaign, Recording, load_campaign, lowpass
from rx90b_flex.signals.data_fault import DataFault, DataFaultError
from rx90b_flex.signals.facts import counter_steps, found_period_s, repeats, sensible_cutoff_hz
from rx90b_flex.signals.stated import JOINT_SIDES

SCHEMA = 1
BY_MOTION = ("sample_rate", "kinematics", "time_shift")  # kinds that are told by velocities and accelerations
AT_REST = 0.01  # of a joint's fastest velocity in the recording: slower is at rest

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class RecordingFacts:
    """One recording as it is.

    Attributes
    ----------
    file, role : str
    duration_s, rate_hz : float
    at_rest : float
        Share of samples at which no joint moves.
    position_step_rad : float or None
        Coarsest step of the positions; None where they are not on a grid.
    period_s : float or None
        Of a motion that repeats, stated or found.
    stated_period_s : float or None
        What the campaign states and the motion contradicts.
    """

    file: str
    role: str
    duration_s: float
    rate_hz: float
    at_rest: float
    position_step_rad: float | None
    period_s: float | None
    stated_period_s: float | None = None


@dataclass(frozen=True, repr=False)
class Checked(Showing):
    """What a look at the data says; the content of ``check.json`` as attributes.

    Attributes
    ----------
    usable : bool
        Whether nothing was found that a model would have to explain away.
    recordings : tuple of RecordingFacts
    data_faults : tuple of DataFault
    parameters : tuple of ParameterStatus
        Empty where no fit was possible.
    undeclared_basics : tuple of str
        Effect types that every drive has and the robot file does not declare.
    robot : str
    joints : tuple of str
    relative_error : tuple of float
        Of the rigid model with basic friction, on rows held out, over the torque's standard deviation, a joint; everything that
        was found mended.
    cutoff_hz : float or None
        A sensible low-pass for this motion.
    noise_floor : tuple of float or None
        Root mean square noise of each torque after the campaign's low-pass, N m: what differs from period to period, or as
        stated; None where neither tells it.
    torque_side : TorqueSide
        On which side of the gears torques were measured.
    torque_unit : str
        Of the joints' torques, ``N`` among them where one slides.
    never_move : tuple of str
        Joints whose own parameters nothing tells.
    source : Path
        The campaign file.
    """

    usable: bool
    recordings: tuple[RecordingFacts, ...]
    data_faults: tuple[DataFault, ...]
    parameters: tuple[ParameterStatus, ...]
    undeclared_basics: tuple[str, ...]
    robot: str
    joints: tuple[str, ...]
    relative_error: tuple[float, ...]
    cutoff_hz: float | None
    never_move: tuple[str, ...]
    source: Path
    noise_floor: tuple[float, ...] | None = None
    torque_side: TorqueSide = NOT_LOOKED_AT
    torque_unit: str = "N m"

    @property
    def verdict(self) -> str:
        """In a sentence."""
        bad = [f for f in self.data_faults if not f.usable]
        if bad:
            more = len(self.data_faults) - len(bad)
            also = f", and {more} thing(s) to know about them" if more else ""
            return f"The data cannot be used as they are: {len(bad)} fault(s) found{also}."
        if self.data_faults:
            return f"The data can be used; {len(self.data_faults)} thing(s) to know about them."
        return "No fault was found in the data."


def check(
    source: str | os.PathLike[str] | Campaign,
    *,
    robot: Robot | str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Checked:
    """Look for what is wrong with a campaign's data, and say what its motion can tell.

    Columns exchanged, signs, units, torque gains, shifts in time, the sample rate, motors that another joint carries and the
    URDF's zeros, axes and lengths are hypotheses: each is a refit of the rigid model with basic friction, judged on rows that the
    fit did not see, against no fault and against each other. Clipped, frozen, damaged and repeated signals show in the log itself.

    Parameters
    ----------
    source : path or Campaign
        Of a file whose torque constants are left out, those that its data and the robot tell are used.
    robot : Robot, name or path, optional
        In place of the one that the campaign names.
    progress : callable, optional
        Called with a message and a fraction.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> checked = rf.check("campaign.toml")
    >>> checked.usable
    True
    """
    with threadpool_limits(limits=1, user_api="blas"):
        return _checked(source, robot, progress or (lambda _text, _part: None))


def _checked(
    source: str | os.PathLike[str] | Campaign, robot: Robot | str | os.PathLike[str] | None, tell: Progress
) -> Checked:
    tell("reading", 0.0)
    if isinstance(source, Campaign):
        campaign = source
    else:
        try:
            campaign = load_campaign(Path(source))
        except ValueError as error:
            return _refused(Path(source), error)
    robot = _robot(campaign, robot)
    with named_in(campaign.path, "joints"):
        rigid = robot.rigid().restricted(campaign.joints)
    if not isinstance(source, Campaign) and None in (campaign.torque_constants or ()):
        # one that is handed in has its torques as its owner wants them; what is wrong with others may keep them from being told
        with contextlib.suppress(ValueError, np.linalg.LinAlgError):
            campaign = of_open_size(*resolved(campaign, robot))
    tell("looking at the signals", 0.1)
    faults, mended = glitches(campaign.recordings)
    still = no_excitation(mended)
    faults += [*repeated(mended), *still]
    moving = moves(mended) > NEVER
    constant = not_measured(mended)
    parameters: tuple[ParameterStatus, ...] = ()
    basics: tuple[str, ...] = ()
    errors: tuple[float, ...] = ()
    side = TorqueSide(campaign.torque_side, None, "")
    if all(f.usable for f in still) and not constant.all():
        tell("comparing what may be wrong with it", 0.3)
        look, faults = _compared(campaign, mended, rigid, faults, constant)
        errors = tuple(float(x) for x in np.sqrt(look.fit().error))
        tell("looking at what the motion can tell", 0.9)
        side = torque_side(campaign.torque_side, look, faults, moving, _of_open_size(campaign))
        parameters = statuses(look, rigid, moving)
        basics = undeclared_basics(look, rigid, moving)
    else:
        faults += [*clipped(mended), *frozen(mended)]
    if constant.all():
        faults += unrelated(campaign.joints, np.ones(len(constant)), np.ones(len(constant)), constant, constant)
    faults += speeds(mended, faults)
    facts = tuple(_facts(r) for r in mended)
    tell("done", 1.0)
    return Checked(
        all(f.usable for f in faults),
        facts,
        tuple(faults),
        parameters,
        basics,
        robot.name,
        campaign.joints,
        errors,
        sensible_cutoff_hz(mended),
        tuple(j for j, m in zip(campaign.joints, moving, strict=True) if not m),
        campaign.path,
        _noise_floor(campaign, mended, facts),
        side,
        robot.force_unit(campaign.joints),
    )


def _compared(
    campaign: Campaign, recordings: Sequence[Recording], rigid: Robot, faults: list[DataFault], constant: Mask
) -> tuple[Look, list[DataFault]]:
    """What may be wrong beside what shows in the log itself, and the look at the data with it mended."""
    other_load, look = stated_load(_look(campaign, recordings, rigid))
    found, look = faults_of(look)
    if any(f.kind == "glitch" and f.signal == "motor_position" and not f.usable for f in faults):
        # of motions that step, velocities and accelerations say little
        found = tuple(f for f in found if f.hypothesis.kind not in BY_MOTION)
    coarse = Coarse(look, recordings)
    faults = [*faults, *clipped(recordings, coarse), *frozen(recordings, coarse), *map(_fault, found)]
    goes = moves_within(recordings) > NEVER
    lost = unrelated(campaign.joints, *look.errors_at_least(), goes, constant)
    faults += [*impossible_sizes(look, [*faults, *lost]), *([other_load] if other_load else [])]
    faults = [f for f in faults if not _gain_is_open(f, campaign)]
    at_rest = AtRest.of(look, recordings)
    faults += [*stuck(recordings, np.sqrt(look.fit().error), at_rest), *stuck_in_one(recordings, look, at_rest)]
    return look, [f for f in faults if not _of_no_use(f, lost, campaign.joints)] + lost + sensor_faults(campaign)


def _robot(campaign: Campaign, given: Robot | str | os.PathLike[str] | None) -> Robot:
    if given is not None:
        return load_robot(given)
    with named_in(campaign.path, "robot"):
        return load_robot(campaign.robot_source)


def _look(campaign: Campaign, recordings: Sequence[Recording], robot: Robot) -> Look:
    at = np.array([robot.layout.index(j) for j in campaign.joints])
    tree = robot.tree
    limits = np.array([tree.lowerPositionLimit, tree.upperPositionLimit])[:, at]
    slides = dict(zip(robot.joints, (unit.slides for unit in robot.units), strict=True))
    return Look(
        Sample.of(campaign, recordings),
        Reading.of(robot, len(campaign.joints), len(recordings)),
        limits,
        tuple(slides[j] for j in campaign.joints),
        _motors(campaign),
    )


def _motors(campaign: Campaign) -> Motors | None:
    if campaign.gear_matrix is None:
        return None
    return Motors(np.array(campaign.gear_matrix), np.array(campaign.offset), campaign.torque_side not in JOINT_SIDES)


def _fault(found: Found) -> DataFault:
    h = found.hypothesis
    before, after = (float(np.sqrt(np.minimum(f.error, 1.0).mean())) for f in (found.before, found.after))
    return DataFault(h.kind, h.signal, h.joints, h.message, h.usable, before, after, factor=h.factor, std=found.std)


def _gain_is_open(fault: DataFault, campaign: Campaign) -> bool:
    """Whether it is about the size of torques whose constant is left out."""
    of_size = fault.signal == "torque" and fault.kind in ("torque_gain", "unit")
    return of_size and set(fault.joints) <= _of_open_size(campaign)


def _of_open_size(campaign: Campaign) -> set[str]:
    """Joints whose torque is a current, its constant left out."""
    stated = campaign.torque_constants or (1.0,) * len(campaign.joints)
    return {j for j, constant in zip(campaign.joints, stated, strict=True) if constant is None}


def _of_no_use(fault: DataFault, lost: Sequence[DataFault], joints: Sequence[str]) -> bool:
    """Whether a hypothesis is about joints alone whose torque has nothing to do with the motion even if it holds."""
    return fault.error_after is not None and set(fault.joints or joints) <= {j for f in lost for j in f.joints}


def _refused(path: Path, error: ValueError) -> Checked:
    """A campaign that cannot be read because of a fault that has a name; other bad input stays bad input."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, DataFaultError):
        cause = cause.__cause__
    if cause is None:
        raise error
    fault = dataclasses.replace(cause.fault, message=str(error))
    return Checked(False, (), (fault,), (), (), "", (), (), None, (), path)


# ---- recordings -------------------------------------------------------------------------------------------------


def _facts(recording: Recording) -> RecordingFacts:
    # a fiftieth of a second at a time: a slow joint's counter steps only now and then
    window = max(1, round(0.02 * recording.sample_rate_hz))
    speed = np.abs(recording.position[window:] - recording.position[:-window])
    stated = recording.period_s
    wrong = stated if stated is not None and not repeats(recording, stated) else None
    resting = (speed <= AT_REST * np.maximum(speed.max(axis=0, initial=0.0), 1e-12)).all(axis=1)
    return RecordingFacts(
        recording.file_name,
        recording.role,
        recording.duration_s,
        recording.sample_rate_hz,
        float(resting.mean()) if len(resting) else 1.0,
        float(counter_steps(recording.position).max(initial=0.0)) or None,
        found_period_s(recording) if wrong or stated is None else stated,
        wrong,
    )


def _noise_floor(
    campaign: Campaign, recordings: Sequence[Recording], facts: Sequence[RecordingFacts]
) -> tuple[float, ...] | None:
    both = zip(recordings, facts, strict=True)
    repeating = [dataclasses.replace(r, period_s=f.period_s) for r, f in both if f.period_s is not None]
    cutoff = campaign.cutoff_hz
    torques = [r.torque if cutoff is None else lowpass(r.torque, cutoff, r.sample_rate_hz) for r in repeating]
    floor = noise_between_periods(repeating, torques, campaign)
    return None if floor is None else tuple(float(x) for x in floor)


# ---- as JSON ----------------------------------------------------------------------------------------------------


def check_json(checked: Checked) -> dict[str, Any]:
    """The content of ``check.json``, schema 1."""
    return {
        "schema": SCHEMA,
        "usable": checked.usable,
        "recordings": [dataclasses.asdict(r) for r in checked.recordings],
        "data_faults": faults_json(checked.data_faults),
        "parameters": [dataclasses.asdict(p) for p in checked.parameters],
        "undeclared_basics": list(checked.undeclared_basics),
        "relative_error": list(checked.relative_error),
        "sensible_cutoff_hz": checked.cutoff_hz,
        "noise_floor": None if checked.noise_floor is None else {"torque_rms": list(checked.noise_floor)},
        "torque_side": dataclasses.asdict(checked.torque_side),
        "never_move": list(checked.never_move),
    }


def faults_json(faults: Sequence[DataFault]) -> list[dict[str, Any]]:
    """Faults as ``check.json`` and ``closed_loop.json`` have them."""
    out = []
    for fault in faults:
        entry = dataclasses.asdict(fault)
        entry["joints"], entry["rows"] = list(fault.joints), list(fault.rows)
        out.append(entry)
    return out
