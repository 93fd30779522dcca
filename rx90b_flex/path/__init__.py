"""A Cartesian path with a speed: can the robot follow it, how far does its tip stray, why, and how to correct it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

# loaded when they are asked for, so that one name does not cost the libraries of all
_HOME = {
    "Contribution": "rx90b_flex.path.check",
    "Deviation": "rx90b_flex.path.check",
    "EXAMPLES": "rx90b_flex.path.seam",
    "MeasuredTip": "rx90b_flex.path.measured",
    "PathOptions": "rx90b_flex.path.check",
    "PathCheck": "rx90b_flex.path.check",
    "PathPlan": "rx90b_flex.path.planning",
    "Seam": "rx90b_flex.path.seam",
    "check_path": "rx90b_flex.path.check",
    "compare_measured": "rx90b_flex.path.measured",
    "load_seam": "rx90b_flex.path.seam",
    "plan": "rx90b_flex.path.planning",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
