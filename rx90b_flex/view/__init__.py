"""Figures, reports and moving pictures of results; nothing here works out a result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rx90b_flex.view.report import report_html, write_report

if TYPE_CHECKING:
    from rx90b_flex.view.meshcat import Run, View, compare, show, show_modes

__all__ = ["Run", "View", "compare", "report_html", "show", "show_modes", "write_report"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from rx90b_flex.view import meshcat  # not at the top: a report needs no server and no notebook

    return getattr(meshcat, name)
