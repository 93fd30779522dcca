"""What the added effects do to the motion: the closed loop simulated with the model before and after, against the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True, eq=False)
class MotionErrors:
    """Simulated motion less measured motion of one validation recording, both under the same references.

    Attributes
    ----------
    recording : str
    seconds : float
        Simulated and compared.
    motor_before_mrad, motor_after_mrad : array, shape (joints,)
        Root mean square, of the motor angle seen through the gears.
    link_before_mrad, link_after_mrad : array, shape (joints,), or None
        Of the angle behind the gears, where that was measured.
    tip_before_mm, tip_after_mm : float or None
        Distance of the tip from where the measured link angles put it, hinges straight; root mean square.
    tip_apart_mm : float
        Distance between the tips of the two simulations, root mean square.
    of_s : float
        Length of the recording; a part is simulated where it is long, a shorter one where effects make that slow.
    """

    recording: str
    seconds: float
    motor_before_mrad: Array
    motor_after_mrad: Array
    link_before_mrad: Array | None
    link_after_mrad: Array | None
    tip_before_mm: float | None
    tip_after_mm: float | None
    tip_apart_mm: float
    of_s: float

    def as_json(self) -> dict[str, Any]:
        """The content of ``motion.json``, but for its schema."""

        def both(before: Array | float | None, after: Array | float | None) -> dict[str, Any] | None:
            if before is None or after is None:
                return None
            return {"before": np.asarray(before).tolist(), "after": np.asarray(after).tolist()}

        return {
            "recording": self.recording,
            "seconds": self.seconds,
            "motor_rms_mrad": both(self.motor_before_mrad, self.motor_after_mrad),
            "link_rms_mrad": both(self.link_before_mrad, self.link_after_mrad),
            "tip_rms_mm": both(self.tip_before_mm, self.tip_after_mm),
            "tip_apart_rms_mm": self.tip_apart_mm,
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
    count = min(len(before.time), len(after.time), recording.samples)
    robot = after.robot

    def off(run: Simulation, name: str) -> Array | None:
        measured, simulated = getattr(recording, name), getattr(run.recording, name)
        if measured is None or simulated is None:
            return None
        return 1e3 * np.sqrt(((simulated[:count] - measured[:count]) ** 2).mean(axis=0))

    def tip_off(run: Simulation) -> float | None:
        if recording.link_position is None:
            return None
        return _distance_mm(run.tip[:count], tip_poses(robot.tree, robot.tip_frame, recording.link_position[:count]))

    motor = [off(run, "position") for run in (before, after)]
    assert motor[0] is not None and motor[1] is not None
    return MotionErrors(
        recording.name,
        count / recording.sample_rate_hz,
        motor[0],
        motor[1],
        off(before, "link_position"),
        off(after, "link_position"),
        tip_off(before),
        tip_off(after),
        _distance_mm(before.tip[:count], after.tip[:count]),
        recording.samples / recording.sample_rate_hz,
    )


def _distance_mm(one: Array, other: Array) -> float:
    """Root mean square distance of two paths of poses, (N, 4, 4)."""
    return float(1e3 * np.sqrt(((one[:, :3, 3] - other[:, :3, 3]) ** 2).sum(axis=1).mean()))
