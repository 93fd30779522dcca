"""Torques of a campaign in N m: what made them so, and where two torques of a joint disagree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.torque import TorqueData
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.torque_scale import TorqueConstant, resolved
from rx90b_flex.identify.torque_sensors import calibrated
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign

FEWEST_BLOCKS = 4  # to hold out in turn; with less, the spread of a gain between them says nothing


@dataclass(frozen=True, eq=False)
class Torques:
    """A campaign whose torques are in N m, the constants that made them so, and what is said of its torque sensors."""

    campaign: Campaign
    constants: tuple[TorqueConstant, ...]
    calibrated: tuple[str, ...]

    @staticmethod
    def of(campaign: Campaign, robot: Robot) -> Torques:
        """By the constants that are stated, or that torque sensors or a robot's model tell."""
        known, constants = resolved(campaign, robot)
        known, words = calibrated(known)
        return Torques(known, constants, words)

    def data(self, declared: Robot) -> TorqueData:
        """Ready to be fitted.

        Raises
        ------
        ValueError
            Recordings that are too short for parts of them to be held out.
        """
        data = TorqueData.of(declared, self.campaign)
        if len(data.regression.blocks()) < FEWEST_BLOCKS:
            seconds = sum(r.duration_s for r in self.campaign.identification)
            raise ValueError(
                f"{self.campaign.path}: the recordings with role 'identification' last {seconds:.3g} s in all; "
                f"{FEWEST_BLOCKS} s or more are needed, for parts of them are held out"
            )
        return data


def sensor_words(declared: Identification, model: Identification) -> tuple[str, ...]:
    """What torque sensors behind the gears, fitted beside the motors, leave before and after."""
    first, sensors = len(model.regression.joints), model.regression.sensors
    sizes = [
        np.sqrt((x[:, first:] ** 2).mean(axis=0)) for x in (declared.residual, model.residual, model.regression.torque)
    ]
    words = [
        f"The torque sensor of {joint} was fitted beside its motor: of {size:.3g} N m that vary in it the declared model leaves "
        f"{before:.3g} N m, the final one {after:.3g} N m."
        for joint, before, after, size in zip(sensors, *sizes, strict=True)
    ]
    words += [
        f"{e.label} is what the motor's torque is over what the torque sensor of {e.joints[0]} and the links ask for: motor "
        "constant and sensor disagree, and the log does not say which of them is off."
        for e in model.effects
        if e.traits.multiplies and e.joints[0] in sensors
    ]
    return tuple(words)
