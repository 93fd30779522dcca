"""Figures, reports and moving pictures of results; nothing here works out a result."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rx90b_flex.view.meshcat import Run, View, compare, show, show_modes
    from rx90b_flex.view.report import report_html, write_report

__all__ = ["Run", "View", "compare", "report_html", "show", "show_modes", "write_report"]

# loaded when they are asked for, so that one name does not cost the libraries of all
_HOME = {
    "Run": "rx90b_flex.view.meshcat",
    "View": "rx90b_flex.view.meshcat",
    "compare": "rx90b_flex.view.meshcat",
    "report_html": "rx90b_flex.view.report",
    "show": "rx90b_flex.view.meshcat",
    "show_modes": "rx90b_flex.view.meshcat",
    "write_report": "rx90b_flex.view.report",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
