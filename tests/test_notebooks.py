"""Notebooks are saved without output and begin with a title; `pytest --nbmake notebooks` runs them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
import pytest

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))


def notebook(name: str) -> Any:
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_valid_and_saved_without_output(name: str) -> None:
    read = notebook(name)
    nbformat.validate(read)
    for cell in read.cells:
        if cell.cell_type == "code":
            assert not cell.outputs and cell.execution_count is None, cell.source


@pytest.mark.parametrize("name", NAMES)
def test_notebook_starts_with_its_title(name: str) -> None:
    first = notebook(name).cells[0]
    assert first.cell_type == "markdown" and first.source.startswith("# ")
