"""Closing the loop: what measured data still holds, which effect explains it, and what is left."""

from rx90b_flex.diagnose.close import close_loop
from rx90b_flex.diagnose.close_flexible import close_modal, close_response
from rx90b_flex.diagnose.modal import load_modal_table

__all__ = ["close_loop", "close_modal", "close_response", "load_modal_table"]
