"""A Cartesian path with a speed: can the robot follow it, how far does its tip stray, why, and how to correct it."""

from typing import TYPE_CHECKING

from rx90b_flex.on_demand import names_of

if TYPE_CHECKING:
    from rx90b_flex.path.check import Contribution, Deviation, PathCheck, PathOptions, check_path
    from rx90b_flex.path.measured import MeasuredTip, compare_measured
    from rx90b_flex.path.planning import PathPlan, plan
    from rx90b_flex.path.seam import EXAMPLES, Seam, load_seam

__all__ = [
    "EXAMPLES",
    "Contribution",
    "Deviation",
    "MeasuredTip",
    "PathCheck",
    "PathOptions",
    "PathPlan",
    "Seam",
    "check_path",
    "compare_measured",
    "load_seam",
    "plan",
]

__getattr__ = names_of(__name__)
