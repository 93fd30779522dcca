"""Models of industrial robots whose drives and joints bend, and the search for what a model lacks."""

from importlib.metadata import PackageNotFoundError, version

from rx90b_flex.diagnose.close import ClosedLoop, close_loop
from rx90b_flex.identify.inverse_eigenvalue import DriveParameters, drive_parameters
from rx90b_flex.robot import Robot, load_robot

try:
    __version__ = version("rx90b-flex")
except PackageNotFoundError:  # a source tree that is not installed
    __version__ = "0+unknown"

__all__ = ["ClosedLoop", "DriveParameters", "Robot", "__version__", "close_loop", "drive_parameters", "load_robot"]
