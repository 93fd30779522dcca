"""What closing the loop ends with where the data cannot be used: the faults, and nothing that they would be mistaken for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from rx90b_flex.diagnose.check import Checked, faults_json
from rx90b_flex.diagnose.faults.fault import DataFault
from rx90b_flex.robot import Robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals import Campaign

DATA_FAULT = "data_fault"


@dataclass(frozen=True, eq=False, repr=False)
class RefusedLoop(Showing):
    """Result of a loop that was not begun; the content of its ``closed_loop.json`` as attributes.

    Attributes
    ----------
    robot : str
    joints : tuple of str
    data_faults : tuple of DataFault
    checked : Checked
        All that the look at the data says.
    source : Robot
        The declared robot, as loaded.
    campaign : Campaign
    verdict : str
        ``data_fault``.
    effects : tuple
        Empty.
    before, after, noise_floor, explainable, moving, unexplained : None
    """

    robot: str
    joints: tuple[str, ...]
    data_faults: tuple[DataFault, ...]
    checked: Checked
    source: Robot
    campaign: Campaign
    verdict: str = DATA_FAULT
    effects: tuple[()] = ()
    before: None = None
    after: None = None
    noise_floor: None = None
    explainable: None = None
    moving: None = None
    unexplained: None = None

    @staticmethod
    def of(checked: Checked, robot: Robot, campaign: Campaign) -> RefusedLoop:
        """From a look that found the data not usable."""
        return RefusedLoop(robot.name, campaign.joints, checked.data_faults, checked, robot, campaign)


def refused_json(result: RefusedLoop) -> dict[str, Any]:
    """The content of ``closed_loop.json``, schema 1: every key, and null where there is nothing."""
    return {
        "schema": 1,
        "robot": result.robot,
        "joints": list(result.joints),
        "before": None,
        "after": None,
        "noise_floor": None,
        "effects": [],
        "verdict": result.verdict,
        "data_faults": faults_json(result.data_faults),
        "explainable": None,
        "moving": None,
        "unexplained": None,
    }


def verdict_despite(verdict: str, checked: Checked, scaled: Collection[str]) -> str:
    """A verdict on data with a fault that no model mends: nothing is explained for certain, nor is nothing missing.

    Parameters
    ----------
    verdict : str
        As the errors alone have it.
    checked : Checked
    scaled : collection of str
        Joints whose torque the model scales: a wrong gain found there is in the model, one found elsewhere has become mass.
    """
    hidden = any(f.kind == "torque_gain" and not set(f.joints) <= set(scaled) for f in checked.data_faults)
    if checked.usable and not hidden:
        return verdict
    return {"explained": "partly_explained", "nothing_missing": "unexplained"}.get(verdict, verdict)
