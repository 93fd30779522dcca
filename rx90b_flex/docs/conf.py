"""Sphinx settings. Build: `sphinx-build -W rx90b_flex/docs build/docs`. The catalogue's pages are made from the effects' classes."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

from effect_pages import write_pages  # noqa: E402

import rx90b_flex  # noqa: E402

# their names are loaded when asked for, and autodoc does not ask
for package in map(import_module, ("rx90b_flex.path", "rx90b_flex.simulate")):
    for name in package.__all__:
        setattr(package, name, getattr(package, name))

project = "rx90b_flex"
author = "the rx90b_flex authors"
copyright = author
version = release = rx90b_flex.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes and units stand in the text
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
# types are words, such as "array, shape (N, joints)": as fields they would be looked up as names of Python objects
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style"), "Signature", "Neighbours", "Source"]

exclude_patterns = ["study_forms_table.md", "study_table.md", "study_frequency_table.md"]  # parts of study.md
html_theme = "furo"
html_title = "rx90b_flex"
html_show_sourcelink = False


def plain_text(app: Any, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Docstrings are plain text first: |v| outside a literal is a size, no substitution; a property's text is no type."""
    if what in ("property", "attribute"):
        lines.insert(0, "")
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        parts[::2] = (re.sub(r"\|([^|]+)\|", r"\\|\1\\|", part) for part in parts[::2])
        lines[i] = "".join(parts)


def setup(app: Any) -> None:
    """Write the catalogue before Sphinx looks for pages."""
    write_pages(HERE / "effects")
    app.connect("autodoc-process-docstring", plain_text, priority=400)  # before napoleon
