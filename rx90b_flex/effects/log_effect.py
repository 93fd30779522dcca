"""What stands between robot and log."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array, Motion


class LogEffect(Effect, in_dynamics=False):
    """An effect that is no force of the robot: it changes what controller and log are shown, or what the motors give."""

    def laws(self, motion: Motion) -> tuple[Law, ...] | None:
        """`measurement_error` and `motor_torque` as laws at ``measured`` and ``motor``; None: they are asked at each sample."""
        of = type(self)
        asked = of.measurement_error is not LogEffect.measurement_error or of.motor_torque is not LogEffect.motor_torque
        return None if asked else ()

    def logged(self, motion: Motion, torque: Array) -> Array:
        """Torque in the log (N, n) where the model's torque is `torque` (N, n)."""
        return torque + self.force(motion)

    def simulated(self, beside: Sequence[Effect]) -> Effect | None:
        """The force that it is in a simulation, beside the robot's other effects; None where it is none."""
        return None

    def measurement_error(self, motion: Motion) -> tuple[Array, Array] | None:
        """What controller and log are shown beyond the angles and their rates, each (N, n); None: nothing."""
        return None

    def motor_torque(self, joints: Sequence[str], torque: Array) -> Array:
        """Torques that the motors give where the controller and the log say `torque` (N, joints)."""
        return torque

    def commanded_torque(self, joints: Sequence[str], torque: Array) -> Array:
        """The inverse of `motor_torque`."""
        return torque

    def logged_torque(self, joints: Sequence[str], time: Array, torque: Array) -> Array:
        """Log of the torque (N, joints, lanes) at uniform times (N,); the first `history_s` of it is there to look back on."""
        return torque

    @property
    def history_s(self) -> float:
        """How far `logged_torque` looks back, s."""
        return 0.0


def between(effects: Sequence[Effect]) -> tuple[LogEffect, ...]:
    """Those that stand between a robot and its log."""
    return tuple(e for e in effects if isinstance(e, LogEffect))


def in_simulation(effects: Sequence[Effect]) -> list[Effect]:
    """A robot's effects as the forces that they are in a simulation.

    Raises
    ------
    ValueError
        One that cannot be simulated beside the others.
    """
    forces = (e.simulated(effects) if isinstance(e, LogEffect) else e for e in effects)
    return [force for force in forces if force is not None]
