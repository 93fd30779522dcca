"""``rx90b-flex excite``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from rx90b_flex.commands.shared import CampaignOut, HighHz, LowHz, Overwrite, RobotSource, numbers, progress, say

# options that take several lines
InputMatrix = Annotated[str, Option(help="Input matrix: ones (-1 down the diagonal), hadamard or identity.")]
Peak = Annotated[
    str | None,
    Option(help="Largest torque, N m (N where a joint slides): one, or one a joint; 10 % of the limits otherwise."),
]
White = Annotated[bool, Option("--white", help="Spectrum over the loop's sensitivity: drive torques are white.")]
ControllerFile = Annotated[
    Path | None,
    Option(help="Controller file (TOML): for --white, --simulate, references that order torques, and frf's replay."),
]
CarriedBy = Annotated[
    str, Option(help="What carries the excitation: torque (fed forward), reference (motion alone) or both.")
]
SpeedPeak = Annotated[
    str | None,
    Option(help="Largest speed added to references, rad/s, one or one a joint, where no controller file is given."),
]
Poses = Annotated[
    list[str] | None, Option(help="Degrees (m where a joint slides), one a joint: 0,90,0; repeat for more poses.")
]
RateHz = Annotated[float | None, Option(help="Rate of the references; the controller file's otherwise.")]


def excite_command(
    robot: RobotSource,
    out: CampaignOut,
    pose: Poses = None,
    joints: Annotated[str | None, Option(help="Joints to excite: NAME,NAME; the first three otherwise.")] = None,
    matrix: InputMatrix = "ones",
    peak: Peak = None,
    low_hz: LowHz = 2.5,
    high_hz: HighHz = 80.0,
    period_s: Annotated[float, Option(help="Period; a longer one has finer lines.")] = 4.096,
    speed: Annotated[float, Option(help="Joint speed between reversals, rad/s or m/s.")] = 0.11,
    swings: Annotated[int, Option(help="Times to and fro in a period; odd.")] = 1,
    realisations: Annotated[int, Option(help="Multisines with other phases.")] = 16,
    periods: Annotated[int, Option(help="Periods of a run; the first is for the transient.")] = 9,
    one_sign: Annotated[bool, Option("--one-sign", help="Without the runs of opposite sign.")] = False,
    white: White = False,
    controller: ControllerFile = None,
    by: CarriedBy = "torque",
    speed_peak: SpeedPeak = None,
    rate_hz: RateHz = None,
    simulate: Annotated[bool, Option("--simulate", help="Simulate the robot's logs, too.")] = False,
    seed: Annotated[int, Option(help="Seed of phases and noise.")] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Write the motions that frf needs, and the campaign file.

    With --simulate, the logs as well, of the robot as its file declares it.
    """
    from rx90b_flex.signals.folders import CAMPAIGN, check_folder

    check_folder(out, CAMPAIGN, overwrite)
    from rx90b_flex.files.keys import whole_names
    from rx90b_flex.robot import load_robot

    loaded = load_robot(robot)
    from rx90b_flex.simulate.excite import ExciteRequest, excite_into

    poses = tuple(tuple(loaded.pose_of(numbers("pose", x), f"pose {k}")) for k, x in enumerate(pose or [], start=1))
    request = ExciteRequest(
        robot, poses, whole_names(joints.split(","), loaded.joints) if joints else (), matrix,  # type: ignore[arg-type]
        numbers("peak", peak) if peak else (), (low_hz, high_hz), period_s, speed, swings, realisations, periods,
        not one_sign, white, controller, seed, by, numbers("speed-peak", speed_peak) if speed_peak else (), rate_hz,  # type: ignore[arg-type]
    )  # fmt: skip
    with progress() as tell:
        said = excite_into(request, out, simulate, tell, overwrite, loaded)
    for text in said:
        say(text)
    say(f"{'Campaign' if simulate else 'References, and a campaign file for the logs'}: {out}")
