"""Figures, reports and moving pictures of results; nothing here works out a result."""

from typing import TYPE_CHECKING

from rx90b_flex.on_demand import names_of

if TYPE_CHECKING:
    from rx90b_flex.view.meshcat import Run, View, compare, show, show_modes
    from rx90b_flex.view.report import report_html, write_report

__all__ = ["Run", "View", "compare", "report_html", "show", "show_modes", "write_report"]

__getattr__ = names_of(__name__)
