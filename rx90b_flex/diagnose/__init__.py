"""Closing the loop: what measured data still holds, which effect explains it, and what is left."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rx90b_flex.diagnose.close import close_loop
    from rx90b_flex.diagnose.likelihood import Change, LikelihoodResidual, State, close_residual
    from rx90b_flex.diagnose.modal import close_modal, load_modal_table
    from rx90b_flex.diagnose.response import close_response
    from rx90b_flex.diagnose.table import TableResidual

__all__ = [
    "Change",
    "LikelihoodResidual",
    "State",
    "TableResidual",
    "close_loop",
    "close_modal",
    "close_residual",
    "close_response",
    "load_modal_table",
]

# loaded when they are asked for, so that one name does not cost the libraries of all
_HOME = {
    "Change": "rx90b_flex.diagnose.likelihood",
    "LikelihoodResidual": "rx90b_flex.diagnose.likelihood",
    "State": "rx90b_flex.diagnose.likelihood",
    "TableResidual": "rx90b_flex.diagnose.table",
    "close_loop": "rx90b_flex.diagnose.close",
    "close_modal": "rx90b_flex.diagnose.modal",
    "close_response": "rx90b_flex.diagnose.response",
    "load_modal_table": "rx90b_flex.diagnose.modal",
    "close_residual": "rx90b_flex.diagnose.likelihood",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
