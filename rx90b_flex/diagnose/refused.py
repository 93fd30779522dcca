"""What closing the loop ends with where the data cannot be used: the faults, and nothing that they would be mistaken for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, ClassVar

from rx90b_flex.diagnose.check import Checked, faults_json
from rx90b_flex.robot import Robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals import Campaign
from rx90b_flex.signals.data_fault import DataFault

DATA_FAULT = "data_fault"


class OfCampaign(Showing):
    """A result about a declared robot and a campaign whose data were looked at."""

    source: Robot
    campaign: Campaign
    checked: Checked

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return self.source.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Of the campaign."""
        return self.campaign.joints

    @property
    def data_faults(self) -> tuple[DataFault, ...]:
        """What the look at the data found."""
        return self.checked.data_faults

    @property
    def undeclared_basics(self) -> tuple[str, ...]:
        """Effect types that every drive has and no joint declares, although the torques show them."""
        return self.checked.undeclared_basics


@dataclass(frozen=True, eq=False, repr=False)
class RefusedLoop(OfCampaign):
    """Result of a loop that was not begun; the content of its ``closed_loop.json`` as attributes.

    Attributes
    ----------
    checked : Checked
        All that the look at the data says, which found them not usable.
    source : Robot
        The declared robot, as loaded.
    campaign : Campaign
    verdict : str
        ``data_fault``.
    effects : tuple
        Empty.
    before, after, noise_floor, explainable, moving, unexplained : None
    """

    verdict: ClassVar[str] = DATA_FAULT
    effects: ClassVar[tuple[()]] = ()
    before: ClassVar[None] = None
    after: ClassVar[None] = None
    noise_floor: ClassVar[None] = None
    explainable: ClassVar[None] = None
    moving: ClassVar[None] = None
    unexplained: ClassVar[None] = None

    checked: Checked
    source: Robot
    campaign: Campaign


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
