"""What a known payload adds to the inertial parameters of the links."""

from __future__ import annotations

import numpy as np

from rx90b_flex.effects.elements import unit_body
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.signals.stated import FlangeLoad

LINK = 10  # parameters of a body


def carried_parameters(robot: Robot, load: FlangeLoad) -> Array:
    """Change of a robot's link parameters by a point mass that is known, shape (10 * bodies,).

    A mass fixed to the tip frame is part of the link that the frame belongs to; the dynamics are linear in that link's ten
    parameters (3.47 to 3.52), so its torque in a recording is ``regressor @ carried_parameters``, with nothing to identify.

    Parameters
    ----------
    robot : Robot
        Rigid; the load's centre is given in its tip frame.
    load : FlangeLoad

    Raises
    ------
    ValueError
        No joint moves the tip frame, so the load does not show in any torque.
    """
    frame = robot.model.frames[robot.model.getFrameId(robot.tip_frame)]
    link = link_of_tip(robot)
    if link is None:
        raise ValueError(f"payload: no joint of {robot.name} moves its tip frame {robot.tip_frame!r}")
    out = np.zeros(LINK * len(robot.bodies))
    out[LINK * link : LINK * (link + 1)] = load.mass * unit_body(frame.placement.act(np.array(load.centre)))
    return out


def link_of_tip(robot: Robot) -> int | None:
    """Number of the link that the tip frame belongs to, among `robot.bodies`; None where no joint moves it."""
    joint = robot.model.frames[robot.model.getFrameId(robot.tip_frame)].parentJoint
    return next((i for i, (_, own) in enumerate(robot.bodies) if own == joint), None)
