"""Closing the loop: what measured data still holds, which effect explains it, and what is left."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rx90b_flex.diagnose.close import close_loop
    from rx90b_flex.diagnose.close_flexible import close_modal, close_response
    from rx90b_flex.diagnose.modal import load_modal_table

__all__ = ["close_loop", "close_modal", "close_response", "load_modal_table"]

# loaded when they are asked for, so that one name does not cost the libraries of all
_HOME = {
    "close_loop": "rx90b_flex.diagnose.close",
    "close_modal": "rx90b_flex.diagnose.close_flexible",
    "close_response": "rx90b_flex.diagnose.close_flexible",
    "load_modal_table": "rx90b_flex.diagnose.modal",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
