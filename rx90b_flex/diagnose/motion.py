"""What the added effects do to the motion: the closed loop simulated with the model before and after, against the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rx90b_flex.diagnose.close import ClosedLoop
from rx90b_flex.diagnose.identified import identified_robot
from rx90b_flex.diagnose.refused import RefusedLoop
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Recording
from rx90b_flex.simulate.closed_loop import Simulation, simulate, tip_poses
from rx90b_flex.simulate.cs8 import CS8, own_controller
from rx90b_flex.simulate.trajectories import from_recording

LONGEST_S = 10.0  # simulated of a recording
LONGEST_SLOW_S = 3.0  # where an effect has no compiled law: a second then takes about two to simulate


class BeforeAfter(NamedTuple):
    """A number, or an array, of the model before and after."""

    before: Any
    after: Any


@dataclass(frozen=True, eq=False)
class MotionErrors:
    """Simulated motion less measured motion of one validation recording, root mean squares, both under the same references.

    Attributes
    ----------
    recording : str
    seconds : float
        Simulated and compared.
    motor_rms_mrad : two arrays, shape (joints,)
        Of the motor angle seen through the gears.
    link_rms_mrad : two arrays, shape (joints,), or None
        Of the angle behind the gears, where that was measured.
    tip_rms_mm : two floats or None
        Distance of the tip from where the measured link angles put it, hinges straight.
    tip_apart_rms_mm : float
        Distance between the tips of the two simulations.
    of_s : float
        Length of the recording; a part is simulated where it is long, a shorter one where effects make that slow.
    """

    recording: str
    seconds: float
    motor_rms_mrad: BeforeAfter
    link_rms_mrad: BeforeAfter | None
    tip_rms_mm: BeforeAfter | None
    tip_apart_rms_mm: float
    of_s: float

    def as_json(self) -> dict[str, Any]:
        """The content of ``motion.json``, but for its schema."""
        pairs = {name: getattr(self, name) for name in ("motor_rms_mrad", "link_rms_mrad", "tip_rms_mm")}
        return {
            "recording": self.recording,
            "seconds": self.seconds,
            **{
                name: pair and {when: np.asarray(x).tolist() for when, x in pair._asdict().items()}
                for name, pair in pairs.items()
            },
            "tip_apart_rms_mm": self.tip_apart_rms_mm,
        }


def motion_errors(result: ClosedLoop | RefusedLoop) -> MotionErrors | str | None:
    """Simulate the closed loop before and after; a sentence that says why where it cannot be done, None where nothing was fitted.

    The robot before is the declared one with its identified values, the robot after has the effects added; both with the
    flexibilities as declared. The references are those of the log, the controller is the one that the robot's file states.
    """
    if isinstance(result, RefusedLoop):
        return None
    recording = next((r for r in result.campaign.validation if r.reference_position is not None), None)
    if recording is None or recording.reference_velocity is None:
        return "The validation recordings hold no references, so the closed loop cannot be simulated against them."
    try:
        robots = [identified_robot(result.source, m, result.joints) for m in (result.declared, result.model)]
        controller = own_controller(robots[0])
        if controller is None:
            return f"The controller of {result.robot} is not known, so its closed loop cannot be simulated."
        seconds = LONGEST_SLOW_S if any(_is_slow(robot) for robot in robots) else LONGEST_S
        before, after = (_simulated(robot, controller, recording, seconds) for robot in robots)
    except ValueError as error:
        return f"The closed loop could not be simulated: {error}."
    for run, which in ((before, "before"), (after, "after")):
        if run.ended is not None:
            return f"The simulation {which} ended early: {run.ended}."
    return _compared(before, after, recording)


def _is_slow(robot: Robot) -> bool:
    """Whether a simulation steps outside its compiled loop for some of the effects."""
    rest = np.zeros(robot.model.nv)
    motion = robot.motion(rest, rest, rest)
    return robot.plant.wide is None or any(e.laws(motion) is None for e in robot.effects if not e.traits.in_dynamics)


def _simulated(robot: Robot, controller: CS8, recording: Recording, seconds: float) -> Simulation:
    trajectory = from_recording(recording)
    if trajectory.duration_s > seconds:
        trajectory = trajectory.part(0.0, seconds)
    return simulate(robot, controller.for_joints(robot.joints), trajectory)


def _compared(before: Simulation, after: Simulation, recording: Recording) -> MotionErrors:
    count, rate = min(len(before.time), len(after.time), recording.samples), recording.sample_rate_hz
    runs, robot, links = (before, after), after.robot, recording.link_position

    def off(measured: Array, simulated: Array) -> Array:
        return np.asarray(1e3 * np.sqrt(((simulated[:count] - measured[:count]) ** 2).mean(axis=0)))

    motor = BeforeAfter(*(off(recording.position, run.recording.position) for run in runs))
    link = tip = None
    if links is not None:
        seen = [off(links, run.recording.link_position) for run in runs if run.recording.link_position is not None]
        link = BeforeAfter(*seen) if len(seen) == len(runs) else None
        there = tip_poses(robot.tree, robot.tip_frame, links[:count])
        tip = BeforeAfter(*(_distance_mm(run.tip[:count], there) for run in runs))
    apart = _distance_mm(before.tip[:count], after.tip[:count])
    return MotionErrors(recording.name, count / rate, motor, link, tip, apart, recording.samples / rate)


def _distance_mm(one: Array, other: Array) -> float:
    """Root mean square distance of two paths of poses, (N, 4, 4)."""
    return float(1e3 * np.sqrt(((one[:, :3, 3] - other[:, :3, 3]) ** 2).sum(axis=1).mean()))
