"""Learning a correction: what to ask of the tip so that the deviation which the model predicts goes away.

With T(jw) the response of the tip to a displaced reference (hinges, drives and controller, linearised about poses along the path),
the next displacement of the reference is ``c - Q L e``, e the deviation of the tip, ``L = (T^H T + r I)^-1 T^H`` and Q a low-pass.
It runs forward and backward in time, so it adds no delay; it is repeated on the nonlinear simulation, which makes up for what the
linear T lacks (friction at reversal, poses in between).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.path.planning import HOLD_S, PathPlan, rates
from rx90b_flex.simulate.closed_loop import static_start
from rx90b_flex.simulate.cs8 import CS8, drive_places
from rx90b_flex.tip import jacobian_at

ComplexArray = NDArray[np.complex128]

BAND_HZ = 20.0  # choice: Q is 1 up to here and falls to 0 at twice this
REGULARISATION = 1e-2  # r; T is about 1 in the loop's bandwidth
SLIDING = 0.05  # rad/s; choice: slowest speed at which friction is linearised
POSE_EVERY = 0.15  # m along the path, between poses at which T is known; the tip moves by little of the arm's length
GRID_HZ = 0.25  # of T's frequencies, a quarter of the sharpest resonance's width
FADE_S = 0.5 * HOLD_S
PAD_S = 2.0  # over which the end of the deviation is led back to its beginning


class Learner:
    """The map from a deviation along a path to a displacement of its reference."""

    def __init__(self, plan: PathPlan, controller: CS8) -> None:
        total = plan.seam.pieces.total
        self.plan = plan
        self.knots = np.linspace(0.0, total, max(2, round(total / POSE_EVERY) + 1))
        self.hz = np.arange(0.0, 2.0 * BAND_HZ + GRID_HZ, GRID_HZ)
        # friction's slope at standstill would hold the drives, but they slide as soon as a correction moves them
        velocity = rates(plan.position, plan.rate_hz)
        velocity = np.where(velocity < 0.0, -1.0, 1.0) * np.maximum(np.abs(velocity), SLIDING)
        places = np.searchsorted(plan.distance, self.knots)
        self.inverse = np.stack(
            [self._inverse(tip_response(plan, controller, k, velocity[k], self.hz)) for k in places]
        )

    def _inverse(self, response: ComplexArray) -> ComplexArray:
        across = response.conj().transpose(0, 2, 1)
        regular = np.linalg.solve(across @ response + REGULARISATION * np.eye(3), across)
        fall = 0.5 * (1.0 + np.cos(np.pi * np.clip(self.hz / BAND_HZ - 1.0, 0.0, 1.0)))
        return np.asarray(fall[:, None, None] * regular)

    def __call__(self, deviation: Array) -> Array:
        """What to take off the reference, m, shape (N, 3), for a deviation of that shape."""
        count = len(deviation)
        pad = round(PAD_S * self.plan.rate_hz)
        back = 0.5 * (1.0 - np.cos(np.pi * (np.arange(pad) + 0.5) / pad))[:, None]
        closed = np.concatenate([deviation, deviation[-1] + back * (deviation[0] - deviation[-1])])
        spectrum = np.fft.rfft(closed, axis=0)
        hz = np.fft.rfftfreq(len(closed), 1.0 / self.plan.rate_hz)
        used = hz < self.hz[-1]
        out = np.zeros_like(deviation)
        for knot, inverse in enumerate(self.inverse):
            at = _between(hz[used], self.hz, inverse)
            learned = np.zeros_like(spectrum)
            learned[used] = np.einsum("fij,fj->fi", at, spectrum[used])
            hat = np.interp(self.plan.distance, self.knots, np.eye(len(self.knots))[knot])
            out += hat[:, None] * np.fft.irfft(learned, len(closed), axis=0)[:count]
        # the robot stands at either end: what the filter brings forward begins after the start, and ends before the end
        ends = np.minimum(self.plan.time, self.plan.time[::-1]) / FADE_S
        part = np.clip(ends, 0.0, 1.0)[:, None]
        rest = np.where(np.arange(count)[:, None] < count // 2, out[0], out[-1])
        return np.asarray(rest + part**3 * (10.0 - 15.0 * part + 6.0 * part**2) * (out - rest))


def _between(hz: Array, grid: Array, values: ComplexArray) -> ComplexArray:
    """Matrices between those of an even grid of frequencies."""
    part = hz / (grid[1] - grid[0])
    k = np.minimum(part.astype(int), len(grid) - 2)
    share = (part - k)[:, None, None]
    return np.asarray((1.0 - share) * values[k] + share * values[k + 1])


def tip_response(plan: PathPlan, controller: CS8, sample: int, velocity: Array, hz: Array) -> ComplexArray:
    """Displacement of the tip over that of the reference, shape (F, 3, 3), about a sample of the path.

    Parameters
    ----------
    sample : int
    velocity : array, shape (joints,), rad/s
        At which friction is linearised.
    hz : array, shape (F,)
        At 0 the controller's integrators have it follow.
    """
    robot, own = plan.robot, controller.for_joints(plan.robot.joints)
    q, v, _ = static_start(robot, plan.position[sample], velocity)
    about = robot.linearize(q, v)
    hz = np.maximum(hz, 1e-3)
    s = 2j * np.pi * hz[:, None, None]
    b = about.input_matrix
    moved = np.linalg.solve(
        about.M * s**2 + about.D * s + about.K, np.broadcast_to(b.astype(complex), (len(hz), *b.shape))
    )
    drives = moved[:, drive_places(robot)]
    gain = own.frequency_response(hz)[:, :, None]
    torque = np.linalg.solve(np.eye(len(own.joints)) + gain * drives, gain * plan.pull[sample])
    data = robot.model.createData()
    tip = robot.model.getFrameId(robot.tip_frame)
    jacobian = jacobian_at(robot.model, data, q, tip)[:3]
    return np.asarray(jacobian @ moved @ torque)
