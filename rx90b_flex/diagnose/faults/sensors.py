"""Torque sensors behind the gears that do not belong to their motors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from rx90b_flex.diagnose.faults.fault import DataFault
from rx90b_flex.identify.torque_sensors import wrong_sensors
from rx90b_flex.signals import Campaign, Recording


def sensor_faults(campaign: Campaign, recordings: Sequence[Recording]) -> list[DataFault]:
    """Of the torque sensors in a campaign's `recordings`; the data can be used all the same, without them."""
    looked_at = dataclasses.replace(campaign, recordings=tuple(recordings))
    return [
        DataFault(w.kind, "joint_torque", w.joints, w.factor, None, w.message, True) for w in wrong_sensors(looked_at)
    ]
