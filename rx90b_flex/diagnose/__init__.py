"""Closing the loop: what measured data still holds, which effect explains it, and what is left."""

from typing import TYPE_CHECKING

from rx90b_flex.on_demand import names_of

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

__getattr__ = names_of(__name__)
