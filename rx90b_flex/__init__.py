"""Models of industrial robots whose drives and joints bend, and the search for what a model lacks."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from rx90b_flex.on_demand import names_of

if TYPE_CHECKING:
    from rx90b_flex.diagnose.check import Checked, check
    from rx90b_flex.diagnose.close import ClosedLoop, close_loop
    from rx90b_flex.diagnose.replayed import replay_errors
    from rx90b_flex.fleet.fleet import Fleet, close_loop_many
    from rx90b_flex.identify.inverse_eigenvalue import DriveParameters, drive_parameters
    from rx90b_flex.robot import Robot, load_robot
    from rx90b_flex.simulators import Exported, export_robot
    from rx90b_flex.verbs import check_path, excite, frf, identify, simulate, view

    __version__: str

__all__ = [
    "Checked",
    "ClosedLoop",
    "DriveParameters",
    "Exported",
    "Fleet",
    "Robot",
    "__version__",
    "check",
    "check_path",
    "close_loop",
    "close_loop_many",
    "drive_parameters",
    "excite",
    "export_robot",
    "frf",
    "identify",
    "load_robot",
    "replay_errors",
    "simulate",
    "view",
]

# loaded when they are asked for: the command line must not wait for all of them
_load = names_of(__name__)


_FOLDERS = ("identify", "simulate", "view")  # verbs that have the name of one


class _Package(ModuleType):
    """This package: what has the name of a verb and of a folder is the verb, also after something of the folder was imported.

    An import puts a folder's module into the package under its name. For verbs it is not put there, but becomes the verb's name
    space, so that ``rx90b_flex.view(...)`` is a call and ``rx90b_flex.view.meshcat`` a module all the same.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in _FOLDERS):
            super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return import_module, (self.__name__,)  # functions that use it go to other processes


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("rx90b-flex")
        except PackageNotFoundError:  # a source tree that is not installed
            return "0+unknown"
    value = _load(name)
    if name in _FOLDERS:
        value.__dict__ = vars(import_module(f"{__name__}.{name}"))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
