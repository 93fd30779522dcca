"""A motor constant that is not what the log assumes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rx90b_flex.effects.effect import Effect, JointEffect
from rx90b_flex.effects.hints import Sites
from rx90b_flex.effects.log_effect import LogEffect
from rx90b_flex.effects.motion import Array, JointMotion, Motion
from rx90b_flex.effects.parameters import Parameter, derived


@dataclass(frozen=True, kw_only=True)
class TorqueGain(LogEffect, JointEffect, needs_model=True, multiplies=True):
    """The logged torque is `gain` times the true one: a motor constant, a gear ratio or a unit that is not what the log assumes.

    It is linear in ``gain - 1``, whose column is the model's torque; a fit goes on until that torque is the one with the gain in
    the model.

    Signature
    ---------
    Proportional to the joint's whole torque: gravity, inertia and friction alike.

    Neighbours
    ----------
    A heavier link changes the torques of the joints before it too; a wrong gain that of one joint alone. All gains together cannot be
    told from heavier links, nor one gain where nothing else feels that joint's links: a known payload, known links or a torque sensor
    fix the scale. `motor_saturation` acts at the torque's peaks only.

    Source
    ------
    Not in Hardeman 2008; M. Gautier, S. Briot, *Global identification of joint drive gains and dynamic parameters of robots*, ASME
    Journal of Dynamic Systems, Measurement, and Control 136(5), 2014.
    """

    acts_at: ClassVar[str] = "drive"

    gain: float | None = derived("-", lower=0.0)

    @property
    def coefficient_parameters(self) -> dict[str, Parameter]:
        return {"excess": Parameter("-", "linear", -1.0)}

    @property
    def coefficients(self) -> Array:
        return np.array([np.nan if self.gain is None else self.gain - 1.0])

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        excess = float(values[0])
        return dataclasses.replace(self, gain=None if np.isnan(excess) else 1.0 + excess)

    def basis(self, at: JointMotion) -> Array:
        return at.motion.model_torque[:, int(np.flatnonzero(at.port)[0])][:, None]

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [cls(joint=j) for j in sites.joints if j not in sites.open_scale]

    def _gains(self, joints: Sequence[str]) -> Array:
        (excess,) = self.known_coefficients()
        return np.array([1.0 + excess if joint == self.joint else 1.0 for joint in joints])

    def logged(self, motion: Motion, torque: Array) -> Array:
        port = motion.coordinates.port(self.joint, "drive")
        return torque * (1.0 + self.known_coefficients()[0] * port)

    def logged_torque(self, joints: Sequence[str], time: Array, torque: Array) -> Array:
        return np.asarray(torque * self._gains(joints)[:, None])
