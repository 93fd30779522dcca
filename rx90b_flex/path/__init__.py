"""A Cartesian path with a speed: can the robot follow it, how far does its tip stray, why, and how to correct it."""

from rx90b_flex.path.check import Contribution, Deviation, Options, PathCheck, check_path
from rx90b_flex.path.plan import Plan, plan
from rx90b_flex.path.seam import EXAMPLES, Seam, load_seam

__all__ = [
    "EXAMPLES",
    "Contribution",
    "Deviation",
    "Options",
    "PathCheck",
    "Plan",
    "Seam",
    "check_path",
    "load_seam",
    "plan",
]
