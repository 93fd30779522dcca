"""Torque sensors behind the gears that do not belong to their motors."""

from __future__ import annotations

from rx90b_flex.identify.torque_sensors import wrong_sensors
from rx90b_flex.signals import Campaign
from rx90b_flex.signals.data_fault import DataFault


def sensor_faults(campaign: Campaign) -> list[DataFault]:
    """Of a campaign's torque sensors, as a fit would find them; the data can be used all the same, without them."""
    return [
        DataFault(w.kind, "joint_torque", w.joints, w.message, usable=True, factor=w.factor)
        for w in wrong_sensors(campaign)
    ]
