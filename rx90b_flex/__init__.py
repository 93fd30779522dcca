"""Models of industrial robots whose drives and joints bend, and the search for what a model lacks."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rx90b_flex.diagnose.check import Checked, check
    from rx90b_flex.diagnose.close import ClosedLoop, close_loop
    from rx90b_flex.diagnose.replayed import replay_errors
    from rx90b_flex.identify.inverse_eigenvalue import DriveParameters, drive_parameters
    from rx90b_flex.robot import Robot, load_robot
    from rx90b_flex.simulators import Exported, export_robot

    __version__: str

__all__ = [
    "Checked",
    "ClosedLoop",
    "DriveParameters",
    "Exported",
    "Robot",
    "__version__",
    "check",
    "close_loop",
    "drive_parameters",
    "export_robot",
    "load_robot",
    "replay_errors",
]

# loaded when they are asked for: the command line must not wait for all of them
_HOME = {
    "Checked": "rx90b_flex.diagnose.check",
    "ClosedLoop": "rx90b_flex.diagnose.close",
    "DriveParameters": "rx90b_flex.identify.inverse_eigenvalue",
    "Exported": "rx90b_flex.simulators",
    "Robot": "rx90b_flex.robot",
    "check": "rx90b_flex.diagnose.check",
    "close_loop": "rx90b_flex.diagnose.close",
    "drive_parameters": "rx90b_flex.identify.inverse_eigenvalue",
    "export_robot": "rx90b_flex.simulators",
    "load_robot": "rx90b_flex.robot",
    "replay_errors": "rx90b_flex.diagnose.replayed",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("rx90b-flex")
        except PackageNotFoundError:  # a source tree that is not installed
            return "0+unknown"
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
