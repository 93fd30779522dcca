"""Cascaded drive controllers, a position loop (P) around a velocity loop (PI), as the PID that does the same.

With f the part of the reference's speed that is fed forward, e the drive's angle and r the reference, the cascade

    u = Kv (w + 1/Ti int w dt) + J r'' + feed-forward,    w = Kp (r - e) + f r' - e'

is, up to a constant that the integrator holds from the start,

    u = (Kv Kp + Kv/Ti) (r - e) + Kv (r' - e') + Kv Kp/Ti int (r - e) dt
        - (1 - f) Kv r' - (1 - f) Kv/Ti (r - r_0) + J r'' + feed-forward:

a PID, and a torque that the reference alone decides. Where the speed e' is filtered on its way to the velocity loop, to F e', so is
what its integral sees: ``-Kv/Ti int (F e' - e') dt`` besides.
"""

from __future__ import annotations

from inspect import Parameter, signature

from rx90b_flex.simulate.cs8 import JointController


def cascade(
    name: str,
    *,
    position_loop: float,
    velocity_loop: float,
    torque_limit: float,
    integral_time_s: float = 0.0,
    velocity_feedforward: float = 0.0,
    inertia_feedforward: float = 0.0,
    position_step: float = 0.0,
    velocity_step: float = 0.0,
    torque_step: float = 0.0,
) -> JointController:
    """One joint's loops, joint side, as a PID and a torque of the reference.

    Parameters
    ----------
    name : str
    position_loop : float
        Kp, 1/s: speed that is asked for over angle error.
    velocity_loop : float
        Kv, N m s/rad: torque over speed error.
    integral_time_s : float
        Ti of the velocity loop, s; 0: no integral.
    velocity_feedforward : float
        f, 0 to 1.
    inertia_feedforward : float
        J, kg m^2.
    position_step, velocity_step, torque_step, torque_limit
        As `JointController` has them.
    """
    if velocity_feedforward > 1.0:
        raise ValueError(f"velocity_feedforward is {velocity_feedforward:g}; expected 0 to 1")
    rate = 1.0 / integral_time_s if integral_time_s > 0.0 else 0.0
    lacking = 1.0 - velocity_feedforward
    return JointController(
        name,
        position_gain=velocity_loop * (position_loop + rate),
        velocity_gain=velocity_loop,
        integral_gain=velocity_loop * position_loop * rate,
        position_step=position_step,
        velocity_step=velocity_step,
        torque_step=torque_step,
        torque_limit=torque_limit,
        by_reference=-lacking * velocity_loop * rate,
        by_reference_speed=-lacking * velocity_loop,
        by_reference_acceleration=inertia_feedforward,
        filtered_speed_gain=velocity_loop * rate,
    )


NUMBERS = [x.name for x in signature(cascade).parameters.values() if x.kind is x.KEYWORD_ONLY]
NEEDED = [name for name in NUMBERS if signature(cascade).parameters[name].default is Parameter.empty]
