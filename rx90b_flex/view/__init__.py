"""Figures and reports of results; nothing here works out a result."""

from rx90b_flex.view.report import report_html, write_report

__all__ = ["report_html", "write_report"]
